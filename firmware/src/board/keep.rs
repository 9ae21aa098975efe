//! What a reset leaves: the drives that this board has commanded, in RAM that a start does not clear, so that a
//! board can stop them before it has a configuration; and the lengths of its last tick, in the backup registers,
//! which keep them without a supply, too, where a battery is fitted (VBAT).
#![allow(unsafe_code, reason = "a linker section")]

use crate::identity::Reset;
use crate::pins::CABLES;
use core::sync::atomic::{AtomicU32, Ordering};
use embassy_stm32::pac;
use embassy_stm32::pac::bkp::regs::Dr;
use mcdpr_firmware::drives::last::{LastDrives, WORDS};
use mcdpr_firmware::kept::KeptLengths;
use mcdpr_protocol::{FaultId, Kept, List, ResetCause, TenthMicrometres};

/// Atomics may hold any bits, as memory after a reset requires.
#[unsafe(link_section = ".uninit.drives")]
static KEPT: [AtomicU32; WORDS] = [const { AtomicU32::new(0) }; WORDS];

/// The drives of the last configuration, if there was one since power-on. After power-on the contents are random;
/// a checksum detects that.
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

/// Place of the brakes, behind the lengths' lower and upper halves.
const BRAKES: usize = 2 * CABLES;
/// Place of the checksum: the last of the ten registers.
const CHECKSUM: usize = BRAKES + 1;

/// The backup registers.
pub struct Lengths {
    /// Those of before the reset, until the board has a reference again.
    before: Option<KeptLengths<CABLES>>,
    /// The encoders have counted since.
    counted: bool,
}

impl Lengths {
    /// Reads them. Must be called before the first tick, which writes them.
    pub fn open(reset: &Reset) -> Self {
        pac::RCC.apb1enr().modify(|w| w.set_bkpen(true));
        pac::PWR.cr().modify(|w| w.set_dbp(true));
        let read = |place: usize| pac::BKP.dr(place).read().0;
        let found = KeptLengths {
            lengths: core::array::from_fn(|cable| {
                (read(2 * cable) | read(2 * cable + 1) << 16).cast_signed()
            }),
            brakes_open: read(BRAKES).to_le_bytes()[0],
        };
        let [low, high, ..] = read(CHECKSUM).to_le_bytes();
        Self {
            before: found.checked(u16::from_le_bytes([low, high])),
            // A processor that hung was not reset before the watchdog's time had passed. A reset by the pin lasts as
            // long as the button is pressed. A supply that fell under 2.8 V may have been too low for the encoders.
            counted: match reset.cause {
                ResetCause::Software => true,
                ResetCause::Panic => reset.fault() == Some(FaultId::P4),
                _ => false,
            },
        }
    }

    /// Stores the lengths of this tick.
    pub fn keep(&mut self, lengths: Option<&KeptLengths<CABLES>>) {
        let write = |place: usize, half: u32| pac::BKP.dr(place).write_value(Dr(half));
        let Some(lengths) = lengths else {
            write(CHECKSUM, 0);
            return;
        };
        self.before = None;
        for (cable, length) in lengths.lengths.iter().enumerate() {
            let length = length.cast_unsigned();
            write(2 * cable, length & 0xFFFF);
            write(2 * cable + 1, length >> 16);
        }
        write(BRAKES, lengths.brakes_open.into());
        write(CHECKSUM, lengths.checksum().into());
    }

    /// Answers with those of before the reset.
    pub fn tell(&self, kept: &mut Kept) {
        if let Some(before) = &self.before {
            kept.lengths = List::collect(before.lengths.iter().copied().map(TenthMicrometres));
            kept.brakes_open = before.brakes_open;
            kept.counted = self.counted;
        }
    }
}
