//! The chip as the board of a simulated robot: its pins, its line and its CAN bus, in lockstep with
//! the plant.
//!
//! Time advances in slices of 50 us: the plant first, then the chip with the new sensor values. So
//! a reading is at most a slice old, and an output reaches the plant within one.

use crate::chip::{Chip, Port, SentFrame};
use crate::device::can_line::{CanFrame, CanWiring};
use crate::device::gpio::Drive;
use crate::error::{LoadError, Stop};
use mcdpr_firmware::{State, drives};
use mcdpr_protocol::{FaultRecord, Tick};
use mcdpr_simulator::can::DriveLine;
use mcdpr_simulator::plant::{Plant, PlantError};
use mcdpr_simulator::{BEHIND_TICKS, BoardFailure, Overheard, Positions, VirtualBoard};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Slice of lockstep, us.
// 3600 ticks of 72 MHz, a twentieth of the control tick.
const SLICE_US: u64 = 50;
/// Winches of the board.
const CABLES: usize = 4;
/// Pin of port A at the fault line.
const FAULT_LINE: u8 = 2;
/// ADC channels of the tension sensors.
const TENSION: [u8; CABLES] = [4, 5, 8, 9];

/// Reading of a tension input at the supply, and between 22 kOhm to 0 V and its 10 kOhm to the
/// supply.
// PULLED is 22 / 32 of FULL, by the divider with the pull-up.
const FULL: u16 = 65_520;
const PULLED: u16 = 45_044;

/// A chip that a [`ChipBoard`] runs, for inspection and fault injection.
#[derive(Debug, Clone)]
pub struct SharedChip(Arc<Mutex<Chip>>);

impl SharedChip {
    /// Accesses the chip between two slices.
    pub fn with<R>(&self, look: impl FnOnce(&mut Chip) -> R) -> R {
        look(&mut self.lock())
    }

    fn lock(&self) -> MutexGuard<'_, Chip> {
        // A panic elsewhere does not change the chip.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// An emulated chip in place of the control core. Resets are survived as on the board.
#[derive(Debug)]
pub struct ChipBoard {
    chip: SharedChip,
    heard: Overheard,
    now: Tick,
    positions: Positions<CABLES>,
    /// Tick after which the sensors' noise was drawn.
    read_at: Tick,
    /// The plant's cable on each channel, and whether the gripper is on this board; `None` for the
    /// only board of a robot.
    wired: Option<([usize; CABLES], bool)>,
}

impl ChipBoard {
    /// A chip with this firmware file (ELF) that just got power.
    ///
    /// # Errors
    /// The file is not firmware for this chip.
    pub fn load(elf: &[u8]) -> Result<Self, LoadError> {
        let mut chip = Chip::load(elf)?;
        // Faults go to the firmware's handler, as on the board.
        chip.deliver_faults(true);
        Ok(Self {
            chip: SharedChip(Arc::new(Mutex::new(chip))),
            heard: Overheard::new(CABLES),
            now: Tick(0),
            positions: Positions::default(),
            read_at: Tick(0),
            wired: None,
        })
    }

    /// For these cables of a plant; `number` from 0 tells several boards of one robot apart, and
    /// the gripper is on the first. `None` for another number of cables than the board has
    /// channels.
    #[must_use]
    pub fn wired(mut self, cables: &[usize], number: u8) -> Option<Self> {
        let cables = <[usize; CABLES]>::try_from(cables).ok()?;
        self.wired = Some((cables, number == 0));
        self.chip.lock().set_number(number);
        Some(self)
    }

    /// The plant's cable on each channel.
    fn cables(&self) -> [usize; CABLES] {
        self.wired.map_or_else(
            || std::array::from_fn(|channel| channel),
            |(cables, _)| cables,
        )
    }

    /// The chip, to keep while a simulation has the board.
    #[must_use]
    pub fn chip(&self) -> SharedChip {
        self.chip.clone()
    }

