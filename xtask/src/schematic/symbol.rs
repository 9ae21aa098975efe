//! The symbol of a kind of part: a rectangle, with its pins on one side or on two.

use super::netlist::Pin;
use super::write::{at, hidden, millimetres, quoted, shown};

/// Length of a pin, in grid units.
const PIN: i32 = 2;

/// Where a pin of a symbol ends, in grid units from the symbol's middle; y points down.
#[derive(Clone, Copy)]
pub(crate) struct End {
    pub(crate) x: i32,
    pub(crate) y: i32,
    /// On the left side.
    pub(crate) left: bool,
}

pub(crate) struct Symbol {
    /// Half of the rectangle's width.
    pub(crate) half: i32,
    /// Rows of pins; half of the rectangle's height, too.
    pub(crate) rows: i32,
    /// In the order of the kind's pins.
    pub(crate) ends: Vec<End>,
}

impl Symbol {
    /// `plug`: all pins on the right side. Else the first half of them is on the left.
    pub(crate) fn new(pins: &[Pin], plug: bool) -> Self {
        let left = if plug { 0 } else { pins.len().div_ceil(2) };
        let rows = left.max(pins.len() - left);
        let widest = |pins: &[Pin]| pins.iter().map(|pin| pin.name.len()).max().unwrap_or(0);
        let (west, east) = pins.split_at(left);
        let (from_west, from_east) = (widest(west), widest(east));
        let between = i32::from(from_west > 0 && from_east > 0);
        let half = units(from_west + from_east).max(4) / 2 + 1 + between;
        let rows = units(rows);
        let end = |index: usize| {
            let on_left = index < left;
            let row = units(if on_left { index } else { index - left });
            End {
                x: if on_left { -half - PIN } else { half + PIN },
                y: 2 * row - (rows - 1),
                left: on_left,
            }
        };
        Self {
            half,
            rows,
            ends: (0..pins.len()).map(end).collect(),
        }
    }

    /// Room on the sheet, with a line of text above and below.
    pub(crate) fn height(&self) -> i32 {
        2 * self.rows + 7
    }

    /// The text of a library's symbol. `prefix` is the letter of its references; `#FLG` that of flags.
    pub(crate) fn text(&self, library: &str, kind: &str, prefix: &str, pins: &[Pin]) -> String {
        let flag = prefix.starts_with('#');
        let listed = if flag { "no" } else { "yes" };
        let power = if flag { "\n\t\t\t(power)" } else { "" };
        // A number that is also the name would be there twice.
        let same = pins.iter().all(|pin| pin.number == pin.name) || flag;
        let numbers = if same {
            "\n\t\t\t(pin_numbers hide)"
        } else {
            ""
        };
        let mut text = format!(
            "\t\t(symbol {}{power}{numbers}
\t\t\t(pin_names
\t\t\t\t(offset 1.016)
\t\t\t)
\t\t\t(exclude_from_sim no)
\t\t\t(in_bom {listed})
\t\t\t(on_board {listed})
",
            quoted(&format!("{library}:{kind}"))
        );
        let (x, y) = (-self.half, self.rows + 2);
        let place = if flag { hidden(x, y) } else { shown(x, y) };
        for (name, value, place) in [
            ("Reference", prefix, place),
            ("Value", kind, shown(x + 4, y)),
            ("Footprint", "", hidden(0, 0)),
            ("Datasheet", "", hidden(0, 0)),
            ("Description", "", hidden(0, 0)),
        ] {
            let value = quoted(value);
            text += &format!("\t\t\t(property \"{name}\" {value} {place})\n");
        }
        let (corner, other) = (at(-self.half, self.rows), at(self.half, -self.rows));
        text += &format!(
            "\t\t\t(symbol {}
\t\t\t\t(rectangle (start {corner}) (end {other})
\t\t\t\t\t(stroke (width 0.254) (type default))
\t\t\t\t\t(fill (type background))
\t\t\t\t)
\t\t\t)
\t\t\t(symbol {}
",
            quoted(&format!("{kind}_0_1")),
            quoted(&format!("{kind}_1_1")),
        );
        for (pin, end) in pins.iter().zip(&self.ends) {
            // In a library y points up, on the sheet down.
            let (place, turn) = (at(end.x, -end.y), if end.left { 0 } else { 180 });
            let (electrical, length) = (&pin.electrical, millimetres(PIN));
            let (name, number) = (quoted(&pin.name), quoted(&pin.number));
            text += &format!(
                "\t\t\t\t(pin {electrical} line (at {place} {turn}) (length {length})
\t\t\t\t\t(name {name} (effects (font (size 1.27 1.27))))
\t\t\t\t\t(number {number} (effects (font (size 1.27 1.27))))
\t\t\t\t)
"
            );
        }
        text += "\t\t\t)\n\t\t)\n";
        text
    }
}

/// A count as grid units. A symbol has far fewer pins and letters than would not fit.
fn units(count: usize) -> i32 {
    i32::try_from(count).unwrap_or(i32::MAX)
}
