//! docs/board.kicad_sch connects what docs/board.net says. The file is read as KiCad reads it: by where pins, wires and
//! labels are. What writes it (`cargo xtask schematic`) shares no code with this reader.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

fn read(path: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// A text, or a list of a file in KiCad's format.
#[derive(Debug)]
enum Node {
    Text(String),
    List(Vec<Node>),
}

impl Node {
    fn parse(text: &str) -> Self {
        let mut open = vec![Vec::new()];
        let mut chars = text.chars().peekable();
        while let Some(c) = chars.next() {
            match c {
                '(' => open.push(Vec::new()),
                ')' => {
                    let list = Self::List(open.pop().unwrap());
                    open.last_mut().unwrap().push(list);
                }
                '"' => {
                    let mut text = String::new();
                    loop {
                        match chars.next().unwrap() {
                            '"' => break,
                            '\\' => text.push(chars.next().unwrap()),
                            c => text.push(c),
                        }
                    }
                    open.last_mut().unwrap().push(Self::Text(text));
                }
                c if c.is_whitespace() => {}
                c => {
                    let mut word = c.to_string();
                    while let Some(c) = chars.next_if(|c| !c.is_whitespace() && !"()".contains(*c))
                    {
                        word.push(c);
                    }
                    open.last_mut().unwrap().push(Self::Text(word));
                }
            }
        }
        let mut all = open.pop().unwrap();
        assert!(open.is_empty() && all.len() == 1, "lists are not closed");
        all.pop().unwrap()
    }

    fn items(&self) -> &[Node] {
        match self {
            Self::List(items) => items,
            Self::Text(text) => panic!("{text} is not a list"),
        }
    }

    /// The text at this place; place 0 has the list's name.
    fn text(&self, place: usize) -> &str {
        match self.items().get(place) {
            Some(Self::Text(text)) => text,
            other => panic!("no text but {other:?}"),
        }
    }

    fn all<'n>(&'n self, name: &str) -> impl Iterator<Item = &'n Node> {
        self.items()
            .iter()
            .filter(move |item| matches!(item, Self::List(_)) && item.text(0) == name)
    }

    fn one(&self, name: &str) -> &Node {
        let mut found = self.all(name);
        let first = found.next().unwrap_or_else(|| panic!("no {name}"));
        assert!(found.next().is_none(), "{name} is there twice");
        first
    }

    fn property(&self, name: &str) -> &str {
        let mut all = self.all("property");
        all.find(|property| property.text(1) == name)
            .unwrap()
            .text(2)
    }

    /// The point at `place`, in hundredths of a millimetre.
    fn point(&self, place: usize) -> Point {
        (
            hundredths(self.text(place)),
            hundredths(self.text(place + 1)),
        )
    }
}

type Point = (i64, i64);
/// A pin: its part's reference, and its number.
type Pin = (String, String);

fn hundredths(text: &str) -> i64 {
    let (whole, part) = text.split_once('.').unwrap_or((text, ""));
    assert!(part.len() <= 2, "{text} is finer than a hundredth");
    format!("{whole}{part:0<2}").parse().unwrap()
}

/// Nets, by their names, and pins that are marked as open.
#[derive(Debug, Default, PartialEq)]
struct Connections {
    nets: BTreeMap<String, BTreeSet<Pin>>,
    open: BTreeSet<Pin>,
}

/// Every pin of every symbol with the place of its end; flags for KiCad's check are parts whose names begin with `#`.
fn pins(sheet: &Node) -> Vec<(Pin, Point)> {
    let mut pins = Vec::new();
    for symbol in sheet.all("symbol") {
        let (at, kind) = (symbol.one("at"), symbol.one("lib_id").text(1));
        assert!(
            at.text(3) == "0" && symbol.all("mirror").count() == 0,
            "this reader knows upright symbols only"
        );
        let (x, y) = at.point(1);
        let mut kinds = sheet.one("lib_symbols").all("symbol");
        let known = kinds.find(|known| known.text(1) == kind).unwrap();
        let before = pins.len();
        for pin in known.all("symbol").flat_map(|unit| unit.all("pin")) {
            let (right, up) = pin.one("at").point(1);
            let number = pin.one("number").text(1).to_owned();
            let reference = symbol.property("Reference").to_owned();
            pins.push(((reference, number), (x + right, y - up)));
        }
        assert_eq!(pins.len() - before, symbol.all("pin").count());
    }
    pins
}

