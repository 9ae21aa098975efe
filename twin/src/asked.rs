//! What an order of the page asks to be planned.

use serde_json::{Value, json};
use std::fmt::Write as _;

/// Most points of a path that the page makes.
const MOST_POINTS: usize = 500;

/// A task that an order names or describes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Asked {
    /// The task of this name.
    Named(String),
    /// A task file's text, and its name.
    Text {
        /// Its file name.
        name: String,
        /// Its text.
        text: String,
    },
}

/// Reads a plan order: a named task, a text, a place, points, or home. `home_m` and the tool's position
/// `tool_m`, if it is known, in the world, m.
///
/// # Errors
/// What is wrong with it, in words.
pub fn asked(message: &Value, home_m: [f64; 3], tool_m: Option<[f64; 3]>) -> Result<Asked, String> {
    let of = |name: &str, text: String| {
        let name = name.to_owned();
        Ok(Asked::Text { name, text })
    };
    if let Some(name) = message["task"].as_str() {
        return match message["text"].as_str() {
            Some(text) => of(name, text.to_owned()),
            None => Ok(Asked::Named(name.to_owned())),
        };
    }
    if message["home"] == json!(true) {
        return of(
            "home.toml",
            path_text("home", &[home_m.map(|v| v * 1e3)], None),
        );
    }
    if !message["to_mm"].is_null() {
        let to_mm = three(message, "to_mm").ok_or("a place is three numbers in mm")?;
        // From where the tool is, so that the speed holds for the whole way.
        let from_mm = tool_m.map(|tool_m| tool_m.map(|v| (v * 1e6).round() * 1e-3));
        let points: Vec<_> = from_mm.into_iter().chain([to_mm]).collect();
        return of(
            "go-to.toml",
            path_text("go to", &points, speed_mm_s(message)?),
        );
    }
    let points = message["points_mm"].as_array();
    let points = points.ok_or("a plan needs task, home, to_mm or points_mm")?;
    if points.is_empty() || points.len() > MOST_POINTS {
        return Err(format!("a path has 1 to {MOST_POINTS} points"));
    }
    let points = points.iter().map(|point| {
        let point = json!({ "point": point });
        three(&point, "point").ok_or("a point is three numbers in mm")
    });
    let points = points.collect::<Result<Vec<_>, _>>()?;
    of(
        "points.toml",
        path_text("taught points", &points, speed_mm_s(message)?),
    )
}

/// Three finite numbers of an order.
#[must_use]
pub fn three(message: &Value, key: &str) -> Option<[f64; 3]> {
    let axes = message[key].as_array().into_iter().flatten();
    let axes: Vec<_> = axes.filter_map(Value::as_f64).collect();
    let found: Option<[f64; 3]> = axes.try_into().ok();
    found.filter(|axes| axes.iter().all(|value| value.is_finite()))
}

/// A text of an order.
///
/// # Errors
/// That it is missing.
pub fn text<'a>(message: &'a Value, key: &str) -> Result<&'a str, String> {
    let text = message[key].as_str();
    text.ok_or_else(|| format!("this order needs {key}, a text"))
}

/// The velocity of a jog order, m/s, at most `most_mps` fast.
///
/// # Errors
/// What is wrong with it, in words.
pub fn jog_mps(message: &Value, most_mps: f64) -> Result<[f64; 3], String> {
    let velocity_mps = three(message, "velocity_mps")
        .ok_or_else(|| "a jog needs velocity_mps, three numbers in m/s".to_owned())?;
    let speed = velocity_mps.iter().map(|v| v * v).sum::<f64>().sqrt();
    if speed > most_mps {
        let most = most_mps * 1e3;
        return Err(format!(
            "a jog of {:.0} mm/s is asked for, the robot's limit is {most:.0} mm/s",
            speed * 1e3
        ));
    }
    Ok(velocity_mps)
}

/// The speed of an order, mm/s; `None`: as fast as the robot file allows.
fn speed_mm_s(message: &Value) -> Result<Option<f64>, String> {
    match &message["speed_mm_s"] {
        Value::Null => Ok(None),
        value => match value.as_f64() {
            Some(speed) if speed.is_finite() && speed > 0.0 => Ok(Some(speed)),
            _ => Err("a speed is a number over 0, in mm/s".to_owned()),
        },
    }
}

/// A task file through points (mm): the first is its start.
fn path_text(name: &str, points_mm: &[[f64; 3]], speed_mm_s: Option<f64>) -> String {
    let mut text = format!("name = \"{name}\"\n");
    let [first, rest @ ..] = points_mm else {
        return text;
    };
    let list = |[x, y, z]: [f64; 3]| format!("[{x:?}, {y:?}, {z:?}]");
    if let Some(speed) = speed_mm_s {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "speed_mm_s = {speed:?}");
    }
    let _ = writeln!(text, "start_mm = {}", list(*first));
    for point in rest {
        let _ = writeln!(text, "\n[[leg]]\nto_mm = {}", list(*point));
    }
    if rest.is_empty() {
        text.push_str("\n[[leg]]\ndwell_s = 0.0\n");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcdpr_core::motion::Task;

    #[test]
    fn a_path_of_points_is_a_task_file() {
        let points = [
            [0.0, 0.0, -200.0],
            [50.5, -1e-3, -200.0],
            [0.0, 10.0, -150.0],
        ];
        let text = path_text("points", &points, Some(20.0));
        let task = Task::parse(&text, "points.toml".into()).unwrap();
        assert_eq!((task.steps.len(), task.name.as_str()), (2, "points"));
        let start_m = task.start_m().unwrap();
        assert!((start_m.z + 0.2).abs() < 1e-12, "{start_m}");
        let one = path_text("home", &points[..1], None);
        let task = Task::parse(&one, "home.toml".into()).unwrap();
        assert_eq!(task.steps.len(), 1);
    }

    #[test]
    fn numbers_that_are_none_are_refused() {
        let message = json!({ "to_mm": [1, 2], "speed_mm_s": -1 });
        assert_eq!(three(&message, "to_mm"), None);
        assert!(speed_mm_s(&message).is_err());
        assert_eq!(
            three(&json!({ "to_mm": [1, 2, 3.5] }), "to_mm"),
            Some([1.0, 2.0, 3.5])
        );
        assert_eq!(speed_mm_s(&json!({})), Ok(None));
    }
}
