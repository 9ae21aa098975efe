//! Drives: enabling, modes, and the performance of the loops, on drums without load.

use super::*;

fn position(counts: i64, rpm_limit: u16) -> DriveCommand {
    DriveCommand::Position { counts, rpm_limit }
}

/// Drum displacement every millisecond.
fn course(plant: &mut Plant, milliseconds: usize) -> Vec<f64> {
    (0..milliseconds)
        .map(|_| {
            plant.advance(1e-3).expect("no failure");
            plant.truth().expect("a path").drum_positions_m[0]
        })
        .collect()
}

fn counts_of(plant: &Plant, metres: f64) -> i64 {
    (metres / plant.params().winches[0].metres_per_motor_count()).round() as i64
}

#[test]
fn a_small_step_follows_with_the_stated_bandwidth() {
    let mut plant = winches_alone(PlantParams::paper_optimistic());
    make_ready(&mut plant, 0, Mode::Position);
    let counts = counts_of(&plant, 1e-4);
    plant.command(0, position(counts, 8000)).expect("cable");
    let course = course(&mut plant, 300);
    // 1/150 s for the position loop, 1/600 s for the speed loop, up to 2.25 ms for the bus.
    let reached = course.iter().position(|x| *x > 0.632e-4).expect("it moves") + 1;
    assert!((7..=11).contains(&reached), "63 % after {reached} ms");
    let overshoot = course.iter().fold(0.0_f64, |m, x| m.max(*x)) / 1e-4 - 1.0;
    assert!(overshoot < 0.08, "{overshoot}");
    assert!((course[299] - 1e-4).abs() < 1e-7);
}

#[test]
fn a_long_way_runs_at_the_motors_speed_limit_or_the_commanded_one() {
    for (rpm_limit, mps) in [(8000, 0.045_148), (4000, 0.022_574), (20_000, 0.045_148)] {
        let mut plant = winches_alone(PlantParams::paper_optimistic());
        make_ready(&mut plant, 0, Mode::Position);
        let counts = counts_of(&plant, 0.1);
        plant
            .command(0, position(counts, rpm_limit))
            .expect("cable");
        let course = course(&mut plant, 6000);
        let plateau = (course[1500] - course[500]) / 1.0;
        assert!(
            (plateau - mps).abs() < 1e-5,
            "{plateau} m/s at {rpm_limit} rpm"
        );
        // Starting from rest at 5 m/s^2 at most.
        let fastest_start = course
            .windows(3)
            .map(|w| (w[2] - 2.0 * w[1] + w[0]) / 1e-6)
            .fold(0.0, f64::max);
        assert!(fastest_start < 5.0 * 1.02, "{fastest_start}");
        assert!(course.iter().all(|x| *x < 0.1 + 2e-5), "overshoot");
        assert!((course[5999] - 0.1).abs() < 2e-7);
        let feedback = plant.read_sensors().feedback[0].expect("it answers");
        assert!(
            (i64::from(feedback.counts) - counts).abs() <= 2,
            "{feedback:?}"
        );
    }
}

#[test]
fn feedback_tells_speed_and_count_on_the_way() {
    let mut params = PlantParams::paper_optimistic();
    params.winches[0].motor_sign = -1;
    let mut plant = winches_alone(params);
    make_ready(&mut plant, 0, Mode::Velocity);
    plant
        .command(0, DriveCommand::Velocity { rpm: 3000 })
        .expect("cable");
    plant.advance(0.5).expect("turns");
    let before = plant.read_sensors().feedback[0].expect("it answers");
    plant.advance(0.5).expect("turns");
    let after = plant.read_sensors().feedback[0].expect("it answers");
    assert!((i32::from(after.rpm) - 3000).abs() <= 1, "{after:?}");
    // 50 turns per second of 1,520,148 / 371.13 = 4096 counts.
    let counts =
        f64::from(after.counts - before.counts) / (after.measured_at_s - before.measured_at_s);
    assert!(
        (counts - 50.0 * 1_520_148.0 / 371.13).abs() < 20.0,
        "{counts}"
    );
    // A sign of -1: positive speed hauls in.
    assert!(plant.truth().expect("a path").drum_positions_m[0] < -0.01);
}

#[test]
fn a_heavy_rotor_slows_the_start_but_not_the_arrival() {
    let mut params = PlantParams::paper_optimistic();
    params.winches[0].rotor_inertia_kg_m2 = 1e-6;
    assert!((params.winches[0].effective_mass_kg() - 344.4).abs() < 0.1);
    let mut plant = winches_alone(params);
    make_ready(&mut plant, 0, Mode::Position);
    let counts = counts_of(&plant, 0.02);
    plant.command(0, position(counts, 8000)).expect("cable");
    let course = course(&mut plant, 3000);
    // 1 A makes 185.6 N: at most 0.54 m/s^2 on 344 kg; the speed limit takes 84 ms at least.
    let fastest_start = course
        .windows(3)
        .map(|w| (w[2] - 2.0 * w[1] + w[0]) / 1e-6)
        .fold(0.0, f64::max);
    assert!((0.2..0.54).contains(&fastest_start), "{fastest_start}");
    assert!(course.iter().all(|x| *x < 0.02 + 2e-4), "overshoot");
    assert!((course[2999] - 0.02).abs() < 1e-6, "{}", course[2999]);
}

