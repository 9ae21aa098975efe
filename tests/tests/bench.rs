//! `mcdpr bench`: the firmware's own file on the emulated chip passes, and fails for each fault of a
//! board; a port without a suitable board is refused before anything is tried.

use mcdpr::bench::{BenchError, Report, examine};
use mcdpr::control::Handle;
use mcdpr::doctor::Verdict;
use mcdpr::experiment::SimulatedRobot;
use mcdpr::flash::{self, FlashError};
use mcdpr::link::{Client, Link, LinkError, SimulatedLink};
use mcdpr::machine::{self, Mismatch};
use mcdpr::motion::Model;
use mcdpr::robot::Robot;
use mcdpr::run::{Homing, NoStore, Session};
use mcdpr_emulator::{Chip, Identity, Jumpers, SharedChip};
use mcdpr_protocol::frame::{MAX_FRAME, encode_frame};
use mcdpr_protocol::{Channel, Command, Request, SequenceNumber, SessionId};
use mcdpr_simulator::{LinkOptions, Simulation};
use mcdpr_tests::chip::firmware;

/// A chip, prepared before it runs, in front of the paper's robot; the board has no configuration.
fn board(prepare: impl FnOnce(&mut Chip)) -> (SimulatedLink, SharedChip) {
    let model = Model::new(&Robot::built_in("paper-table5").unwrap()).unwrap();
    let home = model.rest_at_home().unwrap();
    let params = machine::plant_params(model.robot(), &Mismatch::realistic(), 3);
    let (pose, tensions) = (&home.equilibrium.pose, home.tensions_n());
    let plant = machine::hang(params, pose, tensions, model.holding().by_tension(), 3).unwrap();
    let board = firmware().board().unwrap();
    let chip = board.chip();
    chip.with(prepare);
    let simulation = Simulation::with_board(plant, Box::new(board), &LinkOptions::default(), 3);
    (SimulatedLink::new(simulation), chip)
}

fn test(prepare: impl FnOnce(&mut Chip)) -> Result<Report, BenchError> {
    let (link, _chip) = board(prepare);
    let mut client = Client::connect(link, SessionId(7)).unwrap();
    examine(&mut client, None, false, &mut |_| false)
}

/// Parts that must be mended.
fn bad(report: &Report) -> Vec<&'static str> {
    let findings = report.findings.iter();
    let bad = findings.filter(|finding| finding.verdict == Verdict::Bad);
    let mut parts: Vec<_> = bad.map(|finding| finding.part).collect();
    parts.dedup();
    parts
}

#[test]
fn a_good_board_passes_with_every_output_tried() {
    let (link, chip) = board(|_| {});
    let mut client = Client::connect(link, SessionId(7)).unwrap();
    let mut asked = Vec::new();
    let report = examine(&mut client, None, false, &mut |name| {
        asked.push(name.to_owned());
        true
    })
    .unwrap();
    assert!(report.passes(), "{:#?}", report.findings);
    assert_eq!(asked.len(), 6);
    assert_eq!(report.channels.len(), 4);
    for channel in &report.channels {
        assert!(channel.sigma_v > 0.0 && channel.histogram.iter().sum::<usize>() == 100);
    }
    println!(
        "tick {} cycles, stack {} bytes free, {} mV, slow clock {} Hz",
        report.tick_cycles, report.stack_free_bytes, report.supply_mv, report.slow_hz
    );
    assert!(
        (39_000..=41_000).contains(&report.slow_hz),
        "{}",
        report.slow_hz
    );
    assert!(
        (3290..=3310).contains(&report.supply_mv),
        "{}",
        report.supply_mv
    );
    assert!(report.tick_cycles > 1000 && report.stack_free_bytes > 1000);
    assert!(
        chip.with(|chip| chip.brakes_ever_opened()),
        "brakes were tried"
    );
}

#[test]
fn each_fault_of_a_board_fails_it_and_is_named() {
    let clone = Identity {
        id_code: 0x1303_0410,
        ..Identity::default()
    };
    let maker = Identity {
        maker: 0x51,
        ..Identity::default()
    };
    let small = Identity {
        flash_kib: 32,
        ..Identity::default()
    };
    type Fault = Box<dyn FnOnce(&mut Chip)>;
    let faults: Vec<(&str, &str, Fault)> = vec![
        (
            "a clone's revision",
            "chip",
            Box::new(move |chip| chip.set_identity(clone)),
        ),
        (
            "a clone's maker",
            "chip",
            Box::new(move |chip| chip.set_identity(maker)),
        ),
        (
            "half the flash",
            "chip",
            Box::new(move |chip| chip.set_identity(small)),
        ),
        (
            "no crystal",
            "crystal",
            Box::new(|chip| chip.set_crystal(false)),
        ),
        ("3.05 V", "supply", Box::new(|chip| chip.set_supply_v(3.05))),
        ("3.55 V", "supply", Box::new(|chip| chip.set_supply_v(3.55))),
        (
            "a slow clock of 20 kHz",
            "slow clock",
            Box::new(|chip| chip.set_slow_oscillator(20_000)),
        ),
        (
            "a broken CAN controller",
            "CAN",
            Box::new(|chip| chip.break_can(true)),
        ),
    ];
    for (name, part, fault) in faults {
        let report = test(fault).unwrap();
        let bad = bad(&report);
        assert!(bad.contains(&part) && !report.passes(), "{name}: {bad:?}");
    }
}

