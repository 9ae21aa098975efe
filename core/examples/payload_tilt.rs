//! How well the centre of a payload is known along gravity, by how far the platform tilts: the curve, and where it reaches 2 mm.
//!
//! `cargo run --release -p mcdpr-core --example payload_tilt`
//!
//! A robot whose lengths hold the attitude takes a load of 0.3 of its platform and rests level, and tilted by an angle about x
//! and y, both ways. Standard deviations are those that the tracker states, after 30 rests over the work space without a load.
//! *Along* is without the assumption that a load hangs 30 mm (20 mm) below the fingers.

use mcdpr_core::estimate::Measurements;
use mcdpr_core::estimate::track::{Load, Prior, Rubbing, Tracker};
use mcdpr_core::motion::{Model, StaticState};
use mcdpr_core::robot::Robot;
use mcdpr_kinematics::Pose;
use nalgebra::{Rotation3, Vector3};

/// Share of the platform's mass.
const LOAD: f64 = 0.3;
/// Where the load hangs below the tool, m.
const BELOW_M: f64 = 0.03;

fn main() {
    println!(
        "tilt, deg | cables hold it | mass, % | across, mm | along, mm | along, with assumption, mm"
    );
    for name in ["eight-cable", "six-cable"] {
        println!("{name}");
        for tilt_deg in [0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0] {
            let free = Prior {
                below_m: [BELOW_M, 0.5],
                ..Prior::default()
            };
            let known = [free, Prior::default()].map(|prior| weighed(name, &prior, tilt_deg));
            let [Some(free), Some(hangs)] = known else {
                println!("{tilt_deg:9.0} | no");
                continue;
            };
            let mm = 1e3 * free.center_sigma_m;
            println!(
                "{tilt_deg:9.0} | yes            | {:7.2} | {:10.1} | {:9.1} | {:.1}",
                100.0 * free.mass_sigma_kg / free.mass_kg,
                mm.xy().norm(),
                mm.z,
                1e3 * hangs.center_sigma_m.z,
            );
        }
    }
}

/// What the tracker knows of a load after rests at these attitudes; `None` where the cables cannot hold one of them.
fn weighed(name: &str, prior: &Prior, tilt_deg: f64) -> Option<Load> {
    let robot = Robot::built_in(name).ok()?;
    let model = Model::new(&robot).ok()?;
    let mut tracker = Tracker::new(&model, prior);
    let home = model.rest_at_home().ok()?.equilibrium.pose;
    for index in 0..30 {
        let turn = 2.4 * f64::from(index);
        let by = Vector3::new(turn.cos(), turn.sin(), 0.5 * (3.1 * turn).sin()) * 0.08;
        let there = Pose {
            position_m: home.position_m + by,
            ..home
        };
        measure(&mut tracker, &model.rest_at_pose(&there).ok()?);
    }
    let mut heavy = robot;
    let at = heavy.tool.tcp_in_platform_m - Vector3::new(0.0, 0.0, BELOW_M);
    let platform = &mut heavy.platform;
    let load_kg = LOAD * platform.mass_kg;
    let moment = platform.center_of_mass_m * platform.mass_kg + at * load_kg;
    platform.mass_kg += load_kg;
    platform.center_of_mass_m = moment / platform.mass_kg;
    let heavy = Model::new(&heavy).ok()?;
    tracker.lift();
    let tilt = tilt_deg.to_radians();
    let tilts = [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y()];
    for axis in std::iter::once(Vector3::zeros()).chain(tilts) {
        let there = Pose {
            rotation: Rotation3::new(axis * tilt) * home.rotation,
            ..home
        };
        measure(&mut tracker, &heavy.rest_at_pose(&there).ok()?);
    }
    tracker.load()
}

fn measure(tracker: &mut Tracker, rest: &StaticState) {
    let count = rest.paid_out_m.len();
    let measured = Measurements {
        lengths_m: rest.paid_out_m.clone(),
        tensions_n: rest.tensions_n().to_vec(),
        ..Measurements::default()
    };
    let friction = Rubbing {
        side: 0.0,
        unsure: 0.3,
    };
    tracker.pass(5.0, rest.tensions_n());
    tracker.rest(&measured, &vec![friction; count], &rest.equilibrium.pose);
}
