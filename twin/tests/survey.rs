//! The short version of `cargo xtask study faults`: faults in every phase, measured from the injection.

use mcdpr_core::motion::Model;
use mcdpr_core::robot::Robot;
use mcdpr_protocol::FaultId;
use mcdpr_twin::faults::survey::{self, Moment, Outcome};

fn model(name: &str) -> Model {
    Model::new(&Robot::built_in(name).unwrap()).unwrap()
}

/// Every row, in every phase: what must be noticed is, and what is latched has its name.
#[test]
fn faults_in_every_phase_are_noticed_and_named() {
    let model = model("paper-optimistic");
    let runs = (1..41).filter_map(|seed| survey::run(&model, seed));
    let runs: Vec<_> = runs.filter(|outcome| outcome.injected).collect();
    for moment in Moment::ALL {
        let of = runs.iter().filter(|run| run.drawn.moment == moment);
        assert!(of.count() >= 1, "{} is not drawn", moment.name());
    }
    let broken = runs.iter().filter(|run| !run.violations.is_empty());
    let line = |run: &Outcome| format!("seed {}: {}", run.drawn.seed, run.violations.join("; "));
    let broken: Vec<_> = broken.map(line).collect();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
    let due = runs.iter().filter(|run| !run.may_be_silent);
    let due: Vec<_> = due.filter(|run| run.latched.is_some()).collect();
    let named = due.iter().filter(|run| run.named.fault).count();
    // What is reached, two of three; nine of ten is the aim, and is missed (docs/results/faults.md).
    assert!(named * 3 >= due.len() * 2, "{named} of {} named", due.len());
}

/// Faults are as strong as the robot: 5 N of a load cell of 200 N, or of a platform between cables, had shown nothing.
#[test]
fn faults_of_a_robot_with_strong_cables_are_noticed_or_excused() {
    let model = model("eight-cable");
    for (seed, injected, latched) in [
        (97, FaultId::C5, true),
        // 2.4 mm on a cable that others pull tight: excused.
        (180, FaultId::C1, false),
        (416, FaultId::S10, true),
        (440, FaultId::S10, true),
    ] {
        let run = survey::run(&model, seed).unwrap();
        assert_eq!(run.drawn.injections[0].fault, injected, "seed {seed}");
        assert_eq!(run.violations, [""; 0], "seed {seed}");
        let named = run.latched.is_some_and(|record| record.fault == injected);
        assert_eq!(named, latched, "seed {seed}: {:?}", run.latched);
        assert_eq!(run.may_be_silent, injected != FaultId::S10, "seed {seed}");
    }
}

#[test]
fn the_same_work_without_a_fault_raises_no_alarm() {
    for name in ["paper-optimistic", "lab-fast"] {
        let model = model(name);
        for seed in 1..6 {
            let Some(run) = survey::undisturbed(&model, seed) else {
                continue;
            };
            // A drawn task that the planner refuses is no alarm: nothing was armed.
            let planner = |words: &String| words.contains("more than the tolerance");
            if run.latched.is_none() && run.refused.as_ref().is_some_and(planner) {
                continue;
            }
            let wrong = run.violations.join("; ");
            assert!(wrong.is_empty(), "{name}, seed {seed}: {wrong}");
        }
    }
}

#[test]
fn a_seed_is_the_same_run_again() {
    let model = model("paper-optimistic");
    let run = || format!("{:?}", survey::run(&model, 5));
    assert_eq!(run(), run());
}
