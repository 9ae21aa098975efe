//! The robot description as physics for the simulator, exact or with a stated mismatch.

mod after_hours;

pub use after_hours::AfterHours;

use crate::line::plant_failed;
use mcdpr_core::motion::{Model, PlanOptions};
use mcdpr_core::robot::{Cable, DriveKind, Gear, Robot, Winch};
use mcdpr_core::run::RunError;
use mcdpr_simulator::plant::{
    BrakeParams, BusParams, CableParams, DriveParams, GearParams, Plant, PlantError, PlantParams,
    PlatformParams, Pose, Protocol, TensionSensorParams, WinchParams,
};
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

/// Errors of the simulated machine relative to its description, as one standard deviation or a half
/// width if stated. All zero: the machine is exactly as described.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Mismatch {
    /// Anchors, half width per axis, m.
    pub anchors_m: f64,
    /// Attachments, half width per axis, m.
    pub attachments_m: f64,
    /// Centre of mass, half width per axis, m.
    pub center_of_mass_m: f64,
    /// Mass, relative half width.
    pub mass: f64,
    /// Stiffness EA, relative half width.
    pub ea: f64,
    /// Tension sensor gain, relative half width.
    pub sensor_gain: f64,
    /// Drive bandwidth, relative half width.
    pub bandwidth: f64,
    /// Tension lost at every pulley, as a share.
    pub pulley_loss: f64,
    /// Errors of the gears relative to the file.
    pub gears: GearMismatch,
}

/// Errors of the gears of the simulated machine relative to the robot file; no effect without
/// gears. The board gets the file's values.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct GearMismatch {
    /// Friction of rotor and gear, relative half width.
    pub friction: f64,
    /// Loss of the motor's power in the gear, relative half width; the loss when it is driven
    /// changes with it.
    pub loss: f64,
    /// Play, relative half width.
    pub play: f64,
    /// Torsional stiffness, relative half width.
    pub stiffness: f64,
}

impl GearMismatch {
    /// Errors left by identification: friction within a tenth of its value, the difference between
    /// gears of the same type with their grease and its temperature; assumption.
    const fn realistic() -> Self {
        Self {
            friction: 0.1,
            loss: 0.1,
            play: 0.1,
            stiffness: 0.3,
        }
    }
}

impl Mismatch {
    /// The machine as built, before any calibration: anchors off by 5 mm, and every other error
    /// that occurs in practice.
    #[must_use]
    pub const fn as_built() -> Self {
        Self {
            anchors_m: 5e-3,
            ..Self::realistic()
        }
    }

    /// The machine of a report's second column: calibrated anchors off by 0.3 mm and every other
    /// error that occurs in practice.
    #[must_use]
    pub const fn realistic() -> Self {
        Self {
            anchors_m: 0.3e-3,
            attachments_m: 0.1e-3,
            center_of_mass_m: 1e-3,
            mass: 0.02,
            ea: 0.2,
            sensor_gain: 0.01,
            bandwidth: 0.2,
            pulley_loss: 0.02,
            gears: GearMismatch::realistic(),
        }
    }
}

/// Time that drives take to enter a mode, s.
const RMDS_MODE_S: f64 = 0.5;
const CIA402_MODE_S: f64 = 0.02;
/// Viscous friction is not a key of the robot file: Coulomb friction dominates these drums.
const VISCOUS_FRICTION_NS_PER_M: f64 = 0.0;
/// A brake that is too weak is a fault to be injected, not a property of a robot file, N.
const BRAKE_HOLDING_N: f64 = 150.0;
/// A drive follows set-points as fast as its motor can, m/s².
const MAX_ACCELERATION_MPS2: f64 = 100.0;
/// Sensor noise after oversampling, N.
const SENSOR_NOISE_N: f64 = 0.05;
/// Above this share of the sensor's full scale the bridge saturates.
const SENSOR_OVERLOAD: f64 = 1.5;
/// Lag of the current under the drive's position and speed loops, s: a current loop of 500 Hz;
/// assumption, 0.1 to 0.5 ms. Without a gear it counts as part of the loops' bandwidth.
const INNER_LAG_S: f64 = 0.3e-3;
/// Travel over which a pulley's friction builds up after a reversal, m.
const PRESLIDING_M: f64 = 2e-4;

/// The physics of this robot, off by `mismatch` drawn with `seed`.
#[must_use]
pub fn plant_params(robot: &Robot, mismatch: &Mismatch, seed: u64) -> PlantParams {
    let mut draws = Draws::new(seed);
    let mut cables = Vec::new();
    let mut winches = Vec::new();
    for (index, cable) in robot.cables.iter().enumerate() {
        cables.push(cable_params(cable, mismatch, &mut draws));
        if let Some(winch) = robot.winch_of(index) {
            winches.push(winch_params(winch, mismatch, &mut draws));
        }
    }
    PlantParams {
        platform: platform_params(robot, mismatch, &mut draws),
        cables,
        winches,
        bus: BusParams {
            period_s: f64::from(robot.bus.period_us) * 1e-6,
            latency_s: 0.000_25,
            bitrate: robot.bus.bitrate,
        },
        gravity_mps2: [0.0, 0.0, -mcdpr_kinematics::GRAVITY_MPS2],
        step_s: 1e-4,
        cables_attached: true,
        e_stop_cuts_power: true,
        slow: mcdpr_simulator::plant::SlowParams::default(),
    }
}

