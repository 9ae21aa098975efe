//! A real serial port, or a pseudo-terminal that looks like one.

use super::{Link, LinkError};
use serialport::{ErrorKind, SerialPort, SerialPortType};
use std::io::{Read, Write};
use std::path::Path;
use std::time::{Duration, Instant};

/// Bit rate of the line to a board.
pub const BAUD: u32 = 921_600;

/// Longest single wait on the port: also the grain of time when nothing arrives.
pub(super) const MAX_WAIT: Duration = Duration::from_millis(2);
/// A write that takes longer means that the bridge is gone.
pub(super) const WRITE_TIMEOUT_US: u64 = 200_000;

/// A serial port with the machine's monotonic clock.
pub struct SerialLink {
    port: Box<dyn SerialPort>,
    opened: Instant,
    now_us: u64,
    scale: f64,
}

impl SerialLink {
    /// Opens a port at [`BAUD`], for this program alone, and discards the bytes that waited in it.
    ///
    /// # Errors
    /// [`LinkError::NoPort`], [`LinkError::Taken`], [`LinkError::Permission`],
    /// [`LinkError::Unusable`].
    pub fn open(name: &str) -> Result<Self, LinkError> {
        let port = serialport::new(name, BAUD).timeout(MAX_WAIT).open();
        let port = port.map_err(|error| explain(name, &error))?;
        // Bytes for an earlier host are useless to this one.
        port.clear(serialport::ClearBuffer::All)
            .map_err(|error| explain(name, &error))?;
        Ok(Self {
            port,
            opened: Instant::now(),
            now_us: 0,
            scale: 1.0,
        })
    }

    /// Counts time like a simulated robot that runs `scale` simulated seconds per second, over 0:
    /// its ticks are milliseconds of that time. A board has scale 1.
    #[must_use]
    pub const fn at_scale(mut self, scale: f64) -> Self {
        self.scale = scale;
        self
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "positive, and saturates"
    )]
    fn update(&mut self) -> u64 {
        // A clock that never runs backwards, also after a change of the scale.
        let elapsed = (self.opened.elapsed().as_secs_f64() * self.scale * 1e6) as u64;
        self.now_us = self.now_us.max(elapsed);
        self.now_us
    }
}

fn no_port(name: &str) -> LinkError {
    let ports = list_ports();
    let names: Vec<_> = ports.iter().map(|port| port.name.as_str()).collect();
    LinkError::NoPort {
        port: name.to_owned(),
        found: match names.as_slice() {
            [] => " (none)".to_owned(),
            names => format!(": {}", names.join(", ")),
        },
    }
}

pub(super) fn explain(name: &str, error: &serialport::Error) -> LinkError {
    let port = name.to_owned();
    match error.kind() {
        ErrorKind::Io(std::io::ErrorKind::NotFound) => no_port(name),
        // On Unix a port that another program holds gives this error.
        ErrorKind::NoDevice if Path::new(name).exists() => LinkError::Taken { port },
        ErrorKind::NoDevice => no_port(name),
        ErrorKind::Io(std::io::ErrorKind::PermissionDenied) => LinkError::Permission { port },
        _ => LinkError::Unusable {
            port,
            reason: error.description.clone(),
        },
    }
}

impl Link for SerialLink {
    fn goes_on(&self) -> bool {
        true
    }

    fn now_us(&self) -> u64 {
        self.now_us
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let give_up = self.update() + WRITE_TIMEOUT_US;
        let mut rest = bytes;
        while !rest.is_empty() {
            match self.port.write(rest) {
                Ok(written) => rest = rest.get(written..).unwrap_or_default(),
                Err(error) if may_retry(&error) && self.update() < give_up => {}
                Err(error) => return Err(broken(&error)),
            }
        }
        self.update();
        Ok(())
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        let mut buffer = [0; 512];
        loop {
            let now = self.update();
            let left_s = until_us.saturating_sub(now) as f64 * 1e-6 / self.scale;
            let left = Duration::from_secs_f64(left_s.min(1.0));
            // A timeout of 0 returns at once, and the loop would take a whole core.
            let wait = left.min(MAX_WAIT).max(Duration::from_millis(1));
            self.port
                .set_timeout(wait)
                .map_err(|error| LinkError::Broken {
                    reason: error.description,
                })?;
            match self.port.read(&mut buffer) {
                // A closed pseudo-terminal reads as an endless end of file.
                Ok(0) => {
                    return Err(LinkError::Broken {
                        reason: "the other end was closed".to_owned(),
                    });
                }
                Ok(used) => {
                    into.extend_from_slice(buffer.get(..used).unwrap_or_default());
                    return Ok(self.update());
                }
                Err(error) if may_retry(&error) => {}
                Err(error) => return Err(broken(&error)),
            }
            let now = self.update();
            if now >= until_us {
                return Ok(now);
            }
        }
    }
}

pub(super) fn may_retry(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), Interrupted | TimedOut | WouldBlock)
}

pub(super) fn broken(error: &std::io::Error) -> LinkError {
    LinkError::Broken {
        reason: error.to_string(),
    }
}

/// A serial port of this machine.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub(crate) struct PortInfo {
    /// What to pass to `--on`.
    pub name: String,
    /// What is plugged in there.
    pub description: String,
}

/// The serial ports that exist now, in the order of their names.
#[must_use]
pub(crate) fn list_ports() -> Vec<PortInfo> {
    let mut ports: Vec<_> = serialport::available_ports()
        .unwrap_or_default()
        .into_iter()
        .map(|port| PortInfo {
            description: match &port.port_type {
                SerialPortType::UsbPort(usb) => {
                    let words = [&usb.manufacturer, &usb.product, &usb.serial_number];
                    let words: Vec<_> = words.into_iter().flatten().cloned().collect();
                    format!("USB {:04x}:{:04x} {}", usb.vid, usb.pid, words.join(" "))
                }
                SerialPortType::BluetoothPort => "Bluetooth".to_owned(),
                SerialPortType::PciPort => "built in".to_owned(),
                SerialPortType::Unknown => "unknown".to_owned(),
            },
            name: port.port_name,
        })
        .collect();
    ports.sort_by(|a, b| a.name.cmp(&b.name));
    ports
}
