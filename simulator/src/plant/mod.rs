//! The physical plant of a cable robot, in virtual time.
//!
//! A rigid platform hangs on up to eight unilateral elastic cables; each runs over a swivel pulley
//! to a geared winch with brake, drive, drum encoder and tension sensor. The plant does not depend
//! on a controller, a protocol or a solver: inputs are commands as a board sends them to drives and
//! brakes, outputs are readings as a board gets them, and [`Truth`] is for reports and tests only.
//!
//! Conventions: SI, world frame with z up, cables indexed from 0 (messages name them from 1),
//! drum displacement and winch speed positive when cable is paid out, `rotation` from platform
//! to world.
//!
//! Time advances in equal steps (0.1 ms by default). A step is half a free flight, an impulse of
//! all forces, half a free flight: symplectic for the conservative part, so that the energy of a
//! swinging platform does not creep.
//!
//! ```
//! use mcdpr_simulator::plant::{Plant, PlantParams, Pose};
//! let mut plant = Plant::new(PlantParams::paper_optimistic(), 1)?;
//! plant.settle_with_tension(&Pose::level([0.33, 0.0, -0.2]), 3, 5.0)?; // cable 4 at 5 N
//! plant.advance(0.1)?;
//! assert!((plant.truth()?.tensions_winch_n[3] - 5.0).abs() < 0.01); // brakes hold it there
//! # Ok::<(), mcdpr_simulator::plant::PlantError>(())
//! ```

mod brake;
mod bus;
mod cable;
mod contactor;
mod day;
mod drive;
mod error;
mod faults;
mod foreign;
mod gear;
mod hook;
mod inputs;
mod lift;
mod open;
mod params;
mod placing;
mod platform;
mod pulley;
mod sensors;
mod settle;
mod slow;
mod stand;
#[cfg(test)]
mod tests;
mod truth;
mod unmodelled;
mod validate;
pub(crate) mod vec3;
mod winch;

pub use bus::Feedback;
pub use day::{DayHold, DayPlant, DayState};
pub(crate) use drive::DriveState;
pub use drive::{DriveCommand, Mode};
pub use error::PlantError;
pub use faults::{BrakeFault, CableFaults, DriveFault, EncoderFault, Faults, TensionFault};
pub use foreign::{Foreign, Hanging};
pub use params::{
    BrakeParams, BusParams, CableParams, DriveParams, GearParams, MAX_CABLES, PlantParams,
    PlatformParams, Protocol, SensorDrift, TensionSensorParams, UnmodelledParams, WinchParams,
    box_inertia_kg_m2,
};
pub use platform::Pose;
pub use sensors::Sensors;
pub use slow::{Creep, Payload, SlowParams, Voigt, Warming};
pub use truth::Truth;

use bus::Port;
use cable::{Cable, Tension};
use platform::{Body, Motion};
use sensors::{CableSensors, Noise};
use settle::Load;
use slow::Slow;
use unmodelled::Unmodelled;
use vec3::{V3, add, axpy, cross, dot, mul, mul_t, q_matrix, scale};
use winch::Winch;

/// A simulated robot.
#[derive(Debug, Clone)]
pub struct Plant {
    params: PlantParams,
    body: Body,
    motion: Motion,
    cables: Vec<Cable>,
    winches: Vec<Winch>,
    ports: Vec<Port>,
    sensors: Vec<CableSensors>,
    noise: Noise,
    faults: Faults,
    weight_n: V3,
    load: Load,
    unmodelled: Option<Unmodelled>,
    stand: Option<stand::Stand>,
    hook: Option<hook::Hook>,
    outside: Option<foreign::Outside>,
    hung_n: [Option<f64>; MAX_CABLES],
    /// Weights that hang on drums without a robot.
    lifts: [Option<lift::Lift>; MAX_CABLES],
    e_stop: bool,
    gripper_closed: bool,
    gripper_switch: bool,
    powered: bool,
    contactors: [contactor::Contactor; MAX_CABLES],
    /// When the rail of the drives is empty, if their supply has failed.
    fails_at_s: Option<f64>,
    steps: u64,
    target_s: f64,
    failed: Option<PlantError>,
    slow: Slow,
}

