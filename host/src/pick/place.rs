//! Where the tray stands, where the robot looks at it from, and where it releases.

use super::PickError;
use crate::robot::Robot;
use mcdpr_simulator::camera::Tray;
use nalgebra::{Isometry3, Vector3};

/// Height of the camera over the tray when it looks, m.
const LOOK_HEIGHT_M: f64 = 0.4;
/// Beside the tray of the paper's frame, world, m: at the paper's position, 25 mm from its wall, an
/// object that hangs to one side of the jaws falls back into the tray.
const PAPER_FRAME_RELEASE_M: [f64; 3] = [0.335, 0.14, -0.51];
/// From the middle of the tray's floor, for other frames: 50 mm beside it, because a hanging platform tilts
/// more the farther it is from the middle.
const RELEASE_FROM_TRAY_M: [f64; 3] = [0.02, 0.155, 0.035];
/// The tool rises a little above the place to look from: room below the top of its box, m.
const UNDER_TOP_M: f64 = 0.01;
/// An object that is released must fall beside the tray: least distance from its inside, m.
const BESIDE_M: f64 = 0.035;

/// The workcell's positions, world, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Places {
    /// Middle of the tray's floor.
    pub tray_m: Vector3<f64>,
    /// Where the tool hangs when the camera looks at the tray.
    pub look_m: Vector3<f64>,
    /// Where objects are released.
    pub release_m: Vector3<f64>,
}

impl Places {
    /// Those of the robot file; what it does not give follows from the robot.
    ///
    /// # Errors
    /// [`PickError::NoRoom`] if an object would be released into the tray.
    pub(crate) fn of(robot: &Robot) -> Result<Self, PickError> {
        let given = robot.surroundings;
        let tray_m = given.tray_m.unwrap_or_else(|| default_tray_m(robot));
        let release_m = given
            .release_m
            .unwrap_or_else(|| default_release_m(robot, &tray_m));
        let half_m = Tray::default().half_m;
        let away = release_m - tray_m;
        if away.x.abs() < half_m[0] + BESIDE_M && away.y.abs() < half_m[1] + BESIDE_M {
            return Err(PickError::NoRoom {
                tray_mm: (tray_m * 1e3).into(),
                release_mm: (release_m * 1e3).into(),
                half_mm: half_m.map(|half| (half + BESIDE_M) * 1e3),
            });
        }
        Ok(Self {
            tray_m,
            look_m: look_m(robot, &tray_m),
            release_m,
        })
    }

    /// The tray, without objects and without tags.
    pub(crate) fn tray(&self) -> Tray {
        Tray {
            center_m: self.tray_m.into(),
            ..Tray::default()
        }
    }
}

/// Where the tool hangs when the camera is over the middle of a tray.
fn look_m(robot: &Robot, tray_m: &Vector3<f64>) -> Vector3<f64> {
    // The camera looks down beside the tool: it must see the tray's middle.
    let to_camera = Isometry3::from(robot.camera.camera_from_platform)
        .inverse()
        .translation
        .vector;
    let tool = robot.tool.tcp_in_platform_m;
    Vector3::new(
        tray_m.x - to_camera.x,
        tray_m.y - to_camera.y,
        tray_m.z + LOOK_HEIGHT_M - to_camera.z + tool.z,
    )
}

/// In a robot of the paper's frame, the tray stands around the paper's grasp point. In another it stands
/// below home, so far that the camera sees all of it from there; no lower than the tool may go, and no
/// higher than the tool can look at it.
fn default_tray_m(robot: &Robot) -> Vector3<f64> {
    let home_m = robot.tool.home_in_world_m;
    let papers_m = Vector3::from(Tray::default().center_m);
    let looks_m = |z: f64| look_m(robot, &Vector3::new(home_m.x, home_m.y, z)).z - z;
    let below_home_m = home_m.z - looks_m(home_m.z);
    let Some([low, high]) = robot.limits.box_in_world_m else {
        return Vector3::new(home_m.x, home_m.y, below_home_m);
    };
    let inside = |point: Vector3<f64>| point >= low && point <= high;
    if inside(papers_m) && inside(look_m(robot, &papers_m)) {
        return papers_m;
    }
    let highest_m = high.z - looks_m(high.z) - UNDER_TOP_M;
    let z = below_home_m.min(highest_m).max(low.z);
    Vector3::new(home_m.x, home_m.y, z)
}

fn default_release_m(robot: &Robot, tray_m: &Vector3<f64>) -> Vector3<f64> {
    if *tray_m == Vector3::from(Tray::default().center_m) {
        return PAPER_FRAME_RELEASE_M.into();
    }
    let wanted = tray_m + Vector3::from(RELEASE_FROM_TRAY_M);
    match robot.limits.box_in_world_m {
        Some([low, high]) => wanted.sup(&low).inf(&high),
        None => wanted,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_frame_keeps_its_tray_and_others_have_it_below_home() {
        let robot = Robot::built_in("lab-fast").unwrap();
        let places = Places::of(&robot).unwrap();
        assert_eq!(places.tray_m, Vector3::new(0.315, -0.03, -0.545));
        assert_eq!(places.release_m, Vector3::new(0.335, 0.14, -0.51));
        let eight = Robot::built_in("eight-cable").unwrap();
        let places = Places::of(&eight).unwrap();
        let [low, high] = eight.limits.box_in_world_m.unwrap();
        for at in [places.tray_m, places.look_m, places.release_m] {
            assert!(at >= low && at <= high, "{at}");
        }
        let home_m = eight.tool.home_in_world_m;
        assert_eq!(places.tray_m.xy(), home_m.xy());
        assert!(places.tray_m.z < home_m.z - 0.25, "{}", places.tray_m);
    }

    #[test]
    fn given_places_are_kept_and_a_release_into_the_tray_is_refused() {
        let mut robot = Robot::built_in("eight-cable").unwrap();
        robot.surroundings.tray_m = Some(Vector3::new(0.1, 0.2, 0.5));
        let places = Places::of(&robot).unwrap();
        assert_eq!(places.tray_m, Vector3::new(0.1, 0.2, 0.5));
        let beside_m = Vector3::new(0.12, 0.355, 0.535);
        assert!(
            (places.release_m - beside_m).norm() < 1e-9,
            "{}",
            places.release_m
        );
        robot.surroundings.release_m = Some(Vector3::new(0.2, 0.25, 0.6));
        let error = Places::of(&robot).unwrap_err();
        assert!(matches!(error, PickError::NoRoom { .. }), "{error}");
    }
}
