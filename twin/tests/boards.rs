//! One robot on several boards: start, clocks, and stops that are those of all.

mod several_boards;

use mcdpr_core::control::{Handle, Order};
use mcdpr_core::link::{ClientError, LinkError};
use mcdpr_core::motion::{Model, Plan};
use mcdpr_core::robot::{BuiltInModules, Robot};
use mcdpr_core::run::{Homing, NoStore, RunError, Session};
use mcdpr_protocol::{BoardState, FaultId, SessionId};
use mcdpr_simulator::{BoardTime, Simulation, TracePoint, WireFaults};
use mcdpr_twin::SimulatedLink;
use mcdpr_twin::faults::{FaultyLink, Scenario};
use mcdpr_twin::together::Together;
use several_boards::{
    APART, After, IN_STEP, THREE, TWO, disturbed, model_of, name, robot_line, run, run_over,
    states, without_line,
};

/// How much later the drums of a board are than the plan, s: least squares over the motion, a
/// constant offset of each length aside.
fn delay_s(plan: &Plan, trace: &[TracePoint], cables: &[usize]) -> f64 {
    let (mut vv, mut ve) = (0.0, 0.0);
    for &cable in cables {
        let at = |time_s: f64| plan.state(time_s).map(|state| state.paid_out_m[cable]);
        let mut rows = Vec::new();
        for point in trace.iter().filter(|p| p.path_ms > 0 && p.path_ms % 5 == 0) {
            let time_s = f64::from(point.path_ms) * 1e-3;
            let (Some(before), Some(now), Some(after)) =
                (at(time_s - 1e-3), at(time_s), at(time_s + 1e-3))
            else {
                continue;
            };
            let late = point.truth.unstretched_lengths_m[cable] - now;
            rows.push(((after - before) / 2e-3, late));
        }
        let count = rows.len() as f64;
        let mean_v = rows.iter().map(|r| r.0).sum::<f64>() / count;
        let mean_e = rows.iter().map(|r| r.1).sum::<f64>() / count;
        for (v, e) in rows {
            vv += (v - mean_v).powi(2);
            ve += (v - mean_v) * (e - mean_e);
        }
    }
    -ve / vv
}

/// How much later the drums of each board are than those of the first, µs. Gears that rub and play give
/// most of it: boards of one clock have that part too.
fn late_us(plan: &Plan, trace: &[TracePoint], model: &Model) -> Vec<f64> {
    let boards = model.robot().boards.iter();
    let delays_s: Vec<f64> = boards.map(|b| delay_s(plan, trace, &b.cables)).collect();
    delays_s.iter().map(|d| (d - delays_s[0]) * 1e6).collect()
}

/// Judges the drums of boards with clocks of their own beside those of boards in step.
fn together(robot: &str, late_us: impl Fn(&Model, &[BoardTime]) -> Vec<f64>) {
    let model = model_of(robot);
    let by_winches_us = late_us(&model, &IN_STEP);
    let late_us = late_us(&model, &APART);
    println!("{robot}: late by {late_us:.1?} us, {by_winches_us:.1?} us of it by the winches");
    assert_eq!(late_us.len(), model.robot().boards.len());
    for (late_us, by_winches_us) in late_us.iter().zip(&by_winches_us) {
        assert!(
            (late_us - by_winches_us).abs() < 20.0,
            "{robot}: {late_us} us"
        );
    }
}

fn late_in_motion_us(model: &Model, times: &[BoardTime]) -> Vec<f64> {
    let link = robot_line(model, 1, times);
    let (plan, _) = run(&link, model, &Handle::new(), |_, _| {});
    let trace = link.with(Simulation::take_trace);
    late_us(&plan.unwrap(), &trace, model)
}

#[test]
fn two_boards_with_clocks_of_their_own_move_as_one() {
    together(TWO, late_in_motion_us);
}

#[test]
fn three_boards_with_clocks_of_their_own_move_as_one() {
    together(THREE, late_in_motion_us);
}

