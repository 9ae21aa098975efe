//! The table of figures of the tension loop: every experiment over many seeds, one column a law or
//! a machine that is off. `mcdpr study tension` prints it, docs/results/tension.md quotes it.

use super::bench::{Bench, Change, Script};
use super::measure::{at_rest, recovery};
use crate::motion::Task;
use crate::robot::{LawKind, Robot};
use crate::run::RunError;
use rayon::prelude::*;

/// One machine or law.
#[derive(Debug, Clone)]
pub struct Column {
    /// Its heading.
    pub name: &'static str,
    /// Law instead of the robot file's.
    pub law: LawKind,
    /// Errors of the machine.
    pub change: Change,
}

/// One figure: medians over the seeds, one per column; `None` if too many runs ended in a fault.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Row {
    /// Its name.
    pub figure: String,
    /// The paper's hardware result, if stated.
    pub paper: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Medians.
    pub medians: Vec<Option<f64>>,
    /// Runs of each column without a fault.
    pub ended: Vec<usize>,
}

/// The columns: the default law, the same with 2 % pulley loss, the paper's law.
#[must_use]
pub fn columns() -> Vec<Column> {
    let column = |name, law, pulley_loss| Column {
        name,
        law,
        change: Change {
            pulley_loss,
            ..Change::default()
        },
    };
    vec![
        column("default", LawKind::Default, 0.0),
        column("2 % loss", LawKind::Default, 0.02),
        column("pd", LawKind::Pd, 0.0),
    ]
}

/// Action on a robot.
#[derive(Debug, Clone, Copy)]
enum Act {
    Rest,
    Circle,
    /// Pull on the platform, N.
    Pull(f64),
    /// Pull across the tension-held cable, N.
    Cable(f64),
    /// Cable that creeps off, m.
    Slack(f64),
}

struct Entry {
    what: String,
    act: Act,
    robot: Robot,
    change: Change,
}

/// Gains of the paper's law for this robot: as high as is stable on all seeds. The paper gives
/// none.
fn pd_gains(robot: &mut Robot) {
    let heavy = robot
        .winches
        .last()
        .is_some_and(|winch| winch.effective_mass_kg() > 1.0);
    let law = &mut robot.tension;
    (law.kp, law.kd, law.filter_hz) = if heavy {
        (3.0, 0.05, 50.0)
    } else {
        (0.6, 0.0, 80.0)
    };
}

/// Height of the tool for the circle on a platform at z = -100 mm, m.
const CIRCLE_Z_M: f64 = -0.18;

/// Runs the whole table for a light winch (`light`) and a geared one (`geared`).
///
/// # Errors
/// [`RunError`] where a robot cannot be simulated at all; a fault of a run leaves a gap.
pub fn study(light: &Robot, geared: &Robot, seeds: u64) -> Result<Vec<Row>, RunError> {
    let columns = columns();
    let mut rows = Vec::new();
    for entry in entries(light, geared) {
        let mut medians: Vec<Vec<Option<f64>>> = Vec::new();
        let mut ended = Vec::new();
        for column in &columns {
            let mut robot = entry.robot.clone();
            robot.tension.law = column.law;
            if column.law == LawKind::Pd {
                pd_gains(&mut robot);
            }
            let change = Change {
                pulley_loss: entry.change.pulley_loss.max(column.change.pulley_loss),
                ..entry.change
            };
            let runs: Vec<_> = (1..=seeds)
                .into_par_iter()
                .map(|seed| perform(&robot, &change, entry.act, seed))
                .collect();
            ended.push(runs.iter().flatten().count());
            medians.push(median(&runs, figures_of(entry.act).len()));
        }
        for (index, (name, unit, paper)) in figures_of(entry.act).iter().enumerate() {
            rows.push(Row {
                figure: format!("{}: {name}", entry.what),
                paper,
                unit,
                medians: medians
                    .iter()
                    .map(|column| column.get(index).copied().flatten())
                    .collect(),
                ended: ended.clone(),
            });
        }
    }
    Ok(rows)
}

/// Names, units and the paper's figures of an experiment's results.
fn figures_of(act: Act) -> &'static [(&'static str, &'static str, &'static str)] {
    match act {
        Act::Rest => &[("mean error", "N", "0.2"), ("standard deviation", "N", "")],
        Act::Circle => &[
            ("mean absolute error", "N", "0.291"),
            ("greatest error", "N", ""),
        ],
        Act::Pull(_) | Act::Cable(_) => &[
            ("peak error", "N", ""),
            ("50 ms mean back within 0.5 N", "s", "1"),
            ("every ms back within 0.5 N", "s", ""),
            ("least tension of any cable", "N", ""),
            ("standard deviation while swinging", "N", ""),
        ],
        Act::Slack(_) => &[("greatest tension", "N", "")],
    }
}

