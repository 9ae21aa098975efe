//! The drives on their bus: when to send which frame, and their feedback.
//!
//! A board calls [`DriveBus::listen`] first in its tick, adds [`DriveBus::fill`] to the inputs of
//! the control core, and passes the core's outputs to [`DriveBus::tick`]. Everything else follows
//! from the active configuration: the protocol, the nodes, the bit rate, and the slot of each
//! drive. Slots are spread over the period, so that the load of the ticks is even; a demand for
//! zero torque does not wait for a slot.
//!
//! A drive that lost its power or restarted is set up again by itself, but is enabled only by
//! arming: a torque demand to a drive that was not enabled has no effect.
//!
//! | module | what it is for |
//! |---|---|
//! | [`can`] | frames, and the interface to a board's CAN controller |
//! | [`rmds`], [`cia402`] | the two protocols |
//! | [`last`] | drives to stop after a reset |

pub mod can;
pub mod cia402;
mod drive;
pub mod last;
pub mod rmds;
#[cfg(test)]
mod tests;

pub use can::{BusState, CanFrame, CanPort, Full};
pub use drive::{Mode, Phase};

use crate::config::{Active, DriveKind};
use crate::io::{DriveDemand, DriveInput, Inputs, Outputs, Scan};
use drive::{Drive, Step};
use last::LastDrives;
use mcdpr_protocol::{ConfigHash, Tick};

/// Frames taken in per tick, at most: more than a bus of 1 Mbit/s brings in a millisecond.
// An empty frame without stuffed bits takes 47 bits (ISO 11898-1): 21 fit into a millisecond.
const FRAMES_PER_TICK: usize = 24;
/// Milliseconds from a configuration until the drives have their supply: the same configuration closes their contactor.
/// Schneider Electric, TeSys D, LC1D09BD: 72 ms at most.
const SUPPLY_MS: u16 = 100;
/// The highest drive number on a bus: 127 is the board.
const LAST_NODE: u8 = 126;
/// A scan ends 50 ms after the last drive was asked.
const SCANNED: u8 = LAST_NODE + 50;

/// How often drives are stopped after a reset of the board, and the interval in ticks: one frame
/// may be sent before the bus is ready.
// Five frames 10 ms apart: drives are stopped within 30 ms of the start, even if the first is lost.
const STOPS: u8 = 5;
const STOP_EVERY: u32 = 10;
/// Older feedback is not used to judge torque, ms.
// 20 ms: ten periods of 2 ms.
const TORQUE_MS: u16 = 20;
/// Current above which a motor counts as having torque, mA.
const TORQUE_MA: u16 = 200;

/// Every drive of a board.
#[derive(Debug, Clone)]
pub struct DriveBus<const N: usize> {
    /// The active configuration.
    follows: Option<ConfigHash>,
    kind: DriveKind,
    drives: [Drive; N],
    /// Bit n: the slot of drive n has come and its frame is not sent yet.
    late: u8,
    sync_late: bool,
    /// Whole ticks since the last SYNC, at which the drives read their encoders (CiA 301).
    since_sync_ms: u8,
    bus: BusState,
    /// The next drive number to be asked in a scan, from 1; beyond the last, the waiting time for
    /// late answers.
    asking: u8,
    found: [u32; 4],
    /// How often the drives from before a reset are still to be stopped.
    stops: u8,
    /// A configuration has just been activated.
    new: Option<LastDrives<N>>,
}

impl<const N: usize> Default for DriveBus<N> {
    fn default() -> Self {
        let silent = DriveInput {
            age_ms: u16::MAX,
            ..DriveInput::default()
        };
        Self {
            follows: None,
            kind: DriveKind::None,
            drives: [Drive {
                input: silent,
                ..Drive::default()
            }; N],
            late: 0,
            sync_late: false,
            since_sync_ms: 0,
            bus: BusState::Active,
            asking: SCANNED,
            found: [0; 4],
            stops: 0,
            new: None,
        }
    }
}

