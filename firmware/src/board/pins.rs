//! Pins.
//!
//! | pin | use | at reset | note |
//! |---|---|---|---|
//! | PA0, PA1 | encoder 2 A, B (TIM2) | input | 3.3 V only: buffer; pull-up |
//! | PA2 | fault line between boards | input | 3.3 V only; pull-down; low: a board is not well |
//! | PA3 | gripper switch | input | pull-up; closed to ground |
//! | PA4, PA5 | tension 1, 2 (ADC 4, 5) | input | 3.3 V only; 10 kOhm to 3.3 V |
//! | PA6, PA7 | encoder 3 A, B (TIM3) | input | 3.3 V only: buffer; pull-up |
//! | PA8, PA9 | encoder 1 A, B (TIM1) | input | buffer; pull-up |
//! | PA10 | gripper | input | high closes |
//! | PA11 | well, to the fault line | input | open-drain; low: well; gate pulled up by the line's supply |
//! | PA12 | free | input | USB socket of common boards, as PA11: plug nothing in |
//! | PA13, PA14 | SWDIO, SWCLK | SWD | kept |
//! | PA15, PB4 | free | JTAG, pulled up | freed: SWD only |
//! | PB0, PB1 | tension 3, 4 (ADC 8, 9) | input | 3.3 V only; 10 kOhm to 3.3 V |
//! | PB2 | BOOT1 | input | |
//! | PB3 | drive enable | JTAG, floats | high lets the drives' contactor close; pull-down of 10 kOhm |
//! | PB5 | emergency stop | input | 3.3 V only; 2.2 kOhm to 3.3 V; contact to ground opens when pressed |
//! | PB6, PB7 | encoder 4 A, B (TIM4) | input | buffer; pull-up |
//! | PB8, PB9 | CAN RX, TX (remapped) | input | 3.3 V transceiver; its TXD pulled up |
//! | PB10, PB11 | host link TX, RX (USART3) | input | 921600 baud |
//! | PB12 to PB15 | brakes 1 to 4 | input | high opens; needs a pull-down at the driver |
//! | PC13 | status LED | input | low lights |
//! | PD0, PD1 | 8 MHz crystal | oscillator | |
//!
//! Every output floats from reset until `set_up`: the brakes' pull-downs (10 kOhm) keep the
//! drivers off meanwhile, and that of the drive enable the contactor. An emergency stop that is not wired reads as pressed.
//!
//! LED: on while armed; a second on, a second off when disarmed; 4 Hz at a fault or emergency stop.

use embassy_stm32::pac;
use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::gpio::regs::{Bsrr, Cr};
use mcdpr_firmware::{Brake, Outputs, State};
use mcdpr_protocol::Tick;

/// First of the four brake pins, in port B.
const FIRST_BRAKE: u32 = 12;
/// All four.
const BRAKES: u32 = 0xF << FIRST_BRAKE;
/// Enables the drives' power, in port B.
const DRIVE_ENABLE: u32 = 1 << 3;
/// Winches of this board.
pub const CABLES: usize = 4;

/// Pin 3 of port A, and so on: bits of their ports.
const GRIPPER_SWITCH: u32 = 1 << 3;
const GRIPPER: u32 = 1 << 10;
const FAULT_LINE: u32 = 1 << 2;
/// Low keeps the transistor at the fault line from pulling.
const WELL: u32 = 1 << 11;
const E_STOP: u32 = 1 << 5;
const LED: u32 = 1 << 13;
const CAN_RX: u32 = 1 << 8;
const LINK_RX: u32 = 1 << 11;

/// Configures every pin except the two that CAN and link take over later: brakes closed, gripper
/// open, LED dark. The ports' clocks must run.
pub fn set_up() {
    // Levels first: pull-ups, and the initial levels of outputs.
    // The output register also selects an input's pull: 1 is up.
    set(pac::GPIOA, GRIPPER_SWITCH | WELL, GRIPPER | FAULT_LINE);
    set(pac::GPIOB, E_STOP | CAN_RX | LINK_RX, 0);
    safe_off();
    set(pac::GPIOC, LED, 0);
    // Four bits a pin, pin 0 last: 0 analog, 2 output of 2 MHz, 4 floating input, 6 as 2 with open drain, 8 input with
    // pull.
    pac::GPIOA.cr(0).write_value(Cr(0x4400_8844));
    pac::GPIOA.cr(1).write_value(Cr(0x4444_6244));
    pac::GPIOB.cr(0).write_value(Cr(0x4484_2400));
    pac::GPIOB.cr(1).write_value(Cr(0x2222_8448));
    drive_led();
}

/// Sets some pins of a port and clears others, at once.
fn set(port: Gpio, high: u32, low: u32) {
    // One write: no interrupt can come between setting and clearing.
    port.bsrr().write_value(Bsrr(high | (low << 16)));
}

fn is_high(port: Gpio, pin: u32) -> bool {
    port.idr().read().0 & pin != 0
}

/// Whether the emergency stop is pressed, or its wire is broken.
pub fn e_stop() -> bool {
    is_high(pac::GPIOB, E_STOP)
}

/// Whether the gripper's switch is closed.
pub fn gripper_switch() -> bool {
    !is_high(pac::GPIOA, GRIPPER_SWITCH)
}

/// Whether a board is not well, or the fault line's plug is pulled.
pub fn fault_line_low() -> bool {
    !is_high(pac::GPIOA, FAULT_LINE)
}

/// Sets brakes, drive enable, gripper and what the fault line tells.
pub fn apply(outputs: &Outputs<CABLES>) {
    let mut open = 0;
    for brake in outputs.brakes.iter().rev() {
        open = (open << 1) | u32::from(*brake == Brake::Open);
    }
    let high = (open << FIRST_BRAKE) | (u32::from(outputs.drive_enable) * DRIVE_ENABLE);
    // All brakes change in the same cycle.
    set(pac::GPIOB, high, (BRAKES | DRIVE_ENABLE) & !high);
    let gripper = u32::from(outputs.gripper_closed) * GRIPPER;
    let high = gripper | (u32::from(!outputs.well) * WELL);
    set(pac::GPIOA, high, (GRIPPER | WELL) & !high);
}

/// Levels of the outputs at their pins: brakes 1 to 4, gripper, drive enable.
pub fn outputs() -> u8 {
    let brakes = (pac::GPIOB.idr().read().0 & BRAKES) >> FIRST_BRAKE;
    let gripper = u32::from(is_high(pac::GPIOA, GRIPPER));
    let drives = u32::from(is_high(pac::GPIOB, DRIVE_ENABLE));
    let all = brakes | (gripper << 4) | (drives << 5);
    all.to_le_bytes()[0]
}

/// Shows the state.
pub fn show(state: State, now: Tick) {
    let lit = match state {
        State::Boot => false,
        // About a second, and an eighth of one.
        // Bit 10 changes every 1.024 s, bit 7 every 0.128 s.
        State::Disarmed => now.0 & 1024 != 0,
        State::Fault | State::EStop => now.0 & 128 != 0,
        _ => true,
    };
    light(lit);
}

/// Switches the LED on or off.
pub fn light(lit: bool) {
    let low = u32::from(lit) * LED;
    set(pac::GPIOC, LED & !low, low);
}

/// Makes the LED's pin an output, for a start that fails early.
pub fn drive_led() {
    pac::GPIOC.cr(1).write_value(Cr(0x4424_4444));
}

/// Closes every brake and switches off the drives' power, in one write and without any state: for
/// handlers of fatal errors.
pub fn safe_off() {
    set(pac::GPIOB, 0, BRAKES | DRIVE_ENABLE);
}
