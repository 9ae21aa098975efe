//! bxCAN: mailboxes, filters, receive FIFOs, error states (RM0008, 24).
//!
//! The controller alone: the shared bus is in [`super::can_line`].

use super::can_line::{CanFrame, Outcome};

const INRQ: u32 = 1;
const SLEEP: u32 = 1 << 1;
const TXFP: u32 = 1 << 2;
const RFLM: u32 = 1 << 3;
const NART: u32 = 1 << 4;
const ABOM: u32 = 1 << 6;
const RESET: u32 = 1 << 15;
const INAK: u32 = 1;
const SLAK: u32 = 1 << 1;
const ERRI: u32 = 1 << 2;
const LOOP_BACK: u32 = 1 << 30;
const SILENT: u32 = 1 << 31;
const BANKS: usize = 14;
const DEPTH: usize = 3;
/// Bits of an idle bus before a node may join.
const SYNC_BITS: u64 = 11;
/// Such sequences before a node comes back from bus-off.
const RECOVERY: u64 = 128;

const RQCP: u32 = 1;
const TXOK: u32 = 2;
const ALST: u32 = 4;
const TERR: u32 = 8;
const ABRQ: u32 = 0x80;

/// Last error codes.
const STUFF: u32 = 1;
const ACKNOWLEDGE: u32 = 3;
const BIT_DOMINANT: u32 = 5;

#[derive(Debug, Clone, Copy, Default)]
struct Mailbox {
    words: [u32; 4],
    pending: bool,
    abort: bool,
    /// Order of the requests, for `TXFP`.
    asked: u64,
}

/// Identifier, length and match index, data.
type Received = [u32; 4];

#[derive(Debug, Clone)]
pub(crate) struct Can {
    mcr: u32,
    msr: u32,
    ier: u32,
    btr: u32,
    /// Request results of the three mailboxes.
    results: [u32; 3],
    last_error: u32,
    pub tec: u32,
    pub rec: u32,
    bus_off: bool,
    mailboxes: [Mailbox; 3],
    asked: u64,
    fifos: [Vec<Received>; 2],
    fifo_flags: [u32; 2],
    filter_init: bool,
    filter_list: u32,
    filter_wide: u32,
    filter_fifo: u32,
    filter_on: u32,
    banks: [[u32; 2]; BANKS],
    /// Time at which it has seen enough of an idle bus to join (or to leave bus-off).
    pub joins_at: Option<u64>,
    /// It receives no frames, not even its own.
    pub broken: bool,
}

impl Can {
    pub fn new() -> Self {
        Self {
            // Reset values (RM0008, 24.9.2): asleep, with frozen reception while debugging.
            mcr: 0x0001_0000 | SLEEP,
            msr: SLAK,
            ier: 0,
            btr: 0x0123_0000,
            results: [0; 3],
            last_error: 0,
            tec: 0,
            rec: 0,
            bus_off: false,
            mailboxes: [Mailbox::default(); 3],
            asked: 0,
            fifos: [Vec::new(), Vec::new()],
            fifo_flags: [0; 2],
            filter_init: true,
            filter_list: 0,
            filter_wide: 0,
            filter_fifo: 0,
            filter_on: 0,
            banks: [[0; 2]; BANKS],
            joins_at: None,
            broken: false,
        }
    }

    /// Length of a bit, in cycles of APB1.
    pub(crate) const fn bit_cycles(&self) -> u64 {
        let prescaler = (self.btr & 0x3FF) as u64 + 1;
        let (first, second) = ((self.btr >> 16 & 15) as u64, (self.btr >> 20 & 7) as u64);
        // One quantum to synchronise, and both segments are coded less one.
        prescaler * (3 + first + second)
    }

    /// Whether it participates in the bus.
    pub const fn takes_part(&self) -> bool {
        // Neither in its set-up nor asleep, and the idle bits have been seen.
        self.msr & (INAK | SLAK) == 0 && !self.bus_off && self.joins_at.is_none()
    }

    pub(crate) const fn is_bus_off(&self) -> bool {
        self.bus_off
    }

