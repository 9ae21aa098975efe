//! One weighted problem over all unknowns that affect the measurements, solved and judged.

use super::answer::{Answer, RejectedRow, Solved, Unexplained};
use super::causes;
use super::check::{Usable, usable};
use super::data::Data;
use super::error::Refusal;
use super::general::slip;
use super::judge::{judge, wrong_size};
use super::observability::{Observability, observability};
use super::predict::predict;
use super::restart;
use super::rows::{Model, Scatter, Source};
use super::solve::{Minimum, solve};
use super::unknowns::{Layout, Priors, State};
use mcdpr_kinematics::Pose;

/// Choices of the joint estimate.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Options {
    /// Standard deviations of the priors.
    pub priors: Priors,
    /// Scatter of the rows for which no sensor noise is stated.
    pub scatter: Scatter,
    /// Leave the equations of equilibrium out even if they could be used.
    pub without_statics: bool,
    /// Also test the lower poses by the upper ones, map the expected error, and recommend the next
    /// pose: doubles the work.
    pub closer_looks: bool,
}

impl Options {
    /// For a robot whose winch modules, platform and lens are known: their parameters are held to
    /// the known values ten times as closely.
    #[must_use]
    pub fn frame_only() -> Self {
        let mut out = Self::default();
        let priors = &mut out.priors;
        for sigma in [
            &mut priors.radius_m,
            &mut priors.drum,
            &mut priors.focal,
            &mut priors.center_px,
            &mut priors.k1,
        ] {
            *sigma *= 0.1;
        }
        out
    }

    /// For a robot whose frame is calibrated; see [`Data::keep_frame_of`].
    #[must_use]
    pub fn camera_only() -> Self {
        let mut out = Self::default();
        out.priors.drum *= 0.1;
        out.priors.radius_m *= 0.1;
        out.priors.attachment_m *= 0.1;
        out
    }
}

/// One joint estimate, without further checks; see [`joint`](super::joint::joint).
pub(crate) fn fit(data: &Data, options: &Options) -> Result<Answer, Refusal> {
    match fit_again(data, options) {
        Err(refusal) if options.closer_looks && refusal.may_be_a_mistake() => {
            let slipped = || {
                let found = slip::in_data(data, None);
                let words: Vec<_> = found.into_iter().map(|slip| slip.words).collect();
                slipped(&words)
            };
            let size = || diagnosis(data, &usable(data).ok()?, options);
            // Another size explains much: a mistake that explains all comes first.
            Err(causes::named(data, &|data| fit_once(data, options))
                .or_else(size)
                .or_else(slipped)
                .unwrap_or(refusal))
        }
        Err(refusal @ (Refusal::Contradiction { .. } | Refusal::NotConverged { .. })) => {
            let usable = usable(data)?;
            Err(diagnosis(data, &usable, options).unwrap_or(refusal))
        }
        other => other,
    }
}

/// As [`fit`], with no cause of a refusal sought.
fn fit_once(data: &Data, options: &Options) -> Result<Answer, Refusal> {
    attempt(data, &usable(data)?, options)
}

/// As [`fit_once`]; where that refuses, once more from a start that does not depend on the stated places of tags and
/// camera.
fn fit_again(data: &Data, options: &Options) -> Result<Answer, Refusal> {
    fit_once(data, options).or_else(|refusal| {
        let again = || fit_once(&restart::from_statics(data)?, options).ok();
        let found = if refusal.may_be_a_mistake() {
            again()
        } else {
            None
        };
        let mut answer = found.ok_or(refusal)?;
        answer.warnings.push(
            "the stated places of tags and camera (`nominal`) are far off; they were found from lengths and tensions"
                .to_owned(),
        );
        Ok(answer)
    })
}

/// The refusal of data during which cables slipped.
pub(crate) fn slipped(slips: &[String]) -> Option<Refusal> {
    (!slips.is_empty()).then(|| Refusal::Contradiction {
        what: format!(
            "{}; check how that cable is held on its drum, and use the poses before or after only",
            slips.join("; ")
        ),
    })
}

fn attempt(data: &Data, usable: &Usable, options: &Options) -> Result<Answer, Refusal> {
    let model = model(usable, options);
    let minimum = solve(&model, &options.priors, start(usable, &model.layout))?;
    let anchor_sigma_m = data.robot.anchor_half_tolerance_m / 3f64.sqrt();
    let seen = observability(&model, anchor_sigma_m, &minimum)?;
    if !seen.harmful.is_empty() {
        return Err(Refusal::Degenerate {
            rank: seen.rank,
            expected: seen.unknowns - seen.harmless.len(),
            directions: seen.harmful.join(", "),
        });
    }
    answer(data, usable, &model, &minimum, &seen)
}

