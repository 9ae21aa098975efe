//! Test of a brake, before torque may be switched off and before a brake may open: the drive
//! releases the load and pushes against the closed brake. Only a brake that holds more than the
//! load passes (B2, B3).
//!
//! The test is static. A geared rotor is heavy at the cable (34 kg at 371:1): against a brake that
//! lacks a newton it needs a tenth of a second to turn four encoder counts, while a drive has its
//! current within milliseconds. So the push is held, and the drum's encoder decides.
//!
//! Between a motor and its drum, and between drum and brake, there is play. Until the motor is
//! through it, the motor's current gives no information about the brake; afterwards the motor's
//! friction must be subtracted. Both are in the configuration. After the push the motor returns to
//! where it carried the load, so that no drum falls through the play when its brake opens.

use crate::config::{Active, CableConfig, Control};

/// A brake must hold half of the load beyond the load, or at least this, mN.
const LEAST_MORE_MN: i32 = 1000;
/// The push exceeds what a brake must hold by a sixteenth, or by this, mN, but by no more than an
/// eighth: errors of drives and sensors, and what turns a heavy rotor in time.
const MARGIN_MN: i32 = 250;
/// Ticks for which the push is held: 0.25 N turn 34 kg by 147 um in that time; four counts are
/// 123 um on the paper's winch.
const HOLD_TICKS: u16 = 200;
/// Greatest distance that a position-held drive releases beyond the play, 0.1 µm.
const RELIEF_MOST: i32 = 5000;
/// Force that a tension-held drive releases per tick, mN: at most and at least.
const RELEASE_MN: i32 = 256;
const LEAST_RELEASE_MN: i32 = 8;
/// In the play a motor turns no faster than this, 0.1 µm per tick (5 mm/s), and a drive commanded
/// by speed changes it by no more than this per tick, µm/s (0.05 m/s²): its current is then that of
/// its friction, not of its inertia.
const THROUGH_PLAY: i32 = 50;
const FASTEST_UMPS: i32 = 5000;
const FASTER_UMPS: i32 = 50;
/// Ticks that a current must last behind play: the impact at its end causes ringing.
const LASTS: u16 = 5;

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
    /// Ticks with the wanted current.
    lasted: u16,
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
        if self.holds {
            return Verdict::Holds;
        }
        let from = *self.from.get_or_insert(length);
        let turned = length.saturating_sub(from);
        // A drum under a closed brake may turn by the brake's play and four encoder counts.
        let most = config.four_counts + config.brake_play;
        if turned.unsigned_abs() > most.unsigned_abs() {
            return Verdict::Slips(turned);
        }
        // The push pays out: it adds to the load on the brake. The winch's friction holds, too, but
        // is not the brake's; behind a gear it is half as much again at rest.
        let push_mn = push_mn(load_mn);
        // A force-controlled drive returns by itself, with the force that it held before.
        let gives_force = config.control == Control::Tension && !config.commands_speed();
        let geared = config.play > 0 || config.commands_speed();
        let rubbing_mn = if geared {
            config.friction_mn + config.friction_mn / 2
        } else {
            config.friction_mn
        };
        let wanted_mn = if self.pushed {
            // Back at the side of the play that carries the load.
            load_mn + rubbing_mn
        } else {
            -(push_mn + rubbing_mn)
        };
        let wanted_ma = config.current_ma(wanted_mn);
        let given_ma = i32::from(current_ma) * wanted_ma.signum();
        let wanted_ma = wanted_ma.abs().max(1);
        // A current that is measured in steps is complete within a thirty-second.
        let reached = given_ma >= wanted_ma - (wanted_ma >> 5);
        if reached {
            self.lasted += 1;
        } else if self.pushed {
            self.lasted = 0;
        }
        if self.pushed {
            self.go_back(config, self.lasted >= LASTS);
        } else if self.lasted >= HOLD_TICKS {
            if !geared || gives_force {
                self.holds = true;
            } else {
                self.pushed = true;
                self.lasted = 0;
                if config.control == Control::Tension {
                    self.relief = 0;
                }
            }
        } else {
            let most_mn = 2 * (load_mn.max(0) + push_mn) + rubbing_mn;
            self.release(config, wanted_ma, wanted_ma - given_ma, push_mn, most_mn);
        }
        if self.holds {
            self.relief = 0;
            return Verdict::Holds;
        }
        Verdict::Pending
    }

    /// Releases the set-point until the drive gives the wanted current, and no more of it: a drive
    /// that integrates increases its current as long as it is off.
    fn release(
        &mut self,
        config: &CableConfig,
        wanted_ma: i32,
        missing_ma: i32,
        push_mn: i32,
        most_mn: i32,
    ) {
        let share = missing_ma.abs().min(wanted_ma);
        if config.commands_speed() {
            let target = missing_ma.signum() * (FASTEST_UMPS * share / wanted_ma);
            let step = (target - self.relief).clamp(-FASTER_UMPS, FASTER_UMPS);
            self.relief += step;
        } else if config.control == Control::Length {
            // Slowly at first and at last: a stiff drive reaches its full force within micrometres,
            // and its feedback is some milliseconds late.
            let step = if config.play == 0 {
                1 + self.relief * share / (32 * wanted_ma)
            } else {
                (1 + self.relief * share / (64 * wanted_ma)).min(THROUGH_PLAY)
            };
            let relief = self.relief + missing_ma.signum() * step;
            self.relief = relief.clamp(0, RELIEF_MOST + config.play + config.brake_play);
        } else if missing_ma > 0 {
            // The drive's force before is not exactly the load: the last part is approached slower
            // than its current is reported.
            let step = (push_mn / wanted_ma).max(1).saturating_mul(missing_ma) / 16;
            let relief = self.relief + step.clamp(LEAST_RELEASE_MN, RELEASE_MN);
            self.relief = relief.min(most_mn);
        }
    }

    /// Behind play the motor returns to where it carried the load.
    fn go_back(&mut self, config: &CableConfig, carries: bool) {
        if config.control == Control::Length {
            self.relief = (self.relief - THROUGH_PLAY).max(0);
            self.holds = self.relief == 0;
        } else if carries {
            self.holds = true;
        } else {
            self.relief = (self.relief - FASTER_UMPS).max(-FASTEST_UMPS);
        }
    }
}

/// What the motor adds to the load in the test of a brake, mN.
fn push_mn(load_mn: i32) -> i32 {
    let load_mn = load_mn.max(0);
    let must_hold_mn = load_mn + (load_mn / 2).max(LEAST_MORE_MN);
    let margin_mn = MARGIN_MN.min(must_hold_mn >> 3).max(must_hold_mn >> 4);
    must_hold_mn + margin_mn - load_mn
}
