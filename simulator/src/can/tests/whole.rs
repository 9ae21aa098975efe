//! The firmware's `DriveBus` and the simulated drives, over the simulated wires.

use super::{BusState, DriveLine, DriveState, Mode, Plant, PlantParams, Protocol};
use crate::can::ObjectAddress;
use mcdpr_firmware::config::{Active, ConfigStore, TensionOutput};
use mcdpr_firmware::drives::DriveBus;
use mcdpr_firmware::drives::last::LastDrives;
use mcdpr_firmware::{DriveDemand, Inputs, Outputs};
use mcdpr_protocol::config::config_hash;
use mcdpr_protocol::{BoardKey, CableKey, ConfigEntry, ConfigKey, Tick};

/// Four winches with loose cables, their bus, and the board's end of it.
struct Bench {
    plant: Plant,
    line: DriveLine,
    bus: DriveBus<4>,
    active: Active<4>,
    inputs: Inputs<4>,
    tick: u32,
}

fn value(key: CableKey) -> i32 {
    match key {
        CableKey::DrumRadius => 200_000,
        CableKey::EncoderCountsPerTurn => 4096,
        CableKey::EncoderSign => 1,
        CableKey::MotorCountsPerTurn => 1_520_148,
        CableKey::MotorCountsPerRev => 4096,
        CableKey::ReelSpeed => 10_000,
        CableKey::MaxMotorRpm => 8000,
        CableKey::MaxCurrentMa => 1000,
        CableKey::ForcePerCurrent => -185_000,
        CableKey::TensionGain => 12_770,
        CableKey::TensionMax => 39_130,
        CableKey::TensionCeiling => 34_000,
        CableKey::TensionFilterMhz => 30_000,
        CableKey::BrakeCloseMs => 30,
        CableKey::FollowingError => 1000,
        CableKey::MaxSpeed => 50_000,
        CableKey::MaxAcceleration | CableKey::MaxJerk => 10_000_000,
        CableKey::LengthMax => 20_000_000,
        _ => 0,
    }
}

fn configuration(kind: i32, bitrate: i32, period_us: i32) -> Result<Active<4>, String> {
    let mut entries = Vec::new();
    for key in BoardKey::ALL {
        let value = match key {
            BoardKey::Cables => 4,
            BoardKey::DriveKind => kind,
            BoardKey::BusBitrate => bitrate,
            BoardKey::BusPeriodUs | BoardKey::TensionPeriodUs => period_us,
            BoardKey::StopMs => 300,
            BoardKey::ResidualMs => 100,
            BoardKey::EnableMs => 1100,
            BoardKey::FeedbackTimeoutMs => 10,
            BoardKey::HoldBrakes | BoardKey::FaultLine => 0,
        };
        entries.push(ConfigEntry {
            key: ConfigKey::board(*key),
            value,
        });
    }
    for index in 0..4_u8 {
        for key in CableKey::ALL {
            let value = match key {
                CableKey::Control => i32::from(index == 3),
                CableKey::Node => i32::from(index) + 1,
                key => value(*key),
            };
            entries.push(ConfigEntry {
                key: ConfigKey::cable(index, *key),
                value,
            });
        }
    }
    let mut store = ConfigStore::<4>::default();
    let mut active = None;
    store
        .begin(entries.len() as u16)
        .map_err(|e| format!("{e:?}"))?;
    store.put(&entries).map_err(|e| format!("{e:?}"))?;
    store
        .build_into(config_hash(entries.iter().copied()), &mut active)
        .map_err(|e| format!("{e:?}"))?;
    active.ok_or_else(|| "nothing".into())
}

impl Bench {
    fn new(protocol: Protocol) -> Self {
        let mut params = PlantParams::paper_optimistic();
        for winch in &mut params.winches {
            winch.drive.protocol = protocol;
            if protocol == Protocol::Cia402 {
                winch.drive.mode_time_s = 0.02;
            }
        }
        let plant = Plant::new(params, 1).expect("good parameters");
        let kind = if protocol == Protocol::Rmds { 1 } else { 2 };
        Self {
            line: DriveLine::new(&plant),
            plant,
            bus: DriveBus::default(),
            active: configuration(kind, 1_000_000, 2000).expect("good configuration"),
            inputs: Inputs::default(),
            tick: 0,
        }
    }

