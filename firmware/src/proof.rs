//! Test of a brake, before torque may be switched off and before a brake may open: the drive
//! releases the load and pushes against the closed brake. Only a brake that holds more than the
//! load passes (B2, B3).
//!
//! The test is static. A geared rotor is heavy at the cable (34 kg behind 371:1): a drive has its
//! current within milliseconds, while a drum whose brake lacks a newton needs a tenth of a second to
//! turn by four encoder counts. So the push is held, and the drum judges.
//!
//! Between a motor and its drum, and between drum and brake, there is play. Until the motor is
//! through it, the motor's current gives no information about the brake; afterwards the motor's
//! friction must be subtracted. Both are in the configuration. After the push the motor returns to
//! where it carried the load, so that no drum falls through the play when its brake opens. A drive
//! that holds a position has an integral, which goes on to push: it takes its load up again first.
//! Where the motor was before says nothing behind play: after a loss of power it may be anywhere in it.

use crate::config::{Active, CableConfig, Control};

/// What a brake must hold beyond the load is half of the load, or at least this, mN.
// 1 N: half of a very small load would prove nothing.
const LEAST_PUSH_MN: i32 = 1000;
/// The push exceeds what a brake must hold by this share, as a shift: an eighth. It is what moves a drum
/// whose brake barely fails.
const MARGIN_SHIFT: u32 = 3;
/// Ticks for which the push is held.
// A brake that lacks 0.25 N lets 34 kg turn by 0.15 mm in 200 ms; four encoder counts of the paper's
// drum are 0.12 mm.
const HOLD_TICKS: u16 = 200;
/// Ticks for which a position-held drive carries its load again before its brake may open.
// Five times the time in which the simulated drive's integral takes over from its set-point, 20 ms.
const CARRY_TICKS: u16 = 100;
/// Greatest distance that a position-held drive releases beyond the play, 0.1 µm.
// 0.5 mm.
const RELIEF_MOST: i32 = 5000;
/// Force that a tension-held drive releases per tick, mN, at most and at least.
// 0.26 N per tick: 10 N are released within 40 ms. The last of it is felt for: the current follows
// its command after some ticks.
const RELEASE_MN: i32 = 256;
const LEAST_RELEASE_MN: i32 = 8;
/// In the play a motor turns no faster than this, 0.1 µm per tick (5 mm/s), and a drive commanded
/// by speed changes it by no more than this per tick, µm/s (0.05 m/s²): its current is then that of
/// its friction, not of its inertia.
const THROUGH_PLAY: i32 = 50;
const FASTEST_UMPS: i32 = 5000;
/// From where it was a motor goes on towards the load by this, 0.1 µm per tick (1 mm/s): slowly, because behind the play
/// a stiff gear winds up.
// A gear of 300 N m/rad behind a drum of 20 mm: 0.75 N a tick.
const INTO_LOAD: i32 = 10;
// From rest to 5 mm/s in 100 ms.
const FASTER_UMPS: i32 = 50;
/// Ticks that a current must last behind play on the way back: the impact at its end causes ringing.
const LASTS: u16 = 5;

/// Addition for the play of the widest winch to the duration of a test, ms: there and back at
/// [`THROUGH_PLAY`], as much again for its slow start, and once at [`INTO_LOAD`].
#[must_use]
pub(crate) fn play_ms<const N: usize>(config: &Active<N>) -> u16 {
    let widest = config.cables.iter();
    let widest = widest.map(|cable| cable.play + cable.brake_play).max();
    u16::try_from(widest.unwrap_or(0) * 9 / THROUGH_PLAY).unwrap_or(u16::MAX)
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
    holds: bool,
    /// Ticks with the wanted current.
    lasted: u16,
}

impl Proof {
    /// The drive's release of its set-point: 0.1 µm, mN or µm/s, depending on how the cable is
    /// held.
    #[must_use]
    pub(crate) const fn relief(&self) -> i32 {
        self.relief
    }

    /// Once it holds: the release at which the motor of a length-held cable carries its load behind play, 0.1 µm. It is
    /// not taken back.
    pub(crate) const fn take_carried(&mut self) -> i32 {
        core::mem::replace(&mut self.relief, 0)
    }

