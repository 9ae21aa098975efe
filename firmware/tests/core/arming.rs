use crate::support::{
    ARMING_MS, BRAKE_MS, Bench, CABLES, ENABLE_MS, MOTOR_COUNTS, START, TENSION_MN, adc_of, build,
    entries, entries_with,
};
use mcdpr_firmware::{Brake, DriveDemand, Inputs, State};
use mcdpr_protocol::{
    CableKey, ConfigKey, FaultId, Millinewtons, PerCable, Reject, Reply, Request, TenthMicrometres,
};

#[test]
fn arming_enables_drives_then_gives_torque_then_opens_brakes_then_holds() {
    let mut bench = Bench::ready();
    bench.enable_ticks = [20, 30, 25, 10];
    bench.arm().unwrap();
    let (mut torque, mut open, mut holding) = (None, None, None);
    for tick in 1..2400 {
        let before = bench.outputs;
        bench.step();
        if tick > 1 && torque.is_none() {
            let enabling = before
                .drives
                .iter()
                .all(|d| !d.gives_torque() && *d != DriveDemand::Off);
            assert!(enabling, "drives are enabled before torque");
            assert_eq!(before.drives[3], DriveDemand::EnableCurrent);
            assert_eq!(before.drives[0], DriveDemand::EnablePosition);
        }
        let all = bench
            .outputs
            .drives
            .iter()
            .all(|drive| drive.gives_torque());
        assert_eq!(all, bench.any_torque(), "all axes at once");
        if all {
            torque.get_or_insert(tick);
        }
        if !bench.all_brakes(Brake::Closed) {
            assert!(bench.all_brakes(Brake::Open), "all brakes at once");
            open.get_or_insert(tick);
        }
        if bench.state() == State::Holding {
            holding.get_or_insert(tick);
        }
    }
    let (torque, open, holding) = (torque.unwrap(), open.unwrap(), holding.unwrap());
    assert!(torque > 30, "not before the slowest drive");
    // 30 ms of torque, then the push: reached in 0.1 s and held for 200 ms; then each drive carries its
    // load again for 100 ms.
    assert!((330..=800).contains(&(open - torque)), "{}", open - torque);
    // 50 ms to open, the test motion of four drums for 120 ms each, 500 ms of rest.
    assert_eq!(holding - open, 50 + 4 * 120 + 500);
}

#[test]
fn torque_comes_on_where_the_robot_is() {
    let mut bench = Bench::ready();
    bench.arm().unwrap();
    let motor = bench.motor;
    bench.until(State::Holding, crate::support::ARMING_MS);
    for i in 0..3 {
        let DriveDemand::Position { counts, .. } = bench.outputs.drives[i] else {
            panic!("no position");
        };
        // Half an encoder count is 186 motor counts.
        assert!(
            (counts - motor[i]).abs() <= 190,
            "cable {}: {counts} {}",
            i + 1,
            motor[i]
        );
    }
}

#[test]
fn d5_a_drive_that_never_enables_aborts_at_its_bound_and_the_brakes_never_open() {
    for slow in 0..CABLES {
        let mut bench = Bench::ready();
        bench.enable_ticks[slow] = u32::MAX;
        bench.arm().unwrap();
        let mut latched = None;
        for tick in 1..2000_u32 {
            bench.step();
            assert!(bench.all_brakes(Brake::Closed), "tick {tick}");
            assert!(!bench.any_torque(), "tick {tick}");
            if bench.fault().is_some() {
                latched.get_or_insert(tick);
            }
        }
        // The drive's own enable time and half a second.
        assert_eq!(latched, Some(ENABLE_MS + 500));
        let record = bench.server.controller().fault().unwrap();
        assert_eq!(
            (record.fault, usize::from(record.cable)),
            (FaultId::D5, slow + 1)
        );
        assert_eq!(bench.state(), State::Fault);
        assert!(
            bench
                .outputs
                .drives
                .iter()
                .all(|drive| *drive == DriveDemand::Off)
        );
    }
}

#[test]
fn d5_a_drive_just_in_time_is_taken() {
    let mut bench = Bench::ready();
    bench.enable_ticks[1] = ENABLE_MS + 490;
    bench.arm().unwrap();
    bench.until(State::Holding, crate::support::ARMING_MS + 500);
    assert_eq!(bench.fault(), None);
}

