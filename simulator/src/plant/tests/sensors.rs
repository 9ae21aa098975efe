//! Encoders and tension sensors: their law, their noise, their faults, and determinism.

use super::*;

/// Turns winch 1's drum by `metres` in position mode.
fn turn_to(plant: &mut Plant, metres: f64) {
    let counts = (metres / plant.params().winches[0].metres_per_motor_count()).round() as i64;
    let command = DriveCommand::Position {
        counts,
        rpm_limit: 8000,
    };
    plant.command(0, command).expect("cable");
    plant.advance(0.3 + metres.abs() / 0.04).expect("turns");
}

fn turning() -> Plant {
    let mut plant = winches_alone(PlantParams::paper_optimistic());
    make_ready(&mut plant, 0, Mode::Position);
    plant
}

fn counter(plant: &mut Plant) -> u16 {
    plant.read_sensors().encoder_counts[0]
}

#[test]
fn an_encoder_counts_whole_steps_and_wraps() {
    for encoder_sign in [1_i8, -1] {
        let mut params = PlantParams::paper_optimistic();
        params.winches[0].encoder_sign = encoder_sign;
        let mut plant = winches_alone(params);
        make_ready(&mut plant, 0, Mode::Position);
        let step = plant.params().winches[0].metres_per_encoder_count();
        assert!((step - 3.068e-5).abs() < 1e-8);
        // The counter starts at 0 independent of the drum's position between two counts.
        assert_eq!(counter(&mut plant), 0);
        for target in [0.01, -0.01, 0.3] {
            turn_to(&mut plant, target);
            let drum = plant.truth().expect("a path").drum_positions_m[0];
            let exact = f64::from(encoder_sign) * drum / step;
            let got = f64::from(counter(&mut plant) as i16);
            assert!((got - exact).abs() <= 1.0, "{got} {exact}");
        }
    }
    // 65536 counts are 2.01 m: go over the counter's end.
    let mut plant = turning();
    turn_to(&mut plant, 2.1);
    let expected = (2.1 / plant.params().winches[0].metres_per_encoder_count()) as u32;
    let got = u32::from(counter(&mut plant)) + 65_536;
    assert!(got.abs_diff(expected) <= 1, "{got} {expected}");
}

#[test]
fn encoder_faults_do_as_they_are_named_and_end() {
    let mut plant = turning();
    turn_to(&mut plant, 0.01);
    let at_10_mm = counter(&mut plant);
    assert!(at_10_mm.abs_diff(326) <= 1);

    plant.faults_mut().cables[0].encoder = EncoderFault::Glitch(500);
    assert_eq!(counter(&mut plant), at_10_mm + 500);
    assert_eq!(counter(&mut plant), at_10_mm);

    plant.faults_mut().cables[0].encoder = EncoderFault::Stuck;
    assert_eq!(counter(&mut plant), at_10_mm);
    turn_to(&mut plant, 0.02);
    assert_eq!(counter(&mut plant), at_10_mm);
    // Counts missed while stuck stay missed.
    plant.faults_mut().cables[0].encoder = EncoderFault::None;
    assert_eq!(counter(&mut plant), at_10_mm);
    turn_to(&mut plant, 0.03);
    let now = counter(&mut plant);
    assert!(now.abs_diff(at_10_mm + 326) <= 1, "{now}");

    plant.faults_mut().cables[0].encoder = EncoderFault::Reversed;
    assert_eq!(counter(&mut plant), now);
    turn_to(&mut plant, 0.035);
    assert!(counter(&mut plant).abs_diff(now - 163) <= 1);

    plant.faults_mut().cables[0].encoder = EncoderFault::None;
    let held = counter(&mut plant);
    plant.faults_mut().cables[0].encoder = EncoderFault::Disconnected;
    counter(&mut plant);
    turn_to(&mut plant, 0.05);
    let shown: Vec<u16> = (0..50).map(|_| counter(&mut plant) - held).collect();
    assert!(shown.contains(&0) && shown.contains(&1) && shown.iter().all(|d| *d < 2));
}

/// Mean and standard deviation of 4000 readings of sensor 4, in newtons by the paper's law.
fn sensed(plant: &mut Plant) -> (f64, f64) {
    let readings: Vec<f64> = (0..4000)
        .map(|_| {
            let volts = f64::from(plant.read_sensors().adc[3]) / 65_536.0 * 3.3;
            12.77 * (volts - 0.2355)
        })
        .collect();
    let mean = readings.iter().sum::<f64>() / 4000.0;
    let variance = readings.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / 3999.0;
    (mean, variance.sqrt())
}

#[test]
fn a_tension_sensor_follows_its_law_with_its_noise() {
    for tension_n in [2.0, 5.0, 8.0] {
        let mut plant = at_rest(PlantParams::paper_optimistic(), &off_centre(), tension_n);
        let (mean, sd) = sensed(&mut plant);
        // Four standard errors of 0.05 N over 4000 readings.
        assert!((mean - tension_n).abs() < 0.0032, "{mean}");
        assert!((sd - 0.05).abs() < 0.003, "{sd}");
    }
    // Without tension it shows its zero: 0.2355 V.
    let mut plant = winches_alone(PlantParams::paper_optimistic());
    let (mean, _) = sensed(&mut plant);
    assert!(mean.abs() < 0.0032, "{mean}");
    // The paper's full scale: 3.3 V are 39.13 N; beyond, the rail.
    let mut params = PlantParams::paper_optimistic();
    params.winches[3].sensor.noise_n = 0.0;
    let mut plant = Plant::new(params, 1).expect("good parameters");
    for (tension_n, reading) in [(39.0, 65_328), (39.2, 65_520), (100.0, 65_520)] {
        let tensions = [10.0, 10.0, 10.0, tension_n];
        plant.place_at(&off_centre(), &tensions).expect("a path");
        let adc = plant.read_sensors().adc[3];
        assert!(adc.abs_diff(reading) <= 2, "{adc} at {tension_n} N");
    }
}

