//! Proving a brake: before torque may go, and before a brake may open, the drive lets go of the
//! load and pushes against the closed brake. Only a brake that holds more than the load is trusted
//! with it (B2, B3).

use crate::config::{CableConfig, Control};

/// The push beyond the load is half of the load, or at least this, mN.
const LEAST_PUSH_MN: i32 = 1000;
/// Farthest that a position-held drive lets go, 0.1 µm.
const RELIEF_MOST: i32 = 5000;
/// Force that a tension-held drive lets go per tick, mN.
const RELEASE_MN: i32 = 256;

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
    holds: bool,
}

impl Proof {
    /// How far the drive shall let go of what it holds: 0.1 µm or mN, as the cable is held.
    #[must_use]
    pub const fn relief(&self) -> i32 {
        self.relief
    }

    /// One tick under a closed brake: the drum's length (0.1 µm), the motor's current and the load
    /// that the brake is to hold.
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
        // The push pays out: it adds to the load on the brake.
        let push_mn = (load_mn / 2).max(LEAST_PUSH_MN);
        let push_ma = config.current_ma(-push_mn);
        let current_ma = i32::from(current_ma);
        if (push_ma > 0 && current_ma >= push_ma) || (push_ma < 0 && current_ma <= push_ma) {
            *self = Self {
                holds: true,
                ..Self::default()
            };
            return Verdict::Holds;
        }
        self.relief = match config.control {
            // Slowly at first: a stiff drive has all its force within micrometres.
            Control::Length => (self.relief + 1 + self.relief / 32).min(RELIEF_MOST),
            // What the drive gave before is not quite the load.
            Control::Tension => (self.relief + RELEASE_MN).min(2 * (load_mn + push_mn)),
        };
        Verdict::Pending
    }
}