/// Arms with manipulated inputs from the first tick on; returns the fault, its cable, and whether a
/// brake opened.
fn abort(tamper: fn(&mut Inputs<CABLES>)) -> (Option<FaultId>, u8, bool) {
    let mut bench = Bench::ready();
    bench.tamper = tamper;
    bench.arm().unwrap();
    let mut opened = false;
    for _ in 0..1500 {
        bench.step();
        opened |= !bench.all_brakes(Brake::Closed);
    }
    let record = bench.server.controller().fault();
    (
        record.map(|r| r.fault),
        record.map_or(0, |r| r.cable),
        opened,
    )
}

#[test]
fn s10_s7_s8_a_sensor_that_is_off_aborts_arming_and_the_brakes_never_open() {
    assert_eq!(
        abort(|i| i.tension_adc[2] = adc_of(12_010)),
        (Some(FaultId::S10), 3, false)
    );
    assert_eq!(
        abort(|i| i.tension_adc[2] = adc_of(7990)),
        (Some(FaultId::S10), 3, false)
    );
    assert_eq!(
        abort(|i| i.tension_adc[0] = 65_520),
        (Some(FaultId::S7), 1, false)
    );
    assert_eq!(
        abort(|i| i.tension_adc[3] = 0),
        (Some(FaultId::S8), 4, false)
    );
    // Within 2 N of what the static model expects.
    let fine = abort(|i| i.tension_adc[2] = adc_of(11_900) + i.tension_adc[2] % 7);
    assert_eq!(fine, (None, 0, true));
}

/// What the third cable reads, and what the host expects there: whether arming refuses it.
fn is_off(adc: u16, expected: fn(i32) -> i32) -> bool {
    let config = build(&entries()).unwrap();
    let reads_mn = mcdpr_firmware::tension::measured_mn(&config.cables[2], adc);
    let mut bench = Bench::ready();
    bench.tamper = match adc {
        20_000 => |i| i.tension_adc[2] = 20_000,
        30_000 => |i| i.tension_adc[2] = 30_000,
        _ => |i| i.tension_adc[2] = 50_000,
    };
    let tensions = [TENSION_MN, TENSION_MN, expected(reads_mn), TENSION_MN];
    bench
        .request(Request::Reference {
            lengths: PerCable::collect([TenthMicrometres(START); CABLES]),
            tensions: PerCable::collect(tensions.map(Millinewtons)),
        })
        .unwrap();
    bench.arm().unwrap();
    // Drives enable first.
    bench.run(20);
    let off = bench.fault() == Some(FaultId::S10);
    assert!(off || bench.fault().is_none(), "{:?}", bench.fault());
    off
}

#[test]
fn s10_a_tension_may_be_off_by_2_n_or_a_fifth_and_not_by_a_millinewton_more() {
    // 9.85 N, 16.3 N, 29.1 N: a fifth of more than 10 N is over 2 N.
    assert!(!is_off(20_000, |reads| reads - 2000));
    assert!(is_off(20_000, |reads| reads - 2001));
    assert!(!is_off(20_000, |reads| reads * 5 / 4));
    assert!(is_off(20_000, |reads| reads * 5 / 4 + 2));
    for adc in [30_000, 50_000] {
        // The fifth is of what is expected.
        assert!(!is_off(adc, |reads| reads * 5 / 6 + 1));
        assert!(is_off(adc, |reads| reads * 5 / 6 - 2));
        assert!(is_off(adc, |reads| reads * 5 / 4 + 2));
    }
}

