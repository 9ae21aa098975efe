//! The virtual board: the real control core with simulated pins.

use crate::can::DriveLine;
use crate::plant::{Plant, PlantError};
use crate::wire::{LinkOptions, WireVersion};
use mcdpr_firmware::drives::DriveBus;
use mcdpr_firmware::drives::last::LastDrives;
use mcdpr_firmware::io::{self, Line, RING};
use mcdpr_firmware::kept::KeptLengths;
use mcdpr_firmware::link::{Incoming, LinkState, Outgoing, Queues};
use mcdpr_firmware::server::LinkCounters;
use mcdpr_firmware::{Active, Brake, Cycle, Inputs, Outputs};
use mcdpr_protocol::frame::MAX_FRAME;
use mcdpr_protocol::{
    FaultId, FaultRecord, Hello, Info, Kept, List, PROTOCOL_MAJOR, PROTOCOL_MINOR, PerCable,
    ResetCause, TenthMicrometres, Tick,
};

/// Bytes that a line at 921600 baud sends in a tick: a board passes it frames up to this amount.
/// The next one waits for the next tick, so that an answer never queues behind much telemetry.
const BYTES_PER_TICK: usize = 92;

/// A failure after which a board resets itself, and keeps what a reset leaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BoardFailure {
    /// Its supply falls under the threshold of its voltage detector (P1).
    SupplyLow,
    /// A fault of its program (P4). The encoders count on.
    Crash,
}

/// A board as the simulation sees it, independent of its number of winches.
pub trait VirtualBoard {
    /// Time between two calls of [`Self::tick`], µs: a whole part of a millisecond.
    fn slice_us(&self) -> u64 {
        1000
    }
    /// Whether its time passes by itself, also while nobody calls.
    fn goes_on(&self) -> bool {
        false
    }
    /// Path times of past ticks that are now known; empty if [`Self::path_ms`] always equals the
    /// board's own value.
    fn take_path_times(&mut self) -> Vec<(Tick, u32)> {
        Vec::new()
    }
    /// Delay in ticks of [`Self::take_path_times`], if it reports any.
    fn path_times_behind(&self) -> usize {
        0
    }
    /// Runs plant and drives until `until_us`, a slice from now. A board with its own bus does that
    /// itself, using only the drives' electronics of `line`.
    ///
    /// # Errors
    /// The plant's.
    fn advance(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        until_us: u64,
    ) -> Result<(), PlantError> {
        line.advance(plant, until_us)
    }
    /// As [`Self::advance`] for a plant that is already at the end of the slice, because several
    /// boards share it. `until_us` is the board's own time, at most 100 µs from now.
    ///
    /// # Errors
    /// The plant's.
    fn follow(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        until_us: u64,
    ) -> Result<(), PlantError> {
        line.follow(plant, until_us)
    }
    /// As [`Self::follow`] while the board has no supply.
    ///
    /// # Errors
    /// The plant's.
    fn follow_unpowered(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        until_us: u64,
    ) -> Result<(), PlantError> {
        line.follow(plant, until_us)
    }
    /// One slice of time, for which [`Self::advance`] was just called: takes the received bytes,
    /// returns the bytes to send. `backlog` is the number of bytes that the line has not sent yet.
    ///
    /// # Errors
    /// The plant does not match the board; [`PlantError::Board`] if the board itself cannot
    /// continue.
    fn tick(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        received: &[u8],
        backlog: usize,
        send: &mut Vec<u8>,
    ) -> Result<(), PlantError>;
    /// The supply returns. The board starts without configuration, reference and motion.
    ///
    /// # Errors
    /// [`PlantError::Board`] where it cannot start.
    fn power_on(&mut self) -> Result<(), PlantError>;
    /// The board fails, or the cause is over. It closes its brakes and resets itself at once. Returns whether the board
    /// does that itself; else it is [`Self::restart`]ed when the cause is over, and gets no time until then.
    fn fail(&mut self, failure: BoardFailure, on: bool) -> bool {
        let _ = (failure, on);
        false
    }
    /// Fits a battery, which keeps the board's backup registers without a supply.
    fn fit_battery(&mut self);
    /// The board starts after it has reset itself, with what a reset leaves.
    ///
    /// # Errors
    /// [`PlantError::Board`] where it cannot start.
    fn restart(&mut self, failure: BoardFailure) -> Result<(), PlantError>;
    /// As [`Self::advance`] while the board has no supply: plant and drives are alone.
    ///
    /// # Errors
    /// The plant's.
    fn advance_unpowered(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        until_us: u64,
    ) -> Result<(), PlantError> {
        line.advance(plant, until_us)
    }
    /// Errors that the line's receiver has counted since the last tick. A board with its own
    /// receiver counts them itself.
    fn line_errors(&mut self, errors: u16) {
        let _ = errors;
    }
    /// Level of the fault line at its input from now on; a board without the line sees it low.
    fn hear_fault_line(&mut self, high: bool) {
        let _ = high;
    }
    /// Whether it keeps its transistor from pulling the fault line low.
    fn lets_fault_line_rise(&self) -> bool {
        false
    }
    /// The board's state.
    fn state(&self) -> mcdpr_firmware::State;
    /// Path time of the motion in progress, ms.
    fn path_ms(&self) -> u32;
    /// Ticks since it started.
    fn now(&self) -> Tick;
    /// The latched fault.
    fn fault(&self) -> Option<FaultRecord>;
    /// Whether any drive was commanded to give torque in the last tick.
    fn torque_on(&self) -> bool;
    /// Paid-out lengths that it wants, by channel; empty where only the board itself knows them.
    fn wanted(&self) -> PerCable<TenthMicrometres> {
        PerCable::new()
    }
}

