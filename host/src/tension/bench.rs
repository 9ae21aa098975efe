//! A simulated robot that holds a tension while hands pull on it: the real control core, behind
//! the real client and link, in virtual time.

use crate::experiment::Experiment;
use crate::link::{Client, ClientError, Link, SimulatedLink, plant_failed};
use crate::machine::{Controller, GearMismatch, Mismatch, hang, line_to, plant_params, reference};
use crate::motion::{Model, Task};
use crate::record::events::TruthTap;
use crate::robot::Robot;
use crate::run::{self, Recorder, RunError};
use mcdpr_protocol::{Knot, SessionId};
use mcdpr_simulator::plant::{Plant, PlantError, PlantParams};
use mcdpr_simulator::{LinkOptions, TracePoint};

/// Differences of the simulated machine from its description, beyond the robot file. The default is
/// none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Change {
    /// Factor on every cable's stiffness EA.
    pub stiffness: f64,
    /// Factor on the platform's mass, unknown to the controller.
    pub mass: f64,
    /// Tension lost at every pulley, as a share.
    pub pulley_loss: f64,
    /// Relative error of the tension sensors' gain.
    pub sensor_gain: f64,
    /// Error of the tension sensors' zero, N.
    pub sensor_zero_n: f64,
    /// Coulomb friction of every winch, N; `None` as the robot file says.
    pub friction_n: Option<f64>,
    /// Errors of the gears relative to the robot file.
    pub gears: GearMismatch,
}

impl Default for Change {
    fn default() -> Self {
        Self {
            stiffness: 1.0,
            mass: 1.0,
            pulley_loss: 0.0,
            sensor_gain: 0.0,
            sensor_zero_n: 0.0,
            friction_n: None,
            gears: GearMismatch::default(),
        }
    }
}

impl Change {
    fn apply(&self, params: &mut PlantParams) {
        params.platform.mass_kg *= self.mass;
        // The added mass is spread like the platform's own.
        for row in &mut params.platform.inertia_kg_m2 {
            for entry in row {
                *entry *= self.mass;
            }
        }
        for cable in &mut params.cables {
            cable.ea_n *= self.stiffness;
            cable.pulley_loss = cable.pulley_loss.max(self.pulley_loss);
        }
        for winch in &mut params.winches {
            // The plant's sensor is the true one; the board uses the file. A gain that is too large
            // reads too much: the plant's k is smaller by the same factor.
            winch.sensor.gain_n_per_v /= 1.0 + self.sensor_gain;
            winch.sensor.zero_v += self.sensor_zero_n / winch.sensor.gain_n_per_v;
            if let Some(friction_n) = self.friction_n {
                winch.friction_n = friction_n;
            }
        }
    }
}

/// Action of a hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Hand {
    /// Pulls on the platform's origin with this force, world, N.
    Platform {
        /// Force, world, N.
        force_n: [f64; 3],
    },
    /// Pulls across the middle of a cable's free part.
    Cable {
        /// Index of the cable, from 0.
        cable: usize,
        /// Force, world, N.
        force_n: [f64; 3],
    },
    /// Lets this much cable slip off the drum, m: the cable is slack then.
    Slip {
        /// Index of the cable, from 0.
        cable: usize,
        /// Length, m.
        longer_m: f64,
    },
}

/// What hands do at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct Action {
    /// Time since the robot holds, s.
    pub at_s: f64,
    /// What they do.
    pub hand: Hand,
}

/// An experiment: rest, then actions of hands, then observation.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Script {
    /// Actions in time order.
    pub hands: Vec<Action>,
    /// Length of the experiment, s.
    pub duration_s: f64,
}

impl Script {
    /// A rest.
    #[must_use]
    pub const fn rest(duration_s: f64) -> Self {
        Self {
            hands: Vec::new(),
            duration_s,
        }
    }

    /// One pull on the platform from `from_s` to `to_s`.
    #[must_use]
    pub fn platform_pull(force_n: [f64; 3], from_s: f64, to_s: f64, duration_s: f64) -> Self {
        let action = |at_s, force_n| Action {
            at_s,
            hand: Hand::Platform { force_n },
        };
        Self {
            hands: vec![action(from_s, force_n), action(to_s, [0.0; 3])],
            duration_s,
        }
    }

