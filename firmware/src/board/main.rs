//! The firmware of the STM32F103C8T6 board: the control core with its pins, clocks and links.
//!
//! | module | what it is for |
//! |---|---|
//! | `pins` | pin table; brakes, inputs and outputs |
//! | `encoders` | four quadrature decoders (TIM1 to TIM4) |
//! | `tension` | four tension channels by ADC and DMA |
//! | `tick` | the control tick (SysTick, 1 kHz), sole owner of the control core |
//! | `can` | the drives' bus (bxCAN) |
//! | `clock` | clocks of the chip, ticks since the start |
//! | `link` | bytes to commands, answers and telemetry to bytes (thread mode) |
//! | `uart` | USART3, DMA in both directions |
//! | `interrupts` | priorities, and critical sections that never delay the tick |
//! | `memory` | copying and clearing, small |
//! | `life` | the watchdog, fed only while tick and link both run |
//! | `fatal` | brakes first, then a record that survives the reset |
//! | `keep` | drives to stop after a reset, in memory that a reset does not clear |
//! | `bench` | measurements that only the chip can make |
//! | `identity` | the board's identity and the cause of its start |
//!
//! Three priorities share the work. The tick preempts everything and takes no lock: it communicates
//! with the link and the CAN interrupts only through single-producer queues and atomics. Everything
//! else runs in thread mode.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod bench;
#[cfg(target_os = "none")]
mod can;
#[cfg(target_os = "none")]
mod clock;
#[cfg(target_os = "none")]
mod encoders;
#[cfg(target_os = "none")]
mod fatal;
#[cfg(target_os = "none")]
mod identity;
#[cfg(target_os = "none")]
mod interrupts;
#[cfg(target_os = "none")]
mod keep;
#[cfg(target_os = "none")]
mod life;
#[cfg(target_os = "none")]
mod link;
#[cfg(target_os = "none")]
mod memory;
#[cfg(target_os = "none")]
mod pins;
#[cfg(target_os = "none")]
mod start;
#[cfg(target_os = "none")]
mod tension;
#[cfg(target_os = "none")]
mod tick;
#[cfg(target_os = "none")]
mod uart;

/// This program runs only on the board; building it for a host prints how to build it.
#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("mcdpr-firmware runs on the STM32F103: build it with `cargo fw`");
}
