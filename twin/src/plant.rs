//! The robot description as physics for the simulator, exact or with a stated mismatch.

mod after_hours;
mod sources;

pub use after_hours::AfterHours;
pub use sources::Source;

use crate::line::plant_failed;
use mcdpr_core::motion::{Model, PlanOptions};
use mcdpr_core::random::Random;
use mcdpr_core::robot::{Cable, DriveKind, Gear, Robot, Winch};
use mcdpr_core::run::RunError;
use mcdpr_simulator::plant::{
    BrakeParams, BusParams, CableParams, DriveParams, GearParams, Plant, PlantError, PlantParams,
    PlatformParams, Pose, Protocol, SensorDrift, TensionSensorParams, UnmodelledParams,
    WinchParams,
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
    /// What real machines have besides.
    #[serde(default)]
    pub found: FoundMismatch,
    /// What creeps, warms and drifts while it works; `None`: nothing does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hours: Option<AfterHours>,
}

/// Errors that the logs of a real four-cable robot show beyond those of its geometry (IRMA4U, University
/// of Bologna; repository fzoffoli/UACDPR_SelfCalibration, March 2025): standard deviations, drawn normal.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct FoundMismatch {
    /// Radius of each drum, relative.
    pub drum: f64,
    /// Zero of each load cell in a session, share of its range.
    pub zero: f64,
    /// Noise of each load cell, share of its range; the greater of this and the usual one.
    pub noise: f64,
    /// Where the platform truly hangs when a session begins at home, per axis, m.
    pub homing_m: f64,
    /// Force that no model has, each component, share of the weight.
    pub force: f64,
    /// Moment that no model has, each component over the weight, m.
    pub moment_m: f64,
    /// The session, from 0: zeros and homing are new in each.
    pub session: u64,
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
    /// The machine with all errors found on a real one (IRMA4U, see [`FoundMismatch`]), its winches and
    /// cells calibrated one by one: anchors by tape, each drum its own, cells with zeros of the session,
    /// and equations of equilibrium that do not close.
    #[must_use]
    pub const fn as_found() -> Self {
        Self {
            // Half widths of 1.7 standard deviations: 1 % of a cell's gain, 3 mm of the centre of mass.
            sensor_gain: 0.017,
            center_of_mass_m: 5e-3,
            ea: 0.5,
            found: FoundMismatch {
                drum: 3e-3,
                zero: 7e-3,
                noise: 3e-3,
                homing_m: 5e-4,
                force: 4e-3,
                moment_m: 8e-4,
                session: 0,
            },
            ..Self::as_built()
        }
    }

    /// [`Self::as_found`] before its winches and cells were calibrated.
    #[must_use]
    pub(crate) const fn as_delivered() -> Self {
        let mut out = Self::as_found();
        out.sensor_gain = 0.17;
        out.found.drum = 0.02;
        out.found.zero = 0.05;
        out
    }

    /// A machine by its name, as [`Self::parse`] reads it.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::parse(name).ok()
    }

    /// A kind of machine: `exact`, `realistic`, `as-built`, `as-found`, `as-delivered` or
    /// `after-hours`.
    fn kind(name: &str) -> Option<Self> {
        match name {
            "exact" => Some(Self::default()),
            "realistic" => Some(Self::realistic()),
            "as-built" => Some(Self::as_built()),
            "as-found" => Some(Self::as_found()),
            "as-delivered" => Some(Self::as_delivered()),
            "after-hours" => Some(Self::after_hours()),
            _ => None,
        }
    }

    /// The same machine in another session.
    #[must_use]
    pub const fn in_session(mut self, session: u64) -> Self {
        self.found.session = session;
        self
    }

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
            found: FoundMismatch {
                drum: 0.0,
                zero: 0.0,
                noise: 0.0,
                homing_m: 0.0,
                force: 0.0,
                moment_m: 0.0,
                session: 0,
            },
            hours: None,
        }
    }
}

/// Distance over which a force that no model has is new, m: poses of a calibration are farther apart.
const UNMODELLED_M: f64 = 0.15;

/// Time that drives take to enter a mode, s.
const RMDS_MODE_S: f64 = 0.5;
const CIA402_MODE_S: f64 = 0.02;
/// Viscous friction is not a key of the robot file: Coulomb friction dominates these drums.
const VISCOUS_FRICTION_NS_PER_M: f64 = 0.0;
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
    let found = &mismatch.found;
    for (index, cable) in robot.cables.iter().enumerate() {
        cables.push(cable_params(cable, mismatch, &mut draws));
        if let Some(winch) = robot.winch_of(index) {
            winches.push(winch_params(winch, mismatch, &mut draws));
        }
    }
    found_winches(&mut winches, found, seed);
    let weight_n = robot.platform.mass_kg * mcdpr_kinematics::GRAVITY_MPS2;
    let mut params = PlantParams {
        platform: platform_params(robot, mismatch, &mut draws),
        cables,
        winches,
        unmodelled: UnmodelledParams {
            force_n: found.force * weight_n,
            moment_nm: found.moment_m * weight_n,
            distance_m: UNMODELLED_M,
            seed: seed ^ 0x756e_6d6f,
        },
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
    };
    if let Some(hours) = &mismatch.hours {
        hours.change(&mut params, robot, seed);
    }
    params
}