    /// The plant's sensors to the chip's pins.
    fn sense(&mut self, plant: &mut Plant, chip: &mut Chip) {
        // The sensor's noise is that of a reading as the firmware makes it, from its last sixteen
        // conversions: it is drawn once a tick, right after one, as for a board in this process.
        let cables = self.cables();
        let sensors = if self.read_at == self.now {
            plant.read_sensors_again_of(&cables)
        } else {
            plant.read_sensors_of(&cables)
        };
        self.read_at = self.now;
        let counters = cables.map(|cable| sensors.encoder_counts[cable]);
        // The counters' value at power-on is where the timers start.
        for (index, position) in self.positions.follow(counters).into_iter().enumerate() {
            // Edges of A count up, edges of B down: one output is high at a time.
            let shown = chip.jumpers.map_or(position, |wires| {
                let high = |wire: Option<usize>| wire.is_some_and(|out| chip.is_high(out));
                i64::from(high(wires.a[index])) - i64::from(high(wires.b[index]))
            });
            chip.set_encoder(index + 1, shown);
        }
        let readings = cables.map(|cable| sensors.adc[cable]);
        for (index, (channel, read)) in TENSION.into_iter().zip(readings).enumerate() {
            let wire = chip.jumpers.and_then(|wires| wires.tension[index]);
            let sum = wire.map_or(read, |out| if chip.is_high(out) { FULL } else { PULLED });
            chip.set_adc_sixteenths(channel, sum);
        }
        chip.set_input(Port::B, 5, Some(sensors.e_stop));
        // The gripper's switch closes to ground.
        chip.set_input(Port::A, 3, Some(!plant.gripper_switch()));
    }

    /// The chip's pins to the plant's brakes and gripper.
    fn act(&self, plant: &mut Plant, chip: &Chip) -> Result<(), PlantError> {
        let pins = chip.pins();
        for (cable, drive) in self.cables().into_iter().zip(pins.brakes) {
            // A floating pin closes the brake, and opens the contactor: the drivers have pull-downs.
            plant.set_brake(cable, drive != Drive::High)?;
            plant.set_drive_enable(cable, pins.drive_enable == Drive::High)?;
        }
        if self.wired.is_none_or(|(_, first)| first) {
            plant.set_gripper(chip.pins().gripper == Drive::High);
        }
        Ok(())
    }
}

impl VirtualBoard for ChipBoard {
    fn slice_us(&self) -> u64 {
        SLICE_US
    }

    /// The drives' electronics receive the frames of the chip's CAN controller, and send over its
    /// bus.
    fn advance(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        until_us: u64,
    ) -> Result<(), PlantError> {
        plant.advance(1e-6 * SLICE_US as f64)?;
        self.follow(plant, line, until_us)
    }

    fn follow(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        until_us: u64,
    ) -> Result<(), PlantError> {
        let mut chip = self.chip.lock();
        let faults = line.bus_mut().faults_mut();
        // Taken, not read: each injected error destroys one frame.
        let destroy = std::mem::take(&mut faults.corrupt);
        if destroy > 0 {
            chip.destroy_can_frames(destroy);
        }
        chip.set_can_wiring(CanWiring {
            bitrate: plant.params().bus.bitrate,
            others: (0..plant.cable_count()).any(|cable| plant.drive_has_supply(cable)),
            shorted: plant.faults().bus_off,
        });
        let heard = chip.can_take();
        let mut send = |_drive, at_us, frame: drives::CanFrame| {
            let bytes = frame.data.get(..frame.len.into()).unwrap_or(&frame.data);
            chip.can_send(at_us, CanFrame::standard(frame.id, bytes));
        };
        let nodes = line.nodes_mut();
        let standard = heard.into_iter().filter(|sent| !sent.frame.extended);
        for SentFrame { ends_at_us, frame } in standard {
            let frame = drives::CanFrame {
                id: frame.id as u16,
                len: frame.length,
                data: frame.data,
            };
            nodes.hear(plant, ends_at_us, None, &frame, &mut send)?;
        }
        nodes.pass(plant, until_us, &mut send)
    }

