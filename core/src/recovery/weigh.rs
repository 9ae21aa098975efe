//! The estimates behind a decision: by lengths and tensions, by a tag, by all of them; with a
//! statistical bound and an integrity bound.

use super::cut::{Cut, Lengths, lengths_after};
use super::fuse::{Found, Weighed, fuse};
use super::journal::Journal;
use super::looks::{RestReadings, taper};
use super::reference::{Homed, Priors, TagReference};
use super::verdict::{Evidence, Source, mm, worst_tension};
use crate::estimate::region::chi2_quantile;
use crate::estimate::{EstimateError, Measurements};
use crate::motion::{Model, StaticState};
use crate::sight::TagView;
use causes::{Chosen, Places};
use nalgebra::{Matrix3, Vector3};

mod causes;

/// Normal deviate above which evidence counts as contradictory: one valid case in a thousand.
const CONTRADICTS: f64 = 3.09;
/// A length that is off by so many of its standard deviations is named.
/// By chance 6 of 100 000 normal errors are.
const NAMED: f64 = 4.0;
/// Lengths within so many standard deviations of the tag's estimate are combined with it.
/// By chance 3 of 1000 good lengths are further off.
const AGREES: f64 = 3.0;
/// Standard deviation of a length by a view of a tag alone, m.
const TAG_LENGTH_M: f64 = 1e-3;
/// A slip that adds this to the root of chi-square is detected as a rule: the threshold for one degree
/// of freedom at [`CONTRADICTS`].
const DETECTED: f64 = 3.3;
/// Standard deviations of a tension: a constant part, and a share for gain and pulleys.
/// Together 0.32 N at 15 N.
const TENSION_N: f64 = 0.12;
const TENSION_SHARE: f64 = 0.02;
/// Standard deviation of the attitude from that of statics, rad.
/// A centre of mass 1 mm off tilts the platform by 1 to 2 mrad.
const ATTITUDE_RAD: f64 = 3e-3;
/// Position of the camera's mounting and of a tag after a calibration, standard deviation, m per axis.
const TAG_PLACE_M: f64 = 2.0e-4;
/// Place at which the robot was homed, standard deviation, m per axis: no better known than anchors and
/// tags after a calibration (0.3 mm, uniform).
const HOMED_M: f64 = 1.7e-4;
/// The same at each corner in a picture, px.
const MOUNTING_PX: f64 = 0.25;
/// Centre of mass after a calibration, standard deviation, m per axis.
const CENTER_M: f64 = 1e-3;
/// Relative to a view at homing: what lens, detector and noise leave of a corner's mean, px, the attitude from that
/// of statics with the centre of mass by that view, rad, and a length by such a view, m. Chosen on seeds 30001 to
/// 30300 of lab-fast.
const SINCE_PX: f64 = 0.07;
const SINCE_RAD: f64 = 1.3e-3;
const SINCE_LENGTH_M: f64 = 8e-4;
/// Time from the last record on the disk to the cut where the computer failed too, s: mean and
/// standard deviation.
const UNSEEN_DEAD_S: [f64; 2] = [0.036, 0.018];
/// The same where the program continued: a block of samples on its way.
const UNSEEN_ALIVE_S: [f64; 2] = [0.007, 0.004];

/// The same where the board kept the lengths of its last tick.
const UNSEEN_TICK_S: [f64; 2] = [5e-4, 3e-4];

/// Lengths by the journal or the board.
#[derive(Debug, Clone)]
pub(super) struct Known {
    pub(super) lengths: Lengths,
    /// The same for either cause of the cut; empty where only one is possible.
    causes: Vec<Cause>,
    /// The last lengths before the loss of power, m.
    pub(super) before_m: Vec<f64>,
}

/// A possible cause of the cut: with or without torque on the drums until their brakes closed.
#[derive(Debug, Clone)]
struct Cause {
    probability: f64,
    lengths: Lengths,
}

