//! Requests besides the sequence without waiting for them: for a caller that speaks to several
//! boards at once and may wait for none of them alone.

use super::{Client, GIVE_UP_US, HEARTBEAT_US, RETRY_US, wire};
use crate::faults::request_name;
use crate::link::Link;
use crate::link::error::ClientError;
use mcdpr_protocol::{Answer, Hello, Reject, Reply, Request, SequenceNumber};

/// Distance of the numbers of asides from those of the sequence.
const FAR: u16 = 0x4000;
/// Heartbeats are spread over a tick of the board in steps of this, µs.
const SPREAD_US: u64 = 377;
/// A tick, µs.
const TICK_US: u64 = 1000;

/// A request besides the sequence that waits for its answer.
pub(super) struct Aside {
    sequence: SequenceNumber,
    request: Request,
    sent_us: u64,
    first_us: u64,
}

impl<L: Link> Client<L> {
    /// Sends a request that is not sequenced; its outcome comes by [`Client::next_reply`].
    ///
    /// # Errors
    /// The link's.
    pub(crate) fn post(&mut self, request: Request) -> Result<(), ClientError> {
        // Opening sets the first number of the sequence.
        let sequence = if request == Request::Open {
            let first = self.next;
            self.next = first.next();
            first
        } else {
            self.number_beside()
        };
        let now = self.link.now_us();
        self.transmit(sequence, &request)?;
        self.asides.push(Aside {
            sequence,
            request,
            sent_us: now,
            first_us: now,
        });
        Ok(())
    }

    /// A number for a request besides the sequence, far from those of the window. Each request has its own: a board that
    /// answers late is asked again, and its second answer is none to the next request.
    pub(super) const fn number_beside(&mut self) -> SequenceNumber {
        self.aside_count = (self.aside_count + 1) % FAR;
        SequenceNumber(self.next.0.wrapping_add(FAR).wrapping_add(self.aside_count))
    }

    /// The outcome of the next answered request of [`Client::post`].
    pub(crate) fn next_reply(&mut self) -> Option<(Request, Result<Reply, Reject>)> {
        self.replies.pop_front()
    }

    /// The board is claimed: heartbeats begin.
    pub(crate) fn claimed(&mut self) {
        // The first heartbeat is due at once: a board that hears none stops after 100 ms.
        self.heartbeat_us = Some(0);
        self.heard_us = self.link.now_us();
    }

    /// Sends heartbeats at varying times within the board's tick, so that their answers show when
    /// a tick begins.
    pub(crate) const fn spread_heartbeats(&mut self) {
        self.spread = Some(0);
    }

    /// Time from a heartbeat to the next, µs.
    pub(super) fn heartbeat_pause_us(&self) -> u64 {
        let more = self.spread.map_or(0, |count| count * SPREAD_US % TICK_US);
        HEARTBEAT_US + more
    }

    /// Handles what has arrived and sends what is due, without waiting.
    ///
    /// # Errors
    /// The link's, or [`ClientError::Lost`].
    pub(crate) fn work(&mut self) -> Result<(), ClientError> {
        let now = self.link.now_us();
        for message in self.receiver.take(&mut self.link, now)? {
            self.accept(message)?;
        }
        self.upkeep()
    }

    /// When [`Client::work`] has something to send next, link time, µs.
    pub(crate) fn due_us(&self) -> u64 {
        self.next_due_us()
    }

    /// The line.
    pub(crate) const fn link_mut(&mut self) -> &mut L {
        &mut self.link
    }

    /// Replaces what the board is known to be.
    pub(crate) fn set_info(&mut self, info: mcdpr_protocol::Info) {
        self.info = info;
    }

    /// When the last answer to a heartbeat arrived, link time, µs.
    pub(crate) const fn heard_us(&self) -> u64 {
        self.heard_us
    }

    pub(super) fn aside_due_us(&self) -> u64 {
        let due = self.asides.iter().map(|aside| aside.sent_us + RETRY_US);
        due.min().unwrap_or(u64::MAX)
    }

    pub(super) fn ask_again(&mut self, now: u64) -> Result<(), ClientError> {
        for index in 0..self.asides.len() {
            let Some(aside) = self.asides.get_mut(index) else {
                break;
            };
            if now >= aside.first_us + GIVE_UP_US {
                return Err(ClientError::Lost {
                    waiting: request_name(&aside.request),
                });
            }
            if now >= aside.sent_us + RETRY_US {
                aside.sent_us = now;
                let bytes = wire::command(self.session, aside.sequence, &aside.request);
                self.link.send(&bytes)?;
            }
        }
        Ok(())
    }

    /// Keeps an answer to an aside; another answer is given back.
    pub(super) fn take_aside(&mut self, answer: Answer) -> Option<Answer> {
        let place = self
            .asides
            .iter()
            .position(|aside| aside.sequence == answer.sequence);
        let Some(place) = place else {
            return Some(answer);
        };
        let aside = self.asides.remove(place);
        self.replies.push_back((aside.request, answer.result));
        None
    }
}

/// The frame that asks a board who it is.
pub(crate) fn hello_query() -> Vec<u8> {
    wire::hello_query()
}

/// Reads the hello in what a board sent, if there is one.
pub(crate) fn hello_in(bytes: &[u8]) -> Option<Hello> {
    let mut deframer = mcdpr_protocol::Deframer::new();
    let mut found = None;
    for &byte in bytes {
        if let Some(Ok((mcdpr_protocol::Channel::Hello, body))) = deframer.push(byte) {
            found = Hello::from_bytes(body).or(found);
        }
    }
    found
}
