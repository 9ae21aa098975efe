//! Drums under load: friction, brakes, pulley loss, and the motors that hold the platform.

use super::*;

/// One cable straight down from a point anchor, a weight on it, and nothing else.
fn weight_on_a_line(mass_kg: f64) -> PlantParams {
    let mut params = PlantParams::paper_optimistic();
    params.cables.truncate(1);
    params.winches.truncate(1);
    let cable = &mut params.cables[0];
    cable.anchor_m = [0.0; 3];
    cable.pulley_radius_m = 0.0;
    cable.attachment_m = [0.0; 3];
    params.platform.mass_kg = mass_kg;
    params.platform.center_of_mass_m = [0.0, 0.0, -0.03];
    params
}

fn hang(params: PlantParams) -> Plant {
    let weight_n = 9.81 * params.platform.mass_kg;
    let mut plant = Plant::new(params, 7).expect("good parameters");
    plant
        .settle_at(&Pose::level([0.0, 0.0, -0.5]), &[weight_n], None)
        .expect("a pendulum");
    plant
}

fn drum(plant: &Plant) -> f64 {
    plant.truth().expect("a path").drum_positions_m[0]
}

#[test]
fn a_stuck_drum_does_not_creep() {
    // 0.4905 N of weight against 0.5 N of friction, torque off, brake open.
    let mut plant = hang(weight_on_a_line(0.05));
    plant.set_brake(0, false).expect("cable");
    plant.advance(20.0).expect("hangs");
    assert_eq!(drum(&plant), 0.0);
    // 0.5396 N: it pays out.
    let mut plant = hang(weight_on_a_line(0.055));
    plant.set_brake(0, false).expect("cable");
    plant.advance(1.03).expect("falls");
    // 0.0396 N on 0.055 + 0.1 kg for a second.
    let expected = 0.5 * (0.055 * 9.81 - 0.5) / 0.155;
    assert!(
        (drum(&plant) / expected - 1.0).abs() < 0.01,
        "{} of {expected}",
        drum(&plant)
    );
}

#[test]
fn a_free_drum_falls_with_its_rotor() {
    let mut params = weight_on_a_line(1.0);
    params.winches[0].gear_ratio = 27.0;
    params.winches[0].rotor_inertia_kg_m2 = 1e-6;
    let inertia = 0.1 + 1e-6 * (27.0_f64 / 0.02).powi(2);
    let mut plant = hang(params);
    plant.set_brake(0, false).expect("cable");
    plant.advance(0.23).expect("falls");
    let expected = 0.5 * (9.81 - 0.5) / (1.0 + inertia) * 0.04;
    assert!(
        (drum(&plant) / expected - 1.0).abs() < 0.01,
        "{} of {expected}",
        drum(&plant)
    );
}

#[test]
fn a_brake_holds_up_to_its_force_and_slips_beyond() {
    let mut plant = hang(weight_on_a_line(1.0));
    // 147.8 N: below 150 N and friction; applied gently, since a sudden load doubles itself.
    for step in 1..=138 {
        plant
            .set_load([0.0, 0.0, -f64::from(step)], [0.0; 3], [0.0; 3])
            .expect("finite");
        plant.advance(0.05).expect("held");
    }
    plant.advance(5.0).expect("held");
    assert_eq!(drum(&plant), 0.0);
    plant
        .set_load([0.0, 0.0, -145.0], [0.0; 3], [0.0; 3])
        .expect("finite");
    plant.advance(0.5).expect("slips");
    let truth = plant.truth().expect("a path");
    // 154.81 N against 150.5 N, on 1.1 kg: about 3.9 m/s^2.
    let expected = (154.81 - 150.5) / 1.1 * 0.5;
    assert!(
        (truth.drum_speeds_mps[0] / expected - 1.0).abs() < 0.15,
        "{truth:?}"
    );
    // A worn brake slips under the weight alone.
    let mut plant = hang(weight_on_a_line(1.0));
    plant.faults_mut().cables[0].brake.holding_factor = 0.05;
    plant.advance(0.2).expect("slips");
    assert!(drum(&plant) > 0.01);
}

