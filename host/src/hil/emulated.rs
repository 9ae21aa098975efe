//! The emulated chip in place of a real board, behind the same three wires: for a trial without
//! hardware, and for tests.

use super::port::Port;
use super::signals::{self, CHANNELS, Got, Sentence, Set, VERSION, input, output};
use super::{HilError, slcan};
use mcdpr_emulator::{CanFrame, CanWiring, Chip, Drive, Port as Pins, SentFrame, Stop};
use mcdpr_firmware::drives;
use serialport::{SerialPort, TTYPort};
use std::convert::Infallible;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Slice of the chip's time, us.
const SLICE_US: u32 = 50;
/// ADC channels of the tension sensors.
const TENSION: [u8; CHANNELS] = [4, 5, 8, 9];
/// How often the wires are looked at in real time, us of the chip.
const LOOK_US: u64 = 250;
/// Where the chip is later than this, its time stands still, us.
const LATE_US: u64 = 20_000;

/// One wire: this program's side, the other side's name, and that side, kept open so that the wire
/// outlives the programs that use it.
struct Wire {
    port: Port,
    name: String,
    _other: TTYPort,
}

impl Wire {
    fn new(what: &'static str) -> Result<Self, HilError> {
        let help = "a pseudo-terminal is needed";
        let fails = |error: serialport::Error| HilError::wire(what, "pty", error.description, help);
        let (mut ours, other) = TTYPort::pair().map_err(fails)?;
        ours.set_timeout(Duration::from_millis(2)).map_err(fails)?;
        let name = other.name().unwrap_or_default();
        Ok(Self {
            port: Port::of(what, &name, Box::new(ours)),
            name,
            _other: other,
        })
    }
}

/// The chip with its three wires.
pub(crate) struct Bench {
    /// The firmware's file (ELF).
    firmware: Arc<[u8]>,
    chip: Chip,
    line: Wire,
    can: Wire,
    signals: Wire,
    /// Bytes and frames since the greeting.
    line_received: u32,
    line_sent: u32,
    can_received: u32,
    can_sent: u32,
    from_line: Vec<u8>,
    from_can: Vec<u8>,
    from_signals: Vec<u8>,
    wiring: CanWiring,
    channel_open: bool,
    /// The present inputs, and the encoders' way to them.
    set: Set,
    encoders: [i64; CHANNELS],
    powered: bool,
}

impl Bench {
    /// A chip with this firmware file (ELF) that just got power.
    ///
    /// # Errors
    /// There are no pseudo-terminals, or the file is not firmware for this chip.
    pub(crate) fn new(firmware: Arc<[u8]>) -> Result<Self, HilError> {
        Ok(Self {
            chip: start(&firmware)?,
            firmware,
            line: Wire::new("board")?,
            can: Wire::new("CAN")?,
            signals: Wire::new("signal board")?,
            line_received: 0,
            line_sent: 0,
            can_received: 0,
            can_sent: 0,
            from_line: Vec::new(),
            from_can: Vec::new(),
            from_signals: Vec::new(),
            wiring: CanWiring {
                bitrate: 1_000_000,
                others: false,
                shorted: false,
            },
            channel_open: false,
            set: Set {
                inputs: input::SUPPLY,
                ..Set::default()
            },
            encoders: [0; CHANNELS],
            powered: true,
        })
    }

    /// Value of `--on` for the program on the other side.
    pub(crate) fn names(&self) -> String {
        format!(
            "hil:{},{},{}",
            self.line.name, self.can.name, self.signals.name
        )
    }

    /// Serves the wires until the program ends. The chip's time passes only as the other side says, or, with a
    /// scale, by itself.
    ///
    /// # Errors
    /// A wire fails, or the firmware does something that is invalid on the chip.
    pub(crate) fn serve(&mut self, time_scale: Option<f64>) -> Result<Infallible, HilError> {
        let mut begun = Instant::now();
        let mut reached_us: u64 = 0;
        loop {
            let stepped = time_scale.is_none();
            self.signals.port.read(&mut self.from_signals, stepped)?;
            for text in signals::take_lines(&mut self.from_signals) {
                match Sentence::parse(&text) {
                    Some(Sentence::Hello) => self.greet(stepped)?,
                    Some(Sentence::Set(set)) => self.take(set, stepped)?,
                    _ => {}
                }
            }
            let Some(scale) = time_scale else { continue };
            let due_us = (begun.elapsed().as_secs_f64() * 1e6 * scale) as u64;
            if due_us > reached_us + LATE_US {
                // This computer was busy: the chip stands still meanwhile.
                (begun, reached_us) = (Instant::now(), 0);
                continue;
            }
            while reached_us + LOOK_US <= due_us {
                self.hear(false)?;
                self.run(LOOK_US as u32)?;
                reached_us += LOOK_US;
            }
            std::thread::sleep(Duration::from_micros(200));
        }
    }

    fn greet(&mut self, stepped: bool) -> Result<(), HilError> {
        // Off and on, so that two trials of one kind are the same.
        self.chip = start(&self.firmware)?;
        for wire in [&mut self.line, &mut self.can] {
            wire.port.read(&mut Vec::new(), false)?;
        }
        self.from_line.clear();
        self.from_can.clear();
        (self.line_received, self.line_sent) = (0, 0);
        (self.can_received, self.can_sent) = (0, 0);
        self.channel_open = false;
        self.encoders = [0; CHANNELS];
        self.powered = true;
        self.set = Set {
            inputs: input::SUPPLY,
            ..Set::default()
        };
        let here = Sentence::Here {
            version: VERSION,
            stepped,
        };
        self.signals.port.write(here.to_text().as_bytes())
    }

