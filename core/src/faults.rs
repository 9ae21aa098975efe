//! Faults and refusals in words: what happened, with the numbers, and what to do.

use mcdpr_protocol::{FaultId, FaultRecord, KeyMeaning, Reject, Request};

/// The data of a latched fault: id, cable, numbers.
#[must_use]
pub fn describe_fault(record: &FaultRecord) -> String {
    let cable = match record.cable {
        0 => String::new(),
        cable => format!(" on cable {cable}"),
    };
    let id = record.fault;
    let numbers = match id {
        // Without a limit, arming found it: no motion was commanded yet.
        FaultId::S2 | FaultId::D7 if record.limit > 0 => format!(
            ": {:.2} mm behind its command, limit {:.2} mm",
            f64::from(record.value) * 1e-3,
            f64::from(record.limit) * 1e-3
        ),
        // With a limit, the motor's current or speed revealed it; otherwise the drive reported it.
        FaultId::D2 if record.limit > 0 => format!(
            ": the motor gives {:.0} % of what is commanded",
            // The board's limit is a quarter of the command.
            25.0 * f64::from(record.value) / f64::from(record.limit)
        ),
        FaultId::S5 => format!(
            ": closure error {:.2} mm, limit {:.2} mm",
            f64::from(record.value) * 1e-3,
            f64::from(record.limit) * 1e-3
        ),
        FaultId::C1 | FaultId::C2 => format!(
            ": {:.2} N, limit {:.2} N",
            f64::from(record.value) * 1e-3,
            f64::from(record.limit) * 1e-3
        ),
        FaultId::S10 => format!(
            ": reads {:.2} N where the static model expects {:.2} N",
            f64::from(record.value) * 1e-3,
            f64::from(record.limit) * 1e-3
        ),
        FaultId::S7 | FaultId::S8 => format!(
            ": reads {:.3} V, limit {:.3} V",
            f64::from(record.value) * 3.3 / 65_536.0,
            f64::from(record.limit) * 3.3 / 65_536.0
        ),
        // A refused object of its set-up, not a time: the lowest object index is 0x1000.
        FaultId::D5 if record.limit >= 0x10_0000 => format!(
            ": it refuses object {:04x}:{:02x} with abort code 0x{:08x}",
            record.limit >> 8,
            record.limit & 0xFF,
            record.value
        ),
        FaultId::P2 if record.limit > 0 => {
            format!(
                ": no drive answers ({} ms, limit {} ms)",
                record.value, record.limit
            )
        }
        id if is_of_board(id) && record.cable == 0 && record.value > 0 => {
            format!(" (told by board {})", record.value)
        }
        FaultId::L10 | FaultId::D3 | FaultId::D5 => {
            format!(" for {} ms, limit {} ms", record.value, record.limit)
        }
        _ => String::new(),
    };
    format!("{}: {}{cable}{numbers}", id.name(), id.what())
}

/// Whether a board tells this fault without cable and numbers: of a robot with several boards, `value` is the number of
/// the board that told it, 1 for the first.
#[must_use]
pub(crate) const fn is_of_board(fault: FaultId) -> bool {
    matches!(
        fault,
        FaultId::L19 | FaultId::P1 | FaultId::P4 | FaultId::K6
    )
}