impl<const N: usize> DriveBus<N> {
    /// Takes the received frames. Once per tick, before [`Self::fill`].
    pub fn listen(&mut self, port: &mut impl CanPort) {
        for drive in &mut self.drives {
            // Saturating at 65 s: a silent drive must never look fresh again.
            drive.input.age_ms = drive.input.age_ms.saturating_add(1);
            drive.timer = drive.timer.saturating_sub(1);
        }
        // Only these drives have heartbeats; an RMDS does not pay for them.
        if self.kind == DriveKind::Cia402 {
            for drive in &mut self.drives {
                drive.quiet_ms = drive.quiet_ms.saturating_add(1);
                drive.since_ms = drive.since_ms.saturating_add(1);
            }
        }
        for _ in 0..FRAMES_PER_TICK {
            let Some(frame) = port.receive() else { break };
            if self.asking < SCANNED {
                self.note_answer(&frame);
            }
            match self.kind {
                DriveKind::None => {}
                DriveKind::Rmds => {
                    if let Some(feedback) = rmds::feedback(&frame) {
                        for drive in &mut self.drives {
                            rmds::take(drive, &feedback);
                        }
                    }
                }
                DriveKind::Cia402 => {
                    for drive in &mut self.drives {
                        if cia402::take(drive, &frame) {
                            // Not from its arrival on: at 200 mm/s the drum has turned by 0.4 mm since
                            // SYNC if the frame of an eighth drive comes two ticks later.
                            drive.input.age_ms = u16::from(self.since_sync_ms);
                        }
                    }
                }
            }
        }
        self.since_sync_ms = self.since_sync_ms.wrapping_add(1);
        self.bus = port.state();
    }

    /// After a reset of the board, before the first tick: these drives still follow their last
    /// command, and are stopped.
    pub fn stop_at_start(&mut self, last: &LastDrives<N>, port: &mut impl CanPort) {
        port.set_bitrate(last.bits_per_s);
        self.kind = last.kind;
        self.stops = STOPS;
        for (drive, node) in self.drives.iter_mut().zip(last.nodes) {
            drive.node = node;
        }
    }

    /// The drives of a configuration that was just activated, once: to be kept over a reset.
    pub fn take_new(&mut self) -> Option<LastDrives<N>> {
        self.new.take()
    }

    /// No configuration yet.
    fn stop_drives(&mut self, now: Tick, port: &mut impl CanPort) {
        if self.stops == 0 || !now.0.is_multiple_of(STOP_EVERY) {
            return;
        }
        self.stops -= 1;
        for drive in self.drives.iter().filter(|drive| drive.node != 0) {
            // A frame that finds no room is sent the next time.
            let _ = port.send(&match self.kind {
                DriveKind::Cia402 => cia402::reset(drive.node),
                _ => rmds::reset(drive.node),
            });
        }
    }

    /// Adds the drives' last feedback to the inputs of the control core.
    pub fn fill(&self, inputs: &mut Inputs<N>) {
        inputs.scan = Scan {
            done: self.asking >= SCANNED,
            nodes: self.found,
        };
        for (input, drive) in inputs.drives.iter_mut().zip(&self.drives) {
            *input = drive.input;
            let fresh = drive.input.age_ms < TORQUE_MS;
            // A current that flows is torque, whatever the drive's state claims.
            let pulls = fresh && drive.input.current_ma.unsigned_abs() > TORQUE_MA;
            // Passive is not off: the controller still sends, and D3 reports drives that fall
            // silent.
            input.bus_off = self.bus == BusState::Off;
            match self.kind {
                DriveKind::None => {}
                DriveKind::Rmds => {
                    input.ready = rmds::is_ready(drive);
                    input.torque = pulls || (fresh && input.ready);
                }
                DriveKind::Cia402 => {
                    input.ready = drive.phase == Phase::Enabled && cia402::is_enabled(drive);
                    input.torque = pulls || (fresh && cia402::is_enabled(drive));
                    input.fault = cia402::has_failed(drive);
                    input.refused = drive.refused;
                    input.warning = drive.status & cia402::WARNING != 0;
                    // Excess temperature of device (42) or motor and its supply (43).
                    input.over_temperature = matches!(drive.emergency >> 8, 0x42 | 0x43);
                    if cia402::is_quiet(drive) {
                        input.age_ms = input.age_ms.max(drive.quiet_ms);
                    }
                }
            }
        }
    }

