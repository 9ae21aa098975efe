//! Machines for learning: many plants in lockstep, moved by velocities of the tool or by tensions, without a
//! board between.

use crate::failure::Failure;
use crate::robot::Robot;
use crate::rows::{Table, array};
use crate::session::mismatch_of;
use mcdpr::compute::Subject;
use mcdpr::machine::{Mismatch, hang, plant_params};
use mcdpr_core::machine::paid_out_m;
use mcdpr_simulator::plant::{DriveCommand, Mode, Plant, PlantError};
use nalgebra::Vector3;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use std::f64::consts::TAU;

/// How often drives get set-points, s.
const TICK_S: f64 = 1e-3;
/// Integration step, s, where the robot's own is shorter: at a hundred times real time, not ten digits.
const STEP_S: f64 = 2.5e-4;
/// Drives are awake and in their mode when an episode begins.
const READY_S: f64 = 2e-3;
/// Columns of an observation beside those of the cables: tool, attitude, velocity, angular velocity, and
/// the way from tool to target at its end.
const COMMON: usize = 15;
/// A cable over this share of its limit is torn.
const TORN: f64 = 1.5;
/// Reward of a step that loses the robot.
const LOST: f64 = -10.0;

/// State of the machines after a step: observations (m, 15 + 2 n), rewards (m,), which are lost (m,), which
/// are at their target (m,), the planned places of the tools (m, 3).
type Seen = (
    Py<PyArray2<f32>>,
    Py<PyArray1<f64>>,
    Py<PyArray1<bool>>,
    Py<PyArray1<bool>>,
    Py<PyArray2<f64>>,
);

/// What the numbers of an action are.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Acts {
    /// Velocity of the tool, world, m/s.
    Velocity,
    /// Pull of each winch's motor at its cable, N.
    Tensions,
}

/// A winch as a command sees it.
struct Drum {
    metres_per_count: f64,
    newtons_per_ampere: f64,
    rpm_max: u16,
}

/// One machine under way.
struct Machine {
    plant: Plant,
    drums: Vec<Drum>,
    /// Where the tool is meant to be.
    tool_m: Vector3<f64>,
    /// Target of the tool, world, m.
    goal_m: Vector3<f64>,
    /// Paid out since the start, as last commanded, m.
    target_m: Vec<f64>,
    /// What the drums had paid out at the start, by the description, m.
    start_m: Vec<f64>,
    /// Why this machine has ended.
    ended: Option<PlantError>,
}

/// Simulated machines of one robot, each off its description in its own way.
#[pyclass(name = "Machines", module = "mcdpr._mcdpr")]
pub(crate) struct Machines {
    subject: Subject,
    tensions_n: Vec<Option<f64>>,
    mismatch: Mismatch,
    acts: Acts,
    /// Least and greatest number of an action; others are cut to them.
    within: (f64, f64),
    /// Distance from the target that costs one of reward, m.
    reach_m: f64,
    /// Nearer than this to its target a tool is there, m.
    at_target_m: f64,
    machines: Vec<Option<Machine>>,
}

#[pymethods]
impl Machines {
    #[new]
    fn new(
        robot: &Robot,
        count: usize,
        action: &str,
        mismatch: &str,
        within: (f64, f64),
        reach_m: f64,
        at_target_m: f64,
    ) -> PyResult<Self> {
        let acts = match action {
            "velocity" => Acts::Velocity,
            "tensions" => Acts::Tensions,
            other => {
                let words = format!("action: \"{other}\"; it is \"velocity\" or \"tensions\"");
                return Err(Failure::input(words).into());
            }
        };
        let subject = robot.subject.clone();
        Ok(Self {
            tensions_n: subject.own_tensions().to_vec(),
            mismatch: mismatch_of(mismatch)?,
            subject,
            acts,
            within,
            reach_m,
            at_target_m,
            machines: (0..count).map(|_| None).collect(),
        })
    }

    /// Lays out machine `index` anew, drawn by `seed`, at rest with the tool at a place, and with a
    /// target.
    fn reset(
        &mut self,
        py: Python<'_>,
        index: usize,
        seed: u64,
        tool_m: [f64; 3],
        goal_m: [f64; 3],
    ) -> PyResult<()> {
        let mut made = py.detach(|| self.machine(seed, Vector3::from(tool_m)))?;
        made.goal_m = Vector3::from(goal_m);
        let slot = self.machines.get_mut(index);
        *slot.ok_or_else(|| Failure::input(format!("there is no machine {index}")))? = Some(made);
        Ok(())
    }

    /// Lets `seconds` pass under actions (m, 3 or n).
    fn step(
        &mut self,
        py: Python<'_>,
        actions: PyReadonlyArray2<'_, f64>,
        seconds: f64,
    ) -> PyResult<()> {
        let width = match self.acts {
            Acts::Velocity => 3,
            Acts::Tensions => self.subject.count(),
        };
        let mut actions = Table::of("action", &actions, width)?;
        let (least, most) = self.within;
        for (index, value) in actions.values_mut().enumerate() {
            if !value.is_finite() {
                let shown = if value.is_nan() { "nan" } else { "infinite" };
                let words = format!("action[{}] is {shown}: it must be finite", index % width);
                return Err(Failure::input(words).into());
            }
            *value = value.clamp(least, most);
        }
        py.detach(|| {
            let Self {
                subject,
                tensions_n,
                acts,
                machines,
                ..
            } = self;
            for (index, machine) in machines.iter_mut().enumerate() {
                if let Some(machine) = machine {
                    machine.act(subject, tensions_n, *acts, actions.row(index), seconds);
                }
            }
        });
        Ok(())
    }

