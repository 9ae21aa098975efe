//! K10 on a line that is full: a stop is executed within two ticks of its last byte, whatever comes
//! before and behind it, by the core in this process and by the firmware's file.

use super::{model, refusals, robot};
use mcdpr::link::{Client, SimulatedLink};
use mcdpr::machine::{self, Mismatch};
use mcdpr::motion::Model;
use mcdpr::run;
use mcdpr_firmware::State;
use mcdpr_protocol::frame::MAX_FRAME;
use mcdpr_protocol::{
    CableKnot, Channel, Command, ConfigEntry, ConfigHash, ConfigKey, Knot, List,
    MicrometresPerSecond, Millinewtons, PerCable, Reject, Reply, Request, SequenceNumber,
    SessionId, StopKind, TenthMicrometres, encode_frame,
};
use mcdpr_simulator::{LinkOptions, Simulation};
use mcdpr_tests::fuzz::mutate::Rng;

/// A byte on the line, ns: ten bits at 921600 baud.
const BYTE_NS: u64 = 10_000_000_000 / 921_600;
/// From a stop's last byte to the tick in which it acts: the rest of the tick in which it came and
/// the next tick's work.
const BOUND_US: u64 = 2000;
/// Cycles of a quarter of a tick.
const QUARTER: u64 = 18_000;

fn frame(session: u32, sequence: u16, request: Request) -> Vec<u8> {
    let command = Command {
        session: SessionId(session),
        sequence: SequenceNumber(sequence),
        request,
    };
    let mut frame = [0; MAX_FRAME];
    let used = encode_frame(Channel::Command, &command, &mut frame).unwrap();
    frame[..used].to_vec()
}

/// What fills the line.
const FLOODS: [&str; 9] = [
    "questions for the state",
    "heartbeats",
    "heartbeats of a stranger",
    "questions for what the board is",
    "knots",
    "configuration",
    "a commit that takes twenty ticks, over and over",
    "random bytes",
    "stops with a wrong checksum",
];

/// Some bytes of this flood, whole frames.
fn flood(kind: usize, rng: &mut Rng) -> Vec<u8> {
    let number = rng.word() as u16;
    match kind {
        0 => frame(1, number, Request::Status),
        1 | 2 => {
            let session = [1, rng.word() as u32][kind - 1];
            let host_time_us = rng.word() as u32;
            frame(session, number, Request::Heartbeat { host_time_us })
        }
        3 => frame(1, number, Request::Info),
        4 => {
            let cables = (0..4).map(|_| CableKnot {
                length: TenthMicrometres(rng.word() as i32),
                velocity: MicrometresPerSecond(rng.word() as i32),
                tension: Millinewtons(5000),
            });
            let knot = Knot {
                index: number,
                time_ms: 100,
                last: false,
                cables: PerCable::collect(cables),
                rows: List::new(),
            };
            frame(1, number, Request::Knot(knot))
        }
        5 => {
            let entries = (0..24).map(|index| ConfigEntry {
                key: ConfigKey(index),
                value: rng.word() as i32,
            });
            let entries = List::collect(entries);
            frame(1, number, Request::ConfigPut { entries })
        }
        6 => {
            let hash = ConfigHash(rng.word() as u32);
            frame(1, number, Request::ConfigCommit { hash })
        }
        7 => {
            let count = rng.below(60);
            [rng.bytes(count), vec![0]].concat()
        }
        _ => {
            let mut stop = frame(
                rng.word() as u32,
                number,
                Request::Stop(StopKind::Emergency),
            );
            let at = rng.below(stop.len() - 1);
            // Neither a delimiter nor what it was.
            stop[at] = if stop[at] == 0x55 { 0x56 } else { 0x55 };
            stop
        }
    }
}

/// At least so many bytes of a flood.
fn flooded(kind: usize, count: usize, rng: &mut Rng) -> Vec<u8> {
    let mut bytes = Vec::new();
    while bytes.len() < count {
        bytes.extend(flood(kind, rng));
    }
    bytes
}

