//! The bus: delivery of commands and feedback, and the effects of its faults.

use super::*;

/// All drives reset and answering.
fn answering() -> Plant {
    let mut plant = winches_alone(PlantParams::paper_optimistic());
    for cable in 0..4 {
        plant.command(cable, DriveCommand::Reset).expect("cable");
    }
    plant.advance(0.6).expect("no failure");
    plant
}

#[test]
fn slots_are_staggered_and_feedback_travels() {
    let mut plant = answering();
    let mut seen: [Vec<f64>; 4] = Default::default();
    let mut last = plant.read_sensors().feedback;
    for _ in 0..400 {
        plant.advance(1e-4).expect("no failure");
        let feedback = plant.read_sensors().feedback;
        for cable in 0..4 {
            let (new, old) = (
                feedback[cable].expect("it answers"),
                last[cable].expect("it answers"),
            );
            if new.sequence != old.sequence {
                assert_eq!(new.sequence, old.sequence + 1);
                let age = plant.time_s() - new.measured_at_s;
                // 0.25 ms of transport, seen at the end of the next step.
                assert!((0.000_25 - 1e-9..0.000_45).contains(&age), "{age}");
                seen[cable].push(new.measured_at_s);
            }
        }
        last = feedback;
    }
    for (cable, times) in seen.iter().enumerate() {
        assert_eq!(times.len(), 20, "500 Hz for 40 ms");
        for time in times {
            let phase = (time * 1e3 - 0.5 * cable as f64 + 1.0).rem_euclid(2.0);
            assert!((phase - 1.0).abs() < 1e-6, "cable {cable} at {time}");
        }
    }
    assert_eq!(last[4..], [None; 4]);
}

#[test]
fn the_newest_set_point_wins_and_orders_queue() {
    let mut plant = answering();
    // Written in one go: mode choice first, then the newest of the set-points.
    plant
        .command(0, DriveCommand::SelectMode(Mode::Current))
        .expect("cable");
    plant.advance(0.51).expect("no failure");
    for milliamps in [100, 200, 50] {
        plant
            .command(0, DriveCommand::Current { milliamps })
            .expect("cable");
    }
    plant.set_brake(0, true).expect("cable");
    plant.advance(0.1).expect("no failure");
    assert!((plant.truth().expect("a path").motor_currents_a[0] - 0.05).abs() < 1e-6);
    // Off voids waiting commands.
    plant
        .command(0, DriveCommand::Current { milliamps: 70 })
        .expect("cable");
    plant.command(0, DriveCommand::Off).expect("cable");
    plant.advance(0.1).expect("no failure");
    assert_eq!(plant.drive_state(0), Ok(DriveState::Idle));
    assert!(plant.truth().expect("a path").motor_currents_a[0].abs() < 1e-6);
    // Repeated commands do not pile up; different ones keep their order.
    for _ in 0..100 {
        plant.command(0, DriveCommand::Reset).expect("cable");
    }
    plant
        .command(0, DriveCommand::SelectMode(Mode::Velocity))
        .expect("cable");
    plant.advance(0.6).expect("no failure");
    // The mode choice came 2 ms after the reset began: a drive ignores commands during a reset.
    assert_eq!(plant.drive_state(0), Ok(DriveState::Idle));
}

#[test]
fn a_silent_drive_obeys_and_a_deaf_one_answers() {
    let mut plant = answering();
    for cable in 0..2 {
        make_ready(&mut plant, cable, Mode::Velocity);
    }
    plant.faults_mut().cables[0].drive.silent = true;
    plant.faults_mut().cables[1].drive.ignores_commands = true;
    plant.advance(0.01).expect("no failure");
    let before = plant.read_sensors().feedback;
    for cable in 0..2 {
        plant
            .command(cable, DriveCommand::Velocity { rpm: 1000 })
            .expect("cable");
    }
    plant.advance(0.5).expect("turns");
    let after = plant.read_sensors().feedback;
    let drums = plant.truth().expect("a path").drum_positions_m;
    assert!(drums[0] > 1e-3 && drums[1] == 0.0, "{drums:?}");
    assert_eq!(before[0], after[0]);
    assert!(after[1].expect("it answers").sequence > before[1].expect("it answers").sequence + 200);
}

