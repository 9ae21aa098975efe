//! What keeps a connection alive: heartbeats, requests sent again, and what answers mean.

use super::{ARM_US, Beat, Client, GIVE_UP_US, HEARTBEAT_US, Pending, RETRY_US, wire};
use crate::faults::request_name;
use crate::link::clock::BoardClock;
use crate::link::error::ClientError;
use crate::link::receiver::Message;
use crate::link::{Event, Link, LinkError};
use mcdpr_protocol::{Answer, Reject, Reply, Request, SequenceNumber};

/// A loop that has not run for this long was suspended, µs.
/// By then the board has held for 400 ms.
const SLEPT_US: u64 = 500_000;
/// Frames are sent again at most this often after complaints, µs.
const RESEND_PAUSE_US: u64 = 3_000;

impl<L: Link> Client<L> {
    pub(super) fn next_due_us(&self) -> u64 {
        let beat = self
            .heartbeat_us
            .map_or(u64::MAX, |last| last + self.heartbeat_pause_us());
        let aside = self.aside_due_us();
        let waiting = self.pending.iter().find(|pending| pending.result.is_none());
        let retry = waiting.map_or(u64::MAX, |pending| pending.sent_us + RETRY_US);
        let idle = self.link.now_us() + HEARTBEAT_US;
        beat.min(retry).min(idle).min(aside)
    }

    pub(super) fn upkeep(&mut self) -> Result<(), ClientError> {
        let now = self.link.now_us();
        self.wake(now);
        // Other messages do not count: only answers to heartbeats show that the board receives this
        // side, and still accepts this session.
        if self.heartbeat_us.is_some() && now >= self.heard_us + GIVE_UP_US {
            return Err(ClientError::Lost {
                waiting: request_name(&Request::Heartbeat { host_time_us: 0 }),
            });
        }
        if self
            .heartbeat_us
            .is_some_and(|last| now >= last + self.heartbeat_pause_us())
        {
            self.heartbeat_us = Some(now);
            self.spread = self.spread.map(|count| count + 1);
            let request = Request::Heartbeat {
                host_time_us: wire::wrapping_us(now),
            };
            self.transmit(SequenceNumber(self.next.0 ^ 0x8001), &request)?;
        }
        self.ask_again(now)?;
        let Some(oldest) = self.pending.iter().find(|pending| pending.result.is_none()) else {
            return Ok(());
        };
        let patience_us = match oldest.request {
            Request::Arm { .. } => ARM_US,
            _ => GIVE_UP_US,
        };
        if now >= oldest.first_us + patience_us {
            return Err(ClientError::Lost {
                waiting: request_name(&oldest.request),
            });
        }
        if now >= oldest.sent_us + RETRY_US {
            let from = oldest.sequence;
            self.resend(from)?;
        }
        Ok(())
    }

    /// After a pause of this loop itself (a laptop that slept, a stopped process) the silence is
    /// not the board's fault: it gets the full time again. Meanwhile it has held by itself, and
    /// reports that.
    fn wake(&mut self, now: u64) {
        let slept = now.saturating_sub(self.looped_us) >= SLEPT_US;
        self.looped_us = now;
        if slept {
            self.heard_us = now;
            for pending in &mut self.pending {
                pending.first_us = now;
            }
        }
    }

    /// Sends all requests from a number on again: the board executes strictly in order.
    fn resend(&mut self, from: SequenceNumber) -> Result<(), ClientError> {
        let now = self.link.now_us();
        self.resent_us = now;
        for index in 0..self.pending.len() {
            let Some(pending) = self.pending.get_mut(index) else {
                break;
            };
            if pending.result.is_some() || pending.sequence.since(from) < 0 {
                continue;
            }
            pending.sent_us = now;
            let bytes = wire::command(self.session, pending.sequence, &pending.request);
            self.retransmissions += 1;
            self.link.send(&bytes)?;
        }
        Ok(())
    }

    pub(super) fn transmit(
        &mut self,
        sequence: SequenceNumber,
        request: &Request,
    ) -> Result<(), LinkError> {
        self.link
            .send(&wire::command(self.session, sequence, request))
    }

    pub(super) fn accept(&mut self, message: Message) -> Result<(), ClientError> {
        match message {
            // A restarted board says hello only when asked; an old answer may still be under way.
            Message::Hello(_) => {}
            Message::Event(event) => {
                match &event {
                    Event::Status(status) => {
                        self.handle.publish(|view| view.take_status(status));
                        self.status = Some(status.clone());
                    }
                    Event::Samples(block) => self.recent.take(block),
                }
                self.events.push_back(event);
            }
            Message::Answer(answer) => self.settle(answer)?,
        }
        Ok(())
    }

    fn settle(&mut self, answer: Answer) -> Result<(), ClientError> {
        if let Ok(Reply::Beat {
            host_time_us,
            tick,
            state,
            path_ms,
            knots_free,
            next_knot,
        }) = answer.result
        {
            let now = self.link.now_us();
            self.heard_us = now;
            let round_trip_us = u64::from(wire::wrapping_us(now).wrapping_sub(host_time_us));
            self.handle.publish(|view| {
                view.tick = tick.0;
                view.state = Some(state);
                view.path_s = f64::from(path_ms) * 1e-3;
                view.round_trip_s = round_trip_us as f64 * 1e-6;
            });
            let sent_us = now.saturating_sub(round_trip_us);
            match self.clock.observe(tick.0, sent_us, now) {
                Ok(()) => {}
                Err(jump) if jump.by_ms < 0.0 => {
                    return Err(ClientError::ClockRanBack { by_ms: -jump.by_ms });
                }
                // This machine slept, or its clock stopped: the estimate starts anew.
                Err(_) => {
                    self.clock = BoardClock::default();
                    let _ = self.clock.observe(tick.0, sent_us, now);
                }
            }
            self.beat = Some(Beat {
                tick: tick.0,
                state,
                path_ms,
                knots_free,
                next_knot,
                sent_us,
                round_trip_us,
            });
            return Ok(());
        }
        let Some(answer) = self.take_aside(answer) else {
            return Ok(());
        };
        if let Err(Reject::Sequence { expected }) = answer.result {
            // After one lost frame the board complains about each later one: a single answer is
            // enough.
            if self.link.now_us() >= self.resent_us + RESEND_PAUSE_US {
                self.resend(expected)?;
            }
            return Ok(());
        }
        let mut pending = self.pending.iter_mut();
        if let Some(pending) = pending.find(|pending| pending.sequence == answer.sequence) {
            // A frame that was sent twice is answered twice: the first answer counts.
            pending.result.get_or_insert(answer.result);
        }
        while self
            .pending
            .front()
            .is_some_and(|first| first.result.is_some())
        {
            if let Some(Pending {
                request,
                result: Some(result),
                ..
            }) = self.pending.pop_front()
            {
                self.done.push_back((request, result));
            }
        }
        Ok(())
    }
}
