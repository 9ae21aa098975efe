//! The decision after a loss of power: the tool's position with a bound, or a refusal that names the
//! next measurement.

use super::fuse::Found;
use super::gentle::{Response, locate};
use super::journal::{Journal, JournalError};
use super::looks::RestReadings;
use super::reference::TagReference;
use super::weigh::{Estimates, estimates};
use crate::estimate::{EstimateError, Measurements};
use crate::motion::Model;
use mcdpr_protocol::BoardState;
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// Source of the lengths.
#[derive(Debug, Clone)]
pub enum Source<'a> {
    /// The board kept its supply and counted all along, m.
    Board {
        /// Paid-out lengths.
        lengths_m: Vec<f64>,
    },
    /// A fault of its program reset the board, and its encoders counted on.
    Reset {
        /// Paid-out lengths: those of its last tick and the way since its start, m.
        lengths_m: Vec<f64>,
        /// Speeds at the reset, mean and standard deviation, m/s.
        speeds_mps: Vec<[f64; 2]>,
    },
    /// The board has lost its lengths; a valid journal exists.
    Journal(&'a Journal),
    /// The board has lost its lengths, and there is no valid journal.
    Refused(JournalError),
}

/// All evidence after a loss of power.
#[derive(Debug, Clone)]
pub struct Evidence<'a> {
    /// Source of the lengths.
    pub source: Source<'a>,
    /// Tensions with closed brakes, and the motion of the platform while they were read.
    pub rest: RestReadings,
    /// Views of tags; empty without a camera.
    pub seen: Measurements,
    /// Where the camera saw the tags when the robot was homed, if that was kept.
    pub reference: Option<&'a TagReference>,
    /// Whether the user states that nobody moved drums, brakes or platform without power.
    pub untouched: bool,
    /// Whether the user states that computer and robot lost their supply at the same time.
    pub together: bool,
    /// Lengths in the last tick before the board lost its supply, m, from registers that a reset leaves or a battery
    /// kept.
    pub registers_m: Option<Vec<f64>>,
    /// Largest bound of the tool's position that the job allows, m.
    pub bound_m: f64,
}

/// The result of a recovery. Lengths and positions in mm.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Verdict {
    /// Whether the robot may continue from here.
    pub accepted: bool,
    /// One sentence.
    pub sentence: String,
    /// The tool, world; absent without an estimate.
    pub tool_mm: Option<[f64; 3]>,
    /// Bound of the tool's error that the decision uses: the greater of the two below.
    pub bound_mm: Option<f64>,
    /// Statistical bound: 95 % of the errors are smaller, if no drum slipped unnoticed.
    pub bound_95_mm: Option<f64>,
    /// Integrity bound: the error that an undetected slip of one drum, or lengths that agree with a tag by chance,
    /// can cause.
    pub integrity_bound_mm: Option<f64>,
    /// Covariance of the tool behind the statistical bound, world, mm².
    #[serde(skip)]
    pub covariance_mm2: Option<Matrix3<f64>>,
    /// The evidence that the estimate uses.
    pub used: Vec<String>,
    /// Contradictions in the evidence.
    pub contradicts: Vec<String>,
    /// The one thing to do next.
    pub next: String,
    /// Cable that each drum paid out since the last state in the journal, by this estimate.
    pub paid_out_mm: Vec<f64>,
    /// A slip of each drum that the evidence would not show.
    pub undetected_slip_mm: Vec<f64>,
    /// The gripper's last command before the loss of power.
    pub gripper_closed: Option<bool>,
    /// Path time of the interrupted motion, s.
    pub path_s: Option<f64>,
    /// Swing of each tension while it was read, peak to peak, N.
    pub swing_n: Vec<f64>,
    /// Swing of the platform at the tag, peak to peak; absent without a tag.
    pub swing_mm: Option<f64>,
    /// Lengths to reference, m.
    #[serde(skip)]
    pub lengths_m: Vec<f64>,
    /// Tensions to expect, N.
    #[serde(skip)]
    pub tensions_n: Vec<f64>,
}

/// The last record is at most this much older than the last tick, s, where the program went on.
const LATE_S: f64 = 0.05;

pub(super) const BY_TAG: &str =
    "bring a tag whose place is known into the camera's view and recover again";
pub(super) const BY_HAND: &str =
    "home by hand: `mcdpr home --at X Y Z` with the tool at a known place";

impl Verdict {
    fn refused(sentence: impl Into<String>, next: impl Into<String>) -> Self {
        Self {
            sentence: sentence.into(),
            next: next.into(),
            ..Self::default()
        }
    }

