//! What a winch is used for in service, and the configuration that its board gets for that: that of the robot, made
//! harmless for one winch without a cable.

use super::{Bench, CEILING_N, commission, loss, windup};
use crate::link::Link;
use crate::machine::{self, CableRates, OutOfRange};
use mcdpr_protocol::{CableKey, ConfigEntry, ConfigKey};

/// In service a drum's radius is set to 10 mm, so that a "length" of 10 mm is one radian: every limit of length allows
/// thirty turns, and a set-point's 0.1 um is a fine step for a motor behind a gear.
pub(super) const RADIUS_UM: f64 = 10_000.0;
/// Most current of service against a closed brake, as a share of the motor's largest.
const CURRENT_SHARE: f64 = 0.3;
/// The same while the brake is open: with three tenths the drive of `paper-table5` saturated in a gear of 27 N (D4).
const TURN_SHARE: f64 = 0.5;
/// Least push of the board's proof of a brake without a load, N (`firmware/src/proof.rs`).
const LEAST_PUSH_N: f64 = 1.125;
/// Friction in the board's units of service that a drive commanded by speed is told, N: a tenth of an ampere of 1 A.
const SPIN_FRICTION_N: f64 = 0.5;
/// Share of the current of service that this push shall be.
const PROOF_SHARE: f64 = 0.5;

/// Use of the winch on the board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Purpose {
    /// Turn it by positions, brake open.
    Turn,
    /// Pull with little current against its closed brake.
    Press,
    /// The same the other way round, as by a motor with the opposite sign.
    PressOut,
    /// Turn it by speeds, brake open: the drive's own loop of speed follows a constant command, without the steps of a
    /// position's set-points.
    Spin,
    /// Wind its gear up against its closed brake, with a current that grows to this, A; pulling, or pushing out.
    Wind { most_a: f64, out: bool },
    /// As `Spin`, with this weight on the drum (N); `friction_n` is the winch's own at the cable, N, and `pays_out` the
    /// sign of motor counts that pays out.
    Lift {
        weight_n: f64,
        friction_n: f64,
        pays_out: f64,
    },
}

impl Purpose {
    /// Whether the brake opens.
    pub(super) fn opens(self) -> bool {
        matches!(self, Self::Turn | Self::Spin | Self::Lift { .. })
    }

    /// Whether the drive is commanded by speed.
    pub(super) fn by_speed(self) -> bool {
        matches!(self, Self::Spin | Self::Lift { .. })
    }
}

/// Tension above which the board stops while a weight hangs on a drum, N: the weight swings, and falls through the play.
pub(super) fn lift_ceiling_n(weight_n: f64) -> f64 {
    1.5 * weight_n + CEILING_N
}

