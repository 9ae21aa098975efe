//! From reset to the first tick.

use crate::clock::CYCLES_PER_TICK;
use crate::{can, encoders, fatal, identity, interrupts, link, pins, tension, tick, uart};
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
// The log's transport registers itself.
use defmt_rtt as _;
use embassy_stm32::pac;
use embassy_stm32::pac::afio::vals::SwjCfg;
use embassy_stm32::pac::flash::vals::Latency;
use embassy_stm32::pac::rcc::vals::{Adcpre, Pllmul, Pllsrc, Ppre, Sw};
use mcdpr_firmware::drives::DriveBus;

/// The voltage detector's line of EXTI.
const SUPPLY_LINE: usize = 16;
/// Field of PWR_CR: 2.9 V.
const PVD_2V9: u8 = 7;
/// Field of AFIO_MAPR: receive on PB8, transmit on PB9.
const CAN_ON_B8_B9: u8 = 2;

#[cortex_m_rt::entry]
fn main() -> ! {
    let (incoming, outgoing, mut syst) = bring_up();
    // From here on the tick runs, whatever happens below it.
    syst.enable_counter();
    link::run(incoming, outgoing)
}

/// Everything once. Out of line, so that its temporaries leave the stack again.
#[inline(never)]
fn bring_up() -> (
    &'static mut link::Incoming,
    &'static mut link::Outgoing,
    SYST,
) {
    let reset = identity::reset_cause(fatal::read_record());
    let Some(core) = cortex_m::Peripherals::take() else {
        fatal::stop("started twice")
    };
    interrupts::lower_all(core.NVIC, core.SCB);
    tick::start_cycle_counter(core.DCB, core.DWT);

    clocks();
    pins::set_up();
    watch_supply();
    encoders::start();
    tension::start();
    let (sender, ring, tap) = uart::open();

    let (for_tick, for_link) = link::queues();
    let rim = tick::Rim {
        can: can::open(),
        drives: DriveBus::default(),
        tap,
        last_panic: reset.last_panic.clone(),
    };
    tick::hand_over(rim, for_tick, &reset);
    let (incoming, outgoing) = link::open(for_link, sender, ring, identity::hello(&reset));

    let mut syst = core.SYST;
    syst.set_clock_source(SystClkSource::Core);
    syst.set_reload(CYCLES_PER_TICK - 1);
    syst.clear_current();
    syst.enable_interrupt();
    defmt::info!("started, reset cause {=u8}", reset.cause as u8);
    (incoming, outgoing, syst)
}

/// From here on a supply under 2.9 V, of 3.3 V, closes the brakes (P1). One that is low already
/// gives no edge: then the board starts again until it is not.
fn watch_supply() {
    pac::PWR.cr().write(|w| {
        w.set_pls(PVD_2V9);
        w.set_pvde(true);
    });
    pac::EXTI.rtsr(0).write(|w| w.set_line(SUPPLY_LINE, true));
    pac::EXTI.imr(0).write(|w| w.set_line(SUPPLY_LINE, true));
    interrupts::enable_link(pac::Interrupt::PVD);
    if pac::PWR.csr().read().pvdo() {
        fatal::stop(fatal::SUPPLY_LOW)
    }
}

/// 72 MHz from the 8 MHz crystal; both APB within their limits; ADC at 12 MHz of at most 14. Then
/// clocks for all that is used, and CAN on PB8 and PB9. After a reset the chip runs from its own
/// oscillator of 8 MHz.
fn clocks() {
    let rcc = pac::RCC;
    pac::FLASH.acr().write(|w| {
        w.set_latency(Latency::WS2);
        w.set_prftbe(true);
    });
    rcc.cr().modify(|w| w.set_hseon(true));
    while !rcc.cr().read().hserdy() {}
    rcc.cfgr().write(|w| {
        w.set_pllmul(Pllmul::MUL9);
        w.set_pllsrc(Pllsrc::HSE_DIV_PREDIV);
        w.set_ppre1(Ppre::DIV2);
        w.set_adcpre(Adcpre::DIV6);
    });
    // A crystal that stops raises an NMI, which closes the brakes (P6).
    rcc.cr().modify(|w| {
        w.set_pllon(true);
        w.set_csson(true);
    });
    while !rcc.cr().read().pllrdy() {}
    rcc.cfgr().modify(|w| w.set_sw(Sw::PLL1_P));
    while rcc.cfgr().read().sws() != Sw::PLL1_P {}
    rcc.ahbenr().modify(|w| w.set_dma1en(true));
    rcc.apb1enr().write(|w| {
        w.set_tim2en(true);
        w.set_tim3en(true);
        w.set_tim4en(true);
        w.set_usart3en(true);
        w.set_canen(true);
        w.set_pwren(true);
    });
    rcc.apb2enr().write(|w| {
        w.set_afioen(true);
        w.set_gpioaen(true);
        w.set_gpioben(true);
        w.set_gpiocen(true);
        w.set_adc1en(true);
        w.set_tim1en(true);
    });
    pac::AFIO.mapr().write(|w| {
        w.set_can1_remap(CAN_ON_B8_B9);
        w.set_swj_cfg(SwjCfg::JTAG_DISABLE);
    });
    // A probe can read the log while the processor sleeps.
    pac::DBGMCU.cr().modify(|w| w.set_dbg_sleep(true));
}
