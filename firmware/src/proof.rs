//! Proving a brake: before torque may go, and before a brake may open, the drive lets go of the
//! load and pushes against the closed brake. Only a brake that holds more than the load is trusted
//! with it (B2, B3).
//!
//! The proof is static. A geared rotor is heavy at the cable (34 kg at 371:1): it takes a tenth of a
//! second to turn four encoder counts against a brake that lacks a newton, while a drive has its
//! current within milliseconds. So the push is held, and the drum judges.

use crate::config::{CableConfig, Control};

/// What a brake must hold beyond the load: half of the load, or at least this, mN.
const LEAST_MORE_MN: i32 = 1000;
/// The push goes beyond what a brake must hold by a sixteenth, or by this, mN, but no more than an
/// eighth: what drives and sensors may be off by, and what turns a heavy rotor in time.
const MARGIN_MN: i32 = 250;
/// Ticks for which the push is held. A brake that lacks 0.25 N lets 34 kg turn by 147 µm in that
/// time, one that lacks a sixteenth of 13 N by 480 µm; four counts are 123 µm on the paper's winch.
const HOLD_TICKS: u16 = 200;
/// Farthest that a position-held drive lets go, 0.1 µm.
const RELIEF_MOST: i32 = 5000;
/// Force that a tension-held drive lets go per tick, mN, at most and at least.
const RELEASE_MN: i32 = 256;
const LEAST_RELEASE_MN: i32 = 8;

/// What is known of a brake.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Nothing yet.
    Pending,
    /// It held the load and half as much again.
    Holds,
    /// The drum turned, by this many 0.1 µm.
    Slips(i32),
}

/// The test of one brake.
#[derive(Debug, Clone, Copy, Default)]
pub struct Proof {
    /// Length before, 0.1 µm.
    from: Option<i32>,
    /// How far the drive has let go: 0.1 µm where it holds a position, mN where it gives a force.
    relief: i32,
    /// Ticks with the whole push.
    pushed: u16,
    holds: bool,
}

impl Proof {
    /// How far the drive shall let go of what it holds: 0.1 µm or mN, as the cable is held.
    #[must_use]
    pub const fn relief(&self) -> i32 {
        self.relief
    }

    /// What the motor gives in the proof of a brake under this load, mN: it pays out, so it adds to
    /// the load. The winch's own friction holds, too, but is not the brake's.
    fn push_mn(config: &CableConfig, load_mn: i32) -> i32 {
        let load_mn = load_mn.max(0);
        let must_hold_mn = load_mn + (load_mn / 2).max(LEAST_MORE_MN);
        let more_mn = MARGIN_MN.min(must_hold_mn >> 3).max(must_hold_mn >> 4);
        must_hold_mn + more_mn - load_mn + config.friction_mn
    }

    /// One tick under a closed brake: the drum's length (0.1 µm), the motor's current and the load
    /// that hangs on the brake, mN.
    pub fn tick(
        &mut self,
        config: &CableConfig,
        length: i32,
        current_ma: i16,
        load_mn: i32,
    ) -> Verdict {
        if self.holds {
            return Verdict::Holds;
        }
        let from = *self.from.get_or_insert(length);
        let turned = length.saturating_sub(from);
        // A drum under a closed brake may turn by four encoder counts.
        if turned.unsigned_abs() > config.four_counts.unsigned_abs() {
            return Verdict::Slips(turned);
        }
        let push_mn = Self::push_mn(config, load_mn);
        let push_ma = config.current_ma(-push_mn);
        let wanted_ma = push_ma.abs().max(1);
        let given_ma = i32::from(current_ma) * push_ma.signum();
        // A current that is measured in steps is the whole one within a thirty-second.
        if given_ma >= wanted_ma - (wanted_ma >> 5) {
            self.pushed += 1;
        }
        if self.pushed >= HOLD_TICKS {
            *self = Self {
                holds: true,
                ..Self::default()
            };
            return Verdict::Holds;
        }
        let missing_ma = wanted_ma - given_ma;
        match config.control {
            // Slowly at first and at last: a stiff drive has all its force within micrometres, and
            // its feedback is some milliseconds late. One that integrates goes on to push, so it is
            // taken back.
            Control::Length => {
                let share = missing_ma.abs().min(wanted_ma);
                let step = 1 + self.relief * share / (32 * wanted_ma);
                let relief = self.relief + missing_ma.signum() * step;
                self.relief = relief.clamp(0, RELIEF_MOST);
            }
            // What the drive gave before is not quite the load: the last of it is felt for, slower
            // than its current is told.
            Control::Tension if missing_ma > 0 => {
                let step = (push_mn / wanted_ma).max(1).saturating_mul(missing_ma) / 16;
                let relief = self.relief + step.clamp(LEAST_RELEASE_MN, RELEASE_MN);
                self.relief = relief.min(2 * (load_mn.max(0) + push_mn));
            }
            Control::Tension => {}
        }
        Verdict::Pending
    }
}
