//! The key table itself: every section of the robot file with its keys.

use super::schema::{Absent, Key, Kind, Range, Section};

const fn key(name: &'static str, kind: Kind, absent: Absent, meaning: &'static str) -> Key {
    Key {
        name,
        kind,
        absent,
        meaning,
    }
}

use Absent::{Follows, Numbers, Required, Switch, Whole, Word};
use Range::{Finite, Fraction, NonNegative, Positive, Within};

/// Default of a positive number.
const fn positive(name: &'static str, absent: f64, meaning: &'static str) -> Key {
    key(
        name,
        Kind::Number(Positive),
        Absent::Number(absent),
        meaning,
    )
}

/// Default of a number that may be zero.
const fn non_negative(name: &'static str, absent: f64, meaning: &'static str) -> Key {
    key(
        name,
        Kind::Number(NonNegative),
        Absent::Number(absent),
        meaning,
    )
}

const POINT: Kind = Kind::List(&[3], Finite);

/// The whole file.
pub(crate) static ROBOT: Section = Section {
    title: "the robot file",
    keys: &[
        key(
            "name",
            Kind::Text,
            Required,
            "name of the robot, shown in every report",
        ),
        key(
            "platform",
            Kind::Table(&PLATFORM),
            Follows("all defaults"),
            "the moving platform",
        ),
        key(
            "cable",
            Kind::Tables(&CABLE),
            Required,
            "one table per cable, cable 1 first; 1 to 16",
        ),
        key(
            "winch",
            Kind::Tables(&WINCH),
            Follows("one winch of defaults per cable"),
            "one table per winch module",
        ),
        key(
            "bus",
            Kind::Table(&BUS),
            Follows("all defaults"),
            "the drives' bus",
        ),
        key(
            "tension",
            Kind::Table(&TENSION),
            Follows("all defaults"),
            "the law of the tension-held cables",
        ),
        key(
            "tool",
            Kind::Table(&TOOL),
            Follows("all defaults"),
            "the tool",
        ),
        key(
            "gripper",
            Kind::Table(&GRIPPER),
            Follows("no gripper"),
            "the gripper",
        ),
        key(
            "camera",
            Kind::Table(&CAMERA),
            Follows("all defaults"),
            "the camera on the platform",
        ),
        key(
            "tag",
            Kind::Tables(&TAG),
            Follows("no tags"),
            "one table per fiducial tag in the scene",
        ),
        key(
            "limits",
            Kind::Table(&LIMITS),
            Follows("all defaults"),
            "what a motion may not exceed",
        ),
    ],
};

/// `[platform]`.
pub(crate) static PLATFORM: Section = Section {
    title: "[platform]",
    keys: &[
        positive("mass_kg", 1.4, "mass with tool and gripper, kg"),
        key(
            "center_of_mass_mm",
            POINT,
            Numbers(&[0.0, 0.0, -30.0]),
            "centre of mass in the platform's frame, mm",
        ),
        key(
            "inertia_kg_m2",
            Kind::List(&[3, 6], Finite),
            Follows("a homogeneous box of 130 x 180 x 40 mm with this mass"),
            "inertia about the centre of mass, platform's axes: [xx, yy, zz] or [xx, yy, zz, xy, xz, yz] (tensor entries, signs included), kg m2",
        ),
    ],
};

/// `[[cable]]`.
pub(crate) static CABLE: Section = Section {
    title: "[[cable]]",
    keys: &[
        key(
            "anchor_mm",
            POINT,
            Required,
            "point B where the cable enters the last pulley (or its eyelet), world frame, mm",
        ),
        key(
            "swivel_axis",
            POINT,
            Numbers(&[0.0, 0.0, 1.0]),
            "direction in which the cable travels along the swivel axis when it reaches B; any length but 0",
        ),
        non_negative(
            "pulley_radius_mm",
            10.0,
            "radius of the swivelling pulley to the cable's centre, mm; 0 is a point anchor",
        ),
        key(
            "attachment_mm",
            POINT,
            Required,
            "attachment A on the platform, platform's frame, mm",
        ),
        key(
            "winch",
            Kind::Whole(1, 255),
            Follows("the cable's own number"),
            "id of the winch that drives this cable",
        ),
        key(
            "control",
            Kind::Word(&["position", "tension"]),
            Word("position"),
            "what the winch holds: the cable's length or its tension",
        ),
        positive("ea_n", 50_000.0, "axial stiffness EA of the cable, N"),
        non_negative(
            "damping_time_ms",
            0.2,
            "ratio of the cable's axial damping to its stiffness, ms",
        ),
        non_negative(
            "routing_length_mm",
            700.0,
            "cable between drum and B that stretches too, mm",
        ),
        key(
            "pulley_loss",
            Kind::Number(Fraction),
            Absent::Number(0.0),
            "share of the tension lost at the pulleys between winch and platform, 0 to below 1",
        ),
    ],
};

