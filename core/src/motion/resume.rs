//! The rest of an interrupted motion: back to its path by a straight line, then the remaining steps.

use super::Model;
use super::path::Path;
use super::plan::{Plan, PlanError};
use super::timed::{Step, StepProgress, Timed};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// The motion continues at most this long before the interruption, s: at the point of its path that is
/// nearest to the tool.
const BACK_S: f64 = 0.5;
/// Greatest speed on the way back to the path, m/s.
const WAY_BACK_MPS: f64 = 0.03;
/// A way back shorter than this is left out, m.
const LEAST_M: f64 = 5e-6;

/// An interruption after which a motion was continued.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interruption {
    /// Path time at the interruption, s.
    pub path_s: f64,
    /// The tool when the motion was continued, world, m.
    pub tool_m: [f64; 3],
}

/// How a plan that continues a motion is made again: the whole motion from its start, cut off at each
/// interruption.
#[derive(Debug, Clone, PartialEq)]
pub struct Resumed {
    /// The tool at the start of the whole motion, world, m.
    pub start_m: [f64; 3],
    /// The interruptions in order.
    pub interruptions: Vec<Interruption>,
}

/// The rest of a motion.
#[derive(Debug, Clone)]
pub(crate) struct Remaining {
    /// The way back to the path, if there is a distance, then the remaining steps.
    pub(crate) steps: Vec<Step>,
    /// Path time of the interrupted motion at which it continues, s.
    pub(crate) from_s: f64,
    /// Distance from the tool to that point, m.
    pub(crate) way_back_m: f64,
}

/// The rest of the motion `timed` of `steps`, interrupted at `path_s`, for a tool at `tool_m` (world, m).
/// Steps with a duration keep their greatest speed instead.
///
/// # Errors
/// [`PlanError::Path`]: not for a motion that was planned.
pub(crate) fn remaining(
    model: &Model,
    timed: &Timed,
    steps: &[Step],
    interruption: &Interruption,
) -> Result<Remaining, PlanError> {
    let tool_m = Vector3::from(interruption.tool_m);
    let StepProgress { step, began_s, .. } = timed
        .progress(interruption.path_s)
        .ok_or(super::path::PathError::Empty)?;
    // Not before the step's start: a gripper command before it must not be repeated.
    let earliest_s = began_s.max(interruption.path_s - BACK_S);
    let mut from_s = interruption.path_s;
    let mut nearest_m = (timed.tool_m(from_s)? - tool_m).norm();
    let mut time_s = from_s;
    while time_s > earliest_s {
        time_s = (time_s - 1e-3).max(earliest_s);
        let far_m = (timed.tool_m(time_s)? - tool_m).norm();
        if far_m < nearest_m {
            (from_s, nearest_m) = (time_s, far_m);
        }
    }
    let mut rest = Vec::new();
    let point_m = timed.tool_m(from_s)?;
    if nearest_m > LEAST_M {
        rest.push(Step::Move {
            path: Path::through(&[tool_m, point_m])?,
            duration_s: None,
            speed_mps: Some(WAY_BACK_MPS.min(model.robot().limits.speed_mps)),
        });
    }
    let way_m = timed.progress(from_s).map_or(0.0, |at| at.way_m);
    let top_mps = timed
        .top_speed_mps(step)
        .min(model.robot().limits.speed_mps);
    match steps.get(step) {
        Some(Step::Move {
            path,
            duration_s,
            speed_mps,
        }) if path.length_m() - way_m > LEAST_M => {
            rest.push(Step::Move {
                path: path.tail(way_m)?,
                duration_s: None,
                // A given duration was for the whole step. At least 0.1 mm/s: a step of a few
                // milliseconds may have no sample in motion, and a speed of 0 is refused.
                speed_mps: if duration_s.is_some() {
                    Some(top_mps.max(1e-4))
                } else {
                    *speed_mps
                },
            });
        }
        Some(Step::Dwell { duration_s }) => rest.push(Step::Dwell {
            duration_s: (duration_s - (from_s - began_s)).max(0.0),
        }),
        Some(gripper @ Step::Gripper { .. }) => rest.push(gripper.clone()),
        // A move of which nothing remains.
        Some(Step::Move { .. }) | None => {}
    }
    rest.extend(steps.iter().skip(step + 1).cloned());
    Ok(Remaining {
        steps: rest,
        from_s,
        way_back_m: nearest_m,
    })
}

