//! A winch module: drum, gear, motor, drive, brake and tension sensor.

use serde::Serialize;
use std::f64::consts::PI;

/// Protocol of a motor drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum DriveKind {
    /// RoboModule RMDS.
    Rmds,
    /// CiA 402 over CANopen.
    Cia402,
}

/// One winch module.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Winch {
    /// Number by which cables and commands name it.
    pub id: u8,
    /// Drum radius to the cable's centre, m.
    pub drum_radius_m: f64,
    /// Cable diameter, m.
    pub cable_diameter_m: f64,
    /// Turns of cable that the drum takes.
    pub turns_max: f64,
    /// Inertia of drum, screw and coupling about the drum's axis, kg m2.
    pub drum_inertia_kg_m2: f64,
    /// Drum encoder counts per drum turn.
    pub encoder_counts_per_turn: u32,
    /// 1 if the drum encoder counts up while cable is paid out, else -1.
    pub encoder_sign: i8,
    /// Motor encoder counts per drum turn.
    pub motor_counts_per_turn: f64,
    /// Motor turns per drum turn.
    pub gear_ratio: f64,
    /// Greatest motor speed, turns per minute.
    pub max_motor_rpm: f64,
    /// Greatest motor current, A.
    pub max_current_a: f64,
    /// Torque constant, Nm/A.
    pub torque_constant_nm_per_a: f64,
    /// Rotor inertia about the motor's axis, kg m2.
    pub rotor_inertia_kg_m2: f64,
    /// Coulomb friction of the drum's side, felt at the cable, N.
    pub friction_n: f64,
    /// Gear between motor and drum; `None` for a rigid connection.
    pub gear: Option<Gear>,
    /// How far the drum is out of its axis, m.
    pub drum_eccentricity_m: f64,
    /// Time until the brake holds, s.
    pub brake_close_s: f64,
    /// Force at the cable that the closed brake holds, N.
    pub brake_holding_n: f64,
    /// Time for which the rail keeps the drive after its supply failed, s.
    pub drive_hold_up_s: f64,
    /// How far the drum turns in its closed brake, at the cable, m.
    pub brake_play_m: f64,
    /// k of tension = k (voltage - u_0), N/V.
    pub tension_gain_n_per_v: f64,
    /// u_0 of tension = k (voltage - u_0), V.
    pub tension_zero_v: f64,
    /// Full scale of the tension sensor, N.
    pub tension_max_n: f64,
    /// Protocol of the drive.
    pub drive: DriveKind,
    /// Number of the drive on the bus.
    pub node: u8,
    /// Bandwidth of the drive's position loop, rad/s.
    pub drive_bandwidth_rad_s: f64,
    /// Time constant of the drive's current loop, s.
    pub current_lag_s: f64,
}

/// A gear with its friction, loss, play and twist; torques at the motor unless they say otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Gear {
    /// Coulomb friction of the rotor, Nm.
    pub rotor_friction_nm: f64,
    /// Coulomb friction of the gear without load, Nm.
    pub gear_friction_nm: f64,
    /// Friction at rest over Coulomb friction.
    pub static_friction: f64,
    /// Motor speed over which friction falls from the one to the other, rpm.
    pub stribeck_rpm: f64,
    /// Viscous friction, Nm per rpm.
    pub viscous_nm_per_rpm: f64,
    /// Share of the motor's power that reaches the drum.
    pub efficiency: f64,
    /// Share of the drum's power that reaches the motor.
    pub backdrive_efficiency: f64,
    /// Play as a turn of the drum, rad.
    pub play_rad: f64,
    /// Torque per twist at the drum, Nm/rad.
    pub stiffness_nm_per_rad: f64,
    /// Amplitude of the cogging torque, Nm.
    pub cogging_nm: f64,
    /// Periods of the cogging torque per turn of the motor.
    #[serde(skip_serializing_if = "is_usual_cogging")]
    pub cogging_per_turn: u16,
    /// Cold friction over warm friction.
    pub cold_friction: f64,
}

/// Periods of the cogging torque where a file gives none.
pub(crate) const USUAL_COGGING_PER_TURN: u16 = 12;

/// Whether it is the default: such robots keep the hash of their description without this key.
#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "the signature that serde calls"
)]
const fn is_usual_cogging(periods: &u16) -> bool {
    *periods == USUAL_COGGING_PER_TURN
}