/// Estimates with their bounds.
#[derive(Debug, Clone)]
pub(super) struct Estimates {
    /// By the tag and tensions, or, without a tag, by lengths and tensions.
    pub(super) alone: Found,
    /// By the tag, tensions and lengths, where they agree.
    pub(super) with_lengths: Option<Found>,
    pub(super) by_tag: bool,
    pub(super) known: Option<Known>,
    /// Covariance of the tool, without a slip that is not detected, m².
    pub(super) covariance_m2: Matrix3<f64>,
    /// Statistical bound, 95 %, m.
    pub(super) bound_95_m: f64,
    /// Error by an undetected slip of one drum, by lengths that agree with a tag by chance, or, of a tag alone, in
    /// 99.9 % of cases, m.
    pub(super) integrity_bound_m: f64,
    /// Drums that slipped, and other causes of a contradiction, in words.
    pub(super) suspects: Vec<String>,
}

impl Estimates {
    /// The most exact one.
    pub(super) fn best(&self) -> &Found {
        self.with_lengths.as_ref().unwrap_or(&self.alone)
    }

    /// The bound that the decision uses, m.
    pub(super) fn bound_m(&self) -> f64 {
        bound_m(self.bound_95_m, self.integrity_bound_m)
    }

    pub(super) fn fits(&self) -> bool {
        fits(self.best())
    }
}

/// The greater of both bounds: an undetected slip is not part of the covariance.
fn bound_m(bound_95_m: f64, integrity_bound_m: f64) -> f64 {
    bound_95_m.max(integrity_bound_m)
}

/// Error of the tool that a slip of one drum can cause without being detected, m: the protection level
/// of receiver autonomous integrity monitoring (Brown 1992), for one fault.
fn integrity_bound_m(found: &Found) -> f64 {
    let slopes = found
        .tool_per_length
        .column_iter()
        .zip(&found.residual_per_length);
    let off = slopes.map(|(tool, residual)| DETECTED * tool.norm() / residual.max(1e-9));
    off.fold(0.0, f64::max)
}

fn fits(found: &Found) -> bool {
    found.freedoms == 0 || found.chi2 <= chi2_quantile(found.freedoms as f64, CONTRADICTS)
}

/// The estimates; `None` where no length is known and no tag is in view.
///
/// # Errors
/// [`EstimateError`].
pub(super) fn estimates(
    model: &Model,
    evidence: &Evidence<'_>,
) -> Result<Option<Estimates>, EstimateError> {
    let known = known(model, evidence)?;
    let tensions_n = &evidence.rest.tensions_n;
    let errors = evidence.rest.tension_errors_n.iter().copied();
    let sigmas_n: Vec<f64> = tensions_n
        .iter()
        .zip(errors.chain(std::iter::repeat(0.0)))
        .map(|(tension, error)| {
            let share = TENSION_SHARE * tension;
            (TENSION_N.powi(2) + share * share + error * error).sqrt()
        })
        .collect();
    let nothing = Measurements::default();
    let weighed = |lengths, seen| Weighed {
        lengths,
        tensions_n,
        tension_sigmas_n: &sigmas_n,
        seen,
        attitude_rad: ATTITUDE_RAD,
    };
    let start_m = start(model, known.as_ref(), tensions_n);
    if !evidence.seen.views.is_empty() {
        let sight = Sight::of(model, evidence.reference)?;
        let places = sight.places;
        let eye = sight.eye.as_ref().unwrap_or(model);
        let seen = averaged(
            &evidence.seen,
            sight.corner_px,
            evidence.rest.picture_error_px,
        );
        let by_tag = Weighed {
            attitude_rad: sight.attitude_rad,
            ..weighed(None, &seen)
        };
        let alone = fuse(eye, &by_tag, &start_m)?;
        // Lengths that agree with the tag make the position more exact. Lengths that do not agree
        // only name the drum that slipped.
        let with_lengths = known
            .as_ref()
            .filter(|known| deviations(&known.lengths, &alone, AGREES, sight.length_m).is_empty())
            .map(|known| causes::choose(eye, &by_tag, known, &start_m, places))
            .transpose()?
            .filter(|chosen| fits(&chosen.found));
        let mut chosen = with_lengths.unwrap_or_else(|| Chosen::only(alone.clone(), places));
        // What the board gets are lengths of the robot file's robot, as at homing.
        if sight.eye.is_some() {
            chosen.found.rest = as_in_the_file(model, &chosen.found)?;
        }
        let used_lengths = !chosen.found.residual_per_length.is_empty();
        // Nobody read the encoders without power: lengths that are all wrong by chance in the direction of the
        // tag's error agree with it. Then the tag alone is right, within its own bound. So the bound reaches
        // that far (solution separation, Brown and McBurney 1988).
        let tag_bound_m = if used_lengths {
            (chosen.found.tool_m - alone.tool_m).norm()
                + Chosen::only(alone.clone(), places).bound_95_m()
        } else {
            // No second instrument contradicts a tag that is read wrong by chance.
            chosen.bound_999_m()
        };
        return Ok(Some(Estimates {
            covariance_m2: chosen.covariance_m2(),
            bound_95_m: chosen.bound_95_m(),
            integrity_bound_m: integrity_bound_m(&chosen.found).max(tag_bound_m),
            suspects: slipped_drums(known.as_ref(), &alone, sight.length_m),
            by_tag: true,
            alone,
            with_lengths: used_lengths.then_some(chosen.found),
            known,
        }));
    }
    let Some(known) = known else {
        return Ok(None);
    };
    let chosen = causes::choose(
        model,
        &weighed(None, &nothing),
        &known,
        &start_m,
        Places::Own,
    )?;
    let suspects = if fits(&chosen.found) {
        Vec::new()
    } else {
        suspects(
            model,
            &weighed(Some(&known.lengths), &nothing),
            &chosen.found,
        )
    };
    Ok(Some(Estimates {
        covariance_m2: chosen.covariance_m2(),
        bound_95_m: chosen.bound_95_m(),
        integrity_bound_m: integrity_bound_m(&chosen.found),
        by_tag: false,
        alone: chosen.found,
        with_lengths: None,
        known: Some(known),
        suspects,
    }))
}

