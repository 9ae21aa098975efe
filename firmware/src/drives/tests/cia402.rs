//! CiA 402. Nodes 3 (position) and 5 (torque).

use super::*;
use std::vec::Vec as List;

const RATED_MA: u32 = 2000;

/// Lets the bench run while node 3 (or 5) answers its set-up requests as a drive does.
fn run(bench: &mut Bench, ticks: u32, demands: [DriveDemand; 2]) -> List<(u16, Vec<u8, 8>)> {
    let mut all = List::new();
    for _ in 0..ticks {
        bench.tick(demands);
        for (id, data) in bench.sent() {
            if id == 0x000 && data[0] == 0x82 {
                bench.give(0x700 | u16::from(data[1]), &[0]);
            } else if (0x600..0x680).contains(&id) {
                let answer = if data[0] == 0x40 {
                    let [a, b, c, d] = RATED_MA.to_le_bytes();
                    [0x43, data[1], data[2], data[3], a, b, c, d]
                } else {
                    [0x60, data[1], data[2], data[3], 0, 0, 0, 0]
                };
                bench.give(id - 0x80, &answer);
            }
            all.push((id, data));
        }
    }
    all
}

/// The feedback of both drives at a SYNC: state, mode.
fn say(bench: &mut Bench, status: u16, modes: [u8; 2]) {
    let [low, high] = status.to_le_bytes();
    for (node, mode) in [3, 5].into_iter().zip(modes) {
        // 1000 counts, half of the rated torque.
        bench.give(0x180 + node, &[low, high, 0xE8, 0x03, 0, 0, 0xF4, 0x01]);
        bench.give(0x280 + node, &[mode]);
        bench.give(0x700 + node, &[0x05]);
    }
}

#[test]
fn the_set_up_is_the_objects_of_the_profile() {
    let mut bench = Bench::new(DriveKind::Cia402);
    let frames = run(&mut bench, 120, OFF);
    let node_3: List<_> = frames
        .iter()
        .filter(|(id, data)| *id == 0x603 || (*id == 0 && data[1] == 3))
        .cloned()
        .collect();
    assert_eq!(
        hex(&node_3),
        [
            "000 82 03",
            "603 23 00 18 01 83 01 00 C0",
            "603 2F 00 18 02 01 00 00 00",
            "603 2F 00 1A 00 00 00 00 00",
            "603 23 00 1A 01 10 00 41 60",
            "603 23 00 1A 02 20 00 64 60",
            "603 23 00 1A 03 10 00 77 60",
            "603 2F 00 1A 00 03 00 00 00",
            "603 23 00 18 01 83 01 00 40",
            "603 23 01 18 01 83 02 00 C0",
            "603 2F 01 18 02 0A 00 00 00",
            "603 2F 01 1A 00 00 00 00 00",
            "603 23 01 1A 01 08 00 61 60",
            "603 2F 01 1A 00 01 00 00 00",
            "603 23 01 18 01 83 02 00 40",
            "603 23 02 18 01 83 03 00 C0",
            "603 23 03 18 01 83 04 00 C0",
            "603 23 00 14 01 03 02 00 80",
            "603 2F 00 14 02 FF 00 00 00",
            "603 2F 00 16 00 00 00 00 00",
            "603 23 00 16 01 10 00 40 60",
            "603 23 00 16 02 20 00 7A 60",
            "603 2F 00 16 00 02 00 00 00",
            "603 23 00 14 01 03 02 00 00",
            // 100 ms; node 127 within 200 ms.
            "603 2B 17 10 00 64 00 00 00",
            "603 23 16 10 01 C8 00 7F 00",
            // Cyclic synchronous position.
            // Without them: disable voltage.
            "603 2B 07 60 00 02 00 00 00",
            "603 2F 60 60 00 08 00 00 00",
            "603 40 75 60 00 00 00 00 00",
            // 3000 mA of 2000 mA: 1500 thousandths; 8000 rpm; 2 ms.
            "603 2B 72 60 00 DC 05 00 00",
            "603 23 80 60 00 40 1F 00 00",
            "603 2F C2 60 01 02 00 00 00",
            "000 01 03",
        ]
    );
    // Node 5 is held by tension: cyclic synchronous torque.
    let has = |line: &str| hex(&frames).iter().any(|frame| frame == line);
    assert!(has("605 2F 60 60 00 0A 00 00 00"));
    assert!(has("605 23 00 16 02 10 00 71 60"));
}

