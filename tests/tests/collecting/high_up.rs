//! High up, where cables are flat and tight, the platform stands still: with a current as its output and too little
//! damping the machine of seed 21 shook at 8 Hz there, more and more, until its board stopped it.

use mcdpr::calibration::collect::{Asked, Reach, way};
use mcdpr::experiment::SimulatedRobot;
use mcdpr::link::{Client, Event};
use mcdpr::machine::{self, Mismatch};
use mcdpr::motion::Model;
use mcdpr::robot::Robot;
use mcdpr::run::{self, Recorder};
use mcdpr_protocol::SessionId;
use nalgebra::Vector3;

/// Least and greatest tension of each cable over the fourth second of a rest at a place high up, N.
fn tensions_n(robot: &Robot, seed: u64) -> Vec<[f64; 2]> {
    let model = Model::new(robot).unwrap();
    let built = Mismatch::as_built();
    let link = SimulatedRobot::new(built, seed).at_home(&model).unwrap();
    let mut client = Client::connect(link, SessionId(1)).unwrap();
    let hash = run::configure(&mut client, robot).unwrap();
    let home = model.rest_at_home().unwrap();
    let reference = machine::reference(&home.paid_out_m, home.tensions_n());
    client.request(reference).unwrap();
    run::arm(&mut client, hash).unwrap();
    let reach = Reach::new(&model).unwrap();
    // As high up as the limit of tension allows.
    let (high_up, way) = (45..200)
        .find_map(|below_mm| {
            let at_m = Vector3::new(0.48, 0.11, -1e-3 * f64::from(below_mm));
            (20..34).rev().find_map(|tension_n| {
                let rest = reach.rest(&Asked {
                    at_m,
                    attitude: home.equilibrium.pose.rotation,
                    tension_n: f64::from(tension_n),
                })?;
                let way = way(&reach, robot, &home, &rest, 0.5, &[0.0; 4])?;
                Some((rest, way))
            })
        })
        .unwrap();
    println!(
        "at {:.3?}, tensions {:.1?} N",
        high_up.equilibrium.pose.position_m,
        high_up.tensions_n()
    );
    run::follow(&mut client, &way.knots, &mut Recorder::default(), |_| {}).unwrap();
    let arrived_us = client.now_us();
    client.pump(arrived_us + 3_000_000).unwrap();
    while client.next_event().is_some() {}
    client.pump(arrived_us + 4_000_000).unwrap();
    let mut seen = vec![[f64::MAX, f64::MIN]; 4];
    while let Some(event) = client.next_event() {
        let Event::Samples(block) = event else {
            continue;
        };
        let mut recorder = Recorder::default();
        recorder.take(&block, 0.0);
        for sample in &recorder.samples {
            for ([least, most], tension_n) in seen.iter_mut().zip(&sample.tensions_n) {
                *least = least.min(*tension_n);
                *most = most.max(*tension_n);
            }
        }
    }
    run::disarm(&mut client).unwrap();
    seen
}

#[test]
fn a_platform_high_up_stands_still() {
    let robot = Robot::built_in("lab-fast").unwrap();
    for seed in [5, 19, 21] {
        let seen = tensions_n(&robot, seed);
        println!("seed {seed}: {seen:.2?}");
        // Sensor noise and the rest of the way's swing.
        assert!(
            seen.iter().all(|[least, most]| most - least < 1.0),
            "seed {seed}: {seen:?}"
        );
    }
}
