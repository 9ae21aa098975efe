//! Every class of instruction in the firmware's file must be among those that were checked.
//!
//! A class is a decoded instruction without its numbers: which operation, on what kind of operand,
//! with which flags, in 16 or 32 bits. Most are checked against an independent core (`oracle`).
//! Classes that this core lacks, or that need more than registers and RAM, are listed in
//! [`BY_HAND`] with the test that checks them by hand.

use super::decode::decode;
use super::op::{Alu, Flags, Op};
use crate::bus::FLASH;
use object::{Object, ObjectSection, ObjectSymbol, SymbolSection};
use std::collections::{BTreeMap, BTreeSet};

const CASES: &str = include_str!("../../tests/data/cases.txt");

/// Classes by their first words, and the test in `tests.rs` that checks each.
const BY_HAND: &[(&str, &str)] = &[
    (
        "AluImm { alu: Sub, flags: Never, rd: , rn: , imm:  } in 16",
        "shifts_that_leave_the_flags",
    ),
    (
        "AluReg { alu: Mov, flags: Never, rd: , rn: , rm: , shift: Lsr",
        "shifts_that_leave_the_flags",
    ),
    (
        "AluReg { alu: Mov, flags: Never, rd: , rn: , rm: , shift: Rrx",
        "shifts_that_leave_the_flags",
    ),
    ("Branch {", "jumps_go_where_they_say"),
    ("BranchReg {", "jumps_go_where_they_say"),
    ("Cps {", "masks_hold_back_what_they_should"),
    (
        "Load { width: Half, index: After",
        "loads_and_stores_move_their_base_before_or_after",
    ),
    (
        "LoadLiteral { width: Word",
        "literals_are_counted_from_the_next_word",
    ),
    (
        "LoadReg { width: Word, rt: , rn: , rm: , shift:  } in 16",
        "loads_and_stores_move_their_base_before_or_after",
    ),
    ("Nop in 32", "shifts_that_leave_the_flags"),
    (
        "Store { width: Byte, index: After",
        "loads_and_stores_move_their_base_before_or_after",
    ),
    (
        "Store { width: Word, index: Before",
        "loads_and_stores_move_their_base_before_or_after",
    ),
    ("TableBranch {", "table_branches_jump_by_twice_the_entry"),
    ("Undefined", "what_this_core_lacks_is_undefined"),
    ("Sev", "sleep_ends_with_an_event_or_an_interrupt"),
    ("Wfe", "sleep_ends_with_an_event_or_an_interrupt"),
];

const TESTS: &str = include_str!("tests.rs");

/// An instruction without its numbers.
fn class(op: Op, length: u8) -> String {
    let mut shown = format!("{op:?}");
    // What the expansion of a constant carries out is only seen in the flags of logic.
    if let Op::AluImm { alu, flags, .. } = op
        && (flags == Flags::Never
            || matches!(alu, Alu::Add | Alu::Adc | Alu::Sub | Alu::Sbc | Alu::Rsb))
        && let Some((before, _)) = shown.split_once(", carry")
    {
        shown = format!("{before} }}");
    }
    let plain = shown
        .chars()
        .filter(|sign| !matches!(sign, '0'..='9' | '-'));
    format!("{} in {} bits", plain.collect::<String>(), 8 * length)
}

/// Instructions of these half-words, one after the other, each with its address.
fn instructions(at: u32, code: &[u8]) -> Vec<(u32, Op, u8)> {
    let halves: Vec<u16> = code
        .chunks_exact(2)
        .map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
        .collect();
    let (mut place, mut all) = (0, Vec::new());
    while let Some(&first) = halves.get(place) {
        let second = halves.get(place + 1).copied().unwrap_or(0);
        let address = at + 2 * place as u32;
        let (op, length) = decode(address, first, second);
        all.push((address, op, length));
        place += usize::from(length / 2);
    }
    all
}

fn checked() -> BTreeSet<String> {
    let codes = CASES.lines().map(|line| {
        let code = line.split(' ').nth(4).expect("the code");
        (0..code.len())
            .step_by(2)
            .map(|at| u8::from_str_radix(&code[at..at + 2], 16).expect("hexadecimal"))
            .collect::<Vec<u8>>()
    });
    codes
        .flat_map(|code| instructions(FLASH, &code))
        .map(|(_, op, length)| class(op, length))
        .collect()
}

/// Classes of the firmware file, each with an address. Its symbols `$t` and `$d` distinguish
/// instructions from data.
fn used() -> BTreeMap<String, u32> {
    let built = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../target/thumbv7m-none-eabi/firmware/mcdpr-firmware"
    );
    let path = std::env::var("MCDPR_FIRMWARE").unwrap_or_else(|_| built.to_owned());
    let bytes = std::fs::read(&path)
        .unwrap_or_else(|error| panic!("{path}: {error}. Build the firmware with `cargo fw`"));
    let file = object::File::parse(&*bytes).expect("an ELF file");
    let mut used = BTreeMap::new();
    for section in file.sections() {
        let mut marks: Vec<(u64, bool)> = file
            .symbols()
            .filter(|symbol| symbol.section() == SymbolSection::Section(section.index()))
            .filter_map(|symbol| match symbol.name() {
                Ok(name) if name.starts_with("$t") => Some((symbol.address(), true)),
                Ok(name) if name.starts_with("$d") => Some((symbol.address(), false)),
                _ => None,
            })
            .collect();
        marks.sort_unstable();
        marks.push((section.address() + section.size(), false));
        let data = section.data().expect("the section's bytes");
        for pair in marks.windows(2) {
            let ((from, is_code), (to, _)) = (pair[0], pair[1]);
            if !is_code {
                continue;
            }
            let within = |address: u64| (address - section.address()) as usize;
            for (address, op, length) in instructions(from as u32, &data[within(from)..within(to)])
            {
                used.entry(class(op, length)).or_insert(address);
            }
        }
    }
    used
}

#[test]
fn every_class_of_the_firmware_is_checked() {
    let (checked, used) = (checked(), used());
    assert!(
        used.len() > 100,
        "{} classes: the file is not read",
        used.len()
    );
    for (start, test) in BY_HAND {
        assert!(
            TESTS.contains(&format!("\nfn {test}()")),
            "{start}: no test {test}"
        );
    }
    let by_hand = |name: &str| BY_HAND.iter().any(|(start, _)| name.starts_with(start));
    let missing: Vec<String> = used
        .iter()
        .filter(|(name, _)| !checked.contains(*name) && !by_hand(name))
        .map(|(name, at)| format!("{name} at {at:#x}"))
        .collect();
    println!(
        "{} classes, {} of them by hand",
        used.len(),
        used.keys().filter(|name| by_hand(name)).count()
    );
    assert!(missing.is_empty(), "not checked:\n{}", missing.join("\n"));
}
