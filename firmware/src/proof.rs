//! Test of a brake, before torque may be switched off and before a brake may open: the drive
//! releases the load and pushes against the closed brake. Only a brake that holds more than the
//! load passes (B2, B3).
//!
//! Between a motor and its drum, and between drum and brake, there is play. Until the motor is
//! through it, the motor's current gives no information about the brake; afterwards the motor's
//! friction must be subtracted. Both are in the configuration. After the push the motor returns to
//! where it carried the load, so that no drum falls through the play when its brake opens.

use crate::config::{Active, CableConfig, Control};

/// The push beyond the load is half of the load, or at least this, mN.
// 1 N: half of a very small load would prove nothing.
const LEAST_PUSH_MN: i32 = 1000;
/// Greatest distance that a position-held drive releases beyond the play, 0.1 µm.
// 0.5 mm.
const RELIEF_MOST: i32 = 5000;
/// Force that a tension-held drive releases per tick, mN.
// 0.26 N per tick: 10 N are released within 40 ms.
const RELEASE_MN: i32 = 256;
/// In the play a motor turns no faster than this, 0.1 µm per tick (5 mm/s), and a drive commanded
/// by speed changes it by no more than this per tick, µm/s (0.05 m/s²): its current is then that of
/// its friction, not of its inertia.
const THROUGH_PLAY: i32 = 50;
const FASTEST_UMPS: i32 = 5000;
// From rest to 5 mm/s in 100 ms.
const FASTER_UMPS: i32 = 50;
/// Ticks that a current must last behind play: the impact at its end causes ringing.
const LASTS: u8 = 5;

/// Addition for the play of the widest winch to the duration of a test, ms: there and back at
/// [`THROUGH_PLAY`], and as much again for its slow start.
#[must_use]
pub(crate) fn play_ms<const N: usize>(config: &Active<N>) -> u16 {
    let widest = config.cables.iter();
    let widest = widest.map(|cable| cable.play + cable.brake_play).max();
    u16::try_from(widest.unwrap_or(0) * 4 / THROUGH_PLAY).unwrap_or(u16::MAX)
}

/// Result of a brake's test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Unknown.
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
    /// How far the drive has released: 0.1 µm if it holds a position, mN if it gives a force, µm/s
    /// if it is commanded by speed.
    relief: i32,
    /// The brake has held the push; the motor is returning.
    pushed: bool,
    lasted: u8,
    holds: bool,
}

impl Proof {
    /// The drive's release of its set-point: 0.1 µm, mN or µm/s, depending on how the cable is
    /// held.
    #[must_use]
    pub(crate) const fn relief(&self) -> i32 {
        self.relief
    }

    /// One tick under a closed brake: the drum's length (0.1 µm), the motor's current and the load
    /// that the brake must hold.
    pub fn tick(
        &mut self,
        config: &CableConfig,
        length: i32,
        current_ma: i16,
        load_mn: i32,
    ) -> Verdict {
        // A brake that has passed waits for the others; its drive must not push meanwhile.
        if self.holds {
            return Verdict::Holds;
        }
        let from = *self.from.get_or_insert(length);
        let turned = length.saturating_sub(from);
        // A drum under a closed brake may turn by the brake's play and four encoder counts.
        // On the paper's drum four counts are 0.12 mm.
        let most = config.four_counts + config.brake_play;
        if turned.unsigned_abs() > most.unsigned_abs() {
            return Verdict::Slips(turned);
        }
        // The push pays out: it adds to the load on the brake. Friction is subtracted first; at
        // rest it is half as much again.
        // Example: a load of 6 N is pushed with 3 N, so the brake holds 9 N: one and a half times
        // the load.
        let push_mn = (load_mn / 2).max(LEAST_PUSH_MN);
        // A force-controlled drive returns by itself, with the force that it held before.
        let gives_force = config.control == Control::Tension && !config.commands_speed();
        // Only behind a gear is friction large: 4 to 30 N at the cable behind 371:1
        // (docs/tension.md).
        let geared = config.play > 0 || config.commands_speed();
        let rubbing_mn = if geared {
            config.friction_mn + config.friction_mn / 2
        } else {
            0
        };
        // Forces are positive as they reel in.
        let wanted_mn = if self.pushed {
            // Back at the side of the play that carries the load.
            load_mn + rubbing_mn
        } else {
            -(push_mn + rubbing_mn)
        };
        let wanted_ma = config.current_ma(wanted_mn);
        let current_ma = i32::from(current_ma);
        // The sign of a current depends on the winding: both directions are compared. A wanted
        // current of 0 is never reached.
        let reached = (wanted_ma > 0 && current_ma >= wanted_ma)
            || (wanted_ma < 0 && current_ma <= wanted_ma);
        // In a row: a current that rings through the threshold does not count.
        self.lasted = if reached {
            self.lasted.saturating_add(1)
        } else {
            0
        };
        // Without play there is no impact, and one tick at the threshold is a push that the brake
        // held.
        let done = if geared {
            self.lasted >= LASTS
        } else {
            reached
        };
        // A position-held drive returns by its set-point: no current has to be measured on the way
        // back.
        if self.pushed && config.control == Control::Length {
            self.relief = (self.relief - THROUGH_PLAY).max(0);
            self.holds = self.relief == 0;
        } else if done && (self.pushed || !geared || gives_force) {
            (self.relief, self.holds) = (0, true);
        } else if done {
            self.pushed = true;
            self.lasted = 0;
            if config.control == Control::Tension {
                // From a standstill: the speed of the push must not carry on towards the load.
                self.relief = 0;
            }
        } else if config.commands_speed() {
            let step = if self.pushed {
                -FASTER_UMPS
            } else {
                FASTER_UMPS
            };
            // Play-out is positive: the push runs forwards, the return backwards, both at 5 mm/s at
            // most.
            self.relief = (self.relief + step).clamp(-FASTEST_UMPS, FASTEST_UMPS);
        } else {
            self.relief = match config.control {
                // Slowly at first: a stiff drive reaches its full force within micrometres.
                Control::Length if config.play == 0 => {
                    // Grows by a thirty-second per tick: 0.5 mm is reached after some 180 ms.
                    (self.relief + 1 + self.relief / 32).min(RELIEF_MOST + config.brake_play)
                }
                Control::Length => {
                    let step = (1 + self.relief / 64).min(THROUGH_PLAY);
                    (self.relief + step).min(RELIEF_MOST + config.play + config.brake_play)
                }
                // The drive's force before is not exactly the load.
                Control::Tension => {
                    // Bounded at twice the test's force: a drive that gives no torque must not be
                    // wound up without end.
                    let most = 2 * (load_mn + push_mn) + rubbing_mn;
                    (self.relief + RELEASE_MN).min(most)
                }
            };
        }
        if self.holds {
            self.relief = 0;
            return Verdict::Holds;
        }
        Verdict::Pending
    }
}
