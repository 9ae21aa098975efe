//! The robot as picking uses it: move, close, weigh.

mod loads;

use super::PickError;
use crate::control::Handle;
use crate::estimate::{Measurements, Sigmas, estimate};
use crate::link::{Client, Link, Note, meanwhile};
use crate::machine;
use crate::motion::path::Path;
use crate::motion::{Model, Plan, PlanError, StaticState, Step};
use crate::recovery::{Journal, JournalError, load};
use crate::report::PathPoint;
use crate::run::tracking::Tracking;
use crate::run::{self, Measured, Recorder, ResumeError, RunError};
use crate::sight::Shown;
use mcdpr_protocol::{ConfigHash, Knot, Request, SessionId, Status};
use nalgebra::{Isometry3, Vector3};

/// An armed robot on a line.
pub struct Arm<L: Link> {
    client: Client<L>,
    model: Model,
    hash: ConfigHash,
    tool_m: Vector3<f64>,
    carried_kg: f64,
    keep: bool,
    samples: Vec<Measured>,
    planned: Vec<PathPoint>,
    began_us: u64,
    tracking: Option<Tracking>,
    /// The load has changed since the last motion: the next plan's start may differ from what the board holds.
    load_changed: bool,
    /// The last rest fitted what is tracked.
    load_known: bool,
}

/// Deviation of a planned tension due to swing and friction, N.
const SPARE_N: f64 = 0.8;
/// Lengths are averaged over this time, s.
const SWING_S: f64 = 0.6;
/// Readings in that time.
const SWING_READINGS: u32 = 15;
/// Closure error of the lengths that an uncalibrated frame explains, m; more is a slip.
const FRAME_GAP_M: f64 = 0.012;
/// Without a calibration a move is split into legs of this length at most, m: over 0.2 m the
/// frame's error alone reaches that of a slip, 4 mm.
const LEG_MAX_M: f64 = 0.1;
/// Polling interval for a picture, us.
const ASK_US: u64 = 4_000;
/// Shorter moves are skipped, m.
const NO_WAY_M: f64 = 1e-6;

impl<L: Link> Arm<L> {
    /// Connects, configures, references (the robot hangs at home unless the board knows better)
    /// and arms.
    ///
    /// # Errors
    /// As any run.
    pub fn start(
        model: Model,
        link: L,
        session: SessionId,
        handle: &Handle,
    ) -> Result<Self, PickError> {
        Self::open(model, link, session, handle, |_, _, _| Ok(0.0))
    }

    /// As [`Self::start`], after a loss of power that interrupted picking; `hash` is the checksum of the
    /// task. Also returns whether the jaws were closed before.
    ///
    /// # Errors
    /// As [`Self::start`]; [`ResumeError`] where the journal is not valid or not of an interrupted picking,
    /// [`PickError::NotReferenced`] where the board has lost its lengths. Nothing has moved then.
    pub(crate) fn resume(
        model: Model,
        link: L,
        session: SessionId,
        handle: &Handle,
        hash: u32,
        journal: impl FnOnce(&str) -> Result<Journal, JournalError>,
    ) -> Result<(Self, bool), PickError> {
        let mut was_closed = false;
        let arm = Self::open(model, link, session, handle, |board, status, model| {
            let journal = journal(board).map_err(ResumeError::Journal);
            let journal = journal.map_err(RunError::from)?;
            super::resume::check(&journal, hash).map_err(RunError::from)?;
            if !status.referenced {
                return Err(PickError::NotReferenced);
            }
            was_closed = journal.last.is_some_and(|last| last.gripper_closed);
            let (lengths_m, tensions_n) = (lengths(status), tensions(status));
            Ok(load::in_jaws_kg(model, status, &lengths_m, &tensions_n))
        })?;
        Ok((arm, was_closed))
    }

