//! Cables and balance of a rest at one pose, and how they change with the pose.

use super::layout::Layout;
use super::rows::vector;
use crate::robot::Robot;
use mcdpr_kinematics::{AnyRobot, Cable, CablePath, GRAVITY_MPS2, Platform, Pose};
use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3, Vector6};

/// The weight of a kilogram, N.
pub(super) const WEIGHT: Vector3<f64> = Vector3::new(0.0, 0.0, -GRAVITY_MPS2);

/// Mass (kg) and moment of mass (platform frame, kg m) of platform and payload by the states `x`.
fn masses(robot: &Robot, layout: Layout, x: &[f64]) -> (f64, Vector3<f64>) {
    let at = |k: usize| x.get(k).copied().unwrap_or(0.0);
    let platform = &robot.platform;
    let mass_kg = platform.mass_kg + at(layout.platform()) + at(layout.payload());
    let moment = platform.center_of_mass_m * platform.mass_kg
        + vector(x, layout.platform() + 1)
        + vector(x, layout.payload() + 1);
    (mass_kg, moment)
}

/// The robot with the anchors of the states `x`; `None` where they leave no valid geometry.
pub(super) fn geometry(robot: &Robot, layout: Layout, x: &[f64]) -> Option<AnyRobot> {
    let cables: Vec<Cable> = (robot.cables.iter().enumerate())
        .map(|(i, cable)| Cable {
            anchor_m: cable.anchor_in_world_m + vector(x, layout.anchor(i)),
            swivel_axis: cable.swivel_axis_in_world,
            pulley_radius_m: cable.pulley_radius_m,
            attachment_m: cable.attachment_in_platform_m,
        })
        .collect();
    let platform = Platform {
        mass_kg: robot.platform.mass_kg,
        center_of_mass_m: robot.platform.center_of_mass_m,
        inertia_kg_m2: None,
    };
    AnyRobot::new(&cables, platform).ok()
}

/// One cable at one pose, world.
pub(super) struct Leg {
    /// From anchor to attachment, m.
    pub(super) length_m: f64,
    /// From anchor to attachment.
    pub(super) direction: Vector3<f64>,
    /// Slopes of the direction by the place of the attachment, 1/m; by that of the anchor their negative.
    pub(super) bend_per_m: Matrix3<f64>,
    /// The attachment from the platform's origin, m.
    pub(super) arm_m: Vector3<f64>,
}

impl Leg {
    /// Slopes of the length by a shift and a turn of the platform.
    pub(super) fn length_by_pose(&self) -> [f64; 6] {
        self.wrench(&self.direction)
    }

    /// Force and moment of a pull (N) at the attachment.
    pub(super) fn wrench(&self, pull: &Vector3<f64>) -> [f64; 6] {
        let turn = self.arm_m.cross(pull);
        [pull.x, pull.y, pull.z, turn.x, turn.y, turn.z]
    }
}

/// Cables and balance at one pose. Frame: world; forces act on the platform, moments about its origin.
pub(super) struct Statics {
    pub(super) legs: Vec<Leg>,
    /// Force (N) and moment (N m) that nothing balances.
    pub(super) balance: Vector6<f64>,
    /// Slopes of the balance by a shift (m) and a turn (rad) of the platform.
    pub(super) by_pose: Matrix6<f64>,
}

impl Statics {
    /// `None` where a cable has no path.
    pub(super) fn at(
        robot: &Robot,
        geometry: &AnyRobot,
        layout: Layout,
        x: &[f64],
        pose: &Pose,
        tensions_n: &[f64],
    ) -> Option<Self> {
        let (mass_kg, moment_of_mass) = masses(robot, layout, x);
        let lever = pose.rotation * moment_of_mass;
        let mut force = WEIGHT * mass_kg;
        let mut moment = lever.cross(&WEIGHT);
        // Force by shift and turn, then moment by shift and turn. A turn about k moves a vector v by k x v.
        let mut slopes = [Matrix3::zeros(); 4];
        slopes[3] = crossed(&WEIGHT, &lever);
        let mut legs = Vec::with_capacity(robot.cables.len());
        let each = |i: usize, path: &CablePath, bend_per_m: &Matrix3<f64>| {
            let tension_n = tensions_n.get(i).copied().unwrap_or(0.0);
            let arm = path.attachment_m - pose.position_m;
            let pull = path.direction * -tension_n;
            force += pull;
            moment += arm.cross(&pull);
            let by_shift = bend_per_m * -tension_n;
            let by_turn = -(by_shift * arm.cross_matrix());
            slopes[0] += by_shift;
            slopes[1] += by_turn;
            slopes[2] += arm.cross_matrix() * by_shift;
            slopes[3] += arm.cross_matrix() * by_turn + crossed(&pull, &arm);
            legs.push(Leg {
                length_m: path.length_m,
                direction: path.direction,
                bend_per_m: *bend_per_m,
                arm_m: arm,
            });
        };
        geometry.each_path(pose, each).ok()?;
        let mut by_pose = Matrix6::zeros();
        for (index, part) in slopes.iter().enumerate() {
            let corner = (3 * (index / 2), 3 * (index % 2));
            by_pose
                .fixed_view_mut::<3, 3>(corner.0, corner.1)
                .copy_from(part);
        }
        Some(Self {
            legs,
            balance: Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z),
            by_pose,
        })
    }
}

/// Slopes by a turn of the moment of a force that keeps its direction while its arm turns: F x (arm x k) for each axis k.
fn crossed(force: &Vector3<f64>, arm: &Vector3<f64>) -> Matrix3<f64> {
    force.cross_matrix() * arm.cross_matrix()
}

/// The moment by the platform's (or payload's) moment of mass, N m per kg m: column `axis`, world.
pub(super) fn moment_by_mass(rotation: &Rotation3<f64>, axis: usize) -> Vector3<f64> {
    let by: Vector3<f64> = rotation.matrix().column(axis).into_owned();
    by.cross(&WEIGHT)
}
