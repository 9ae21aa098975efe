//! Many seeded runs with random faults at random times on random robots, and the invariants that
//! each must keep: those of the project's fault list.

use super::{Aftermath, Injection, Scenario, When};
use crate::experiment::{Experiment, SimulatedRobot};
use crate::machine::Mismatch;
use crate::motion::{Model, Task};
use crate::robot::Robot;
use mcdpr_firmware::State;
use mcdpr_protocol::FaultId;
use mcdpr_twin::faults::survey::re_energises;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::sync::atomic::{AtomicU64, Ordering};

/// The faults, each equally likely.
pub const DRAWN: &[FaultId] = &[
    FaultId::L1,
    FaultId::L3,
    FaultId::L4,
    FaultId::L8,
    FaultId::L9,
    FaultId::L10,
    FaultId::L11,
    FaultId::L16,
    FaultId::L18,
    FaultId::S1,
    FaultId::S2,
    FaultId::S4,
    FaultId::S5,
    FaultId::S6,
    FaultId::S7,
    FaultId::S8,
    FaultId::S9,
    FaultId::S10,
    FaultId::S11,
    FaultId::D1,
    FaultId::D2,
    FaultId::D3,
    FaultId::D5,
    FaultId::D7,
    FaultId::B1,
    FaultId::B2,
    FaultId::B3,
    FaultId::P2,
    FaultId::P7,
    FaultId::C1,
    FaultId::C2,
    FaultId::C3,
    FaultId::C4,
    FaultId::C5,
];

/// Largest drop in a stop with all cables intact, m.
const DROP_M: f64 = 5e-3;
/// Longest time over a cable's limit by 10 %, ms.
const OVER_MS: usize = 5;
/// Longest time that a cable may be slack under torque, ms.
const SLACK_MS: usize = 50;

/// Requirements on a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// All of it: cables intact, brakes in time, drives under control.
    Intact,
    /// The drop bound computed for the robot: control, a brake or a cable is lost.
    Bounded,
    /// The fault itself moves the platform or pulls a cable: only that it ends safely.
    Disturbed,
}

/// Requirements after this fault.
#[must_use]
pub const fn class(fault: FaultId) -> Class {
    match fault {
        FaultId::S5 | FaultId::C1 | FaultId::C2 | FaultId::C4 | FaultId::C5 => Class::Disturbed,
        FaultId::C3
        | FaultId::B1
        | FaultId::B2
        | FaultId::B3
        | FaultId::D1
        | FaultId::P2
        | FaultId::P7 => Class::Bounded,
        _ => Class::Intact,
    }
}

/// Result of a run.
#[derive(Debug, Clone)]
pub struct Verdict {
    /// Its seed.
    pub seed: u64,
    /// The faults that were injected.
    pub injections: Vec<Injection>,
    /// The fault that the board latched first.
    pub noticed: Option<FaultId>,
    /// Ticks from the first injection to its detection.
    pub noticed_after_ms: Option<usize>,
    /// How far the tool fell, m; and the bound for the robot, m.
    pub drop_m: f64,
    /// The bound.
    pub drop_bound_m: f64,
    /// Longest time over a cable's limit by 10 %, ms.
    pub over_ms: usize,
    /// Longest time that an intact cable was slack under torque, ms.
    pub slack_ms: usize,
    /// The broken invariants.
    pub violations: Vec<String>,
}

impl Verdict {
    /// One line with the events and the command to repeat it.
    #[must_use]
    pub fn line(&self) -> String {
        let faults: Vec<_> = self.injections.iter().map(word).collect();
        format!(
            "seed {}: {}: {}; again: cargo xtask study invariants --seed {} --runs 1",
            self.seed,
            faults.join(" "),
            self.violations.join("; "),
            self.seed
        )
    }
}

/// An injection as the command line takes it.
#[must_use]
pub fn word(injection: &Injection) -> String {
    let when = match injection.when {
        When::Start => "start".to_owned(),
        When::Motion(at_s) => format!("{at_s:.3}s"),
        When::After(phase, at_s) => format!("{}+{at_s:.3}s", phase.name()),
    };
    let (id, cable) = (injection.fault.name(), injection.cable + 1);
    format!("{id}:{cable}@{when}")
}

struct Draw(ChaCha8Rng);

impl Draw {
    fn unit(&mut self) -> f64 {
        // One more than the largest: below 1, so that `below` never returns its count.
        f64::from(self.0.next_u32()) / (f64::from(u32::MAX) + 1.0)
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a small count"
    )]
    fn below(&mut self, count: usize) -> usize {
        (self.unit() * count as f64) as usize
    }
}

