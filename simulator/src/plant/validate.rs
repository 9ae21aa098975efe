//! The permitted ranges of the plant's parameters.

use super::error::PlantError;
use super::params::{CableParams, GearParams, MAX_CABLES, PlantParams, WinchParams};
use super::vec3::{cross, dot, norm, symmetric_eigen};

impl PlantParams {
    /// Checks every value.
    ///
    /// # Errors
    /// The first value out of range, by name and cable.
    pub fn validate(&self) -> Result<(), PlantError> {
        let count = self.cables.len();
        if count == 0 || count > MAX_CABLES {
            return Err(PlantError::CableCount { count });
        }
        if self.winches.len() != count {
            return Err(PlantError::WinchCount {
                cables: count,
                winches: self.winches.len(),
            });
        }
        self.validate_platform()?;
        require("step_s", self.step_s, Rule::Positive)?;
        // A board reads and commands once per tick of 1 ms.
        if self.step_s > 1e-3 {
            return Err(PlantError::Parameter {
                name: "step_s",
                value: self.step_s,
                rule: "at most 0.001",
            });
        }
        for g in self.gravity_mps2 {
            require("gravity_mps2", g, Rule::Finite)?;
        }
        let unmodelled = &self.unmodelled;
        require("unmodelled force_n", unmodelled.force_n, Rule::NotNegative)?;
        require(
            "unmodelled moment_nm",
            unmodelled.moment_nm,
            Rule::NotNegative,
        )?;
        if unmodelled.force_n + unmodelled.moment_nm > 0.0 {
            require(
                "unmodelled distance_m",
                unmodelled.distance_m,
                Rule::Positive,
            )?;
        }
        require("bus period_s", self.bus.period_s, Rule::Positive)?;
        require("bus latency_s", self.bus.latency_s, Rule::NotNegative)?;
        // A port has one frame in transit: a longer transport would overwrite it by the next.
        if self.bus.latency_s >= self.bus.period_s {
            return Err(PlantError::Parameter {
                name: "bus latency_s",
                value: self.bus.latency_s,
                rule: "less than the bus period_s",
            });
        }
        for (i, (cable, winch)) in self.cables.iter().zip(&self.winches).enumerate() {
            cable.validate(i)?;
            winch.validate(i)?;
            winch.validate_shaft(i, self.step_s)?;
        }
        Ok(())
    }

    fn validate_platform(&self) -> Result<(), PlantError> {
        let p = &self.platform;
        require("platform mass_kg", p.mass_kg, Rule::Positive)?;
        for v in p.center_of_mass_m {
            require("platform center_of_mass_m", v, Rule::Finite)?;
        }
        for v in p.tcp_m {
            require("platform tcp_m", v, Rule::Finite)?;
        }
        require(
            "platform linear_damping_ns_per_m",
            p.linear_damping_ns_per_m,
            Rule::NotNegative,
        )?;
        require(
            "platform angular_damping_nms",
            p.angular_damping_nms,
            Rule::NotNegative,
        )?;
        let m = &p.inertia_kg_m2;
        for v in m.iter().flatten() {
            require("platform inertia_kg_m2", *v, Rule::Finite)?;
        }
        let scale = m[0][0].abs() + m[1][1].abs() + m[2][2].abs();
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let skew = (m[i][j] - m[j][i]).abs();
            // More than rounding of an inertia given in other axes.
            if skew > 1e-9 * scale {
                return Err(PlantError::Parameter {
                    name: "platform inertia_kg_m2 asymmetry",
                    value: skew,
                    rule: "0 (the matrix must be symmetric)",
                });
            }
        }
        for v in symmetric_eigen(m).0 {
            require("platform inertia_kg_m2 principal moment", v, Rule::Positive)?;
        }
        Ok(())
    }
}

