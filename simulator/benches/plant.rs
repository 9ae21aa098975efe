//! Speed of the plant: time of one simulated second, and simulated seconds per second.

use std::hint::black_box;
use std::time::Instant;

use criterion::{Criterion, criterion_group, criterion_main};
use mcdpr_simulator::plant::{DriveCommand, Mode, Plant, PlantParams, Pose};

/// The paper's robot, all brakes open: cables 1-3 in position mode, cable 4 in current mode,
/// with pulley loss, so that no part of the model is idle.
fn running_plant() -> Plant {
    let mut params = PlantParams::paper_optimistic();
    for cable in &mut params.cables {
        cable.pulley_loss = 0.02;
    }
    let mut plant = Plant::new(params, 1).expect("good parameters");
    plant
        .settle_with_tension(&Pose::level([0.33, 0.0, -0.2]), 3, 5.0)
        .expect("equilibrium");
    for cable in 0..4 {
        let mode = if cable == 3 {
            Mode::Current
        } else {
            Mode::Position
        };
        plant.command(cable, DriveCommand::Reset).expect("cable");
        plant.advance(0.6).expect("at rest");
        plant
            .command(cable, DriveCommand::SelectMode(mode))
            .expect("cable");
        plant.advance(0.6).expect("at rest");
    }
    for cable in 0..4 {
        plant.set_brake(cable, false).expect("cable");
    }
    plant
}

/// One second of a controller's life: a command and a reading per millisecond.
fn one_second(plant: &mut Plant) {
    for tick in 0..1000_i64 {
        for cable in 0..3 {
            let counts = (tick - 500).abs() * 10;
            let rpm_limit = 8000;
            let command = DriveCommand::Position { counts, rpm_limit };
            plant.command(cable, command).expect("cable");
        }
        let milliamps = -27;
        plant
            .command(3, DriveCommand::Current { milliamps })
            .expect("cable");
        plant.advance(1e-3).expect("no failure");
        black_box(plant.read_sensors());
    }
}

fn bench(c: &mut Criterion) {
    let mut plant = running_plant();
    let begin = Instant::now();
    for _ in 0..10 {
        one_second(&mut plant);
    }
    let rate = 10.0 / begin.elapsed().as_secs_f64();
    println!("plant at 10 kHz, 4 cables: {rate:.0} simulated seconds per second");
    c.bench_function("one simulated second, 4 cables, 10 kHz", |b| {
        b.iter(|| one_second(&mut plant));
    });
}

criterion_group!(benches, bench);
criterion_main!(benches);
