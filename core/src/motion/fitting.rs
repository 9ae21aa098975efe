//! A task that fits a robot's own work space: for a demonstration without a named task.

use super::model::Model;
use super::path::{Path, PathError, Piece};
use super::plan::{Plan, PlanError};
use super::task::{FITTING, Task};
use super::timed::Step;
use crate::holding::Freedom;
use nalgebra::{Rotation3, Vector3};
use std::f64::consts::TAU;

/// Radii that are tried, m.
const RADII_M: [f64; 6] = [0.3, 0.2, 0.15, 0.1, 0.065, 0.03];
/// Time for the circle where the drives can follow, s.
const CIRCLE_S: f64 = 10.0;
/// Share of the greatest speed that the circle uses.
const SPEED_SHARE: f64 = 0.7;
/// Points of a circle that is not horizontal.
const POINTS: u32 = 36;
/// Tilts and turns that are tried after the circle, degrees.
const TILTS_DEG: [f64; 5] = [15.0, 12.0, 8.0, 5.0, 2.0];
/// Share of the greatest tilt of the robot file that a tilt uses: a verdict at the limit itself would
/// depend on rounding.
const TILT_SHARE: f64 = 0.98;

/// The task of robots like the paper's.
pub const PAPER: &str = "paper:table7";
/// Height of a level platform's origin on that circle, m: at the paper's own, 24 mm, it needs tensions beyond
/// the sensors.
pub const PAPER_HEIGHT_M: f64 = -0.1;

impl Task {
    /// Name of the built-in task that fits a robot: the paper's circle for a robot like the paper's, else
    /// that of [`Task::fitting`].
    #[must_use]
    pub fn fitting_name(model: &Model) -> &'static str {
        let robot = model.robot();
        let height_m = PAPER_HEIGHT_M + robot.tool.tcp_in_platform_m.z;
        let like_paper = model.holding().hangs() && model.holding().first_by_tension().is_some();
        let [low, high] = robot.search_box_in_world_m();
        let start_m = Self::built_in(PAPER, height_m)
            .ok()
            .and_then(|task| task.start_m());
        let inside = start_m
            .is_some_and(|at| at.x > low.x && at.x < high.x && at.y > low.y && at.y < high.y);
        if like_paper && inside { PAPER } else { FITTING }
    }

    /// A circle about the middle of the robot's work space (its box, or its home), horizontal or in the
    /// robot's plane, as large as fits; then, where lengths hold the attitude, a path that tilts and turns
    /// the platform both ways about every axis that it has.
    ///
    /// # Errors
    /// Why the smallest one is impossible.
    pub fn fitting(model: &Model) -> Result<Self, PlanError> {
        let mut refused = None;
        for radius_m in RADII_M {
            let circle = match circle(model, radius_m) {
                Ok(steps) => steps,
                Err(error) => {
                    refused = Some(error);
                    continue;
                }
            };
            match made(model, &circle, Vec::new()) {
                Ok(task) => return Ok(tilted(model, &circle).unwrap_or(task)),
                Err(error) => refused = Some(error),
            }
        }
        Err(refused.unwrap_or_else(|| PathError::Empty.into()))
    }
}

/// Start and steps of a circle.
struct Circle {
    start_m: Vector3<f64>,
    center_m: Vector3<f64>,
    /// Unit vectors across and up, or across twice.
    axes: [Vector3<f64>; 2],
    radius_m: f64,
    step: Step,
}

