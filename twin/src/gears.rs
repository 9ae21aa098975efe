//! Geared winches over the range that such winches have.
//!
//! Friction of rotor and first stage of 0.2 to 0.5 mN m is 4 to 10 N at a drum of 20 mm behind 371:1, and small
//! ratios have less; four planetary stages return 55 to 85 % of the power, and have 0.2 to 2 degrees of play. The range is
//! an assumption about winches of this kind, not a measurement of one.

use mcdpr_core::robot::Robot;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Friction of rotor and gear felt at the cable, N: drawn evenly in its logarithm.
pub const FRICTION_N: [f64; 2] = [1.0, 30.0];
/// Share of the motor's power that reaches the drum.
const EFFICIENCY: [f64; 2] = [0.55, 0.85];
/// Play at the drum, degrees.
const PLAY_DEG: [f64; 2] = [0.2, 2.0];
/// Salt of the gears in a seed.
const GEARS: u64 = 0x7769_6E63;

/// The robot with a gear that is drawn by a seed; and the friction (N), the efficiency and the play (degrees) drawn.
/// Every winch has the same type; its own errors are those of the machine's mismatch.
#[must_use]
pub fn drawn(robot: &Robot, seed: u64) -> (Robot, [f64; 3]) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ GEARS);
    let mut between = |[low, high]: [f64; 2]| {
        let share = f64::from(rng.next_u32()) / f64::from(u32::MAX);
        low + (high - low) * share
    };
    let friction_n = libm::exp(between(FRICTION_N.map(libm::log)));
    let efficiency = between(EFFICIENCY);
    let play_deg = between(PLAY_DEG);
    let mut drawn = robot.clone();
    for winch in &mut drawn.winches {
        let torque_nm = friction_n * winch.drum_radius_m / winch.gear_ratio;
        if let Some(gear) = &mut winch.gear {
            (gear.rotor_friction_nm, gear.gear_friction_nm) = (0.5 * torque_nm, 0.5 * torque_nm);
            gear.efficiency = efficiency;
            // Teeth rub the same in both directions: 1 - backdrive = 1 / efficiency - 1.
            gear.backdrive_efficiency = (2.0 - 1.0 / efficiency).max(0.0);
            gear.play_rad = play_deg.to_radians();
        }
    }
    (drawn, [friction_n, efficiency, play_deg])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gears_are_drawn_over_the_whole_range() {
        let robot = Robot::built_in("paper-table5").unwrap();
        let all: Vec<_> = (0..200).map(|seed| drawn(&robot, seed)).collect();
        for (at, [low, high]) in [FRICTION_N, EFFICIENCY, PLAY_DEG].into_iter().enumerate() {
            let values = || all.iter().map(|(_, values)| values[at]);
            assert!(values().all(|value| (low..=high).contains(&value)));
            let (least, most) = (values().fold(high, f64::min), values().fold(low, f64::max));
            let end = 0.05 * (high - low);
            assert!(least < low + end && most > high - end, "{least} to {most}");
        }
        // The friction at the cable is that of both parts through the gear.
        let (built, [friction_n, ..]) = &all[7];
        for winch in &built.winches {
            let gear = winch.gear.as_ref().unwrap();
            let torque_nm = gear.rotor_friction_nm + gear.gear_friction_nm;
            let felt_n = torque_nm * winch.gear_ratio / winch.drum_radius_m;
            assert!((felt_n - friction_n).abs() < 1e-9);
        }
    }
}