/// Steps of a tension channel at which a board takes it for open.
/// Of 65 536 steps for 3.3 V: 3.27 V.
const OPEN_SENSOR_STEPS: f64 = 64_900.0;
/// Share of that reading which a limit may be, as the board checks it, less a rounding error.
const SENSOR_SHARE: f64 = 0.9 * 0.9999;

impl Winch {
    /// Coulomb friction of drum, gear and rotor together, felt at the cable, N.
    pub fn total_friction_n(&self) -> f64 {
        let at_motor_nm = self
            .gear
            .map_or(0.0, |gear| gear.rotor_friction_nm + gear.gear_friction_nm);
        self.friction_n + at_motor_nm * self.gear_ratio / self.drum_radius_m
    }

    /// Whether a gear between motor and drum rubs or loses torque.
    pub fn has_lossy_gear(&self) -> bool {
        self.gear.is_some_and(|gear| {
            gear.rotor_friction_nm + gear.gear_friction_nm > 0.0 || gear.efficiency < 1.0
        })
    }

    /// Play between motor and drum, as cable, m.
    pub fn play_m(&self) -> f64 {
        self.gear
            .map_or(0.0, |gear| gear.play_rad * self.drum_radius_m)
    }

    /// Motor force at the cable needed for `force_n`: it includes gear losses on the way to the
    /// drum and friction, N.
    pub fn driving_force_n(&self, force_n: f64) -> f64 {
        let efficiency = self.gear.map_or(1.0, |gear| gear.efficiency);
        // The drum's friction passes through the gear as the load does; that of rotor and gear does
        // not.
        (force_n + self.friction_n) / efficiency + self.total_friction_n() - self.friction_n
    }

    /// Cable speed at the greatest motor speed, m/s: `2 pi R rpm / (60 ratio)`.
    pub fn max_cable_speed_mps(&self) -> f64 {
        // 8000 rpm behind 371:1 on a drum of 20 mm give 45 mm/s.
        self.max_motor_rpm / 60.0 / self.gear_ratio * 2.0 * PI * self.drum_radius_m
    }

    /// Mass that the cable feels when it accelerates the winch, kg:
    /// (rotor inertia x ratio^2 + drum inertia) / R^2.
    pub fn effective_mass_kg(&self) -> f64 {
        // The ratio counts twice: 371:1 multiplies a rotor's inertia by 138 000, to 34 kg at the
        // cable.
        (self.rotor_inertia_kg_m2 * self.gear_ratio.powi(2) + self.drum_inertia_kg_m2)
            / self.drum_radius_m.powi(2)
    }

    /// Cable force per motor current, N/A, without losses in the gear.
    pub fn force_per_current_n_per_a(&self) -> f64 {
        self.torque_constant_nm_per_a * self.gear_ratio / self.drum_radius_m
    }

    /// Cable force at the greatest current, N, without losses in the gear.
    pub(crate) fn max_force_n(&self) -> f64 {
        self.force_per_current_n_per_a() * self.max_current_a
    }

    /// Greatest tension that its sensor can be trusted to show, N: nine tenths of the reading at
    /// which the board takes it for an open input (S7). A limit above that could be exceeded
    /// unnoticed.
    pub fn trusted_tension_n(&self) -> f64 {
        // 3.27 V: from there on the board takes the input for an open wire (S7).
        let rail_v = OPEN_SENSOR_STEPS / 65_536.0 * 3.3;
        let reads_n = self.tension_gain_n_per_v * (rail_v - self.tension_zero_v);
        (SENSOR_SHARE * reads_n).min(self.tension_max_n)
    }

    /// Greatest tension, N, at which the board's test of the brake passes: the board has it hold the tension and half of
    /// it, and pushes with an eighth more (`firmware/src/proof.rs`).
    pub fn proven_tension_n(&self) -> f64 {
        self.brake_holding_n / (1.5 * 1.125)
    }

    /// Motor counts per drum encoder count: the rho of the paper's Eqs. 50 and 54.
    pub fn motor_counts_per_encoder_count(&self) -> f64 {
        self.motor_counts_per_turn / f64::from(self.encoder_counts_per_turn)
    }
}
