//! Consequences of a fault: detection time, reaction, drop, and loads on the cables.

use crate::motion::Model;
use crate::run::RunError;
use mcdpr_core::diagnosis::Diagnosis;
use mcdpr_firmware::State;
use mcdpr_protocol::FaultRecord;
use mcdpr_simulator::TracePoint;
use mcdpr_twin::faults::survey::away;
use nalgebra::Vector3;

/// Limits of the robot, for judging.
#[derive(Debug, Clone, PartialEq)]
pub struct Limits {
    /// Cables.
    pub cables: usize,
    /// Largest tension of each cable, N.
    pub ceiling_n: Vec<f64>,
    /// Below this tension a cable is slack, N.
    pub slack_n: f64,
}

impl Limits {
    /// For this robot. Slack is judged physically, at a tenth of a newton, not at the least
    /// permitted tension.
    #[must_use]
    pub fn of(model: &Model) -> Self {
        let robot = model.robot();
        let ceiling = |index| {
            let winch = robot.winch_of(index);
            let sensor = winch.map_or(f64::INFINITY, |winch| winch.tension_max_n);
            sensor.min(robot.limits.tension_max_n)
        };
        Self {
            cables: robot.cables.len(),
            ceiling_n: (0..robot.cables.len()).map(ceiling).collect(),
            slack_n: 0.1,
        }
    }
}

/// An event, at a time after the first fault.
#[derive(Debug, Clone, PartialEq)]
pub struct Moment {
    /// Time after the fault, ms; negative before it.
    pub after_ms: i64,
    /// The event.
    pub what: String,
}

/// A run with faults, with the plant's true states.
#[derive(Debug)]
pub struct Aftermath {
    /// Every tick of the run, from power-on.
    pub trace: Vec<TracePoint>,
    /// When the faults happened, ms since power-on.
    pub injected_ms: Vec<u64>,
    /// The error that ended the host's program; `None` if the motion was completed.
    pub error: Option<RunError>,
    /// Limits of the robot.
    pub limits: Limits,
    /// Planned place of the tool at each millisecond of path time, world, m.
    pub planned_m: Vec<Vector3<f64>>,
}

impl Aftermath {
    pub(super) const fn new(
        trace: Vec<TracePoint>,
        injected_ms: Vec<u64>,
        error: Option<RunError>,
        limits: Limits,
        planned_m: Vec<Vector3<f64>>,
    ) -> Self {
        Self {
            trace,
            injected_ms,
            error,
            limits,
            planned_m,
        }
    }

    /// From the first fault's tick on; the whole run if none was injected.
    #[must_use]
    pub fn after(&self) -> &[TracePoint] {
        let first = self.injected_ms.first().copied().unwrap_or(0);
        let from = usize::try_from(first).unwrap_or(usize::MAX);
        self.trace
            .get(from.min(self.trace.len())..)
            .unwrap_or_default()
    }

    /// The first fault that the board latched.
    #[must_use]
    pub fn record(&self) -> Option<FaultRecord> {
        self.trace.iter().find_map(|point| point.fault)
    }

    /// The probable cause that the host's program found, where it is another than the latched fault.
    #[must_use]
    pub fn cause(&self) -> Option<&Diagnosis> {
        match &self.error {
            Some(RunError::Fault { why, .. }) => why.as_deref(),
            _ => None,
        }
    }

    /// Ticks from the first injection until a fault was latched.
    #[must_use]
    pub fn detected_after_ms(&self) -> Option<usize> {
        self.after().iter().position(|point| point.fault.is_some())
    }

    /// Height that the tool lost against its path since the first fault, m, noticed or not.
    #[must_use]
    pub fn drop_m(&self) -> f64 {
        self.away_m().1
    }

    /// Greatest distance of the tool from its path since the first fault, m, noticed or not; beyond that at the fault.
    #[must_use]
    pub fn deviation_m(&self) -> f64 {
        self.away_m().0
    }

    fn away_m(&self) -> (f64, f64) {
        let from = self.trace.len() - self.after().len();
        // A second day follows the same path.
        let path_m = self.planned_m.as_slice();
        away(&self.trace, from, usize::MAX, [path_m, &[]])
    }

