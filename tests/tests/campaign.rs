//! The short version of `cargo xtask study faults`.

use mcdpr::motion::Model;
use mcdpr::robot::Robot;
use mcdpr::scenario::campaign;
use mcdpr::scenario::survey::{self, Moment, silent};

/// Seeds that run here; the study has ten thousand.
const RUNS: u64 = 200;

#[test]
fn random_faults_at_random_times_on_random_robots_break_no_invariant() {
    let verdicts = campaign::run_all(1..RUNS + 1, |_, _| {});
    let verdicts: Vec<_> = verdicts.into_iter().flatten().collect();
    let ran = verdicts.len() as u64;
    let noticed = verdicts.iter().filter(|v| v.noticed.is_some()).count() as u64;
    let broken = verdicts.iter().filter(|v| !v.violations.is_empty());
    let broken: Vec<_> = broken.map(campaign::Verdict::line).collect();
    assert!(ran > RUNS * 9 / 10, "{ran} runs");
    assert!(noticed > ran / 2, "{noticed} of {ran} noticed");
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

/// Seeds that broke one: what was repaired stays so.
#[test]
fn seeds_of_the_study_that_once_broke_an_invariant_do_not_again() {
    let seeds = [
        316, 2001, 2112, 2638, 2771, 2927, 3746, 3782, 4250, 4452, 6292, 7972,
    ];
    for seed in seeds {
        let verdict = campaign::run(seed).unwrap();
        assert!(verdict.violations.is_empty(), "{}", verdict.line());
    }
}

#[test]
fn a_seed_is_the_same_run_again() {
    let (one, two) = (campaign::run(7).unwrap(), campaign::run(7).unwrap());
    assert_eq!(format!("{one:?}"), format!("{two:?}"));
}

/// Every row, in every phase, measured from the injection: what must be noticed is, and what is
/// latched has its name.
#[test]
fn faults_in_every_phase_are_noticed_and_named() {
    let model = Model::new(&Robot::built_in("paper-table5").unwrap()).unwrap();
    let outcomes = survey::run_all(&model, 1..121, true, |_| {});
    let outcomes: Vec<_> = outcomes
        .into_iter()
        .flatten()
        .filter(|o| o.injected)
        .collect();
    for moment in Moment::ALL {
        let of = outcomes
            .iter()
            .filter(|outcome| outcome.drawn.moment == moment);
        assert!(of.count() >= 3, "{} is not drawn", moment.name());
    }
    let broken = outcomes
        .iter()
        .filter(|outcome| !outcome.violations.is_empty());
    let broken: Vec<_> = broken
        .map(|o| format!("seed {}: {}", o.drawn.seed, o.violations.join("; ")))
        .collect();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
    let due = outcomes.iter().filter(|outcome| {
        let mut injections = outcome.drawn.injections.iter();
        injections.any(|injection| silent(injection, outcome.drawn.moment).is_none())
    });
    let due: Vec<_> = due.filter(|outcome| outcome.latched.is_some()).collect();
    let named = due.iter().filter(|outcome| outcome.named.fault).count();
    assert!(
        named * 10 >= due.len() * 8,
        "{named} of {} named",
        due.len()
    );
}

#[test]
fn the_same_work_without_a_fault_raises_no_alarm() {
    for name in ["paper-table5", "lab-fast"] {
        let model = Model::new(&Robot::built_in(name).unwrap()).unwrap();
        for outcome in survey::run_all(&model, 1..13, false, |_| {})
            .into_iter()
            .flatten()
        {
            let wrong = outcome.violations.join("; ");
            assert!(
                wrong.is_empty(),
                "{name}, seed {}: {wrong}",
                outcome.drawn.seed
            );
        }
    }
}