/// The received bytes of the line, as a chip's DMA stores them.
struct Ring {
    bytes: [u8; RING],
    arrived: u32,
}

impl Ring {
    fn place(number: u32) -> usize {
        number as usize % RING
    }

    fn store(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.bytes[Self::place(self.arrived)] = byte;
            self.arrived = self.arrived.wrapping_add(1);
        }
    }
}

impl Line for Ring {
    fn arrived(&mut self) -> u32 {
        self.arrived
    }

    fn byte(&self, number: u32) -> u8 {
        self.bytes[Self::place(number)]
    }
}

/// The control core as a board for these cables of a plant; `number` from 0 tells several boards
/// of one robot apart.
///
/// # Errors
/// [`PlantError::CableCount`] for a number of cables that a board cannot drive.
pub(crate) fn core(
    link: &LinkOptions,
    cables: &[usize],
    number: u8,
) -> Result<Box<dyn VirtualBoard + Send>, PlantError> {
    fn of<const N: usize>(
        link: &LinkOptions,
        cables: &[usize],
        number: u8,
    ) -> Box<dyn VirtualBoard + Send> {
        let mut board = Board::<N>::new(Tick(link.first_tick), link.version);
        board.cables.copy_from_slice(cables);
        board.number = number;
        board.name();
        Box::new(board)
    }
    Ok(match cables.len() {
        1 => of::<1>(link, cables, number),
        2 => of::<2>(link, cables, number),
        3 => of::<3>(link, cables, number),
        4 => of::<4>(link, cables, number),
        5 => of::<5>(link, cables, number),
        6 => of::<6>(link, cables, number),
        7 => of::<7>(link, cables, number),
        8 => of::<8>(link, cables, number),
        count => return Err(PlantError::CableCount { count }),
    })
}

/// The control core for `N` winches with the other parts of a board.
pub(crate) struct Board<const N: usize> {
    /// The plant's cable on each channel.
    cables: [usize; N],
    /// Which of several boards, from 0: the gripper is on the first.
    number: u8,
    cycle: Cycle<N>,
    queues: Queues<N>,
    link: LinkState,
    incoming: Incoming,
    outgoing: Outgoing<N>,
    ring: Ring,
    drives: DriveBus<N>,
    now: Tick,
    line_errors: u16,
    /// Level of the fault line at its input.
    fault_line: bool,
    version: Option<WireVersion>,
    memory: Memory<N>,
    /// Drives that the board commanded before its reset, until it has stopped them.
    to_stop: Option<LastDrives<N>>,
}