/// Random errors of one machine. The order of the draws decides what a seed means.
struct Draws {
    rng: ChaCha8Rng,
    /// A separate sequence: machines without gears are unchanged.
    gears: ChaCha8Rng,
}

impl Draws {
    fn new(seed: u64) -> Self {
        Self {
            rng: ChaCha8Rng::seed_from_u64(seed ^ 0x6D69_736D),
            gears: ChaCha8Rng::seed_from_u64(seed ^ 0x6765_6172),
        }
    }

    /// A number from `-half_width` to `half_width`.
    fn within(&mut self, half_width: f64) -> f64 {
        (2.0 * unit(&mut self.rng) - 1.0) * half_width
    }

    fn shifted(&mut self, vector: Vector3<f64>, half_width: f64) -> [f64; 3] {
        let vector: [f64; 3] = vector.into();
        vector.map(|value| value + self.within(half_width))
    }
}

fn cable_params(cable: &Cable, mismatch: &Mismatch, draws: &mut Draws) -> CableParams {
    CableParams {
        anchor_m: draws.shifted(cable.anchor_in_world_m, mismatch.anchors_m),
        swivel_axis: cable.swivel_axis_in_world.into(),
        pulley_radius_m: cable.pulley_radius_m,
        attachment_m: draws.shifted(cable.attachment_in_platform_m, mismatch.attachments_m),
        ea_n: cable.ea_n * (1.0 + draws.within(mismatch.ea)),
        damping_time_s: cable.damping_time_s,
        routing_length_m: cable.routing_length_m,
        // The greater of both: a file that names its pulleys' loss keeps it.
        pulley_loss: cable.pulley_loss.max(mismatch.pulley_loss),
        pulley_presliding_m: PRESLIDING_M,
    }
}

fn winch_params(winch: &Winch, mismatch: &Mismatch, draws: &mut Draws) -> WinchParams {
    let reversed = winch.motor_counts_per_turn < 0.0;
    let gear = winch
        .gear
        .map(|gear| gear_params(&gear, &mismatch.gears, &mut draws.gears));
    WinchParams {
        drum_radius_m: winch.drum_radius_m,
        encoder_counts_per_turn: f64::from(winch.encoder_counts_per_turn),
        encoder_sign: winch.encoder_sign,
        motor_counts_per_drum_turn: winch.motor_counts_per_turn.abs(),
        motor_sign: if reversed { -1 } else { 1 },
        gear_ratio: winch.gear_ratio,
        rotor_inertia_kg_m2: winch.rotor_inertia_kg_m2,
        torque_constant_nm_per_a: winch.torque_constant_nm_per_a,
        max_motor_rpm: winch.max_motor_rpm,
        max_current_a: winch.max_current_a,
        friction_n: winch.friction_n,
        viscous_friction_ns_per_m: VISCOUS_FRICTION_NS_PER_M,
        gear,
        eccentricity_m: winch.drum_eccentricity_m,
        // Where the drum's farthest side is when the cable is cut is unknown.
        eccentric_rad: std::f64::consts::TAU * unit(&mut draws.gears),
        // J / r^2 is the drum's mass at the cable.
        drum_mass_kg: winch.drum_inertia_kg_m2 / winch.drum_radius_m.powi(2),
        brake: BrakeParams {
            close_delay_s: winch.brake_close_s,
            // A robot file has one time for a brake: it opens as fast as it closes.
            open_delay_s: winch.brake_close_s,
            holding_n: BRAKE_HOLDING_N,
            play_m: winch.brake_play_m,
        },
        drive: drive_params(winch, mismatch, draws),
        sensor: TensionSensorParams {
            gain_n_per_v: winch.tension_gain_n_per_v * (1.0 + draws.within(mismatch.sensor_gain)),
            zero_v: winch.tension_zero_v,
            noise_n: SENSOR_NOISE_N,
            max_n: winch.tension_max_n * SENSOR_OVERLOAD,
        },
    }
}