/// `[[winch]]`, and a winch module file (without `module`, `id` and `node`).
pub(crate) static WINCH: Section = Section {
    title: "[[winch]]",
    keys: &[
        key(
            "module",
            Kind::Text,
            Follows("no module file"),
            "winch module file, relative to this file's folder; keys written here override it",
        ),
        key(
            "id",
            Kind::Whole(1, 255),
            Follows("its place in the file, from 1"),
            "number of the winch, which `[[cable]] winch` names",
        ),
        positive(
            "drum_radius_mm",
            20.0,
            "drum radius to the cable's centre, mm",
        ),
        positive(
            "cable_diameter_mm",
            1.0,
            "cable diameter, the least pitch of the turns on the drum, mm",
        ),
        positive(
            "turns_max",
            12.0,
            "turns of cable that the drum takes in one layer",
        ),
        non_negative(
            "drum_inertia_kg_m2",
            4e-5,
            "inertia of the drum, screw and coupling about the drum's axis, kg m2",
        ),
        key(
            "encoder_counts_per_turn",
            Kind::Whole(4, 16_777_216),
            Whole(4096),
            "drum encoder counts per drum turn, all four edges",
        ),
        key(
            "encoder_sign",
            Kind::Whole(-1, 1),
            Whole(1),
            "1 if the drum encoder counts up while cable is paid out, -1 otherwise",
        ),
        key(
            "motor_counts_per_turn",
            Kind::Number(Finite),
            Follows("gear_ratio x 4096, rounded"),
            "motor encoder counts per DRUM turn; negative where they fall as cable is paid out",
        ),
        positive("gear_ratio", 371.13, "motor turns per drum turn"),
        positive(
            "max_motor_rpm",
            8000.0,
            "greatest motor speed, turns per minute",
        ),
        positive("max_current_a", 0.5, "greatest motor current, A"),
        positive(
            "torque_constant_nm_per_a",
            0.006,
            "motor torque per current, Nm/A",
        ),
        non_negative(
            "rotor_inertia_kg_m2",
            1e-7,
            "inertia of the motor's rotor about its own axis, kg m2",
        ),
        non_negative(
            "friction_n",
            0.5,
            "Coulomb friction of drum, screw and bearings, felt at the cable, N; of the whole winch where no other friction is named",
        ),
        non_negative(
            "rotor_friction_mnm",
            0.0,
            "Coulomb friction of the motor's rotor: bearings, brushes, mN m at the motor",
        ),
        non_negative(
            "gear_friction_mnm",
            0.0,
            "Coulomb friction of the gear without load, mN m at the motor",
        ),
        key(
            "static_friction",
            Kind::Number(Within(1.0, 5.0)),
            Absent::Number(1.0),
            "friction of rotor and gear at rest over their Coulomb friction, 1 to 5",
        ),
        positive(
            "stribeck_rpm",
            100.0,
            "motor speed over which friction falls from rest to Coulomb friction, rpm",
        ),
        non_negative(
            "viscous_mnm_per_krpm",
            0.0,
            "viscous friction of rotor and gear, mN m at the motor per 1000 rpm",
        ),
        key(
            "gear_efficiency",
            Kind::Number(Within(0.01, 1.0)),
            Absent::Number(1.0),
            "share of the motor's power that reaches the drum, without the friction above",
        ),
        key(
            "backdrive_efficiency",
            Kind::Number(Within(0.0, 1.0)),
            Follows("2 - 1 / gear_efficiency, or 0 where that is less"),
            "share of the drum's power that reaches the motor; 0 locks itself",
        ),
        key(
            "play_deg",
            Kind::Number(Within(0.0, 10.0)),
            Absent::Number(0.0),
            "play between motor and drum, as a turn of the drum, degrees",
        ),
        non_negative(
            "torsional_stiffness_nm_per_rad",
            0.0,
            "torque per twist between motor and drum, at the drum, N m/rad; 0: rigid, which takes no friction, loss or play of a gear",
        ),
        non_negative(
            "cogging_mnm",
            0.0,
            "cogging torque of the motor, amplitude, mN m",
        ),
        key(
            "cold_friction",
            Kind::Number(Within(1.0, 10.0)),
            Absent::Number(1.0),
            "friction of rotor and gear when they are cold over that when warm, 1 to 10; it warms up within 300 s of turning",
        ),
        non_negative(
            "drum_eccentricity_mm",
            0.0,
            "how far the drum is out of its axis, mm",
        ),
        positive(
            "brake_close_ms",
            30.0,
            "time from the command until the brake holds, ms",
        ),
        key(
            "brake_play_deg",
            Kind::Number(Within(0.0, 2.0)),
            Absent::Number(0.0),
            "how far the drum turns in its closed brake, degrees; `mcdpr commission` measures it",
        ),
        positive(
            "tension_gain_n_per_v",
            12.77,
            "k of tension = k (voltage - u_0), N/V",
        ),
        key(
            "tension_zero_v",
            Kind::Number(Within(0.0, 3.3)),
            Absent::Number(0.2355),
            "u_0 of tension = k (voltage - u_0), V",
        ),
        positive(
            "tension_max_n",
            39.13,
            "full scale of the tension sensor, N",
        ),
        key(
            "drive",
            Kind::Word(&["rmds", "cia402"]),
            Word("rmds"),
            "protocol of the motor drive",
        ),
        key(
            "node",
            Kind::Whole(1, 127),
            Follows("the winch's id"),
            "number of the drive on the bus; rmds takes 1 to 15, cia402 1 to 127",
        ),
        positive(
            "drive_bandwidth_rad_s",
            150.0,
            "bandwidth of the drive's position loop, rad/s",
        ),
        non_negative(
            "current_lag_ms",
            3.0,
            "time constant of the drive's current loop, ms",
        ),
    ],
};