impl Plant {
    /// Builds the robot, level and 0.3 m below the middle of its anchors, cables without tension.
    /// Place it with [`Plant::settle_at`] or its relatives before use.
    ///
    /// `seed` decides the sensor noise and where between two counts each encoder starts.
    ///
    /// # Errors
    /// The first parameter out of range (see [`PlantParams::validate`]).
    pub fn new(params: PlantParams, seed: u64) -> Result<Self, PlantError> {
        params.validate()?;
        let body = Body::new(&params.platform);
        let mut noise = Noise::new(seed);
        let cables = params
            .cables
            .iter()
            .map(|c| Cable::new(c, body.principal(c.attachment_m)))
            .collect();
        let winches = params
            .winches
            .iter()
            .map(|w| Winch::new(w, params.step_s))
            .collect();
        let count = params.cables.len();
        let ports = (0..count)
            .map(|i| Port::new(i, count, &params.bus))
            .collect();
        let sensors = params
            .winches
            .iter()
            .map(|w| CableSensors::new(w, noise.uniform()))
            .collect();
        let mut plant = Self {
            motion: Motion::at_rest(&body, &Pose::level([0.0; 3])),
            weight_n: scale(params.gravity_mps2, params.platform.mass_kg),
            body,
            cables,
            winches,
            ports,
            sensors,
            noise,
            faults: Faults::default(),
            load: Load::default(),
            unmodelled: Unmodelled::new(&params.unmodelled),
            stand: None,
            hook: None,
            outside: None,
            hung_n: [None; MAX_CABLES],
            lifts: [None; MAX_CABLES],
            e_stop: false,
            gripper_closed: false,
            gripper_switch: false,
            powered: true,
            contactors: Default::default(),
            fails_at_s: None,
            steps: 0,
            target_s: 0.0,
            failed: None,
            slow: Slow::new(&params),
            params,
        };
        let start = plant.pose_below_anchors();
        // Some robots have no cable path there: such a plant must be placed first.
        plant.failed = plant.place_at(&start, &[0.0; MAX_CABLES][..count]).err();
        if !plant.params.cables_attached {
            plant.failed = None;
        }
        Ok(plant)
    }

    fn pose_below_anchors(&self) -> Pose {
        let share = 1.0 / self.cables.len() as f64;
        let middle = self
            .cables
            .iter()
            .fold([0.0; 3], |sum, c| axpy(sum, share, c.pulley.anchor_m));
        Pose::level(axpy(middle, 0.3, [0.0, 0.0, -1.0]))
    }

    /// The parameters that the plant was built from.
    #[must_use]
    pub fn params(&self) -> &PlantParams {
        &self.params
    }

    /// Number of cables.
    #[must_use]
    pub fn cable_count(&self) -> usize {
        self.cables.len()
    }

    /// Simulated time since the robot was placed (s).
    #[must_use]
    pub fn time_s(&self) -> f64 {
        self.steps as f64 * self.params.step_s
    }

    /// The active faults.
    #[must_use]
    pub fn faults(&self) -> &Faults {
        &self.faults
    }

    /// The active faults, to change.
    pub fn faults_mut(&mut self) -> &mut Faults {
        &mut self.faults
    }

    /// State of a drive between power-on and operation (for tests; a board cannot see it).
    ///
    /// # Errors
    /// [`PlantError::NoSuchCable`].
    pub(crate) fn drive_state(&self, cable: usize) -> Result<DriveState, PlantError> {
        self.known(cable)?;
        Ok(self.winches[cable].drive.state())
    }

    /// Reads all inputs of the board. Draws fresh noise at each call, so the number of readings
    /// is part of a run's history.
    pub fn read_sensors(&mut self) -> Sensors {
        self.sensed(true, |_| true)
    }

    /// As [`Plant::read_sensors`], for a board that drives only these cables: the others read zero,
    /// and their noise is not drawn.
    pub fn read_sensors_of(&mut self, cables: &[usize]) -> Sensors {
        self.sensed(true, |cable| cables.contains(&cable))
    }