fn entries(light: &Robot, geared: &Robot) -> Vec<Entry> {
    let mut all = Vec::new();
    let mut add = |what: &str, act, robot: &Robot, change: Change| {
        all.push(Entry {
            what: what.to_owned(),
            act,
            robot: robot.clone(),
            change,
        });
    };
    let exact = Change::default();
    let off = Change {
        sensor_gain: 0.005,
        sensor_zero_n: 0.02,
        ..exact
    };
    add("rest", Act::Rest, light, exact);
    add("circle", Act::Circle, light, exact);
    add(
        "circle, sensor off 0.5 % and 0.02 N",
        Act::Circle,
        light,
        off,
    );
    add(
        "platform pulled 0.6 N (swings 5 mm)",
        Act::Pull(0.6),
        light,
        exact,
    );
    add("platform pulled 2 N", Act::Pull(2.0), light, exact);
    add("platform pulled 5 N", Act::Pull(5.0), light, exact);
    let with = |edit: &dyn Fn(&mut Robot)| {
        let mut robot = light.clone();
        edit(&mut robot);
        robot
    };
    let smooth = with(&|robot| robot.winches.iter_mut().for_each(|w| w.friction_n = 0.1));
    add("pulled 2 N, friction 0.1 N", Act::Pull(2.0), &smooth, exact);
    add("cable pulled 1 N", Act::Cable(1.0), light, exact);
    add("10 mm slack within 0.2 s", Act::Slack(0.01), light, exact);
    for stiffness in [0.5, 2.0] {
        let change = Change { stiffness, ..exact };
        add(
            &format!("pulled 2 N, stiffness x{stiffness}"),
            Act::Pull(2.0),
            light,
            change,
        );
    }
    for mass_kg in [1.0, 2.0] {
        let robot = with(&|robot| {
            let factor = mass_kg / robot.platform.mass_kg;
            robot.platform.mass_kg = mass_kg;
            robot.platform.inertia_kg_m2 *= factor;
        });
        add(
            &format!("pulled 2 N, platform {mass_kg} kg"),
            Act::Pull(2.0),
            &robot,
            exact,
        );
    }
    for drum_kg in [0.05, 0.2] {
        let robot = with(&|robot| {
            if let Some(winch) = robot.winches.last_mut() {
                let inertia = drum_kg * winch.drum_radius_m.powi(2);
                (winch.rotor_inertia_kg_m2, winch.drum_inertia_kg_m2) = (0.0, inertia);
            }
        });
        add(
            &format!("pulled 2 N, drum {drum_kg} kg"),
            Act::Pull(2.0),
            &robot,
            exact,
        );
    }
    for period_us in [4000, 1000] {
        let robot = with(&|robot| {
            robot.bus.tension_period_us = period_us;
            robot.bus.period_us = robot.bus.period_us.max(period_us);
        });
        let hertz = 1_000_000 / period_us;
        add(
            &format!("pulled 2 N, bus {hertz} Hz"),
            Act::Pull(2.0),
            &robot,
            exact,
        );
    }
    add("geared 371:1, rest", Act::Rest, geared, exact);
    add("geared 371:1, circle", Act::Circle, geared, exact);
    add(
        "geared 371:1, platform pulled 2 N",
        Act::Pull(2.0),
        geared,
        exact,
    );
    all
}

/// One run; `None` where a fault ended it.
fn perform(robot: &Robot, change: &Change, act: Act, seed: u64) -> Option<Vec<f64>> {
    let mut bench = Bench::start(robot, change, seed).ok()?;
    // Another direction with every seed, by the golden angle.
    #[expect(clippy::cast_precision_loss, reason = "a small count")]
    let angle = seed as f64 * 2.399_963;
    let pull = |n: f64| [n * angle.cos(), n * angle.sin(), 0.0];
    let (on_s, off_s, end_s) = (0.5, 1.0, 4.0);
    let trace = match act {
        Act::Rest => bench.run(&Script::rest(2.0)),
        Act::Circle => bench.follow(Task::built_in("paper:table7", CIRCLE_Z_M).ok()?),
        Act::Pull(n) => bench.run(&Script::platform_pull(pull(n), on_s, off_s, end_s)),
        Act::Cable(n) => {
            let cable = bench.watched();
            bench.run(&Script::cable_pull(cable, pull(n), on_s, off_s, end_s))
        }
        Act::Slack(m) => {
            let cable = bench.watched();
            bench.run(&Script::slip(cable, m, on_s, on_s + 0.2, end_s))
        }
    }
    .ok()?;
    if trace.fault.is_some() {
        return None;
    }
    Some(match act {
        Act::Rest => {
            let steady = at_rest(&trace, 0.0, 2.0);
            vec![steady.mean_error_n.abs(), steady.sd_n]
        }
        Act::Circle => {
            let steady = at_rest(&trace, 0.0, f64::INFINITY);
            vec![steady.mean_abs_n, steady.max_abs_n]
        }
        Act::Pull(_) | Act::Cable(_) => {
            let back = recovery(&trace, on_s, off_s);
            let swing = at_rest(&trace, 2.0, end_s);
            vec![
                back.peak_n,
                back.mean_back_s,
                back.instant_back_s,
                back.least_n,
                swing.sd_n,
            ]
        }
        Act::Slack(_) => vec![recovery(&trace, on_s + 0.2, end_s).greatest_n],
    })
}

/// Medians figure by figure; none if half of the runs or more ended in a fault.
fn median(runs: &[Option<Vec<f64>>], figures: usize) -> Vec<Option<f64>> {
    let good: Vec<_> = runs.iter().flatten().collect();
    (0..figures)
        .map(|index| {
            let mut values: Vec<f64> = good
                .iter()
                .filter_map(|run| run.get(index))
                .copied()
                .collect();
            values.sort_by(f64::total_cmp);
            // A median over less than half of the runs would show the good machines only.
            (2 * values.len() > runs.len())
                .then(|| values.get(values.len() / 2).copied())
                .flatten()
        })
        .collect()
}
