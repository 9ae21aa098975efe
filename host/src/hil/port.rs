//! A serial port that is read without waiting, or with a deadline.

use super::HilError;
use serialport::SerialPort;
use std::io::{ErrorKind, Read, Write};
use std::time::{Duration, Instant};

/// Longest single wait.
const GRAIN: Duration = Duration::from_millis(2);
/// A write that takes longer means that the other side is gone.
const WRITE_TIMEOUT: Duration = Duration::from_millis(500);

/// A serial port, by name and purpose.
pub(super) struct Port {
    port: Box<dyn SerialPort>,
    what: &'static str,
    name: String,
}

impl Port {
    /// Opens a port and discards the bytes that waited in it.
    pub(super) fn open(what: &'static str, name: &str, baud: u32) -> Result<Self, HilError> {
        let help = "`mcdpr ports` lists the ports; only one program can have a port";
        let fails = |error: serialport::Error| HilError::wire(what, name, error.description, help);
        let port = serialport::new(name, baud).timeout(GRAIN).open();
        let port = port.map_err(fails)?;
        port.clear(serialport::ClearBuffer::All).map_err(fails)?;
        Ok(Self::of(what, name, port))
    }

    /// This open port.
    pub(super) fn of(what: &'static str, name: &str, port: Box<dyn SerialPort>) -> Self {
        Self {
            port,
            what,
            name: name.to_owned(),
        }
    }

    pub(super) fn failed(&self, reason: impl ToString) -> HilError {
        let help = "check its plug and its supply, and that no other program uses it";
        HilError::wire(self.what, &self.name, reason, help)
    }

    pub(super) fn write(&mut self, bytes: &[u8]) -> Result<(), HilError> {
        let give_up = Instant::now() + WRITE_TIMEOUT;
        let mut rest = bytes;
        while !rest.is_empty() {
            match self.port.write(rest) {
                Ok(written) => rest = rest.get(written..).unwrap_or_default(),
                Err(error) if passes(error.kind()) && Instant::now() < give_up => {}
                Err(error) => return Err(self.failed(error)),
            }
        }
        Ok(())
    }

    /// Appends what has arrived. Waits for the first byte, for 2 ms at most, if `wait`.
    pub(super) fn read(&mut self, into: &mut Vec<u8>, wait: bool) -> Result<(), HilError> {
        if !wait {
            let ready = self.port.bytes_to_read();
            if ready.map_err(|error| self.failed(error.description))? == 0 {
                return Ok(());
            }
        }
        let mut buffer = [0; 1024];
        match self.port.read(&mut buffer) {
            Ok(count) => into.extend_from_slice(buffer.get(..count).unwrap_or_default()),
            Err(error) if passes(error.kind()) => {}
            Err(error) => return Err(self.failed(error)),
        }
        Ok(())
    }
}

fn passes(kind: ErrorKind) -> bool {
    matches!(
        kind,
        ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted
    )
}