    /// The present inputs, with the tension sensors' noise of the last reading: for a board that drives only these
    /// cables and samples more often than it reads.
    pub fn read_sensors_again_of(&mut self, cables: &[usize]) -> Sensors {
        self.sensed(false, |cable| cables.contains(&cable))
    }

    fn sensed(&mut self, fresh: bool, wanted: impl Fn(usize) -> bool) -> Sensors {
        let now_s = self.time_s();
        let mut out = Sensors {
            encoder_counts: [0; MAX_CABLES],
            adc: [0; MAX_CABLES],
            feedback: [None; MAX_CABLES],
            e_stop: self.e_stop,
        };
        for i in (0..self.cables.len()).filter(|&i| wanted(i)) {
            let (counts, adc) = self.sensors[i].read(
                self.winches[i].drum_m,
                self.hung_n[i].unwrap_or(self.cables[i].tension.winch_n),
                now_s,
                &mut self.faults.cables[i],
                &mut self.noise,
                fresh,
            );
            out.encoder_counts[i] = counts;
            out.adc[i] = adc;
            out.feedback[i] = self.ports[i].received;
        }
        out
    }

    /// Advances by `duration_s`. Durations add up exactly: a remainder below one step is carried
    /// over to later calls.
    ///
    /// # Errors
    /// [`PlantError::Parameter`] for a negative or non-finite duration;
    /// [`PlantError::InsidePulley`], [`PlantError::Exhausted`] or [`PlantError::Diverged`] when the
    /// robot leaves the model's range. Then time stops, and the error repeats, until the robot is
    /// placed again.
    pub fn advance(&mut self, duration_s: f64) -> Result<(), PlantError> {
        if !(0.0..=1e6).contains(&duration_s) {
            return Err(PlantError::Parameter {
                name: "duration_s",
                value: duration_s,
                rule: "0 to 1000000",
            });
        }
        if let Some(error) = &self.failed {
            return Err(error.clone());
        }
        self.target_s += duration_s;
        // 1e-6 of a step more: a sum of rounded durations must not lose its last step.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let last = (self.target_s / self.params.step_s + 1e-6).floor() as u64;
        while self.steps < last {
            if let Err(error) = self.step() {
                self.failed = Some(error.clone());
                return Err(error);
            }
        }
        if !self.is_finite() {
            let error = PlantError::Diverged {
                time_s: self.time_s(),
            };
            self.failed = Some(error.clone());
            return Err(error);
        }
        Ok(())
    }

    fn is_finite(&self) -> bool {
        let m = &self.motion;
        let body = m.center_m.iter().chain(&m.velocity).chain(&m.attitude);
        let winches = self.winches.iter();
        let drums = winches.flat_map(|w| [w.drum_m, w.drum_rate, w.motor_m(), w.motor_rate()]);
        body.chain(&m.momentum)
            .copied()
            .chain(drums)
            // A million m or m/s is beyond any robot: an unstable step is reported before it
            // overflows.
            .all(|v| v.is_finite() && v.abs() < 1e6)
    }

