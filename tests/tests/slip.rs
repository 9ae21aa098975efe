//! The self-check of a calibrated robot: readings with noise of robots whose cables slipped.

use mcdpr::calibration::slip::{Finding, Reading, SelfCheck, Sigmas};
use mcdpr::motion::Model;
use mcdpr::robot::Robot;
use nalgebra::Vector3;

/// Normal noise (Box and Muller, 1958) from a counter (splitmix64).
struct Dice(u64);

impl Dice {
    const fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15))
    }
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }
}

const TOOLS: [[f64; 3]; 5] = [
    [0.255, -0.105, -0.18],
    [0.33, 0.0, -0.3],
    [0.4, 0.1, -0.25],
    [0.25, 0.12, -0.4],
    [0.42, -0.1, -0.35],
];

/// Readings with noise of a robot whose cable `cable` (from 0) slipped.
fn reading(model: &Model, tool: usize, slip: (usize, f64), view: bool, dice: &mut Dice) -> Reading {
    let rest = model.rest(&Vector3::from(TOOLS[tool]), None).unwrap();
    let mut lengths_m: Vec<f64> = rest
        .paid_out_m
        .iter()
        .map(|l| l + 2e-5 * dice.normal())
        .collect();
    lengths_m[slip.0] -= slip.1;
    let tensions_n = rest
        .tensions_n()
        .iter()
        .map(|t| t + 0.01 * dice.normal())
        .collect();
    let seen = view.then(|| {
        let off = Vector3::from_fn(|_, _| 1.5e-4 * dice.normal());
        let turn = Vector3::from_fn(|_, _| 3e-4 * dice.normal());
        rest.equilibrium.pose.displaced(&off, &turn)
    });
    Reading {
        lengths_m,
        tensions_n,
        seen,
    }
}

fn finding(model: &Model, tools: &[usize], slip: (usize, f64), view: bool, seed: u64) -> Finding {
    let mut dice = Dice::new(seed);
    let mut check = SelfCheck::new(model, Sigmas::default());
    for &tool in tools {
        check
            .add(&reading(model, tool, slip, view, &mut dice))
            .unwrap();
    }
    check.finding()
}

#[test]
fn an_honest_robot_holds() {
    let model = Model::new(&Robot::find("paper-table5").unwrap()).unwrap();
    for seed in 0..40 {
        for (tools, view) in [
            (&[0][..], false),
            (&[0, 1, 2, 3, 4][..], false),
            (&[1][..], true),
        ] {
            let found = finding(&model, tools, (0, 0.0), view, seed);
            assert_eq!(found, Finding::Holds, "seed {seed}, {tools:?}");
        }
    }
}

#[test]
fn a_slip_shows_at_one_pose_and_the_cable_after_five_or_with_a_tag() {
    let model = Model::new(&Robot::find("paper-table5").unwrap()).unwrap();
    let (mut small, mut shown, mut by_five, mut by_tag, mut all) = (0, 0, 0, 0, 0);
    for cable in 0..4 {
        for seed in 0..10 {
            all += 1;
            let seed = seed + 100 * cable as u64;
            let one = finding(&model, &[1], (cable, 4e-4), false, seed);
            shown += u32::from(one != Finding::Holds);
            let half = finding(&model, &[1], (cable, 2e-4), false, seed);
            small += u32::from(half != Finding::Holds);
            let named = |found| matches!(found, Finding::Cable { cable: c, .. } if c == cable + 1);
            by_five += u32::from(named(finding(
                &model,
                &[0, 1, 2, 3, 4],
                (cable, 1.5e-3),
                false,
                seed,
            )));
            by_tag += u32::from(named(finding(&model, &[1], (cable, 1e-3), true, seed)));
        }
    }
    println!(
        "of {all}: of 0.2 mm {small}, of 0.4 mm shown {shown}, by five {by_five}, by tag {by_tag}"
    );
    assert!(shown * 100 >= all * 95, "{shown} of {all}");
    assert!(by_five * 100 >= all * 90, "{by_five} of {all}");
    assert!(by_tag * 100 >= all * 80, "{by_tag} of {all}");
}

#[test]
fn a_bent_frame_is_no_slip() {
    let robot = Robot::find("paper-table5").unwrap();
    let model = Model::new(&robot).unwrap();
    let mut bent = robot;
    bent.cables[0].anchor_in_world_m += Vector3::new(8e-3, -5e-3, 3e-3);
    bent.cables[2].anchor_in_world_m += Vector3::new(-4e-3, 9e-3, 0.0);
    bent.cables[1].anchor_in_world_m.z -= 8e-3;
    let other = Model::new(&bent).unwrap();
    let mut dice = Dice::new(4);
    let mut check = SelfCheck::new(&model, Sigmas::default());
    for tool in 0..TOOLS.len() {
        check
            .add(&reading(&other, tool, (0, 0.0), true, &mut dice))
            .unwrap();
    }
    let found = check.finding();
    assert!(matches!(found, Finding::NoLongerHolds { .. }), "{found:?}");
}
