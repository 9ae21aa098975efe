//! Finds stops among the bytes of a line, without decoding the rest.
//!
//! A stop must not wait behind other requests (K10). A board can execute one request per tick and a
//! line brings more than eight, so a reader of whole frames falls behind on a full line.
//! [`StopFinder`] checks every byte as it arrives, keeps the few that a stop can have, and returns
//! the stop at its frame's end.

use crate::frame::{Channel, decode_frame};
use crate::message::{STOP, StopKind, stop_in};

/// Most bytes of a stop's frame between two delimiters: one of COBS, the channel, the session and
/// its number (five bytes and three, as postcard writes 32 and 16 bits), the request, its kind, and
/// the checksum.
// 16 bytes.
const MOST: usize = 1 + 1 + 5 + 3 + 1 + 1 + 4;
/// Fewest: session and number may take a byte each.
const LEAST: usize = 1 + 1 + 1 + 1 + 1 + 1 + 4;

/// Finds stops in a stream of bytes.
///
/// ```
/// use mcdpr_protocol::frame::{MAX_FRAME, encode_frame};
/// use mcdpr_protocol::stop::StopFinder;
/// use mcdpr_protocol::{Channel, Command, Request, SequenceNumber, SessionId, StopKind};
///
/// let (session, sequence) = (SessionId(7), SequenceNumber(1));
/// let request = Request::Stop(StopKind::Hold);
/// let command = Command { session, sequence, request };
/// let mut frame = [0; MAX_FRAME];
/// let used = encode_frame(Channel::Command, &command, &mut frame).unwrap();
/// let mut finder = StopFinder::default();
/// let found: Vec<_> = frame[..used].iter().filter_map(|&byte| finder.push(byte)).collect();
/// assert_eq!(found, [StopKind::Hold]);
/// ```
#[derive(Debug, Default, Clone)]
pub struct StopFinder {
    frame: [u8; MOST],
    /// Bytes since the last delimiter; more than [`MOST`] count as one more.
    used: usize,
}

impl StopFinder {
    /// Takes the line's next byte; returns the stop whose frame ends with it.
    #[inline]
    pub fn push(&mut self, byte: u8) -> Option<StopKind> {
        if byte != 0 {
            if let Some(slot) = self.frame.get_mut(self.used) {
                *slot = byte;
                self.used += 1;
            } else {
                // Stays there: a long frame of any length is rejected at its end.
                self.used = MOST + 1;
            }
            return None;
        }
        // Each delimiter begins anew, whatever came before: noise costs one frame at most.
        let used = core::mem::take(&mut self.used);
        if (LEAST..=MOST).contains(&used) {
            self.finish(used)
        } else {
            None
        }
    }

    /// Other frames are rejected before their checksum is computed: a full line brings eight short
    /// frames per tick.
    #[inline(never)]
    fn finish(&mut self, used: usize) -> Option<StopKind> {
        let coded = self.frame.get(..used)?;
        if !asks_to_stop(coded)? {
            return None;
        }
        // The checksum counts here, too: noise must not stop a robot.
        match decode_frame(self.frame.get_mut(..used)?) {
            Ok((Channel::Command, body)) => stop_in(body),
            _ => None,
        }
    }
}