#[test]
fn a_drum_turns_by_the_brakes_play_and_no_farther() {
    let play_m = 0.35e-3;
    let mut params = weight_on_a_line(1.0);
    params.winches[0].brake.play_m = play_m;
    let mut plant = hang(params);
    // The weight has pulled the drum against the disc: it stays there.
    plant.advance(0.5).expect("held");
    assert!(drum(&plant).abs() < 1e-8, "{}", drum(&plant));
    // The drive pulls in: through the play, and no farther.
    make_ready(&mut plant, 0, Mode::Current);
    let mut pull = |milliamps: i16| {
        let command = DriveCommand::Current { milliamps };
        plant.command(0, command).expect("cable");
        plant.advance(0.5).expect("held");
        drum(&plant)
    };
    let pulled = pull(-500).min(pull(500));
    let back = pull(0);
    assert!((pulled + play_m).abs() < 0.02 * play_m, "{pulled}");
    assert!(back.abs() < 0.02 * play_m, "{back}");
    // Closing keeps the drum's position: it falls by the play at most.
    let mut params = weight_on_a_line(1.0);
    params.winches[0].brake.play_m = play_m;
    let mut plant = hang(params);
    plant.set_brake(0, false).expect("cable");
    plant.advance(0.05).expect("falls");
    plant.set_brake(0, true).expect("cable");
    plant.advance(0.2).expect("held");
    let caught = drum(&plant);
    plant.advance(1.0).expect("held");
    assert!(drum(&plant) - caught < 1e-8, "{caught}");
}

#[test]
fn a_brake_opens_and_closes_after_its_delays() {
    let mut plant = hang(weight_on_a_line(1.0));
    plant.set_brake(0, false).expect("cable");
    plant.advance(0.0299).expect("held");
    assert_eq!(drum(&plant), 0.0);
    assert!(plant.truth().expect("a path").brakes_closed[0]);
    plant.advance(0.002).expect("falls");
    assert!(drum(&plant) > 0.0);
    plant.advance(0.1).expect("falls");
    plant.set_brake(0, true).expect("cable");
    plant.advance(0.0299).expect("falls");
    let before = plant.truth().expect("a path");
    assert!(before.drum_speeds_mps[0] > 0.5 && !before.brakes_closed[0]);
    plant.advance(0.2).expect("stops");
    let after = plant.truth().expect("a path");
    assert!(after.brakes_closed[0]);
    assert_eq!(after.drum_speeds_mps[0], 0.0);
    // A slow brake: 100 ms more.
    let mut plant = hang(weight_on_a_line(1.0));
    plant.faults_mut().cables[0].brake.extra_close_delay_s = 0.1;
    plant.set_brake(0, false).expect("cable");
    plant.advance(0.05).expect("falls");
    plant.set_brake(0, true).expect("cable");
    // 2 ms less, as its coil had only 50 ms to get its current.
    plant.advance(0.127).expect("falls");
    assert!(!plant.truth().expect("a path").brakes_closed[0]);
    plant.advance(0.002).expect("falls");
    assert!(plant.truth().expect("a path").brakes_closed[0]);
    // A brake that never opens.
    let mut plant = hang(weight_on_a_line(1.0));
    plant.faults_mut().cables[0].brake.stays_closed = true;
    plant.set_brake(0, false).expect("cable");
    plant.advance(1.0).expect("held");
    assert_eq!(drum(&plant), 0.0);
}

