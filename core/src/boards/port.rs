//! The line of one board among several: bytes that wait for the client and for the line.

use crate::link::{Link, LinkError};

/// One board's bytes. It never waits: the set of lines does.
#[derive(Debug, Default)]
pub(super) struct Port {
    /// Time of the last call, µs.
    pub now_us: u64,
    /// Received and not read.
    pub inbox: Vec<u8>,
    /// To be sent.
    pub outbox: Vec<u8>,
}

impl Link for Port {
    fn now_us(&self) -> u64 {
        self.now_us
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.outbox.extend_from_slice(bytes);
        Ok(())
    }

    fn receive(&mut self, _until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        into.append(&mut self.inbox);
        Ok(self.now_us)
    }
}
