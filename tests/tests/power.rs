//! Power that goes at any tick: what is left, and what a recovery makes of it.

use mcdpr::machine::{Controller, Mismatch};
use mcdpr::motion::{Model, Task};
use mcdpr::recovery::story::{Mishap, Played, Story, play};
use mcdpr::recovery::{Journal, JournalError, Verdict};
use mcdpr::robot::Robot;
use mcdpr::scenario::Supply;
use nalgebra::Vector3;
use std::process::Output;

fn model(robot: &str) -> Model {
    Model::new(&Robot::built_in(robot).unwrap()).unwrap()
}

/// A way down and aside from home at 40 mm/s.
fn played(model: &Model, supply: Supply, mishap: Mishap) -> Played {
    let home = model.robot().tool.home_in_world_m * 1e3;
    let text = format!(
        "start_mm = [{}, {}, {}]\n[[leg]]\nto_mm = [{}, {}, {}]\nspeed_mm_s = 40\n",
        home.x,
        home.y,
        home.z,
        home.x + 60.0,
        home.y + 40.0,
        home.z - 30.0
    );
    let story = Story {
        task: Task::parse(&text, "way.toml".into()).unwrap(),
        mismatch: Mismatch::realistic(),
        seed: 3,
        supply,
        at_s: 0.8,
        lasts_s: 1.0,
        mishap,
        controller: Controller::InProcess,
    };
    play(model, &story).unwrap().unwrap()
}

fn recovered(model: &Model, played: &Played, camera: bool, untouched: bool) -> (Verdict, f64) {
    let journal = played.read(model, u64::MAX / 2);
    let (verdict, truth_m) = played
        .recover(model, journal, camera, untouched, 5e-3)
        .unwrap();
    let tool_m = verdict.tool_mm.map(|mm| Vector3::from(mm) * 1e-3);
    let off_mm = tool_m.map_or(f64::INFINITY, |tool| (tool - truth_m).norm() * 1e3);
    (verdict, off_mm)
}

#[test]
fn p2_with_a_tag_in_view_every_cut_is_recovered_within_a_millimetre() {
    // The aim for the drop is 5 mm. Light drums miss it: they fall until their brakes have closed
    // (docs/results/power.md).
    for (robot, drop_m) in [("paper-table5", 5e-3), ("lab-fast", 7e-3)] {
        let model = model(robot);
        for (supply, name) in Supply::ALL {
            let played = played(&model, supply, Mishap::None);
            let (verdict, off_mm) = recovered(&model, &played, true, false);
            assert!(verdict.accepted, "{robot}, {name}: {}", verdict.sentence);
            assert!(off_mm < 1.0, "{robot}, {name}: {off_mm} mm");
            assert!(
                played.drop_m < drop_m,
                "{robot}, {name}: {} m",
                played.drop_m
            );
        }
    }
}

#[test]
fn p2_without_a_camera_lost_counts_need_somebody_who_vouches() {
    let model = model("paper-table5");
    for supply in [Supply::Board, Supply::All] {
        let played = played(&model, supply, Mishap::None);
        let (verdict, _) = recovered(&model, &played, false, false);
        assert!(!verdict.accepted);
        assert!(verdict.next.contains("--untouched"), "{}", verdict.next);
        let (verdict, off_mm) = recovered(&model, &played, false, true);
        assert!(verdict.accepted, "{}", verdict.sentence);
        let bound_mm = verdict.bound_mm.unwrap();
        assert!(off_mm < 1.5 * bound_mm, "{off_mm} of {bound_mm} mm");
    }
    // A board that kept its supply has counted.
    for supply in [Supply::Drives, Supply::Host] {
        let played = played(&model, supply, Mishap::None);
        let (verdict, off_mm) = recovered(&model, &played, false, false);
        assert!(verdict.accepted, "{}", verdict.sentence);
        assert!(off_mm < 1.5, "{off_mm} mm");
    }
}

#[test]
fn p2_a_platform_that_was_moved_is_seen_by_the_tag_and_named() {
    let model = model("paper-table5");
    let by_m = [0.02, -0.01, 0.0];
    let played = played(&model, Supply::All, Mishap::Moved { by_m });
    let (verdict, off_mm) = recovered(&model, &played, true, false);
    // Lengths that contradict the tag are left out: one view of one tag is all that counts.
    assert!(
        verdict.accepted && verdict.bound_mm.is_some_and(|bound_mm| off_mm < bound_mm),
        "{off_mm} mm: {}",
        verdict.sentence
    );
    let told = verdict.contradicts.join("; ");
    assert!(told.contains("moved"), "{told}");
}

#[test]
fn p2_a_journal_that_is_not_to_be_believed_is_refused_with_the_reason() {
    let model = model("paper-table5");
    let played = played(&model, Supply::All, Mishap::None);
    let good = played.read(&model, u64::MAX / 2).unwrap();
    let refused = |journal: Result<Journal, JournalError>, part: &str| {
        let (verdict, _) = played.recover(&model, journal, false, true, 5e-3).unwrap();
        assert!(!verdict.accepted);
        assert!(verdict.sentence.contains(part), "{}", verdict.sentence);
        assert!(verdict.next.contains("mcdpr home"), "{}", verdict.next);
    };
    let board = played.board.clone();
    refused(Err(JournalError::Missing { board }), "no journal was kept");
    refused(played.read(&model, 0), "from the future");
    let of = good.identity.scale;
    refused(
        good.check("other", of, None, u64::MAX / 2)
            .map(|()| good.clone()),
        "this is board other",
    );
    refused(
        good.check(&played.board, of + 1, None, u64::MAX / 2)
            .map(|()| good.clone()),
        "calibration",
    );
    let mut bytes = played.journal.clone();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x40;
    refused(Journal::read(&bytes), "damaged");
}

fn mcdpr(words: &[&str]) -> Output {
    mcdpr_tests::mcdpr().args(words).output().unwrap()
}

#[test]
fn the_program_recovers_or_refuses_with_what_to_do() {
    let out = mcdpr(&["recover", "--tag", "--json"]);
    assert!(
        out.status.success(),
        "{}",
        String::from_utf8_lossy(&out.stderr)
    );
    let verdict: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(verdict["accepted"], true);
    assert!(verdict["bound_mm"].as_f64().unwrap() < 5.0);
    let out = mcdpr(&["recover"]);
    let told = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(1), "{told}");
    assert!(told.contains("--untouched"), "{told}");
    for wrong in [
        &["--bound-mm", "0"][..],
        &["--fault", "S2@1s"],
        &["--fault", "power:sun@1s"],
    ] {
        let out = mcdpr(&[&["recover"], wrong].concat());
        assert_eq!(out.status.code(), Some(1), "{wrong:?}");
    }
}
