//! Bounds on one plan: checked before anything is solved or allocated.

use super::model::Model;
use super::path::Path;
use super::plan::{LONGEST_M, LONGEST_S, MOST_STEPS, PlanError};
use super::timed::Step;
use crate::robot::Robot;
use nalgebra::Vector3;
use std::f64::consts::{PI, TAU};

/// At most this many points of a step's path are checked.
const LOOKS: u32 = 64;

/// Checks that number, duration and reach of the steps are within the bounds of one plan.
///
/// # Errors
/// [`PlanError::Large`], [`PlanError::Long`], [`PlanError::Reach`].
pub(super) fn check(model: &Model, steps: &[Step]) -> Result<(), PlanError> {
    let large = |what, asked: f64, limit: f64| Err(PlanError::Large { what, asked, limit });
    if steps.len() > MOST_STEPS {
        return large("steps", steps.len() as f64, MOST_STEPS as f64);
    }
    let robot = model.robot();
    let reaches_m: Vec<f64> = (0..robot.cables.len())
        .map(|cable| reach_m(robot, cable))
        .collect();
    let (mut length_m, mut least_s) = (0.0, 0.0);
    for (number, step) in (1..).zip(steps) {
        match step {
            Step::Dwell { duration_s } => least_s += duration_s.max(0.0),
            Step::Gripper { .. } => least_s += robot.gripper.close_s,
            Step::Move {
                path,
                duration_s,
                speed_mps,
            } => {
                length_m += path.length_m();
                // A lower bound: the whole way at the greatest speed. It refuses hours before they
                // are solved.
                let most_mps = speed_mps.unwrap_or(robot.limits.speed_mps);
                least_s += duration_s.unwrap_or(path.length_m() / most_mps);
                reached(robot, &reaches_m, number, path)?;
            }
        }
    }
    if length_m > LONGEST_M {
        return large("metres of path", length_m, LONGEST_M);
    }
    // NaN passes here: the piece that it belongs to is refused by name.
    if least_s > LONGEST_S {
        return Err(PlanError::Long {
            duration_s: least_s,
        });
    }
    Ok(())
}

/// Checks that no point of a path is further from an anchor than its cable reaches.
fn reached(robot: &Robot, reaches_m: &[f64], step: usize, path: &Path) -> Result<(), PlanError> {
    for look in 0..=LOOKS {
        // A sample refuses a mistyped coordinate; later the verdict checks every 10 ms of motion.
        let way_m = path.length_m() * f64::from(look) / f64::from(LOOKS);
        let tool_m = path.point(way_m)?.position_m;
        for (index, (cable, reach_m)) in robot.cables.iter().zip(reaches_m).enumerate() {
            let distance_m = (tool_m - cable.anchor_in_world_m).norm();
            if distance_m > *reach_m {
                return Err(PlanError::Reach {
                    step,
                    x_mm: tool_m.x * 1e3,
                    y_mm: tool_m.y * 1e3,
                    z_mm: tool_m.z * 1e3,
                    cable: index + 1,
                    distance_mm: distance_m * 1e3,
                    reach_mm: reach_m * 1e3,
                });
            }
        }
    }
    Ok(())
}

