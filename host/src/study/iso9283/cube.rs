//! The cube of ISO 9283:1998 (6.8): as large as the robot's limits allow, with the five test poses
//! on its diagonal plane. A robot in a vertical plane has a square in that plane instead, with the test poses on its
//! diagonals: such figures are not those of a cube.

use crate::motion::{Model, Plan, PlanError, Step, judge_place};
use nalgebra::Vector3;
use thiserror::Error;

/// Number of test poses.
pub const POSES: usize = 5;
/// Distance of a test pose from the end of its diagonal, as a share of the diagonal.
const INSET: f64 = 0.1;
/// Places for the cube's middle along each side of the box of the robot's limits.
const MIDDLES: usize = 7;
/// Least side that is worth a test, m.
const LEAST_SIDE_M: f64 = 0.02;
/// A side whose part along an axis is less than this needs no room there.
const ALONG: f64 = 1e-9;
/// Halvings of the side: the last one decides over less than a thousandth of the box.
const HALVINGS: usize = 10;

/// A cube in the work space, its sides along the world's axes; or a square in a robot's vertical plane, two of its sides
/// upright.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cube {
    /// Middle, world frame, m.
    pub middle_m: Vector3<f64>,
    /// Length of a side, m.
    pub side_m: f64,
    /// Of a square: unit normal of its plane, world.
    pub normal: Option<Vector3<f64>>,
}

/// Why there is no cube to test in.
#[derive(Debug, Error)]
pub enum CubeError {
    /// The robot cannot hang at the corners of any cube.
    #[error(
        "no cube of {:.0} mm or more fits into the work space; raise the limits of tension, tilt or \
         box in the robot file, or check its anchors with `mcdpr workspace`",
        LEAST_SIDE_M * 1e3
    )]
    None,
    /// The cycle through the poses breaks a limit.
    #[error(transparent)]
    Plan(#[from] PlanError),
}

impl Cube {
    /// The largest cube whose corners, middles of edges and middle the tool can rest at, and whose
    /// cycle of test poses keeps every limit on the way.
    ///
    /// # Errors
    /// [`CubeError`].
    pub fn largest(model: &Model) -> Result<Self, CubeError> {
        let [low, high] = model.robot().search_box_in_world_m();
        let normal = model.holding().freedom().normal();
        let home_m = model.robot().tool.home_in_world_m;
        let sides = sides(normal.as_ref());
        let size = high - low;
        let mut best: Option<Self> = None;
        let share = |index: usize| (index as f64 + 0.5) / MIDDLES as f64;
        for index in 0..MIDDLES.pow(3) {
            let places = Vector3::new(
                share(index % MIDDLES),
                share(index / MIDDLES % MIDDLES),
                share(index / MIDDLES.pow(2)),
            );
            let mut middle_m = low + size.component_mul(&places);
            if let Some(normal) = normal {
                middle_m -= normal * normal.dot(&(middle_m - home_m));
            }
            // The cube stays in the box: twice the distance to the nearest face that its sides point to.
            let rooms_m = (middle_m - low).inf(&(high - middle_m)) * 2.0;
            let reach = sides
                .iter()
                .fold(Vector3::zeros(), |sum: Vector3<f64>, side| sum + side.abs());
            let room_m = (0..3)
                .filter(|axis| reach[*axis] > ALONG)
                .map(|axis| rooms_m[axis] / reach[axis])
                .fold(f64::INFINITY, f64::min);
            let least_m = best.map_or(LEAST_SIDE_M, |cube| cube.side_m);
            let fits = |side_m| {
                let cube = Self {
                    middle_m,
                    side_m,
                    normal,
                };
                cube.can_rest(model)
            };
            // Only a larger cube than the best so far is worth the halvings.
            if room_m <= least_m || !fits(least_m) {
                continue;
            }
            let (mut inside_m, mut outside_m) = (least_m, room_m);
            if fits(room_m) {
                inside_m = room_m;
            } else {
                for _ in 0..HALVINGS {
                    let side_m = (inside_m + outside_m) / 2.0;
                    if fits(side_m) {
                        inside_m = side_m;
                    } else {
                        outside_m = side_m;
                    }
                }
            }
            if best.is_none_or(|cube| inside_m > cube.side_m) {
                best = Some(Self {
                    middle_m,
                    side_m: inside_m,
                    normal,
                });
            }
        }
        let mut cube = best.ok_or(CubeError::None)?;
        // On the way between two poses a limit may be nearer than at its ends.
        loop {
            match cube.cycle(model) {
                Ok(_) => return Ok(cube),
                Err(error) if cube.side_m * 0.9 < LEAST_SIDE_M => return Err(error.into()),
                Err(_) => cube.side_m *= 0.9,
            }
        }
    }

