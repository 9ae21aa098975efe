//! The drives that this board has commanded, in RAM that a start does not clear: a board that was
//! reset can stop them before it has a configuration. After power-on the contents are random; a
//! checksum detects that.
#![allow(unsafe_code, reason = "a linker section")]

use crate::pins::CABLES;
use core::sync::atomic::{AtomicU32, Ordering};
use mcdpr_firmware::drives::last::{LastDrives, WORDS};

/// Atomics may hold any bits, as memory after a reset requires.
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

/// Keeps the drives of a configuration that is being activated.
pub fn store(last: &LastDrives<CABLES>) {
    for (word, kept) in last.to_words().into_iter().zip(&KEPT) {
        kept.store(word, Ordering::Relaxed);
    }
}