impl<L: Link> Bench<'_, L> {
    /// Motor current of service, A.
    pub(super) fn current_a(&self) -> f64 {
        self.described().max_current_a * CURRENT_SHARE
    }

    /// The robot's configuration, made harmless for this winch.
    pub(super) fn configuration(&self, purpose: Purpose) -> Result<Vec<ConfigEntry>, OutOfRange> {
        let winch = self.described();
        let rad_per_s = winch.max_motor_rpm / winch.gear_ratio * std::f64::consts::TAU / 60.0;
        // The board's own proof of a brake is within the current of service.
        let counts_per_turn = match purpose {
            Purpose::Wind { out: true, .. } => -winch.motor_counts_per_turn,
            Purpose::Lift { pays_out, .. } => pays_out * winch.motor_counts_per_turn.abs(),
            _ => winch.motor_counts_per_turn,
        };
        let ceiling_n = match purpose {
            Purpose::Lift { weight_n, .. } => lift_ceiling_n(weight_n),
            _ => CEILING_N,
        };
        let ceiling_n = ceiling_n.min(winch.trusted_tension_n());
        let (most_a, force_per_a) = match purpose {
            Purpose::Lift { pays_out, .. } => (
                loss::LIFT_SHARE * winch.max_current_a,
                -pays_out * winch.force_per_current_n_per_a(),
            ),
            // The integral of the law grows up to the ceiling.
            // A force that reels in lets counts fall that rise with the length: the law damps such a motor, and the
            // proof of the brake, which pushes out, waits for its current. With the other sign it waits in vain, and the
            // drive pushes with all it has.
            Purpose::Wind { most_a, .. } => (
                most_a,
                -counts_per_turn.signum() * (windup::BEGINS_N + ceiling_n) / most_a,
            ),
            Purpose::Turn | Purpose::Spin => (
                winch.max_current_a * TURN_SHARE,
                -counts_per_turn.signum() * LEAST_PUSH_N / (PROOF_SHARE * self.current_a()),
            ),
            _ => {
                let per_a = LEAST_PUSH_N / (PROOF_SHARE * self.current_a());
                let out = purpose == Purpose::PressOut;
                (self.current_a(), if out { -per_a } else { per_a })
            }
        };
        let mut entries = machine::configuration(self.robot)?;
        let changed = |key: CableKey| {
            let value = match key {
                CableKey::Control => f64::from(u8::from(purpose != Purpose::Turn)),
                CableKey::DrumRadius => RADIUS_UM * 10.0,
                CableKey::MaxCurrentMa => most_a * 1e3,
                CableKey::MotorCountsPerTurn => counts_per_turn,
                CableKey::ForcePerCurrent => force_per_a * 1e3,
                // The robot file's value is in N at the cable; in service forces have another scale, and the friction
                // is what is searched for.
                CableKey::Friction => match purpose {
                    Purpose::Lift { friction_n, .. } => friction_n * 1e3,
                    // After the push of its proof a drive that is commanded by speed turns back until its current
                    // exceeds load and friction: with none of both it would wind the gear up.
                    Purpose::Spin => SPIN_FRICTION_N * 1e3,
                    _ => 0.0,
                },
                CableKey::TensionZeroUv => self.zero_v * 1e6,
                CableKey::TensionMax => winch.tension_max_n * 1e3,
                CableKey::TensionFloor | CableKey::TensionKd => 0.0,
                CableKey::TensionKi => match purpose {
                    // N/s per N of the error, which is the set-point.
                    Purpose::Wind { .. } => ceiling_n / windup::GROWS_S / windup::BEGINS_N * 1e3,
                    _ => 0.0,
                },
                CableKey::TensionDamping => match purpose {
                    // A free rotor's inertia over this time, by the board's units of force and length.
                    Purpose::Wind { .. } => {
                        let torque_nms = winch.rotor_inertia_kg_m2 / windup::DAMPED_S;
                        let force_per_nm = force_per_a.abs() / winch.torque_constant_nm_per_a;
                        torque_nms * force_per_nm * winch.gear_ratio / (RADIUS_UM * 1e-6) * 1e3
                    }
                    _ => return None,
                },
                CableKey::TensionCeiling => ceiling_n * 1e3,
                // The default law with a speed as its output and without gains commands the planned speed alone.
                CableKey::TensionLaw => f64::from(u8::from(
                    purpose.by_speed() || matches!(purpose, Purpose::Wind { .. }),
                )),
                CableKey::TensionOutput => f64::from(u8::from(purpose.by_speed())),
                CableKey::Play => 0.0,
                // This is the unknown.
                CableKey::BrakePlay => {
                    commission::MOST_BRAKE_PLAY_DEG.to_radians() * RADIUS_UM * 10.0
                }
                CableKey::TensionKp => match purpose {
                    Purpose::Press | Purpose::PressOut => 100e3,
                    _ => 0.0,
                },
                CableKey::LeadUs => 0.0,
                CableKey::FollowingError => 1e6,
                // Its encoder may count far more than the file says.
                CableKey::MaxSpeed => rad_per_s * RADIUS_UM * 4.0,
                // There is no load: only its own largest speed limits it.
                CableKey::MaxAcceleration => CableRates::LARGEST.acceleration_mps2 * 1e6,
                CableKey::MaxJerk => CableRates::LARGEST.jerk_mps3 * 1e3,
                CableKey::LengthMin => -2e9,
                CableKey::LengthMax => 2e9,
                CableKey::Node => f64::from(self.node),
                _ => return None,
            };
            #[expect(clippy::cast_possible_truncation, reason = "all are small")]
            Some(value.round() as i32)
        };
        for key in CableKey::ALL {
            let wanted = ConfigKey::cable(self.number() - 1, *key);
            let entry = entries.iter_mut().find(|entry| entry.key == wanted);
            if let (Some(entry), Some(value)) = (entry, changed(*key)) {
                entry.value = value;
            }
        }
        // Two drives with one number conflict: another winch that claims it is not connected today.
        for index in 0..self.robot.cables.len() {
            let claims = self.robot.winch_of(index).map(|winch| winch.node);
            if index != self.index && claims == Some(self.node) {
                let index = u8::try_from(index).unwrap_or(u8::MAX);
                let key = ConfigKey::cable(index, CableKey::Node);
                if let Some(entry) = entries.iter_mut().find(|entry| entry.key == key) {
                    entry.value = i32::from(self.described().node);
                }
            }
        }
        Ok(entries)
    }
}
