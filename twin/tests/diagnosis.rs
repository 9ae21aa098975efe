//! What the host's program says beyond the latched fault, from the samples around it: each run by the seed that showed
//! it first (`cargo xtask study faults --robot paper-table5`), with a plant that is off.

use mcdpr_core::motion::Model;
use mcdpr_core::robot::Robot;
use mcdpr_protocol::FaultId;
use mcdpr_twin::faults::survey::{Outcome, run};

fn model() -> Model {
    Model::new(&Robot::built_in("paper-table5").unwrap()).unwrap()
}

/// The run of a seed, which injects this fault alone.
fn outcome(model: &Model, seed: u64, injected: FaultId) -> Outcome {
    let outcome = run(model, seed).unwrap();
    let faults = outcome.drawn.injections.iter();
    let faults: Vec<_> = faults.map(|injection| injection.fault).collect();
    assert_eq!(faults, [injected], "seed {seed}");
    assert_eq!(outcome.violations, [""; 0], "seed {seed}");
    outcome
}

#[test]
fn a_closed_brake_a_slip_a_break_and_an_open_input_are_told_from_what_the_board_latched() {
    use FaultId as F;
    let model = model();
    for (seed, injected, latched, told) in [
        // A brake that closes in motion, or stays closed behind a gear with play.
        (126, F::B1, F::D7, F::B1),
        (37, F::B1, F::D2, F::B1),
        (4, F::B1, F::D4, F::B1),
        // 20 mm of slip: slack for 250 ms, and tight again later.
        (287, F::S5, F::C3, F::S5),
        // Another cable snaps tight after one was slack.
        (442, F::C1, F::C2, F::C1),
        (296, F::C1, F::C5, F::C1),
        // It breaks while the robot arms: its floor is checked, and it stays slack.
        (259, F::C3, F::C1, F::C3),
        (172, F::S6, F::S2, F::S6),
    ] {
        let outcome = outcome(&model, seed, injected);
        let record = outcome.latched.unwrap();
        assert_eq!(record.fault, latched, "seed {seed}");
        let why = outcome.diagnosed.expect("a cause");
        let cable = outcome.drawn.injections[0].cable + 1;
        assert_eq!(
            (why.fault, usize::from(why.cable)),
            (told, cable),
            "seed {seed}: {why}"
        );
        assert!(outcome.told.fault && outcome.told.cable, "seed {seed}");
    }
}

#[test]
fn a_latched_fault_that_is_the_cause_gets_no_other() {
    use FaultId as F;
    let model = model();
    // A dead encoder in motion, a broken cable, dead encoders at arming.
    for (seed, injected) in [(2, F::S2), (36, F::C3), (71, F::S2), (25, F::S2)] {
        let outcome = outcome(&model, seed, injected);
        assert_eq!(outcome.latched.unwrap().fault, injected, "seed {seed}");
        assert_eq!(outcome.diagnosed, None, "seed {seed}");
        assert!(outcome.named.fault && outcome.named.cable, "seed {seed}");
    }
}

#[test]
fn a_bad_brake_behind_a_gear_is_named_within_its_bound_and_a_lost_supply_by_its_name() {
    let model = model();
    // 1.5 s after its first slip, and the attempt under way.
    let brake = outcome(&model, 158, FaultId::B2);
    assert_eq!(brake.latched.unwrap().fault, FaultId::B2);
    let after_ms = brake.latched_after_ms.unwrap();
    assert!(after_ms <= 2500, "{after_ms} ms");
    // Found at arming, on a cable that is held by tension: the push against the bad brake ends, and its drum stays.
    let armed = outcome(&model, 944, FaultId::B2);
    assert_eq!(armed.latched.unwrap().fault, FaultId::B2);
    assert_eq!(armed.slack_ms, 0);
    assert!(armed.deviation_m < 2e-3, "{} m", armed.deviation_m);
    for seed in [80, 360] {
        let supply = outcome(&model, seed, FaultId::P2);
        let record = supply.latched.unwrap();
        assert_eq!((record.fault, record.cable), (FaultId::P2, 0));
    }
}

#[test]
fn what_fails_at_the_end_of_a_stop_is_found_when_the_robot_moves_again() {
    let model = model();
    for (seed, injected) in [(38, FaultId::S2), (185, FaultId::B1)] {
        let outcome = outcome(&model, seed, injected);
        assert!(outcome.at_next_arming, "seed {seed}");
        assert!(outcome.told.fault && outcome.told.cable, "seed {seed}");
    }
}