fn touches((from, to): &(Point, Point), (x, y): Point) -> bool {
    let within = |a: i64, b: i64, c: i64| a.min(b) <= c && c <= a.max(b);
    let cross = (to.0 - from.0) * (y - from.1) - (to.1 - from.1) * (x - from.0);
    cross == 0 && within(from.0, to.0, x) && within(from.1, to.1, y)
}

/// What the drawing connects. Points are one where they are equal or on a wire, and where labels have one name.
fn drawn(text: &str) -> Connections {
    let sheet = Node::parse(text);
    let pins = pins(&sheet);
    let ends = |wire: &Node| {
        let points: Vec<_> = wire.one("pts").all("xy").map(|xy| xy.point(1)).collect();
        let [from, to] = points[..] else {
            panic!("a wire has two ends: {wire:?}")
        };
        (from, to)
    };
    let wires: Vec<_> = sheet.all("wire").map(ends).collect();
    let labels = sheet.all("global_label");
    let labels: Vec<_> = labels
        .map(|label| (label.text(1), label.one("at").point(1)))
        .collect();
    // The name of each wire: from the labels on it, and over wires that end on it.
    let mut names: Vec<BTreeSet<&str>> = vec![BTreeSet::new(); wires.len()];
    for (name, at) in &labels {
        let mut on = 0;
        for (wire, names) in wires.iter().zip(&mut names) {
            if touches(wire, *at) {
                names.insert(name);
                on += 1;
            }
        }
        assert!(on > 0, "the label {name} at {at:?} is on no wire");
    }
    for (index, wire) in wires.iter().enumerate() {
        for (other, their) in wires.iter().enumerate() {
            let apart = !(touches(wire, their.0) || touches(wire, their.1));
            assert!(
                index == other || apart,
                "two wires touch; this reader knows single ones only"
            );
        }
    }
    let mut marks: BTreeSet<Point> = sheet
        .all("no_connect")
        .map(|mark| mark.one("at").point(1))
        .collect();
    let mut found = Connections::default();
    for (pin, at) in &pins {
        let alone = pins.iter().filter(|other| other.1 == *at).count() == 1;
        assert!(alone, "another pin is where {pin:?} is");
        let mut on = BTreeSet::new();
        for (wire, names) in wires.iter().zip(&names) {
            if touches(wire, *at) {
                on.extend(names.iter().copied());
            }
        }
        let marked = marks.remove(at);
        match (on.len(), marked) {
            (0, true) => _ = found.open.insert(pin.clone()),
            (1, false) => {
                let net = (*on.first().unwrap()).to_owned();
                found.nets.entry(net).or_default().insert(pin.clone());
            }
            _ => panic!("{pin:?} is on {on:?}, marked as open: {marked}"),
        }
    }
    assert!(marks.is_empty(), "marks on no pin: {marks:?}");
    found
}

/// What the netlist says, and the parts: reference, value, description.
fn listed(text: &str) -> (Connections, BTreeSet<[String; 3]>) {
    let list = Node::parse(text);
    let mut said = Connections::default();
    for net in list.one("nets").all("net") {
        let pin = |node: &Node| {
            let text = |key| node.one(key).text(1).to_owned();
            (text("ref"), text("pin"))
        };
        let pins = net.all("node").map(pin).collect();
        let name = net.one("name").text(1).to_owned();
        assert!(said.nets.insert(name, pins).is_none());
    }
    let mut parts = BTreeSet::new();
    for part in list.one("components").all("comp") {
        let text = |key| part.one(key).text(1).to_owned();
        parts.insert([text("ref"), text("value"), text("description")]);
        let kind = part.one("libsource").one("part").text(1);
        let mut kinds = list.one("libparts").all("libpart");
        let known = kinds.find(|known| known.one("part").text(1) == kind);
        for pin in known.unwrap().one("pins").all("pin") {
            let pin = (text("ref"), pin.one("num").text(1).to_owned());
            if !said.nets.values().any(|pins| pins.contains(&pin)) {
                said.open.insert(pin);
            }
        }
    }
    (said, parts)
}

