//! The robot as the program uses it: SI units, every default filled in, checked.

mod winch;

pub(super) use winch::USUAL_COGGING_PER_TURN;
pub use winch::{DriveKind, Gear, Winch};

use crate::holding::Choice;
use mcdpr_kinematics::{AnyRobot, Pose};
use mcdpr_vision::Camera as Lens;
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// A complete, checked description of one robot.
///
/// Lengths in m, forces in N, masses in kg, times in s, angles in rad. Cable `i` of the file is
/// `cables[i - 1]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Robot {
    /// Name of the robot.
    pub name: String,
    /// The moving platform.
    pub platform: Platform,
    /// The cables, cable 1 first; 1 to 16 of them.
    pub cables: Vec<Cable>,
    /// The winches in the order of the file; see [`Cable::winch_index`].
    pub winches: Vec<Winch>,
    /// The boards, if the robot has several; none is one board for all cables.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub boards: Vec<Board>,
    /// The drives' bus.
    pub bus: Bus,
    /// The law of the tension-held cables.
    pub tension: TensionLaw,
    /// The tool.
    pub tool: Tool,
    /// The gripper.
    pub gripper: Gripper,
    /// The camera on the platform.
    pub camera: Camera,
    /// Inclinometer or inertial unit on the platform.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub imu: Option<Imu>,
    /// The tags in the scene.
    pub tags: Vec<Tag>,
    /// What lies around the robot.
    #[serde(skip_serializing_if = "Surroundings::is_default")]
    pub surroundings: Surroundings,
    /// Limits of a motion.
    pub limits: Limits,
    /// Where these values come from, if not from the robot file alone. Not part of the description.
    #[serde(skip)]
    pub calibrated: Option<Box<Calibrated>>,
    /// How the cables to hold by length were chosen, where the file leaves that to the program. Not
    /// part of the description.
    #[serde(skip)]
    pub chosen: Option<Choice>,
}

/// Pose of a rigid body of tags.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TagPlace {
    /// Number of the body.
    pub body: u32,
    /// world_from_body.
    pub world_from_body: Pose,
}

/// The origin of a calibrated robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibrated {
    /// The robot as its file describes it, with the tags that it was calibrated by.
    pub designed: Robot,
    /// Where each body of tags was found.
    pub places: Vec<TagPlace>,
    /// Seed of the simulated machine that was calibrated; `None` for a real one.
    pub simulated_seed: Option<u64>,
    /// Kind of that machine, as `--machine` names it; `None`: as built.
    pub simulated_machine: Option<String>,
    /// When, UTC, as in 20260301-120000.
    pub date: String,
    /// Predicted root mean square position error, m.
    pub predicted_error_m: Option<f64>,
    /// Paid-out length of each cable where the encoders were zeroed, m.
    pub home_lengths_m: Vec<f64>,
    /// True length per length that each encoder reported while the data were taken.
    pub drum_scales: Vec<f64>,
    /// Covariance of what was estimated, SI units, in the order of the file.
    pub covariance: Option<nalgebra::DMatrix<f64>>,
    /// What it left open, in the frame of the first body of tags: covariance of the errors in the order of
    /// `Errors` of the tube that a plan states.
    pub errors: Option<nalgebra::DMatrix<f64>>,
    /// The calibration file.
    pub file: std::path::PathBuf,
}

/// The moving platform; vectors in its own frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Platform {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass, m.
    pub center_of_mass_m: Vector3<f64>,
    /// Inertia tensor about the centre of mass, kg m2; symmetric, positive definite.
    pub inertia_kg_m2: Matrix3<f64>,
}

/// What the winch of a cable controls.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Control {
    /// The cable's length.
    Position,
    /// The cable's tension.
    Tension,
}

/// One cable with its last pulley.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cable {
    /// Point B where the cable enters the pulley, on the swivel axis; world frame, m.
    pub anchor_in_world_m: Vector3<f64>,
    /// Unit vector along the swivel axis: the cable's direction of travel at B; world frame.
    pub swivel_axis_in_world: Vector3<f64>,
    /// Pulley radius, m; 0 is a point anchor.
    pub pulley_radius_m: f64,
    /// Attachment A, platform's frame, m.
    pub attachment_in_platform_m: Vector3<f64>,
    /// The winch that drives the cable: index into [`Robot::winches`].
    pub winch_index: usize,
    /// What the winch holds.
    pub control: Control,
    /// Axial stiffness EA, N.
    pub ea_n: f64,
    /// Axial damping over stiffness, s.
    pub damping_time_s: f64,
    /// Cable between drum and B, m.
    pub routing_length_m: f64,
    /// Share of the tension lost at the pulleys, 0 to below 1.
    pub pulley_loss: f64,
}

