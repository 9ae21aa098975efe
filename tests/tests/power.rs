//! Loss of power at any tick: the recovery of the tool's position, and the rest of the task.

use mcdpr::machine::{Controller, Mismatch};
use mcdpr::motion::{Model, Task};
use mcdpr::recovery::simulated::{AfterCut, Disturbance, SimulatedCut, simulate};
use mcdpr::recovery::{Journal, JournalError, Verdict};
use mcdpr::robot::Robot;
use mcdpr::run::RunError;
use mcdpr::scenario::{FaultyLink, Supply};
use nalgebra::Vector3;
use std::process::Output;

fn model(robot: &str) -> Model {
    Model::new(&Robot::built_in(robot).unwrap()).unwrap()
}

/// Down and aside from home at 40 mm/s.
fn task(model: &Model) -> Task {
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
    Task::parse(&text, "way.toml".into()).unwrap()
}

/// That task, interrupted after 0.8 s, in this process and without a look at the tags before.
fn cut(model: &Model, supply: Supply, disturbance: Disturbance) -> SimulatedCut {
    SimulatedCut {
        task: task(model),
        mismatch: Mismatch::realistic(),
        seed: 3,
        supply,
        at_s: 0.8,
        lasts_s: 1.0,
        disturbance,
        seen_at_home: false,
        battery: false,
        controller: Controller::InProcess,
    }
}

fn interrupted(model: &Model, supply: Supply, disturbance: Disturbance) -> AfterCut {
    simulate(model, &cut(model, supply, disturbance))
        .unwrap()
        .unwrap()
}

fn recovered(model: &Model, played: &AfterCut, camera: bool, untouched: bool) -> (Verdict, f64) {
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
    for robot in ["paper-optimistic", "lab-fast"] {
        let model = model(robot);
        for (supply, name) in Supply::ALL {
            let played = interrupted(&model, supply, Disturbance::None);
            let (verdict, off_mm) = recovered(&model, &played, true, false);
            assert!(verdict.accepted, "{robot}, {name}: {}", verdict.sentence);
            assert!(off_mm < 1.0, "{robot}, {name}: {off_mm} mm");
            let drop_m = played.drop_m;
            assert!(drop_m < 5e-3, "{robot}, {name}: {drop_m} m");
        }
    }
}

#[test]
fn p2_a_view_of_the_tag_at_homing_makes_the_recovery_more_exact() {
    let model = model("lab-fast");
    let mut cut = cut(&model, Supply::All, Disturbance::None);
    let mut bounds_mm = Vec::new();
    for seen_at_home in [false, true] {
        cut.seen_at_home = seen_at_home;
        let played = simulate(&model, &cut).unwrap().unwrap();
        assert_eq!(played.reference.is_some(), seen_at_home);
        let (verdict, off_mm) = recovered(&model, &played, true, false);
        assert!(verdict.accepted, "{}", verdict.sentence);
        assert!(off_mm < 1.0, "{off_mm} mm");
        let used = verdict.used.join("; ");
        assert_eq!(
            used.contains("when the robot was homed"),
            seen_at_home,
            "{used}"
        );
        bounds_mm.push(verdict.bound_mm.unwrap());
    }
    assert!(bounds_mm[1] < 0.7 * bounds_mm[0], "{bounds_mm:?}");
}

#[test]
fn p2_without_a_camera_lost_counts_need_the_users_confirmation() {
    let model = model("paper-optimistic");
    // In a dip the encoders may have had too little.
    for supply in [Supply::Board, Supply::All, Supply::Dip] {
        let played = interrupted(&model, supply, Disturbance::None);
        let (verdict, _) = recovered(&model, &played, false, false);
        assert!(!verdict.accepted);
        assert!(verdict.next.contains("--untouched"), "{}", verdict.next);
        let (verdict, off_mm) = recovered(&model, &played, false, true);
        assert!(verdict.accepted, "{}", verdict.sentence);
        let bound_mm = verdict.bound_mm.unwrap();
        assert!(off_mm < 1.5 * bound_mm, "{off_mm} of {bound_mm} mm");
    }
    // A board that kept its supply has counted, and so has one that a fault of its program has reset.
    for supply in [Supply::Drives, Supply::Host, Supply::Crash] {
        let played = interrupted(&model, supply, Disturbance::None);
        let (verdict, off_mm) = recovered(&model, &played, false, false);
        assert!(verdict.accepted, "{}", verdict.sentence);
        assert!(off_mm < 1.5, "{off_mm} mm");
        let used = verdict.used.join("; ");
        let by_reset = used.contains("kept over its reset");
        assert_eq!(by_reset, supply == Supply::Crash, "{used}");
    }
}