    fn tick(&mut self, demands: [DriveDemand; 4]) {
        self.tick += 1;
        self.line
            .advance(&mut self.plant, u64::from(self.tick) * 1000)
            .expect("no failure");
        self.inputs = Inputs::default();
        self.bus.listen(&mut self.line.port());
        self.bus.fill(&mut self.inputs);
        let outputs = Outputs {
            drives: demands,
            ..Outputs::default()
        };
        let now = Tick(self.tick);
        self.bus
            .tick(now, Some(&self.active), &outputs, &mut self.line.port());
    }

    fn run(&mut self, ticks: u32, demands: [DriveDemand; 4]) {
        for _ in 0..ticks {
            self.tick(demands);
        }
    }

    fn ready(&self) -> [bool; 4] {
        self.inputs.drives.map(|drive| drive.ready)
    }
}

const ENABLE: [DriveDemand; 4] = [
    DriveDemand::EnablePosition,
    DriveDemand::EnablePosition,
    DriveDemand::EnablePosition,
    DriveDemand::EnableCurrent,
];
const OFF: [DriveDemand; 4] = [DriveDemand::Off; 4];
const BOTH: [Protocol; 2] = [Protocol::Rmds, Protocol::Cia402];

fn enabled(protocol: Protocol) -> Bench {
    let mut bench = Bench::new(protocol);
    bench.run(1200, OFF);
    bench.run(700, ENABLE);
    assert_eq!(bench.ready(), [true; 4], "{protocol:?}");
    bench
}

fn hold(bench: &Bench) -> [DriveDemand; 4] {
    let mut demands = ENABLE;
    for (demand, drive) in demands.iter_mut().zip(&bench.inputs.drives).take(3) {
        *demand = DriveDemand::Position {
            counts: drive.counts,
            rpm: 8000,
        };
    }
    demands[3] = DriveDemand::Current { ma: -100 };
    demands
}

#[test]
fn drives_of_both_kinds_come_up_and_obey() {
    for protocol in BOTH {
        let mut bench = enabled(protocol);
        for cable in 0..4 {
            let mode = if cable == 3 {
                Mode::Current
            } else {
                Mode::Position
            };
            let state = bench.plant.drive_state(cable).expect("cable");
            assert_eq!(state, DriveState::Ready(mode), "{protocol:?}");
            bench.plant.set_brake(cable, false).expect("cable");
        }
        let mut demands = hold(&bench);
        let start = bench.inputs.drives[0].counts;
        // 100,000 counts at 8000 rpm (546 counts a millisecond): 183 ms and the ends.
        demands[0] = DriveDemand::Position {
            counts: start + 100_000,
            rpm: 8000,
        };
        bench.run(400, demands);
        let drives = bench.inputs.drives;
        assert!(
            (drives[0].counts - start - 100_000).abs() < 50,
            "{protocol:?} {drives:?}"
        );
        // CiA 402 reports it in thousandths of 667 mA, rounded towards zero twice.
        assert!((drives[3].current_ma + 100).abs() <= 2, "{protocol:?}");
        assert!(drives[3].rpm < -10, "{protocol:?}: it hauls in");
        assert!(drives.iter().all(|drive| drive.age_ms <= 2), "{drives:?}");
    }
}

#[test]
fn the_commanded_speed_is_the_speed() {
    for protocol in BOTH {
        let mut bench = enabled(protocol);
        bench.plant.set_brake(0, false).expect("cable");
        let mut demands = hold(&bench);
        let mut at = bench.inputs.drives[0].counts;
        let mut sum = 0;
        for tick in 0..300 {
            // 2000 rpm of 4096 counts: 136.5 counts a millisecond.
            at += 136;
            demands[0] = DriveDemand::Position {
                counts: at,
                rpm: 8000,
            };
            bench.tick(demands);
            if tick >= 200 {
                sum += i32::from(bench.inputs.drives[0].rpm);
            }
        }
        // 136 * 60,000 / 4096 = 1992. An RMDS executes the steps of 2 ms as they come: its speed
        // ripples, and is always reported at the same phase of the ripple.
        let most = if protocol == Protocol::Rmds { 250 } else { 20 };
        assert!((sum / 100 - 1992).abs() < most, "{protocol:?}: {sum}");
    }
}