/// The paper's robot at home in front of the core in this process.
fn in_process(model: &Model, seed: u64) -> SimulatedLink {
    let home = model.rest_at_home().unwrap();
    let params = machine::plant_params(model.robot(), &Mismatch::realistic(), seed);
    let (pose, tensions) = (&home.equilibrium.pose, home.tensions_n());
    let plant = machine::hang(params, pose, tensions, model.holding().by_tension(), seed).unwrap();
    let options = LinkOptions::default();
    SimulatedLink::new(Simulation::new(plant, &options, seed).unwrap())
}

fn armed(model: &Model, link: &SimulatedLink) -> Client<SimulatedLink> {
    let mut client = Client::connect(link.clone(), SessionId(1)).unwrap();
    let hash = run::configure(&mut client, model.robot()).unwrap();
    let home = model.rest_at_home().unwrap();
    client
        .request(machine::reference(&home.paid_out_m, home.tensions_n()))
        .unwrap();
    run::arm(&mut client, hash).unwrap();
    client
}

/// Sends a stop in the middle of a flood at line rate; time from its last byte to the tick in which
/// it acts, µs. `acts` says whether it does.
fn time_to_stop(
    link: &SimulatedLink,
    (kind, stop): (usize, StopKind),
    rng: &mut Rng,
    mut acts: impl FnMut(&Simulation) -> bool,
) -> Option<u64> {
    let before = 1500 + rng.below(6000);
    let mut bytes = flooded(kind, before, rng);
    let session = rng.word() as u32;
    bytes.extend(frame(session, rng.word() as u16, Request::Stop(stop)));
    let last = bytes.len() as u64;
    bytes.extend(flooded(kind, 20_000, rng));
    link.with(|simulation| {
        let latency_us = u64::from(LinkOptions::default().latency_us);
        let arrives_us = simulation.now_us() + latency_us + last * BYTE_NS / 1000;
        simulation.send(&bytes);
        let mut said = Vec::new();
        while simulation.now_us() < arrives_us + 60_000 {
            let until = simulation.now_us() + 50;
            while simulation.now_us() < until {
                said.clear();
                simulation.advance(until, &mut said).unwrap();
            }
            if acts(simulation) {
                return simulation.now_us().checked_sub(arrives_us);
            }
        }
        None
    })
}

#[test]
fn k10_a_stop_in_a_flood_at_line_rate_acts_within_two_ticks_in_the_core() {
    let model = model();
    let mut most_us = 0;
    for (kind, flood) in FLOODS.iter().enumerate() {
        for (seed, stop) in
            (1..=6).zip([StopKind::Emergency, StopKind::Stop, StopKind::Hold].repeat(2))
        {
            let link = in_process(&model, seed);
            let mut client = armed(&model, &link);
            if stop == StopKind::Hold {
                start_moving(&mut client);
            }
            let mut rng = Rng(100 * kind as u64 + seed);
            let stopped = match stop {
                StopKind::Hold => State::Pausing,
                StopKind::Stop => State::Stopping,
                StopKind::Emergency => State::Fault,
            };
            let acts = |simulation: &Simulation| simulation.state() == stopped;
            let time = time_to_stop(&link, (kind, stop), &mut rng, acts);
            let what = format!("{}, seed {seed}, {stop:?}", flood);
            let time_us = time.unwrap_or_else(|| panic!("{what}: not executed"));
            assert!(time_us <= BOUND_US, "{what}: {time_us} us");
            most_us = most_us.max(time_us);
        }
    }
    println!("core: a stop acts {most_us} us after its last byte at most");
}

