//! The short version of `cargo xtask study faults`.

use mcdpr::scenario::campaign;

/// Seeds that run here; the study has ten thousand.
const RUNS: u64 = 200;

#[test]
fn random_faults_at_random_times_on_random_robots_break_no_invariant() {
    let mut broken = Vec::new();
    let (mut ran, mut noticed) = (0, 0);
    for seed in 1..=RUNS {
        let Some(verdict) = campaign::run(seed) else {
            continue;
        };
        ran += 1;
        noticed += u64::from(verdict.noticed.is_some());
        if !verdict.violations.is_empty() {
            broken.push(verdict.line());
        }
    }
    assert!(ran > RUNS * 9 / 10, "{ran} runs");
    assert!(noticed > ran / 2, "{noticed} of {ran} noticed");
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn a_seed_is_the_same_run_again() {
    let (one, two) = (campaign::run(7).unwrap(), campaign::run(7).unwrap());
    assert_eq!(format!("{one:?}"), format!("{two:?}"));
}
