//! The robot's side of a day: plans and what it tracks. It sees counts, tensions and pictures only.

use super::machine::Sensed;
use super::work::DayError;
use mcdpr_core::estimate::Measurements;
use mcdpr_core::estimate::track::{Prior, Pulleys, Region, Report, Rubbing, Tracker};
use mcdpr_core::motion::{Model, PlanError, StaticState};
use mcdpr_core::robot::TagPlace;
use mcdpr_core::sight::TagView;
use nalgebra::Vector3;

/// What the winches are told.
#[derive(Debug, Clone)]
pub(super) struct Command {
    pub(super) drums_m: Vec<f64>,
    pub(super) readings_n: Vec<f64>,
}

/// Planner and tracker.
#[derive(Debug, Clone)]
pub(super) struct Side {
    model: Model,
    tracker: Option<Tracker>,
    /// Paid-out lengths where the drums' displacement is zero, as calibrated, m.
    zero_m: Vec<f64>,
    rest: StaticState,
    /// Friction of the pulleys at the end of the planned way.
    rubbing: Vec<Rubbing>,
    /// The same when the winches were last at rest: where the next way begins.
    pulleys: Pulleys,
    /// Measured less planned tensions, N, and lengths, m: a load that no plan knows yet, and what the
    /// winches that hold a tension paid out for it.
    unplanned_n: Vec<f64>,
    unplanned_m: Vec<f64>,
    /// What the tension sensors show, N.
    readings_n: Vec<f64>,
    paid_out_m: Vec<f64>,
    command: Command,
    place: TagPlace,
    /// Sum of what the sensors showed times seconds since the tracker was told, N s, and seconds. Plans take the creep of
    /// the last rest: with that of each second payloads were weighed worse (docs/results/day.md).
    since: (Vec<f64>, f64),
}

impl Side {
    pub(super) fn new(
        model: &Model,
        tracked: bool,
        lengths_m: &[f64],
        drums_m: &[f64],
        rest: StaticState,
        place: TagPlace,
    ) -> Self {
        let zero_m: Vec<f64> = lengths_m.iter().zip(drums_m).map(|(l, d)| l - d).collect();
        let count = zero_m.len();
        let pulleys = Pulleys::new(model.robot(), lengths_m, rest.tensions_n());
        Self {
            tracker: tracked.then(|| Tracker::new(model, &Prior::default())),
            model: model.clone(),
            paid_out_m: lengths_m.to_vec(),
            rubbing: pulleys.rubbing(),
            pulleys,
            command: Command {
                drums_m: drums_m.to_vec(),
                readings_n: rest.tensions_n().to_vec(),
            },
            readings_n: rest.tensions_n().to_vec(),
            zero_m,
            rest,
            since: (vec![0.0; count], 0.0),
            unplanned_n: vec![0.0; count],
            unplanned_m: vec![0.0; count],
            place,
        }
    }

    pub(super) fn tracker(&self) -> Option<&Tracker> {
        self.tracker.as_ref()
    }

    /// Plans a place of the tool, and takes note of the way there.
    pub(super) fn go(&mut self, tool_m: &Vector3<f64>) -> Result<Command, PlanError> {
        let rest = self.model.rest(tool_m, Some(&self.rest))?;
        let tensions = rest.tensions_n().iter().zip(&self.unplanned_n);
        let felt_n: Vec<f64> = tensions.map(|(planned, more)| planned + more).collect();
        let mut paid_out_m = rest.paid_out_m.clone();
        if let Some(tracker) = &self.tracker {
            // Twice: the way decides the pulleys' friction, and that, a little, the lengths.
            paid_out_m = tracker.paid_out_m(&rest, &self.rubbing);
            self.rubbing = self.rubbing_after(&paid_out_m, &felt_n);
            paid_out_m = tracker.paid_out_m(&rest, &self.rubbing);
        }
        self.rubbing = self.rubbing_after(&paid_out_m, &felt_n);
        let tensions = rest.tensions_n().iter().zip(&self.rubbing).enumerate();
        let readings_n = tensions
            .map(|(i, (tension_n, rubbing))| match &self.tracker {
                Some(tracker) => tracker.reading_n(i, *tension_n, *rubbing),
                None => *tension_n,
            })
            .collect();
        let drums_m = paid_out_m
            .iter()
            .zip(&self.zero_m)
            .map(|(l, z)| l - z)
            .collect();
        self.paid_out_m = paid_out_m;
        self.rest = rest;
        self.command = Command {
            drums_m,
            readings_n,
        };
        Ok(self.command.clone())
    }

