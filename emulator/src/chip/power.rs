//! The chip's supply: what a voltage does to core, outputs and memory.

use super::{Chip, TICKS_PER_US};
use crate::device::rcc::RESET_POWER;
use crate::device::supply::SupplyLimits;
use crate::error::ResetBy;

/// What the supply does to the chip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Power {
    /// It runs.
    Up,
    /// It is in reset: the supply is below a threshold. With the lowest voltage since.
    Down { lowest_v: f64 },
    /// It is in reset until then, in ticks, although its supply is good.
    Starting { at: u64 },
}

impl Power {
    pub(super) fn is_down(self) -> bool {
        self != Self::Up
    }
}

impl Chip {
    /// The supply's voltage from now on, V. It is the converter's full scale (a voltage applied to a
    /// pin does not change), and what the firmware's voltage detector sees. Below the power-down
    /// threshold the chip is in reset, with every output floating; when the supply is above the
    /// power-on threshold again, it starts after a time ([`SupplyLimits`]).
    ///
    /// Memory forgets according to the lowest voltage, and so do the backup registers without a
    /// battery.
    pub fn set_supply_v(&mut self, volts: f64) {
        let volts = volts.max(0.0);
        self.bus.set_supply_v(volts);
        let limits = self.bus.supply.limits;
        let now = self.until.max(self.bus.now);
        if volts >= limits.power_down_v {
            if matches!(self.power, Power::Down { .. }) && volts >= limits.power_on_v {
                let at = now + limits.start_us * TICKS_PER_US;
                self.power = Power::Starting { at };
            }
            return;
        }
        let lowest_v = match self.power {
            Power::Down { lowest_v } => lowest_v,
            Power::Starting { .. } => f64::INFINITY,
            Power::Up => {
                self.power = Power::Down { lowest_v: volts };
                self.resets.push(ResetBy::Supply);
                self.begin_again(RESET_POWER);
                f64::INFINITY
            }
        };
        // Once for each new low: what is lost is lost.
        if volts < lowest_v {
            self.forget(limits.lost_at(volts));
        }
        self.power = Power::Down {
            lowest_v: volts.min(lowest_v),
        };
    }

    /// The supply falls so far that every voltage detector notices and no chip is reset, or it is
    /// again what it was before. Returns whether the firmware monitors it.
    pub fn set_supply_low(&mut self, low: bool) -> bool {
        if low {
            self.volts_before.get_or_insert(self.bus.supply.volts);
            self.set_supply_v(self.bus.supply.limits.low_v());
        } else if let Some(volts) = self.volts_before.take() {
            self.set_supply_v(volts);
        }
        self.bus.watches_supply()
    }

    /// Thresholds of this chip's supply, by default those of a typical one.
    pub fn set_supply_limits(&mut self, limits: SupplyLimits) {
        self.bus.supply.limits = limits;
        self.set_supply_v(self.bus.supply.volts);
    }

    /// A battery at VBAT: the backup registers keep their contents without a supply.
    pub fn fit_battery(&mut self) {
        self.battery = true;
    }

    /// A share of the memory, always the same bytes of it, gets contents that depend on the time.
    pub(super) fn forget(&mut self, share: f64) {
        let seed = self.bus.now;
        // Anything but what was there before: the upper byte of a product with an odd number.
        let hash = |number: u64| number.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        // Which bytes: those of a lower hash of their own. All of them at 1.
        let goes = |index: u64| ((hash(index ^ 0x5A5A) >> 32) as f64) < share * 4_294_967_296.0;
        for (index, byte) in (0_u64..).zip(self.bus.ram.iter_mut()) {
            if goes(index) {
                *byte = (hash(seed.wrapping_add(index)) >> 56) as u8;
            }
        }
        if self.battery {
            return;
        }
        for (index, register) in (1_u64 << 32..).zip(self.bus.backup.iter_mut()) {
            if goes(index) {
                *register = 0;
            }
        }
    }

    /// Lets the chip start if its time comes until then. Returns the time until which nothing
    /// happens.
    pub(super) fn start_in_time(&mut self, until: u64) -> u64 {
        match self.power {
            Power::Starting { at } if at <= until => {
                self.power = Power::Up;
                self.hangs = false;
                at
            }
            _ => until,
        }
    }
}