    /// `check` gets the number of the board and its state, and returns the mass in the jaws, kg.
    fn open(
        model: Model,
        link: L,
        session: SessionId,
        handle: &Handle,
        check: impl FnOnce(&str, &Status, &Model) -> Result<f64, PickError>,
    ) -> Result<Self, PickError> {
        let mut client = Client::connect(link, session).map_err(RunError::from)?;
        client.obey(handle.clone());
        let hash = run::configure(&mut client, model.robot())?;
        let status = run::status(&mut client)?;
        if let Some(record) = status.fault {
            return Err(RunError::Latched { record }.into());
        }
        let board = run::saved::board_name(client.hello());
        let carried_kg = check(&board, &status, &model)?;
        let model = if carried_kg > 0.0 {
            load::loaded(&model, carried_kg)?
        } else {
            model
        };
        let (start, lengths_m) = if status.referenced {
            let lengths_m = lengths(&status);
            (
                model.rest_from_lengths(&lengths_m, &tensions(&status))?,
                lengths_m,
            )
        } else {
            let home = model.rest_at_home()?;
            let calibrated = model.robot().calibrated.as_ref();
            let lengths_m = calibrated.map_or_else(
                || home.paid_out_m.clone(),
                |calibrated| calibrated.home_lengths_m.clone(),
            );
            (home, lengths_m)
        };
        let tensions_n = machine::expected_n(model.robot(), start.tensions_n());
        client
            .request(machine::reference(&lengths_m, &tensions_n))
            .map_err(RunError::from)?;
        run::arm(&mut client, hash)?;
        let tool_m = model.tool_m(&start);
        let began_us = client.now_us();
        Ok(Self {
            client,
            model,
            hash,
            tool_m,
            carried_kg,
            keep: false,
            samples: Vec::new(),
            planned: Vec::new(),
            began_us,
            tracking: None,
            load_changed: false,
            load_known: false,
        })
    }

    /// From now on keeps the board's samples and the planned tool positions.
    pub(crate) const fn keep_samples(&mut self) {
        self.keep = true;
    }

    /// The board's samples since `Arm::keep_samples`, times from the start.
    #[must_use]
    pub fn samples(&self) -> &[Measured] {
        &self.samples
    }

    /// Planned tool positions since `Arm::keep_samples`.
    #[must_use]
    pub fn planned(&self) -> &[PathPoint] {
        &self.planned
    }

    /// Shows a picture to the observers of the line.
    pub fn show(&mut self, picture: &Shown) {
        self.client.note(Note::Picture(picture));
    }

    /// The robot model used for planning.
    #[must_use]
    pub const fn model(&self) -> &Model {
        &self.model
    }

    /// The last commanded tool position, world, m.
    #[must_use]
    pub const fn tool_m(&self) -> Vector3<f64> {
        self.tool_m
    }

