//! Topics of a record and the JSON schemas of their messages: Foxglove's if they exist.

use serde_json::{Value, json};

/// A topic: name of its schema and the schema.
pub(super) struct Topic {
    pub(super) topic: &'static str,
    pub(super) schema: &'static str,
    pub(super) body: fn() -> Value,
}

pub(super) const CABLES: usize = 0;
pub(super) const STATUS: usize = 1;
pub(super) const KNOT: usize = 2;
pub(super) const COMMAND: usize = 3;
pub(super) const PLAN: usize = 4;
pub(super) const LOG: usize = 5;
pub(super) const POSE_PLANNED: usize = 6;
pub(super) const POSE_ESTIMATED: usize = 7;
pub(super) const POSE_TRUE: usize = 8;
pub(super) const TRANSFORM: usize = 9;
pub(super) const TRUTH: usize = 10;
pub(super) const ORDER: usize = 11;
pub(super) const IMAGE: usize = 12;
pub(super) const MARKS: usize = 13;
pub(super) const SCENE: usize = 14;
pub(super) const LENS: usize = 15;

/// The topics in the order of the numbers above.
pub(super) const TOPICS: [Topic; 16] = [
    topic("/cables", "mcdpr.Cables", cables),
    topic("/status", "mcdpr.Status", status),
    topic("/knot", "mcdpr.Knot", knot),
    topic("/command", "mcdpr.Command", command),
    topic("/plan", "mcdpr.Plan", plan),
    topic("/log", "foxglove.Log", log),
    topic("/pose/planned", "foxglove.PoseInFrame", pose),
    topic("/pose/estimated", "foxglove.PoseInFrame", pose),
    topic("/pose/true", "foxglove.PoseInFrame", pose),
    topic("/tf", "foxglove.FrameTransform", transform),
    topic("/truth", "mcdpr.Truth", truth),
    topic("/order", "mcdpr.Order", order),
    topic("/camera/image", "foxglove.CompressedImage", image),
    topic("/camera/marks", "foxglove.ImageAnnotations", marks),
    topic("/scene", "foxglove.SceneUpdate", scene),
    topic(
        "/camera/calibration",
        "foxglove.CameraCalibration",
        calibration,
    ),
];

const fn topic(topic: &'static str, schema: &'static str, body: fn() -> Value) -> Topic {
    Topic {
        topic,
        schema,
        body,
    }
}

fn numbers(of: &str) -> Value {
    json!({ "type": "array", "items": { "type": "number" }, "description": of })
}

fn object(title: &str, properties: Value) -> Value {
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        "type": "object",
        "properties": properties,
    })
}

fn time() -> Value {
    json!({
        "type": "object",
        "title": "time",
        "properties": { "sec": { "type": "integer", "minimum": 0 }, "nsec": { "type": "integer", "minimum": 0, "maximum": 999_999_999 } },
    })
}

fn vector() -> Value {
    json!({
        "type": "object",
        "properties": { "x": { "type": "number" }, "y": { "type": "number" }, "z": { "type": "number" } },
    })
}

fn quaternion() -> Value {
    json!({
        "type": "object",
        "properties": {
            "x": { "type": "number" }, "y": { "type": "number" },
            "z": { "type": "number" }, "w": { "type": "number" },
        },
    })
}

fn cables() -> Value {
    object(
        "mcdpr.Cables",
        json!({
            "timestamp": time(),
            "tick": { "type": "integer", "description": "board tick, ms" },
            "path_s": { "type": ["number", "null"], "description": "path time of the motion, s" },
            "length_m": numbers("paid-out lengths by the drum encoders, m"),
            "tension_n": numbers("tensions at the winches, N"),
            "current_a": numbers("motor currents, A"),
            "planned_length_m": numbers("set-points of the lengths, m; empty without a motion"),
            "planned_tension_n": numbers("expected tensions or set-points, N; empty without a motion"),
        }),
    )
}

fn image() -> Value {
    object(
        "foxglove.CompressedImage",
        json!({
            "timestamp": time(),
            "frame_id": { "type": "string" },
            "data": { "type": "string", "contentEncoding": "base64" },
            "format": { "type": "string" },
        }),
    )
}

fn marks() -> Value {
    let point = || {
        json!({
            "type": "object",
            "properties": { "x": { "type": "number" }, "y": { "type": "number" } },
        })
    };
    let color = || {
        json!({
            "type": "object",
            "properties": {
                "r": { "type": "number" }, "g": { "type": "number" },
                "b": { "type": "number" }, "a": { "type": "number" },
            },
        })
    };
    let list = |items: Value| json!({ "type": "array", "items": items });
    object(
        "foxglove.ImageAnnotations",
        json!({
            "circles": list(json!({ "type": "object" })),
            "points": list(json!({
                "type": "object",
                "properties": {
                    "timestamp": time(),
                    "type": { "type": "integer", "description": "2: closed line through the points" },
                    "points": list(point()),
                    "outline_color": color(),
                    "outline_colors": list(color()),
                    "fill_color": color(),
                    "thickness": { "type": "number" },
                },
            })),
            "texts": list(json!({
                "type": "object",
                "properties": {
                    "timestamp": time(),
                    "position": point(),
                    "text": { "type": "string" },
                    "font_size": { "type": "number" },
                    "text_color": color(),
                    "background_color": color(),
                },
            })),
        }),
    )
}

