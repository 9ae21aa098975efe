//! Which drives this board has told what to do: in RAM that no start clears, so that a board that was
//! reset can stop them before it knows anything else. After power-on it holds anything; a checksum
//! tells.
#![allow(unsafe_code, reason = "a linker section")]

use crate::pins::CABLES;
use core::sync::atomic::{AtomicU32, Ordering};
use mcdpr_firmware::drives::last::{LastDrives, WORDS};

/// Atomics may hold any bits: exactly what memory after a reset is.
#[unsafe(link_section = ".uninit.drives")]
static KEPT: [AtomicU32; WORDS] = [const { AtomicU32::new(0) }; WORDS];

/// The drives of the last configuration, if there was one since power-on.
pub fn last() -> Option<LastDrives<CABLES>> {
    let mut words = [0; WORDS];
    for (word, kept) in words.iter_mut().zip(&KEPT) {
        *word = kept.load(Ordering::Relaxed);
    }
    LastDrives::from_words(&words)
}

/// Keeps the drives of a configuration that is taken into use.
pub fn store(last: &LastDrives<CABLES>) {
    for (word, kept) in last.to_words().into_iter().zip(&KEPT) {
        kept.store(word, Ordering::Relaxed);
    }
}