/// As `run`, with drives that refuse one object.
fn run_without(bench: &mut Bench, ticks: u32, lacks: (u16, u8)) -> List<(u16, Vec<u8, 8>)> {
    let mut all = List::new();
    for _ in 0..ticks {
        bench.tick(OFF);
        for (id, data) in bench.sent() {
            if id == 0x000 && data[0] == 0x82 {
                bench.give(0x700 | u16::from(data[1]), &[0]);
            } else if (0x600..0x680).contains(&id) {
                let asked = (u16::from_le_bytes([data[1], data[2]]), data[3]);
                let [a, b, c, d] = RATED_MA.to_le_bytes();
                // It does not exist (CiA 301), or its value is not supported.
                let refuses = asked == lacks && !(lacks == (0x1400, 2) && data[4] == 1);
                let answer = match (refuses, data[0]) {
                    (true, _) => [0x80, data[1], data[2], data[3], 0, 0, 2, 6],
                    (_, 0x40) => [0x43, data[1], data[2], data[3], a, b, c, d],
                    _ => [0x60, data[1], data[2], data[3], 0, 0, 0, 0],
                };
                bench.give(id - 0x80, &answer);
            }
            all.push((id, data));
        }
    }
    all
}

#[test]
fn a_refused_object_is_named_with_its_abort_code() {
    let mut bench = Bench::new(DriveKind::Cia402);
    run_without(&mut bench, 300, (0x6060, 0));
    let inputs = bench.tick(OFF);
    for drive in inputs {
        let refused = drive.refused.unwrap();
        assert_eq!((refused.object, refused.code), (0x0060_6000, 0x0602_0000));
        assert!(!drive.ready);
    }
    // It is not repeated without end: once in a start of its communication, a second apart.
    let frames = run_without(&mut bench, 3000, (0x6060, 0));
    let asked = frames
        .iter()
        .filter(|(id, data)| *id == 0x603 && u16::from_le_bytes([data[1], data[2]]) == 0x6060);
    let asked = asked.count();
    assert!((1..=4).contains(&asked), "{asked}");
}

#[test]
fn a_drive_without_an_optional_object_falls_back() {
    for lacks in [
        (0x1801, 1),
        (0x1801, 2),
        (0x1A01, 1),
        (0x1802, 1),
        (0x1016, 1),
        (0x6007, 0),
        (0x6072, 0),
        (0x6080, 0),
        (0x60C2, 1),
    ] {
        let mut bench = Bench::new(DriveKind::Cia402);
        let frames = run_without(&mut bench, 200, lacks);
        let started = hex(&frames).iter().any(|frame| frame == "000 01 03");
        assert!(started, "{lacks:x?}");
        assert_eq!(bench.tick(OFF)[0].refused, None, "{lacks:x?}");
    }
    // A drive without immediate effect acts at SYNC.
    let mut bench = Bench::new(DriveKind::Cia402);
    let frames = hex(&run_without(&mut bench, 200, (0x1400, 2)));
    assert!(
        frames
            .iter()
            .any(|frame| frame == "603 2F 00 14 02 01 00 00 00")
    );
    assert!(frames.iter().any(|frame| frame == "000 01 03"));
}

/// Both drives in their mode, as a conforming drive would get there.
fn enabled() -> Bench {
    let mut bench = Bench::new(DriveKind::Cia402);
    run(&mut bench, 120, OFF);
    for (status, control) in [(0x40, 0x06), (0x21, 0x07), (0x23, 0x0F), (0x27, 0x0F)] {
        say(&mut bench, status, [8, 10]);
        let frames = run(&mut bench, 2, ENABLE);
        let commands: List<_> = hex(&frames)
            .into_iter()
            .filter(|frame| frame.starts_with('2'))
            .collect();
        // Where it is, 1000 counts; no torque.
        let position = std::format!("203 {control:02X} 00 E8 03 00 00");
        let torque = std::format!("205 {control:02X} 00 00 00");
        assert_eq!(commands, [position, torque], "from {status:#x}");
    }
    say(&mut bench, 0x27, [8, 10]);
    let inputs = bench.tick(ENABLE);
    assert!(inputs.iter().all(|drive| drive.ready && !drive.fault));
    bench.sent();
    bench
}

