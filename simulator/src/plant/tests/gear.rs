//! Motor and drum on their shaft: friction, loss, play and twist, against calculations by hand.

use super::super::gear::Gear;
use super::*;

/// A weight on a line on a winch with this gear: 20 mm drum, 43:1, rotor of 1e-6 kg m^2.
fn geared(mass_kg: f64, gear: GearParams) -> Plant {
    let mut params = PlantParams::paper_optimistic();
    params.cables.truncate(1);
    params.winches.truncate(1);
    let cable = &mut params.cables[0];
    cable.anchor_m = [0.0; 3];
    cable.pulley_radius_m = 0.0;
    cable.attachment_m = [0.0; 3];
    cable.damping_time_s = 5e-3;
    params.platform.mass_kg = mass_kg;
    params.platform.center_of_mass_m = [0.0, 0.0, -0.03];
    let winch = &mut params.winches[0];
    winch.gear_ratio = 43.0;
    winch.motor_counts_per_drum_turn = 43.0 * 4096.0;
    winch.rotor_inertia_kg_m2 = 1e-6;
    winch.friction_n = 0.0;
    winch.max_current_a = 3.0;
    winch.gear = Some(gear);
    // No motor here turns a drum under its closed brake.
    winch.brake.holding_n = 1e5;
    let mut plant = Plant::new(params, 7).expect("good parameters");
    plant
        .settle_at(&Pose::level([0.0, 0.0, -0.5]), &[9.81 * mass_kg], None)
        .expect("a pendulum");
    plant
}

/// Motor torque (N m) while the winch turns at this speed, positive as it hauls in.
fn torque_at(plant: &mut Plant, rpm: i16) -> f64 {
    plant
        .command(0, DriveCommand::Velocity { rpm })
        .expect("cable");
    plant.advance(0.7).expect("turns");
    let mut mean = 0.0;
    for _ in 0..500 {
        plant.advance(1e-3).expect("turns");
        mean -= plant.truth().expect("a path").motor_currents_a[0] / 500.0;
    }
    mean * plant.params().winches[0].torque_constant_nm_per_a
}

fn turning(gear: GearParams) -> Plant {
    let mut plant = geared(0.361_88, gear);
    make_ready(&mut plant, 0, Mode::Velocity);
    plant
        .command(0, DriveCommand::Velocity { rpm: 0 })
        .expect("cable");
    plant.advance(0.01).expect("held");
    plant.set_brake(0, false).expect("cable");
    plant.advance(0.5).expect("held");
    plant
}

#[test]
fn a_gear_of_the_data_sheet_takes_its_share_in_both_directions() {
    // Faulhaber 16/7, 43:1: 70 %. Its page on gearheads asks for 71 mN m at the output (3.55 N on a
    // drum of 20 mm): 71 / 43 / 0.7 = 2.36 mN m at the motor. Driven by the load: 43 % of 1.65 mN m
    // come back. Friction without load adds to the one and takes from the other.
    let mut plant = turning(GearParams {
        rotor_friction_nm: 1e-4,
        gear_friction_nm: 1e-4,
        efficiency_driving: 0.7,
        efficiency_driven: 0.43,
        play_rad: 0.02,
        ..GearParams::default()
    });
    let up = torque_at(&mut plant, -100);
    let down = torque_at(&mut plant, 100);
    println!("up {:.3} mN m, down {:.3} mN m", up * 1e3, down * 1e3);
    assert!((up - (2.359e-3 + 2e-4)).abs() < 2e-5, "{up}");
    assert!((down - (0.710e-3 - 2e-4)).abs() < 2e-5, "{down}");
}

#[test]
fn what_sticks_does_not_creep_and_breaks_loose_at_static_friction() {
    // No load: 1 mN m of Coulomb friction, half as much again at rest, on 3 mN m/A... in steps.
    let gear = GearParams {
        rotor_friction_nm: 1e-3,
        static_friction: 1.5,
        ..GearParams::default()
    };
    let mut plant = geared(0.01, gear);
    make_ready(&mut plant, 0, Mode::Current);
    // 0.0981 N of weight are 0.046 mN m at the motor: 1.45 mN m do not move it, 1.6 do.
    let amperes = |nm: f64| (nm * 1e5) as i16; // 0.01 N m/A: mA per N m
    for (nm, moves) in [(1.45e-3, false), (1.60e-3, true)] {
        plant
            .command(
                0,
                DriveCommand::Current {
                    milliamps: amperes(nm),
                },
            )
            .expect("cable");
        let before = plant.truth().expect("a path").motor_positions_m[0];
        plant
            .advance(10.0 * f64::from(u8::from(!moves)) + 0.03)
            .expect("sticks or turns");
        let after = plant.truth().expect("a path").motor_positions_m[0];
        assert_eq!(before != after, moves, "{nm} N m: {before} to {after}");
    }
}

