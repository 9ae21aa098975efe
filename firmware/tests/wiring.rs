//! docs/wiring.md documents the pins that the firmware uses, and its drawing exists.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

use std::path::Path;

fn read(path: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn the_guides_pin_table_is_the_firmwares() {
    let source = read("firmware/src/board/pins.rs");
    let rows = source.lines().filter_map(|line| line.strip_prefix("//! |"));
    let rows: Vec<_> = rows.map(|row| format!("|{row}")).collect();
    assert!(rows.len() > 15, "{}", rows.len());
    let guide = read("docs/wiring.md");
    assert!(guide.contains(&rows.join("\n")), "{}", rows.join("\n"));
}

#[test]
fn every_element_of_the_drawing_is_closed() {
    let drawing = read("docs/schematic.svg");
    let mut open = Vec::new();
    for tag in drawing.split('<').skip(1) {
        let (tag, _) = tag.split_once('>').unwrap();
        let name = tag.split([' ', '/', '?']).find(|part| !part.is_empty());
        let name = name.unwrap();
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "in {tag}");
        } else if !tag.starts_with('?') && !tag.ends_with('/') {
            open.push(name);
        }
    }
    assert!(open.is_empty(), "{open:?}");
    assert!(drawing.contains("<svg") && drawing.matches("<text").count() > 20);
}

/// A net of `docs/board.net`: its name, and parts with their pins.
struct Net {
    name: String,
    nodes: Vec<(String, String)>,
}

impl Net {
    fn has(&self, part: &str, pin: &str) -> bool {
        self.nodes
            .iter()
            .any(|node| node.0 == part && node.1 == pin)
    }

    fn parts(&self) -> impl Iterator<Item = &str> {
        self.nodes.iter().map(|node| node.0.as_str())
    }
}

/// The quoted text after each `(key "` of a line.
fn quoted<'t>(line: &'t str, key: &str) -> Option<&'t str> {
    let from = line.find(&format!("({key} \""))? + key.len() + 3;
    line.get(from..)?.split('"').next()
}

/// Nets and the values of the parts, from KiCad's netlist format.
fn board() -> (Vec<Net>, Vec<(String, String)>) {
    let text = read("docs/board.net");
    assert_eq!(text.matches('(').count(), text.matches(')').count());
    let (mut nets, mut parts) = (Vec::<Net>::new(), Vec::new());
    for line in text.lines() {
        let text = |key| quoted(line, key).map(str::to_owned);
        if line.contains("(comp ") {
            parts.push((text("ref").unwrap(), text("value").unwrap()));
        } else if line.contains("(net ") {
            let name = text("name").unwrap();
            let nodes = Vec::new();
            nets.push(Net { name, nodes });
        } else if line.contains("(node ") {
            // By its name where it has one: U2 A1, not U2 2.
            let pin = text("pinfunction").or_else(|| text("pin"));
            let node = (text("ref").unwrap(), pin.unwrap());
            nets.last_mut().unwrap().nodes.push(node);
        }
    }
    (nets, parts)
}

/// Pins of the chip that the pin table gives a use on the carrier board.
fn used_pins() -> Vec<String> {
    let source = read("firmware/src/board/pins.rs");
    let rows = source
        .lines()
        .filter_map(|line| line.strip_prefix("//! | P"));
    let mut pins = Vec::new();
    for row in rows {
        let (cell, rest) = row.split_once(" | ").unwrap();
        let elsewhere = ["free", "reserved", "BOOT1", "status LED", "8 MHz"];
        if elsewhere.iter().any(|what| rest.starts_with(what)) {
            continue;
        }
        let cell = format!("P{cell}");
        if let Some((first, last)) = cell.split_once(" to ") {
            let number = |pin: &str| pin[2..].parse::<u8>().unwrap();
            pins.extend((number(first)..=number(last)).map(|pin| format!("{}{pin}", &first[..2])));
        } else {
            pins.extend(cell.split(", ").map(str::to_owned));
        }
    }
    pins
}

