//! Ports (RM0008, 9).

/// Output state of a pin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drive {
    /// Nothing: an input, or not configured.
    Floating,
    /// Pulls to ground.
    Low,
    /// Pulls to the supply.
    High,
    /// A peripheral drives it.
    Peripheral,
}

#[derive(Debug, Clone)]
pub(crate) struct Gpio {
    /// CRL below, CRH above.
    config: u64,
    output: u16,
    /// Levels applied from outside; other pins keep their pull's.
    pub applied: [Option<bool>; 16],
}

impl Gpio {
    pub fn new(applied: [Option<bool>; 16]) -> Self {
        Self {
            // After a reset every pin is a floating input (RM0008, 9.2.1).
            config: 0x4444_4444_4444_4444,
            output: 0,
            applied,
        }
    }

    /// CNF and MODE of a pin.
    const fn mode(&self, pin: u8) -> u8 {
        (self.config >> (4 * (pin & 15))) as u8 & 15
    }

    pub(crate) const fn is_analog(&self, pin: u8) -> bool {
        self.mode(pin) == 0
    }

    pub(crate) const fn is_digital_input(&self, pin: u8) -> bool {
        self.mode(pin) & 3 == 0 && self.mode(pin) != 0
    }

    pub const fn drive(&self, pin: u8) -> Drive {
        let mode = self.mode(pin);
        let high = self.output & 1 << (pin & 15) != 0;
        match (mode & 3, mode >> 2) {
            (0, _) => Drive::Floating,
            (_, 2..) => Drive::Peripheral,
            // Open drain: a high level is left to the pull-up.
            (_, 1) if high => Drive::Floating,
            _ if high => Drive::High,
            _ => Drive::Low,
        }
    }

    fn level(&self, pin: u8) -> bool {
        match self.drive(pin) {
            Drive::High => true,
            Drive::Low => false,
            // The input stage of an analog pin is off and reads 0.
            _ if self.is_analog(pin) => false,
            _ => self.applied[usize::from(pin & 15)]
                .unwrap_or(self.mode(pin) == 8 && self.output & 1 << (pin & 15) != 0),
        }
    }

    pub fn read(&self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.config as u32,
            0x04 => (self.config >> 32) as u32,
            0x08 => (0..16_u8).fold(0, |idr, pin| idr | u32::from(self.level(pin)) << pin),
            0x0C => u32::from(self.output),
            0x10 | 0x14 | 0x18 => 0,
            _ => return None,
        })
    }

    pub fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            0x00 => self.config = (self.config & !0xFFFF_FFFF) | u64::from(value),
            0x04 => self.config = (self.config & 0xFFFF_FFFF) | u64::from(value) << 32,
            0x0C => self.output = value as u16,
            // Where a pin is both set and reset, set wins.
            0x10 => self.output = (self.output & !(value >> 16) as u16) | value as u16,
            0x14 => self.output &= !value as u16,
            _ => return None,
        }
        Some(())
    }
}
