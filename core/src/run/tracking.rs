//! What a robot tracks while it works: rests and motions are given to the filter of
//! [`crate::estimate::track`], and plans follow it.

use super::Measured;
use crate::estimate::Measurements;
use crate::estimate::friction::{Friction, Frictions, Ticked};
use crate::estimate::track::{Kept, KeptError, Load, Prior, Pulleys, Rubbing, Tracker};
use crate::estimate::tube::{Belief, Doubts};
use crate::link::client::Row;
use crate::motion::{Model, PlanError};
use crate::robot::TagPlace;
use crate::sight::TagView;
use mcdpr_kinematics::Pose;
use serde::{Deserialize, Serialize};

/// A tracker with what it needs of the time between two rests.
#[derive(Debug, Clone)]
pub struct Tracking {
    tracker: Tracker,
    described: Model,
    planner: Model,
    frictions: Frictions,
    /// `None` until the first rest shows lengths.
    pulleys: Option<Pulleys>,
    /// Sum of tensions since the last rest, N, their number, and the mean at the last rest, N.
    sums_n: Vec<f64>,
    count: u32,
    last_n: Vec<f64>,
    /// The lengths were referenced anew since the states were kept: the next rest is told.
    homed: bool,
    /// When the states were last brought up to date, us of the line's clock.
    last_us: Option<u64>,
    lessons: Vec<Lesson>,
}

/// What one rest taught.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Lesson {
    /// Since the first rest, s.
    pub at_s: f64,
    /// Whether the rest fitted what was known.
    pub fits: bool,
    /// Sum of squared innovations over the value beyond which a rest is doubted.
    pub doubt: f64,
    /// Tags that were seen.
    pub tags: usize,
    /// By how much the planned tool moved, mm.
    pub step_mm: f64,
    /// What moved, in words, if one cause explains the rests that did not fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub named: Option<String>,
    /// Mass in the gripper, kg.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub load_kg: Option<f64>,
    /// Friction of each cable's winch over that of the description; `None` where none shows.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub frictions: Vec<Option<Friction>>,
}

/// A robot at rest.
#[derive(Debug, Clone, Default)]
pub struct AtRest {
    /// Time on the line's clock, us.
    pub now_us: u64,
    /// Paid-out lengths by the encoders, mean of the rest, m.
    pub lengths_m: Vec<f64>,
    /// Tensions by the sensors, mean of the rest, N.
    pub tensions_n: Vec<f64>,
    /// Tags in the camera's view, with the places of their bodies.
    pub views: Vec<TagView>,
    /// The places.
    pub places: Vec<TagPlace>,
    /// Ticks of the rest, as the board sampled them; may be empty.
    pub ticks: Vec<Row>,
}

impl Tracking {
    /// Tracks a robot from its file, or its calibration, on.
    #[must_use]
    pub fn new(described: &Model, prior: &Prior) -> Self {
        Self::of(Tracker::new(described, prior), described, described.clone())
    }

    /// Goes on from kept states, `seconds` after they were kept, with the tensions (N) that the robot was left
    /// with.
    ///
    /// # Errors
    /// [`KeptError`]; a model that cannot be made from the states counts as damaged.
    pub fn resume(
        described: &Model,
        prior: &Prior,
        kept: &Kept,
        seconds: f64,
        tensions_n: &[f64],
    ) -> Result<Self, KeptError> {
        let mut tracker = Tracker::resume(described, prior, kept)?;
        if seconds > 0.0 && tensions_n.len() == described.robot().cables.len() {
            tracker.pass(seconds, tensions_n);
        }
        let planner = tracker.model(described).map_err(|_| KeptError::Damaged {
            what: "no robot has the geometry that it states",
        })?;
        Ok(Self::of(tracker, described, planner))
    }

    fn of(tracker: Tracker, described: &Model, planner: Model) -> Self {
        Self {
            tracker,
            described: described.clone(),
            planner,
            frictions: Frictions::new(described),
            pulleys: None,
            sums_n: vec![0.0; described.robot().cables.len()],
            count: 0,
            last_n: Vec::new(),
            homed: false,
            last_us: None,
            lessons: Vec::new(),
        }
    }

    /// The lengths were referenced anew since the states were kept.
    pub fn homed(&mut self) {
        self.homed = true;
    }

    /// The same robot, as if nothing had been tracked.
    #[must_use]
    pub(super) fn anew(self) -> Self {
        let new = Self::new(&self.described, self.tracker.prior());
        // A cable that was put on anew changes no gear.
        new.with_frictions(&self.frictions.all(), 0.0)
    }

    /// The model that plans should use now.
    #[must_use]
    pub const fn model(&self) -> &Model {
        &self.planner
    }

