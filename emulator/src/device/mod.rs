//! Peripherals of the STM32F103C8 that this firmware uses (ST reference manual RM0008).

pub(crate) mod adc;
pub(crate) mod can;
pub(crate) mod can_line;
#[cfg(test)]
mod can_tests;
pub(crate) mod dma;
pub(crate) mod encoder_line;
pub(crate) mod gpio;
pub(crate) mod quadrature;
pub(crate) mod rcc;
pub(crate) mod supply;
#[cfg(test)]
mod tests;
pub(crate) mod timer;
pub(crate) mod usart;
pub(crate) mod watchdog;

/// Ticks of the chip's time in a second: the fastest core clock. Slower clocks last whole ticks.
pub(crate) const TICKS_PER_SECOND: u64 = 72_000_000;