    /// Time on the link's clock since it was armed, s.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        (self.client.now_us() - self.began_us) as f64 * 1e-6
    }

    /// How the robot hangs, from the board's measurements over `SWING_S`: about a period of its
    /// slowest swing. All lengths and all tensions are used, each with its standard deviation: the
    /// pulley friction of a single tension would shift a pose that is found from it alone by
    /// millimetres.
    ///
    /// # Errors
    /// The line's; if no pose fits.
    pub fn state(&mut self) -> Result<StaticState, PickError> {
        let count = self.model.robot().cables.len();
        let (mut lengths_m, mut tensions_n) = (vec![0.0; count], vec![0.0; count]);
        let share = 1.0 / f64::from(SWING_READINGS);
        for _ in 0..SWING_READINGS {
            self.wait(SWING_S * share)?;
            let status = run::status(&mut self.client)?;
            for (sum, length_m) in lengths_m.iter_mut().zip(lengths(&status)) {
                *sum += length_m * share;
            }
            for (sum, tension_n) in tensions_n.iter_mut().zip(tensions(&status)) {
                *sum += tension_n * share;
            }
        }
        let measured = Measurements {
            lengths_m,
            tensions_n,
            ..Measurements::default()
        };
        let (model, near) = (&self.model, &self.tool_m);
        let found = meanwhile(&mut self.client, || {
            estimate(model, &measured, &Sigmas::default(), near)
        });
        let found = found.map_err(RunError::from)?;
        Ok(found.map_err(RunError::from)?.rest)
    }

    /// The platform's pose now, world_from_platform.
    ///
    /// # Errors
    /// As [`Arm::state`].
    pub fn world_from_platform(&mut self) -> Result<Isometry3<f64>, PickError> {
        Ok(isometry(&self.state()?))
    }

    /// Whether the robot can move along these points from its present position, with every tension
    /// within its limit and a margin: judged, not executed.
    ///
    /// # Errors
    /// The first limit that would be broken.
    pub fn judge(&mut self, points_m: &[Vector3<f64>]) -> Result<(), PickError> {
        let at_m = self.tool_m;
        let judged =
            self.meanwhile(|model| plan(&with_spare(model), at_m, points_m).map(|_| ()))?;
        Ok(judged?)
    }

    /// Does work with the robot's model while the board is kept fed.
    ///
    /// # Errors
    /// The line's.
    pub(crate) fn meanwhile<T: Send>(
        &mut self,
        work: impl FnOnce(&Model) -> T + Send,
    ) -> Result<T, PickError> {
        let model = &self.model;
        let done = meanwhile(&mut self.client, || work(model));
        Ok(done.map_err(RunError::from)?)
    }

    /// Repeats a question until there is an answer, while the board is kept fed.
    ///
    /// # Errors
    /// The line's; a stop that was asked for.
    pub fn until<T>(&mut self, mut ask: impl FnMut() -> Option<T>) -> Result<T, PickError> {
        loop {
            if let Some(answer) = ask() {
                return Ok(answer);
            }
            if let Some(kind) = run::stop_wanted(&self.client) {
                return Err(run::stop_now(&mut self.client, kind).into());
            }
            let next = self.client.now_us() + ASK_US;
            self.client.pump(next).map_err(RunError::from)?;
        }
    }

    /// Moves the tool straight from point to point (world, m), with a rest at each.
    ///
    /// # Errors
    /// Before anything moves, the first limit that would be broken; then those of a run.
    pub fn go(&mut self, points_m: &[Vector3<f64>]) -> Result<(), PickError> {
        if self.model.robot().calibrated.is_some() {
            return self.go_at_once(points_m);
        }
        // The closure error of a frame without a calibration is measured at every rest.
        for leg in legs(self.tool_m, points_m) {
            self.go_at_once(&[leg])?;
        }
        Ok(())
    }

    fn go_at_once(&mut self, points_m: &[Vector3<f64>]) -> Result<(), PickError> {
        let at_m = self.tool_m;
        let plan = self.meanwhile(|model| plan(model, at_m, points_m))??;
        self.follow(plan, points_m)
    }

    /// Follows a plan that ends at the last of some points; there is none if there is no way.
    fn follow(&mut self, plan: Option<Plan>, points_m: &[Vector3<f64>]) -> Result<(), PickError> {
        let Some(plan) = plan else {
            return Ok(());
        };
        let mut status = run::status(&mut self.client)?;
        if std::mem::take(&mut self.load_changed)
            && let Some(way) = run::settling(&plan, &status, &self.model)
        {
            run::follow(&mut self.client, &way, &mut Recorder::default(), |_| {})?;
            status = run::status(&mut self.client)?;
        }
        let mut knots = run::joined_to(&plan, &status, &self.model)?;
        self.close_at_rest(&mut knots, &status);
        self.client.note(Note::Plan(&plan));
        let mut recorder = Recorder::default();
        let from_s = self.time_s();
        let followed = run::follow(&mut self.client, &knots, &mut recorder, |_| {});
        followed.map_err(|error| self.explain(error))?;
        if let Some(tracking) = &mut self.tracking {
            tracking.moved(&recorder.samples);
        }
        if let Some(last) = points_m.last() {
            self.tool_m = *last;
        }
        if self.keep {
            let duration_s = plan.timed.duration_s();
            let mut t = 0.0;
            while t <= duration_s {
                self.planned.push(PathPoint {
                    path_s: from_s + t,
                    tool_m: plan.timed.tool_m(t)?.into(),
                });
                t += 0.01;
            }
            self.samples
                .extend(recorder.samples.into_iter().map(|sample| Measured {
                    path_s: sample.path_s.map(|path_s| path_s + from_s),
                    ..sample
                }));
        }
        Ok(())
    }

    /// The length of the tension-held cable follows from the others; this is how the board detects
    /// a slip (S5). If the frame was only measured by tape, it does not follow accurately enough:
    /// the error while the robot rests is then attributed to the frame, and a further error during
    /// the move to a slip.
    fn close_at_rest(&self, knots: &mut [Knot], status: &Status) {
        if self.model.robot().calibrated.is_some() {
            return;
        }
        let Some(held) = self.model.holding().first_by_tension() else {
            return;
        };
        let start = knots.first().and_then(|knot| knot.cables.get(held));
        let Some(gap) = start
            .zip(status.lengths.get(held))
            .map(|(cable, measured)| measured.0 - cable.length.0)
        else {
            return;
        };
        // Lengths on the wire are in 0.1 um: 12 mm are 120 000 of them.
        if f64::from(gap).abs() * 1e-7 > FRAME_GAP_M {
            return;
        }
        for cable in knots
            .iter_mut()
            .filter_map(|knot| knot.cables.get_mut(held))
        {
            cable.length.0 += gap;
        }
    }

    /// Waits, s.
    ///
    /// # Errors
    /// The line's; a fault that the board latches meanwhile.
    pub fn wait(&mut self, seconds: f64) -> Result<(), PickError> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "some seconds"
        )]
        let until = self.client.now_us() + (seconds.max(0.0) * 1e6) as u64;
        while self.client.now_us() < until {
            if let Some(kind) = run::stop_wanted(&self.client) {
                return Err(run::stop_now(&mut self.client, kind).into());
            }
            // In slices of 50 ms: a stop that is asked for waits no longer.
            let next = until.min(self.client.now_us() + 50_000);
            self.client.pump(next).map_err(RunError::from)?;
        }
        if let Some(record) = run::status(&mut self.client)?.fault {
            return Err(self.explain(RunError::Fault { record, why: None }));
        }
        Ok(())
    }

    fn explain(&mut self, error: RunError) -> PickError {
        run::explained(&mut self.client, &self.model, error).into()
    }

    /// Opens or closes the gripper and waits until it has finished; returns whether its switch
    /// reports that the jaws met.
    ///
    /// # Errors
    /// The line's.
    pub fn grip(&mut self, closed: bool) -> Result<bool, PickError> {
        self.client
            .request(Request::Gripper { closed })
            .map_err(RunError::from)?;
        let close_s = self.model.robot().gripper.close_s;
        self.wait(close_s + 0.15)?;
        Ok(run::status(&mut self.client)?.gripper_switch)
    }

    /// Whether the gripper is commanded closed.
    ///
    /// # Errors
    /// The line's.
    pub(crate) fn gripper_closed(&mut self) -> Result<bool, PickError> {
        Ok(run::status(&mut self.client)?.gripper_closed)
    }

    /// Closes brakes, switches off, returns the line.
    ///
    /// # Errors
    /// The line's.
    pub fn finish(mut self) -> Result<L, PickError> {
        run::disarm(&mut self.client)?;
        Ok(self.client.into_link())
    }

    /// Hash of the configuration in use.
    #[must_use]
    pub const fn config_hash(&self) -> ConfigHash {
        self.hash
    }

    /// Whether the board is simulated.
    #[must_use]
    pub fn simulated(&self) -> bool {
        self.client.info().simulated
    }
}