/// How exactly tags show the tool.
struct Sight {
    /// The robot with its camera displaced as a view at homing showed it.
    eye: Option<Model>,
    corner_px: f64,
    attitude_rad: f64,
    length_m: f64,
    places: Places,
}

impl Sight {
    fn of(model: &Model, reference: Option<&TagReference>) -> Result<Self, EstimateError> {
        Ok(match reference {
            Some(reference) => Self {
                eye: Some(reference.seen_by(model)?),
                corner_px: SINCE_PX,
                attitude_rad: SINCE_RAD,
                length_m: SINCE_LENGTH_M,
                places: Places::OfHoming {
                    homed_m: reference.homed_m,
                },
            },
            None => Self {
                eye: None,
                corner_px: MOUNTING_PX,
                attitude_rad: ATTITUDE_RAD,
                length_m: TAG_LENGTH_M,
                places: Places::Own,
            },
        })
    }
}

/// Where the camera sees the tags while the robot rests with known lengths (m): kept for the time after a loss
/// of power. `scale` is the robot's checksum. `None` where no tag is in view, or where camera or tag are off by
/// more than a calibration leaves.
///
/// # Errors
/// [`EstimateError::NoFit`] where the robot cannot hang with these lengths.
pub fn reference_of(
    model: &Model,
    lengths_m: &[f64],
    rest: &RestReadings,
    seen: &Measurements,
    homed: Homed,
    scale: u32,
) -> Result<Option<TagReference>, EstimateError> {
    let hangs = model.rest_from_lengths(lengths_m, &rest.tensions_n);
    let hangs = hangs.map_err(|source| EstimateError::NoFit {
        source: Box::new(source),
    })?;
    let seen = averaged(seen, SINCE_PX, rest.picture_error_px);
    let priors = Priors {
        center_m: CENTER_M,
        place_m: libm::hypot(TAG_PLACE_M, HOMED_M),
    };
    let homed_m = match homed {
        Homed::Taught => HOMED_M,
        Homed::ByTag => libm::hypot(TAG_PLACE_M, ATTITUDE_RAD * far_m(model, &hangs, &seen)),
    };
    Ok(TagReference::measure(
        model, &hangs, &seen, priors, homed_m, scale,
    ))
}

