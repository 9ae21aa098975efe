//! The short version of `cargo xtask study invariants`.

use mcdpr::scenario::campaign;

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
