//! docs/wiring.md tells the pins that the firmware uses, and its drawing is one.
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
