//! Lengths kept over a loss of power: brakes hold the drums, and a file remembers what they paid
//! out.
//!
//! A file is believed only if it is of this board, of a robot file with the same geometry and
//! scale, and if the tensions that the sensors show now are those of its lengths.

use crate::motion::Model;
use crate::robot::Robot;
use mcdpr_protocol::{Hello, Status};
use miette::Diagnostic;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use thiserror::Error;

/// A tension may have changed by this, N, or by a fifth: as arming allows.
const TENSION_BAND_N: f64 = 2.0;
/// Lengths that a resting pose explains to this are plausible, m.
const CLOSURE_M: f64 = 0.004;

/// What is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Saved {
    /// Of which board, hexadecimal.
    pub board: String,
    /// Checksum of geometry and scale: what turns counts into places.
    pub scale: u32,
    /// Paid-out lengths, m.
    pub lengths_m: Vec<f64>,
    /// Tensions with brakes closed, N.
    pub tensions_n: Vec<f64>,
}

/// Why saved lengths are not believed.
#[derive(Debug, Clone, PartialEq, Error, Diagnostic)]
pub enum Implausible {
    /// None were saved.
    #[error("no lengths were saved for this board")]
    None,
    /// The robot file's geometry or scale has changed since.
    #[error("the robot file's geometry or scale has changed since the lengths were saved")]
    Scale,
    /// A tension is not what it was.
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

/// The checksum of everything that turns encoder counts into places: a gain may change without
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
    /// What a disarmed board knows.
    #[must_use]
    pub fn of(hello: &Hello, status: &Status, robot: &Robot) -> Self {
        Self {
            board: board_name(hello),
            scale: scale_of(robot),
            lengths_m: status.lengths_m().collect(),
            tensions_n: status.tensions_n().collect(),
        }
    }

    /// Whether it can be believed of a robot whose sensors show `tensions_n` now.
    ///
    /// # Errors
    /// [`Implausible`] says why not.
    pub fn check(&self, model: &Model, tensions_n: &[f64]) -> Result<(), Implausible> {
        if self.scale != scale_of(model.robot()) {
            return Err(Implausible::Scale);
        }
        let pairs = tensions_n.iter().zip(&self.tensions_n);
        for (cable, (&now_n, &then_n)) in (1..).zip(pairs) {
            let band = TENSION_BAND_N.max(then_n / 5.0);
            let off_n = (now_n - then_n).abs();
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

    /// Keeps it, whole, in place of the old one.
    ///
    /// # Errors
    /// The system's.
    pub fn store(&self) -> std::io::Result<()> {
        let path = path_of(&self.board).ok_or(std::io::ErrorKind::NotFound)?;
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        crate::files::write_atomically(&path, serde_json::to_vec_pretty(self)?)
    }

    /// What was kept for a board.
    ///
    /// # Errors
    /// [`Implausible::None`].
    pub fn load(hello: &Hello) -> Result<Self, Implausible> {
        let text = path_of(&board_name(hello)).and_then(|path| std::fs::read(path).ok());
        let saved = text.and_then(|text| serde_json::from_slice(&text).ok());
        saved.ok_or(Implausible::None)
    }
}

/// A board's number in hexadecimal.
fn board_name(hello: &Hello) -> String {
    hello.board_id.iter().map(|b| format!("{b:02x}")).collect()
}

/// `$XDG_STATE_HOME/mcdpr/lengths-BOARD.json`, by default under `~/.local/state`.
fn path_of(board: &str) -> Option<PathBuf> {
    let given = std::env::var_os("XDG_STATE_HOME").filter(|dir| !dir.is_empty());
    let folder = match given {
        Some(folder) => PathBuf::from(folder),
        None => PathBuf::from(std::env::var_os("HOME")?).join(".local/state"),
    };
    Some(folder.join("mcdpr").join(format!("lengths-{board}.json")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_believed_only_if_nothing_was_moved_or_rescaled() {
        let robot = Robot::find("paper-table5").unwrap();
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
