//! A chip whose supply follows a course, and drives that let it open its brakes.

use super::{Bench, SLICE_US};
use mcdpr_emulator::{CanFrame, CanWiring, Chip, Drive, ResetBy, Stop, SupplyLimits};
use mcdpr_protocol::{ConfigHash, Reply, Request, Status};

/// Chips with the thresholds at the ends and in the middle of the data sheet's tolerance.
pub const CHIPS: [(&str, SupplyLimits); 3] = [
    ("lowest", SupplyLimits::LOWEST),
    ("typical", SupplyLimits::TYPICAL),
    ("highest", SupplyLimits::HIGHEST),
];
/// The board's supply, V.
pub const GOOD_V: f64 = 3.3;

/// Runs; a chip that resets itself is restarted.
pub fn run(chip: &mut Chip, us: u64) {
    let mut ran = chip.run_us(us);
    while let Err(stop) = ran {
        let Stop::Reset { by, .. } = stop else {
            panic!("at {} us: {stop}", chip.now_us())
        };
        chip.restart(by);
        // The rest of the slice.
        ran = chip.run_us(0);
    }
}

/// Runs while the supply is `volts` of the seconds since now, in steps of `step_us`.
pub fn follow(chip: &mut Chip, seconds: f64, step_us: u64, volts: impl Fn(f64) -> f64) {
    let steps = (seconds * 1e6 / step_us as f64).round() as u64;
    for step in 1..=steps {
        chip.set_supply_v(volts((step * step_us) as f64 * 1e-6));
        run(chip, step_us);
    }
}

/// The resets of a kind.
pub fn resets(chip: &Chip, kind: ResetBy) -> usize {
    chip.resets().iter().filter(|by| **by == kind).count()
}

/// Four drives whose drums stand: a position-held one pushes the harder, the farther its command is away.
#[derive(Clone, Default)]
pub struct Drives {
    ma: [i16; 4],
    slice: u64,
}

impl Drives {
    /// One slice of a chip with its drives, at a supply that was set before.
    pub fn step(&mut self, chip: &mut Chip, us: u64) {
        for sent in chip.can_take() {
            let [_, _, c, d, e, f, g, h] = sent.frame.data;
            let node = sent.frame.id as usize >> 4;
            let Some(ma) = self.ma.get_mut(node.wrapping_sub(1)) else {
                continue;
            };
            // RMDS: 0 resets, 3 commands a current, 6 a position; 0.2 mA per count hold it.
            *ma = match sent.frame.id & 0xF {
                0 => 0,
                3 => i16::from_be_bytes([c, d]),
                6 => (i32::from_be_bytes([e, f, g, h]) / 5).clamp(-3000, 3000) as i16,
                _ => *ma,
            };
        }
        // Each drive reports every 2 ms.
        let before = chip.now_us() / 500;
        if before != self.slice {
            self.slice = before;
            let node = (before % 4) as u16;
            let [high, low] = self.ma[usize::from(node)].to_be_bytes();
            let feedback = [high, low, 0, 0, 0, 0, 0, 0];
            let frame = CanFrame::standard((node + 1) << 4 | 0xB, &feedback);
            chip.can_send(chip.now_us(), frame);
        }
        run(chip, us);
    }
}

/// A board with its four drives.
pub struct Winches {
    pub bench: Bench,
    pub drives: Drives,
    pub config_hash: ConfigHash,
}

impl Winches {
    /// Configured and referenced, at a good supply; its drives answer.
    pub fn new(limits: SupplyLimits) -> Self {
        let mut bench = Bench::on(|chip| chip.set_supply_limits(limits));
        bench.chip.set_can_wiring(CanWiring {
            bitrate: 1_000_000,
            others: true,
            shorted: false,
        });
        let config_hash = bench.prepare();
        let drives = Drives::default();
        let mut winches = Self {
            bench,
            drives,
            config_hash,
        };
        // An RMDS is silent for half a second after its reset.
        winches.run_ms(700);
        winches
    }

    pub fn fork(&self) -> Self {
        Self {
            bench: self.bench.fork(),
            drives: self.drives.clone(),
            config_hash: self.config_hash,
        }
    }

    pub fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms * 1000 / SLICE_US {
            self.drives.step(&mut self.bench.chip, SLICE_US);
        }
    }

    /// The state, while the drives go on and the host is alive.
    pub fn status(&mut self) -> Status {
        self.bench.sort();
        self.bench.answers.clear();
        self.bench.tell(Request::Heartbeat { host_time_us: 0 });
        self.run_ms(10);
        self.bench.tell(Request::Status);
        self.run_ms(10);
        self.bench.sort();
        match self
            .bench
            .answers
            .last()
            .map(|answer| answer.result.clone())
        {
            Some(Ok(Reply::Status(status))) => status,
            other => panic!("{other:?} is not a status"),
        }
    }

    /// Arms, until the brakes open; the fault that prevents it.
    pub fn arm(&mut self) -> Option<mcdpr_protocol::FaultRecord> {
        let config_hash = self.config_hash;
        self.bench.tell(Request::Arm { config_hash });
        for _ in 0..100 {
            let status = self.status();
            if status.fault.is_some() || open(&self.bench.chip) {
                return status.fault;
            }
        }
        panic!("neither armed nor refused");
    }
}

/// Whether a brake is open.
pub fn open(chip: &Chip) -> bool {
    chip.pins().any_brake_open()
}

/// Whether nothing drives any output of the board.
pub fn floats(chip: &Chip) -> bool {
    let pins = chip.pins();
    let rest = [pins.drive_enable, pins.gripper, pins.led];
    pins.brakes == [Drive::Floating; 4] && rest == [Drive::Floating; 3]
}
