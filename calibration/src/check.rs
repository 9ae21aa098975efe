//! Checks of the data before anything is solved.

use super::data::Data;
use super::error::Refusal;
use super::pnp::sightings;
use mcdpr_kinematics::Pose;
use nalgebra::Vector3;

/// Fewest poses of a calibration.
pub const POSES_MIN: usize = 7;
/// Least variation of the platform's tilt, degrees.
pub(crate) const TILT_MIN_DEG: f64 = 1.0;

/// The poses that can be used, with a start value each.
#[derive(Debug, Clone)]
pub struct Usable {
    /// The data with the other poses left out.
    pub data: Data,
    /// Number (from 0) in the original data of each pose kept.
    pub number: Vec<usize>,
    /// world_from_platform of each pose, as the pictures and the start values have it.
    pub start: Vec<Pose>,
    /// What was left out and why.
    pub warnings: Vec<String>,
}

/// Leaves out poses without a usable picture and checks the rest.
///
/// # Errors
/// [`Refusal::TooFewPoses`], [`Refusal::Duplicate`], [`Refusal::OneTilt`].
pub fn usable(data: &Data) -> Result<Usable, Refusal> {
    for (second, b) in data.poses.iter().enumerate() {
        for (first, a) in data.poses.iter().take(second).enumerate() {
            // Noise does not repeat all readings exactly: such a pose was written twice.
            if a == b || (a.encoder_m == b.encoder_m && a.encoder_m.iter().all(Option::is_some)) {
                return Err(Refusal::Duplicate {
                    first: first + 1,
                    second: second + 1,
                });
            }
        }
    }
    let mut kept = Usable {
        data: data.clone(),
        number: Vec::new(),
        start: Vec::new(),
        warnings: Vec::new(),
    };
    let mut note = String::new();
    kept.data.poses.clear();
    for (k, seen) in data.poses.iter().enumerate() {
        if seen.encoder_m.iter().all(Option::is_none) {
            kept.warnings
                .push(format!("pose {}: no encoder reading; left out", k + 1));
            continue;
        }
        let Some(start) = start(data, k) else {
            kept.warnings
                .push(format!("pose {}: no tag in the picture; left out", k + 1));
            continue;
        };
        kept.data.poses.push(seen.clone());
        kept.number.push(k);
        kept.start.push(start);
    }
    let close = near_repeats(&kept.data);
    if close > 0 {
        note = format!(" ({close} repeat another pose within the noise)");
    }
    let got = kept.number.len().saturating_sub(close);
    if got < POSES_MIN {
        return Err(Refusal::TooFewPoses {
            got,
            total: data.poses.len(),
            needed: POSES_MIN,
            note,
        });
    }
    if close > 0 {
        kept.warnings.push(format!(
            "{close} poses repeat another within the noise: they add little"
        ));
    }
    let spread_deg = tilt_spread_deg(&kept.start);
    if spread_deg < TILT_MIN_DEG {
        return Err(Refusal::OneTilt {
            spread_deg,
            needed_deg: TILT_MIN_DEG,
        });
    }
    Ok(kept)
}

/// Number of poses whose lengths equal those of an earlier one within the noise.
fn near_repeats(data: &Data) -> usize {
    // Two readings of one place differ by 1.4 sigma of one reading: 6 sigma include nearly all.
    let limit = 6.0 * data.noise.encoder_m;
    let near = |a: &[Option<f64>], b: &[Option<f64>]| {
        a.iter().zip(b).all(|(x, y)| match (x, y) {
            (Some(x), Some(y)) => (x - y).abs() < limit,
            _ => true,
        })
    };
    let repeats = |(k, pose): &(usize, &super::data::Observation)| {
        let mut earlier = data.poses.iter().take(*k);
        earlier.any(|other| near(&other.encoder_m, &pose.encoder_m))
    };
    data.poses.iter().enumerate().filter(repeats).count()
}

/// Largest angle between the platform's z axes at two poses, degrees. The median pose is not known,
/// so that one misread picture must not count: the largest tenth of the angles is left out.
fn tilt_spread_deg(poses: &[Pose]) -> f64 {
    let axis = |pose: &Pose| pose.rotation.matrix().column(2).into_owned();
    let axes: Vec<Vector3<f64>> = poses.iter().map(axis).collect();
    let mut angles = Vec::with_capacity(axes.len() * axes.len() / 2);
    for (k, a) in axes.iter().enumerate() {
        for b in &axes[..k] {
            angles.push(a.angle(b).to_degrees());
        }
    }
    let place = angles.len() * 9 / 10;
    if angles.is_empty() {
        return 0.0;
    }
    *angles.select_nth_unstable_by(place, f64::total_cmp).1
}

/// The platform's pose from the body that shows most corners: of its candidates the one that
/// explains the corners, or if both do, the more level one.
fn start(data: &Data, k: usize) -> Option<Pose> {
    let seen = &data.poses[k];
    let count = |body: usize| {
        let on = seen
            .views
            .iter()
            .filter(|view| data.tags[view.tag].body == body);
        on.count()
    };
    let body =
        (0..data.world_from_body.len()).max_by_key(|&body| (count(body), usize::MAX - body))?;
    let candidates = sightings(data, seen, body);
    let best = candidates.first()?;
    let noise = data.noise.corner_px * data.noise.corner_px;
    let platform = |camera_from_body: &Pose| {
        data.world_from_body[body]
            .compose(&camera_from_body.inverse())
            .compose(&data.camera_from_platform)
    };
    candidates
        .iter()
        // A twin that is worse by less than 12 in chi-square cannot be excluded by its corners.
        .filter(|c| c.cost_px2 < best.cost_px2 + 12.0 * noise)
        .map(|c| platform(&c.camera_from_body))
        .min_by(|a, b| a.tilt_rad().total_cmp(&b.tilt_rad()))
}
