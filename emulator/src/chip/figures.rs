//! Figures of a run: instructions, ticks, stack, resets, and the log of a probe.

use super::{Chip, ProfileRow, TickStats};
use crate::bus::{RAM, RAM_BYTES};
use crate::error::ResetBy;

impl Chip {
    /// Instructions since power-on.
    #[must_use]
    pub fn instructions(&self) -> u64 {
        self.instructions_before + self.cpu.instructions
    }

    /// The resets since power-on, in their order.
    #[must_use]
    pub fn resets(&self) -> &[ResetBy] {
        &self.resets
    }

    /// Runs of the SysTick handler since the last reset that have ended.
    #[must_use]
    pub(crate) const fn ticks_since_reset(&self) -> u32 {
        self.ticks_done
    }

    /// How often the core went to sleep (`WFE`) although a handler had returned since its last
    /// check: the handler's result waits for the next interrupt.
    #[must_use]
    pub const fn slept_through(&self) -> u64 {
        self.cpu.slept_through
    }

    /// From now on records the addresses of the SysTick handler's instructions.
    pub fn profile_ticks(&mut self) {
        self.profile = Some(Box::default());
    }

    /// The SysTick handler's instructions executed since [`Self::profile_ticks`].
    #[must_use]
    pub fn tick_profile(&self) -> Vec<ProfileRow> {
        let Some(profile) = &self.profile else {
            return Vec::new();
        };
        let mut counts: std::collections::BTreeMap<u32, (u64, u64)> = profile
            .all
            .iter()
            .map(|(&pc, &all)| (pc, (all, 0)))
            .collect();
        for pc in &profile.longest {
            counts.entry(*pc).or_default().1 += 1;
        }
        let counts = counts.into_iter();
        counts
            .map(|(address, (all, longest))| ProfileRow {
                address,
                all,
                longest,
            })
            .collect()
    }

    /// Duration of the SysTick handler so far.
    #[must_use]
    pub fn tick_stats(&self) -> TickStats {
        let mut sorted = self.ticks.clone();
        sorted.sort_unstable();
        TickStats {
            count: sorted.len(),
            median: sorted.get(sorted.len() / 2).copied().unwrap_or(0),
            max: sorted.last().copied().unwrap_or(0),
            cycles_max: self.cycles_max,
            latency_max: self.latency_max,
            lost: self.lost_before + self.bus.scs.ticks_lost,
        }
    }

    /// As [`Self::tick_stats`], and starts anew.
    pub fn take_tick_stats(&mut self) -> TickStats {
        let stats = self.tick_stats();
        self.ticks.clear();
        (self.latency_max, self.cycles_max) = (0, 0);
        // Lost ticks are counted by the core, and carried over its resets here.
        self.lost_before = 0;
        self.bus.scs.ticks_lost = 0;
        stats
    }

    /// Lowest stack pointer since the last reset: an address.
    #[must_use]
    pub fn stack_low_water(&self) -> u32 {
        self.cpu.lowest_sp
    }

    /// Takes the content of the first up-channel of the RTT block, as a probe would.
    pub fn rtt_take(&mut self) -> Vec<u8> {
        let mut taken = Vec::new();
        let Some(block) = self
            .rtt
            .filter(|at| (RAM..RAM + RAM_BYTES - 48).contains(at))
        else {
            return taken;
        };
        let mut word = |offset: u32| self.bus.read(block + offset, 4).unwrap_or(0);
        // SEGGER RTT: 24 bytes of identification and counts, then the first up-channel: name,
        // buffer, size, write and read position.
        let (id, buffer, size, write, mut read) = (word(0), word(28), word(32), word(36), word(40));
        let initialised = id.to_le_bytes() == *b"SEGG";
        // Before the firmware's start the block contains arbitrary bytes.
        if !initialised || size > RAM_BYTES || write >= size || read >= size {
            return taken;
        }
        while read != write {
            taken.push(self.bus.read(buffer + read, 1).unwrap_or(0) as u8);
            read = (read + 1) % size;
        }
        // The place was just read, so it can be written.
        let _ = self.bus.write(block + 40, 4, read);
        taken
    }
}