#[test]
fn the_net_list_has_every_pin_of_the_table_once_and_no_loose_end() {
    let (nets, parts) = board();
    let mut named: Vec<_> = parts.iter().map(|part| part.0.as_str()).collect();
    named.sort_unstable();
    named.dedup();
    assert_eq!(named.len(), parts.len(), "a part is there twice");
    for net in &nets {
        assert!(net.nodes.len() > 1, "{} ends nowhere", net.name);
        for part in net.parts() {
            assert!(
                named.binary_search(&part).is_ok(),
                "{part} is not a part of the board"
            );
        }
    }
    let mut pins = used_pins();
    let supply = ["5V", "3V3", "GND", "VBAT"].map(str::to_owned);
    let nodes = nets.iter().flat_map(|net| &net.nodes);
    let mut wired: Vec<_> = nodes
        .filter(|node| node.0 == "U1")
        .map(|node| node.1.clone())
        .collect();
    wired.retain(|pin| !supply.contains(pin));
    pins.sort_unstable();
    wired.sort_unstable();
    assert_eq!(pins, wired);
}

#[test]
fn the_net_list_keeps_every_pin_within_what_it_stands() {
    let (nets, parts) = board();
    let net_of = |part: &str, pin: &str| {
        let mut found = nets.iter().filter(|net| net.has(part, pin));
        found
            .next()
            .unwrap_or_else(|| panic!("{part} {pin} is not connected"))
    };
    let value = |part: &str| {
        parts
            .iter()
            .find(|known| known.0 == part)
            .unwrap()
            .1
            .as_str()
    };
    // A resistor or capacitor of this value from a net to another.
    let joins = |net: &Net, other: &str, what: &str| {
        let other = nets.iter().find(|net| net.name == other).unwrap();
        net.parts()
            .any(|part| value(part) == what && other.parts().any(|there| there == part))
    };
    for (a, b) in [
        ("PA8", "PA9"),
        ("PA0", "PA1"),
        ("PA6", "PA7"),
        ("PB6", "PB7"),
    ] {
        for pin in [a, b] {
            // Nothing but a buffer of 3.3 V drives an encoder's pin; its input is pulled up.
            let net = net_of("U1", pin);
            let driver = net.nodes.iter().find(|node| node.0 != "U1").unwrap();
            assert_eq!(
                (net.nodes.len(), value(&driver.0)),
                (2, "74LVC541A"),
                "{pin}"
            );
            assert!(net_of(&driver.0, "VCC").name == "+3V3");
            let input = net_of(&driver.0, &driver.1.replace('Y', "A"));
            assert!(joins(input, "+3V3", "4k7"), "{pin}");
        }
    }
    for pin in ["PA4", "PA5", "PB0", "PB1"] {
        let net = net_of("U1", pin);
        assert!(
            joins(net, "+3V3", "10k") && joins(net, "GND", "10nF"),
            "{pin}"
        );
    }
    for pin in ["PB12", "PB13", "PB14", "PB15", "PB3", "PA10"] {
        let net = net_of("U1", pin);
        let gate = nets
            .iter()
            .find(|gate| gate.name == format!("{}_G", net.name))
            .unwrap();
        assert!(joins(gate, "GND", "10k"), "{pin}");
        assert!(gate.parts().any(|part| value(part) == "AO3400A"), "{pin}");
    }
    // 24 V is connected to no pin of the chip, not even through one part.
    for net in nets.iter().filter(|net| net.name.starts_with("+24V")) {
        for part in net
            .parts()
            .filter(|part| !part.starts_with(['S', 'J', 'K']))
        {
            let beyond = nets
                .iter()
                .filter(|other| other.parts().any(|there| there == part));
            for other in beyond {
                assert!(
                    !other.parts().any(|part| part == "U1"),
                    "{} {part}",
                    other.name
                );
            }
        }
        assert!(!net.parts().any(|part| part == "U1"), "{}", net.name);
    }
    // A board that does not hold the gate low pulls the line, by the line's own supply; the chip's 3.3 V is not in it.
    let well = net_of("U1", "PA11");
    assert!(joins(well, "FAULT_LINE_SUPPLY", "10k"));
    assert!(well.parts().any(|part| value(part) == "AO3400A"));
    assert!(joins(net_of("U1", "PA2"), "FAULT_LINE", "1k"));
    let supply = nets.iter().find(|net| net.name == "FAULT_LINE_SUPPLY");
    assert!(
        supply
            .unwrap()
            .parts()
            .all(|part| ["J17", "R35"].contains(&part))
    );
    let emergency = net_of("U1", "PB5");
    assert!(joins(emergency, "+3V3", "2k2") && joins(emergency, "GND", "100nF"));
}
