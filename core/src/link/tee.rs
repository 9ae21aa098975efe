//! Keeps the traffic of a line, both ways, with its times.

use super::{Link, LinkError};

/// Direction of the bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// From host to board.
    ToBoard,
    /// From board to host.
    ToHost,
}

/// Bytes that went over the line at one time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RawFrame {
    /// The link's time, µs.
    pub time_us: u64,
    /// Direction.
    pub direction: Direction,
    /// The bytes; empty where a wait ended without any (the clock was read all the same).
    pub bytes: Vec<u8>,
}

/// A line that passes its traffic to `sink`, including waits that brought nothing: a replay needs
/// only the sequence of calls and their times.
pub struct Tee<L, S> {
    inner: L,
    sink: S,
}

impl<L: Link, S: FnMut(RawFrame)> Tee<L, S> {
    /// Shows the traffic of `inner` to `sink`.
    pub const fn new(inner: L, sink: S) -> Self {
        Self { inner, sink }
    }
}

impl<L: Link, S: FnMut(RawFrame)> Link for Tee<L, S> {
    fn goes_on(&self) -> bool {
        self.inner.goes_on()
    }

    fn now_us(&self) -> u64 {
        self.inner.now_us()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.inner.send(bytes)?;
        (self.sink)(RawFrame {
            time_us: self.inner.now_us(),
            direction: Direction::ToBoard,
            bytes: bytes.to_vec(),
        });
        Ok(())
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        let before = into.len();
        let time_us = self.inner.receive(until_us, into)?;
        (self.sink)(RawFrame {
            time_us,
            direction: Direction::ToHost,
            bytes: into.get(before..).unwrap_or_default().to_vec(),
        });
        Ok(time_us)
    }
}
