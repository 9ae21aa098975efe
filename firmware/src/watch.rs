//! Fault detectors. Each counts ticks and reports when its time has passed; none acts.

use crate::fixed::saturate;
use mcdpr_protocol::FaultId;

mod channel;
mod link;

use channel::{Pace, Polarity};
pub use link::{Heartbeat, LinkHealth};
pub(crate) use link::{Latch, LineNoise};

/// Counts consecutive ticks of a condition.
#[derive(Debug, Clone, Copy, Default)]
pub struct Persist {
    ticks: u16,
}

impl Persist {
    /// Whether the condition has now been true for `limit` ticks or more.
    #[inline]
    pub fn update(&mut self, condition: bool, limit: u16) -> bool {
        self.ticks = if condition {
            // Saturating: a condition that lasts for more than 65 s must not wrap to "just begun".
            self.ticks.saturating_add(1)
        } else {
            0
        };
        condition && self.ticks >= limit
    }

    /// Ticks so far.
    #[must_use]
    pub const fn ticks(&self) -> u16 {
        self.ticks
    }
}

/// Detectors of one cable.
#[derive(Debug, Clone, Copy, Default)]
pub struct CableWatch {
    slack: Persist,
    snag: Persist,
    open: Persist,
    short: Persist,
    frozen: Persist,
    following: Persist,
    saturated: Persist,
    hot: Persist,
    runaway: Persist,
    /// Drum speed when [`Self::runaway`] began to count, um/s.
    ran_umps: u32,
    deaf: Persist,
    last_adc: u16,
    pace: Pace,
    /// Tension of the last ticks, mN: a cable that breaks falls below half of it at once.
    recent_mn: i32,
    broke: bool,
    /// The tension rose so fast in the last ticks that it was about to exceed its ceiling.
    rising: u8,
    /// Mean change of the tension from tick to tick, 1/64 mN.
    noise_q6: i32,
    polarity: Polarity,
    /// A condition was true in the last tick: some count is not zero.
    counting: bool,
}

/// Conditions of a tick; each becomes a fault when it lasts.
struct Conditions {
    runs: bool,
    open: bool,
    short: bool,
    frozen: bool,
    snag: bool,
    slack: bool,
    astray: bool,
    saturated: bool,
    hot: bool,
    deaf: bool,
}

impl Conditions {
    // Without branches.
    const fn any(&self) -> bool {
        self.runs
            | self.open
            | self.short
            | self.frozen
            | self.snag
            | self.slack
            | self.astray
            | self.saturated
            | self.hot
            | self.deaf
    }
}

/// A fault that a detector found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The fault.
    pub fault: FaultId,
    /// What was measured; the fault has its unit (`docs/protocol.md`).
    pub value: i32,
    /// The limit that it exceeds, same unit.
    pub limit: i32,
}

impl Finding {
    /// With all of its parts.
    #[must_use]
    pub(crate) const fn new(fault: FaultId, value: i32, limit: i32) -> Self {
        Self {
            fault,
            value,
            limit,
        }
    }
}

/// Inputs of a cable's detectors in a tick.
#[derive(Debug, Clone, Copy, Default)]
pub struct CableView {
    /// Tension channel.
    pub adc: u16,
    /// Tension, mN.
    pub tension_mn: i32,
    /// Floor, mN.
    pub floor_mn: i32,
    /// The cable's own law reels it in when it is slack, and there is time for it.
    pub reels_in: bool,
    /// Ceiling, mN.
    pub ceiling_mn: i32,
    /// Time until a drum that is commanded to stop no longer pulls, µs.
    pub horizon_us: i32,
    /// Commanded minus measured length, 0.1 µm; zero if the cable is held by tension.
    pub length_error: i32,
    /// Its limit, 0.1 µm.
    pub length_error_max: i32,
    /// The same difference by the motor's own counts: distinguishes a dead encoder from a dead
    /// drive.
    pub motor_error: i32,
    /// Commanded and actual current (mA) or speed (µm/s), without signs.
    pub commanded: i32,
    /// As the drive reports.
    pub given: i32,
    /// The current is at its limit.
    pub saturated: bool,
    /// Age of the drive's feedback, ms.
    pub feedback_age_ms: u16,
    /// Its limit, ms.
    pub feedback_timeout_ms: u16,
    /// The drive reports a fault.
    pub drive_fault: bool,
    /// It is too hot.
    pub hot: bool,
    /// Expected tension, mN.
    pub expected_mn: i32,
    /// The cable is held by its tension.
    pub by_tension: bool,
    /// How much faster than planned the drum pays out, µm/s.
    pub too_fast_umps: i32,
    /// Lengths by the motor and by the drum, and four encoder counts, 0.1 µm.
    pub motor_length: i32,
    /// By the drum.
    pub drum_length: i32,
    /// The distance after which the two are compared.
    pub polarity_way: i32,
}