fn drive_params(winch: &Winch, mismatch: &Mismatch, draws: &mut Draws) -> DriveParams {
    let (protocol, mode_time_s) = match winch.drive {
        DriveKind::Rmds => (Protocol::Rmds, RMDS_MODE_S),
        DriveKind::Cia402 => (Protocol::Cia402, CIA402_MODE_S),
    };
    DriveParams {
        hold_up_s: winch.drive_hold_up_s,
        position_bandwidth_rad_s: winch.drive_bandwidth_rad_s
            * (1.0 + draws.within(mismatch.bandwidth)),
        current_lag_s: winch.current_lag_s,
        inner_lag_s: if winch.gear.is_some() {
            INNER_LAG_S
        } else {
            0.0
        },
        // The motor is the limit, not the drive's profile.
        max_acceleration_mps2: MAX_ACCELERATION_MPS2,
        protocol,
        node: Some(winch.node),
        mode_time_s,
        ..WinchParams::default().drive
    }
}

fn platform_params(robot: &Robot, mismatch: &Mismatch, draws: &mut Draws) -> PlatformParams {
    let platform = &robot.platform;
    let inertia = platform.inertia_kg_m2;
    PlatformParams {
        mass_kg: platform.mass_kg * (1.0 + draws.within(mismatch.mass)),
        center_of_mass_m: draws.shifted(platform.center_of_mass_m, mismatch.center_of_mass_m),
        inertia_kg_m2: [0, 1, 2].map(|row| [0, 1, 2].map(|column| inertia[(row, column)])),
        tcp_m: robot.tool.tcp_in_platform_m.into(),
        linear_damping_ns_per_m: 0.0,
        angular_damping_nms: 0.0,
    }
}

/// A number from 0 to 1.
fn unit(rng: &mut ChaCha8Rng) -> f64 {
    f64::from(rng.next_u32()) / f64::from(u32::MAX)
}

/// A winch's gear, with the errors drawn.
fn gear_params(gear: &Gear, off: &GearMismatch, rng: &mut ChaCha8Rng) -> GearParams {
    let mut times = |half_width: f64| 1.0 + (2.0 * unit(rng) - 1.0) * half_width;
    let friction = times(off.friction);
    let loss = times(off.loss);
    let play = times(off.play);
    let stiffness = times(off.stiffness);
    // Losses as shares of the load, as friction in the teeth causes them.
    let driving = (1.0 / gear.efficiency - 1.0) * loss;
    let driven = (1.0 - gear.backdrive_efficiency) * loss;
    GearParams {
        rotor_friction_nm: gear.rotor_friction_nm * friction,
        gear_friction_nm: gear.gear_friction_nm * friction,
        static_friction: gear.static_friction,
        stribeck_rpm: gear.stribeck_rpm,
        viscous_nm_per_rpm: gear.viscous_nm_per_rpm,
        // Back from a loss to a share: 1 / 0.7 - 1 = 0.43 and 1 / 1.43 = 0.7.
        efficiency_driving: 1.0 / (1.0 + driving),
        efficiency_driven: (1.0 - driven).clamp(0.0, 1.0),
        play_rad: gear.play_rad * play,
        stiffness_nm_per_rad: gear.stiffness_nm_per_rad * stiffness,
        cogging_nm: gear.cogging_nm,
        cold_friction: gear.cold_friction,
        ..GearParams::default()
    }
}

/// The plant of a robot that hangs at rest near a pose, brakes closed, its tension-held cables (from 0)
/// at their tensions (N).
///
/// # Errors
/// If it finds no equilibrium near the pose.
pub fn hang(
    params: PlantParams,
    pose: &mcdpr_kinematics::Pose,
    tensions_n: &[f64],
    held: &[usize],
    seed: u64,
) -> Result<Plant, PlantError> {
    let mut plant = Plant::new(params, seed)?;
    let matrix = pose.rotation.matrix();
    let rotation = [0, 1, 2].map(|row| [0, 1, 2].map(|column| matrix[(row, column)]));
    let start = Pose::from_matrix(pose.position_m.into(), &rotation)?;
    plant.settle_held(&start, tensions_n, held)?;
    Ok(plant)
}

/// The plant of `machine` at rest with its tool at a place (world, m; `None`: at home), brakes closed, with
/// the tensions that the model's options have there.
///
/// # Errors
/// Where it cannot hang there.
pub fn at_rest(
    model: &Model,
    machine: &Robot,
    mismatch: &Mismatch,
    seed: u64,
    tool_m: Option<Vector3<f64>>,
) -> Result<Plant, RunError> {
    // A planner that takes the platform for level knows no other way to hang than the others.
    let hanging = PlanOptions {
        tensioning: model.options().tensioning,
        ..PlanOptions::default()
    };
    let described = Model::new(machine)?.with_options(hanging);
    let rest = match tool_m {
        None => described.rest_at_home()?,
        Some(tool_m) => described.rest(&tool_m, None)?,
    };
    let params = plant_params(machine, mismatch, seed);
    let (pose, held) = (&rest.equilibrium.pose, model.holding().by_tension());
    hang(params, pose, rest.tensions_n(), held, seed)
        .map_err(|error| RunError::Client(plant_failed(error).into()))
}
