//! From files to a judged plan: any robot with any task gives a plan or an error in words, in bounded
//! time and memory.

use super::mutate::{Rng, mistake};
use mcdpr::experiment::SimulatedRobot;
use mcdpr::machine::{self, Mismatch};
use mcdpr::motion::{
    Extremes, Model, Plan, PlanOptions, Planner, Shaping, Task, TaskError, Tensioning, Watch,
};
use mcdpr::robot::{BUILT_IN, BuiltInModules, Robot};
use mcdpr_simulator::LinkOptions;
use std::path::PathBuf;

/// The outcome for an input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Came {
    /// The robot file was refused.
    NoRobot,
    /// The robot cannot be planned for.
    NoModel,
    /// The task was refused.
    NoTask,
    /// There is no plan.
    NoPlan,
    /// The plan breaks a limit.
    Judged,
    /// There is a plan with its knots.
    Planned,
}

impl Came {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::NoRobot,
        Self::NoModel,
        Self::NoTask,
        Self::NoPlan,
        Self::Judged,
        Self::Planned,
    ];
}

/// A robot, a task for it, and how to plan.
#[derive(Debug, Clone)]
pub struct Input {
    /// Text of the robot file.
    pub robot: String,
    /// Text of the task.
    pub task: String,
    /// Whether the task is G-code.
    pub is_gcode: bool,
    /// How to plan.
    pub options: PlanOptions,
    /// Whether the robot is simulated as well.
    pub simulate: bool,
}

/// Tasks to begin with, around the home of the paper's robot.
const TASKS: [&str; 3] = [
    "name = \"a\"\nstart_mm = [335, 0, -160]\nspeed_mm_s = 40\n[[leg]]\nto_mm = [345, -10, -165]\n\
     duration_s = 3.5\n[[leg]]\ncircle_center_mm = [335, -10, -165]\nsweep_deg = -90\n[[leg]]\n\
     dwell_s = 1.5\n[[leg]]\ngripper = \"close\"\n",
    "start_mm = [335, 0, -160]\n[[leg]]\npoints_mm = [[340, 2, -160], [335, 9, -160]]\n[[leg]]\n\
     through_mm = [[340, 0, -160], [345, 8, -162], [350, 3, -160]]\n[[leg]]\nto_mm = [335, 0, -160]\n",
    "start_mm = [335, 0, -160]\n[[leg]]\nto_mm = [335, 0, -220]\nspeed_mm_s = 15\n",
];

/// Programs to begin with.
const PROGRAMS: [&str; 2] = [
    "G21 G90 G17\nG0 X335 Y0 Z-160\nF1200 G1 X345 (there)\nG2 X355 Y10 I10 J0\nM3 ; close\n\
     G4 P0.5\nG91\nG1 X-5 Y2 Z-1\nM5\nM2\n",
    "G0 X335 Y0 Z-160\nG1 Y20 F900\nG1 X315\nG1 Y0\nG1 X335\n",
];

/// What a number of a task is exchanged for, besides what all texts get.
const NUMBERS: [&str; 24] = [
    "1e3",
    "1e5",
    "-1e5",
    "1e9",
    "-1e9",
    "1e15",
    "-1e300",
    "1e-9",
    "1e-300",
    "3600",
    "7200",
    "1e6",
    "100000",
    "-99999",
    "99999999999999",
    "0.001",
    "0.0000001",
    "335",
    "-160",
    "-700",
    "45",
    "44.9",
    "720",
    "36000",
];

/// The input of a seed: mostly a good robot with an odd task, also odd robots with good tasks.
#[must_use]
pub fn draw(rng: &mut Rng) -> Input {
    let robots: Vec<&str> = BUILT_IN.iter().map(|(_, text)| *text).collect();
    let mut robot = pick(rng, &robots).to_owned();
    let is_gcode = rng.below(3) == 0;
    let tasks: &[&str] = if is_gcode { &PROGRAMS } else { &TASKS };
    let mut task = pick(rng, tasks).to_owned();
    match rng.below(4) {
        0 => robot = odd(rng, &robot),
        1 => {
            robot = odd(rng, &robot);
            task = odd(rng, &task);
        }
        _ => task = odd(rng, &task),
    }
    let options = PlanOptions {
        planner: [Planner::Equilibrium, Planner::Level][usize::from(rng.below(8) == 0)],
        tensioning: [Tensioning::MaxMin, Tensioning::Setpoint][usize::from(rng.below(4) == 0)],
        shaping: [Shaping::None, Shaping::Zv, Shaping::Zvd][rng.below(3)],
    };
    Input {
        robot,
        task,
        is_gcode,
        options,
        simulate: rng.below(16) == 0,
    }
}