#[test]
fn p2_a_battery_keeps_the_last_lengths_when_everything_else_loses_its_supply() {
    let model = model("paper-optimistic");
    let mut cut = SimulatedCut {
        battery: true,
        ..cut(&model, Supply::All, Disturbance::None)
    };
    let with = simulate(&model, &cut).unwrap().unwrap();
    let (verdict, off_mm) = recovered(&model, &with, false, true);
    assert!(verdict.accepted, "{}", verdict.sentence);
    let used = verdict.used.join("; ");
    assert!(used.contains("the lengths that the board kept"), "{used}");
    let bound_mm = verdict.bound_95_mm.unwrap();
    assert!(off_mm < bound_mm, "{off_mm} of {bound_mm} mm");
    cut.battery = false;
    let without = simulate(&model, &cut).unwrap().unwrap();
    let (verdict, _) = recovered(&model, &without, false, true);
    assert!(bound_mm < verdict.bound_95_mm.unwrap());
    // The journal of another hour. The board above has got its reference.
    cut.battery = true;
    let with = simulate(&model, &cut).unwrap().unwrap();
    let mut old = with.read(&model, u64::MAX / 2).unwrap();
    for cable in &mut old.last.as_mut().unwrap().cables {
        cable.length_m += 0.02;
    }
    old.ended = true;
    let (verdict, _) = with
        .recover(&model, Ok(old.clone()), false, true, 5e-3)
        .unwrap();
    assert!(!verdict.accepted);
    assert!(
        verdict.sentence.contains("not of the same time"),
        "{}",
        verdict.sentence
    );
    // A tag in view shows the place all the same.
    let (verdict, _) = with.recover(&model, Ok(old), true, false, 5e-3).unwrap();
    assert!(verdict.accepted, "{}", verdict.sentence);
}

#[test]
fn p2_light_drums_fall_less_the_longer_their_rail_holds_up() {
    let [none_m, half_m, all_m] = drops_m(Supply::Drives);
    assert!(none_m > 3e-3 && half_m < 0.6 * none_m, "{none_m} {half_m}");
    assert!(all_m < 0.5 * half_m, "{half_m} {all_m}");
    // Without its board the contactor opens after 20 ms: a longer rail is of no use.
    let [none_m, half_m, all_m] = drops_m(Supply::All);
    assert!(none_m > 3e-3 && half_m < 0.6 * none_m, "{none_m} {half_m}");
    assert!((all_m - half_m).abs() < 0.2 * half_m, "{half_m} {all_m}");
}

/// Drops of the tool after a cut, m, by the rail of the drives: 0, 20 and 40 ms.
fn drops_m(supply: Supply) -> [f64; 3] {
    [0.0, 0.02, 0.04].map(|hold_up_s| {
        let mut robot = Robot::built_in("lab-fast").unwrap();
        for winch in &mut robot.winches {
            winch.drive_hold_up_s = hold_up_s;
        }
        let model = Model::new(&robot).unwrap();
        let played = interrupted(&model, supply, Disturbance::None);
        let (verdict, off_mm) = recovered(&model, &played, false, true);
        assert!(verdict.accepted, "{hold_up_s}: {}", verdict.sentence);
        let bound_mm = verdict.bound_mm.unwrap();
        assert!(off_mm < bound_mm, "{hold_up_s}: {off_mm} of {bound_mm} mm");
        played.drop_m
    })
}