#[test]
fn a_constant_current_holds_a_tension_within_friction() {
    // The platform carried by brakes 1-3; cable 4 pulled by its motor alone.
    let mut plant = at_rest(PlantParams::paper_optimistic(), &off_centre(), 5.0);
    make_ready(&mut plant, 3, Mode::Current);
    let force_per_ma = plant.params().winches[3].force_per_ampere_n() * 1e-3;
    for milliamps in [-27_i16, -40, -20, -27] {
        plant
            .command(3, DriveCommand::Current { milliamps })
            .expect("cable");
        plant.advance(0.05).expect("held");
        plant.set_brake(3, false).expect("cable");
        plant.advance(3.0).expect("swings");
        let mut mean_n = 0.0;
        for _ in 0..3000 {
            plant.advance(1e-3).expect("swings");
            mean_n += plant.truth().expect("a path").tensions_winch_n[3] / 3000.0;
        }
        let asked = -f64::from(milliamps) * force_per_ma;
        assert!((mean_n - asked).abs() < 0.5, "{mean_n} N at {milliamps} mA");
    }
}

#[test]
fn position_mode_carries_the_platform_without_sag() {
    // A bare drum, and the geared winch with a real rotor: 344 kg at the cable.
    for rotor_inertia_kg_m2 in [0.0, 1e-6] {
        let mut params = PlantParams::paper_optimistic();
        for winch in &mut params.winches {
            winch.rotor_inertia_kg_m2 = rotor_inertia_kg_m2;
        }
        let mut plant = at_rest(params, &off_centre(), 3.0);
        let rest = plant.truth().expect("a path");
        let hold = |counts| DriveCommand::Position {
            counts,
            rpm_limit: 8000,
        };
        for cable in 0..4 {
            make_ready(&mut plant, cable, Mode::Position);
            plant.command(cable, hold(0)).expect("cable");
            plant.advance(0.01).expect("held");
            plant.set_brake(cable, false).expect("cable");
        }
        let mut sag = 0.0_f64;
        for _ in 0..1000 {
            plant.advance(1e-3).expect("held");
            let truth = plant.truth().expect("a path");
            sag = truth.drum_positions_m[..4]
                .iter()
                .fold(sag, |m, x| m.max(x.abs()));
        }
        assert!(sag < 1e-4, "{sag} m when the brakes open");
        plant.advance(5.0).expect("held");
        let truth = plant.truth().expect("a path");
        let drums = &truth.drum_positions_m[..4];
        println!("rotor {rotor_inertia_kg_m2}: sag {sag:.2e} m, drums after 5 s {drums:?} m");
        assert!(drums.iter().all(|x| x.abs() < 1e-6), "{drums:?}");
        assert!(distance(truth.pose.position_m, rest.pose.position_m) < 5e-4);
        // All four pay out 5 mm: the platform goes down with them and stays taut.
        let counts = (0.005 / plant.params().winches[0].metres_per_motor_count()) as i64;
        for cable in 0..4 {
            plant.command(cable, hold(counts)).expect("cable");
        }
        plant.advance(3.0).expect("moves");
        let truth = plant.truth().expect("a path");
        let drums = &truth.drum_positions_m[..4];
        // Still swinging, so that load and friction push them about: a sixth of a count.
        assert!(drums.iter().all(|x| (x - 0.005).abs() < 5e-6), "{drums:?}");
        let lowered = rest.pose.position_m[2] - truth.pose.position_m[2];
        assert!((0.004..0.03).contains(&lowered), "{lowered}");
    }
}