    /// Sends the frames of this tick; `active` is the active configuration.
    pub fn tick(
        &mut self,
        now: Tick,
        active: Option<&Active<N>>,
        outputs: &Outputs<N>,
        port: &mut impl CanPort,
    ) {
        let Some(active) = active else {
            // Without a configuration no drive is commanded; only those from before a reset are
            // stopped.
            return self.stop_drives(now, port);
        };
        // The hash stands for every value: another one may mean other nodes or another protocol.
        if self.follows != Some(active.hash) {
            self.follow(active, port);
        }
        if self.kind == DriveKind::Cia402 {
            self.beat_and_sync(now, active, port);
        }
        if outputs.scan {
            (self.asking, self.found) = (1, [0; 4]);
        }
        if self.asking < SCANNED {
            self.ask(port);
        }
        let slots = outputs.drives.iter().zip(&active.cables);
        for (bit, (drive, (&demand, cable))) in (0_u8..8).zip(self.drives.iter_mut().zip(slots)) {
            let slot = now.0 % u32::from(cable.period_ticks.max(1)) == u32::from(cable.slot);
            // A drive that is to lose its torque must not wait for up to a period of 20 ms.
            let torque_off = demand == DriveDemand::Off && drive.phase as u8 > Phase::Idle as u8;
            self.late |= u8::from(slot || torque_off) << bit;
            if self.late & (1 << bit) == 0 {
                continue;
            }
            let step = match self.kind {
                DriveKind::None => None,
                DriveKind::Rmds => rmds::next(drive, cable, demand),
                DriveKind::Cia402 => cia402::next(drive, cable, demand),
            };
            if let Some(Step { frame, then, timer }) = step {
                // The bit in `late` stays: the frame is offered again in the next tick.
                if port.send(&frame).is_err() {
                    continue;
                }
                if drive.phase != then && then == Phase::Setup {
                    drive.step = 0;
                }
                (drive.phase, drive.timer) = (then, timer);
            }
            self.late &= !(1 << bit);
        }
    }

    /// Starts anew with a configuration.
    fn follow(&mut self, active: &Active<N>, port: &mut impl CanPort) {
        port.set_bitrate(active.bus_bitrate);
        *self = Self {
            follows: Some(active.hash),
            kind: active.drive_kind,
            new: Some(LastDrives::of(active)),
            ..Self::default()
        };
        for (drive, cable) in self.drives.iter_mut().zip(&active.cables) {
            drive.node = cable.node;
            drive.timer = SUPPLY_MS;
            drive.wanted_mode = cia402::mode_number(Mode::of(cable));
            drive.period_ms = u16::from(cable.period_ticks);
            drive.rpm_per_count_q16 = cable.rpm_per_count_q16;
        }
    }

    /// One number per tick is asked, so that the scan hardly loads the bus.
    fn ask(&mut self, port: &mut impl CanPort) {
        let frame = match self.kind {
            DriveKind::Cia402 => cia402::probe(self.asking),
            _ => rmds::probe(self.asking),
        };
        // A number that found no room is asked again; beyond the last one only time passes.
        if self.asking > LAST_NODE || port.send(&frame).is_ok() {
            self.asking += 1;
        }
    }

    fn note_answer(&mut self, frame: &CanFrame) {
        let node = match self.kind {
            DriveKind::Cia402 => cia402::probed(frame),
            _ => rmds::probed(frame),
        };
        let word = node.and_then(|node| self.found.get_mut(usize::from(node >> 5)));
        if let (Some(node), Some(word)) = (node, word) {
            *word |= 1 << (node & 31);
        }
    }

    fn beat_and_sync(&mut self, now: Tick, active: &Active<N>, port: &mut impl CanPort) {
        let shortest = active.cables.iter().map(|cable| cable.period_ticks).min();
        self.sync_late |= now
            .0
            .is_multiple_of(u32::from(shortest.unwrap_or(1).max(1)));
        if self.sync_late {
            self.sync_late = port.send(&cia402::sync()).is_err();
            if !self.sync_late {
                self.since_sync_ms = 0;
            }
        }
        // At remainder 1: not in the tick of a SYNC with an even period, which is the usual one.
        if now.0 % cia402::BOARD_BEAT_MS == 1 {
            // A lost one does not matter: three more follow before a drive stops.
            let _ = port.send(&cia402::beat());
        }
    }
}
