//! What a board says of itself on its line, for a board whose inside cannot be seen.

use mcdpr_firmware::State;
use mcdpr_protocol::message::decode;
use mcdpr_protocol::{Channel, Deframer, FaultRecord, SampleBlock, Status, Tick};

/// Ticks after which the measurements of a tick have reached the host.
// A block of 10 ticks, its queue and its time on the line; an upper bound.
pub const BEHIND_TICKS: usize = 40;

/// Positions of encoders by a plant's counters, which wrap at 16 bits; positions do not.
#[derive(Debug)]
pub struct Positions<const N: usize> {
    counters: Option<[u16; N]>,
    counts: [i64; N],
}

impl<const N: usize> Default for Positions<N> {
    fn default() -> Self {
        Self {
            counters: None,
            counts: [0; N],
        }
    }
}

impl<const N: usize> Positions<N> {
    /// The positions, counts since the first reading, after another reading of the counters.
    pub fn follow(&mut self, counters: [u16; N]) -> [i64; N] {
        let before = self.counters.replace(counters).unwrap_or(counters);
        for ((count, now), before) in self.counts.iter_mut().zip(counters).zip(before) {
            *count += i64::from(now.wrapping_sub(before).cast_signed());
        }
        self.counts
    }

    /// The counters start again, wherever they do: positions go on from where they are.
    pub fn restart(&mut self) {
        self.counters = None;
    }
}

/// The board's state by its own messages. Each is known only after the board has reported it.
#[derive(Debug)]
pub struct Overheard {
    deframer: Deframer,
    cables: usize,
    /// The board's state.
    pub state: State,
    /// The latched fault.
    pub fault: Option<FaultRecord>,
    /// Whether a drive gives torque.
    pub torque_on: bool,
    /// Path times of past ticks since the last call of [`Self::take_path_times`].
    path_times: Vec<(Tick, u32)>,
    /// The last tick of a block of samples, and the block's bytes.
    last_tick: Option<(Tick, usize)>,
}

impl Overheard {
    /// A board of so many cables that just started.
    #[must_use]
    pub fn new(cables: usize) -> Self {
        Self {
            deframer: Deframer::new(),
            cables,
            state: State::Boot,
            fault: None,
            torque_on: false,
            path_times: Vec::new(),
            last_tick: None,
        }
    }

    /// The board starts again.
    pub fn restart(&mut self) {
        self.state = State::Boot;
        (self.fault, self.torque_on) = (None, false);
        self.last_tick = None;
    }

    /// Bytes that the board has sent.
    pub fn listen(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            match self.deframer.push(byte) {
                Some(Ok((Channel::Status, body))) => {
                    if let Some(status) = decode::<Status>(body) {
                        self.state = status.state;
                        self.fault = status.fault;
                        self.torque_on = status.torque_on != 0;
                    }
                }
                Some(Ok((Channel::Samples, body))) => {
                    if let Some(block) = decode::<SampleBlock>(body) {
                        let ticks = SampleBlock::ticks(self.cables) as u32;
                        // The path clock is zero while no motion runs.
                        let moves = u32::from(block.path_ms > 0);
                        let times =
                            (0..ticks).map(|i| (block.tick.after(i), moves * (block.path_ms + i)));
                        self.path_times.extend(times);
                        let last = block.tick.after(ticks.saturating_sub(1));
                        self.last_tick = Some((last, body.len()));
                    }
                }
                _ => {}
            }
        }
    }

    /// Path times of past ticks that have become known since the last call.
    pub fn take_path_times(&mut self) -> Vec<(Tick, u32)> {
        std::mem::take(&mut self.path_times)
    }

    /// The last tick of the blocks of samples that have ended since the last call, and the bytes of
    /// its block.
    pub fn take_last_tick(&mut self) -> Option<(Tick, usize)> {
        self.last_tick.take()
    }
}
