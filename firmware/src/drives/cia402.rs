//! CiA 402 drives over CANopen (CiA 301): expedited set-up, control word, cyclic position, speed
//! or torque.
//!
//! After a reset of its communication a drive is set up object by object (`SETUP`) and started.
//! From then on it receives one PDO in its slot (control word with position, speed or torque,
//! taking effect at once) and returns one PDO per SYNC (status word, position, torque), with its
//! actual mode every `MODE_SYNCS` SYNCs. Drive and board monitor each other's heartbeat.

use super::can::CanFrame;
use super::drive::{Drive, Mode, Phase, Step, mode_of};
use crate::config::CableConfig;
use crate::config::schedule::MODE_SYNCS;
use crate::io::{DriveDemand, Refused};

/// The board's own node, for its heartbeat.
pub(crate) const BOARD_NODE: u8 = 127;
/// Milliseconds between two heartbeats of the board.
pub(crate) const BOARD_BEAT_MS: u32 = 50;
/// Transmission type of a command that takes effect at the next SYNC (CiA 301): for drives that do
/// not support immediate effect.
const AT_SYNC: u32 = 1;
/// Milliseconds between two heartbeats of a drive.
const BEAT_MS: u32 = 100;
/// Milliseconds after which a drive without heartbeats is lost: two may be late.
// 300 ms are three heartbeats of 100 ms.
const QUIET_MS: u16 = 300;
/// Milliseconds for a drive to start its communication.
// 1 s; an assumption for the slowest drive.
const BOOT_MS: u16 = 1000;
/// A drive that was started and does not answer for this long has lost its power: start again.
const LOST_MS: u16 = 100;
/// Milliseconds for an answer to a set-up request, before it is repeated.
const ANSWER_MS: u16 = 50;

const NMT: u16 = 0x000;
const SYNC: u16 = 0x080;
const EMERGENCY: u16 = 0x080;
const FEEDBACK: u16 = 0x180;
const COMMAND: u16 = 0x200;
const MODE_REPORT: u16 = 0x280;
const SDO_ANSWER: u16 = 0x580;
const SDO_REQUEST: u16 = 0x600;
const HEARTBEAT: u16 = 0x700;

const START: u8 = 0x01;
const RESET_NODE: u8 = 0x81;
const RESET_COMMUNICATION: u8 = 0x82;
const OPERATIONAL: u8 = 0x05;
const BOOT_UP: u8 = 0x00;

/// Status word: the bits that name the state, and the states (CiA 402, table of state coding).
const STATE_BITS: u16 = 0x6F;
const NO_TORQUE_BITS: u16 = 0x4F;
const FAULT: u16 = 0x08;
const SWITCH_ON_DISABLED: u16 = 0x40;
const READY_TO_SWITCH_ON: u16 = 0x21;
const SWITCHED_ON: u16 = 0x23;
/// The state in which a drive follows commands.
pub(super) const OPERATION_ENABLED: u16 = 0x27;
/// The drive's own warning.
pub(super) const WARNING: u16 = 0x80;

/// Source of an object's value.
#[derive(Clone, Copy, PartialEq, Eq)]
enum From {
    /// The given number.
    Number,
    /// The given number plus the node.
    Node,
    /// The mode.
    Mode,
    /// The content of the command besides the control word.
    Target,
    /// SYNCs per feedback.
    Syncs,
    /// Period of commands, ms.
    Period,
    /// Largest torque, thousandths of the rated.
    Torque,
    /// Largest speed, rpm.
    Speed,
    /// The object is read, not written.
    Drive,
}

/// An object of the set-up, in eight bytes: there are thirty-one of them, and little flash.
struct Object {
    index: u16,
    /// Sub-index in bits 0 to 3, bytes in bits 4 to 6, bit 7: optional.
    shape: u8,
    from: From,
    value: u32,
}

impl Object {
    const fn sub(&self) -> u8 {
        self.shape & 0xF
    }

    const fn size(&self) -> u8 {
        (self.shape >> 4) & 7
    }

    const fn is_optional(&self) -> bool {
        self.shape & 0x80 != 0
    }
}

