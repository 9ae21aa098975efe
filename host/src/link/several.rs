//! Serial ports of several boards with one clock.

use super::serial::{BAUD, MAX_WAIT, WRITE_TIMEOUT_US, broken, explain, may_retry};
use super::{Link, LinkError, Note, SerialLink};
use mcdpr_core::boards::{Boards, Lines};
use serialport::SerialPort;
use std::io::{Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

/// What a port's thread has read, and when.
struct Heard {
    line: usize,
    at: Instant,
    bytes: Result<Vec<u8>, LinkError>,
}

/// The ports of several boards. A thread per port waits for bytes and notes when they came, so that
/// no port waits for another.
pub(crate) struct SerialLines {
    ports: Vec<Box<dyn SerialPort>>,
    names: Vec<String>,
    opened: Instant,
    now_us: u64,
    scale: f64,
    heard: Receiver<Heard>,
    quit: Arc<AtomicBool>,
}

impl SerialLines {
    /// Opens these ports for this program alone, and discards the bytes that waited in them. Time is
    /// counted as [`SerialLink::at_scale`] says.
    ///
    /// # Errors
    /// As [`SerialLink::open`], of the first port that does not open.
    pub fn open(names: &[&str], scale: f64) -> Result<Self, LinkError> {
        let opened = Instant::now();
        let quit = Arc::new(AtomicBool::new(false));
        let (say, heard) = channel();
        let mut ports = Vec::new();
        for (line, name) in names.iter().enumerate() {
            let port = serialport::new(*name, BAUD).timeout(MAX_WAIT).open();
            let port = port.map_err(|error| explain(name, &error))?;
            port.clear(serialport::ClearBuffer::All)
                .map_err(|error| explain(name, &error))?;
            let reader = port.try_clone().map_err(|error| explain(name, &error))?;
            let (say, quit) = (say.clone(), Arc::clone(&quit));
            std::thread::spawn(move || read(reader, line, &say, &quit));
            ports.push(port);
        }
        Ok(Self {
            ports,
            names: names.iter().map(|&name| name.to_owned()).collect(),
            opened,
            now_us: 0,
            scale,
            heard,
            quit,
        })
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "positive, and saturates"
    )]
    fn at_us(&self, at: Instant) -> u64 {
        (at.duration_since(self.opened).as_secs_f64() * self.scale * 1e6) as u64
    }

    fn update(&mut self) -> u64 {
        self.now_us = self.now_us.max(self.at_us(Instant::now()));
        self.now_us
    }

    fn take(&mut self, heard: Heard, into: &mut [Vec<u8>]) -> Result<(), LinkError> {
        self.now_us = self.now_us.max(self.at_us(heard.at));
        let bytes = heard.bytes?;
        if let Some(into) = into.get_mut(heard.line) {
            into.extend(bytes);
        }
        Ok(())
    }
}

impl Drop for SerialLines {
    fn drop(&mut self) {
        self.quit.store(true, Ordering::Relaxed);
    }
}

/// Reads a port until the set is dropped or the port is gone.
fn read(mut port: Box<dyn SerialPort>, line: usize, say: &Sender<Heard>, quit: &AtomicBool) {
    let mut buffer = [0; 512];
    while !quit.load(Ordering::Relaxed) {
        let bytes = match port.read(&mut buffer) {
            // A closed pseudo-terminal reads as an endless end of file.
            Ok(0) => Err(LinkError::Broken {
                reason: "the other end was closed".to_owned(),
            }),
            Ok(used) => Ok(buffer.get(..used).unwrap_or_default().to_vec()),
            Err(error) if may_retry(&error) => continue,
            Err(error) => Err(broken(&error)),
        };
        let ends = bytes.is_err();
        let at = Instant::now();
        if say.send(Heard { line, at, bytes }).is_err() || ends {
            return;
        }
    }
}

impl Lines for SerialLines {
    fn count(&self) -> usize {
        self.ports.len()
    }

    fn now_us(&self) -> u64 {
        self.now_us
    }

    fn send(&mut self, line: usize, bytes: &[u8]) -> Result<(), LinkError> {
        let give_up = self.update() + WRITE_TIMEOUT_US;
        let mut rest = bytes;
        while !rest.is_empty() {
            let Some(port) = self.ports.get_mut(line) else {
                break;
            };
            match port.write(rest) {
                Ok(written) => rest = rest.get(written..).unwrap_or_default(),
                Err(error) if may_retry(&error) && self.update() < give_up => {}
                Err(error) => return Err(broken(&error)),
            }
        }
        self.update();
        Ok(())
    }

    fn receive(&mut self, until_us: u64, into: &mut [Vec<u8>]) -> Result<u64, LinkError> {
        let left_s = until_us.saturating_sub(self.update()) as f64 * 1e-6 / self.scale;
        let wait = Duration::from_secs_f64(left_s.min(1.0));
        match self.heard.recv_timeout(wait) {
            Ok(heard) => {
                self.take(heard, into)?;
                // All that waits: a line that is read later must not look silent.
                while let Ok(heard) = self.heard.try_recv() {
                    self.take(heard, into)?;
                }
            }
            Err(RecvTimeoutError::Timeout) => {
                self.update();
            }
            Err(RecvTimeoutError::Disconnected) => {
                return Err(LinkError::Broken {
                    reason: "no port is open any more".to_owned(),
                });
            }
        }
        Ok(self.now_us)
    }

    fn name(&self, line: usize) -> String {
        self.names.get(line).cloned().unwrap_or_default()
    }

    fn goes_on(&self) -> bool {
        true
    }
}

/// The line of `--on`: one port, or those of all boards of a robot.
pub(crate) enum PortLink {
    /// One board.
    One(SerialLink),
    /// Several boards as one.
    Several(Box<Boards<SerialLines>>),
}

impl Link for PortLink {
    fn now_us(&self) -> u64 {
        match self {
            Self::One(link) => link.now_us(),
            Self::Several(link) => link.now_us(),
        }
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        match self {
            Self::One(link) => link.send(bytes),
            Self::Several(link) => link.send(bytes),
        }
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        match self {
            Self::One(link) => link.receive(until_us, into),
            Self::Several(link) => link.receive(until_us, into),
        }
    }

    fn note(&mut self, note: Note<'_>) {
        match self {
            Self::One(link) => link.note(note),
            Self::Several(link) => link.note(note),
        }
    }

    fn goes_on(&self) -> bool {
        true
    }
}
