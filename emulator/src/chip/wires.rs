//! External connections of the chip and their faults: pins, voltages, lines, supply, crystal.

use super::{CanErrors, Chip, Drive, Jumpers, Pins, Port, SentFrame, TICKS_PER_US};
use crate::bus::{Identity, RAM, RAM_BYTES};
use crate::device::can_line::{CanFrame, CanWiring};
use crate::device::encoder_line::{EncoderLine, Lines};
use crate::device::timer::Timer;
use crate::scs::HARD_FAULT;

impl Chip {
    /// Whether faults go to the firmware's handler, as on the chip, instead of stopping the run.
    pub fn deliver_faults(&mut self, deliver: bool) {
        self.bus.scs.delivers_faults = deliver;
    }

    /// Raises a hard fault at the present instruction, as broken hardware might.
    pub fn inject_hard_fault(&mut self) {
        self.bus.scs.pend(HARD_FAULT);
    }

    /// The processor stops executing until a reset: firmware that hangs with its interrupts masked.
    /// Its peripherals continue.
    pub fn hang(&mut self) {
        self.hangs = true;
    }

    /// From now on every instruction takes `factor` times its time, 1 for normal: simulates an
    /// overloaded tick.
    pub fn slow_down(&mut self, factor: u32) {
        self.slowness = u64::from(factor.max(1));
    }

    /// Writes a word of RAM, as a debugger does: to start from a state that would take weeks to
    /// reach. Returns whether there is such a word.
    pub fn write_ram(&mut self, address: u32, value: u32) -> bool {
        let in_ram = (RAM..=RAM + RAM_BYTES - 4).contains(&address);
        in_ram && self.bus.write(address, 4, value).is_ok()
    }

    /// Stops the crystal. If the clock security system monitors it, the core gets its NMI and
    /// continues with the internal oscillator.
    pub fn stop_crystal(&mut self) -> bool {
        let watched = self.bus.rcc.watches_crystal();
        if watched {
            // 2 is the NMI.
            self.bus.scs.pend(2);
        }
        watched
    }

    /// Whether the crystal starts, from the next reset on.
    pub fn set_crystal(&mut self, works: bool) {
        self.bus.rcc.crystal_dead = !works;
    }

    /// Whether the PLL locks, from the next reset on.
    pub fn set_pll(&mut self, works: bool) {
        self.bus.rcc.pll_dead = !works;
    }

    /// Frequency of the watchdog's oscillator (LSI), Hz: 30 to 60 kHz in real chips, 40 kHz here by
    /// default. Takes effect at the watchdog's next feed.
    pub fn set_slow_oscillator(&mut self, hz: u32) {
        self.bus.watchdog.oscillator_hz = u64::from(hz.max(1));
    }

    /// The chip's identification: that of a clone differs.
    pub fn set_identity(&mut self, identity: Identity) {
        self.bus.identity = identity;
    }

    /// Tells the chips of one robot apart by their numbers.
    pub(crate) fn set_number(&mut self, number: u8) {
        self.bus.identity.number = u32::from(number);
    }

    /// The CAN controller stops sending and receiving, or works again.
    pub fn break_can(&mut self, broken: bool) {
        self.bus.can.broken = broken;
    }

    /// A debugger halts the core until [`Self::resume`]; its peripherals, including the watchdog,
    /// continue.
    pub fn halt(&mut self) {
        self.hangs = true;
    }

    /// A debugger resumes the core.
    pub fn resume(&mut self) {
        self.hangs = self.power.is_down();
    }

    /// Virtual time since power-on, microseconds.
    #[must_use]
    pub fn now_us(&self) -> u64 {
        self.bus.now / TICKS_PER_US
    }

    /// Present state of the outputs.
    #[must_use]
    pub fn pins(&self) -> Pins {
        Pins {
            brakes: [12, 13, 14, 15].map(|pin| self.bus.gpio[1].drive(pin)),
            drive_enable: self.bus.gpio[1].drive(3),
            gripper: self.bus.gpio[0].drive(10),
            led: self.bus.gpio[2].drive(13),
            well: self.bus.gpio[0].drive(11),
        }
    }

    /// Puts jumper wires between outputs and inputs, in place of encoders and sensors.
    pub fn set_jumpers(&mut self, jumpers: Jumpers) {
        self.jumpers = Some(jumpers);
    }

    /// Whether an output is high: the brakes from 0, then gripper and drive enable.
    pub(crate) fn is_high(&self, output: usize) -> bool {
        let pins = self.pins();
        let others = [pins.gripper, pins.drive_enable];
        let mut outputs = pins.brakes.into_iter().chain(others);
        outputs.nth(output) == Some(Drive::High)
    }

    /// Whether any brake was open at any time since power-on, as seen after every write to a
    /// peripheral.
    #[must_use]
    pub fn brakes_ever_opened(&self) -> bool {
        self.were_high & 0xF != 0
    }