    pub(crate) const fn is_passive(&self) -> bool {
        self.tec > 127 || self.rec > 127
    }

    /// The mailbox that is sent next, and its frame.
    pub fn candidate(&self) -> Option<(usize, CanFrame)> {
        // A silent controller only listens.
        if !self.takes_part() || self.btr & SILENT != 0 {
            return None;
        }
        self.next_waiting()
    }

    /// Silent loop back (RM0008, 24.4.4): waiting frames come back, without reaching the bus. Takes
    /// no time here.
    pub(crate) fn loop_back(&mut self) {
        if self.btr & LOOP_BACK == 0 || !self.takes_part() {
            return;
        }
        while let Some((mailbox, frame)) = self.next_waiting() {
            self.mailboxes[mailbox].pending = false;
            self.results[mailbox] |= RQCP | TXOK;
            if !self.broken {
                self.received(&frame, Outcome::Good);
            }
        }
    }

    fn next_waiting(&self) -> Option<(usize, CanFrame)> {
        let waiting = (0..3).filter(|&index| self.mailboxes[index].pending);
        let frames = waiting.map(|index| (index, frame_of(&self.mailboxes[index].words)));
        // Else the lowest identifier goes first, and two frames of one identifier may overtake.
        if self.mcr & TXFP != 0 {
            frames.min_by_key(|(index, _)| self.mailboxes[*index].asked)
        } else {
            frames.min_by_key(|(_, frame)| frame.arbitration())
        }
    }

    /// It lost the arbitration.
    pub(crate) fn lose(&mut self, mailbox: usize) {
        // No automatic retransmission: a lost arbitration ends the attempt.
        if self.mcr & NART != 0 {
            self.mailboxes[mailbox].pending = false;
            self.results[mailbox] |= RQCP;
        }
        self.results[mailbox] |= ALST;
    }

    /// Result of sending a mailbox.
    pub fn sent(&mut self, mailbox: usize, outcome: Outcome, now: u64, bit: u64) {
        match outcome {
            Outcome::Good => {
                self.mailboxes[mailbox].pending = false;
                self.results[mailbox] |= RQCP | TXOK;
                self.last_error = 0;
                // ISO 11898-1, fault confinement: plus 8 for a failed frame, minus 1 for a good
                // one.
                self.tec = self.tec.saturating_sub(1);
            }
            Outcome::NoAcknowledge | Outcome::Destroyed => {
                let lonely = outcome == Outcome::NoAcknowledge;
                // A node that is alone must not go bus-off: error passive at most.
                if !(lonely && self.is_passive()) {
                    self.tec += 8;
                }
                self.last_error = if lonely { ACKNOWLEDGE } else { BIT_DOMINANT };
                // An abort that was requested while the frame was on the wire takes effect at its
                // end.
                if self.mcr & NART != 0 || self.mailboxes[mailbox].abort {
                    self.mailboxes[mailbox].pending = false;
                    self.results[mailbox] |= RQCP | TERR;
                }
                if self.tec > 255 {
                    self.tec = 255;
                    self.bus_off = true;
                    // Without ABOM only a new set-up by software brings the controller back.
                    self.joins_at = None;
                    if self.mcr & ABOM != 0 {
                        self.joins_at = Some(now + self.join_bits() * bit);
                    }
                }
            }
        }
        self.mailboxes[mailbox].abort = false;
        self.note_errors();
    }

    /// A frame of another node has passed.
    pub fn received(&mut self, frame: &CanFrame, outcome: Outcome) {
        if !self.takes_part() {
            return;
        }
        if outcome != Outcome::Good {
            self.rec = (self.rec + 8).min(135);
            self.last_error = STUFF;
            self.note_errors();
            return;
        }
        // A passive receiver returns to between 119 and 127 with the first good frame.
        self.rec = if self.rec > 127 {
            120
        } else {
            self.rec.saturating_sub(1)
        };
        self.last_error = 0;
        let Some((fifo, index)) = self.matching(frame) else {
            return;
        };
        let words = words_of(frame);
        let entry = [words[0], words[1] | index << 8, words[2], words[3]];
        let queue = &mut self.fifos[fifo];
        if queue.len() < DEPTH {
            queue.push(entry);
            return;
        }
        self.fifo_flags[fifo] |= 1 << 4;
        // An unlocked FIFO overwrites its newest frame; the overrun flag is set either way.
        if self.mcr & RFLM == 0 {
            queue[DEPTH - 1] = entry;
        }
    }

