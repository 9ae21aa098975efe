//! The tension loop on typical winches: machines drawn over the whole range of friction, gear
//! efficiency and play of geared winches. `mcdpr study winch` prints it, docs/tension.md quotes it.
//!
//! The controller knows the robot file, and what `commission` found on each winch: friction, play, loss and stiffness.
//! Mass, anchors and the rest of the machine's errors are unknown to it.

mod identified;
mod uses;

pub use identified::Identified;
pub(crate) use identified::{commissioned, described};

use super::bench::{Bench, Change, Script};
use super::measure::{at_rest, recovery};
use crate::machine::Mismatch;
use crate::motion::Task;
use crate::robot::{LawKind, Robot, TensionOutput};
use mcdpr_twin::gears;
use rayon::prelude::*;
use serde::Serialize;

/// Height of the tool for the circle on a platform at z = -100 mm, m.
const CIRCLE_Z_M: f64 = -0.18;
/// Start and end of a pull on the platform, s, its force, N, and the end of the experiment, s.
const PULL_S: [f64; 2] = [0.5, 1.0];
const PULL_N: f64 = 2.0;
const END_S: f64 = 4.0;
/// Cable that slips off a drum, m, within 0.2 s.
const SLIP_M: f64 = 0.003;

/// A law with its output and gains.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Contender {
    /// Its heading.
    pub name: &'static str,
    /// The robot with this law.
    #[serde(skip)]
    pub robot: Robot,
}

/// The measured figures of a machine, in this order.
pub(crate) const FIGURES: [(&str, &str, &str); 22] = [
    ("rest: mean error", "N", "0.2"),
    ("rest: standard deviation", "N", ""),
    ("rest: drum's way in the last second", "um", ""),
    ("circle: mean absolute error", "N", "0.291"),
    ("circle: greatest error", "N", ""),
    ("pulled 2 N: 50 ms mean back within 0.5 N", "s", "1"),
    ("pulled 2 N: least tension of any cable", "N", ""),
    ("3 mm slack: greatest tension", "N", ""),
    ("circle of the tool, absolute: mean", "mm", "3.425"),
    ("circle of the tool, absolute: greatest", "mm", "7.044"),
    ("circle: reversal error of a cable", "mm", ""),
    ("circle of the tool, homed: mean", "mm", ""),
    ("circle of the tool, homed: greatest", "mm", ""),
    ("line of the tool, absolute: mean", "mm", ""),
    ("line of the tool, absolute: greatest", "mm", ""),
    ("steps of 2 N as `tune` makes them: error, rms", "N", ""),
    ("steps of 2 N as `tune` makes them: ringing, rms", "N", ""),
    ("poses collected of 20", "", ""),
    ("circle of the tool, calibrated: mean", "mm", ""),
    ("circle of the tool, calibrated: greatest", "mm", ""),
    ("line of the tool, calibrated: mean", "mm", ""),
    ("line of the tool, calibrated: greatest", "mm", ""),
];
/// Figures of the tension loop; the rest are those of the tool's path, of tuning and of collecting, which only the
/// first contender runs.
pub const OF_TENSION: usize = 8;

/// A drawn machine, and the results of each contender on it.
#[derive(Debug, Clone, Serialize)]
pub struct Drawn {
    /// Seed.
    pub seed: u64,
    /// Friction of rotor and gear, felt at the cable, N; each winch differs from it by up to a tenth.
    pub friction_n: f64,
    /// Efficiency, likewise.
    pub efficiency: f64,
    /// Play, likewise, degrees.
    pub play_deg: f64,
    /// What `commission` found, winch by winch; empty if it failed.
    pub found: Vec<Identified>,
    /// Why `commission` failed, if so.
    pub refused: Vec<String>,
    /// One per contender: its figures, and the faults that ended some runs.
    pub runs: Vec<Ran>,
}

/// Results of one contender on one machine.
#[derive(Debug, Clone, Serialize)]
pub struct Ran {
    /// As `FIGURES`; `None` where a fault ended the run.
    pub figures: Vec<Option<f64>>,
    /// Faults, each with the experiment that it ended.
    pub faults: Vec<String>,
}

/// The laws that are compared on a robot: its own, and the paper's with either output, and on the planned speed.
#[must_use]
pub(crate) fn contenders(robot: &Robot) -> Vec<Contender> {
    let with = |name, output, kp, kd| {
        let mut robot = robot.clone();
        robot.tension.law = LawKind::Pd;
        robot.tension.output = output;
        (robot.tension.kp, robot.tension.kd) = (kp, kd);
        Contender { name, robot }
    };
    vec![
        Contender {
            name: "default",
            robot: robot.clone(),
        },
        with(
            "pd, speed",
            TensionOutput::Velocity,
            PD_SPEED[0],
            PD_SPEED[1],
        ),
        with("pd, current", TensionOutput::Current, 3.0, 0.05),
        planned_with_pd(robot),
    ]
}

/// Eq. 1 as a correction of the planned speed, a reading of the paper: the default law with its proportional part
/// alone.
fn planned_with_pd(robot: &Robot) -> Contender {
    let mut robot = robot.clone();
    robot.tension.output = TensionOutput::Velocity;
    (robot.tension.kp, robot.tension.kd, robot.tension.ki) = (PD_ON_PLAN, 0.0, 0.0);
    robot.tension.gain_length_m = 0.0;
    Contender {
        name: "pd on the planned speed",
        robot,
    }
}

/// Gains of Eq. 1 with a speed as its output, mm/s per N and mm/N: see docs/paper-notes.md.
const PD_SPEED: [f64; 2] = [5.0, 0.0];
/// Gain with which the tension is back after about the paper's second (0.7 s, median of 40 machines), mm/s per N.
const PD_ON_PLAN: f64 = 0.3;