impl CableParams {
    fn validate(&self, cable: usize) -> Result<(), PlantError> {
        let check = |name, value, rule| require_of(cable, name, value, rule);
        for v in self.anchor_m {
            check("anchor_m", v, Rule::Finite)?;
        }
        for v in self.attachment_m {
            check("attachment_m", v, Rule::Finite)?;
        }
        check(
            "length of swivel_axis",
            norm(self.swivel_axis),
            Rule::Positive,
        )?;
        check("pulley_radius_m", self.pulley_radius_m, Rule::NotNegative)?;
        check("ea_n", self.ea_n, Rule::Positive)?;
        check("damping_time_s", self.damping_time_s, Rule::NotNegative)?;
        check("routing_length_m", self.routing_length_m, Rule::NotNegative)?;
        check("pulley_loss", self.pulley_loss, Rule::UpTo(0.2, "0 to 0.2"))?;
        check(
            "pulley_presliding_m",
            self.pulley_presliding_m,
            Rule::Positive,
        )
    }
}

impl WinchParams {
    fn validate(&self, cable: usize) -> Result<(), PlantError> {
        use Rule::{NotNegative, Positive};
        let (drive, sensor) = (&self.drive, &self.sensor);
        for (name, value, rule) in [
            ("drum_radius_m", self.drum_radius_m, Positive),
            (
                "encoder_counts_per_turn",
                self.encoder_counts_per_turn,
                Positive,
            ),
            (
                "motor_counts_per_drum_turn",
                self.motor_counts_per_drum_turn,
                Positive,
            ),
            ("gear_ratio", self.gear_ratio, Positive),
            ("rotor_inertia_kg_m2", self.rotor_inertia_kg_m2, NotNegative),
            (
                "torque_constant_nm_per_a",
                self.torque_constant_nm_per_a,
                Positive,
            ),
            ("max_motor_rpm", self.max_motor_rpm, Positive),
            ("max_current_a", self.max_current_a, Positive),
            ("friction_n", self.friction_n, NotNegative),
            (
                "viscous_friction_ns_per_m",
                self.viscous_friction_ns_per_m,
                NotNegative,
            ),
            ("drum_mass_kg", self.drum_mass_kg, Positive),
            ("brake close_delay_s", self.brake.close_delay_s, NotNegative),
            ("brake open_delay_s", self.brake.open_delay_s, NotNegative),
            ("brake holding_n", self.brake.holding_n, NotNegative),
            (
                "brake play_m",
                self.brake.play_m,
                Rule::UpTo(0.01, "0 to 0.01"),
            ),
            ("hold_up_s", drive.hold_up_s, NotNegative),
            (
                "position_bandwidth_rad_s",
                drive.position_bandwidth_rad_s,
                Positive,
            ),
            (
                "max_acceleration_mps2",
                drive.max_acceleration_mps2,
                Positive,
            ),
            ("tuned_load_kg", drive.tuned_load_kg, NotNegative),
            ("inner_lag_s", drive.inner_lag_s, NotNegative),
            ("current_lag_s", drive.current_lag_s, NotNegative),
            ("current_quantum_a", drive.current_quantum_a, NotNegative),
            ("reset_time_s", drive.reset_time_s, NotNegative),
            ("mode_time_s", drive.mode_time_s, NotNegative),
            ("tension gain_n_per_v", sensor.gain_n_per_v, Positive),
            ("tension zero_v", sensor.zero_v, Rule::UpTo(3.3, "0 to 3.3")),
            ("tension noise_n", sensor.noise_n, NotNegative),
            ("tension max_n", sensor.max_n, Positive),
            (
                "tension drift steady_n",
                sensor.drift.steady_n,
                Rule::Finite,
            ),
            ("tension drift wave_n", sensor.drift.wave_n, Rule::Finite),
            (
                "tension drift phase_rad",
                sensor.drift.phase_rad,
                Rule::Finite,
            ),
        ] {
            require_of(cable, name, value, rule)?;
        }
        for (name, sign) in [
            ("encoder_sign", self.encoder_sign),
            ("motor_sign", self.motor_sign),
        ] {
            if sign.abs() != 1 {
                return Err(PlantError::CableParameter {
                    cable,
                    name,
                    value: f64::from(sign),
                    rule: "+1 or -1",
                });
            }
        }
        // An eccentricity above a tenth of the radius is not plausible.
        let most = 0.1 * self.drum_radius_m;
        if !(0.0..=most).contains(&self.eccentricity_m) || !self.eccentric_rad.is_finite() {
            return Err(PlantError::CableParameter {
                cable,
                name: "eccentricity_m",
                value: self.eccentricity_m,
                rule: "0 to a tenth of drum_radius_m, at a finite eccentric_rad",
            });
        }
        self.gear
            .as_ref()
            .map_or(Ok(()), |gear| gear.validate(cable))
    }