    /// One pull across a cable from `from_s` to `to_s`, rising and falling over 100 ms, smoothly,
    /// as a hand's does.
    #[must_use]
    pub(crate) fn cable_pull(
        cable: usize,
        force_n: [f64; 3],
        from_s: f64,
        to_s: f64,
        duration_s: f64,
    ) -> Self {
        let mut hands = Vec::new();
        for (start_s, rising) in [(from_s, true), (to_s, false)] {
            for step in 1..=100 {
                let share = 0.5 - 0.5 * (std::f64::consts::PI * f64::from(step) / 100.0).cos();
                let share = if rising { share } else { 1.0 - share };
                let force_n = force_n.map(|f| f * share);
                let at_s = start_s + f64::from(step) * 1e-3;
                let hand = Hand::Cable { cable, force_n };
                hands.push(Action { at_s, hand });
            }
        }
        Self { hands, duration_s }
    }
}

impl Script {
    /// Cable that creeps off a drum between two times.
    #[must_use]
    pub fn slip(cable: usize, longer_m: f64, from_s: f64, to_s: f64, duration_s: f64) -> Self {
        let steps = 200_u32;
        let hands = (0..steps).map(|step| {
            let at_s = from_s + (to_s - from_s) * f64::from(step) / f64::from(steps);
            let longer_m = longer_m / f64::from(steps);
            let hand = Hand::Slip { cable, longer_m };
            Action { at_s, hand }
        });
        Self {
            hands: hands.collect(),
            duration_s,
        }
    }
}

/// Trace of an experiment, tick by tick.
#[derive(Debug, Clone, Default)]
pub struct Trace {
    /// Set-point of the watched cable at rest, N.
    pub setpoint_n: f64,
    /// Its set-point at each time, N: a plan schedules it along its path.
    pub setpoints_n: Vec<f64>,
    /// Time since the robot holds, s.
    pub time_s: Vec<f64>,
    /// True tension of the watched cable at its winch, N.
    pub tension_n: Vec<f64>,
    /// The board's measurement there, N (at its own times; see `measured_s`).
    pub measured_n: Vec<f64>,
    /// Times of `measured_n`, s.
    pub measured_s: Vec<f64>,
    /// Turn of the watched drum, as cable paid out, m.
    pub drum_m: Vec<f64>,
    /// Motor current of the watched winch, A.
    pub current_a: Vec<f64>,
    /// Tool, world, m.
    pub tool_m: Vec<[f64; 3]>,
    /// The least tension of any cable, N.
    pub least_n: Vec<f64>,
    /// All tensions at the winches, N.
    pub all_n: Vec<Vec<f64>>,
    /// Fault that ended it early.
    pub fault: Option<String>,
}

/// A simulated robot at home that holds its tension, and a client that observes it.
pub struct Bench<'l> {
    link: SimulatedLink,
    truth: TruthTap,
    client: Client<Box<dyn Link + 'l>>,
    model: Model,
    watched: usize,
    setpoint_n: f64,
}

/// Rest before an experiment begins, s: the drives' start has decayed.
const REST_S: f64 = 1.0;

impl<'l> Bench<'l> {
    /// Arms a simulated robot until it holds.
    ///
    /// # Errors
    /// As a run: the robot cannot hang at home, or a check of arming failed.
    pub fn start(robot: &Robot, change: &Change, seed: u64) -> Result<Self, RunError> {
        let (model, core) = (Model::new(robot)?, Controller::InProcess);
        Self::start_on(model, change, seed, &core, |link, _| Box::new(link))
    }

    /// As [`Bench::start`]; the machine is built as `machine` says, the controller knows `robot`.
    ///
    /// # Errors
    /// As [`Bench::start`].
    pub(crate) fn start_built(
        robot: &Robot,
        machine: &Robot,
        change: &Change,
        seed: u64,
    ) -> Result<Self, RunError> {
        let (model, core) = (Model::new(robot)?, Controller::InProcess);
        let watch = |link: SimulatedLink, _| -> Box<dyn Link + 'l> { Box::new(link) };
        Self::begin(model, machine, change, seed, &core, watch)
    }

