//! What a page gets of a recorded run: figures, and the motion for the drawing.

use super::RecordedRun;
use super::judge::Judgement;
use super::mcap::Damage;
use crate::events::TruthPoint;
use mcdpr_core::robot::Robot;
use nalgebra::Vector3;
use serde_json::{Value, json};

/// Most instants of a motion that the page gets.
const MOST_INSTANTS: usize = 2000;
/// Runs of a robot whose anchors are within this of the page's robot are drawn in its frame, m.
const SAME_FRAME_M: f64 = 0.1;

/// Figures of a run, and its motion for a page whose robot has these anchors, world, m.
#[must_use]
pub fn message(
    name: &str,
    run: &RecordedRun,
    robot: &Robot,
    judgement: &Judgement,
    page_anchors_m: &[Vector3<f64>],
) -> Value {
    let theirs = anchors_m(robot);
    let near = |(a, b): (&Vector3<f64>, &Vector3<f64>)| (a - b).norm() < SAME_FRAME_M;
    let same = theirs.len() == page_anchors_m.len() && theirs.iter().zip(page_anchors_m).all(near);
    let (source, instants) = instants(run);
    let planned = run.plan.iter().flat_map(|plan| &plan.points);
    let planned: Vec<_> = planned.step_by(5).map(|point| point.tool_m).collect();
    json!({
        "name": name,
        "robot": robot.name,
        "drawn": same && !instants.is_empty(),
        "task": run.scenario.task.name,
        "source": source,
        "duration_s": judgement.duration_s,
        "damage": run.damage.as_ref().map(Damage::words),
        "judgement": judgement,
        "planned_m": planned,
        "instants": instants,
    })
}

/// Where the platform was: of a simulated robot its true states, else those of the plan.
fn instants(run: &RecordedRun) -> (&'static str, Vec<Value>) {
    let thinned = |count: usize| count.div_ceil(MOST_INSTANTS).max(1);
    if let Some(first) = run.truth.first() {
        let points = run.truth.iter().step_by(thinned(run.truth.len()));
        let instant = |point: &TruthPoint| {
            json!({
                "time_s": f64::from(point.tick.wrapping_sub(first.tick)) * 1e-3,
                "tool_m": point.tool_m,
                "position_m": point.position_m,
                "rotation_xyzw": point.rotation_xyzw,
                "tensions_n": point.tensions_n,
            })
        };
        return (
            "true state of the simulation",
            points.map(instant).collect(),
        );
    }
    let points = run.plan.as_ref().map_or(&[][..], |plan| &plan.points);
    let points = points.iter().step_by(thinned(points.len()));
    let instants = points.map(|point| json!(point));
    (
        "as planned; a board does not measure its tool",
        instants.collect(),
    )
}

/// Anchors of a robot, world, m.
#[must_use]
pub fn anchors_m(robot: &Robot) -> Vec<Vector3<f64>> {
    robot
        .cables
        .iter()
        .map(|cable| cable.anchor_in_world_m)
        .collect()
}
