//! The decision after a cut: the tool's position with a bound, or a refusal that names the next
//! measurement.

use super::cut::{Cut, Lengths, lengths_after};
use super::fuse::{Found, Weighed, chi2_quantile, fuse, radius_95_m};
use super::journal::{Journal, JournalError};
use crate::estimate::{EstimateError, Measurements};
use crate::motion::Model;
use crate::sight::TagView;
use mcdpr_protocol::BoardState;
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// Normal deviate at which measurements that fit are called contradicting: one case in a thousand.
const CONTRADICTS: f64 = 3.09;
/// A length that is off by so many of its standard deviations is named.
const NAMED: f64 = 4.0;
/// Lengths within so many standard deviations of the tag's are weighed with it.
const AGREES: f64 = 3.0;
/// What a view of a tag leaves of a length, m.
const TAG_LENGTH_M: f64 = 1e-3;
/// A slip that adds this to the root of chi-square is found as a rule: the threshold for one degree
/// of freedom at [`CONTRADICTS`].
const UNSEEN: f64 = 3.3;
/// Standard deviations of a tension: a constant part, and a share for gain and pulleys.
const TENSION_N: f64 = 0.12;
const TENSION_SHARE: f64 = 0.02;
/// How far the attitude may be from that of statics, rad.
const ATTITUDE_RAD: f64 = 3e-3;
/// What a camera's mounting and a tag's place are known to after a calibration, m per axis.
const TAG_PLACE_M: f64 = 2.0e-4;
/// What the same leaves at each corner in a picture, px.
const MOUNTING_PX: f64 = 0.25;
/// Time over which a disk may not yet have what was written, s: mean and standard deviation of what
/// a program that went with its computer leaves unseen.
const UNSEEN_DEAD_S: [f64; 2] = [0.036, 0.018];
/// The same where the program lived on: a block of samples on its way.
const UNSEEN_ALIVE_S: [f64; 2] = [0.007, 0.004];

/// Where lengths come from.
#[derive(Debug, Clone)]
pub enum Source<'a> {
    /// The board kept its supply and counted all along, m.
    Board {
        /// Paid-out lengths.
        lengths_m: Vec<f64>,
    },
    /// The board has lost them; a journal was kept.
    Journal(&'a Journal),
    /// The board has lost them, and there is no journal to believe.
    Refused(JournalError),
}

/// Everything that is known after a cut.
#[derive(Debug, Clone)]
pub struct Evidence<'a> {
    /// Lengths.
    pub source: Source<'a>,
    /// Tensions with closed brakes, means over some time, N.
    pub tensions_n: Vec<f64>,
    /// Standard errors of these means, N.
    pub tension_errors_n: Vec<f64>,
    /// What a camera sees; empty without one.
    pub seen: Measurements,
    /// Whether somebody vouches that no hand moved drums or platform while the power was gone.
    pub untouched: bool,
    /// Largest bound of the tool's place that the job allows, m.
    pub bound_m: f64,
}

/// The result of a recovery. Lengths and positions in mm.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// Whether the robot may go on from here.
    pub accepted: bool,
    /// One sentence.
    pub sentence: String,
    /// The tool, world; absent where nothing can be said.
    pub tool_mm: Option<[f64; 3]>,
    /// Bound of the tool's error: the greater of the estimate's 95 % radius and of the error that an
    /// unseen slip of one drum can cause.
    pub bound_mm: Option<f64>,
    /// What was weighed.
    pub used: Vec<String>,
    /// What contradicts what.
    pub contradicts: Vec<String>,
    /// The one thing to do next.
    pub next: String,
    /// How much each drum let out since the last state that was kept, by this estimate.
    pub let_out_mm: Vec<f64>,
    /// A slip of each drum that what was weighed would not show.
    pub unseen_slip_mm: Vec<f64>,
    /// What the gripper was told last, and whether its switch says that it holds nothing.
    pub gripper_closed: Option<bool>,
    /// Path time of the interrupted motion, s.
    pub path_s: Option<f64>,
    /// Lengths to reference, m.
    #[serde(skip)]
    pub lengths_m: Vec<f64>,
    /// Tensions to expect, N.
    #[serde(skip)]
    pub tensions_n: Vec<f64>,
}

const BY_TAG: &str = "bring a tag whose place is known into the camera's view and recover again";
const BY_HAND: &str = "home by hand: `mcdpr home --at X Y Z` with the tool at a known place";

impl Verdict {
    fn refused(sentence: String, next: &str) -> Self {
        Self {
            accepted: false,
            sentence,
            tool_mm: None,
            bound_mm: None,
            used: Vec::new(),
            contradicts: Vec::new(),
            next: next.to_owned(),
            let_out_mm: Vec::new(),
            unseen_slip_mm: Vec::new(),
            gripper_closed: None,
            path_s: None,
            lengths_m: Vec::new(),
            tensions_n: Vec::new(),
        }
    }

