//! Figures and verdicts of a recorded run, from the record alone.

use super::figures::{MeanMax, MeanSdMax, TensionError, greatest, mean};
use super::mcap::Damage;
use super::{Change, RecordedRun};
use crate::decode::{Seen, Tick};
use mcdpr_core::robot::{Control, Robot};
use mcdpr_protocol::Status;
use serde::Serialize;

/// A check of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// Its name.
    pub what: String,
    /// Whether it passed.
    pub pass: bool,
    /// The numbers.
    pub numbers: String,
}

/// Figures of one cable over the motion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CableFigures {
    /// Absolute difference of measured and commanded length, m.
    pub length_error_m: MeanSdMax,
    /// Least tension at the winch, N.
    pub tension_min_n: f64,
    /// Greatest tension at the winch, N.
    pub tension_max_n: f64,
}

/// Results of a recorded run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judgement {
    /// Duration of the record, s.
    pub duration_s: f64,
    /// Distance of the tool from its planned position, m; simulated runs only.
    pub path_error_m: Option<MeanMax>,
    /// Absolute length errors of all cables, m.
    pub cable_length_error_m: Option<MeanSdMax>,
    /// Tension-held cables: measured minus set-point, N.
    pub tension_error_n: Option<TensionError>,
    /// Cable by cable.
    pub cables: Vec<CableFigures>,
    /// Changes of state and faults.
    pub changes: Vec<Change>,
    /// Checks.
    pub verdicts: Vec<Verdict>,
}

/// The measurements during the motion.
#[must_use]
pub fn moving(ticks: &[Tick]) -> Vec<&Tick> {
    ticks
        .iter()
        .filter(|tick| !tick.planned.is_empty())
        .collect()
}

fn mean_sd_max(values: &[f64]) -> MeanSdMax {
    let middle = mean(values);
    let spread: Vec<_> = values.iter().map(|v| (v - middle).powi(2)).collect();
    MeanSdMax {
        mean: middle,
        sd: mean(&spread).sqrt(),
        max: greatest(values),
    }
}

/// Judges a recorded run of a robot.
#[must_use]
pub fn judge(run: &RecordedRun, robot: &Robot) -> Judgement {
    let ticks = run.ticks();
    let motion = moving(&ticks);
    let mut all = Vec::new();
    let mut held = Vec::new();
    let mut cables = Vec::new();
    for (index, cable) in robot.cables.iter().enumerate() {
        let pairs = motion.iter().filter_map(|tick| {
            let planned = tick.planned.get(index)?;
            Some((tick.lengths_m.get(index)? - planned.length_m).abs())
        });
        let errors: Vec<f64> = pairs.collect();
        let tensions: Vec<f64> = motion
            .iter()
            .filter_map(|tick| tick.tensions_n.get(index).copied())
            .collect();
        if cable.control == Control::Tension {
            // The set-point comes from the plan: it changes along the path.
            let off = motion.iter().filter_map(|tick| {
                let planned = tick.planned.get(index)?;
                Some((tick.tensions_n.get(index)? - planned.tension_n).abs())
            });
            held.extend(off);
        }
        if !errors.is_empty() {
            cables.push(CableFigures {
                length_error_m: mean_sd_max(&errors),
                // `f64::min` ignores NaN: without tensions the least is NaN, not infinity.
                tension_min_n: tensions.iter().copied().fold(f64::NAN, f64::min),
                tension_max_n: greatest(&tensions),
            });
        }
        all.extend(errors);
    }
    let path: Vec<f64> = path_errors(run)
        .into_iter()
        .map(|(_, error)| error)
        .collect();
    let changes = run.changes();
    let mut judgement = Judgement {
        duration_s: run.duration_s(),
        path_error_m: (!path.is_empty()).then(|| MeanMax {
            mean: mean(&path),
            max: greatest(&path),
        }),
        cable_length_error_m: (!all.is_empty()).then(|| mean_sd_max(&all)),
        tension_error_n: (!held.is_empty()).then(|| TensionError::of(held)),
        cables,
        changes,
        verdicts: Vec::new(),
    };
    judgement.verdicts = verdicts(run, robot, &judgement);
    judgement
}

