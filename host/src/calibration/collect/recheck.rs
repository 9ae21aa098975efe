//! The self-check on a running robot: at a few poses, after waiting for rest, it measures lengths
//! and tensions and, with a camera, observes the tags; [`slip`](crate::calibration::slip) evaluates
//! them.

use super::CollectError;
use super::still::{self, Still};
use crate::calibration::slip::{Reading, SelfCheck, Sigmas};
use crate::estimate::{self, Measurements};
use crate::link::{Link, meanwhile};
use crate::motion::{Model, Task};
use crate::run::{Recorder, Session, plan_from};
use crate::sight::{TagSource, TagView};
use mcdpr_kinematics::Pose;
use nalgebra::Vector3;

/// Tool positions after home, m from home; unreachable ones are skipped.
const PLACES: [[f64; 3]; 8] = [
    [0.07, 0.08, -0.09],
    [0.14, -0.05, -0.05],
    [0.03, 0.16, -0.16],
    [0.16, 0.10, -0.20],
    [-0.05, 0.06, -0.06],
    [0.05, -0.06, -0.10],
    [-0.06, -0.07, -0.12],
    [0.0, 0.0, -0.08],
];

/// Measures at the present pose and at up to `places - 1` more, calls `judge` after each, and moves
/// back. Ends early if `judge` returns `false`. The robot must be armed.
///
/// # Errors
/// The link's, the camera's, a fault; [`CollectError::Impossible`] for a reading that fits no resting
/// pose.
pub fn recheck<L: Link>(
    model: &Model,
    session: &mut Session<'_, L>,
    source: Option<&mut dyn TagSource>,
    places: usize,
    sigmas: Sigmas,
    mut judge: impl FnMut(&SelfCheck<'_>, &Reading) -> bool,
) -> Result<(), CollectError> {
    let mut check = SelfCheck::new(model, sigmas);
    let mut source = source;
    let home = session.tool_m();
    // A robot in a plane goes to places in it.
    let normal = model.holding().freedom().normal();
    let in_plane = |by: Vector3<f64>| normal.map_or(by, |normal| by - normal * normal.dot(&by));
    let mut ways = (PLACES.iter()).map(|by| home + in_plane(Vector3::from(*by)));
    loop {
        let still = match &mut source {
            Some(source) => measure(model, session, *source)?,
            None => {
                let slowest_s = slowest_s(model, session)?;
                still::blind(session.client(), slowest_s)?
            }
        };
        let at = session.tool_m();
        let (reading, fits) = meanwhile(session.client(), || {
            let reading = reading_of(model, &still, &at);
            let fits = check.add(&reading);
            (reading, fits)
        })?;
        fits.map_err(|error| CollectError::Impossible {
            what: format!("what was measured fits no resting pose: {error}"),
            help: "home the robot again and calibrate it".into(),
        })?;
        if !judge(&check, &reading) || check.readings() >= places {
            break;
        }
        // The first of the places left that the robot can reach.
        let gone = ways.find_map(|to| go(model, session, to).transpose());
        match gone {
            Some(done) => done?,
            None => break,
        }
    }
    if let Some(done) = go(model, session, home).transpose() {
        done?;
    }
    Ok(())
}

/// Moves there; `None` if the move would break a limit.
fn go<L: Link>(
    model: &Model,
    session: &mut Session<'_, L>,
    to: Vector3<f64>,
) -> Result<Option<()>, CollectError> {
    let task = Task::go_to("check", to).map_err(crate::run::RunError::from)?;
    let at = session.tool_m();
    let plan = || plan_from(model, task, &at, None);
    let Ok(plan) = meanwhile(session.client(), plan)? else {
        return Ok(None);
    };
    session.follow(&plan, &mut Recorder::default(), |_| {})?;
    Ok(Some(()))
}

fn slowest_s<L: Link>(model: &Model, session: &mut Session<'_, L>) -> Result<f64, CollectError> {
    let here = session.at().clone();
    let slowest = || super::slowest_s(model, &here);
    Ok(meanwhile(session.client(), slowest)?)
}

fn measure<L: Link>(
    model: &Model,
    session: &mut Session<'_, L>,
    mut source: &mut dyn TagSource,
) -> Result<Still, CollectError> {
    let slowest_s = slowest_s(model, session)?;
    let tags = &model.robot().tags;
    let size_m = |id: u32| {
        let tag = tags.iter().find(|tag| tag.id == id)?;
        let [a, b, ..] = tag.corners_in_body_m;
        Some((b - a).norm())
    };
    match still::measure(session.client(), &mut source, size_m, slowest_s)? {
        still::Waited::Still(still) => Ok(still),
        // Without a tag in view lengths and tensions are still used.
        still::Waited::Nothing(_) => still::blind(session.client(), slowest_s),
    }
}

fn reading_of(model: &Model, still: &Still, near: &Vector3<f64>) -> Reading {
    Reading {
        lengths_m: still.lengths_m.clone(),
        tensions_n: still.tensions_n.clone(),
        seen: seen(model, still, near),
    }
}

/// Pose of the platform by the tags alone, with the attitude from statics.
fn seen(model: &Model, still: &Still, near: &Vector3<f64>) -> Option<Pose> {
    let calibrated = model.robot().calibrated.as_ref()?;
    let variance = still.sigma_px * still.sigma_px;
    let views = still.tags.iter().map(|tag| TagView {
        id: tag.id,
        corners_px: tag.corners_px,
        covariance_px2: [[[variance, 0.0], [0.0, variance]]; 4],
        image_time_us: 0,
    });
    let views: Vec<_> = views.collect();
    if views.is_empty() {
        return None;
    }
    let measured = Measurements {
        lengths_m: Vec::new(),
        tensions_n: still.tensions_n.clone(),
        views,
        places: calibrated.places.clone(),
    };
    let found = estimate::estimate(model, &measured, &estimate::Sigmas::default(), near).ok()?;
    Some(found.rest.equilibrium.pose)
}
