//! Loads and stores.

use super::op::{Index, Op, Width};
use super::{Cpu, Trap};
use crate::bus::Bus;

impl Cpu {
    #[inline(always)]
    fn load(&self, bus: &mut Bus, width: Width, address: u32) -> Result<u32, Trap> {
        Ok(match width {
            Width::Byte => bus.read(address, 1)?,
            Width::Half => bus.read(address, 2)?,
            Width::Word => bus.read(address, 4)?,
            Width::SignedByte => bus.read(address, 1)? as i8 as u32,
            Width::SignedHalf => bus.read(address, 2)? as i16 as u32,
        })
    }

    #[inline(always)]
    fn store(&self, bus: &mut Bus, width: Width, address: u32, value: u32) -> Result<(), Trap> {
        match width {
            Width::Byte | Width::SignedByte => bus.write(address, 1, value),
            Width::Half | Width::SignedHalf => bus.write(address, 2, value),
            Width::Word => bus.write(address, 4, value),
        }
    }

    /// A loaded register; the program counter branches.
    #[inline(always)]
    fn loaded(&mut self, bus: &mut Bus, rt: u8, value: u32) -> Result<u64, Trap> {
        if rt == 15 {
            // A load to the program counter is a branch that may leave an exception.
            return Ok(2 + self.branch_exchange(bus, value)?);
        }
        self.set(rt, value);
        Ok(2)
    }

    /// The address of an access and the new value of the base.
    #[inline(always)]
    fn indexed(&self, rn: u8, offset: i32, index: Index) -> (u32, Option<u32>) {
        let base = self.reg(rn);
        let moved = base.wrapping_add_signed(offset);
        match index {
            Index::Offset => (moved, None),
            Index::Before => (moved, Some(moved)),
            Index::After => (base, Some(moved)),
        }
    }

    #[inline(always)]
    fn write_back(&mut self, rn: u8, base: Option<u32>) {
        if let Some(base) = base {
            self.set(rn, base);
        }
    }

    pub(super) fn transfer(&mut self, bus: &mut Bus, op: Op) -> Result<u64, Trap> {
        match op {
            Op::LoadLiteral { width, rt, address } => {
                let value = self.load(bus, width, address)?;
                return self.loaded(bus, rt, value);
            }
            Op::Load {
                width,
                index,
                rt,
                rn,
                offset,
            } => {
                let (address, base) = self.indexed(rn, offset, index);
                let value = self.load(bus, width, address)?;
                // Before the loaded register is set: if both are the same, the loaded value stays.
                self.write_back(rn, base);
                return self.loaded(bus, rt, value);
            }
            Op::LoadReg {
                width,
                rt,
                rn,
                rm,
                shift,
            } => {
                let address = self.reg(rn).wrapping_add(self.reg(rm) << shift);
                let value = self.load(bus, width, address)?;
                return self.loaded(bus, rt, value);
            }
            Op::Store {
                width,
                index,
                rt,
                rn,
                offset,
            } => {
                let (address, base) = self.indexed(rn, offset, index);
                self.store(bus, width, address, self.reg(rt))?;
                self.write_back(rn, base);
            }
            Op::StoreReg {
                width,
                rt,
                rn,
                rm,
                shift,
            } => {
                let address = self.reg(rn).wrapping_add(self.reg(rm) << shift);
                self.store(bus, width, address, self.reg(rt))?;
            }
            Op::LoadDual {
                index,
                rt,
                rt2,
                rn,
                offset,
            } => {
                let (address, base) = if rn == 15 {
                    // Literals are relative to the aligned program counter.
                    ((self.regs[15] & !3).wrapping_add_signed(offset), None)
                } else {
                    self.indexed(rn, offset, index)
                };
                // Both words are read before a register changes: a fault leaves all of them.
                let first = word(bus, address)?;
                let second = word(bus, address.wrapping_add(4))?;
                self.write_back(rn, base);
                self.set(rt, first);
                self.set(rt2, second);
                return Ok(3);
            }
            Op::StoreDual {
                index,
                rt,
                rt2,
                rn,
                offset,
            } => {
                let (address, base) = self.indexed(rn, offset, index);
                aligned(address, 4)?;
                bus.write(address, 4, self.reg(rt))?;
                bus.write(address.wrapping_add(4), 4, self.reg(rt2))?;
                self.write_back(rn, base);
                return Ok(3);
            }
            Op::LoadMany {
                rn,
                list,
                down,
                wback,
            } => return self.load_many(bus, rn, list, down, wback),
            Op::StoreMany {
                rn,
                list,
                down,
                wback,
            } => return self.store_many(bus, rn, list, down, wback),
            Op::TableBranch { rn, rm, half } => {
                let (size, shift) = if half { (2, 1) } else { (1, 0) };
                let address = self.reg(rn).wrapping_add(self.reg(rm) << shift);
                let entry = bus.read(address, size)?;
                self.pc = self.regs[15].wrapping_add(2 * entry);
                return Ok(4);
            }
            Op::LoadExclusive {
                width,
                rt,
                rn,
                offset,
            } => {
                let address = self.reg(rn).wrapping_add(offset);
                aligned(address, bytes(width))?;
                let value = self.load(bus, width, address)?;
                self.exclusive = Some(address);
                self.set(rt, value);
            }
            Op::StoreExclusive {
                width,
                rd,
                rt,
                rn,
                offset,
            } => {
                let address = self.reg(rn).wrapping_add(offset);
                aligned(address, bytes(width))?;
                // The reservation is gone in any case, granted or not.
                let granted = self.exclusive.take() == Some(address);
                if granted {
                    self.store(bus, width, address, self.reg(rt))?;
                }
                self.set(rd, u32::from(!granted));
            }
            Op::ClearExclusive => self.exclusive = None,
            _ => return Err(Trap::Undefined),
        }
        Ok(2)
    }

