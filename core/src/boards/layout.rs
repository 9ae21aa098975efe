//! Which cable is on which channel of which board, and messages split and joined by it.

use crate::faults::is_of_board;
use crate::robot::Robot;
use mcdpr_protocol::config::{BoardKey, KeyMeaning};
use mcdpr_protocol::{ConfigEntry, ConfigKey, FaultRecord, Knot, List, PerCable, Reject};

/// The cables of each board: index of the robot's cable by channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Layout {
    boards: Vec<Vec<usize>>,
    cables: usize,
}

impl Layout {
    /// Of a robot; `None` for one with a single board.
    pub(super) fn of(robot: &Robot) -> Option<Self> {
        if robot.boards.is_empty() {
            return None;
        }
        let boards = robot.boards.iter().map(|board| board.cables.clone());
        Some(Self {
            boards: boards.collect(),
            cables: robot.cables.len(),
        })
    }

    /// Boards.
    pub(super) fn len(&self) -> usize {
        self.boards.len()
    }

    /// Cables of the robot.
    pub(super) fn cables(&self) -> usize {
        self.cables
    }

    /// Cables on a board, by channel.
    pub(super) fn of_board(&self, board: usize) -> &[usize] {
        self.boards.get(board).map_or(&[], Vec::as_slice)
    }

    /// Board and channel of a cable.
    pub(super) fn place(&self, cable: usize) -> Option<(usize, usize)> {
        self.boards.iter().enumerate().find_map(|(board, cables)| {
            let channel = cables.iter().position(|other| *other == cable)?;
            Some((board, channel))
        })
    }

    /// The values of a board's cables.
    pub(super) fn part<T: Clone>(&self, board: usize, whole: &[T]) -> PerCable<T> {
        let cables = self.of_board(board).iter();
        PerCable::collect(cables.filter_map(|cable| whole.get(*cable).cloned()))
    }

    /// The values of all cables from those of each board.
    pub(super) fn whole<T: Clone + Default>(&self, parts: &[&[T]]) -> PerCable<T> {
        PerCable::collect((0..self.cables).map(|cable| {
            self.place(cable)
                .and_then(|(board, channel)| parts.get(board)?.get(channel).cloned())
                .unwrap_or_default()
        }))
    }

    /// Bits of all cables from those of each board's channels.
    pub(super) fn whole_bits(&self, parts: impl Iterator<Item = u8>) -> u8 {
        let mut bits = 0;
        for (board, part) in parts.enumerate() {
            for (channel, cable) in self.of_board(board).iter().enumerate() {
                bits |= (part >> channel & 1) << cable;
            }
        }
        bits
    }

    /// The robot's number of a board's cable, both from 1; 0 is no cable.
    pub(super) fn number(&self, board: usize, number: u8) -> u8 {
        let channel = usize::from(number).checked_sub(1);
        let cable = channel.and_then(|channel| self.of_board(board).get(channel));
        cable.map_or(0, |cable| u8::try_from(cable + 1).unwrap_or(0))
    }

    /// A board's fault in the robot's numbers of cables; a fault of the board itself with the board's number.
    pub(super) fn fault(&self, board: usize, record: FaultRecord) -> FaultRecord {
        let of_board = is_of_board(record.fault) && record.cable == 0 && record.value == 0;
        FaultRecord {
            cable: self.number(board, record.cable),
            value: match i32::try_from(board + 1) {
                Ok(number) if of_board => number,
                _ => record.value,
            },
            ..record
        }
    }

    /// A board's refusal in the robot's numbers of cables.
    pub(super) fn reject(&self, board: usize, reject: Reject) -> Reject {
        let of = |cable| self.number(board, cable);
        match reject {
            Reject::KnotStart { cable, gap } => Reject::KnotStart {
                cable: of(cable),
                gap,
            },
            Reject::KnotLength { cable } => Reject::KnotLength { cable: of(cable) },
            Reject::KnotSpeed { cable } => Reject::KnotSpeed { cable: of(cable) },
            Reject::KnotTension { cable } => Reject::KnotTension { cable: of(cable) },
            Reject::KnotAcceleration { cable } => Reject::KnotAcceleration { cable: of(cable) },
            Reject::KnotJerk { cable } => Reject::KnotJerk { cable: of(cable) },
            Reject::Faulted { record } => Reject::Faulted {
                record: self.fault(board, record),
            },
            other => other,
        }
    }