    /// The vibration of motor and drum on their shaft must be slow enough for the step.
    fn validate_shaft(&self, cable: usize, step_s: f64) -> Result<(), PlantError> {
        let Some(gear) = &self.gear else {
            return Ok(());
        };
        require_of(
            cable,
            "rotor_inertia_kg_m2 of a winch with a gear",
            self.rotor_inertia_kg_m2,
            Rule::Positive,
        )?;
        let stiffness = self.shaft_stiffness_n_per_m(gear);
        let per_mass = 1.0 / self.drum_mass_kg + 1.0 / self.rotor_mass_kg();
        // omega^2 h^2 may be 4 at most for an explicit step: 1 leaves a factor of two in omega.
        if stiffness * per_mass * step_s * step_s > 1.0 {
            return Err(PlantError::CableParameter {
                cable,
                name: "stiffness_nm_per_rad",
                value: gear.stiffness_nm_per_rad,
                rule: "low enough for the step: k (1/drum + 1/rotor) step^2 at most 1",
            });
        }
        Ok(())
    }
}

impl GearParams {
    fn validate(&self, cable: usize) -> Result<(), PlantError> {
        use Rule::{NotNegative, Positive, UpTo};
        for (name, value, rule) in [
            ("rotor_friction_nm", self.rotor_friction_nm, NotNegative),
            ("gear_friction_nm", self.gear_friction_nm, NotNegative),
            (
                "static_friction - 1",
                self.static_friction - 1.0,
                NotNegative,
            ),
            ("stribeck_rpm", self.stribeck_rpm, Positive),
            ("viscous_nm_per_rpm", self.viscous_nm_per_rpm, NotNegative),
            ("efficiency_driving", self.efficiency_driving, Positive),
            (
                "efficiency_driving",
                self.efficiency_driving,
                UpTo(1.0, "above 0, to 1"),
            ),
            (
                "efficiency_driven",
                self.efficiency_driven,
                UpTo(1.0, "0 to 1"),
            ),
            ("play_rad", self.play_rad, UpTo(1.0, "0 to 1")),
            ("stiffness_nm_per_rad", self.stiffness_nm_per_rad, Positive),
            ("cogging_nm", self.cogging_nm, NotNegative),
            ("cold_friction - 1", self.cold_friction - 1.0, NotNegative),
            ("warming_s", self.warming_s, Positive),
        ] {
            require_of(cable, name, value, rule)?;
        }
        Ok(())
    }
}

#[derive(Clone, Copy)]
enum Rule {
    Finite,
    Positive,
    NotNegative,
    UpTo(f64, &'static str),
}

impl Rule {
    fn broken_by(self, value: f64) -> Option<&'static str> {
        let (kept, text) = match self {
            Self::Finite => (true, "finite"),
            Self::Positive => (value > 0.0, "finite and greater than 0"),
            Self::NotNegative => (value >= 0.0, "finite and at least 0"),
            Self::UpTo(max, text) => ((0.0..=max).contains(&value), text),
        };
        (!kept || !value.is_finite()).then_some(text)
    }
}

fn require(name: &'static str, value: f64, rule: Rule) -> Result<(), PlantError> {
    match rule.broken_by(value) {
        Some(rule) => Err(PlantError::Parameter { name, value, rule }),
        None => Ok(()),
    }
}

fn require_of(cable: usize, name: &'static str, value: f64, rule: Rule) -> Result<(), PlantError> {
    match rule.broken_by(value) {
        Some(rule) => Err(PlantError::CableParameter {
            cable,
            name,
            value,
            rule,
        }),
        None => Ok(()),
    }
}

/// `true` if `m` has orthonormal, right-handed rows to `tolerance`.
pub(crate) fn is_rotation(m: &[[f64; 3]; 3], tolerance: f64) -> bool {
    let unit = m.iter().all(|r| (dot(*r, *r) - 1.0).abs() <= tolerance);
    unit && (dot(cross(m[0], m[1]), m[2]) - 1.0).abs() <= tolerance
}
