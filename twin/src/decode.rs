//! Decodes the bytes of a line, both ways.
//!
//! A decoder needs only the bytes, so it serves a live line and a record alike. From the knots that
//! the host sent it computes the board's set-points at every path time.

use mcdpr_core::link::{Direction, RawFrame};
use mcdpr_protocol::{
    Answer, Channel, Command, Deframer, Hello, Knot, Reject, Reply, Request, SampleBlock, Status,
    message,
};
use std::collections::BTreeMap;

/// One tick of all cables, SI.
#[derive(Debug, Clone, PartialEq)]
pub struct Tick {
    /// Board tick.
    pub tick: u32,
    /// Path time of the motion, s; `None` while none is in progress.
    pub path_s: Option<f64>,
    /// Paid-out lengths by the drum encoders, m.
    pub lengths_m: Vec<f64>,
    /// Tensions at the winches, N.
    pub tensions_n: Vec<f64>,
    /// Motor currents, A.
    pub currents_a: Vec<f64>,
    /// Set-points from the knots of the motion at this path time; empty without a motion.
    pub planned: Vec<Planned>,
}

/// Set-points from the knots for one cable at one time, SI.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Planned {
    /// Paid-out length, m.
    pub length_m: f64,
    /// Its rate, m/s.
    pub speed_mps: f64,
    /// Expected tension at the winch, or its set-point, N.
    pub tension_n: f64,
}

/// Decoded content of bytes.
#[derive(Debug, Clone, PartialEq)]
pub enum Seen {
    /// The board sent its greeting.
    Hello(Hello),
    /// The host requested something other than heartbeats and knots.
    Asked(Request),
    /// The host sent a knot for the first time.
    Knot(Knot),
    /// The board refused a request.
    Refused(Reject),
    /// The board's state.
    Status(Status),
    /// Measurements.
    Ticks(Vec<Tick>),
    /// A heartbeat came back.
    Beat {
        /// Path time, ms.
        path_ms: u32,
        /// The board's state.
        state: mcdpr_protocol::BoardState,
    },
}

/// Decodes bytes.
#[derive(Default)]
pub struct Decoder {
    to_board: Deframer,
    to_host: Deframer,
    knots: BTreeMap<u16, Knot>,
    damaged: u64,
    sequence: Option<u16>,
}

impl Decoder {
    /// Damaged frames.
    #[must_use]
    pub const fn damaged(&self) -> u64 {
        self.damaged
    }

    /// Takes bytes of the line.
    pub fn take(&mut self, frame: &RawFrame) -> Vec<Seen> {
        let mut seen = Vec::new();
        for &byte in &frame.bytes {
            let deframer = match frame.direction {
                Direction::ToBoard => &mut self.to_board,
                Direction::ToHost => &mut self.to_host,
            };
            let what = match deframer.push(byte) {
                None => continue,
                Some(Ok((channel, body))) => Some(understand(channel, body)),
                Some(Err(_)) => None,
            };
            match what {
                Some(Some(meaning)) => self.settle(meaning, &mut seen),
                Some(None) => {}
                None => self.damaged += 1,
            }
        }
        seen
    }

    fn settle(&mut self, meaning: Meaning, seen: &mut Vec<Seen>) {
        match meaning {
            Meaning::Hello(hello) => seen.push(Seen::Hello(hello)),
            Meaning::Status(status) => seen.push(Seen::Status(status)),
            Meaning::Samples(block) => seen.push(Seen::Ticks(self.ticks(&block))),
            Meaning::Answer(answer) => match answer.result {
                Ok(Reply::Beat { path_ms, state, .. }) => {
                    seen.push(Seen::Beat { path_ms, state });
                }
                Ok(Reply::Status(status)) => seen.push(Seen::Status(status)),
                Ok(_) | Err(Reject::Sequence { .. }) => {}
                Err(reject) => seen.push(Seen::Refused(reject)),
            },
            Meaning::Command(command) => {
                // A repeated request is the same request.
                if command.request.is_sequenced() {
                    let again = self.sequence.is_some_and(|last| {
                        // As a signed difference: numbers of 16 bits wrap.
                        command.sequence.0.wrapping_sub(last).cast_signed() <= 0
                    });
                    if again {
                        return;
                    }
                    self.sequence = Some(command.sequence.0);
                }
                match command.request {
                    Request::Heartbeat { .. } | Request::Info | Request::Status => {}
                    Request::Knot(knot) => {
                        // Knot 0 begins a motion: those of the motion before are void.
                        if knot.index == 0 {
                            self.knots.clear();
                        }
                        self.knots.insert(knot.index, knot.clone());
                        seen.push(Seen::Knot(knot));
                    }
                    request => {
                        if request == Request::Open {
                            self.sequence = Some(command.sequence.0);
                        }
                        seen.push(Seen::Asked(request));
                    }
                }
            }
        }
    }