#[test]
fn motion_starts_within_a_tenth_of_a_millisecond_on_all_boards_and_stays_there() {
    for robot in [TWO, THREE] {
        let model = model_of(robot);
        let link = robot_line(&model, 1, &APART);
        link.with(Simulation::record_boards);
        let (plan, _) = run(&link, &model, &Handle::new(), |_, _| {});
        let mut together = Together::new(model.robot(), &plan.unwrap().knots);
        together.take(link.with(Simulation::take_boards));
        let windows = together.windows();
        let skews_us: Vec<f64> = windows.iter().map(|w| w.skew_s() * 1e6).collect();
        let worst_us = skews_us.iter().copied().fold(0.0, f64::max);
        println!(
            "{robot}: {:.1} us at the start, {worst_us:.1} us at most",
            skews_us[0]
        );
        assert!(windows[0].path_s < 2.0, "{}", windows[0].path_s);
        assert!(windows.len() > 15, "{}", windows.len());
        assert!(
            worst_us > 0.0 && worst_us < 100.0,
            "{robot}: {skews_us:.1?}"
        );
    }
}

/// A judge that finds no skew must be able to find one.
#[test]
fn a_skew_that_is_there_is_seen() {
    let model = model_of(TWO);
    let link = robot_line(&model, 1, &IN_STEP);
    link.with(Simulation::record_boards);
    let (plan, _) = run(&link, &model, &Handle::new(), |_, _| {});
    let mut together = Together::new(model.robot(), &plan.unwrap().knots);
    let mut points = link.with(Simulation::take_boards);
    for point in points.iter_mut().filter(|point| point.board == 1) {
        point.at_us += 250.0;
    }
    points.sort_by(|a, b| a.at_us.total_cmp(&b.at_us));
    together.take(points);
    let windows = together.windows();
    let middle = &windows[windows.len() / 2];
    assert!((middle.late_s[1] - 250e-6).abs() < 10e-6, "{middle:?}");
    assert!(middle.late_s[0].abs() < 10e-6, "{middle:?}");
}

#[test]
fn a_stop_is_the_same_stop_on_all_boards() {
    for robot in [TWO, THREE] {
        let model = model_of(robot);
        let link = robot_line(&model, 2, &APART);
        let handle = Handle::new();
        let orders = handle.clone();
        let mut given = None;
        let (done, _) = run(&link, &model, &handle, |simulation, now_us| {
            if given.is_none() && simulation.path_ms() >= 3000 {
                given = Some(now_us as f64);
                simulation.record_boards();
                orders.order(Order::Stop);
            }
        });
        assert!(matches!(done, Err(RunError::Interrupted)), "{done:?}");
        let points = link.with(Simulation::take_boards);
        let first_us = |board: usize| {
            let mut stopping = points.iter().filter(|p| p.state == BoardState::Stopping);
            let first = stopping.find(|point| point.board == board).unwrap();
            first.at_us - given.unwrap()
        };
        let boards = 0..model.robot().boards.len();
        let after_us: Vec<f64> = boards.map(first_us).collect();
        println!("{robot}: stops {after_us:.0?} us after the order");
        let (low, high) = after_us
            .iter()
            .fold((f64::MAX, 0.0_f64), |(low, high), us| {
                (low.min(*us), high.max(*us))
            });
        assert!(high - low <= 5_000.0 && high < 50_000.0, "{robot}");
    }
}

/// The other boards have reacted to what happened to this one in time.
fn others_react(what: &str, after: &After, board: usize, states: &[BoardState]) {
    for other in after.others(board) {
        let first_s = after.first_s(other, states).unwrap();
        println!("{what}: board {} after {:.1} ms", other + 1, first_s * 1e3);
        assert!(first_s < 0.15, "{what}: {first_s} s");
    }
}

/// What comes of a fault by its word, such as `S5:6@3.0s`.
fn injected(robot: &str, seed: u64, word: &str) -> Result<(), RunError> {
    let model = model_of(robot);
    let scenario = Scenario::from_words(&[word.to_owned()], 8).unwrap();
    scenario.suits(model.robot()).unwrap();
    let link = robot_line(&model, seed, &APART);
    let faulty = FaultyLink::new(link.clone(), &scenario.injections);
    run_over(faulty, &link, &model, &Handle::new()).map(|_| ())
}