/// Whether these bytes of a frame, still in COBS, have a stop's channel and request; `None` if they
/// are too few.
fn asks_to_stop(coded: &[u8]) -> Option<bool> {
    let mut bytes = coded.iter();
    // In a frame under 254 bytes every byte that a code points to represents a zero.
    let mut left = *bytes.next()?;
    let mut next = || {
        left -= 1;
        let byte = *bytes.next()?;
        if left == 0 {
            left = byte;
            return Some(0);
        }
        Some(byte)
    };
    if next()? != Channel::Command as u8 {
        return Some(false);
    }
    // Session and number end with a byte under 128.
    for _ in 0..2 {
        // Varints of postcard: bit 7 says that another byte follows.
        while next()? >= 0x80 {}
    }
    Some(u32::from(next()?) == STOP)
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use crate::frame::{MAX_FRAME, encode_frame};
    use crate::message::{Command, Request, SequenceNumber, SessionId};
    use std::vec::Vec;

    fn frame(session: u32, sequence: u16, request: Request) -> Vec<u8> {
        let command = Command {
            session: SessionId(session),
            sequence: SequenceNumber(sequence),
            request,
        };
        let mut out = [0; MAX_FRAME];
        let used = encode_frame(Channel::Command, &command, &mut out).unwrap();
        out[..used].to_vec()
    }

    fn found(bytes: &[u8]) -> Vec<StopKind> {
        let mut finder = StopFinder::default();
        let bytes = bytes.iter();
        bytes.filter_map(|&byte| finder.push(byte)).collect()
    }

    const KINDS: [StopKind; 3] = [StopKind::Hold, StopKind::Stop, StopKind::Emergency];

    #[test]
    fn every_stop_is_found_whatever_its_session_and_number() {
        for session in [0, 1, 127, 128, 0x1234, 0x00FF_FFFF, u32::MAX] {
            for sequence in [0, 1, 127, 128, 0x3FFF, 0x4000, u16::MAX] {
                for kind in KINDS {
                    let bytes = frame(session, sequence, Request::Stop(kind));
                    assert!((LEAST..=MOST).contains(&(bytes.len() - 1)), "{bytes:?}");
                    assert_eq!(found(&bytes), [kind], "{session} {sequence}");
                }
            }
        }
    }

    #[test]
    fn the_smallest_and_the_largest_stop_have_the_sizes_that_are_looked_at() {
        let stop = Request::Stop(StopKind::Stop);
        assert_eq!(frame(0, 0, stop.clone()).len() - 1, LEAST);
        assert_eq!(frame(u32::MAX, u16::MAX, stop).len() - 1, MOST);
    }

    #[test]
    fn no_other_request_and_no_damaged_stop_is_taken_for_a_stop() {
        for session in [0, 5, 300, u32::MAX] {
            for request in [
                Request::Info,
                Request::Status,
                Request::Open,
                Request::Close,
                Request::Heartbeat { host_time_us: 0 },
                Request::Heartbeat { host_time_us: 5 },
                Request::Start,
                Request::Resume,
                Request::Disarm,
                Request::Winch { cable: 1 },
                Request::Gripper { closed: true },
                Request::Samples { enabled: true },
            ] {
                let bytes = frame(session, 9, request.clone());
                assert_eq!(found(&bytes), [], "{request:?}");
            }
        }
        let bytes = frame(77, 9, Request::Stop(StopKind::Stop));
        for at in 0..bytes.len() - 1 {
            for bit in 0..8 {
                let mut damaged = bytes.clone();
                damaged[at] ^= 1 << bit;
                assert_eq!(found(&damaged), [], "byte {at}, bit {bit}");
            }
        }
        // Bytes that a longer frame has in its middle do not make its ends a stop.
        let whole = frame(u32::MAX, u16::MAX, Request::Stop(StopKind::Stop));
        for extra in 1..40 {
            for at in 1..whole.len() - 1 {
                let (head, tail) = whole.split_at(at);
                let longer = [head, &[7; 40][..extra], tail].concat();
                assert_eq!(found(&longer), [], "{extra} at {at}");
            }
        }
        // A byte too many, and one too few.
        assert_eq!(found(&[&[3][..], &bytes].concat()), []);
        assert_eq!(found(&bytes[1..]), []);
    }

    #[test]
    fn a_stop_is_found_behind_a_delimiter_whatever_came_before() {
        let stop = frame(1, 2, Request::Stop(StopKind::Emergency));
        for before in [0, 1, LEAST, MOST - 1, MOST, MOST + 1, 300] {
            let garbage: Vec<u8> = (1..=255).cycle().take(before).collect();
            let bytes = [&garbage[..], &[0], &stop].concat();
            assert_eq!(found(&bytes), [StopKind::Emergency], "{before}");
        }
    }
}
