//! Requests and their outcomes.

use crate::frame::{Channel, FrameError, MAX_FRAME, encode_frame};
use crate::{
    BoardState, ConfigEntry, ConfigHash, FaultId, FaultRecord, Knot, List, Millinewtons, PerCable,
    Status, TenthMicrometres, Tick,
};
use postcard::experimental::max_size::MaxSize;
use serde::{Deserialize, Serialize};

/// A host's session with a board: random, not zero, new at every start of a host program.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct SessionId(pub u32);

/// Number of a request in its session, wrapping.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct SequenceNumber(pub u16);

impl SequenceNumber {
    /// The next number.
    #[must_use]
    pub const fn next(self) -> Self {
        Self(self.0.wrapping_add(1))
    }

    /// Signed distance from `other` to `self`, across the wrap.
    #[must_use]
    pub const fn since(self, other: Self) -> i16 {
        self.0.wrapping_sub(other.0).cast_signed()
    }
}

/// A request with its session and number.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Command {
    /// The session of the sender.
    pub session: SessionId,
    /// Which request of the session this is; echoed in the [`Answer`].
    pub sequence: SequenceNumber,
    /// The request.
    pub request: Request,
}

/// Configuration entries that travel in one request.
// 24 entries of up to 8 bytes (key 3, value 5) are 192 of the 249 bytes of a body.
pub const CONFIG_CHUNK: usize = 24;

/// Requests of a host to a board. Append only.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub enum Request {
    /// Properties of the board: answered with [`Reply::Info`].
    Info,
    /// State of the board: answered with [`Reply::Status`].
    Status,
    /// Claims the board for this session and sets the sequence to the number after this one.
    Open,
    /// Ends the session; refused while armed.
    Close,
    /// Shows that the host is alive; answered with [`Reply::Beat`].
    Heartbeat {
        /// The host's clock, echoed, µs, wrapping.
        host_time_us: u32,
    },
    /// Stops. Accepted from anyone, in any state, before everything else.
    Stop(StopKind),
    /// Discards the entries received so far and expects this many.
    ConfigBegin {
        /// How many entries will follow.
        entries: u16,
    },
    /// Some entries, keys in ascending order over all chunks.
    ConfigPut {
        /// The entries.
        entries: List<ConfigEntry, CONFIG_CHUNK>,
    },
    /// Activates the entries if the hash matches and every value is valid.
    ConfigCommit {
        /// Hash over all entries.
        hash: ConfigHash,
    },
    /// Sets the present length of each cable (paid out, as the drum encoder measures it).
    Reference {
        /// The lengths.
        lengths: PerCable<TenthMicrometres>,
        /// Tensions that the static model expects now.
        tensions: PerCable<Millinewtons>,
    },
    /// Enables drives, checks, opens brakes and holds.
    Arm {
        /// The configuration that the host expects.
        config_hash: ConfigHash,
    },
    /// Closes brakes under torque, then switches torque off.
    Disarm,
    /// Adds a knot to the motion buffer.
    Knot(Knot),
    /// Starts the buffered motion.
    Start,
    /// Continues after a hold, along the same path.
    Resume,
    /// Discards the buffered motion; refused while moving.
    Discard,
    /// Acknowledges the latched fault.
    ClearFault,
    /// Switches sample blocks on or off.
    Samples {
        /// On or off.
        enabled: bool,
    },
    /// Opens or closes the gripper.
    Gripper {
        /// Whether to close it.
        closed: bool,
    },
    /// Enables a single drive, for work on one winch: every other drive stays off and every other
    /// brake closed, a slack cable is not a fault, and tensions need not agree with a model.
    /// Everything else applies: heartbeat, stops, limits, the configuration's hash.
    Service {
        /// The configuration that the host expects.
        config_hash: ConfigHash,
        /// The winch, 1 for the first.
        cable: u8,
        /// Whether its brake opens; else the drive pulls against it until the board is disarmed.
        open: bool,
    },
    /// One winch, unfiltered: answered with [`Reply::Winch`].
    Winch {
        /// Its number, 1 for the first.
        cable: u8,
    },
    /// Drives found on the bus: answered with [`Reply::Drives`].
    Scan {
        /// Starts a new scan; otherwise returns the drives found so far.
        restart: bool,
    },
    /// The board's self-test, while nothing has torque: answered with [`Reply::Bench`].
    Bench {
        /// What is tested first.
        test: BenchTest,
    },
    /// Lengths that the board kept over its last reset: answered with [`Reply::Kept`].
    Kept,
}

