//! The robot description as a board's configuration.

use crate::robot::{Control, DriveKind, LawKind, Robot, TensionOutput, Winch};
use mcdpr_protocol::{
    BoardKey, CableKey, ConfigEntry, ConfigHash, ConfigKey, Millinewtons, PerCable, Request,
    TenthMicrometres, config_hash,
};
use miette::Diagnostic;
use thiserror::Error;

/// A value that does not fit the board's range.
#[derive(Debug, Error, Diagnostic)]
#[error("{key} of cable {cable} is {value}, which a board cannot hold")]
#[diagnostic(
    code(mcdpr::config::range),
    help("correct the value in the robot file; see docs/robot-file.md")
)]
pub struct OutOfRange {
    key: &'static str,
    cable: usize,
    value: f64,
}

/// Time for a coordinated stop, ms.
const STOP_MS: i32 = 300;
/// Time that a residual row may be over its limit, ms (S5).
const RESIDUAL_MS: i32 = 100;
/// Time a drive needs to enable: the RMDS's reset and mode, ms.
const RMDS_ENABLE_MS: i32 = 1100;
/// Time a CiA 402 drive needs to enable, ms: it goes through its state machine in some
/// milliseconds.
const CIA402_ENABLE_MS: i32 = 500;
/// Age at which a drive's feedback counts as lost, ms (D3).
const FEEDBACK_MS: i32 = 10;
/// Time from a bus slot to the drive's action, s.
/// A CAN frame of 130 bits takes 0.13 ms at 1 Mbit/s, and 0.26 ms at 500 kbit/s.
const BUS_LATENCY_S: f64 = 0.000_25;
/// Following error that is a fault, m (S2, D7): the least limit.
const FOLLOWING_M: f64 = 1e-3;
/// A drive's lag is known to this share. At the robot's largest speed a healthy drum is behind or
/// ahead of its command by this share of the lead that compensates the lag (`eight-cable`: 0.4 of
/// 5.6 ms at 0.5 m/s, 1.1 mm).
const LAG_SHARE: f64 = 0.4;
/// A slack cable is reeled in no faster than this, m/s: slow enough to watch.
const MOST_REEL_MPS: f64 = 0.02;
/// A cable may exceed the speed limit that follows from the motor by this share before the board
/// refuses: rounding must not refuse a motion exactly at the limit.
const SPEED_MARGIN: f64 = 1.02;

/// Ratio of the cable's acceleration to the tool's above which board and plan refuse: curves, tilt
/// and the cubics between knots reach 1.25 in the built-in tasks; a length that is wrong by a
/// millimetre exceeds this ratio.
const RATES_MARGIN: f64 = 3.0;

/// Limits on what the cables of a robot may be commanded (K3).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CableRates {
    /// Acceleration, m/s².
    pub acceleration_mps2: f64,
    /// Jerk, m/s³.
    pub jerk_mps3: f64,
}

impl CableRates {
    /// The greatest values that a board can represent.
    pub const LARGEST: Self = Self {
        acceleration_mps2: 1e3,
        jerk_mps3: 1e4,
    };

    /// Three times what the robot file allows the tool.
    #[must_use]
    pub fn of(robot: &Robot) -> Self {
        let (limits, largest) = (&robot.limits, Self::LARGEST);
        Self {
            acceleration_mps2: (RATES_MARGIN * limits.acceleration_mps2)
                .min(largest.acceleration_mps2),
            jerk_mps3: (RATES_MARGIN * limits.jerk_mps3).min(largest.jerk_mps3),
        }
    }
}

/// All entries of the board's configuration, in ascending order of keys.
///
/// # Errors
/// The first value that a board cannot hold.
pub fn configuration(robot: &Robot) -> Result<Vec<ConfigEntry>, OutOfRange> {
    let mut entries = Vec::new();
    // One protocol for all drives: the reader of robot files refuses a mixture.
    let kind = robot.winches.first().map(|winch| winch.drive);
    let mut board = |key: BoardKey, value: i32| {
        entries.push(ConfigEntry {
            key: ConfigKey::board(key),
            value,
        });
    };
    let whole = |value: u32| i32::try_from(value).unwrap_or(i32::MAX);
    board(
        BoardKey::Cables,
        i32::try_from(robot.cables.len()).unwrap_or(i32::MAX),
    );
    let (number, enable) = match kind {
        Some(DriveKind::Cia402) => (2, CIA402_ENABLE_MS),
        Some(DriveKind::Rmds) | None => (1, RMDS_ENABLE_MS),
    };
    board(BoardKey::DriveKind, number);
    board(BoardKey::BusBitrate, whole(robot.bus.bitrate));
    board(BoardKey::BusPeriodUs, whole(robot.bus.period_us));
    board(BoardKey::StopMs, STOP_MS);
    board(BoardKey::ResidualMs, RESIDUAL_MS);
    board(BoardKey::EnableMs, enable);
    board(BoardKey::FeedbackTimeoutMs, FEEDBACK_MS);
    board(
        BoardKey::TensionPeriodUs,
        whole(robot.bus.tension_period_us),
    );
    board(BoardKey::HoldBrakes, i32::from(robot.tension.hold_braked));
    let fault_line = robot.boards.iter().any(|board| board.fault_line);
    board(BoardKey::FaultLine, i32::from(fault_line));
    for index in 0..robot.cables.len() {
        if let Some(winch) = robot.winch_of(index) {
            cable(robot, index, winch, &mut entries)?;
        }
    }
    Ok(entries)
}

