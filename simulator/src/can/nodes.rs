//! The electronics of all drives: frames in, motor commands to the plant, frames out.

use super::cia402::Cia402;
use super::rmds::Rmds;
use crate::plant::{MAX_CABLES, Plant, PlantError, Protocol};
use mcdpr_firmware::drives::CanFrame;

/// Faults of one drive's electronics. The motor's own faults are the plant's.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct NodeFault {
    /// It answers to this node number, not to its own.
    pub node: Option<u8>,
    /// It always reports this mode (CiA 402).
    pub mode: Option<u8>,
    /// It sends nothing at all.
    pub silent: bool,
    /// It sends everything but its heartbeats (CiA 402).
    pub no_heartbeat: bool,
    /// It reports a fault with this emergency code, and gives no torque (CiA 402; an RMDS only
    /// stops giving torque).
    pub fault: Option<u16>,
    /// It is too hot, and reports it (CiA 402).
    pub hot: bool,
    /// It lacks this object (CiA 402).
    pub lacks: Option<ObjectAddress>,
    /// Its communication starts this much later, ms (CiA 402).
    pub boots_late_ms: u32,
}

/// Address of an object of the dictionary (CiA 301).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct ObjectAddress {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
}

/// One drive's electronics.
#[derive(Debug, Clone)]
enum Electronics {
    Rmds(Rmds),
    Cia402(Box<Cia402>),
}

/// The electronics of every drive of a plant, in the order of its cables.
#[derive(Debug, Clone)]
pub struct DriveNodes {
    nodes: Vec<Electronics>,
    faults: [NodeFault; MAX_CABLES],
    /// Whether a drive is on another board's bus.
    elsewhere: [bool; MAX_CABLES],
}

/// Queue of frames that a node wants to send: time in µs, frame.
pub(super) type Outbox<'a> = &'a mut dyn FnMut(u64, CanFrame);

impl DriveNodes {
    /// The electronics that the plant's parameters name, just powered.
    #[must_use]
    pub fn new(plant: &Plant) -> Self {
        let winches = plant.params().winches.iter();
        let nodes = winches.enumerate().map(|(index, winch)| {
            let number = winch.drive.node_of(index);
            match winch.drive.protocol {
                Protocol::Rmds => Electronics::Rmds(Rmds::new(number)),
                Protocol::Cia402 => Electronics::Cia402(Box::new(Cia402::new(number, winch))),
            }
        });
        Self {
            nodes: nodes.collect(),
            faults: [NodeFault::default(); MAX_CABLES],
            elsewhere: [false; MAX_CABLES],
        }
    }

    /// Only the drives of these cables are on this bus.
    pub(crate) fn keep(&mut self, cables: &[usize]) {
        for (index, elsewhere) in self.elsewhere.iter_mut().enumerate() {
            *elsewhere = !cables.contains(&index);
        }
    }

    /// Drives.
    #[must_use]
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// The faults of a drive (index from 0), to change.
    pub fn fault_mut(&mut self, drive: usize) -> Option<&mut NodeFault> {
        self.faults
            .get_mut(drive)
            .filter(|_| drive < self.nodes.len())
    }

    /// A complete frame has passed on the bus at `at_us`: every drive but its sender receives it.
    /// `from` is the drive that sent it, `None` for the board.
    ///
    /// # Errors
    /// The plant's.
    pub fn hear(
        &mut self,
        plant: &mut Plant,
        at_us: u64,
        from: Option<usize>,
        frame: &CanFrame,
        send: &mut dyn FnMut(usize, u64, CanFrame),
    ) -> Result<(), PlantError> {
        for (index, node) in self.nodes.iter_mut().enumerate() {
            if self.elsewhere[index] || !plant.drive_has_supply(index) {
                continue;
            }
            let fault = &self.faults[index];
            // A controller does not receive its own frames.
            if from == Some(index) || plant.faults().cables[index].drive.ignores_commands {
                continue;
            }
            let silent = fault.silent || plant.faults().cables[index].drive.silent;
            let mut out = |at, frame| {
                if !silent {
                    send(index, at, frame);
                }
            };
            match node {
                Electronics::Rmds(node) => {
                    node.hear(plant, index, fault, at_us, frame, &mut out)?
                }
                Electronics::Cia402(node) => {
                    node.hear(plant, index, fault, at_us, frame, &mut out)?;
                }
            }
        }
        Ok(())
    }

    /// Time has passed, to `now_us`: what drives do by themselves. Call it at least every 100 µs.
    ///
    /// # Errors
    /// The plant's.
    pub fn pass(
        &mut self,
        plant: &mut Plant,
        now_us: u64,
        send: &mut dyn FnMut(usize, u64, CanFrame),
    ) -> Result<(), PlantError> {
        for (index, node) in self.nodes.iter_mut().enumerate() {
            if self.elsewhere[index] {
                continue;
            }
            let fault = &self.faults[index];
            let silent = fault.silent || plant.faults().cables[index].drive.silent;
            let mut out = |at, frame| {
                if !silent {
                    send(index, at, frame);
                }
            };
            match node {
                Electronics::Rmds(node) => node.pass(plant, index, fault, now_us, &mut out)?,
                Electronics::Cia402(node) => node.pass(plant, index, fault, now_us, &mut out)?,
            }
        }
        Ok(())
    }
}
