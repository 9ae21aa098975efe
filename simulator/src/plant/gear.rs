//! The gear between a motor and its drum: two bodies on a shaft that twists, with play, and the
//! friction of rotor and gear.
//!
//! Motor and drum each have their own position and speed, as cable at the drum's surface. The shaft
//! between them carries force only at the ends of the play, as a damped spring that pushes and
//! cannot pull. Friction acts on the rotor, where a reduction gear has most of it. It includes the
//! bearings, brushes and seals of the motor and the first stage without load, both with Stribeck's
//! decrease from rest to motion (in the form of Bo and Pavelescu, 1982, with the exponent 2 that
//! Armstrong-Hélouvry, Dupont and Canudas de Wit, Automatica 30 (1994) 1083, use), and a share of
//! the transmitted power, which differs between the two directions of power. Dry friction is an
//! impulse that can stop the rotor and no more: a stuck rotor stays exactly in place.

use super::params::{GearParams, WinchParams};
use std::f64::consts::TAU;

/// Damping of the shaft as a share of critical damping for the drum on it: assumption, 0.1 to 0.4
/// for steel with grease.
const SHAFT_DAMPING: f64 = 0.2;
/// Under this speed of the motor its friction does not warm up (rpm).
const WARMING_RPM: f64 = 10.0;

/// The motor's side of a winch; displacements, speeds and forces at the cable, paying out positive.
#[derive(Debug, Clone)]
pub(crate) struct Gear {
    pub motor_m: f64,
    pub motor_rate: f64,
    pub mass_kg: f64,
    /// Share of cold friction that is left, 0 to 1.
    cold: f64,
    half_play_m: f64,
    stiffness: f64,
    damping: f64,
    coulomb_n: f64,
    static_share: f64,
    stribeck_mps: f64,
    viscous: f64,
    loss_driving: f64,
    loss_driven: f64,
    cogging_n: f64,
    cogging_per_m: f64,
    cold_share: f64,
    cools_per_s: f64,
    warming_mps: f64,
}

impl Gear {
    pub(crate) fn new(p: &WinchParams, gear: &GearParams) -> Self {
        // From N m at the motor to N at the cable: 371.13 / 20 mm are 18 557 N per N m.
        let per_torque = p.gear_ratio / p.drum_radius_m;
        let stiffness = p.shaft_stiffness_n_per_m(gear);
        let half_play_m = 0.5 * gear.play_rad * p.drum_radius_m;
        Self {
            // The winch pulled last: the play is on the other side.
            motor_m: -half_play_m,
            motor_rate: 0.0,
            mass_kg: p.rotor_mass_kg(),
            cold: 1.0,
            half_play_m,
            stiffness,
            // 2 zeta sqrt(k m): 1 MN/m on a drum of 0.1 kg give 126 N s/m.
            damping: 2.0 * SHAFT_DAMPING * (stiffness * p.drum_mass_kg).sqrt(),
            coulomb_n: (gear.rotor_friction_nm + gear.gear_friction_nm) * per_torque,
            static_share: gear.static_friction - 1.0,
            stribeck_mps: gear.stribeck_rpm * p.mps_per_rpm(),
            viscous: gear.viscous_nm_per_rpm * per_torque / p.mps_per_rpm(),
            // Driving, the motor gives shaft / efficiency: 70 % cost 43 % more than the shaft's
            // force.
            loss_driving: 1.0 / gear.efficiency_driving - 1.0,
            // Driven, it receives shaft x efficiency: the rest is lost as friction.
            loss_driven: 1.0 - gear.efficiency_driven,
            cogging_n: gear.cogging_nm * per_torque,
            // The motor's angle is the displacement times gear over radius.
            cogging_per_m: f64::from(gear.cogging_per_turn) * per_torque,
            cold_share: gear.cold_friction - 1.0,
            cools_per_s: 1.0 / gear.warming_s,
            warming_mps: WARMING_RPM * p.mps_per_rpm(),
        }
    }

    /// Force of the shaft on the drum; the reaction acts on the motor.
    #[inline(always)]
    pub(crate) fn shaft_n(&self, drum_m: f64, drum_rate: f64) -> f64 {
        let ahead = self.motor_m - drum_m;
        let twist = ahead - ahead.clamp(-self.half_play_m, self.half_play_m);
        if twist == 0.0 {
            return 0.0;
        }
        let force = self.stiffness * twist + self.damping * (self.motor_rate - drum_rate);
        // Flanks push; they do not stick together.
        if twist > 0.0 {
            force.max(0.0)
        } else {
            force.min(0.0)
        }
    }

    /// Energy of motor and shaft (J).
    pub(crate) fn energy_j(&self, drum_m: f64) -> f64 {
        let ahead = self.motor_m - drum_m;
        let twist = ahead - ahead.clamp(-self.half_play_m, self.half_play_m);
        0.5 * (self.stiffness * twist * twist + self.mass_kg * self.motor_rate * self.motor_rate)
    }

    /// Friction of rotor and gear without load (N) at the present speed.
    #[inline(always)]
    pub(crate) fn dry_n(&self) -> f64 {
        let ratio = self.motor_rate / self.stribeck_mps;
        let rest = 1.0 + self.static_share * libm::exp(-ratio * ratio);
        self.coulomb_n * rest * (1.0 + self.cold_share * self.cold)
    }

    /// One step of `h` seconds under the motor's force and the shaft's.
    #[inline(always)]
    pub(crate) fn kick(&mut self, motor_n: f64, shaft_n: f64, h: f64) {
        let hm = h / self.mass_kg;
        let cogging = if self.cogging_n > 0.0 {
            self.cogging_n * libm::sin(self.cogging_per_m * self.motor_m % TAU)
        } else {
            0.0
        };
        let pushed = self.motor_rate + hm * (motor_n + cogging - shaft_n);
        let free = pushed / (1.0 + hm * self.viscous);
        // Power flows to the drum if the shaft pushes it in the motor's direction of motion,
        // present or coming.
        let loss = if shaft_n * free > 0.0 {
            self.loss_driving
        } else {
            self.loss_driven
        };
        let stopped_by = hm * (self.dry_n() + loss * shaft_n.abs());
        self.motor_rate = if free.abs() <= stopped_by {
            0.0
        } else {
            free - stopped_by.copysign(free)
        };
        // A gear at rest does not cool down again: runs are shorter than that.
        if self.cold_share > 0.0 && self.motor_rate.abs() > self.warming_mps {
            self.cold -= self.cold * h * self.cools_per_s;
        }
    }
}
