//! USART3: bytes take the time given by its baud rate register (RM0008, 27).

use std::collections::VecDeque;

const TXE: u32 = 1 << 7;
const TC: u32 = 1 << 6;
const RXNE: u32 = 1 << 5;
const IDLE: u32 = 1 << 4;
const ORE: u32 = 1 << 3;
const FE: u32 = 1 << 1;
const ERRORS: u32 = 0xF;

const UE: u32 = 1 << 13;
const TE: u32 = 1 << 3;
const RE: u32 = 1 << 2;
const DMAT: u32 = 1 << 7;
const DMAR: u32 = 1 << 6;
/// Start bit, eight data bits, stop bit.
const BITS: u64 = 10;

#[derive(Debug, Clone, Default)]
pub(crate) struct Usart {
    sr: u32,
    brr: u32,
    cr1: u32,
    cr2: u32,
    cr3: u32,
    gtpr: u32,
    received: u8,
    /// Waits for the shift register.
    next: Option<u8>,
    shifting: Option<u8>,
    pub sent_at: Option<u64>,
    pub arrives_at: Option<u64>,
    /// Bytes on their way to the chip.
    pub line: VecDeque<u8>,
    /// Number of next bytes that arrive without a stop bit.
    pub damaged: u16,
    /// Sent by the chip.
    pub sent: Vec<u8>,
    /// The status was read since a flag was set: reading the data clears it.
    status_read: bool,
    pub overruns: u64,
}

impl Usart {
    pub fn new() -> Self {
        Self {
            sr: TXE | TC,
            ..Self::default()
        }
    }

    fn byte_ticks(&self, cycle: u64) -> u64 {
        BITS * u64::from(self.brr) * cycle
    }

    pub(crate) const fn wants_byte(&self) -> bool {
        self.cr3 & DMAT != 0 && self.cr1 & (UE | TE) == UE | TE && self.sr & TXE != 0
    }

    pub(crate) const fn offers_byte(&self) -> bool {
        self.cr3 & DMAR != 0 && self.sr & RXNE != 0
    }

    /// Whether the interrupt line is high.
    pub const fn interrupts(&self) -> bool {
        let enabled = self.cr1 & 0x1F0;
        // RXNEIE enables the overrun, too (RM0008, 27.4).
        let overrun = if self.sr & ORE != 0 { RXNE } else { 0 };
        let errors = self.cr3 & 1 != 0 && self.cr3 & DMAR != 0 && self.sr & ERRORS & !1 != 0;
        (self.sr | overrun) & enabled & 0xF0 != 0 || errors
    }

    /// Bytes for the chip appear on the line.
    pub fn send(&mut self, bytes: &[u8], now: u64, cycle: u64) {
        self.line.extend(bytes);
        if self.arrives_at.is_none() && !self.line.is_empty() && self.brr != 0 {
            self.arrives_at = Some(now + self.byte_ticks(cycle));
        }
    }

    /// The byte that is due has arrived; `wired`: the pin is an input.
    pub(crate) fn arrive(&mut self, cycle: u64, wired: bool) {
        let Some(byte) = self.line.pop_front() else {
            self.arrives_at = None;
            self.sr |= IDLE;
            return;
        };
        let step = self.byte_ticks(cycle);
        self.arrives_at = self.arrives_at.map(|at| at + step);
        // The byte passes unheard, but takes its time on the line.
        if self.cr1 & (UE | RE) != UE | RE || !wired {
            return;
        }
        // The new byte is lost, the old one stays in the register.
        if self.sr & RXNE != 0 {
            self.sr |= ORE;
            self.overruns += 1;
            self.status_read = false;
            return;
        }
        if self.damaged > 0 {
            self.damaged -= 1;
            self.sr |= FE;
            self.status_read = false;
        }
        self.received = byte;
        self.sr |= RXNE;
    }

    /// The byte that is due has left; `wired`: the pin belongs to the transmitter.
    pub fn leave(&mut self, cycle: u64, wired: bool) {
        if let Some(byte) = self.shifting.take()
            && wired
        {
            self.sent.push(byte);
        }
        let at = self.sent_at.take();
        self.shifting = self.next.take();
        if self.shifting.is_some() {
            self.sr |= TXE;
            let step = self.byte_ticks(cycle);
            self.sent_at = at.map(|at| at + step);
        } else {
            self.sr |= TC;
        }
    }

    pub fn read(&mut self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => {
                self.status_read = true;
                self.sr
            }
            0x04 => {
                // Reading status, then data, clears the error flags: reading the data alone does
                // not.
                if self.status_read {
                    self.sr &= !(ERRORS | IDLE);
                    self.status_read = false;
                }
                self.sr &= !RXNE;
                u32::from(self.received)
            }
            0x08 => self.brr,
            0x0C => self.cr1,
            0x10 => self.cr2,
            0x14 => self.cr3,
            0x18 => self.gtpr,
            _ => return None,
        })
    }

    pub fn write(
        &mut self,
        offset: u32,
        value: u32,
        now: u64,
        cycle: u64,
    ) -> Result<(), &'static str> {
        match offset {
            // Only these can be cleared by writing zero.
            0x00 => self.sr &= value | !(RXNE | TC | 1 << 8 | 1 << 9),
            0x04 => {
                if self.cr1 & (UE | TE) != UE | TE {
                    return Err("a byte is sent while the transmitter is off");
                }
                if self.sr & TXE == 0 {
                    return Err("a byte is sent before the last one has left the register");
                }
                self.sr &= !TC;
                // An idle transmitter takes the byte at once, and its register stays free.
                if self.shifting.is_none() {
                    self.shifting = Some(value as u8);
                    self.sent_at = Some(now + self.byte_ticks(cycle));
                } else {
                    self.next = Some(value as u8);
                    self.sr &= !TXE;
                }
            }
            0x08 => {
                self.brr = value & 0xFFFF;
                // Sixteen samples per bit.
                if self.brr < 16 {
                    return Err("a baud rate over a sixteenth of the bus clock");
                }
                // Bytes sent to it before were not received.
                if !self.line.is_empty() && self.arrives_at.is_none() {
                    self.line.clear();
                }
            }
            0x0C => {
                if value & (1 << 12 | 1 << 10) != 0 {
                    return Err("only eight bits without parity are emulated");
                }
                self.cr1 = value;
            }
            0x10 => self.cr2 = value,
            0x14 if value & 0x0300 != 0 => return Err("flow control is not emulated"),
            0x14 => self.cr3 = value,
            0x18 => self.gtpr = value,
            _ => return Err("no such register"),
        }
        Ok(())
    }
}
