//! The parts of an ELF file that go to a chip's memory, and its symbols (Tool Interface Standard,
//! ELF 1.2).

use crate::bus::{FLASH, FLASH_BYTES, RAM, RAM_BYTES};
use crate::error::LoadError;

/// A firmware file.
pub(crate) struct Image {
    pub flash: Vec<u8>,
    /// Address of the RTT control block, if there is one.
    pub rtt: Option<u32>,
}

const ARM: u16 = 40;
const EXECUTABLE: u16 = 2;
const LOAD: u32 = 1;
const SYMBOLS: u32 = 2;
const RTT: &[u8] = b"_SEGGER_RTT";

struct File<'a>(&'a [u8]);

impl File<'_> {
    fn bytes(&self, at: usize, length: usize) -> Result<&[u8], LoadError> {
        // Offsets come from the file: they must not overflow before they are checked.
        let needed = at.saturating_add(length);
        self.0.get(at..needed).ok_or(LoadError::Truncated {
            length: self.0.len(),
            needed,
        })
    }

    fn half(&self, at: usize) -> Result<u16, LoadError> {
        let bytes = self.bytes(at, 2)?;
        Ok(u16::from_le_bytes([bytes[0], bytes[1]]))
    }

    fn word(&self, at: usize) -> Result<u32, LoadError> {
        let bytes = self.bytes(at, 4)?;
        Ok(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }
}

/// Reads a firmware file.
pub(crate) fn load(bytes: &[u8]) -> Result<Image, LoadError> {
    let file = File(bytes);
    if !bytes.starts_with(b"\x7FELF") {
        return Err(LoadError::NotElf);
    }
    let kind = file.bytes(4, 2)?;
    // 32 bits, little-endian.
    if kind != [1, 1] {
        return Err(LoadError::WrongKind);
    }
    let machine = file.half(18)?;
    if machine != ARM {
        return Err(LoadError::WrongMachine(machine));
    }
    if file.half(16)? != EXECUTABLE {
        return Err(LoadError::WrongKind);
    }
    // Erased flash reads as ones.
    let mut flash = vec![0xFF; FLASH_BYTES as usize];
    let headers = file.word(28)? as usize;
    let (size, count) = (usize::from(file.half(42)?), usize::from(file.half(44)?));
    for header in (0..count).map(|index| headers + index * size) {
        let length = file.word(header + 16)?;
        if file.word(header)? != LOAD || length == 0 {
            continue;
        }
        let content = file.bytes(file.word(header + 4)? as usize, length as usize)?;
        // The physical address: initial values of RAM are loaded from flash.
        let address = file.word(header + 12)?;
        let from = address.wrapping_sub(FLASH) as usize;
        let slot = flash.get_mut(from..from.saturating_add(content.len()));
        let slot = slot.ok_or(LoadError::Outside {
            address,
            bytes: length,
        })?;
        slot.copy_from_slice(content);
    }
    let word = |at: usize| {
        flash
            .get(at..at + 4)
            .map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
    };
    let (stack, entry) = (word(0), word(4));
    // Checked here, so that a file for another chip is refused with a reason instead of a fault at
    // once.
    let good_stack = (RAM + 4..=RAM + RAM_BYTES).contains(&stack);
    if !good_stack || entry & 1 == 0 || !(FLASH..FLASH + FLASH_BYTES).contains(&entry) {
        return Err(LoadError::NoVectors { stack, entry });
    }
    let rtt = symbol(&file, RTT)?;
    Ok(Image { flash, rtt })
}

/// The flash content of a firmware file (ELF), from 0x08000000 on, without the erased rest: what a
/// debug probe must write.
///
/// # Errors
/// The file is not firmware for this chip.
pub fn flash_image(elf: &[u8]) -> Result<Vec<u8>, LoadError> {
    let mut flash = load(elf)?.flash;
    let used = flash.iter().rposition(|byte| *byte != 0xFF);
    // Flash is written by half-words.
    flash.truncate(used.map_or(0, |last| (last + 2) & !1));
    Ok(flash)
}

/// Value of a symbol.
fn symbol(file: &File<'_>, name: &[u8]) -> Result<Option<u32>, LoadError> {
    let sections = file.word(32)? as usize;
    let (size, count) = (usize::from(file.half(46)?), usize::from(file.half(48)?));
    for section in (0..count).map(|index| sections + index * size) {
        if file.word(section + 4)? != SYMBOLS {
            continue;
        }
        let from = file.word(section + 16)? as usize;
        let bytes = file.word(section + 20)? as usize;
        let strings = sections + file.word(section + 24)? as usize * size;
        let strings = file.word(strings + 16)? as usize;
        for entry in (from..from.saturating_add(bytes)).step_by(16) {
            let at = strings + file.word(entry)? as usize;
            let found = file.bytes(at, name.len() + 1);
            if found.is_ok_and(|found| found.split_last() == Some((&0, name))) {
                return Ok(Some(file.word(entry + 4)?));
            }
        }
    }
    Ok(None)
}