#[test]
fn the_schematic_connects_what_the_net_list_says_pin_by_pin() {
    let (said, parts) = listed(&read("docs/board.net"));
    let text = read("docs/board.kicad_sch");
    let mut found = drawn(&text);
    for pins in found.nets.values_mut() {
        pins.retain(|pin| !pin.0.starts_with('#'));
    }
    assert!(said.nets.len() > 60, "{}", said.nets.len());
    for (name, pins) in &said.nets {
        assert_eq!(found.nets.get(name), Some(pins), "{name}");
    }
    assert_eq!(found, said);

    let sheet = Node::parse(&text);
    let symbols = sheet.all("symbol");
    let keys = ["Reference", "Value", "Description"];
    let shown = symbols.map(|symbol| keys.map(|key| symbol.property(key).to_owned()));
    let shown: BTreeSet<_> = shown.filter(|part| !part[0].starts_with('#')).collect();
    assert_eq!(shown, parts);
}

#[test]
fn only_these_pins_are_open() {
    let mut open = BTreeSet::new();
    for pin in ["NRST", "PA12", "PA15", "PB4", "PC13", "PC14", "PC15"] {
        open.insert(("U1".to_owned(), pin.to_owned()));
    }
    // Outputs of the buffers whose inputs are grounded.
    for part in ["U2", "U3"] {
        open.extend((11..15).map(|pin| (part.to_owned(), pin.to_string())));
    }
    // The transceiver's reference output.
    open.insert(("U4".to_owned(), "5".to_owned()));
    assert_eq!(listed(&read("docs/board.net")).0.open, open);
}

#[test]
fn every_point_is_on_kicads_grid() {
    let text = read("docs/board.kicad_sch");
    let sheet = Node::parse(&text);
    let marks = ["symbol", "global_label", "no_connect"];
    let marks = marks.into_iter().flat_map(|name| sheet.all(name));
    let marks = marks.map(|item| item.one("at").point(1));
    let wires = sheet.all("wire").flat_map(|wire| wire.one("pts").all("xy"));
    let points = marks.chain(wires.map(|xy| xy.point(1)));
    for (x, y) in points.chain(pins(&sheet).into_iter().map(|pin| pin.1)) {
        assert!(x % 127 == 0 && y % 127 == 0, "{x} {y}");
    }
}

/// A sheet with two resistors of two pins each; all of them are on the net A, or open.
const SMALL: &str = r#"(kicad_sch
  (lib_symbols (symbol "b:R" (symbol "R_1_1"
    (pin passive line (at -5.08 1.27 0) (number "1"))
    (pin passive line (at 5.08 0 180) (number "2")))))
  (symbol (lib_id "b:R") (at 25.4 25.4 0) (property "Reference" "R1") (pin "1") (pin "2"))
  (symbol (lib_id "b:R") (at 25.4 50.8 0) (property "Reference" "R2") (pin "1") (pin "2"))
  (wire (pts (xy 20.32 24.13) (xy 17.78 24.13))) (global_label "A" (at 17.78 24.13 180))
  (wire (pts (xy 20.32 49.53) (xy 17.78 49.53))) (global_label "A" (at 17.78 49.53 180))
  (no_connect (at 30.48 25.4)) (no_connect (at 30.48 50.8)))"#;

#[test]
fn labels_of_one_name_connect_and_others_do_not() {
    let pin = |part: &str, number: &str| (part.to_owned(), number.to_owned());
    let found = drawn(SMALL);
    let both = BTreeSet::from([pin("R1", "1"), pin("R2", "1")]);
    assert_eq!(found.nets, BTreeMap::from([("A".to_owned(), both)]));
    assert_eq!(found.open, [pin("R1", "2"), pin("R2", "2")].into());
    let apart = SMALL.replacen("label \"A\"", "label \"B\"", 1);
    assert_eq!(drawn(&apart).nets.len(), 2);
}

#[test]
#[should_panic(expected = "is on {}, marked as open: false")]
fn a_wire_that_misses_its_pin_by_a_grid_unit_does_not_connect() {
    drawn(&SMALL.replace("(xy 20.32 24.13)", "(xy 19.05 24.13)"));
}

#[test]
#[should_panic(expected = "is on no wire")]
fn a_label_beside_its_wire_does_not_name_it() {
    drawn(&SMALL.replace("(at 17.78 24.13 180)", "(at 17.78 25.4 180)"));
}

#[test]
#[should_panic(expected = "two wires touch")]
fn a_wire_over_another_is_noticed() {
    let short = "(wire (pts (xy 17.78 24.13) (xy 17.78 49.53))) (no_connect";
    drawn(&SMALL.replacen("(no_connect", short, 1));
}