const fn object(index: u16, sub: u8, size: u8, from: From, value: u32) -> Object {
    Object {
        index,
        shape: sub | (size << 4),
        from,
        value,
    }
}

const fn optional(index: u16, sub: u8, size: u8, from: From, value: u32) -> Object {
    let object = object(index, sub, size, from, value);
    Object {
        shape: object.shape | 0x80,
        ..object
    }
}

/// Objects written to a drive before it starts, in this order. A PDO is switched off while its
/// content changes. Bit 31: off; bit 30: no remote request.
///
/// If a drive lacks an optional object there is a fallback: one that does not support immediate
/// effect acts at SYNC ([`AT_SYNC`]), one that cannot report its mode is assumed to be in the one
/// it accepted.
static SETUP: [Object; 31] = [
    // Feedback: status word, position, torque, at SYNC.
    // CiA 301: an identifier may be changed only while bit 31 switches the PDO off.
    object(0x1800, 1, 4, From::Node, 0xC000_0000 | FEEDBACK as u32),
    object(0x1800, 2, 1, From::Syncs, 0),
    // A mapping is changed only with a count of 0; an entry is index, sub-index and bits.
    object(0x1A00, 0, 1, From::Number, 0),
    object(0x1A00, 1, 4, From::Number, 0x6041_0010),
    object(0x1A00, 2, 4, From::Number, 0x6064_0020),
    object(0x1A00, 3, 4, From::Number, 0x6077_0010),
    object(0x1A00, 0, 1, From::Number, 3),
    object(0x1800, 1, 4, From::Node, 0x4000_0000 | FEEDBACK as u32),
    // The actual mode.
    optional(0x1801, 1, 4, From::Node, 0xC000_0000 | MODE_REPORT as u32),
    optional(0x1801, 2, 1, From::Number, MODE_SYNCS as u32),
    optional(0x1A01, 0, 1, From::Number, 0),
    optional(0x1A01, 1, 4, From::Number, 0x6061_0008),
    optional(0x1A01, 0, 1, From::Number, 1),
    optional(0x1801, 1, 4, From::Node, 0x4000_0000 | MODE_REPORT as u32),
    // Its other default PDOs would use bus time.
    optional(0x1802, 1, 4, From::Node, 0xC000_0380),
    optional(0x1803, 1, 4, From::Node, 0xC000_0480),
    // Command: control word and target, at once.
    object(0x1400, 1, 4, From::Node, 0x8000_0000 | COMMAND as u32),
    // 255: takes effect on reception, without waiting for a SYNC.
    optional(0x1400, 2, 1, From::Number, 255),
    object(0x1600, 0, 1, From::Number, 0),
    object(0x1600, 1, 4, From::Number, 0x6040_0010),
    object(0x1600, 2, 4, From::Target, 0),
    object(0x1600, 0, 1, From::Number, 2),
    object(0x1400, 1, 4, From::Node, COMMAND as u32),
    // Heartbeats: its own, and the board's, without which it stops by itself after 200 ms.
    object(0x1017, 0, 2, From::Number, BEAT_MS),
    optional(
        0x1016,
        1,
        4,
        From::Number,
        ((BOARD_NODE as u32) << 16) | 200,
    ),
    // Its reaction to that, and to a stop: disable voltage.
    // 2 is "disable voltage": the brake, not a ramp of the drive, stops the drum.
    optional(0x6007, 0, 2, From::Number, 2),
    object(0x6060, 0, 1, From::Mode, 0),
    // The motor's rated current, mA: torques on the bus are thousandths of it.
    object(0x6075, 0, 4, From::Drive, 0),
    optional(0x6072, 0, 2, From::Torque, 0),
    optional(0x6080, 0, 4, From::Speed, 0),
    // Commands come at equal intervals: the drive interpolates.
    optional(0x60C2, 1, 1, From::Period, 0),
];

fn setup(step: u8) -> Option<&'static Object> {
    SETUP.get(usize::from(step))
}

/// The number of a mode: cyclic synchronous position, torque, velocity.
pub(super) const fn mode_number(mode: Mode) -> u8 {
    match mode {
        // CiA 402, object 0x6060.
        Mode::Position => 8,
        Mode::Current => 10,
        Mode::Speed => 9,
    }
}