/// Ratio of winch to platform tension while a motor winds the weight up and down slowly.
fn loss_loop(rpm: i16) -> Vec<(f64, f64)> {
    let mut params = weight_on_a_line(1.0);
    params.cables[0].pulley_loss = 0.02;
    params.cables[0].damping_time_s = 2e-3;
    let mut plant = hang(params);
    make_ready(&mut plant, 0, Mode::Velocity);
    plant
        .command(0, DriveCommand::Velocity { rpm: 0 })
        .expect("cable");
    plant.advance(0.01).expect("held");
    plant.set_brake(0, false).expect("cable");
    plant.advance(1.0).expect("held");
    let mut ratios = Vec::new();
    let way = 0.004 / (plant.params().winches[0].mps_per_rpm() * f64::from(rpm));
    for turn in 0..4 {
        let rpm = if turn % 2 == 0 { rpm } else { -rpm };
        plant
            .command(0, DriveCommand::Velocity { rpm })
            .expect("cable");
        for _ in 0..100 {
            plant.advance(way / 100.0).expect("moves");
            let truth = plant.truth().expect("a path");
            let ratio = truth.tensions_winch_n[0] / truth.tensions_platform_n[0];
            ratios.push((truth.drum_positions_m[0], ratio));
        }
    }
    ratios
}

#[test]
fn pulley_loss_runs_through_a_loop_whatever_the_speed() {
    let slow = loss_loop(100);
    let fast = loss_loop(400);
    for course in [&slow, &fast] {
        assert!(
            course
                .iter()
                .all(|(_, r)| (0.98 - 1e-9..=1.02 + 1e-9).contains(r))
        );
        // Paid out 4 mm, hauled in 4 mm, twice: saturated at each end.
        assert!((course[99].1 - 0.98).abs() < 1e-4, "{:?}", course[99]);
        assert!((course[199].1 - 1.02).abs() < 1e-4, "{:?}", course[199]);
        assert!((course[299].1 - 0.98).abs() < 1e-4, "{:?}", course[299]);
        // Presliding: 0.1 mm of 0.2 mm past the turn, the friction has not yet reversed.
        let turn = course[99].0;
        let early = course[100..200]
            .iter()
            .find(|(x, _)| turn - x > 1e-4)
            .expect("it passes");
        assert!((0.985..1.01).contains(&early.1), "{early:?}");
    }
    // Rate independence: Dahl's curve from -1 is 1 - 2 exp(-d / sigma) at any speed.
    for course in [&slow, &fast] {
        let turn = course[99..115].iter().map(|c| c.0).fold(0.0, f64::max);
        for (x, ratio) in &course[115..200] {
            let expected = 1.0 + 0.02 * (1.0 - 2.0 * (-(turn - x) / 2e-4).exp());
            assert!((ratio - expected).abs() < 1e-3, "{ratio} {expected}");
        }
    }
}

#[test]
fn the_routing_behind_the_pulley_stretches_too() {
    let stretch = |routing_length_m: f64| {
        let mut params = weight_on_a_line(1.0);
        params.cables[0].routing_length_m = routing_length_m;
        let plant = hang(params);
        let truth = plant.truth().expect("a path");
        truth.cable_lengths_m[0] - truth.unstretched_lengths_m[0]
    };
    // T L / EA = 9.81 * 0.5 / 50000, and 0.7 m more of cable.
    assert!((stretch(0.0) - 9.81 * 0.5 / 50e3).abs() < 1e-7);
    assert!((stretch(0.7) - 9.81 * 1.2 / 50e3).abs() < 1e-7);
}

#[test]
fn a_cable_never_pushes() {
    // Thrown up against slack, with a damping that would push hard if it could.
    let mut params = weight_on_a_line(1.0);
    params.cables[0].damping_time_s = 0.05;
    let mut plant = hang(params);
    plant
        .set_load([0.0, 0.0, 60.0], [0.0; 3], [0.0; 3])
        .expect("finite");
    plant.advance(0.05).expect("thrown");
    plant
        .set_load([0.0; 3], [0.0; 3], [0.0; 3])
        .expect("finite");
    let mut slack = 0;
    for _ in 0..6000 {
        plant.advance(1e-4).expect("bounces");
        let tension = plant.truth().expect("a path").tensions_platform_n[0];
        assert!(tension >= 0.0, "{tension}");
        slack += u32::from(tension == 0.0);
    }
    assert!(slack > 1000, "{slack} substeps of flight");
}
