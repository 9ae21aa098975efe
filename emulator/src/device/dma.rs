//! DMA1: seven channels, one transfer per request (RM0008, 13).

#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Channel {
    pub config: u32,
    pub left: u32,
    whole: u32,
    peripheral: u32,
    memory: u32,
    done: u32,
}

/// One transfer: where from, where to, how many bytes each.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Transfer {
    pub from: u32,
    pub to: u32,
    pub from_bytes: u32,
    pub to_bytes: u32,
}

#[derive(Debug, Clone, Default)]
pub(crate) struct Dma {
    pub channels: [Channel; 7],
    flags: u32,
}

const ENABLE: u32 = 1;
const FROM_MEMORY: u32 = 1 << 4;
const CIRCULAR: u32 = 1 << 5;

impl Dma {
    pub fn is_ready(&self, channel: usize) -> bool {
        let channel = &self.channels[channel];
        channel.config & ENABLE != 0 && channel.left > 0
    }

    /// The transfer that a request starts, if the channel is ready.
    pub fn request(&mut self, index: usize) -> Option<Transfer> {
        if !self.is_ready(index) {
            return None;
        }
        let channel = &mut self.channels[index];
        let config = channel.config;
        let peripheral_bytes = 1 << (config >> 8 & 3);
        let memory_bytes = 1 << (config >> 10 & 3);
        let step = |grows: u32, bytes: u32| {
            if config & grows != 0 {
                // Counted from the start of the transfer: the written addresses themselves do not
                // change.
                channel.done * bytes
            } else {
                0
            }
        };
        let peripheral = channel.peripheral + step(1 << 6, peripheral_bytes);
        let memory = channel.memory + step(1 << 7, memory_bytes);
        channel.done += 1;
        channel.left -= 1;
        let shift = 4 * index;
        if channel.left == channel.whole / 2 {
            // Four flags per channel: any, complete, half, error.
            self.flags |= 0b0101 << shift;
        }
        if channel.left == 0 {
            self.flags |= 0b0011 << shift;
            if config & CIRCULAR != 0 {
                // A circular channel reloads itself and never stops.
                channel.left = channel.whole;
                channel.done = 0;
            }
        }
        Some(if config & FROM_MEMORY != 0 {
            Transfer {
                from: memory,
                to: peripheral,
                from_bytes: memory_bytes,
                to_bytes: peripheral_bytes,
            }
        } else {
            Transfer {
                from: peripheral,
                to: memory,
                from_bytes: peripheral_bytes,
                to_bytes: memory_bytes,
            }
        })
    }

    /// A transfer accessed an unmapped address: the channel stops.
    pub fn fail(&mut self, index: usize) {
        self.channels[index].config &= !ENABLE;
        self.flags |= 0b1001 << (4 * index);
    }

    /// Whether a channel's interrupt line is high.
    pub fn interrupts(&self, index: usize) -> bool {
        // The enable bits in CCR are at the same places as the flags: complete, half, error.
        let flags = self.flags >> (4 * index) & 0xE;
        flags & self.channels[index].config & 0xE != 0
    }

    pub fn read(&self, offset: u32) -> Option<u32> {
        let Some((channel, register)) = place(offset) else {
            return match offset {
                0 => Some(self.flags),
                4 => Some(0),
                _ => None,
            };
        };
        let channel = &self.channels[channel];
        Some(match register {
            0 => channel.config,
            1 => channel.left,
            2 => channel.peripheral,
            3 => channel.memory,
            _ => 0,
        })
    }

    pub fn write(&mut self, offset: u32, value: u32) -> Result<(), &'static str> {
        let Some((index, register)) = place(offset) else {
            if offset == 4 {
                for index in 0..7 {
                    // The global bit clears all four.
                    let bits = value >> (4 * index) & 0xF;
                    let bits = if bits & 1 != 0 { 0xF } else { bits };
                    self.flags &= !(bits << (4 * index));
                    if self.flags >> (4 * index) & 0xE == 0 {
                        self.flags &= !(1 << (4 * index));
                    }
                }
                return Ok(());
            }
            return Err("no such register");
        };
        let channel = &mut self.channels[index];
        // A real channel ignores such a write or mixes addresses: both are errors of the firmware.
        if register > 0 && channel.config & ENABLE != 0 {
            return Err("a DMA channel's address or count changes while it is on");
        }
        match register {
            0 => {
                if value & ENABLE != 0 && channel.config & ENABLE == 0 {
                    channel.whole = channel.left;
                    channel.done = 0;
                }
                channel.config = value;
            }
            1 => channel.left = value & 0xFFFF,
            2 => channel.peripheral = value,
            _ => channel.memory = value,
        }
        Ok(())
    }
}

/// Channel and register of an address.
const fn place(offset: u32) -> Option<(usize, u32)> {
    if offset < 8 || offset >= 8 + 7 * 20 {
        return None;
    }
    let (channel, register) = ((offset - 8) / 20, (offset - 8) % 20 / 4);
    if register > 3 {
        return None;
    }
    Some((channel as usize, register))
}