#[test]
fn a_self_locking_gear_holds_the_load_without_torque_and_still_lowers_it() {
    let lock = GearParams {
        efficiency_driving: 0.45,
        efficiency_driven: 0.0,
        ..GearParams::default()
    };
    let mut plant = geared(1.0, lock.clone());
    plant.set_brake(0, false).expect("cable");
    // The shaft twists by T / k and no more.
    plant.advance(20.0).expect("hangs");
    let sunk = plant.truth().expect("a path").drum_positions_m[0];
    let twist = 9.81 * 0.02 * 0.02 / 400.0;
    assert!((sunk / twist - 1.0).abs() < 0.02, "{sunk} of {twist}");
    // Driven down, the motor pushes with almost no force.
    let mut plant = turning(lock);
    let down = torque_at(&mut plant, 100);
    assert!(down.abs() < 2e-5, "{down}");
}

#[test]
fn the_motor_turns_through_the_play_before_the_drum() {
    let play_rad = 1.5_f64.to_radians();
    let gear = GearParams {
        play_rad,
        ..GearParams::default()
    };
    let mut plant = geared(0.5, gear);
    make_ready(&mut plant, 0, Mode::Position);
    // Against the closed brake: out by 2 mm, and the motor moves as far as play and twist allow.
    let counts = |metres: f64| (metres / (std::f64::consts::TAU * 0.02) * 43.0 * 4096.0) as i64;
    let go = |plant: &mut Plant, metres: f64| {
        let to = DriveCommand::Position {
            counts: counts(metres),
            rpm_limit: 8000,
        };
        plant.command(0, to).expect("cable");
        plant.advance(0.5).expect("pushes");
        plant.truth().expect("a path").motor_positions_m[0]
    };
    let near = go(&mut plant, 0.0);
    let far = go(&mut plant, 2e-3);
    let strongest_n = 3.0 * plant.params().winches[0].force_per_ampere_n();
    let expected = play_rad * 0.02 + strongest_n.min(1e9) / (400.0 / 0.02 / 0.02);
    println!("through {} of {expected}", far - near);
    assert!(
        ((far - near) / expected - 1.0).abs() < 0.05,
        "{}",
        far - near
    );
    assert_eq!(plant.truth().expect("a path").drum_positions_m[0], 0.0);
}

#[test]
fn an_eccentric_drum_pays_out_what_its_shape_says() {
    let mut params = PlantParams::paper_optimistic();
    params.winches[0].eccentricity_m = 1e-4;
    params.winches[0].eccentric_rad = 0.5;
    let mut plant = winches_alone(params);
    make_ready(&mut plant, 0, Mode::Position);
    let quarter = DriveCommand::Position {
        counts: 1_520_148 / 4,
        rpm_limit: 8000,
    };
    let before = plant.truth().expect("a path").unstretched_lengths_m[0];
    plant.command(0, quarter).expect("cable");
    plant.advance(3.0).expect("turns");
    let after = plant.truth().expect("a path").unstretched_lengths_m[0];
    let turn = std::f64::consts::FRAC_PI_2;
    let expected = 0.02 * turn + 1e-4 * ((turn + 0.5).sin() - 0.5_f64.sin());
    assert!(
        (after - before - expected).abs() < 2e-6,
        "{}",
        after - before
    );
}

#[test]
fn stick_slip_is_that_of_the_literature() {
    // Canudas de Wit, Olsson, Astrom and Lischinsky, IEEE Trans. Autom. Control 40 (1995) 419: 1 kg
    // pulled over a spring of 2 N/m at 0.1 m/s, Coulomb 1 N, static 1.5 N, Stribeck 1 mm/s,
    // 0.4 N s/m: it sticks until 1.5 N, 7.5 s, slips for a little more than half a period of the
    // spring, and sticks again.
    let params = WinchParams {
        drum_radius_m: 1.0,
        gear_ratio: 1.0,
        rotor_inertia_kg_m2: 1.0,
        ..WinchParams::default()
    };
    let per_rpm = params.mps_per_rpm();
    let gear = GearParams {
        rotor_friction_nm: 1.0,
        static_friction: 1.5,
        stribeck_rpm: 1e-3 / per_rpm,
        viscous_nm_per_rpm: 0.4 * per_rpm,
        ..GearParams::default()
    };
    let mut body = Gear::new(&params, &gear);
    body.motor_m = 0.0;
    let h = 1e-4;
    let (mut slips, mut sticks) = (Vec::new(), Vec::new());
    for step in 0..300_000 {
        let time_s = f64::from(step) * h;
        let was = body.motor_rate;
        let spring_n = 2.0 * (0.1 * time_s - body.motor_m);
        body.kick(spring_n, 0.0, h);
        body.motor_m += h * body.motor_rate;
        match (was == 0.0, body.motor_rate == 0.0) {
            (true, false) => slips.push(time_s),
            (false, true) => sticks.push(time_s),
            _ => {}
        }
    }
    println!("slips at {slips:?}, sticks at {sticks:?}");
    assert!((slips[0] - 7.5).abs() < 0.01, "{slips:?}");
    // Half a period of the spring, 2.2 s, and the two arcs in which it is slower than the pull.
    assert!((sticks[0] - slips[0] - 2.8).abs() < 0.2, "{sticks:?}");
    assert!((slips[1] - slips[0] - 6.5).abs() < 0.3, "{slips:?}");
    assert!(slips.len() >= 3, "{slips:?}");
}