fn status() -> Value {
    object(
        "mcdpr.Status",
        json!({
            "timestamp": time(),
            "tick": { "type": "integer" },
            "state": { "type": "string" },
            "path_s": { "type": "number" },
            "setpoint_m": numbers("commanded lengths, m"),
            "length_m": numbers("measured lengths, m"),
            "tension_n": numbers("measured tensions, N"),
            "fault": { "type": ["string", "null"] },
            "limits": { "type": "integer", "description": "bit set of warnings" },
            "brakes_open": { "type": "integer" },
            "torque_on": { "type": "integer" },
            "referenced": { "type": "boolean" },
            "gripper_closed": { "type": "boolean" },
            "frames_ok": { "type": "integer" },
            "frames_bad": { "type": "integer" },
            "tick_overruns": { "type": "integer" },
            "telemetry_dropped": { "type": "integer" },
        }),
    )
}

fn knot() -> Value {
    object(
        "mcdpr.Knot",
        json!({
            "timestamp": time(),
            "index": { "type": "integer" },
            "time_s": { "type": "number" },
            "last": { "type": "boolean" },
            "length_m": numbers("lengths, m"),
            "speed_mps": numbers("rates, m/s"),
            "tension_n": numbers("expected tensions or set-points, N"),
        }),
    )
}

fn command() -> Value {
    object(
        "mcdpr.Command",
        json!({ "timestamp": time(), "request": { "type": "string" } }),
    )
}

fn plan() -> Value {
    object(
        "mcdpr.Plan",
        json!({
            "timestamp": time(),
            "duration_s": { "type": "number" },
            "points": { "type": "array", "items": { "type": "object", "properties": {
                "time_s": { "type": "number" },
                "tool_m": numbers("tool, world, m"),
                "position_m": numbers("platform, world, m"),
                "rotation_xyzw": numbers("attitude of the platform"),
                "tensions_n": numbers("expected tensions, N"),
            } } },
        }),
    )
}

fn truth() -> Value {
    object(
        "mcdpr.Truth",
        json!({
            "timestamp": time(),
            "tick": { "type": "integer" },
            "path_s": { "type": "number" },
            "tool_m": numbers("tool, world, m"),
            "position_m": numbers("platform, world, m"),
            "rotation_xyzw": numbers("attitude of the platform"),
            "tensions_n": numbers("tensions at the platform, N"),
        }),
    )
}

fn order() -> Value {
    object(
        "mcdpr.Order",
        json!({
            "timestamp": time(),
            "looks": { "type": "integer", "description": "how often the feeding thread had looked for orders before" },
            "order": { "type": "object", "description": "the order and its numbers" },
        }),
    )
}

fn log() -> Value {
    object(
        "foxglove.Log",
        json!({
            "timestamp": time(),
            "level": { "type": "integer", "description": "0 unknown, 1 debug, 2 info, 3 warning, 4 error, 5 fatal" },
            "message": { "type": "string" },
            "name": { "type": "string" },
            "file": { "type": "string" },
            "line": { "type": "integer", "minimum": 0 },
        }),
    )
}

fn pose() -> Value {
    object(
        "foxglove.PoseInFrame",
        json!({
            "timestamp": time(),
            "frame_id": { "type": "string" },
            "pose": {
                "type": "object",
                "title": "foxglove.Pose",
                "properties": { "position": vector(), "orientation": quaternion() },
            },
        }),
    )
}

fn transform() -> Value {
    object(
        "foxglove.FrameTransform",
        json!({
            "timestamp": time(),
            "parent_frame_id": { "type": "string" },
            "child_frame_id": { "type": "string" },
            "translation": vector(),
            "rotation": quaternion(),
        }),
    )
}

fn scene() -> Value {
    let list = |items: Value| json!({ "type": "array", "items": items });
    let things = || list(json!({ "type": "object" }));
    object(
        "foxglove.SceneUpdate",
        json!({
            "deletions": things(),
            "entities": list(json!({
                "type": "object",
                "title": "foxglove.SceneEntity",
                "properties": {
                    "timestamp": time(),
                    "frame_id": { "type": "string" },
                    "id": { "type": "string" },
                    "lifetime": time(),
                    "frame_locked": { "type": "boolean" },
                    "metadata": things(),
                    "arrows": things(), "cubes": things(), "spheres": things(),
                    "cylinders": things(), "lines": things(), "triangles": things(),
                    "texts": things(), "models": things(),
                },
            })),
        }),
    )
}

fn calibration() -> Value {
    object(
        "foxglove.CameraCalibration",
        json!({
            "timestamp": time(),
            "frame_id": { "type": "string" },
            "width": { "type": "integer", "minimum": 0 },
            "height": { "type": "integer", "minimum": 0 },
            "distortion_model": { "type": "string" },
            "D": numbers("distortion: k1, k2, p1, p2, k3"),
            "K": numbers("intrinsic matrix, 3 x 3, row by row"),
            "R": numbers("rectification, 3 x 3"),
            "P": numbers("projection, 3 x 4"),
        }),
    )
}