/// One of several boards.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Board {
    /// The board's own number, hexadecimal; `None` takes any board, in the order of the lines.
    pub id: Option<String>,
    /// It has the fault line in common with the others.
    pub fault_line: bool,
    /// The cable on each of its channels: index into [`Robot::cables`], channel 1 first.
    pub cables: Vec<usize>,
}

/// The drives' bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Bus {
    /// Bit rate, bit/s.
    pub bitrate: u32,
    /// Time between two commands to the same drive, us; whole milliseconds.
    pub period_us: u32,
    /// The same for drives of tension-held cables, µs.
    pub tension_period_us: u32,
}

/// Which law holds the tension of a tension-held cable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum LawKind {
    /// The paper's Eq. 1.
    Pd,
    /// The project's own law: also feed-forward, integral and damping.
    Default,
}

/// Type of command that the law of the tension-held cables sends to the drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum TensionOutput {
    /// A current.
    Current,
    /// A speed.
    Velocity,
}

/// The law of the tension-held cables; gains give winch force at the cable.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TensionLaw {
    /// Set-point where the plan gives none, N.
    pub setpoint_n: f64,
    /// Which law.
    pub law: LawKind,
    /// Type of command to the drive. With a speed, gains are in mm/s per N.
    pub output: TensionOutput,
    /// Force per tension error, N/N.
    pub kp: f64,
    /// Force per rate of tension error, N s/N.
    pub kd: f64,
    /// Force per integral of tension error, N/(N s).
    pub ki: f64,
    /// Force against cable speed beyond the planned one, N s/m.
    pub damping_ns_per_m: f64,
    /// Corner of the low-pass on the measured tension, Hz.
    pub filter_hz: f64,
    /// Corner of the low-pass on the default law's speed, Hz; 0 is none.
    pub corner_hz: f64,
    /// Length at which the gains of a default law that commands a speed hold, m; a shorter cable gets
    /// less in proportion; 0: the same gains at any length.
    pub gain_length_m: f64,
    /// Whether the brakes close under torque while the robot holds.
    pub hold_braked: bool,
    /// Least tension that a plan may ask, N.
    pub floor_n: f64,
    /// Greatest tension that a plan may ask, N.
    pub ceiling_n: f64,
}

/// The tool.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Tool {
    /// Tool centre point, platform's frame, m.
    pub tcp_in_platform_m: Vector3<f64>,
    /// Where the tool hangs when the robot is switched on, world frame, m.
    pub home_in_world_m: Vector3<f64>,
}

/// Kind of gripper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum GripperKind {
    /// No gripper.
    None,
    /// One output: open or closed.
    Digital,
}

/// The gripper.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Gripper {
    /// Kind.
    pub kind: GripperKind,
    /// Greatest opening, m.
    pub stroke_m: f64,
    /// Time from open to closed, s.
    pub close_s: f64,
    /// Whether a switch reports that the fingers closed on nothing.
    pub switch: bool,
}

/// What lies around the robot, world frame, m. What is absent has a default that follows from the robot.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Surroundings {
    /// Where the simulated calibration target lies.
    pub target_m: Option<Vector3<f64>>,
    /// Middle of the floor of the tray that is picked from.
    pub tray_m: Option<Vector3<f64>>,
    /// Where objects are released.
    pub release_m: Option<Vector3<f64>>,
}

impl Surroundings {
    /// Whether nothing is given: such robots have the hash of their description without this section.
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// The canonical form of a transform, see [`Robot::content_hash`].
fn canonical<S: serde::Serializer>(pose: &Pose, serializer: S) -> Result<S::Ok, S::Error> {
    #[derive(Serialize)]
    struct Canonical<'a> {
        rotation: &'a Matrix3<f64>,
        translation_m: &'a Vector3<f64>,
    }
    let form = Canonical {
        rotation: pose.rotation.matrix(),
        translation_m: &pose.position_m,
    };
    form.serialize(serializer)
}

/// The canonical form of a camera's numbers, see [`Robot::content_hash`].
fn canonical_lens<S: serde::Serializer>(lens: &Lens, serializer: S) -> Result<S::Ok, S::Error> {
    #[derive(Serialize)]
    struct Canonical {
        width_px: usize,
        height_px: usize,
        fx_px: f64,
        fy_px: f64,
        cx_px: f64,
        cy_px: f64,
        distortion: [f64; 5],
    }
    let form = Canonical {
        width_px: lens.size_px[0],
        height_px: lens.size_px[1],
        fx_px: lens.focal_px[0],
        fy_px: lens.focal_px[1],
        cx_px: lens.center_px[0],
        cy_px: lens.center_px[1],
        distortion: lens.distortion,
    };
    form.serialize(serializer)
}

/// An inclinometer or inertial unit on the platform: it measures roll and pitch. How it is turned on the platform is
/// found by calibration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Imu {
    /// Standard deviation of a reading at rest, rad.
    pub noise_rad: f64,
    /// Speed of its serial port, bit/s.
    pub baud: u32,
}

