//! Parameters of the plant: plain numbers in SI, one struct per physical part.

use super::sensors::ADC_REFERENCE_V;
use super::slow::SlowParams;

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
    /// Speed limit of the motor (rpm): no torque accelerates it beyond.
    pub max_motor_rpm: f64,
    /// Current limit (A).
    pub max_current_a: f64,
    /// Coulomb friction of the drum and the parts that turn with it, as a force at the cable (N);
    /// without [`Self::gear`], of the whole winch.
    pub friction_n: f64,
    /// Viscous friction, as a force at the cable per cable speed (N s/m).
    pub viscous_friction_ns_per_m: f64,
    /// Drum inertia as an equivalent mass at the cable (kg).
    pub drum_mass_kg: f64,
    /// The gear between motor and drum; without one, both turn as one body without loss.
    pub gear: Option<GearParams>,
    /// How far the drum is out of its axis (m).
    pub eccentricity_m: f64,
    /// Angle of the drum at displacement 0 (rad): at 0 the cable leaves the side that is farthest
    /// out.
    pub eccentric_rad: f64,
    /// Brake.
    pub brake: BrakeParams,
    /// Drive electronics.
    pub drive: DriveParams,
    /// Tension sensor.
    pub sensor: TensionSensorParams,
}

/// A real gear: friction, loss, play and twist between motor and drum.
///
/// Typical data sheets: planetary gearheads of 16 to 32 mm lose 10 to 20 % per stage at their rated
/// torque (70 % remain behind 43:1 on Faulhaber's page about its gearheads; Citizen Micro assumes
/// 81 % per stage, and much less at small torques).
#[derive(Debug, Clone, PartialEq)]
pub struct GearParams {
    /// Coulomb friction of the rotor: bearings, brushes (N m, at the motor).
    pub rotor_friction_nm: f64,
    /// Coulomb friction of the gear without load (N m, at the motor).
    pub gear_friction_nm: f64,
    /// Friction at rest over Coulomb friction, 1 or more.
    pub static_friction: f64,
    /// Speed of the motor over which friction falls from rest to Coulomb friction (rpm).
    pub stribeck_rpm: f64,
    /// Viscous friction of rotor and gear (N m/rpm, at the motor).
    pub viscous_nm_per_rpm: f64,
    /// Share of the motor's power that reaches the drum, above 0 to 1.
    pub efficiency_driving: f64,
    /// Share of the drum's power that reaches the motor, 0 to 1; a gear with 0 locks itself.
    pub efficiency_driven: f64,
    /// Play, as a turn of the drum (rad).
    pub play_rad: f64,
    /// Torque per twist of gear and coupling, at the drum (N m/rad).
    pub stiffness_nm_per_rad: f64,
    /// Cogging torque of the motor, amplitude (N m).
    pub cogging_nm: f64,
    /// Periods of the cogging torque per turn of the motor.
    pub cogging_per_turn: u16,
    /// Friction of a cold gear over that of a warm one, 1 or more.
    pub cold_friction: f64,
    /// Time of turning in which this difference falls to about a third (s).
    pub warming_s: f64,
}

impl Default for GearParams {
    /// A gear without friction, loss or play, on a shaft of 400 N m/rad.
    fn default() -> Self {
        Self {
            rotor_friction_nm: 0.0,
            gear_friction_nm: 0.0,
            static_friction: 1.0,
            stribeck_rpm: 100.0,
            viscous_nm_per_rpm: 0.0,
            efficiency_driving: 1.0,
            efficiency_driven: 1.0,
            play_rad: 0.0,
            stiffness_nm_per_rad: 400.0,
            cogging_nm: 0.0,
            cogging_per_turn: 12,
            cold_friction: 1.0,
            warming_s: 300.0,
        }
    }
}

/// A spring-applied brake on the drum.
#[derive(Debug, Clone, PartialEq)]
pub struct BrakeParams {
    /// From the command until it holds (s).
    pub close_delay_s: f64,
    /// From the command until it is free (s).
    pub open_delay_s: f64,
    /// Force at the cable above which it slips (N); a slipping brake keeps this friction.
    pub holding_n: f64,
    /// How far the drum turns in the closed brake, at the cable (m). A brake's rotor sits on a toothed
    /// hub with backlash, which grows with every start and stop (operating instructions of Kendrion's
    /// INTORQ BFK557, "wear of spring-applied brakes"); a belt between brake and drum adds its own.
    pub play_m: f64,
}

