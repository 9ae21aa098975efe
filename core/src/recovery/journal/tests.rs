use super::*;

fn identity() -> Identity {
    Identity {
        board: "0011".to_owned(),
        session: 7,
        robot: "lab".to_owned(),
        scale: 5,
        task: "paper:table7".to_owned(),
        task_hash: 9,
        wall_ms: 1_000_000,
    }
}

fn state(index: u32) -> Kept {
    Kept {
        time_us: u64::from(index) * 10_000,
        path_ms: index * 10,
        state: BoardState::Moving,
        referenced: true,
        brakes_open: 15,
        torque_on: 15,
        gripper_closed: true,
        gripper_switch: false,
        cables: vec![
            KeptCable {
                length_m: 0.5 + 1e-4 * f64::from(index),
                setpoint_m: 0.5,
                speed_mps: 0.01,
                tension_n: 7.25,
            };
            4
        ],
    }
}

/// A file of some states, and where each record ends.
fn file(states: u32) -> (Vec<u8>, Vec<usize>) {
    let mut encoder = Encoder::default();
    let plan = Plan {
        start_m: [0.1, 0.2, 0.3],
        duration_s: 4.0,
        interruptions: vec![crate::motion::Interruption {
            path_s: 1.25,
            tool_m: [0.3, 0.2, -0.1],
        }],
    };
    let mut bytes = encoder.begin(&identity(), Some(&plan));
    let mut ends = Vec::new();
    for index in 0..states {
        bytes.extend(encoder.kept(&state(index)));
        ends.push(bytes.len());
    }
    (bytes, ends)
}

#[test]
fn what_is_written_is_read() {
    let (mut bytes, _) = file(5);
    let journal = Journal::read(&bytes).unwrap();
    assert_eq!(journal.identity, identity());
    let last = journal.last.unwrap();
    assert_eq!((last.path_ms, last.state), (40, BoardState::Moving));
    assert!((last.cables[3].length_m - 0.5004).abs() < 1e-9);
    assert!((last.cables[0].tension_n - 7.25).abs() < 1e-9);
    assert!(last.gripper_closed && !last.gripper_switch && !journal.ended);
    let mut encoder = Encoder {
        number: journal.number,
    };
    bytes.extend(encoder.end());
    assert!(Journal::read(&bytes).unwrap().ended);
}

#[test]
fn a_cut_at_any_byte_leaves_every_record_before_it() {
    let (bytes, ends) = file(12);
    for cut in 0..bytes.len() {
        let whole = ends.iter().filter(|end| **end <= cut).count();
        match Journal::read(&bytes[..cut]) {
            Ok(journal) => {
                let last = journal.last.unwrap();
                assert_eq!(usize::try_from(last.path_ms).unwrap(), (whole - 1) * 10);
                assert_eq!(journal.torn_bytes, cut - ends[whole - 1], "cut at {cut}");
            }
            Err(error) => {
                assert_eq!(error, JournalError::Empty, "cut at {cut}");
                assert_eq!(whole, 0, "cut at {cut}");
            }
        }
        // A file system that gave the length and not the bytes.
        let mut zeros = bytes[..cut].to_vec();
        zeros.resize(cut + 300, 0);
        let torn = Journal::read(&zeros);
        let kept = torn.as_ref().map_or(0, |journal| journal.last.iter().len());
        assert!(kept == usize::from(whole > 0), "zeros from {cut}: {torn:?}");
    }
}

#[test]
fn a_changed_byte_never_gives_another_state() {
    let (bytes, ends) = file(6);
    let mut cut = 0;
    for at in 0..bytes.len() {
        for flip in [1_u8, 0x80] {
            let mut changed = bytes.clone();
            changed[at] ^= flip;
            match Journal::read(&changed) {
                // A length that reaches over the end looks like a cut: what was before counts.
                Ok(journal) => {
                    cut += 1;
                    let path_ms = usize::try_from(journal.last.unwrap().path_ms).unwrap();
                    assert!(ends[path_ms / 10] <= at, "byte {at}");
                    let marked = Mark {
                        session: 7,
                        number: journal.number + 1,
                    };
                    let whole = Journal::read(&changed).unwrap();
                    let found = whole.check("0011", 5, Some(marked), 1_000_000);
                    assert!(matches!(found, Err(JournalError::Cut { .. })), "{found:?}");
                }
                Err(JournalError::Form | JournalError::Damaged { .. } | JournalError::Empty) => {}
                Err(other) => panic!("byte {at}: {other}"),
            }
        }
    }
    let last = ends[5] - ends[4];
    assert!(
        cut < 2 * last + 40,
        "{cut}, of {last} bytes of the last record"
    );
}

#[test]
fn a_journal_of_another_board_robot_run_or_time_is_refused() {
    let (bytes, _) = file(3);
    let journal = Journal::read(&bytes).unwrap();
    let now = 1_005_000;
    let mark = |session, number| Some(Mark { session, number });
    assert_eq!(
        journal.check("0011", 5, mark(7, journal.number), now),
        Ok(())
    );
    assert_eq!(journal.check("0011", 5, None, now), Ok(()));
    let found = |board, scale, mark, now| journal.check(board, scale, mark, now).unwrap_err();
    assert!(matches!(
        found("0012", 5, None, now),
        JournalError::Board { .. }
    ));
    assert!(matches!(
        found("0011", 6, None, now),
        JournalError::Robot { .. }
    ));
    assert!(matches!(
        found("0011", 5, None, 900_000),
        JournalError::Future { ahead_s: 100 }
    ));
    assert!(matches!(
        found("0011", 5, mark(8, 1), now),
        JournalError::Session { .. }
    ));
    assert!(matches!(
        found("0011", 5, mark(7, 99), now),
        JournalError::Cut { .. }
    ));
}

#[test]
fn of_two_marks_the_later_whole_one_counts() {
    let (a, b) = (
        Mark {
            session: 7,
            number: 3,
        },
        Mark {
            session: 7,
            number: 4,
        },
    );
    let mut bytes = [a.to_bytes(), b.to_bytes()].concat();
    assert_eq!(Mark::read(&bytes), Some(b));
    bytes[MARK_BYTES + 5] ^= 1;
    assert_eq!(Mark::read(&bytes), Some(a));
    assert_eq!(Mark::read(&bytes[..5]), None);
}

#[test]
fn a_minute_of_eight_cables_is_under_a_megabyte() {
    let mut encoder = Encoder::default();
    let mut eight = state(1);
    eight.cables.resize(8, KeptCable::default());
    // A record at most every ten milliseconds.
    let minute = encoder.kept(&eight).len() * 6000;
    assert!(minute < 1_000_000, "{minute} bytes");
}
