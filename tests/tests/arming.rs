//! Arming with a broken cable, or one that breaks meanwhile: no brake opens, whichever cable it is and
//! wherever the robot hangs.

use mcdpr::control::Handle;
use mcdpr::link::{Client, SimulatedLink};
use mcdpr::machine::{self, Mismatch};
use mcdpr::motion::{Model, StaticState};
use mcdpr::run::{self, Homing, NoStore, RunError, Session};
use mcdpr_protocol::{FaultId, Request, SessionId};
use mcdpr_simulator::{LinkOptions, Simulation};
use nalgebra::Vector3;

/// The robots whose cables hold a platform, and whose board is the one of four winches or more.
const ROBOTS: [&str; 3] = ["paper-table5", "lab-fast", "lab-direct"];
/// Where they hang, m from home.
const PLACES: [[f64; 3]; 3] = [[0.0; 3], [0.04, 0.03, 0.02], [-0.04, 0.02, -0.03]];

/// The robot as its file describes it, but for what a real one is off by, hanging at a place.
fn hanging(model: &Model, from_home: [f64; 3], seed: u64) -> (SimulatedLink, StaticState) {
    let rest = if from_home == [0.0; 3] {
        model.rest_at_home().unwrap()
    } else {
        let place = model.robot().tool.home_in_world_m + Vector3::from(from_home);
        model.rest(&place, None).unwrap()
    };
    let params = machine::plant_params(model.robot(), &Mismatch::realistic(), seed);
    let (pose, tensions) = (&rest.equilibrium.pose, rest.tensions_n());
    let plant = machine::hang(params, pose, tensions, model.holding().by_tension(), seed).unwrap();
    let simulation = Simulation::new(plant, &LinkOptions::default(), seed).unwrap();
    (SimulatedLink::new(simulation), rest)
}

fn wait(link: &SimulatedLink, ms: u64) {
    link.with(|simulation| {
        let until = simulation.now_us() + 1000 * ms;
        let mut said = Vec::new();
        while simulation.now_us() < until {
            said.clear();
            simulation.advance(until, &mut said).unwrap();
        }
    });
}

/// Whether any brake has opened since the last call, and how far the tool came from `from`, m.
fn seen(link: &SimulatedLink, from: [f64; 3]) -> (bool, f64) {
    link.with(|simulation| {
        let count = simulation.plant().cable_count();
        let trace = simulation.take_trace();
        let opened = trace
            .iter()
            .any(|point| point.truth.brakes_closed[..count].contains(&false));
        let way = |point: [f64; 3]| (Vector3::from(point) - Vector3::from(from)).norm();
        let ways = trace.iter().map(|point| way(point.truth.tool_position_m));
        (opened, ways.fold(0.0, f64::max))
    })
}

fn tool(link: &SimulatedLink) -> [f64; 3] {
    link.with(|simulation| simulation.plant().truth().unwrap().tool_position_m)
}

/// Whether a cable (1 for the first) truly carries less than its floor.
fn is_slack(link: &SimulatedLink, model: &Model, cable: u8) -> bool {
    let truth = link.with(|simulation| simulation.plant().truth().unwrap());
    truth.tensions_winch_n[usize::from(cable) - 1] < model.robot().limits.tension_min_n
}

#[test]
fn c1_c3_a_parked_robot_with_a_broken_cable_opens_no_brake() {
    for name in ROBOTS {
        let model = Model::new(&mcdpr::robot::find(name).unwrap()).unwrap();
        for (seed, place) in (1..).zip(PLACES) {
            for cable in 0..model.robot().cables.len() {
                let what = format!("{name}, place {seed}, cable {}", cable + 1);
                let (link, rest) = hanging(&model, place, seed);
                let open = |homing| {
                    let handle = Handle::default();
                    Session::open(
                        &model,
                        link.clone(),
                        SessionId(7),
                        &handle,
                        homing,
                        &NoStore,
                    )
                };
                let mut session = open(Homing::Place(model.tool_m(&rest))).unwrap();
                session
                    .arm()
                    .unwrap_or_else(|error| panic!("{what}: {error}"));
                session.disarm().unwrap();
                link.with(|s| s.plant_mut().break_cable(cable)).unwrap();
                // On its other cables it swings.
                wait(&link, 500);
                let from = tool(&link);
                let at = link.with(|simulation| {
                    simulation.record_truth();
                    simulation.now_us()
                });
                let outcome = open(Homing::Known).and_then(|mut session| session.arm());
                assert!(outcome.is_err(), "{what} armed");
                // What still swings does so with brakes closed.
                let took = link.with(|simulation| simulation.now_us()) - at;
                let (opened, _) = seen(&link, from);
                assert!(!opened, "{what}: a brake opened");
                if let Err(RunError::Fault { record, .. }) = outcome {
                    let named = matches!(record.fault, FaultId::C1 | FaultId::S10);
                    assert!(named, "{what}: {record:?}");
                    assert!(record.fault != FaultId::C1 || is_slack(&link, &model, record.cable));
                }
                assert!(took < 6_000_000, "{what}: {took} us");
            }
        }
    }
}

#[test]
fn c1_c3_a_cable_that_breaks_while_the_robot_arms_opens_no_brake() {
    for name in ROBOTS {
        let model = Model::new(&mcdpr::robot::find(name).unwrap()).unwrap();
        let begin = |seed| {
            let (link, rest) = hanging(&model, PLACES[1], seed);
            let mut client = Client::connect(link.clone(), SessionId(7)).unwrap();
            let config_hash = run::configure(&mut client, model.robot()).unwrap();
            let expected = machine::expected_n(model.robot(), rest.tensions_n());
            let reference = machine::reference(&rest.paid_out_m, &expected);
            client.request(reference).unwrap();
            client.request(Request::Arm { config_hash }).unwrap();
            link.with(Simulation::record_truth);
            (link, client)
        };
        // How long it takes until brakes open where nothing breaks.
        let (link, mut client) = begin(1);
        let mut opens_ms = 0;
        while !seen(&link, [0.0; 3]).0 {
            let until = client.now_us() + 1000;
            client.pump(until).unwrap();
            opens_ms += 1;
            assert!(opens_ms < 3000, "{name} does not arm");
        }
        let count = model.robot().cables.len();
        // Later than that the brakes have their order to open, which takes them 30 ms.
        for share in [0.1, 0.5, 0.9] {
            for cable in 0..count {
                let (link, mut client) = begin(1);
                let cut_ms = (share * f64::from(opens_ms)) as u64;
                let what = format!(
                    "{name}, cable {} after {cut_ms} ms of {opens_ms}",
                    cable + 1
                );
                let until = client.now_us() + 1000 * cut_ms;
                client.pump(until).unwrap();
                link.with(|s| s.plant_mut().break_cable(cable)).unwrap();
                let until = client.now_us() + 2_000_000;
                client.pump(until).unwrap();
                let fault = link.with(|simulation| simulation.fault());
                let fault = fault.unwrap_or_else(|| panic!("{what}: no fault"));
                assert!(
                    !seen(&link, [0.0; 3]).0,
                    "{what}: a brake opened, {fault:?}"
                );
                let named = matches!(fault.fault, FaultId::C1 | FaultId::S10);
                assert!(named, "{what}: {fault:?}");
                // A broken cable can unload another one.
                assert!(is_slack(&link, &model, fault.cable), "{what}: {fault:?}");
            }
        }
    }
}