/// A servo drive similar to the RoboModule RMDS (an inference from the paper's text).
#[derive(Debug, Clone, PartialEq)]
pub struct DriveParams {
    /// Bandwidth of the position loop (rad/s). The speed loop inside it runs at four times this;
    /// the current loop's lag is taken to be part of these figures.
    pub position_bandwidth_rad_s: f64,
    /// Largest acceleration the position and speed modes ask for, at the cable (m/s^2).
    pub max_acceleration_mps2: f64,
    /// Mass at the cable, beyond drum and rotor, that the loops are tuned for (kg).
    pub tuned_load_kg: f64,
    /// Time constant of the current under the position and speed loops (s); 0: part of their
    /// bandwidth.
    pub inner_lag_s: f64,
    /// Time constant of the current in current mode (s).
    pub current_lag_s: f64,
    /// Step of the current command (A).
    pub current_quantum_a: f64,
    /// From a reset until the drive answers (s).
    pub reset_time_s: f64,
    /// From the choice of a mode until it is active (s).
    pub mode_time_s: f64,
    /// Time for which the rail's capacitors keep the drive after the supply failed (s).
    pub hold_up_s: f64,
    /// Its protocol.
    pub protocol: Protocol,
    /// Its number on the bus; none: the winch's own number, from 1.
    pub node: Option<u8>,
}

/// Protocol of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Protocol {
    /// RoboModule RMDS.
    #[default]
    Rmds,
    /// CiA 402 over CANopen.
    Cia402,
}

impl DriveParams {
    /// Its number on the bus, for the winch with this index (from 0).
    #[must_use]
    pub(crate) fn node_of(&self, index: usize) -> u8 {
        let own = u8::try_from(index + 1).unwrap_or(u8::MAX);
        self.node.unwrap_or(own)
    }
}

/// A tension sensor at the winch, `tension = gain (voltage - zero)`, and its converter.
///
/// The reading is the sum of 16 conversions of 12 bits, 0..=65520, so
/// `voltage = reading / 65536 * 3.3`.
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
    /// How its zero drifts.
    pub drift: SensorDrift,
}

impl TensionSensorParams {
    /// Tension at which the converter's input is at its upper end (N).
    ///
    /// ```
    /// let sensor = mcdpr_simulator::plant::WinchParams::default().sensor;
    /// assert!((sensor.range_n() - 39.13).abs() < 0.01); // 12.77 N/V (3.3 - 0.2355) V
    /// ```
    #[must_use]
    pub fn range_n(&self) -> f64 {
        self.gain_n_per_v * (ADC_REFERENCE_V - self.zero_v)
    }
}

/// Drift of a tension sensor's zero: half of it steady, half in waves of some hours.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SensorDrift {
    /// Steady part after eight hours (N).
    pub steady_n: f64,
    /// Amplitude of the waves, nine radians in eight hours (N).
    pub wave_n: f64,
    /// Where the waves begin (rad).
    pub phase_rad: f64,
}

impl SensorDrift {
    /// What the sensor shows without tension, some seconds after the start (N).
    #[must_use]
    pub fn zero_n(&self, seconds: f64) -> f64 {
        let hours = seconds / 28_800.0;
        let wave = libm::sin(9.0 * hours + self.phase_rad) - libm::sin(self.phase_rad);
        self.steady_n * hours + self.wave_n * wave
    }
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

/// Force and moment on the platform that no model has, as a random function of its place.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct UnmodelledParams {
    /// Each component of the force, root mean square over the work space (N).
    pub force_n: f64,
    /// Each component of the moment about the centre of mass, root mean square (N m).
    pub moment_nm: f64,
    /// They are new after about this distance (m).
    pub distance_m: f64,
    /// Seed of the function.
    pub seed: u64,
}

/// Timing of the bus between board and drives.
#[derive(Debug, Clone, PartialEq)]
pub struct BusParams {
    /// Each drive gets one command and sends one feedback per period (s). The drives' slots are
    /// spread evenly over the period: drive `i` of `n` at `i / n` of it.
    pub period_s: f64,
    /// Transport time of a command or a feedback (s), less than the period.
    pub latency_s: f64,
    /// Bit rate that the drives are set to (bit/s).
    pub bitrate: u32,
}

/// All parameters of the plant. All fields SI, world frame with z up.
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
    /// What pulls at the platform beside its cables and its weight.
    pub unmodelled: UnmodelledParams,
    /// Acceleration of gravity, world frame (m/s^2).
    pub gravity_mps2: [f64; 3],
    /// Length of one integration step (s).
    pub step_s: f64,
    /// Whether cables run from the drums to the platform. If not, the platform lies on the floor
    /// and every drum turns freely: commissioning of a winch.
    pub cables_attached: bool,
    /// Whether the e-stop button cuts drive power and brake current by wire (as required).
    pub e_stop_cuts_power: bool,
    /// Creep and warmth; by default none.
    pub slow: SlowParams,
}