/// The computer fails, and its robot with it only later: meanwhile the board moved on without a record.
#[test]
fn p2_a_robot_that_outlives_its_computer_is_not_recovered_by_the_journal() {
    let model = model("lab-fast");
    let mut played = interrupted(&model, Supply::Host, Disturbance::None);
    let settle = |us: u64| {
        FaultyLink::new(played.link.clone(), &[])
            .settle(us)
            .unwrap();
    };
    played
        .link
        .with(|robot| robot.set_board_power(false))
        .unwrap();
    settle(500_000);
    played
        .link
        .with(|robot| robot.set_board_power(true))
        .unwrap();
    settle(1_000_000);
    let (verdict, _) = recovered(&model, &played, false, true);
    assert!(!verdict.accepted, "{}", verdict.sentence);
    assert!(verdict.next.contains("--together"), "{}", verdict.next);
    // Whoever confirms it all the same is wrong, and this is by how much: the check is needed.
    played.together = true;
    let (wrong, off_mm) = recovered(&model, &played, false, true);
    assert!(
        !wrong.accepted || off_mm > 2.0,
        "{off_mm} mm: {}",
        wrong.sentence
    );
    // A tag shows the platform, whatever the journal says.
    let (verdict, off_mm) = recovered(&model, &played, true, false);
    assert!(verdict.accepted, "{}", verdict.sentence);
    let bound_mm = verdict.bound_mm.unwrap();
    assert!(off_mm < bound_mm, "{off_mm} of {bound_mm} mm");
}

#[test]
fn p2_a_gentle_test_finds_a_platform_that_was_moved_without_journal_or_camera() {
    let model = model("lab-fast");
    let by_m = [0.02, -0.01, 0.0];
    let mut played = interrupted(&model, Supply::All, Disturbance::Moved { by_m });
    let missing = || {
        let board = played.board.clone();
        Err(JournalError::Missing { board })
    };
    let (verdict, _) = played
        .recover(&model, missing(), false, false, 8e-3)
        .unwrap();
    // No journal, no lengths: `--gentle` was not given, so nothing moved.
    assert!(!verdict.accepted && verdict.tool_mm.is_none());
    let journal = missing();
    played.gentle = true;
    let (verdict, truth_m) = played.recover(&model, journal, false, false, 8e-3).unwrap();
    assert!(verdict.accepted, "{}", verdict.sentence);
    let off_mm = (Vector3::from(verdict.tool_mm.unwrap()) - truth_m * 1e3).norm();
    let bound_mm = verdict.bound_mm.unwrap();
    assert!(off_mm < bound_mm, "{off_mm} of {bound_mm} mm");
    // The board holds the lengths of where it hangs, and drums are where they were.
    assert!(verdict.used.iter().any(|used| used.contains("gentle")));
}

#[test]
fn p2_a_platform_that_was_moved_is_seen_by_the_tag_and_named() {
    let model = model("paper-optimistic");
    let by_m = [0.02, -0.01, 0.0];
    let played = interrupted(&model, Supply::All, Disturbance::Moved { by_m });
    let (verdict, off_mm) = recovered(&model, &played, true, false);
    // Lengths that contradict the tag are left out: one view of one tag is all that counts.
    assert!(
        verdict.accepted && verdict.bound_mm.is_some_and(|bound_mm| off_mm < bound_mm),
        "{off_mm} mm: {}",
        verdict.sentence
    );
    let words = verdict.contradicts.join("; ");
    assert!(words.contains("moved"), "{words}");
}

