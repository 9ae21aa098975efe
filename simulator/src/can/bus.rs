//! The bus: arbitration, duration of frames, and faults (ISO 11898-1).

use super::wire::{ERROR_BITS, frame_bits};
use mcdpr_firmware::drives::{BusState, CanFrame};
use std::collections::VecDeque;

/// An error passive sender waits this long before it tries again, bits.
const SUSPEND_BITS: u64 = 8;
/// Idle bits after which a controller that is off takes part again.
const RECOVERY_BITS: u64 = 128 * 11;
/// A controller is error passive from this count on, and bus-off above 255.
const PASSIVE_FROM: u16 = 128;

/// One controller on the bus. The board is number 0, drive `n` (from 0) number `n + 1`.
#[derive(Debug, Clone)]
struct Node {
    bitrate: u32,
    waiting: VecDeque<(u64, CanFrame)>,
    transmit_errors: u16,
    receive_errors: u16,
    off_until_us: Option<u64>,
    suspended_until_us: u64,
    connected: bool,
}

impl Node {
    fn state(&self) -> BusState {
        if self.off_until_us.is_some() {
            BusState::Off
        } else if self.transmit_errors.max(self.receive_errors) >= PASSIVE_FROM {
            BusState::Passive
        } else {
            BusState::Active
        }
    }

    fn takes_part(&self) -> bool {
        self.connected && self.off_until_us.is_none()
    }
}

/// A complete frame that went over the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Delivery {
    /// When its last bit was received, µs.
    pub at_us: u64,
    /// Who sent it: 0 the board, `n + 1` drive `n` (from 0).
    pub from: usize,
    /// The frame.
    pub frame: CanFrame,
}

/// Faults of the bus as a whole.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct BusFaults {
    /// The wires are shorted, or cut at the board: no frame passes.
    pub shorted: bool,
    /// This many frames from now on are destroyed on the wire; their senders try again.
    pub corrupt: u32,
    /// This many frames from now on are received by nobody, though their senders believe so.
    pub drop: u32,
}

/// Counters of a bus since it was made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct BusCounters {
    /// Frames that passed.
    pub frames: u64,
    /// Frames that were destroyed.
    pub destroyed: u64,
    /// Time that the wires were taken, µs.
    pub busy_us: u64,
}

/// Frames of several controllers on one pair of wires, in time.
///
/// ```
/// use mcdpr_firmware::drives::CanFrame;
/// use mcdpr_simulator::can::CanBus;
/// let mut bus = CanBus::new(1_000_000, 2); // the board and two drives
/// let frame = |id| CanFrame { id, ..CanFrame::default() };
/// bus.offer(1, 0, frame(0x20));
/// bus.offer(0, 0, frame(0x10)); // the same moment: the lower identifier wins
/// let first = bus.next(1000).expect("delivered");
/// assert_eq!((first.from, first.frame.id), (0, 0x10));
/// assert_eq!(bus.next(1000).map(|d| d.frame.id), Some(0x20));
/// assert_eq!(bus.next(1000), None);
/// ```
#[derive(Debug, Clone)]
pub struct CanBus {
    nodes: Vec<Node>,
    /// Time until which the wires are busy, µs.
    busy_until_us: u64,
    faults: BusFaults,
    counters: BusCounters,
}

impl CanBus {
    /// An idle bus of a board and this many drives, all at this bit rate (bit/s).
    #[must_use]
    pub fn new(bitrate: u32, drives: usize) -> Self {
        let node = Node {
            bitrate,
            waiting: VecDeque::new(),
            transmit_errors: 0,
            receive_errors: 0,
            off_until_us: None,
            suspended_until_us: 0,
            connected: true,
        };
        Self {
            nodes: vec![node; drives + 1],
            busy_until_us: 0,
            faults: BusFaults::default(),
            counters: BusCounters::default(),
        }
    }

    /// Sets a controller's bit rate (bit/s), with an empty queue and cleared error counters.
    pub fn restart(&mut self, node: usize, bitrate: u32) {
        if let Some(node) = self.nodes.get_mut(node) {
            node.bitrate = bitrate;
            node.waiting.clear();
            node.transmit_errors = 0;
            node.receive_errors = 0;
            node.off_until_us = None;
        }
    }

    /// Connects a controller to the bus, or disconnects it: without power it neither sends nor
    /// acknowledges, and its queue is cleared.
    pub fn connect(&mut self, node: usize, connected: bool) {
        if let Some(node) = self.nodes.get_mut(node) {
            if !connected {
                node.waiting.clear();
            }
            node.connected = connected;
        }
    }