/// What to do about a fault.
#[must_use]
pub const fn advice(fault: FaultId) -> &'static str {
    match fault {
        FaultId::L1 | FaultId::L3 | FaultId::L6 | FaultId::L7 | FaultId::L8 => {
            "nothing, while it is rare; if the counters rise, take a shorter or shielded cable and keep it away from the motors"
        }
        FaultId::L2 => "use a program and a firmware of the same version; if both are, report it",
        FaultId::L4 | FaultId::L5 => {
            "nothing: the bridge repeats or reorders; if it goes on, take another one"
        }
        FaultId::L9 | FaultId::L10 | FaultId::L12 | FaultId::L15 => {
            "the board held by itself; see why the host stopped (sleep, crash, cable), connect again and re-arm"
        }
        FaultId::L11 => "plug the line in again and fix it; then clear the fault and re-arm",
        FaultId::L13 => "clear the fault and arm again: the session of the old program is over",
        FaultId::L14 => "end the other program, or only look on; `mcdpr stop` works from anywhere",
        FaultId::L16 => {
            "close what keeps this program from reading; the record shows what is missing"
        }
        FaultId::L17 => {
            "`cargo flash-fw` writes this program's firmware, or take the program of the board's version"
        }
        FaultId::L18 => {
            "check the serial line's ground, shield and plugs, keep it away from the motors, then clear the fault"
        }
        FaultId::L19 => {
            "another board stopped first, has no supply or was reset, or the fault line's plug is off: look at the other boards, then clear the fault"
        }
        FaultId::S1 => {
            "nothing, while it is rare; if it goes on, look at the encoder cable's shield"
        }
        FaultId::S2 | FaultId::S6 => {
            "check the drum encoder's plug, supply and coupling; the motor turned but the encoder did not. At arming, behind a gear with play: the brake, too"
        }
        FaultId::S3 | FaultId::K9 => "nothing: it is normal",
        FaultId::S4 => {
            "swap the encoder's A and B or change encoder_sign; `mcdpr commission` finds out which"
        }
        FaultId::S5 | FaultId::C4 => {
            "a cable slipped or is mis-wound: look at the drums, then re-reference the lengths"
        }
        FaultId::S7 | FaultId::S11 => {
            "check the tension sensor's plug and amplifier; the reading cannot be true"
        }
        FaultId::S8 => {
            "check the tension sensor's plug and amplifier; where every sensor reads 0 V, the board's own supply: it is not within 3.0 to 3.6 V"
        }
        FaultId::S9 => {
            "look at the sensor's shield and amplifier; `mcdpr tune tension` shows the noise"
        }
        FaultId::S10 => {
            "check that the robot hangs where it was said to be, and the sensor's zero (tension_zero_v)"
        }
        FaultId::S12 => "clean the lens, light the tag, look whether one hides it; then look again",
        FaultId::D1 | FaultId::D2 | FaultId::D3 => {
            "check the drive's supply, CAN plugs and termination, then clear the fault"
        }
        FaultId::D4 => "the motor gives all it can: less load, less acceleration, or free a jam",
        FaultId::D5 => {
            "the drive did not come up: check its supply, its number on the bus and the CAN wiring; a refused object is in its manual with its abort code"
        }
        FaultId::D6 => "let the drive cool; less load, slower, or more air",
        FaultId::D7 => {
            "the drum did not follow its command: check the motor's plug, the drive, the brake and for a jam"
        }
        FaultId::B1 => {
            "check the brake's supply and coil, it must click when the robot arms; turn the drum by hand, it may be jammed"
        }
        FaultId::B2 => {
            "the robot is held by torque: lower it by a motion (clear the fault first), or hold the platform by other means, then give an emergency stop; clean or replace the brake"
        }
        FaultId::B3 => {
            "hold the platform by other means before you switch off; check the brake's spring, its gap and its diode"
        }
        FaultId::P1 => {
            "check the supply under load, clear the fault, then `mcdpr recover`: the board may have kept its lengths"
        }
        FaultId::P2 => {
            "no drive answers: check their supply and the CAN plug at the board; then reference the lengths and arm"
        }
        FaultId::P3 | FaultId::P4 => {
            "`mcdpr doctor` shows the firmware's last message; report it; then clear the fault, reference the lengths and re-arm"
        }
        FaultId::P5 => "report it with the record; then clear the fault and re-arm",
        FaultId::P6 => {
            "check the board's crystal; then clear the fault, reference the lengths and re-arm"
        }
        FaultId::P7 => "release the emergency stop, look around, then clear the fault",
        FaultId::C1 => "the cable is slack: check that it lies on its pulleys, then tension it up",
        FaultId::C2 => "the cable is snagged or pulled against another: free it before you clear",
        FaultId::C3 => {
            "keep clear of the platform, hold it up, put in a new cable (`mcdpr rig`) and reference the lengths"
        }
        FaultId::C5 => "see what the platform touches or carries; free it, then clear the fault",
        FaultId::K1 => "choose a target inside: `mcdpr workspace` shows where the robot can go",
        FaultId::K2 => "correct the number in the file that the message names",
        FaultId::K3 => {
            "a slower or smoother task, or limits in the robot file that the winches can keep"
        }
        FaultId::K4 => "plan again from where the robot is now",
        FaultId::K5 | FaultId::K7 => "report it with the record: the program sends no such motion",
        FaultId::K6 => "the host could not feed the motion in time: close other programs",
        FaultId::K8 => "do what the message says first: mostly arm, stop or clear",
        FaultId::K10 => "nothing: the robot was at rest; start again if needed",
        FaultId::F1 | FaultId::F2 => {
            "correct the line of the file that the message names; `mcdpr config check` checks the whole file"
        }
        FaultId::F3 | FaultId::F4 => "nothing: it cannot happen",
        FaultId::F5 => {
            "look at the named rows; a few are left out by themselves, many mean a moved camera or tag"
        }
        FaultId::F6 => {
            "collect poses that differ more, or hold the parameters that the message names"
        }
        FaultId::F7 => "collect the named rows again, or take the repeated ones out",
        FaultId::F8 => "make room, then start a new record; the motion was not disturbed",
        FaultId::F9 => "use the calibration of this robot, or calibrate it again",
    }
}

