//! The fault list of `mcdpr faults`: meaning and reaction of each row.

use mcdpr_protocol::FaultId;

/// Groups by the first letter of a row's id.
pub const GROUPS: [(char, &str); 8] = [
    ('L', "the link"),
    ('S', "sensors"),
    ('D', "drives"),
    ('B', "brakes"),
    ('P', "power and processor"),
    ('C', "cables"),
    ('K', "motion and commands"),
    ('F', "files, configuration and calibration"),
];

/// Reaction of the robot, or the program, to a fault.
#[must_use]
pub const fn reaction(fault: FaultId) -> &'static str {
    match fault {
        FaultId::L1 | FaultId::L6 | FaultId::L7 | FaultId::L8 => {
            "the frame is dropped and counted; the motion goes on from the board's buffer"
        }
        FaultId::L2 => "the value is refused: every number has a range, hashes confirm the rest",
        FaultId::L3 | FaultId::L5 => "asked for again; the motion goes on from the board's buffer",
        FaultId::L4 => "answered again, executed once",
        FaultId::L9 => "advice after 20 ms; the motion goes on from the board's buffer",
        FaultId::L10 | FaultId::L11 | FaultId::L12 | FaultId::L15 => {
            "after 100 ms it decelerates along its path, holds for 2 s, then brakes, torque off"
        }
        FaultId::L13 | FaultId::L14 => "refused by its session number; anyone may look and stop",
        FaultId::L16 => "telemetry is dropped; control never waits",
        FaultId::L17 | FaultId::F9 => "refused to arm",
        FaultId::S1 => "up to two samples are replaced by their prediction",
        FaultId::S3 | FaultId::K9 => "none needed",
        FaultId::S9 | FaultId::S10 => "advice in motion; out of its band at arming: refused",
        FaultId::S12 => "no motion follows the camera: it goes on by its lengths",
        FaultId::D1 | FaultId::P7 => "brakes and torque off at once (STOP0)",
        FaultId::S4 => {
            "the brake of this winch closes and its drive gives no torque, at once; the others stop along the path (STOP1)"
        }
        FaultId::D2 | FaultId::D3 | FaultId::D7 | FaultId::S6 => {
            "the brake of this winch closes at once, the others stop along the path (STOP1)"
        }
        FaultId::D5 => "arming is given up, brakes stay closed",
        FaultId::B1 => "arming is given up, brakes close",
        FaultId::B2 | FaultId::B3 => {
            "torque stays and holds the drum at its place; a late brake is tried again until it holds"
        }
        FaultId::P2 => "brakes close by their springs; nothing starts without arming",
        FaultId::P1 | FaultId::P3 | FaultId::P4 | FaultId::P6 => {
            "brakes close, the board starts again, without torque, in Fault with the cause"
        }
        FaultId::K1 | FaultId::K3 | FaultId::F1 | FaultId::F2 => "refused before anything moves",
        FaultId::K2 => "cannot be sent: all numbers are integers",
        FaultId::K4 | FaultId::K5 | FaultId::K7 | FaultId::K8 => "refused, nothing changes",
        FaultId::K6 => "it stops along the tangent of its path and holds",
        FaultId::K10 => "the stop wins",
        FaultId::F3 | FaultId::F4 => "cannot happen: the board stores nothing",
        FaultId::F5 => "outliers weigh little and are named",
        FaultId::F6 | FaultId::F7 => "the calibration is refused",
        FaultId::F8 => "a warning; motion goes on",
        _ => "it decelerates along its path, brakes close under torque, torque off (STOP1)",
    }
}