/// What real winches have besides, by sequences of their own: machines without it are unchanged.
fn found_winches(winches: &mut [WinchParams], found: &FoundMismatch, seed: u64) {
    let mut drums = Random::new(seed ^ 0x6472_756d);
    let mut zeros = session_draws(found, seed, 0x7a65_726f);
    for winch in winches {
        winch.drum_radius_m *= 1.0 + found.drum * drums.normal();
        let sensor = &mut winch.sensor;
        let range_n = sensor.max_n / SENSOR_OVERLOAD;
        sensor.zero_v += found.zero * range_n / sensor.gain_n_per_v * zeros.normal();
        sensor.noise_n = sensor.noise_n.max(found.noise * range_n);
    }
}

/// Draws that are new in every session.
fn session_draws(found: &FoundMismatch, seed: u64, what: u64) -> Random {
    Random::new(seed ^ what ^ found.session.wrapping_mul(0x9e37_79b9_7f4a_7c15))
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
            holding_n: winch.brake_holding_n,
            play_m: winch.brake_play_m,
        },
        drive: drive_params(winch, mismatch, draws),
        sensor: TensionSensorParams {
            gain_n_per_v: winch.tension_gain_n_per_v * (1.0 + draws.within(mismatch.sensor_gain)),
            zero_v: winch.tension_zero_v,
            noise_n: SENSOR_NOISE_N,
            max_n: winch.tension_max_n * SENSOR_OVERLOAD,
            drift: SensorDrift::default(),
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
        cogging_per_turn: gear.cogging_per_turn,
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
    let held = model.holding().by_tension();
    // Nobody brings a robot home exactly: each length is off by as much as its platform.
    let mut homing = session_draws(&mismatch.found, seed, 0x686f_6d65);
    let off_m = Vector3::from_fn(|_, _| mismatch.found.homing_m * homing.normal());
    let pose = &rest.equilibrium.pose.displaced(&off_m, &Vector3::zeros());
    hang(params, pose, rest.tensions_n(), held, seed)
        .map_err(|error| RunError::Client(plant_failed(error).into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn params(mismatch: Mismatch, seed: u64) -> PlantParams {
        plant_params(
            &Robot::built_in("paper-optimistic").unwrap(),
            &mismatch,
            seed,
        )
    }

    #[test]
    fn each_drum_of_a_machine_as_found_has_a_radius_of_its_own() {
        let described = params(Mismatch::default(), 1).winches[0].drum_radius_m;
        let mut squares = 0.0;
        for seed in 1..=50 {
            let found = params(Mismatch::as_found(), seed);
            let off = |i: usize| found.winches[i].drum_radius_m / described - 1.0;
            assert!(
                (0..3).all(|i| (off(i) - off(i + 1)).abs() > 1e-6),
                "seed {seed}"
            );
            squares += (0..4).map(|i| off(i).powi(2)).sum::<f64>();
        }
        // 200 draws: the root mean square scatters by a twentieth.
        let rms = (squares / 200.0).sqrt();
        assert!((rms / 3e-3 - 1.0).abs() < 0.2, "{rms}");
    }

    #[test]
    fn a_new_session_changes_the_zeros_of_the_cells_and_nothing_else() {
        let one = params(Mismatch::as_found(), 5);
        let mut other = params(Mismatch::as_found().in_session(1), 5);
        for (a, b) in one.winches.iter().zip(&mut other.winches) {
            let apart_n = (a.sensor.zero_v - b.sensor.zero_v) * a.sensor.gain_n_per_v;
            assert!(apart_n != 0.0 && apart_n.abs() < 2.0, "{apart_n}");
            b.sensor.zero_v = a.sensor.zero_v;
        }
        assert_eq!(one, other);
    }

    #[test]
    fn what_real_machines_have_besides_leaves_other_machines_as_they_were() {
        for kind in ["exact", "realistic", "as-built"] {
            let mismatch = Mismatch::named(kind).unwrap();
            let plant = params(mismatch, 3);
            assert_eq!(plant.unmodelled.force_n, 0.0, "{kind}");
            assert_eq!(plant, params(mismatch.in_session(7), 3), "{kind}");
        }
        assert!(Mismatch::named("as found").is_none());
    }
}
