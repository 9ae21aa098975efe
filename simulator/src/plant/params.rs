//! What the plant is made of: plain numbers in SI, one struct per physical part.

use super::error::PlantError;
use super::vec3::{cross, dot, norm, symmetric_eigen};

/// The most cables a plant can have.
pub const MAX_CABLES: usize = 8;

/// A cable with its pulley.
#[derive(Debug, Clone, PartialEq)]
pub struct CableParams {
    /// Fixed entry point `B` of the cable on the swivel axis, world frame (m).
    pub anchor_m: [f64; 3],
    /// Swivel axis: the direction in which the cable travels when it reaches `B`, world frame,
    /// any non-zero length.
    pub swivel_axis: [f64; 3],
    /// Radius of the cable's arc on the pulley (m); 0 is a point anchor.
    pub pulley_radius_m: f64,
    /// Attachment on the platform, platform frame (m).
    pub attachment_m: [f64; 3],
    /// Axial stiffness EA: tension per unit strain (N).
    pub ea_n: f64,
    /// Damping over stiffness (s): the cable's damping is this times EA over its length.
    pub damping_time_s: f64,
    /// Cable between pulley and drum (m). It stretches like the rest.
    pub routing_length_m: f64,
    /// Largest fraction of tension lost over the pulley, 0 to 0.2. While the cable is hauled in
    /// the winch side carries `1 + loss` times the platform side, while it is paid out `1 - loss`.
    pub pulley_loss: f64,
    /// Travel over which the pulley's friction reverses (m): the `sigma` of Dahl's model (1968).
    pub pulley_presliding_m: f64,
}

/// A drum with its rotor, gear, friction and encoder.
#[derive(Debug, Clone, PartialEq)]
pub struct WinchParams {
    /// Radius at which the cable leaves the drum (m).
    pub drum_radius_m: f64,
    /// Drum encoder counts per drum turn.
    pub encoder_counts_per_turn: f64,
    /// +1 if the encoder counts up when cable is paid out, -1 otherwise.
    pub encoder_sign: i8,
    /// Motor counts per drum turn.
    pub motor_counts_per_drum_turn: f64,
    /// +1 if motor counts (and a positive current) pay out, -1 if they haul in.
    pub motor_sign: i8,
    /// Motor turns per drum turn.
    pub gear_ratio: f64,
    /// Inertia of the motor's rotor (kg m^2). At the cable it weighs `J (gear / radius)^2`.
    pub rotor_inertia_kg_m2: f64,
    /// Motor torque per ampere (N m/A), before the gear.
    pub torque_constant_nm_per_a: f64,
    /// Speed limit of the motor (rpm): no torque pushes it beyond.
    pub max_motor_rpm: f64,
    /// Current limit (A).
    pub max_current_a: f64,
    /// Coulomb friction of drum and gear, as a force at the cable (N).
    pub friction_n: f64,
    /// Viscous friction, as a force at the cable per cable speed (N s/m).
    pub viscous_friction_ns_per_m: f64,
    /// Drum inertia as an equivalent mass at the cable (kg).
    pub drum_mass_kg: f64,
    /// Brake.
    pub brake: BrakeParams,
    /// Drive electronics.
    pub drive: DriveParams,
    /// Tension sensor.
    pub sensor: TensionSensorParams,
}

/// A spring-applied brake on the drum.
#[derive(Debug, Clone, PartialEq)]
pub struct BrakeParams {
    /// From the command until it holds (s).
    pub close_delay_s: f64,
    /// From the command until it is free (s).
    pub open_delay_s: f64,
    /// Force at the cable above which it slips (N); it keeps rubbing with that force.
    pub holding_n: f64,
}

/// A servo drive in the manner of the RoboModule RMDS (an inference from the paper's words).
#[derive(Debug, Clone, PartialEq)]
pub struct DriveParams {
    /// Bandwidth of the position loop (rad/s). The speed loop inside it runs at four times this;
    /// the current loop's lag is taken to be part of these figures.
    pub position_bandwidth_rad_s: f64,
    /// Largest acceleration the position and speed modes ask for, at the cable (m/s^2).
    pub max_acceleration_mps2: f64,
    /// Mass at the cable, beyond drum and rotor, that the loops are tuned for (kg).
    pub tuned_load_kg: f64,
    /// Time constant of the current in current mode (s).
    pub current_lag_s: f64,
    /// Step of the current command (A).
    pub current_quantum_a: f64,
    /// From a reset until the drive answers (s).
    pub reset_time_s: f64,
    /// From the choice of a mode until it is obeyed (s).
    pub mode_time_s: f64,
}

