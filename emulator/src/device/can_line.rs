//! The CAN bus outside of the chip: arbitration, duration, and faults (ISO 11898-1).

use super::can::Can;
use std::collections::VecDeque;

/// A classic CAN frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CanFrame {
    /// 11 bits, or 29 where `extended`.
    pub id: u32,
    /// Whether the identifier has 29 bits.
    pub extended: bool,
    /// Whether it asks for data instead of carrying any.
    pub remote: bool,
    /// Data bytes, 0 to 8.
    pub length: u8,
    /// Data; zero beyond the length.
    pub data: [u8; 8],
}

impl CanFrame {
    /// A data frame with an identifier of 11 bits.
    ///
    /// # Panics
    /// For more than eight bytes.
    #[must_use]
    pub fn standard(id: u16, bytes: &[u8]) -> Self {
        assert!(bytes.len() <= 8, "a CAN frame has at most 8 bytes");
        let mut data = [0; 8];
        data[..bytes.len()].copy_from_slice(bytes);
        Self {
            id: u32::from(id & 0x7FF),
            length: bytes.len() as u8,
            data,
            ..Self::default()
        }
    }

    /// The lower, the more urgent: the bits of the arbitration field, in their order on the bus.
    pub(crate) const fn arbitration(&self) -> u32 {
        let remote = self.remote as u32;
        if self.extended {
            // Base, SRR and IDE recessive, extension, RTR.
            // The first 11 bits at the same places as those of a standard frame: both kinds can be
            // compared.
            (self.id >> 18) << 21 | 0b11 << 19 | (self.id & 0x3_FFFF) << 1 | remote
        } else {
            self.id << 21 | remote << 20
        }
    }

    /// Bits on the wire from the start of frame to the end of the interframe space, with those
    /// stuffed after every five alike up to the checksum's end.
    pub(crate) fn bits(&self) -> u64 {
        let mut stuffing = Stuffing::default();
        stuffing.put(0, 1);
        if self.extended {
            stuffing.put(self.id >> 18, 11);
            // SRR and IDE, both recessive.
            stuffing.put(0b11, 2);
            stuffing.put(self.id & 0x3_FFFF, 18);
            // RTR, and two reserved dominant bits.
            stuffing.put(u32::from(self.remote) << 2, 3);
        } else {
            stuffing.put(self.id, 11);
            // RTR, IDE, and a reserved dominant bit.
            stuffing.put(u32::from(self.remote) << 2, 3);
        }
        stuffing.put(u32::from(self.length), 4);
        if !self.remote {
            for &byte in self.data.iter().take(usize::from(self.length)) {
                stuffing.put(u32::from(byte), 8);
            }
        }
        // The argument is taken before `put` changes the checksum.
        stuffing.put(stuffing.checksum, 15);
        // Delimiter, acknowledge and its delimiter, end of frame, interframe space.
        stuffing.bits + 1 + 2 + 7 + 3
    }
}

/// Counts bits with stuffing.
#[derive(Default)]
struct Stuffing {
    bits: u64,
    checksum: u32,
    last: u32,
    run: u32,
}

impl Stuffing {
    fn put(&mut self, value: u32, width: u32) {
        for place in (0..width).rev() {
            let bit = value >> place & 1;
            // CRC-15-CAN.
            let next = bit ^ (self.checksum >> 14 & 1);
            self.checksum = self.checksum << 1 & 0x7FFF ^ if next != 0 { 0x4599 } else { 0 };
            self.push(bit);
            // The stuffed bit itself begins a new run, but is not covered by the checksum.
            if self.run == 5 {
                self.push(bit ^ 1);
            }
        }
    }

    fn push(&mut self, bit: u32) {
        self.bits += 1;
        self.run = if self.run > 0 && bit == self.last {
            self.run + 1
        } else {
            1
        };
        self.last = bit;
    }
}

/// Outcome of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    Good,
    NoAcknowledge,
    Destroyed,
}

/// Connection of the chip's CAN pins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CanWiring {
    /// The other nodes' bit rate, bit/s.
    pub bitrate: u32,
    /// Whether there is another node, which acknowledges.
    pub others: bool,
    /// The two wires are shorted: no frame passes.
    pub shorted: bool,
}

#[derive(Debug, Clone, Copy)]
enum Sender {
    Chip(usize),
    Other,
}

#[derive(Debug, Clone, Copy)]
struct Transfer {
    sender: Sender,
    frame: CanFrame,
    outcome: Outcome,
    ends_at: u64,
}

/// The bus.
#[derive(Debug, Clone)]
pub(crate) struct CanLine {
    pub wiring: CanWiring,
    /// Frames to be destroyed from now on.
    pub destroy: u32,
    /// Frames of the other nodes, each with the time from which it waits.
    waiting: VecDeque<(u64, CanFrame)>,
    transfer: Option<Transfer>,
    idle_at: u64,
    /// Frames of the chip that the others have received, with their ends.
    pub delivered: Vec<(u64, CanFrame)>,
}

