//! Frames that a client sends, and the search for a board.

use crate::link::Link;
use crate::link::error::ClientError;
use crate::link::receiver::{Message, Receiver};
use mcdpr_protocol::frame::{MAX_FRAME, encode_bytes, encode_frame};
use mcdpr_protocol::{Channel, Command, Hello, Request, SequenceNumber, SessionId};

/// Time for a board to say hello, µs.
const HELLO_US: u64 = 3_000_000;

fn frame(channel: Channel, body: &[u8]) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let used = encode_bytes(channel, body, &mut out).unwrap_or(0);
    out.get(..used).unwrap_or_default().to_vec()
}

/// The frame that asks a board who it is, after a delimiter that ends any frame sent in part.
pub(super) fn hello_query() -> Vec<u8> {
    let mut bytes = vec![0];
    bytes.extend(frame(Channel::HelloQuery, &[]));
    bytes
}

/// A request in its frame.
pub(super) fn command(session: SessionId, sequence: SequenceNumber, request: &Request) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let command = Command {
        session,
        sequence,
        request: request.clone(),
    };
    // Every message fits a frame: the protocol crate asserts it at compile time.
    let used = encode_frame(Channel::Command, &command, &mut out).unwrap_or(0);
    out.get(..used).unwrap_or_default().to_vec()
}

/// A board that is starting, or a line with noise on it, may miss the first requests.
pub(super) fn find(link: &mut impl Link, receiver: &mut Receiver) -> Result<Hello, ClientError> {
    let give_up = link.now_us() + HELLO_US;
    // A delimiter first: it ends any frame that was sent in part before.
    link.send(&[0])?;
    while link.now_us() < give_up {
        link.send(&frame(Channel::HelloQuery, &[]))?;
        // A starting board misses the first questions: thirty of them fit into the wait.
        let ask_again = link.now_us() + 100_000;
        while link.now_us() < ask_again {
            for message in receiver.take(link, ask_again)? {
                if let Message::Hello(hello) = message {
                    return Ok(hello);
                }
            }
        }
    }
    Err(ClientError::Silent)
}

/// The lowest 32 bits of a time.
pub(super) fn wrapping_us(time_us: u64) -> u32 {
    u32::try_from(time_us & u64::from(u32::MAX)).unwrap_or(0)
}