    /// A controller wants to send a frame from `at_us` on. Those of one controller leave in the
    /// order of their identifiers; equal ones as they came.
    pub fn offer(&mut self, node: usize, at_us: u64, frame: CanFrame) {
        if let Some(node) = self.nodes.get_mut(node).filter(|node| node.connected) {
            node.waiting.push_back((at_us, frame));
        }
    }

    /// Frames of a controller that are not sent yet.
    #[must_use]
    pub fn waiting(&self, node: usize) -> usize {
        self.nodes.get(node).map_or(0, |node| node.waiting.len())
    }

    /// A controller gives up the frames that it has not sent.
    pub(crate) fn drop_waiting(&mut self, node: usize) {
        if let Some(node) = self.nodes.get_mut(node) {
            node.waiting.clear();
        }
    }

    /// State of a controller on the bus.
    #[must_use]
    pub fn state(&self, node: usize) -> BusState {
        self.nodes.get(node).map_or(BusState::Off, Node::state)
    }

    /// Transmit and receive error counters of a controller.
    #[must_use]
    pub fn errors(&self, node: usize) -> (u16, u16) {
        let node = self.nodes.get(node);
        node.map_or((0, 0), |n| (n.transmit_errors, n.receive_errors))
    }

    /// The faults, to change.
    pub const fn faults_mut(&mut self) -> &mut BusFaults {
        &mut self.faults
    }

    /// The counters.
    #[must_use]
    pub const fn counters(&self) -> BusCounters {
        self.counters
    }

    /// The next frame that is complete by `until_us`; call it again until it returns none. Time
    /// cannot be set back.
    pub fn next(&mut self, until_us: u64) -> Option<Delivery> {
        loop {
            self.recover(until_us);
            let start = self.start_us().filter(|start| *start < until_us)?;
            let ready: Vec<usize> = (0..self.nodes.len())
                .filter(|&node| self.urgent(node, start).is_some())
                .collect();
            let lowest = ready
                .iter()
                .filter_map(|&node| self.urgent(node, start).map(|(_, frame)| frame.id))
                .min()?;
            let senders: Vec<usize> = ready
                .into_iter()
                .filter(|&node| {
                    // On shorted wires no controller notices that another one won.
                    let shorted = self.faults.shorted;
                    self.urgent(node, start)
                        .is_some_and(|(_, frame)| shorted || frame.id == lowest)
                })
                .collect();
            let (_, frame) = self.urgent(*senders.first()?, start)?;
            let bit_us = |bits: u64, rate: u32| (bits * 1_000_000).div_ceil(u64::from(rate.max(1)));
            let bitrate = self.nodes[senders[0]].bitrate;
            let whole_us = bit_us(frame_bits(&frame), bitrate);
            if start + whole_us > until_us && !self.goes_wrong(&senders, &frame, start) {
                // It ends later, and a later call delivers it: nothing that arrives meanwhile changes
                // it. Controllers that have something to send join the next arbitration.
                return None;
            }
            if self.goes_wrong(&senders, &frame, start) {
                // On shorted wires not even the start of a frame comes back to its sender.
                let passed = if self.faults.shorted {
                    1
                } else {
                    // A disturbance hits a frame in its middle, on the average.
                    frame_bits(&frame) / 2
                };
                let bits = passed + ERROR_BITS;
                self.destroy(&senders, start, bit_us(bits, bitrate), bitrate);
                continue;
            }
            // Without another controller nobody writes the acknowledge bit.
            if self.is_alone(senders[0]) {
                self.unacknowledged(senders[0], start, whole_us, bitrate);
                continue;
            }
            let end = start + whole_us;
            for &sender in &senders {
                self.done(sender, start);
            }
            self.busy_until_us = end;
            self.counters.frames += 1;
            self.counters.busy_us += whole_us;
            if self.faults.drop > 0 {
                self.faults.drop -= 1;
                continue;
            }
            return Some(Delivery {
                at_us: end,
                from: senders[0],
                frame,
            });
        }
    }

