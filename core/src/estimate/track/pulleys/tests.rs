//! Friction against Dahl's law, written as its differential equation, and pulleys that differ.

use super::*;
use crate::random::Random;

/// Cable per count of a winch's encoder, m.
fn count_m(robot: &Robot) -> f64 {
    let winch = robot.winch_of(0).unwrap();
    std::f64::consts::TAU * winch.drum_radius_m / f64::from(winch.encoder_counts_per_turn)
}

/// What an encoder shows of a cable, its edges at `phase` of a count.
fn read(true_m: f64, count_m: f64, phase: f64) -> f64 {
    ((true_m / count_m + phase).floor() + 0.5 - phase) * count_m
}

/// Friction after this much cable has passed out, in steps.
fn rubbed(mut side: f64, passed_m: f64, travel_m: f64) -> f64 {
    for _ in 0..2000 {
        let step_m = -passed_m / 2000.0;
        side += (step_m.signum() - side) * step_m.abs() / travel_m;
    }
    side
}

#[test]
fn friction_turns_over_its_travel_and_a_flickering_encoder_does_not_wear_it_away() {
    let robot = Robot::built_in("lab-fast").unwrap();
    let tensions_n = [10.0; 4];
    let at = |m: f64| vec![0.6 - m; 4];
    let mut pulleys = Pulleys::by_encoders(&robot, &at(0.0), &tensions_n);
    pulleys.turn(&robot, &at(0.01), &tensions_n);
    assert!(pulleys.rubbing().iter().all(|rub| rub.side > 0.999));
    for _ in 0..100 {
        pulleys.turn(&robot, &at(0.010_03), &tensions_n);
        pulleys.turn(&robot, &at(0.01), &tensions_n);
    }
    assert!(pulleys.rubbing().iter().all(|rub| rub.side > 0.999));
    // A way back of the travel: 1 - 2 (1 - 1/e) = -0.26.
    pulleys.turn(&robot, &at(0.01 - PRESLIDING_M), &tensions_n);
    let state = pulleys.rubbing()[2].side;
    assert!((state + 0.264).abs() < 0.01, "{state}");
}

/// Root mean square of errors over what is said, of ended and of turning friction: pulleys whose travel, stiffness and encoder's
/// edges differ go a way of moves up to `sizes_m`, with tensions that change by up to `pull_n`.
fn off_by(robot: &Robot, sizes_m: &[f64], pull_n: f64) -> [f64; 2] {
    let cable = &robot.cables[0];
    let count_m = count_m(robot);
    let mut random = Random::new(5);
    let (mut squares, mut counted) = ([0.0; 2], [0.0; 2]);
    for _ in 0..400 {
        let travel_m = PRESLIDING_M * (1.0 + random.within(0.3));
        let softer = 1.0 + random.within(0.2);
        let phase = random.unit();
        let (mut length_m, mut tension_n) = (0.6, 10.0);
        let mut side = random.within(1.0);
        let first = [read(length_m, count_m, phase)];
        let mut pulleys = Pulleys::new(robot, &first, &[tension_n]);
        for _ in 0..12 {
            let which = (sizes_m.len() as f64 * random.unit()) as usize;
            let way_m = random.within(sizes_m[which]);
            let change_n = random.within(pull_n);
            let stretch_m = change_n * cable.routing_length_m / cable.ea_n * softer;
            side = rubbed(side, way_m + stretch_m, travel_m);
            (length_m, tension_n) = (length_m + way_m, tension_n + change_n);
            let shown = [read(length_m, count_m, phase)];
            pulleys.turn(robot, &shown, &[tension_n]);
            let said = pulleys.rubbing()[0];
            let turning = usize::from(said.side.abs() < 0.9);
            squares[turning] += ((said.side - side) / said.unsure).powi(2);
            counted[turning] += 1.0;
        }
    }
    [0, 1].map(|k| (squares[k] / counted[k]).sqrt())
}

#[test]
fn a_friction_is_off_by_as_much_as_is_said() {
    let robot = Robot::built_in("lab-fast").unwrap();
    let [ends, turning] = off_by(&robot, &[1e-5, 1e-4, 3e-4, 1e-2], 8.0);
    // Of turning friction about as much as is said, at its ends less: most of the doubt there is of moves that no count shows.
    assert!((0.6..1.1).contains(&turning), "{turning}");
    assert!((0.1..1.0).contains(&ends), "{ends}");
}

/// Drums that stand while tensions change: all of the way is stretch.
#[test]
fn a_friction_turned_by_stretch_is_off_by_as_much_as_is_said() {
    let mut robot = Robot::built_in("lab-fast").unwrap();
    // A routing that stretches by a pulley's travel under 15 N.
    let cable = &mut robot.cables[0];
    cable.routing_length_m = PRESLIDING_M * cable.ea_n / 15.0;
    let [_, turning] = off_by(&robot, &[1e-9], 30.0);
    assert!((0.6..1.1).contains(&turning), "{turning}");
}

/// A cable that turns back within half a count: the encoder shows nothing, and the friction is less than at its end.
#[test]
fn a_way_back_that_no_count_shows_is_within_what_is_said() {
    let robot = Robot::built_in("lab-fast").unwrap();
    let count_m = count_m(&robot);
    let mut random = Random::new(7);
    let (mut squares, mut counted) = (0.0, 0.0);
    while counted < 2000.0 {
        let phase = random.unit();
        let end_m = 0.5 - random.unit() * count_m;
        let shown = [read(end_m, count_m, phase)];
        let back_m = random.within(count_m / 2.0);
        if read(end_m + back_m, count_m, phase) != shown[0] {
            continue;
        }
        let mut pulleys = Pulleys::new(&robot, &[0.6], &[10.0]);
        pulleys.turn(&robot, &shown, &[10.0]);
        let side = rubbed(1.0, back_m, PRESLIDING_M);
        let said = pulleys.rubbing()[0];
        squares += ((said.side - side) / said.unsure).powi(2);
        counted += 1.0;
    }
    let off = f64::sqrt(squares / counted);
    assert!((0.6..1.1).contains(&off), "{off}");
}

/// A friction's slope by the stiffness is the difference that a slightly stiffer routing makes.
#[test]
fn a_slope_by_stiffness_is_a_difference() {
    let stiff = Robot::built_in("lab-fast").unwrap();
    let mut stiffer = stiff.clone();
    let share = 1e-5;
    stiffer.cables[0].ea_n *= 1.0 + share;
    let start = |robot: &Robot| Pulleys::new(robot, &[0.6], &[10.0]);
    let (mut pulleys, mut others) = (start(&stiff), start(&stiffer));
    for (length_m, tension_n) in [(0.59, 14.0), (0.590_05, 2.0), (0.590_02, 9.0), (0.59, 30.0)] {
        pulleys.turn(&stiff, &[length_m], &[tension_n]);
        others.turn(&stiffer, &[length_m], &[tension_n]);
        let by_stiffness = (others.0[0].side - pulleys.0[0].side) / share;
        let said = pulleys.0[0].by_stiffness;
        assert!(
            (said - by_stiffness).abs() < 1e-3 * by_stiffness.abs() + 1e-9,
            "{said} {by_stiffness}"
        );
    }
    let squares = pulleys.rubbing()[0].unsure.powi(2);
    let mut known = pulleys.clone();
    known.0[0].by_stiffness = 0.0;
    let without = known.rubbing()[0].unsure.powi(2);
    let part = (STIFFNESS_SHARE * pulleys.0[0].by_stiffness).powi(2);
    assert!(
        (squares - without - part).abs() < 1e-9 && part > 1e-5,
        "{part}"
    );
}
