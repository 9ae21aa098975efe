//! The keys of what sees: inclinometer, camera, tags.

use super::{POINT, key, positive};
use crate::robot::schema::Absent::{Follows, Numbers, Switch, Whole, Word};
use crate::robot::schema::Range::Finite;
use crate::robot::schema::{Kind, Section};

/// `[imu]`.
pub(crate) static IMU: Section = Section {
    title: "[imu]",
    keys: &[
        key(
            "kind",
            Kind::Word(&["serial", "none"]),
            Word("none"),
            "`serial`: lines of roll and pitch on a serial port of its own (`--imu PORT`)",
        ),
        positive(
            "noise_deg",
            0.05,
            "standard deviation of a reading at rest, degrees",
        ),
        key(
            "baud",
            Kind::Whole(1200, 4_000_000),
            Whole(115_200),
            "speed of its port, bit/s",
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