impl Request {
    /// Whether the request is executed strictly in order and exactly once.
    #[must_use]
    pub const fn is_sequenced(&self) -> bool {
        !matches!(
            self,
            Self::Info
                | Self::Status
                | Self::Open
                | Self::Heartbeat { .. }
                | Self::Stop(_)
                | Self::Winch { .. }
                | Self::Kept
        )
    }
}

/// Tests of a self-test. Append only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub enum BenchTest {
    /// None: the board only reports its identity and measurements.
    Look,
    /// Frames through the CAN controller and back, without the bus. Only without a configuration.
    CanLoop,
    /// Sets one output for [`BENCH_OUTPUT_MS`]; it falls by itself. Only without a configuration,
    /// so that no drive has received a command.
    Output {
        /// 1 to 4: a brake opens. 5: the gripper closes. 6: the drives get power. 7
        /// ([`BENCH_FAULT_LINE`]): the board pulls the fault line low, with a configuration, too.
        output: u8,
    },
}

/// Number of outputs that a self-test can set.
pub const BENCH_OUTPUTS: u8 = 6;
/// The output that pulls the fault line low.
pub const BENCH_FAULT_LINE: u8 = 7;
/// Duration of the output, ms.
pub const BENCH_OUTPUT_MS: u16 = 300;

/// Ways to stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub enum StopKind {
    /// Decelerate along the path and hold under tension; can be resumed.
    Hold,
    /// Decelerate along the path, close brakes under torque, torque off (STOP1).
    Stop,
    /// Brakes and torque off at once (STOP0); only if drive control is lost.
    Emergency,
}

/// Outcome of a request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Answer {
    /// The request's number.
    pub sequence: SequenceNumber,
    /// The outcome.
    pub result: Result<Reply, Reject>,
}

/// A request was executed, or started if it takes time.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub enum Reply {
    /// Done.
    Done,
    /// To [`Request::Info`].
    Info(Info),
    /// To [`Request::Status`].
    Status(Status),
    /// To [`Request::Heartbeat`].
    Beat {
        /// The host's clock as sent.
        host_time_us: u32,
        /// The board's tick when it took the heartbeat.
        tick: Tick,
        /// The board's state.
        state: BoardState,
        /// Path time of the motion in progress, ms.
        path_ms: u32,
        /// Free knots of the motion buffer.
        knots_free: u8,
        /// The number that the next knot must have.
        next_knot: u16,
    },
    /// To a knot: room left in the motion buffer.
    Queued {
        /// Free knots.
        free: u8,
    },
    /// To [`Request::ConfigCommit`].
    Configured {
        /// The hash now in use.
        hash: ConfigHash,
    },
    /// To [`Request::Winch`].
    Winch(Winch),
    /// To [`Request::Scan`].
    Drives {
        /// Whether every number has been asked.
        done: bool,
        /// Bit n of word m: drive 32 m + n answers.
        nodes: [u32; 4],
    },
    /// To [`Request::Bench`].
    Bench(Bench),
    /// To [`Request::Kept`].
    Kept(Kept),
}

/// Lengths that a board kept over a reset. Append only.
#[derive(Debug, Default, Clone, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Kept {
    /// Paid-out lengths in the last tick before the reset; empty if none are valid, or if the board has got a
    /// reference since.
    pub lengths: PerCable<TenthMicrometres>,
    /// Brakes that were commanded open then; bit 0 is the first.
    pub brakes_open: u8,
    /// The encoders counted on from a few tens of microseconds after the last tick: a fault of the program reset the
    /// board, with a good supply. Else the drums may have turned by any way since.
    pub counted: bool,
}

/// Error counters of a CAN controller (ISO 11898-1).
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct CanErrors {
    /// Transmit errors.
    pub transmit: u8,
    /// Receive errors.
    pub receive: u8,
}