#[test]
fn the_bus_is_as_full_as_the_schedule_says() {
    use mcdpr_firmware::config::DriveKind;
    use mcdpr_firmware::config::schedule::load_permille;
    for (protocol, kind) in [
        (Protocol::Rmds, DriveKind::Rmds),
        (Protocol::Cia402, DriveKind::Cia402),
    ] {
        let mut bench = enabled(protocol);
        let demands = hold(&bench);
        let before = bench.line.bus().counters();
        bench.run(1000, demands);
        let after = bench.line.bus().counters();
        let busy = (after.busy_us - before.busy_us) / 1000;
        let cycle = [(2000, false), (2000, false), (2000, false), (2000, true)];
        let worst = u64::from(load_permille(kind, 1_000_000, cycle));
        assert!(busy <= worst && busy * 10 > worst * 8, "{busy} of {worst}");
        assert_eq!(after.destroyed, 0);
    }
}

#[test]
fn power_that_goes_and_comes_back_gives_no_torque_until_it_is_asked_for_again() {
    for protocol in BOTH {
        let mut bench = enabled(protocol);
        let demands = hold(&bench);
        bench.run(20, demands);
        bench.plant.set_power(false);
        bench.run(50, demands);
        assert!(bench.inputs.drives.iter().all(|drive| drive.age_ms > 40));
        bench.plant.set_power(true);
        bench.run(2000, demands);
        for cable in 0..4 {
            let state = bench.plant.drive_state(cable).expect("cable");
            assert!(!matches!(state, DriveState::Ready(_)), "{protocol:?}");
        }
        bench.run(1200, OFF);
        assert!(bench.inputs.drives.iter().all(|drive| drive.age_ms < 10));
        bench.run(700, ENABLE);
        assert_eq!(bench.ready(), [true; 4], "{protocol:?}");
    }
}

/// The drives' contactor closes after the board has its configuration. Until then nobody acknowledges, and
/// the board drops what it cannot send.
#[test]
fn drives_whose_contactor_closes_late_are_ready_in_time() {
    for protocol in BOTH {
        for closed_after in [0, 9, 30] {
            let mut bench = Bench::new(protocol);
            for cable in 0..4 {
                bench.plant.set_drive_enable(cable, false).expect("cable");
            }
            bench.run(closed_after, ENABLE);
            for cable in 0..4 {
                bench.plant.set_drive_enable(cable, true).expect("cable");
            }
            let most = bench.active.enable_ms + 500 - closed_after;
            bench.run(most, ENABLE);
            assert_eq!(
                bench.ready(),
                [true; 4],
                "{protocol:?}, {closed_after} ms and the contactor's 63"
            );
        }
    }
}

#[test]
fn a_wrong_number_leaves_one_drive_silent_and_the_others_well() {
    for protocol in BOTH {
        let mut bench = Bench::new(protocol);
        bench.line.nodes_mut().fault_mut(1).expect("drive").node = Some(9);
        bench.run(1200, OFF);
        bench.run(700, ENABLE);
        assert_eq!(bench.ready(), [true, false, true, true], "{protocol:?}");
        assert!(bench.inputs.drives[1].age_ms > 1000);
    }
}

#[test]
fn a_wrong_mode_is_noticed_before_and_after_arming() {
    let mut bench = Bench::new(Protocol::Cia402);
    bench.line.nodes_mut().fault_mut(2).expect("drive").mode = Some(1);
    bench.run(1200, OFF);
    bench.run(700, ENABLE);
    assert_eq!(bench.ready(), [true, true, false, true]);
    let mut bench = enabled(Protocol::Cia402);
    bench.line.nodes_mut().fault_mut(2).expect("drive").mode = Some(1);
    let demands = hold(&bench);
    bench.run(30, demands);
    assert!(bench.inputs.drives[2].fault);
}

