//! A drum that does not turn as its motor should turn it: its brake, its encoder, or its drive.

use super::Diagnosis;
use super::window::{Window, lengths_m, spread};
use mcdpr_protocol::FaultId;

/// A motor at this share of its greatest current gives all it has.
const ALL: f64 = 0.9;
/// Ticks for which it must have done so.
// Three quarters of D2's 20 ticks: a motor that accelerates a rotor is at its limit for a few.
const PUSHED_TICKS: usize = 15;
/// Ticks in which an open encoder input shows itself, and how often its count must change in them.
// Interference changes it in every second tick (the simulator), or with the motors' switching. A drum that swings with
// its platform changes by a count some ten times.
const FLICKER_TICKS: i32 = 400;
const FLICKERS: usize = 60;

/// The cause for a drum that is not where it should be.
pub(super) fn judge(window: &Window<'_>) -> Option<Diagnosis> {
    let cable = usize::from(window.record.cable).checked_sub(1)?;
    flickers(window, cable).or_else(|| stands(window, cable))
}

/// The count of an encoder whose inputs are open changes by one, back and forth (S6): at arming that may look like a drum
/// that turns the wrong way.
fn flickers(window: &Window<'_>, cable: usize) -> Option<Diagnosis> {
    if !matches!(window.record.fault, FaultId::S2 | FaultId::S4) {
        return None;
    }
    let count_m = window.count_m(cable)?;
    let rows = window.ticks(-FLICKER_TICKS..1);
    let lengths = lengths_m(rows, cable);
    let changes = lengths.clone().zip(lengths.clone().skip(1));
    let changes = changes
        .filter(|(before, now)| (now - before).abs() > 0.5 * count_m)
        .count();
    (changes >= FLICKERS && spread(lengths) < 2.5 * count_m).then(|| Diagnosis {
        fault: FaultId::S6,
        cable: window.record.cable,
        because: format!(
            "its count changed {changes} times in {} ms and stayed within two counts: an input is open",
            rows.len()
        ),
    })
}

/// A drum stands while its motor gives all it has: something holds it, first of all its brake (B1).
fn stands(window: &Window<'_>, cable: usize) -> Option<Diagnosis> {
    let most_a = window.robot.winch_of(cable)?.max_current_a;
    let count_m = window.count_m(cable)?;
    let rows = window.ticks(-window.before()..1);
    let pushed = rows.iter().rev().take_while(|row| {
        let current_a = row.currents_a.get(cable).copied().unwrap_or(0.0);
        current_a.abs() >= ALL * most_a
    });
    let pushed = pushed.count();
    let rows = rows.get(rows.len() - pushed..)?;
    (pushed >= PUSHED_TICKS && spread(lengths_m(rows, cable)) < 1.5 * count_m).then(|| Diagnosis {
        fault: FaultId::B1,
        cable: window.record.cable,
        because: format!(
            "its motor gave its greatest current, {most_a} A, for {pushed} ms and the drum stood: its brake is closed, or \
             the drum is jammed"
        ),
    })
}
