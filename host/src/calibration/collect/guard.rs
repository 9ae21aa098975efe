//! Reasons to end a move to a pose before the board would: a tension near a limit because the robot
//! differs from its description, and oscillating tensions.

use super::reach::Reach;
use crate::run::{Halt, Measured};
use mcdpr_protocol::StopKind;

/// Ticks (of 1 ms) over which a tension is averaged.
const MEAN: usize = 20;
/// Ticks between the three readings that show an oscillation: half a period at 10 Hz. At about this
/// frequency a platform high up vibrates on the elasticity of its flat cables, where the gain of
/// the tension loop is too high.
const APART: usize = 50;
/// Amplitude of an oscillation (at 10 Hz) that neither sensor noise nor a normal move causes, N.
const SHAKING_N: f64 = 3.0;
/// Below this a tension near a limit is due to the move and not to an oscillation, N.
const STILL_N: f64 = 1.0;

/// A move that starts near a limit may come this much nearer, N: a mean of measurements at the same tension scatters less.
const NEARER_N: f64 = 0.1;

/// Why a robot with these measurements should stop, and how: brakes end an oscillation, but closing
/// and opening them would slacken a cable that is nearly slack.
pub(super) fn halt(reach: &Reach<'_>, samples: &[Measured]) -> Option<Halt> {
    let cables = 0..samples.last()?.tensions_n.len();
    let swings_n: Vec<f64> = cables.clone().map(|k| swing_n(samples, k)).collect();
    let (first, rest) = samples.split_at(MEAN.min(samples.len()));
    let recent = samples.split_at(rest.len()).1;
    for cable in cables {
        let mean_n = |of: &[Measured]| {
            let tensions = of.iter().filter_map(|s| s.tensions_n.get(cable));
            tensions.sum::<f64>() / MEAN as f64
        };
        let recent_n = mean_n(recent);
        // Where a pose was too near to a limit, the way out of it must stay open.
        let nearer = || {
            let (began_n, middle_n) = (mean_n(first), reach.middle_n(cable));
            !reach.beyond(cable, began_n)
                || (recent_n - middle_n).abs() > (began_n - middle_n).abs() + NEARER_N
        };
        if !rest.is_empty() && reach.beyond(cable, recent_n) && nearer() {
            return Some(Halt {
                kind: if swings_n.iter().any(|swing_n| *swing_n > STILL_N) {
                    StopKind::Stop
                } else {
                    StopKind::Hold
                },
                reason: format!(
                    "cable {}'s tension came to {recent_n:.1} N on the way: the robot is built otherwise \
                     than described",
                    cable + 1
                ),
            });
        }
        let swing_n = swings_n.get(cable).copied().unwrap_or(0.0);
        // A cable near its least tension has less room than that.
        let slackens = swing_n > STILL_N && recent_n - swing_n < reach.least_n();
        if swing_n > SHAKING_N || slackens {
            return Some(Halt {
                kind: StopKind::Stop,
                reason: format!(
                    "cable {}'s tension oscillated by {swing_n:.0} N on the way",
                    cable + 1
                ),
            });
        }
    }
    None
}

/// Amplitude of an oscillation at 10 Hz by the last three readings half a period apart, N.
fn swing_n(samples: &[Measured], cable: usize) -> f64 {
    let tension_n = |back: usize| {
        let at = samples.len().checked_sub(1 + back)?;
        samples.get(at)?.tensions_n.get(cable).copied()
    };
    match [2 * APART, APART, 0].map(tension_n) {
        // For a sine, half periods apart, a - 2 b + c is four amplitudes.
        [Some(a), Some(b), Some(c)] => (a - 2.0 * b + c).abs() / 4.0,
        _ => 0.0,
    }
}

/// Tensions over the last period of such an oscillation, N.
pub(super) fn mean_n(samples: &[Measured]) -> Vec<f64> {
    let recent = samples.len().saturating_sub(2 * APART);
    let recent = samples.get(recent..).unwrap_or_default();
    let count = recent.first().map_or(0, |s| s.tensions_n.len());
    let mean = |cable: usize| {
        let all = recent.iter().filter_map(|s| s.tensions_n.get(cable));
        all.sum::<f64>() / recent.len() as f64
    };
    (0..count).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Model;
    use crate::robot::Robot;

    fn measured(milliseconds: u32, tension_n: impl Fn(f64) -> f64) -> Vec<Measured> {
        let at = |tick: u32| Measured {
            tick,
            path_s: None,
            lengths_m: vec![0.5; 4],
            tensions_n: vec![10.0, tension_n(f64::from(tick) * 1e-3), 10.0, 10.0],
            currents_a: vec![0.0; 4],
        };
        (0..milliseconds).map(at).collect()
    }

    #[test]
    fn a_robot_stops_where_a_tension_oscillates_or_comes_near_its_limit() {
        let model = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
        let reach = Reach::new(&model).unwrap();
        let ended = |tension_n: &dyn Fn(f64) -> f64| {
            let all = measured(1000, tension_n);
            (1..=all.len()).find_map(|n| halt(&reach, &all[..n]))
        };
        // Steep ways, and a short jolt.
        assert_eq!(ended(&|t| 4.0 + 25.0 * t), None);
        assert_eq!(
            ended(&|t| if (0.5..0.51).contains(&t) { 15.0 } else { 10.0 }),
            None
        );
        let shaking = |t: f64| 18.0 + 4.0 * (std::f64::consts::TAU * 10.0 * t).sin();
        let shaken = ended(&shaking).unwrap();
        assert!(shaken.kind == StopKind::Stop && shaken.reason.contains("oscillated"));
        // A cable with little tension has less room: it would be slack before that.
        let little = |t: f64| 3.0 + 2.5 * t * (std::f64::consts::TAU * 10.0 * t).sin();
        let shaken = ended(&little).unwrap();
        assert!(
            shaken.kind == StopKind::Stop && shaken.reason.contains("oscillated"),
            "{shaken:?}"
        );
        // From a place near its least tension it may leave, not go on.
        let least_n = reach.least_n();
        assert_eq!(ended(&|t| least_n + 0.05 + t), None);
        assert!(ended(&|t| least_n + 0.05 - 0.3 * t).is_some());
        for slope in [|t| 3.0 - 2.0 * t, |t| 34.0 + 5.0 * t] {
            let limit = ended(&slope).unwrap();
            assert!(limit.kind == StopKind::Hold && limit.reason.contains("cable 2's"));
        }
    }
}
