//! `mcdpr workspace` against point-by-point computation.

use super::{answer, batch, numbers, rotation, run, text, vector};
use mcdpr::robot::Robot;
use nalgebra::{Matrix3, Vector3};
use serde_json::{Value, json};
use std::path::PathBuf;

/// A folder that goes with the test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path =
            std::env::temp_dir().join(format!("mcdpr-compute-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Points of a slice's table: place, verdict.
fn points(csv: &str) -> Vec<(Vector3<f64>, String)> {
    let text = std::fs::read_to_string(csv).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("x_m,y_m,z_m,verdict,cable"));
    lines
        .map(|line| {
            let cells: Vec<_> = line.split(',').collect();
            let at = Vector3::from_fn(|k, _| cells[k].parse().unwrap());
            (at, cells[3].to_owned())
        })
        .collect()
}

/// Runs `workspace` with one slice; checks what adds up, and gives document and points.
fn sliced(name: &str, words: &[&str]) -> (Value, Vec<(Vector3<f64>, String)>) {
    let folder = Folder::new(name);
    let out = folder.0.display().to_string();
    let found = answer(&[&["workspace", "--out", &out], words].concat());
    let total: u64 = found["verdicts"]
        .as_object()
        .unwrap()
        .values()
        .map(|n| n.as_u64().unwrap())
        .sum();
    assert_eq!(total, found["points"].as_u64().unwrap());
    let grid: Vec<_> = numbers(&found["grid"]);
    assert_eq!(grid.iter().product::<f64>(), total as f64);
    assert_eq!(found["verdicts"]["feasible"], found["feasible"]);
    let share = found["feasible"].as_f64().unwrap() / total as f64;
    let extent = vector(&found["box_m"][1]) - vector(&found["box_m"][0]);
    assert!((found["volume_m3"].as_f64().unwrap() - share * extent.product()).abs() < 1e-12);
    for key in ["below_minimum", "above_maximum", "no_path"] {
        let rows = found["limiting"].as_array().unwrap();
        let sum: u64 = rows.iter().map(|row| row[key].as_u64().unwrap()).sum();
        assert_eq!(sum, found["verdicts"][key].as_u64().unwrap(), "{key}");
    }
    let slice = &found["slices"][0];
    let points = points(slice["csv"].as_str().unwrap());
    assert_eq!(points.len() as u64, slice["points"].as_u64().unwrap());
    let feasible = points
        .iter()
        .filter(|(_, verdict)| verdict == "feasible")
        .count();
    assert_eq!(feasible as u64, slice["feasible"].as_u64().unwrap());
    let svg = std::fs::read_to_string(slice["plot"].as_str().unwrap()).unwrap();
    assert!(
        svg.contains(&format!("feasible ({feasible})")),
        "the legend counts"
    );
    assert!(
        0 < feasible && feasible < points.len(),
        "a slice with an edge in it"
    );
    (found, points)
}

#[test]
fn the_equilibrium_workspace_is_where_statics_says_so() {
    for rule in ["--setpoint", "--tension=4=10", "as planned"] {
        equilibria(rule);
    }
}

fn equilibria(rule: &str) {
    let planned = rule == "as planned";
    let mut words = vec!["--step", "25", "--slice", "z=-180"];
    words.extend((!planned).then_some(rule));
    let (found, points) = sliced("equilibrium", &words);
    assert_eq!(
        (&found["test"], &found["places_of"]),
        (&json!("equilibrium"), &json!("tool"))
    );
    let lines: String = points
        .iter()
        .map(|(at, _)| {
            let mut line = json!({"position_m": at.as_slice()});
            if !planned {
                line["tensions_n"] = json!({"4": 10.0});
            }
            format!("{line}\n")
        })
        .collect();
    let output = run(&["statics", "--tool", "--batch"], &lines);
    let limits = Robot::built_in("paper-table5").unwrap().limits;
    let rests = text(&output.stdout);
    assert_eq!(rests.lines().count(), points.len());
    for ((at, verdict), rest) in points.iter().zip(rests.lines()) {
        let rest: Value = serde_json::from_str(rest).unwrap();
        let feasible = rest.get("error").is_none() && rest["stable"] == true && {
            let tilt = rotation(&rest["attitude_rad"]).matrix().m33.acos();
            let within = limits.tension_min_n..=limits.tension_max_n;
            tilt <= limits.tilt_max_rad
                && numbers(&rest["tensions_n"])
                    .iter()
                    .all(|t| within.contains(t))
        };
        assert_eq!(
            verdict == "feasible",
            feasible,
            "{rule}: {at} {verdict} {rest}"
        );
    }
}

#[test]
fn places_are_feasible_that_a_plan_can_reach() {
    // The constant set-point excludes most of a wide frame, the tension that plans choose little.
    let folder = Folder::new("wide");
    let file = folder.0.join("wide.toml").display().to_string();
    let frame = ["--frame-mm", "2000", "3000", "2000", "--mass-kg", "4"];
    let init = run(&[&["config", "init", &file], &frame[..]].concat(), "");
    assert!(init.status.success());
    let share = |more: &[&str]| {
        let words = ["--robot", &file, "workspace", "--step", "100"];
        let found = answer(&[&words[..], more].concat());
        found["feasible_fraction"].as_f64().unwrap()
    };
    let (planned, setpoint) = (share(&[]), share(&["--setpoint"]));
    println!("{planned:.3} as planned, {setpoint:.3} at the set-point");
    assert!(planned > 0.5 && planned > setpoint, "{planned} {setpoint}");
    // The same as `config check` says, which judges fewer places.
    let checked = answer(&["config", "check", &file]);
    let said = checked["physics"]["share"].as_f64().unwrap();
    assert!((said - planned).abs() < 0.15, "{said} {planned}");
}

#[test]
fn the_force_workspace_is_where_some_tension_of_cable_four_balances() {
    let (_, points) = sliced(
        "forces",
        &[
            "--test", "forces", "--origin", "--step", "30", "--slice", "z=-100",
        ],
    );
    let robot = Robot::built_in("paper-table5").unwrap();
    let (least, most) = (robot.limits.tension_min_n, robot.limits.tension_max_n);
    let lines: Vec<_> = points
        .iter()
        .map(|(at, _)| json!({"position_m": at.as_slice()}))
        .collect();
    let load = Vector3::z() * robot.platform.mass_kg * 9.80665;
    let mut checked = 0;
    for ((at, verdict), inverse) in points.iter().zip(batch(&["ik"], &lines)) {
        let t: Vec<_> = inverse["directions"]
            .as_array()
            .unwrap()
            .iter()
            .map(vector)
            .collect();
        let three = Matrix3::from_columns(&[-t[0], -t[1], -t[2]])
            .try_inverse()
            .unwrap();
        // How far the worst tension is inside its limits, at the best tension of cable 4.
        let inside = (0..=2000)
            .map(|k| {
                let fourth = least + (most - least) * f64::from(k) / 2000.0;
                let others = three * (load + t[3] * fourth);
                others
                    .iter()
                    .map(|x| (x - least).min(most - x))
                    .fold(f64::MAX, f64::min)
            })
            .fold(f64::MIN, f64::max);
        // At the edge the scan is too coarse to tell.
        if inside.abs() > 0.1 {
            checked += 1;
            assert_eq!(
                verdict == "feasible",
                inside > 0.0,
                "{at} {verdict} {inside}"
            );
        }
    }
    assert!(
        checked * 10 > points.len() * 8,
        "{checked} of {}",
        points.len()
    );
}

#[test]
fn clearance_takes_places_away() {
    let feasible = |more: &[&str]| {
        let words = ["--robot", "eight-cable", "workspace", "--step", "75"];
        let found = answer(&[&words[..], more].concat());
        (
            found["feasible"].as_u64().unwrap(),
            found["cables_near"].as_array().unwrap().len(),
        )
    };
    let (all, pairs) = feasible(&[]);
    assert_eq!(pairs, 0);
    assert_eq!(feasible(&["--clearance", "0"]), (all, 0));
    let (some, pairs) = feasible(&["--clearance", "120"]);
    assert!(
        0 < some && some < all && pairs > 0,
        "{some} of {all}, {pairs} pairs"
    );
    // A body that reaches out to the cables leaves less than the cables alone.
    let (fewer, _) = feasible(&["--clearance", "120", "--body", "600", "600", "600"]);
    assert!(fewer < some, "{fewer} {some}");
}