pub(crate) fn model<'a>(usable: &'a Usable, options: &Options) -> Model<'a> {
    let layout = Layout {
        cables: usable.data.cable_count(),
        bodies: usable.data.world_from_body.len(),
        statics: usable.data.has_statics() && !options.without_statics,
        tilt: usable.data.has_tilt(),
    };
    Model::new(&usable.data, layout, options.scatter)
}

/// Whether another tag size would explain data that do not fit as they are.
fn diagnosis(data: &Data, usable: &Usable, options: &Options) -> Option<Refusal> {
    let mut open = *options;
    // With the size left open to 50 %, data whose only error is the size do fit.
    open.priors.tag = 0.5;
    let model = model(usable, &open);
    let minimum = solve(&model, &open.priors, start(usable, &model.layout)).ok()?;
    let all = minimum.weights.iter().flatten().count() as f64;
    let used = minimum
        .weights
        .iter()
        .flatten()
        .filter(|w| **w > 0.0)
        .count() as f64;
    let scale = minimum.state.tag_scale;
    // Nearly all rows must be used: the few that suit each other fit any size.
    let explained = minimum.normal.chi_square < 1.6 * used && used > 0.9 * all;
    (explained && (scale - 1.0).abs() > 5e-3).then(|| wrong_size(data, scale))
}

/// Nominal values and the poses from the pictures.
pub(crate) fn start(usable: &Usable, layout: &Layout) -> State {
    let data = &usable.data;
    State {
        cables: data.robot.cables.clone(),
        // `solve` sets them from the poses of the pictures.
        initial_length_m: vec![0.0; layout.cables],
        routing_m: data.robot.routing_m.clone(),
        camera_from_platform: data.camera_from_platform,
        world_from_body: data.world_from_body.clone(),
        drum_scale: 1.0,
        drum_own: vec![0.0; layout.cables],
        camera: data.camera,
        focal_scale: 0.0,
        tag_scale: 1.0,
        compliance_per_n: if layout.statics {
            data.robot.compliance_per_n
        } else {
            0.0
        },
        soft_per_n: vec![0.0; layout.cables],
        mass_kg: data.robot.mass_kg,
        center_of_mass_m: data.robot.center_of_mass_m,
        loss: vec![0.0; layout.cables],
        zero_n: vec![0.0; layout.cables],
        mount_rad: nalgebra::Vector3::zeros(),
        poses: usable.start.clone(),
        tensions_n: data
            .poses
            .iter()
            .map(|pose| {
                pose.tension_n
                    .clone()
                    .unwrap_or_else(|| vec![0.0; layout.cables])
            })
            .collect(),
    }
}

fn answer(
    data: &Data,
    usable: &Usable,
    model: &Model<'_>,
    minimum: &Minimum,
    seen: &Observability,
) -> Result<Answer, Refusal> {
    let (layout, state) = (&model.layout, &minimum.state);
    let mut rejected = Vec::new();
    let (mut used, mut leverage) = (0usize, 0.0);
    for (k, sources) in minimum.sources.iter().enumerate() {
        for (j, source) in sources.iter().enumerate() {
            if minimum.weights[k][j] > 0.0 {
                used += 1;
                leverage += minimum.leverage[k][j];
            } else if !matches!(source, Source::Corner(_, _, 1)) {
                rejected.push(rejected_row(usable, minimum, k, j));
            }
        }
    }
    // The leverages add up to the number of unknowns that the readings determine.
    let freedom = (used as f64 - leverage).round().max(0.0);
    let chi_square = minimum.normal.chi_square;
    let mut warnings = usable.warnings.clone();
    judge(data, model, minimum, &rejected, freedom, &mut warnings)?;
    let mean = mean_tension_n(&usable.data);
    let mut out = Answer::of_state("joint", state, layout);
    let predict_at = |pose: &Pose| predict(state, layout, &minimum.covariance, &mean, pose);
    for (i, pose) in data.holdout.iter().enumerate() {
        let found = predict_at(pose).map_err(|error| {
            Refusal::field(format!("holdout_H_tag_platform[{i}]"), error.to_string())
        })?;
        out.holdout_encoder_m.push(found.encoder_m);
        out.holdout_covariance_m2.push(found.position_covariance_m2);
    }
    // Without other poses, the poses of the data.
    let tag_from_world = state.world_from_body[0].inverse();
    let mut squares: Vec<f64> = out
        .holdout_covariance_m2
        .iter()
        .map(nalgebra::Matrix3::trace)
        .collect();
    if squares.is_empty() {
        for pose in &state.poses {
            if let Ok(found) = predict_at(&tag_from_world.compose(pose)) {
                squares.push(found.position_covariance_m2.trace());
            }
        }
    }
    let mean_square = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
    out.predicted_error_m = mean_square.sqrt();
    out.worst_predicted_error_m = squares.iter().fold(0.0_f64, |a, b| a.max(*b)).sqrt();
    if out.predicted_error_m > 2e-3 {
        warnings.push(format!(
            "the predicted position error is {:.1} mm: a board of tags, or poses that tilt more, would \
             reduce it",
            out.predicted_error_m * 1e3
        ));
    }
    out.chi_square = Some(chi_square);
    out.degrees_of_freedom = Some(freedom);
    out.rank = seen.rank;
    out.core_unknowns = seen.unknowns;
    out.unobservable = seen.harmless.clone();
    out.rejected = rejected;
    out.rejected_stretch = stretch(data, usable, minimum);
    out.unexplained = layout.statics.then_some(Unexplained {
        force_n: minimum.force_n,
        moment_nm: minimum.moment_nm,
    });
    out.tension_scatter_relative = Some(minimum.tension_relative).filter(|_| layout.statics);
    out.warnings = warnings;
    out.iterations = minimum.iterations;
    out.covariance = Some(minimum.covariance.clone());
    out.solved = Some(Solved {
        state: state.clone(),
        layout: *layout,
        numbers: usable.number.clone(),
        mean_tension_n: mean,
    });
    Ok(out)
}

