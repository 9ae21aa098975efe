//! What failed, by the samples around a fault.
//!
//! A board latches the first condition that lasts: it has to stop within milliseconds, and stops for any of them. Its
//! host has every tick of before and after, and tells apart what looks the same at first: a closed brake from a dead
//! encoder, a slipped cable from a broken one, a cable that snaps tight from one that was slack before it.

mod drum;
mod fall;
mod window;

use crate::link::client::Row;
use crate::motion::Model;
use mcdpr_protocol::{FaultId, FaultRecord};
use std::fmt;
use window::Window;

/// The probable cause of a latched fault.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnosis {
    /// The fault of docs/faults.md.
    pub fault: FaultId,
    /// Its cable, 1 for the first.
    pub cable: u8,
    /// What shows it.
    pub because: String,
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (name, what, cable) = (self.fault.name(), self.fault.what(), self.cable);
        write!(
            to,
            "probable cause {name}: {what} on cable {cable}, because {}",
            self.because
        )
    }
}

/// The probable cause of this fault, where the ticks around it show another than the latched one, or another cable.
///
/// `rows` are in order of time and reach from before the fault to some time after the robot has come to rest; what they
/// do not cover stays undecided.
pub(crate) fn diagnose(model: &Model, record: &FaultRecord, rows: &[Row]) -> Option<Diagnosis> {
    let window = Window::new(model.robot(), record, rows)?;
    let found = match record.fault {
        FaultId::S2 | FaultId::S4 | FaultId::S6 | FaultId::D2 | FaultId::D4 | FaultId::D7 => {
            drum::judge(&window).or_else(|| fall::judge(&window))
        }
        FaultId::C1 | FaultId::C2 | FaultId::C3 | FaultId::C5 | FaultId::S5 => fall::judge(&window),
        _ => None,
    };
    found.filter(|found| (found.fault, found.cable) != (record.fault, record.cable))
}
