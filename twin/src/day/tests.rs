//! A short day: what the tracker is worth, and what it names.

use super::*;
use crate::plant::Mismatch;
use mcdpr_core::motion::Model;
use mcdpr_core::robot::Robot;

fn day(kind: Kind, hours: f64, knock_m: f64, seed: u64) -> Day {
    day_of("lab-fast", kind, hours, knock_m, seed)
}

fn day_of(robot: &str, kind: Kind, hours: f64, knock_m: f64, seed: u64) -> Day {
    let work = Work {
        model: Model::new(&Robot::built_in(robot).unwrap()).unwrap(),
        mismatch: Mismatch::after_hours(),
        hours,
        look_every_s: 300.0,
        kind,
        knock_m,
    };
    work.run(seed, &mut |_| true).unwrap()
}

fn mean_mm(day: &Day) -> f64 {
    let sum: f64 = day.samples.iter().map(|sample| sample.error_m).sum();
    sum / day.samples.len() as f64 * 1e3
}

#[test]
fn a_tracked_hour_stays_within_its_region_and_far_below_an_untracked_one() {
    let seen = day(Kind::Seeing, 1.0, 0.0, 31);
    let untracked = day(Kind::Untracked, 1.0, 0.0, 31);
    assert!(untracked.rests == 0 && seen.looks >= 10);
    let (with, without) = (mean_mm(&seen), mean_mm(&untracked));
    println!("{with:.3} mm with, {without:.3} mm without");
    assert!(with < 0.35 && without > 4.0 * with);
    assert!(inside(&seen) > 0.9, "{}", inside(&seen));
    let mut mass: Vec<f64> = seen.loads.iter().map(|load| load.mass.abs()).collect();
    mass.sort_by(f64::total_cmp);
    assert!(mass.len() > 50 && mass[mass.len() / 2] < 0.01, "{mass:?}");
}

/// Share of the samples in the tracked region.
fn inside(day: &Day) -> f64 {
    let inside = day.samples.iter().filter(|s| s.inside == Some(true));
    inside.count() as f64 / day.samples.len() as f64
}

/// Without a camera a friction that is followed wrongly, or one loss for pulleys that differ, teaches wrong states.
#[test]
fn pulleys_that_differ_teach_no_wrong_state_though_no_camera_looks() {
    for robot in ["lab-fast", "eight-cable"] {
        let days: Vec<Day> = (35..38)
            .map(|seed| day_of(robot, Kind::Blind, 2.0, 0.0, seed))
            .collect();
        for day in &days {
            assert!(day.rests > 400, "{robot}: {}", day.rests);
            assert_eq!(day.doubted, 0, "{robot}");
        }
        let share = days.iter().map(inside).sum::<f64>() / days.len() as f64;
        let mean = days.iter().map(mean_mm).sum::<f64>() / days.len() as f64;
        println!("{robot}: {mean:.3} mm, {share:.3} inside");
        assert!(share > 0.88 && mean < 0.5, "{robot}: {share}, {mean} mm");
        let mut mass: Vec<f64> = days
            .iter()
            .flat_map(|day| &day.loads)
            .map(|load| load.mass.abs())
            .collect();
        mass.sort_by(f64::total_cmp);
        assert!(mass[mass.len() / 2] < 0.01, "{robot}");
    }
}

#[test]
fn knocks_are_named_and_never_wrongly() {
    let day = day(Kind::Seeing, 1.1, 3e-3, 32);
    let right = day.knocks.iter().filter(|knock| knock.right).count();
    let wrong = day
        .knocks
        .iter()
        .filter(|knock| knock.looks.is_some() && !knock.right)
        .count();
    assert_eq!(day.knocks.len(), 5, "four anchors and the camera");
    assert!(right >= 4 && wrong == 0, "{:?}", day.knocks);
    assert!(day.false_names.is_empty(), "{:?}", day.false_names);
}

#[test]
fn the_same_seed_is_the_same_day_and_an_interrupted_one_ends() {
    let (a, b) = (
        day(Kind::Blind, 0.1, 0.0, 33),
        day(Kind::Blind, 0.1, 0.0, 33),
    );
    assert_eq!(a.samples, b.samples);
    let work = Work {
        model: Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap(),
        mismatch: Mismatch::after_hours(),
        hours: 100.0,
        look_every_s: 300.0,
        kind: Kind::Blind,
        knock_m: 0.0,
    };
    let mut calls = 0;
    let day = work.run(33, &mut |_| {
        calls += 1;
        calls < 3
    });
    assert!(day.unwrap().samples.len() < 1000);
}