    /// What the machines look like now.
    fn seen(&self, py: Python<'_>) -> PyResult<Seen> {
        let cables = self.subject.count();
        let [low, high] = self.subject.robot.search_box_in_world_m();
        let torn_n = TORN * self.subject.robot.limits.tension_max_n;
        let width = COMMON + 2 * cables;
        let count = self.machines.len();
        let mut rows = Vec::with_capacity(width * count);
        let mut planned = Vec::with_capacity(3 * count);
        let (mut rewards, mut lost, mut there) = (vec![0.0; count], vec![true; count], Vec::new());
        let verdicts = rewards.iter_mut().zip(&mut lost);
        for (machine, (reward, lost)) in self.machines.iter().zip(verdicts) {
            let Some(machine) = machine else {
                let words = "a machine that was never reset";
                return Err(Failure::input(words).into());
            };
            planned.extend(machine.tool_m.iter());
            let Ok(truth) = machine.plant.truth() else {
                rows.extend(std::iter::repeat_n(0.0, width));
                *reward = LOST;
                there.push(false);
                continue;
            };
            let left_m = machine.goal_m - Vector3::from(truth.tool_position_m);
            let tensions = || truth.tensions_winch_n.iter().take(cables);
            let mut column =
                |values: &[f64]| rows.extend(values.iter().map(|value| single(*value)));
            column(&truth.tool_position_m);
            column(&rpy(truth.pose.rotation_wxyz));
            column(&truth.velocity_mps);
            column(&truth.angular_velocity_rad_s);
            column(truth.tensions_winch_n.get(..cables).unwrap_or_default());
            column(truth.drum_positions_m.get(..cables).unwrap_or_default());
            column(left_m.as_slice());
            let inside = (0..3).all(|k| (low[k]..=high[k]).contains(&truth.tool_position_m[k]));
            *lost = machine.ended.is_some() || !inside || tensions().any(|n| *n > torn_n);
            let away_m = left_m.norm();
            let near = !*lost && away_m < self.at_target_m;
            there.push(near);
            *reward = match (*lost, near) {
                (true, _) => LOST,
                (false, true) => 1.0 - away_m / self.reach_m,
                (false, false) => -away_m / self.reach_m,
            };
        }
        let seen = PyArray1::from_vec(py, rows).reshape([count, width])?;
        Ok((
            seen.unbind(),
            PyArray1::from_vec(py, rewards).unbind(),
            PyArray1::from_vec(py, lost).unbind(),
            PyArray1::from_vec(py, there).unbind(),
            array(py, planned, 3)?,
        ))
    }
}

impl Machines {
    fn machine(&self, seed: u64, tool_m: Vector3<f64>) -> Result<Machine, Failure> {
        let robot = &self.subject.robot;
        let (rest, _) = self.subject.hang(&tool_m, true, &self.tensions_n, None)?;
        let mut params = plant_params(robot, &self.mismatch, seed);
        params.step_s = params.step_s.max(STEP_S);
        for winch in &mut params.winches {
            winch.drive.reset_time_s = READY_S;
            winch.drive.mode_time_s = READY_S;
        }
        let drums = params.winches.iter().map(|winch| Drum {
            metres_per_count: f64::from(winch.motor_sign) * TAU * winch.drum_radius_m
                / winch.motor_counts_per_drum_turn,
            newtons_per_ampere: f64::from(winch.motor_sign) * winch.force_per_ampere_n(),
            rpm_max: whole(winch.max_motor_rpm.min(f64::from(u16::MAX))),
        });
        let drums: Vec<Drum> = drums.collect();
        let held = self.tensions_n.iter().position(Option::is_some);
        let failed = |error: PlantError| Failure::new("RunError", error.to_string());
        let mut plant =
            hang(params, &rest.pose, &rest.tensions_n, held.as_slice(), seed).map_err(failed)?;
        let mode = match self.acts {
            Acts::Velocity => Mode::Position,
            Acts::Tensions => Mode::Current,
        };
        for cable in 0..drums.len() {
            plant.command(cable, DriveCommand::Reset).map_err(failed)?;
        }
        plant.advance(10.0 * READY_S).map_err(failed)?;
        for cable in 0..drums.len() {
            let select = DriveCommand::SelectMode(mode);
            plant.command(cable, select).map_err(failed)?;
        }
        plant.advance(10.0 * READY_S).map_err(failed)?;
        let start_m = paid_out(&self.subject, &rest);
        let mut machine = Machine {
            plant,
            target_m: vec![0.0; drums.len()],
            drums,
            tool_m,
            goal_m: tool_m,
            start_m,
            ended: None,
        };
        // What carries the platform now, then the brakes open.
        match self.acts {
            Acts::Velocity => machine.go(&vec![0.0; machine.drums.len()]),
            Acts::Tensions => machine.pull(&rest.tensions_n),
        }
        .map_err(failed)?;
        machine.plant.advance(10.0 * TICK_S).map_err(failed)?;
        for cable in 0..machine.drums.len() {
            let opened = machine.plant.set_brake(cable, false);
            opened.map_err(failed)?;
        }
        machine.plant.advance(0.1).map_err(failed)?;
        Ok(machine)
    }
}