    /// The figures of an estimate.
    fn of(estimates: &Estimates) -> Self {
        let found = estimates.best();
        let before_m = estimates
            .known
            .as_ref()
            .map_or(&[][..], |known| &known.before_m);
        let pairs = found.rest.paid_out_m.iter().zip(before_m);
        let residual = found.residual_per_length.iter();
        Self {
            tool_mm: Some((found.tool_m * 1e3).into()),
            bound_mm: Some(estimates.bound_m() * 1e3),
            bound_95_mm: Some(estimates.bound_95_m * 1e3),
            integrity_bound_mm: Some(estimates.integrity_bound_m * 1e3),
            covariance_mm2: Some(estimates.covariance_m2 * 1e6),
            lengths_m: found.rest.paid_out_m.clone(),
            tensions_n: found.rest.tensions_n().to_vec(),
            paid_out_mm: pairs.map(|(now, then)| (now - then) * 1e3).collect(),
            // A slip that adds four to the root of chi-square is noticed in most cases.
            undetected_slip_mm: residual.map(|per_m| 4.0 / per_m.max(1e-9) * 1e3).collect(),
            ..Self::default()
        }
    }

    fn accept(&mut self, tool_m: Vector3<f64>, bound_m: f64) {
        let at = tool_m * 1e3;
        self.accepted = true;
        self.sentence = format!(
            "the tool is at ({:.1}, {:.1}, {:.1}) mm, within {}",
            at.x,
            at.y,
            at.z,
            mm(bound_m)
        );
        self.next = "continue the task with `mcdpr run TASK --resume`, or start any other: it is planned from here".to_owned();
    }
}

pub(super) fn mm(value_m: f64) -> String {
    format!("{:.1} mm", value_m * 1e3)
}

/// Judges whether the robot may continue, and from where.
///
/// # Errors
/// [`EstimateError`] where the statics cannot be solved at all.
pub fn judge(model: &Model, evidence: &Evidence<'_>) -> Result<Verdict, EstimateError> {
    let mut verdict = decide(model, evidence)?;
    if let Source::Journal(journal) = evidence.source {
        let last = journal.last.as_ref();
        verdict.gripper_closed = last.map(|last| last.gripper_closed);
        verdict.path_s = (journal.path_ms > 0).then(|| f64::from(journal.path_ms) * 1e-3);
    }
    verdict.swing_n.clone_from(&evidence.rest.swing_n);
    verdict.swing_mm = evidence.rest.swing_m.map(|swing_m| swing_m * 1e3);
    Ok(verdict)
}

fn decide(model: &Model, evidence: &Evidence<'_>) -> Result<Verdict, EstimateError> {
    if let Source::Refused(reason) = &evidence.source {
        let next = if evidence.seen.views.is_empty() {
            BY_HAND
        } else {
            "home by the tag in view: `mcdpr home --tag`"
        };
        let sentence = format!("the journal is not valid: {reason}; the file is unchanged");
        return Ok(Verdict::refused(sentence, next));
    }
    if let Some(sentence) = contradicted(model, evidence) {
        return Ok(Verdict::refused(sentence, BY_TAG));
    }
    // Slack and drift before the estimate: statics hold for taut cables at rest only.
    if let Some(slack) = evidence.rest.slack() {
        let number = slack.cable + 1;
        return Ok(if slack.always {
            Verdict::refused(
                format!(
                    "cable {number} is slack ({:.1} N): the robot does not hang as statics describe it",
                    slack.tension_n
                ),
                format!(
                    "put the platform on its stand, take the cable up with `mcdpr rig tension`, then {BY_HAND}"
                ),
            )
        } else {
            Verdict::refused(
                format!(
                    "cable {number} goes slack while the platform swings (down to {:.1} N)",
                    slack.tension_n
                ),
                "steady the platform, or wait until it rests, and recover again",
            )
        });
    }
    if let Some(motion) = evidence.rest.drift() {
        return Ok(Verdict::refused(
            motion,
            "hold the platform still, or wait until it rests, and recover again; if it keeps sinking, a brake slips: repair it first",
        ));
    }
    match estimates(model, evidence) {
        Ok(Some(estimates)) if estimates.by_tag => Ok(by_tag(evidence, &estimates)),
        Ok(Some(estimates)) => Ok(without_tag(evidence, &estimates)),
        Ok(None) => Ok(Verdict::refused(
            "the lengths were not referenced when the power failed",
            BY_HAND,
        )),
        Err(error @ (EstimateError::NoFit { .. } | EstimateError::Rank)) => {
            let sentence = format!(
                "{error}: a drum slipped far, a cable is slack or off its drum, or something carries the platform"
            );
            Ok(Verdict::refused(sentence, BY_HAND))
        }
        Err(error) => Err(error),
    }
}

