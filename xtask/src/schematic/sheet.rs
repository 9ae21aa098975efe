//! Where the parts are on the sheet: columns of groups, the chip's board in the middle.
//!
//! Lengths are integers in units of KiCad's grid, 1.27 mm: pins, wires and labels that shall touch then do.

/// The sheet, A2: 594 mm x 420 mm.
pub(crate) const PAPER: &str = "A2";
/// Height of the sheet.
const HEIGHT: i32 = 330;
/// Least distance from the upper and the lower edge, which have the frame.
const MARGIN: i32 = 14;
/// Middle of the first column.
const FIRST: i32 = 46;
/// From column to column: a symbol with the longest labels on both sides.
const PITCH: i32 = 62;
/// Room of a group's title.
const TITLE: i32 = 3;
/// Room after a group.
const GAP: i32 = 5;

/// The group of the flags for KiCad's check. It takes what has no other group.
const FLAGS: &str = "For KiCad's check";

/// Columns of groups: title and parts.
const COLUMNS: [&[(&str, &[&str])]; 7] = [
    &[
        ("Encoder 1", &["J1", "R1", "R2"]),
        ("Encoder 2", &["J2", "R3", "R4"]),
        ("Buffer of encoders 1 and 2", &["U2", "C1"]),
        ("Encoder 3", &["J3", "R5", "R6"]),
        ("Encoder 4", &["J4", "R7", "R8"]),
        ("Buffer of encoders 3 and 4", &["U3", "C2"]),
    ],
    &[
        ("Tension 1", &["J5", "R9", "R10", "C3", "D1"]),
        ("Tension 2", &["J6", "R11", "R12", "C4", "D2"]),
        ("Tension 3", &["J7", "R13", "R14", "C5", "D3"]),
        ("Tension 4", &["J8", "R15", "R16", "C6", "D4"]),
    ],
    &[
        ("Input of the emergency stop", &["R31", "R30", "C7"]),
        ("Host link", &["U5"]),
        ("Debug probe", &["J14"]),
        ("Shields", &["J16", "R34"]),
        ("Fault line", &["J17", "R35", "Q7", "R36"]),
    ],
    &[
        ("Board of the chip", &["U1"]),
        ("Supply of the chip's memory", &["BT1", "JP1"]),
    ],
    &[
        ("Brake 1", &["R17", "R18", "Q1", "D5"]),
        ("Brake 2", &["R19", "R20", "Q2", "D6"]),
        ("Brake 3", &["R21", "R22", "Q3", "D7"]),
        ("Brake 4", &["R23", "R24", "Q4", "D8"]),
        ("Plug of the brakes", &["J9"]),
    ],
    &[
        ("Drives' bus", &["U4", "R32", "R33", "J13"]),
        (
            "Drives' contactor",
            &["R25", "R26", "Q5", "D9", "K1", "J10"],
        ),
        ("Gripper", &["R27", "R28", "Q6", "D10", "J11", "R29"]),
    ],
    &[
        ("24 V and emergency stop", &["J12", "F2", "S1"]),
        ("5 V", &["J15", "F3", "F1"]),
        (FLAGS, &[]),
    ],
];

/// Something at a place on the sheet; y points down.
pub(crate) struct Placed<T> {
    pub(crate) what: T,
    pub(crate) x: i32,
    pub(crate) y: i32,
}

/// What is on the sheet.
pub(crate) struct Sheet {
    pub(crate) titles: Vec<Placed<&'static str>>,
    /// Indices of the parts.
    pub(crate) parts: Vec<Placed<usize>>,
}

/// Places parts by their references. `height` gives the room of a part by its index.
///
/// # Errors
/// If a part has no group, a group names no part, or a column is too high.
pub(crate) fn place(references: &[&str], height: impl Fn(usize) -> i32) -> Result<Sheet, String> {
    let mut sheet = Sheet {
        titles: Vec::new(),
        parts: Vec::new(),
    };
    let mut middle = FIRST;
    for groups in COLUMNS {
        let mut y = 0;
        let first = (sheet.titles.len(), sheet.parts.len());
        for (title, names) in groups {
            let what = *title;
            let x = middle - 20;
            sheet.titles.push(Placed { what, x, y });
            y += TITLE;
            for what in members(title, names, references)? {
                let room = height(what);
                let middle_of_part = y + room / 2;
                sheet.parts.push(Placed {
                    what,
                    x: middle,
                    y: middle_of_part,
                });
                y += room;
            }
            y += GAP;
        }
        let top = (HEIGHT - y) / 2;
        if top < MARGIN {
            let title = groups.first().map(|group| group.0).unwrap_or_default();
            return Err(format!(
                "the column of {title:?} is {y} grid units high: move a group to another column"
            ));
        }
        let titles = sheet.titles.iter_mut().skip(first.0);
        titles.for_each(|placed| placed.y += top);
        let parts = sheet.parts.iter_mut().skip(first.1);
        parts.for_each(|placed| placed.y += top);
        middle += PITCH;
    }
    for (index, name) in references.iter().enumerate() {
        if !sheet.parts.iter().any(|placed| placed.what == index) {
            return Err(format!(
                "{name} is in no group of the sheet: add it to COLUMNS"
            ));
        }
    }
    Ok(sheet)
}

/// Indices of a group's parts.
fn members(title: &str, names: &[&str], references: &[&str]) -> Result<Vec<usize>, String> {
    if title == FLAGS {
        let all = references.iter().enumerate();
        let flags = all.filter(|(_, name)| name.starts_with('#'));
        return Ok(flags.map(|(index, _)| index).collect());
    }
    let find = |name: &&str| {
        let found = references.iter().position(|known| known == name);
        found.ok_or_else(|| format!("{name}, of the group {title:?}, is not in the netlist"))
    };
    names.iter().map(find).collect()
}
