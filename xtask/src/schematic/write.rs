//! Writes a schematic in KiCad's text format, version 20231120: that of KiCad 8, which later ones read.

use super::netlist::{Netlist, Part, Pin};
use super::sheet::{self, Placed, Sheet};
use super::symbol::{End, Symbol};
use std::collections::BTreeMap;

/// Name of the project and of its library of symbols.
const NAME: &str = "board";
/// Length of the wire from a pin to its label, in grid units.
const WIRE: i32 = 2;

/// The schematic of a netlist.
///
/// # Errors
/// If the netlist and the groups of the sheet do not fit.
pub(crate) fn schematic(mut netlist: Netlist) -> Result<String, String> {
    let flagged = add_flags(&mut netlist)?;
    let mut symbols = BTreeMap::new();
    for part in &netlist.parts {
        let pins = netlist.pins(part)?;
        let letters = part
            .reference
            .trim_end_matches(|c: char| c.is_ascii_digit());
        let plug = matches!(letters, "J" | "#FLG");
        let symbol = || (Symbol::new(pins, plug), letters, pins);
        symbols.entry(part.kind.as_str()).or_insert_with(symbol);
    }
    let symbol_of = |part: &Part| symbols.get(part.kind.as_str()).map(|symbol| &symbol.0);
    let references: Vec<_> = netlist
        .parts
        .iter()
        .map(|part| part.reference.as_str())
        .collect();
    let height = |index: usize| {
        let part = netlist.parts.get(index);
        part.and_then(symbol_of).map_or(0, Symbol::height)
    };
    let Sheet { titles, parts } = sheet::place(&references, height)?;

    let mut text = head();
    text += "\t(lib_symbols\n";
    for (kind, (symbol, letters, pins)) in &symbols {
        text += &symbol.text(NAME, kind, letters, pins);
    }
    text += "\t)\n";
    for title in &titles {
        text += &heading(title);
    }
    for Placed { what, x, y } in parts {
        let Some(part) = netlist.parts.get(what) else {
            continue;
        };
        let pins = netlist.pins(part)?;
        let Some(symbol) = symbol_of(part) else {
            continue;
        };
        text += &placed(part, pins, symbol, (x, y));
        for (pin, end) in pins.iter().zip(&symbol.ends) {
            let net = netlist.net(&part.reference, &pin.number);
            let net = net.or_else(|| flagged.get(&part.reference).map(String::as_str));
            let name = format!("{} {}", part.reference, pin.number);
            text += &match net {
                Some(net) => connected(&name, net, pin, *end, (x, y)),
                None => open(&name, *end, (x, y)),
            };
        }
    }
    text += "\t(sheet_instances\n\t\t(path \"/\" (page \"1\"))\n\t)\n)\n";
    Ok(text)
}

/// Adds a flag for each net that needs one. Returns the nets by the references of their flags.
fn add_flags(netlist: &mut Netlist) -> Result<BTreeMap<String, String>, String> {
    let mut flagged = BTreeMap::new();
    let kind = "PWR_FLAG";
    for (index, net) in netlist.without_source()?.into_iter().enumerate() {
        let reference = format!("#FLG{}", index + 1);
        netlist.parts.push(Part {
            reference: reference.clone(),
            value: kind.to_owned(),
            description: String::new(),
            kind: kind.to_owned(),
        });
        flagged.insert(reference, net);
    }
    let pin = Pin {
        number: "1".to_owned(),
        name: String::new(),
        electrical: "power_out".to_owned(),
    };
    netlist.kinds.insert(kind.to_owned(), vec![pin]);
    Ok(flagged)
}