/// Times of `docs/faults.md`, ticks.
// 20 ms (C1). A swing or an impact unloads a cable for some ticks without being a fault.
const SLACK_TICKS: u16 = 20;
/// Time that a tension-held cable of a robot at rest has for being reeled in.
// 2 s at the reel speed of at most 20 mm/s are 40 mm of slack.
const REEL_TICKS: u16 = 2000;
// 2 ms (C2): one disturbed reading does not stop the robot, and the prediction already covers the
// drum's time to stop.
const SNAG_TICKS: u16 = 2;
/// A reading at the rail within this many ticks of a steep rise is a tension, not a disconnected
/// plug.
const RISING_TICKS: u8 = 3;
/// Below this above the plan, mN, a rising tension does not count as about to exceed the ceiling.
const COMING_OFF_MN: i32 = 3000;
// 5 ms (S7, S8): a plug that shakes opens for single ticks.
const RAIL_TICKS: u16 = 5;
// 10 repetitions (S11) of a channel that seldom repeats. Quiet channels get more, see
// `Pace::TABLE`.
const FROZEN_TICKS: u16 = 10;
// 20 ms (S2, D7) beyond the following error, which is 1 mm on the paper's robot.
const FOLLOWING_TICKS: u16 = 20;
// 20 ms (D2): longer than the feedback's delay and a current's rise, 3 ms on the paper's robot.
const DEAF_TICKS: u16 = 20;
// 100 ms (D4): the eased path clock has time to bring the current down.
const SATURATED_TICKS: u16 = 100;
// 10 ms after a fall from one tick to the next, the robot stops: half of C1's time.
pub(crate) const BREAK_TICKS: u16 = 10;
// 250 ms after the fall it has its name. A cable that is tight again by then has slipped, or the
// platform was pushed or shaken (C1); one that broke stays slack (C3). 5 mm of slip are gone within
// 120 ms (docs/results/faults.md); a stop closes its brakes after 300 ms.
const NAMED_TICKS: u16 = 250;
// 100 ms (D6): heat changes slowly, a single status bit may be disturbed.
const HOT_TICKS: u16 = 100;
// 10 ms (S4): at 30 mm/s the drum has turned by 0.3 mm then.
const RUNAWAY_TICKS: u16 = 10;
/// A tension loop that moves its drum faster than this in the wrong direction counts as a runaway,
/// µm/s.
const RUNAWAY_UMPS: i32 = 2000;
/// A tension this close to the expected one is neither a runaway nor a break, mN: a cable that is
/// being tightened bounces by more than half of its small tension.
pub(crate) const LEAST_OFF_MN: i32 = 2000;
/// Mean change of a tension from tick to tick that counts as noise, 1/64 mN.
// 250 mN from tick to tick, as a mean over about 128 ticks (S9).
const NOISE_Q6: i32 = 250 * 64;

/// Whether a drive gives less than a quarter of its commanded current or speed (D2): the only
/// symptom of an RMDS whose motor has died, on a cable that is not held by length. Only sizes are
/// compared, since feedback is some milliseconds late and the current of a drum that arming moves
/// changes its sign.
#[inline]
pub(crate) const fn is_deaf(commanded: i32, given: i32) -> bool {
    // Saturating: the largest size must compare as large, not wrap to a small one.
    given.saturating_mul(4) < commanded
}

impl CableWatch {
    /// One reading before monitoring starts: learns how often this channel repeats a value.
    pub fn learn(&mut self, adc: u16) {
        if adc == self.last_adc {
            self.pace.repeated();
            // A channel that never changes is either that quiet, or frozen already: then it is
            // reported later.
            self.pace.mean_q8 = self.pace.mean_q8.max(256 * self.pace.run);
        } else {
            self.last_adc = adc;
            self.pace.changed();
        }
    }

    /// A quick check of a tick under torque in which the caller saw no fault: whether no count
    /// changes here either. If so, the tick is complete for this cable; if not, nothing was
    /// changed, and [`Self::update`] must run. Lengths are by motor and drum, `way` is that of
    /// [`CableView::polarity_way`].
    #[inline]
    pub(crate) fn is_quiet(
        &mut self,
        adc: u16,
        tension_mn: i32,
        motor: i32,
        drum: i32,
        way: i32,
    ) -> bool {
        // A repeated reading needs the full check, because it counts towards S11.
        if self.counting | !crate::adc::is_plausible(adc) | (adc == self.last_adc) {
            return false;
        }
        let turned = motor.wrapping_sub(self.polarity.motor).unsigned_abs();
        // A comparison of motor and drum is due only every four counts. Most ticks skip it.
        if turned >= way.cast_unsigned() && !self.polarity.agrees(motor, drum, way) {
            return false;
        }
        let change = tension_mn.saturating_sub(self.recent_mn);
        self.last_adc = adc;
        self.pace.changed();
        // The caller has found the tension above its floor.
        self.broke = false;
        self.noise_q6 = self.noise_after(change);
        self.recent_mn = self.recent_mn.saturating_add(change / 2);
        true
    }