    /// The frame that a controller would send at a time, with its place in the queue.
    fn urgent(&self, node: usize, at_us: u64) -> Option<(usize, CanFrame)> {
        let node = self.nodes.get(node)?;
        if !node.takes_part() || node.suspended_until_us > at_us {
            return None;
        }
        let ready = node.waiting.iter().enumerate();
        let ready = ready.filter(|(_, (from, _))| *from <= at_us);
        let best = ready.min_by_key(|(place, (_, frame))| (frame.id, *place))?;
        Some((best.0, best.1.1))
    }

    /// When the next frame starts: as soon as the wires are free and a controller has one.
    fn start_us(&self) -> Option<u64> {
        let ready = self.nodes.iter().filter(|node| node.takes_part());
        let ready = ready.flat_map(|node| {
            let from = node.waiting.iter().map(|(at, _)| *at);
            from.map(|at| at.max(node.suspended_until_us))
        });
        ready.min().map(|at| at.max(self.busy_until_us))
    }

    /// Whether a frame is destroyed: by the wires, by chance, by a controller that hears another
    /// bit rate, or by two that send different data under one identifier.
    fn goes_wrong(&self, senders: &[usize], frame: &CanFrame, start: u64) -> bool {
        let rate = self.nodes[senders[0]].bitrate;
        let misheard = self.nodes.iter().any(|node| {
            node.takes_part() && node.bitrate != rate && node.state() == BusState::Active
        });
        let differ = senders.iter().any(|&node| {
            self.urgent(node, start)
                .is_some_and(|(_, other)| other != *frame)
        });
        self.faults.shorted || self.faults.corrupt > 0 || misheard || differ
    }

    fn is_alone(&self, sender: usize) -> bool {
        let rate = self.nodes[sender].bitrate;
        let mut others = self.nodes.iter().enumerate();
        !others.any(|(other, node)| other != sender && node.takes_part() && node.bitrate == rate)
    }

    fn destroy(&mut self, senders: &[usize], start: u64, length_us: u64, bitrate: u32) {
        self.faults.corrupt = self.faults.corrupt.saturating_sub(1);
        let end = start + length_us;
        for (index, node) in self.nodes.iter_mut().enumerate() {
            if senders.contains(&index) {
                // ISO 11898-1, fault confinement: 8 for a failed transmission, 1 for an error
                // heard.
                node.transmit_errors += 8;
                fail(node, end, bitrate);
            } else if node.takes_part() && !self.faults.shorted {
                // Capped: receive errors make a controller passive and never switch it off.
                node.receive_errors = (node.receive_errors + 1).min(PASSIVE_FROM);
            }
        }
        self.busy_until_us = end;
        self.counters.destroyed += 1;
        self.counters.busy_us += length_us;
    }

    /// Missing acknowledgement: an error, but one that never leads to bus-off.
    fn unacknowledged(&mut self, sender: usize, start: u64, length_us: u64, bitrate: u32) {
        let end = start + length_us;
        let node = &mut self.nodes[sender];
        // A passive sender does not count a missing acknowledgement: it tries for ever.
        if node.transmit_errors < PASSIVE_FROM {
            node.transmit_errors += 8;
        }
        fail(node, end, bitrate);
        self.busy_until_us = end;
        self.counters.destroyed += 1;
        self.counters.busy_us += length_us;
    }

    fn done(&mut self, sender: usize, start: u64) {
        if let Some((place, _)) = self.urgent(sender, start) {
            self.nodes[sender].waiting.remove(place);
        }
        for (index, node) in self.nodes.iter_mut().enumerate() {
            if index == sender {
                node.transmit_errors = node.transmit_errors.saturating_sub(1);
            } else {
                node.receive_errors = node.receive_errors.saturating_sub(1);
            }
        }
    }

    /// Controllers that were off come back after their idle time: not while the wires are shorted.
    fn recover(&mut self, until_us: u64) {
        for node in &mut self.nodes {
            let due = node.off_until_us.is_some_and(|at| at <= until_us);
            if due && !self.faults.shorted {
                node.off_until_us = None;
                node.transmit_errors = 0;
                node.receive_errors = 0;
            }
        }
    }
}

fn fail(node: &mut Node, end: u64, bitrate: u32) {
    let wait_us = |bits: u64| bits * 1_000_000 / u64::from(bitrate.max(1));
    if node.transmit_errors > 255 {
        node.off_until_us = Some(end + wait_us(RECOVERY_BITS));
        // A controller that comes back must not send frames from before.
        node.waiting.clear();
    } else if node.transmit_errors >= PASSIVE_FROM {
        node.suspended_until_us = end + wait_us(SUSPEND_BITS);
    }
}
