//! A day's slow changes, tracked while the robot works: cable lengths, creep, sensors, payload, anchors.
//!
//! A Kalman filter over states that change slowly. It is fed where the robot rests anyway, with lengths,
//! tensions and, if the camera sees any, tags. Pose and true tensions of each rest are removed first, so
//! the filter needs no model of motion. Between rests each state drifts as far as its own random walk,
//! and creep follows a model with two retardation times (Piao et al., 2017) whose size and times are states.
//! What nothing observes keeps its uncertainty. Rests that do not fit are not used: see [`Report`].

mod camera;
mod creep;
mod errors;
mod estimates;
mod gaussian;
mod hang;
mod hint;
mod home;
mod judge;
mod kept;
mod knock;
mod layout;
mod lines;
mod payload;
mod plans;
mod prior;
mod pulleys;
mod recent;
mod report;
mod rows;
mod statics;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod update_tests;

use super::Measurements;
use crate::motion::Model;
use crate::robot::Robot;
use creep::{CREEP_SHARES, Creeping};
pub use estimates::{CableEstimate, Estimates, Known};
use gaussian::{Fit, Gaussian};
use hint::Hint;
use judge::Reading;
pub use kept::{Kept, KeptError};
pub use knock::{Moved, Named};
use layout::Layout;
use mcdpr_kinematics::Pose;
use nalgebra::Matrix3;
pub use prior::Prior;
pub use pulleys::{Pulleys, Rubbing};
use recent::{Event, Recent};
pub use report::{Load, Region, Report};
pub use rows::RowSigmas;
use rows::{Hanging, Rest};
use std::collections::VecDeque;

/// Rests are doubted beyond this many standard deviations of a normal distribution: 1e-9 of them.
const DOUBT_SIGMAS: f64 = 6.0;
/// A rest is linearised again at the new states this often: a payload is unknown before.
const ROUNDS: usize = 6;
/// The search for the pose takes a payload's moment to be known at least this well, kg m.
const LOOSEST_KG_M: f64 = 5e-3;

const EIGHT_HOURS_S: f64 = 28_800.0;

/// What a rest makes of the states.
struct Taken {
    states: Gaussian,
    fit: Fit,
    /// Of each anchor, and of the camera.
    hints: Vec<Hint>,
}

/// The tracked state of a robot.
#[derive(Debug, Clone)]
pub struct Tracker {
    robot: Robot,
    layout: Layout,
    prior: Prior,
    /// How the offsets of lengths that were taken at home follow other states.
    at_home: Option<Vec<home::Follows>>,
    now: Gaussian,
    /// The states that plans use: they follow in small steps.
    planned: Vec<f64>,
    loaded: bool,
    /// The last rests, which are judged together.
    recent: VecDeque<Recent>,
}

impl Tracker {
    /// A tracker that starts from a robot as its file, or its calibration, describes it.
    #[must_use]
    pub fn new(model: &Model, prior: &Prior) -> Self {
        let robot = model.robot().clone();
        let layout = Layout {
            cables: robot.cables.len(),
        };
        let mut sigmas = vec![0.0; layout.size()];
        let mut mean = sigmas.clone();
        let mut put = |state: usize, value: f64, sigma: f64| {
            sigmas[state] = sigma;
            mean[state] = value;
        };
        for (i, cable) in robot.cables.iter().enumerate() {
            put(layout.offset(i), 0.0, prior.length_m);
            put(layout.zero(i), 0.0, prior.zero_n);
            put(layout.gain(i), 0.0, prior.gain);
            put(layout.compliance(i), 0.0, prior.compliance);
            put(layout.loss(i), prior.loss[0], prior.loss[1]);
            for axis in 0..3 {
                put(layout.anchor(i) + axis, 0.0, prior.anchor_m);
            }
            let per_strain = cable.ea_n / robot.tension.setpoint_n;
            for (element, share) in CREEP_SHARES.into_iter().enumerate() {
                let [value, sigma] = prior.creep.map(|strain| share * strain * per_strain);
                put(layout.creep_ratio(i, element), value, sigma);
                put(layout.creep_time(i, element), 0.0, prior.creep_time);
            }
        }
        let mass_kg = robot.platform.mass_kg;
        put(layout.platform(), 0.0, prior.mass * mass_kg);
        for axis in 0..3 {
            let moment = prior.center_m * mass_kg;
            put(layout.platform() + 1 + axis, 0.0, moment);
            put(layout.camera() + axis, 0.0, prior.camera[0]);
            put(layout.camera() + 3 + axis, 0.0, prior.camera[1]);
        }
        let mut now = Gaussian::new(mean.clone(), &sigmas);
        now.creeping = vec![Creeping::default(); layout.cables];
        // Cables of the same stiffness count as one rope: what creeps are two elements of each.
        let rope = |i: usize| robot.cables.get(i).map(|cable| cable.ea_n);
        let elements = (0..layout.cables).flat_map(|i| [(i, 0), (i, 1)]);
        let elements: Vec<(usize, usize)> = elements.collect();
        for (k, (i, one)) in elements.iter().enumerate() {
            for (j, other) in elements
                .iter()
                .skip(k + 1)
                .filter(|(j, _)| rope(*i) == rope(*j))
            {
                let ratios = [layout.creep_ratio(*i, *one), layout.creep_ratio(*j, *other)];
                now.tie(ratios, prior.creep_alike);
            }
        }
        let at_home = prior.homed.then(|| home::slopes(model, layout));
        for (from, to, slope) in at_home.iter().flatten() {
            now.couple(*from, *to, *slope);
        }
        Self {
            planned: mean,
            now,
            robot,
            layout,
            prior: *prior,
            at_home,
            loaded: false,
            recent: VecDeque::new(),
        }
    }

