//! Frames computed by hand from the protocols' texts, and sequences of drive states.

use super::{BusState, CanFrame, CanPort, DriveBus, Full};
use crate::config::{Active, CableConfig, Control, DriveKind, TensionLaw, TensionOutput};
use crate::io::{DriveDemand, DriveInput, Inputs, Outputs};
use heapless::{Deque, Vec};
use mcdpr_protocol::{ConfigHash, Tick};

/// A port that keeps sent frames and returns given ones.
#[derive(Default)]
struct Port {
    sent: Vec<(u32, CanFrame), 512>,
    given: Deque<CanFrame, 16>,
    room: usize,
    state: BusState,
    now: u32,
    bitrate: u32,
}

impl CanPort for Port {
    fn set_bitrate(&mut self, bits_per_s: u32) {
        self.bitrate = bits_per_s;
    }
    fn send(&mut self, frame: &CanFrame) -> Result<(), Full> {
        self.room = self.room.checked_sub(1).ok_or(Full)?;
        self.sent.push((self.now, *frame)).unwrap();
        Ok(())
    }
    fn receive(&mut self) -> Option<CanFrame> {
        self.given.pop_front()
    }
    fn state(&self) -> BusState {
        self.state
    }
}

fn cable(control: Control, node: u8, slot: u8) -> CableConfig {
    CableConfig {
        control,
        per_count_q24: 1 << 24,
        half_count: 0,
        four_counts: 4,
        max_encoder_step: 100,
        motor_per_length_q32: 1 << 32,
        length_per_motor_q32: 1 << 32,
        rpm_per_speed_q32: 1 << 32,
        speed_per_rpm_q16: 1 << 16,
        motor_reversed: false,
        max_rpm: 8000,
        max_current_ma: 3000,
        most_ma: 2900,
        current_per_force_q32: 1 << 32,
        tension_per_adc_q24: 1,
        tension_zero_q24: 0,
        tension_max_mn: 1,
        floor_mn: 0,
        ceiling_mn: 1,
        law: TensionLaw::Default,
        output: TensionOutput::Current,
        kp_milli: 0,
        kd_us: 0,
        ki_milli: 0,
        damping_mns_per_m: 0,
        filter_alpha_q16: 1,
        corner_alpha_q16: 0,
        gain_per_length_q40: 0,
        friction_mn: 0,
        mass_g: 0,
        most_force_mn: 1,
        stop_q16: 0,
        play: 0,
        brake_play: 0,
        lead_us: 0,
        lead_square: 0,
        brake_close_ms: 30,
        following_error: 1000,
        max_speed_umps: 1,
        max_acceleration_umps2: 1,
        max_jerk_mmps3: 1,
        reel_speed_umps: 10_000,
        length_min: 0,
        length_max: 1,
        node,
        period_ticks: 2,
        slot,
        syncs: 1,
        // A motor of 4096 counts per turn: 65,536 * 60,000 / 4096.
        rpm_per_count_q16: 960_000,
    }
}

fn active(kind: DriveKind) -> Active<2> {
    Active {
        hash: ConfigHash(7),
        drive_kind: kind,
        bus_bitrate: 1_000_000,
        stop_ms: 300,
        residual_ms: 100,
        enable_ms: 1100,
        feedback_timeout_ms: 10,
        hold_braked: false,
        fault_line: false,
        cables: [cable(Control::Length, 3, 0), cable(Control::Tension, 5, 1)],
    }
}

/// A bus of two drives on a port.
struct Bench {
    bus: DriveBus<2>,
    port: Port,
    active: Active<2>,
    now: u32,
}

impl Bench {
    /// From the moment at which the drives have their supply: until then nothing is sent.
    fn new(kind: DriveKind) -> Self {
        let mut bench = Self {
            bus: DriveBus::default(),
            port: Port::default(),
            active: active(kind),
            now: 0,
        };
        for _ in 0..super::SUPPLY_MS {
            bench.tick(OFF);
        }
        // SYNC and the board's heartbeat are for nobody in particular.
        let to_drives = |id: u16| !matches!(id, 0x080 | 0x77F);
        assert!(!bench.sent().iter().any(|(id, _)| to_drives(*id)));
        bench.now = 0;
        bench
    }

    fn tick(&mut self, demands: [DriveDemand; 2]) -> [DriveInput; 2] {
        self.port.now = self.now;
        self.port.room = 3;
        self.bus.listen(&mut self.port);
        let mut inputs = Inputs::<2>::default();
        self.bus.fill(&mut inputs);
        let outputs = Outputs {
            drives: demands,
            ..Outputs::default()
        };
        let active = Some(&self.active);
        self.bus
            .tick(Tick(self.now), active, &outputs, &mut self.port);
        self.now += 1;
        inputs.drives
    }

    /// What was sent since the last time, without times.
    fn sent(&mut self) -> Vec<(u16, Vec<u8, 8>), 512> {
        let bytes = |frame: &CanFrame| {
            let data = &frame.data[..usize::from(frame.len)];
            Vec::from_slice(data).unwrap()
        };
        let sent = self.port.sent.iter();
        let sent = sent.map(|(_, frame)| (frame.id, bytes(frame))).collect();
        self.port.sent.clear();
        sent
    }

    fn give(&mut self, id: u16, bytes: &[u8]) {
        let mut data = [0; 8];
        data[..bytes.len()].copy_from_slice(bytes);
        let len = u8::try_from(bytes.len()).unwrap();
        self.port
            .given
            .push_back(CanFrame { id, len, data })
            .unwrap();
    }
}

/// Frames in hexadecimal, as a bus monitor shows them.
fn hex(frames: &[(u16, Vec<u8, 8>)]) -> std::vec::Vec<std::string::String> {
    frames
        .iter()
        .map(|(id, data)| {
            let bytes: std::vec::Vec<_> = data.iter().map(|b| std::format!("{b:02X}")).collect();
            std::format!("{id:03X} {}", bytes.join(" "))
        })
        .collect()
}

const OFF: [DriveDemand; 2] = [DriveDemand::Off; 2];
const ENABLE: [DriveDemand; 2] = [DriveDemand::EnablePosition, DriveDemand::EnableCurrent];

mod bus;
mod cia402;
mod rmds;