fn mean_tension_n(data: &Data) -> Vec<f64> {
    let mut sum = vec![0.0; data.cable_count()];
    let mut count = 0.0_f64;
    for tensions in data.poses.iter().filter_map(|pose| pose.tension_n.as_ref()) {
        count += 1.0;
        for (slot, t) in sum.iter_mut().zip(tensions) {
            *slot += t;
        }
    }
    sum.iter().map(|s| s / count.max(1.0)).collect()
}

fn rejected_row(usable: &Usable, minimum: &Minimum, k: usize, j: usize) -> RejectedRow {
    let pose = usable.number[k] + 1;
    let residuals = &minimum.normal.residuals[k];
    let mut row = RejectedRow {
        pose,
        kind: "encoder",
        cable: None,
        tag: None,
        corner: None,
        sigmas: residuals[j].abs(),
    };
    match minimum.sources[k][j] {
        Source::Encoder(cable) => row.cable = Some(cable + 1),
        Source::Tension(cable) => {
            row.kind = "tension";
            row.cable = Some(cable + 1);
        }
        Source::Balance(_) => row.kind = "balance",
        Source::Tilt(_) => row.kind = "tilt",
        Source::Corner(view, corner, _) => {
            row.kind = "corner";
            row.tag = Some(usable.data.tags[usable.data.poses[k].views[view].tag].id);
            row.corner = Some(corner);
            row.sigmas = row
                .sigmas
                .max(residuals.get(j + 1).map_or(0.0, |r| r.abs()));
        }
    }
    row
}

/// Standard deviations by which the lengths of a slipped cable are off, at least.
const SLIPPED: f64 = 8.0;

/// A cable whose lengths were rejected at all poses before or after some moment, and only there: a slip. One
/// wrong reading in between is not.
fn stretch(data: &Data, usable: &Usable, minimum: &Minimum) -> Option<String> {
    let mut best: Option<(f64, String)> = None;
    for cable in 0..data.cable_count() {
        let mut off: Vec<(usize, f64, bool)> = Vec::new();
        for (k, sources) in minimum.sources.iter().enumerate() {
            let row = sources
                .iter()
                .position(|source| *source == Source::Encoder(cable));
            if let Some(j) = row {
                let used = minimum.weights[k][j] > 0.0;
                off.push((k, minimum.normal.residuals[k][j], used));
            }
        }
        let wrong = off.iter().filter(|(.., used)| !used).count();
        if wrong == 0 || wrong * 2 > off.len() + 1 {
            continue;
        }
        let first = off.iter().take_while(|(.., used)| !used).count();
        let last = off.iter().rev().take_while(|(.., used)| !used).count();
        // Another wrong reading elsewhere may be an outlier of its own.
        let (from, side, sign) = if last >= first {
            (off.len() - last, &off[off.len() - last..], 1.0)
        } else {
            (first, &off[..first], -1.0)
        };
        if side.is_empty() || side.len() + 1 < wrong {
            continue;
        }
        let mut sizes: Vec<f64> = side.iter().map(|(_, residual, _)| *residual).collect();
        sizes.sort_by(f64::total_cmp);
        let median = sizes[sizes.len() / 2];
        let together = sizes.iter().all(|size| size * median > 0.0);
        if !together || median.abs() < SLIPPED || from == 0 || from >= off.len() {
            continue;
        }
        let gain = median * median * side.len() as f64;
        if best.as_ref().is_none_or(|(most, _)| gain > *most) {
            let words = format!(
                "cable {} slipped by {:+.1} mm before pose {}",
                cable + 1,
                sign * median * data.noise.encoder_m * 1e3,
                usable.number[off[from].0] + 1
            );
            best = Some((gain, words));
        }
    }
    best.map(|(_, words)| words)
}
