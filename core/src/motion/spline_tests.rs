//! Splines against exact cubics, the paper's circle, and each other.

use std::f64::consts::TAU;

use super::knots::{Fit, FitOptions, Spacing, fit};
use super::path::{Path, Piece};
use super::spline::{Ends, Knot, Spline, SplineError};
use super::time_law::{Bounds, TimeLaw};

const UNEVEN: [f64; 8] = [0.0, 0.3, 0.35, 1.1, 1.7, 1.9, 2.8, 3.0];

/// Tolerance that 32 segments keep on the paper's circle, m.
const TOLERANCE_M: f64 = 1e-5;

fn cubic(t: f64) -> f64 {
    2.0 - 3.0 * t + 0.5 * t * t + 1.5 * t * t * t
}

fn cubic_velocity(t: f64) -> f64 {
    -3.0 + t + 4.5 * t * t
}

fn times(count: usize, end: f64) -> Vec<f64> {
    (0..=count)
        .map(|index| end * index as f64 / count as f64)
        .collect()
}

/// Length of cable 1 of the paper's robot without its pulley, level platform, at angle `phi` of
/// the circle, m.
fn length_on_circle(phi: f64) -> f64 {
    let (x, y, z): (f64, f64, f64) = (
        0.335 + 0.065 * phi.cos() - 0.045 - 0.0251,
        0.065 * phi.sin() - 0.065 + 0.3706,
        -0.1 - 0.0241,
    );
    (x * x + y * y + z * z).sqrt()
}

fn circle_spline(segments: usize, ends: Ends) -> Spline {
    let times = times(segments, TAU);
    let mut values: Vec<f64> = times.iter().map(|phi| length_on_circle(*phi)).collect();
    values[segments] = values[0];
    Spline::interpolate(&times, &values, ends).unwrap()
}

/// End velocities of the circle by central differences.
fn clamped() -> Ends {
    let h = 1e-5;
    let velocity = (length_on_circle(h) - length_on_circle(-h)) / (2.0 * h);
    Ends::Clamped {
        start: velocity,
        end: velocity,
    }
}

#[test]
fn cubics_are_reproduced_exactly_over_uneven_knots() {
    let values: Vec<f64> = UNEVEN.iter().map(|t| cubic(*t)).collect();
    let clamped = Ends::Clamped {
        start: cubic_velocity(0.0),
        end: cubic_velocity(3.0),
    };
    for ends in [Ends::NotAKnot, clamped] {
        let spline = Spline::interpolate(&UNEVEN, &values, ends).unwrap();
        assert!(spline.greatest_error(20, cubic) < 1e-13);
        for step in 0..=60 {
            let t = f64::from(step) * 0.05;
            let sample = spline.sample(t).unwrap();
            assert!(
                (sample.velocity - cubic_velocity(t)).abs() < 1e-12,
                "{ends:?} {t}"
            );
            assert!(
                (sample.acceleration - (1.0 + 9.0 * t)).abs() < 1e-11,
                "{ends:?} {t}"
            );
        }
        for [_, _, _, s3] in spline.coefficients() {
            assert!((s3 - 1.5).abs() < 1e-11);
        }
    }
    // Four knots are the fewest that leave not-a-knot ends a cubic; three give the parabola.
    let four = Spline::interpolate(&UNEVEN[..4], &values[..4], Ends::NotAKnot).unwrap();
    assert!(four.greatest_error(20, cubic) < 1e-13);
    let square = |t: f64| 1.0 - t + 2.0 * t * t;
    let three: Vec<f64> = UNEVEN[..3].iter().map(|t| square(*t)).collect();
    let three = Spline::interpolate(&UNEVEN[..3], &three, Ends::NotAKnot).unwrap();
    assert!(three.greatest_error(20, square) < 1e-13);
    let two = Spline::interpolate(&[1.0, 3.0], &[2.0, 6.0], Ends::NotAKnot).unwrap();
    assert!(two.greatest_error(20, |t| 2.0 * t) < 1e-13);
}

