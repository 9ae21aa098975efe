//! Measurements that only the chip can make, for the board's self-test.

#![allow(
    unsafe_code,
    reason = "registers of the core and of the factory, which can be read at any time without effect"
)]

use crate::clock::CORE_HZ;
use crate::{can, pins};
use core::sync::atomic::{AtomicU32, Ordering};
use embassy_stm32::pac;
use embassy_stm32::pac::rcc::vals::Rtcsel;
use mcdpr_firmware::Inputs;
use mcdpr_protocol::{Bench, CanErrors};

/// Ticks over which the slow oscillator is counted.
// 1.024 s: 40,960 counts at 40 kHz, so a count is 25 ppm.
const COUNTED_TICKS: u32 = 1024;
/// The real-time clock's divider counts down from here: 20 bits.
const DIVIDER: u32 = 0xF_FFFF;
/// Loops until the divider may be written: some cycles of the slow oscillator each.
const PATIENCE: u32 = 5000;
/// The pattern that the stack is filled with at the start (cortex-m-rt, `paint-stack`).
const PAINT: u32 = 0xCCCC_CCCC;
/// Last word of the identification registers of the core's table of components (ARM DDI 0337).
const COMPONENTS: usize = 0xE00F_F000;
/// Factory's register of the flash's size, KiB (RM0008, 30.1).
const FLASH_SIZE: usize = 0x1FFF_F7E0;
const CPUID: usize = 0xE000_ED00;

/// Counts of the slow oscillator in the last [`COUNTED_TICKS`]; 0 before the first.
static COUNTED: AtomicU32 = AtomicU32::new(0);

unsafe extern "C" {
    /// Ends of the stack, from memory.x; only their addresses mean anything.
    static _stack_start: u32;
    static _stack_end: u32;
}

/// What the self-test measures in every tick.
pub struct Gauge {
    /// Greatest time of a tick, core cycles.
    tick_cycles: u32,
    /// This tick did a self-test.
    tested: bool,
    /// The divider, at most [`COUNTED_TICKS`] ago.
    divider: Option<u32>,
    /// The chip's reset flags and clock, at the start.
    pub reset_flags: u8,
    /// It runs from its crystal.
    pub crystal: bool,
}

impl Gauge {
    /// Lets the slow oscillator drive the real-time clock's divider, which has no other use here.
    pub fn new(reset_flags: u8, crystal: bool) -> Self {
        pac::RCC.apb1enr().modify(|w| w.set_bkpen(true));
        pac::PWR.cr().modify(|w| w.set_dbp(true));
        pac::RCC.csr().modify(|w| w.set_lsion(true));
        // Another source stays selected until the domain is reset.
        if pac::RCC.bdcr().read().rtcsel() != Rtcsel::LSI {
            pac::RCC.bdcr().write(|w| w.set_bdrst(true));
            pac::RCC.bdcr().write(|w| w.set_bdrst(false));
        }
        pac::RCC.bdcr().write(|w| {
            w.set_rtcsel(Rtcsel::LSI);
            w.set_rtcen(true);
        });
        let rtc = pac::RTC;
        // Bounded: without its oscillator the divider never becomes ready, and the board must
        // start.
        let idle = || (0..PATIENCE).any(|_| rtc.crl().read().0 & RTOFF != 0);
        if idle() {
            rtc.crl().modify(|w| w.set_cnf(true));
            rtc.prlh().write(|w| w.0 = DIVIDER >> 16);
            rtc.prll().write(|w| w.0 = DIVIDER & 0xFFFF);
            rtc.crl().modify(|w| w.set_cnf(false));
        }
        Self {
            tick_cycles: 0,
            tested: false,
            divider: None,
            reset_flags,
            crystal,
        }
    }

    /// Once a tick.
    pub fn count(&mut self, now: u32) {
        if !now.is_multiple_of(COUNTED_TICKS) {
            return;
        }
        let rtc = pac::RTC;
        let high = || rtc.divh().read().0;
        // The upper half may change between the two.
        // Two reads of the upper half that agree enclose a lower half that belongs to them.
        let (before, low, after) = (high(), rtc.divl().read().0, high());
        if before != after {
            self.divider = None;
            return;
        }
        let divider = before << 16 | low;
        if let Some(last) = self.divider.replace(divider) {
            // It counts down: earlier minus later.
            COUNTED.store(last.wrapping_sub(divider) & DIVIDER, Ordering::Relaxed);
        }
    }

    /// A tick took this long, core cycles. A tick with a self-test does not count: it needs extra
    /// time, and no drive has torque then.
    pub fn took(&mut self, cycles: u32) {
        if !core::mem::take(&mut self.tested) {
            self.tick_cycles = self.tick_cycles.max(cycles);
        }
    }

    /// The part number is spread over three registers (JEP106, bits 0 to 3 and 4 to 6).
    #[inline(never)]
    pub fn fill(&mut self, report: &mut Bench, supply_mv: u16, inputs: &Inputs<{ pins::CABLES }>) {
        self.tested = true;
        report.id_code = pac::DBGMCU.idcode().read().0;
        report.core_id = register(CPUID);
        // Parts of the code lie in three registers (JEP106, bits 0 to 3 and 4 to 6).
        let [second, third] = [0xFE4, 0xFE8].map(|at| register(COMPONENTS + at));
        let maker = (second >> 4 & 0xF) | (third & 7) << 4;
        report.maker = u16::try_from(maker).unwrap_or(0);
        report.flash_kib = u16::try_from(register(FLASH_SIZE) & 0xFFFF).unwrap_or(0);
        report.reset_flags = self.reset_flags;
        report.crystal = self.crystal;
        report.supply_mv = supply_mv;
        report.slow_hz = COUNTED.load(Ordering::Relaxed) * 1000 / COUNTED_TICKS;
        let errors = pac::CAN.esr().read();
        report.can_errors = CanErrors {
            transmit: errors.tec(),
            receive: errors.rec(),
        };
        report.can_lost = can::lost();
        report.can_loop = can::looped();
        report.tick_cycles = self.tick_cycles;
        report.stack_free = stack_free();
        report.inputs = u8::from(inputs.e_stop) | u8::from(inputs.gripper_switch) << 1;
        report.outputs = pins::outputs();
    }
}

/// Whether the real-time clock accepts a new write.
const RTOFF: u32 = 1 << 5;
const _: () = assert!(CORE_HZ == 72_000_000);

fn register(address: usize) -> u32 {
    // SAFETY: called only with the addresses above, which are always present and aligned.
    unsafe { core::ptr::read_volatile(address as *const u32) }
}

/// Bytes of the stack that were never written.
fn stack_free() -> u16 {
    let (low, high) = (&raw const _stack_end, &raw const _stack_start);
    let words = (high as usize - low as usize) / 4;
    let untouched = (0..words).take_while(|&word| {
        // SAFETY: within the stack's region, which is memory.
        unsafe { low.add(word).read_volatile() == PAINT }
    });
    u16::try_from(4 * untouched.count()).unwrap_or(u16::MAX)
}