fn pick<'a>(rng: &mut Rng, texts: &[&'a str]) -> &'a str {
    texts.get(rng.below(texts.len())).copied().unwrap_or("")
}

/// A text with other numbers in up to four places, or with any mistake.
fn odd(rng: &mut Rng, text: &str) -> String {
    if rng.below(3) == 0 {
        return mistake(rng, text);
    }
    let mut text = text.to_owned();
    for _ in 0..=rng.below(4) {
        text = other_number(rng, &text);
    }
    text
}

/// The text with one of its numbers exchanged or scaled.
fn other_number(rng: &mut Rng, text: &str) -> String {
    let is_part = |c: char| c.is_ascii_digit() || matches!(c, '.' | '-');
    let starts: Vec<usize> = text
        .char_indices()
        .zip(text.chars().skip(1))
        .filter(|((_, before), after)| !is_part(*before) && is_part(*after))
        .map(|((at, before), _)| at + before.len_utf8())
        .collect();
    let Some(&at) = starts.get(rng.below(starts.len())) else {
        return text.to_owned();
    };
    let (head, tail) = text.split_at(at);
    let length = tail.find(|c| !is_part(c)).unwrap_or(tail.len());
    let (number, rest) = tail.split_at(length);
    let new = match (rng.below(3), number.parse::<f64>()) {
        (0, Ok(value)) => {
            let scale = [1e-3, 0.1, 0.5, -1.0, 1.1, 2.0, 10.0, 1e3];
            format!("{}", value * scale[rng.below(scale.len())])
        }
        _ => pick(rng, &NUMBERS).to_owned(),
    };
    format!("{head}{new}{rest}")
}

/// Plans an input from the robot's home as far as it goes.
///
/// # Panics
/// Where a rule is broken: a panic of the planner, or a refusal without words.
#[must_use]
pub fn plan(input: &Input) -> Came {
    let robot = match Robot::parse(&input.robot, "robots/robot.toml", &BuiltInModules) {
        Ok(robot) => robot,
        Err(error) => return refused(&error, Came::NoRobot),
    };
    let model = match Model::new(&robot) {
        Ok(model) => model.with_options(input.options),
        Err(error) => return refused(&error, Came::NoModel),
    };
    if let Err(error) = machine::configuration(&robot) {
        let _ = refused(&error, Came::NoModel);
    }
    if input.simulate {
        let (mismatch, options) = (Mismatch::realistic(), LinkOptions::default());
        match SimulatedRobot::new(mismatch, 1)
            .line(options)
            .at_home(&model)
        {
            Ok(link) => link.with(|simulation| assert!(simulation.now_us() < 60_000_000)),
            Err(error) => {
                let _ = refused(&error, Came::NoModel);
            }
        }
    }
    let any = |kind: &str| PathBuf::from(format!("any.{kind}"));
    let task = if input.is_gcode {
        Task::parse_gcode(&input.task, any("gcode"))
    } else {
        Task::parse(&input.task, any("toml"))
    };
    let home_m = robot.tool.home_in_world_m;
    let task = task.and_then(|task| task.approached_from(&home_m, None));
    let task = match task {
        Ok(task) => task,
        Err(error) => return refused::<TaskError>(&error, Came::NoTask),
    };
    let plan = match Plan::unjudged(&model, &home_m, &task.steps) {
        Ok(plan) => plan,
        Err(error) => return refused(&error, Came::NoPlan),
    };
    let seen = plan.extremes(&Watch::default());
    let broken = match &seen {
        Ok(seen) => {
            assert_margins(seen);
            seen.broken.is_some()
        }
        Err(error) => return refused(error, Came::Judged),
    };
    match plan.judged() {
        Ok(plan) => {
            assert!(!broken, "judged in two ways");
            assert!(plan.knots.last().is_some_and(|knot| knot.last));
            Came::Planned
        }
        Err(error) => refused(&error, Came::Judged),
    }
}

/// The listed margins and the verdict are of the same limits: a margin is used up exactly where a limit
/// that has one is broken.
fn assert_margins(seen: &Extremes) {
    // The verdict allows a cable's speed a millionth.
    let used_up = seen
        .margins
        .iter()
        .find(|margin| margin.left_percent < -1e-3);
    match &seen.broken {
        None => assert!(used_up.is_none(), "allowed, and {used_up:?}"),
        Some(said) => {
            let has_no_margin = ["stability", "from the platform"];
            let exempt = has_no_margin.iter().any(|what| said.contains(what));
            assert!(exempt || used_up.is_some(), "no margin is used up: {said}");
        }
    }
}

/// A refusal must say something.
fn refused<E: std::fmt::Display>(error: &E, came: Came) -> Came {
    assert!(!error.to_string().is_empty());
    came
}
