//! One robot on several boards: start, clocks, and stops that are those of all.

mod two_boards;

use mcdpr_core::control::{Handle, Order};
use mcdpr_core::link::{ClientError, LinkError};
use mcdpr_core::motion::{Model, Plan};
use mcdpr_core::robot::{BuiltInModules, Robot};
use mcdpr_core::run::{Homing, NoStore, RunError, Session};
use mcdpr_protocol::{BoardState, SessionId};
use mcdpr_simulator::{BoardTime, Simulation, TracePoint, WireFaults};
use mcdpr_twin::SimulatedLink;
use two_boards::{APART, IN_STEP, disturbed, model, robot_line, run, without_line};

/// How much later the drums of a board are than the plan, s: least squares over the motion, a
/// constant offset of each length aside.
fn delay_s(plan: &Plan, trace: &[TracePoint], cables: std::ops::Range<usize>) -> f64 {
    let (mut vv, mut ve) = (0.0, 0.0);
    for cable in cables {
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

/// How much later the drums of the second board are than those of the first, µs. Gears that rub and play give
/// most of it: two boards of one clock have that part too.
fn skew_us(plan: &Plan, trace: &[TracePoint]) -> f64 {
    let (first, second) = (delay_s(plan, trace, 0..4), delay_s(plan, trace, 4..8));
    (second - first) * 1e6
}

#[test]
fn two_boards_with_clocks_of_their_own_move_as_one() {
    let model = model();
    let moved = |times: &[BoardTime]| {
        let link = robot_line(&model, 1, times);
        let (plan, _) = run(&link, &model, &Handle::new(), |_, _| {});
        let trace = link.with(Simulation::take_trace);
        skew_us(&plan.unwrap(), &trace)
    };
    let by_winches_us = moved(&IN_STEP);
    let skew_us = moved(&APART);
    println!("skew {skew_us:.1} us, {by_winches_us:.1} us of it by the winches");
    assert!((skew_us - by_winches_us).abs() < 20.0, "{skew_us} us");
}

/// When each board first was in one of these states, µs.
fn first_us(
    seen: &[(u64, [BoardState; 2])],
    since_us: u64,
    wanted: &[BoardState],
) -> [Option<u64>; 2] {
    [0, 1].map(|board| {
        let mut later = seen.iter().filter(|(at_us, _)| *at_us >= since_us);
        let found = later.find(|(_, states)| wanted.contains(&states[board]));
        found.map(|(at_us, _)| *at_us)
    })
}

#[test]
fn a_stop_is_the_same_stop_on_both_boards() {
    let model = model();
    let link = robot_line(&model, 2, &APART);
    let handle = Handle::new();
    let orders = handle.clone();
    let mut given = 0;
    let (done, seen) = run(&link, &model, &handle, |simulation, now_us| {
        if given == 0 && simulation.path_ms() >= 3000 {
            given = now_us;
            orders.order(Order::Stop);
        }
    });
    assert!(matches!(done, Err(RunError::Interrupted)), "{done:?}");
    let [first, second] = first_us(&seen, given, &[BoardState::Stopping]).map(Option::unwrap);
    println!(
        "stop: {} and {} us after the order",
        first - given,
        second - given
    );
    assert!(first.abs_diff(second) <= 5_000 && first.max(second) - given < 50_000);
}

#[test]
fn a_fault_on_one_board_stops_the_other() {
    use BoardState::{Disarmed, Fault, Stopping};
    // The sixth cable is on the second board. A drive counts as lost after 10 ms.
    let after = disturbed(3, 2_500_000, |simulation| {
        without_line(simulation);
        simulation.plant_mut().faults_mut().cables[5].drive.silent = true;
    });
    let Err(RunError::Fault { record, .. }) = after.done else {
        panic!("{:?}", after.done);
    };
    assert_eq!(record.cable, 6, "{record:?}");
    let first_s = after.first_s(&[Stopping]).unwrap();
    println!("fault: the other board after {:.1} ms", first_s * 1e3);
    assert!(first_s < 0.15, "{first_s} s");
    // Without a host the other board may have noted that as a fault of its own (L10).
    let (_, last) = after.first.last().unwrap();
    assert!([Disarmed, Fault].contains(last), "{last:?}");
    assert_eq!(after.second, Fault);
}

#[test]
fn a_dead_line_of_one_board_makes_both_hold() {
    use BoardState::{Holding, Pausing};
    let dead = WireFaults {
        drop: 1.0,
        ..WireFaults::default()
    };
    let after = disturbed(4, 500_000, |simulation| {
        without_line(simulation);
        simulation.set_faults_of(1, dead, dead);
    });
    let Err(RunError::Client(ClientError::Link(LinkError::Boards { what, .. }))) = &after.done
    else {
        panic!("{:?}", after.done);
    };
    assert!(what.contains("board 2 (simulated 02)"), "{what}");
    let first_s = after.first_s(&[Pausing]).unwrap();
    println!("dead line: the other board after {:.1} ms", first_s * 1e3);
    assert!(first_s < 0.15, "{first_s} s");
    let (_, last) = after.first.last().unwrap();
    assert_eq!((*last, after.second), (Holding, Holding));
}

#[test]
fn a_board_without_supply_makes_the_other_hold() {
    use BoardState::Pausing;
    let after = disturbed(5, 500_000, |simulation| {
        without_line(simulation);
        simulation.set_power_of(1, false).unwrap();
    });
    let Err(RunError::Client(ClientError::Link(LinkError::Boards { what, .. }))) = &after.done
    else {
        panic!("{:?}", after.done);
    };
    assert!(what.contains("board 2 (simulated 02)"), "{what}");
    let first_s = after.first_s(&[Pausing]).unwrap();
    println!("no supply: the other board after {:.1} ms", first_s * 1e3);
    assert!(first_s < 0.15, "{first_s} s");
}

#[test]
fn a_pause_and_a_way_on_leave_the_boards_together() {
    let model = model();
    let by_winches_us = skew_after_a_pause_us(&model, &IN_STEP);
    let skew_us = skew_after_a_pause_us(&model, &APART);
    println!("after a pause: skew {skew_us:.1} us, {by_winches_us:.1} us of it by the winches");
    assert!((skew_us - by_winches_us).abs() < 20.0, "{skew_us} us");
}

fn skew_after_a_pause_us(model: &Model, times: &[BoardTime]) -> f64 {
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
        let rests = simulation.look_at(0).0 == BoardState::Holding
            && simulation.look_at(1).0 == BoardState::Holding;
        if given == 1 && rests {
            given = 2;
            orders.order(Order::Resume);
        }
    });
    let plan = done.unwrap();
    assert_eq!(given, 2);
    let mut trace = link.with(Simulation::take_trace);
    // One second after the way on: led together again.
    trace.retain(|point| point.path_ms > 5000);
    skew_us(&plan, &trace)
}

