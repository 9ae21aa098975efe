//! From reset to the first tick.
//!
//! By registers, not by embassy-stm32's `init`: that waits for the crystal and the PLL without limit (version 0.6,
//! `rcc/f013.rs`). A board whose crystal never starts must say so (P6), and its watchdog must run before.

use crate::bench::Gauge;
use crate::clock::CYCLES_PER_TICK;
use crate::life::Keeper;
use crate::{can, fatal, identity, interrupts, keep, link, pins, tension, tick, uart};
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{DWT, SYST};
// The log's transport registers itself.
use defmt_rtt as _;
use embassy_stm32::pac;
use embassy_stm32::pac::afio::vals::SwjCfg;
use embassy_stm32::pac::flash::vals::Latency;
use embassy_stm32::pac::rcc::vals::{Adcpre, Pllmul, Pllsrc, Ppre, Sw};
use mcdpr_firmware::drives::DriveBus;
use mcdpr_firmware::supply::Supply;

/// Clock after a reset, by the chip's own oscillator, Hz.
const RESET_HZ: u32 = 8_000_000;
/// A crystal takes 2 ms to start (data sheet, 5.3.6), a slow one a little more; the PLL 0.2 ms at
/// most. Together they stay far below the watchdog's timeout, 25 ms at least.
// 12 ms: six times the typical start-up time. With the PLL's two waits 14 ms, of 25 ms at least.
const CRYSTAL_MS: u32 = 12;
const PLL_MS: u32 = 1;

/// The voltage detector's line of EXTI.
const SUPPLY_LINE: usize = 16;
/// Field of PWR_CR: the highest threshold, 2.66 to 2.90 V while falling.
// The highest threshold of the detector: it leaves the most time to close the brakes.
const PVD_2V9: u8 = 7;
/// Field of AFIO_MAPR: receive on PB8, transmit on PB9.
const CAN_ON_B8_B9: u8 = 2;

#[cortex_m_rt::entry]
fn main() -> ! {
    let (incoming, outgoing, mut syst) = bring_up();
    // From here on the tick runs, independent of the code below it.
    syst.enable_counter();
    link::run(incoming, outgoing)
}

/// All steps of the start. Out of line, so that its temporaries leave the stack again.
#[inline(never)]
fn bring_up() -> (
    &'static mut link::Incoming,
    &'static mut link::Outgoing,
    SYST,
) {
    // Before anything that could hang. It cannot be stopped again.
    let mut keeper = Keeper::new();
    let reset = identity::reset_cause(fatal::read_record());
    let Some(core) = cortex_m::Peripherals::take() else {
        fatal::stop("started twice")
    };
    // Before any interrupt is enabled: none may ever run at the tick's priority.
    interrupts::lower_all(core.NVIC, core.SCB);
    tick::start_cycle_counter(core.DCB, core.DWT);

    let crystal = clocks(&mut keeper);
    // The clocks took up to 14 ms of the watchdog's time.
    keeper.feed_at_start();
    pins::set_up();
    watch_supply(&mut keeper);
    tension::start();
    let (sender, ring, tap) = uart::open();

    let (for_tick, for_link) = link::queues();
    let mut rim = tick::Rim {
        can: can::open(),
        supply: Supply::default(),
        drives: DriveBus::default(),
        tap,
        last_panic: reset.last_panic.clone(),
        // Before the gauge: it resets the backup registers of a chip whose clock had another source.
        lengths: keep::Lengths::open(&reset),
        gauge: Gauge::new(reset.flags, crystal),
    };
    // The drives continue with their last command until they are stopped.
    if let Some(last) = keep::last() {
        rim.drives.stop_at_start(&last, &mut rim.can);
    }
    tick::hand_over(rim, for_tick, &reset, crystal);
    let hello = identity::hello(&reset);
    let (incoming, outgoing) = link::open(for_link, sender, ring, keeper, hello);

    let mut syst = core.SYST;
    syst.set_clock_source(SystClkSource::Core);
    // 36 MHz instead of 72 MHz: half as many cycles are the same millisecond.
    let cycles = if crystal {
        CYCLES_PER_TICK
    } else {
        CYCLES_PER_TICK / 2
    };
    syst.set_reload(cycles - 1);
    syst.clear_current();
    syst.enable_interrupt();
    defmt::info!("started, reset cause {=u8}", reset.cause as u8);
    (incoming, outgoing, syst)
}