#[test]
fn acceleration_has_no_steps_and_the_ends_hold() {
    let mut values: Vec<f64> = UNEVEN.iter().map(|t| (2.0 * t).sin()).collect();
    values[7] = values[0];
    let clamped = Ends::Clamped {
        start: 0.7,
        end: -0.4,
    };
    for ends in [clamped, Ends::NotAKnot, Ends::Periodic, Ends::Natural] {
        let spline = Spline::interpolate(&UNEVEN, &values, ends).unwrap();
        for (time, value) in UNEVEN.iter().zip(&values) {
            assert!((spline.sample(*time).unwrap().value - value).abs() < 1e-14);
        }
        let pieces = spline.coefficients();
        let end_of = |index: usize| {
            let [_, s1, s2, s3] = pieces[index];
            let h = UNEVEN[index + 1] - UNEVEN[index];
            (s1 + h * (2.0 * s2 + 3.0 * h * s3), 2.0 * s2 + 6.0 * h * s3)
        };
        for index in 0..6 {
            let [_, s1, s2, _] = pieces[index + 1];
            let (velocity, acceleration) = end_of(index);
            assert!((velocity - s1).abs() < 1e-11, "{ends:?} at knot {index}");
            assert!(
                (acceleration - 2.0 * s2).abs() < 1e-9,
                "{ends:?} at knot {index}"
            );
        }
        let [_, start_velocity, start_s2, start_s3] = pieces[0];
        let (end_velocity, end_acceleration) = end_of(6);
        let holds = match ends {
            Ends::Clamped { start, end } => (start_velocity - start)
                .abs()
                .max((end_velocity - end).abs()),
            Ends::NotAKnot => (start_s3 - pieces[1][3])
                .abs()
                .max((pieces[5][3] - pieces[6][3]).abs()),
            Ends::Periodic => (start_velocity - end_velocity)
                .abs()
                .max((2.0 * start_s2 - end_acceleration).abs()),
            Ends::Natural => (2.0 * start_s2).abs().max(end_acceleration.abs()),
        };
        assert!(holds < 1e-9, "{ends:?}: {holds}");
    }
}

#[test]
fn the_smallest_periodic_splines_are_periodic() {
    for count in [3, 4, 5] {
        let times = &UNEVEN[..count];
        let mut values: Vec<f64> = times.iter().map(|t| (3.0 * t).cos()).collect();
        values[count - 1] = values[0];
        let spline = Spline::interpolate(times, &values, Ends::Periodic).unwrap();
        let (start, end) = spline.span_s();
        let (first, last) = (spline.sample(start).unwrap(), spline.sample(end).unwrap());
        assert!((first.velocity - last.velocity).abs() < 1e-12, "{count}");
        assert!(
            (first.acceleration - last.acceleration).abs() < 1e-9,
            "{count}"
        );
        for knot in &spline.knots()[1..count - 1] {
            let before = spline.sample(knot.time_s - 1e-9).unwrap();
            let after = spline.sample(knot.time_s + 1e-9).unwrap();
            let step = (before.acceleration - after.acceleration).abs();
            assert!(step < 1e-3, "{count}: {step}");
        }
    }
}

#[test]
fn thirty_two_segments_keep_the_circle_within_a_hundredth_of_a_millimetre() {
    for ends in [Ends::Periodic, Ends::NotAKnot, clamped()] {
        let error = circle_spline(32, ends).greatest_error(16, length_on_circle);
        println!("32 segments, {ends:?}: {:.3} um", error * 1e6);
        assert!(error < TOLERANCE_M, "{ends:?}: {error}");
    }
    let natural = circle_spline(32, Ends::Natural).greatest_error(16, length_on_circle);
    println!("32 segments, natural: {:.3} um", natural * 1e6);
    assert!(natural > 2.0 * TOLERANCE_M, "{natural}");
}

#[test]
fn the_error_falls_with_the_fourth_power_of_the_spacing() {
    let order = |ends: Ends| {
        let error = |segments| circle_spline(segments, ends).greatest_error(16, length_on_circle);
        (error(32) / error(64)).log2()
    };
    for ends in [Ends::Periodic, Ends::NotAKnot, clamped()] {
        let order = order(ends);
        assert!((3.7..4.6).contains(&order), "{ends:?}: {order}");
    }
    let natural = order(Ends::Natural);
    assert!((1.7..2.3).contains(&natural), "{natural}");
}

type Motion = (Piece, TimeLaw);

/// The paper's circle from rest to rest in 10 s, all four cables, as a function of time.
fn circle_lengths(motion: &Motion) -> impl Fn(f64, &mut [f64]) -> Result<(), SplineError> {
    const ANCHORS: [[f64; 3]; 4] = [
        [0.0251, -0.3706, 0.0241],
        [0.0402, 0.3849, 0.0242],
        [0.6445, 0.3701, 0.0245],
        [0.6295, -0.3854, 0.0239],
    ];
    move |time_s, lengths| {
        let (piece, law) = motion;
        let p = piece.point(law.at(time_s).position_m).unwrap().position_m;
        for (length, [x, y, z]) in lengths.iter_mut().zip(ANCHORS) {
            *length = ((p.x - x).powi(2) + (p.y - y).powi(2) + (p.z - z).powi(2)).sqrt();
        }
        Ok(())
    }
}

fn circle_fit(tolerance: f64, most_segments: usize) -> (Motion, Result<Fit, SplineError>) {
    let circle = Path::paper_circle(-0.1).unwrap().pieces()[1].clone();
    let bounds = Bounds {
        speed_mps: 0.045,
        acceleration_mps2: 0.2,
        jerk_mps3: 2.0,
    };
    let law = TimeLaw::fit_duration(circle.length_m(), bounds, 10.0).unwrap();
    let motion = (circle, law);
    let options = FitOptions {
        least_segments: 4,
        ends: Ends::Clamped {
            start: 0.0,
            end: 0.0,
        },
        spacing: Spacing::Ticks,
        tolerance,
        most_segments,
    };
    let fitted = fit(4, (0.0, 10.0), options, circle_lengths(&motion));
    (motion, fitted)
}