/// Whether the board's registers and the journal are of different times: a board moves for some hundredths of a second
/// at most after the last record, unless its computer failed long before it. A tag in view shows the place whatever the
/// lengths are: they are not used then where they disagree with it.
fn contradicted(model: &Model, evidence: &Evidence<'_>) -> Option<String> {
    let (Source::Journal(journal), Some(registers_m)) = (&evidence.source, &evidence.registers_m)
    else {
        return None;
    };
    let decides = journal.ended && evidence.seen.views.is_empty();
    let last = journal.last.as_ref().filter(|_| decides)?;
    let pairs = last.cables.iter().zip(registers_m);
    let apart = pairs.map(|(cable, kept_m)| (cable.length_m - kept_m).abs());
    let (cable, apart_m) = (1..).zip(apart).max_by(|a, b| a.1.total_cmp(&b.1))?;
    let most_m = LATE_S * model.robot().limits.speed_mps + 1e-3;
    (apart_m > most_m).then(|| {
        format!(
            "the journal and the lengths that the board kept are {} apart at cable {cable}: they are not of the same time",
            mm(apart_m)
        )
    })
}

/// The decision by lengths and tensions alone.
fn without_tag(evidence: &Evidence<'_>, estimates: &Estimates) -> Verdict {
    let found = estimates.best();
    let bound_m = estimates.bound_m();
    let journal = match evidence.source {
        Source::Journal(journal) => Some(journal),
        _ => None,
    };
    let mut verdict = Verdict::of(estimates);
    BY_TAG.clone_into(&mut verdict.next);
    let lengths = match evidence.source {
        Source::Reset { .. } => {
            "the lengths that the board kept over its reset, and its counts since".to_owned()
        }
        Source::Journal(_) if evidence.registers_m.is_some() => {
            "the lengths that the board kept, the journal's speeds, and the model of the drums until their brakes close"
                .to_owned()
        }
        _ => used_lengths(journal),
    };
    verdict.used = vec![lengths, "tensions at rest".to_owned()];
    if !estimates.fits() {
        verdict.contradicts.clone_from(&estimates.suspects);
        verdict.sentence = format!(
            "lengths and tensions contradict each other: {}",
            verdict.contradicts.join("; ")
        );
        return verdict;
    }
    let parked = journal
        .and_then(|journal| journal.last.as_ref())
        .is_some_and(|last| last.state == BoardState::Disarmed);
    // A bound that is too large is reported first: a confirmation by the user would not reduce it.
    if bound_m > evidence.bound_m {
        verdict.sentence = format!(
            "the tool's position is known to {} only, and {} are required",
            mm(bound_m),
            mm(evidence.bound_m)
        );
    } else if let Some(journal) = journal.filter(|journal| moved_unseen(journal, evidence)) {
        verdict.sentence = format!(
            "the journal stops at path time {:.1} s in motion, as the computer failed: a board that kept its supply longer moved on, and no record says how far",
            f64::from(journal.path_ms) * 1e-3
        );
        verdict.next = format!(
            "{BY_TAG}; or, if computer and robot lost their supply at the same time, confirm it: `mcdpr recover --untouched --together`"
        );
    } else if journal.is_some() && !evidence.untouched {
        verdict.sentence = format!(
            "nothing contradicts a bound of {}, but no encoder was read without power{}",
            mm(bound_m),
            if parked {
                ", although the robot was parked"
            } else {
                ""
            }
        );
        verdict.next = format!(
            "{BY_TAG}; or, if nobody touched drums, brakes or platform meanwhile, confirm it: `mcdpr recover --untouched`"
        );
    } else {
        verdict.accept(found.tool_m, bound_m);
    }
    verdict
}

/// Whether the board may have moved on after the journal's last record. Without its host it stops along its
/// path only after 100 ms (L10): at 0.3 m/s that is some centimetres, which tensions do not show.
fn moved_unseen(journal: &Journal, evidence: &Evidence<'_>) -> bool {
    let moving = journal.last.as_ref().is_some_and(|last| {
        matches!(
            last.state,
            BoardState::Moving | BoardState::Pausing | BoardState::Stopping
        )
    });
    moving && !journal.ended && !evidence.together && evidence.registers_m.is_none()
}

fn used_lengths(journal: Option<&Journal>) -> String {
    let text = match journal {
        None => "the board's own counts: it kept its supply",
        Some(journal) if journal.ended => {
            "the journal, and the model of the drums until their brakes close"
        }
        Some(_) => {
            "the journal up to its last record on the disk, and the model of the drums until their brakes close"
        }
    };
    text.to_owned()
}

