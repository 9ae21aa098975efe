//! Lengths kept over a loss of power: brakes hold the drums, and a store keeps the paid-out
//! lengths.
//!
//! They are used only if they belong to this board and to a robot file with the same geometry and
//! scale, and if the sensors show the saved tensions now.

use crate::motion::Model;
use crate::robot::Robot;
use mcdpr_protocol::{Hello, Status};
use miette::Diagnostic;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A tension may have changed by this, N, or by a fifth: as arming allows.
const TENSION_BAND_N: f64 = 2.0;
/// Greatest residual of a resting pose at which lengths are plausible, m.
/// As the board's limit in motion (S5) has it besides inexact tensions.
const CLOSURE_M: f64 = 0.004;

/// The saved values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Saved {
    /// The board's number, hexadecimal.
    pub board: String,
    /// Checksum of geometry and scale: the values that convert turns to positions.
    pub scale: u32,
    /// Paid-out lengths, m.
    pub lengths_m: Vec<f64>,
    /// Tensions with brakes closed, N.
    pub tensions_n: Vec<f64>,
}

/// Why saved lengths are not used.
#[derive(Debug, Clone, PartialEq, Error, Diagnostic)]
pub enum Implausible {
    /// None were saved.
    #[error("no lengths were saved for this board")]
    None,
    /// The robot file's geometry or scale has changed since.
    #[error("the robot file's geometry or scale has changed since the lengths were saved")]
    Scale,
    /// A tension has changed.
    #[error(
        "cable {cable} shows {now_n:.1} N where {then_n:.1} N were saved: it was moved or touched"
    )]
    Tension {
        /// The cable, 1 for the first.
        cable: usize,
        /// Shown now, N.
        now_n: f64,
        /// Saved, N.
        then_n: f64,
    },
    /// The lengths fit no resting pose.
    #[error("the saved lengths fit no resting pose ({off_mm:.1} mm off)")]
    Lengths {
        /// By how much, mm.
        off_mm: f64,
    },
}

/// The checksum of all values that convert encoder counts to positions: a gain may change without
/// losing home, a drum radius or an anchor may not.
#[must_use]
pub fn scale_of(robot: &Robot) -> u32 {
    let winches = robot.winches.iter().map(|winch| {
        serde_json::json!([
            winch.id,
            winch.drum_radius_m,
            winch.encoder_counts_per_turn,
            winch.encoder_sign,
            winch.motor_counts_per_turn,
        ])
    });
    let winches: Vec<_> = winches.collect();
    let text = serde_json::json!([robot.cables, winches, robot.tool]).to_string();
    mcdpr_protocol::frame::crc32(text.as_bytes())
}

impl Saved {
    /// The values of a disarmed board.
    #[must_use]
    pub fn of(hello: &Hello, status: &Status, robot: &Robot) -> Self {
        Self {
            board: board_name(hello),
            scale: scale_of(robot),
            lengths_m: status.lengths_m().collect(),
            tensions_n: status.tensions_n().collect(),
        }
    }

    /// Checks the saved values of a robot whose sensors show `tensions_n` now.
    ///
    /// # Errors
    /// [`Implausible`] with the reason.
    pub fn check(&self, model: &Model, tensions_n: &[f64]) -> Result<(), Implausible> {
        if self.scale != scale_of(model.robot()) {
            return Err(Implausible::Scale);
        }
        let pairs = tensions_n.iter().zip(&self.tensions_n);
        for (cable, (&now_n, &then_n)) in (1..).zip(pairs) {
            let band = TENSION_BAND_N.max(then_n / 5.0);
            let off_n = (now_n - then_n).abs();
            // A NaN is never greater than the band: it would pass as unchanged.
            if off_n.is_nan() || off_n > band {
                return Err(Implausible::Tension {
                    cable,
                    now_n,
                    then_n,
                });
            }
        }
        let rest = model.rest_from_lengths(&self.lengths_m, &self.tensions_n);
        let off_m = rest.map_or(f64::INFINITY, |rest| {
            let pairs = rest.paid_out_m.iter().zip(&self.lengths_m);
            pairs.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()))
        });
        if off_m > CLOSURE_M {
            return Err(Implausible::Lengths {
                off_mm: off_m * 1e3,
            });
        }
        Ok(())
    }
}

/// A board's number in hexadecimal.
#[must_use]
pub fn board_name(hello: &Hello) -> String {
    hello.board_id.iter().map(|b| format!("{b:02x}")).collect()
}

/// Where lengths are kept over a loss of power.
pub trait LengthStore {
    /// The values saved last for a board, by its number in hexadecimal.
    fn load(&self, board: &str) -> Option<Saved>;

    /// Saves lengths in place of those of the same board. A failure to save costs a homing, not the
    /// run: the store reports it to the user.
    fn keep(&self, saved: &Saved);

    /// The lengths of a board were referenced anew: what was measured with the lengths before is not valid.
    fn homed(&self, _board: &str) {}

    /// When the lengths of a board were last referenced anew, s since 1970; `None` if that is not known.
    fn homed_unix_s(&self, _board: &str) -> Option<u64> {
        None
    }

    /// Discards the lengths of a board: its drums are about to turn.
    fn forget(&self, _board: &str) {}
}

/// Keeps nothing: for simulated robots.
#[derive(Debug, Clone, Copy)]
pub struct NoStore;

impl LengthStore for NoStore {
    fn load(&self, _board: &str) -> Option<Saved> {
        None
    }

    fn keep(&self, _saved: &Saved) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_believed_only_if_nothing_was_moved_or_rescaled() {
        let robot = Robot::built_in("paper-optimistic").unwrap();
        let model = Model::new(&robot).unwrap();
        let rest = model.rest(&robot.tool.home_in_world_m, None).unwrap();
        let saved = Saved {
            board: "00".to_owned(),
            scale: scale_of(&robot),
            lengths_m: rest.paid_out_m.clone(),
            tensions_n: rest.tensions_n().to_vec(),
        };
        let now = rest.tensions_n().to_vec();
        assert_eq!(saved.check(&model, &now), Ok(()));

        let mut moved = now.clone();
        moved[2] += 5.0;
        let found = saved.check(&model, &moved).unwrap_err();
        assert!(
            matches!(found, Implausible::Tension { cable: 3, .. }),
            "{found}"
        );

        let mut rescaled = robot.clone();
        rescaled.winches[1].drum_radius_m *= 1.01;
        let other = Model::new(&rescaled).unwrap();
        assert_eq!(saved.check(&other, &now), Err(Implausible::Scale));

        let mut gains = robot.clone();
        gains.tension.kp *= 2.0;
        assert_eq!(saved.check(&Model::new(&gains).unwrap(), &now), Ok(()));

        let mut slipped = saved.clone();
        slipped.lengths_m[3] += 0.02;
        let found = slipped.check(&model, &now).unwrap_err();
        assert!(matches!(found, Implausible::Lengths { .. }), "{found}");
    }
}
