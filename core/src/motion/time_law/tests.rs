//! The time law in all its degenerate forms, checked against differences, bounds and closed forms.

use super::*;

fn bounds(speed_mps: f64, acceleration_mps2: f64, jerk_mps3: f64) -> Bounds {
    Bounds {
        speed_mps,
        acceleration_mps2,
        jerk_mps3,
    }
}

/// Ends, limits, symmetry, and every derivative against differences of the one before.
fn check_law(law: &TimeLaw, b: Bounds, what: &str) {
    let duration = law.duration_s();
    let start = law.at(0.0);
    let end = law.at(duration);
    assert_eq!((start.position_m, start.velocity_mps), (0.0, 0.0), "{what}");
    assert_eq!((end.position_m, end.velocity_mps), (law.length_m(), 0.0));
    let near = |a: f64, b: f64, scale: f64, which: &str, t: f64| {
        assert!(
            (a - b).abs() < 1e-6 * scale,
            "{what} {which} at {t}: {a} {b}"
        );
    };
    let h = law.jerk_s * 1e-3;
    let phases = law.phase_times_s();
    let mut last = start;
    for step in 1..2000 {
        let t = duration * f64::from(step) / 2000.0;
        let here = law.at(t);
        let mirror = law.at(duration - t);
        assert!(here.velocity_mps <= b.speed_mps * (1.0 + 1e-9), "{what}");
        assert!(here.acceleration_mps2.abs() <= b.acceleration_mps2 * (1.0 + 1e-9));
        assert!(here.jerk_mps3.abs() <= b.jerk_mps3 * (1.0 + 1e-9), "{what}");
        assert!(
            here.position_m > last.position_m,
            "{what}: backwards at {t}"
        );
        last = here;
        let scale = law.length_m();
        near(
            here.position_m + mirror.position_m,
            scale,
            scale,
            "symmetry",
            t,
        );
        near(
            here.velocity_mps,
            mirror.velocity_mps,
            b.speed_mps,
            "symmetry",
            t,
        );
        if phases.iter().any(|phase| (t - phase).abs() < 2.0 * h) {
            continue;
        }
        let (early, late) = (t - h, t + h);
        let (before, after) = (law.at(early), law.at(late));
        // The times themselves are rounded: their own difference divides.
        let slope = |f: fn(&State) -> f64| (f(&after) - f(&before)) / (late - early);
        let (speed, acceleration) = (law.peak_speed_mps(), law.peak_acceleration_mps2());
        // A difference of positions keeps their rounding: two units in the last place.
        let rounding = 1e6 * 4.0 * f64::EPSILON * law.length_m() / (late - early);
        near(
            slope(|s| s.position_m),
            here.velocity_mps,
            speed + rounding,
            "velocity",
            t,
        );
        near(
            slope(|s| s.velocity_mps),
            here.acceleration_mps2,
            acceleration,
            "acc",
            t,
        );
        near(
            slope(|s| s.acceleration_mps2),
            here.jerk_mps3,
            law.peak_jerk_mps3(),
            "jerk",
            t,
        );
    }
    // Position, velocity and acceleration are continuous where the phases meet.
    for phase in phases {
        let step = law.jerk_s * 1e-9;
        let (before, after) = (law.at(phase - step), law.at(phase + step));
        near(
            before.position_m,
            after.position_m,
            law.length_m(),
            "join",
            phase,
        );
        near(
            before.velocity_mps,
            after.velocity_mps,
            law.peak_speed_mps(),
            "join",
            phase,
        );
        near(
            before.acceleration_mps2,
            after.acceleration_mps2,
            law.peak_acceleration_mps2(),
            "join",
            phase,
        );
    }
}

/// Lengths and bounds that reach every combination of vanishing phases.
const CASES: [(&str, f64, f64, f64, f64); 10] = [
    ("all seven phases", 1.0, 0.5, 1.0, 10.0),
    ("no cruise", 0.2, 5.0, 1.0, 10.0),
    ("no constant acceleration", 1.0, 0.05, 1.0, 10.0),
    ("jerk phases only", 0.001, 5.0, 1.0, 10.0),
    ("exactly no cruise", 2.0, 1.0, 1.0, 1.0),
    ("exactly no constant acceleration", 5.0, 1.0, 1.0, 1.0),
    ("the paper's robot", 0.408_407, 0.045, 0.2, 2.0),
    ("very long", 1e4, 0.5, 1.0, 10.0),
    ("very short", 1e-9, 0.5, 1.0, 10.0),
    ("a bound that never binds", 1.0, 1e12, 1e12, 10.0),
];

#[test]
fn fastest_laws_are_exact_smooth_and_within_the_bounds() {
    for (what, length, v, a, j) in CASES {
        let law = TimeLaw::fastest(length, bounds(v, a, j)).unwrap();
        check_law(&law, bounds(v, a, j), what);
    }
}

#[test]
fn the_cases_have_the_phases_they_are_named_for() {
    let law = |case: usize| {
        let (_, length, v, a, j) = CASES[case];
        TimeLaw::fastest(length, bounds(v, a, j)).unwrap()
    };
    let plateau = |law: &TimeLaw| law.rise_s - 2.0 * law.jerk_s;
    assert!(law(0).cruise_s() > 0.1 && plateau(&law(0)) > 0.1);
    assert!(law(1).cruise_s() < 1e-12 && plateau(&law(1)) > 0.1);
    assert!(law(2).cruise_s() > 0.1 && plateau(&law(2)).abs() < 1e-12);
    assert!(law(3).cruise_s() < 1e-12 && plateau(&law(3)).abs() < 1e-12);
    assert!(law(4).cruise_s() < 1e-12 && plateau(&law(4)).abs() < 1e-12);
    assert!((law(5).cruise_s() - 3.0).abs() < 1e-12 && plateau(&law(5)).abs() < 1e-12);
}

