//! A short day: what the tracker is worth, and what it names.

use super::*;
use crate::plant::Mismatch;
use mcdpr_core::motion::Model;
use mcdpr_core::robot::Robot;

fn day(kind: Kind, hours: f64, knock_m: f64, seed: u64) -> Day {
    let work = Work {
        model: Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap(),
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
    let inside = seen
        .samples
        .iter()
        .filter(|s| s.inside == Some(true))
        .count();
    let share = inside as f64 / seen.samples.len() as f64;
    assert!(share > 0.9, "{share}");
    let mut mass: Vec<f64> = seen.loads.iter().map(|load| load.mass.abs()).collect();
    mass.sort_by(f64::total_cmp);
    assert!(mass.len() > 50 && mass[mass.len() / 2] < 0.01, "{mass:?}");
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
