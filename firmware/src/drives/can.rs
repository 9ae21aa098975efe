//! Frames and the port that carries them: all that the drives need of a CAN controller.

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

/// How a CAN controller stands to its bus (ISO 11898-1).
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub enum BusState {
    /// Takes part.
    #[default]
    Active,
    /// 128 errors or more: takes part, but must not disturb others.
    Passive,
    /// 256 transmit errors: silent until it has recovered (D1).
    Off,
}

/// A CAN controller. Nothing here waits.
///
/// `send` must find room for one frame per drive and one more in every tick on a bus that keeps up;
/// frames leave in any order, but two of the same identifier in the order they came.
pub trait CanPort {
    /// Starts anew at this bit rate, with nothing queued either way.
    fn set_bitrate(&mut self, bits_per_s: u32);
    /// Queues a frame.
    ///
    /// # Errors
    /// [`Full`]: it was not queued.
    fn send(&mut self, frame: &CanFrame) -> Result<(), Full>;
    /// The oldest frame that has arrived.
    fn receive(&mut self) -> Option<CanFrame>;
    /// How the controller stands to the bus.
    fn state(&self) -> BusState;
}