    /// FIFO and filter number of the first filter that lets a frame through.
    fn matching(&self, frame: &CanFrame) -> Option<(usize, u32)> {
        if self.filter_init {
            return None;
        }
        let whole = words_of(frame)[0];
        let short = if frame.extended {
            (frame.id >> 18) << 5 | u32::from(frame.remote) << 4 | 1 << 3 | (frame.id >> 15 & 7)
        } else {
            frame.id << 5 | u32::from(frame.remote) << 4
        };
        let mut numbers = [0; 2];
        for bank in 0..BANKS {
            let bit = 1 << bank;
            let fifo = usize::from(self.filter_fifo & bit != 0);
            let [a, b] = self.banks[bank];
            let halves = [a & 0xFFFF, a >> 16, b & 0xFFFF, b >> 16];
            let list = self.filter_list & bit != 0;
            let found = match (self.filter_wide & bit != 0, list) {
                // Bit 0 is TXRQ in a mailbox and has no meaning in a filter.
                (true, false) => [((whole ^ a) & b) >> 1 == 0].iter().position(|&hit| hit),
                (true, true) => [a, b].iter().position(|id| (id ^ whole) >> 1 == 0),
                (false, false) => [0, 2]
                    .iter()
                    .position(|&at| (short ^ halves[at]) & halves[at + 1] == 0),
                (false, true) => halves.iter().position(|&id| id == short),
            };
            if self.filter_on & bit != 0
                && let Some(at) = found
            {
                return Some((fifo, numbers[fifo] + at as u32));
            }
            // Filter numbers count over all banks of a FIFO, active or not (RM0008, 24.7.4).
            numbers[fifo] += match (self.filter_wide & bit != 0, list) {
                (true, false) => 1,
                (true, true) | (false, false) => 2,
                (false, true) => 4,
            };
        }
        None
    }

    fn note_errors(&mut self) {
        let esr = self.esr();
        let causes = self.ier >> 8 & 7 & esr;
        // Warning, passive and bus-off have an enable bit each; the last error code has its own.
        if causes != 0 || (self.ier & 1 << 11 != 0 && self.last_error != 0) {
            self.msr |= ERRI;
        }
    }

    fn esr(&self) -> u32 {
        // 96: the warning limit of ISO 11898-1.
        let warning = self.tec >= 96 || self.rec >= 96;
        u32::from(warning)
            | u32::from(self.is_passive()) << 1
            | u32::from(self.bus_off) << 2
            | self.last_error << 4
            | self.tec.min(255) << 16
            | self.rec << 24
    }

    /// Bits of an idle bus until it joins.
    pub(crate) const fn join_bits(&self) -> u64 {
        SYNC_BITS * if self.bus_off { RECOVERY } else { 1 }
    }

    /// The time in [`Self::joins_at`] has come.
    pub fn join(&mut self) {
        self.joins_at = None;
        if self.bus_off {
            self.bus_off = false;
            self.tec = 0;
            self.rec = 0;
        }
        // The set-up ends only now: the bus has been idle for long enough.
        self.msr &= !INAK;
    }

    /// Interrupt lines: transmit, FIFO 0, FIFO 1, status.
    pub fn interrupts(&self) -> [bool; 4] {
        let sent = self.ier & 1 != 0 && self.results.iter().any(|result| result & RQCP != 0);
        let fifo = |index: usize| {
            let enabled = self.ier >> (1 + 3 * index);
            let count = self.fifos[index].len();
            enabled & 1 != 0 && count > 0
                || enabled & 2 != 0 && count == DEPTH
                || enabled & 4 != 0 && self.fifo_flags[index] & 1 << 4 != 0
        };
        let status = self.ier & 1 << 15 != 0 && self.msr & ERRI != 0;
        [sent, fifo(0), fifo(1), status]
    }