fn frame(id: u16, bytes: &[u8]) -> CanFrame {
    let mut frame = CanFrame {
        id,
        ..CanFrame::default()
    };
    for (to, from) in frame.data.iter_mut().zip(bytes) {
        *to = *from;
        frame.len += 1;
    }
    frame
}

/// Requests the feedback of every drive.
pub(super) fn sync() -> CanFrame {
    frame(SYNC, &[])
}

/// Removes the torque of a drive, whatever its state: NMT reset of the whole node (CiA 301).
pub(super) fn reset(node: u8) -> CanFrame {
    frame(NMT, &[RESET_NODE, node])
}

/// The board's heartbeat.
pub(super) fn beat() -> CanFrame {
    frame(HEARTBEAT | u16::from(BOARD_NODE), &[OPERATIONAL])
}

fn sdo(node: u8, command: u8, index: u16, sub: u8, value: u32) -> CanFrame {
    let [low, high] = index.to_le_bytes();
    let [a, b, c, d] = value.to_le_bytes();
    let bytes = [command, low, high, sub, a, b, c, d];
    frame(SDO_REQUEST | u16::from(node), &bytes)
}

/// Asks whether a drive is present: for its device type.
pub(super) fn probe(node: u8) -> CanFrame {
    sdo(node, 0x40, 0x1000, 0, 0)
}

/// The node that answers a probe.
pub(super) fn probed(received: &CanFrame) -> Option<u8> {
    let node = u8::try_from(received.id & 0x7F).ok()?;
    // A device type of profile 402: the lower half.
    let [_, low, high, _, profile_low, profile_high, ..] = received.data;
    // The answer must be to this question: index 0x1000, and 402 = 0x0192 in its lower half.
    let is_drive = [low, high] == [0x00, 0x10] && [profile_low, profile_high] == [0x92, 0x01];
    (received.id & 0x780 == SDO_ANSWER && is_drive).then_some(node)
}

fn set_up(drive: &Drive, cable: &CableConfig, object: &Object) -> CanFrame {
    let value = match object.from {
        From::Number if object.index == 0x1400 && drive.at_sync => AT_SYNC,
        From::Number => object.value,
        From::Node => object.value | u32::from(cable.node),
        From::Mode => u32::from(mode_number(Mode::of(cable))),
        From::Target => match Mode::of(cable) {
            Mode::Position => 0x607A_0020,
            Mode::Current => 0x6071_0010,
            Mode::Speed => 0x60FF_0020,
        },
        From::Syncs => u32::from(cable.syncs),
        From::Period => u32::from(cable.period_ticks),
        From::Torque => u32::from(thousandths(cable.max_current_ma, drive.rated_ma)),
        From::Speed => u32::from(cable.max_rpm),
        From::Drive => 0,
    };
    let command = match (object.from, object.size()) {
        (From::Drive, _) => 0x40,
        // Expedited, size given: 0x23 for four bytes, four more for each byte less.
        (_, size) => 0x23 | ((4 - size) << 2),
    };
    sdo(cable.node, command, object.index, object.sub(), value)
}

/// A current in thousandths of the drive's rated one, which CiA 402 uses for torque.
fn thousandths(ma: i32, rated_ma: i32) -> u16 {
    // 32,000 mA times 1000 are 3.2e7; a rated current of 0 would be one that the drive never reported.
    let share = ma * 1000 / rated_ma.max(1);
    crate::fixed::saturate_i16(share).cast_unsigned()
}

/// The control word that brings a drive from a state towards operation enabled.
fn onwards(status: u16) -> u16 {
    match status & STATE_BITS {
        // One state per command: 0x06 shutdown, 0x07 switch on, 0x0F enable operation.
        READY_TO_SWITCH_ON => 0x07,
        SWITCHED_ON | OPERATION_ENABLED => 0x0F,
        _ if status & NO_TORQUE_BITS == SWITCH_ON_DISABLED => 0x06,
        // An old fault: the edge from 0, which every drive receives while it is off, resets it
        // once.
        _ if status & NO_TORQUE_BITS == FAULT => 0x80,
        // Not ready, or stopping on its own: wait with the voltage disabled.
        _ => 0x00,
    }
}

