//! What a board says about itself when it is asked: its state, its winches, its drives.

use crate::support::{Bench, START, TENSION_MN, adc_of, entries, hash_of};
use mcdpr_firmware::State;
use mcdpr_firmware::io::Scan;
use mcdpr_protocol::{Limit, Reject, Reply, Request};

#[test]
fn a_status_has_what_the_board_measures_and_does() {
    let mut bench = Bench::holding();
    let free = bench.status().knots_free;
    bench.request(Request::Gripper { closed: true }).unwrap();
    bench.tamper = |i| {
        i.gripper_switch = true;
        i.drives[1].torque = true;
        i.tension_adc[2] = adc_of(TENSION_MN + 3500) + i.encoders[0] % 5;
    };
    bench.buffer(4000, true);
    let before = bench.status();
    assert_eq!((before.knots_free, before.next_knot), (free - 4, 4));
    bench.request(Request::Start).unwrap();
    bench.run(700);
    let status = bench.status();
    assert_eq!((status.tick, status.state), (bench.now, State::Moving));
    assert!((695..=700).contains(&status.path_ms), "{}", status.path_ms);
    // 200 ms to 20 mm/s, then 20 mm/s: 2 mm and 10 mm, in 0.1 µm.
    for (cable, (setpoint, length)) in status
        .setpoints
        .iter()
        .zip(status.lengths.iter())
        .enumerate()
    {
        let way = setpoint.0 - START;
        assert!((118_000..122_000).contains(&way), "{cable}: {way}");
        let off = (length.0 - setpoint.0).abs();
        // The fourth is held by its tension, which the bench does not change.
        assert!(cable == 3 || off < 2000, "{cable}: {off}");
    }
    let tensions: Vec<_> = status.tensions.iter().map(|tension| tension.0).collect();
    // An empty list would agree with anything.
    let counts = [status.setpoints.len(), status.lengths.len(), tensions.len()];
    assert_eq!(counts, [4; 3]);
    let expected = [TENSION_MN, TENSION_MN, TENSION_MN + 3500, TENSION_MN];
    for (found, expected) in tensions.iter().zip(expected) {
        assert!((found - expected).abs() < 20, "{tensions:?}");
    }
    assert!(status.limits.contains(Limit::TensionOff));
    assert_eq!(status.config, Some(hash_of(&entries())));
    assert!(status.referenced && status.gripper_closed && status.gripper_switch);
    assert_eq!((status.brakes_open, status.torque_on), (0b1111, 0b0010));
    assert_eq!((status.fault, status.tick_overruns), (None, 0));
    bench.tamper = |i| i.overrun = true;
    bench.run(2);
    let status = bench.status();
    assert_eq!(status.tick_overruns, 2);
    assert_eq!(status.fault, bench.server.controller().fault());
    assert!(status.fault.is_some() && !status.gripper_switch);
}

#[test]
fn a_search_for_drives_is_asked_of_the_bus_once_and_its_result_is_of_this_search() {
    let mut bench = Bench::ready();
    bench.tamper = |i| {
        i.scan = Scan {
            done: true,
            nodes: [0b1010, 0, 0, 1],
        };
    };
    bench.step();
    let nodes = [0b1010, 0, 0, 1];
    let look = Request::Scan { restart: false };
    let known = Ok(Reply::Drives { done: true, nodes });
    assert_eq!(bench.request(look.clone()), known);
    assert!(!bench.step().scan, "nothing was asked of the bus");
    // What is known is of the search before.
    let begun = bench.request(Request::Scan { restart: true });
    assert_eq!(begun, Ok(Reply::Drives { done: false, nodes }));
    assert!(bench.step().scan);
    assert!(!bench.step().scan);
    assert_eq!(bench.request(look.clone()), known);
    // Without a configuration there is no bus.
    let mut fresh = Bench::new();
    fresh.step();
    fresh.open();
    assert_eq!(fresh.request(look), Err(Reject::NotConfigured));
}

#[test]
fn a_winch_is_told_as_its_inputs_are() {
    let mut bench = Bench::ready();
    bench.tamper = |i| {
        for (number, drive) in (1..).zip(&mut i.drives) {
            (drive.ready, drive.bus_off) = (number == 1, number == 2);
            (drive.fault, drive.over_temperature) = (number == 3, number == 4);
            (drive.age_ms, drive.counts) = (number as u16, -1000 * number);
            drive.current_ma = 10 * number as i16;
        }
        i.tension_adc = [20_001, 20_002, 20_003, 20_004];
    };
    bench.step();
    let first = bench.now;
    for number in 1..=4_u8 {
        let Ok(Reply::Winch(winch)) = bench.request(Request::Winch { cable: number }) else {
            panic!("{number}");
        };
        let is = [winch.ready, winch.bus_off, winch.fault, winch.hot];
        assert_eq!(is, [1, 2, 3, 4].map(|only| only == number));
        let number = i32::from(number);
        assert_eq!(
            (i32::from(winch.age_ms), winch.motor_counts),
            (number, -1000 * number)
        );
        assert_eq!(i32::from(winch.current_ma), 10 * number);
        assert_eq!(i32::from(winch.tension_adc), 20_000 + number);
    }
    for number in [0, 5, u8::MAX] {
        let expected = Reject::CableCount {
            expected: 4,
            got: number,
        };
        assert_eq!(
            bench.request(Request::Winch { cable: number }),
            Err(expected)
        );
    }
    assert_eq!(bench.now, first);
    // A turn of the third drum is 4096 counts of its encoder, of which it has turned one in eight.
    let counts = |bench: &mut Bench| match bench.request(Request::Winch { cable: 3 }) {
        Ok(Reply::Winch(winch)) => winch.drum_counts,
        other => panic!("{other:?}"),
    };
    let before = counts(&mut bench);
    for _ in 0..256 {
        bench.motor[2] += 742;
        bench.step();
    }
    assert!((counts(&mut bench) - before - 512).abs() <= 1);
}
