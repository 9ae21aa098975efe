use super::*;
use crate::robot::Robot;
use std::f64::consts::TAU;

/// Sixty readings, 50 ms apart, of four cables at 10 N; `change` adds to cable 2.
fn looks(change: impl Fn(f64) -> f64) -> Looks {
    let row = |number: u32| {
        let time_s = f64::from(number) * 0.05;
        // Noise of 0.05 N: alternating, so that no random number is needed.
        let noise_n = if number.is_multiple_of(2) {
            0.05
        } else {
            -0.05
        };
        vec![
            10.0 + noise_n,
            10.0 + noise_n + change(time_s),
            10.0 - noise_n,
            10.0,
        ]
    };
    Looks {
        tensions_n: (0..60).map(row).collect(),
        pictures: Vec::new(),
    }
}

/// Thirty pictures of a tag of `edge_m`, its corners moved by `shift_px`; `seen` says in which it is.
fn pictures(shift_px: impl Fn(f64) -> f64, seen: impl Fn(u32) -> bool) -> Vec<Vec<TagView>> {
    let picture = |number: u32| {
        let shift = shift_px(f64::from(number) * 0.1);
        let corners = [
            [100.0, 100.0],
            [200.0, 100.0],
            [200.0, 200.0],
            [100.0, 200.0],
        ];
        let view = TagView {
            id: Robot::built_in("lab-fast").unwrap().tags[0].id,
            corners_px: corners.map(|[u, v]| [u + shift, v]),
            covariance_px2: [[[0.01, 0.0], [0.0, 0.01]]; 4],
            image_time_us: 0,
        };
        if seen(number) { vec![view] } else { Vec::new() }
    };
    (0..30).map(picture).collect()
}

#[test]
fn a_platform_at_rest_is_still_and_no_cable_is_slack() {
    let robot = Robot::built_in("lab-fast").unwrap();
    let rest = looks(|_| 0.0).rest(&robot);
    assert!(rest.is_still(), "{rest:?}");
    assert_eq!((rest.slack(), rest.drift()), (None, None));
    assert!(
        rest.tension_errors_n.iter().all(|error| *error < 0.03),
        "{rest:?}"
    );
}

#[test]
fn a_slack_cable_is_named_within_its_sensors_uncertainty() {
    let robot = Robot::built_in("lab-fast").unwrap();
    let slack = looks(|_| -9.7).rest(&robot).slack().unwrap();
    assert!(
        slack.cable == 1 && slack.always && slack.tension_n < 0.4,
        "{slack:?}"
    );
    assert_eq!(looks(|_| -8.5).rest(&robot).slack(), None);
}

#[test]
fn a_cable_that_goes_slack_in_a_swing_is_found_although_its_mean_is_not() {
    let robot = Robot::built_in("lab-fast").unwrap();
    let slack = looks(|time_s| -6.0 + 4.0 * (TAU * 1.3 * time_s).sin());
    let slack = slack.rest(&robot).slack().unwrap();
    assert!(slack.cable == 1 && !slack.always, "{slack:?}");
}

#[test]
fn a_swing_is_no_rest_and_widens_the_error_of_the_mean() {
    let robot = Robot::built_in("lab-fast").unwrap();
    let rest = looks(|time_s| (TAU * 1.3 * time_s).sin()).rest(&robot);
    assert!(!rest.is_still() && rest.drift().is_none(), "{rest:?}");
    assert!((rest.swing_n[1] - 2.0).abs() < 0.1, "{rest:?}");
    // Four periods in the window: little is left of them, but more than of the noise.
    assert!(
        rest.tension_errors_n[1] > 2.0 * rest.tension_errors_n[0],
        "{rest:?}"
    );
    // Three quarters of one: the mean is off, and its error states that.
    let slow = looks(|time_s| (TAU * 0.25 * time_s).sin()).rest(&robot);
    let off_n = (slow.tensions_n[1] - 10.0).abs();
    assert!(
        off_n > 0.2 && slow.tension_errors_n[1] > 0.5 * off_n,
        "{slow:?}"
    );
}

#[test]
fn a_brake_that_slips_is_a_drift() {
    let robot = Robot::built_in("lab-fast").unwrap();
    let rest = looks(|time_s| -0.3 * time_s).rest(&robot);
    let words = rest.drift().unwrap();
    assert!(
        words.starts_with("tension 2") && !rest.is_still(),
        "{words}"
    );
}

#[test]
fn a_swing_of_the_picture_is_measured_at_the_tag() {
    let robot = Robot::built_in("lab-fast").unwrap();
    let mut looks = looks(|_| 0.0);
    looks.pictures = pictures(|time_s| 5.0 * (TAU * 1.3 * time_s).sin(), |_| true);
    let rest = looks.rest(&robot);
    // 10 px peak to peak, where the tag's edge is 100 px.
    let expected_m = robot.tags[0].size_m * 0.1;
    let swing_m = rest.swing_m.unwrap();
    assert!((swing_m / expected_m - 1.0).abs() < 0.05, "{swing_m} m");
    assert!(!rest.is_still() && rest.drift().is_none(), "{rest:?}");
    looks.pictures = pictures(|time_s| 20.0 * time_s, |_| true);
    let words = looks.rest(&robot).drift().unwrap();
    assert!(words.contains("still moves"), "{words}");
}

#[test]
fn a_tag_that_leaves_the_picture_in_a_swing_does_not_count() {
    let mut looks = looks(|_| 0.0);
    looks.pictures = pictures(|_| 0.0, |number| number % 5 != 0);
    assert!(looks.steady_views().is_empty() && looks.lost_tag());
    looks.pictures = pictures(|_| 0.0, |number| number != 7);
    assert_eq!(looks.steady_views().len(), 29);
    assert!(!looks.lost_tag());
}
