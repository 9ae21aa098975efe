//! Measurements on a run's true states, from the injection on.

use mcdpr_core::motion::Model;
use mcdpr_firmware::State;
use mcdpr_protocol::FaultId;
use mcdpr_simulator::TracePoint;
use nalgebra::Vector3;

/// Limits of the robot.
pub(super) struct Limits {
    cables: usize,
    /// Largest tension of each cable, N.
    ceiling_n: Vec<f64>,
}

impl Limits {
    pub(super) fn of(model: &Model) -> Self {
        let robot = model.robot();
        let ceiling = |index| {
            let winch = robot.winch_of(index);
            let sensor_n = winch.map_or(f64::INFINITY, |winch| winch.tension_max_n);
            sensor_n.min(robot.limits.tension_max_n)
        };
        Self {
            cables: robot.cables.len(),
            ceiling_n: (0..robot.cables.len()).map(ceiling).collect(),
        }
    }
}

/// A cable is slack below this, N: physically, not below its least permitted tension.
const SLACK_N: f64 = 0.1;

/// Once a fault is latched and torque is off, torque must stay off and the fault must stay latched; and states
/// without torque have none. What is violated is appended to `wrong`.
pub fn re_energises(trace: &[TracePoint], wrong: &mut Vec<String>) {
    let mut was_off = false;
    let mut latched = None;
    for point in trace {
        if latched.is_some() && latched != point.fault {
            wrong.push(format!("the fault changed at tick {}", point.tick.0));
            return;
        }
        latched = point.fault;
        if latched.is_some() && was_off && point.torque_on {
            wrong.push(format!("torque came back at tick {}", point.tick.0));
            return;
        }
        was_off = latched.is_some() && !point.torque_on;
        let calm = matches!(
            point.state,
            State::Boot | State::Disarmed | State::Fault | State::EStop
        );
        if calm && point.torque_on {
            wrong.push(format!("torque in {:?}", point.state));
            return;
        }
    }
}

fn longest(conditions: impl Iterator<Item = bool>) -> usize {
    let mut run = 0;
    conditions.fold(0, |most, holds| {
        run = if holds { run + 1 } else { 0 };
        most.max(run)
    })
}

/// The greatest distance from the path, and the greatest height lost against it, m, from tick `from`
/// on. Both are differences to that tick: a machine that is off is beside its path all the time. From tick `again` on
/// the second path applies, if there is one. A path is the tool's place at each millisecond of path time, world, m.
#[must_use]
pub fn away(
    trace: &[TracePoint],
    from: usize,
    again: usize,
    [first_m, second_m]: [&[Vector3<f64>]; 2],
) -> (f64, f64) {
    let mut path_m = first_m;
    let mut at = 0;
    let mut begin: Option<Vector3<f64>> = None;
    let (mut away_m, mut drop_m) = (0.0_f64, 0.0_f64);
    for (tick, point) in trace.iter().enumerate() {
        let path_ms = usize::try_from(point.path_ms).unwrap_or(usize::MAX);
        // The clock is reset when a motion is discarded: the tool stays where the clock stopped.
        match point.state {
            // A motion after a stop begins with the way from where it stopped.
            State::Moving if tick >= again && !std::ptr::eq(path_m, second_m) => {
                (path_m, at) = (second_m, path_ms);
            }
            State::Moving => at = path_ms,
            State::Pausing | State::Stopping if path_ms > at => at = path_ms,
            _ => {}
        }
        if tick < from {
            continue;
        }
        let Some(planned) = path_m.get(at).or(path_m.last()) else {
            return (0.0, 0.0);
        };
        let off = Vector3::from(point.truth.tool_position_m) - planned;
        let off = off - *begin.get_or_insert(off);
        away_m = away_m.max(off.norm());
        drop_m = drop_m.max(-off.z);
    }
    (away_m, drop_m)
}

/// The largest tension as a share of its limit, and the longest time in ms over it by 10 %.
pub(super) fn over(after: &[TracePoint], limits: &Limits) -> (f64, usize) {
    let mut worst = (0.0_f64, 0);
    for (cable, ceiling) in limits.ceiling_n.iter().enumerate() {
        let pull = |point: &TracePoint| point.truth.tensions_winch_n.get(cable).copied();
        let shares = after.iter().filter_map(pull).map(|n| n / ceiling);
        worst.0 = shares.clone().fold(worst.0, f64::max);
        worst.1 = worst.1.max(longest(shares.map(|share| share > 1.1)));
    }
    worst
}

/// The longest time in ms that a cable other than these was slack under torque.
pub(super) fn slack(after: &[TracePoint], limits: &Limits, without: &[usize]) -> usize {
    let cables = (0..limits.cables).filter(|cable| !without.contains(cable));
    let slack_ms = cables.map(|cable| {
        let armed = after.iter().filter(|point| point.torque_on);
        let pull = |point: &TracePoint| point.truth.tensions_platform_n.get(cable).copied();
        longest(armed.filter_map(pull).map(|n| n < SLACK_N))
    });
    slack_ms.max().unwrap_or(0)
}

/// Whether a run ends with brakes closed, drums at rest and no torque. With a brake that does not hold,
/// torque stays on; a drive that obeys no command cannot be switched off.
pub(super) fn is_safe(trace: &[TracePoint], limits: &Limits, faults: &[FaultId]) -> bool {
    let Some(end) = trace.last() else {
        return false;
    };
    let stands = matches!(end.state, State::Stopping | State::Holding);
    if stands
        && faults
            .iter()
            .any(|fault| matches!(fault, FaultId::B2 | FaultId::B3))
    {
        return true;
    }
    let brakes = end.truth.brakes_closed.iter().take(limits.cables);
    let drums = end.truth.drum_speeds_mps.iter().take(limits.cables);
    let still = drums.clone().all(|speed| speed.abs() < 1e-6);
    brakes.clone().all(|closed| *closed) && still && !end.torque_on
}