    fn power_on(&mut self) -> Result<(), PlantError> {
        self.chip.lock().power_on();
        self.positions.restart();
        self.heard.restart();
        self.now = Tick(0);
        self.read_at = Tick(0);
        Ok(())
    }

    fn fit_battery(&mut self) {
        self.chip.lock().fit_battery();
    }

    fn restart(&mut self, _: BoardFailure) -> Result<(), PlantError> {
        // The chip resets itself.
        Ok(())
    }

    fn fail(&mut self, failure: BoardFailure, on: bool) -> bool {
        let mut chip = self.chip.lock();
        match failure {
            BoardFailure::SupplyLow => _ = chip.set_supply_low(on),
            BoardFailure::Crash if on => chip.inject_hard_fault(),
            BoardFailure::Crash => {}
        }
        true
    }

    fn advance_unpowered(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        until_us: u64,
    ) -> Result<(), PlantError> {
        plant.advance(1e-6 * SLICE_US as f64)?;
        self.follow_unpowered(plant, line, until_us)
    }

    fn follow_unpowered(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        until_us: u64,
    ) -> Result<(), PlantError> {
        self.chip.lock().skip_us(SLICE_US);
        // Nobody hears the drives.
        line.nodes_mut().pass(plant, until_us, &mut |_, _, _| {})
    }

    fn tick(
        &mut self,
        plant: &mut Plant,
        _line: &mut DriveLine,
        received: &[u8],
        _backlog: usize,
        send: &mut Vec<u8>,
    ) -> Result<(), PlantError> {
        let count = plant.cable_count();
        if count != CABLES && self.wired.is_none() {
            let reason =
                format!("the robot has {count} cables, and this firmware drives four winches");
            return Err(PlantError::Board { reason });
        }
        let shared = self.chip.clone();
        let mut chip = shared.lock();
        self.sense(plant, &mut chip);
        if !received.is_empty() {
            chip.uart_send(received);
        }
        let resets = chip.resets().len();
        if let Err(stop) = chip.run_us(SLICE_US) {
            let Stop::Reset { by, .. } = stop else {
                let reason = format!("emulated chip: {stop}");
                return Err(PlantError::Board { reason });
            };
            chip.restart(by);
        }
        // A dip of its supply resets it, too.
        if chip.resets().len() > resets {
            self.heard.restart();
        }
        self.act(plant, &chip)?;
        let begin = send.len();
        send.extend(chip.uart_take());
        self.heard.listen(&send[begin..]);
        self.now = Tick(chip.ticks_since_reset());
        Ok(())
    }

    fn line_errors(&mut self, errors: u16) {
        if errors > 0 {
            self.chip.lock().uart_damage(errors);
        }
    }

    fn hear_fault_line(&mut self, high: bool) {
        self.chip.lock().set_input(Port::A, FAULT_LINE, Some(high));
    }

    fn lets_fault_line_rise(&self) -> bool {
        // An open drain: only a low level holds the transistor's gate down.
        self.chip.lock().pins().well == Drive::Low
    }

    fn state(&self) -> State {
        self.heard.state
    }

    fn path_ms(&self) -> u32 {
        // Known only after the board has reported it: see `take_path_times`.
        0
    }

    fn take_path_times(&mut self) -> Vec<(Tick, u32)> {
        self.heard.take_path_times()
    }

    fn path_times_behind(&self) -> usize {
        BEHIND_TICKS
    }

    fn now(&self) -> Tick {
        self.now
    }

    fn fault(&self) -> Option<FaultRecord> {
        self.heard.fault
    }

    fn torque_on(&self) -> bool {
        self.heard.torque_on
    }
}