/// Why a request was refused, in words.
#[must_use]
pub fn describe_reject(reject: &Reject) -> String {
    match reject {
        Reject::WrongState { state } => format!("not possible while {state:?}"),
        Reject::SessionHeld => "another host holds the board".to_owned(),
        Reject::NoSession => "this session does not hold the board".to_owned(),
        Reject::Sequence { expected } => format!("out of order, it waits for {}", expected.0),
        Reject::Unsupported => "this board does not support the request".to_owned(),
        Reject::CableCount { expected, got } => {
            format!("it drives {expected} cables, not {got}")
        }
        Reject::NotConfigured => "it has no configuration".to_owned(),
        Reject::ConfigHash { board, host } => {
            format!("its configuration is {:08x}, not {:08x}", board.0, host.0)
        }
        Reject::ConfigSequence => "configuration entries are missing or out of order".to_owned(),
        Reject::ConfigUnknownKey { key } => format!("unknown configuration key {key:#06x}"),
        Reject::ConfigValue { key } => match mcdpr_protocol::ConfigKey(*key).meaning() {
            Some(KeyMeaning::Board(key)) => format!("{} is out of range", key.name()),
            Some(KeyMeaning::Cable(index, key)) => {
                format!("{} of cable {} is out of range", key.name(), index + 1)
            }
            None => format!("configuration key {key:#06x} is out of range"),
        },
        Reject::NotReferenced => "it does not know the cable lengths".to_owned(),
        Reject::BufferFull => "its motion buffer is full".to_owned(),
        Reject::KnotIndex { expected } => format!("knot {expected} must come first"),
        Reject::KnotTime { earliest_ms } => {
            format!("the knot's time lies before {earliest_ms} ms or too far ahead")
        }
        Reject::KnotStart { cable, gap } => format!(
            "the motion starts {:.3} mm from where cable {cable} is",
            gap.metres() * 1e3
        ),
        Reject::KnotLength { cable } => format!("the length of cable {cable} is out of range"),
        Reject::KnotSpeed { cable } => format!("cable {cable} would be too fast"),
        Reject::KnotAcceleration { cable } => format!("cable {cable} would accelerate too much"),
        Reject::KnotJerk { cable } => format!("cable {cable} would accelerate too abruptly"),
        Reject::Configured => {
            "the board has a configuration: only one that was just started tries its bus and its outputs"
                .to_owned()
        }
        Reject::KnotTension { cable } => format!("the tension of cable {cable} is out of range"),
        Reject::KnotEnd => "the motion has ended, or does not end at rest".to_owned(),
        Reject::NothingToStart => "there is no motion to start".to_owned(),
        Reject::Faulted { record } => format!("a fault is latched, {}", describe_fault(record)),
        Reject::CauseRemains { fault } => {
            format!(
                "the cause of {} is still there: {}",
                fault.name(),
                fault.what()
            )
        }
    }
}

pub(crate) fn reject_advice(reject: &Reject) -> String {
    match reject {
        Reject::SessionHeld => {
            "end the other program; a board whose host died is free again after about three seconds"
                .to_owned()
        }
        Reject::Faulted { record } => advice(record.fault).to_owned(),
        Reject::CauseRemains { fault } => advice(*fault).to_owned(),
        Reject::ConfigValue { .. } => "correct the value in the robot file".to_owned(),
        Reject::CableCount { .. } => "use the robot file of this machine".to_owned(),
        Reject::WrongState { .. } => {
            "wait for the robot to come to rest, or stop it first".to_owned()
        }
        _ => "nothing was changed; this is likely a mistake of the program, please report it"
            .to_owned(),
    }
}

/// What a request asks for, as it follows "the board refused".
pub(crate) fn request_name(request: &Request) -> String {
    let text = match request {
        Request::Info => "to report its identity",
        Request::Status => "to report its state",
        Request::Open => "the connection",
        Request::Close => "to end the connection",
        Request::Heartbeat { .. } => "the heartbeat",
        Request::Stop(_) => "to stop",
        Request::ConfigBegin { .. } | Request::ConfigPut { .. } | Request::ConfigCommit { .. } => {
            "the configuration"
        }
        Request::Reference { .. } => "the reference lengths",
        Request::Arm { .. } => "to arm",
        Request::Disarm => "to disarm",
        Request::Knot(knot) => return format!("knot {} of the motion", knot.index),
        Request::Start => "to start the motion",
        Request::Resume => "to go on",
        Request::Discard => "to discard the motion",
        Request::ClearFault => "to clear the fault",
        Request::Samples { .. } => "the samples",
        Request::Gripper { .. } => "the gripper command",
        Request::Service { cable, .. } => return format!("to enable winch {cable} alone"),
        Request::Winch { cable } => return format!("to report the state of winch {cable}"),
        Request::Scan { .. } => "to look for drives",
        Request::Bench { .. } => "the self-test",
        Request::Kept => "to report the lengths that it kept",
    };
    text.to_owned()
}