fn head() -> String {
    format!(
        "(kicad_sch
\t(version 20231120)
\t(generator \"xtask\")
\t(generator_version \"8.0\")
\t(uuid \"{}\")
\t(paper \"{}\")
\t(title_block
\t\t(title \"Winch board\")
\t\t(comment 1 \"Written by cargo xtask schematic from docs/board.net\")
\t\t(comment 2 \"Not built or measured yet\")
\t)
",
        uuid("sheet"),
        sheet::PAPER
    )
}

/// The title of a group.
fn heading(title: &Placed<&str>) -> String {
    let (text, id) = (quoted(title.what), uuid(&format!("title {}", title.what)));
    format!(
        "\t(text {text} (exclude_from_sim no) (at {} 0)
\t\t(effects (font (size 2.54 2.54)) (justify left))
\t\t(uuid \"{id}\")
\t)
",
        at(title.x, title.y)
    )
}

/// A part on the sheet.
fn placed(part: &Part, pins: &[Pin], symbol: &Symbol, (x, y): (i32, i32)) -> String {
    let Part {
        reference,
        value,
        description,
        kind,
    } = part;
    let flag = reference.starts_with('#');
    let listed = if flag { "no" } else { "yes" };
    let (left, above, below) = (x - symbol.half, y - symbol.rows - 2, y + symbol.rows + 2);
    let width = i32::try_from(reference.len()).unwrap_or(0) + 2;
    let mut text = format!(
        "\t(symbol (lib_id {}) (at {} 0) (unit 1)
\t\t(exclude_from_sim no) (in_bom {listed}) (on_board {listed}) (dnp no)
\t\t(uuid \"{}\")
",
        quoted(&format!("{NAME}:{kind}")),
        at(x, y),
        uuid(reference)
    );
    let (of_reference, of_value) = if flag {
        (hidden(left, above), shown(left, above))
    } else {
        (shown(left, above), shown(left + width, above))
    };
    for (name, value, place) in [
        ("Reference", reference.as_str(), of_reference),
        ("Value", value, of_value),
        ("Footprint", "", hidden(x, y)),
        ("Datasheet", "", hidden(x, y)),
        ("Description", description, note(left, below)),
    ] {
        text += &format!("\t\t(property \"{name}\" {} {place})\n", quoted(value));
    }
    for pin in pins {
        let id = uuid(&format!("{reference} {}", pin.number));
        text += &format!("\t\t(pin {} (uuid \"{id}\"))\n", quoted(&pin.number));
    }
    let (path, reference) = (uuid("sheet"), quoted(reference));
    text += &format!(
        "\t\t(instances
\t\t\t(project \"{NAME}\"
\t\t\t\t(path \"/{path}\" (reference {reference}) (unit 1))
\t\t\t)
\t\t)
\t)
"
    );
    text
}

/// The wire from a pin, and the label of its net.
fn connected(name: &str, net: &str, pin: &Pin, end: End, (x, y): (i32, i32)) -> String {
    let (from, y) = (x + end.x, y + end.y);
    let (to, turn, side) = if end.left {
        (from - WIRE, 180, "right")
    } else {
        (from + WIRE, 0, "left")
    };
    let shape = match pin.electrical.as_str() {
        "input" => "input",
        "output" => "output",
        "bidirectional" => "bidirectional",
        _ => "passive",
    };
    let (begin, finish) = (at(from, y), at(to, y));
    let (wire, label) = (
        uuid(&format!("wire {name}")),
        uuid(&format!("label {name}")),
    );
    format!(
        "\t(wire (pts (xy {begin}) (xy {finish}))
\t\t(stroke (width 0) (type default))
\t\t(uuid \"{wire}\")
\t)
\t(global_label {} (shape {shape}) (at {finish} {turn}) (fields_autoplaced yes)
\t\t(effects (font (size 1.27 1.27)) (justify {side}))
\t\t(uuid \"{label}\")
\t\t(property \"Intersheetrefs\" \"${{INTERSHEET_REFS}}\" (at {finish} 0)
\t\t\t(effects (font (size 1.27 1.27)) (justify {side}) (hide yes))
\t\t)
\t)
",
        quoted(net)
    )
}

/// The mark of a pin that is left open on purpose.
fn open(name: &str, end: End, (x, y): (i32, i32)) -> String {
    let id = uuid(&format!("open {name}"));
    format!(
        "\t(no_connect (at {}) (uuid \"{id}\"))\n",
        at(x + end.x, y + end.y)
    )
}

/// A point in millimetres, from grid units of 1.27 mm.
pub(crate) fn at(x: i32, y: i32) -> String {
    format!("{} {}", millimetres(x), millimetres(y))
}

/// Grid units of 1.27 mm as millimetres, without trailing zeros, as KiCad writes them.
pub(crate) fn millimetres(units: i32) -> String {
    let hundredths = units * 127;
    let sign = if hundredths < 0 { "-" } else { "" };
    let (whole, rest) = (hundredths.abs() / 100, hundredths.abs() % 100);
    let text = format!("{sign}{whole}.{rest:02}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Place and look of a field that is shown.
pub(crate) fn shown(x: i32, y: i32) -> String {
    format!(
        "(at {} 0) (effects (font (size 1.27 1.27)) (justify left))",
        at(x, y)
    )
}

/// The same in small letters.
fn note(x: i32, y: i32) -> String {
    format!(
        "(at {} 0) (effects (font (size 1 1)) (justify left))",
        at(x, y)
    )
}

/// Place of a field that is not shown.
pub(crate) fn hidden(x: i32, y: i32) -> String {
    format!(
        "(at {} 0) (effects (font (size 1.27 1.27)) (hide yes))",
        at(x, y)
    )
}

pub(crate) fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

/// An identifier that depends on the name alone, so that the same netlist gives the same file: the 128-bit FNV-1a hash,
/// marked as version 8 of RFC 9562.
fn uuid(name: &str) -> String {
    const BASIS: u128 = 0x6c62_272e_07bb_0142_62b8_2175_6295_c58d;
    const PRIME: u128 = 0x0100_0000_0000_0000_0000_013b;
    let hash = name.bytes().fold(BASIS, |hash, byte| {
        (hash ^ u128::from(byte)).wrapping_mul(PRIME)
    });
    let version = (hash & !(0xf << 76)) | (8 << 76);
    let marked = (version & !(0x3 << 62)) | (2 << 62);
    let hex = format!("{marked:032x}");
    let cut = |from: usize, to: usize| hex.get(from..to).unwrap_or_default();
    let parts = [cut(0, 8), cut(8, 12), cut(12, 16), cut(16, 20), cut(20, 32)];
    parts.join("-")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grid_units_are_written_as_kicad_writes_millimetres() {
        let written = [0, 1, -1, 2, 100, -250].map(millimetres);
        assert_eq!(written, ["0", "1.27", "-1.27", "2.54", "127", "-317.5"]);
    }

    #[test]
    fn an_identifier_has_its_version_and_variant() {
        let id = uuid("sheet");
        assert_eq!(id.len(), 36);
        assert_eq!(&id[14..15], "8");
        assert!("89ab".contains(&id[19..20]), "{id}");
        assert_ne!(id, uuid("sheeu"));
    }
}
