//! The ticks around a fault, as the rules of a diagnosis read them.

use crate::link::client::Row;
use crate::robot::Robot;
use mcdpr_protocol::FaultRecord;
use std::ops::Range;

/// The samples of a robot around the tick at which a fault was latched.
pub(super) struct Window<'a> {
    /// The robot, by its file.
    pub(super) robot: &'a Robot,
    /// The latched fault.
    pub(super) record: &'a FaultRecord,
    rows: &'a [Row],
    /// Position of the fault's tick in the rows.
    at: usize,
}

impl<'a> Window<'a> {
    /// `None` if the rows do not reach back to the fault.
    pub(super) fn new(robot: &'a Robot, record: &'a FaultRecord, rows: &'a [Row]) -> Option<Self> {
        // A wrap of the ticks (K9) lies on neither side.
        let at = rows
            .iter()
            .position(|row| row.tick.since(record.tick) >= 0)?;
        Some(Self {
            robot,
            record,
            rows,
            at,
        })
    }

    /// Number of cables.
    pub(super) fn cables(&self) -> usize {
        self.rows.first().map_or(0, |row| row.tensions_n.len())
    }

    /// Rows of these ticks, counted from the fault's; shorter where samples are missing.
    pub(super) fn ticks(&self, range: Range<i32>) -> &'a [Row] {
        let position = |tick: i32| {
            let tick = isize::try_from(tick).unwrap_or(0);
            self.at.saturating_add_signed(tick).min(self.rows.len())
        };
        let (from, to) = (position(range.start), position(range.end));
        self.rows.get(from..to.max(from)).unwrap_or_default()
    }

    /// Ticks between the first row and the fault's.
    pub(super) fn before(&self) -> i32 {
        i32::try_from(self.at).unwrap_or(i32::MAX)
    }

    /// Ticks from the fault's to the last row.
    pub(super) fn after(&self) -> i32 {
        i32::try_from(self.rows.len() - self.at).unwrap_or(i32::MAX)
    }

    /// Cable that one count of a drum's encoder winds, m.
    pub(super) fn count_m(&self, cable: usize) -> Option<f64> {
        let winch = self.robot.winch_of(cable)?;
        let turn_m = std::f64::consts::TAU * winch.drum_radius_m;
        Some(turn_m / f64::from(winch.encoder_counts_per_turn.max(1)))
    }
}

/// A cable's lengths, m.
pub(super) fn lengths_m(rows: &[Row], cable: usize) -> impl Iterator<Item = f64> + Clone {
    rows.iter()
        .filter_map(move |row| row.lengths_m.get(cable).copied())
}

/// A cable's tensions, N.
pub(super) fn tensions_n(rows: &[Row], cable: usize) -> impl Iterator<Item = f64> + Clone {
    rows.iter()
        .filter_map(move |row| row.tensions_n.get(cable).copied())
}

/// The mean; `None` of nothing.
pub(super) fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    (count > 0.0).then(|| sum / count)
}

/// Greatest minus least value; 0 of nothing.
pub(super) fn spread(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let greatest = values.clone().fold(f64::NEG_INFINITY, f64::max);
    let least = values.fold(f64::INFINITY, f64::min);
    (greatest - least).max(0.0)
}
