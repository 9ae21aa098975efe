//! What happens to the processor itself: a hang, a crash, a failing supply or crystal, ticks that
//! take too long, counters that wrap, a host that does not read.

use super::{line, model, robot};
use mcdpr::experiment::Experiment;
use mcdpr::link::{Link, LinkError, SimulatedLink};
use mcdpr::scenario::{FaultyLink, Injection};
use mcdpr_emulator::{Chip, SharedChip};
use mcdpr_firmware::State;
use mcdpr_protocol::{FaultId, FaultRecord, SessionId};
use mcdpr_simulator::{Simulation, TracePoint};
use mcdpr_tests::chip::path;

type Disturbance = (u64, fn(&mut Chip));

/// A line that looks every tick whether it is time to disturb the chip.
struct Disturbed {
    inner: SimulatedLink,
    chip: SharedChip,
    /// Time after the motion's start, µs, and what to do then; the earliest last.
    due: Vec<Disturbance>,
    moving_us: Option<u64>,
}

impl Link for Disturbed {
    fn now_us(&self) -> u64 {
        self.inner.now_us()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.inner.send(bytes)
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        let before = into.len();
        loop {
            let now = self.inner.now_us();
            if self.inner.with(|simulation| simulation.state()) == State::Moving {
                self.moving_us.get_or_insert(now);
            }
            if let (Some(start), Some((at, disturb))) = (self.moving_us, self.due.last())
                && now >= start + at
            {
                self.chip.with(disturb);
                self.due.pop();
            }
            let now = self.inner.receive(until_us.min(now + 1000), into)?;
            if into.len() > before || now >= until_us {
                return Ok(now);
            }
        }
    }
}

/// The effects of a disturbance at 0.5 s.
struct After {
    trace: Vec<TracePoint>,
    fault: Option<FaultRecord>,
    state: State,
    resets: usize,
}

impl After {
    /// The tool's greatest fall below its level path, m.
    fn drop_m(&self) -> f64 {
        let height = |point: &TracePoint| point.truth.tool_position_m[2];
        let lowest = self.trace.iter().map(height).fold(f64::INFINITY, f64::min);
        -0.18 - lowest
    }
}

fn disturbed(due: &[Disturbance]) -> After {
    let (goes_on, after) = run(due);
    assert!(!goes_on, "the run ended as if nothing had been");
    after
}

/// Whether the line was driven to its end, and the effects.
fn run(due: &[Disturbance]) -> (bool, After) {
    let model = model();
    let (inner, seen) = robot(&model);
    let chip = seen.chip();
    inner.with(Simulation::record_truth);
    let mut due = due.to_vec();
    due.reverse();
    let link = Disturbed {
        inner: inner.clone(),
        chip: chip.clone(),
        due,
        moving_us: None,
    };
    let outcome = Experiment::new(&model, line())
        .at_home()
        .session(SessionId(1))
        .run_on(link);
    let mut line = inner.clone();
    let until = line.now_us() + 1_500_000;
    while line.now_us() < until {
        line.receive(until, &mut Vec::new()).unwrap();
    }
    let after = After {
        trace: inner.with(Simulation::take_trace),
        fault: inner.with(|simulation| simulation.fault()),
        state: inner.with(|simulation| simulation.state()),
        resets: chip.with(|chip| chip.resets().len()),
    };
    (outcome.is_ok(), after)
}

#[test]
fn p1_p3_p4_p6_a_board_that_goes_down_in_motion_brakes_and_comes_back_in_fault() {
    let falls: fn(&mut Chip) = |chip| assert!(chip.set_supply_low(true), "it is watched");
    let recovers: fn(&mut Chip) = |chip| _ = chip.set_supply_low(false);
    let rows: [(FaultId, &[Disturbance]); 4] = [
        (FaultId::P1, &[(500_000, falls), (520_000, recovers)]),
        (FaultId::P3, &[(500_000, Chip::hang)]),
        (FaultId::P4, &[(500_000, Chip::inject_hard_fault)]),
        (
            FaultId::P6,
            &[(500_000, |chip| assert!(chip.stop_crystal()))],
        ),
    ];
    for (fault, due) in rows {
        let after = disturbed(due);
        println!(
            "{fault:?}: drop {:.2} mm, {} resets",
            after.drop_m() * 1e3,
            after.resets
        );
        assert_eq!(after.fault.map(|record| record.fault), Some(fault));
        assert_eq!(after.state, State::Fault, "{fault:?}");
        assert!(after.resets > 0);
        let closed = |point: &&TracePoint| point.truth.brakes_closed[..4] == [true; 4];
        assert!(after.trace.last().as_ref().is_some_and(closed), "{fault:?}");
        // A hang lasts as long as the watchdog, 37.5 ms; the drives go on meanwhile.
        assert!(after.drop_m() < 5e-3, "{fault:?}: {} m", after.drop_m());
    }
}