    /// One tick under a closed brake: the drum's length (0.1 µm), the motor's current, the load that
    /// the brake must hold, and whether the brake opens next.
    pub fn tick(
        &mut self,
        config: &CableConfig,
        length: i32,
        current_ma: i16,
        load_mn: i32,
        opens: bool,
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
        // The push pays out: it adds to the load on the brake. Friction is subtracted first; behind a
        // gear it is half as much again at rest.
        // Example: a load of 6 N. The brake must hold 9 N; it is pushed with 4.1 N.
        let load_mn = load_mn.max(0);
        let more_mn = (load_mn / 2).max(LEAST_PUSH_MN);
        let needed_mn = load_mn + more_mn;
        let push_mn = more_mn + (needed_mn >> MARGIN_SHIFT);
        // A force-controlled drive returns by itself, with the force that it held before.
        let by_length = config.control == Control::Length;
        let gives_force = !by_length && !config.commands_speed();
        // Only behind a gear is friction large: 4 to 30 N at the cable behind 371:1
        // (docs/tension.md).
        let geared = config.play > 0 || config.commands_speed();
        let rubbing_mn = config.friction_mn + if geared { config.friction_mn / 2 } else { 0 };
        // Forces are positive as they reel in. The way back ends where the motor carries the load.
        let wanted_ma = config.current_ma(if !self.pushed {
            -(push_mn + rubbing_mn)
        } else if geared {
            load_mn + rubbing_mn
        } else {
            load_mn
        });
        let most_ma = wanted_ma.abs().max(1);
        // The sign of a current depends on the winding.
        let missing_ma = most_ma - i32::from(current_ma) * wanted_ma.signum();
        // A current is measured in steps: it is complete within a thirty-second. What carries the
        // load need not be exact.
        let reached = missing_ma <= most_ma >> if self.pushed { 3 } else { 5 };
        // Behind a gear in a row on the way back: a current that rings through the threshold does not
        // count. A drive of 34 kg changes its current by 0.3 N for a motor count, so that it is not at
        // rest elsewhere.
        if reached {
            self.lasted = self.lasted.saturating_add(1);
        } else if self.pushed && geared {
            self.lasted = 0;
        }
        let ticks = match (self.pushed, geared) {
            (false, _) => HOLD_TICKS,
            (true, false) => CARRY_TICKS,
            (true, true) => LASTS,
        };
        if self.pushed && geared && by_length {
            // Back to where it was, and on until the current carries the load, by the play at most.
            self.relief -= if self.relief > THROUGH_PLAY {
                THROUGH_PLAY
            } else {
                INTO_LOAD
            };
            let farthest = -(config.play + config.brake_play);
            self.holds = self.relief <= 0 && (self.lasted >= LASTS || self.relief <= farthest);
        } else if self.lasted >= ticks {
            self.holds = self.pushed || gives_force || !(geared || opens);
            self.pushed = true;
            self.lasted = 0;
            if !by_length {
                // From a standstill: the speed of the push must not carry on towards the load.
                self.relief = 0;
            }
        } else if by_length {
            // Slowly at first: a stiff drive reaches its full force within micrometres, and its
            // feedback is some milliseconds late. Grows by a thirty-second per tick: 0.5 mm after some
            // 180 ms. Its integral goes on to push, so the release is taken back when it is enough.
            let share = missing_ma.abs().min(most_ma);
            let towards = if share <= most_ma >> 5 {
                -self.relief.signum()
            } else {
                let step = 1 + self.relief.abs() * share / (most_ma << if geared { 6 } else { 5 });
                let step = if geared { step.min(THROUGH_PLAY) } else { step };
                missing_ma.signum() * if self.pushed { -step } else { step }
            };
            let most = RELIEF_MOST + config.play + config.brake_play;
            let least = if self.pushed { -most } else { 0 };
            self.relief = (self.relief + towards).clamp(least, most);
        } else if gives_force {
            // The drive's force before is not exactly the load. Bounded at twice the test's force: a
            // drive that gives no torque must not be wound up without end.
            if missing_ma > 0 {
                let per_ma = (push_mn / most_ma).max(1);
                let step =
                    (per_ma.saturating_mul(missing_ma) / 16).clamp(LEAST_RELEASE_MN, RELEASE_MN);
                let most = 2 * (load_mn + push_mn) + rubbing_mn;
                self.relief = (self.relief + step).min(most);
            }
        } else if reached {
            // Its speed loop has an integral: it holds the push without a speed.
            self.relief = 0;
        } else {
            // Play-out is positive: the push runs forwards, the return backwards, both at 5 mm/s at
            // most.
            let step = if self.pushed {
                -FASTER_UMPS
            } else {
                FASTER_UMPS
            };
            self.relief = (self.relief + step).clamp(-FASTEST_UMPS, FASTEST_UMPS);
        }
        if self.holds {
            if !(geared && by_length) {
                self.relief = 0;
            }
            return Verdict::Holds;
        }
        Verdict::Pending
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Play of the gear, 0.1 µm.
    const PLAY: i32 = 3500;
    const LOAD_MN: i32 = 12_000;
    const FRICTION_MN: i32 = 10_000;

    /// Current of a motor at this place in its play (0: it carries the load, `PLAY`: it pushes out) that has just moved by
    /// `moved`, mA of a newton each. Both flanks wind up by 0.75 N per micrometre.
    fn current_ma(at: i32, moved: i32) -> i32 {
        let wound_mn = 75 * (at.min(0) + (at - PLAY).max(0));
        let rubs_mn = FRICTION_MN * moved.signum();
        -(wound_mn + rubs_mn) / 1000
    }

    #[test]
    fn a_motor_that_was_anywhere_in_its_play_carries_its_load_when_its_brake_may_open() {
        let config = CableConfig {
            // 1 mA per N.
            current_per_force_q32: (1 << 32) / 1000,
            friction_mn: FRICTION_MN,
            play: PLAY,
            four_counts: 1200,
            ..CableConfig::NOTHING
        };
        for began in [0, 100, 1000, 2500, 3400] {
            let mut proof = Proof::default();
            let (mut at, mut way, mut farthest) = (began, 0, began);
            let (mut ticks, mut turned_at) = (0, 0);
            loop {
                let now = crate::fixed::saturate_i16(current_ma(at, way));
                let verdict = proof.tick(&config, 0, now, LOAD_MN, true);
                let to = began + proof.relief();
                (way, at) = (to - at, to);
                ticks += 1;
                farthest = farthest.max(at);
                // The push swings by some micrometres.
                if at >= farthest - 200 {
                    turned_at = ticks;
                }
                if verdict == Verdict::Holds {
                    break;
                }
                assert!(ticks < 1500 + 630, "{began}: still at {at}");
            }
            // It pushed against the brake, and came back.
            assert!(farthest > PLAY, "{began}: {farthest}");
            assert_eq!(at, began + proof.take_carried(), "not taken back");
            // Back to where it was at 5 mm/s, and on at 1 mm/s.
            let back = (farthest - began) / 50 + (began - at) / 10;
            assert!(ticks - turned_at <= back + 20, "{began}: {ticks}");
            // Wound up by the load or somewhat more, never in the play.
            assert!((-600..=-100).contains(&at), "{began}: ends at {at}");
            assert_eq!(proof.relief(), 0);
        }
    }

    /// A drum may turn by the play between it and its brake, and by what its encoder cannot tell from rest.
    #[test]
    fn b2_a_drum_within_its_brakes_play_has_not_slipped() {
        for (brake_play, most) in [(0, 1200), (500, 1700), (3000, 4200)] {
            let config = CableConfig {
                current_per_force_q32: (1 << 32) / 1000,
                four_counts: 1200,
                brake_play,
                ..CableConfig::NOTHING
            };
            for way in [1, -1] {
                let mut proof = Proof::default();
                let from = 7000;
                assert_eq!(proof.tick(&config, from, 0, 12_000, true), Verdict::Pending);
                for turned in [1, 1200, most] {
                    let length = from + way * turned;
                    let verdict = proof.tick(&config, length, 0, 12_000, true);
                    assert_eq!(verdict, Verdict::Pending, "{turned} of {most}");
                }
                let beyond = way * (most + 1);
                let verdict = proof.tick(&config, from + beyond, 0, 12_000, true);
                assert_eq!(verdict, Verdict::Slips(beyond));
            }
        }
    }

    /// The push is wanted and no more: behind late feedback a drive would swing beyond it, and back towards the load.
    #[test]
    fn a_force_builds_up_to_its_push_without_swinging_beyond_it() {
        const LATE: usize = 5;
        let config = CableConfig {
            control: Control::Tension,
            // 20 mA per N, as on the paper's robot.
            current_per_force_q32: (1 << 32) / 50,
            friction_mn: 500,
            four_counts: 1200,
            ..CableConfig::NOTHING
        };
        for load_mn in [1000, 6000, 10_000, 20_000] {
            // Half of the load beyond it, an eighth, and friction.
            let more = load_mn / 2;
            let more = more.max(1000);
            let wanted = load_mn + more + (load_mn + more) / 8 + 500;
            let mut proof = Proof::default();
            let mut releases = std::vec![0; LATE];
            while {
                let seen = releases[releases.len() - LATE];
                let now = crate::fixed::saturate_i16((load_mn - seen) / 50);
                proof.tick(&config, 0, now, load_mn, true) == Verdict::Pending
            } {
                releases.push(proof.relief());
                assert!(releases.len() < 460, "{load_mn} mN: not in time");
            }
            let most = releases.iter().max().copied().unwrap();
            // Three steps of the current that a drive reports.
            assert!(
                most.abs_diff(wanted) <= 60,
                "{load_mn} mN: {most} of {wanted}"
            );
        }
    }
}
