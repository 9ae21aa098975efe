//! A day's slow changes, tracked while the robot works: cable lengths, creep, sensors, payload, anchors.
//!
//! A Kalman filter over states that change slowly. It is fed where the robot rests anyway, with lengths,
//! tensions and, if the camera sees any, tags. Pose and true tensions of each rest are removed first, so
//! the filter needs no model of motion. Between rests each state drifts as far as its own random walk,
//! and creep follows a model with two retardation times (Piao et al., 2017) whose size is itself a state.
//! What nothing observes keeps its uncertainty. Rests that do not fit are not used: see [`Report`].

mod errors;
mod estimates;
mod gaussian;
mod kept;
mod knock;
mod layout;
mod pulleys;
mod rows;
#[cfg(test)]
mod tests;

use super::Measurements;
use super::region::chi2_quantile;
use crate::motion::{Drift, Model, PlanError, StaticState};
use crate::robot::Robot;
pub use estimates::{CableEstimate, Estimates, Known};
use gaussian::{Fit, Gaussian};
pub use kept::{Kept, KeptError};
use knock::{Hypothesis, Pending};
pub use knock::{Moved, Named};
use layout::Layout;
use mcdpr_kinematics::Pose;
use nalgebra::{Matrix3, Vector3};
pub use pulleys::Pulleys;
pub use rows::RowSigmas;
use rows::{Hanging, Rest, vector};

/// Rests are doubted beyond this many standard deviations of a normal distribution: 1e-9 of them.
const DOUBT_SIGMAS: f64 = 6.0;
/// A rest is linearised again at the new states this often: a payload is unknown before.
const ROUNDS: usize = 6;
/// The search for the pose takes a payload's moment to be known at least this well, kg m.
const LOOSEST_KG_M: f64 = 5e-3;
/// A payload heavier than this many times the platform is not looked for.
const HEAVIEST: f64 = 1.0;

/// What is known of the states at the start, as standard deviations, and how fast they drift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Anchors, per axis, m.
    pub anchor_m: f64,
    /// Lengths, m.
    pub length_m: f64,
    /// Relative error of the elastic compliance.
    pub compliance: f64,
    /// Relative error of a tension sensor.
    pub gain: f64,
    /// What a sensor shows without tension, N.
    pub zero_n: f64,
    /// Loss over a pulley: mean and standard deviation.
    pub loss: [f64; 2],
    /// Relative error of the platform's mass.
    pub mass: f64,
    /// Its centre, per axis, m.
    pub center_m: f64,
    /// Final creep at the tension set-point: mean and standard deviation, strain.
    pub creep: [f64; 2],
    /// The camera's mounting: shift per axis, m, and turn, rad.
    pub camera: [f64; 2],
    /// Drift in eight hours: anchors and lengths, m.
    pub drift_m: f64,
    /// Drift of the tension sensors in eight hours, N.
    pub drift_n: f64,
    /// Error of the model's rate of creep, as a share of it.
    pub creep_drift: f64,
    /// Errors of each rest.
    pub rows: RowSigmas,
    /// Where a payload's centre is, below the tool: mean and standard deviation, m.
    pub below_m: [f64; 2],
    /// The same, sideways: standard deviation, m.
    pub grasp_m: f64,
    /// Greatest shift of the planned tool by what one rest taught, m.
    pub step_m: f64,
}

impl Default for Prior {
    /// A robot calibrated in the morning: the errors of `Mismatch::realistic`.
    fn default() -> Self {
        Self {
            anchor_m: 2e-4,
            length_m: 1e-4,
            compliance: 0.12,
            gain: 0.006,
            zero_n: 0.05,
            loss: [0.01, 0.01],
            mass: 0.012,
            center_m: 6e-4,
            creep: [0.0015, 0.0015],
            camera: [1e-4, 2e-4],
            drift_m: 1e-4,
            drift_n: 0.15,
            creep_drift: 0.25,
            rows: RowSigmas::default(),
            below_m: [0.03, 0.02],
            grasp_m: 0.015,
            step_m: 5e-4,
        }
    }
}