#[test]
fn p2_an_invalid_journal_is_refused_with_the_reason() {
    let model = model("paper-optimistic");
    let played = interrupted(&model, Supply::All, Disturbance::None);
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

/// The power fails on the machine that was calibrated. Its motors are then somewhere in their gears' play: a drum
/// that falls through the rest of it when its brake opens ends the run with C2.
#[test]
fn p2_a_calibrated_robot_with_play_is_recovered_and_goes_on() {
    let folder = mcdpr_tests::process::Folder::new("power-calibrated");
    let done = |words: &[&str]| {
        let mut command = mcdpr_tests::mcdpr();
        let out = command.args(words).current_dir(folder.path());
        let out = out.output().unwrap();
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(out.status.success(), "{words:?}: {said}");
        said
    };
    let poses = ["--target", "board", "--poses", "8", "--candidates", "40"];
    done(&[&["calibrate", "all"], &poses[..]].concat());
    let said = done(&["recover", "--untouched", "--resume"]);
    assert!(said.contains("calibration.json applied"), "{said}");
    let number = |before: &str| -> f64 {
        let (_, rest) = said.split_once(before).expect(before);
        rest.split_whitespace().next().unwrap().parse().unwrap()
    };
    assert!(number("true position is ") < 1.5, "{said}");
    assert!(number("the tool at most ") < 2.0, "{said}");
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
    let errors = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(1), "{errors}");
    assert!(errors.contains("--untouched"), "{errors}");
    for wrong in [
        &["--bound-mm", "0"][..],
        &["--fault", "S2@1s"],
        &["--fault", "power:sun@1s"],
    ] {
        let out = mcdpr(&[&["recover"], wrong].concat());
        assert_eq!(out.status.code(), Some(1), "{wrong:?}");
    }
}

/// Path error of a robot whose position is known, mm: pulleys and elasticity. The error of the recovered
/// position adds to it.
const PATH_MM: f64 = 1.0;

#[test]
fn p2_a_task_continues_where_it_was_interrupted() {
    for (robot, supply) in [
        ("lab-fast", Supply::All),
        ("lab-fast", Supply::Board),
        ("paper-optimistic", Supply::Drives),
    ] {
        let model = model(robot);
        let after = interrupted(&model, supply, Disturbance::None);
        let (verdict, _) = recovered(&model, &after, false, true);
        assert!(verdict.accepted, "{robot}: {}", verdict.sentence);
        let journal = after.read(&model, u64::MAX / 2).unwrap();
        let path_s = f64::from(journal.path_ms) * 1e-3;
        assert!((0.6..=1.4).contains(&path_s), "{robot}: {path_s} s");
        let run = after.resume(&model, task(&model), journal).unwrap();
        // Judged like any plan, shorter than the whole task, and to the task's end.
        let end_m = model.robot().tool.home_in_world_m + Vector3::new(0.06, 0.04, -0.03);
        let last_s = run.plan.timed.duration_s();
        assert!((run.plan.timed.tool_m(last_s).unwrap() - end_m).norm() < 1e-6);
        let figures = run.figures(&model).unwrap();
        let most_mm = figures.path_error_m.unwrap().max * 1e3;
        let bound_mm = verdict.bound_mm.unwrap();
        assert!(most_mm < bound_mm + PATH_MM, "{robot}: {most_mm} mm");
        let resumed = run.plan.resumed.unwrap();
        assert_eq!(resumed.interruptions.len(), 1);
    }
}

#[test]
fn p2_another_task_a_changed_plan_and_a_lost_object_are_not_continued() {
    let model = model("lab-fast");
    let after = interrupted(&model, Supply::All, Disturbance::None);
    let (verdict, _) = recovered(&model, &after, false, true);
    assert!(verdict.accepted, "{}", verdict.sentence);
    let journal = after.read(&model, u64::MAX / 2).unwrap();
    let refused = |journal: &Journal, part: &str| {
        let error = after
            .resume(&model, task(&model), journal.clone())
            .map(|_| ())
            .unwrap_err();
        assert!(matches!(error, RunError::Resume(_)), "{error}");
        assert!(error.to_string().contains(part), "{error}");
    };
    let mut other = journal.clone();
    other.identity.task_hash ^= 1;
    refused(&other, "another version");
    let mut longer = journal.clone();
    longer.plan.as_mut().unwrap().duration_s += 0.1;
    refused(&longer, "limits or options");
    let mut holding = journal.clone();
    holding.last.as_mut().unwrap().gripper_closed = true;
    refused(&holding, "holds an object");
    let mut done = journal.clone();
    done.path_ms = 60_000;
    refused(&done, "reached its end");
    // The robot has not moved: the true journal still continues.
    assert!(after.resume(&model, task(&model), journal).is_ok());
}

