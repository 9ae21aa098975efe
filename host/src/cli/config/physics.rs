//! Whether a robot file describes a robot that can work: home, tensions, motors, work space.

use super::reserve;
use crate::motion::{Model, PlanOptions, judge_place, rests_on_grid};
use crate::robot::Robot;
use miette::Diagnostic;
use nalgebra::Vector3;
use serde::Serialize;
use thiserror::Error;

/// Places along each axis of the box at which the robot is judged.
const PLACES: u32 = 7;
/// Less than this share of the box within every limit is a problem.
const LEAST_SHARE: f64 = 0.05;
/// A motor that needs more than this share of its current at home has no reserve to accelerate.
const MOST_CURRENT: f64 = 0.7;

/// The judgement.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(super) struct Physics {
    /// Facts, in words.
    pub(super) facts: Vec<String>,
    /// What keeps the robot from working, with the remedy.
    pub(super) problems: Vec<String>,
    /// Share of the tool's box in which it is within every limit.
    pub(super) share: Option<f64>,
    /// Least and greatest tension at home, N.
    pub(super) tension_n: Option<[f64; 2]>,
}

/// The robot cannot work as it is described.
#[derive(Debug, Error, Diagnostic)]
#[error("{name} cannot work as it is described: {}", problems.join("; "))]
#[diagnostic(
    code(mcdpr::config::physics),
    help("change the file, and check it again with `mcdpr config check {name}`")
)]
pub(super) struct Unfit {
    pub(super) name: String,
    pub(super) problems: Vec<String>,
}

/// Judges a robot.
///
/// # Errors
/// Where its geometry or its configuration is refused.
pub(super) fn judge(robot: &Robot) -> miette::Result<Physics> {
    let model = Model::new(robot)?.with_options(PlanOptions::default());
    let mut out = Physics::default();
    let by_tension = model.holding().by_tension().len();
    let count = robot.cables.len();
    out.facts.push(format!(
        "{count} cables: {} held by length, {by_tension} by tension",
        count - by_tension
    ));
    let home_m = robot.tool.home_in_world_m;
    match model.rest_at_home() {
        Err(error) => {
            let [x, y, z] = [home_m.x, home_m.y, home_m.z].map(|v| v * 1e3);
            out.problems.push(format!(
                "it cannot hang at home ({x:.0}, {y:.0}, {z:.0}) mm: {error}; move home_mm, or change the set-point"
            ));
            return Ok(out);
        }
        Ok(rest) => {
            if let Err(error) = judge_place(&model, &home_m, &rest, None) {
                out.problems.push(format!("home: {error}"));
            }
            let tensions = rest.tensions_n();
            let least = tensions.iter().copied().fold(f64::MAX, f64::min);
            let most = tensions.iter().copied().fold(0.0, f64::max);
            out.tension_n = Some([least, most]);
            out.facts.push(format!(
                "home: {least:.1} to {most:.1} N ({:.1} to {:.1} N allowed), tilt {:.1} deg",
                robot.limits.tension_min_n,
                robot.limits.tension_max_n,
                rest.equilibrium.pose.tilt_rad().to_degrees()
            ));
            motors(robot, tensions, &mut out);
        }
    }
    brakes(robot, &mut out);
    space(&model, &mut out);
    if out.problems.is_empty() {
        reserve::judge(&model, &mut out);
    }
    Ok(out)
}