/// The robot file's robot with the tool and the tension of an estimate.
fn as_in_the_file(model: &Model, found: &Found) -> Result<StaticState, EstimateError> {
    let held = model.holding().first_by_tension().unwrap_or(0);
    let tensions_n = found.rest.tensions_n();
    let tension_n = tensions_n.get(held).copied().unwrap_or_default();
    let rest = model.rest_with(&found.tool_m, tension_n, Some(&found.rest));
    rest.map_err(|source| EstimateError::NoFit {
        source: Box::new(source),
    })
}

/// Distance of the farthest place of tags from the tool, m: so far an error of the attitude reaches.
fn far_m(model: &Model, rest: &StaticState, seen: &Measurements) -> f64 {
    let tool_m = model.tool_m(rest);
    let far = seen.places.iter();
    far.map(|place| (place.world_from_body.position_m - tool_m).norm())
        .fold(0.0, f64::max)
}

/// Start of the search: by the lengths, else home.
fn start(model: &Model, known: Option<&Known>, tensions_n: &[f64]) -> Vector3<f64> {
    let by_lengths = known.and_then(|known| {
        let list: Vec<f64> = known.lengths.mean_m.iter().copied().collect();
        let rest = model.rest_from_lengths(&list, tensions_n).ok()?;
        Some(model.tool_m(&rest))
    });
    by_lengths.unwrap_or(model.robot().tool.home_in_world_m)
}

/// Lengths by the journal or the board.
fn known(model: &Model, evidence: &Evidence<'_>) -> Result<Option<Known>, EstimateError> {
    let journal: &Journal = match &evidence.source {
        Source::Journal(journal) => journal,
        Source::Board { lengths_m } => {
            return Ok(Some(Known {
                lengths: Lengths::counted(lengths_m),
                causes: Vec::new(),
                before_m: lengths_m.clone(),
            }));
        }
        Source::Reset {
            lengths_m,
            speeds_mps,
        } => {
            return Ok(Some(Known {
                lengths: Lengths::counted_on(lengths_m, speeds_mps),
                causes: Vec::new(),
                before_m: lengths_m.clone(),
            }));
        }
        Source::Refused(_) => return Ok(None),
    };
    // Without a reference, counts begin at any length.
    let Some(last) = journal.last.as_ref().filter(|last| last.referenced) else {
        return Ok(None);
    };
    if last.cables.len() != model.robot().cables.len() {
        return Ok(None);
    }
    let mut last = last.clone();
    if let Some(registers_m) = &evidence.registers_m {
        for (cable, kept_m) in last.cables.iter_mut().zip(registers_m) {
            cable.length_m = *kept_m;
        }
    }
    let before_m: Vec<f64> = last.cables.iter().map(|cable| cable.length_m).collect();
    let tensions_n: Vec<f64> = last.cables.iter().map(|cable| cable.tension_n).collect();
    let rest = model
        .rest_from_lengths(&before_m, &tensions_n)
        .map_err(|source| EstimateError::NoFit {
            source: Box::new(source),
        })?;
    let [unseen_s, unseen_sd_s] = if evidence.registers_m.is_some() {
        UNSEEN_TICK_S
    } else if journal.ended {
        UNSEEN_ALIVE_S
    } else {
        UNSEEN_DEAD_S
    };
    // A computer that failed too was on the same supply, as a rule with the drives.
    let gone = if journal.ended { 0.5 } else { 0.9 };
    let after = |torque_gone: f64| {
        let cut = Cut {
            unseen_s,
            unseen_sd_s,
            torque_gone,
        };
        lengths_after(model, &rest, &last, &cut)
    };
    let cause = |probability: f64, torque_gone: f64| Cause {
        probability,
        lengths: after(torque_gone),
    };
    Ok(Some(Known {
        lengths: after(gone),
        causes: vec![cause(gone, 1.0), cause(1.0 - gone, 0.0)],
        before_m,
    }))
}

