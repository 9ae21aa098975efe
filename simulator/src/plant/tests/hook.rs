//! A hook holds the platform where it was caught.

use super::*;

/// Pushes the hooked platform with `force_n`; returns the displacement of its origin after half a
/// second (m).
fn pushed(along: Option<[f64; 3]>, force_n: [f64; 3]) -> [f64; 3] {
    let mut plant = at_rest(PlantParams::paper_optimistic(), &off_centre(), 5.0);
    plant.hook([0.0; 3], along).expect("a direction");
    let before = plant.truth().expect("a path").pose.position_m;
    plant.set_load(force_n, [0.0; 3], [0.0; 3]).expect("finite");
    plant.advance(0.5).expect("no failure");
    let after = plant.truth().expect("a path").pose.position_m;
    vec3::sub(after, before)
}

#[test]
fn it_holds_in_every_direction_or_against_one() {
    for axis in 0..3 {
        let mut force = [0.0; 3];
        force[axis] = 3.0;
        let held = pushed(None, force)[axis];
        // 3 N on 127 kN/m, less the cables' share.
        assert!(held > 0.0 && held < 2.4e-5, "axis {axis}: {held} m");
        let mut along = [0.0; 3];
        along[axis] = 7.0;
        let against = pushed(Some(along), force)[axis];
        assert!(against.abs() < 2.4e-5, "axis {axis}: {against} m");
        let free = pushed(Some(vec3::scale(along, -1.0)), force)[axis];
        assert!(free > 2.0 * held, "axis {axis}: {free} m");
    }
}

#[test]
fn it_lets_go_and_a_direction_needs_a_length() {
    let mut plant = at_rest(PlantParams::paper_optimistic(), &off_centre(), 5.0);
    assert!(plant.hook([0.0; 3], Some([0.0; 3])).is_err());
    assert!(plant.hook([f64::NAN, 0.0, 0.0], None).is_err());
    plant.hook([0.0; 3], None).expect("caught");
    plant.unhook();
    plant
        .set_load([0.0, 2.0, 0.0], [0.0; 3], [0.0; 3])
        .expect("finite");
    let before = plant.truth().expect("a path").tool_position_m;
    plant.advance(0.5).expect("no failure");
    let after = plant.truth().expect("a path").tool_position_m;
    assert!(distance(before, after) > 1e-4);
}
