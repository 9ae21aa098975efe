//! The key table itself: every section of the robot file with its keys.

mod sight;
mod winch;

use super::schema::{Absent, Key, Kind, Range, Section};
pub use sight::CAMERA;
pub(crate) use sight::{CAMERA_FROM_PLATFORM, IMU, TAG};
pub(crate) use winch::WINCH;

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
            "all_cables",
            Kind::Common(&CABLE),
            Follows("nothing in common"),
            "keys of [[cable]] for every cable that does not give its own",
        ),
        key(
            "winch",
            Kind::Tables(&WINCH),
            Follows("one winch of defaults per cable"),
            "one table per winch module",
        ),
        key(
            "all_winches",
            Kind::Common(&WINCH),
            Follows("nothing in common"),
            "keys of [[winch]] for every winch that does not give its own",
        ),
        key(
            "board",
            Kind::Tables(&BOARD),
            Follows("one board for all cables"),
            "one table per board, board 1 first, if the robot has several",
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
            "imu",
            Kind::Table(&IMU),
            Follows("no inclinometer"),
            "inclinometer or inertial unit on the platform",
        ),
        key(
            "tag",
            Kind::Tables(&TAG),
            Follows("no tags"),
            "one table per fiducial tag in the scene",
        ),
        key(
            "surroundings",
            Kind::Table(&SURROUNDINGS),
            Follows("all defaults"),
            "what lies around the robot",
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
            Kind::Word(&["position", "tension", "auto"]),
            Word("position"),
            "what the winch holds: the cable's length or its tension; auto: the program chooses, see below",
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
        key(
            "board",
            Kind::Whole(1, 8),
            Follows("the boards in order, as many cables on each"),
            "number of the [[board]] whose winch drives this cable, 1 for the first",
        ),
        key(
            "channel",
            Kind::Whole(1, 8),
            Follows("the board's channels in the order of its cables"),
            "the board's channel: winch 1 to 4 of the wiring guide",
        ),
    ],
};

/// `[[board]]`.
pub(crate) static BOARD: Section = Section {
    title: "[[board]]",
    keys: &[
        key(
            "id",
            Kind::Text,
            Follows("any board, in the order of the ports"),
            "the board's own number, as `mcdpr doctor` shows it, 24 hexadecimal digits",
        ),
        key(
            "channels",
            Kind::Whole(1, 8),
            Whole(4),
            "winches that the board drives",
        ),
        key(
            "fault_line",
            Kind::Switch,
            Switch(false),
            "the fault line of the wiring guide connects all boards; the same for each",
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
            Kind::Word(&["auto", "current", "velocity"]),
            Word("auto"),
            "what the law commands: a current, or a speed, with which the drive's own loop overcomes the friction of a gear; auto: a speed if a winch has a gear that rubs or loses torque",
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
        non_negative(
            "gain_length_mm",
            0.0,
            "cable length at which kp, kd and ki hold, with `output = \"velocity\"`; a shorter cable is stiffer and gets less in proportion; 0: the same gains at any length",
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

/// `[surroundings]`.
pub(crate) static SURROUNDINGS: Section = Section {
    title: "[surroundings]",
    keys: &[
        key(
            "target_mm",
            POINT,
            Follows(
                "on the floor between the middle of the anchors and home; the floor is at the lowest anchors where the tool's box is above them",
            ),
            "where the simulated calibration target lies, world frame, mm; a real one is found by the calibration",
        ),
        key(
            "tray_mm",
            POINT,
            Follows("below home; for the paper's frame (315, -30, -545)"),
            "middle of the floor of the tray that `mcdpr pick` empties, world frame, mm",
        ),
        key(
            "release_mm",
            POINT,
            Follows("beside the tray: (20, 155, 35) mm from it, within `box_mm`"),
            "where `mcdpr pick` releases, world frame, mm",
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
pub(crate) static SECTIONS: [&Section; 15] = [
    &ROBOT,
    &PLATFORM,
    &CABLE,
    &WINCH,
    &BOARD,
    &BUS,
    &TENSION,
    &TOOL,
    &GRIPPER,
    &CAMERA,
    &CAMERA_FROM_PLATFORM,
    &IMU,
    &TAG,
    &SURROUNDINGS,
    &LIMITS,
];