/// Pictures of one pose as one view for each tag. The error of the mounting is the same in every
/// picture: averaging does not reduce it. `motion_px` is the standard error of the corners' means by
/// the platform's motion.
fn averaged(seen: &Measurements, corner_px: f64, motion_px: f64) -> Measurements {
    let mut views: Vec<TagView> = Vec::new();
    for view in &seen.views {
        if views.iter().any(|known| known.id == view.id) {
            continue;
        }
        let same: Vec<_> = seen.views.iter().filter(|of| of.id == view.id).collect();
        let weights = taper(same.len());
        // 1.5 / n for a Hann window: the noise is averaged as by two thirds of the pictures.
        let noise_share: f64 = weights.iter().map(|weight| weight * weight).sum();
        let mut mean = *view;
        for (index, corner) in mean.corners_px.iter_mut().enumerate() {
            for (axis, value) in corner.iter_mut().enumerate() {
                let all = same.iter().zip(&weights);
                let all = all
                    .filter_map(|(of, weight)| Some(weight * of.corners_px.get(index)?.get(axis)?));
                *value = all.sum();
            }
        }
        for covariance in &mut mean.covariance_px2 {
            for (axis, row) in covariance.iter_mut().enumerate() {
                if let Some(variance) = row.get_mut(axis) {
                    *variance = *variance * noise_share + corner_px.powi(2) + motion_px.powi(2);
                }
            }
        }
        views.push(mean);
    }
    Measurements {
        views,
        ..seen.clone()
    }
}

/// Drums whose lengths differ from an estimate without them by more than `limit` standard deviations,
/// and by how much, m.
fn deviations(
    lengths: &Lengths,
    found: &Found,
    limit: f64,
    tag_length_m: f64,
) -> Vec<(usize, f64)> {
    let pairs = lengths.mean_m.iter().zip(&found.rest.paid_out_m);
    pairs
        .enumerate()
        .map(|(cable, (expected, now))| (cable, now - expected))
        .filter(|(cable, off_m)| {
            off_m.abs() > limit * libm::hypot(lengths.sigma_m(*cable), tag_length_m)
        })
        .collect()
}

/// Drums that slipped, by the tag's estimate.
fn slipped_drums(known: Option<&Known>, alone: &Found, tag_length_m: f64) -> Vec<String> {
    let off = known.map_or(Vec::new(), |known| {
        deviations(&known.lengths, alone, NAMED, tag_length_m)
    });
    let mut words: Vec<String> = off
        .iter()
        .map(|(cable, off_m)| slipped(*cable, *off_m))
        .collect();
    if off.len() > 1 {
        words.push("the platform was moved, or drums were turned by hand".to_owned());
    }
    words
}

fn slipped(cable: usize, off_m: f64) -> String {
    let verb = if off_m > 0.0 { "paid out" } else { "took in" };
    format!(
        "drum {} {verb} {} without power",
        cable + 1,
        mm(off_m.abs())
    )
}

/// The drum whose slip would explain a contradiction: the one whose length, left out, lets the rest
/// agree. Without such a drum the platform was moved or is loaded.
fn suspects(model: &Model, weighed: &Weighed<'_>, found: &Found) -> Vec<String> {
    let Some(lengths) = weighed.lengths else {
        return Vec::new();
    };
    let mut best: Option<(f64, usize, f64)> = None;
    for cable in 0..lengths.mean_m.len() {
        let mut loose = lengths.clone();
        // A standard deviation of 0.1 m leaves the length out in effect, and no row changes its
        // place.
        loose.covariance_m2[(cable, cable)] += 0.1_f64.powi(2);
        let without = Weighed {
            lengths: Some(&loose),
            ..weighed.clone()
        };
        let Ok(other) = fuse(model, &without, &found.tool_m) else {
            continue;
        };
        let now_m = other.rest.paid_out_m.get(cable).copied().unwrap_or(0.0);
        let off_m = now_m - lengths.mean_m[cable];
        if fits(&other) && best.is_none_or(|(chi2, ..)| other.chi2 < chi2) {
            best = Some((other.chi2, cable, off_m));
        }
    }
    match best {
        Some((_, cable, off_m)) => vec![slipped(cable, off_m)],
        None => vec![format!(
            "the platform was moved or is loaded by hand, or a cable is off its drum (tension {} differs most)",
            worst_tension(found) + 1
        )],
    }
}

#[cfg(test)]
mod tests;