/// Speed and torque of the motors.
fn motors(robot: &Robot, tensions_n: &[f64], out: &mut Physics) {
    let mut worst: Option<(usize, f64)> = None;
    let mut slowest_mps = f64::MAX;
    for (cable, tension_n) in tensions_n.iter().enumerate() {
        let Some(winch) = robot.winch_of(cable) else {
            continue;
        };
        let current_a = winch.driving_force_n(*tension_n) / winch.force_per_current_n_per_a();
        let share = current_a / winch.max_current_a;
        if worst.is_none_or(|(_, most)| share > most) {
            worst = Some((cable, share));
        }
        slowest_mps = slowest_mps.min(winch.max_cable_speed_mps());
    }
    if let Some((cable, share)) = worst {
        out.facts.push(format!(
            "motors: cable {} needs {:.0} % of its current at home; the slowest winch moves {:.0} mm/s",
            cable + 1,
            share * 100.0,
            slowest_mps * 1e3
        ));
        if share > MOST_CURRENT {
            out.problems.push(format!(
                "the motor of cable {} needs {:.0} % of its greatest current only to hold at home: a lighter platform, a higher gear ratio or a stronger motor",
                cable + 1,
                share * 100.0
            ));
        }
    }
    if robot.limits.speed_mps > 3.0 * slowest_mps {
        out.facts.push(format!(
            "the speed limit of {:.0} mm/s is never reached: the slowest winch decides",
            robot.limits.speed_mps * 1e3
        ));
    }
}

/// Brakes that hold less than the tensions which the file allows.
fn brakes(robot: &Robot, out: &mut Physics) {
    let winches = (0..robot.cables.len()).filter_map(|cable| Some((cable, robot.winch_of(cable)?)));
    let weakest = winches.min_by(|a, b| a.1.brake_holding_n.total_cmp(&b.1.brake_holding_n));
    let Some((cable, winch)) = weakest else {
        return;
    };
    let (proven_n, most_n) = (winch.proven_tension_n(), robot.limits.tension_max_n);
    if proven_n < most_n {
        out.facts.push(format!(
            "brakes: that of cable {} holds {:.0} N and passes its test up to {proven_n:.0} N: no plan ends with more, \
             although {most_n:.0} N are allowed; a brake of {:.0} N would do everywhere",
            cable + 1,
            winch.brake_holding_n,
            most_n * winch.brake_holding_n / proven_n
        ));
    }
}

/// Share of the tool's box within every limit.
fn space(model: &Model, out: &mut Physics) {
    let robot = model.robot();
    let [low, high] = robot.limits.box_in_world_m.unwrap_or_else(|| around(robot));
    let fine = rests_on_grid(model, [low, high], PLACES).len();
    let share = fine as f64 / f64::from(PLACES.pow(3));
    out.share = Some(share);
    let given = if robot.limits.box_in_world_m.is_some() {
        "limits.box_mm"
    } else {
        "the space below the anchors"
    };
    out.facts.push(format!(
        "work space: {:.0} % of {given} is within every limit",
        share * 100.0
    ));
    if share < LEAST_SHARE {
        out.problems.push(format!(
            "the work space is nearly empty ({:.0} % of {given}): see `mcdpr workspace` for the cable that limits it",
            share * 100.0
        ));
    }
}

/// Without a box: between the anchors, from home as far down as up.
fn around(robot: &Robot) -> [Vector3<f64>; 2] {
    let mut low = Vector3::repeat(f64::MAX);
    let mut high = Vector3::repeat(f64::MIN);
    for cable in &robot.cables {
        low = low.inf(&cable.anchor_in_world_m);
        high = high.sup(&cable.anchor_in_world_m);
    }
    let middle = (low + high) / 2.0;
    let half = (high - low) * 0.35;
    let home = robot.tool.home_in_world_m;
    let depth = (high.z - home.z).abs().max(half.z);
    [
        Vector3::new(middle.x - half.x, middle.y - half.y, home.z - 0.5 * depth),
        Vector3::new(middle.x + half.x, middle.y + half.y, home.z + 0.5 * depth),
    ]
}

/// Prints facts, problems, and the next step.
pub(super) fn show(judged: &Physics, name: &str) {
    for fact in &judged.facts {
        say!("{fact}");
    }
    for problem in &judged.problems {
        say!("problem: {problem}");
    }
    let quoted = if name.contains(char::is_whitespace) {
        format!("\"{name}\"")
    } else {
        name.to_owned()
    };
    if judged.problems.is_empty() {
        say!("verdict: it can work; next: mcdpr serve --robot {quoted}");
    } else {
        say!(
            "verdict: it cannot work yet; next: change {quoted}, then mcdpr config check {quoted}"
        );
    }
}
