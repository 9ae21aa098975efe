//! Moves between resting poses: knots for a board, slowly, with every state on the way within the
//! robot's limits.

use super::reach::{Asked, Reach};
use crate::motion::StaticState;
use crate::motion::knot;
use crate::motion::spline::{Ends, Spline};
use crate::robot::Robot;
use mcdpr_protocol::Knot;
use nalgebra::{Rotation3, UnitQuaternion};

/// Share of the drives' speed that is used.
const SPEED_SHARE: f64 = 0.7;
/// Greatest acceleration of a cable, m/s2: the platform must not be excited.
const ACCELERATION_MPS2: f64 = 0.1;
/// Shortest duration of a move, in periods of the slowest swing.
const PERIODS: f64 = 3.0;
/// Distance between knots, s.
const KNOT_S: f64 = 0.05;
/// Number of states at which a move is checked.
const TRIES: usize = 24;

/// Share of the distance at a share of the time: a polynomial with zero velocity, acceleration and
/// jerk at its ends, so that slow modes are hardly excited.
fn share(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t.powi(4) * (35.0 - 84.0 * t + 70.0 * t * t - 20.0 * t * t * t)
}
/// Greatest first and second derivative of [`share`].
/// `140 t^3 (1 - t)^3` at t = 1/2 is 140 / 64.
const SHARE_SPEED: f64 = 2.1875;
// 420 t^2 (1 - t)^2 (1 - 2 t) is greatest at t = 0.276: 7.51.
const SHARE_ACCELERATION: f64 = 7.52;

/// A motion from rest to rest.
#[derive(Debug, Clone)]
pub struct Transfer {
    /// The knots for the board.
    pub knots: Vec<Knot>,
    /// Its duration, s.
    pub duration_s: f64,
}

/// States along the straight line of the platform's origin, the held tension or the attitude changing in
/// proportion; `None` if `hang` fails at one.
fn states(
    reach: &Reach<'_>,
    (from, to): (&StaticState, &StaticState),
    shares: &[f64],
    hang: impl Fn(&Asked) -> Option<StaticState>,
) -> Option<Vec<StaticState>> {
    let (a, b) = (&from.equilibrium.pose, &to.equilibrium.pose);
    let step_m = b.position_m - a.position_m;
    let turn = UnitQuaternion::from_rotation_matrix(&(a.rotation.inverse() * b.rotation));
    let turn = turn.scaled_axis();
    let mut out: Vec<StaticState> = Vec::with_capacity(shares.len());
    for &s in shares {
        let mut asked = Asked {
            at_m: a.position_m + step_m * s,
            attitude: a.rotation * Rotation3::new(turn * s),
            tension_n: 0.0,
        };
        if let Some(held) = reach.held() {
            let (t, u) = (*from.tensions_n().get(held)?, *to.tensions_n().get(held)?);
            // The tension changes in equal ratios, the position in equal steps.
            asked.tension_n = t * (u / t).powf(s);
            asked.attitude = out.last().unwrap_or(from).equilibrium.pose.rotation;
        }
        out.push(hang(&asked)?);
    }
    Some(out)
}

/// The states at which a move is checked; `None` if the robot, or a varied one, cannot hang at one
/// of them.
fn tried(reach: &Reach<'_>, from: &StaticState, to: &StaticState) -> Option<Vec<StaticState>> {
    if !reach.robust(to) {
        return None;
    }
    let tried = states(reach, (from, to), &even(), |asked| reach.rest(asked))?;
    tried
        .iter()
        .all(|state| reach.robust(state))
        .then_some(tried)
}

fn even() -> Vec<f64> {
    (0..=TRIES).map(|k| k as f64 / TRIES as f64).collect()
}

/// Whether the straight line between two resting poses is within the robot's reach.
#[must_use]
pub(super) fn open(reach: &Reach<'_>, from: &StaticState, to: &StaticState) -> bool {
    tried(reach, from, to).is_some()
}

/// The move between two resting poses, or `None` if the straight line leaves the robot's reach.
/// `offsets_m` are added to the lengths: the board's lengths, less the model's.
#[must_use]
pub fn way(
    reach: &Reach<'_>,
    robot: &Robot,
    from: &StaticState,
    to: &StaticState,
    slowest_s: f64,
    offsets_m: &[f64],
) -> Option<Transfer> {
    let tried = tried(reach, from, to)?;
    let kept = |asked: &Asked| reach.rest(asked);
    knots(reach, robot, (from, to), &tried, slowest_s, offsets_m, kept)
}

