//! What a task would do, for viewers.

use crate::feed::Feed;
use mcdpr_core::estimate::tube::{Belief, Doubts, Tube};
use mcdpr_core::motion::{Margin, Model, Task, Watch};
use mcdpr_core::run::preview;
use nalgebra::{Quaternion, Rotation3, UnitQuaternion, Vector3};
use serde_json::{Value, json};

/// Points of a plan that are drawn.
const DRAWN: usize = 600;

/// The message that shows viewers what a task would do from where the robot hangs: its path, its duration
/// and every limit's margin, or the reason why it cannot be run. `id` is the plan's number.
#[must_use]
pub fn message(model: &Model, feed: &Feed, task: &Task, id: u64) -> Value {
    let mut about = match planned(model, feed, task) {
        Ok(about) => about,
        Err(reason) => json!({ "ok": false, "reason": reason, "tool_m": [], "margins": [] }),
    };
    about["type"] = json!("preview");
    about["id"] = json!(id);
    about["name"] = json!(task.name);
    about
}

fn planned(model: &Model, feed: &Feed, task: &Task) -> Result<Value, String> {
    let pose = feed.now().0.pose;
    let (start_m, attitude) = match pose {
        Some(pose) => {
            let [x, y, z, w] = pose.rotation_xyzw;
            let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
            (Vector3::from(pose.tool_m), turn.to_rotation_matrix())
        }
        None => (model.robot().tool.home_in_world_m, Rotation3::identity()),
    };
    let failed = |error: &dyn std::fmt::Display| error.to_string();
    let plan = preview(model, task.clone(), &start_m, attitude).map_err(|e| failed(&e))?;
    let seen = plan.extremes(&Watch::default()).map_err(|e| failed(&e))?;
    let duration_s = seen.duration_s;
    let belief = Belief::of(model.robot(), &Doubts::by_tape());
    let tube = Tube::along(&plan, &belief).map_err(|e| failed(&e))?;
    let times = (0..=DRAWN).map(|index| duration_s * index as f64 / DRAWN as f64);
    let points = times.filter_map(|time_s| plan.timed.tool_m(time_s).ok());
    let points: Vec<[f64; 3]> = points.map(Into::into).collect();
    Ok(json!({
        "ok": seen.broken.is_none(),
        "reason": seen.broken,
        "duration_s": duration_s,
        "speed_mps": seen.speed_mps,
        "tool_m": points,
        "tightest": seen.margins.first().map(words),
        "margins": seen.margins,
        "tube": tube.map(|tube| json!({
            "widest_m": tube.widest.radius_m, "mean_m": tube.mean_m, "words": tube.words(),
        })),
    }))
}

/// A margin as one line.
fn words(margin: &Margin) -> String {
    let Margin {
        what,
        value,
        limit,
        unit,
        left_percent,
        time_s,
        ..
    } = margin;
    format!("{what}: {value:.1} of {limit:.1} {unit}, {left_percent:.0} % left, at {time_s:.1} s")
}
