//! The verdict on a joint estimate: data that contradict the model are refused, doubtful ones named.

use super::answer::RejectedRow;
use super::data::Data;
use super::error::Refusal;
use super::rows::{Model, Source};
use super::solve::Minimum;

/// Share by which a drum, and a load cell's gain, may be off: several times what machines as delivered show.
const DRUM_MAX: f64 = 0.1;
const GAIN_MAX: f64 = 0.4;

/// Refuses data that contradict the model and warns of doubtful ones.
#[allow(clippy::too_many_arguments)]
pub(crate) fn judge(
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
    for kind in ["encoder", "tension", "tilt", "corner"] {
        let is = |source: &&Source| match source {
            Source::Encoder(_) => kind == "encoder",
            Source::Tension(_) => kind == "tension",
            Source::Tilt(_) => kind == "tilt",
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

/// Refuses where too many lengths of one cable fit no robot: among those of four cables they are few.
pub(crate) fn judge_cables(data: &Data, rejected: &[RejectedRow]) -> Result<(), Refusal> {
    for cable in 0..data.cable_count() {
        let of = |row: &&RejectedRow| row.kind == "encoder" && row.cable == Some(cable + 1);
        let read = data
            .poses
            .iter()
            .filter(|pose| pose.encoder_m[cable].is_some());
        let (out, all) = (rejected.iter().filter(of).count(), read.count());
        if out * 10 > 3 * all {
            return Err(Refusal::Contradiction {
                what: format!(
                    "{out} of {all} lengths of cable {} fit no common robot: look at its drum, its encoder and its \
                     pulley",
                    cable + 1
                ),
            });
        }
    }
    Ok(())
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

/// What a misfit can come from.
#[derive(Clone, Copy, PartialEq)]
enum Suspect {
    Pose(usize),
    Length(usize),
    Tension(usize),
    Inclinometer,
    Tag(usize),
}

/// Finds the cable, pose or tag that contributes most to the misfit.
fn blame(model: &Model<'_>, minimum: &Minimum) -> String {
    // Words are made for one of them only: there are thousands of rows.
    let mut sums: Vec<(Suspect, f64)> = Vec::new();
    let mut add = |who: Suspect, square: f64| match sums.iter_mut().find(|(one, _)| *one == who) {
        Some((_, sum)) => *sum += square,
        None => sums.push((who, square)),
    };
    let mut total = 0.0;
    for (k, sources) in minimum.sources.iter().enumerate() {
        // 20 standard deviations at most: one gross outlier must not hide the cause of many
        // misfits.
        let residuals = minimum.normal.residuals[k].iter();
        let squares: Vec<f64> = residuals.map(|r| r.powi(2).min(400.0)).collect();
        let of_pose = squares.iter().sum::<f64>();
        total += of_pose;
        if !sources.is_empty() {
            add(Suspect::Pose(k), of_pose);
        }
        for (source, &square) in sources.iter().zip(&squares) {
            match source {
                Source::Encoder(i) => add(Suspect::Length(*i), square),
                Source::Tension(i) => add(Suspect::Tension(*i), square),
                Source::Tilt(_) => add(Suspect::Inclinometer, square),
                Source::Balance(_) => {}
                Source::Corner(v, ..) => {
                    add(Suspect::Tag(model.data.poses[k].views[*v].tag), square);
                }
            }
        }
    }
    // Of equal ones the first.
    let most = sums.iter().rev().max_by(|a, b| a.1.total_cmp(&b.1));
    let Some((who, sum)) = most else {
        return "no single cause".to_owned();
    };
    let who = match who {
        Suspect::Pose(k) => format!("pose {}", k + 1),
        Suspect::Length(i) => format!("cable {}'s length", i + 1),
        Suspect::Tension(i) => format!("cable {}'s tension", i + 1),
        Suspect::Inclinometer => "the inclinometer".to_owned(),
        Suspect::Tag(tag) => format!("tag {}", model.data.tags[*tag].id),
    };
    format!(
        "{who} contributes most ({:.0} % of it)",
        100.0 * sum / total
    )
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
    if let (true, Some(axis)) = (layout.tilt, index.checked_sub(layout.mount())) {
        return format!(
            "the inclinometer's mounting about {}",
            ["x", "y", "z"][axis]
        );
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

/// The refusal of tags whose true size is `scale` times the stated one.
pub(crate) fn wrong_size(data: &Data, scale: f64) -> Refusal {
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

#[cfg(test)]
mod tests {
    use super::super::Options;
    use super::super::joint::joint;
    use super::super::simulate::{Setup, simulate};

    #[test]
    fn a_refusal_names_the_cable_whose_readings_fit_nothing() {
        let (mut data, _) = simulate(&Setup::default()).unwrap();
        for (k, pose) in data.poses.iter_mut().enumerate() {
            // Neither a gain nor a zero: it shows what it likes.
            pose.tension_n.as_mut().unwrap()[1] *= [3.0, 0.2, 1.0, 0.5][k % 4];
        }
        let told = match joint(&data, &Options::default()) {
            Ok(answer) => answer.warnings.join("\n"),
            Err(refusal) => refusal.to_string(),
        };
        assert!(
            told.contains("cable 2's tension contributes most"),
            "{told}"
        );
    }
}