/// The rows of the watch that need cables of several boards are not checked (S5, C5). The tensions show a slip as a slack
/// cable (C1), and the cause is judged from the samples of all boards.
#[test]
fn s5_a_cable_that_slips_is_named_by_its_number_on_any_board() {
    for (robot, seed, cable) in [
        (TWO, 15, 2),
        (TWO, 15, 6),
        (TWO, 16, 8),
        (THREE, 15, 5),
        (THREE, 15, 7),
    ] {
        let done = injected(robot, seed, &format!("S5:{cable}@3.0s"));
        let Err(RunError::Fault { record, why }) = done else {
            panic!("{robot}: {done:?}");
        };
        let cause = why.map(|why| (why.fault, why.cable));
        println!("{robot}, cable {cable}: {record:?}, cause {cause:?}");
        let (fault, named) = cause.unwrap_or((record.fault, record.cable));
        let slack = [FaultId::S5, FaultId::C1, FaultId::C3].contains(&fault);
        assert!(slack && named == cable, "{robot}: {fault:?} on {named}");
    }
}

/// What the host says of a board that is lost.
fn lost(after: &After) -> &str {
    match &after.done {
        Err(RunError::Client(ClientError::Link(LinkError::Boards { what, .. }))) => what,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_fault_on_one_board_stops_the_others() {
    use BoardState::{Disarmed, Fault, Stopping};
    // A drive counts as lost after 10 ms.
    for (robot, board, cable) in [(TWO, 1, 6), (THREE, 1, 6), (THREE, 2, 7)] {
        let after = disturbed(robot, 3, 2_500_000, |simulation| {
            without_line(simulation);
            let faults = simulation.plant_mut().faults_mut();
            faults.cables[usize::from(cable) - 1].drive.silent = true;
        });
        let Err(RunError::Fault { record, .. }) = &after.done else {
            panic!("{robot}: {:?}", after.done);
        };
        assert_eq!(record.cable, cable, "{robot}: {record:?}");
        others_react("fault", &after, board, &[Stopping]);
        // Without a host another board may have noted that as a fault of its own (L10).
        for other in after.others(board) {
            assert!(
                [Disarmed, Fault].contains(&after.last[other]),
                "{:?}",
                after.last
            );
        }
        assert_eq!(after.last[board], Fault);
    }
}

#[test]
fn a_dead_line_of_one_board_makes_all_hold() {
    use BoardState::{Holding, Pausing};
    let dead = WireFaults {
        drop: 1.0,
        ..WireFaults::default()
    };
    for (robot, board) in [(TWO, 1), (THREE, 0), (THREE, 2)] {
        let after = disturbed(robot, 4, 500_000, |simulation| {
            without_line(simulation);
            simulation.set_faults_of(board, dead, dead);
        });
        assert!(lost(&after).contains(&name(board)), "{}", lost(&after));
        others_react("dead line", &after, board, &[Pausing]);
        assert!(
            after.last.iter().all(|state| *state == Holding),
            "{:?}",
            after.last
        );
    }
}

#[test]
fn a_board_without_supply_makes_the_others_hold() {
    for (robot, board) in [(TWO, 1), (THREE, 1)] {
        let after = disturbed(robot, 5, 500_000, |simulation| {
            without_line(simulation);
            simulation.set_power_of(board, false).unwrap();
        });
        assert!(lost(&after).contains(&name(board)), "{}", lost(&after));
        others_react("no supply", &after, board, &[BoardState::Pausing]);
    }
}

#[test]
fn a_pause_and_a_way_on_leave_the_boards_together() {
    for robot in [TWO, THREE] {
        together(robot, late_after_a_pause_us);
    }
}

fn late_after_a_pause_us(model: &Model, times: &[BoardTime]) -> Vec<f64> {
    let link = robot_line(model, 6, times);
    let handle = Handle::new();
    let orders = handle.clone();
    let mut given = 0;
    let (done, _) = run(&link, model, &handle, |simulation, _| {
        let path_ms = simulation.path_ms();
        if given == 0 && path_ms >= 3000 {
            given = 1;
            orders.order(Order::Pause);
        }
        let rests = || states(simulation).iter().all(|s| *s == BoardState::Holding);
        if given == 1 && rests() {
            given = 2;
            orders.order(Order::Resume);
        }
    });
    let plan = done.unwrap();
    assert_eq!(given, 2);
    let mut trace = link.with(Simulation::take_trace);
    // One second after the way on: led together again.
    trace.retain(|point| point.path_ms > 5000);
    late_us(&plan, &trace, model)
}

#[test]
fn boards_that_are_swapped_or_another_robots_are_refused() {
    for robot in [TWO, THREE] {
        swapped_or_another_robots(robot);
    }
}

fn swapped_or_another_robots(robot: &str) {
    let model = model_of(robot);
    let link = robot_line(&model, 7, &APART);
    let home = || Homing::Place(model.robot().tool.home_in_world_m);
    let open = |link: SimulatedLink, model: &Model, home| {
        let handle = Handle::new();
        let session = Session::open(model, link, SessionId(9), &handle, home, &NoStore);
        session.and_then(Session::close)
    };
    // All boards have the robot's configuration now.
    open(link.clone(), &model, home()).unwrap();
    // The same boards, the cables of the last two in the file the other way round.
    let mut swapped = model.robot().clone();
    let last = swapped.boards.len() - 1;
    swapped.boards.swap(last - 1, last);
    let lines = link.lines().unwrap();
    let model_of = Model::new(&swapped).unwrap();
    let other = SimulatedLink::joined(&swapped, lines.clone()).unwrap();
    let error = open(other, &model_of, home()).unwrap_err().to_string();
    let said = format!(
        "{} has the configuration of board {}",
        name(last - 1),
        last + 1
    );
    assert!(
        error.contains(&said) && error.contains("swapped"),
        "{error}"
    );
    // A robot whose last board's winches are others.
    let mut another = model.robot().clone();
    for cable in another.boards[last].cables.clone() {
        another.winches[cable].drum_radius_m *= 1.1;
    }
    let model_of = Model::new(&another).unwrap();
    let other = SimulatedLink::joined(&another, lines).unwrap();
    let error = open(other, &model_of, home()).unwrap_err().to_string();
    assert!(
        error.contains(&name(last)) && error.contains("another robot"),
        "{error}"
    );
}

#[test]
fn a_channel_twice_or_missing_and_a_board_twice_are_refused_with_their_key() {
    let text = include_str!("../../robots/eight-two-boards.toml");
    let refused = |change: &dyn Fn(&str) -> String, word: &str| {
        let changed = change(text);
        assert_ne!(changed, text);
        let error = Robot::parse(&changed, "robot.toml", &BuiltInModules).unwrap_err();
        let said = format!("{error:?} {error}");
        assert!(said.contains(word), "{said}");
    };
    let anchor = "anchor_mm = [1000, 1000, 0]";
    let with = |keys: &str| {
        let keys = keys.to_owned();
        move |text: &str| text.replacen(anchor, &format!("{anchor}\n{keys}"), 1)
    };
    refused(&with("board = 1"), "`board` 1 has no channel left");
    refused(
        &with("board = 2\nchannel = 5"),
        "`channel` 5 is one that board 2 has not",
    );
    refused(&with("board = 3"), "`board` 3 is not a board of this file");
    let twice = |text: &str| {
        let text = text.replacen(anchor, &format!("{anchor}\nboard = 2\nchannel = 1"), 1);
        let next = "anchor_mm = [-1000, 1000, 0]";
        text.replacen(next, &format!("{next}\nboard = 2\nchannel = 1"), 1)
    };
    refused(&twice, "`channel` 1 of board 2 already drives cable 5");
    let line = |text: &str| text.replacen("fault_line = true", "", 1);
    refused(&line, "`fault_line` is not on board 1, too");
    let id = "id = \"0123456789abcdef01234567\"";
    let same = |text: &str| text.replace("[[board]]", &format!("[[board]]\n{id}\n#"));
    refused(&same, "is already that of board 1");
}
