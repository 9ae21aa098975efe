//! The paper's robot as designed, its space, and the tags on its floor.

use crate::data::{NominalRobot, Tag};
use crate::space::Space;
use mcdpr_kinematics::{Cable, Platform, Pose, Robot, four_cables};
use nalgebra::{Rotation3, Vector3};

/// What is on the floor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// One tag of 100 mm.
    Tag,
    /// A rigid board of 3 x 3 tags of 80 mm, 110 mm apart.
    Board,
    /// Three loose tags of 80 mm, each a separate body.
    Loose,
}

/// The paper's robot with nominal anchors (Table 5, theoretical values) and 1 kg.
#[must_use]
pub(crate) fn nominal_robot() -> NominalRobot {
    let anchors = [
        [25.0, -370.0],
        [40.0, 385.0],
        [645.0, 370.0],
        [630.0, -385.0],
    ];
    let cables = four_cables();
    NominalRobot {
        cables: cables
            .cables()
            .iter()
            .zip(anchors)
            .map(|(cable, [x, y])| Cable {
                anchor_m: Vector3::new(x, y, 24.0) * 1e-3,
                ..*cable
            })
            .collect(),
        anchor_half_tolerance_m: 5e-3,
        mass_kg: 1.0,
        center_of_mass_m: Vector3::new(0.0, 0.0, -0.03),
        home: 0,
        routing_m: vec![0.0; 4],
        compliance_per_n: 0.0,
        limits: None,
    }
}

pub(super) fn robot_of(nominal: &NominalRobot, anchors_off: &[Vector3<f64>]) -> Option<Robot<4>> {
    let cables: Vec<Cable> = nominal
        .cables
        .iter()
        .zip(anchors_off)
        .map(|(cable, off)| Cable {
            anchor_m: cable.anchor_m + off,
            ..*cable
        })
        .collect();
    let platform = Platform {
        mass_kg: nominal.mass_kg,
        center_of_mass_m: nominal.center_of_mass_m,
        inertia_kg_m2: None,
    };
    Robot::new(<[Cable; 4]>::try_from(cables).ok()?, platform).ok()
}

/// The tags of a target and the number of bodies.
#[must_use]
pub(crate) fn tags_of(target: Target) -> (Vec<Tag>, usize) {
    let square = |id: u32, size_m: f64, x: f64, y: f64, body: usize| {
        let h = size_m / 2.0;
        let corner = |sx: f64, sy: f64| Vector3::new(x + sx * h, y + sy * h, 0.0);
        Tag {
            id,
            size_m,
            body,
            corners_in_body_m: [
                corner(-1.0, -1.0),
                corner(1.0, -1.0),
                corner(1.0, 1.0),
                corner(-1.0, 1.0),
            ],
        }
    };
    match target {
        Target::Tag => (vec![square(0, 0.1, 0.0, 0.0, 0)], 1),
        Target::Board => {
            let at = |i: u32| (f64::from(i) - 1.0) * 0.11;
            let tags = (0..9).map(|i| square(i, 0.08, at(i / 3), at(i % 3), 0));
            (tags.collect(), 1)
        }
        Target::Loose => (
            (0..3)
                .map(|i| square(i, 0.08, 0.0, 0.0, i as usize))
                .collect(),
            3,
        ),
    }
}

/// The space of the paper's robot, which is the one that is simulated here: 25 degrees of tilt at
/// most, and tensions up to its sensors' 39 N.
pub(super) const PAPER_SPACE: Space = Space {
    middle_m: Vector3::new(0.335, 0.0, -0.295),
    half_m: Vector3::new(0.19, 0.19, 0.235),
    tension_n: [0.5, 39.0],
    held_n: [0.5, 28.0],
    tilt_max_rad: 25.0 * std::f64::consts::PI / 180.0,
};

/// Where the bodies of tags lie on the floor: world_from_body.
pub(super) fn places_of(target: Target) -> Vec<Pose> {
    // Tags lie face up: AprilTag's z axis points into the floor.
    let down = |x: f64, y: f64, yaw: f64| {
        Pose::new(
            Vector3::new(x, y, -0.7),
            Rotation3::from_euler_angles(std::f64::consts::PI, 0.0, yaw),
        )
    };
    match target {
        Target::Loose => vec![
            down(0.24, -0.05, 0.2),
            down(0.36, 0.08, 1.0),
            down(0.43, -0.06, -0.7),
        ],
        Target::Tag | Target::Board => vec![down(0.32, 0.0, 0.53)],
    }
}
