//! Which names are right for an injected fault, and which faults are not noticed, by docs/faults.md.

use super::super::Injection;
use super::{Drawn, Moment};
use mcdpr_core::link::ClientError;
use mcdpr_core::motion::Model;
use mcdpr_core::robot::DriveKind;
use mcdpr_core::run::RunError;
use mcdpr_protocol::FaultId;

/// Whether a fault got its right name, and the right cable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RightName {
    /// The fault is one that docs/faults.md gives for what was injected.
    pub fault: bool,
    /// And its cable is the one into which it was injected, where the fault has a cable.
    pub cable: bool,
}

/// Judges a fault and its cable (1 for the first, 0 for none); of two injections, either may be named.
pub(super) fn judge(model: &Model, drawn: &Drawn, (name, cable): (FaultId, u8)) -> RightName {
    let mut best = RightName::default();
    for injection in &drawn.injections {
        let fault = accepted(model, injection, drawn.moment).contains(&name);
        let cable = cable == 0 || usize::from(cable) == injection.cable + 1;
        // A fault of the whole robot has no cable; the drives that report it first have theirs.
        let whole = matches!(
            injection.fault,
            FaultId::P2 | FaultId::D1 | FaultId::C5 | FaultId::P7 | FaultId::C2
        );
        if fault {
            best.fault = true;
            best.cable |= cable || whole;
        }
    }
    best
}

/// Judges an error of the host's program where the board latched nothing. A board without torque latches no loss of its
/// host: that it does not answer is the name then.
pub(super) fn judge_refusal(injections: &[Injection], error: &RunError) -> RightName {
    let unanswered = matches!(
        error,
        RunError::Client(ClientError::Silent | ClientError::Lost { .. })
    );
    let of_line = |injection: &Injection| {
        use FaultId as F;
        matches!(
            injection.fault,
            F::L8 | F::L10 | F::L11 | F::L12 | F::L15 | F::L16 | F::L18
        )
    };
    let right = unanswered && injections.iter().any(of_line);
    RightName {
        fault: right,
        cable: right,
    }
}

/// The names that docs/faults.md gives for an injected row, in this phase.
fn accepted(model: &Model, injection: &Injection, moment: Moment) -> Vec<FaultId> {
    use FaultId as F;
    let robot = model.robot();
    let by_tension = model.holding().by_tension().contains(&injection.cable);
    let winch = robot.winch_of(injection.cable);
    let rmds = winch.is_some_and(|winch| winch.drive == DriveKind::Rmds);
    let at_rest = matches!(
        moment,
        Moment::Off | Moment::Arming | Moment::Parked | Moment::Rearming
    );
    match injection.fault {
        // Nearly nothing arrives: noise, or silence.
        F::L8 => vec![F::L8, F::L10, F::L18],
        F::L11 | F::L12 | F::L15 => vec![F::L10],
        // A host that hears nothing sends nothing more: the motion runs out first.
        F::L16 => vec![F::L10, F::K6],
        // Open inputs are a count that stands.
        F::S6 => vec![F::S6, F::S2],
        F::S5 => vec![F::S5, F::C1],
        // An RMDS reports no fault: it does not follow its commands.
        F::D2 if rmds => vec![F::D2, F::D7],
        // A brake that drags more than its motor can turn is a closed one.
        F::D4 => vec![F::D4, F::B1],
        // Before it has come up, a drive that does not answer, or does nothing, is one that never comes up.
        F::D3 if at_rest => vec![F::D3, F::D5],
        // It keeps its last current.
        F::D7 => [
            &[F::D7][..],
            if by_tension {
                &[F::S4, F::C1, F::C2]
            } else {
                &[]
            },
            if at_rest { &[F::D5] } else { &[] },
        ]
        .concat(),
        F::B2 => vec![F::B2, F::C1, F::S10],
        F::C1 => vec![F::C1, F::S5],
        F::C2 => vec![F::C2, F::C1],
        // Nobody saw it break: the board finds a slack cable.
        F::C3 if matches!(moment, Moment::Off | Moment::Parked) => vec![F::C3, F::C1],
        F::C4 => vec![F::C4, F::S5],
        other => vec![other],
    }
}

/// Why docs/faults.md ("What need not be reported") says that this fault is not noticed; `None` where it
/// must be.
pub(super) fn silent(model: &Model, injection: &Injection, moment: Moment) -> Option<&'static str> {
    use FaultId as F;
    let strength = injection.strength;
    let in_motion = matches!(moment, Moment::Moving | Moment::Blending);
    match injection.fault {
        F::L1 | F::L3 | F::L4 | F::L9 => Some("the link's protocol repairs it"),
        F::S1 => Some("single readings are replaced"),
        F::S9 => Some("advice"),
        // An eighth of the range at full strength: refused beyond 2 N or a fifth of the tension, at
        // arming only.
        F::S10 if moment != Moment::Off || strength < 0.7 => Some("advice once it is armed"),
        F::D4 if !in_motion || strength < 1.0 => Some("a motor at rest is not saturated"),
        F::D5 if moment != Moment::Off => Some("its drives are up"),
        F::B3 => Some("a brake that is late while torque holds the drum turns nothing"),
        F::C1 if SLIP_M * strength < CLOSURE_M && is_pulled_down(model) => {
            Some("a short slip of a cable that others pull tight")
        }
        F::C2 => Some("the cable need not come over its limit"),
        F::C4 => Some("there is no detector for it"),
        F::C5 if !in_motion || strength < 1.0 => Some("contact is looked for in motion"),
        F::C5 if is_pulled_down(model) => Some("losses of cables that pull down may be as large"),
        _ => None,
    }
}

/// Cable that slips off the drum at full strength (C1), m.
const SLIP_M: f64 = 0.005;
/// A slip under this is not reported by the closure of lengths and tensions (docs/faults.md, S5), m.
const CLOSURE_M: f64 = 0.004;

/// Whether cables are tight against each other: one leaves the platform downwards where it is at home.
fn is_pulled_down(model: &Model) -> bool {
    let robot = model.robot();
    let home_m = robot.tool.home_in_world_m.z;
    robot
        .cables
        .iter()
        .any(|cable| cable.anchor_in_world_m.z < home_m)
}
