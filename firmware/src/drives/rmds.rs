//! RoboModule RMDS: big-endian frames of eight bytes, filler 0x55.
//!
//! Identifier: group (3 bits), number (4 bits), function (4 bits); group and number together are
//! the configuration's node. Number 0 addresses every drive of a group and is not used. A drive is
//! silent for half a second after a reset and takes half a second to enter a mode. The type of the
//! paper's drive is inferred, and with it this protocol (`docs/paper-notes.md`).

use super::can::CanFrame;
use super::drive::{Drive, Mode, Phase, Step, mode_of};
use crate::config::CableConfig;
use crate::io::DriveDemand;

/// Milliseconds of silence after a reset.
pub(crate) const RESET_MS: u16 = 500;
/// Milliseconds from the choice of a mode until its commands take effect.
pub(crate) const MODE_MS: u16 = 500;
/// Allowance: a frame may wait for the bus.
const SLACK_MS: u16 = 10;
/// A drive that was commanded to answer and does not for this long has lost its power: start again.
// 100 ms: fifty periods of 2 ms without a single feedback.
const LOST_MS: u16 = 100;

const FILL: [u8; 8] = [0x55; 8];
const RESET: u16 = 0x0;
const MODE: u16 = 0x1;
const CURRENT: u16 = 0x3;
const SPEED: u16 = 0x4;
const SPEED_AND_POSITION: u16 = 0x6;
const CONFIGURE: u16 = 0xA;
const FEEDBACK: u16 = 0xB;
const ONLINE: u16 = 0xF;
/// The whole supply voltage.
// 5000 is the full voltage: the current or speed limits, not the voltage, bound the motor.
const PWM: [u8; 2] = 5000_u16.to_be_bytes();

fn frame(node: u8, function: u16, start: &[u8]) -> CanFrame {
    let mut data = FILL;
    for (to, from) in data.iter_mut().zip(start) {
        *to = *from;
    }
    CanFrame {
        id: (u16::from(node) << 4) | function,
        len: 8,
        data,
    }
}

/// Removes the torque of a drive, whatever its state.
pub(super) fn reset(node: u8) -> CanFrame {
    frame(node, RESET, &[])
}

/// Asks whether a drive is present.
pub(super) fn probe(node: u8) -> CanFrame {
    frame(node, ONLINE, &[])
}

/// The node that answers a probe.
pub(super) fn probed(received: &CanFrame) -> Option<u8> {
    // Number 0 does not belong to a drive.
    let is_answer = received.id & 0xF == ONLINE && received.id & 0xF0 != 0;
    is_answer.then(|| (received.id >> 4).to_le_bytes()[0])
}

/// The frame for the drive in its slot, and the drive's state after it is sent.
pub(super) fn next(drive: &Drive, cable: &CableConfig, demand: DriveDemand) -> Option<Step> {
    let node = cable.node;
    let again = Step::new(reset(node), Phase::Waiting, RESET_MS + SLACK_MS);
    let wanted = mode_of(demand);
    match drive.phase {
        Phase::Cold if drive.timer == 0 => Some(again),
        Phase::Waiting if drive.timer == 0 => {
            // Feedback comes by itself at this interval, ms.
            let start = [cable.period_ticks, 0];
            Some(Step::new(
                // A drive that restarts has forgotten it: therefore it is sent after every reset.
                frame(node, CONFIGURE, &start),
                Phase::Idle,
                LOST_MS,
            ))
        }
        Phase::Idle if drive.timer == 0 && drive.input.age_ms > LOST_MS => Some(again),
        // There is no command "off": only a reset removes the torque in every state. The same is
        // needed for a change of mode.
        Phase::Enabling if wanted != Some(Mode::of(cable)) => Some(again),
        Phase::Idle => {
            // A torque demand does not enable a drive that arming has not enabled; and a drive that
            // does not answer is not enabled.
            let answers = drive.input.age_ms <= LOST_MS;
            let asked = !demand.gives_torque() && wanted == Some(Mode::of(cable)) && answers;
            let mode = match wanted? {
                Mode::Position => 5,
                Mode::Current => 2,
                Mode::Speed => 3,
            };
            asked.then(|| {
                Step::new(
                    frame(node, MODE, &[mode]),
                    Phase::Enabling,
                    MODE_MS + SLACK_MS,
                )
            })
        }
        Phase::Enabling if drive.timer == 0 => {
            let [high, low] = PWM;
            let sent = match demand {
                DriveDemand::Position { counts, rpm } => {
                    let [rpm_high, rpm_low] = rpm.to_be_bytes();
                    let [a, b, c, d] = counts.to_be_bytes();
                    let start = [high, low, rpm_high, rpm_low, a, b, c, d];
                    frame(node, SPEED_AND_POSITION, &start)
                }
                DriveDemand::Current { ma } => {
                    let [ma_high, ma_low] = ma.to_be_bytes();
                    frame(node, CURRENT, &[high, low, ma_high, ma_low])
                }
                DriveDemand::Speed { rpm } => {
                    let [rpm_high, rpm_low] = rpm.to_be_bytes();
                    frame(node, SPEED, &[high, low, rpm_high, rpm_low])
                }
                _ => return None,
            };
            Some(Step::new(sent, Phase::Enabling, 0))
        }
        _ => None,
    }
}

/// Whether the drive follows commands.
pub(super) fn is_ready(drive: &Drive) -> bool {
    // The drive acknowledges no mode: only the time since the choice shows that it is in effect.
    drive.phase == Phase::Enabling && drive.timer == 0
}

/// Feedback of a drive.
pub(super) struct Feedback {
    node: u16,
    current_ma: i16,
    rpm: i16,
    counts: i32,
}

/// Decodes a frame as feedback.
pub(super) fn feedback(received: &CanFrame) -> Option<Feedback> {
    let [a, b, c, d, e, f, g, h] = received.data;
    // All eight bytes: a shorter frame is another message with the same function.
    let is_feedback = received.id & 0xF == FEEDBACK && received.len == 8;
    is_feedback.then(|| Feedback {
        node: received.id >> 4,
        current_ma: i16::from_be_bytes([a, b]),
        rpm: i16::from_be_bytes([c, d]),
        counts: i32::from_be_bytes([e, f, g, h]),
    })
}

/// Takes feedback, if it is this drive's.
pub(super) fn take(drive: &mut Drive, feedback: &Feedback) {
    if feedback.node == u16::from(drive.node) {
        let input = &mut drive.input;
        (input.current_ma, input.rpm) = (feedback.current_ma, feedback.rpm);
        input.counts = feedback.counts;
        input.age_ms = 0;
    }
}
