//! Friction of a winch that holds a length, from its current at rest.
//!
//! A drive with an integral cannot come to rest on its set-point while static friction holds its motor: the integral
//! turns the current until the motor breaks away and passes the set-point, and then turns it back to where the motor
//! breaks away in the other direction (limit cycles by friction: Olsson and Åström, IEEE Trans. Control Systems
//! Technology 9, 2001). Between these two currents friction holds the load. Half their distance is static friction and
//! half the difference of the gear's losses, reeling in and paying out.
//!
//! No drum turns meanwhile, and no set-point moves: the ripple that hides friction in motion is not there.

use crate::robot::Winch;

/// The current has turned where it has come back by this share of the whole swing.
const BACK: f64 = 0.25;
/// An end is the mean of the ticks around a turn within this share of the swing; at least so many: an impact is shorter.
const END: f64 = 0.1;
const LEAST_TICKS: usize = 10;
/// The turns of one side differ by no more than this share of the swing.
const ALIKE: f64 = 0.15;
/// Least swing, A: ten steps of a drive's measured current.
const LEAST_A: f64 = 0.01;

/// The two currents between which a motor's current swings at rest, A: least and greatest. `None` if it does not turn on
/// both sides, or not always at the same ones.
pub(super) fn ends_a(currents_a: &[f64]) -> Option<[f64; 2]> {
    let least = currents_a.iter().copied().reduce(f64::min)?;
    let most = currents_a.iter().copied().reduce(f64::max)?;
    let swing = most - least;
    if swing < LEAST_A {
        return None;
    }
    let mut ends: [Vec<f64>; 2] = [Vec::new(), Vec::new()];
    for (upper, at) in turns(currents_a, BACK * swing) {
        let (before, after) = currents_a.split_at(at);
        let turn = *after.first()?;
        let near = |current: &&f64| (**current - turn).abs() <= END * swing;
        let around = before
            .iter()
            .rev()
            .take_while(near)
            .chain(after.iter().take_while(near));
        let (sum, ticks) = around.fold((0.0, 0_usize), |(sum, ticks), current| {
            (sum + current, ticks + 1)
        });
        if ticks < LEAST_TICKS {
            return None;
        }
        ends.get_mut(usize::from(upper))?.push(sum / ticks as f64);
    }
    let alike = |of: &[f64]| -> Option<f64> {
        let low = of.iter().copied().reduce(f64::min)?;
        let high = of.iter().copied().reduce(f64::max)?;
        (high - low <= ALIKE * swing).then(|| of.iter().sum::<f64>() / of.len() as f64)
    };
    let [low, high] = &ends;
    Some([alike(low)?, alike(high)?])
}

/// Where a signal turns, in order: whether at a greatest value, and the index. It must come back by `back`. The first turn is
/// left out: before it the signal may have been anywhere.
fn turns(signal: &[f64], back: f64) -> Vec<(bool, usize)> {
    let mut found = Vec::new();
    let (mut high, mut low) = (0, 0);
    let mut rises = None;
    let value = |index: usize| signal.get(index).copied().unwrap_or_default();
    for (index, &now) in signal.iter().enumerate() {
        if now > value(high) {
            high = index;
        }
        if now < value(low) {
            low = index;
        }
        if rises != Some(false) && value(high) - now > back {
            found.push((true, high));
            (rises, low) = (Some(false), index);
        } else if rises != Some(true) && now - value(low) > back {
            found.push((false, low));
            (rises, high) = (Some(true), index);
        }
    }
    found.drain(..found.len().min(1));
    found
}

/// Coulomb friction of rotor and gear, at the cable, N, of a winch whose current swings between these ends (A) under
/// this tension (N). `None` without a gear.
pub(super) fn rubs_n(winch: &Winch, ends_a: [f64; 2], tension_n: f64) -> Option<f64> {
    let gear = winch.gear.as_ref()?;
    let swing_n = (ends_a[1] - ends_a[0]) * winch.force_per_current_n_per_a().abs();
    let reels_n = (tension_n + winch.friction_n) / gear.efficiency;
    let pays_out_n = (tension_n - winch.friction_n).max(0.0) * gear.backdrive_efficiency;
    Some(0.5 * (swing_n - (reels_n - pays_out_n)) / gear.static_friction)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    /// A current that goes from one end to the other and stays there for 50 ms, 400 ms apart.
    fn hunting(ends: [f64; 2], ticks: usize) -> Vec<f64> {
        let at = |tick: usize| {
            let phase = (tick + 130) % 900;
            let share = match phase {
                0..400 => phase as f64 / 400.0,
                400..450 => 1.0,
                450..850 => 1.0 - (phase - 450) as f64 / 400.0,
                _ => 0.0,
            };
            ends[0] + share * (ends[1] - ends[0])
        };
        (0..ticks).map(at).collect()
    }

    #[test]
    fn the_ends_of_a_swing_are_found_and_give_the_friction() {
        // Measured on the simulator: cable 1 of paper-table5 under 13.8 N, seed 11.
        let ends = ends_a(&hunting([-0.316, 0.062], 2000)).unwrap();
        assert!(
            (ends[0] + 0.316).abs() < 0.03 && (ends[1] - 0.062).abs() < 0.03,
            "{ends:?}"
        );
        let robot = Robot::built_in("paper-table5").unwrap();
        let winch = robot.winch_of(0).unwrap();
        let file_n = winch.total_friction_n() - winch.friction_n;
        // By hand: 42.2 N from end to end; 22.0 N reel in against the loss, 6.1 N are left of the load; 13.1 N of 1.3
        // times Coulomb friction.
        let found_n = rubs_n(winch, [-0.316, 0.062], 13.8).unwrap();
        assert!(
            (found_n / file_n - 1.0).abs() < 0.05,
            "{found_n} of {file_n}"
        );
    }

    #[test]
    fn a_current_that_does_not_swing_to_and_fro_shows_nothing() {
        // It stands, it drifts, it has one impact, it has turned on one side only, its ends move.
        assert_eq!(ends_a(&[]), None);
        assert_eq!(ends_a(&[-0.2; 2000]), None);
        let drift: Vec<f64> = (0..2000).map(|tick| f64::from(tick) * 1e-4).collect();
        assert_eq!(ends_a(&drift), None);
        let mut impact = vec![-0.2; 2000];
        impact.get_mut(900..930).unwrap().fill(0.3);
        assert_eq!(ends_a(&impact), None);
        assert_eq!(ends_a(&hunting([-0.3, 0.1], 600)), None);
        let wider: Vec<f64> = (0..)
            .zip(hunting([-0.3, 0.1], 4000))
            .map(|(tick, current)| current * (1.0 + f64::from(tick) * 1e-4))
            .collect();
        assert_eq!(ends_a(&wider), None);
    }
}