/// The robot of a seed: the paper's, with different mass, stiffness, brakes, friction and anchors.
fn robot(draw: &mut Draw) -> Option<Robot> {
    let mut robot = Robot::built_in("paper-optimistic").ok()?;
    let scale = draw.between(0.7, 1.5);
    robot.platform.mass_kg *= scale;
    robot.platform.inertia_kg_m2 *= scale;
    for axis in 0..3 {
        robot.platform.center_of_mass_m[axis] += draw.between(-5e-3, 5e-3);
    }
    let ea_n = draw.between(20e3, 80e3);
    let loss = draw.between(0.0, 0.02);
    for cable in &mut robot.cables {
        cable.ea_n = ea_n;
        cable.pulley_loss = loss;
        for axis in 0..3 {
            cable.anchor_in_world_m[axis] += draw.between(-0.01, 0.01);
        }
    }
    let brake_s = draw.between(0.01, 0.03);
    let friction_n = draw.between(0.2, 0.8);
    for winch in &mut robot.winches {
        winch.brake_close_s = brake_s;
        winch.friction_n = friction_n;
    }
    Some(robot)
}

/// A short move from home that the robot can do: the first of up to twenty draws.
fn task(draw: &mut Draw, model: &Model) -> Option<(Task, f64)> {
    let home = model.robot().tool.home_in_world_m * 1e3;
    for _ in 0..20 {
        let to = [
            home.x + draw.between(-50.0, 50.0),
            home.y + draw.between(-50.0, 50.0),
            home.z + draw.between(-40.0, 20.0),
        ];
        let text = format!(
            "start_mm = [{}, {}, {}]\n[[leg]]\nto_mm = [{}, {}, {}]\n",
            home.x, home.y, home.z, to[0], to[1], to[2]
        );
        let Ok(task) = Task::parse(&text, "drawn.toml".into()) else {
            continue;
        };
        if let Ok(plan) = Experiment::new(model, task.clone()).plan() {
            return Some((task, plan.timed.duration_s()));
        }
    }
    None
}

fn injections(draw: &mut Draw, duration_s: f64, cables: usize) -> Vec<Injection> {
    // Every fifth run has two faults.
    let count = if draw.unit() < 0.2 { 2 } else { 1 };
    let drawn = (0..count).map(|_| {
        let fault = DRAWN.get(draw.below(DRAWN.len())).copied();
        let fault = fault.unwrap_or(FaultId::S2);
        let at_start = matches!(fault, FaultId::B1 | FaultId::B2 | FaultId::B3 | FaultId::D5);
        let when = if at_start {
            When::Start
        } else {
            When::Motion(draw.between(0.0, duration_s))
        };
        // Never worse than nominal: 20 mm of slip are enough.
        let strength = draw.between(0.1, 1.0);
        Injection {
            cable: draw.below(cables),
            strength,
            ..Injection::new(fault, when)
        }
    });
    drawn.collect()
}

/// Runs one seed. `None` if no motion was found for its robot.
#[must_use]
pub fn run(seed: u64) -> Option<Verdict> {
    let mut draw = Draw(ChaCha8Rng::seed_from_u64(seed ^ 0x6661_756C));
    let robot = robot(&mut draw)?;
    let model = Model::new(&robot).ok()?;
    let (task, duration_s) = task(&mut draw, &model)?;
    let injections = injections(&mut draw, duration_s, robot.cables.len());
    let scenario = Scenario {
        name: format!("seed {seed}"),
        injections: injections.clone(),
    };
    let mut verdict = Verdict {
        seed,
        injections,
        noticed: None,
        noticed_after_ms: None,
        drop_m: 0.0,
        drop_bound_m: 0.0,
        over_ms: 0,
        slack_ms: 0,
        violations: Vec::new(),
    };
    match super::run(
        &model,
        task,
        &SimulatedRobot::new(Mismatch::realistic(), seed),
        &scenario,
    ) {
        Ok(after) => judge(&mut verdict, &model, &after),
        Err(error) => verdict.violations.push(format!("no run: {error}")),
    }
    Some(verdict)
}

/// Runs these seeds on all processors; verdicts in the order of the seeds, `None` if there was no
/// motion. `seen` is called for each as it is done, in any order.
pub fn run_all(
    seeds: std::ops::Range<u64>,
    seen: impl Fn(u64, Option<&Verdict>) + Sync,
) -> Vec<Option<Verdict>> {
    let next = AtomicU64::new(seeds.start);
    let work = || {
        let mut done = Vec::new();
        loop {
            // Seed by seed: a slow one does not keep the other threads waiting.
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= seeds.end {
                return done;
            }
            let verdict = run(seed);
            seen(seed, verdict.as_ref());
            done.push((seed, verdict));
        }
    };
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let mut all: Vec<_> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        let join = |worker: std::thread::ScopedJoinHandle<'_, _>| match worker.join() {
            Ok(done) => done,
            Err(panic) => std::panic::resume_unwind(panic),
        };
        workers.into_iter().flat_map(join).collect()
    });
    all.sort_unstable_by_key(|(seed, _)| *seed);
    all.into_iter().map(|(_, verdict)| verdict).collect()
}

