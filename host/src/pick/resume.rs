//! Whether a journal is one of picking that a loss of power interrupted.

use crate::recovery::Journal;
use crate::run::ResumeError;
use mcdpr_protocol::BoardState;

/// Checks that the journal is of the task with this checksum, and that the robot did not end by itself.
///
/// # Errors
/// [`ResumeError::Task`] and [`ResumeError::NoMotion`].
pub(super) fn check(journal: &Journal, hash: u32) -> Result<(), ResumeError> {
    if journal.identity.task_hash != hash {
        return Err(ResumeError::Task {
            journal: journal.identity.task.clone(),
            asked: "pick".to_owned(),
        });
    }
    let state = match journal.last.as_ref().map(|last| last.state) {
        None => "the journal has no state of the robot",
        Some(BoardState::Disarmed) => "the robot had been disarmed, as at the end of picking",
        Some(_) => return Ok(()),
    };
    Err(ResumeError::NoMotion { state })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recovery::{Identity, Kept};

    fn journal(state: Option<BoardState>) -> Journal {
        let identity = Identity {
            board: "00".to_owned(),
            session: 1,
            robot: "r".to_owned(),
            scale: 1,
            task: "pick".to_owned(),
            task_hash: 7,
            wall_ms: 0,
        };
        let last = state.map(|state| Kept {
            state,
            ..Kept::default()
        });
        Journal {
            identity,
            plan: None,
            last,
            still: None,
            path_ms: 0,
            ended: false,
            number: 1,
            torn_bytes: 0,
        }
    }

    #[test]
    fn an_interrupted_picking_is_continued_and_nothing_else() {
        assert_eq!(check(&journal(Some(BoardState::Moving)), 7), Ok(()));
        // Looking and weighing: the robot holds.
        assert_eq!(check(&journal(Some(BoardState::Holding)), 7), Ok(()));
        assert_eq!(check(&journal(Some(BoardState::Fault)), 7), Ok(()));
        for over in [None, Some(BoardState::Disarmed)] {
            let error = check(&journal(over), 7);
            assert!(
                matches!(error, Err(ResumeError::NoMotion { .. })),
                "{error:?}"
            );
        }
        let error = check(&journal(Some(BoardState::Moving)), 8);
        assert!(matches!(error, Err(ResumeError::Task { .. })), "{error:?}");
    }
}
