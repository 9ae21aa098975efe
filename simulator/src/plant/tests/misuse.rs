//! Bad input is refused with an error that names the cable and the value; nothing panics.

use super::*;

fn refused(change: impl FnOnce(&mut PlantParams)) -> String {
    let mut params = PlantParams::paper_optimistic();
    change(&mut params);
    Plant::new(params, 1)
        .expect_err("must be refused")
        .to_string()
}

#[test]
fn parameters_out_of_range_are_named() {
    for (message, part) in [
        (refused(|p| p.cables.clear()), "0 cables"),
        (refused(|p| p.winches.truncate(3)), "4 cables but 3 winches"),
        (refused(|p| p.cables[2].ea_n = 0.0), "cable 3: ea_n is 0"),
        (
            refused(|p| p.cables[0].swivel_axis = [0.0; 3]),
            "cable 1: length of swivel_axis",
        ),
        (
            refused(|p| p.cables[1].anchor_m[2] = f64::NAN),
            "cable 2: anchor_m is NaN",
        ),
        (
            refused(|p| p.cables[3].pulley_loss = 0.5),
            "cable 4: pulley_loss is 0.5",
        ),
        (
            refused(|p| p.winches[3].drum_radius_m = -0.02),
            "cable 4: drum_radius_m is -0.02",
        ),
        (
            refused(|p| p.winches[0].encoder_sign = 0),
            "cable 1: encoder_sign is 0",
        ),
        (
            refused(|p| p.winches[1].drive.current_lag_s = f64::INFINITY),
            "cable 2: current_lag_s",
        ),
        (
            refused(|p| p.platform.mass_kg = 0.0),
            "platform mass_kg is 0",
        ),
        (
            refused(|p| p.platform.inertia_kg_m2[0][0] = -1.0),
            "principal moment is -1",
        ),
        (
            refused(|p| p.platform.inertia_kg_m2[0][1] = 0.1),
            "must be symmetric",
        ),
        (refused(|p| p.step_s = 0.01), "step_s is 0.01"),
        (
            refused(|p| p.bus.latency_s = 0.002),
            "bus latency_s is 0.002",
        ),
        (
            refused(|p| p.gravity_mps2[0] = f64::NAN),
            "gravity_mps2 is NaN",
        ),
    ] {
        assert!(message.contains(part), "{message} should name {part}");
    }
    let nine = refused(|p| {
        p.cables = vec![p.cables[0].clone(); 9];
        p.winches = vec![p.winches[0].clone(); 9];
    });
    assert!(nine.contains("9 cables; give 1 to 8"), "{nine}");
}

#[test]
fn bad_poses_tensions_and_indices_are_refused_and_change_nothing() {
    let mut plant = at_rest(PlantParams::paper_optimistic(), &off_centre(), 5.0);
    let before = plant.truth().expect("a path");
    let inside = Pose::level([0.025_102 + 0.045 + 0.01, -0.370_603 + 0.065, 0.0241]);
    assert_eq!(
        plant.place_at(&inside, &[5.0; 4]),
        Err(PlantError::InsidePulley { cable: 0 })
    );
    assert_eq!(
        PlantError::InsidePulley { cable: 0 }.to_string(),
        "cable 1: the attachment lies on the swivel axis or inside the pulley; keep the platform clear of the pulley"
    );
    let here = off_centre();
    assert!(matches!(
        plant.place_at(&here, &[5.0; 3]),
        Err(PlantError::Length { given: 3, .. })
    ));
    for bad in [-1.0, f64::NAN, f64::INFINITY, 1e5] {
        let error = plant
            .place_at(&here, &[5.0, bad, 5.0, 5.0])
            .expect_err("refused");
        assert!(
            error.to_string().starts_with("cable 2: tension_n is"),
            "{error}"
        );
    }
    for bad in [
        Pose::level([f64::NAN, 0.0, 0.0]),
        Pose {
            rotation_wxyz: [0.0; 4],
            ..here
        },
    ] {
        assert!(matches!(
            plant.place_at(&bad, &[5.0; 4]),
            Err(PlantError::Parameter { .. })
        ));
    }
    let missing = Err(PlantError::NoSuchCable { cable: 4, count: 4 });
    assert_eq!(plant.command(4, DriveCommand::Off), missing);
    assert_eq!(plant.set_brake(4, true), missing);
    assert_eq!(plant.break_cable(4), missing);
    assert_eq!(plant.slip_cable(4, 0.1), missing);
    assert_eq!(plant.set_winding_gain(4, 1.0), missing);
    assert_eq!(plant.settle_at(&here, &[5.0; 4], Some(4)), missing);
    assert_eq!(plant.settle_with_tension(&here, 4, 5.0), missing);
    assert!(plant.slip_cable(0, f64::NAN).is_err());
    assert!(plant.set_winding_gain(0, 0.0).is_err());
    assert!(
        plant
            .set_load([f64::NAN, 0.0, 0.0], [0.0; 3], [0.0; 3])
            .is_err()
    );
    assert!(plant.advance(-1.0).is_err() && plant.advance(f64::NAN).is_err());
    assert_eq!(plant.truth(), Ok(before));
}

