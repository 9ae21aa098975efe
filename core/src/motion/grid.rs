//! Where a robot can rest: the places of a grid.

use super::model::{Model, StaticState};
use super::verdict::judge_place;
use nalgebra::Vector3;

/// The robot at the places of a grid at which it rests within every limit. The grid has `per_axis` places (2 or more) along
/// each axis of a box (least and greatest corner of the tool, world, m), its corners among them.
#[must_use]
pub fn rests_on_grid(
    model: &Model,
    [low, high]: [Vector3<f64>; 2],
    per_axis: u32,
) -> Vec<StaticState> {
    let steps = f64::from(per_axis.max(2) - 1);
    let mut found = Vec::new();
    let mut near = None;
    for x in 0..per_axis {
        for y in 0..per_axis {
            for z in 0..per_axis {
                let share = Vector3::new(f64::from(x), f64::from(y), f64::from(z)) / steps;
                let tool_m = low + (high - low).component_mul(&share);
                if let Ok(rest) = model.rest(&tool_m, near.as_ref()) {
                    if judge_place(model, &tool_m, &rest, None).is_ok() {
                        found.push(rest.clone());
                    }
                    near = Some(rest);
                }
            }
        }
    }
    found
}