/// What a reset leaves, as the chip keeps it in its memory and backup registers.
#[derive(Default)]
struct Memory<const N: usize> {
    /// Lengths of the last tick, with their checksum.
    lengths: Option<(KeptLengths<N>, u16)>,
    /// Those of before the reset, until the board has a reference again.
    before: Option<KeptLengths<N>>,
    drives: Option<LastDrives<N>>,
    /// The encoders have counted since.
    counted: bool,
    /// A battery keeps the lengths without a supply.
    battery: bool,
}

impl<const N: usize> Board<N> {
    pub(crate) fn new(first_tick: Tick, version: Option<WireVersion>) -> Self {
        let hello = hello(version, 0);
        Self {
            cables: std::array::from_fn(|cable| cable),
            number: 0,
            cycle: Cycle::new(true),
            queues: Queues::new(),
            link: LinkState::new(),
            incoming: Incoming::default(),
            outgoing: Outgoing::new(hello),
            ring: Ring {
                bytes: [0; RING],
                arrived: 0,
            },
            drives: DriveBus::default(),
            now: first_tick,
            line_errors: 0,
            fault_line: false,
            version,
            memory: Memory::default(),
            to_stop: None,
        }
    }

    /// Takes the name that goes with its number.
    fn name(&mut self) {
        self.outgoing = Outgoing::new(hello(self.version, self.number));
    }

    /// Starts anew: after a reset by itself with all that a reset leaves, else with what a battery kept.
    fn start(&mut self, by_itself: Option<BoardFailure>) {
        let memory = std::mem::take(&mut self.memory);
        let (cables, number) = (self.cables, self.number);
        *self = Self::new(Tick(0), self.version);
        (self.cables, self.number) = (cables, number);
        let lengths = memory
            .lengths
            .filter(|_| by_itself.is_some() || memory.battery);
        self.memory = Memory {
            before: lengths.and_then(|(lengths, sum)| lengths.checked(sum)),
            counted: by_itself == Some(BoardFailure::Crash),
            battery: memory.battery,
            ..Memory::default()
        };
        let mut hello = hello(self.version, number);
        if by_itself.is_some() {
            hello.reset_cause = ResetCause::Panic;
            self.to_stop = memory.drives;
        }
        self.outgoing = Outgoing::new(hello);
    }

    fn outputs(&self) -> &Outputs<N> {
        self.cycle.server().controller().outputs()
    }
}

fn hello(version: Option<WireVersion>, number: u8) -> Hello {
    let WireVersion {
        major,
        minor,
        git_hash,
    } = version.unwrap_or(WireVersion {
        major: PROTOCOL_MAJOR,
        minor: PROTOCOL_MINOR,
        git_hash: [0; 8],
    });
    let mut board_id = *b"simulated 01";
    // "simulated 02" is the second of several.
    board_id[11] = b'1' + number;
    Hello {
        major,
        minor,
        board_id,
        git_hash,
        reset_cause: ResetCause::Power,
    }
}

/// The inputs and outputs of a simulated board: a plant's sensors and brakes, and the drives' line.
struct Rim<'a, const N: usize> {
    plant: &'a mut Plant,
    line: &'a mut DriveLine,
    ring: &'a mut Ring,
    drives: &'a mut DriveBus<N>,
    line_errors: u16,
    fault_line: bool,
    memory: &'a mut Memory<N>,
    cables: &'a [usize; N],
    /// Whether the gripper is on this board.
    first: bool,
    /// The plant's result for the outputs.
    applied: Result<(), PlantError>,
}

impl<const N: usize> Line for Rim<'_, N> {
    fn arrived(&mut self) -> u32 {
        self.ring.arrived()
    }

    fn byte(&self, number: u32) -> u8 {
        self.ring.byte(number)
    }
}