/// The camera on the platform.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Camera {
    /// Picture size, focal lengths, principal point and distortion.
    #[serde(flatten, serialize_with = "canonical_lens")]
    pub lens: Lens,
    /// Whether the camera gives a depth picture.
    pub depth: bool,
    /// Maps platform coordinates to camera coordinates (x right, y down, z forward).
    #[serde(serialize_with = "canonical")]
    pub camera_from_platform: Pose,
}

/// A fiducial tag on a rigid body of the scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tag {
    /// Number that the tag encodes.
    pub id: u32,
    /// AprilTag family without the prefix "tag": `36h11`.
    pub family: String,
    /// Edge, m.
    pub size_m: f64,
    /// Rigid body that carries the tag.
    pub body: u32,
    /// Corners in the body's frame, in the detector's order, m.
    pub corners_in_body_m: [Vector3<f64>; 4],
}

/// Limits of a motion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Limits {
    /// Speed of the tool, m/s.
    pub speed_mps: f64,
    /// Acceleration of the tool along its path, m/s2.
    pub acceleration_mps2: f64,
    /// Jerk of the tool along its path, m/s3.
    pub jerk_mps3: f64,
    /// Least and greatest corner of the tool's box, world frame, m; `None`: no box.
    pub box_in_world_m: Option<[Vector3<f64>; 2]>,
    /// Least tension of any cable, N.
    pub tension_min_n: f64,
    /// Greatest tension of any cable, N.
    pub tension_max_n: f64,
    /// Greatest angle between the platform's z axis and the world's, rad.
    pub tilt_max_rad: f64,
}

impl Robot {
    /// The geometry for the solvers.
    ///
    /// # Errors
    /// What the geometry check finds; see [`AnyRobot::new`].
    pub(crate) fn geometry(&self) -> Result<AnyRobot, mcdpr_kinematics::Error> {
        let cables: Vec<_> = self
            .cables
            .iter()
            .map(|cable| mcdpr_kinematics::Cable {
                anchor_m: cable.anchor_in_world_m,
                swivel_axis: cable.swivel_axis_in_world,
                pulley_radius_m: cable.pulley_radius_m,
                attachment_m: cable.attachment_in_platform_m,
            })
            .collect();
        let platform = mcdpr_kinematics::Platform {
            mass_kg: self.platform.mass_kg,
            center_of_mass_m: self.platform.center_of_mass_m,
            inertia_kg_m2: Some(self.platform.inertia_kg_m2),
        };
        AnyRobot::new(&cables, platform)
    }

    /// The winch that drives cable `cable` (from 0), if there is such a cable.
    pub fn winch_of(&self, cable: usize) -> Option<&Winch> {
        self.winches.get(self.cables.get(cable)?.winch_index)
    }

    /// Box to search or draw in, world frame, m: the box of the limits where one is given, else
    /// the box of the anchors. A robot whose anchors all lie near one height hangs below them:
    /// its box reaches down by the diagonal of the anchors' rectangle.
    pub fn search_box_in_world_m(&self) -> [Vector3<f64>; 2] {
        if let Some(corners) = self.limits.box_in_world_m {
            return corners;
        }
        let [mut low, high] = self.anchor_box_in_world_m();
        let diagonal_m = libm::hypot(high.x - low.x, high.y - low.y);
        if high.z - low.z < 0.25 * diagonal_m {
            low.z = high.z - diagonal_m;
        }
        [low, high]
    }

    /// Lowest and highest corner of the box around the anchors, world frame, m.
    pub fn anchor_box_in_world_m(&self) -> [Vector3<f64>; 2] {
        anchor_box_in_world_m(&self.cables)
    }

    /// CRC-32 (ISO-HDLC, as in zip) of the description in a canonical form.
    ///
    /// Two files that describe the same robot (other comments, other order of keys, defaults
    /// written out) have the same hash; a change of any value changes it.
    pub fn content_hash(&self) -> u32 {
        // Field order is fixed by the types, and numbers are written in the shortest form that
        // reads back exactly, so equal robots give equal bytes. Writing to memory cannot fail, and
        // a checked robot holds no value that JSON lacks.
        let canonical = serde_json::to_vec(self).unwrap_or_default();
        mcdpr_protocol::frame::crc32(&canonical)
    }
}

/// Lowest and highest corner of the box around the cables' anchors, world frame, m.
pub(super) fn anchor_box_in_world_m(cables: &[Cable]) -> [Vector3<f64>; 2] {
    let anchors = cables.iter().map(|cable| cable.anchor_in_world_m);
    let none = [
        Vector3::repeat(f64::INFINITY),
        Vector3::repeat(f64::NEG_INFINITY),
    ];
    anchors.fold(none, |[low, high], anchor| {
        [low.inf(&anchor), high.sup(&anchor)]
    })
}