    /// What it is, in a word.
    #[must_use]
    pub(crate) const fn shape(&self) -> &'static str {
        match self.normal {
            Some(_) => "square in the robot's plane",
            None => "cube",
        }
    }

    /// The test poses P1 to P5: the middle, then 10 % of a diagonal inside of the four corners of
    /// the diagonal plane C1-C2-C7-C8, or of the square, world frame, m.
    #[must_use]
    pub(crate) fn poses_m(&self) -> [Vector3<f64>; POSES] {
        let corner = |x: f64, y: f64, z: f64| {
            let reach = self.side_m / 2.0 * (1.0 - 2.0 * INSET);
            self.middle_m + self.at(&Vector3::new(x, y, z)) * reach
        };
        [
            self.middle_m,
            corner(-1.0, -1.0, -1.0),
            corner(1.0, -1.0, -1.0),
            corner(1.0, 1.0, 1.0),
            corner(-1.0, 1.0, 1.0),
        ]
    }

    /// One cycle from P1 over P5, P4, P3, P2 back to P1 at the robot's greatest speed, judged.
    fn cycle(&self, model: &Model) -> Result<Plan, PlanError> {
        let poses_m = self.poses_m();
        let mut steps = Vec::new();
        for pair in ORDER.windows(2) {
            if let [from, to] = pair {
                steps.push(Step::Move {
                    path: crate::motion::path::Path::through(&[poses_m[*from], poses_m[*to]])?,
                    duration_s: None,
                    speed_mps: None,
                });
            }
        }
        Plan::new(model, &poses_m[0], &steps)
    }

    /// The cycles as the text of a task file: what a robot on a port is to drive while a tracker
    /// watches. The tool waits `wait_s` at each pose.
    #[must_use]
    pub(crate) fn task_text(&self, cycles: usize, wait_s: f64, speed_mps: f64) -> String {
        let poses_m = self.poses_m();
        let mm =
            |p: &Vector3<f64>| format!("[{:.3}, {:.3}, {:.3}]", p.x * 1e3, p.y * 1e3, p.z * 1e3);
        let mut text = format!(
            "# ISO 9283: {cycles} cycles over P5, P4, P3, P2, P1 in a {} of {:.1} mm.\n\
             name = \"iso9283\"\nstart_mm = {}\nspeed_mm_s = {:.3}\n",
            self.shape(),
            self.side_m * 1e3,
            mm(&poses_m[0]),
            speed_mps * 1e3
        );
        for _ in 0..cycles {
            for pose in &ORDER[1..] {
                text.push_str(&format!(
                    "[[leg]]\nto_mm = {}\n[[leg]]\ndwell_s = {wait_s}\n",
                    mm(&poses_m[*pose])
                ));
            }
        }
        text
    }

    /// A corner's place from the middle, in halves of a side, along the sides: a square has none across its plane.
    fn at(&self, corner: &Vector3<f64>) -> Vector3<f64> {
        match sides(self.normal.as_ref()).as_slice() {
            [across, up] => across * corner.x + up * corner.z,
            _ => *corner,
        }
    }

    /// Whether the tool can rest in the middle, at the corners and in the middles of the edges.
    fn can_rest(&self, model: &Model) -> bool {
        let steps = [-1.0, 0.0, 1.0];
        let all = steps
            .iter()
            .flat_map(|x| steps.iter().map(move |y| (*x, *y)))
            .flat_map(|(x, y)| steps.iter().map(move |z| Vector3::new(x, y, *z)));
        // Middles of faces lie between those of their edges.
        let checked = all.filter(|at| at.iter().filter(|v| **v == 0.0).count() != 2);
        checked.into_iter().all(|at| {
            let tool_m = self.middle_m + self.at(&at) * (self.side_m / 2.0);
            model
                .rest(&tool_m, None)
                .is_ok_and(|rest| judge_place(model, &tool_m, &rest, None).is_ok())
        })
    }
}

