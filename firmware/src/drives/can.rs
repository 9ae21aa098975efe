//! Frames and the port that carries them: the interface of the drives to a CAN controller.

/// A data frame with an 11-bit identifier.
// Aligned so that it is copied by words.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
#[repr(C, align(4))]
pub struct CanFrame {
    /// The bytes; those beyond `len` are 0.
    pub data: [u8; 8],
    /// Identifier, 11 bits; the lowest wins the bus.
    pub id: u16,
    /// Bytes that count, 0 to 8.
    pub len: u8,
}

/// There is no room for another frame: offer it again in the next tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Full;

/// State of a CAN controller on its bus (ISO 11898-1).
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub enum BusState {
    /// Active.
    #[default]
    Active,
    /// Error passive, 128 errors or more: still active, but must not disturb others.
    Passive,
    /// Bus-off, 256 transmit errors: silent until it has recovered (D1).
    Off,
}

/// A CAN controller. No call blocks.
///
/// On a bus that keeps up, `send` must have room for one frame per drive and one more in every
/// tick; frames leave in any order, but two with the same identifier in the order of the calls.
pub trait CanPort {
    /// Restarts at this bit rate, with both queues empty.
    fn set_bitrate(&mut self, bits_per_s: u32);
    /// Queues a frame.
    ///
    /// # Errors
    /// [`Full`]: it was not queued.
    fn send(&mut self, frame: &CanFrame) -> Result<(), Full>;
    /// The oldest frame that has arrived.
    fn receive(&mut self) -> Option<CanFrame>;
    /// State of the controller on the bus.
    fn state(&self) -> BusState;
}
