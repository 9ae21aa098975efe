//! What a run was: figures, plots, files.

pub mod chart;
mod figures;
mod folder;
pub mod html;
mod judge;
mod plot;
pub mod tables;

pub use figures::{Figures, MeanMax, MeanSdMax, TensionError, measure};
pub use folder::{RunFolder, utc_stamp, write_samples};
pub use judge::{CableFigures, Judgement, Verdict, judge, path_errors};
pub use plot::{PathTrace, draw_path};

use mcdpr_simulator::TracePoint;

/// True tool positions of a simulated run along its motion: path time (s) and place (m).
#[must_use]
pub fn true_path(trace: &[TracePoint]) -> Vec<(f64, [f64; 3])> {
    trace
        .iter()
        .filter(|point| point.path_ms > 0)
        .map(|point| (f64::from(point.path_ms) * 1e-3, point.truth.tool_position_m))
        .collect()
}