/// Retardation times of the creep model, s: rough, as in `Creep::polymer`'s ranges.
const RETARDATION_S: [f64; 2] = [300.0, 7200.0];
/// Shares of the final creep.
const CREEP_SHARES: [f64; 2] = [0.4, 0.6];
const EIGHT_HOURS_S: f64 = 28_800.0;
/// A payload lighter than this is none.
const LIGHTEST_KG: f64 = 1e-3;

/// What one rest taught.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Whether it fitted what was known.
    pub fits: bool,
    /// Sum of squared innovations over the value beyond which it is doubted.
    pub doubt: f64,
    /// What moved, if this or an earlier rest did not fit and now one cause explains all.
    pub named: Option<Named>,
}

/// A payload as tracked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Load {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Its standard deviation, kg.
    pub mass_sigma_kg: f64,
    /// Centre of mass, platform frame, m.
    pub center_m: Vector3<f64>,
    /// Its standard deviation per axis, m.
    pub center_sigma_m: Vector3<f64>,
}

/// Where the tool is, with the covariance that the states leave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// The platform's pose.
    pub pose: Pose,
    /// Tool, world, m.
    pub tool_m: Vector3<f64>,
    /// Its covariance, m2.
    pub covariance_m2: Matrix3<f64>,
}

impl Region {
    /// Whether a place lies in the 95 % region (chi-square of three: 7.815).
    #[must_use]
    pub fn holds(&self, tool_m: &Vector3<f64>) -> bool {
        let off = tool_m - self.tool_m;
        self.covariance_m2
            .try_inverse()
            .is_some_and(|inverse| (off.transpose() * inverse * off).x <= 7.815)
    }
}

/// The tracked state of a robot.
#[derive(Debug, Clone)]
pub struct Tracker {
    robot: Robot,
    layout: Layout,
    prior: Prior,
    now: Gaussian,
    /// The states that plans use: they follow in small steps.
    planned: Vec<f64>,
    loaded: bool,
    pending: Vec<Pending>,
}