    fn load_many(
        &mut self,
        bus: &mut Bus,
        rn: u8,
        list: u16,
        down: bool,
        wback: bool,
    ) -> Result<u64, Trap> {
        let count = list.count_ones();
        let base = self.reg(rn);
        let low = if down {
            base.wrapping_sub(4 * count)
        } else {
            base
        };
        let end = if down { low } else { low + 4 * count };
        aligned(low, 4)?;
        // All are read first: a fault in the middle must leave the registers for a repetition.
        let mut values = [0; 16];
        let mut address = low;
        for register in 0..16_u8 {
            if list & 1 << register != 0 {
                values[usize::from(register)] = bus.read(address, 4)?;
                address = address.wrapping_add(4);
            }
        }
        if wback {
            self.set(rn, end);
        }
        // After the base: a base in the list gets the loaded value.
        for register in 0..15_u8 {
            if list & 1 << register != 0 {
                self.set(register, values[usize::from(register)]);
            }
        }
        let cycles = u64::from(count) + 1;
        if list & 0x8000 != 0 {
            return Ok(cycles + self.branch_exchange(bus, values[15])?);
        }
        Ok(cycles)
    }

    fn store_many(
        &mut self,
        bus: &mut Bus,
        rn: u8,
        list: u16,
        down: bool,
        wback: bool,
    ) -> Result<u64, Trap> {
        let count = list.count_ones();
        let base = self.reg(rn);
        let low = if down {
            base.wrapping_sub(4 * count)
        } else {
            base
        };
        aligned(low, 4)?;
        let mut address = low;
        for register in 0..16_u8 {
            if list & 1 << register != 0 {
                bus.write(address, 4, self.reg(register))?;
                address = address.wrapping_add(4);
            }
        }
        if wback {
            self.set(rn, if down { low } else { address });
        }
        Ok(u64::from(count) + 1)
    }
}

const fn bytes(width: Width) -> u32 {
    match width {
        Width::Byte | Width::SignedByte => 1,
        Width::Half | Width::SignedHalf => 2,
        Width::Word => 4,
    }
}

const fn aligned(address: u32, size: u32) -> Result<(), Trap> {
    if address & (size - 1) == 0 {
        Ok(())
    } else {
        Err(Trap::Unaligned { address })
    }
}

fn word(bus: &mut Bus, address: u32) -> Result<u32, Trap> {
    aligned(address, 4)?;
    bus.read(address, 4)
}