#[test]
fn without_a_bus_drives_go_on_with_their_last_command() {
    let mut plant = answering();
    make_ready(&mut plant, 0, Mode::Velocity);
    plant
        .command(0, DriveCommand::Velocity { rpm: 1000 })
        .expect("cable");
    plant.advance(0.2).expect("turns");
    plant.faults_mut().bus_off = true;
    plant.advance(0.01).expect("turns");
    let before = plant.read_sensors().feedback;
    plant.command(0, DriveCommand::Off).expect("cable");
    plant.advance(1.0).expect("turns");
    assert_eq!(plant.read_sensors().feedback, before);
    let speed = plant.truth().expect("a path").drum_speeds_mps[0];
    assert!((speed / (1000.0 * plant.params().winches[0].mps_per_rpm()) - 1.0).abs() < 1e-3);
    // Connected again: commands sent meanwhile are lost, a new command arrives.
    plant.faults_mut().bus_off = false;
    plant.command(0, DriveCommand::Off).expect("cable");
    plant.advance(1.0).expect("stops");
    assert_eq!(plant.truth().expect("a path").drum_speeds_mps[0], 0.0);
}

#[test]
fn the_e_stop_cuts_power_and_nothing_starts_by_itself() {
    let mut plant = at_rest(PlantParams::paper_optimistic(), &off_centre(), 3.0);
    for cable in 0..4 {
        make_ready(&mut plant, cable, Mode::Position);
        let hold = DriveCommand::Position {
            counts: 0,
            rpm_limit: 8000,
        };
        plant.command(cable, hold).expect("cable");
        plant.advance(0.01).expect("held");
        plant.set_brake(cable, false).expect("cable");
    }
    plant.advance(0.5).expect("held");
    plant.set_e_stop(true);
    assert!(plant.read_sensors().e_stop);
    plant.advance(0.5).expect("drops, then brakes");
    let truth = plant.truth().expect("a path");
    assert_eq!(truth.brakes_closed[..4], [true; 4]);
    // 30 ms of fall with the drums in tow.
    let drop = truth.drum_positions_m[..4]
        .iter()
        .fold(0.0_f64, |m, x| m.max(*x));
    assert!(drop > 1e-4 && drop < 0.01, "{drop}");
    // Commands have no effect without power, and its return starts nothing.
    plant.set_brake(0, false).expect("cable");
    plant.command(0, DriveCommand::Reset).expect("cable");
    plant.advance(1.0).expect("rests");
    assert_eq!(plant.drive_state(0), Ok(DriveState::Unpowered));
    plant.set_e_stop(false);
    plant.advance(1.0).expect("rests");
    let after = plant.truth().expect("a path");
    assert!(!plant.read_sensors().e_stop);
    assert_eq!(after.brakes_closed[..4], [true; 4]);
    assert_eq!(plant.drive_state(0), Ok(DriveState::Unpowered));
}

#[test]
fn a_rail_that_holds_up_keeps_the_drives_until_the_brakes_have_closed() {
    let mut params = PlantParams::paper_optimistic();
    for winch in &mut params.winches {
        winch.drive.hold_up_s = 0.05;
    }
    let mut plant = at_rest(params, &off_centre(), 3.0);
    for cable in 0..4 {
        make_ready(&mut plant, cable, Mode::Position);
        let hold = DriveCommand::Position {
            counts: 0,
            rpm_limit: 8000,
        };
        plant.command(cable, hold).expect("cable");
        plant.advance(0.01).expect("held");
        plant.set_brake(cable, false).expect("cable");
    }
    plant.advance(0.5).expect("held");
    let before = plant.truth().expect("a path").drum_positions_m;
    plant.lose_supply();
    // The brakes' coils are fed before the rail: no output opens one any more.
    plant.set_brake(0, false).expect("cable");
    plant.advance(0.045).expect("held");
    let truth = plant.truth().expect("a path");
    assert_eq!(truth.brakes_closed[..4], [true; 4]);
    assert!(matches!(plant.drive_state(0), Ok(DriveState::Ready(_))));
    assert!(plant.drive_has_supply(0));
    plant.advance(0.5).expect("rests");
    assert!(!plant.drive_has_supply(0));
    assert_eq!(plant.drive_state(0), Ok(DriveState::Unpowered));
    let after = plant.truth().expect("a path").drum_positions_m;
    for (now, then) in after[..4].iter().zip(&before[..4]) {
        assert!((now - then).abs() < 2e-5, "{now} {then}");
    }
    // With its supply back a brake opens again.
    plant.set_power(true);
    plant.set_brake(0, false).expect("cable");
    plant.advance(0.1).expect("falls");
    assert!(!plant.truth().expect("a path").brakes_closed[0]);
}
