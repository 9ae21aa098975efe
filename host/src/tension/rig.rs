//! Rigging: winding cable onto a drum, taking up slack evenly, tensioning, lowering. Every cable is
//! held by its tension meanwhile, so that no drum pulls harder than commanded; every step is slow,
//! monitored by the board, and can be undone by its opposite.

use crate::link::{Client, Link};
use crate::machine;
use crate::motion::knot;
use crate::robot::{Control, LawKind, Robot, TensionLaw, TensionOutput, Winch};
use crate::run::{self, Recorder, RunError};
use mcdpr_protocol::{CableKnot, SessionId};

/// Tension at which a cable counts as taken up, N: enough to lie in its pulleys.
pub(crate) const TAKEN_UP_N: f64 = 1.0;
/// Below this tension a cable of a robot that is being rigged is reeled in, N.
const FLOOR_N: f64 = 0.5;
/// Rate at which tensions rise and fall, N/s.
const RATE_NPS: f64 = 2.0;
/// Gain of a law that commands a speed where the robot file has one for currents, mm/s per N: the file's own gains are
/// for another unit.
const SPEED_PER_N: f64 = 1.0;
/// Longest time that the board lets a slack cable be reeled in at a stretch, s (C1 after 2 s).
const STRETCH_S: f64 = 1.5;
/// Snag guard while a free cable is wound, N.
const SNAG_N: f64 = 5.0;

/// The robot with all cables held by their tension and slack allowed.
#[must_use]
pub(crate) fn rigged(robot: &Robot) -> Robot {
    let mut robot = robot.clone();
    for cable in &mut robot.cables {
        cable.control = Control::Tension;
    }
    robot.tension.law = LawKind::Default;
    robot.tension.hold_braked = false;
    // Also of a robot whose own tension-held drum has no gear: here every drum is held by its tension.
    if robot.tension.output == TensionOutput::Current
        && robot.winches.iter().any(Winch::has_lossy_gear)
    {
        robot.tension = TensionLaw {
            output: TensionOutput::Velocity,
            kp: SPEED_PER_N,
            kd: 0.0,
            ki: 0.0,
            ..robot.tension
        };
    }
    robot.limits.tension_min_n = FLOOR_N;
    // Four fifths of this are compensated: all of it, because a drum with a slack cable is driven
    // only by its motor when the board checks whether it turns.
    for winch in &mut robot.winches {
        winch.friction_n *= 1.25;
    }
    robot
}

/// The same for a hanging robot that is let down: without floors, because every cable ends slack. Behind a gear the
/// board then also moves each drum further when it arms: with all cables taut, the small test motion ends in the
/// friction and the loss of the gear. A broken cable is still noticed before the brakes open, by the tensions that are
/// expected (S10).
#[must_use]
pub(crate) fn lowered(robot: &Robot) -> Robot {
    let mut robot = rigged(robot);
    robot.limits.tension_min_n = 0.0;
    robot
}

/// The robot with one cable wound by length and the others passive, a sensitive snag guard on all.
#[must_use]
pub(crate) fn winding(robot: &Robot, cable: usize) -> Robot {
    let mut robot = rigged(robot);
    if let Some(wound) = robot.cables.get_mut(cable) {
        wound.control = Control::Position;
    }
    // No floor: the cable's end is free.
    robot.limits.tension_min_n = 0.0;
    robot.limits.tension_max_n = robot.limits.tension_max_n.min(SNAG_N);
    robot
}

/// A robot that is being rigged: armed, all cables under the control of their tension.
pub struct Rig<L: Link> {
    client: Client<L>,
    lengths_m: Vec<f64>,
    tensions_n: Vec<f64>,
}

impl<L: Link> Rig<L> {
    /// Arms a robot for rigging. `lengths_m` are approximate; `tensions_n` are the present
    /// tensions: zero if slack. The board compares them with its sensors (S10).
    ///
    /// # Errors
    /// As a run.
    pub fn start(
        robot: &Robot,
        link: L,
        session: SessionId,
        lengths_m: &[f64],
        tensions_n: &[f64],
    ) -> Result<Self, RunError> {
        let mut client = Client::connect(link, session)?;
        let hash = run::configure(&mut client, robot)?;
        if let Some(record) = run::status(&mut client)?.fault {
            return Err(RunError::Latched { record });
        }
        client.request(machine::reference(lengths_m, tensions_n))?;
        run::arm(&mut client, hash)?;
        // Motions start at the board's present lengths, by its encoders.
        let held = run::status(&mut client)?.setpoints;
        Ok(Self {
            client,
            lengths_m: held.iter().map(|l| l.metres()).collect(),
            tensions_n: tensions_n.to_vec(),
        })
    }

    /// Measured tensions, N.
    ///
    /// # Errors
    /// The client's, or the fault that the board has latched.
    pub(crate) fn measured_n(&mut self) -> Result<Vec<f64>, RunError> {
        let status = run::status(&mut self.client)?;
        if let Some(record) = status.fault {
            return Err(RunError::Fault { record, why: None });
        }
        let tensions = status.tensions.iter();
        Ok(tensions.map(|t| t.newtons()).collect())
    }