/// Draws machines, commissions their winches, and, unless only that is wanted, runs every contender on each; `done` is
/// called after each machine.
#[must_use]
pub fn study(
    robot: &Robot,
    seeds: std::ops::Range<u64>,
    commission_only: bool,
    done: impl Fn() + Sync,
) -> Vec<Drawn> {
    let mut contenders = contenders(robot);
    if commission_only {
        contenders.clear();
    }
    let seeds: Vec<u64> = seeds.collect();
    seeds
        .into_par_iter()
        .map(|seed| {
            let (built, [friction_n, efficiency, play_deg]) = gears::drawn(robot, seed);
            let mut failed = Vec::new();
            let found = commissioned(robot, &built, seed).unwrap_or_else(|error| {
                failed.push(format!("commission: {error}"));
                Vec::new()
            });
            let refused = failed.clone();
            let runs = contenders.iter().enumerate().map(|(index, contender)| {
                let told = described(&contender.robot, &found);
                let mut run = ran(&told, &built, seed);
                if index == 0 {
                    uses::follow(&told, &built, seed, &mut run);
                    uses::tune_collect_and_follow(&told, &built, seed, &mut run);
                    run.faults.append(&mut failed);
                }
                run
            });
            let runs = runs.collect();
            let found = found.into_iter().map(|(_, errors)| errors).collect();
            done();
            Drawn {
                seed,
                friction_n,
                efficiency,
                play_deg,
                found,
                refused,
                runs,
            }
        })
        .collect()
}

/// Every experiment with the tension loop on one machine, built as `built` says and described by `robot`.
#[must_use]
pub fn ran(robot: &Robot, built: &Robot, seed: u64) -> Ran {
    let change = Change {
        gears: Mismatch::realistic().gears,
        ..Change::default()
    };
    let mut faults = Vec::new();
    let mut figures = Vec::new();
    // Another direction with every seed, by the golden angle.
    #[expect(clippy::cast_precision_loss, reason = "a small count")]
    let angle = seed as f64 * 2.399_963;
    let force_n = [PULL_N * angle.cos(), PULL_N * angle.sin(), 0.0];
    let mut act = |name: &str, count: usize, act: &dyn Fn(&mut Bench<'_>) -> Acted| {
        let acted = Bench::start_built(robot, built, &change, seed)
            .map_err(|error| error.to_string())
            .and_then(|mut bench| act(&mut bench));
        match acted {
            Ok(values) => figures.extend(values.into_iter().map(Some)),
            Err(fault) => {
                faults.push(format!("{name}: {fault}"));
                figures.extend(std::iter::repeat_n(None, count));
            }
        }
    };
    act("rest", 3, &|bench| {
        let trace = whole(bench.run(&Script::rest(3.0)))?;
        let steady = at_rest(&trace, 1.0, 3.0);
        let late = trace.time_s.iter().zip(&trace.drum_m);
        let late = late.filter(|(time_s, _)| **time_s > 2.0);
        let (least, most) = late.fold((f64::INFINITY, f64::NEG_INFINITY), |range, (_, at)| {
            (range.0.min(*at), range.1.max(*at))
        });
        Ok(vec![
            steady.mean_error_n.abs(),
            steady.sd_n,
            (most - least) * 1e6,
        ])
    });
    act("circle", 2, &|bench| {
        let task = Task::built_in("paper:table7", CIRCLE_Z_M).map_err(|error| error.to_string())?;
        let trace = whole(bench.follow(task))?;
        let steady = at_rest(&trace, 0.0, f64::INFINITY);
        Ok(vec![steady.mean_abs_n, steady.max_abs_n])
    });
    act("pull", 2, &|bench| {
        let [on_s, off_s] = PULL_S;
        let script = Script::platform_pull(force_n, on_s, off_s, END_S);
        let back = recovery(&whole(bench.run(&script))?, on_s, off_s);
        Ok(vec![back.mean_back_s, back.least_n])
    });
    act("slack", 1, &|bench| {
        let [on_s, _] = PULL_S;
        let script = Script::slip(bench.watched(), SLIP_M, on_s, on_s + 0.2, END_S);
        let back = recovery(&whole(bench.run(&script))?, on_s + 0.2, END_S);
        Ok(vec![back.greatest_n])
    });
    Ran { figures, faults }
}

type Acted = Result<Vec<f64>, String>;

/// A trace that no fault ended.
fn whole(trace: Result<super::Trace, crate::run::RunError>) -> Result<super::Trace, String> {
    let trace = trace.map_err(|error| error.to_string())?;
    trace.fault.clone().map_or(Ok(trace), Err)
}

/// Median and 95th percentile (nearest rank) of one figure of one contender over machines without a
/// fault, and their number; `within` selects machines by their friction, N.
#[must_use]
pub fn spread(
    drawn: &[Drawn],
    contender: usize,
    figure: usize,
    within: [f64; 2],
) -> Option<(f64, f64, usize)> {
    let values = drawn
        .iter()
        .filter(|machine| (within[0]..within[1]).contains(&machine.friction_n))
        .filter_map(|machine| *machine.runs.get(contender)?.figures.get(figure)?);
    median_and_p95(values.collect())
}

/// Median and 95th percentile (nearest rank) of some values, and their number.
#[must_use]
pub(crate) fn median_and_p95(mut values: Vec<f64>) -> Option<(f64, f64, usize)> {
    values.sort_by(f64::total_cmp);
    let rank = |share: f64| {
        #[expect(
            clippy::cast_precision_loss,
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "some machines"
        )]
        let at = ((values.len() as f64 * share).ceil() as usize).saturating_sub(1);
        values.get(at).copied()
    };
    Some((rank(0.5)?, rank(0.95)?, values.len()))
}