/// What the tension sensors' steps are worth is not known then, and all of them read as shorted.
#[test]
fn s8_a_supply_that_is_not_the_sensors_stops_the_robot_of_the_chip() {
    // The reference may be off by 3 %: 3.75 V and 2.85 V are wrong whatever it is.
    for volts in [3.75, 2.85] {
        let sets: fn(&mut Chip) = if volts > 3.3 {
            |chip| chip.set_supply_v(3.75)
        } else {
            |chip| chip.set_supply_v(2.85)
        };
        let after = disturbed(&[(500_000, sets)]);
        let fault = after.fault.map(|record| record.fault);
        assert_eq!(fault, Some(FaultId::S8), "{volts} V");
        assert_eq!((after.state, after.resets), (State::Fault, 0), "{volts} V");
        assert!(after.drop_m() < 5e-3, "{volts} V: {} m", after.drop_m());
    }
    // A supply within its tolerance does not stop the robot.
    let sets: fn(&mut Chip) = |chip| chip.set_supply_v(3.2);
    let (goes_on, after) = run(&[(500_000, sets)]);
    assert!(goes_on && after.fault.is_none(), "{:?}", after.fault);
}

#[test]
fn p5_two_ticks_that_are_late_in_a_row_stop_the_robot_of_the_chip() {
    let after = disturbed(&[
        // A tick takes some 0.1 ms; forty times that is late. The watchdog waits for 25 ms or more.
        (500_000, |chip| chip.slow_down(40)),
        (512_000, |chip| chip.slow_down(1)),
    ]);
    assert_eq!(after.fault.map(|record| record.fault), Some(FaultId::P5));
    assert_eq!((after.state, after.resets), (State::Fault, 0));
    assert!(after.drop_m() < 1e-3, "{} m", after.drop_m());
}

#[test]
fn l16_a_host_that_does_not_read_costs_the_chip_no_tick() {
    let model = model();
    let (inner, seen) = robot(&model);
    let chip = seen.chip();
    let deaf = Injection::parse("L16@0.5s", 4).unwrap();
    let link = FaultyLink::new(inner.clone(), &[deaf]);
    let outcome = Experiment::new(&model, line())
        .at_home()
        .session(SessionId(1))
        .run_on(link.clone());
    assert!(outcome.is_err());
    link.settle(4_000_000).unwrap();
    let stats = chip.with(|chip| chip.tick_stats());
    assert_eq!((stats.lost, chip.with(|chip| chip.resets().len())), (0, 0));
    // 2 us at 72 MHz, as ever.
    assert!(stats.latency_max <= 144, "{} cycles", stats.latency_max);
    assert_eq!(inner.with(|simulation| simulation.state()), State::Fault);
}

/// Address of the firmware's tick counter.
fn tick_counter() -> u32 {
    use object::{Object, ObjectSymbol};
    let bytes = std::fs::read(path()).unwrap();
    let file = object::File::parse(&*bytes).unwrap();
    let mut found = file.symbols().filter(|symbol| {
        let name = symbol.name().unwrap_or_default();
        name.contains("5clock3NOW")
    });
    let symbol = found.next().expect("the tick counter has a symbol");
    u32::try_from(symbol.address()).unwrap()
}

#[test]
fn k9_the_chip_moves_on_through_the_wrap_of_its_tick_counter() {
    let model = model();
    let (inner, seen) = robot(&model);
    let chip = seen.chip();
    let at = tick_counter();
    // Arming takes two seconds, the line three.
    let near = u32::MAX - 3500;
    let mut link = inner.clone();
    link.receive(30_000, &mut Vec::new()).unwrap();
    assert!(chip.with(|chip| chip.write_ram(at, near)));
    let run = Experiment::new(&model, line())
        .at_home()
        .session(SessionId(1))
        .run_on(inner.clone());
    let run = run.unwrap();
    let (first, last) = (run.samples.first().unwrap(), run.samples.last().unwrap());
    println!("ticks {} to {}", first.tick, last.tick);
    assert!(last.tick < first.tick, "the counter did not wrap in motion");
    assert_eq!(inner.with(|simulation| simulation.fault()), None);
    assert_eq!(chip.with(|chip| chip.resets().len()), 0);
}
