//! The supervisor: the permitted transitions, as one table of states and events.
//!
//! `transition` is complete, without side effects, and defined for every state and event; [`TABLE`]
//! can be printed. The controller decides the outputs of a state; the next state is decided only
//! here. A stop always has priority: it is possible in every state.

pub use mcdpr_protocol::BoardState as State;
use mcdpr_protocol::FaultId;

/// Everything that can change the state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Event {
    /// The first tick ran.
    Booted,
    /// A host asks to arm (the configuration is agreed).
    Arm,
    /// Every check of arming passed.
    Armed,
    /// A host asks to start the buffered motion.
    Start,
    /// The motion's last knot is reached.
    MotionDone,
    /// A host asks to hold, or a fault asks for it.
    Hold,
    /// A host asks to resume.
    Resume,
    /// A deceleration has ended.
    AtRest,
    /// A host asks to stop, or to disarm, or a fault asks for it (STOP1).
    Stop,
    /// Drive control is lost, or a host asks for an emergency stop (STOP0).
    Emergency,
    /// Brakes are closed and torque is off.
    TorqueOff,
    /// A brake does not hold its load: torque must stay on.
    BrakeFails,
    /// A host acknowledges the fault and its cause is gone.
    Clear,
    /// The emergency stop was pressed.
    EStopPressed,
    /// The emergency stop was released.
    EStopReleased,
}

impl Event {
    /// Every event, in the order of the table's columns.
    pub const ALL: [Self; 15] = [
        Self::Booted,
        Self::Arm,
        Self::Armed,
        Self::Start,
        Self::MotionDone,
        Self::Hold,
        Self::Resume,
        Self::AtRest,
        Self::Stop,
        Self::Emergency,
        Self::TorqueOff,
        Self::BrakeFails,
        Self::Clear,
        Self::EStopPressed,
        Self::EStopReleased,
    ];
}

/// Every state, in the order of the table's rows.
pub const STATES: [State; 9] = [
    State::Boot,
    State::Disarmed,
    State::Arming,
    State::Holding,
    State::Moving,
    State::Pausing,
    State::Stopping,
    State::Fault,
    State::EStop,
];

/// Effect of an event in a state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cell {
    /// The event is not allowed here: a request is refused, a detection is ignored.
    No,
    /// Accepted, the state stays.
    Stay,
    /// Accepted, with this state next.
    To(State),
    /// Accepted; `Fault` if a fault is latched, else `Disarmed`.
    Settle,
}

use Cell::{No, Settle, Stay, To};
use State::{Arming, Disarmed, EStop, Fault, Holding, Moving, Pausing, Stopping};

/// Rows: [`STATES`]; columns: [`Event::ALL`].
#[rustfmt::skip]
pub const TABLE: [[Cell; 15]; 9] = [
//              Booted        Arm         Armed        Start       MotionDone   Hold         Resume      AtRest       Stop          Emergency   TorqueOff  BrakeFails   Clear         EStopPressed EStopReleased
/* Boot     */ [Settle,       No,         No,          No,         No,          No,          No,         No,          Stay,         Stay,       No,        No,          No,           To(EStop),   No],
/* Disarmed */ [No,           To(Arming), No,          No,         No,          No,          No,         No,          Stay,         Settle,     No,        No,          Stay,         To(EStop),   No],
/* Arming   */ [No,           No,         To(Holding), No,         No,          To(Stopping),No,         No,          To(Stopping), To(Fault),  No,        No,          No,           To(EStop),   No],
/* Holding  */ [No,           No,         No,          To(Moving), No,          Stay,        To(Moving), No,          To(Stopping), To(Fault),  No,        No,          Stay,         To(EStop),   No],
/* Moving   */ [No,           No,         No,          No,         To(Holding), To(Pausing), No,         No,          To(Stopping), To(Fault),  No,        No,          No,           To(EStop),   No],
/* Pausing  */ [No,           No,         No,          No,         No,          Stay,        No,         To(Holding), To(Stopping), To(Fault),  No,        No,          No,           To(EStop),   No],
/* Stopping */ [No,           No,         No,          No,         No,          Stay,        No,         Stay,        Stay,         To(Fault),  Settle,    To(Holding), No,           To(EStop),   No],
/* Fault    */ [No,           No,         No,          No,         No,          Stay,        No,         No,          Stay,         Stay,       No,        No,          To(Disarmed), To(EStop),   No],
/* EStop    */ [No,           No,         No,          No,         No,          Stay,        No,         No,          Stay,         Stay,       No,        No,          No,           Stay,        To(Fault)],
];