/// Results of a board's self-test; zeros in a simulation without a chip.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Bench {
    /// The chip's own identity (DBGMCU_IDCODE).
    pub id_code: u32,
    /// The core's (CPUID).
    pub core_id: u32,
    /// The maker by the core's table of components (JEP106 code; ST is 0x20).
    pub maker: u16,
    /// Size of the flash by the factory's register, KiB.
    pub flash_kib: u16,
    /// Cause of the start: RCC_CSR, bits 24 to 31.
    pub reset_flags: u8,
    /// It runs from its crystal.
    pub crystal: bool,
    /// Supply by the internal reference, mV.
    pub supply_mv: u16,
    /// The slow oscillator's frequency by the crystal, Hz; 0 in the first two seconds.
    pub slow_hz: u32,
    /// CAN: the error counters.
    pub can_errors: CanErrors,
    /// CAN: received frames that were lost.
    pub can_lost: u32,
    /// CAN: whether the last [`BenchTest::CanLoop`] returned the frames sent; `None` before the
    /// first.
    pub can_loop: Option<bool>,
    /// Greatest time of a control tick since the start, core cycles, self-tests left out.
    pub tick_cycles: u32,
    /// Stack that was never used, bytes.
    pub stack_free: u16,
    /// Bit 0: the emergency input is open; bit 1: the gripper's switch is closed.
    pub inputs: u8,
    /// Levels of the outputs at the pins, in the order of [`BenchTest::Output`].
    pub outputs: u8,
}

/// State of one winch in a tick.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Winch {
    /// The drive is enabled and follows commands.
    pub ready: bool,
    /// The drive reports a fault.
    pub fault: bool,
    /// The drive is too hot.
    pub hot: bool,
    /// The drives' bus is off.
    pub bus_off: bool,
    /// Milliseconds since the drive's last feedback; 65535 if there was none.
    pub age_ms: u16,
    /// Motor position, counts since the drive was reset.
    pub motor_counts: i32,
    /// Motor current, mA.
    pub current_ma: i16,
    /// Drum encoder, counts since the board started, as the pins count: without the configured
    /// sign.
    pub drum_counts: i32,
    /// Tension channel: 0 to 65520 for 0 V to 3.3 V.
    pub tension_adc: u16,
}

/// Greatest size of a panic message that survives a reset, bytes.
pub const PANIC_BYTES: usize = 96;

/// Properties of a board; append-only.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Info {
    /// Cables that this board can drive.
    pub cables: u8,
    /// Knots that its motion buffer holds.
    pub knot_capacity: u8,
    /// Control ticks per second.
    pub ticks_per_second: u16,
    /// Bit set of drive kinds that the firmware speaks: bit n is drive kind n.
    pub drive_kinds: u8,
    /// Whether the board is simulated.
    pub simulated: bool,
    /// The last panic message, UTF-8, empty if none.
    pub last_panic: List<u8, PANIC_BYTES>,
}

