//! A cable that slips on its drum while poses are collected: it is named, whenever it slipped.

use crate::{options, with_board};
use mcdpr::calibration::collect::{Step, collect};
use mcdpr::experiment::SimulatedRobot;
use mcdpr::link::{Link, LinkError, SimulatedLink};
use mcdpr::machine::Mismatch;
use mcdpr::motion::Model;
use mcdpr::sight::{Scene, SimulatedTags};
use mcdpr_firmware::State;
use std::cell::Cell;
use std::rc::Rc;

/// Time between two small slips, µs, and how far each goes, m: slower than what the board takes for a break.
const STEP_US: u64 = 10_000;
const STEP_M: f64 = 4e-6;

/// A robot of which a cable slips while it moves.
struct Slipping {
    link: SimulatedLink,
    cable: usize,
    sign: f64,
    /// What is left of the slip, m.
    left_m: Rc<Cell<f64>>,
    /// When it goes on.
    next_us: u64,
}

impl Link for Slipping {
    fn now_us(&self) -> u64 {
        self.link.now_us()
    }
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.link.send(bytes)
    }
    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        loop {
            let moving = self.link.with(|s| s.state()) == State::Moving;
            let now = self.link.now_us();
            if moving && now >= self.next_us && self.left_m.get() > 0.0 {
                self.next_us = now + STEP_US;
                let (cable, step_m) = (self.cable, self.sign * STEP_M);
                self.link
                    .with(|s| s.plant_mut().slip_cable(cable, step_m))
                    .unwrap();
                self.left_m.set(self.left_m.get() - STEP_M);
            }
            let next_us = until_us.min(self.link.now_us() + STEP_US);
            let now = self.link.receive(next_us, into)?;
            if now >= until_us || !into.is_empty() {
                return Ok(now);
            }
        }
    }
}

#[test]
fn a_cable_that_slips_on_the_way_to_any_pose_is_named() {
    let robot = with_board("paper-table5");
    let model = Model::new(&robot).unwrap();
    // On the way to the second, the seventh and the last of twelve poses.
    for (seed, done, cable, slip_m) in [(3, 1, 1, 1e-3), (4, 6, 2, -1e-3), (4, 11, 0, 1e-3)] {
        let link = SimulatedRobot::new(Mismatch::as_built(), seed)
            .at_home(&model)
            .unwrap();
        let scene = Scene::of(&robot, seed);
        let mut tags = SimulatedTags::new(link.clone(), scene, 0.1, seed);
        let left_m = Rc::new(Cell::new(0.0));
        let line = Slipping {
            link,
            cable,
            sign: f64::signum(slip_m),
            left_m: left_m.clone(),
            next_us: 0,
        };
        let (mut kept, mut began) = (0, false);
        let keep = |data: &mcdpr::calibration::Data| {
            kept = data.poses.len();
            Ok(())
        };
        let progress = |step| {
            if matches!(step, Step::Going { done: now, .. } if now == done) && !began {
                began = true;
                left_m.set(slip_m.abs());
            }
        };
        let options = options(12, seed);
        let ended = collect(&model, line, &mut tags, &options, None, keep, progress);
        let words = ended.unwrap_err().to_string();
        let named = format!("cable {} slipped", cable + 1);
        assert!(words.contains(&named), "seed {seed}: {words}");
        assert!(kept > done, "seed {seed}: {kept} poses are kept");
    }
}