fn cable(
    robot: &Robot,
    index: usize,
    winch: &Winch,
    entries: &mut Vec<ConfigEntry>,
) -> Result<(), OutOfRange> {
    let number = u8::try_from(index).unwrap_or(u8::MAX);
    let mut put = |key: CableKey, value: f64| {
        let rounded = value.round();
        if !(f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&rounded) {
            return Err(OutOfRange {
                key: key.name(),
                cable: index + 1,
                value,
            });
        }
        #[expect(
            clippy::cast_possible_truncation,
            reason = "the range was just checked"
        )]
        let value = rounded as i32;
        entries.push(ConfigEntry {
            key: ConfigKey::cable(number, key),
            value,
        });
        Ok(())
    };
    let law = &robot.tension;
    let held_by_tension = robot
        .cables
        .get(index)
        .is_some_and(|c| c.control == Control::Tension);
    // A positive count and a positive current turn the motor alike; counts that rise as the cable
    // pays out mean that a positive current pays out, so that it takes a negative one to pull.
    let pull = -winch.motor_counts_per_turn.signum() * winch.force_per_current_n_per_a();
    let speed = winch.max_cable_speed_mps() * SPEED_MARGIN;
    // Lag of the drive's loop, half a bus period of waiting on average, and the frame on the bus.
    let lead_s =
        1.0 / winch.drive_bandwidth_rad_s + f64::from(robot.bus.period_us) * 0.5e-6 + BUS_LATENCY_S;
    // Whole numbers on the board: lengths in 0.1 um, forces in mN, speeds in um/s, times in us or
    // ms.
    put(CableKey::Control, f64::from(u8::from(held_by_tension)))?;
    put(CableKey::DrumRadius, winch.drum_radius_m * 1e7)?;
    put(
        CableKey::EncoderCountsPerTurn,
        f64::from(winch.encoder_counts_per_turn),
    )?;
    put(CableKey::EncoderSign, f64::from(winch.encoder_sign))?;
    put(CableKey::MotorCountsPerTurn, winch.motor_counts_per_turn)?;
    put(CableKey::MaxMotorRpm, winch.max_motor_rpm)?;
    put(CableKey::MaxCurrentMa, winch.max_current_a * 1e3)?;
    put(CableKey::ForcePerCurrent, pull * 1e3)?;
    put(CableKey::TensionGain, winch.tension_gain_n_per_v * 1e3)?;
    put(CableKey::TensionZeroUv, winch.tension_zero_v * 1e6)?;
    put(CableKey::TensionMax, winch.tension_max_n * 1e3)?;
    put(CableKey::TensionFloor, robot.limits.tension_min_n * 1e3)?;
    let ceiling = robot.limits.tension_max_n.min(winch.trusted_tension_n());
    put(CableKey::TensionCeiling, ceiling * 1e3)?;
    put(
        CableKey::TensionLaw,
        f64::from(u8::from(law.law == LawKind::Default)),
    )?;
    put(CableKey::TensionKp, law.kp * 1e3)?;
    put(CableKey::TensionKd, law.kd * 1e6)?;
    put(CableKey::TensionKi, law.ki * 1e3)?;
    put(CableKey::TensionDamping, law.damping_ns_per_m * 1e3)?;
    put(CableKey::TensionFilterMhz, law.filter_hz * 1e3)?;
    put(CableKey::Friction, winch.total_friction_n() * 1e3)?;
    put(CableKey::DrumMass, winch.effective_mass_kg() * 1e3)?;
    put(CableKey::LeadUs, lead_s * 1e6)?;
    put(CableKey::BrakeCloseMs, winch.brake_close_s * 1e3)?;
    let following_m = FOLLOWING_M.max(LAG_SHARE * lead_s * robot.limits.speed_mps);
    put(CableKey::FollowingError, following_m * 1e6)?;
    put(CableKey::MaxSpeed, speed * 1e6)?;
    let turn = std::f64::consts::TAU * winch.drum_radius_m;
    put(CableKey::LengthMin, 0.0)?;
    // Capacity of the drum; a longer cable does not fit on it.
    put(CableKey::LengthMax, winch.turns_max.max(1.0) * turn * 1e7)?;
    put(CableKey::Node, f64::from(winch.node))?;
    put(
        CableKey::MotorCountsPerRev,
        winch.motor_counts_per_turn.abs() / winch.gear_ratio,
    )?;
    put(
        CableKey::ReelSpeed,
        reel_speed_mps(robot, index, winch) * 1e6,
    )?;
    let rates = CableRates::of(robot);
    put(CableKey::MaxAcceleration, rates.acceleration_mps2 * 1e6)?;
    put(CableKey::MaxJerk, rates.jerk_mps3 * 1e3)?;
    let tells_speed = law.output == TensionOutput::Velocity;
    put(CableKey::TensionOutput, f64::from(u8::from(tells_speed)))?;
    put(CableKey::Play, winch.play_m() * 1e7)?;
    put(CableKey::SpeedCornerMhz, law.corner_hz * 1e3)?;
    put(CableKey::BrakePlay, winch.brake_play_m * 1e7)?;
    put(CableKey::GainLength, law.gain_length_m * 1e7)
}

