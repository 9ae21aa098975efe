//! Rigid transformations one after the other, and undone.

use mcdpr_kinematics::Pose;

/// The pose that undoes a pose: frame b from frame a, given a from b.
#[must_use]
pub fn inverse(pose: &Pose) -> Pose {
    let rotation = pose.rotation.inverse();
    Pose::new(-(rotation * pose.position_m), rotation)
}

/// a from c, given a from b and b from c.
#[must_use]
pub fn compose(a_from_b: &Pose, b_from_c: &Pose) -> Pose {
    Pose::new(
        a_from_b.transform(&b_from_c.position_m),
        a_from_b.rotation * b_from_c.rotation,
    )
}