    fn step(&mut self) -> Result<(), PlantError> {
        let h = self.params.step_s;
        let now_s = self.time_s();
        if self.fails_at_s.is_some_and(|at_s| now_s >= at_s) {
            self.set_power(false);
        }
        for (i, (port, winch)) in self.ports.iter_mut().zip(&mut self.winches).enumerate() {
            let fault = &self.faults.cables[i].drive;
            let contactor = &mut self.contactors[i];
            if contactor.opens(now_s) {
                winch.drive.cut_power();
                port.clear();
            }
            let powered = self.powered && contactor.is_closed();
            let motor = (winch.motor_m(), winch.motor_rate());
            // Without supply no restart of a drive comes to its end.
            let late_s = if powered { fault.late_s } else { f64::INFINITY };
            winch.drive.tick(now_s, motor.0, late_s);
            let bus_off = self.faults.bus_off || !powered;
            port.poll(
                now_s,
                &self.params.bus,
                bus_off,
                fault,
                &mut winch.drive,
                motor,
            );
        }

        let half = 0.5 * h;
        if !self.params.cables_attached {
            for (i, winch) in self.winches.iter_mut().enumerate() {
                winch.drift(half);
                let pull_n = self.lifts[i].map_or(0.0, |lift| lift.pull_n(winch.drum_rate));
                if pull_n > 0.0 {
                    self.hung_n[i] = Some(pull_n);
                }
                winch.kick(pull_n, now_s, h, &self.faults.cables[i].brake);
                winch.drift(half);
            }
            self.steps += 1;
            return Ok(());
        }
        if self.outside.is_some() {
            return self.step_outside(now_s);
        }
        self.motion.drift(&self.body, half);
        let rotation = q_matrix(self.motion.attitude);
        let spin = self.motion.spin(&self.body);
        let mut force = add(self.weight_n, self.load.force_n);
        let mut torque = add(
            cross(self.load.point, mul_t(&rotation, self.load.force_n)),
            mul_t(&rotation, self.load.torque_nm),
        );
        if let Some(unmodelled) = &self.unmodelled {
            let (push, turn) = unmodelled.at(self.motion.center_m);
            force = add(force, push);
            torque = add(torque, mul_t(&rotation, turn));
        }
        for (i, (cable, winch)) in self.cables.iter_mut().zip(&mut self.winches).enumerate() {
            winch.drift(half);
            let off_drum = winch.paid_out();
            let arm = mul(&rotation, cable.attachment);
            let path = cable.path(add(self.motion.center_m, arm), i)?;
            let velocity = add(
                self.motion.velocity,
                mul(&rotation, cross(spin, cable.attachment)),
            );
            let rate = dot(path.direction, velocity);
            if cable.exhausted(off_drum.length_m) {
                return Err(PlantError::Exhausted { cable: i });
            }
            // Tension first: the pulley's friction follows the routing's stretch, which the tension
            // sets.
            cable.tension =
                cable.tension(path.length_m, rate, off_drum.length_m, off_drum.rate_mps);
            cable.rub(off_drum.length_m);
            let Tension {
                platform_n,
                winch_n,
                ..
            } = cable.tension;
            let mut pull = scale(path.direction, -platform_n);
            if let Some((along, across)) = cable.hand() {
                pull = axpy(across, along, pull);
            }
            force = add(force, pull);
            torque = add(torque, cross(cable.attachment, mul_t(&rotation, pull)));
            let fault = &self.faults.cables[i].brake;
            // An eccentric drum feels the cable at its present radius, not at its nominal one.
            let pull_n = off_drum.lever * cable.force_on_drum(winch_n);
            winch.kick(pull_n, now_s, h, fault);
            winch.drift(half);
        }
        if let Some(stand) = &self.stand {
            let (center, velocity) = (self.motion.center_m, self.motion.velocity);
            let (push, turn) = stand.push(center, velocity, &rotation, spin);
            force = add(force, push);
            torque = add(torque, mul_t(&rotation, turn));
        }
        if let Some(hook) = &self.hook {
            let arm = mul(&rotation, hook.point);
            let moves = mul(&rotation, cross(spin, hook.point));
            let at_m = add(self.motion.center_m, arm);
            let pull = hook.pull(at_m, add(self.motion.velocity, moves));
            force = add(force, pull);
            torque = add(torque, cross(hook.point, mul_t(&rotation, pull)));
        }
        // All forces belong to the middle of the step: half a drift lies on either side of the
        // kick.
        self.motion.kick(&self.body, force, torque, h);
        self.motion.drift(&self.body, half);
        self.steps += 1;
        if self.slow.due(self.steps) {
            self.slow.pass(&mut self.cables, slow::EVERY as f64 * h);
        }
        Ok(())
    }

    /// Path of a cable for a given motion state.
    fn path(&self, motion: &Motion, cable: usize) -> Result<pulley::Path, PlantError> {
        let arm = mul(&q_matrix(motion.attitude), self.cables[cable].attachment);
        self.cables[cable].path(add(motion.center_m, arm), cable)
    }

    fn known(&self, cable: usize) -> Result<(), PlantError> {
        let count = self.cables.len();
        if cable < count {
            Ok(())
        } else {
            Err(PlantError::NoSuchCable { cable, count })
        }
    }
}