    /// Takes over inputs. Where time is stepped, runs until they are reached.
    fn take(&mut self, set: Set, stepped: bool) -> Result<(), HilError> {
        self.set = set;
        for (channel, sum) in TENSION.into_iter().zip(set.tensions) {
            self.chip.set_adc_sixteenths(channel, sum);
        }
        let is = |bit: u8| set.inputs & bit != 0;
        self.chip.set_input(Pins::B, 5, Some(is(input::E_STOP)));
        self.chip
            .set_input(Pins::A, 3, Some(is(input::GRIPPER_SWITCH)));
        self.chip.set_supply_low(is(input::SUPPLY_LOW));
        self.wiring.shorted = is(input::CAN_SHORTED);
        if is(input::SUPPLY) && !self.powered {
            self.chip.power_on();
            self.encoders = set.encoders;
            for (timer, position) in (1..).zip(self.encoders) {
                self.chip.set_encoder(timer, position);
            }
        }
        self.powered = is(input::SUPPLY);
        if stepped {
            self.hear(true)?;
            self.run(set.step_us)?;
        }
        let pins = self.chip.pins();
        let brakes = (0..).zip(pins.brakes);
        let mut outputs = brakes.fold(0, |all, (bit, drive)| {
            all | u8::from(drive == Drive::High) << bit
        });
        if pins.gripper == Drive::High {
            outputs |= output::GRIPPER;
        }
        if pins.drive_enable == Drive::High {
            outputs |= output::DRIVE_ENABLE;
        }
        if !self.powered {
            outputs = 0;
        }
        let got = Got {
            sequence: set.sequence,
            outputs,
            line_bytes: self.line_sent,
            can_frames: self.can_sent,
        };
        let text = Sentence::Got(got).to_text();
        self.signals.port.write(text.as_bytes())
    }

    /// Takes what has arrived on line and bus; all that was announced, if `complete`.
    fn hear(&mut self, complete: bool) -> Result<(), HilError> {
        let begun = Instant::now();
        loop {
            let bytes_due = complete && self.line_received != self.set.line_bytes;
            let count = self.from_line.len();
            self.line.port.read(&mut self.from_line, bytes_due)?;
            let came = (self.from_line.len() - count) as u32;
            self.line_received = self.line_received.wrapping_add(came);
            let frames_due = complete && self.can_received != self.set.can_frames;
            self.can.port.read(&mut self.from_can, frames_due)?;
            for text in signals::take_lines(&mut self.from_can) {
                self.adapter(&text);
            }
            let all = self.line_received == self.set.line_bytes
                && self.can_received == self.set.can_frames;
            if !complete || all {
                break;
            }
            if begun.elapsed() > Duration::from_secs(10) {
                return Err(self.signals.port.failed("announced bytes did not come"));
            }
        }
        if !self.from_line.is_empty() && self.powered {
            if self.set.inputs & input::LINE_DISTURBED != 0 {
                let bytes = u16::try_from(self.from_line.len()).unwrap_or(u16::MAX);
                self.chip.uart_damage(bytes);
            }
            self.chip.uart_send(&self.from_line);
        }
        self.from_line.clear();
        self.wiring.others = self.channel_open;
        self.chip.set_can_wiring(self.wiring);
        Ok(())
    }

    /// A command to the emulated adapter.
    fn adapter(&mut self, text: &str) {
        if let Some(frame) = slcan::parse(text) {
            self.can_received = self.can_received.wrapping_add(1);
            if self.channel_open {
                let bytes = frame.data.get(..frame.len.into()).unwrap_or(&frame.data);
                let now_us = self.chip.now_us();
                self.chip
                    .can_send(now_us, CanFrame::standard(frame.id, bytes));
            }
        } else if let Some(rate) = slcan::speed_of(text) {
            self.wiring.bitrate = rate;
        } else if text == slcan::OPEN.trim_end() {
            self.channel_open = true;
        } else if text == slcan::CLOSE.trim_end() {
            self.channel_open = false;
        }
    }

    /// Lets time pass, with the encoders on their way to where they shall be.
    fn run(&mut self, us: u32) -> Result<(), HilError> {
        let slices = us.div_ceil(SLICE_US);
        for left in (1..=slices).rev() {
            if !self.powered {
                self.chip.skip_us(SLICE_US.into());
                continue;
            }
            for (index, position) in self.encoders.iter_mut().enumerate() {
                *position += (self.set.encoders[index] - *position) / i64::from(left);
                self.chip.set_encoder(index + 1, *position);
            }
            match self.chip.run_us(SLICE_US.into()) {
                Ok(()) => {}
                Err(Stop::Reset { by, .. }) => self.chip.restart(by),
                Err(stop) => return Err(self.line.port.failed(format!("emulated chip: {stop}"))),
            }
        }
        let bytes = self.chip.uart_take();
        self.line_sent = self.line_sent.wrapping_add(bytes.len() as u32);
        self.line.port.write(&bytes)?;
        for SentFrame { frame, .. } in self.chip.can_take() {
            if frame.extended || !self.channel_open {
                continue;
            }
            let frame = drives::CanFrame {
                id: frame.id as u16,
                len: frame.length,
                data: frame.data,
            };
            self.can_sent = self.can_sent.wrapping_add(1);
            let text = slcan::to_text(&frame);
            self.can.port.write(text.as_bytes())?;
        }
        Ok(())
    }
}

fn start(firmware: &[u8]) -> Result<Chip, HilError> {
    let mut chip = Chip::load(firmware).map_err(|error| {
        HilError::wire(
            "emulated chip",
            "",
            error,
            "`cargo fw` builds the board's file",
        )
    })?;
    // Faults go to the firmware's handler, as on the board.
    chip.deliver_faults(true);
    Ok(chip)
}
