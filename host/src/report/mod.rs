//! Results of a run: figures, plots, files.

mod figures;
mod folder;
pub(crate) mod html;
mod plan_plot;
mod plot;
mod predict_plot;
mod robot_plot;
pub mod tables;
pub(crate) mod tube;

pub use figures::{Figures, measure};
pub(crate) use folder::{RUNS, RunFolder, write_samples};
pub use mcdpr_twin::record::figures::{MeanMax, MeanSdMax, TensionError};
pub use mcdpr_twin::record::judge::{CableFigures, Judgement, Verdict, judge};
pub(crate) use plan_plot::plan_figure;
pub use plan_plot::{draw_plan, draw_plan_png};
pub(crate) use plot::PathTrace;
pub(crate) use plot::draw_path;
pub(crate) use predict_plot::predict_figure;
pub(crate) use robot_plot::draw_robot;

use mcdpr_kinematics::Pose;
use mcdpr_simulator::TracePoint;
use mcdpr_simulator::plant::Truth;
use nalgebra::{Quaternion, Rotation3, UnitQuaternion};

/// True pose of a simulated platform, world_from_platform.
#[must_use]
pub(crate) fn true_pose(truth: &Truth) -> Pose {
    let [w, x, y, z] = truth.pose.rotation_wxyz;
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    Pose::from_quaternion(truth.pose.position_m.into(), turn)
}

/// True attitudes (world_from_platform) of a simulated run along its motion: path time (s) and rotation.
#[must_use]
pub(crate) fn true_turns(trace: &[TracePoint]) -> Vec<(f64, Rotation3<f64>)> {
    along(trace)
        .map(|point| {
            let pose = true_pose(&point.truth);
            (f64::from(point.path_ms) * 1e-3, pose.rotation)
        })
        .collect()
}

/// The tool at one time of its path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    /// Path time, s.
    pub path_s: f64,
    /// Position of the tool, world, m.
    pub tool_m: [f64; 3],
}

/// True tool positions of a simulated run along its motion.
#[must_use]
pub fn true_path(trace: &[TracePoint]) -> Vec<PathPoint> {
    along(trace)
        .map(|point| PathPoint {
            path_s: f64::from(point.path_ms) * 1e-3,
            tool_m: point.truth.tool_position_m,
        })
        .collect()
}

/// The points of the last motion of a trace.
fn along(trace: &[TracePoint]) -> impl Iterator<Item = &TracePoint> {
    // A path clock that runs back belongs to another motion.
    let begun = trace
        .windows(2)
        .rposition(|pair| matches!(pair, [a, b] if b.path_ms > 0 && a.path_ms > b.path_ms));
    trace
        .iter()
        .skip(begun.map_or(0, |index| index + 1))
        .filter(|point| point.path_ms > 0)
}
