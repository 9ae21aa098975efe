//! The drives' contactor, and the current in a brake's coil.

use super::*;

/// Time (s, to 0.1 ms) until cable 1's brake is open or closed, and 2 s at most.
fn until(plant: &mut Plant, closed: bool) -> f64 {
    for step in 0..20_000 {
        if plant.truth().expect("a path").brakes_closed[0] == closed {
            return f64::from(step) * 1e-4;
        }
        plant.advance(1e-4).expect("held");
    }
    panic!("the brake does not follow");
}

/// The paper's robot with the other brakes closed: the platform stays.
fn robot() -> Plant {
    at_rest(PlantParams::paper_optimistic(), &off_centre(), 5.0)
}

#[test]
fn a_coil_that_freewheels_closes_its_brake_eight_to_ten_times_later() {
    let mut plant = robot();
    let close_s = plant.params().winches[0].brake.close_delay_s;
    let mut times = [false, true].map(|freewheels| {
        plant.faults_mut().cables[0].brake.freewheels = freewheels;
        plant.set_brake(0, false).expect("cable");
        plant.advance(1.0).expect("held");
        plant.set_brake(0, true).expect("cable");
        until(&mut plant, true)
    });
    assert!((times[0] - close_s).abs() < 2e-4, "{times:?}");
    // INTORQ, BA 14.0217, 5.5.
    times[1] /= times[0];
    assert!((8.0..10.0).contains(&times[1]), "{times:?}");
}

#[test]
fn a_coil_that_has_little_current_closes_its_brake_sooner_and_opens_it_later() {
    let mut plant = robot();
    let (open_s, close_s) = {
        let brake = &plant.params().winches[0].brake;
        (brake.open_delay_s, brake.close_delay_s)
    };
    plant.set_brake(0, false).expect("cable");
    let opened_s = until(&mut plant, false);
    assert!((opened_s - open_s).abs() < 2e-4, "{opened_s}");
    // Just open: 0.7 of the current, which falls to 0.3 in less time than from 1.
    plant.set_brake(0, true).expect("cable");
    let soon_s = until(&mut plant, true);
    let falls = (0.7_f64 / 0.3).ln() / (1.0_f64 / 0.3).ln();
    let expected_s = close_s * (13.0 + 15.0 * falls) / 28.0;
    assert!((soon_s - expected_s).abs() < 3e-4, "{soon_s} {expected_s}");
    // Switched on again at once: some current is left, so that it opens sooner.
    plant.set_brake(0, false).expect("cable");
    let again_s = until(&mut plant, false);
    assert!(again_s < opened_s - 1e-3, "{again_s} {opened_s}");
    // Off before it has opened, it never opens.
    plant.set_brake(0, true).expect("cable");
    plant.advance(1.0).expect("held");
    plant.set_brake(0, false).expect("cable");
    plant.advance(0.5 * open_s).expect("held");
    plant.set_brake(0, true).expect("cable");
    for _ in 0..1000 {
        plant.advance(1e-3).expect("held");
        assert!(plant.truth().expect("a path").brakes_closed[0]);
    }
}

#[test]
fn a_contactor_closes_and_opens_after_its_times() {
    let mut plant = robot();
    assert!(plant.drive_has_supply(0), "a plant alone has none");
    plant.set_drive_enable(0, false).expect("cable");
    assert!(!plant.drive_has_supply(0), "low since long ago");
    assert!(plant.drive_has_supply(1), "each drive has its board's");
    for (on, least_s, most_s) in [
        (true, 0.053_55, 0.072_45),
        (false, 0.016, 0.024),
        (true, 0.053_55, 0.072_45),
    ] {
        plant.set_drive_enable(0, on).expect("cable");
        plant.advance(least_s).expect("held");
        assert_eq!(plant.drive_has_supply(0), !on, "too soon");
        plant.advance(most_s - least_s).expect("held");
        assert_eq!(plant.drive_has_supply(0), on, "too late");
    }
    // A pulse that is shorter than the contactor's time moves nothing.
    plant.set_drive_enable(0, false).expect("cable");
    plant.advance(0.005).expect("held");
    plant.set_drive_enable(0, true).expect("cable");
    for _ in 0..200 {
        plant.advance(1e-3).expect("held");
        assert!(plant.drive_has_supply(0));
    }
}

#[test]
fn a_drive_whose_contactor_opens_gives_no_torque_and_needs_a_reset() {
    let mut plant = robot();
    make_ready(&mut plant, 3, Mode::Current);
    let pull = DriveCommand::Current { milliamps: -27 };
    plant.command(3, pull).expect("cable");
    plant.advance(0.05).expect("held");
    assert!(plant.truth().expect("a path").motor_currents_a[3] < -0.02);
    plant.set_drive_enable(3, true).expect("cable");
    plant.set_drive_enable(3, false).expect("cable");
    plant.advance(0.2).expect("held");
    assert_eq!(plant.truth().expect("a path").motor_currents_a[3], 0.0);
    assert_eq!(plant.drive_state(3), Ok(DriveState::Unpowered));
    // The supply is back: nothing starts by itself.
    plant.set_drive_enable(3, true).expect("cable");
    for _ in 0..200 {
        plant.command(3, pull).expect("cable");
        plant.advance(1e-2).expect("held");
        assert_eq!(plant.truth().expect("a path").motor_currents_a[3], 0.0);
    }
}