/// A tension sensor at the winch, `tension = gain (voltage - zero)`, and its converter.
///
/// The reading is the sum of 16 conversions of 12 bits: 0..=65520 for 0 V to 3.3 V, so
/// `voltage = reading / 65520 * 3.3`.
#[derive(Debug, Clone, PartialEq)]
pub struct TensionSensorParams {
    /// Newtons per volt.
    pub gain_n_per_v: f64,
    /// Voltage without tension (V).
    pub zero_v: f64,
    /// Standard deviation of one reading, after its 16-fold averaging (N).
    pub noise_n: f64,
    /// The bridge saturates at this tension (N).
    pub max_n: f64,
}

/// The moving platform.
#[derive(Debug, Clone, PartialEq)]
pub struct PlatformParams {
    /// Mass (kg).
    pub mass_kg: f64,
    /// Centre of mass, platform frame (m).
    pub center_of_mass_m: [f64; 3],
    /// Inertia about the centre of mass, platform axes (kg m^2).
    pub inertia_kg_m2: [[f64; 3]; 3],
    /// Tool point, platform frame (m).
    pub tcp_m: [f64; 3],
    /// Drag on the centre of mass (N s/m). 0 in a real robot; tests raise it.
    pub linear_damping_ns_per_m: f64,
    /// Drag on rotation (N m s). 0 in a real robot; tests raise it.
    pub angular_damping_nms: f64,
}

/// Timing of the bus between board and drives.
#[derive(Debug, Clone, PartialEq)]
pub struct BusParams {
    /// Each drive gets one command and sends one feedback per period (s). The drives' slots are
    /// spread evenly over the period: drive `i` of `n` at `i / n` of it.
    pub period_s: f64,
    /// Transport time of a command or a feedback (s), less than the period.
    pub latency_s: f64,
}

/// Everything the plant needs to know. All fields SI, world frame with z up.
#[derive(Debug, Clone, PartialEq)]
pub struct PlantParams {
    /// The platform.
    pub platform: PlatformParams,
    /// Cables, 1 to [`MAX_CABLES`].
    pub cables: Vec<CableParams>,
    /// Winches, one per cable, same order.
    pub winches: Vec<WinchParams>,
    /// Drive bus.
    pub bus: BusParams,
    /// Acceleration of gravity, world frame (m/s^2).
    pub gravity_mps2: [f64; 3],
    /// Length of one integration step (s).
    pub step_s: f64,
    /// Whether the e-stop button cuts drive power and brake current by wire (as it must).
    pub e_stop_cuts_power: bool,
}

impl Default for WinchParams {
    /// The paper's winch with the assumptions of this project: 20 mm drum, 371.13:1, 0.1 kg
    /// equivalent drum, 0.5 N friction. Rotor inertia is 0: name the motor's to have it.
    fn default() -> Self {
        Self {
            drum_radius_m: 0.02,
            encoder_counts_per_turn: 4096.0,
            encoder_sign: 1,
            motor_counts_per_drum_turn: 1_520_148.0,
            motor_sign: 1,
            gear_ratio: 371.13,
            rotor_inertia_kg_m2: 0.0,
            torque_constant_nm_per_a: 0.01,
            max_motor_rpm: 8000.0,
            max_current_a: 1.0,
            friction_n: 0.5,
            viscous_friction_ns_per_m: 0.0,
            drum_mass_kg: 0.1,
            brake: BrakeParams {
                close_delay_s: 0.03,
                open_delay_s: 0.03,
                holding_n: 150.0,
            },
            drive: DriveParams {
                position_bandwidth_rad_s: 150.0,
                max_acceleration_mps2: 5.0,
                tuned_load_kg: 1.5,
                current_lag_s: 0.003,
                current_quantum_a: 0.001,
                reset_time_s: 0.5,
                mode_time_s: 0.5,
            },
            sensor: TensionSensorParams {
                gain_n_per_v: 12.77,
                zero_v: 0.2355,
                noise_n: 0.05,
                max_n: 60.0,
            },
        }
    }
}

