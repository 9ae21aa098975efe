//! Pins.
//!
//! | pin | use | at reset | note |
//! |---|---|---|---|
//! | PA0, PA1 | encoder 2 A, B (TIM2) | input | |
//! | PA2 | reserved: fault line between boards | input | not driven |
//! | PA3 | gripper switch | input | pull-up; closed to ground |
//! | PA4, PA5 | tension 1, 2 (ADC 4, 5) | input | 0 to 3.3 V, not 5 V tolerant |
//! | PA6, PA7 | encoder 3 A, B (TIM3) | input | not 5 V tolerant: divide |
//! | PA8, PA9 | encoder 1 A, B (TIM1) | input | |
//! | PA10 | gripper | input | high closes |
//! | PA11, PA12 | free | input | USB socket of common boards |
//! | PA13, PA14 | SWDIO, SWCLK | SWD | kept |
//! | PA15, PB3, PB4 | free | JTAG | freed: SWD only |
//! | PB0, PB1 | tension 3, 4 (ADC 8, 9) | input | 0 to 3.3 V, not 5 V tolerant |
//! | PB2 | BOOT1 | input | |
//! | PB5 | emergency stop | input | pull-up; contact to ground opens when pressed |
//! | PB6, PB7 | encoder 4 A, B (TIM4) | input | |
//! | PB8, PB9 | CAN RX, TX (remapped) | input | 3.3 V transceiver; its TXD pulled up |
//! | PB10, PB11 | host link TX, RX (USART3) | input | 921600 baud |
//! | PB12 to PB15 | brakes 1 to 4 | input | high opens; needs a pull-down at the driver |
//! | PC13 | status LED | input | low lights |
//! | PD0, PD1 | 8 MHz crystal | oscillator | |
//!
//! Every output floats from reset until `Pins::new`: the brakes' pull-downs (10 kOhm) keep the
//! drivers off meanwhile. An emergency stop that is not wired reads as pressed.
//!
//! LED: on while armed; one second on, one off when disarmed; 4 Hz at a fault or emergency stop.

use embassy_stm32::Peri;
use embassy_stm32::gpio::{AnyPin, Input, Level, Output, Pull, Speed};
use embassy_stm32::pac;
use embassy_stm32::peripherals::{PA3, PA10, PB5, PC13};
use mcdpr_firmware::{Brake, Outputs, State};
use mcdpr_protocol::Tick;

/// First of the four brake pins, in port B.
const FIRST_BRAKE: usize = 12;
/// Winches of this board.
pub const CABLES: usize = 4;

/// Digital inputs and outputs.
pub struct Pins {
    brakes: [Output<'static>; CABLES],
    gripper: Output<'static>,
    gripper_switch: Input<'static>,
    e_stop: Input<'static>,
    led: Output<'static>,
}

impl Pins {
    /// Brakes closed, gripper open, LED dark.
    pub fn new(
        brakes: [Peri<'static, AnyPin>; CABLES],
        gripper: Peri<'static, PA10>,
        gripper_switch: Peri<'static, PA3>,
        e_stop: Peri<'static, PB5>,
        led: Peri<'static, PC13>,
    ) -> Self {
        Self {
            brakes: brakes.map(|pin| Output::new(pin, Level::Low, Speed::Low)),
            gripper: Output::new(gripper, Level::Low, Speed::Low),
            gripper_switch: Input::new(gripper_switch, Pull::Up),
            e_stop: Input::new(e_stop, Pull::Up),
            led: Output::new(led, Level::High, Speed::Low),
        }
    }

    /// Whether the emergency stop is pressed, or its wire is broken.
    pub fn e_stop(&self) -> bool {
        self.e_stop.is_high()
    }

    /// Whether the gripper's switch is closed.
    pub fn gripper_switch(&self) -> bool {
        self.gripper_switch.is_low()
    }

    /// Sets brakes and gripper.
    pub fn apply(&mut self, outputs: &Outputs<CABLES>) {
        for (pin, brake) in self.brakes.iter_mut().zip(outputs.brakes) {
            pin.set_level(Level::from(brake == Brake::Open));
        }
        self.gripper.set_level(Level::from(outputs.gripper_closed));
    }

    /// Shows the state.
    pub fn show(&mut self, state: State, now: Tick) {
        let lit = match state {
            State::Boot => false,
            State::Disarmed => now.0 % 2000 < 1000,
            State::Fault | State::EStop => now.0 % 250 < 125,
            _ => true,
        };
        self.led.set_level(Level::from(!lit));
    }
}

/// Closes every brake, in one write and without any state: for handlers of fatal errors.
pub fn close_brakes() {
    pac::GPIOB.bsrr().write(|w| {
        for pin in FIRST_BRAKE..FIRST_BRAKE + CABLES {
            w.set_br(pin, true);
        }
    });
}