    /// Goes on from frictions that were kept `seconds` ago; plans follow them.
    #[must_use]
    pub fn with_frictions(mut self, kept: &[Option<Friction>], seconds: f64) -> Self {
        self.frictions.resume(kept, seconds);
        self.planner = self.planner.with_friction(&self.frictions.used());
        self
    }

    /// Friction of each cable's winch relative to the description; `None` where none shows.
    #[must_use]
    pub fn frictions(&self) -> Vec<Option<Friction>> {
        self.frictions.all()
    }

    /// The described robot with the friction that was found, for the board's configuration.
    #[must_use]
    pub fn rubbing_as_found(&self, described: Model) -> Model {
        described.with_friction(&self.frictions.used())
    }

    /// The filter.
    #[must_use]
    pub const fn tracker(&self) -> &Tracker {
        &self.tracker
    }

    /// The states, to be kept.
    #[must_use]
    pub fn kept(&self) -> Kept {
        self.tracker.kept()
    }

    /// What each rest taught, in order.
    #[must_use]
    pub fn lessons(&self) -> &[Lesson] {
        &self.lessons
    }

    /// Tensions at the last rest, N; empty before the first.
    #[must_use]
    pub fn last_n(&self) -> &[f64] {
        &self.last_n
    }

    /// What is known of the machine in `seconds`, for the tube of a plan that ends then; `doubts` are those of errors that
    /// are not tracked.
    #[must_use]
    pub fn belief(&self, seconds: f64, doubts: &Doubts) -> Belief {
        let setpoint_n = self.described.robot().tension.setpoint_n;
        let tensions_n = if self.last_n.is_empty() {
            vec![setpoint_n; self.described.robot().cables.len()]
        } else {
            self.last_n.clone()
        };
        self.tracker
            .belief(seconds, &self.felt_n(&tensions_n), doubts)
    }

    /// The payload, if there is one.
    #[must_use]
    pub fn load(&self) -> Option<Load> {
        self.tracker.load()
    }

    /// Takes a motion's samples into account: which way the cables went, and what loaded them.
    pub fn moved(&mut self, samples: &[Measured]) {
        let robot = self.described.robot();
        for sample in samples {
            if let Some(pulleys) = &mut self.pulleys {
                pulleys.turn(robot, &sample.lengths_m, &sample.tensions_n);
            }
            for (sum, tension_n) in self.sums_n.iter_mut().zip(&sample.tensions_n) {
                *sum += tension_n;
            }
            self.count += 1;
            if sample.path_s.is_some() {
                let (lengths_m, tensions_n) = (&sample.lengths_m, &sample.tensions_n);
                self.frictions.take(
                    &self.described,
                    sample.tick,
                    lengths_m,
                    tensions_n,
                    &sample.currents_a,
                );
            }
        }
    }

    /// Takes a rest into account; `near` is about how the platform hangs. The plans' model follows it.
    ///
    /// # Errors
    /// [`PlanError`] where the states leave no valid geometry; the model is that of before then.
    pub fn rest(&mut self, rest: AtRest, near: &Pose) -> Result<Lesson, PlanError> {
        let seconds = self.seconds_to(rest.now_us);
        let mean_n = self.mean_n(&rest.tensions_n);
        if seconds > 0.0 {
            self.tracker.pass(seconds, &self.felt_n(&mean_n));
        }
        if std::mem::take(&mut self.homed) {
            self.tracker.homed(&rest.lengths_m);
        }
        let robot = self.described.robot();
        let by_encoders = || Pulleys::by_encoders(robot, &rest.lengths_m, &rest.tensions_n);
        let pulleys = self.pulleys.get_or_insert_with(by_encoders);
        pulleys.turn(robot, &rest.lengths_m, &rest.tensions_n);
        let rubbing = pulleys.rubbing();
        let ticks: Vec<Ticked<'_>> = rest.ticks.iter().map(ticked).collect();
        self.frictions.rested(&self.described, &ticks, seconds);
        let tags = rest.views.len();
        let measured = Measurements {
            lengths_m: rest.lengths_m,
            tensions_n: rest.tensions_n,
            views: rest.views,
            places: rest.places,
        };
        let tool_m = |model: &Model| -> Option<nalgebra::Vector3<f64>> {
            let at = model.rest_from_lengths(&measured.lengths_m, &measured.tensions_n);
            at.ok().map(|at| model.tool_m(&at))
        };
        let before_m = tool_m(&self.planner);
        let report = self.tracker.rest(&measured, &rubbing, near);
        self.planner = self.follow()?;
        let after_m = tool_m(&self.planner);
        let step_mm = before_m
            .zip(after_m)
            .map_or(0.0, |(a, b)| (b - a).norm() * 1e3);
        self.last_n.clone_from(&measured.tensions_n);
        let at_s = self.lessons.last().map_or(0.0, |last| last.at_s);
        let lesson = Lesson {
            at_s: at_s + seconds,
            fits: report.fits,
            doubt: report.doubt,
            tags,
            step_mm,
            named: report.named.map(|named| named.words()),
            load_kg: self.tracker.load().map(|load| load.mass_kg),
            frictions: self.frictions.all(),
        };
        self.lessons.push(lesson.clone());
        Ok(lesson)
    }

