//! Time of one update of the tracker of slow states, and of those after a knock, beside one plan's equilibrium in the same run.
//!
//! `cargo run --release -p mcdpr-core --example track_time`

use mcdpr_core::estimate::Measurements;
use mcdpr_core::estimate::track::{Prior, Rubbing, Tracker};
use mcdpr_core::motion::{Model, StaticState};
use nalgebra::Vector3;
use std::time::Instant;

/// Updates that are timed.
const UPDATES: u32 = 400;

fn main() {
    for name in ["lab-fast", "eight-cable"] {
        let model = Model::new(&mcdpr_core::robot::Robot::built_in(name).unwrap()).unwrap();
        let home = model.robot().tool.home_in_world_m;
        let count = model.robot().cables.len();
        let rests: Vec<_> = (0..UPDATES)
            .map(|index| {
                let turn = f64::from(index) * 0.7;
                let by = Vector3::new(turn.cos(), turn.sin(), 0.0) * 0.05;
                model.rest(&(home + by), None).unwrap()
            })
            .collect();
        let began = Instant::now();
        for rest in &rests {
            std::hint::black_box(model.rest(&model.tool_m(rest), Some(rest)).unwrap());
        }
        let plan_us = began.elapsed().as_secs_f64() * 1e6 / f64::from(UPDATES);
        let mut tracker = Tracker::new(&model, &Prior::default());
        let friction = Rubbing {
            side: 0.0,
            unsure: 0.3,
        };
        let rubbing = vec![friction; count];
        let mut update = |rest: &StaticState| {
            let measured = Measurements {
                lengths_m: rest.paid_out_m.clone(),
                tensions_n: rest.tensions_n().to_vec(),
                ..Measurements::default()
            };
            tracker.pass(1.0, rest.tensions_n());
            tracker.rest(&measured, &rubbing, &rest.equilibrium.pose)
        };
        let began = Instant::now();
        for rest in &rests {
            std::hint::black_box(update(rest));
        }
        let track_us = began.elapsed().as_secs_f64() * 1e6 / f64::from(UPDATES);
        // An anchor moves: causes are compared after each rest until one is named.
        let mut knocked = model.robot().clone();
        knocked.cables[0].anchor_in_world_m += Vector3::new(0.001, 0.002, 0.002);
        let knocked = Model::new(&knocked).unwrap();
        let mut slowest_ms: f64 = 0.0;
        for rest in rests.iter().take(12) {
            let moved = knocked.rest(&model.tool_m(rest), Some(rest)).unwrap();
            let began = Instant::now();
            std::hint::black_box(update(&moved));
            slowest_ms = slowest_ms.max(began.elapsed().as_secs_f64() * 1e3);
        }
        println!(
            "{name}: {track_us:.0} us per update, {plan_us:.0} us per equilibrium of a plan; after a knock up to {slowest_ms:.0} ms"
        );
    }
}