    /// The largest tension over its cable's limit, as a share of it, and the longest time in ms
    /// that a cable was over its limit by 10 %, from the first fault on.
    #[must_use]
    pub fn over_tension(&self) -> (f64, usize) {
        let mut worst = (0.0_f64, 0);
        for (cable, ceiling) in self.limits.ceiling_n.iter().enumerate() {
            let pull = |point: &TracePoint| point.truth.tensions_winch_n.get(cable).copied();
            let shares = self.after().iter().filter_map(pull).map(|n| n / ceiling);
            worst.0 = shares.clone().fold(worst.0, f64::max);
            worst.1 = worst.1.max(longest(shares.map(|share| share > 1.1)));
        }
        worst
    }

    /// The longest time in ms that a cable was slack, and its number from 0, from the first fault
    /// on while the board gave torque.
    #[must_use]
    pub fn slack(&self) -> (usize, usize) {
        self.slack_but(&[])
    }

    /// The same, except for some cables (from 0): those that are not needed to hold it taut.
    #[must_use]
    pub(crate) fn slack_but(&self, without: &[usize]) -> (usize, usize) {
        let mut worst = (0, 0);
        for cable in (0..self.limits.cables).filter(|cable| !without.contains(cable)) {
            let pull = |point: &TracePoint| point.truth.tensions_platform_n.get(cable).copied();
            let armed = self.after().iter().filter(|point| point.torque_on);
            let ms = longest(armed.filter_map(pull).map(|n| n < self.limits.slack_n));
            worst = worst.max((ms, cable));
        }
        worst
    }

    /// The board's last state.
    #[must_use]
    pub fn end(&self) -> Option<State> {
        self.trace.last().map(|point| point.state)
    }

    /// Whether the robot is safe at the end: brakes closed, torque off.
    #[must_use]
    pub fn is_safe(&self) -> bool {
        let Some(end) = self.trace.last() else {
            return false;
        };
        let brakes = end.truth.brakes_closed.iter().take(self.limits.cables);
        let drums = end.truth.drum_speeds_mps.iter().take(self.limits.cables);
        // 1 um/s: a drum of 31 um a count would need half a minute for the next one.
        let still = drums.clone().all(|speed| speed.abs() < 1e-6);
        brakes.clone().all(|closed| *closed) && still && !end.torque_on
    }

    /// The events, in order of time.
    #[must_use]
    pub fn timeline(&self) -> Vec<Moment> {
        let first = self.injected_ms.first().copied().unwrap_or(0);
        let zero = i64::try_from(first).unwrap_or(i64::MAX);
        let mut moments = Vec::new();
        for pair in self.trace.windows(2) {
            let [before, now] = pair else { continue };
            let mut note = |what: String| {
                moments.push(Moment {
                    after_ms: i64::from(now.tick.0) - zero,
                    what,
                });
            };
            if let (None, Some(record)) = (before.fault, now.fault) {
                note(format!("noticed: {}", crate::link::describe_fault(&record)));
            }
            if before.state != now.state {
                note(meaning(now.state).to_owned());
            }
            let closed = |point: &TracePoint| {
                let brakes = point.truth.brakes_closed.iter().take(self.limits.cables);
                brakes.filter(|closed| **closed).count()
            };
            let count = closed(now);
            if closed(before) != count {
                note(format!("{count} of {} brakes closed", self.limits.cables));
            }
            if before.torque_on != now.torque_on {
                let what = if now.torque_on {
                    "torque on"
                } else {
                    "torque off"
                };
                note(what.to_owned());
            }
        }
        moments
    }
}

const fn meaning(state: State) -> &'static str {
    match state {
        State::Boot => "Boot: the board starts",
        State::Disarmed => "Disarmed: brakes closed, no torque",
        State::Arming => "Arming: drives come up, checks run",
        State::Holding => "Holding: it is at rest under tension",
        State::Moving => "Moving",
        State::Pausing => "Pausing: it decelerates along its path",
        State::Stopping => "Stopping: it decelerates, then brakes close under torque",
        State::Fault => "Fault: brakes closed, no torque, until it is cleared",
        State::EStop => "EStop: brakes closed, no torque, the button is pressed",
    }
}

fn longest(conditions: impl Iterator<Item = bool>) -> usize {
    let mut run = 0;
    conditions.fold(0, |most, holds| {
        run = if holds { run + 1 } else { 0 };
        most.max(run)
    })
}