#[test]
fn p2_the_journal_takes_less_than_a_megabyte_a_minute() {
    let model = model("lab-fast");
    let cost = mcdpr::recovery::cost(&model, &task(&model)).unwrap();
    assert!(cost.duration_s > 2.0, "{cost:?}");
    assert!((0.2..1.0).contains(&cost.mb_per_min), "{cost:?}");
    if cfg!(target_os = "linux") {
        // `mcdpr study power` prints the share; a test does not judge time.
        assert!(cost.core_share.unwrap() > 0.0, "{cost:?}");
    }
}

#[test]
fn p4_on_the_emulated_chip_a_fault_of_the_program_costs_no_lengths() {
    let model = model("lab-fast");
    let cut = SimulatedCut {
        controller: Controller::Chip(mcdpr_tests::chip::firmware()),
        ..cut(&model, Supply::Crash, Disturbance::None)
    };
    let after = simulate(&model, &cut).unwrap().unwrap();
    let (verdict, off_mm) = recovered(&model, &after, false, false);
    assert!(verdict.accepted, "{}", verdict.sentence);
    let used = verdict.used.join("; ");
    assert!(used.contains("kept over its reset"), "{used}");
    let bound_mm = verdict.bound_mm.unwrap();
    assert!(off_mm < bound_mm, "{off_mm} of {bound_mm} mm");
}

#[test]
fn p2_on_the_emulated_chip_a_cut_is_recovered_and_the_task_continues() {
    let model = model("paper-optimistic");
    let cut = SimulatedCut {
        seen_at_home: true,
        controller: Controller::Chip(mcdpr_tests::chip::firmware()),
        ..cut(&model, Supply::Board, Disturbance::None)
    };
    let after = simulate(&model, &cut).unwrap().unwrap();
    assert!(after.drop_m < 5e-3, "{} m", after.drop_m);
    let (verdict, off_mm) = recovered(&model, &after, true, false);
    assert!(verdict.accepted, "{}", verdict.sentence);
    assert!(off_mm < 1.0, "{off_mm} mm");
    let journal = after.read(&model, u64::MAX / 2).unwrap();
    let run = after.resume(&model, task(&model), journal).unwrap();
    let most_mm = run.figures(&model).unwrap().path_error_m.unwrap().max * 1e3;
    assert!(most_mm < 1.0 + PATH_MM, "{most_mm} mm");
}

/// Picks on the simulator with a cut of the supply, and continues.
fn pick(fault: &str) -> Output {
    let words = [
        "pick",
        "--robot",
        "lab-fast",
        "--objects",
        "2",
        "--ideal",
        "--seed",
        "1",
    ];
    let rest = ["--resume", "--fault", fault, "--json"];
    mcdpr(&[&words[..], &rest].concat())
}

#[test]
fn p2_picking_continues_with_what_is_in_the_jaws() {
    // On the way to the first grasp, and on the way to the release.
    for (fault, jaws, outcome) in [
        ("power:drives@12s/1s", "empty", None),
        ("power:drives@22s/1s", "holding", Some("delivered")),
        // A board without supply opens its gripper, and has lost its lengths.
        ("power:board@12s/1s", "empty", None),
        ("power:board@22s/1s", "dropped", None),
        ("power:all@22s/1s", "dropped", None),
        // Its outputs float while it starts, so its gripper opens; its lengths remain.
        ("power:crash@22s", "dropped", None),
    ] {
        let out = pick(fault);
        let errors = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(out.status.success(), "{fault}: {errors}");
        let scene: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        let resumed = &scene["report"]["resumed"];
        assert_eq!(resumed["jaws"], jaws, "{fault}: {resumed}");
        assert_eq!(resumed["outcome"].as_str(), outcome, "{fault}: {resumed}");
        assert_eq!(scene["report"]["end"]["why"], "empty", "{fault}: {scene}");
        assert_eq!(scene["carried_off"], 2, "{fault}: {scene}");
        // Of the grasps after the cut, too.
        for error_m in scene["errors_m"].as_array().unwrap() {
            assert!(error_m.as_f64().unwrap() < 3e-3, "{fault}: {scene}");
        }
    }
}

