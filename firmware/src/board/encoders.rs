//! Drum encoders: the four timers as quadrature decoders, every edge counted.

use crate::pins::CABLES;
use embassy_stm32::Peri;
use embassy_stm32::gpio::{AfioRemap, AfioRemapBool};
use embassy_stm32::pac;
use embassy_stm32::pac::timer::vals::FilterValue;
use embassy_stm32::peripherals::{PA0, PA1, PA6, PA7, PA8, PA9, PB6, PB7, TIM1, TIM2, TIM3, TIM4};
use embassy_stm32::timer::qei::{Ch1, Ch2, Config, Qei};

/// Pins as after reset.
type NoRemap = AfioRemap<0>;

/// Eight equal samples at 72 MHz / 16: shorter pulses than 1.8 us are noise. Edges may follow each
/// other at 560 kHz, far over any drum: 1024 lines at 10 turns per second give 41 kHz.
const FILTER: FilterValue = FilterValue::FDTS_DIV16_N8;

/// A timer with its two pins.
type Decoder<T, A, B> = (Peri<'static, T>, Peri<'static, A>, Peri<'static, B>);

/// The four counters.
pub struct Encoders {
    one: Qei<'static, TIM1>,
    two: Qei<'static, TIM2>,
    three: Qei<'static, TIM3>,
    four: Qei<'static, TIM4>,
}

impl Encoders {
    /// Starts counting, with both inputs of every timer filtered.
    pub fn new(
        one: Decoder<TIM1, PA8, PA9>,
        two: Decoder<TIM2, PA0, PA1>,
        three: Decoder<TIM3, PA6, PA7>,
        four: Decoder<TIM4, PB6, PB7>,
    ) -> Self {
        let config = Config::default();
        let encoders = Self {
            one: Qei::new::<Ch1, Ch2, NoRemap>(one.0, one.1, one.2, config),
            two: Qei::new::<Ch1, Ch2, NoRemap>(two.0, two.1, two.2, config),
            three: Qei::new::<Ch1, Ch2, NoRemap>(three.0, three.1, three.2, config),
            four: Qei::new::<Ch1, Ch2, AfioRemapBool<false>>(four.0, four.1, four.2, config),
        };
        // The driver leaves the filters off.
        for input in 0..2 {
            pac::TIM1.ccmr_input(0).modify(|w| w.set_icf(input, FILTER));
            for timer in [pac::TIM2, pac::TIM3, pac::TIM4] {
                timer.ccmr_input(0).modify(|w| w.set_icf(input, FILTER));
            }
        }
        encoders
    }

    /// The counters, cable 1 first.
    pub fn read(&self) -> [u16; CABLES] {
        [
            self.one.count(),
            self.two.count(),
            self.three.count(),
            self.four.count(),
        ]
    }
}
