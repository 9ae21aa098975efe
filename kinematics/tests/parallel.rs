//! The parallel workspace gives the serial one, cell by cell.

use mcdpr_kinematics::*;
use nalgebra::{Rotation3, Vector3};

#[test]
fn all_cores_give_the_same_verdicts() {
    let robot = four_cables();
    let grid = Grid {
        min_m: Vector3::new(0.0, -0.4, -0.5),
        max_m: Vector3::new(0.65, 0.4, -0.05),
        counts: [37, 41, 11],
    };
    let test = WorkspaceTest::Forces {
        rotation: Rotation3::identity(),
        limits: TensionLimits::uniform(2.0, 39.0),
    };
    let serial = robot.workspace(&grid, &test).unwrap();
    let parallel = robot.workspace_parallel(&grid, &test).unwrap();
    assert_eq!(serial, parallel);
    let feasible = serial.iter().filter(|v| v.is_feasible()).count();
    assert!(feasible > grid.len() / 4 && feasible < grid.len());
}