#[test]
fn a_fit_has_the_knots_its_tolerance_takes_and_not_many_more() {
    let mut before = 0;
    for tolerance in [1e-3, 1e-4, 1e-5, 1e-6] {
        let (motion, fitted) = circle_fit(tolerance, 2000);
        let fitted = fitted.unwrap();
        println!(
            "{tolerance:e} m: {} segments, {:e} m",
            fitted.segments, fitted.error
        );
        assert!(fitted.error <= tolerance && fitted.segments > before);
        before = fitted.segments;
        // An independent, finer check finds at most a little above the tolerance.
        let function = circle_lengths(&motion);
        for (channel, spline) in fitted.splines.iter().enumerate() {
            assert_eq!(spline.knots().len(), fitted.segments + 1);
            let error = spline.greatest_error(37, |t| {
                let mut lengths = [0.0; 4];
                function(t, &mut lengths).unwrap();
                lengths[channel]
            });
            assert!(error < 1.1 * tolerance, "{error}");
        }
        // Far fewer segments do not suffice.
        let (_, too_few) = circle_fit(tolerance, fitted.segments * 2 / 3);
        assert!(matches!(too_few, Err(SplineError::Tolerance { .. })));
    }
}

#[test]
fn bad_knots_are_refused_by_number() {
    let ends = Ends::NotAKnot;
    let of = |times: &[f64], values: &[f64]| Spline::interpolate(times, values, ends);
    assert!(matches!(of(&[0.0], &[0.0]), Err(SplineError::Count { .. })));
    assert!(matches!(
        of(&[0.0, 1.0], &[0.0]),
        Err(SplineError::Count { .. })
    ));
    assert!(matches!(
        of(&[0.0, 2.0, 1.0], &[0.0; 3]),
        Err(SplineError::Order { knot: 3, .. })
    ));
    assert!(matches!(
        of(&[0.0, 1.0, 1.0], &[0.0; 3]),
        Err(SplineError::Order { knot: 3, .. })
    ));
    for bad in [f64::NAN, f64::INFINITY, 1e300] {
        assert_eq!(
            of(&[0.0, 1.0, 2.0], &[0.0, bad, 0.0]),
            Err(SplineError::NotFinite { knot: 2 })
        );
        assert_eq!(
            of(&[0.0, 1.0, bad], &[0.0; 3]),
            Err(SplineError::NotFinite { knot: 3 })
        );
        let clamped = Ends::Clamped {
            start: bad,
            end: 0.0,
        };
        assert!(Spline::interpolate(&[0.0, 1.0], &[0.0, 1.0], clamped).is_err());
        let knot = Knot {
            time_s: 0.0,
            value: 0.0,
            velocity: bad,
        };
        assert!(Spline::from_knots(vec![knot, knot]).is_err());
    }
    assert!(matches!(
        Spline::interpolate(&[0.0, 1.0, 2.0], &[0.0, 1.0, 0.1], Ends::Periodic),
        Err(SplineError::NotPeriodic { .. })
    ));
    let spline = of(&[0.0, 1.0, 2.0], &[0.0, 1.0, 4.0]).unwrap();
    for outside in [-1e-9, 2.0 + 1e-9, f64::NAN] {
        assert!(
            matches!(spline.sample(outside), Err(SplineError::OutsideTime { .. })),
            "{outside}"
        );
    }
    assert_eq!(spline.sample(2.0).unwrap().value, 4.0);
}

#[test]
fn a_fit_of_a_function_that_fails_or_is_no_number_ends_with_an_error() {
    let options = FitOptions {
        least_segments: 4,
        ends: Ends::NotAKnot,
        spacing: Spacing::Equal,
        tolerance: 1e-6,
        most_segments: 64,
    };
    let nan = fit(1, (0.0, 1.0), options, |t, values| {
        // A number at every knot of 4 segments, NaN between them.
        values[0] = if (4.0 * t).fract() == 0.0 {
            t
        } else {
            f64::NAN
        };
        Ok::<(), SplineError>(())
    });
    assert!(nan.is_err(), "{nan:?}");
    let failing = fit(1, (0.0, 1.0), options, |t, _| {
        Err(SplineError::OutsideTime {
            time_s: t,
            start_s: 0.0,
            end_s: 0.0,
        })
    });
    assert!(matches!(failing, Err(SplineError::OutsideTime { .. })));
    let backwards = fit(1, (1.0, 0.0), options, |_, _| Ok::<(), SplineError>(()));
    assert!(matches!(backwards, Err(SplineError::Order { .. })));
}
