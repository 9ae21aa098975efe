//! States and limits of a board in words for people.

use mcdpr_protocol::{BoardState, Limit};

/// Every limit, in the order of its bit.
pub const LIMITS: [Limit; 8] = [
    Limit::HeartbeatLate,
    Limit::CurrentSaturated,
    Limit::TensionOff,
    Limit::ResidualHigh,
    Limit::CableSlack,
    Limit::TelemetryDropped,
    Limit::BufferShort,
    Limit::TrimSaturated,
];

/// Meaning of a limit.
#[must_use]
pub const fn limit(limit: Limit) -> &'static str {
    match limit {
        Limit::HeartbeatLate => "the host's heartbeat is late",
        Limit::CurrentSaturated => "a motor current is at its limit",
        Limit::TensionOff => "a tension is far from what is expected",
        Limit::ResidualHigh => "lengths and tensions hardly fit together",
        Limit::CableSlack => "a cable is under its least tension",
        Limit::TelemetryDropped => "telemetry was dropped: the line is full",
        Limit::BufferShort => "the motion buffer is shorter than the braking distance",
        Limit::TrimSaturated => "motor and drum encoder drift apart",
        Limit::BrakeSlips => "a brake let its drum turn: torque stays on",
        Limit::TensionNoisy => "a tension reading is noisy",
        Limit::DriveWarns => "a drive warns",
        Limit::FaultLine => "the fault line is low",
    }
}

/// Meaning of a state.
#[must_use]
pub const fn state(state: BoardState) -> &'static str {
    match state {
        BoardState::Boot => "starting, everything is off",
        BoardState::Disarmed => "disarmed: brakes closed, torque off",
        BoardState::Arming => "arming: enabling drives and checking",
        BoardState::Holding => "holding still under tension",
        BoardState::Moving => "moving along its path",
        BoardState::Pausing => "slowing down to a hold",
        BoardState::Stopping => "stopping: brakes, then torque off",
        BoardState::Fault => "stopped by a fault, brakes closed",
        BoardState::EStop => "emergency stop is pressed",
    }
}
