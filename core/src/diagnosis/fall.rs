//! A cable whose tension fell at once: it slipped, or it broke; and what it did to the others.

use super::Diagnosis;
use super::window::{Window, mean, tensions_n};
use mcdpr_protocol::FaultId;

/// The first fall is looked for from this long before the fault, ticks: a cable that may be broken is named after 250.
const BACK_TICKS: i32 = 400;
/// What a tension is before it falls: its mean over these ticks.
const CALM_TICKS: i32 = 100;
/// A tension under this is none, N: three times the noise of a sensor for 40 N.
const NONE_N: f64 = 0.3;
/// A tension that counts: before it falls, and when a cable is tight again, N.
const TIGHT_N: f64 = 1.5;
/// A fall takes at most so many ticks, from more than half of the tension to none.
// A cable that is let go keeps no tension for longer than its own vibration, a few milliseconds.
const FALL_TICKS: i32 = 5;
/// Ticks in a row for which a tight cable is tight.
const TIGHT_TICKS: usize = 3;
/// Ticks after the fall in which its own vibration does not count.
const RINGS_TICKS: i32 = 20;
/// A cable that has not been tight for so long after its fall has broken, or hangs slack for good.
const GONE_TICKS: i32 = 700;

/// The cable that fell first, if one did before the fault, and whether it was tight again.
pub(super) fn judge(window: &Window<'_>) -> Option<Diagnosis> {
    let from = -window.before().min(BACK_TICKS);
    let (fell, cable, was_n) = (from + CALM_TICKS..=0).find_map(|tick| {
        let cables = 0..window.cables();
        cables
            .into_iter()
            .find_map(|cable| Some((tick, cable, falls(window, tick, cable)?)))
    })?;
    if !calm(window, fell - FALL_TICKS, cable) {
        return None;
    }
    let number = u8::try_from(cable + 1).ok()?;
    let after = window.ticks(fell + RINGS_TICKS..window.after());
    let mut run = 0;
    let tight = tensions_n(after, cable).any(|tension_n| {
        run = if tension_n > TIGHT_N { run + 1 } else { 0 };
        run >= TIGHT_TICKS
    });
    let watched = i32::try_from(after.len()).unwrap_or(i32::MAX);
    let ago = -fell;
    if tight {
        return Some(Diagnosis {
            // The board's name for a short slip; a cable that it took for broken has slipped further.
            fault: if window.record.fault == FaultId::C3 {
                FaultId::S5
            } else {
                FaultId::C1
            },
            cable: number,
            because: format!(
                "its tension fell from {was_n:.1} N to none within {FALL_TICKS} ms, {ago} ms before the fault was \
                 latched, and it was tight again: it slipped, or lay loose"
            ),
        });
    }
    // Not long enough to tell.
    if watched < GONE_TICKS {
        return None;
    }
    Some(Diagnosis {
        fault: FaultId::C3,
        cable: number,
        because: format!(
            "its tension fell from {was_n:.1} N to none within {FALL_TICKS} ms and it was never tight again: it broke, or \
             slipped so far that it hangs slack"
        ),
    })
}

/// The tension before, N, where it has fallen to none at this tick.
fn falls(window: &Window<'_>, tick: i32, cable: usize) -> Option<f64> {
    let now = tensions_n(window.ticks(tick..tick + 1), cable).next()?;
    if now > NONE_N {
        return None;
    }
    let recent = tensions_n(window.ticks(tick - FALL_TICKS..tick), cable).next()?;
    let before = window.ticks(tick - CALM_TICKS..tick - FALL_TICKS);
    let was_n = mean(tensions_n(before, cable))?;
    (was_n > TIGHT_N && recent > 0.5 * was_n).then_some(was_n)
}

/// Whether nothing had happened to any other cable before: each within half of its mean.
fn calm(window: &Window<'_>, tick: i32, cable: usize) -> bool {
    let before = window.ticks(tick - CALM_TICKS..tick);
    let mut others = (0..window.cables()).filter(|other| *other != cable);
    others.all(|other| {
        let Some(mean_n) = mean(tensions_n(before, other)) else {
            return true;
        };
        let most_n = 0.5 * mean_n + TIGHT_N;
        tensions_n(before, other).all(|tension_n| (tension_n - mean_n).abs() <= most_n)
    })
}