    /// The model that the states describe.
    fn follow(&self) -> Result<Model, PlanError> {
        let model = self.tracker.model(&self.described)?;
        Ok(model.with_friction(&self.frictions.used()))
    }

    /// Seconds since the last rest, now taken into account.
    fn seconds_to(&mut self, now_us: u64) -> f64 {
        let last_us = self.last_us.replace(now_us).unwrap_or(now_us);
        now_us.saturating_sub(last_us) as f64 * 1e-6
    }

    /// What the platform feels while the sensors show this, N; the friction of pulleys cancels out on a way.
    fn felt_n(&self, readings_n: &[f64]) -> Vec<f64> {
        let free = Rubbing {
            side: 0.0,
            unsure: 0.0,
        };
        let pairs = readings_n.iter().enumerate();
        pairs
            .map(|(cable, shown_n)| self.tracker.felt_n(cable, *shown_n, free))
            .collect()
    }

    /// Mean of the tensions since the last rest, N: they make the cables creep. Without a motion those of now.
    fn mean_n(&mut self, now_n: &[f64]) -> Vec<f64> {
        let count = std::mem::take(&mut self.count);
        let sums_n = std::mem::replace(&mut self.sums_n, vec![0.0; now_n.len()]);
        if count == 0 {
            return now_n.to_vec();
        }
        sums_n.iter().map(|sum| sum / f64::from(count)).collect()
    }

    /// The gripper took something: its mass and centre are estimated from the next rest on.
    pub fn lift(&mut self) {
        self.tracker.lift();
    }

    /// The gripper let go.
    ///
    /// # Errors
    /// As [`Self::rest`].
    pub fn set_down(&mut self) -> Result<(), PlanError> {
        self.tracker.set_down();
        self.planner = self.follow()?;
        Ok(())
    }
}