/// The next state, or `None` if the event is not possible.
#[must_use]
pub(crate) fn transition(state: State, event: Event, fault_latched: bool) -> Option<State> {
    let row = STATES.iter().position(|&known| known == state)?;
    let cell = TABLE.get(row)?.get(event as usize)?;
    match *cell {
        No => None,
        Stay => Some(state),
        To(next) => Some(next),
        Settle if fault_latched => Some(Fault),
        Settle => Some(Disarmed),
    }
}

/// Whether drives may give torque in a state.
#[must_use]
pub const fn may_give_torque(state: State) -> bool {
    matches!(state, Arming | Holding | Moving | Pausing | Stopping)
}

/// Reaction of the board to a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reaction {
    /// Latch it, decelerate along the path and hold under tension.
    Hold,
    /// Latch it, decelerate, brakes under torque, torque off (STOP1).
    Stop,
    /// Latch it, brakes and torque off at once (STOP0).
    Emergency,
}

impl Reaction {
    /// The event that the reaction raises.
    #[must_use]
    pub const fn event(self) -> Event {
        match self {
            Self::Hold => Event::Hold,
            Self::Stop => Event::Stop,
            Self::Emergency => Event::Emergency,
        }
    }
}

/// The reaction to a fault that the board detects; `docs/faults.md` has the reasons.
#[must_use]
pub const fn reaction(fault: FaultId) -> Reaction {
    match fault {
        FaultId::L10 | FaultId::K4 | FaultId::K5 | FaultId::K6 => Reaction::Hold,
        FaultId::D1 | FaultId::P1 | FaultId::P2 | FaultId::P6 => Reaction::Emergency,
        _ => Reaction::Stop,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_is_possible_in_every_state_and_never_starts_torque() {
        for state in STATES {
            for event in [Event::Stop, Event::Emergency, Event::EStopPressed] {
                for latched in [false, true] {
                    let next = transition(state, event, latched);
                    let next = next.unwrap_or_else(|| panic!("{event:?} refused in {state:?}"));
                    assert!(
                        may_give_torque(state) || !may_give_torque(next),
                        "{event:?} in {state:?} gives torque in {next:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn motion_only_follows_from_holding() {
        for state in STATES {
            for event in Event::ALL {
                if transition(state, event, false) == Some(Moving) {
                    assert_eq!(state, Holding, "{event:?}");
                }
            }
        }
    }

    #[test]
    fn a_latched_fault_and_an_emergency_stop_end_only_by_an_explicit_clear() {
        for event in Event::ALL {
            let next = transition(Fault, event, true);
            match event {
                Event::Clear => assert_eq!(next, Some(Disarmed)),
                Event::EStopPressed => assert_eq!(next, Some(EStop)),
                _ => assert!(next.is_none() || next == Some(Fault), "{event:?}: {next:?}"),
            }
            let next = transition(EStop, event, true);
            match event {
                Event::EStopReleased => assert_eq!(next, Some(Fault)),
                _ => assert!(next.is_none() || next == Some(EStop), "{event:?}: {next:?}"),
            }
        }
    }

    #[test]
    fn torque_starts_only_by_arming_from_disarmed() {
        for state in STATES.into_iter().filter(|&state| !may_give_torque(state)) {
            for event in Event::ALL {
                if let Some(next) = transition(state, event, false) {
                    let starts = may_give_torque(next);
                    assert_eq!(starts, state == Disarmed && event == Event::Arm);
                }
            }
        }
    }

    #[test]
    fn p3_p4_a_board_that_starts_after_a_crash_starts_in_fault() {
        assert_eq!(transition(State::Boot, Event::Booted, true), Some(Fault));
        assert_eq!(
            transition(State::Boot, Event::Booted, false),
            Some(Disarmed)
        );
    }

    #[test]
    fn stopping_settles_in_fault_when_one_is_latched() {
        assert_eq!(transition(Stopping, Event::TorqueOff, true), Some(Fault));
        assert_eq!(
            transition(Stopping, Event::TorqueOff, false),
            Some(Disarmed)
        );
    }
}