/// Directions of the sides, world: three of a cube; of a square in the plane of this normal the level and the upright one.
fn sides(normal: Option<&Vector3<f64>>) -> Vec<Vector3<f64>> {
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
    match normal {
        Some(normal) => vec![normal.cross(&z), z],
        None => vec![x, y, z],
    }
}

/// The order of one cycle, by the poses' indices.
pub(super) const ORDER: [usize; 6] = [0, 4, 3, 2, 1, 0];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Task;
    use crate::robot::Robot;

    #[test]
    fn the_cube_of_a_robot_is_as_large_as_its_limits_allow() {
        let robot = Robot::built_in("lab-fast").unwrap();
        let model = Model::new(&robot).unwrap();
        let cube = Cube::largest(&model).unwrap();
        assert!(cube.can_rest(&model));
        let [low, high] = robot.search_box_in_world_m();
        for pose in cube.poses_m() {
            assert!(
                (0..3).all(|k| (low[k]..=high[k]).contains(&pose[k])),
                "{pose}"
            );
        }
        // The poses are 80 % of the diagonal apart.
        let [_, p2, _, p4, _] = cube.poses_m();
        let wanted_m = 0.8 * cube.side_m * 3.0_f64.sqrt();
        assert!(((p4 - p2).norm() - wanted_m).abs() < 1e-12);
        // A larger one does not fit at the same place.
        let larger = Cube {
            side_m: cube.side_m * 1.3,
            ..cube
        };
        assert!(!larger.can_rest(&model) || larger.cycle(&model).is_err());
        let text = cube.task_text(3, 0.5, 0.1);
        let task = Task::parse(&text, "iso9283.toml".into()).unwrap();
        // Three cycles of five moves and five waits.
        assert_eq!(task.steps.len(), 30);
        let plan = Plan::new(&model, &task.start_m().unwrap(), &task.steps).unwrap();
        let end_m = plan.timed.tool_m(plan.timed.duration_s()).unwrap();
        assert!((end_m - cube.poses_m()[0]).norm() < 1e-6);
    }

    #[test]
    fn a_robot_in_a_plane_has_a_square_in_it() {
        let robot = Robot::built_in("planar-vertical").unwrap();
        let model = Model::new(&robot).unwrap();
        let square = Cube::largest(&model).unwrap();
        let poses_m = square.poses_m();
        assert!(poses_m.iter().all(|pose| pose.y == 0.0), "{poses_m:?}");
        // Corners of a square, not of one line.
        let [_, p2, p3, p4, p5] = poses_m;
        let side_m = 0.8 * square.side_m;
        for (a, b) in [(p2, p3), (p3, p4), (p4, p5), (p5, p2)] {
            assert!(((a - b).norm() - side_m).abs() < 1e-12, "{a} {b}");
        }
        assert!(square.side_m > 0.1 && square.cycle(&model).is_ok());
        let larger = Cube {
            side_m: square.side_m * 1.3,
            ..square
        };
        let [low, high] = robot.search_box_in_world_m();
        let inside =
            |p: &Vector3<f64>| [0, 2].iter().all(|k| (low[*k]..=high[*k]).contains(&p[*k]));
        let half_m = larger.side_m / 2.0;
        let corners = [-half_m, half_m].map(|by| larger.middle_m + Vector3::new(by, 0.0, by));
        assert!(!corners.iter().all(inside) || !larger.can_rest(&model));
    }

    #[test]
    fn a_robot_that_can_hang_nowhere_has_no_cube() {
        let mut robot = Robot::built_in("lab-fast").unwrap();
        robot.limits.tension_max_n = 0.5;
        let model = Model::new(&robot).unwrap();
        let error = Cube::largest(&model).unwrap_err();
        assert!(error.to_string().contains("robot file"), "{error}");
    }
}
