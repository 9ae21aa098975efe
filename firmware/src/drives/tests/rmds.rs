//! RoboModule RMDS. Node 3 is group 0, number 3: identifiers 0x030 to 0x03F.

use super::*;

/// Feedback of 1500 mA (0x05DC), -300 rpm (0xFED4), 70,000 counts (0x00011170).
const FEEDBACK: [u8; 8] = [0x05, 0xDC, 0xFE, 0xD4, 0x00, 0x01, 0x11, 0x70];

fn feed(bench: &mut Bench) {
    bench.give(0x03B, &FEEDBACK);
    bench.give(0x05B, &FEEDBACK);
}

fn enabled() -> Bench {
    let mut bench = Bench::new(DriveKind::Rmds);
    for tick in 0..1100 {
        if tick >= 515 {
            feed(&mut bench);
        }
        bench.tick(if tick < 520 { OFF } else { ENABLE });
    }
    bench
}

#[test]
fn a_drive_is_reset_ordered_to_report_and_put_in_its_mode() {
    let mut bench = enabled();
    let frames = bench.sent();
    assert_eq!(
        hex(&frames),
        [
            "030 55 55 55 55 55 55 55 55",
            "050 55 55 55 55 55 55 55 55",
            // Feedback every 2 ms, no report of limit switches.
            "03A 02 00 55 55 55 55 55 55",
            "05A 02 00 55 55 55 55 55 55",
            // Speed and position (5); current (2).
            "031 05 55 55 55 55 55 55 55",
            "051 02 55 55 55 55 55 55 55",
        ]
    );
    assert_eq!(bench.port.bitrate, 1_000_000);
    feed(&mut bench);
    let inputs = bench.tick(ENABLE);
    for input in inputs {
        assert!(input.ready && !input.fault);
        assert_eq!((input.current_ma, input.rpm), (1500, -300));
        assert_eq!((input.counts, input.age_ms), (70_000, 0));
    }
}

#[test]
fn a_drive_in_its_mode_gets_set_points_in_its_slot() {
    let mut bench = enabled();
    bench.sent();
    // -2 counts at 8000 rpm (0x1F40); -1000 mA (0xFC18); 5000 (0x1388) is the whole voltage.
    let demands = [
        DriveDemand::Position {
            counts: -2,
            rpm: 8000,
        },
        DriveDemand::Current { ma: -1000 },
    ];
    for _ in 0..2 {
        feed(&mut bench);
        bench.tick(demands);
    }
    let times: std::vec::Vec<_> = bench.port.sent.iter().map(|(at, _)| *at).collect();
    assert_eq!(times, [1100, 1101]);
    let frames = bench.sent();
    assert_eq!(
        hex(&frames),
        ["036 13 88 1F 40 FF FF FF FE", "053 13 88 FC 18 55 55 55 55"]
    );
}

#[test]
fn torque_goes_at_once_and_comes_back_only_by_enabling() {
    let mut bench = enabled();
    bench.sent();
    bench.tick(OFF);
    let frames = bench.sent();
    // Both, in the same tick, slot or not.
    assert_eq!(
        hex(&frames),
        ["030 55 55 55 55 55 55 55 55", "050 55 55 55 55 55 55 55 55"]
    );
    let torque = [
        DriveDemand::Position {
            counts: 0,
            rpm: 100,
        },
        DriveDemand::Current { ma: 100 },
    ];
    for _ in 0..3000 {
        feed(&mut bench);
        assert!(bench.tick(torque).iter().all(|drive| !drive.ready));
    }
    let frames = bench.sent();
    assert!(frames.iter().all(|(id, _)| id & 0xF == 0xA), "{frames:?}");
}

#[test]
fn a_silent_drive_never_becomes_ready_and_is_woken_again_and_again() {
    let mut bench = Bench::new(DriveKind::Rmds);
    for _ in 0..5000 {
        let inputs = bench.tick(OFF);
        assert!(inputs.iter().all(|drive| drive.age_ms > 1000));
        assert!(inputs.iter().all(|drive| !drive.ready));
    }
    let resets = bench.sent().iter().filter(|(id, _)| *id == 0x030).count();
    // 510 ms until it is commanded to report, 100 ms until it is lost, and its slots.
    assert!((7..=9).contains(&resets), "{resets}");
}

#[test]
fn feedback_of_another_node_or_length_is_not_this_drives() {
    let mut bench = enabled();
    for tick in 0..20_u16 {
        bench.give(0x04B, &FEEDBACK);
        bench.give(0x03B, &FEEDBACK[..7]);
        bench.give(0x03C, &FEEDBACK);
        bench.give(0x05B, &FEEDBACK);
        let inputs = bench.tick(ENABLE);
        assert_eq!(inputs[0].age_ms, tick + 1);
        assert_eq!(inputs[1].age_ms, 0);
    }
}

#[test]
fn what_the_port_has_no_room_for_goes_in_the_next_tick() {
    let mut bench = enabled();
    bench.sent();
    let demands = [DriveDemand::Position { counts: 9, rpm: 9 }, ENABLE[1]];
    bench.port.room = 0;
    bench.port.now = bench.now;
    let outputs = Outputs {
        drives: demands,
        ..Outputs::default()
    };
    let active = bench.active.clone();
    let now = Tick(bench.now);
    bench
        .bus
        .tick(now, Some(&active), &outputs, &mut bench.port);
    assert!(bench.port.sent.is_empty());
    bench.now += 1;
    bench.tick(demands);
    assert_eq!(bench.sent()[0].0, 0x036);
}

#[test]
fn a_bus_that_is_off_is_reported() {
    let mut bench = enabled();
    bench.port.state = BusState::Off;
    assert!(bench.tick(ENABLE).iter().all(|drive| drive.bus_off));
    bench.port.state = BusState::Passive;
    assert!(bench.tick(ENABLE).iter().all(|drive| !drive.bus_off));
}

#[test]
fn a_drive_that_is_given_a_speed_enters_the_speed_mode() {
    let mut bench = Bench::new(DriveKind::Rmds);
    bench.active.cables[1].output = TensionOutput::Speed;
    let enable = [DriveDemand::EnablePosition, DriveDemand::EnableSpeed];
    for tick in 0..1100 {
        if tick >= 515 {
            feed(&mut bench);
        }
        bench.tick(if tick < 520 { OFF } else { enable });
    }
    let frames = bench.sent();
    let commanded = hex(&frames);
    assert_eq!(commanded[5], "051 03 55 55 55 55 55 55 55");
    // -300 rpm (0xFED4) at the whole voltage, 5000 (0x1388).
    let demands = [OFF[0], DriveDemand::Speed { rpm: -300 }];
    for _ in 0..2 {
        bench.tick(demands);
    }
    let frames = bench.sent();
    let commanded = hex(&frames);
    assert!(
        commanded.iter().any(|f| f == "054 13 88 FE D4 55 55 55 55"),
        "{commanded:?}"
    );
}
