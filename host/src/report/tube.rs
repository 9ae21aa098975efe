//! The tube that a plan stated, against the tool's true path.

use super::PathPoint;
use crate::motion::Plan;
use mcdpr_core::estimate::tube::Tube;
use nalgebra::Vector3;

/// Share of a true path that lies inside a tube; 1 for an empty path.
pub(crate) fn share_inside(plan: &Plan, tube: &Tube, path: &[PathPoint]) -> f64 {
    let all = ratios(plan, Some(tube), path);
    let inside = all.iter().filter(|ratio| ratio.of() <= 1.0).count();
    if all.is_empty() {
        1.0
    } else {
        inside as f64 / all.len() as f64
    }
}

/// Error of the tool, and the radius that was stated there, m.
pub(crate) struct Ratio {
    pub(crate) error_m: f64,
    pub(crate) radius_m: f64,
}

impl Ratio {
    /// Their ratio: at most 1 inside.
    pub(crate) fn of(&self) -> f64 {
        self.error_m / self.radius_m.max(1e-9)
    }
}

/// Point by point of a true path. Without a tube every point is outside.
pub(crate) fn ratios(plan: &Plan, tube: Option<&Tube>, path: &[PathPoint]) -> Vec<Ratio> {
    let duration_s = plan.timed.duration_s();
    let points = path.iter().filter(|point| point.path_s <= duration_s);
    points
        .filter_map(|point| {
            let planned_m = plan.timed.tool_m(point.path_s).ok()?;
            Some(Ratio {
                error_m: (Vector3::from(point.tool_m) - planned_m).norm(),
                radius_m: tube.map_or(0.0, |tube| tube.radius_m(point.path_s)),
            })
        })
        .collect()
}