    /// Mean change of the tension with one more.
    #[inline]
    fn noise_after(&self, change_mn: i32) -> i32 {
        // At most 10 N per tick count: a single glitch, which is two jumps, raises the mean by 156
        // mN and so stays under the threshold of 250 mN.
        self.noise_q6
            + ((change_mn.unsigned_abs().min(10_000) * 64).cast_signed() - self.noise_q6) / 128
    }

    /// Checks one tick under torque; returns the first fault found.
    pub fn update(&mut self, view: &CableView) -> Option<Finding> {
        let tension = view.tension_mn;
        let open = view.adc >= crate::adc::RAIL_HIGH;
        let short = view.adc <= crate::adc::RAIL_LOW;
        let frozen = view.adc == self.last_adc && !open && !short;
        self.last_adc = view.adc;
        // A reading at a rail does not repeat by chance: it is judged as S7 or S8, not as frozen.
        if !frozen {
            self.pace.changed();
        } else {
            self.pace.repeated();
        }
        let most = (view.expected_mn / 2).max(LEAST_OFF_MN);
        // A fall to the floor from one tick to the next is a break, a slow one is slack.
        // A shorted input reads as no tension: that is S8.
        let slack = tension < view.floor_mn && !short;
        let change = tension.saturating_sub(self.recent_mn);
        // Decided in the first slack tick only: later ones compare with a mean that has fallen,
        // too.
        if self.slack.ticks() == 0 {
            self.broke = slack && self.recent_mn > tension.saturating_add(most);
        }
        self.noise_q6 = self.noise_after(change);
        self.recent_mn = self.recent_mn.saturating_add(change / 2);
        // Half or one and a half times the tension, and the drum still makes it worse.
        let off = tension.saturating_sub(view.expected_mn);
        // An invalid reading gives no information about the loop.
        // A law that works pays out while the tension is too high and reels in while it is too low.
        // A reversed one does the opposite.
        let runs = view.by_tension
            && !(open | short)
            && ((off < -most && view.too_fast_umps > RUNAWAY_UMPS)
                || (off > most && view.too_fast_umps < -RUNAWAY_UMPS));
        let reversed = self
            .polarity
            .update(view.motor_length, view.drum_length, view.polarity_way);
        // Half of `change` is the rise of a tick. A drum that is commanded to stop continues for
        // its horizon: the predicted tension at that time counts, if it deviates from the plan.
        let coming = crate::fixed::quotient::<2000>(i64::from(change) * i64::from(view.horizon_us));
        let coming = saturate(coming);
        let coming = off > COMING_OFF_MN && tension.saturating_add(coming) > view.ceiling_mn;
        let over = tension > view.ceiling_mn;
        // A tension that was rising towards the rail has reached it; a plug that comes off jumps.
        let at_rail = open && self.rising > 0;
        // The count runs down while the reading is off the rail, and stands still while it is at
        // the rail: the snag lasts as long as the rail reading does.
        self.rising = if (coming | over) && !open {
            RISING_TICKS
        } else {
            self.rising.saturating_sub(u8::from(!at_rail))
        };
        let snag = ((coming | over) & !open) | at_rail;
        let open = open && !at_rail;
        let now = Conditions {
            runs,
            open,
            short,
            frozen,
            snag,
            slack,
            astray: view.length_error.unsigned_abs() > view.length_error_max.unsigned_abs(),
            saturated: view.saturated,
            hot: view.hot,
            deaf: is_deaf(view.commanded, view.given),
        };
        // Feedback's age and the drive's own fault need no counting: they are limits by themselves.
        let any = now.any();
        let lost = view.feedback_age_ms >= view.feedback_timeout_ms;
        if !(any | self.counting | reversed | view.drive_fault | lost) {
            return None;
        }
        self.counting = any;
        self.judge(view, &now, reversed)
    }

