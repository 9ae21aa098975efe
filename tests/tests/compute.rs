//! `mcdpr ik`, `fk`, `statics`, `workspace`: the real program against independent arithmetic.

use mcdpr::robot::Robot;
use mcdpr_tests::mcdpr;
use nalgebra::{Matrix3, Rotation3, Vector3};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Output, Stdio};
use std::time::Duration;

/// Runs the program with words and lines on its standard input.
fn run(words: &[&str], input: &str) -> Output {
    let mut child = mcdpr()
        .args(words)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let input = input.to_owned();
    // From a thread of its own: the program answers while it still reads.
    let writer = std::thread::spawn(move || stdin.write_all(input.as_bytes()));
    let output = child.wait_with_output().unwrap();
    // A program that refuses its arguments reads nothing: then the pipe is broken, which is fine.
    let _ = writer.join().unwrap();
    output
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// The one JSON document of a command that succeeds.
fn answer(words: &[&str]) -> Value {
    let output = run(&[words, &["--json"]].concat(), "");
    assert!(
        output.status.success(),
        "{words:?}: {}",
        text(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).unwrap()
}

/// The refusal of a command: exit code 1, a document with the error, the same on standard error.
fn refusal(words: &[&str]) -> String {
    let output = run(&[words, &["--json"]].concat(), "");
    assert_eq!(
        output.status.code(),
        Some(1),
        "{words:?}: {}",
        text(&output.stdout)
    );
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(document.as_object().unwrap().len(), 1, "{document}");
    assert!(!output.stderr.is_empty());
    document["error"].as_str().unwrap().to_owned()
}

/// Results of a batch in which every line succeeds.
fn batch(words: &[&str], lines: &[Value]) -> Vec<Value> {
    let input: String = lines.iter().map(|line| format!("{line}\n")).collect();
    let output = run(&[words, &["--batch"]].concat(), &input);
    let results: Vec<Value> = text(&output.stdout)
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(results.len(), lines.len(), "{}", text(&output.stderr));
    assert!(
        output.status.success(),
        "{:?}",
        results.iter().find(|result| result.get("error").is_some())
    );
    results
}

fn numbers(value: &Value) -> Vec<f64> {
    let list = value
        .as_array()
        .unwrap_or_else(|| panic!("no list: {value}"));
    list.iter().map(|x| x.as_f64().unwrap()).collect()
}

fn vector(value: &Value) -> Vector3<f64> {
    Vector3::from_column_slice(&numbers(value))
}

fn rotation(attitude_rad: &Value) -> Rotation3<f64> {
    let [rx, ry, rz] = numbers(attitude_rad)[..] else {
        panic!("three angles: {attitude_rad}");
    };
    Rotation3::from_axis_angle(&Vector3::z_axis(), rz)
        * Rotation3::from_axis_angle(&Vector3::y_axis(), ry)
        * Rotation3::from_axis_angle(&Vector3::x_axis(), rx)
}

/// Numbers in 0..1, the same in every run.
struct Seeded(u64);

impl Seeded {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

/// Poses in the middle of a robot's box, tilted up to `angle`.
fn poses(robot: &str, count: usize, angle: f64) -> Vec<Value> {
    let [low, high] = Robot::find(robot).unwrap().search_box_in_world_m();
    // The box's top may lie between the pulleys.
    let (low, high) = (low.lerp(&high, 0.2), low.lerp(&high, 0.8));
    let mut seeded = Seeded(11);
    (0..count)
        .map(|_| {
            let at = low.zip_map(&high, |a, b| seeded.between(a, b));
            let turned: Vec<_> = (0..3).map(|_| seeded.between(-angle, angle)).collect();
            json!({"position_m": at.as_slice(), "attitude_rad": turned})
        })
        .collect()
}

const SPATIAL: [&str; 5] = [
    "paper-table5",
    "paper-table3",
    "lab-fast",
    "point-anchor",
    "eight-cable",
];

#[test]
fn lengths_lead_back_to_the_pose() {
    for robot in SPATIAL {
        let poses = poses(robot, 400, 0.2);
        let inverse = batch(&["--robot", robot, "ik"], &poses);
        let with = |attitude: &dyn Fn(&Value) -> Value| -> Vec<Value> {
            let pairs = poses.iter().zip(&inverse);
            pairs
                .map(|(pose, found)| {
                    json!({
                        "lengths_m": found["lengths_m"],
                        "attitude_rad": attitude(&pose["attitude_rad"]),
                    })
                })
                .collect()
        };
        let close = |found: &[Value], attitude_too: bool| {
            for (pose, found) in poses.iter().zip(found) {
                let miss = (vector(&found["position_m"]) - vector(&pose["position_m"])).norm();
                assert!(miss < 1e-10, "{robot}: {miss} {pose} {found}");
                assert!(found["residual_m"].as_f64().unwrap() < 1e-10);
                assert!(found["iterations"].as_u64().unwrap() > 0);
                let attitude = found.get("attitude_rad");
                assert_eq!(attitude.is_some(), attitude_too, "{found}");
                if let Some(attitude) = attitude {
                    let [got, want] = [attitude, &pose["attitude_rad"]].map(rotation);
                    let turn = (got.matrix() - want.matrix()).norm();
                    assert!(turn < 1e-9, "{robot}: {turn} {pose} {found}");
                }
            }
        };
        close(
            &batch(&["--robot", robot, "fk"], &with(&Value::clone)),
            false,
        );
        // Roll and pitch are kept; a yaw of zero is only where the search begins.
        let without_yaw = with(&|attitude| json!([attitude[0], attitude[1], 0.0]));
        close(
            &batch(&["--robot", robot, "fk", "--free", "yaw"], &without_yaw),
            true,
        );
        if robot == "eight-cable" {
            let lengths: Vec<_> = inverse
                .iter()
                .map(|found| json!({"lengths_m": found["lengths_m"]}))
                .collect();
            close(&batch(&["--robot", robot, "fk"], &lengths), true);
            close(
                &batch(&["--robot", robot, "fk", "--free", "all"], &lengths),
                true,
            );
        }
    }
}

#[test]
fn the_jacobian_is_the_derivative_of_the_lengths() {
    let step = 1e-6;
    for robot in ["paper-table5", "eight-cable", "planar-four"] {
        let poses = if robot == "planar-four" {
            vec![json!({"position_m": [0.1, 0.0, 0.6], "attitude_rad": [0.1, -0.2, 0.3]})]
        } else {
            poses(robot, 5, 0.3)
        };
        for (kind, pose) in ["twist", "euler"]
            .iter()
            .flat_map(|k| poses.iter().map(move |p| (k, p)))
        {
            let mut lines = vec![pose.clone()];
            for column in 0..6 {
                for sign in [1.0, -1.0] {
                    let mut moved = pose.clone();
                    let change = sign * step;
                    if column < 3 {
                        let at = &mut moved["position_m"][column];
                        *at = json!(at.as_f64().unwrap() + change);
                    } else if *kind == "euler" {
                        let angle = &mut moved["attitude_rad"][column - 3];
                        *angle = json!(angle.as_f64().unwrap() + change);
                    } else {
                        let axis = Vector3::ith_axis(column - 3);
                        let turned = Rotation3::from_axis_angle(&axis, change)
                            * rotation(&pose["attitude_rad"]);
                        let (rx, ry, rz) = turned.euler_angles();
                        moved["attitude_rad"] = json!([rx, ry, rz]);
                    }
                    lines.push(moved);
                }
            }
            let found = batch(&["--robot", robot, "ik", "--jacobian", kind], &lines);
            let lengths: Vec<_> = found.iter().map(|f| numbers(&f["lengths_m"])).collect();
            for (cable, row) in found[0]["jacobian"].as_array().unwrap().iter().enumerate() {
                for (column, got) in numbers(row).into_iter().enumerate() {
                    let (plus, minus) = (&lengths[1 + 2 * column], &lengths[2 + 2 * column]);
                    let want = (plus[cable] - minus[cable]) / (2.0 * step);
                    assert!(
                        (got - want).abs() < 1e-7,
                        "{robot} {kind} {cable} {column}: {got} {want}"
                    );
                }
            }
        }
    }
}

#[test]
fn hanging_poses_balance_and_come_back_from_their_lengths() {
    for robot in ["paper-table5", "lab-fast", "point-anchor"] {
        let description = Robot::find(robot).unwrap();
        let mut seeded = Seeded(3);
        let places: Vec<_> = (0..200)
            .map(|_| {
                let mut at = || seeded.between(-0.03, 0.03);
                let place = [0.33 + at(), at(), -0.2 + at()];
                json!({"position_m": place, "tensions_n": {"4": 10.0 + 30.0 * at()}})
            })
            .collect();
        let rest = batch(&["--robot", robot, "statics"], &places);
        let poses: Vec<_> = places
            .iter()
            .zip(&rest)
            .map(|(place, rest)| {
                json!({"position_m": place["position_m"], "attitude_rad": rest["attitude_rad"]})
            })
            .collect();
        let inverse = batch(&["--robot", robot, "ik"], &poses);
        let weight_n = description.platform.mass_kg * 9.80665;
        for ((place, rest), inverse) in places.iter().zip(&rest).zip(&inverse) {
            let turned = rotation(&rest["attitude_rad"]);
            let gravity = Vector3::z() * -weight_n;
            let mut force = gravity;
            let mut moment = (turned * description.platform.center_of_mass_m).cross(&gravity);
            let tensions = numbers(&rest["tensions_n"]);
            assert_eq!(rest["tensions_n"][3], place["tensions_n"]["4"]);
            for (cable, direction) in inverse["directions"].as_array().unwrap().iter().enumerate() {
                let pull = -vector(direction) * tensions[cable];
                force += pull;
                moment +=
                    (turned * description.cables[cable].attachment_in_platform_m).cross(&pull);
            }
            assert!(
                force.norm() < 1e-8 && moment.norm() < 1e-9,
                "{place} {rest}"
            );
            assert_eq!(rest["stable"], true);
            let modes = numbers(&rest["modes_hz"]);
            assert!(
                modes.len() == 3 && modes.iter().all(|f| (0.5..20.0).contains(f)),
                "{modes:?}"
            );
        }
        // Lengths with a gap, and with the tension-held cable left out.
        for gap in [true, false] {
            let lines: Vec<_> = places
                .iter()
                .zip(&rest)
                .map(|(place, rest)| {
                    let mut lengths = rest["lengths_m"].as_array().unwrap()[..3].to_vec();
                    if gap {
                        lengths.push(Value::Null);
                    }
                    json!({"lengths_m": lengths, "tensions_n": place["tensions_n"]})
                })
                .collect();
            let found = batch(&["--robot", robot, "fk", "--static"], &lines);
            for ((place, rest), found) in places.iter().zip(&rest).zip(&found) {
                let miss = (vector(&found["position_m"]) - vector(&place["position_m"])).norm();
                assert!(miss < 1e-9, "{miss}: {place} {found}");
                assert_eq!(found["slack"], json!([]));
                assert_eq!(found["stable"], true);
                for key in ["tensions_n", "lengths_m", "attitude_rad", "modes_hz"] {
                    for (a, b) in numbers(&found[key]).into_iter().zip(numbers(&rest[key])) {
                        assert!((a - b).abs() < 1e-5, "{key}: {found} {rest}");
                    }
                }
            }
        }
    }
}

#[test]
fn a_cable_paid_out_too_far_is_slack() {
    let rest = answer(&["fk", "470", "470", "470", "600", "--static"]);
    assert_eq!(rest["slack"], json!([4]));
    assert_eq!(rest["tensions_n"][3], 0.0);
    assert!(rest["lengths_m"][3].as_f64().unwrap() < 0.6);
}

#[test]
fn eight_cables_share_the_load_within_their_limits() {
    let robot = Robot::find("eight-cable").unwrap();
    let found = answer(&[
        "--robot",
        "eight-cable",
        "statics",
        "100",
        "-50",
        "700",
        "--attitude",
        "3",
        "-4",
        "5",
    ]);
    let tensions = numbers(&found["tensions_n"]);
    let limits = robot.limits.tension_min_n..=robot.limits.tension_max_n;
    assert!(tensions.iter().all(|t| limits.contains(t)), "{tensions:?}");
    let inverse = answer(&[
        "--robot",
        "eight-cable",
        "ik",
        "100",
        "-50",
        "700",
        "3",
        "-4",
        "5",
    ]);
    assert_eq!(found["lengths_m"], inverse["lengths_m"]);
    let directions = inverse["directions"].as_array().unwrap();
    let pull: Vector3<f64> = directions
        .iter()
        .zip(&tensions)
        .map(|(d, t)| -vector(d) * *t)
        .sum();
    let lift = Vector3::z() * robot.platform.mass_kg * 9.80665;
    assert!((pull - lift).norm() < 1e-8, "{pull}");
    assert_eq!(numbers(&found["modes_hz"]).len(), 6);
    let pinned = answer(&[
        "--robot",
        "eight-cable",
        "statics",
        "0",
        "0",
        "700",
        "--tension",
        "5=60",
        "--tension",
        "6=0.06kN",
    ]);
    assert_eq!(
        (&pinned["tensions_n"][4], &pinned["tensions_n"][5]),
        (&json!(60.0), &json!(60.0))
    );
}

#[test]
fn units_mean_the_same_place() {
    let millimetres = answer(&["ik", "335", "-10", "-200", "3", "-2", "90"]);
    for words in [
        ["0.335m", "-1cm", "-0.2m", "3deg", "-2deg", "90deg"],
        [
            "33.5cm",
            "-10mm",
            "-200000um",
            "3",
            "-2 deg",
            "1.5707963267948966rad",
        ],
    ] {
        let other = answer(&[&["ik"], &words[..]].concat());
        for key in ["lengths_m", "wrap_rad"] {
            for (a, b) in numbers(&millimetres[key])
                .into_iter()
                .zip(numbers(&other[key]))
            {
                assert!((a - b).abs() < 1e-14, "{words:?}");
            }
        }
    }
    // The tool of this robot is 80 mm below the origin.
    assert_eq!(
        answer(&["ik", "300", "0", "-200"]),
        answer(&["ik", "300", "0", "-280", "--tool"])
    );
}

#[test]
fn bad_input_is_refused_with_what_and_where() {
    let cases: &[(&[&str], &str)] = &[
        (&["ik", "nan", "0", "0"], "`nan` is no length"),
        (&["ik", "1", "2", "3deg"], "`deg` is no unit of a length"),
        (&["ik", "300", "0", "-200", "5"], "3 angles needed"),
        // The attachment of cable 1 in the middle of its pulley: see the robot file.
        (&["ik", "80", "-305", "24"], "cable 1"),
        (&["fk", "400", "400", "400"], "4 needed"),
        (
            &["fk", "400", "400", "400", "-400"],
            "cable 4: the length must be positive",
        ),
        (&["fk", "400", "400", "400", "900"], "misses the lengths"),
        (
            &["fk", "400", "400", "400", "400", "--free", "all"],
            "six are needed",
        ),
        (&["fk", "400", "400", "400", "--static"], "4"),
        (
            &[
                "fk",
                "400",
                "400",
                "400",
                "400",
                "--static",
                "--tension",
                "4=10",
            ],
            "cable 4: both",
        ),
        (
            &["fk", "400", "_", "400", "400", "--static"],
            "cable 2: neither",
        ),
        (
            &["fk", "400", "400", "400", "--static", "--tension", "9=10"],
            "cables 1 to 4",
        ),
        (
            &[
                "fk",
                "400",
                "400",
                "--static",
                "--tension",
                "4=1",
                "--tension",
                "4=2",
            ],
            "twice",
        ),
        (&["statics", "0", "0", "100"], "cannot push"),
        (
            &["statics", "300", "0", "-200", "--tension", "4:10"],
            "CABLE=FORCE",
        ),
        (
            &[
                "statics",
                "300",
                "0",
                "-200",
                "--tension",
                "3=5",
                "--tension",
                "4=5",
            ],
            "exactly three",
        ),
        (
            &["statics", "300", "0", "-200", "--attitude", "0", "0", "0"],
            "leave it out",
        ),
        (&["workspace", "--step", "0"], "--step"),
        (&["workspace", "--slice", "w=3"], "--slice w=3"),
        (&["workspace", "--clearance", "-1"], "must not be negative"),
        (
            &["ik", "1", "2", "3", "--robot", "no-such-robot"],
            "no-such-robot",
        ),
    ];
    for (words, part) in cases {
        let message = refusal(words);
        assert!(message.contains(part), "{words:?}: {message}");
    }
}

#[test]
fn a_planar_robot_says_what_it_can_not_do() {
    let robot = ["--robot", "planar-four"];
    let lengths = answer(&[&robot[..], &["ik", "100", "0", "600"]].concat());
    // Radius 10 mm at (-1000, 0, 1200): a point anchor there is within pi times the radius.
    let straight = f64::hypot(1.1, 0.6);
    assert!((lengths["lengths_m"][0].as_f64().unwrap() - straight).abs() < 0.0315);
    for words in [
        &["statics", "0", "0", "600"][..],
        &["fk", "1253", "1082", "1082", "1253"],
        &["fk", "1253", "1082", "1082", "1253", "--static"],
        &["workspace"],
    ] {
        let message = refusal(&[&robot[..], words].concat());
        assert!(
            message.contains("planar") && message.contains("mcdpr ik"),
            "{message}"
        );
    }
}

#[test]
fn a_batch_goes_on_after_bad_lines() {
    let good = r#"{"position_m":[0.33,0,-0.2],"attitude_rad":[0,0,0]}"#;
    let lines = [
        good,
        "{not json",
        r#"{"position_m":[0.33,0,-0.2],"attitude_deg":[0,0,0]}"#,
        r#"{"attitude_rad":[0,0,0]}"#,
        r#"{"position_m":[0.33,0]}"#,
        r#"{"position_m":[NaN,0,0]}"#,
        r#"{"position_m":[1e999,0,0]}"#,
        r#"{"position_m":[1e300,0,0]}"#,
        "",
        "[[0.33,0,-0.2],[0,0,0]]",
        good,
    ];
    let output = run(&["ik", "--batch"], &(lines.join("\n") + "\n"));
    assert_eq!(output.status.code(), Some(1));
    let results: Vec<Value> = text(&output.stdout)
        .lines()
        .map(|l| serde_json::from_str(l).unwrap())
        .collect();
    assert_eq!(results.len(), lines.len());
    for (index, result) in results.iter().enumerate() {
        if lines[index] == good {
            assert_eq!(result, &results[0]);
            assert_eq!(result["lengths_m"].as_array().unwrap().len(), 4);
        } else {
            assert_eq!(result["line"], json!(index + 1), "{result}");
            assert!(result["error"].is_string() && result.as_object().unwrap().len() == 2);
        }
    }
    assert!(
        results[2]["error"]
            .as_str()
            .unwrap()
            .contains("`attitude_deg`")
    );
    assert!(
        results[3]["error"]
            .as_str()
            .unwrap()
            .contains("`position_m`")
    );
    assert!(
        text(&output.stderr).contains("9 of 11 lines failed"),
        "{}",
        text(&output.stderr)
    );

    let lines = concat!(
        "{\"lengths_m\":[0.4,0.41,0.42],\"tensions_n\":{\"4\":10}}\n",
        "{\"lengths_m\":[0.4,0.41,0.42],\"tensions_n\":{\"7\":10}}\n",
        "{\"lengths_m\":[0.4,0.41,0.42],\"tensions_n\":{\"x\":10}}\n",
        "{\"lengths_m\":[0.4,0.41,0.42],\"tensions_n\":{\"4\":-10}}\n",
        "{\"lengths_m\":[0.4,0.41]}",
    );
    let output = run(&["fk", "--static", "--batch"], lines);
    let results: Vec<Value> = text(&output.stdout)
        .lines()
        .map(|l| serde_json::from_str(l).unwrap())
        .collect();
    let words = ["", "cable 7", "`x`", "cable 4", "2 given"];
    assert_eq!(results.len(), words.len());
    assert!(results[0].get("error").is_none());
    for (result, word) in results.iter().zip(words).skip(1) {
        assert!(result["error"].as_str().unwrap().contains(word), "{result}");
    }
}

#[test]
fn each_line_is_answered_before_the_next_is_asked() {
    let mut child = mcdpr()
        .args(["ik", "--batch"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let stdout = child.stdout.take().unwrap();
    let (sender, receiver) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        for line in BufReader::new(stdout).lines() {
            if sender.send(line.unwrap()).is_err() {
                return;
            }
        }
    });
    for _ in 0..3 {
        stdin
            .write_all(b"{\"position_m\":[0.33,0,-0.2]}\n")
            .unwrap();
        let line = receiver.recv_timeout(Duration::from_secs(30)).unwrap();
        assert!(line.starts_with("{\"lengths_m\":["), "{line}");
    }
    drop(stdin);
    assert!(child.wait().unwrap().success());
}

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
    let svg = std::fs::read_to_string(slice["svg"].as_str().unwrap()).unwrap();
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
    let (found, points) = sliced("equilibrium", &["--step", "25", "--slice", "z=-180"]);
    assert_eq!(
        (&found["test"], &found["places_of"]),
        (&json!("equilibrium"), &json!("tool"))
    );
    let lines: String = points
        .iter()
        .map(|(at, _)| {
            format!(
                "{}\n",
                json!({"position_m": at.as_slice(), "tensions_n": {"4": 10.0}})
            )
        })
        .collect();
    let output = run(&["statics", "--tool", "--batch"], &lines);
    let limits = Robot::find("paper-table5").unwrap().limits;
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
        assert_eq!(verdict == "feasible", feasible, "{at} {verdict} {rest}");
    }
}

#[test]
fn the_force_workspace_is_where_some_tension_of_cable_four_balances() {
    let (_, points) = sliced(
        "forces",
        &[
            "--test", "forces", "--origin", "--step", "30", "--slice", "z=-100",
        ],
    );
    let robot = Robot::find("paper-table5").unwrap();
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
