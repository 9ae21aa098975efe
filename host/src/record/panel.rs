//! The robot for a 3-D panel without a plugin: Foxglove's `SceneUpdate` and `CameraCalibration`,
//! and the transforms between its parts.
//!
//! Source: the well-known schemas of docs.foxglove.dev/docs/visualization/message-schemas.

use super::PlanNote;
use crate::motion::Model;
use mcdpr_kinematics::Pose;
use nalgebra::Vector3;
use serde::Serialize;
use serde_json::{Value, json};

/// Colours: red, green, blue, opacity.
type Color = [f64; 4];
const FRAME: Color = [0.55, 0.55, 0.6, 1.0];
const PLATFORM: Color = [0.25, 0.45, 0.75, 0.7];
const TOOL: Color = [0.1, 0.7, 0.2, 1.0];
const PATH: Color = [0.9, 0.6, 0.1, 0.8];
const SLACK: Color = [0.6, 0.6, 0.6, 0.6];
/// Widths and sizes, m.
const CABLE_M: f64 = 0.003;
const PATH_M: f64 = 0.002;
const BALL_M: f64 = 0.02;
const LETTERS_M: f64 = 0.04;

/// An entity of the scene with all required fields; it stays until it is replaced.
fn entity(id: &str, frame: &str, stamp: &impl Serialize, parts: Value) -> Value {
    let mut all = json!({
        "timestamp": stamp,
        "frame_id": frame,
        "id": id,
        "lifetime": { "sec": 0, "nsec": 0 },
        "frame_locked": true,
        "metadata": [],
        "arrows": [], "cubes": [], "spheres": [], "cylinders": [],
        "lines": [], "triangles": [], "texts": [], "models": [],
    });
    if let (Some(all), Value::Object(parts)) = (all.as_object_mut(), parts) {
        all.extend(parts);
    }
    json!({ "deletions": [], "entities": [all] })
}

fn color([r, g, b, a]: Color) -> Value {
    json!({ "r": r, "g": g, "b": b, "a": a })
}

fn xyz(v: &Vector3<f64>) -> Value {
    json!({ "x": v.x, "y": v.y, "z": v.z })
}

fn at(place: &Vector3<f64>) -> Value {
    json!({ "position": xyz(place), "orientation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 } })
}

fn ball(place: &Vector3<f64>, paint: Color) -> Value {
    json!({
        "pose": at(place),
        "size": { "x": BALL_M, "y": BALL_M, "z": BALL_M },
        "color": color(paint),
    })
}

/// The anchors with their numbers.
pub(super) fn frame(model: &Model, stamp: &impl Serialize) -> Value {
    let anchors = model.robot().cables.iter().map(|c| c.anchor_in_world_m);
    let balls: Vec<_> = anchors.clone().map(|anchor| ball(&anchor, FRAME)).collect();
    let texts: Vec<_> = anchors
        .enumerate()
        .map(|(index, anchor)| {
            json!({
                "pose": at(&(anchor + Vector3::z() * LETTERS_M)),
                "billboard": true,
                "font_size": LETTERS_M,
                "scale_invariant": false,
                "color": color(FRAME),
                "text": (index + 1).to_string(),
            })
        })
        .collect();
    let parts = json!({ "spheres": balls, "texts": texts });
    entity("frame", "world", stamp, parts)
}

/// The platform as the box of its mass and inertia, with the tool, in its own frame.
pub(super) fn platform(model: &Model, stamp: &impl Serialize) -> Value {
    let robot = model.robot();
    let half = crate::model_file::platform_half_size_m(robot);
    let box_ = json!({
        "pose": at(&robot.platform.center_of_mass_m),
        "size": xyz(&(half * 2.0)),
        "color": color(PLATFORM),
    });
    let tool = ball(&robot.tool.tcp_in_platform_m, TOOL);
    let parts = json!({ "cubes": [box_], "spheres": [tool] });
    entity("platform", "platform", stamp, parts)
}

/// The cables at a pose, blue at the least permitted tension, red at the greatest.
pub(super) fn cables(
    model: &Model,
    pose: &Pose,
    tensions_n: &[f64],
    stamp: &impl Serialize,
) -> Option<Value> {
    let paths = model.geometry().paths(pose).ok()?;
    let limits = &model.robot().limits;
    let span_n = (limits.tension_max_n - limits.tension_min_n).max(1e-3);
    let (mut points, mut colors) = (Vec::new(), Vec::new());
    for (path, tension_n) in paths.iter().zip(tensions_n) {
        let share = (tension_n - limits.tension_min_n) / span_n;
        let paint = if *tension_n <= 0.0 {
            SLACK
        } else {
            let share = share.clamp(0.0, 1.0);
            // From blue over green in the middle to red.
            [share, 1.0 - (2.0 * share - 1.0).abs(), 1.0 - share, 1.0]
        };
        for end in [&path.tangent_point_m, &path.attachment_m] {
            points.push(xyz(end));
            colors.push(color(paint));
        }
    }
    let lines = json!([{
        "type": 2,
        "pose": at(&Vector3::zeros()),
        "thickness": CABLE_M,
        "scale_invariant": false,
        "points": points,
        "color": color(SLACK),
        "colors": colors,
        "indices": [],
    }]);
    Some(entity("cables", "world", stamp, json!({ "lines": lines })))
}

/// Planned path of the tool.
pub(super) fn path(plan: &PlanNote, stamp: &impl Serialize) -> Value {
    let points = plan.points.iter().map(|point| xyz(&point.tool_m.into()));
    let lines = json!([{
        "type": 0,
        "pose": at(&Vector3::zeros()),
        "thickness": PATH_M,
        "scale_invariant": false,
        "points": points.collect::<Vec<_>>(),
        "color": color(PATH),
        "colors": [],
        "indices": [],
    }]);
    entity("path", "world", stamp, json!({ "lines": lines }))
}

/// A part fixed to the platform: the name of its frame, and platform_from_it.
pub(crate) fn fixed(model: &Model) -> [(&'static str, Pose); 2] {
    let robot = model.robot();
    [
        ("tool", Pose::level(robot.tool.tcp_in_platform_m)),
        ("camera", robot.camera.camera_from_platform.inverse()),
    ]
}

/// The lens, in the terms of `plumb_bob`.
pub(super) fn calibration(model: &Model, stamp: &impl Serialize) -> Value {
    let lens = &model.robot().camera.lens;
    let ([fx, fy], [cx, cy]) = (lens.focal_px, lens.center_px);
    json!({
        "timestamp": stamp,
        "frame_id": "camera",
        "width": lens.size_px[0],
        "height": lens.size_px[1],
        "distortion_model": "plumb_bob",
        "D": lens.distortion,
        "K": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    })
}