impl Plan {
    /// The same plan as the rest of an interrupted motion.
    #[must_use]
    pub(crate) fn resuming(mut self, resumed: Resumed) -> Self {
        self.resumed = Some(resumed);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Task;
    use crate::robot::Robot;

    fn planned(text: &str) -> (Model, Plan, Vec<Step>) {
        let model = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
        let task = Task::parse(text, "rest.toml".into()).unwrap();
        let start_m = task.start_m().unwrap();
        let plan = Plan::new(&model, &start_m, &task.steps).unwrap();
        (model, plan, task.steps)
    }

    const CIRCLE: &str = "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [270, -100, -180]\n\
        [[leg]]\ncircle_center_mm = [310, -100, -180]\nduration_s = 6\n\
        [[leg]]\ngripper = \"close\"\n[[leg]]\nto_mm = [270, -100, -170]\n";

    #[test]
    fn the_rest_of_a_motion_stays_on_its_path_and_ends_where_it_ends() {
        let (model, plan, steps) = planned(CIRCLE);
        let end_s = plan.timed.duration_s();
        let end_m = plan.timed.tool_m(end_s).unwrap();
        for share in [0.05, 0.3, 0.5, 0.7, 0.97] {
            let path_s = share * end_s;
            let off = Vector3::new(1e-3, 0.0, -2e-3);
            let tool_m = plan.timed.tool_m(path_s).unwrap() + off;
            let interruption = Interruption {
                path_s,
                tool_m: tool_m.into(),
            };
            let rest = remaining(&model, &plan.timed, &steps, &interruption).unwrap();
            assert!(
                rest.from_s <= path_s && rest.from_s > path_s - 0.51,
                "{rest:?}"
            );
            assert!(rest.way_back_m < 2.3e-3, "{rest:?}");
            let again = Plan::new(&model, &tool_m, &rest.steps).unwrap();
            let last_s = again.timed.duration_s();
            assert!((again.timed.tool_m(last_s).unwrap() - end_m).norm() < 1e-6);
            // After the way back every point is on the path that was planned.
            let way_back_s = again.timed.rests_s()[1];
            let mut time_s = way_back_s;
            while time_s < last_s {
                let at_m = again.timed.tool_m(time_s).unwrap();
                let far = |ms: u32| {
                    let then_m = plan.timed.tool_m(f64::from(ms) * 1e-3).unwrap();
                    (then_m - at_m).norm()
                };
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "some seconds"
                )]
                let nearest_m = (0..=(end_s * 1e3) as u32).map(far).fold(1.0, f64::min);
                assert!(nearest_m < 2e-4, "{nearest_m} m at {time_s} s");
                time_s += 0.1;
            }
        }
    }

    #[test]
    fn actions_before_the_interruption_are_not_repeated_and_later_ones_remain() {
        let (model, plan, steps) = planned(CIRCLE);
        let gripper_s = plan.timed.actions()[0].time_s;
        let count = |path_s: f64| {
            let tool_m = plan.timed.tool_m(path_s).unwrap().into();
            let interruption = Interruption { path_s, tool_m };
            let rest = remaining(&model, &plan.timed, &steps, &interruption).unwrap();
            let grippers = rest
                .steps
                .iter()
                .filter(|step| matches!(step, Step::Gripper { .. }));
            grippers.count()
        };
        assert_eq!(count(gripper_s - 0.3), 1);
        assert_eq!(count(plan.timed.duration_s() - 0.05), 0);
    }

    #[test]
    fn a_step_with_a_duration_keeps_its_speed() {
        let (model, plan, steps) = planned(CIRCLE);
        let circle_mps = plan.timed.top_speed_mps(1);
        let path_s = plan.timed.rests_s()[1] + 3.0;
        let tool_m = plan.timed.tool_m(path_s).unwrap().into();
        let rest = remaining(
            &model,
            &plan.timed,
            &steps,
            &Interruption { path_s, tool_m },
        )
        .unwrap();
        let speeds = rest.steps.iter().filter_map(|step| match step {
            Step::Move { speed_mps, .. } => *speed_mps,
            _ => None,
        });
        assert!(
            speeds
                .into_iter()
                .any(|mps| (mps - circle_mps).abs() < 1e-9)
        );
    }
}