impl Machine {
    /// Lets time pass under an action. A machine that has ended stays as it is.
    fn act(
        &mut self,
        subject: &Subject,
        tensions_n: &[Option<f64>],
        acts: Acts,
        action: &[f64],
        seconds: f64,
    ) {
        if self.ended.is_some() {
            return;
        }
        let done = match acts {
            Acts::Velocity => self.travel(subject, tensions_n, action, seconds),
            Acts::Tensions => self.pull(action).and_then(|()| self.plant.advance(seconds)),
        };
        self.ended = done.err();
    }

    /// The tool travels at a velocity, as far as the robot can hang there within its limits; else it stays.
    fn travel(
        &mut self,
        subject: &Subject,
        tensions_n: &[Option<f64>],
        velocity_mps: &[f64],
        seconds: f64,
    ) -> Result<(), PlantError> {
        let step_m = Vector3::from_iterator(velocity_mps.iter().map(|speed| speed * seconds));
        let to_m = self.tool_m + step_m;
        let mut goal_m = self.target_m.clone();
        let limits = &subject.robot.limits;
        if let Ok((rest, stability)) = subject.hang(&to_m, true, tensions_n, None) {
            let within =
                |tension: &f64| (limits.tension_min_n..=limits.tension_max_n).contains(tension);
            let [low, high] = subject.robot.search_box_in_world_m();
            let inside = (0..3).all(|k| (low[k]..=high[k]).contains(&to_m[k]));
            if stability.stable && inside && rest.tensions_n.iter().all(within) {
                let paid_out = paid_out(subject, &rest);
                goal_m = paid_out
                    .iter()
                    .zip(&self.start_m)
                    .map(|(now, start)| now - start)
                    .collect();
                self.tool_m = to_m;
            }
        }
        let from_m = std::mem::replace(&mut self.target_m, goal_m.clone());
        let ticks = (seconds / TICK_S).round().max(1.0);
        let mut tick = 1.0;
        while tick <= ticks {
            let share = tick / ticks;
            let now_m = from_m.iter().zip(&goal_m);
            let now_m: Vec<f64> = now_m.map(|(a, b)| a + (b - a) * share).collect();
            self.go(&now_m)?;
            self.plant.advance(seconds / ticks)?;
            tick += 1.0;
        }
        Ok(())
    }

    /// Every drum to what it shall have paid out since the start, m.
    fn go(&mut self, paid_out_m: &[f64]) -> Result<(), PlantError> {
        for (cable, (drum, target)) in self.drums.iter().zip(paid_out_m).enumerate() {
            let command = DriveCommand::Position {
                counts: counts(target / drum.metres_per_count),
                rpm_limit: drum.rpm_max,
            };
            self.plant.command(cable, command)?;
        }
        Ok(())
    }

    /// Every motor pulls at its cable, N.
    fn pull(&mut self, tensions_n: &[f64]) -> Result<(), PlantError> {
        for (cable, (drum, tension)) in self.drums.iter().zip(tensions_n).enumerate() {
            let milliamps = current(-tension / drum.newtons_per_ampere * 1e3);
            let command = DriveCommand::Current { milliamps };
            self.plant.command(cable, command)?;
        }
        Ok(())
    }
}

/// What the drums have paid out at an equilibrium, m.
fn paid_out(subject: &Subject, rest: &mcdpr_kinematics::Equilibrium) -> Vec<f64> {
    let pairs = rest.lengths_m.iter().zip(&rest.tensions_n).enumerate();
    pairs
        .map(|(cable, (length, tension))| paid_out_m(&subject.robot, cable, *length, *tension))
        .collect()
}

/// Roll, pitch, yaw of a quaternion, rad.
fn rpy([w, x, y, z]: [f64; 4]) -> [f64; 3] {
    let rotation = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
    let (roll, pitch, yaw) = rotation.euler_angles();
    [roll, pitch, yaw]
}

/// As an observation has it: what is not a number is 0.
#[expect(clippy::cast_possible_truncation, reason = "rounds")]
fn single(value: f64) -> f32 {
    if value.is_nan() {
        return 0.0;
    }
    value.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32
}

// `as` saturates: a drive's own limits are far inside.
#[expect(clippy::cast_possible_truncation, reason = "saturates")]
fn counts(value: f64) -> i64 {
    value.round() as i64
}

#[expect(clippy::cast_possible_truncation, reason = "saturates")]
fn current(milliamps: f64) -> i16 {
    milliamps.round() as i16
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "saturates"
)]
fn whole(value: f64) -> u16 {
    value as u16
}
