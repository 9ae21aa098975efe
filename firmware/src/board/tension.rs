//! Tension channels: ADC1 scans them without end, DMA keeps the last sixteen scans.
//!
//! A conversion takes 84 cycles of 12 MHz, so sixteen scans of four channels span 0.45 ms: every
//! tick reads sixteen new samples of each. No interrupt is involved, and the tick needs no lock: a
//! sample is one aligned half-word, old or new.
//!
//! Sixteen samples of 12 bits add up to 65520 at most, so two channels are summed at once in the
//! halves of a word: the lower one cannot carry into the upper one.
//!
//! The value of a step depends on the supply. So each tick the converter also measures its internal
//! reference, as an injected conversion between two of a scan, and readings are scaled by it
//! ([`Supply`]). With a supply outside the converter's range all of them read as shorted (S8), and
//! no other fault is derived from them.
//!
//! By registers: embassy-stm32's driver for this chip's converter does single conversions only (version 0.6).

use crate::clock::CORE_HZ;
use crate::pins::CABLES;
use core::sync::atomic::{AtomicU32, Ordering, fence};
use embassy_stm32::pac;
use embassy_stm32::pac::adc::vals::SampleTime;
use embassy_stm32::pac::bdma::vals::{Dir, Pl, Size};
use mcdpr_firmware::supply::Supply;

/// ADC channels of PA4, PA5, PB0, PB1.
const CHANNELS: [u8; CABLES] = [4, 5, 8, 9];
/// Samples of each channel that are summed: 12 bits become 0 to 65520.
const OVERSAMPLING: usize = 16;
/// Software starts the conversion, the regular and the injected one.
const EXTSEL_SWSTART: u8 = 7;
/// Channel of the internal reference, 1.16 to 1.24 V (data sheet, 5.3.4).
const REFERENCE: u8 = 17;
const SAMPLES: usize = CABLES * OVERSAMPLING;
/// A scan is two words of two samples.
const _: () = assert!(CABLES == 4 && OVERSAMPLING.is_multiple_of(4));
/// The same for the DMA's counter.
const TRANSFERS: u16 = 64;
const _: () = assert!(TRANSFERS as usize == SAMPLES);

/// Written by DMA, cable 1 first (in the lower half of its word), scan after scan.
static RING: [AtomicU32; SAMPLES / 2] = [const { AtomicU32::new(0) }; SAMPLES / 2];

/// Calibrates, then scans continuously. The clocks of ADC and DMA must run.
pub fn start() {
    let adc = pac::ADC1;
    adc.cr2().modify(|w| w.set_adon(true));
    // Two cycles of its clock at least (RM0008, 11.4); it takes a microsecond to power up.
    cortex_m::asm::delay(CORE_HZ / 500_000);
    adc.cr2().modify(|w| w.set_rstcal(true));
    // Some cycles of its clock. A converter that never ends is caught by the watchdog.
    while adc.cr2().read().rstcal() {}
    adc.cr2().modify(|w| w.set_cal(true));
    while adc.cr2().read().cal() {}

    let channel = pac::DMA1.ch(0);
    channel.par().write_value(adc.dr().as_ptr() as u32);
    channel.mar().write_value(RING.as_ptr() as u32);
    channel.ndtr().write(|w| w.set_ndt(TRANSFERS));
    fence(Ordering::SeqCst);
    channel.cr().write(|w| {
        w.set_dir(Dir::FROM_PERIPHERAL);
        w.set_circ(true);
        w.set_minc(true);
        w.set_psize(Size::BITS16);
        w.set_msize(Size::BITS16);
        // A sample that is not fetched before the next one is lost, and cables would be exchanged.
        w.set_pl(Pl::HIGH);
        w.set_en(true);
    });

    adc.cr1().modify(|w| w.set_scan(true));
    for (position, channel) in (0_u8..).zip(CHANNELS) {
        adc.smpr2()
            .modify(|w| w.set_smp(usize::from(channel), SampleTime::CYCLES71_5));
        adc.sqr3()
            .modify(|w| w.set_sq(usize::from(position), channel));
        // Counted from 0: the index of the last one.
        adc.sqr1().modify(|w| w.set_l(position));
    }
    // The reference wants 17.1 us; a sequence of one is the fourth place.
    adc.smpr1()
        .modify(|w| w.set_smp(usize::from(REFERENCE - 10), SampleTime::CYCLES239_5));
    adc.jsqr().write(|w| w.set_jsq(3, REFERENCE));
    adc.cr2().modify(|w| {
        w.set_cont(true);
        w.set_dma(true);
        w.set_extsel(EXTSEL_SWSTART);
        w.set_exttrig(true);
        w.set_jextsel(EXTSEL_SWSTART);
        w.set_jexttrig(true);
        w.set_tsvrefe(true);
    });
    adc.cr2().modify(|w| w.set_swstart(true));
}

/// Sums of the last sixteen samples as they would be at 3.3 V, cable 1 first; all 0 while the
/// supply is under 3.0 V or over 3.6 V. Measures the supply again for the next call.
pub fn read(supply: &mut Supply) -> [u16; CABLES] {
    let adc = pac::ADC1;
    let supplied = supply.update(adc.jdr(0).read().jdata());
    // Its result is read in the next tick: 21 us of conversion are over by then.
    adc.cr2().modify(|w| w.set_jswstart(true));
    if !supplied {
        return [0; CABLES];
    }
    let (mut first, mut second) = (0_u32, 0_u32);
    let at = |pair: &AtomicU32| pair.load(Ordering::Relaxed);
    // Four scans at a time, unrolled: a loop costs as much as its body.
    let (scans, _) = RING.as_chunks::<8>();
    for [a, b, c, d, e, f, g, h] in scans {
        // Wrapping never happens: sixteen samples are 65,520 at most in each half.
        first = first.wrapping_add(at(a)).wrapping_add(at(c));
        second = second.wrapping_add(at(b)).wrapping_add(at(d));
        first = first.wrapping_add(at(e)).wrapping_add(at(g));
        second = second.wrapping_add(at(f)).wrapping_add(at(h));
    }
    let [a, b, c, d] = first.to_le_bytes();
    let [e, f, g, h] = second.to_le_bytes();
    [[a, b], [c, d], [e, f], [g, h]].map(|sum| supply.scale(u16::from_le_bytes(sum)))
}