    fn tsr(&self) -> u32 {
        let results = (0..3).fold(0, |all, index| all | self.results[index] << (8 * index));
        let empty = (0..3).filter(|&index| !self.mailboxes[index].pending);
        // CODE: the mailbox that a driver is to fill next.
        let first = empty.clone().next().unwrap_or(0) as u32;
        empty.fold(results | first << 24, |all, index| all | 1 << (26 + index))
    }

    pub fn read(&self, offset: u32) -> Option<u32> {
        let fifo = |index: usize| {
            let count = self.fifos[index].len();
            self.fifo_flags[index] | count as u32 | u32::from(count == DEPTH) << 3
        };
        Some(match offset {
            0x00 => self.mcr,
            // The receive pin idles recessive.
            0x04 => self.msr | 0xC00,
            0x08 => self.tsr(),
            0x0C => fifo(0),
            0x10 => fifo(1),
            0x14 => self.ier,
            0x18 => self.esr(),
            0x1C => self.btr,
            0x180..0x1B0 => {
                let (mailbox, word) = ((offset - 0x180) / 16, (offset & 15) / 4);
                let mailbox = &self.mailboxes[mailbox as usize];
                let asks = u32::from(mailbox.pending && word == 0);
                mailbox.words[word as usize] | asks
            }
            0x1B0..0x1D0 => {
                let (index, word) = ((offset - 0x1B0) / 16, (offset & 15) / 4);
                let first = self.fifos[index as usize].first();
                first.map_or(0, |words| words[word as usize])
            }
            // FMR's reset value with its reserved bits.
            0x200 => 0x2A1C_0E00 | u32::from(self.filter_init),
            0x204 => self.filter_list,
            0x20C => self.filter_wide,
            0x214 => self.filter_fifo,
            0x21C => self.filter_on,
            0x240..0x2B0 => {
                let index = (offset - 0x240) / 4;
                self.banks[(index / 2) as usize][(index & 1) as usize]
            }
            _ => return None,
        })
    }