#[test]
fn k10_a_stop_in_a_flood_at_line_rate_acts_within_two_ticks_on_the_chip() {
    let model = model();
    let (mut most_us, mut most_cycles) = (0, 0);
    for (kind, flood) in FLOODS.iter().enumerate() {
        for (seed, stop) in [(1, StopKind::Emergency), (2, StopKind::Stop)] {
            let (link, seen) = robot(&model);
            let chip = seen.chip();
            let client = armed(&model, &link);
            chip.with(|chip| chip.take_tick_stats());
            let mut rng = Rng(100 * kind as u64 + seed);
            let acts = |_: &Simulation| chip.with(|chip| !chip.pins().any_brake_open());
            let time = time_to_stop(&link, (kind, stop), &mut rng, acts);
            let what = format!("{}, seed {seed}, {stop:?}", flood);
            let time_us = time.unwrap_or_else(|| panic!("{what}: not executed"));
            assert!(time_us <= BOUND_US, "{what}: {time_us} us");
            let stats = chip.with(|chip| chip.tick_stats());
            println!("{what}: {time_us} us, tick {} cycles", stats.cycles_max);
            assert!(stats.cycles_max <= QUARTER, "{what}: {stats:?}");
            assert_eq!(stats.lost, 0, "{what}");
            assert_eq!(chip.with(|chip| chip.resets().len()), 0, "{what}");
            most_us = most_us.max(time_us);
            most_cycles = most_cycles.max(stats.cycles_max);
            drop(client);
        }
    }
    println!(
        "chip: a stop acts {most_us} us after its last byte at most; longest tick {most_cycles} cycles"
    );
}

/// A motion of ten seconds, all cables by 2 mm/s.
fn load_motion(client: &mut Client<SimulatedLink>) {
    let Ok(Reply::Status(status)) = client.request(Request::Status) else {
        panic!("no status")
    };
    for (index, ms) in (0_u16..).zip((0..=10_000).step_by(1000)) {
        let way = |rising: i32| -rising * i32::from(ms > 0);
        let cables = status.setpoints.iter().map(|at| CableKnot {
            length: TenthMicrometres(at.0 + way(20 * (ms - 500).max(0))),
            velocity: MicrometresPerSecond(way(2000)),
            tension: Millinewtons(5000),
        });
        let knot = Knot {
            index,
            time_ms: u32::try_from(ms).unwrap(),
            last: false,
            cables: PerCable::collect(cables),
            rows: List::new(),
        };
        client.request(Request::Knot(knot)).unwrap();
    }
}

fn start_moving(client: &mut Client<SimulatedLink>) {
    load_motion(client);
    client.request(Request::Start).unwrap();
    let until = client.now_us() + 300_000;
    client.pump(until).unwrap();
}

/// A start waits behind many questions when a stop comes that is executed before it: the start is
/// older, and moves nothing. One that is sent after the stop does.
#[test]
fn k10_a_start_that_a_stop_has_overtaken_starts_nothing() {
    let model = model();
    let mut link = in_process(&model, 1);
    let mut client = armed(&model, &link);
    load_motion(&mut client);
    let session = SessionId(1).0;
    // A number outside of the session's: the board says which it waits for.
    let answers = refusals::ask(&mut link, &frame(session, 30_000, Request::Start));
    let expected = answers.iter().find_map(|answer| match answer.result {
        Err(Reject::Sequence { expected }) => Some(expected.0),
        _ => None,
    });
    let expected = expected.expect("the number that the board waits for");
    // The client is not pumped meanwhile: these are its signs of life.
    let beat = frame(session, 7, Request::Heartbeat { host_time_us: 0 });
    let mut bytes = beat.clone();
    for _ in 0..40 {
        bytes.extend(frame(session, 7, Request::Status));
    }
    bytes.extend(frame(session, expected, Request::Start));
    bytes.extend(frame(session, 8, Request::Stop(StopKind::Hold)));
    link.with(|simulation| {
        simulation.send(&bytes);
        let mut said = Vec::new();
        let until = simulation.now_us() + 80_000;
        while simulation.now_us() < until {
            said.clear();
            simulation.advance(until, &mut said).unwrap();
            assert_eq!(simulation.state(), State::Holding);
        }
        let start = frame(session, expected + 1, Request::Start);
        simulation.send(&[beat, start].concat());
        let until = simulation.now_us() + 10_000;
        while simulation.now_us() < until {
            said.clear();
            simulation.advance(until, &mut said).unwrap();
        }
        assert_eq!(simulation.state(), State::Moving);
    });
}