#[test]
fn boards_that_are_swapped_or_another_robots_are_refused() {
    let model = model();
    let link = robot_line(&model, 7, &APART);
    let home = || Homing::Place(model.robot().tool.home_in_world_m);
    let open = |link: SimulatedLink, model: &Model, home| {
        let handle = Handle::new();
        let session = Session::open(model, link, SessionId(9), &handle, home, &NoStore);
        session.and_then(Session::close)
    };
    // Both boards have the robot's configuration now.
    open(link.clone(), &model, home()).unwrap();
    // The same boards, the cables of the file the other way round.
    let mut swapped = model.robot().clone();
    swapped.boards.reverse();
    let lines = link.lines().unwrap();
    let model_of = Model::new(&swapped).unwrap();
    let other = SimulatedLink::joined(&swapped, lines.clone()).unwrap();
    let error = open(other, &model_of, home()).unwrap_err().to_string();
    assert!(error.contains("swapped"), "{error}");
    // A robot whose second board's winches are others.
    let mut another = model.robot().clone();
    for cable in 4..8 {
        another.winches[cable].drum_radius_m *= 1.1;
    }
    let model_of = Model::new(&another).unwrap();
    let other = SimulatedLink::joined(&another, lines).unwrap();
    let error = open(other, &model_of, home()).unwrap_err().to_string();
    assert!(
        error.contains("board 2") && error.contains("another robot"),
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