/// Speed at which a slack cable is reeled in, m/s. A drum that is stopped by its cable gives it an
/// impact of `v sqrt(k m)`; it must not exceed three tenths of the set-point.
fn reel_speed_mps(robot: &Robot, index: usize, winch: &Winch) -> f64 {
    let Some(cable) = robot.cables.get(index) else {
        return MOST_REEL_MPS;
    };
    // The shortest cable is the stiffest: the length of the routing, twice.
    let length_m = (2.0 * cable.routing_length_m).max(0.2);
    let stiffness_n_per_m = cable.ea_n / length_m;
    let blow_n = 0.3 * robot.tension.setpoint_n;
    let speed = blow_n / (stiffness_n_per_m * winch.effective_mass_kg()).sqrt();
    speed
        .min(MOST_REEL_MPS)
        .min(0.5 * winch.max_cable_speed_mps())
        .max(1e-6)
}

/// The hash that must be the same on host and board.
#[must_use]
pub fn hash_of(entries: &[ConfigEntry]) -> ConfigHash {
    config_hash(entries.iter().copied())
}

/// Tensions that a board shall expect of a hanging robot, N: those of statics, and no less than the
/// floor. Statics rest on the tension-held cable's own sensor: where that is below the floor, the
/// cable is slack or broken, and arming must end there (C1).
#[must_use]
pub fn expected_n(robot: &Robot, tensions_n: &[f64]) -> Vec<f64> {
    let floor_n = robot.limits.tension_min_n;
    tensions_n.iter().map(|n| n.max(floor_n)).collect()
}

/// The request that sets a board's cable lengths: paid-out lengths in m, tensions in N.
#[must_use]
pub fn reference(lengths_m: &[f64], tensions_n: &[f64]) -> Request {
    Request::Reference {
        lengths: PerCable::collect(lengths_m.iter().map(|l| TenthMicrometres::from_metres(*l))),
        tensions: PerCable::collect(tensions_n.iter().map(|t| Millinewtons::from_newtons(*t))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Limit of the following error of the first cable, um.
    fn following_um(name: &str) -> i32 {
        let robot = Robot::built_in(name).unwrap();
        let wanted = ConfigKey::cable(0, CableKey::FollowingError);
        let entries = configuration(&robot).unwrap();
        let entry = entries.iter().find(|entry| entry.key == wanted);
        entry.unwrap().value
    }

    #[test]
    fn no_cable_is_expected_below_its_floor_c1() {
        let robot = Robot::built_in("paper-optimistic").unwrap();
        let floor_n = robot.limits.tension_min_n;
        let expected = expected_n(&robot, &[8.0, 6.0, floor_n, 0.1]);
        assert_eq!(expected, [8.0, 6.0, floor_n, floor_n]);
    }

    #[test]
    fn a_fast_robot_may_be_behind_by_a_share_of_its_drives_lag_d7() {
        // 5.6 ms at 0.5 m/s are 2.8 mm, 40 % of it 1.12 mm; the paper's robot is slow.
        let fast = following_um("eight-cable");
        assert!((1050..1200).contains(&fast), "{fast}");
        assert_eq!(following_um("paper-optimistic"), 1000);
    }
}