/// The frame for the drive in its slot, and the drive's state after it is sent.
pub(super) fn next(drive: &Drive, cable: &CableConfig, demand: DriveDemand) -> Option<Step> {
    let node = cable.node;
    let wanted = mode_of(demand) == Some(Mode::of(cable));
    let nmt = |command| frame(NMT, &[command, node]);
    match drive.phase {
        // It has no supply yet, the drive still boots, or an answer is pending.
        Phase::Cold | Phase::Waiting | Phase::Setup if drive.timer > 0 => return None,
        // From a known state: a drive may have kept PDOs of an earlier configuration.
        Phase::Cold | Phase::Waiting => {
            return Some(Step::new(nmt(RESET_COMMUNICATION), Phase::Waiting, BOOT_MS));
        }
        Phase::Setup => {
            return Some(match setup(drive.step) {
                Some(object) => Step::new(set_up(drive, cable, object), Phase::Setup, ANSWER_MS),
                None => Step::new(nmt(START), Phase::Idle, LOST_MS),
            });
        }
        // It was started and is silent: it has lost its power since.
        Phase::Idle if drive.timer == 0 && drive.input.age_ms > LOST_MS => {
            return Some(Step::new(nmt(RESET_COMMUNICATION), Phase::Waiting, BOOT_MS));
        }
        Phase::Idle | Phase::Enabling | Phase::Enabled => {}
    }
    let obeys = is_enabled(drive) && drive.mode == drive.wanted_mode;
    let (control, then) = match drive.phase {
        // Disable voltage: torque goes at once, as STOP0 requires.
        _ if !wanted => (0x00, Phase::Idle),
        // A torque demand does not enable a drive that arming has not enabled.
        Phase::Idle if demand.gives_torque() => (0x00, Phase::Idle),
        // A drive that lost its state is not enabled again by itself: `has_failed` reports it (D2).
        Phase::Enabled => (if obeys { 0x0F } else { 0x00 }, Phase::Enabled),
        _ if obeys => (0x0F, Phase::Enabled),
        _ => (onwards(drive.status), Phase::Enabling),
    };
    let (target, bytes) = match demand {
        DriveDemand::Current { ma } => {
            let torque = thousandths(i32::from(ma), drive.rated_ma);
            (i32::from(torque.cast_signed()), 4)
        }
        DriveDemand::Position { counts, .. } => (counts, 6),
        // In turns per minute, as the largest speed of 0x6080 is.
        DriveDemand::Speed { rpm } => (i32::from(rpm), 6),
        // While enabling, the target is where the motor is: no jump when torque comes.
        _ => match Mode::of(cable) {
            Mode::Position => (drive.input.counts, 6),
            Mode::Current => (0, 4),
            Mode::Speed => (0, 6),
        },
    };
    let [low, high] = control.to_le_bytes();
    let [a, b, c, d] = target.to_le_bytes();
    let mut command = frame(COMMAND | u16::from(node), &[low, high, a, b, c, d]);
    // In torque mode the mapped PDO has four bytes: control word and 16 bits of torque.
    if bytes == 4 {
        command.len = 4;
        command.data = [low, high, a, b, 0, 0, 0, 0];
    }
    Some(Step::new(command, then, drive.timer))
}

/// Whether the drive reports operation enabled.
pub(super) fn is_enabled(drive: &Drive) -> bool {
    drive.status & STATE_BITS == OPERATION_ENABLED
}

/// Whether the drive reports a failure: a fault, or torque that was lost without a command.
pub(super) fn has_failed(drive: &Drive) -> bool {
    let obeys = is_enabled(drive) && drive.mode == drive.wanted_mode;
    drive.status & FAULT != 0 || (drive.phase == Phase::Enabled && !obeys)
}

/// Whether its heartbeat is missing.
pub(super) const fn is_quiet(drive: &Drive) -> bool {
    drive.quiet_ms > QUIET_MS
}