    /// A board's part of the robot's configuration.
    pub(super) fn configuration(&self, board: usize, whole: &[ConfigEntry]) -> Vec<ConfigEntry> {
        let cables = self.of_board(board);
        let mut part: Vec<ConfigEntry> = whole
            .iter()
            .filter_map(|entry| match entry.key.meaning()? {
                KeyMeaning::Board(BoardKey::Cables) => Some(ConfigEntry {
                    value: i32::try_from(cables.len()).ok()?,
                    ..*entry
                }),
                KeyMeaning::Board(_) => Some(*entry),
                KeyMeaning::Cable(cable, key) => {
                    let channel = cables.iter().position(|c| *c == usize::from(cable))?;
                    Some(ConfigEntry {
                        key: ConfigKey::cable(u8::try_from(channel).ok()?, key),
                        ..*entry
                    })
                }
            })
            .collect();
        // The hash is over ascending keys, and channels may be in another order than cables.
        part.sort_by_key(|entry| entry.key.0);
        part
    }

    /// A board's part of a knot. A consistency check that needs cables of other boards is left
    /// out: no board can compute it.
    pub(super) fn knot(&self, board: usize, whole: &Knot) -> Knot {
        let cables = self.of_board(board);
        let mine = |row: &&mcdpr_protocol::ResidualRow| {
            let others = |list: &[mcdpr_protocol::Coefficient]| {
                let mut list = list.iter().enumerate();
                list.all(|(cable, value)| value.0 == 0 || cables.contains(&cable))
            };
            others(&row.lengths) && others(&row.tensions)
        };
        // The board takes the first row for slip and the second for contact: one that is left out leaves out the second.
        let rows = whole.rows.iter().take_while(mine);
        Knot {
            cables: self.part(board, &whole.cables),
            rows: List::collect(rows.map(|row| mcdpr_protocol::ResidualRow {
                lengths: self.part(board, &row.lengths),
                tensions: self.part(board, &row.tensions),
                limit: row.limit,
            })),
            ..whole.clone()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;
    use mcdpr_protocol::{Coefficient, FaultId, Micrometres, ResidualRow, Tick};

    fn layout() -> Layout {
        Layout::of(&Robot::built_in("eight-two-boards").unwrap()).unwrap()
    }

    /// A row of which these cables have a length's coefficient, with this limit.
    fn row(cables: std::ops::Range<usize>, limit: i32) -> ResidualRow {
        let of = |cable| Coefficient(i16::from(cables.contains(&cable)));
        ResidualRow {
            lengths: PerCable::collect((0..8).map(of)),
            tensions: PerCable::collect((0..8).map(|_| Coefficient(0))),
            limit: Micrometres(limit),
        }
    }

    #[test]
    fn a_row_that_a_board_cannot_compute_leaves_out_the_rows_after_it() {
        let layout = layout();
        let rows_of = |first: ResidualRow, second: ResidualRow| {
            let knot = Knot {
                rows: List::collect([first, second]),
                ..Knot::default()
            };
            let part = layout.knot(0, &knot);
            part.rows.iter().map(|row| row.limit.0).collect::<Vec<_>>()
        };
        // A board takes its first row for slip (S5), its second for contact (C5).
        assert_eq!(rows_of(row(0..4, 5), row(0..3, 9)), [5, 9]);
        assert_eq!(rows_of(row(0..4, 5), row(0..8, 9)), [5]);
        assert_eq!(rows_of(row(0..8, 5), row(0..3, 9)), [0; 0]);
    }

    #[test]
    fn a_fault_of_a_board_names_the_board_and_one_of_a_cable_the_robots_cable() {
        let layout = layout();
        let record = |fault, cable, value| FaultRecord {
            fault,
            cable,
            value,
            tick: Tick(0),
            limit: 0,
        };
        for fault in [FaultId::L19, FaultId::P1, FaultId::P4, FaultId::K6] {
            let told = layout.fault(1, record(fault, 0, 0));
            assert_eq!((told.cable, told.value), (0, 2), "{fault:?}");
            assert!(crate::faults::describe_fault(&told).ends_with("(told by board 2)"));
        }
        let told = layout.fault(1, record(FaultId::C1, 3, 700));
        assert_eq!((told.cable, told.value), (7, 700));
    }
}