impl Default for WinchParams {
    /// The paper's winch with the assumptions of this project: 20 mm drum, 371.13:1, 0.1 kg
    /// equivalent drum, 0.5 N friction. Rotor inertia is 0: name the motor's to have it.
    fn default() -> Self {
        Self {
            drum_radius_m: 0.02,
            // One count is 2 pi 20 mm / 4096 = 31 um of cable.
            encoder_counts_per_turn: 4096.0,
            encoder_sign: 1,
            // 371.13 turns of the motor with 4096 counts each.
            motor_counts_per_drum_turn: 1_520_148.0,
            motor_sign: 1,
            gear_ratio: 371.13,
            rotor_inertia_kg_m2: 0.0,
            // At the cable 0.01 N m/A x 371.13 / 20 mm = 186 N per ampere.
            torque_constant_nm_per_a: 0.01,
            // 8000 rpm behind 371.13:1 on 20 mm are 45 mm/s of cable.
            max_motor_rpm: 8000.0,
            max_current_a: 1.0,
            friction_n: 0.5,
            viscous_friction_ns_per_m: 0.0,
            drum_mass_kg: 0.1,
            gear: None,
            eccentricity_m: 0.0,
            eccentric_rad: 0.0,
            brake: BrakeParams {
                close_delay_s: 0.03,
                open_delay_s: 0.03,
                holding_n: 150.0,
                play_m: 0.0,
            },
            drive: DriveParams {
                // 150 rad/s is a lag of 6.7 ms behind a moving set-point.
                position_bandwidth_rad_s: 150.0,
                hold_up_s: 0.0,
                max_acceleration_mps2: 5.0,
                tuned_load_kg: 1.5,
                inner_lag_s: 0.0,
                current_lag_s: 0.003,
                // 1 mA is 0.19 N at the cable.
                current_quantum_a: 0.001,
                reset_time_s: 0.5,
                mode_time_s: 0.5,
                protocol: Protocol::Rmds,
                node: None,
            },
            sensor: TensionSensorParams {
                // The converter's 3.3 V are (3.3 - 0.2355) x 12.77 = 39 N.
                gain_n_per_v: 12.77,
                zero_v: 0.2355,
                noise_n: 0.05,
                max_n: 60.0,
                drift: SensorDrift::default(),
            },
        }
    }
}

impl PlantParams {
    /// The paper's four-cable robot with the calibrated anchors of its Table 5; values that the
    /// paper does not give are assumptions (mass 1.4 kg, EA 50 kN, pulley radius 10 mm, 0.7 m of
    /// routing, no pulley loss).
    ///
    /// ```
    /// let robot = mcdpr_simulator::plant::PlantParams::paper_optimistic();
    /// assert_eq!(robot.cables.len(), 4);
    /// assert_eq!(robot.cables[0].anchor_m, [0.025102, -0.370603, 0.0241]);
    /// ```
    #[must_use]
    pub fn paper_optimistic() -> Self {
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
                // A cable of 1 m with 50 kN/m then has 10 N s/m.
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
                bitrate: 1_000_000,
            },
            unmodelled: UnmodelledParams::default(),
            gravity_mps2: [0.0, 0.0, -9.81],
            // Ten steps per control tick of 1 ms.
            step_s: 1e-4,
            cables_attached: true,
            e_stop_cuts_power: true,
            slow: SlowParams::default(),
        }
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
        self.drum_mass_kg + self.rotor_mass_kg()
    }

    /// Rotor inertia as a mass at the cable (kg).
    #[must_use]
    pub(crate) fn rotor_mass_kg(&self) -> f64 {
        self.rotor_inertia_kg_m2 * (self.gear_ratio / self.drum_radius_m).powi(2)
    }

    /// Mass at the cable of all parts that are rigidly connected to the motor (kg).
    #[must_use]
    pub(crate) fn mass_on_drive_kg(&self) -> f64 {
        if self.gear.is_some() {
            self.rotor_mass_kg()
        } else {
            self.effective_mass_kg()
        }
    }

    /// Stiffness of the shaft at the cable (N/m).
    #[must_use]
    pub(crate) fn shaft_stiffness_n_per_m(&self, gear: &GearParams) -> f64 {
        // F = k phi / r with phi = x / r: 400 N m/rad on 20 mm are 1 MN/m.
        gear.stiffness_nm_per_rad / (self.drum_radius_m * self.drum_radius_m)
    }

    /// Force at the cable per ampere (N/A): torque constant times gear over drum radius.
    #[must_use]
    pub fn force_per_ampere_n(&self) -> f64 {
        self.torque_constant_nm_per_a * self.gear_ratio / self.drum_radius_m
    }

    /// Force at the cable that the greatest current gives behind the losses of the gear (N).
    #[must_use]
    pub fn greatest_pull_n(&self) -> f64 {
        let kept = (self.gear.as_ref()).map_or(1.0, |gear| gear.efficiency_driving);
        self.force_per_ampere_n() * self.max_current_a * kept
    }

    /// Cable speed at the motor's speed limit (m/s).
    #[must_use]
    pub fn max_speed_mps(&self) -> f64 {
        self.max_motor_rpm * self.mps_per_rpm()
    }

    /// Cable speed per motor rpm (m/s).
    #[must_use]
    pub(crate) fn mps_per_rpm(&self) -> f64 {
        std::f64::consts::TAU * self.drum_radius_m / (60.0 * self.gear_ratio)
    }

    /// Cable per motor count (m).
    #[must_use]
    pub(crate) fn metres_per_motor_count(&self) -> f64 {
        std::f64::consts::TAU * self.drum_radius_m / self.motor_counts_per_drum_turn
    }

    /// Cable per encoder count (m).
    #[must_use]
    pub(crate) fn metres_per_encoder_count(&self) -> f64 {
        std::f64::consts::TAU * self.drum_radius_m / self.encoder_counts_per_turn
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