/// Slopes of the tool's three coordinates, and where the platform hangs.
type Slopes = ([Vec<f64>; 3], (Hanging, Matrix3<f64>));

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
            for axis in 0..3 {
                put(layout.anchor(i) + axis, 0.0, prior.anchor_m);
            }
            let per_strain = cable.ea_n / robot.tension.setpoint_n;
            for (element, share) in CREEP_SHARES.into_iter().enumerate() {
                let [value, sigma] = prior.creep.map(|strain| share * strain * per_strain);
                put(layout.creep_ratio(i, element), value, sigma);
            }
        }
        put(layout.loss(), prior.loss[0], prior.loss[1]);
        let mass_kg = robot.platform.mass_kg;
        put(layout.platform(), 0.0, prior.mass * mass_kg);
        for axis in 0..3 {
            let moment = prior.center_m * mass_kg;
            put(layout.platform() + 1 + axis, 0.0, moment);
            put(layout.camera() + axis, 0.0, prior.camera[0]);
            put(layout.camera() + 3 + axis, 0.0, prior.camera[1]);
        }
        Self {
            planned: mean.clone(),
            now: Gaussian::new(mean, &sigmas),
            robot,
            layout,
            prior: *prior,
            loaded: false,
            pending: Vec::new(),
        }
    }

    /// Lets time pass: cables creep under `tensions_n` (at the platform, mean of that time, N), and
    /// everything drifts.
    pub fn pass(&mut self, seconds: f64, tensions_n: &[f64]) {
        let layout = self.layout;
        let share = seconds / EIGHT_HOURS_S;
        let length = self.prior.drift_m.powi(2) * share;
        let zero = self.prior.drift_n.powi(2) * share;
        for (i, tension_n) in tensions_n.iter().enumerate().take(layout.cables) {
            let Some(cable) = self.robot.cables.get(i) else {
                continue;
            };
            let elastic = tension_n / cable.ea_n;
            for (element, retardation_s) in RETARDATION_S.into_iter().enumerate() {
                let keep = libm::exp(-seconds / retardation_s);
                let gain = (1.0 - keep) * elastic;
                let (state, ratio) = (layout.creep(i, element), layout.creep_ratio(i, element));
                let before = self.now.mean[state];
                self.now.mix(state, keep, ratio, gain);
                self.planned[state] = keep * self.planned[state] + gain * self.planned[ratio];
                // A wrong retardation time errs in the same direction for about that time.
                let off = self.prior.creep_drift * (self.now.mean[state] - before);
                let together = (retardation_s / seconds).max(1.0);
                self.now.loosen(state, off * off * together);
            }
            self.now.loosen(layout.offset(i), length);
            self.now.loosen(layout.zero(i), zero);
            for axis in 0..3 {
                self.now.loosen(layout.anchor(i) + axis, length);
            }
        }
    }

    /// The gripper took something: from the next rest on its mass and centre are estimated.
    pub fn lift(&mut self) {
        let first = self.layout.payload();
        let heavy = HEAVIEST * self.robot.platform.mass_kg;
        // What a gripper holds hangs below its fingers.
        let [below_m, below_sigma_m] = self.prior.below_m;
        let tool = self.robot.tool.tcp_in_platform_m - Vector3::new(0.0, 0.0, below_m);
        let guess_kg = 0.25 * self.robot.platform.mass_kg;
        self.now.reset(first, guess_kg, heavy);
        for axis in 0..3 {
            let moment = guess_kg * tool[axis];
            let sigma_m = if axis == 2 {
                below_sigma_m
            } else {
                self.prior.grasp_m
            };
            // Half of the heaviest at the edge of where it may be held.
            self.now
                .reset(first + 1 + axis, moment, 0.5 * heavy * sigma_m);
            // The load hangs near the tool: its moment follows its mass.
            self.now.couple(first, first + 1 + axis, tool[axis]);
        }
        self.loaded = true;
    }

    /// The gripper let go.
    pub fn set_down(&mut self) {
        let first = self.layout.payload();
        for state in first..first + 4 {
            self.now.reset(state, 0.0, 0.0);
            self.planned[state] = 0.0;
        }
        self.loaded = false;
    }

    /// The payload, if there is one.
    #[must_use]
    pub fn load(&self) -> Option<Load> {
        let first = self.layout.payload();
        let mass_kg = self.now.mean[first];
        if !self.loaded || mass_kg <= LIGHTEST_KG {
            return None;
        }
        let center_m = vector(&self.now.mean, first + 1) / mass_kg;
        let sigma = |axis: usize| {
            let mut row = vec![0.0; self.layout.size()];
            row[first + 1 + axis] = 1.0 / mass_kg;
            row[first] = -center_m[axis] / mass_kg;
            self.now.spread(&[row])[0][0].max(0.0).sqrt()
        };
        Some(Load {
            mass_kg,
            mass_sigma_kg: self.now.variance(first).max(0.0).sqrt(),
            center_m,
            center_sigma_m: Vector3::new(sigma(0), sigma(1), sigma(2)),
        })
    }

    /// Takes a rest into account. `hauled`: for each pulley 1 if its cable was hauled in last, -1 if paid
    /// out, between while its friction turns. `near`: about how the platform hangs.
    pub fn rest(&mut self, measured: &Measurements, hauled: &[f64], near: &Pose) -> Report {
        let look = Pending {
            measured: measured.clone(),
            hauled: hauled.to_vec(),
            near: *near,
        };
        let Some((next, fit)) = self.taken(&self.now, &look) else {
            return self.doubted(look, f64::INFINITY);
        };
        let doubt = fit.squares / chi2_quantile(fit.rows as f64, DOUBT_SIGMAS);
        if doubt > 1.0 || !doubt.is_finite() {
            return self.doubted(look, doubt);
        }
        // A rest without a picture says nothing of the camera: looks that did not fit wait for the next one.
        let blind = measured.views.is_empty();
        self.pending
            .retain(|waiting| blind && !waiting.measured.views.is_empty());
        self.now = next;
        self.follow(measured, hauled, near);
        Report {
            fits: true,
            doubt,
            named: None,
        }
    }

    /// A rest that does not fit: it waits until one cause explains it.
    fn doubted(&mut self, look: Pending, doubt: f64) -> Report {
        self.pending.push(look);
        let (named, next) = knock::explain(self);
        if let Some(next) = next {
            if let Some(last) = self.pending.last().cloned() {
                self.now = next;
                self.follow(&last.measured, &last.hauled, &last.near);
            }
            self.pending.clear();
        }
        // Older rests tell no more: what they do not explain together stays open.
        if self.pending.len() >= knock::MOST {
            self.pending.remove(0);
        }
        Report {
            fits: false,
            doubt,
            named,
        }
    }

    /// The states after a rest, if they were `before` it.
    fn taken(&self, before: &Gaussian, look: &Pending) -> Option<(Gaussian, Fit)> {
        let rest = Rest {
            robot: &self.robot,
            sigmas: &self.prior.rows,
            measured: &look.measured,
            hauled: &look.hauled,
            every_tension: true,
        };
        let mut hanging = Hanging {
            pose: look.near,
            tensions_n: look.measured.tensions_n.clone(),
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
            let mut next = before.clone();
            let fit = next.update(&linear);
            // Two rounds are enough where no state moves far.
            let moved = self.shift(&at, &next.mean);
            at.clone_from(&next.mean);
            result = Some((next, fit));
            if moved < 0.05 {
                break;
            }
        }
        result
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

    /// Lets the planned states follow the tracked ones, the tool's shift within its bound. A payload is
    /// used at once: it is not a drift.
    fn follow(&mut self, measured: &Measurements, hauled: &[f64], near: &Pose) {
        let payload = self.layout.payload();
        for k in payload..payload + 4 {
            self.planned[k] = self.now.mean[k];
        }
        let by: Vec<f64> = self
            .now
            .mean
            .iter()
            .zip(&self.planned)
            .map(|(now, planned)| now - planned)
            .collect();
        let shift_m = self
            .slopes(measured, hauled, near)
            .map_or(f64::INFINITY, |(slopes, _)| {
                let moved = slopes.map(|slope| gaussian::dot(&slope, &by));
                Vector3::from(moved).norm()
            });
        let share = (self.prior.step_m / shift_m).min(1.0);
        if share.is_finite() {
            for (planned, by) in self.planned.iter_mut().zip(&by) {
                *planned += share * by;
            }
        }
    }

    fn slopes(&self, commanded: &Measurements, hauled: &[f64], near: &Pose) -> Option<Slopes> {
        let rest = Rest {
            robot: &self.robot,
            sigmas: &self.prior.rows,
            measured: commanded,
            hauled,
            every_tension: false,
        };
        let start = Hanging {
            pose: *near,
            tensions_n: commanded.tensions_n.clone(),
        };
        let none = vec![0.0; self.now.size()];
        let hanging = rest.hang(&self.now.mean, &start, &none)?;
        let (slopes, noise) = rest.tool(&self.now.mean, &hanging)?;
        Some((slopes, (hanging, noise)))
    }

    /// Where the tool is, or will be, under these lengths and tensions of the tension-held cables; those
    /// of the others are a guess. `None` where the platform does not hang.
    #[must_use]
    pub fn region(&self, commanded: &Measurements, hauled: &[f64], near: &Pose) -> Option<Region> {
        let (slopes, (hanging, noise)) = self.slopes(commanded, hauled, near)?;
        let spread = self.now.spread(&slopes);
        let covariance = Matrix3::from_fn(|i, j| spread[i][j]);
        Some(Region {
            pose: hanging.pose,
            tool_m: hanging.pose.transform(&self.robot.tool.tcp_in_platform_m),
            covariance_m2: covariance + noise,
        })
    }

    /// The robot as plans should take it: anchors, stiffness, mass and centre of mass as tracked, with payload.
    #[must_use]
    pub fn robot(&self) -> Robot {
        let (layout, x) = (self.layout, &self.planned);
        let mut robot = self.robot.clone();
        for (i, cable) in robot.cables.iter_mut().enumerate() {
            cable.anchor_in_world_m += vector(x, layout.anchor(i));
            cable.ea_n /= 1.0 + x[layout.compliance(i)];
        }
        let platform = &mut robot.platform;
        let moment = platform.center_of_mass_m * platform.mass_kg
            + vector(x, layout.platform() + 1)
            + vector(x, layout.payload() + 1);
        platform.mass_kg += x[layout.platform()] + x[layout.payload()];
        platform.center_of_mass_m = moment / platform.mass_kg;
        robot
    }

    /// What has changed in each cable and its tension sensor, as plans should take it. The friction of pulleys
    /// is not in it: it stretches the routing by some micrometres.
    #[must_use]
    pub fn drift(&self) -> Vec<Drift> {
        let (layout, x) = (self.layout, &self.planned);
        (0..layout.cables)
            .map(|i| Drift {
                strain: x[layout.creep(i, 0)] + x[layout.creep(i, 1)],
                offset_m: x[layout.offset(i)],
                gain: x[layout.gain(i)],
                zero_n: x[layout.zero(i)],
            })
            .collect()
    }

    /// The model that plans should use now, with the options of `described`.
    ///
    /// # Errors
    /// Those of [`Model::new`], where what was tracked leaves no valid geometry.
    pub fn model(&self, described: &Model) -> Result<Model, PlanError> {
        let model = Model::new(&self.robot())?.with_options(described.options());
        Ok(model.with_drift(&self.drift()))
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

    /// What the encoders must show for a planned rest, m.
    #[must_use]
    pub fn paid_out_m(&self, rest: &StaticState, hauled: &[f64]) -> Vec<f64> {
        let (layout, x) = (self.layout, &self.planned);
        let pairs = rest.equilibrium.lengths_m.iter().zip(rest.tensions_n());
        let cables = self.robot.cables.iter().zip(pairs).enumerate();
        cables
            .map(|(i, (cable, (length_m, tension_n)))| {
                let compliance = (1.0 + x[layout.compliance(i)]) / cable.ea_n;
                let rubbing = x[layout.loss()] * hauled.get(i).copied().unwrap_or(0.0);
                let extra = cable.routing_length_m * rubbing * compliance * tension_n;
                let total = length_m + cable.routing_length_m - extra;
                let creep = x[layout.creep(i, 0)] + x[layout.creep(i, 1)];
                let off_drum = total / ((1.0 + tension_n * compliance) * (1.0 + creep));
                off_drum - cable.routing_length_m - x[layout.offset(i)]
            })
            .collect()
    }

    /// What a tension sensor shows while the platform feels `tension_n`, N.
    #[must_use]
    pub fn reading_n(&self, cable: usize, tension_n: f64, hauled: f64) -> f64 {
        let (layout, x) = (self.layout, &self.planned);
        let rubbed = 1.0 + x[layout.loss()] * hauled;
        tension_n * rubbed * (1.0 + x[layout.gain(cable)]) + x[layout.zero(cable)]
    }

    /// The states after a hypothesis is granted: what may have moved is free to move.
    fn freed(&self, hypothesis: Hypothesis) -> Gaussian {
        let mut now = self.now.clone();
        hypothesis.free(self.layout, &mut now);
        now
    }
}