/// Least durations by hand: length / V + V / a + a / j with a cruise, and so on.
#[test]
fn least_durations_are_those_of_the_closed_forms() {
    let duration = |length, v, a, j| {
        TimeLaw::fastest(length, bounds(v, a, j))
            .unwrap()
            .duration_s()
    };
    assert!((duration(1.0, 0.5, 1.0, 10.0) - (2.0 + 0.5 + 0.1)).abs() < 1e-12);
    assert!((duration(5.0, 1.0, 1.0, 1.0) - 7.0).abs() < 1e-12);
    // Jerk only: four phases of (length / 2 j)^(1/3).
    let four = 4.0 * (0.001f64 / 20.0).cbrt();
    assert!((duration(0.001, 5.0, 1.0, 10.0) - four).abs() < 1e-12);
}

#[test]
fn no_time_law_within_the_bounds_is_faster() {
    // Each bound that binds, lowered a little, makes the motion longer; raised, shorter.
    for (what, length, v, a, j) in CASES {
        let b = bounds(v, a, j);
        let least = TimeLaw::fastest(length, b).unwrap().duration_s();
        let law = TimeLaw::fastest(length, b).unwrap();
        for (peak, bound, changed) in [
            (law.peak_speed_mps(), v, bounds(0.99 * v, a, j)),
            (law.peak_acceleration_mps2(), a, bounds(v, 0.99 * a, j)),
            (law.peak_jerk_mps3(), j, bounds(v, a, 0.99 * j)),
        ] {
            let slower = TimeLaw::fastest(length, changed).unwrap().duration_s();
            if (peak - bound).abs() < 1e-9 * bound {
                assert!(slower > least, "{what}: {slower} {least}");
            } else {
                assert!((slower - least).abs() < 1e-9 * least, "{what}");
            }
        }
    }
}

#[test]
fn fitted_laws_take_exactly_the_time_asked() {
    for (what, length, v, a, j) in CASES {
        let b = bounds(v, a, j);
        let least = TimeLaw::fastest(length, b).unwrap().duration_s();
        for factor in [1.0, 1.0001, 1.3, 2.0, 7.0, 100.0] {
            let wanted = least * factor;
            let law = TimeLaw::fit_duration(length, b, wanted).unwrap();
            let error = (law.duration_s() - wanted).abs();
            assert!(error <= 1e-12 * wanted, "{what} x{factor}: {error}");
            check_law(&law, b, what);
        }
    }
}

#[test]
fn an_impossible_duration_names_the_bound_in_the_way() {
    let refuse = |length, b, duration| match TimeLaw::fit_duration(length, b, duration) {
        Err(TimeLawError::TooShort { bound, least_s, .. }) => {
            let least = TimeLaw::fastest(length, b).unwrap().duration_s();
            assert_eq!(least, least_s);
            bound
        }
        other => panic!("{other:?}"),
    };
    // 1 m in 9 s at 0.1 m/s, with acceleration to spare.
    assert_eq!(refuse(1.0, bounds(0.1, 1e3, 1e5), 9.0), Bound::Speed);
    assert_eq!(refuse(1.0, bounds(1e3, 0.1, 1e5), 5.0), Bound::Acceleration);
    assert_eq!(refuse(1.0, bounds(1e3, 1e3, 1.0), 2.0), Bound::Jerk);
    assert_eq!(refuse(1.0, bounds(0.1, 0.1, 0.1), 0.5), Bound::Several);
    // The paper's circle in 9 s with the paper's drives.
    let paper = bounds(0.045, 0.2, 2.0);
    assert_eq!(refuse(0.408_407, paper, 9.0), Bound::Speed);
    let said = TimeLaw::fit_duration(0.408_407, paper, 9.0).unwrap_err();
    assert!(said.to_string().contains("the speed limit"), "{said}");
}

#[test]
fn values_that_are_no_lengths_bounds_or_durations_are_refused() {
    let good = bounds(1.0, 1.0, 1.0);
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e300, 1e-300] {
        assert!(TimeLaw::fastest(bad, good).is_err(), "{bad}");
        assert!(TimeLaw::fastest(1.0, bounds(bad, 1.0, 1.0)).is_err());
        assert!(TimeLaw::fastest(1.0, bounds(1.0, bad, 1.0)).is_err());
        assert!(TimeLaw::fastest(1.0, bounds(1.0, 1.0, bad)).is_err());
        assert!(TimeLaw::fit_duration(1.0, good, bad).is_err());
    }
}

#[test]
fn the_motion_rests_before_and_after() {
    let law = TimeLaw::fastest(1.0, bounds(1.0, 1.0, 1.0)).unwrap();
    for t in [-1.0, f64::NEG_INFINITY, f64::NAN] {
        assert_eq!(law.at(t).position_m, 0.0);
        assert_eq!(law.at(t).jerk_mps3, 0.0);
    }
    for t in [law.duration_s(), 1e9, f64::INFINITY] {
        assert_eq!(law.at(t).position_m, 1.0);
        assert_eq!(law.at(t).velocity_mps, 0.0);
    }
}