#[test]
fn p2_picking_that_was_over_or_a_wrong_fault_is_refused() {
    for (fault, part) in [
        ("power:drives@500s/1s", "over before the power failed"),
        ("S2@12s", "cuts no supply"),
        ("power:sun@12s", "power"),
    ] {
        let out = pick(fault);
        let errors = String::from_utf8_lossy(&out.stderr).into_owned();
        assert_eq!(out.status.code(), Some(1), "{fault}: {errors}");
        assert!(errors.contains(part), "{fault}: {errors}");
    }
}

/// One case of the study: whether it was accepted, and wrongly so.
fn study(words: &[&str]) -> serde_json::Value {
    let out = mcdpr(&[&["study", "power", "--json"], words].concat());
    let errors = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.success(), "{errors}");
    serde_json::from_slice(&out.stdout).unwrap()
}

#[test]
fn p2_the_study_has_all_kinds_and_accepts_none_wrongly() {
    let document = study(&["--runs", "6", "--seed", "7", "--robot", "lab-fast"]);
    let cost = &document["journal"];
    assert!(cost["mb_per_min"].as_f64().unwrap() < 1.0, "{document}");
    let kinds = document["kinds"].as_object().unwrap();
    assert_eq!(kinds.len(), 6, "{document}");
    assert!(kinds.values().all(|kind| kind["cases"] == 1), "{document}");
    assert_eq!(document["accepted_wrongly"], 0, "{document}");
    for kind in ["swapped", "corrupted"] {
        assert_eq!(kinds[kind]["accepted"], 0, "{document}");
    }
}

/// When only the board's supply fails, drives go on with their last command. Behind a gear of 371:1 a current limit of
/// 2 A leaves slack cables: seeds 150007 and 150012.
#[test]
fn p2_drives_that_outlive_their_board_do_not_overcome_closed_brakes() {
    let words = ["--undisturbed", "--runs", "6", "--seed", "150007"];
    let document = study(&[&words[..], &["--robot", "paper-table5"]].concat());
    assert_eq!(document["refused_wrongly"], 0.0, "{document}");
    assert_eq!(document["accepted_wrongly"], 0, "{document}");
}

#[test]
fn p2_lengths_that_agree_with_a_tag_by_chance_are_not_believed_beyond_it() {
    // In both cases all lengths are off in the direction of the tag's error. Fused, they were accepted with an
    // error of 1.5 and 2.1 times the bound.
    // Since the drives' contactor is simulated, the drums of the first fall further, and it is refused.
    for (seed, kind, accepted) in [("60818", "slipped", 0), ("61143", "moved", 1)] {
        let document = study(&["--runs", "1", "--seed", seed, "--robot", "lab-fast"]);
        assert_eq!(document["kinds"][kind]["accepted"], accepted, "{document}");
        assert_eq!(document["accepted_wrongly"], 0, "{document}");
    }
    // A tag alone, 1.8 mm off: its 95 % bound is 1.2 mm, and the bound that decides is a greater one.
    let document = study(&[
        "--runs",
        "1",
        "--seed",
        "121287",
        "--disturbed",
        "--robot",
        "lab-fast",
    ]);
    assert_eq!(document["kinds"]["moved"]["accepted"], 1, "{document}");
    assert_eq!(document["accepted_wrongly"], 0, "{document}");
}

#[test]
fn p2_slipped_brakes_that_leave_a_slack_cable_or_a_swing_are_not_accepted_wrongly() {
    // 1070 and 1082 hang with a slack cable. In 2 the tag leaves the picture at one end of the swing; since the drives'
    // contactor is simulated, its drums fall further.
    for (seed, accepted) in [("1070", 0), ("1082", 0), ("2", 0)] {
        let document = study(&["--runs", "1", "--seed", seed, "--robot", "lab-fast"]);
        let slipped = &document["kinds"]["slipped"];
        assert_eq!(slipped["cases"], 1, "{document}");
        assert_eq!(slipped["accepted"], accepted, "{document}");
        assert_eq!(document["accepted_wrongly"], 0, "{document}");
    }
}