/// Takes a frame; returns whether it was this drive's feedback.
pub(super) fn take(drive: &mut Drive, received: &CanFrame) -> bool {
    // CiA 301's default identifiers: function in bits 7 to 10, node in bits 0 to 6.
    if received.id & 0x7F != u16::from(drive.node) {
        return false;
    }
    let [a, b, c, d, e, f, g, h] = received.data;
    match (received.id & 0x780, received.len) {
        (HEARTBEAT, 1) => {
            drive.quiet_ms = 0;
            if a == BOOT_UP {
                // Boot-up: the drive has lost its settings, by a reset or a dip of its supply.
                drive.phase = Phase::Setup;
                drive.step = 0;
                drive.timer = 0;
                drive.tells_mode = true;
                drive.at_sync = false;
                drive.emergency = 0;
            } else if a & 0x7F != OPERATIONAL && drive.phase as u8 > Phase::Idle as u8 {
                // Bit 7 may toggle. A drive that left the operational state ignores its PDOs.
                drive.phase = Phase::Cold;
            }
        }
        (SDO_ANSWER, 8) if drive.phase == Phase::Setup => answered(drive, received),
        (EMERGENCY, 8) => drive.emergency = u16::from_le_bytes([a, b]),
        (MODE_REPORT, 1..) => drive.mode = a,
        (FEEDBACK, 8) => {
            drive.status = u16::from_le_bytes([a, b]);
            let counts = i32::from_le_bytes([c, d, e, f]);
            let torque = i32::from(i16::from_le_bytes([g, h]));
            // 32,768 thousandths of 60 A are 1.97e9 in the product: it fits 32 bits.
            drive.input.current_ma = crate::fixed::saturate_i16(torque * drive.rated_ma / 1000);
            // Feedback is sampled at SYNC: whole periods lie between two samples, independent of
            // their arrival.
            let period = i32::from(drive.period_ms.max(1));
            let periods = (i32::from(drive.since_ms) + (period - 1) / 2) / period;
            // CiA 402 has a speed object, too, but the PDO's eight bytes are full.
            let moved = i64::from(counts.wrapping_sub(drive.input.counts));
            let rpm_ms = (moved * i64::from(drive.rpm_per_count_q16)) >> 16;
            drive.input.rpm = crate::fixed::saturate_i16(
                crate::fixed::saturate(rpm_ms) / (periods.max(1) * period),
            );
            drive.input.counts = counts;
            drive.since_ms = 0;
            return true;
        }
        _ => {}
    }
    false
}

/// An answer to a set-up request: continue, or start again.
fn answered(drive: &mut Drive, received: &CanFrame) {
    let Some(object) = setup(drive.step) else {
        return;
    };
    let [command, low, high, sub, a, b, c, d] = received.data;
    // An answer that arrives after its repetition belongs to an earlier object.
    if u16::from_le_bytes([low, high]) != object.index || sub != object.sub() {
        return;
    }
    let refused = command == 0x80;
    if refused && !object.is_optional() {
        // Arming reports it (D5). The start may have come too early: once more, later.
        drive.refused = Some(Refused {
            object: u32::from(object.index) << 8 | u32::from(sub),
            code: u32::from_le_bytes([a, b, c, d]),
        });
        drive.phase = Phase::Waiting;
        drive.timer = BOOT_MS;
        return;
    }
    match (object.index, refused) {
        (0x1801 | 0x1A01, true) => drive.tells_mode = false,
        // The same object again, with the other transmission type.
        (0x1400, true) if !drive.at_sync => {
            drive.at_sync = true;
            drive.timer = 0;
            return;
        }
        _ => {}
    }
    // It cannot report its mode: it is assumed to be in the one that it accepted.
    if object.index == 0x6060 && !drive.tells_mode {
        drive.mode = drive.wanted_mode;
    }
    if object.from == From::Drive && !refused {
        // More than 60 A is not plausible for these winches; 0 is not a rated current.
        let rated = i32::from_le_bytes([a, b, c, d]);
        drive.rated_ma = rated.clamp(1, 60_000);
    }
    drive.step += 1;
    drive.timer = 0;
    if setup(drive.step).is_none() {
        drive.refused = None;
    }
}