/// Error flag, its echo and its delimiter, interframe space.
// Worst case: other nodes answer with a whole flag of their own, six bits later.
const ERROR_BITS: u64 = 6 + 6 + 8 + 3;
/// Waiting time of an error passive sender before it tries again.
// ISO 11898-1: so that a passive node lets the others go first.
const SUSPEND_BITS: u64 = 8;
/// Two nodes understand each other within this share of their bit rates, per mille.
// 0.5 %: with a jump width of 2 and bits of 18 quanta the oscillators may differ by 2 / (20 x 18) =
// 0.56 %.
const TOLERANCE: u64 = 5;

impl CanLine {
    pub const fn new() -> Self {
        Self {
            wiring: CanWiring {
                bitrate: 1_000_000,
                others: false,
                shorted: false,
            },
            destroy: 0,
            waiting: VecDeque::new(),
            transfer: None,
            idle_at: 0,
            delivered: Vec::new(),
        }
    }

    /// Another node wants to send a frame from `at` on.
    pub fn offer(&mut self, at: u64, frame: CanFrame) {
        // After those of the same time: a node's frames keep their order.
        let place = self.waiting.partition_point(|(other, _)| *other <= at);
        self.waiting.insert(place, (at, frame));
    }

    /// When the bus is free for a node that wants to join; never while it is shorted.
    pub(crate) fn idle_from(&self, now: u64) -> u64 {
        if self.wiring.shorted {
            // No recessive bit passes a shorted bus: 11 of them in a row never come.
            u64::MAX
        } else {
            self.transfer
                .map_or(now, |transfer| transfer.ends_at)
                .max(now)
        }
    }

    /// The mailbox that is on the wire now.
    pub const fn busy(&self) -> Option<usize> {
        match self.transfer {
            Some(Transfer {
                sender: Sender::Chip(mailbox),
                ..
            }) => Some(mailbox),
            _ => None,
        }
    }

    /// The chip was reset: its current frame is cut off.
    pub(crate) fn cut_off(&mut self) {
        if self.busy().is_some() {
            self.transfer = None;
        }
    }

    pub fn next_event(&self, can: &Can, now: u64) -> u64 {
        let joins = can.joins_at.unwrap_or(u64::MAX);
        let next = match self.transfer {
            Some(transfer) => transfer.ends_at,
            None => {
                let other = self.waiting.front().map_or(u64::MAX, |(at, _)| *at);
                let own = if can.candidate().is_some() {
                    now
                } else {
                    u64::MAX
                };
                let next = other.min(own);
                if next == u64::MAX {
                    next
                } else {
                    // Nothing starts before the interframe space has ended.
                    next.max(self.idle_at)
                }
            }
        };
        next.min(joins)
    }

    /// Brings the bus up to `now`. `bit`: the chip's bit in ticks; `wired`: its two pins belong to
    /// CAN.
    pub fn service(&mut self, can: &mut Can, now: u64, bit: u64, wired: (bool, bool)) {
        // First: a controller that joins now takes part in the arbitration at this moment.
        if can.joins_at.is_some_and(|at| at <= now) {
            can.join();
        }
        loop {
            if let Some(transfer) = self.transfer {
                if transfer.ends_at > now {
                    return;
                }
                self.end(can, transfer, bit, wired);
            } else if !self.start(can, now, bit, wired) {
                return;
            }
        }
    }

    fn other_bit(&self) -> u64 {
        super::TICKS_PER_SECOND / u64::from(self.wiring.bitrate.max(1))
    }

    fn agrees(&self, bit: u64) -> bool {
        let theirs = self.other_bit();
        // Per mille of the other nodes' bit, in integers.
        bit.abs_diff(theirs) * 1000 <= theirs * TOLERANCE
    }