/// What shows friction.
fn ticked(row: &Row) -> Ticked<'_> {
    Ticked {
        tensions_n: &row.tensions_n,
        currents_a: &row.currents_a,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    /// A machine whose cables are all longer by `strain`.
    fn machine_of(model: &Model, strain: f64) -> Model {
        let drift = crate::motion::Drift {
            strain,
            ..crate::motion::Drift::default()
        };
        model
            .clone()
            .with_drift(&vec![drift; model.robot().cables.len()])
    }

    /// A rest at home of such a machine.
    fn rest_of(model: &Model, strain: f64, now_us: u64) -> (AtRest, Pose) {
        let machine = machine_of(model, strain);
        let rest = machine.rest_at_home().unwrap();
        let at_rest = AtRest {
            now_us,
            lengths_m: rest.paid_out_m.clone(),
            tensions_n: rest.tensions_n().to_vec(),
            ..AtRest::default()
        };
        (at_rest, rest.equilibrium.pose)
    }

    /// A sensor that is known to show 5 N too much makes its cable creep by what the platform feels.
    #[test]
    fn cables_creep_by_what_the_platform_feels() {
        let model = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
        let crept = |zero_n: f64| {
            let kept = Tracking::new(&model, &Prior::default()).kept();
            let mut kept = serde_json::to_value(&kept).unwrap();
            // The fourth state of the first cable is its sensor's zero.
            kept["planned"][3] = zero_n.into();
            let kept: Kept = serde_json::from_value(kept).unwrap();
            let mut tracking =
                Tracking::resume(&model, &Prior::default(), &kept, 0.0, &[]).unwrap();
            for seconds in [0, 600] {
                let (mut rest, pose) = rest_of(&model, 0.0, seconds * 1_000_000);
                rest.tensions_n[0] += zero_n;
                // So far off that it teaches nothing: only time passes.
                rest.lengths_m[1] += 0.05;
                assert!(!tracking.rest(rest, &pose).unwrap().fits);
            }
            let prior = Prior::default();
            tracking.tracker().estimates(&prior).cables[0].strain.value
        };
        let (exact, shown) = (crept(0.0), crept(5.0));
        assert!(
            exact > 1e-4 && (shown / exact - 1.0).abs() < 1e-9,
            "{exact} {shown}"
        );
    }

    #[test]
    fn plans_close_with_the_lengths_of_the_last_rest() {
        for name in ["lab-fast", "eight-cable"] {
            let model = Model::new(&Robot::built_in(name).unwrap()).unwrap();
            let prior = Prior {
                step_m: 1.0,
                length_m: 3e-4,
                ..Prior::default()
            };
            let mut tracking = Tracking::new(&model, &prior);
            let mut before: Option<(Vec<f64>, Vec<f64>)> = None;
            for second in 0..4_u64 {
                let strain = 1e-4 * (second as f64);
                let (rest, pose) = rest_of(&model, strain, second * 20_000_000);
                let lengths_m = rest.lengths_m.clone();
                let tensions_n = rest.tensions_n.clone();
                let lesson = tracking.rest(rest, &pose).unwrap();
                let at = tracking
                    .model()
                    .rest_from_lengths(&lengths_m, &tensions_n)
                    .unwrap();
                assert!(lesson.fits, "{lesson:?}");
                // As well as an encoder counts: 30 um.
                for (plan, read) in at.paid_out_m.iter().zip(&lengths_m) {
                    assert!((plan - read).abs() < 3e-5, "{name}: {plan} {read}");
                }
                // About as far as the tool of the machine of now hangs off under the lengths of the rest before.
                if let Some((lengths_m, tensions_n)) = &before {
                    let hangs = machine_of(&model, strain).rest_from_lengths(lengths_m, tensions_n);
                    let off = model.tool_m(&hangs.unwrap()) - model.robot().tool.home_in_world_m;
                    let share = lesson.step_mm / (off.norm() * 1e3);
                    assert!((0.5..1.6).contains(&share), "{name}: {share}");
                }
                before = Some((lengths_m, tensions_n));
            }
        }
    }

    #[test]
    fn a_homing_since_the_state_was_kept_is_no_slip_of_all_cables() {
        let model = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
        let prior = Prior::default();
        let mut tracking = Tracking::new(&model, &prior);
        for second in 0..6_u64 {
            // Within two minutes each cable creeps by 1.3 mm.
            let (rest, pose) = rest_of(&model, 2e-4 * second as f64, second * 20_000_000);
            assert!(tracking.rest(rest, &pose).unwrap().fits);
        }
        let kept = tracking.kept();
        // Homed: the encoders show the lengths of the description again.
        let doubt = |homed: bool| {
            let mut tracking = Tracking::resume(&model, &prior, &kept, 0.0, &[]).unwrap();
            if homed {
                tracking.homed();
            }
            let (rest, pose) = rest_of(&model, 0.0, 0);
            tracking.rest(rest, &pose).unwrap().doubt
        };
        assert!(
            doubt(true) < 0.2 * doubt(false),
            "{} {}",
            doubt(true),
            doubt(false)
        );
    }

    #[test]
    fn plans_follow_the_friction_of_the_last_motion() {
        let model = Model::new(&Robot::built_in("paper-table5").unwrap()).unwrap();
        let mut tracking = Tracking::new(&model, &Prior::default());
        let winch = model.robot().winch_of(3).unwrap();
        let gear = *winch.gear.as_ref().unwrap();
        let (rest, pose) = rest_of(&model, 0.0, 0);
        // Cable 4 is reeled in at 20 mm/s by a motor that gives its load and 15 N of friction, as much as the file says and
        // half as much again.
        let per_rpm = winch.max_cable_speed_mps() / winch.max_motor_rpm;
        let viscous_n =
            gear.viscous_nm_per_rpm * 0.02 / per_rpm * winch.gear_ratio / winch.drum_radius_m;
        let rubs_n = 1.5 * (winch.total_friction_n() - winch.friction_n) + viscous_n;
        let motor_n = (rest.tensions_n[3] + winch.friction_n) / gear.efficiency + rubs_n;
        let samples: Vec<Measured> = (0..3000)
            .map(|tick| Measured {
                tick,
                path_s: Some(f64::from(tick) * 1e-3),
                lengths_m: rest
                    .lengths_m
                    .iter()
                    .map(|l| l - f64::from(tick) * 2e-5)
                    .collect(),
                tensions_n: rest.tensions_n.clone(),
                currents_a: vec![-motor_n / winch.force_per_current_n_per_a(); 4],
            })
            .collect();
        tracking.moved(&samples);
        let _ = tracking.rest(rest, &pose).unwrap();
        let rubs_nm = |model: &Model, cable: usize| {
            let gear = model.robot().winch_of(cable).unwrap().gear.unwrap();
            gear.rotor_friction_nm + gear.gear_friction_nm
        };
        let share = |of: &Model, cable: usize| rubs_nm(of, cable) / rubs_nm(&model, cable);
        let configured = tracking.rubbing_as_found(model.clone());
        for of in [tracking.model(), &configured] {
            assert!((share(of, 3) - 1.5).abs() < 0.05, "{}", share(of, 3));
            // Nothing is known of the winches that are held by length.
            assert!((share(of, 0) - 1.0).abs() < 1e-12);
        }
    }
}