#[test]
fn faults_heat_and_missing_heartbeats_are_reported() {
    let mut bench = enabled(Protocol::Cia402);
    let demands = hold(&bench);
    // Over-current.
    bench.line.nodes_mut().fault_mut(0).expect("drive").fault = Some(0x2310);
    bench.line.nodes_mut().fault_mut(1).expect("drive").hot = true;
    let silent = bench.line.nodes_mut().fault_mut(2).expect("drive");
    silent.no_heartbeat = true;
    bench.run(4, demands);
    assert!(bench.inputs.drives[0].fault, "within two periods");
    assert!(bench.inputs.drives[1].over_temperature && bench.inputs.drives[1].warning);
    bench.run(420, demands);
    assert!(bench.inputs.drives[2].age_ms > 300);
    assert!(!bench.inputs.drives[3].fault && bench.inputs.drives[3].age_ms < 5);
    // After the repair, arming alone brings it back.
    *bench.line.nodes_mut().fault_mut(0).expect("drive") = Default::default();
    bench.run(200, demands);
    assert!(!bench.ready()[0]);
    bench.run(50, OFF);
    bench.run(300, ENABLE);
    assert!(bench.ready()[0]);
}

#[test]
fn a_drive_whose_board_died_gives_no_torque() {
    let mut bench = enabled(Protocol::Cia402);
    let demands = hold(&bench);
    bench.run(20, demands);
    // The board's program has stopped: it sends nothing any more.
    let end = u64::from(bench.tick) * 1000 + 300_000;
    bench
        .line
        .advance(&mut bench.plant, end)
        .expect("no failure");
    for cable in 0..4 {
        assert_eq!(bench.plant.drive_state(cable), Ok(DriveState::Idle));
    }
}

#[test]
fn a_drive_without_an_abort_connection_option_goes_on_when_its_board_died() {
    let mut bench = Bench::new(Protocol::Cia402);
    bench.line.nodes_mut().fault_mut(1).expect("drive").lacks = Some(object(0x6007));
    bench.run(1200, OFF);
    bench.run(700, ENABLE);
    assert_eq!(bench.ready(), [true; 4], "the object is optional");
    let demands = hold(&bench);
    bench.run(20, demands);
    let end = u64::from(bench.tick) * 1000 + 300_000;
    let done = bench.line.advance(&mut bench.plant, end);
    done.expect("no failure");
    assert_eq!(bench.plant.drive_state(0), Ok(DriveState::Idle));
    assert_ne!(bench.plant.drive_state(1), Ok(DriveState::Idle));
}

#[test]
fn the_drives_of_before_a_reset_of_the_board_lose_their_torque() {
    for protocol in BOTH {
        let mut bench = enabled(protocol);
        let demands = hold(&bench);
        bench.run(20, demands);
        let last = LastDrives::of(&bench.active);
        // The board was reset: only this is left.
        bench.bus = DriveBus::default();
        bench.bus.stop_at_start(&last, &mut bench.line.port());
        for _ in 0..40 {
            bench.tick += 1;
            let until = u64::from(bench.tick) * 1000;
            let done = bench.line.advance(&mut bench.plant, until);
            done.expect("no failure");
            bench.bus.listen(&mut bench.line.port());
            let now = Tick(bench.tick);
            let outputs = Outputs::default();
            bench.bus.tick(now, None, &outputs, &mut bench.line.port());
        }
        for cable in 0..4 {
            let state = bench.plant.drive_state(cable);
            assert!(
                !matches!(state, Ok(DriveState::Ready(_))),
                "{protocol:?}: {state:?}"
            );
        }
    }
}

#[test]
fn a_drive_that_boots_late_comes_up_and_one_without_its_mode_says_which_object() {
    let mut bench = Bench::new(Protocol::Cia402);
    bench
        .line
        .nodes_mut()
        .fault_mut(0)
        .expect("drive")
        .boots_late_ms = 700;
    bench.line.nodes_mut().fault_mut(2).expect("drive").lacks = Some(object(0x6060));
    bench.run(3000, OFF);
    bench.run(700, ENABLE);
    assert_eq!(bench.ready(), [true, true, false, true]);
    let refused = bench.inputs.drives[2].refused.expect("a refusal");
    assert_eq!((refused.object, refused.code), (0x0060_6000, 0x0602_0000));
}