impl<const N: usize> io::Board<N> for Rim<'_, N> {
    fn read(&mut self, inputs: &mut Inputs<N>) {
        let sensors = self.plant.read_sensors_of(self.cables);
        inputs.e_stop = sensors.e_stop;
        inputs.gripper_switch = self.plant.gripper_switch();
        inputs.line_errors = self.line_errors;
        inputs.fault_line_low = !self.fault_line;
        for (channel, &cable) in self.cables.iter().enumerate() {
            inputs.encoders[channel] = sensors.encoder_counts[cable];
            inputs.tension_adc[channel] = sensors.adc[cable];
        }
        self.drives.listen(&mut self.line.port());
        self.drives.fill(inputs);
    }

    fn apply(&mut self, now: Tick, config: Option<&Active<N>>, outputs: &Outputs<N>) {
        if self.first {
            self.plant.set_gripper(outputs.gripper_closed);
        }
        let mut port = self.line.port();
        self.drives.tick(now, config, outputs, &mut port);
        self.memory.drives = self.drives.take_new().or(self.memory.drives.take());
        for (i, brake) in outputs.brakes.iter().enumerate() {
            let cable = self.cables[i];
            let enabled = self.plant.set_drive_enable(cable, outputs.drive_enable);
            let applied = self.plant.set_brake(cable, *brake == Brake::Closed);
            let applied = enabled.and(applied);
            // The first error is the cause; later ones follow from it.
            if self.applied.is_ok() {
                self.applied = applied;
            }
        }
    }

    fn complete(&self, info: &mut Info) {
        // RMDS and CiA 402, as on the real board.
        info.drive_kinds = 0b110;
    }

    fn keep(&mut self, lengths: Option<&KeptLengths<N>>) {
        self.memory.lengths = lengths.map(|lengths| (*lengths, lengths.checksum()));
        if lengths.is_some() {
            self.memory.before = None;
        }
    }

    fn kept(&self, kept: &mut Kept) {
        if let Some(before) = &self.memory.before {
            kept.lengths = List::collect(before.lengths.iter().copied().map(TenthMicrometres));
            kept.brakes_open = before.brakes_open;
            kept.counted = self.memory.counted;
        }
    }
}

impl<const N: usize> VirtualBoard for Board<N> {
    fn tick(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        received: &[u8],
        backlog: usize,
        send: &mut Vec<u8>,
    ) -> Result<(), PlantError> {
        self.now = self.now.after(1);
        if let Some(last) = self.to_stop.take() {
            self.drives.stop_at_start(&last, &mut line.port());
        }
        self.ring.store(received);
        let (mut tick, mut link) = self.queues.split(&self.link);
        let receives = &mut self.incoming;
        receives.receive(&mut self.ring, &mut link.commands, &self.link);
        let mut rim = Rim {
            plant,
            line,
            ring: &mut self.ring,
            drives: &mut self.drives,
            line_errors: self.line_errors,
            fault_line: self.fault_line,
            memory: &mut self.memory,
            cables: &self.cables,
            first: self.number == 0,
            applied: Ok(()),
        };
        self.cycle.tick(self.now, false, &mut rim, &mut tick);
        rim.applied?;
        self.outgoing.pack(&mut link.outgoing);
        let mut frame = [0; MAX_FRAME];
        while backlog + send.len() < BYTES_PER_TICK {
            let used = self.outgoing.next(&mut link.outgoing, &mut frame);
            if used == 0 {
                break;
            }
            send.extend_from_slice(&frame[..used]);
        }
        Ok(())
    }

    fn fit_battery(&mut self) {
        self.memory.battery = true;
    }

    fn restart(&mut self, failure: BoardFailure) -> Result<(), PlantError> {
        self.start(Some(failure));
        self.cycle.start_in_fault(match failure {
            BoardFailure::SupplyLow => FaultId::P1,
            BoardFailure::Crash => FaultId::P4,
        });
        Ok(())
    }

    fn power_on(&mut self) -> Result<(), PlantError> {
        self.start(None);
        Ok(())
    }

    fn line_errors(&mut self, errors: u16) {
        self.line_errors = errors;
    }

    fn hear_fault_line(&mut self, high: bool) {
        self.fault_line = high;
    }

    fn lets_fault_line_rise(&self) -> bool {
        self.outputs().well
    }

    fn state(&self) -> mcdpr_firmware::State {
        self.cycle.server().controller().state()
    }

    fn path_ms(&self) -> u32 {
        self.cycle.server().controller().path_ms()
    }

    fn now(&self) -> Tick {
        self.now
    }

    fn fault(&self) -> Option<FaultRecord> {
        self.cycle.server().controller().fault()
    }

    fn torque_on(&self) -> bool {
        let drives = &self.outputs().drives;
        drives.iter().any(|drive| drive.gives_torque())
    }

    fn wanted(&self) -> PerCable<TenthMicrometres> {
        let counters = LinkCounters::default();
        self.cycle.server().status(&counters).setpoints
    }
}