impl PlantParams {
    /// The paper's four-cable robot with the calibrated anchors of its Table 5; everything the
    /// paper does not give is an assumption (mass 1.4 kg, EA 50 kN, pulley radius 10 mm, 0.7 m of
    /// routing, no pulley loss).
    ///
    /// ```
    /// let robot = mcdpr_simulator::plant::PlantParams::paper_table5();
    /// assert_eq!(robot.cables.len(), 4);
    /// assert_eq!(robot.cables[0].anchor_m, [0.025102, -0.370603, 0.0241]);
    /// ```
    #[must_use]
    pub fn paper_table5() -> Self {
        let anchors = [
            [0.025_102, -0.370_603, 0.0241],
            [0.040_201, 0.384_903, 0.0242],
            [0.644_503, 0.370_101, 0.0245],
            [0.629_502, -0.385_401, 0.0239],
        ];
        let attachments = [
            [-0.045, -0.065, 0.0],
            [-0.045, 0.065, 0.0],
            [0.045, 0.065, 0.0],
            [0.045, -0.065, 0.0],
        ];
        let mass_kg = 1.4;
        let cables: Vec<_> = anchors
            .into_iter()
            .zip(attachments)
            .map(|(anchor_m, attachment_m)| CableParams {
                anchor_m,
                swivel_axis: [0.0, 0.0, 1.0],
                pulley_radius_m: 0.01,
                attachment_m,
                ea_n: 50_000.0,
                damping_time_s: 2e-4,
                routing_length_m: 0.7,
                pulley_loss: 0.0,
                pulley_presliding_m: 2e-4,
            })
            .collect();
        Self {
            platform: PlatformParams {
                mass_kg,
                center_of_mass_m: [0.0, 0.0, -0.03],
                inertia_kg_m2: box_inertia_kg_m2(mass_kg, [0.13, 0.18, 0.04]),
                tcp_m: [0.0, 0.0, -0.08],
                linear_damping_ns_per_m: 0.0,
                angular_damping_nms: 0.0,
            },
            winches: vec![WinchParams::default(); cables.len()],
            cables,
            bus: BusParams {
                period_s: 0.002,
                latency_s: 0.000_25,
            },
            gravity_mps2: [0.0, 0.0, -9.81],
            step_s: 1e-4,
            e_stop_cuts_power: true,
        }
    }

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
        require("bus period_s", self.bus.period_s, Rule::Positive)?;
        require("bus latency_s", self.bus.latency_s, Rule::NotNegative)?;
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
    /// Mass at the cable of drum and rotor together (kg): `m + J (gear / radius)^2`.
    ///
    /// ```
    /// let mut winch = mcdpr_simulator::plant::WinchParams::default();
    /// (winch.gear_ratio, winch.rotor_inertia_kg_m2) = (100.0, 1e-6);
    /// assert!((winch.effective_mass_kg() - (0.1 + 25.0)).abs() < 1e-9); // 1e-6 (100 / 0.02)^2
    /// ```
    #[must_use]
    pub fn effective_mass_kg(&self) -> f64 {
        self.drum_mass_kg
            + self.rotor_inertia_kg_m2 * (self.gear_ratio / self.drum_radius_m).powi(2)
    }

    /// Force at the cable per ampere (N/A): torque constant times gear over drum radius.
    #[must_use]
    pub fn force_per_ampere_n(&self) -> f64 {
        self.torque_constant_nm_per_a * self.gear_ratio / self.drum_radius_m
    }

    /// Cable speed at the motor's speed limit (m/s).
    #[must_use]
    pub fn max_speed_mps(&self) -> f64 {
        self.max_motor_rpm * self.mps_per_rpm()
    }

    /// Cable speed per motor rpm (m/s).
    #[must_use]
    pub fn mps_per_rpm(&self) -> f64 {
        std::f64::consts::TAU * self.drum_radius_m / (60.0 * self.gear_ratio)
    }

    /// Cable per motor count (m).
    #[must_use]
    pub fn metres_per_motor_count(&self) -> f64 {
        std::f64::consts::TAU * self.drum_radius_m / self.motor_counts_per_drum_turn
    }

    /// Cable per encoder count (m).
    #[must_use]
    pub fn metres_per_encoder_count(&self) -> f64 {
        std::f64::consts::TAU * self.drum_radius_m / self.encoder_counts_per_turn
    }

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
            ("current_lag_s", drive.current_lag_s, NotNegative),
            ("current_quantum_a", drive.current_quantum_a, NotNegative),
            ("reset_time_s", drive.reset_time_s, NotNegative),
            ("mode_time_s", drive.mode_time_s, NotNegative),
            ("tension gain_n_per_v", sensor.gain_n_per_v, Positive),
            ("tension zero_v", sensor.zero_v, Rule::UpTo(3.3, "0 to 3.3")),
            ("tension noise_n", sensor.noise_n, NotNegative),
            ("tension max_n", sensor.max_n, Positive),
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
        Ok(())
    }
}

/// Inertia of a solid box about its centre, box axes (kg m^2).
///
/// `sides_m`: lengths along x, y, z.
///
/// ```
/// let i = mcdpr_simulator::plant::box_inertia_kg_m2(12.0, [1.0, 2.0, 3.0]);
/// assert_eq!([i[0][0], i[1][1], i[2][2]], [13.0, 10.0, 5.0]);
/// ```
#[must_use]
pub fn box_inertia_kg_m2(mass_kg: f64, sides_m: [f64; 3]) -> [[f64; 3]; 3] {
    let [x, y, z] = sides_m.map(|s| s * s * mass_kg / 12.0);
    [[y + z, 0.0, 0.0], [0.0, x + z, 0.0], [0.0, 0.0, x + y]]
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