    /// As [`Bench::start`], with the tension that the model's options ask for at home, on the line
    /// that `watch` makes of the simulated one (a recorded one).
    ///
    /// # Errors
    /// As [`Bench::start`].
    pub(crate) fn start_on(
        model: Model,
        change: &Change,
        seed: u64,
        controller: &Controller,
        watch: impl FnOnce(SimulatedLink, TruthTap) -> Box<dyn Link + 'l>,
    ) -> Result<Self, RunError> {
        let machine = model.robot().clone();
        Self::begin(model, &machine, change, seed, controller, watch)
    }

    fn begin(
        model: Model,
        machine: &Robot,
        change: &Change,
        seed: u64,
        controller: &Controller,
        watch: impl FnOnce(SimulatedLink, TruthTap) -> Box<dyn Link + 'l>,
    ) -> Result<Self, RunError> {
        let robot = &model.robot().clone();
        let home = model.rest_at_home()?;
        let mismatch = Mismatch {
            gears: change.gears,
            ..Mismatch::default()
        };
        let mut params = plant_params(machine, &mismatch, seed);
        change.apply(&mut params);
        let broken = |error: PlantError| RunError::Client(plant_failed(error).into());
        let (pose, held) = (&home.equilibrium.pose, model.holding().by_tension());
        let plant = hang(params, pose, home.tensions_n(), held, seed).map_err(broken)?;
        let link = line_to(robot, plant, &LinkOptions::default(), seed, controller)
            .map_err(|error| RunError::Client(error.into()))?;
        let truth = TruthTap::new(link.clone(), robot.cables.len());
        let line = watch(link.clone(), truth.clone());
        let mut client = Client::connect(line, SessionId(1))?;
        let hash = run::configure(&mut client, robot)?;
        client.request(reference(&home.paid_out_m, home.tensions_n()))?;
        run::arm(&mut client, hash)?;
        let until = client.now_us() + seconds(REST_S);
        client.pump(until)?;
        let watched = model.holding().first_by_tension().unwrap_or(0);
        let setpoint_n = home.tensions_n().get(watched).copied().unwrap_or(0.0);
        Ok(Self {
            link,
            truth,
            client,
            model,
            watched,
            setpoint_n,
        })
    }

    /// Index of the cable that is watched, from 0: the first tension-held one.
    #[must_use]
    pub const fn watched(&self) -> usize {
        self.watched
    }

    /// Accesses the simulated plant directly.
    ///
    /// # Errors
    /// The plant's.
    pub fn plant<R>(
        &mut self,
        act: impl FnOnce(&mut Plant) -> Result<R, PlantError>,
    ) -> Result<R, RunError> {
        self.link
            .with(|simulation| act(simulation.plant_mut()))
            .map_err(|error| RunError::Client(ClientError::from(plant_failed(error))))
    }

    /// Runs a script while the robot holds.
    ///
    /// # Errors
    /// The link's; a fault of the board is part of the trace.
    pub fn run(&mut self, script: &Script) -> Result<Trace, RunError> {
        self.clear();
        let begin_us = self.client.now_us();
        let mut recorder = Recorder::default();
        for Action { at_s, hand } in &script.hands {
            self.watch_until(begin_us + seconds(*at_s), &mut recorder)?;
            self.hand(hand)?;
        }
        self.watch_until(begin_us + seconds(script.duration_s), &mut recorder)?;
        let points = self.truth.take();
        Ok(self.trace(&points, &recorder, &[]))
    }

