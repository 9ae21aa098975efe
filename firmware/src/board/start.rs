//! From reset to the first tick.

use crate::{can, encoders, fatal, identity, interrupts, link, pins, tension, tick, uart};
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
// The log's transport registers itself.
use defmt_rtt as _;
use embassy_stm32::Config;
use embassy_stm32::gpio::SwjCfg;
use embassy_stm32::rcc::{
    ADCPrescaler, AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPreDiv, PllSource,
    Sysclk,
};
use embassy_stm32::time::Hertz;
use mcdpr_firmware::drives::DriveBus;

/// Core clock, Hz.
pub const CORE_HZ: u32 = 72_000_000;
/// Core clock cycles of one control tick.
pub const CYCLES_PER_TICK: u32 = CORE_HZ / 1000;

#[cortex_m_rt::entry]
fn main() -> ! {
    let (link, mut syst) = bring_up();
    // From here on the tick runs, whatever happens below it.
    syst.enable_counter();
    link.run()
}

/// Everything once. Out of line, so that its temporaries leave the stack again.
#[inline(never)]
fn bring_up() -> (&'static mut link::Link, SYST) {
    let reset = identity::reset_cause(fatal::read_record());
    let Some(core) = cortex_m::Peripherals::take() else {
        fatal::stop("started twice")
    };
    interrupts::lower_all(core.NVIC, core.SCB);
    tick::start_cycle_counter(core.DCB, core.DWT);

    let p = embassy_stm32::init(clocks());
    watch_clock();
    let pins = pins::Pins::new(
        [p.PB12.into(), p.PB13.into(), p.PB14.into(), p.PB15.into()],
        p.PA10,
        p.PA3,
        p.PB5,
        p.PC13,
    );
    let encoders = encoders::Encoders::new(
        (p.TIM1, p.PA8, p.PA9),
        (p.TIM2, p.PA0, p.PA1),
        (p.TIM3, p.PA6, p.PA7),
        (p.TIM4, p.PB6, p.PB7),
    );
    tension::start(
        p.ADC1,
        p.DMA1_CH1,
        [p.PA4.into(), p.PA5.into(), p.PB0.into(), p.PB1.into()],
    );
    let (sender, ring) = uart::open(p.USART3, p.PB10, p.PB11, p.DMA1_CH2, p.DMA1_CH3);

    let (for_tick, for_link) = link::queues();
    let rim = tick::Rim {
        pins,
        encoders,
        can: can::open(p.CAN, p.PB8, p.PB9),
        drives: DriveBus::default(),
    };
    tick::hand_over(rim, for_tick, &reset);
    let link = link::Link::new(for_link, sender, ring, identity::hello(&reset), p.IWDG);

    let mut syst = core.SYST;
    syst.set_clock_source(SystClkSource::Core);
    syst.set_reload(CYCLES_PER_TICK - 1);
    syst.clear_current();
    syst.enable_interrupt();
    defmt::info!("started, reset cause {=u8}", reset.cause as u8);
    (link, syst)
}

/// 72 MHz from the 8 MHz crystal; both APB within their limits; ADC at 12 MHz of at most 14.
fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hse = Some(Hse {
        freq: Hertz(8_000_000),
        mode: HseMode::Oscillator,
    });
    config.rcc.pll = Some(Pll {
        src: PllSource::HSE,
        prediv: PllPreDiv::DIV1,
        mul: PllMul::MUL9,
    });
    config.rcc.sys = Sysclk::PLL1_P;
    config.rcc.ahb_pre = AHBPrescaler::DIV1;
    config.rcc.apb1_pre = APBPrescaler::DIV2;
    config.rcc.apb2_pre = APBPrescaler::DIV1;
    config.rcc.adc_pre = ADCPrescaler::DIV6;
    config.swj = SwjCfg::SwdOnly;
    config.bdma_interrupt_priority = interrupts::LINK;
    config
}

/// A crystal that stops raises an NMI, which closes the brakes (P6).
fn watch_clock() {
    embassy_stm32::pac::RCC.cr().modify(|w| w.set_csson(true));
}
