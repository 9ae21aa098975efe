//! Which board and channel drives which cable.

use super::model::Board;
use super::read::{Reader, Values};
use super::schema::key;

/// Hexadecimal digits of a board's number.
const ID_DIGITS: usize = 24;

/// The boards of the file with their cables; none where the file names none: one board for all.
pub(super) fn boards(reader: &mut Reader, tables: &[Values], cables: &[Values]) -> Vec<Board> {
    let mut boards: Vec<Board> = Vec::new();
    for table in tables {
        let id = table.has(key!(BOARD, "id"));
        let id = id.then(|| table.text(key!(BOARD, "id")).to_lowercase());
        if let Some(id) = &id {
            check_id(reader, table, id, &boards);
        }
        boards.push(Board {
            id,
            fault_line: table.switch(key!(BOARD, "fault_line")),
            cables: Vec::new(),
        });
    }
    check_fault_line(reader, tables, &boards);
    let channels: Vec<usize> = tables
        .iter()
        .map(|table| usize::try_from(table.whole(key!(BOARD, "channels"))).unwrap_or(0))
        .collect();
    if boards.is_empty() {
        for cable in cables {
            for key in [key!(CABLE, "board"), key!(CABLE, "channel")] {
                if cable.has(key) {
                    let what = format!("`{}` needs [[board]] tables", key.name());
                    let help = "write one [[board]] table per board, or leave the key out";
                    reader.problem(&cable.at(key), &cable.place, what, Some(help.into()));
                }
            }
        }
        return boards;
    }
    let mut taken: Vec<Vec<Option<usize>>> = channels.iter().map(|n| vec![None; *n]).collect();
    // Given channels first: cables without one take those that are left.
    let given = |cable: &&Values| cable.has(key!(CABLE, "channel"));
    let numbered = || cables.iter().enumerate();
    let order = numbered()
        .filter(|(_, cable)| given(cable))
        .chain(numbered().filter(|(_, cable)| !given(cable)));
    for (index, cable) in order {
        assign(reader, cables, index, cable, &mut taken);
    }
    for ((board, table), taken) in boards.iter_mut().zip(tables).zip(&taken) {
        board.cables = taken.iter().copied().flatten().collect();
        let gap = taken.iter().position(Option::is_none);
        let last = taken.iter().rposition(Option::is_some);
        if let Some(gap) = gap
            && last.is_none_or(|last| gap < last)
        {
            let what = if last.is_none() {
                "no cable is on this board".to_owned()
            } else {
                format!("channel {} drives no cable, but a later one does", gap + 1)
            };
            let help = "a board's cables are on its first channels; `board` and `channel` of \
                        [[cable]] say which";
            reader.problem(&table.at, &table.place, what, Some(help.into()));
        }
    }
    boards
}

/// The line connects all boards, and one alone has nobody to tell.
fn check_fault_line(reader: &mut Reader, tables: &[Values], boards: &[Board]) {
    let Some(without) = boards.iter().position(|board| !board.fault_line) else {
        if let [only] = tables {
            reader.problem(
                &only.at(key!(BOARD, "fault_line")),
                &only.place,
                "`fault_line` of a robot with one board".into(),
                Some("a fault line connects several boards: leave the key out".into()),
            );
        }
        return;
    };
    let with = tables
        .iter()
        .zip(boards)
        .find(|(_, board)| board.fault_line);
    if let Some((table, _)) = with {
        reader.problem(
            &table.at(key!(BOARD, "fault_line")),
            &table.place,
            format!("`fault_line` is not on board {}, too", without + 1),
            Some("the line connects all boards: write it in every [[board]], or in none".into()),
        );
    }
}

fn check_id(reader: &mut Reader, table: &Values, id: &str, before: &[Board]) {
    let at = table.at(key!(BOARD, "id"));
    if id.len() != ID_DIGITS || !id.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        reader.problem(
            &at,
            &table.place,
            format!("`id` {id} is not a board's number: {ID_DIGITS} hexadecimal digits"),
            Some("`mcdpr doctor --on PORT` shows it; without `id` any board is taken".into()),
        );
    }
    if let Some(twin) = before.iter().position(|b| b.id.as_deref() == Some(id)) {
        reader.problem(
            &at,
            &table.place,
            format!("`id` {id} is already that of board {}", twin + 1),
            Some("every board has a number of its own: read both again".into()),
        );
    }
}

/// Puts a cable on its board's channel; mistakes are noted.
fn assign(
    reader: &mut Reader,
    cables: &[Values],
    index: usize,
    cable: &Values,
    taken: &mut [Vec<Option<usize>>],
) {
    let whole = |key| {
        cable
            .whole_given(key)
            .and_then(|number| usize::try_from(number).ok())
    };
    let free = |board: &Vec<Option<usize>>| board.iter().any(Option::is_none);
    let board = match whole(key!(CABLE, "board")) {
        Some(number) => number - 1,
        None => match taken.iter().position(free) {
            Some(board) => board,
            None => {
                let all: usize = taken.iter().map(Vec::len).sum();
                reader.problem(
                    &cable.at,
                    &cable.place,
                    format!("no channel is left for this cable: the boards have {all} in all"),
                    Some("add a [[board]] table, or raise its `channels`".into()),
                );
                return;
            }
        },
    };
    let count = taken.len();
    let Some(channels) = taken.get_mut(board) else {
        reader.problem(
            &cable.at(key!(CABLE, "board")),
            &cable.place,
            format!(
                "`board` {} is not a board of this file: it has {count}",
                board + 1
            ),
            Some("the first [[board]] is 1".into()),
        );
        return;
    };
    let has = channels.len();
    let channel = match whole(key!(CABLE, "channel")) {
        Some(number) => number - 1,
        None => match channels.iter().position(Option::is_none) {
            Some(channel) => channel,
            None => {
                reader.problem(
                    &cable.at(key!(CABLE, "board")),
                    &cable.place,
                    format!("`board` {} has no channel left: it has {has}", board + 1),
                    Some("put the cable on another board".into()),
                );
                return;
            }
        },
    };
    let key = key!(CABLE, "channel");
    match channels.get_mut(channel) {
        None => reader.problem(
            &cable.at(key),
            &cable.place,
            format!(
                "`channel` {} is one that board {} has not: it has {has}",
                channel + 1,
                board + 1
            ),
            Some("`channels` of [[board]] says how many winches a board drives".into()),
        ),
        Some(Some(other)) => {
            let other = cables.get(*other).map_or("another cable", |c| &c.place);
            reader.problem(
                &cable.at(key),
                &cable.place,
                format!(
                    "`channel` {} of board {} already drives {other}",
                    channel + 1,
                    board + 1
                ),
                Some("a channel drives one winch with one cable: name another".into()),
            );
        }
        Some(place) => *place = Some(index),
    }
}