/// A request was refused and nothing changed. Append only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub enum Reject {
    /// Not possible in this state (K8).
    WrongState {
        /// The state.
        state: BoardState,
    },
    /// Another session holds the board (L14).
    SessionHeld,
    /// This session does not hold the board (L13): open it first.
    NoSession,
    /// Out of order (L3, L5): the board waits for this number.
    Sequence {
        /// The number that the board waits for.
        expected: SequenceNumber,
    },
    /// A request of a later version.
    Unsupported,
    /// A list has another number of cables than the board is configured for.
    CableCount {
        /// Configured.
        expected: u8,
        /// Received.
        got: u8,
    },
    /// No active configuration.
    NotConfigured,
    /// Another configuration is active (F9).
    ConfigHash {
        /// The board's.
        board: ConfigHash,
        /// The host's.
        host: ConfigHash,
    },
    /// Entries missing, repeated, unsorted or too many.
    ConfigSequence,
    /// The key is unknown.
    ConfigUnknownKey {
        /// The key.
        key: u16,
    },
    /// A value is out of range or missing (F2).
    ConfigValue {
        /// The key.
        key: u16,
    },
    /// The lengths were never referenced.
    NotReferenced,
    /// The motion buffer is full (K7).
    BufferFull,
    /// A knot's number is not the next one.
    KnotIndex {
        /// The next one.
        expected: u16,
    },
    /// A knot's time is not after the one before, or too far after it, or already past (K5).
    KnotTime {
        /// Earliest path time that would be accepted, ms.
        earliest_ms: u32,
    },
    /// The motion does not start where the robot is (K4).
    KnotStart {
        /// The cable, 1 for the first.
        cable: u8,
        /// The knot minus the set-point, 0.1 µm.
        gap: TenthMicrometres,
    },
    /// A length is out of range.
    KnotLength {
        /// The cable, 1 for the first.
        cable: u8,
    },
    /// A velocity, at a knot or anywhere in the segment before it, is over its limit (K3).
    KnotSpeed {
        /// The cable, 1 for the first.
        cable: u8,
    },
    /// A tension is out of range.
    KnotTension {
        /// The cable, 1 for the first.
        cable: u8,
    },
    /// A motion already ended with a last knot, or must end at rest.
    KnotEnd,
    /// Nothing is buffered.
    NothingToStart,
    /// A fault is latched: read it, remove its cause, clear it.
    Faulted {
        /// The fault.
        record: FaultRecord,
    },
    /// The cause of the fault is still there.
    CauseRemains {
        /// Which.
        fault: FaultId,
    },
    /// The acceleration of a segment is over its limit (K3).
    KnotAcceleration {
        /// The cable, 1 for the first.
        cable: u8,
    },
    /// The jerk of a segment is over its limit (K3).
    KnotJerk {
        /// The cable, 1 for the first.
        cable: u8,
    },
    /// The board has a configuration, so its drives may have received commands: only a board that
    /// was just started tests its outputs.
    Configured,
}

/// Every message fits a frame; a message that does not fit is a compile error.
const _: () = {
    use crate::frame::MAX_BODY;
    // While compiling: a message that grows beyond a frame would fail on the robot only.
    assert!(Command::POSTCARD_MAX_SIZE <= MAX_BODY);
    assert!(Answer::POSTCARD_MAX_SIZE <= MAX_BODY);
    assert!(Status::POSTCARD_MAX_SIZE <= MAX_BODY);
    // No block has both the most cables and the most packed bytes, so the sum of the fields' maxima
    // is too large; the worst block has five cables.
    assert!(crate::telemetry::SAMPLE_BYTES + 2 + 5 + 5 + 1 + 5 * 5 <= MAX_BODY);
};

/// Decodes a request; `None` if the body is invalid, or has bytes to spare. The only decoder on a
/// board: compiled here, for size, and not where it is used, for speed.
#[must_use]
#[inline(never)]
pub fn decode_command(body: &[u8]) -> Option<Command> {
    decode(body)
}

/// Index of [`Request::Stop`] in its enum, as postcard writes it.
// The position of `Stop` in `Request`, as postcard numbers variants. Append-only enums keep it.
pub(crate) const STOP: u32 = 5;

/// The stop that a command's body requests, if any; see [`crate::stop`].
pub(crate) fn stop_in(body: &[u8]) -> Option<StopKind> {
    // Not decoded as a `Command`: that is large, and only a stop is searched for.
    match decode::<(SessionId, SequenceNumber, u32, StopKind)>(body) {
        Some((_, _, STOP, kind)) => Some(kind),
        _ => None,
    }
}

/// Encodes an answer into a frame, as [`encode_frame`] does; see
/// [`decode_command`].
///
/// # Errors
/// Never: every answer fits.
pub fn encode_answer(answer: &Answer, out: &mut [u8; MAX_FRAME]) -> Result<usize, FrameError> {
    encode_frame(Channel::Answer, answer, out)
}

/// Encodes a state, as [`encode_answer`] does an answer.
///
/// # Errors
/// Never: every state fits.
pub fn encode_status(status: &Status, out: &mut [u8; MAX_FRAME]) -> Result<usize, FrameError> {
    encode_frame(Channel::Status, status, out)
}

/// Decodes the body of a frame; `None` if it is not this message, or has bytes to spare.
#[must_use]
pub fn decode<'a, T: Deserialize<'a>>(body: &'a [u8]) -> Option<T> {
    match postcard::take_from_bytes(body) {
        // Bytes left over mean another message or another version: it is not executed.
        Ok((message, [])) => Some(message),
        _ => None,
    }
}