/// From here on a supply under some 2.8 V, of 3.3 V, closes the brakes (P1). One that is low already gives no edge: then
/// the board waits until it is not, with every output off, and the encoders count on.
fn watch_supply(keeper: &mut Keeper) {
    pac::PWR.cr().write(|w| {
        w.set_pls(PVD_2V9);
        w.set_pvde(true);
    });
    pac::EXTI.rtsr(0).write(|w| w.set_line(SUPPLY_LINE, true));
    pac::EXTI.imr(0).write(|w| w.set_line(SUPPLY_LINE, true));
    interrupts::enable_link(pac::Interrupt::PVD);
    // After the interrupt is enabled: a fall in between is then either an edge or seen here.
    while pac::PWR.csr().read().pvdo() {
        keeper.feed_at_start();
    }
}

/// Whether a condition becomes true in time; meanwhile the core runs from its own oscillator of 8
/// MHz.
fn comes(within_ms: u32, is_there: impl Fn() -> bool) -> bool {
    let began = DWT::cycle_count();
    while !is_there() {
        // Counted in cycles: no timer runs yet.
        if DWT::cycle_count().wrapping_sub(began) > within_ms * (RESET_HZ / 1000) {
            return false;
        }
    }
    true
}

/// 72 MHz from the 8 MHz crystal; both APB within their limits; ADC at 12 MHz of at most 14. Then
/// clocks for all used peripherals, and CAN on PB8 and PB9. After a reset the chip runs from its
/// own oscillator of 8 MHz.
///
/// If the crystal does not start, the oscillator gives 36 MHz. The slower peripherals keep their 36
/// MHz, so that line and bus need no other settings; the board reports P6 and does not arm. Returns
/// whether the crystal runs.
fn clocks(keeper: &mut Keeper) -> bool {
    let rcc = pac::RCC;
    pac::FLASH.acr().write(|w| {
        // Two wait states above 48 MHz (RM0008, 3.3.3), set before the clock becomes fast.
        w.set_latency(Latency::WS2);
        w.set_prftbe(true);
    });
    rcc.cr().modify(|w| w.set_hseon(true));
    let crystal = comes(CRYSTAL_MS, || rcc.cr().read().hserdy());
    rcc.cfgr().write(|w| {
        w.set_pllmul(Pllmul::MUL9);
        w.set_adcpre(Adcpre::DIV6);
        if crystal {
            w.set_pllsrc(Pllsrc::HSE_DIV_PREDIV);
            // APB1 is limited to 36 MHz. Without the crystal the core itself has 36 MHz.
            w.set_ppre1(Ppre::DIV2);
        }
    });
    // A crystal that stops raises an NMI, which closes the brakes (P6).
    rcc.cr().modify(|w| {
        w.set_hseon(crystal);
        w.set_pllon(true);
        // Only a crystal that runs can be monitored.
        w.set_csson(crystal);
    });
    if !comes(PLL_MS, || rcc.cr().read().pllrdy()) {
        blink(keeper);
    }
    rcc.cfgr().modify(|w| w.set_sw(Sw::PLL1_P));
    // The switch takes a few cycles of both clocks, which are running.
    let _ = comes(PLL_MS, || rcc.cfgr().read().sws() == Sw::PLL1_P);
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
        // Frees PA15, PB3 (drive enable) and PB4; a probe needs SWD only.
        w.set_swj_cfg(SwjCfg::JTAG_DISABLE);
    });
    // A probe can read the log while the processor sleeps.
    pac::DBGMCU.cr().modify(|w| w.set_dbg_sleep(true));
    crystal
}

/// Without a PLL there is no clock for the line: only the LED can signal, at some Hz. Pins float,
/// so brakes are closed and drives without power.
fn blink(keeper: &mut Keeper) -> ! {
    pac::RCC.apb2enr().modify(|w| w.set_gpiocen(true));
    pins::drive_led();
    for step in 0_u32.. {
        // Takes a few times longer than stated, because of the flash's wait states.
        cortex_m::asm::delay(RESET_HZ / 1000);
        keeper.feed_at_start();
        pins::light(step % 64 < 32);
    }
    fatal::stop("P6: no PLL")
}