#[test]
fn the_control_word_follows_the_state_machine_and_set_points_follow() {
    let mut bench = enabled();
    say(&mut bench, 0x1627, [8, 10]);
    let demands = [
        DriveDemand::Position {
            counts: -70_000,
            rpm: 1,
        },
        DriveDemand::Current { ma: -500 },
    ];
    let inputs = bench.tick(demands);
    assert_eq!(inputs[0].current_ma, 1000); // half of 2 A
    assert_eq!(inputs[0].counts, 1000);
    bench.tick(demands);
    let frames = bench.sent();
    let commands: List<_> = hex(&frames)
        .into_iter()
        .filter(|frame| frame.starts_with('2'))
        .collect();
    assert_eq!(commands.len(), 2);
    // -70,000 is 0xFFFEEE90; -500 mA of 2000 mA is -250 thousandths, 0xFF06.
    assert!(
        commands.contains(&"203 0F 00 90 EE FE FF".into()),
        "{commands:?}"
    );
    assert!(commands.contains(&"205 0F 00 06 FF".into()), "{commands:?}");
}

#[test]
fn speed_comes_from_counts_of_whole_periods() {
    let mut bench = enabled();
    for turn in 1_u16..=4 {
        // 273 counts in 2 ms of a motor with 4096 per turn: 1999.5 rpm.
        let [low, high] = (1000 + 273 * turn).to_le_bytes();
        bench.give(0x183, &[0x27, 0, low, high, 0, 0, 0, 0]);
        let inputs = bench.tick(ENABLE);
        if turn > 1 {
            assert!((1998..=2000).contains(&inputs[0].rpm), "{}", inputs[0].rpm);
        }
        // Early and late by a tick.
        for _ in 0..[0, 1, 2][usize::from(turn) % 3] {
            bench.tick(ENABLE);
        }
    }
}

#[test]
fn a_fault_a_wrong_mode_and_torque_that_went_are_faults() {
    for (status, mode) in [(0x08, 8), (0x0F, 8), (0x23, 8), (0x40, 8), (0x27, 1)] {
        let mut bench = enabled();
        say(&mut bench, status, [mode, 10]);
        let inputs = bench.tick(ENABLE);
        assert!(inputs[0].fault, "{status:#x} in mode {mode}");
    }
}

#[test]
fn a_drive_in_a_wrong_mode_never_becomes_ready() {
    let mut bench = Bench::new(DriveKind::Cia402);
    run(&mut bench, 120, OFF);
    for status in [0x40, 0x21, 0x23, 0x27, 0x27, 0x27] {
        say(&mut bench, status, [1, 10]);
        run(&mut bench, 2, ENABLE);
    }
    let inputs = bench.tick(ENABLE);
    assert!(!inputs[0].ready && inputs[1].ready);
}

#[test]
fn heat_is_reported_until_the_drive_takes_it_back() {
    let mut bench = enabled();
    // Excess temperature of the motor's supply (0x4310), error register 9.
    bench.give(0x083, &[0x10, 0x43, 0x09, 0, 0, 0, 0, 0]);
    let inputs = bench.tick(ENABLE);
    assert!(inputs[0].over_temperature && !inputs[1].over_temperature);
    bench.give(0x083, &[0; 8]);
    assert!(!bench.tick(ENABLE)[0].over_temperature);
}

#[test]
fn a_missing_heartbeat_is_a_lost_drive_whatever_else_it_says() {
    let mut bench = enabled();
    for _ in 0..310 {
        bench.give(0x183, &[0x27, 0, 0, 0, 0, 0, 0, 0]);
        bench.tick(ENABLE);
    }
    assert!(bench.tick(ENABLE)[0].age_ms > 300);
}