    /// The way is done, and the encoders show these drum displacements, m, the sensors these tensions, N: means of the rest
    /// after what they showed on the way.
    pub(super) fn feel(&mut self, way: &[Sensed], encoders_m: &[f64], readings_n: &[f64]) {
        for seen in way {
            let pairs = seen.encoders_m.iter().zip(&self.zero_m);
            let lengths_m: Vec<f64> = pairs.map(|(drum, zero)| drum + zero).collect();
            self.pulleys
                .turn(self.model.robot(), &lengths_m, &seen.readings_n);
        }
        let pairs = encoders_m.iter().zip(&self.zero_m);
        let lengths_m: Vec<f64> = pairs.map(|(drum, zero)| drum + zero).collect();
        let robot = self.model.robot();
        self.pulleys.turn(robot, &lengths_m, readings_n);
        self.rubbing = self.pulleys.rubbing();
        self.readings_n = readings_n.to_vec();
        let pairs = lengths_m.iter().zip(&self.paid_out_m);
        self.unplanned_m = pairs.map(|(read, planned)| read - planned).collect();
        let pairs = readings_n.iter().zip(self.rest.tensions_n());
        self.unplanned_n = pairs.map(|(read, planned)| read - planned).collect();
    }

    /// Dahl's friction after a way, as the robot takes it.
    fn rubbing_after(&self, planned_m: &[f64], tensions_n: &[f64]) -> Vec<Rubbing> {
        let pairs = planned_m.iter().zip(&self.unplanned_m);
        let paid_out_m: Vec<f64> = pairs.map(|(planned, more)| planned + more).collect();
        self.pulleys
            .after(self.model.robot(), &paid_out_m, tensions_n)
    }

    /// Time passes under the tensions that the sensors show.
    pub(super) fn pass(&mut self, seconds: f64) {
        let Some(tracker) = &self.tracker else {
            return;
        };
        let felt_n: Vec<f64> = (self.readings_n.iter().zip(&self.rubbing).enumerate())
            .map(|(i, (reading_n, rubbing))| tracker.felt_n(i, *reading_n, *rubbing))
            .collect();
        for (sum, tension_n) in self.since.0.iter_mut().zip(felt_n) {
            *sum += tension_n * seconds;
        }
        self.since.1 += seconds;
    }

    /// Mean tensions since the tracker was told, N, and seconds.
    fn since(&self) -> (Vec<f64>, f64) {
        let (sums, seconds) = &self.since;
        let mean = sums.iter().map(|sum| sum / seconds.max(f64::MIN_POSITIVE));
        (mean.collect(), *seconds)
    }

    fn catch_up(&mut self) {
        let (mean_n, seconds) = self.since();
        if let (Some(tracker), true) = (&mut self.tracker, seconds > 0.0) {
            tracker.pass(seconds, &mean_n);
        }
        self.since.0.fill(0.0);
        self.since.1 = 0.0;
    }

    /// A rest: lengths from the encoders, tensions, and what the camera sees.
    pub(super) fn measure(
        &mut self,
        encoders_m: &[f64],
        readings_n: Vec<f64>,
        views: Vec<TagView>,
    ) -> Result<Option<Report>, DayError> {
        self.catch_up();
        let Some(tracker) = &mut self.tracker else {
            return Ok(None);
        };
        let lengths = encoders_m.iter().zip(&self.zero_m);
        let measured = Measurements {
            lengths_m: lengths.map(|(d, z)| d + z).collect(),
            tensions_n: readings_n,
            places: if views.is_empty() {
                Vec::new()
            } else {
                vec![self.place]
            },
            views,
        };
        let report = tracker.rest(&measured, &self.rubbing, &self.rest.equilibrium.pose);
        self.replan()?;
        Ok(Some(report))
    }

    fn replan(&mut self) -> Result<(), PlanError> {
        if let Some(tracker) = &self.tracker {
            self.model = Model::new(&tracker.robot())?.with_options(self.model.options());
        }
        Ok(())
    }

    /// The gripper closed on something.
    pub(super) fn lift(&mut self) {
        self.catch_up();
        if let Some(tracker) = &mut self.tracker {
            tracker.lift();
        }
    }

    /// The gripper opened.
    pub(super) fn set_down(&mut self) -> Result<(), PlanError> {
        self.catch_up();
        if let Some(tracker) = &mut self.tracker {
            tracker.set_down();
        }
        self.replan()
    }

    /// Where the robot believes its tool to be under the present command, with the creep since the last rest.
    pub(super) fn region(&self) -> Option<Region> {
        let tracker = self.tracker.as_ref()?;
        let commanded = Measurements {
            lengths_m: self.paid_out_m.clone(),
            tensions_n: self
                .rest
                .tensions_n()
                .iter()
                .zip(&self.command.readings_n)
                .map(|(_, reading)| *reading)
                .collect(),
            ..Measurements::default()
        };
        let (mean_n, seconds) = self.since();
        let later = tracker.later(seconds, &mean_n);
        later.region(&commanded, &self.rubbing, &self.rest.equilibrium.pose)
    }
}