    fn ticks(&self, block: &SampleBlock) -> Vec<Tick> {
        let mut ticks = Vec::new();
        block.unpack(|tick, row| {
            let since = tick.since(block.tick);
            // The path clock is zero while no motion runs.
            let path_s = (block.path_ms > 0)
                .then(|| (f64::from(block.path_ms) + f64::from(since)) * 1e-3)
                .filter(|path_s| *path_s <= self.end_s());
            ticks.push(Tick {
                tick: tick.0,
                path_s,
                lengths_m: row.iter().map(|s| s.length.metres()).collect(),
                tensions_n: row.iter().map(|s| s.tension.newtons()).collect(),
                currents_a: row.iter().map(|s| s.current.amperes()).collect(),
                planned: path_s.map_or(Vec::new(), |path_s| self.planned(path_s)),
            });
        });
        ticks
    }

    /// End of the motion as far as its knots are known, s.
    fn end_s(&self) -> f64 {
        let last = self.knots.last_key_value();
        last.map_or(0.0, |(_, knot)| knot.time_s())
    }

    /// Set-points from the knots at a path time: the cubic between two of them (the paper's Eq.
    /// 53).
    fn planned(&self, path_s: f64) -> Vec<Planned> {
        let ms = path_s * 1e3;
        // Knots are ordered both by time and by number: bisection.
        let (mut low, mut high) = match (self.knots.first_key_value(), self.knots.last_key_value())
        {
            (Some((first, _)), Some((last, _))) => (*first, *last),
            _ => return Vec::new(),
        };
        while high - low > 1 {
            let middle = low + (high - low) / 2;
            match self.knots.get(&middle) {
                Some(knot) if f64::from(knot.time_ms) <= ms => low = middle,
                Some(_) => high = middle,
                None => return Vec::new(),
            }
        }
        let (Some(from), Some(to)) = (self.knots.get(&low), self.knots.get(&high)) else {
            return Vec::new();
        };
        let spacing_s = (f64::from(to.time_ms) - f64::from(from.time_ms)) * 1e-3;
        let phase = if spacing_s > 0.0 {
            ((path_s - from.time_s()) / spacing_s).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let pairs = from.cables.iter().zip(to.cables.iter());
        pairs
            .map(|(a, b)| {
                let (start, end) = (a.length.metres(), b.length.metres());
                let rise = |speed: i32| f64::from(speed) * 1e-6 * spacing_s;
                let (m0, m1) = (rise(a.velocity.0), rise(b.velocity.0));
                let delta = end - start;
                // Hermite's cubic in the phase: value and slope are those of both knots.
                let (c2, c3) = (3.0 * delta - 2.0 * m0 - m1, m0 + m1 - 2.0 * delta);
                let slope = m0 + phase * (2.0 * c2 + phase * 3.0 * c3);
                let tension = |knot: i32| f64::from(knot) * 1e-3;
                Planned {
                    length_m: start + phase * (m0 + phase * (c2 + phase * c3)),
                    speed_mps: if spacing_s > 0.0 {
                        slope / spacing_s
                    } else {
                        0.0
                    },
                    // Linear between knots, as on the board.
                    tension_n: tension(a.tension.0) * (1.0 - phase) + tension(b.tension.0) * phase,
                }
            })
            .collect()
    }
}

enum Meaning {
    Hello(Hello),
    Command(Command),
    Answer(Answer),
    Samples(SampleBlock),
    Status(Status),
}

fn understand(channel: Channel, body: &[u8]) -> Option<Meaning> {
    match channel {
        Channel::Hello => Hello::from_bytes(body).map(Meaning::Hello),
        Channel::Command => message::decode(body).map(Meaning::Command),
        Channel::Answer => message::decode(body).map(Meaning::Answer),
        Channel::Samples => message::decode(body).map(Meaning::Samples),
        Channel::Status => message::decode(body).map(Meaning::Status),
        Channel::HelloQuery => None,
    }
}
