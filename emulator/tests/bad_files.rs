//! Files that are not firmware for this chip: each is refused with its own error.

mod support;

use mcdpr_emulator::{Chip, LoadError};
use support::firmware;

fn refusal(bytes: &[u8]) -> LoadError {
    Chip::load(bytes).expect_err("it must be refused")
}

/// The file with these bytes changed.
fn changed(at: usize, bytes: &[u8]) -> Vec<u8> {
    let mut file = firmware();
    file[at..at + bytes.len()].copy_from_slice(bytes);
    file
}

#[test]
fn what_is_no_elf_file() {
    assert_eq!(refusal(b""), LoadError::NotElf);
    assert_eq!(refusal(b"S00F000068656C6C6F"), LoadError::NotElf);
}

#[test]
fn another_machine_or_class() {
    // e_machine 243 is RISC-V; EI_CLASS 2 is 64 bits; e_type 1 is an object file.
    assert_eq!(
        refusal(&changed(18, &[243, 0])),
        LoadError::WrongMachine(243)
    );
    assert_eq!(refusal(&changed(4, &[2])), LoadError::WrongKind);
    assert_eq!(refusal(&changed(16, &[1])), LoadError::WrongKind);
}

#[test]
fn a_truncated_file() {
    let file = firmware();
    for length in [5, 30, 60, 5000, file.len() / 2] {
        let error = refusal(&file[..length]);
        assert!(
            matches!(error, LoadError::Truncated { length: reported, needed } if reported == length && needed > length),
            "{length}: {error}"
        );
    }
}

#[test]
fn a_file_for_another_chip() {
    // The first program header's physical address, moved to where an RP2040 has its flash.
    let file = firmware();
    let headers = u32::from_le_bytes([file[28], file[29], file[30], file[31]]) as usize;
    let moved = (0..8)
        .map(|index| headers + 32 * index)
        .find(|&at| file[at] == 1 && file[at + 16..at + 20] != [0; 4])
        .expect("a part to load");
    let error = refusal(&changed(moved + 12, &0x1000_0000_u32.to_le_bytes()));
    assert!(
        matches!(
            error,
            LoadError::Outside {
                address: 0x1000_0000,
                ..
            }
        ),
        "{error}"
    );
    assert!(error.to_string().contains("another chip"));
}