#[test]
fn no_equilibrium_is_said_so() {
    // A twisted pendulum on a single line turns for ever.
    let mut params = PlantParams::paper_optimistic();
    params.cables.truncate(1);
    params.winches.truncate(1);
    params.cables[0].pulley_radius_m = 0.0;
    params.cables[0].attachment_m = [0.0; 3];
    let mut plant = Plant::new(params, 1).expect("good parameters");
    plant
        .set_load([0.0; 3], [0.0; 3], [0.0, 0.0, 0.01])
        .expect("finite");
    let error = plant
        .settle_at(&Pose::level([0.1, -0.37, -0.5]), &[13.7], None)
        .expect_err("it turns");
    assert!(matches!(error, PlantError::NoEquilibrium { .. }), "{error}");
}

#[test]
fn where_the_model_ends_time_stands_still_until_placed_again() {
    let mut params = PlantParams::paper_optimistic();
    params.gravity_mps2 = [0.0; 3];
    let mut plant = Plant::new(params, 1).expect("good parameters");
    plant.place_at(&off_centre(), &[0.0; 4]).expect("a path");
    // Straight toward pulley 1, with the other cables out of the way.
    for cable in 1..4 {
        plant.break_cable(cable).expect("cable");
    }
    let a = off_centre().point_in_world([-0.045, -0.065, 0.0]);
    let way = vec3::sub([0.035, -0.36, 0.0241], a);
    plant
        .set_load(vec3::scale(way, 50.0), [0.0, 0.0, -0.03], [0.0; 3])
        .expect("finite");
    let error = (0..10_000)
        .find_map(|_| plant.advance(1e-3).err())
        .expect("it ends in the pulley");
    assert_eq!(error, PlantError::InsidePulley { cable: 0 });
    let time_s = plant.time_s();
    assert_eq!(plant.advance(1.0), Err(error));
    assert_eq!(plant.time_s(), time_s);
    plant
        .set_load([0.0; 3], [0.0; 3], [0.0; 3])
        .expect("finite");
    plant.place_at(&off_centre(), &[0.0; 4]).expect("a path");
    plant.advance(1.0).expect("it works again");
}

#[test]
fn an_unstable_step_is_reported_and_never_returned() {
    let mut params = PlantParams::paper_optimistic();
    params.step_s = 1e-3;
    for cable in &mut params.cables {
        cable.ea_n = 5e7;
    }
    let mut plant = Plant::new(params, 1).expect("good parameters");
    plant.place_at(&off_centre(), &[5.0; 4]).expect("a path");
    let error = (0..1000)
        .find_map(|_| plant.advance(0.1).err())
        .expect("it explodes");
    assert!(
        matches!(
            error,
            PlantError::Diverged { .. } | PlantError::InsidePulley { .. }
        ),
        "{error}"
    );
}

#[test]
fn a_drum_that_winds_in_everything_is_an_error() {
    let mut plant = winches_alone(PlantParams::paper_optimistic());
    make_ready(&mut plant, 0, Mode::Velocity);
    plant
        .command(0, DriveCommand::Velocity { rpm: -8000 })
        .expect("cable");
    let error = plant.advance(60.0).expect_err("less than 2.7 m of cable");
    assert_eq!(error, PlantError::Exhausted { cable: 0 });
}

#[test]
fn a_disturbed_winding_changes_the_cable_but_not_the_encoder() {
    let mut plant = winches_alone(PlantParams::paper_optimistic());
    make_ready(&mut plant, 0, Mode::Position);
    let start = plant.truth().expect("a path").unstretched_lengths_m[0];
    let mut go = |metres: f64| {
        let counts = (metres / plant.params().winches[0].metres_per_motor_count()) as i64;
        let command = DriveCommand::Position {
            counts,
            rpm_limit: 8000,
        };
        plant.command(0, command).expect("cable");
        plant.advance(3.0).expect("turns");
        let change = plant.truth().expect("a path").unstretched_lengths_m[0] - start;
        plant.set_winding_gain(0, 1.1).expect("cable");
        change
    };
    assert!((go(0.05) - 0.05).abs() < 1e-6);
    assert!((go(0.1) - (0.05 + 1.1 * 0.05)).abs() < 1e-6);
}