#[test]
fn feedback_is_as_old_as_its_sync_whenever_it_arrives() {
    let mut bench = enabled();
    // A period of two ticks: SYNC at each even one.
    while bench.now % 2 == 1 {
        bench.tick(ENABLE);
    }
    bench.tick(ENABLE);
    bench.give(0x183, &[0x27, 0x02, 0xE8, 0x03, 0, 0, 0xF4, 0x01]);
    assert_eq!(bench.tick(ENABLE)[0].age_ms, 0, "in the tick after SYNC");
    bench.tick(ENABLE);
    // Two ticks later, and no SYNC in between.
    for _ in 0..2 {
        bench.bus.listen(&mut bench.port);
    }
    bench.give(0x183, &[0x27, 0x02, 0xE8, 0x03, 0, 0, 0xF4, 0x01]);
    bench.bus.listen(&mut bench.port);
    let mut inputs = Inputs::<2>::default();
    bench.bus.fill(&mut inputs);
    assert_eq!(inputs.drives[0].age_ms, 2);
}

#[test]
fn torque_goes_at_once_and_comes_back_only_by_enabling() {
    let mut bench = enabled();
    say(&mut bench, 0x27, [8, 10]);
    bench.tick(OFF);
    let commands: List<_> = hex(&bench.sent());
    for node in ["203 00 00", "205 00 00"] {
        assert!(
            commands.iter().any(|frame| frame.starts_with(node)),
            "{node}: {commands:?}"
        );
    }
    let torque = [
        DriveDemand::Position { counts: 0, rpm: 1 },
        DriveDemand::Current { ma: 1 },
    ];
    for status in [0x40, 0x21, 0x23, 0x27] {
        say(&mut bench, status, [8, 10]);
        bench.tick(torque);
        bench.tick(torque);
    }
    let commands = hex(&bench.sent());
    let mut commands = commands.iter().filter(|frame| frame.starts_with('2'));
    assert!(commands.all(|frame| frame[4..].starts_with("00 00")));
}

/// A demand for no torque does not wait for a slot, and does not fill the bus once it is obeyed.
#[test]
fn a_drive_without_torque_is_commanded_in_its_slot_alone() {
    let mut bench = Bench::new(DriveKind::Cia402);
    run(&mut bench, 120, OFF);
    let first = bench.now;
    for _ in 0..20 {
        say(&mut bench, 0x40, [8, 10]);
        bench.tick(OFF);
    }
    let mut times = [List::new(), List::new()];
    for (at, frame) in &bench.port.sent {
        match frame.id {
            0x203 => times[0].push(*at),
            0x205 => times[1].push(*at),
            _ => {}
        }
    }
    for (slot, times) in (0..).zip(times) {
        let due = (first..first + 20).filter(|at| at % 2 == slot);
        assert_eq!(times, due.collect::<List<_>>());
    }
}

#[test]
fn a_drive_that_restarts_is_set_up_again() {
    let mut bench = enabled();
    bench.give(0x703, &[0]);
    let frames = run(&mut bench, 120, OFF);
    let again = hex(&frames)
        .iter()
        .filter(|frame| frame.starts_with("603"))
        .count();
    assert_eq!(again, 31);
}

#[test]
fn a_refused_object_stops_the_set_up_unless_a_drive_may_lack_it() {
    let mut bench = Bench::new(DriveKind::Cia402);
    bench.tick(OFF);
    bench.give(0x703, &[0]);
    // The mapping of the feedback does not exist: abort code 0x06020000.
    let mut refused = 0;
    for _ in 0..10 {
        bench.tick(OFF);
        for (id, data) in bench.sent() {
            if id == 0x603 {
                refused += 1;
                let (low, high, sub) = (data[1], data[2], data[3]);
                bench.give(0x583, &[0x80, low, high, sub, 0, 0, 2, 6]);
            }
        }
    }
    assert!(refused > 0, "nothing was asked that could be refused");
    bench.sent();
    let asked = |bench: &mut Bench| {
        for _ in 0..120 {
            bench.tick(OFF);
        }
        let sent = bench.sent();
        sent.iter().filter(|(id, _)| *id == 0x603).count()
    };
    assert_eq!(asked(&mut bench), 0);
    // The refusal ended it, not the end of the list: a drive that restarts is asked again.
    bench.give(0x703, &[0]);
    assert!(asked(&mut bench) > 0);
}
