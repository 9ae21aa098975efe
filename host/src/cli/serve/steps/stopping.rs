//! How a command is stopped: by an order, then by an interrupt, in the end by force.

use std::time::Duration;

/// A command that has not answered a stop for this long is interrupted.
const ANSWER: Duration = Duration::from_millis(500);
/// A command that was stopped or interrupted has this long to stop its robot and to end.
const END: Duration = Duration::from_secs(5);

/// What is done to a command, each after the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Measure {
    /// An order over its live page.
    Ordered,
    /// As Ctrl-C: it stops the robot and ends.
    Interrupted,
    /// A second time: it ends at once, and the board stops the robot by itself.
    Again,
    /// The system ends it.
    Killed,
}

/// The next measure, if it is time for it: `last` was taken `since` ago; `answered` says whether the command has
/// answered the order, `orders` whether it can get one.
pub(super) fn next(
    last: Measure,
    since: Duration,
    answered: bool,
    orders: bool,
) -> Option<Measure> {
    let (patience, measure) = match last {
        Measure::Ordered if !orders => (Duration::ZERO, Measure::Interrupted),
        Measure::Ordered if !answered => (ANSWER, Measure::Interrupted),
        Measure::Ordered => (END, Measure::Interrupted),
        Measure::Interrupted => (END, Measure::Again),
        Measure::Again => (ANSWER, Measure::Killed),
        Measure::Killed => return None,
    };
    (since >= patience).then_some(measure)
}

impl Measure {
    /// For the output.
    pub(super) const fn words(self) -> &'static str {
        match self {
            Self::Ordered => "stop: the order went to the command",
            Self::Interrupted => "stop: the command was interrupted, as by Ctrl-C",
            Self::Again => {
                "stop: it was interrupted again, and ends at once; a board stops its robot by itself"
            }
            Self::Killed => "stop: the system ended the command; a board stops its robot by itself",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_asked_interrupted_and_ended() {
        let ms = Duration::from_millis;
        let ordered = Measure::Ordered;
        // Without a page of its own it is interrupted at once.
        assert_eq!(
            next(ordered, ms(0), false, false),
            Some(Measure::Interrupted)
        );
        assert_eq!(next(ordered, ms(499), false, true), None);
        assert_eq!(
            next(ordered, ms(500), false, true),
            Some(Measure::Interrupted)
        );
        // One that has answered gets the time to stop its robot.
        assert_eq!(next(ordered, ms(4_900), true, true), None);
        assert_eq!(
            next(ordered, ms(5_000), true, true),
            Some(Measure::Interrupted)
        );
        assert_eq!(next(Measure::Interrupted, ms(4_900), false, false), None);
        assert_eq!(
            next(Measure::Interrupted, ms(5_000), false, false),
            Some(Measure::Again)
        );
        assert_eq!(
            next(Measure::Again, ms(500), false, false),
            Some(Measure::Killed)
        );
        assert_eq!(next(Measure::Killed, ms(90_000), false, false), None);
    }
}