    fn with(mut self, found: &Found, bound_m: f64, before_m: &[f64]) -> Self {
        self.tool_mm = Some((found.tool_m * 1e3).into());
        self.bound_mm = Some(bound_m * 1e3);
        self.lengths_m.clone_from(&found.rest.paid_out_m);
        self.tensions_n = found.rest.tensions_n().to_vec();
        let pairs = found.rest.paid_out_m.iter().zip(before_m);
        self.let_out_mm = pairs.map(|(now, then)| (now - then) * 1e3).collect();
        // What adds four to the root of chi2 would be noticed in most cases.
        let shows = found.shows_per_length.iter();
        self.unseen_slip_mm = shows.map(|per_m| 4.0 / per_m.max(1e-9) * 1e3).collect();
        self
    }
}

/// How far the tool can be off by the slip of one drum that the measurements do not show, m: the
/// protection level of receiver autonomous integrity monitoring (Brown 1992), for one fault.
fn unseen_slip_m(found: &Found) -> f64 {
    let slopes = found
        .tool_per_length
        .column_iter()
        .zip(&found.shows_per_length);
    let off = slopes.map(|(tool, shows)| UNSEEN * tool.norm() / shows.max(1e-9));
    off.fold(0.0, f64::max)
}

/// Drums whose lengths differ from an estimate without them by more than `deviations` standard
/// deviations, and by how much, m.
fn contradicted(lengths: &Lengths, found: &Found, deviations: f64) -> Vec<(usize, f64)> {
    let pairs = lengths.mean_m.iter().zip(&found.rest.paid_out_m);
    pairs
        .enumerate()
        .map(|(cable, (expected, now))| (cable, now - expected))
        .filter(|(cable, off_m)| {
            off_m.abs() > deviations * lengths.sigma_m(*cable).hypot(TAG_LENGTH_M)
        })
        .collect()
}

fn fits(found: &Found) -> bool {
    found.freedoms == 0 || found.chi2 <= chi2_quantile(found.freedoms as f64, CONTRADICTS)
}

fn mm(value_m: f64) -> String {
    format!("{:.1} mm", value_m * 1e3)
}

/// Judges whether the robot may go on, and from where.
///
/// # Errors
/// [`EstimateError`] where not even statics can be solved; nothing is to be believed then.
pub fn judge(model: &Model, evidence: &Evidence<'_>) -> Result<Verdict, EstimateError> {
    let journal = match &evidence.source {
        Source::Refused(reason) => {
            let sentence = format!("the journal is not believed: {reason}; it was left as it is");
            let next = if evidence.seen.views.is_empty() {
                BY_HAND
            } else {
                "home by the tag in view: `mcdpr home --tag`"
            };
            return Ok(Verdict::refused(sentence, next));
        }
        Source::Journal(journal) => Some(*journal),
        Source::Board { .. } => None,
    };
    let mut verdict = match weigh(model, evidence, journal) {
        Ok(verdict) => verdict,
        Err(error @ (EstimateError::NoFit { .. } | EstimateError::Rank)) => {
            let sentence = format!(
                "{error}: a drum slipped far, a cable is slack or off its drum, or something carries the platform"
            );
            Verdict::refused(sentence, BY_HAND)
        }
        Err(error) => return Err(error),
    };
    if let Some(last) = journal.and_then(|journal| journal.last.as_ref()) {
        verdict.gripper_closed = Some(last.gripper_closed);
        verdict.path_s = (last.path_ms > 0).then(|| f64::from(last.path_ms) * 1e-3);
    }
    Ok(verdict)
}