/// The self-test with jumper wires, every output confirmed: what is bad about them.
fn with_jumpers(wires: Jumpers) -> Vec<String> {
    let (link, _chip) = board(|chip| chip.set_jumpers(wires));
    let mut client = Client::connect(link, SessionId(7)).unwrap();
    let report = examine(&mut client, None, true, &mut |_| true).unwrap();
    let findings = report.findings.into_iter();
    let bad = findings.filter(|finding| finding.verdict == Verdict::Bad);
    bad.map(|finding| format!("{}: {}", finding.part, finding.found))
        .collect()
}

#[test]
fn jumper_wires_from_outputs_to_inputs_prove_each_of_them() {
    let complete = Jumpers::COMPLETE;
    assert_eq!(with_jumpers(complete), Vec::<String>::new());
    let mut open_a = complete;
    open_a.a[1] = None;
    let mut crossed = complete;
    crossed.a.swap(2, 3);
    let mut exchanged = complete;
    (exchanged.a[0], exchanged.b[0]) = (exchanged.b[0], exchanged.a[0]);
    let mut open_tension = complete;
    open_tension.tension[3] = Some(2);
    for (wires, names) in [
        (open_a, "encoder 2"),
        (crossed, "encoder 3"),
        (exchanged, "encoder 1"),
        (open_tension, "tension input 4"),
    ] {
        let bad = with_jumpers(wires);
        let found = bad.iter().any(|found| found.contains(names));
        assert!(found, "{names}: {bad:?}");
    }
}

#[test]
fn an_unknown_chip_another_firmware_and_a_board_without_a_chip_are_refused() {
    let unknown = Identity {
        id_code: 0x2003_6414,
        ..Identity::default()
    };
    let refused = test(|chip| chip.set_identity(unknown));
    assert!(matches!(refused, Err(BenchError::UnknownChip { .. })));

    let (link, chip) = board(|_| {});
    let mut client = Client::connect(link, SessionId(7)).unwrap();
    let refused = examine(&mut client, Some("00000000"), false, &mut |_| true);
    assert!(matches!(refused, Err(BenchError::OtherFirmware { .. })));
    assert!(!chip.with(|chip| chip.brakes_ever_opened()));

    let model = Model::new(&Robot::built_in("paper-table5").unwrap()).unwrap();
    let line = LinkOptions::default();
    let link = SimulatedRobot::new(Mismatch::realistic(), 1)
        .line(line)
        .at_home(&model)
        .unwrap();
    let mut client = Client::connect(link, SessionId(7)).unwrap();
    let refused = examine(&mut client, None, false, &mut |_| true);
    assert!(matches!(refused, Err(BenchError::NoChip)));
}

/// A line on which the program that holds the board (session 6) is heard, too.
struct Beating(SimulatedLink, u64);

impl Link for Beating {
    fn now_us(&self) -> u64 {
        self.0.now_us()
    }
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.0.send(bytes)
    }
    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        loop {
            if self.now_us() >= self.1 {
                let beat = Command {
                    session: SessionId(6),
                    sequence: SequenceNumber(30_000),
                    request: Request::Heartbeat { host_time_us: 0 },
                };
                let mut frame = [0; MAX_FRAME];
                let used = encode_frame(Channel::Command, &beat, &mut frame).unwrap();
                self.0.send(&frame[..used])?;
                self.1 = self.now_us() + 20_000;
            }
            let next_us = until_us.min(self.now_us() + 20_000);
            let now_us = self.0.receive(next_us, into)?;
            if now_us >= until_us {
                return Ok(now_us);
            }
        }
    }
}

#[test]
fn an_armed_board_is_neither_tested_nor_flashed() {
    let model = Model::new(&Robot::built_in("paper-table5").unwrap()).unwrap();
    let line = LinkOptions::default();
    let link = SimulatedRobot::new(Mismatch::realistic(), 1)
        .line(line)
        .at_home(&model)
        .unwrap();
    // Disarmed, and given back: it may be written.
    assert!(matches!(
        flash::ask_before(link.clone(), SessionId(5)),
        Ok(None)
    ));
    let handle = Handle::new();
    let homing = Homing::Place(model.robot().tool.home_in_world_m);
    let mut session = Session::open(
        &model,
        Box::new(link.clone()),
        SessionId(6),
        &handle,
        homing,
        &NoStore,
    )
    .unwrap();
    session.arm().unwrap();
    let refused = flash::ask_before(Beating(link, 0), SessionId(7));
    assert!(matches!(refused, Err(FlashError::Armed)), "{refused:?}");
    // Its own program was not heard for seconds: it may have been given up.
    let _ = session.disarm();
}
