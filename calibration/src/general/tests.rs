//! What is read from files, and what is said of what cannot be used.

use super::Set;
use super::fit::Options;
use super::simulate::{Case, simulate};
use super::study::study;

fn case(seed: u64) -> Case {
    Case {
        seed,
        ..Case::default()
    }
}

#[test]
fn version_2_is_read_back_and_a_reading_that_is_no_number_is_named() {
    let (set, _) = simulate(&case(5)).unwrap();
    let text = serde_json::to_string(&set.to_json()).unwrap();
    let back = Set::from_json(&text).unwrap();
    assert_eq!(back.samples.len(), set.samples.len());
    let near = |a: &[Option<f64>], b: &[Option<f64>]| {
        a.iter()
            .zip(b)
            .all(|(a, b)| (a.unwrap() - b.unwrap()).abs() < 1e-12)
    };
    assert!(near(&back.samples[7].length_m, &set.samples[7].length_m));
    let mut value = set.to_json();
    value["samples"][2]["tension_N"][1] = serde_json::json!("here");
    let text = serde_json::to_string(&value)
        .unwrap()
        .replace("\"here\"", "NaN");
    let back = Set::from_json(&text).unwrap();
    assert_eq!(back.samples[2].tension_n[1], None);
    assert_eq!(
        back.notes,
        ["sample 3: cable 2's tension is not a finite number: left out"]
    );
}

#[test]
fn the_layout_of_other_laboratories_is_read() {
    let text = r#"{"robot": {"name": "r", "platform": {"mass_kg": 3, "center_of_mass_m": [0, 0, 0.1]},
        "pulley_radius_m": 0.02, "anchors_m": [[1, 0, 2], [-1, 1, 2], [-1, -1, 2]],
        "swivel_axes": [[1, 0, 0], [-1, 0, 0], [-1, 0, 0]],
        "attachments_m": [[0.1, 0, 0], [-0.1, 0.1, 0], [-0.1, -0.1, 0]]},
        "samples": [{"log": "a", "t_s": 1, "lengths_m": [1, 1.5, null], "speed_mps": [0, -0.2, 0]},
                    {"log": "b", "ahrs_rad": [0.1, 0.2, 0.3]}]}"#;
    let set = Set::from_json(text).unwrap();
    assert_eq!(set.sessions, ["a", "b"]);
    assert!(set.robot.absolute);
    assert_eq!(set.samples[0].length_m, [Some(1.0), Some(1.5), None]);
    assert_eq!(set.samples[0].speed_mps, Some(0.2));
    assert_eq!(set.samples[1].rpy_rad, [Some(0.1), Some(0.2), Some(0.3)]);
    let still = super::verdict::without_moving(&set);
    assert_eq!(still.samples.len(), 1);
    assert_eq!(
        still.notes,
        ["sample 1 of a (1.0 s): a cable moved at 200 mm/s: left out"]
    );
    let error = study(&set, "c", &Options::default()).unwrap_err();
    assert_eq!(error, "there is no session c in the data; there are a, b");
}