    /// Reels cables in slowly until each has `TAKEN_UP_N`, at most `stretches` times a second and a
    /// half; the first ones wait for the last. All cables, or `only` one (from 0) while the others
    /// stay slack. `watch` is called with the tensions now and then.
    ///
    /// # Errors
    /// A fault; cables that are still slack at the end are visible in the returned tensions.
    pub fn take_up(
        &mut self,
        only: Option<usize>,
        stretches: usize,
        mut watch: impl FnMut(&[f64]),
    ) -> Result<Vec<f64>, RunError> {
        let wanted = |cable: usize| only.is_none_or(|only| only == cable);
        let up: Vec<f64> = (0..self.tensions_n.len())
            .map(|cable| if wanted(cable) { TAKEN_UP_N } else { 0.0 })
            .collect();
        for _ in 0..stretches {
            let now = self.measured_n()?;
            watch(&now);
            let taken = |(cable, &n): (usize, &f64)| !wanted(cable) || n > 0.7 * TAKEN_UP_N;
            if now.iter().enumerate().all(taken) {
                return Ok(now);
            }
            // A set-point below the floor for a moment restarts the board's time limit for slack.
            let each = now.iter().enumerate().zip(&up);
            let low: Vec<f64> = each
                .map(|(now, &up)| if taken(now) { up } else { 0.0 })
                .collect();
            self.go(&[(0.05, low), (0.01, up.clone()), (STRETCH_S, up.clone())])?;
        }
        let now = self.measured_n()?;
        watch(&now);
        Ok(now)
    }

    /// Brings all tensions to `tensions_n` together, at 2 N/s for the one with the largest change.
    ///
    /// # Errors
    /// A fault.
    pub fn tension(&mut self, tensions_n: &[f64]) -> Result<Vec<f64>, RunError> {
        let ways = self.tensions_n.iter().zip(tensions_n);
        let longest = ways.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let duration_s = (longest / RATE_NPS).max(0.1);
        self.go(&[
            (duration_s, tensions_n.to_vec()),
            (0.5, tensions_n.to_vec()),
        ])?;
        self.measured_n()
    }

    /// Winds a cable that is held by its length, in for negative `by_m`, at no more than
    /// `speed_mps`.
    ///
    /// # Errors
    /// A fault: a snag stops at 5 N.
    pub(crate) fn wind(&mut self, cable: usize, by_m: f64, speed_mps: f64) -> Result<(), RunError> {
        // A cubic from rest to rest peaks at one and a half times its mean speed.
        let duration_s = (1.5 * by_m.abs() / speed_mps).max(0.2);
        if let Some(length) = self.lengths_m.get_mut(cable) {
            *length += by_m;
        }
        let tensions = self.tensions_n.clone();
        self.go(&[(duration_s, tensions)])?;
        Ok(())
    }

    /// Closes the brakes under torque and ends the session.
    ///
    /// # Errors
    /// The client's.
    pub fn finish(mut self) -> Result<(), RunError> {
        run::disarm(&mut self.client)
    }

    /// Moves one cable's set-point through stages of duration (s) and level (N); returns its
    /// measured tension, N, one sample per millisecond.
    ///
    /// # Errors
    /// A fault.
    pub fn step(&mut self, cable: usize, stages: &[(f64, f64)]) -> Result<Vec<f64>, RunError> {
        let with = |level: f64| {
            let mut tensions = self.tensions_n.clone();
            if let Some(tension) = tensions.get_mut(cable) {
                *tension = level;
            }
            tensions
        };
        let stages: Vec<_> = stages.iter().map(|&(t, level)| (t, with(level))).collect();
        let recorder = self.go(&stages)?;
        let moving = recorder.samples.iter().filter(|s| s.path_s.is_some());
        let tensions = moving.filter_map(|sample| sample.tensions_n.get(cable));
        Ok(tensions.copied().collect())
    }

    /// Goes through tensions, each reached within its time, at rest at the end of each.
    fn go(&mut self, stages: &[(f64, Vec<f64>)]) -> Result<Recorder, RunError> {
        let status = run::status(&mut self.client)?;
        let begin_m: Vec<f64> = status.setpoints_m().collect();
        let whole_s: f64 = stages.iter().map(|(duration_s, _)| duration_s).sum();
        let mut knots = Vec::new();
        let mut add = |time_s: f64, tensions: &[f64]| {
            let share = time_s / whole_s.max(1e-9);
            let lengths = begin_m
                .iter()
                .zip(&self.lengths_m)
                .map(|(a, b)| a + share * (b - a));
            let cables = lengths
                .zip(tensions)
                .map(|(length_m, &n)| CableKnot::from_si(length_m, 0.0, n.max(0.0)));
            knots.push(knot::knot(knots.len(), knot::milliseconds(time_s), cables));
        };
        add(0.0, &self.tensions_n);
        let mut time_s = 0.0;
        let mut from = &self.tensions_n;
        for (duration_s, to) in stages {
            // Knots may be at most four seconds apart.
            let parts = (duration_s / 3.0).ceil().max(1.0);
            let mut part = 1.0;
            while part <= parts {
                let share = part / parts;
                let between: Vec<f64> = from
                    .iter()
                    .zip(to)
                    .map(|(a, b)| a + share * (b - a))
                    .collect();
                add(time_s + share * duration_s, &between);
                part += 1.0;
            }
            time_s += duration_s;
            from = to;
        }
        knot::end(&mut knots);
        // Samples from before are not part of this motion.
        while self.client.next_event().is_some() {}
        let mut recorder = Recorder::default();
        run::follow(&mut self.client, &knots, &mut recorder, |_| {})?;
        if let Some((_, tensions)) = stages.last() {
            self.tensions_n.clone_from(tensions);
        }
        Ok(recorder)
    }
}