    /// Runs a task and gives the trace of its motion alone.
    ///
    /// # Errors
    /// As a run.
    pub fn follow(&mut self, task: Task) -> Result<Trace, RunError> {
        let start = self.model.robot().tool.home_in_world_m;
        let plan = Experiment::new(&self.model, task).plan()?;
        debug_assert!((self.model.tool_m(&plan.start) - start).norm() < 1e-3);
        let status = run::status(&mut self.client)?;
        let knots = run::joined_to(&plan, &status, &self.model)?;
        self.clear();
        let mut recorder = Recorder::default();
        let done = run::follow(&mut self.client, &knots, &mut recorder, |_| {});
        // A fault is a result: it is in the trace.
        let stopped = run::status(&mut self.client)?.fault.is_some();
        if let (Err(error), false) = (done, stopped) {
            return Err(error);
        }
        let points = self.truth.take();
        let moving: Vec<_> = points.into_iter().filter(|p| p.path_ms > 0).collect();
        Ok(self.trace(&moving, &recorder, &knots))
    }

    fn clear(&mut self) {
        drop(self.truth.take());
        while self.client.next_event().is_some() {}
    }

    fn watch_until(&mut self, until_us: u64, recorder: &mut Recorder) -> Result<(), RunError> {
        self.client.pump(until_us)?;
        while let Some(event) = self.client.next_event() {
            if let crate::link::Event::Samples(block) = event {
                recorder.take(&block, 0.0);
            }
        }
        Ok(())
    }

    fn hand(&mut self, hand: &Hand) -> Result<(), RunError> {
        self.plant(|plant| match *hand {
            Hand::Platform { force_n } => plant.set_load(force_n, [0.0; 3], [0.0; 3]),
            Hand::Cable { cable, force_n } => plant.pull_cable(cable, force_n),
            Hand::Slip { cable, longer_m } => plant.slip_cable(cable, longer_m),
        })
    }

    /// Set-point of the watched cable from a motion's knots at a path time, N: linear between them,
    /// as on the board. At rest, the set-point.
    fn planned_n(&self, knots: &[Knot], path_ms: u32) -> f64 {
        let at = knots.partition_point(|knot| knot.time_ms <= path_ms);
        let tension_n = |knot: &Knot| {
            let cable = knot.cables.get(self.watched);
            cable.map_or(self.setpoint_n, |cable| cable.tension.newtons())
        };
        match (at.checked_sub(1).and_then(|i| knots.get(i)), knots.get(at)) {
            (Some(a), Some(b)) => {
                let share = f64::from(path_ms - a.time_ms) / f64::from(b.time_ms - a.time_ms);
                tension_n(a) + share * (tension_n(b) - tension_n(a))
            }
            (Some(end), None) | (None, Some(end)) => tension_n(end),
            (None, None) => self.setpoint_n,
        }
    }

    fn trace(&mut self, points: &[TracePoint], recorder: &Recorder, knots: &[Knot]) -> Trace {
        let mut trace = Trace {
            setpoint_n: self.setpoint_n,
            ..Trace::default()
        };
        let count = self.model.robot().cables.len();
        let first = points.first().map_or(0, |point| point.tick.0);
        let since = |tick: u32| f64::from(tick.wrapping_sub(first).cast_signed()) * 1e-3;
        for point in points {
            let truth = &point.truth;
            let winch = truth.tensions_winch_n.get(..count).unwrap_or_default();
            trace.time_s.push(since(point.tick.0));
            let planned = self.planned_n(knots, point.path_ms);
            trace.setpoints_n.push(planned);
            trace
                .tension_n
                .push(winch.get(self.watched).copied().unwrap_or(0.0));
            trace.all_n.push(winch.to_vec());
            trace
                .least_n
                .push(winch.iter().copied().fold(f64::INFINITY, f64::min));
            let current = truth.motor_currents_a.get(self.watched);
            let drum = truth.drum_positions_m.get(self.watched);
            trace.drum_m.push(drum.copied().unwrap_or(0.0));
            trace.current_a.push(current.copied().unwrap_or(0.0));
            trace.tool_m.push(truth.tool_position_m);
        }
        for sample in &recorder.samples {
            if let Some(&tension) = sample.tensions_n.get(self.watched) {
                trace.measured_s.push(since(sample.tick));
                trace.measured_n.push(tension);
            }
        }
        let fault = self.client.status().and_then(|status| status.fault);
        trace.fault = fault.map(|record| crate::link::describe_fault(&record));
        trace
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "some seconds"
)]
fn seconds(s: f64) -> u64 {
    (s.max(0.0) * 1e6).round() as u64
}