#[test]
fn current_rises_with_its_lag_in_whole_milliamps() {
    let mut params = PlantParams::paper_optimistic();
    params.winches[0].drive.current_quantum_a = 0.01;
    let mut plant = at_rest(params, &off_centre(), 5.0);
    make_ready(&mut plant, 0, Mode::Current);
    plant
        .command(0, DriveCommand::Current { milliamps: 104 })
        .expect("cable");
    let mut rise = Vec::new();
    for _ in 0..400 {
        plant.advance(1e-4).expect("held by the brake");
        rise.push(plant.truth().expect("a path").motor_currents_a[0]);
    }
    let begin = rise.iter().position(|i| *i > 0.0).expect("it rises");
    // Begins in the drive's slot: within a period and the latency.
    assert!(begin <= 23, "{begin}");
    let third = rise[begin + 29];
    assert!(
        (third / 0.1 - (1.0 - (-1.0_f64).exp())).abs() < 1e-6,
        "{third}"
    );
    assert!((rise[399] - 0.1).abs() < 1e-4, "steps of 10 mA");
    plant
        .command(
            0,
            DriveCommand::Current {
                milliamps: i16::MAX,
            },
        )
        .expect("cable");
    plant.advance(0.1).expect("held by the brake");
    let current = plant.truth().expect("a path").motor_currents_a[0];
    assert!((current - 1.0).abs() < 1e-9, "limited to 1 A: {current}");
}

#[test]
fn a_motor_in_current_mode_does_not_run_beyond_its_speed() {
    let mut plant = winches_alone(PlantParams::paper_optimistic());
    make_ready(&mut plant, 0, Mode::Current);
    plant
        .command(0, DriveCommand::Current { milliamps: 100 })
        .expect("cable");
    plant.advance(2.0).expect("runs");
    let speed = plant.truth().expect("a path").drum_speeds_mps[0];
    let limit = plant.params().winches[0].max_speed_mps();
    assert!(speed > limit && speed < 1.05 * limit, "{speed} of {limit}");
}

#[test]
fn a_drive_obeys_only_after_reset_and_mode_and_only_its_mode() {
    let mut plant = winches_alone(PlantParams::paper_optimistic());
    let counts = counts_of(&plant, 1e-3);
    let go = position(counts, 8000);
    let command = |plant: &mut Plant, command, seconds| {
        plant.command(0, command).expect("cable");
        plant.advance(seconds).expect("no failure");
        plant.truth().expect("a path").drum_positions_m[0]
    };
    assert_eq!(command(&mut plant, go, 0.1), 0.0);
    assert_eq!(
        command(&mut plant, DriveCommand::SelectMode(Mode::Position), 0.6),
        0.0
    );
    assert_eq!(plant.drive_state(0), Ok(DriveState::Unpowered));
    assert_eq!(plant.read_sensors().feedback[0], None);

    command(&mut plant, DriveCommand::Reset, 0.49);
    assert_eq!(plant.drive_state(0), Ok(DriveState::Resetting));
    assert_eq!(plant.read_sensors().feedback[0], None);
    plant.advance(0.02).expect("no failure");
    assert_eq!(plant.drive_state(0), Ok(DriveState::Idle));
    assert!(plant.read_sensors().feedback[0].is_some());

    command(&mut plant, DriveCommand::SelectMode(Mode::Position), 0.49);
    assert_eq!(command(&mut plant, go, 0.005), 0.0);
    assert_eq!(
        plant.drive_state(0),
        Ok(DriveState::Selecting(Mode::Position))
    );
    plant.advance(0.02).expect("no failure");
    assert_eq!(plant.drive_state(0), Ok(DriveState::Ready(Mode::Position)));
    // The set-point that came too early is lost; one of another mode is ignored.
    assert_eq!(
        command(&mut plant, DriveCommand::Current { milliamps: 500 }, 0.1),
        0.0
    );
    assert!((command(&mut plant, go, 0.3) - 1e-3).abs() < 1e-6);
    // The mode it has already: no interruption. Off: torque and mode gone.
    command(&mut plant, DriveCommand::SelectMode(Mode::Position), 0.01);
    assert_eq!(plant.drive_state(0), Ok(DriveState::Ready(Mode::Position)));
    command(&mut plant, DriveCommand::Off, 0.05);
    assert_eq!(plant.drive_state(0), Ok(DriveState::Idle));
    assert!((command(&mut plant, position(0, 8000), 0.1) - 1e-3).abs() < 1e-6);
}

#[test]
fn a_late_drive_is_late_and_a_dead_one_never_comes() {
    let mut plant = winches_alone(PlantParams::paper_optimistic());
    plant.faults_mut().cables[0].drive.late_s = 0.3;
    plant.faults_mut().cables[1].drive.late_s = f64::INFINITY;
    for cable in 0..2 {
        plant.command(cable, DriveCommand::Reset).expect("cable");
    }
    plant.advance(0.75).expect("no failure");
    assert_eq!(plant.drive_state(0), Ok(DriveState::Resetting));
    plant.advance(0.06).expect("no failure");
    assert_eq!(plant.drive_state(0), Ok(DriveState::Idle));
    plant.advance(100.0).expect("no failure");
    assert_eq!(plant.drive_state(1), Ok(DriveState::Resetting));
}

#[test]
fn counts_start_at_zero_at_the_reset() {
    let mut plant = winches_alone(PlantParams::paper_optimistic());
    make_ready(&mut plant, 0, Mode::Position);
    let counts = counts_of(&plant, 0.01);
    plant.command(0, position(counts, 8000)).expect("cable");
    plant.advance(1.0).expect("moves");
    make_ready(&mut plant, 0, Mode::Position);
    let feedback = plant.read_sensors().feedback[0].expect("it answers");
    assert!(feedback.counts.abs() <= 1, "{feedback:?}");
    plant.command(0, position(counts, 8000)).expect("cable");
    plant.advance(1.0).expect("moves");
    assert!((plant.truth().expect("a path").drum_positions_m[0] - 0.02).abs() < 1e-6);
}