#[test]
fn a_short_is_a_bus_that_is_off_and_drives_come_back_after_it() {
    for protocol in BOTH {
        let mut bench = enabled(protocol);
        let demands = hold(&bench);
        bench.plant.faults_mut().bus_off = true;
        let mut ticks = 0;
        while !bench.inputs.drives[0].bus_off {
            bench.tick(demands);
            ticks += 1;
            assert!(ticks <= 5, "D1 has five milliseconds");
        }
        bench.plant.faults_mut().bus_off = false;
        bench.run(5000, OFF);
        assert_eq!(bench.line.bus().state(0), BusState::Active);
        bench.run(800, ENABLE);
        assert_eq!(bench.ready(), [true; 4], "{protocol:?}");
    }
}

#[test]
fn frames_that_are_destroyed_or_lost_now_and_then_change_nothing() {
    for protocol in BOTH {
        let mut bench = enabled(protocol);
        let demands = hold(&bench);
        for round in 0..200 {
            let faults = bench.line.bus_mut().faults_mut();
            if round % 2 == 0 {
                faults.corrupt = 1;
            } else {
                faults.drop = 1;
            }
            bench.run(10, demands);
            let drives = &bench.inputs.drives;
            assert!(drives.iter().all(|drive| drive.ready && !drive.bus_off));
            assert!(drives.iter().all(|drive| drive.age_ms < 8), "{drives:?}");
        }
    }
}

#[test]
fn a_schedule_over_seventy_percent_is_refused_by_the_board() {
    for (kind, bitrate, period_us, good) in [
        (1, 1_000_000, 2000, true),
        (1, 1_000_000, 1000, false),
        (1, 500_000, 4000, true),
        (1, 500_000, 2000, false),
        (2, 1_000_000, 2000, true),
        (2, 500_000, 2000, false),
        (2, 500_000, 4000, true),
    ] {
        let built = configuration(kind, bitrate, period_us);
        assert_eq!(built.is_ok(), good, "{kind} {bitrate} {period_us}");
        if let Err(refusal) = built {
            assert!(refusal.contains("ConfigValue { key: 4 }"), "{refusal}");
        }
    }
}

#[test]
fn drives_of_both_kinds_turn_at_the_speed_that_is_commanded() {
    let enable = [ENABLE[0], ENABLE[1], ENABLE[2], DriveDemand::EnableSpeed];
    for protocol in BOTH {
        let mut bench = Bench::new(protocol);
        bench.active.cables[3].output = TensionOutput::Speed;
        bench.run(1200, OFF);
        bench.run(700, enable);
        assert_eq!(bench.ready(), [true; 4], "{protocol:?}");
        let state = bench.plant.drive_state(3).expect("cable");
        assert_eq!(state, DriveState::Ready(Mode::Velocity), "{protocol:?}");
        bench.plant.set_brake(3, false).expect("cable");
        let mut demands = hold(&bench);
        demands[3] = DriveDemand::Speed { rpm: -400 };
        let before = bench.inputs.drives[3].counts;
        bench.run(500, demands);
        // 400 rpm of 4096 counts for half a second are 13,650. The platform swings while its cable
        // is hauled in, and the load changes by 4 N five times a second: the speed loop gives way
        // by up to a quarter.
        let way = before - bench.inputs.drives[3].counts;
        assert!((10_000..14_500).contains(&way), "{protocol:?} {way}");
        demands[3] = DriveDemand::Speed { rpm: 0 };
        bench.run(300, demands);
        let rest = bench.inputs.drives[3];
        assert!(rest.rpm.abs() <= 150, "{protocol:?} {rest:?}");
    }
}

/// The address of an object without sub-indices.
const fn object(index: u16) -> ObjectAddress {
    ObjectAddress { index, sub: 0 }
}
