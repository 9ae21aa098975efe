//! A drum with its brake: what turns the drive's force and the cable's pull into motion.

use super::drive::Drive;
use super::faults::BrakeFault;
use super::params::WinchParams;

/// A spring-applied brake: commands act after a delay, and an open brake costs nothing.
#[derive(Debug, Clone)]
pub(crate) struct Brake {
    pub asked_closed: bool,
    pub engaged: bool,
    change_at_s: f64,
    close_delay_s: f64,
    open_delay_s: f64,
    holding_n: f64,
}

impl Brake {
    fn new(p: &WinchParams) -> Self {
        Self {
            asked_closed: true,
            engaged: true,
            change_at_s: 0.0,
            close_delay_s: p.brake.close_delay_s,
            open_delay_s: p.brake.open_delay_s,
            holding_n: p.brake.holding_n,
        }
    }

    pub(crate) fn ask(&mut self, closed: bool, now_s: f64, fault: &BrakeFault) {
        if closed != self.asked_closed {
            self.asked_closed = closed;
            let delay = if closed {
                self.close_delay_s + fault.extra_close_delay_s
            } else {
                self.open_delay_s
            };
            self.change_at_s = now_s + delay;
        }
    }

    #[inline(always)]
    fn friction_n(&mut self, now_s: f64, fault: &BrakeFault) -> f64 {
        if self.engaged != self.asked_closed && now_s >= self.change_at_s {
            self.engaged = self.asked_closed;
        }
        if self.engaged || fault.stays_closed {
            self.holding_n * fault.holding_factor
        } else {
            0.0
        }
    }
}

/// A winch's constants and state; displacement and speed are cable paid out.
#[derive(Debug, Clone)]
pub(crate) struct Winch {
    pub drum_m: f64,
    pub drum_rate: f64,
    pub brake: Brake,
    pub drive: Drive,
    pub mass_kg: f64,
    friction_n: f64,
    viscous: f64,
}

impl Winch {
    pub(crate) fn new(p: &WinchParams, step_s: f64) -> Self {
        Self {
            drum_m: 0.0,
            drum_rate: 0.0,
            brake: Brake::new(p),
            drive: Drive::new(p, step_s),
            mass_kg: p.effective_mass_kg(),
            friction_n: p.friction_n,
            viscous: p.viscous_friction_ns_per_m,
        }
    }

    /// The impulse of one step of `h` seconds under the cable's pull. Dry friction is an impulse
    /// that can stop the drum and no more, so a stuck drum stays exactly where it is.
    #[inline(always)]
    pub(crate) fn kick(&mut self, pull_n: f64, now_s: f64, h: f64, fault: &BrakeFault) {
        let motor = self.drive.force(self.drum_m, self.drum_rate, pull_n, h);
        let rubbing = self.friction_n + fault.drag_n + self.brake.friction_n(now_s, fault);
        let hm = h / self.mass_kg;
        let free = (self.drum_rate + hm * (pull_n + motor)) / (1.0 + hm * self.viscous);
        let stopped_by = hm * rubbing;
        self.drum_rate = if free.abs() <= stopped_by {
            0.0
        } else {
            free - stopped_by.copysign(free)
        };
    }
}