    /// Lets time pass: cables creep under `tensions_n` (at the platform, mean of that time, N), and
    /// everything drifts.
    pub fn pass(&mut self, seconds: f64, tensions_n: &[f64]) {
        self.happened(|| Event::Passed(seconds, tensions_n.to_vec()));
        let layout = self.layout;
        let share = seconds / EIGHT_HOURS_S;
        let length = self.prior.drift_m.powi(2) * share;
        let zero = self.prior.drift_n.powi(2) * share;
        for (i, tension_n) in tensions_n.iter().enumerate().take(layout.cables) {
            let Some(cable) = self.robot.cables.get(i) else {
                continue;
            };
            if let Some(creeping) = self.now.creeping.get_mut(i) {
                creeping.pass(seconds, tension_n / cable.ea_n);
            }
            self.now.loosen(layout.offset(i), length);
            self.now.loosen(layout.zero(i), zero);
            for axis in 0..3 {
                self.now.loosen(layout.anchor(i) + axis, length);
            }
        }
    }

    /// The states after a rest, if they were `before` it.
    fn taken(&self, before: &Gaussian, reading: &Reading) -> Option<Taken> {
        let rest = Rest {
            robot: &self.robot,
            sigmas: &self.prior.rows,
            measured: &reading.measured,
            rubbing: &reading.rubbing,
            creeping: &before.creeping,
            every_tension: true,
        };
        let mut hanging = Hanging {
            pose: reading.near,
            tensions_n: reading.measured.tensions_n.clone(),
        };
        let mut at = before.mean.clone();
        let mut result = None;
        let mut loose: Vec<f64> = (0..before.size()).map(|k| before.variance(k)).collect();
        for axis in 0..3 {
            // A new payload's moment is nearly unknown, but without the balance of moments three or four
            // lengths alone do not hold the pose.
            let state = self.layout.payload() + 1 + axis;
            loose[state] = loose[state].min(LOOSEST_KG_M * LOOSEST_KG_M);
        }
        let tight = vec![0.0; before.size()];
        for round in 0..ROUNDS {
            let weights = if round == 0 { &loose } else { &tight };
            hanging = rest.hang(&at, &hanging, weights)?;
            let linear = rest.linear(&at, &hanging)?;
            let lesson = before.learn(&linear)?;
            // Two rounds are enough where no state moves far.
            let moved = self.shift(&at, &lesson.mean);
            at.clone_from(&lesson.mean);
            result = Some((lesson, linear));
            if moved < 0.05 {
                break;
            }
        }
        let (lesson, linear) = result?;
        let anchors = (0..self.layout.cables).map(|i| self.layout.anchor(i));
        let movable: Vec<usize> = anchors.chain([self.layout.camera()]).collect();
        Some(Taken {
            fit: lesson.fit,
            hints: linear.hints(&lesson, &movable),
            states: before.taught(lesson),
        })
    }

    /// How far states moved, in the units of nonlinearity: mm of an anchor, 20 g of a payload.
    fn shift(&self, from: &[f64], to: &[f64]) -> f64 {
        let by = |k: usize| (to[k] - from[k]).abs();
        let mut most = by(self.layout.payload()) / 0.02;
        for i in 0..self.layout.cables {
            for k in 0..3 {
                most = most.max(by(self.layout.anchor(i) + k) / 1e-3);
            }
            most = most.max(by(self.layout.offset(i)) / 1e-3);
        }
        most
    }

    /// Where the tool is, or will be, under these lengths and tensions of the tension-held cables; those
    /// of the others are a guess. `None` where the platform does not hang.
    #[must_use]
    pub fn region(
        &self,
        commanded: &Measurements,
        rubbing: &[Rubbing],
        near: &Pose,
    ) -> Option<Region> {
        let (slopes, (hanging, noise)) = self.slopes(commanded, rubbing, near)?;
        let spread = self.now.spread(&slopes);
        let covariance = Matrix3::from_fn(|i, j| spread[i][j]);
        Some(Region {
            pose: hanging.pose,
            tool_m: hanging.pose.transform(&self.robot.tool.tcp_in_platform_m),
            covariance_m2: covariance + noise,
        })
    }

    /// The same after `seconds` more under `tensions_n` (at the platform, N), without the last rests.
    #[must_use]
    pub fn later(&self, seconds: f64, tensions_n: &[f64]) -> Self {
        let mut later = Self {
            robot: self.robot.clone(),
            now: self.now.clone(),
            planned: self.planned.clone(),
            at_home: self.at_home.clone(),
            recent: VecDeque::new(),
            ..*self
        };
        if seconds > 0.0 {
            later.pass(seconds, tensions_n);
        }
        later
    }

    /// What was assumed at the start.
    #[must_use]
    pub const fn prior(&self) -> &Prior {
        &self.prior
    }

    /// Whether the gripper holds something, as it was said.
    #[must_use]
    pub const fn loaded(&self) -> bool {
        self.loaded
    }
}