/// `[bus]`.
pub(crate) static BUS: Section = Section {
    title: "[bus]",
    keys: &[
        key(
            "bitrate",
            Kind::Whole(125_000, 1_000_000),
            Whole(1_000_000),
            "bit rate: 125000, 250000, 500000 or 1000000 bit/s",
        ),
        key(
            "period_us",
            Kind::Whole(1000, 20_000),
            Follows("2000 at 1000000 bit/s, 4000 at 500000 and below"),
            "time between two commands to the same drive, us, whole milliseconds",
        ),
        key(
            "tension_period_us",
            Kind::Whole(1000, 20_000),
            Follows("period_us"),
            "the same for drives of tension-held cables, us; divides period_us",
        ),
    ],
};

/// `[tension]`.
pub static TENSION: Section = Section {
    title: "[tension]",
    keys: &[
        positive(
            "setpoint_n",
            10.0,
            "tension of a tension-held cable where the plan gives none, N",
        ),
        key(
            "law",
            Kind::Word(&["pd", "default"]),
            Word("default"),
            "`pd`: the paper's Eq. 1; `default`: with feed-forward, integral and damping",
        ),
        key(
            "output",
            Kind::Word(&["current", "velocity"]),
            Word("current"),
            "what the law commands: a current, or a speed, with which the drive's own loop overcomes the friction of a gear",
        ),
        non_negative(
            "kp",
            1.0,
            "winch force per tension error, N/N; with `output = \"velocity\"` cable speed per tension error, mm/s per N",
        ),
        non_negative(
            "kd",
            0.02,
            "winch force per rate of tension error, N s/N; with `output = \"velocity\"` mm/N",
        ),
        non_negative(
            "ki",
            2.0,
            "winch force per integral of tension error, N/(N s), or mm/s per N s; not used by `pd`",
        ),
        non_negative(
            "damping_ns_per_m",
            100.0,
            "winch force against cable speed beyond the planned one, N s/m; not used by `pd` nor with `output = \"velocity\"`",
        ),
        positive(
            "filter_hz",
            50.0,
            "corner of the low-pass on the measured tension, Hz",
        ),
        non_negative(
            "corner_hz",
            0.0,
            "corner of the low-pass on the default law's speed, with `output = \"velocity\"`, Hz; 0 switches it off",
        ),
        key(
            "hold_brakes",
            Kind::Word(&["open", "closed"]),
            Word("open"),
            "brakes while the robot holds: open, so that the law is at work, or closed under torque",
        ),
        non_negative(
            "floor_n",
            2.0,
            "least tension that a plan may ask of a tension-held cable, N",
        ),
        key(
            "ceiling_n",
            Kind::Number(Positive),
            Follows("0.9 x the tension_max_n of [limits]"),
            "greatest tension that a plan may ask of a tension-held cable, N",
        ),
    ],
};

/// `[tool]`.
pub static TOOL: Section = Section {
    title: "[tool]",
    keys: &[
        key(
            "tcp_mm",
            POINT,
            Numbers(&[0.0, 0.0, -80.0]),
            "tool centre point in the platform's frame, mm",
        ),
        key(
            "home_mm",
            POINT,
            Follows("middle of the anchors, a quarter of their diagonal below them"),
            "where the tool hangs when the robot is switched on, world frame, mm",
        ),
    ],
};

/// `[gripper]`.
pub static GRIPPER: Section = Section {
    title: "[gripper]",
    keys: &[
        key(
            "kind",
            Kind::Word(&["digital", "none"]),
            Word("none"),
            "`digital`: one output, open or closed",
        ),
        non_negative(
            "stroke_mm",
            60.0,
            "greatest opening between the fingers, mm",
        ),
        non_negative("close_ms", 300.0, "time from open to closed, ms"),
        key(
            "switch",
            Kind::Switch,
            Switch(false),
            "whether a switch reports that the fingers closed on nothing",
        ),
    ],
};