/// Half a lobe out, a whole one in, half a lobe out: a platform that swings hardly feels it. Two counts of the encoder.
#[test]
fn the_test_motion_of_a_drum_ends_where_it_began_and_has_no_mean() {
    for index in 0..3 {
        // Without lead: demands are set-points.
        let key = ConfigKey::cable(index as u8, CableKey::LeadUs);
        let entries = entries_with(key, 0);
        let mut bench = Bench::ready_with(&entries);
        bench.arm_with(&entries).unwrap();
        let mut counts = Vec::new();
        for _ in 0..ARMING_MS {
            bench.step();
            if bench.state() == State::Holding {
                break;
            }
            if let DriveDemand::Position { counts: at, .. } = bench.outputs.drives[index]
                && bench.all_brakes(Brake::Open)
            {
                counts.push(at);
            }
        }
        assert_eq!(bench.state(), State::Holding);
        let ways: Vec<_> = counts.iter().map(|at| f64::from(at - counts[0])).collect();
        let (least, most) = ways.iter().fold((0.0_f64, 0.0_f64), |(least, most), way| {
            (least.min(*way), most.max(*way))
        });
        let two_counts = f64::from(MOTOR_COUNTS) / 2048.0;
        assert!((most / two_counts - 0.5).abs() < 0.03, "{most}");
        assert!((least / two_counts + 1.0).abs() < 0.03, "{least}");
        assert!(ways.last().unwrap().abs() < 5.0, "{ways:?}");
        let sum: f64 = ways.iter().sum();
        assert!(sum.abs() < 0.02 * two_counts * 120.0, "{sum}");
    }
}

#[test]
fn d2_d3_s8_what_goes_after_it_came_up_aborts_before_the_brakes_open() {
    let cases: [(fn(&mut Inputs<CABLES>), FaultId); 4] = [
        (|i| i.drives[1].age_ms = 10, FaultId::D3),
        (|i| i.drives[1].ready = false, FaultId::D3),
        (|i| i.drives[1].fault = true, FaultId::D2),
        (|i| i.tension_adc[1] = 0, FaultId::S8),
    ];
    for (tamper, fault) in cases {
        let mut bench = Bench::ready();
        bench.arm().unwrap();
        while !bench.any_torque() {
            bench.step();
        }
        bench.run(50);
        assert!(bench.all_brakes(Brake::Closed));
        bench.tamper = tamper;
        bench.run(1000);
        assert_eq!((bench.fault(), bench.state()), (Some(fault), State::Fault));
        bench.tamper = |_| {};
        // No brake was opened.
        let mut again = Bench::ready();
        again.arm().unwrap();
        while !again.any_torque() {
            again.step();
        }
        again.tamper = tamper;
        for _ in 0..1000 {
            again.step();
            assert!(again.all_brakes(Brake::Closed));
        }
    }
}

#[test]
fn l17_f9_no_arming_without_configuration_reference_and_agreement() {
    let mut bench = Bench::new();
    bench.step();
    bench.open();
    assert_eq!(bench.arm(), Err(Reject::NotConfigured));
    bench.configure(&crate::support::entries());
    assert_eq!(bench.arm(), Err(Reject::NotReferenced));
    bench.reference();
    let host = mcdpr_protocol::ConfigHash(5);
    let board = crate::support::hash_of(&crate::support::entries());
    assert_eq!(
        bench.request(Request::Arm { config_hash: host }),
        Err(Reject::ConfigHash { board, host })
    );
    assert_eq!(bench.arm(), Ok(Reply::Done));
    // Other gains do not affect the lengths; with another scale they must be set again.
    for (key, value, expected) in [
        (CableKey::TensionKp, 77, Ok(Reply::Done)),
        (CableKey::DrumRadius, 210_000, Err(Reject::NotReferenced)),
        (CableKey::EncoderSign, 1, Err(Reject::NotReferenced)),
    ] {
        let key = ConfigKey::cable(1, key);
        let before = crate::support::entries();
        assert!(
            before.iter().any(|e| e.key == key && e.value != value),
            "{key:?}"
        );
        let entries = crate::support::entries_with(key, value);
        let mut bench = Bench::ready();
        bench.configure(&entries);
        let config_hash = crate::support::hash_of(&entries);
        assert_eq!(
            bench.request(Request::Arm { config_hash }),
            expected,
            "{key:?}"
        );
    }
}

#[test]
fn d7_a_motor_that_does_not_push_against_its_closed_brake_is_named_and_no_brake_opens() {
    for (index, dead) in [
        (|i: &mut Inputs<CABLES>| i.drives[1].current_ma = 0) as fn(&mut Inputs<CABLES>),
        |i| i.drives[3].current_ma = 0,
    ]
    .into_iter()
    .enumerate()
    {
        let mut bench = Bench::ready();
        bench.tamper = dead;
        bench.arm().unwrap();
        for _ in 0..2500 {
            bench.step();
            assert!(bench.all_brakes(Brake::Closed));
        }
        let record = bench.status().fault.unwrap();
        assert_eq!(record.fault, FaultId::D7);
        assert_eq!(record.cable, [2, 4][index]);
        assert!(!bench.any_torque());
    }
}

