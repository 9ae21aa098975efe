//! Calls of a line, packed: a line in virtual time returns its bytes one by one, and a separate
//! message for each would be ten times the size.
//!
//! A pack is the number of its first call (u32, little-endian) and the calls: time since the call
//! before (since 0 for the first of a pack), µs; twice the number of bytes, plus one towards the
//! board; the bytes. Both numbers are LEB128.

use mcdpr_core::link::{Direction, RawFrame};

/// Bytes after which a pack is written.
const FULL: usize = 4096;
/// Time after which a pack is written, µs.
const SPAN_US: u64 = 10_000;

/// Calls that gather.
#[derive(Debug, Default)]
pub struct Pack {
    bytes: Vec<u8>,
    first_us: u64,
    last_us: u64,
    next: u32,
}

impl Pack {
    /// Adds a call; returns the packs that are complete, each with the time of its first call, µs.
    pub fn push(&mut self, call: u32, frame: &RawFrame) -> Option<(u64, Vec<u8>)> {
        let mut done = None;
        let late = frame.time_us > self.first_us + SPAN_US;
        // A gap in the calls begins a new pack: within one they are counted, not numbered.
        if !self.bytes.is_empty() && (call != self.next || late || self.bytes.len() > FULL) {
            done = self.take();
        }
        if self.bytes.is_empty() {
            self.bytes.extend_from_slice(&call.to_le_bytes());
            self.first_us = frame.time_us;
            self.last_us = 0;
        }
        let size = (frame.bytes.len() as u64) << 1;
        put(
            &mut self.bytes,
            frame.time_us - self.last_us.min(frame.time_us),
        );
        put(
            &mut self.bytes,
            size | u64::from(frame.direction == Direction::ToBoard),
        );
        self.bytes.extend_from_slice(&frame.bytes);
        self.last_us = frame.time_us;
        self.next = call.wrapping_add(1);
        done
    }

    /// The collected calls, with the time of their first call, µs.
    pub fn take(&mut self) -> Option<(u64, Vec<u8>)> {
        (!self.bytes.is_empty()).then(|| (self.first_us, std::mem::take(&mut self.bytes)))
    }
}

fn put(out: &mut Vec<u8>, mut value: u64) {
    loop {
        let low = (value & 0x7F) as u8;
        value >>= 7;
        if value == 0 {
            out.push(low);
            return;
        }
        out.push(low | 0x80);
    }
}

fn get(bytes: &mut &[u8]) -> Option<u64> {
    let mut value = 0_u64;
    for shift in (0..64).step_by(7) {
        let (&byte, rest) = bytes.split_first()?;
        *bytes = rest;
        value |= u64::from(byte & 0x7F).checked_shl(shift)?;
        if byte & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

/// Unpacks: the number of the first call, and the calls. `None` for invalid bytes.
#[must_use]
pub fn unpack(pack: &[u8]) -> Option<(u32, Vec<RawFrame>)> {
    let (head, mut rest) = pack.split_first_chunk::<4>()?;
    let mut time_us = 0_u64;
    let mut frames = Vec::new();
    while !rest.is_empty() {
        time_us = time_us.checked_add(get(&mut rest)?)?;
        let size = get(&mut rest)?;
        let (bytes, left) = rest.split_at_checked(usize::try_from(size >> 1).ok()?)?;
        rest = left;
        frames.push(RawFrame {
            time_us,
            direction: if size & 1 == 1 {
                Direction::ToBoard
            } else {
                Direction::ToHost
            },
            bytes: bytes.to_vec(),
        });
    }
    Some((u32::from_le_bytes(*head), frames))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packs_give_back_what_went_in_and_break_at_holes() {
        let frame = |index: u64| RawFrame {
            time_us: 1_000_000 + index * 137,
            direction: if index.is_multiple_of(5) {
                Direction::ToBoard
            } else {
                Direction::ToHost
            },
            bytes: vec![7; usize::try_from(index % 300).unwrap()],
        };
        let mut pack = Pack::default();
        let mut packs = Vec::new();
        let numbers = (0..500_u32).filter(|number| *number != 200);
        for number in numbers.clone() {
            packs.extend(pack.push(number, &frame(u64::from(number))));
        }
        packs.extend(pack.take());
        let mut seen = Vec::new();
        for (first_us, bytes) in &packs {
            let (first, frames) = unpack(bytes).unwrap();
            assert_eq!(frames[0].time_us, *first_us);
            seen.extend((first..).zip(frames));
        }
        let wanted: Vec<_> = numbers.map(|n| (n, frame(u64::from(n)))).collect();
        assert_eq!(seen, wanted);
        assert_eq!(unpack(&[1, 2, 3]), None);
        assert_eq!(unpack(&[0, 0, 0, 0, 255, 255]), None);
    }
}