fn circle(model: &Model, radius_m: f64) -> Result<Circle, PlanError> {
    let robot = model.robot();
    let mut center_m = match robot.limits.box_in_world_m {
        Some([low, high]) => (low + high) / 2.0,
        None => robot.tool.home_in_world_m,
    };
    let plane = match model.holding().freedom() {
        Freedom::Plane { normal } | Freedom::PlanePoint { normal } => Some(normal),
        _ => None,
    };
    let mut axes = [Vector3::x(), Vector3::y()];
    if let Some(normal) = plane {
        let tool = &robot.tool.tcp_in_platform_m;
        // The platform's origin must lie in the plane of the cables; the tool may stand beside it.
        center_m = model.in_plane(&(center_m - tool)) + tool;
        axes = [Vector3::z().cross(&normal), Vector3::z()];
    }
    let [across, other] = axes;
    let start_m = center_m - across * radius_m;
    let piece = if plane.is_some() {
        let points: Vec<_> = (0..=POINTS)
            .map(|point| {
                // The remainder makes the last point exactly the first one.
                let angle = TAU * f64::from(point % POINTS) / f64::from(POINTS);
                center_m
                    - across * (radius_m * libm::cos(angle))
                    - other * (radius_m * libm::sin(angle))
            })
            .collect();
        Piece::curve(&points)?
    } else {
        Piece::arc(center_m, radius_m, start_m, TAU)?
    };
    let path = Path::new(vec![piece])?;
    let slow_s = path.length_m() / (SPEED_SHARE * robot.limits.speed_mps);
    Ok(Circle {
        start_m,
        center_m,
        axes,
        radius_m,
        step: Step::Move {
            path,
            duration_s: Some(CIRCLE_S.max(slow_s)),
            speed_mps: None,
        },
    })
}

/// The task, if it keeps every limit from home on.
fn made(model: &Model, circle: &Circle, more: Vec<Step>) -> Result<Task, PlanError> {
    let mut steps = vec![circle.step.clone()];
    steps.extend(more);
    let task = Task::fitted(circle.start_m, steps);
    let home_m = model.robot().tool.home_in_world_m;
    let whole = task.clone().approached_from(&home_m, None);
    let whole = whole.map_err(|_| PlanError::from(PathError::Empty))?;
    Plan::new(model, &home_m, &whole.steps)?;
    Ok(task)
}

/// The circle with the greatest tilts that fit after it; `None` for a robot without attitude, and where
/// none fits.
fn tilted(model: &Model, circle: &Circle) -> Option<Task> {
    let freedom = model.holding().freedom();
    let tilt_max = model.robot().limits.tilt_max_rad * TILT_SHARE;
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
    TILTS_DEG.into_iter().find_map(|degrees| {
        let angle = degrees.to_radians();
        let tilt = angle.min(tilt_max);
        let turns = match freedom {
            Freedom::Pose => vec![
                x * tilt,
                y * tilt,
                z * angle,
                x * -tilt,
                y * -tilt,
                z * -angle,
            ],
            Freedom::Plane { normal } => vec![normal * tilt, normal * -tilt],
            _ => return None,
        };
        let [across, other] = circle.axes;
        let mut at_m = circle.start_m;
        let mut steps = Vec::new();
        let count = turns.len().max(1) as f64;
        for (index, turn) in turns.iter().chain([&Vector3::zeros()]).enumerate() {
            // A polygon about the middle of the circle, half as large.
            let angle = TAU * (index as f64 + 0.5) / count;
            let arm =
                (across * libm::cos(angle) + other * libm::sin(angle)) * (0.5 * circle.radius_m);
            let to_m = circle.center_m - arm;
            let path = Path::through(&[at_m, to_m]).ok()?;
            at_m = to_m;
            steps.push(Step::Move {
                path: path.turning_to(Some(Rotation3::new(*turn))),
                duration_s: None,
                speed_mps: Some(0.5 * model.robot().limits.speed_mps),
            });
        }
        made(model, circle, steps).ok()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    #[test]
    fn every_robot_has_a_task_and_those_with_attitude_use_it() {
        for name in ["eight-cable", "three-point", "planar-four", "lab-fast"] {
            let model = Model::new(&Robot::built_in(name).unwrap()).unwrap();
            let task = Task::fitting(&model).unwrap_or_else(|error| panic!("{name}: {error}"));
            let turns =
                |step: &Step| matches!(step, Step::Move { path, .. } if path.attitude().is_some());
            let turning = task.steps.iter().any(turns);
            assert_eq!(turning, model.holding().freedom().turns(), "{name}");
        }
    }
}