#[test]
fn tension_is_sensed_at_the_winch() {
    let mut params = PlantParams::paper_optimistic();
    params.cables[3].pulley_loss = 0.03;
    params.winches[3].sensor.noise_n = 0.0;
    let mut plant = at_rest(params, &off_centre(), 6.0);
    make_ready(&mut plant, 3, Mode::Velocity);
    plant
        .command(3, DriveCommand::Velocity { rpm: -200 })
        .expect("cable");
    plant.advance(0.01).expect("held");
    plant.set_brake(3, false).expect("cable");
    plant.advance(1.0).expect("hauls in");
    let truth = plant.truth().expect("a path");
    let ratio = truth.tensions_winch_n[3] / truth.tensions_platform_n[3];
    assert!(ratio > 1.02, "{ratio}");
    let (mean, _) = sensed(&mut plant);
    assert!(
        (mean - truth.tensions_winch_n[3]).abs() < 0.3 * (ratio - 1.0) * mean,
        "{mean} {truth:?}"
    );
}

#[test]
fn tension_faults_do_as_they_are_named() {
    let mut plant = at_rest(PlantParams::paper_optimistic(), &off_centre(), 5.0);
    let fault = |plant: &mut Plant, fault| {
        plant.faults_mut().cables[3].tension = fault;
        [plant.read_sensors().adc[3], plant.read_sensors().adc[3]]
    };
    // Within 1 % of the rail, which the board calls open.
    fault(&mut plant, TensionFault::Open);
    // The pull-up charges the filter.
    plant.advance(0.1).expect("rests");
    let open = fault(&mut plant, TensionFault::Open);
    assert!(open.iter().all(|adc| *adc > 64_900), "{open:?}");
    assert_eq!(fault(&mut plant, TensionFault::Short), [0; 2]);
    let [a, b] = fault(&mut plant, TensionFault::Frozen);
    assert_eq!(a, b);
    let [a, b] = fault(&mut plant, TensionFault::None);
    assert_ne!(a, b);
    plant.faults_mut().cables[3].tension_noise_factor = 10.0;
    let (_, sd) = sensed(&mut plant);
    assert!((sd - 0.5).abs() < 0.03, "{sd}");
    plant.faults_mut().cables[3].tension_noise_factor = 1.0;
    plant.faults_mut().cables[3].tension_drift_n_per_s = 0.5;
    plant.read_sensors();
    plant.advance(2.0).expect("rests");
    let (mean, _) = sensed(&mut plant);
    assert!((mean - 6.0).abs() < 0.01, "{mean}");
    plant.faults_mut().cables[3].tension_drift_n_per_s = 0.0;
    plant.faults_mut().cables[3].tension_offset_n = -1.0;
    let (mean, _) = sensed(&mut plant);
    assert!((mean - 4.0).abs() < 0.01, "{mean}");
}

/// A busy second: motors, loss, load, noise. All readings and the final truth.
fn busy(seed: u64) -> (Vec<Sensors>, Truth) {
    let mut params = PlantParams::paper_optimistic();
    for cable in &mut params.cables {
        cable.pulley_loss = 0.02;
    }
    let mut plant = Plant::new(params, seed).expect("good parameters");
    plant
        .settle_with_tension(&off_centre(), 3, 5.0)
        .expect("an equilibrium");
    make_ready(&mut plant, 3, Mode::Current);
    plant
        .command(3, DriveCommand::Current { milliamps: -30 })
        .expect("cable");
    plant.set_brake(3, false).expect("cable");
    plant
        .set_load([0.5, 0.0, 0.0], [0.0; 3], [0.0; 3])
        .expect("finite");
    let readings = (0..1000)
        .map(|_| {
            plant.advance(1e-3).expect("no failure");
            plant.read_sensors()
        })
        .collect();
    (readings, plant.truth().expect("a path"))
}

#[test]
fn a_seed_gives_the_same_run_bit_by_bit_and_another_does_not() {
    let (first, again, other) = (busy(5), busy(5), busy(6));
    assert_eq!(first, again);
    assert_eq!(first.1.energy_j.to_bits(), again.1.energy_j.to_bits());
    assert_ne!(first.0, other.0);
    // The seed is in the sensors only: the physics itself is the same.
    assert_eq!(first.1, other.1);
}

#[test]
fn the_length_of_the_calls_does_not_matter() {
    let mut plant = at_rest(PlantParams::paper_optimistic(), &off_centre(), 5.0);
    plant
        .set_load([1.0, 0.0, 0.0], [0.0; 3], [0.0; 3])
        .expect("finite");
    let mut other = plant.clone();
    plant.advance(1.0).expect("swings");
    for _ in 0..3000 {
        other.advance(1.0 / 3000.0).expect("swings");
    }
    assert_eq!(plant.truth(), other.truth());
}