/// `[camera]`.
pub static CAMERA: Section = Section {
    title: "[camera]",
    keys: &[
        key(
            "width",
            Kind::Whole(16, 16_384),
            Whole(1280),
            "picture width, px",
        ),
        key(
            "height",
            Kind::Whole(16, 16_384),
            Whole(720),
            "picture height, px",
        ),
        positive("fx", 920.0, "focal length along the rows, px"),
        positive("fy", 920.0, "focal length along the columns, px"),
        key(
            "cx",
            Kind::Number(Finite),
            Follows("half the width"),
            "principal point, px from the left",
        ),
        key(
            "cy",
            Kind::Number(Finite),
            Follows("half the height"),
            "principal point, px from the top",
        ),
        key(
            "distortion",
            Kind::List(&[5], Finite),
            Numbers(&[0.0; 5]),
            "k1, k2, p1, p2, k3 (Brown, Conrady)",
        ),
        key(
            "depth",
            Kind::Switch,
            Switch(true),
            "whether the camera gives a depth picture",
        ),
        key(
            "camera_from_platform",
            Kind::Table(&CAMERA_FROM_PLATFORM),
            Follows("its own defaults"),
            "pose that maps platform coordinates to camera coordinates",
        ),
    ],
};

/// `camera_from_platform` of `[camera]`.
pub(crate) static CAMERA_FROM_PLATFORM: Section = Section {
    title: "camera_from_platform",
    keys: &[
        key(
            "position_mm",
            POINT,
            Numbers(&[22.1, 54.8, -7.5]),
            "the platform's origin in the camera's frame, mm",
        ),
        key(
            "attitude_deg",
            POINT,
            Numbers(&[180.0, 0.0, 90.0]),
            "[rx, ry, rz] of the platform's axes in the camera's frame, R = Rz Ry Rx, degrees",
        ),
    ],
};

/// `[[tag]]`.
pub(crate) static TAG: Section = Section {
    title: "[[tag]]",
    keys: &[
        key(
            "id",
            Kind::Whole(0, 1_000_000),
            Follows("its place in the file, from 0"),
            "number that the tag encodes",
        ),
        key(
            "family",
            Kind::Word(&["36h11", "25h9", "16h5", "standard41h12"]),
            Word("36h11"),
            "AprilTag family",
        ),
        positive(
            "size_mm",
            100.0,
            "edge of the square that the detector reports, mm",
        ),
        key(
            "body",
            Kind::Whole(0, 1_000_000),
            Follows("its place in the file, from 0"),
            "rigid body that carries the tag; tags of one board name the same body",
        ),
        key(
            "corners_in_body_mm",
            Kind::Rows(4, 3),
            Follows(
                "a square about the body's origin: [-s, -s, 0], [s, -s, 0], [s, s, 0], [-s, s, 0] with s = size_mm / 2",
            ),
            "the four corners in the body's frame, in the detector's order, mm",
        ),
    ],
};

/// `[limits]`.
pub static LIMITS: Section = Section {
    title: "[limits]",
    keys: &[
        key(
            "speed_mps",
            Kind::Number(Positive),
            Follows("the cable speed of the slowest winch at its greatest motor speed"),
            "speed of the tool, m/s; every winch's own limit holds besides",
        ),
        positive(
            "acceleration_mps2",
            0.2,
            "acceleration of the tool along its path, m/s2",
        ),
        positive("jerk_mps3", 2.0, "jerk of the tool along its path, m/s3"),
        key(
            "box_mm",
            Kind::Rows(2, 3),
            Follows("no box"),
            "box that the tool may not leave, [[x, y, z least], [x, y, z greatest]], world frame, mm",
        ),
        positive("tension_min_n", 1.0, "least tension of any cable, N"),
        key(
            "tension_max_n",
            Kind::Number(Positive),
            Follows("the smallest tension that a sensor can be trusted to show"),
            "greatest tension of any cable, N",
        ),
        key(
            "tilt_max_deg",
            Kind::Number(Within(0.0, 180.0)),
            Absent::Number(20.0),
            "greatest angle between the platform's z axis and the world's, degrees",
        ),
    ],
};

/// Every section of the file, the file itself first.
pub(crate) static SECTIONS: [&Section; 12] = [
    &ROBOT,
    &PLATFORM,
    &CABLE,
    &WINCH,
    &BUS,
    &TENSION,
    &TOOL,
    &GRIPPER,
    &CAMERA,
    &CAMERA_FROM_PLATFORM,
    &TAG,
    &LIMITS,
];
