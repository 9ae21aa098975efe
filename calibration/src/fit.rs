//! One weighted problem over all unknowns that affect the measurements, solved and judged.

use super::answer::{Answer, RejectedRow, Solved};
use super::causes;
use super::check::{Usable, usable};
use super::data::Data;
use super::error::Refusal;
use super::general::slip;
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

/// The refusal of tags whose true size is `scale` times the stated one.
fn wrong_size(data: &Data, scale: f64) -> Refusal {
    let (id, size_mm) = data
        .tags
        .first()
        .map_or((0, 0.0), |tag| (tag.id, tag.size_m * 1e3));
    Refusal::Contradiction {
        what: format!(
            "the tags are {:+.2} % off their stated size: tag {id} is said to be {size_mm:.2} mm, the \
             cables' lengths say {:.2} mm; measure its edge and correct size_mm and corners_in_body_mm",
            (scale - 1.0) * 100.0,
            size_mm * scale
        ),
    }
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
    let mut out = Answer::of_state("joint", state, layout.statics);
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

/// Share by which a drum, and a load cell's gain, may be off: several times what machines as delivered show.
const DRUM_MAX: f64 = 0.1;
const GAIN_MAX: f64 = 0.4;

/// Refuses data that contradict the model and warns of doubtful ones.
#[allow(clippy::too_many_arguments)]
fn judge(
    data: &Data,
    model: &Model<'_>,
    minimum: &Minimum,
    rejected: &[RejectedRow],
    freedom: f64,
    warnings: &mut Vec<String>,
) -> Result<(), Refusal> {
    let refuse = |what: String| Err(Refusal::Contradiction { what });
    let state = &minimum.state;
    let priors = &minimum.priors;
    let tags_off = (state.tag_scale - 1.0) / priors.tag;
    // Six standard deviations of the prior: 0.6 % of the size by default.
    if tags_off.abs() > 6.0 {
        return Err(wrong_size(data, state.tag_scale));
    }
    // Priors that the data widen must not turn a mistake into a property of the machine.
    for i in 0..data.cable_count() {
        let (drum, gain) = (state.scale(i) - 1.0, -state.loss[i]);
        if drum.abs() > DRUM_MAX {
            return refuse(format!(
                "cable {}'s lengths come out {:+.0} % off: check its drum, its encoder and the unit",
                i + 1,
                drum * 100.0
            ));
        }
        if gain.abs() > GAIN_MAX {
            return refuse(format!(
                "cable {}'s tensions come out {:+.0} % off: check its sensor's gain and the unit",
                i + 1,
                gain * 100.0
            ));
        }
    }
    let blame = blame(model, minimum);
    let rows = judge_rejected(minimum, rejected, &blame)?;
    if minimum.tension_relative > 0.06 {
        return refuse(format!(
            "the tensions contradict the lengths and pictures by {:.0} % of their value: check their \
             gains and zeros, or leave them out (null); {blame}",
            minimum.tension_relative * 100.0
        ));
    }
    judge_scatter(minimum, freedom, &blame, warnings)?;
    if rejected.len() * 100 > 3 * rows {
        warnings.push(format!(
            "{} of {rows} measurements were rejected; {blame}",
            rejected.len()
        ));
    }
    judge_priors(data, model, minimum, warnings)?;
    if minimum.tension_relative > 0.0 {
        warnings.push(format!(
            "the tensions scatter by another {:.1} % of their value (friction of the pulleys)",
            minimum.tension_relative * 100.0
        ));
    }
    Ok(())
}

/// Refuses where too many measurements of one kind, or of all, fit no robot. Returns the number of
/// measurements.
fn judge_rejected(
    minimum: &Minimum,
    rejected: &[RejectedRow],
    blame: &str,
) -> Result<usize, Refusal> {
    let refuse = |what: String| Err(Refusal::Contradiction { what });
    // A corner is one measurement of two rows.
    let second = |source: &Source| matches!(source, Source::Corner(_, _, 1) | Source::Balance(_));
    let all = minimum.sources.iter().flatten();
    let rows = all.filter(|source| !second(source)).count();
    for kind in ["encoder", "tension", "corner"] {
        let is = |source: &&Source| match source {
            Source::Encoder(_) => kind == "encoder",
            Source::Tension(_) => kind == "tension",
            Source::Corner(_, _, axis) => kind == "corner" && *axis == 0,
            Source::Balance(_) => false,
        };
        let all = minimum.sources.iter().flatten().filter(is).count();
        let out = rejected.iter().filter(|row| row.kind == kind).count();
        if out * 10 > 3 * all {
            return refuse(format!(
                "{out} of {all} {kind} measurements fit no common robot; {blame}"
            ));
        }
    }
    if rejected.len() * 5 > rows {
        return refuse(format!(
            "{} of {rows} measurements fit no common robot; {blame}",
            rejected.len()
        ));
    }
    Ok(rows)
}

/// Refuses, or warns, where the measurements scatter more than stated.
fn judge_scatter(
    minimum: &Minimum,
    freedom: f64,
    blame: &str,
    warnings: &mut Vec<String>,
) -> Result<(), Refusal> {
    let ratio = minimum.normal.chi_square / freedom.max(1.0);
    // Five standard deviations of chi-square over its mean.
    let chance = 5.0 * (2.0 / freedom.max(1.0)).sqrt();
    if ratio > 2.0 + chance {
        return Err(Refusal::Contradiction {
            what: format!(
                "the measurements scatter {:.1} times as much as stated (chi-square {:.0} for {freedom:.0} \
             degrees of freedom); {blame}",
                ratio.sqrt(),
                minimum.normal.chi_square
            ),
        });
    }
    if ratio > 1.0 + chance {
        warnings.push(format!(
            "the measurements scatter {:.2} times as much as stated: check noise_1sigma; {blame}",
            ratio.sqrt()
        ));
    }
    Ok(())
}

/// Standard deviations from which on a pulley's entered radius is contradicted, and the least difference, m.
const RADIUS_SURE: f64 = 5.0;
const RADIUS_M: f64 = 5e-4;

/// Warns of pulleys whose entered radius the data contradict, with the value that they want.
fn judge_radii(data: &Data, model: &Model<'_>, minimum: &Minimum, warnings: &mut Vec<String>) {
    let cables = minimum.state.cables.iter().zip(&data.robot.cables);
    for (i, (now, entered)) in cables.enumerate() {
        let at = model.layout.radius(i);
        let sigma = minimum.covariance[(at, at)].sqrt();
        let off = now.pulley_radius_m - entered.pulley_radius_m;
        if off.abs() > RADIUS_M.max(RADIUS_SURE * sigma) {
            warnings.push(format!(
                "cable {}'s pulley radius is entered as {:.2} mm, the data want {:.2} mm (1 sigma {:.2}): \
                 measure it and correct the robot file",
                i + 1,
                entered.pulley_radius_m * 1e3,
                now.pulley_radius_m * 1e3,
                sigma * 1e3
            ));
        }
    }
}

/// Refuses anchors far from nominal; warns of values that contradict what was known before.
fn judge_priors(
    data: &Data,
    model: &Model<'_>,
    minimum: &Minimum,
    warnings: &mut Vec<String>,
) -> Result<(), Refusal> {
    let (priors, state) = (&minimum.priors, &minimum.state);
    judge_radii(data, model, minimum, warnings);
    for prior in state.priors(data, &model.layout, priors) {
        let off = prior.deviation / prior.sigma;
        let anchor = prior.index < model.layout.initial_length(0);
        // A fifth more than the tolerance: the estimate has an error of its own.
        let limit = data.robot.anchor_half_tolerance_m * 1.2;
        if anchor && prior.deviation.abs() > 3.0 * limit {
            return Err(Refusal::Contradiction {
                what: format!(
                    "cable {}: its anchor comes out {:.1} mm from nominal, the tolerance is {:.1} mm: are \
                 these the data of this robot?",
                    prior.index / 3 + 1,
                    prior.deviation * 1e3,
                    data.robot.anchor_half_tolerance_m * 1e3
                ),
            });
        }
        if anchor && prior.deviation.abs() > limit {
            warnings.push(format!(
                "cable {}: its anchor comes out {:+.1} mm from nominal in {}, beyond the tolerance",
                prior.index / 3 + 1,
                prior.deviation * 1e3,
                ["x", "y", "z"][prior.index % 3]
            ));
        } else if !anchor && off.abs() > 4.0 {
            warnings.push(format!(
                "{} comes out {:.1} standard deviations from what was known beforehand",
                name(model, prior.index),
                off.abs()
            ));
        }
    }
    Ok(())
}

/// Finds the cable, pose or tag that contributes most to the misfit.
fn blame(model: &Model<'_>, minimum: &Minimum) -> String {
    let mut sums: Vec<(String, f64)> = Vec::new();
    let mut add = |who: String, square: f64| match sums.iter_mut().find(|(name, _)| *name == who) {
        Some((_, sum)) => *sum += square,
        None => sums.push((who, square)),
    };
    let mut total = 0.0;
    for (k, sources) in minimum.sources.iter().enumerate() {
        for (j, source) in sources.iter().enumerate() {
            // 20 standard deviations at most: one gross outlier must not hide the cause of many
            // misfits.
            let square = minimum.normal.residuals[k][j].powi(2).min(400.0);
            total += square;
            add(format!("pose {}", k + 1), square);
            match source {
                Source::Encoder(i) => add(format!("cable {}'s length", i + 1), square),
                Source::Tension(i) => add(format!("cable {}'s tension", i + 1), square),
                Source::Balance(_) => {}
                Source::Corner(v, ..) => {
                    let tag = model.data.poses[k].views[*v].tag;
                    add(format!("tag {}", model.data.tags[tag].id), square);
                }
            }
        }
    }
    sums.sort_by(|a, b| b.1.total_cmp(&a.1));
    match sums.first() {
        Some((who, sum)) => format!(
            "{who} contributes most ({:.0} % of it)",
            100.0 * sum / total
        ),
        None => "no single cause".to_owned(),
    }
}

fn name(model: &Model<'_>, index: usize) -> String {
    let layout = &model.layout;
    if index < layout.attachment(0) {
        return format!("cable {}'s pulley radius", index - layout.radius(0) + 1);
    }
    if index < layout.scales() {
        let i = index - layout.attachment(0);
        return format!(
            "cable {}'s attachment in {}",
            i / 3 + 1,
            ["x", "y", "z"][i % 3]
        );
    }
    let of = |index: usize, first: usize, what: &str| {
        Some(index.wrapping_sub(first))
            .filter(|i| *i < layout.cables)
            .map(|i| format!("cable {}'s {what}", i + 1))
    };
    if let Some(words) = of(index, layout.drum(0), "drum") {
        return words;
    }
    if index < layout.statics() {
        let words = [
            "the drums' scale",
            "the focal length",
            "the principal point in u",
            "the principal point in v",
            "the lens's k1",
            "the tags' scale",
        ];
        return words[index - layout.scales()].to_owned();
    }
    let own = of(index, layout.zero(0), "tension zero")
        .or_else(|| of(index, layout.soft(0), "own compliance"));
    if let Some(words) = own {
        return words;
    }
    let words = [
        "the cables' compliance",
        "the mass",
        "the centre of mass in x",
        "the centre of mass in y",
        "the centre of mass in z",
    ];
    match words.get(index - layout.statics()) {
        Some(words) => (*words).to_owned(),
        None => format!("cable {}'s loss of tension", index - layout.loss(0) + 1),
    }
}
