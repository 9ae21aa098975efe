//! Decodes a board's bytes into messages.

use super::client::Event;
use super::{Link, LinkError};
use mcdpr_protocol::{Answer, Channel, Deframer, Hello, message};

/// Turns bytes into messages of the board.
#[derive(Default)]
pub(super) struct Receiver {
    deframer: Deframer,
    bytes: Vec<u8>,
    /// Number of damaged frames.
    pub frames_bad: u64,
}

/// One message of the board.
pub(super) enum Message {
    Hello(Hello),
    Answer(Answer),
    Event(Event),
}

impl Receiver {
    /// Reads what arrives until then, link time, µs.
    ///
    /// # Errors
    /// The line is gone.
    pub fn take(&mut self, link: &mut impl Link, until_us: u64) -> Result<Vec<Message>, LinkError> {
        self.bytes.clear();
        link.receive(until_us, &mut self.bytes)?;
        let mut messages = Vec::new();
        for &byte in &self.bytes {
            let Some(frame) = self.deframer.push(byte) else {
                continue;
            };
            let message = frame.ok().and_then(|(channel, body)| match channel {
                Channel::Hello => Hello::from_bytes(body).map(Message::Hello),
                Channel::Answer => message::decode(body).map(Message::Answer),
                Channel::Samples => message::decode(body)
                    .map(Event::Samples)
                    .map(Message::Event),
                Channel::Status => message::decode(body).map(Event::Status).map(Message::Event),
                // Only hosts send these: on a line that echoes they count as damaged.
                Channel::HelloQuery | Channel::Command => None,
            });
            match message {
                Some(message) => messages.push(message),
                None => self.frames_bad += 1,
            }
        }
        Ok(messages)
    }
}