    fn start(&mut self, can: &mut Can, now: u64, bit: u64, wired: (bool, bool)) -> bool {
        let own = can.candidate();
        let first = self.waiting.front().map_or(u64::MAX, |(at, _)| *at);
        let begin = self
            .idle_at
            .max(if own.is_some() { first.min(now) } else { first });
        if begin > now {
            return false;
        }
        // All nodes that wait by now take part in the arbitration.
        let ready = self.waiting.iter().take_while(|(at, _)| *at <= begin);
        let urgent = ready
            .enumerate()
            .min_by_key(|(index, (_, frame))| (frame.arbitration(), *index));
        let urgent = urgent.map(|(index, (_, frame))| (index, *frame));
        // With equal identifiers both send on; the chip's frame is taken.
        let own_wins = |own: &CanFrame| {
            urgent.is_none_or(|(_, other)| own.arbitration() <= other.arbitration())
        };
        match (own, urgent) {
            (Some((mailbox, frame)), _) if own_wins(&frame) => {
                // A sender reads back each bit: without its receive pin it sees an error at once.
                let heard = wired.0 && wired.1;
                let outcome = if !heard || self.wiring.shorted || self.spoils() {
                    Outcome::Destroyed
                } else if !self.wiring.others {
                    Outcome::NoAcknowledge
                } else if self.agrees(bit) {
                    Outcome::Good
                } else {
                    Outcome::Destroyed
                };
                self.transfer = Some(Transfer {
                    sender: Sender::Chip(mailbox),
                    frame,
                    outcome,
                    ends_at: begin + length(&frame, outcome, can.is_passive()) * bit,
                });
                true
            }
            (own, Some((index, frame))) => {
                if let Some((mailbox, _)) = own {
                    // Unless NART is set, the mailbox takes part in the next arbitration.
                    can.lose(mailbox);
                }
                self.waiting.remove(index);
                let bad = self.wiring.shorted || self.spoils();
                let outcome = if bad {
                    Outcome::Destroyed
                } else {
                    Outcome::Good
                };
                self.transfer = Some(Transfer {
                    sender: Sender::Other,
                    frame,
                    outcome,
                    ends_at: begin + length(&frame, outcome, false) * self.other_bit(),
                });
                true
            }
            _ => false,
        }
    }

    fn spoils(&mut self) -> bool {
        let spoils = self.destroy > 0;
        self.destroy = self.destroy.saturating_sub(1);
        spoils
    }

    fn end(&mut self, can: &mut Can, transfer: Transfer, bit: u64, wired: (bool, bool)) {
        self.transfer = None;
        self.idle_at = transfer.ends_at;
        let Transfer {
            frame,
            outcome,
            ends_at,
            ..
        } = transfer;
        match transfer.sender {
            Sender::Chip(mailbox) => {
                can.sent(mailbox, outcome, ends_at, bit);
                if self.wiring.shorted {
                    // No bit is recessive, so there is nothing to wait for.
                    can.joins_at = can.joins_at.map(|_| u64::MAX);
                }
                if outcome == Outcome::Good {
                    self.delivered.push((ends_at, frame));
                }
            }
            Sender::Other => {
                let understood = if self.agrees(bit) {
                    outcome
                } else {
                    Outcome::Destroyed
                };
                if wired.0 {
                    can.received(&frame, understood);
                }
                if outcome != Outcome::Good && !self.wiring.shorted {
                    // Its sender tries again.
                    // At the front, since it was on the wire before the others.
                    self.waiting.push_front((ends_at, frame));
                }
            }
        }
        can.abort_waiting(None);
    }
}

/// Bits until the bus is free again.
fn length(frame: &CanFrame, outcome: Outcome, passive: bool) -> u64 {
    let suspend = if passive { SUSPEND_BITS } else { 0 };
    match outcome {
        Outcome::Good => frame.bits(),
        // Detected after the checksum, or somewhere before.
        Outcome::NoAcknowledge => frame.bits() - 10 + ERROR_BITS + suspend,
        Outcome::Destroyed => frame.bits() / 2 + ERROR_BITS + suspend,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stuffed_bits_are_as_counted_by_hand() {
        // 34 bits up to the checksum's end and 13 behind it, 8 per byte; stuffing adds one bit
        // per five alike at first and per four after that: 24 for eight bytes at most.
        let most = (34 + 64) + 24 + 13;
        let mut seen = 0;
        for id in [0, 0x078, 0x0F8, 0x555, 0x7FF] {
            for byte in [0x00, 0x3C, 0x55, 0x87, 0xC3, 0xE1, 0xFF] {
                let bits = CanFrame::standard(id, &[byte; 8]).bits();
                assert!(
                    (34 + 64 + 13..=most).contains(&bits),
                    "{id:x} {byte:x}: {bits}"
                );
                seen = seen.max(bits);
            }
        }
        assert!(seen > most - 6, "{seen}");
        // Start, identifier, three zeros and the first two of the length: 17 zeros alike take 3,
        // the rest 0000 and a zero checksum of 15 bits go on: 34 zeros, one stuffed after 5, then
        // one per 5 of the original bits.
        assert_eq!(CanFrame::standard(0, &[]).bits(), 34 + 6 + 13);
    }

    #[test]
    fn standard_frames_win_against_extended_ones_of_the_same_base() {
        let data = CanFrame::standard(0x123, &[]);
        let remote = CanFrame {
            remote: true,
            ..data
        };
        let extended = CanFrame {
            id: 0x123 << 18,
            extended: true,
            ..data
        };
        assert!(data.arbitration() < remote.arbitration());
        assert!(remote.arbitration() < extended.arbitration());
        assert!(extended.arbitration() < CanFrame::standard(0x124, &[]).arbitration());
    }
}