/// Greatest distance from its anchor at which a cable can hold the tool, m: the drum's whole
/// capacity, stretched by the greatest tension, with the pulley's wrap, and the platform between
/// cable and tool.
fn reach_m(robot: &Robot, index: usize) -> f64 {
    let (Some(cable), Some(winch)) = (robot.cables.get(index), robot.winch_of(index)) else {
        return f64::INFINITY;
    };
    let drum_m = winch.turns_max * TAU * winch.drum_radius_m;
    let tension_n = robot.limits.tension_max_n.min(winch.tension_max_n);
    let stretched_m = (drum_m + cable.routing_length_m) * (1.0 + tension_n / cable.ea_n);
    let platform: Vector3<f64> = cable.attachment_in_platform_m - robot.tool.tcp_in_platform_m;
    stretched_m + PI * cable.pulley_radius_m + platform.norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Plan, PlanOptions, Shaping, Task};
    use std::path::PathBuf;

    fn refused(text: &str) -> PlanError {
        let model = Model::new(&Robot::built_in("paper-optimistic").unwrap()).unwrap();
        let task = if text.starts_with('G') {
            Task::parse_gcode(text, PathBuf::from("any.gcode"))
        } else {
            Task::parse(text, PathBuf::from("any.toml"))
        };
        let task = task.unwrap();
        Plan::unjudged(&model, &task.start_m().unwrap(), &task.steps).unwrap_err()
    }

    #[test]
    fn what_would_fill_the_memory_is_refused_by_name() {
        let began = std::time::Instant::now();
        let head = "start_mm = [335, 0, -160]\n[[leg]]\n";
        let deep = refused(&format!("{head}to_mm = [335, 0, -99999]"));
        assert!(matches!(deep, PlanError::Reach { step: 1, .. }), "{deep}");
        let wait = refused(&format!("{head}dwell_s = 1e12"));
        assert!(matches!(wait, PlanError::Long { .. }), "{wait}");
        let slow = refused(&format!("{head}to_mm = [340, 0, -160]\nspeed_mm_s = 1e-7"));
        assert!(matches!(slow, PlanError::Long { .. }), "{slow}");
        let wound = refused(
            "start_mm = [335, 10, -160]\n[[leg]]\ncircle_center_mm = [335, 0, -160]\nsweep_deg = 1e12",
        );
        let PlanError::Large { what, .. } = wound else {
            panic!("{wound}")
        };
        assert_eq!(what, "metres of path");
        let program = refused("G0 X335 Y0 Z-160\nG4 P99999999999999");
        assert!(matches!(program, PlanError::Long { .. }), "{program}");
        assert!(began.elapsed().as_secs() < 5);
    }

    #[test]
    fn a_motion_of_too_many_impulses_is_refused_and_a_shorter_one_is_not() {
        let model = Model::new(&Robot::built_in("paper-optimistic").unwrap()).unwrap();
        let planned = |shaping, speed_mm_s: f64| {
            let options = PlanOptions {
                shaping,
                ..PlanOptions::default()
            };
            let model = model.clone().with_options(options);
            let text = format!(
                "start_mm = [335, 0, -160]\n[[leg]]\nto_mm = [345, 0, -160]\nspeed_mm_s = {speed_mm_s}"
            );
            let task = Task::parse(&text, PathBuf::from("any.toml")).unwrap();
            Plan::unjudged(&model, &task.start_m().unwrap(), &task.steps).map(|_| ())
        };
        // Three modes: 27 impulses, and 2,500 s; the same without a shaper, and in 250 s.
        let refused = planned(Shaping::Zvd, 0.004).unwrap_err();
        let PlanError::Large { what, .. } = refused else {
            panic!("{refused}")
        };
        assert!(what.starts_with("impulses"), "{what}");
        assert_eq!(
            planned(Shaping::None, 0.004).map_err(|e| e.to_string()),
            Ok(())
        );
        assert_eq!(
            planned(Shaping::Zvd, 0.04).map_err(|e| e.to_string()),
            Ok(())
        );
    }

    #[test]
    fn an_hour_fits_and_one_second_more_does_not() {
        let model = Model::new(&Robot::built_in("paper-optimistic").unwrap()).unwrap();
        let dwell = |duration_s| [Step::Dwell { duration_s }];
        assert!(check(&model, &dwell(LONGEST_S)).is_ok());
        assert!(check(&model, &dwell(LONGEST_S + 1.0)).is_err());
        assert!(
            check(&model, &dwell(f64::NAN)).is_ok(),
            "refused by its step"
        );
        let many = vec![Step::Gripper { closed: true }; MOST_STEPS + 1];
        let error = check(&model, &many).unwrap_err();
        assert!(error.to_string().starts_with("steps: 10001"), "{error}");
    }
}
