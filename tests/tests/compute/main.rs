//! `mcdpr ik`, `fk`, `statics`, `workspace`: the real program against independent arithmetic.

mod refusals;
mod workspace;

use mcdpr::robot::Robot;
use mcdpr_tests::mcdpr;
use nalgebra::{Rotation3, Vector3};
use serde_json::{Value, json};
use std::io::Write;
use std::process::{Output, Stdio};

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
    let [low, high] = mcdpr::robot::find(robot).unwrap().search_box_in_world_m();
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
        let description = mcdpr::robot::find(robot).unwrap();
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
    let robot = Robot::built_in("eight-cable").unwrap();
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
fn corrections_to_the_length_are_reported_with_their_size() {
    let place = ["statics", "320", "0", "-200", "--tension", "4=10"];
    let plain = answer(&place);
    assert_eq!(plain["stretch_m"], Value::Null);
    let numbers = |document: &Value, key: &str| -> Vec<f64> {
        let list = document[key].as_array().unwrap();
        list.iter().map(|value| value.as_f64().unwrap()).collect()
    };
    let (lengths, tensions) = (numbers(&plain, "lengths_m"), numbers(&plain, "tensions_n"));
    let corrected = |kind: &str, weight: &str| {
        let more = ["--correct", kind, "--cable-g-per-m", weight];
        let document = answer(&[&place[..], &more].concat());
        assert_eq!(numbers(&document, "lengths_m"), lengths);
        let [out, stretch, sag] =
            ["unstretched_m", "stretch_m", "sag_m"].map(|key| numbers(&document, key));
        for cable in 0..4 {
            let sum = lengths[cable] - stretch[cable] + sag[cable];
            assert!(
                (out[cable] - sum).abs() < 1e-12,
                "{kind}, cable {}",
                cable + 1
            );
        }
        (stretch, sag)
    };
    let (stretch, sag) = corrected("stretch", "1");
    assert_eq!(sag, [0.0; 4]);
    for cable in 0..4 {
        // Hooke over cable and 0.7 m of routing, EA = 50 kN.
        let total = lengths[cable] + 0.7;
        let hooke = total - total / (1.0 + tensions[cable] / 50e3);
        assert!(
            (stretch[cable] - hooke).abs() < 1e-9,
            "{} {hooke}",
            stretch[cable]
        );
    }
    let (_, parabola) = corrected("parabola", "20");
    let (_, catenary) = corrected("catenary", "20");
    let (_, lighter) = corrected("catenary", "10");
    for cable in 0..4 {
        assert!(catenary[cable] > 0.0);
        // Both models agree while the cable's weight is far below its tension; sag grows with the
        // square of the weight.
        assert!(
            (parabola[cable] / catenary[cable] - 1.0).abs() < 0.1,
            "{parabola:?} {catenary:?}"
        );
        assert!(
            (catenary[cable] / lighter[cable] - 4.0).abs() < 0.2,
            "{catenary:?} {lighter:?}"
        );
    }
}
