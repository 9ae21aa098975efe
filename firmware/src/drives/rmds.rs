//! RoboModule RMDS: big-endian frames of eight bytes, filler 0x55.
//!
//! Identifier: group (3 bits), number (4 bits), function (4 bits); group and number together are
//! the configuration's node. Number 0 calls every drive of a group and is never used. A drive is
//! silent for half a second after a reset and takes half a second to enter a mode. Which drive the
//! paper used is inferred, and with it this protocol (`docs/paper-notes.md`).

use super::can::CanFrame;
use super::drive::{Drive, Mode, Phase, Step, mode_of};
use crate::config::CableConfig;
use crate::io::DriveDemand;

/// Milliseconds of silence after a reset.
pub(crate) const RESET_MS: u16 = 500;
/// Milliseconds from the choice of a mode until its commands are obeyed.
pub(crate) const MODE_MS: u16 = 500;
/// Slack: a frame may wait for the bus.
const SLACK_MS: u16 = 10;
/// A drive that was told to answer and does not for so long has lost its power: start again.
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

/// Asks whether a drive is there.
pub(super) fn probe(node: u8) -> CanFrame {
    frame(node, ONLINE, &[])
}

/// The node that answers a probe.
pub(super) fn probed(received: &CanFrame) -> Option<u8> {
    // Number 0 is nobody's own.
    let is_answer = received.id & 0xF == ONLINE && received.id & 0xF0 != 0;
    is_answer.then(|| (received.id >> 4).to_le_bytes()[0])
}

/// What goes to the drive in its slot, and what it makes of the drive once it is on its way.
pub(super) fn next(drive: &Drive, cable: &CableConfig, demand: DriveDemand) -> Option<Step> {
    let node = cable.node;
    let reset = Step::new(frame(node, RESET, &[]), Phase::Waiting, RESET_MS + SLACK_MS);
    let wanted = mode_of(demand);
    match drive.phase {
        Phase::Cold => Some(reset),
        Phase::Waiting if drive.timer == 0 => {
            let start = [cable.period_ticks, 0];
            Some(Step::new(
                frame(node, CONFIGURE, &start),
                Phase::Idle,
                LOST_MS,
            ))
        }
        Phase::Idle if drive.timer == 0 && drive.input.age_ms > LOST_MS => Some(reset),
        // There is no command "off": a reset takes the torque whatever the drive does. So does a
        // change of mind.
        Phase::Enabling if wanted != Some(Mode::of(cable)) => Some(reset),
        Phase::Idle => {
            // Torque that is asked of a drive that was not enabled never comes by itself; and a
            // drive that does not answer is not enabled.
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

/// Whether the drive obeys.
pub(super) fn is_ready(drive: &Drive) -> bool {
    drive.phase == Phase::Enabling && drive.timer == 0
}

/// What a drive has fed back.
pub(super) struct Feedback {
    node: u16,
    current_ma: i16,
    rpm: i16,
    counts: i32,
}

/// The feedback that a frame is.
pub(super) fn feedback(received: &CanFrame) -> Option<Feedback> {
    let [a, b, c, d, e, f, g, h] = received.data;
    let is_feedback = received.id & 0xF == FEEDBACK && received.len == 8;
    is_feedback.then(|| Feedback {
        node: received.id >> 4,
        current_ma: i16::from_be_bytes([a, b]),
        rpm: i16::from_be_bytes([c, d]),
        counts: i32::from_be_bytes([e, f, g, h]),
    })
}

/// Takes feedback in, if it is this drive's.
pub(super) fn take(drive: &mut Drive, feedback: &Feedback) {
    if feedback.node == u16::from(drive.node) {
        let input = &mut drive.input;
        (input.current_ma, input.rpm) = (feedback.current_ma, feedback.rpm);
        input.counts = feedback.counts;
        input.age_ms = 0;
    }
}