    /// `bit`: length of a bit in ticks; `idle_at`: when the bus is free.
    pub fn write(
        &mut self,
        offset: u32,
        value: u32,
        idle_at: u64,
        bit: u64,
    ) -> Result<(), &'static str> {
        let initialising = self.msr & INAK != 0;
        match offset {
            // A master reset clears everything. A defect of the controller stays.
            0x00 if value & RESET != 0 => {
                *self = Self {
                    broken: self.broken,
                    ..Self::new()
                };
            }
            0x00 => self.write_mcr(value, idle_at, bit),
            0x04 => self.msr &= !(value & 0x1C),
            0x08 => self.write_tsr(value),
            0x0C | 0x10 => {
                let index = usize::from(offset == 0x10);
                self.fifo_flags[index] &= !(value & 0x18);
                if value & 1 << 5 != 0 && !self.fifos[index].is_empty() {
                    // RFOM releases the oldest frame; the next one is there at once in this model.
                    self.fifos[index].remove(0);
                }
            }
            0x14 => self.ier = value,
            0x18 => self.last_error = value >> 4 & 7,
            // RM0008, 24.9.2: BTR can be written in the set-up only. A real chip ignores the write.
            0x1C if !initialising => return Err("CAN's bit timing changes outside of its set-up"),
            0x1C if value & LOOP_BACK != 0 && value & SILENT == 0 => {
                return Err("CAN's loop back onto the bus is not emulated");
            }
            0x1C => self.btr = value,
            0x180..0x1B0 => return self.write_mailbox(offset, value),
            0x200 => self.filter_init = value & 1 != 0,
            0x204 | 0x20C | 0x214 if !self.filter_init => {
                return Err("CAN's filters change outside of their set-up");
            }
            0x204 => self.filter_list = value & 0x3FFF,
            0x20C => self.filter_wide = value & 0x3FFF,
            0x214 => self.filter_fifo = value & 0x3FFF,
            0x21C => self.filter_on = value & 0x3FFF,
            0x240..0x2B0 => {
                let index = ((offset - 0x240) / 4) as usize;
                if !self.filter_init && self.filter_on & 1 << (index / 2) != 0 {
                    return Err("a CAN filter changes while it is on");
                }
                self.banks[index / 2][index & 1] = value;
            }
            _ => return Err("no such register"),
        }
        Ok(())
    }

    fn write_mcr(&mut self, value: u32, idle_at: u64, bit: u64) {
        self.mcr = value & 0x0001_00FF;
        // A request for the set-up outweighs one for sleep.
        if value & SLEEP != 0 && value & INRQ == 0 {
            self.msr = (self.msr | SLAK) & !INAK;
            self.joins_at = None;
            return;
        }
        self.msr &= !SLAK;
        if value & INRQ != 0 {
            self.msr |= INAK;
            self.joins_at = None;
        } else if self.msr & INAK != 0 && self.joins_at.is_none() {
            self.joins_at = Some(idle_at.saturating_add(self.join_bits() * bit));
        }
    }

    fn write_tsr(&mut self, value: u32) {
        for (index, result) in self.results.iter_mut().enumerate() {
            let bits = value >> (8 * index);
            // Clearing RQCP clears the mailbox's other results, too.
            if bits & RQCP != 0 {
                *result = 0;
            } else {
                *result &= !(bits & (TXOK | ALST | TERR));
            }
            if bits & ABRQ != 0 && self.mailboxes[index].pending {
                self.mailboxes[index].abort = true;
            }
        }
    }

    /// Aborts the mailboxes that were requested to abort and are not `busy` on the bus.
    pub(crate) fn abort_waiting(&mut self, busy: Option<usize>) {
        for (index, mailbox) in self.mailboxes.iter_mut().enumerate() {
            if mailbox.abort && busy != Some(index) {
                (mailbox.pending, mailbox.abort) = (false, false);
                self.results[index] |= RQCP;
            }
        }
    }

    fn write_mailbox(&mut self, offset: u32, value: u32) -> Result<(), &'static str> {
        let (index, word) = (
            ((offset - 0x180) / 16) as usize,
            ((offset & 15) / 4) as usize,
        );
        let mailbox = &mut self.mailboxes[index];
        // A driver that writes here would send a mixture of two frames.
        if mailbox.pending {
            return Err("a CAN mailbox changes while it waits to be sent");
        }
        if word != 0 {
            mailbox.words[word] = value;
            return Ok(());
        }
        mailbox.words[0] = value & !1;
        if value & 1 != 0 {
            if self.msr & SLAK != 0 {
                return Err("a CAN frame is sent while the controller sleeps");
            }
            self.asked += 1;
            (mailbox.pending, mailbox.asked) = (true, self.asked);
            self.results[index] = 0;
        }
        Ok(())
    }
}

fn frame_of(words: &[u32; 4]) -> CanFrame {
    let extended = words[0] & 4 != 0;
    let mut data = [0; 8];
    data[..4].copy_from_slice(&words[2].to_le_bytes());
    data[4..].copy_from_slice(&words[3].to_le_bytes());
    let length = (words[1] & 15).min(8) as u8;
    // Data beyond the length are not sent.
    data.iter_mut()
        .skip(usize::from(length))
        .for_each(|byte| *byte = 0);
    CanFrame {
        id: if extended {
            words[0] >> 3
        } else {
            words[0] >> 21
        },
        extended,
        remote: words[0] & 2 != 0,
        length,
        data,
    }
}

fn words_of(frame: &CanFrame) -> [u32; 4] {
    let id = if frame.extended {
        frame.id << 3 | 4
    } else {
        frame.id << 21
    };
    let half = |from: usize| {
        let d = &frame.data;
        u32::from_le_bytes([d[from], d[from + 1], d[from + 2], d[from + 3]])
    };
    [
        id | u32::from(frame.remote) << 1,
        u32::from(frame.length),
        half(0),
        half(4),
    ]
}