/// Pictures of one resting pose as one view a tag. What is left of the mounting's error is in every
/// picture the same: no number of them takes it away.
fn averaged(seen: &Measurements) -> Measurements {
    let mut views: Vec<TagView> = Vec::new();
    for view in &seen.views {
        if views.iter().any(|known| known.id == view.id) {
            continue;
        }
        let same: Vec<_> = seen.views.iter().filter(|of| of.id == view.id).collect();
        let count = same.len() as f64;
        let mut mean = *view;
        for (index, corner) in mean.corners_px.iter_mut().enumerate() {
            for (axis, value) in corner.iter_mut().enumerate() {
                let all = same
                    .iter()
                    .filter_map(|of| of.corners_px.get(index)?.get(axis));
                *value = all.sum::<f64>() / count;
            }
        }
        for covariance in &mut mean.covariance_px2 {
            for (axis, row) in covariance.iter_mut().enumerate() {
                if let Some(variance) = row.get_mut(axis) {
                    *variance = *variance / count + MOUNTING_PX.powi(2);
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

/// Lengths by the journal or the board, and the lengths that were kept last.
fn lengths_of(
    model: &Model,
    evidence: &Evidence<'_>,
    journal: Option<&Journal>,
) -> Result<Option<(Lengths, Vec<f64>)>, EstimateError> {
    let Some(journal) = journal else {
        let Source::Board { lengths_m } = &evidence.source else {
            return Ok(None);
        };
        return Ok(Some((Lengths::counted(lengths_m), lengths_m.clone())));
    };
    let Some(last) = journal.last.as_ref().filter(|last| last.referenced) else {
        return Ok(None);
    };
    if last.cables.len() != model.robot().cables.len() {
        return Ok(None);
    }
    let before_m: Vec<f64> = last.cables.iter().map(|cable| cable.length_m).collect();
    let tensions_n: Vec<f64> = last.cables.iter().map(|cable| cable.tension_n).collect();
    let rest = model
        .rest_from_lengths(&before_m, &tensions_n)
        .map_err(|source| EstimateError::NoFit {
            source: Box::new(source),
        })?;
    let [unseen_s, unseen_sd_s] = if journal.ended {
        UNSEEN_ALIVE_S
    } else {
        UNSEEN_DEAD_S
    };
    let cut = Cut {
        unseen_s,
        unseen_sd_s,
        // A program that went too was on the same supply, as a rule with the drives.
        torque_gone: if journal.ended { 0.5 } else { 0.9 },
    };
    Ok(Some((lengths_after(model, &rest, last, &cut), before_m)))
}

fn weigh(
    model: &Model,
    evidence: &Evidence<'_>,
    journal: Option<&Journal>,
) -> Result<Verdict, EstimateError> {
    let known = lengths_of(model, evidence, journal)?;
    let errors = evidence.tension_errors_n.iter().copied();
    let sigmas_n: Vec<f64> = evidence
        .tensions_n
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
        tensions_n: &evidence.tensions_n,
        tension_sigmas_n: &sigmas_n,
        seen,
        attitude_rad: ATTITUDE_RAD,
    };
    let start_m = known.as_ref().and_then(|(lengths, _)| {
        let list: Vec<f64> = lengths.mean_m.iter().copied().collect();
        let rest = model.rest_from_lengths(&list, &evidence.tensions_n).ok()?;
        Some(model.tool_m(&rest))
    });
    let start_m = start_m.unwrap_or(model.robot().tool.home_in_world_m);
    let before_m = known.as_ref().map_or(&[][..], |(_, before)| before);
    if !evidence.seen.views.is_empty() {
        let seen = averaged(&evidence.seen);
        let alone = fuse(model, &weighed(None, &seen), &start_m)?;
        // Lengths that agree with the tag make the place more exact; lengths that do not only name
        // the drum that slipped.
        let with_lengths = known
            .as_ref()
            .filter(|(lengths, _)| contradicted(lengths, &alone, AGREES).is_empty())
            .map(|(lengths, _)| fuse(model, &weighed(Some(lengths), &seen), &start_m))
            .transpose()?
            .filter(fits);
        return Ok(by_tag(evidence, &alone, with_lengths, known.as_ref()));
    }
    let Some((lengths, _)) = &known else {
        let sentence = "the lengths were not referenced when the power went".to_owned();
        return Ok(Verdict::refused(sentence, BY_HAND));
    };
    let found = fuse(model, &weighed(Some(lengths), &nothing), &start_m)?;
    let bound_m = radius_95_m(&found.covariance_m2).max(unseen_slip_m(&found));
    let mut verdict = Verdict::refused(String::new(), BY_TAG).with(&found, bound_m, before_m);
    verdict.used = vec![
        used_lengths(evidence, journal),
        "tensions at rest".to_owned(),
    ];
    if !fits(&found) {
        verdict.contradicts = blamed(model, &weighed(Some(lengths), &nothing), &found);
        verdict.sentence = format!(
            "lengths and tensions contradict each other: {}",
            verdict.contradicts.join("; ")
        );
        return Ok(verdict);
    }
    let counted = matches!(evidence.source, Source::Board { .. });
    let parked = journal
        .and_then(|journal| journal.last.as_ref())
        .is_some_and(|last| last.state == BoardState::Disarmed);
    if bound_m > evidence.bound_m {
        verdict.sentence = format!(
            "the tool is known to {} only, and {} are needed",
            mm(bound_m),
            mm(evidence.bound_m)
        );
    } else if !counted && !evidence.untouched {
        verdict.sentence = format!(
            "nothing contradicts {}, but without power no drum was counted{}",
            mm(bound_m),
            if parked {
                ", the parked robot's neither"
            } else {
                ""
            }
        );
        verdict.next = format!(
            "{BY_TAG}; or, if nobody touched drums, brakes or platform meanwhile, say so: `mcdpr recover --untouched`"
        );
    } else {
        accept(&mut verdict, &found, bound_m);
    }
    Ok(verdict)
}

fn used_lengths(evidence: &Evidence<'_>, journal: Option<&Journal>) -> String {
    match (&evidence.source, journal) {
        (Source::Board { .. }, _) => "the board's own counts: it kept its supply".to_owned(),
        (_, Some(journal)) if journal.ended => {
            "the journal and what drums do until brakes close".to_owned()
        }
        _ => "the journal up to what had reached the disk, and what drums do until brakes close"
            .to_owned(),
    }
}

fn accept(verdict: &mut Verdict, found: &Found, bound_m: f64) {
    let at = found.tool_m * 1e3;
    verdict.accepted = true;
    verdict.sentence = format!(
        "the tool is at ({:.1}, {:.1}, {:.1}) mm, within {}",
        at.x,
        at.y,
        at.z,
        mm(bound_m)
    );
    verdict.next =
        "the board knows its lengths: run the task again; it is planned from here".to_owned();
}

/// A tag says where the robot hangs, whatever its drums did; what the lengths say besides names what
/// happened.
fn by_tag(
    evidence: &Evidence<'_>,
    alone: &Found,
    with_lengths: Option<Found>,
    known: Option<&(Lengths, Vec<f64>)>,
) -> Verdict {
    let found = with_lengths.as_ref().unwrap_or(alone);
    let covariance = found.covariance_m2 + Matrix3::identity() * TAG_PLACE_M.powi(2);
    let bound_m = radius_95_m(&covariance).max(unseen_slip_m(found));
    let before_m = known.map_or(&[][..], |(_, before)| before);
    let mut verdict = Verdict::refused(String::new(), BY_HAND).with(found, bound_m, before_m);
    verdict.used = vec!["tags in view".to_owned(), "tensions at rest".to_owned()];
    if with_lengths.is_some() {
        verdict
            .used
            .push("lengths, which agree with the tag".to_owned());
    }
    if let Some((lengths, _)) = known {
        let off = contradicted(lengths, alone, NAMED);
        verdict.contradicts = off
            .iter()
            .map(|(cable, off_m)| slipped(*cable, *off_m))
            .collect();
        if off.len() > 1 {
            let all = "the platform was moved, or drums were turned by hand".to_owned();
            verdict.contradicts.push(all);
        }
    }
    if !fits(found) {
        let worst = worst_tension(found);
        verdict.sentence = format!(
            "tag and tensions contradict each other most at cable {}: something carries or pulls the platform, a cable is off its drum, or the tag was moved",
            worst + 1
        );
        verdict
            .contradicts
            .push(format!("tension {} and the tag", worst + 1));
    } else if bound_m > evidence.bound_m {
        verdict.sentence = format!(
            "the tag shows the tool to {} only, and {} are needed",
            mm(bound_m),
            mm(evidence.bound_m)
        );
        BY_TAG.clone_into(&mut verdict.next);
    } else {
        accept(&mut verdict, found, bound_m);
    }
    verdict
}

fn slipped(cable: usize, off_m: f64) -> String {
    let (which, way) = if off_m > 0.0 {
        ("out", off_m)
    } else {
        ("in", -off_m)
    };
    format!("drum {} went {which} by {} unseen", cable + 1, mm(way))
}

fn worst_tension(found: &Found) -> usize {
    let rows = found.tension_residuals.iter().enumerate();
    let worst = rows.max_by(|(_, a), (_, b)| a.abs().total_cmp(&b.abs()));
    worst.map_or(0, |(cable, _)| cable)
}

/// Which drum's slip would explain a contradiction: the one whose length, left out, lets the rest
/// agree. Where none does, the platform was moved or is loaded.
fn blamed(model: &Model, weighed: &Weighed<'_>, found: &Found) -> Vec<String> {
    let Some(lengths) = weighed.lengths else {
        return Vec::new();
    };
    let mut best: Option<(f64, usize, f64)> = None;
    for cable in 0..lengths.mean_m.len() {
        let mut loose = lengths.clone();
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
            "the platform was moved or is loaded by hand, or a cable is off its drum (tension {} is furthest off)",
            worst_tension(found) + 1
        )],
    }
}

/// Distance of an estimate from where the tool truly is, m: for studies.
#[must_use]
pub fn error_m(verdict: &Verdict, truth_m: &Vector3<f64>) -> Option<f64> {
    let tool = Vector3::from(verdict.tool_mm?) * 1e-3;
    Some((tool - truth_m).norm())
}