    /// Counts how long conditions have been true.
    #[inline(never)]
    fn judge(&mut self, view: &CableView, now: &Conditions, reversed: bool) -> Option<Finding> {
        let adc = i32::from(view.adc);
        let tension = view.tension_mn;
        let slack_ticks = if view.reels_in {
            REEL_TICKS
        } else {
            SLACK_TICKS
        };
        // The count is updated further down: this tick is the one to be added.
        let fell = self.breaks_ticks();
        let broken = now.slack && fell + 1 >= BREAK_TICKS;
        let caught = !now.slack && fell >= BREAK_TICKS;
        // A dead drive also leaves the motor behind; a dead encoder does not.
        // Half the limit: at the tick that exceeds it, a motor that stands shows the same error as
        // the drum, and a motor that follows shows almost none.
        let dead = if view.motor_error.unsigned_abs() > view.length_error_max.unsigned_abs() / 2 {
            FaultId::D7
        } else {
            FaultId::S2
        };
        // All of them count, whichever is reported: no early exit may skip the later ones. A
        // working loop slows the drum down, whatever moves the platform; a reversed one accelerates
        // it.
        let ran_umps = view.too_fast_umps.unsigned_abs();
        if self.runaway.ticks() == 0 {
            self.ran_umps = ran_umps;
        }
        let runs = self.runaway.update(now.runs, RUNAWAY_TICKS) && ran_umps >= self.ran_umps;
        let open = self.open.update(now.open, RAIL_TICKS);
        let short = self.short.update(now.short, RAIL_TICKS);
        let frozen = self.frozen.update(now.frozen, self.pace.patience());
        let snag = self.snag.update(now.snag, SNAG_TICKS);
        let slack = self.slack.update(now.slack, slack_ticks);
        let astray = self.following.update(now.astray, FOLLOWING_TICKS);
        let saturated = self.saturated.update(now.saturated, SATURATED_TICKS);
        let hot = self.hot.update(now.hot, HOT_TICKS);
        let deaf = self.deaf.update(now.deaf, DEAF_TICKS);
        let ticks = |count: &Persist, limit: u16| (i32::from(count.ticks()), i32::from(limit));
        let (age, timeout) = (view.feedback_age_ms, view.feedback_timeout_ms);
        // Only the first is reported. A reversed loop comes before a lost drive, and faulty
        // sensors before the tensions that they pretend.
        let (fault, (value, limit)) = if reversed || runs {
            (FaultId::S4, (view.too_fast_umps, RUNAWAY_UMPS))
        } else if view.drive_fault {
            (FaultId::D2, (1, 0))
        } else if deaf {
            (FaultId::D2, (view.given, view.commanded / 4))
        } else if age >= timeout {
            (FaultId::D3, (i32::from(age), i32::from(timeout)))
        } else if open {
            (FaultId::S7, (adc, i32::from(crate::adc::RAIL_HIGH)))
        } else if short {
            (FaultId::S8, (adc, i32::from(crate::adc::RAIL_LOW)))
        } else if frozen {
            (FaultId::S11, (adc, i32::from(self.pace.patience())))
        } else if snag {
            (FaultId::C2, (tension, view.ceiling_mn))
        } else if broken {
            if fell < NAMED_TICKS - 1 {
                // The robot stops already. Its other conditions are consequences.
                return None;
            }
            (FaultId::C3, (tension, view.floor_mn))
        } else if slack | caught {
            (FaultId::C1, (tension, view.floor_mn))
        } else if astray {
            (dead, (view.length_error / 10, view.length_error_max / 10))
        } else if saturated {
            (FaultId::D4, ticks(&self.saturated, SATURATED_TICKS))
        } else if hot {
            (FaultId::D6, ticks(&self.hot, HOT_TICKS))
        } else {
            return None;
        };
        Some(Finding::new(fault, value, limit))
    }

    /// Whether the tension reading is noisy (S9).
    #[must_use]
    pub const fn is_noisy(&self) -> bool {
        self.noise_q6 > NOISE_Q6
    }

    /// Whether the current has begun to be at its limit.
    #[must_use]
    pub(crate) const fn saturates(&self) -> bool {
        self.saturated.ticks() > 0
    }

    /// Rate of rise of the tension, mN per tick: its excess over the mean of the last ones.
    #[must_use]
    pub(crate) const fn rise_mn(&self, tension_mn: i32) -> i32 {
        tension_mn.saturating_sub(self.recent_mn)
    }

    /// Whether a reading at the upper rail is a tension that rose up to it.
    #[must_use]
    pub(crate) const fn rose_to_rail(&self) -> bool {
        self.rising > 0
    }

    /// Ticks since the tension fell to the floor from one tick to the next, 0 if it did not. From
    /// [`BREAK_TICKS`] on the cable may be broken, and the robot must stop.
    #[must_use]
    pub(crate) const fn breaks_ticks(&self) -> u16 {
        if self.broke { self.slack.ticks() } else { 0 }
    }

    /// Ticks that the tension has been above its ceiling or about to exceed it.
    #[must_use]
    pub(crate) const fn snag_ticks(&self) -> u16 {
        self.snag.ticks()
    }

    /// Whether the cable has begun to be slack.
    #[must_use]
    pub const fn slackens(&self) -> bool {
        self.slack.ticks() > 0
    }
}