/// Path time (s) and distance of the simulated tool from its planned position (m).
#[must_use]
pub fn path_errors(run: &RecordedRun) -> Vec<(f64, f64)> {
    let Some(plan) = &run.plan else {
        return Vec::new();
    };
    let moving = run
        .truth
        .iter()
        .filter(|point| point.path_s > 0.0 && point.path_s <= plan.duration_s);
    moving
        .filter_map(|point| {
            let shall = plan.tool_at(point.path_s)?;
            let gaps = shall
                .iter()
                .zip(&point.tool_m)
                .map(|(a, b)| (a - b).powi(2));
            Some((point.path_s, gaps.sum::<f64>().sqrt()))
        })
        .collect()
}

/// Checks with their results.
#[derive(Default)]
struct Checks(Vec<Verdict>);

impl Checks {
    fn check(&mut self, what: &str, pass: bool, numbers: String) {
        self.0.push(Verdict {
            what: what.to_owned(),
            pass,
            numbers,
        });
    }

    /// No fault, and a motion that ended at rest with closed brakes.
    fn states(&mut self, judgement: &Judgement, last: Option<&Status>) {
        let faults: Vec<_> = judgement
            .changes
            .iter()
            .filter(|change| change.text.starts_with("fault"))
            .collect();
        self.check(
            "no fault",
            faults.is_empty(),
            match faults.first() {
                Some(change) => format!("{} at {:.3} s", change.text, change.time_s),
                None => "none latched".to_owned(),
            },
        );
        let moved = judgement
            .changes
            .iter()
            .any(|change| change.text == "Moving");
        let ended = judgement
            .changes
            .iter()
            .rev()
            .map(|change| change.text.as_str());
        let ended = ended.clone().next() == Some("Disarmed");
        self.check(
            "ended at rest, brakes closed",
            ended && moved,
            last.map_or("no status was received".to_owned(), |s| {
                format!("{:?}", s.state)
            }),
        );
    }

    fn tensions(&mut self, robot: &Robot, judgement: &Judgement) {
        let limits = &robot.limits;
        let low = judgement
            .cables
            .iter()
            .map(|c| c.tension_min_n)
            .fold(f64::MAX, f64::min);
        let high = judgement
            .cables
            .iter()
            .map(|c| c.tension_max_n)
            .fold(0.0, f64::max);
        if !judgement.cables.is_empty() {
            self.check(
                "every tension within its band",
                low >= limits.tension_min_n && high <= limits.tension_max_n,
                format!(
                    "{low:.1} to {high:.1} N, band {:.1} to {:.1} N",
                    limits.tension_min_n, limits.tension_max_n
                ),
            );
        }
        if let Some(error) = judgement.tension_error_n {
            self.check(
                "tension-held cable within 0.5 N on average (the paper's band)",
                error.mean_abs <= 0.5,
                format!(
                    "mean {:.3} N, greatest {:.3} N",
                    error.mean_abs, error.max_abs
                ),
            );
        }
    }

    /// The board's tick, the line, and the record itself.
    fn line(&mut self, run: &RecordedRun, last: Option<&Status>) {
        if let Some(status) = last {
            self.check(
                "no control tick was late",
                status.tick_overruns == 0,
                format!("{} late", status.tick_overruns),
            );
            self.check(
                "no frame was damaged on its way to the board",
                status.frames_bad == 0,
                format!(
                    "{} of {}",
                    status.frames_bad,
                    status.frames_ok + status.frames_bad
                ),
            );
        }
        self.check(
            "the record is whole",
            run.damage.is_none() && run.gaps == 0,
            match (&run.damage, run.gaps) {
                (None, 0) => format!("{} calls of the line", run.frames.len()),
                (Some(Damage::Truncated { at }), _) => format!("cut short at byte {at}"),
                (Some(Damage::Corrupt { at }), _) => format!("corrupt at byte {at}"),
                (None, gaps) => format!("{gaps} calls are missing"),
            },
        );
    }
}

fn verdicts(run: &RecordedRun, robot: &Robot, judgement: &Judgement) -> Vec<Verdict> {
    let seen = run.seen();
    let last = seen.iter().rev().find_map(|report| match &report.seen {
        Seen::Status(status) => Some(status),
        _ => None,
    });
    let mut checks = Checks::default();
    checks.states(judgement, last);
    checks.tensions(robot, judgement);
    checks.line(run, last);
    checks.0
}