/// The same robot with limits of tension that are closer by [`SPARE_N`].
fn with_spare(model: &Model) -> Model {
    model.clone().with_limits(|limits| {
        limits.tension_min_n += SPARE_N;
        limits.tension_max_n -= SPARE_N;
    })
}

/// The plan of straight moves from point to point; `None` if there is no distance to move.
fn plan(
    model: &Model,
    from_m: Vector3<f64>,
    points_m: &[Vector3<f64>],
) -> Result<Option<Plan>, PlanError> {
    let mut at = from_m;
    let mut steps = Vec::new();
    for point in points_m {
        if (point - at).norm() < NO_WAY_M {
            continue;
        }
        let path = Path::through(&[at, *point])?;
        steps.push(Step::Move {
            path,
            duration_s: None,
            speed_mps: None,
        });
        at = *point;
    }
    if steps.is_empty() {
        return Ok(None);
    }
    Ok(Some(Plan::new(model, &from_m, &steps)?))
}

/// Points on the straight lines to some points, no further apart than [`LEG_MAX_M`].
fn legs(mut at_m: Vector3<f64>, points_m: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let mut legs = Vec::new();
    for point in points_m {
        let way = point - at_m;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a small number"
        )]
        // At least one: a way without length is a leg too, which the plan leaves out.
        let count = (way.norm() / LEG_MAX_M).ceil().max(1.0) as u32;
        legs.extend((1..=count).map(|k| at_m + way * (f64::from(k) / f64::from(count))));
        at_m = *point;
    }
    legs
}

fn lengths(status: &Status) -> Vec<f64> {
    status.lengths_m().collect()
}

fn tensions(status: &Status) -> Vec<f64> {
    let newtons = status.tensions_n();
    newtons.collect()
}

/// world_from_platform of a resting state.
pub(super) fn isometry(rest: &StaticState) -> Isometry3<f64> {
    rest.equilibrium.pose.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn legs_are_short_and_end_where_the_way_does() {
        let (a, b) = (
            Vector3::new(0.0, 0.0, -0.25),
            Vector3::new(0.05, 0.0, -0.25),
        );
        let legs = legs(Vector3::zeros(), &[a, b]);
        assert_eq!(legs.len(), 4);
        assert_eq!((legs[2], legs[3]), (a, b));
        let mut at = Vector3::zeros();
        for leg in legs {
            assert!((leg - at).norm() <= LEG_MAX_M);
            at = leg;
        }
    }
}