    /// Whether a brake, the gripper or the drives' enable was high at any time since power-on, as
    /// seen after every write to a peripheral.
    #[must_use]
    pub fn outputs_ever_high(&self) -> bool {
        self.were_high != 0
    }

    /// Applies a level to a pin; `None` leaves it to its pull.
    pub fn set_input(&mut self, port: Port, pin: u8, level: Option<bool>) {
        self.bus.gpio[port as usize].applied[usize::from(pin & 15)] = level;
    }

    /// Turns the encoder of TIM1 to TIM4 (`timer` 1 to 4) to a position in counts, during the next
    /// slice. Edges that the input filter swallows are lost, as on the chip.
    pub fn set_encoder(&mut self, timer: usize, position: i64) {
        if let Some(encoder) = timer.checked_sub(1).and_then(|i| self.encoders.get_mut(i)) {
            encoder.1 = position;
        }
    }

    /// What the lines of the encoder of TIM1 to TIM4 (`timer` 1 to 4) are like from now on; by
    /// default they are ideal. Different encoders have different jitter, and equal runs the same.
    pub fn set_encoder_line(&mut self, timer: usize, line: EncoderLine) {
        let Some(index) = timer.checked_sub(1).filter(|index| *index < 4) else {
            return;
        };
        let position = self.encoders[index].0;
        // Ideal lines take the short way: their edges need not be followed one by one.
        match &mut self.lines[index] {
            lines if line == EncoderLine::default() => *lines = None,
            Some(lines) => lines.become_like(line),
            lines => *lines = Some(Box::new(Lines::new(line, position, index as u64))),
        }
    }

    /// Counts of an encoder that its timer did not see; with lines that are not ideal the difference
    /// in all, of which the last counts may still be in the timer's filters.
    #[must_use]
    pub fn lost_counts(&self, timer: usize) -> u64 {
        let timer = timer.checked_sub(1).and_then(|i| self.bus.timers.get(i));
        timer.map_or(0, Timer::lost)
    }

    /// Applies a voltage to an ADC channel, as the 12 bits that it converts to at 3.3 V.
    pub fn set_adc(&mut self, channel: u8, raw: u16) {
        self.set_adc_sixteenths(channel, raw.min(4095) * 16);
    }

    /// Applies a voltage to an ADC channel, in sixteenths of a step at 3.3 V (0 to 65520): as
    /// with a little noise, sixteen conversions add up to it.
    pub fn set_adc_sixteenths(&mut self, channel: u8, sum: u16) {
        if let Some(applied) = self.bus.adc.applied.get_mut(usize::from(channel)) {
            *applied = sum.min(4095 * 16);
        }
    }

    /// Puts bytes on the line to USART3. They arrive one after the other, at its baud rate.
    pub fn uart_send(&mut self, bytes: &[u8]) {
        let (now, cycle) = (self.bus.now, self.bus.clocks.apb1);
        self.bus.usart.send(bytes, now, cycle);
        // The first byte's arrival is a new event.
        self.bus.plan();
    }

    /// The next so many bytes to USART3 arrive without a stop bit.
    pub fn uart_damage(&mut self, bytes: u16) {
        let damaged = &mut self.bus.usart.damaged;
        *damaged = damaged.saturating_add(bytes);
    }

    /// Bytes that USART3 has sent since the last call.
    pub fn uart_take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.bus.usart.sent)
    }

    /// Bytes that arrived at USART3 before the previous one was read.
    #[must_use]
    pub fn uart_overruns(&self) -> u64 {
        self.bus.usart.overruns
    }

    /// What is connected to the CAN pins. After power-on: nothing.
    pub fn set_can_wiring(&mut self, wiring: CanWiring) {
        self.bus.rewire_can(wiring);
    }

    /// Destroys the next frames on the bus, from any sender.
    pub(crate) fn destroy_can_frames(&mut self, count: u32) {
        self.bus.can_line.destroy = count;
    }

    /// Another node wants to send a frame from `at_us` on (at once, if that is past). It is sent
    /// when the bus is free and nothing more urgent waits, and repeated until it passes.
    pub fn can_send(&mut self, at_us: u64, frame: CanFrame) {
        // Not into the past: the bus has been served up to now.
        let at = (at_us * TICKS_PER_US).max(self.bus.now);
        self.bus.can_line.offer(at, frame);
        self.bus.plan();
    }

    /// Frames of the chip that the other nodes have received since the last call.
    pub fn can_take(&mut self) -> Vec<SentFrame> {
        let taken = std::mem::take(&mut self.bus.can_line.delivered);
        let taken = taken.into_iter();
        taken
            .map(|(ends_at, frame)| SentFrame {
                ends_at_us: ends_at / TICKS_PER_US,
                frame,
            })
            .collect()
    }

    /// The CAN controller's counters.
    #[must_use]
    pub fn can_errors(&self) -> CanErrors {
        CanErrors {
            transmit: self.bus.can.tec,
            receive: self.bus.can.rec,
            passive: self.bus.can.is_passive(),
            bus_off: self.bus.can.is_bus_off(),
        }
    }
}
