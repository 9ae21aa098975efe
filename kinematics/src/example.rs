//! The four-cable robot of the paper with the calibrated anchors of its Table 5, as the crate's
//! tests and examples use it. Mass, centre of mass, inertia and pulley radius are assumptions.

use nalgebra::Vector3;

use crate::robot::{Cable, Platform, Robot};

/// The tool centre point of the example robot, platform frame, m.
pub const EXAMPLE_TOOL_M: [f64; 3] = [0.0, 0.0, -0.08];

/// The example robot: 1.4 kg, pulleys of 10 mm with vertical swivel axes.
///
/// # Panics
/// Never: the numbers are constant and valid.
#[allow(clippy::missing_panics_doc, clippy::expect_used)]
pub fn four_cables() -> Robot<4> {
    let anchors = [
        [25.102, -370.603, 24.1],
        [40.201, 384.903, 24.2],
        [644.503, 370.101, 24.5],
        [629.502, -385.401, 23.9],
    ];
    let attachments = [
        [-45.0, -65.0, 0.0],
        [-45.0, 65.0, 0.0],
        [45.0, 65.0, 0.0],
        [45.0, -65.0, 0.0],
    ];
    let cables = core::array::from_fn(|i| Cable {
        anchor_m: Vector3::from(anchors[i]) * 1e-3,
        swivel_axis: Vector3::z(),
        pulley_radius_m: 0.01,
        attachment_m: Vector3::from(attachments[i]) * 1e-3,
    });
    Robot::new(cables, example_platform()).expect("constant and valid")
}

/// The platform of the example robot.
pub fn example_platform() -> Platform {
    let mass_kg = 1.4;
    Platform {
        mass_kg,
        center_of_mass_m: Vector3::new(0.0, 0.0, -0.03),
        inertia_kg_m2: Some(Platform::box_inertia(
            mass_kg,
            Vector3::new(0.13, 0.18, 0.04),
        )),
    }
}

/// An eight-cable robot with six degrees of freedom: a 2 m x 2 m x 1.5 m frame, crossed cables.
///
/// # Panics
/// Never: the numbers are constant and valid.
#[allow(clippy::missing_panics_doc, clippy::expect_used)]
pub fn eight_cables() -> Robot<8> {
    let mut platform = example_platform();
    platform.mass_kg = 4.0;
    platform.center_of_mass_m = Vector3::new(0.002, -0.001, -0.01);
    platform.inertia_kg_m2 = Some(Platform::box_inertia(4.0, Vector3::new(0.3, 0.3, 0.2)));
    let cables = core::array::from_fn(|i| {
        let top = i < 4;
        let (sx, sy) = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)][i % 4];
        // Upper cables go to the platform's lower corners and are swapped in y, lower ones to
        // the upper corners and swapped in x: the crossing is what resists rotation.
        let attachment = if top {
            Vector3::new(0.15 * sx, -0.12 * sy, -0.1)
        } else {
            Vector3::new(-0.12 * sx, 0.15 * sy, 0.1)
        };
        Cable {
            anchor_m: Vector3::new(sx, sy, if top { 1.5 } else { 0.0 }),
            swivel_axis: Vector3::z() * if top { 1.0 } else { -1.0 },
            pulley_radius_m: 0.025,
            attachment_m: attachment,
        }
    });
    Robot::new(cables, platform).expect("constant and valid")
}
