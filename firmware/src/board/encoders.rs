//! Drum encoders: the four timers as quadrature decoders, every edge counted.

use crate::pins::CABLES;
use embassy_stm32::pac;
use embassy_stm32::pac::timer::TimGp16;
use embassy_stm32::pac::timer::vals::{CcmrInputCcs, FilterValue, Sms};

/// Eight equal samples at 72 MHz / 16: pulses shorter than 1.8 us are filtered out. Edges may
/// follow each other at 560 kHz, far above any drum: 1024 lines at 10 turns per second give 41 kHz.
const FILTER: FilterValue = FilterValue::FDTS_DIV16_N8;

/// Cable 1 first.
fn timers() -> [TimGp16; CABLES] {
    #[allow(unsafe_code, reason = "one timer by the registers that all four share")]
    // SAFETY: TIM1 has all registers of the others at the same offsets, and further ones behind
    // them.
    let first = unsafe { TimGp16::from_ptr(pac::TIM1.as_ptr()) };
    [first, pac::TIM2, pac::TIM3, pac::TIM4]
}

/// Starts counting, with both inputs of every timer filtered. The timers' clocks run.
pub fn start() {
    for timer in timers() {
        timer.ccmr_input(0).write(|w| {
            for input in 0..2 {
                w.set_ccs(input, CcmrInputCcs::TI4);
                w.set_icf(input, FILTER);
            }
        });
        // Its value after a reset differs between manuals and makers of the chip; at 0 the counter
        // stops.
        timer.arr().write(|w| w.0 = u16::MAX.into());
        // Mode 3 counts every edge of both inputs: 4096 counts of 1024 lines.
        timer.smcr().write(|w| w.set_sms(Sms::ENCODER_MODE_3));
        timer.cr1().write(|w| w.set_cen(true));
    }
}

/// The counters.
pub fn read() -> [u16; CABLES] {
    // One by one: a loop over them would first build a table of their addresses.
    let [a, b, c, d] = timers();
    let count = |timer: TimGp16| timer.cnt().read().cnt();
    [count(a), count(b), count(c), count(d)]
}