/// The decision by a tag: it shows the platform whatever the drums did. Lengths that differ name the
/// drum that slipped.
fn by_tag(evidence: &Evidence<'_>, estimates: &Estimates) -> Verdict {
    let found = estimates.best();
    let bound_m = estimates.bound_m();
    let mut verdict = Verdict::of(estimates);
    // A tag shows the place itself: the user need not confirm that nothing was touched.
    BY_HAND.clone_into(&mut verdict.next);
    let tags = match evidence.reference {
        Some(_) => "tags in view, relative to the view when the robot was homed",
        None => "tags in view",
    };
    verdict.used = vec![tags.to_owned(), "tensions at rest".to_owned()];
    if estimates.with_lengths.is_some() {
        let agree = "lengths, which agree with the tag".to_owned();
        verdict.used.push(agree);
    }
    verdict.contradicts.clone_from(&estimates.suspects);
    if !estimates.fits() {
        let worst = worst_tension(found) + 1;
        verdict.sentence = format!(
            "tag and tensions contradict each other most at cable {worst}: something carries or pulls the platform, a cable is off its drum, or the tag was moved"
        );
        verdict
            .contradicts
            .push(format!("tension {worst} and the tag"));
    } else if bound_m > evidence.bound_m {
        verdict.sentence = format!(
            "the tag shows the tool to {} only, and {} are required",
            mm(bound_m),
            mm(evidence.bound_m)
        );
        BY_TAG.clone_into(&mut verdict.next);
    } else {
        verdict.accept(found.tool_m, bound_m);
    }
    verdict
}

/// Whether a gentle test may be begun: on a robot at rest with taut cables.
#[must_use]
pub fn gentle_helps(evidence: &Evidence<'_>) -> bool {
    evidence.rest.slack().is_none() && evidence.rest.drift().is_none()
}

/// The decision by a gentle test, after `refused`. It uses neither lengths nor what anybody did without power.
///
/// # Errors
/// [`EstimateError`] where the robot cannot hang at home.
pub fn by_gentle_test(
    model: &Model,
    evidence: &Evidence<'_>,
    refused: Verdict,
    responses: &[Response],
) -> Result<Verdict, EstimateError> {
    let home_m = model.robot().tool.home_in_world_m;
    let near = refused.tool_mm.map(|mm| Vector3::from(mm) * 1e-3);
    let starts = near.into_iter().chain([home_m]);
    let mut found =
        starts.filter_map(|start_m| locate(model, &evidence.rest, responses, &start_m).ok());
    let Some(found) = found.find(|found| found.fits) else {
        return Ok(Verdict {
            sentence: format!(
                "{}; and the gentle test's tensions fit no place of this robot",
                refused.sentence
            ),
            next: BY_HAND.to_owned(),
            ..refused
        });
    };
    let bound_m = found.bound_95_m;
    let mut verdict = Verdict {
        tool_mm: Some((found.tool_m * 1e3).into()),
        bound_mm: Some(bound_m * 1e3),
        bound_95_mm: Some(bound_m * 1e3),
        integrity_bound_mm: None,
        covariance_mm2: Some(found.covariance_m2 * 1e6),
        lengths_m: found.rest.paid_out_m.clone(),
        tensions_n: found.rest.tensions_n().to_vec(),
        paid_out_mm: Vec::new(),
        used: vec![
            "a gentle test of all cables".to_owned(),
            "tensions at rest".to_owned(),
        ],
        ..refused
    };
    if bound_m > evidence.bound_m {
        verdict.sentence = format!(
            "the gentle test shows the tool to {} only, and {} are required",
            mm(bound_m),
            mm(evidence.bound_m)
        );
        BY_TAG.clone_into(&mut verdict.next);
    } else {
        verdict.accept(found.tool_m, bound_m);
    }
    Ok(verdict)
}

/// The cable, from 0, whose tension differs most from the estimate's.
pub(super) fn worst_tension(found: &Found) -> usize {
    let rows = found.tension_residuals.iter().enumerate();
    let worst = rows.max_by(|(_, a), (_, b)| a.abs().total_cmp(&b.abs()));
    worst.map_or(0, |(cable, _)| cable)
}

/// Distance of an estimate from the tool's true position, m: for studies.
#[must_use]
pub fn error_m(verdict: &Verdict, truth_m: &Vector3<f64>) -> Option<f64> {
    let tool = Vector3::from(verdict.tool_mm?) * 1e-3;
    Some((tool - truth_m).norm())
}

/// Square of an estimate's error in units of its covariance: chi-square with three degrees of freedom if
/// the covariance is right (normalised estimation error squared; Bar-Shalom, Li and Kirubarajan 2001,
/// section 5.4).
#[must_use]
pub fn normalised_error(verdict: &Verdict, truth_m: &Vector3<f64>) -> Option<f64> {
    let off_mm = Vector3::from(verdict.tool_mm?) - truth_m * 1e3;
    let weight = verdict.covariance_mm2?.try_inverse()?;
    Some((off_mm.transpose() * weight * off_mm).x)
}