/// The move back to its start of a robot that has stopped beyond the planned limits: they do not
/// apply any more, and every step back moves away from that state. `None` if the robot cannot hang
/// in between.
#[must_use]
pub(super) fn back(
    reach: &Reach<'_>,
    robot: &Robot,
    from: &StaticState,
    to: &StaticState,
    slowest_s: f64,
    offsets_m: &[f64],
) -> Option<Transfer> {
    let anyhow = |asked: &Asked| reach.anyhow(asked);
    let tried = states(reach, (from, to), &even(), anyhow)?;
    knots(
        reach,
        robot,
        (from, to),
        &tried,
        slowest_s,
        offsets_m,
        anyhow,
    )
}

/// The knots of a checked move.
fn knots(
    reach: &Reach<'_>,
    robot: &Robot,
    ends: (&StaticState, &StaticState),
    tried: &[StaticState],
    slowest_s: f64,
    offsets_m: &[f64],
    hang: impl Fn(&Asked) -> Option<StaticState>,
) -> Option<Transfer> {
    let mut duration_s = PERIODS * slowest_s;
    for pair in tried.windows(2) {
        let [a, b] = pair else { continue };
        for (i, (x, y)) in a.paid_out_m.iter().zip(&b.paid_out_m).enumerate() {
            let slope = (y - x).abs() * TRIES as f64;
            let fastest = robot.winch_of(i)?.max_cable_speed_mps() * SPEED_SHARE;
            // v = slope 2.19 / T and a = slope 7.52 / T^2, solved for the time T.
            duration_s = duration_s
                .max(slope * SHARE_SPEED / fastest)
                .max((slope * SHARE_ACCELERATION / ACCELERATION_MPS2).sqrt());
        }
    }
    let segments = (duration_s / KNOT_S).ceil().max(8.0) as usize;
    let ms: Vec<u32> = (0..=segments)
        .map(|k| knot::milliseconds(k as f64 * duration_s / segments as f64))
        .collect();
    let end_ms = f64::from(*ms.last()?);
    let times: Vec<f64> = ms.iter().map(|ms| f64::from(*ms) * 1e-3).collect();
    let shares: Vec<f64> = ms.iter().map(|ms| share(f64::from(*ms) / end_ms)).collect();
    let states = states(reach, ends, &shares, hang)?;
    let still = Ends::Clamped {
        start: 0.0,
        end: 0.0,
    };
    let splines: Vec<Spline> = (0..robot.cables.len())
        .map(|i| {
            let offset = offsets_m.get(i).copied().unwrap_or(0.0);
            let lengths: Vec<f64> = states.iter().map(|s| s.paid_out_m[i] + offset).collect();
            Spline::interpolate(&times, &lengths, still).ok()
        })
        .collect::<Option<_>>()?;
    let mut knots = Vec::with_capacity(states.len());
    for (k, state) in states.iter().enumerate() {
        // No residual rows: the relation of lengths and tensions is still to be determined.
        let cables = knot::on_splines(&splines, k, state.tensions_n());
        knots.push(knot::knot(k, ms[k], cables));
    }
    knot::end(&mut knots);
    Some(Transfer {
        knots,
        duration_s: end_ms * 1e-3,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_of_the_way_has_the_stated_derivatives() {
        let n = 4000;
        let at = |k: i32| share(f64::from(k) / f64::from(n));
        let (mut fastest, mut hardest) = (0.0_f64, 0.0_f64);
        for k in 1..n {
            let step = 1.0 / f64::from(n);
            fastest = fastest.max((at(k + 1) - at(k - 1)) / (2.0 * step));
            hardest = hardest.max(((at(k + 1) - 2.0 * at(k) + at(k - 1)) / (step * step)).abs());
        }
        assert_eq!((at(0), at(n)), (0.0, 1.0));
        assert!((fastest - SHARE_SPEED).abs() < 1e-3, "{fastest}");
        assert!((hardest - SHARE_ACCELERATION).abs() < 0.01, "{hardest}");
    }
}
