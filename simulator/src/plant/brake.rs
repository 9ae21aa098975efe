//! A spring-applied brake: coil, disc and hub.

use super::faults::BrakeFault;
use super::params::WinchParams;

/// Distance at which teeth count as touching (m).
const TOUCHING_M: f64 = 1e-9;
/// Shares of the coil's final current at which the brake opens, and closes again. INTORQ, BA 14.0217
/// (BFK458): disengagement is specified at 0.7 of the rated current. The second is an assumption: only
/// the time until then is specified.
const OPENS_AT: f64 = 0.7;
const CLOSES_AT: f64 = 0.3;
/// Share of the closing time in which the current falls: 15 of 28 ms. The rest is the rise of the torque.
/// The same manual, table 9, size 06, switched on the DC side.
const DECAY_SHARE: f64 = 15.0 / 28.0;
/// Closing time of a coil whose current freewheels through a diode, over that of one that is
/// switched off against a voltage. The same manual, 5.5: 8 to 10 times; BA 14.0215 (BFK455) gives 5.
const FREEWHEELING: f64 = 9.0;

/// A spring-applied brake: its disc follows the coil's current, and an open brake costs nothing.
#[derive(Debug, Clone)]
pub(crate) struct Brake {
    pub asked_closed: bool,
    pub engaged: bool,
    asked_at_s: f64,
    change_at_s: f64,
    /// Current of the coil when the last command came, as a share of its final one.
    coil_share: f64,
    close_delay_s: f64,
    open_delay_s: f64,
    holding_n: f64,
    half_play_m: f64,
    /// Position of the disc, as displacement of the drum: the drum turns by half of the play to
    /// either side of it.
    disc_m: f64,
}

impl Brake {
    pub(crate) fn new(p: &WinchParams) -> Self {
        Self {
            asked_closed: true,
            engaged: true,
            asked_at_s: 0.0,
            coil_share: 0.0,
            change_at_s: 0.0,
            close_delay_s: p.brake.close_delay_s,
            open_delay_s: p.brake.open_delay_s,
            holding_n: p.brake.holding_n,
            half_play_m: 0.5 * p.brake.play_m,
            // The cable has pulled the drum against the disc.
            disc_m: -0.5 * p.brake.play_m,
        }
    }

    pub(crate) fn ask(&mut self, closed: bool, now_s: f64, fault: &BrakeFault) {
        if closed == self.asked_closed {
            return;
        }
        self.coil_share = self.coil_at(now_s, fault);
        self.asked_closed = closed;
        self.asked_at_s = now_s;
        let from = self.coil_share;
        let delay_s = if closed {
            let falls_s = self.falling_s(fault) * libm::log(from / CLOSES_AT).max(0.0);
            falls_s + (1.0 - DECAY_SHARE) * self.close_delay_s + fault.extra_close_delay_s
        } else {
            self.rising_s() * libm::log((1.0 - from) / (1.0 - OPENS_AT)).max(0.0)
        };
        self.change_at_s = now_s + delay_s;
    }

    /// Time constant of the current after switching on (s): it opens the brake after `open_delay_s`.
    fn rising_s(&self) -> f64 {
        self.open_delay_s / libm::log(1.0 / (1.0 - OPENS_AT))
    }

    /// Time constant of the current after switching off (s).
    fn falling_s(&self, fault: &BrakeFault) -> f64 {
        let free = if fault.freewheels {
            (FREEWHEELING - (1.0 - DECAY_SHARE)) / DECAY_SHARE
        } else {
            1.0
        };
        free * DECAY_SHARE * self.close_delay_s / libm::log(1.0 / CLOSES_AT)
    }

    /// Current of the coil, as a share of its final one.
    fn coil_at(&self, now_s: f64, fault: &BrakeFault) -> f64 {
        let since_s = now_s - self.asked_at_s;
        let (goal, constant_s) = if self.asked_closed {
            (0.0, self.falling_s(fault))
        } else {
            (1.0, self.rising_s())
        };
        if constant_s <= 0.0 {
            return goal;
        }
        goal + (self.coil_share - goal) * libm::exp(-since_s / constant_s)
    }

    /// Friction at the drum, which is at `drum_m` and is pushed towards `way`. The disc has no
    /// mass: the drum carries it along where their teeth touch, and between them it has no effect.
    #[inline(always)]
    pub(crate) fn friction_n(
        &mut self,
        (drum_m, way): (f64, f64),
        now_s: f64,
        fault: &BrakeFault,
    ) -> f64 {
        if self.engaged != self.asked_closed && now_s >= self.change_at_s {
            self.engaged = self.asked_closed;
        }
        let mut meets = true;
        if self.half_play_m > 0.0 {
            let ahead = drum_m - self.disc_m;
            let within = ahead.clamp(-self.half_play_m, self.half_play_m);
            self.disc_m = drum_m - within;
            // They touch within the last nanometre: the disc's position is a difference of rounded
            // numbers.
            meets = ahead * way > 0.0 && ahead.abs() > self.half_play_m - TOUCHING_M;
        }
        if meets && (self.engaged || fault.stays_closed) {
            self.holding_n * fault.holding_factor
        } else {
            0.0
        }
    }
}