fn judge(verdict: &mut Verdict, model: &Model, after: &Aftermath) {
    let happened = after.injected_ms.len();
    let faults: Vec<_> = verdict.injections.iter().map(|i| i.fault).collect();
    let worst = |wanted: Class| faults.iter().any(|fault| class(*fault) == wanted);
    verdict.noticed = after.record().map(|record| record.fault);
    verdict.noticed_after_ms = after.detected_after_ms();
    verdict.drop_m = after.drop_m();
    verdict.over_ms = after.over_tension().1;
    // The slack of a drum whose drive does not follow commands, or has none, is not taken up.
    let dead = verdict.injections.iter();
    let dead = dead.filter(|i| matches!(i.fault, FaultId::D2 | FaultId::D7 | FaultId::S4));
    let dead: Vec<_> = dead.map(|i| i.cable).collect();
    let (slack_ms, slack_cable) = after.slack_but(&dead);
    verdict.slack_ms = slack_ms;
    verdict.drop_bound_m = if worst(Class::Bounded) {
        drop_bound_m(model, after, &verdict.injections)
    } else {
        DROP_M
    };
    let mut wrong = Vec::new();
    re_energises(&after.trace, &mut wrong);
    ends_safely(after, &faults, &mut wrong);
    if happened > 0 && !worst(Class::Disturbed) && verdict.drop_m > verdict.drop_bound_m {
        wrong.push(format!(
            "dropped {:.2} mm, bound {:.2} mm",
            verdict.drop_m * 1e3,
            verdict.drop_bound_m * 1e3
        ));
    }
    if happened > 0 && !worst(Class::Disturbed) && !worst(Class::Bounded) {
        if verdict.over_ms > OVER_MS {
            wrong.push(format!("over its limit for {} ms", verdict.over_ms));
        }
        if verdict.slack_ms > SLACK_MS {
            let cable = slack_cable + 1;
            wrong.push(format!("cable {cable} slack for {slack_ms} ms"));
        }
    }
    verdict.violations = wrong;
}

fn ends_safely(after: &Aftermath, faults: &[FaultId], wrong: &mut Vec<String>) {
    // If a brake does not hold, torque stays on intentionally.
    let stands = matches!(after.end(), Some(State::Stopping | State::Holding));
    let kept = faults.contains(&FaultId::B2) && stands;
    if !kept && !after.is_safe() {
        wrong.push(format!("ended unsafely in {:?}", after.end()));
    }
}

/// Greatest possible drop of this robot's tool, m: freely until the brakes hold; and if a cable has
/// broken, until one of the others is stretched straight down from its anchor, with the platform in
/// any attitude.
#[must_use]
pub fn drop_bound_m(model: &Model, after: &Aftermath, injections: &[Injection]) -> f64 {
    let robot = model.robot();
    let slowest_s = robot.winches.iter().map(|winch| winch.brake_close_s);
    let late_s = injections.iter().filter(|i| i.fault == FaultId::B3);
    let late_s = late_s.map(|i| 0.3 * i.strength).fold(0.0, f64::max);
    // Ten ticks for detection, and the brakes.
    let falls_s = 0.01 + slowest_s.fold(0.0, f64::max) + late_s;
    // v t + g t^2 / 2: 40 ms from 0.1 m/s are 12 mm.
    let free_m =
        robot.limits.speed_mps * falls_s + 0.5 * mcdpr_kinematics::GRAVITY_MPS2 * falls_s * falls_s;
    let lost: Vec<_> = injections
        .iter()
        .filter(|i| matches!(i.fault, FaultId::C3 | FaultId::B2))
        .map(|i| i.cable)
        .collect();
    if lost.is_empty() {
        return DROP_M + free_m;
    }
    let Some(start) = after.after().first() else {
        return DROP_M + free_m;
    };
    let tool_m = robot.tool.tcp_in_platform_m;
    let hangs = robot.cables.iter().enumerate();
    let hangs = hangs.filter(|(index, _)| !lost.contains(index));
    let falls = hangs.filter_map(|(index, cable)| {
        let length_m = start.truth.cable_lengths_m.get(index)?;
        let attachment = cable.attachment_in_platform_m.into();
        let from_m = start.truth.pose.point_in_world(attachment)[2];
        // The cable straight down from its anchor.
        let lowest_m = cable.anchor_in_world_m.z - length_m;
        let arm_m = (tool_m - cable.attachment_in_platform_m).norm();
        // The tool may be above its attachment before and below it after: twice the arm.
        Some(from_m - lowest_m + 2.0 * arm_m)
    });
    // Drums are braked and cables stretch: a tenth more.
    DROP_M + free_m + 1.1 * falls.fold(f64::INFINITY, f64::min)
}