/// A cable that carries 0.1 N, of a floor of 0.5 N.
const CUT: [fn(&mut Inputs<CABLES>); CABLES] = [
    |i| i.tension_adc[0] = adc_of(100) + i.tension_adc[0] % 7,
    |i| i.tension_adc[1] = adc_of(100) + i.tension_adc[1] % 7,
    |i| i.tension_adc[2] = adc_of(100) + i.tension_adc[2] % 7,
    |i| i.tension_adc[3] = adc_of(100) + i.tension_adc[3] % 7,
];

#[test]
fn c1_a_cable_under_its_floor_aborts_arming_although_it_is_within_what_the_host_expects() {
    for (index, cut) in CUT.into_iter().enumerate() {
        let mut bench = Bench::ready();
        bench.tamper = cut;
        // Little, but not below the floor: the band of 2 N does not show it.
        let mut tensions = [Millinewtons(TENSION_MN); CABLES];
        tensions[index] = Millinewtons(500);
        let request = Request::Reference {
            lengths: PerCable::collect([TenthMicrometres(START); CABLES]),
            tensions: PerCable::collect(tensions),
        };
        bench.request(request).unwrap();
        bench.arm().unwrap();
        for _ in 0..1500 {
            bench.step();
            assert!(bench.all_brakes(Brake::Closed), "cable {}", index + 1);
        }
        let record = bench.status().fault.unwrap();
        assert_eq!(record.fault, FaultId::C1);
        assert_eq!(usize::from(record.cable), index + 1);
        assert_eq!(bench.state(), State::Fault);
    }
}

#[test]
fn c1_a_cable_that_breaks_while_drives_and_brakes_are_tested_is_named_and_no_brake_opens() {
    let mut bench = Bench::ready();
    bench.arm().unwrap();
    let mut opens = 0;
    while bench.all_brakes(Brake::Closed) {
        bench.step();
        opens += 1;
    }
    // It is detected within five ticks.
    for at in (1..opens - 6).step_by(3) {
        let index = at as usize % CABLES;
        let mut bench = Bench::ready();
        bench.arm().unwrap();
        bench.run(at);
        bench.tamper = CUT[index];
        for tick in 0..1500 {
            bench.step();
            assert!(bench.all_brakes(Brake::Closed), "cut at {at}, tick {tick}");
        }
        let record = bench.status().fault.unwrap();
        assert_eq!(record.fault, FaultId::C1, "cut at {at}");
        assert_eq!(usize::from(record.cable), index + 1, "cut at {at}");
    }
}

#[test]
fn c1_four_ticks_below_the_floor_do_not_abort_arming() {
    let mut bench = Bench::ready();
    bench.arm().unwrap();
    while !bench.any_torque() {
        bench.step();
    }
    bench.tamper = CUT[1];
    bench.run(4);
    bench.tamper = |_| {};
    bench.until(State::Holding, 2000);
    assert_eq!(bench.fault(), None);
}

/// Brakes that never opened hold what they held: nothing has to calm down before the torque goes.
#[test]
fn a_stop_while_brakes_are_tested_takes_the_torque_off_after_a_brakes_time_and_150_ms() {
    // Drives are ready after 5 ticks, give torque for 30, and push for 200.
    for after in [20, 40, 100] {
        let mut bench = Bench::ready();
        bench.arm().unwrap();
        bench.run(after);
        assert!(bench.any_torque() && bench.all_brakes(Brake::Closed));
        bench.stop(mcdpr_protocol::StopKind::Stop);
        let most = BRAKE_MS + 150 + 5;
        for _ in 0..most {
            bench.step();
            assert!(bench.all_brakes(Brake::Closed));
        }
        assert!(!bench.any_torque(), "{after}");
        assert_eq!((bench.state(), bench.fault()), (State::Disarmed, None));
    }
}
