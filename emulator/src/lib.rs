//! An emulated STM32F103C8 that executes the real firmware file.
//!
//! An ARMv7-M core (Cortex-M3, integers), its exceptions, and the peripherals this firmware uses.
//! Strict: a misuse that would go unnoticed on a bench stops the run with a [`Stop`] that names the
//! error, the address and the instruction. Deterministic: time is counted in ticks of 1/72 us that
//! follow from the instructions alone.
//!
//! Cycles are estimated: one per instruction, one more per word moved, two more per branch taken,
//! twelve per exception entry and exit; no wait states. Instruction counts are exact. A maximum
//! over runs is not a proven worst case.
//!
//! | module | what it is for |
//! |---|---|
//! | `core` | decoder, instructions, exceptions |
//! | `scs` | NVIC, system control block, SysTick, DWT |
//! | `bus` | memory map, time, DMA transfers |
//! | `device` | RCC, ports, timers with their encoders' lines, ADC, DMA, USART, CAN, watchdog, supply |
//! | `elf` | the firmware file |
//! | `chip` | the whole chip, from outside |
//! | `board` | the chip in lockstep with the simulated robot |

mod board;
mod bus;
mod chip;
mod core;
mod device;
mod elf;
mod error;
mod scs;
mod trap;

pub use board::{ChipBoard, SharedChip};
pub use bus::Identity;
pub use chip::{CanErrors, Chip, Jumpers, Pins, Port, ProfileRow, SentFrame, TickStats};
pub use device::can_line::{CanFrame, CanWiring};
pub use device::encoder_line::EncoderLine;
pub use device::gpio::Drive;
pub use device::supply::SupplyLimits;
pub use elf::flash_image;
pub use error::{LoadError, ResetBy, Stop};
