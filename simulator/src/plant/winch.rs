//! A drum with its brake: converts the drive's force and the cable's pull into motion.

use super::brake::Brake;
use super::drive::Drive;
use super::faults::BrakeFault;
use super::gear::Gear;
use super::params::WinchParams;

/// Cable that has left a drum.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PaidOut {
    pub length_m: f64,
    pub rate_mps: f64,
    /// Present radius at which the cable leaves, as a share of the drum's.
    pub lever: f64,
}

/// A winch's constants and state; displacement and speed are the drum's turn times its radius,
/// paying out positive.
#[derive(Debug, Clone)]
pub(crate) struct Winch {
    pub drum_m: f64,
    pub drum_rate: f64,
    pub brake: Brake,
    pub drive: Drive,
    /// The motor, if it does not turn with the drum.
    pub gear: Option<Gear>,
    mass_kg: f64,
    radius_m: f64,
    eccentricity_m: f64,
    eccentric_rad: f64,
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
            gear: p.gear.as_ref().map(|gear| Gear::new(p, gear)),
            mass_kg: if p.gear.is_some() {
                p.drum_mass_kg
            } else {
                p.effective_mass_kg()
            },
            radius_m: p.drum_radius_m,
            eccentricity_m: p.eccentricity_m,
            eccentric_rad: p.eccentric_rad,
            friction_n: p.friction_n,
            viscous: p.viscous_friction_ns_per_m,
        }
    }

    /// Motor displacement, as cable at the drum (m).
    #[inline(always)]
    pub(crate) fn motor_m(&self) -> f64 {
        self.gear.as_ref().map_or(self.drum_m, |gear| gear.motor_m)
    }

    /// Motor speed, as cable at the drum (m/s).
    #[inline(always)]
    pub(crate) fn motor_rate(&self) -> f64 {
        let gear = self.gear.as_ref();
        gear.map_or(self.drum_rate, |gear| gear.motor_rate)
    }

    /// Cable off the drum. A drum that is `e` out of its axis pays out `R a + e (sin(a + b) - sin
    /// b)` over a turn of `a`.
    #[inline(always)]
    pub(crate) fn paid_out(&self) -> PaidOut {
        if self.eccentricity_m == 0.0 {
            return PaidOut {
                length_m: self.drum_m,
                rate_mps: self.drum_rate,
                lever: 1.0,
            };
        }
        let (sin, cos) = libm::sincos(self.drum_m / self.radius_m + self.eccentric_rad);
        // The derivative of the paid out cable by the drum's displacement.
        let lever = 1.0 + self.eccentricity_m / self.radius_m * cos;
        PaidOut {
            length_m: self.drum_m + self.eccentricity_m * (sin - libm::sin(self.eccentric_rad)),
            rate_mps: self.drum_rate * lever,
            lever,
        }
    }

    /// Energy of motion and of the shaft (J).
    pub(crate) fn energy_j(&self) -> f64 {
        let gear = self.gear.as_ref();
        0.5 * self.mass_kg * self.drum_rate * self.drum_rate
            + gear.map_or(0.0, |gear| gear.energy_j(self.drum_m))
    }

    /// Free flight.
    #[inline(always)]
    pub(crate) fn drift(&mut self, h: f64) {
        self.drum_m += h * self.drum_rate;
        if let Some(gear) = &mut self.gear {
            gear.motor_m += h * gear.motor_rate;
        }
    }

    /// The impulse of one step of `h` seconds under the cable's pull. Dry friction is an impulse
    /// that can stop the drum and no more, so a stuck drum stays exactly where it is.
    #[inline(always)]
    pub(crate) fn kick(&mut self, pull_n: f64, now_s: f64, h: f64, fault: &BrakeFault) {
        let motor = match &mut self.gear {
            None => self.drive.force(self.drum_m, self.drum_rate, pull_n, h),
            Some(gear) => {
                // One force for both bodies, taken before either moves: it adds no momentum.
                let shaft_n = gear.shaft_n(self.drum_m, self.drum_rate);
                let (motor_m, motor_rate) = (gear.motor_m, gear.motor_rate);
                // The motor feels the shaft's reaction, not the cable.
                let motor_n = self.drive.force(motor_m, motor_rate, -shaft_n, h);
                gear.kick(motor_n, shaft_n, h);
                shaft_n
            }
        };
        let hm = h / self.mass_kg;
        // Viscous friction is taken at the end of the step: no value of it is unstable.
        let free = (self.drum_rate + hm * (pull_n + motor)) / (1.0 + hm * self.viscous);
        // The direction that the drum would take decides which flank of the play carries.
        let braked_n = self.brake.friction_n((self.drum_m, free), now_s, fault);
        let rubbing = self.friction_n + fault.drag_n + braked_n;
        let stopped_by = hm * rubbing;
        self.drum_rate = if free.abs() <= stopped_by {
            0.0
        } else {
            free - stopped_by.copysign(free)
        };
    }
}
