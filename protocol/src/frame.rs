//! Framing: `COBS(channel, body, CRC-32 little-endian) 0x00`.
//!
//! The CRC is CRC-32/ISO-HDLC over channel and body. A receiver that starts in the middle, or that
//! receives noise, loses at most the current frame: it resynchronises at the next `0x00`.

use serde::Serialize;

/// Most bytes of a frame on the wire, its delimiter included.
// At 921,600 baud 256 bytes take 2.8 ms: a lost frame costs no more.
pub const MAX_FRAME: usize = 256;
/// Most bytes before COBS: COBS adds one byte up to 254, and the delimiter is one.
// Up to 254 bytes COBS needs a single code byte of overhead; a 255th would need a second.
const MAX_PLAIN: usize = 254;
/// Most bytes of a body.
pub const MAX_BODY: usize = MAX_PLAIN - 1 - CRC_SIZE;
const CRC_SIZE: usize = 4;

/// Effect of four bits on the checksum: 64 bytes of a board's flash, where a table of bytes is 1
/// KB.
const CRC_TABLE: [u32; 16] = {
    let mut table = [0; 16];
    let mut nibble = 0;
    while nibble < 16 {
        let mut value = nibble;
        let mut bit = 0;
        while bit < 4 {
            // The reflected polynomial of IEEE 802.3.
            value = (value >> 1) ^ if value & 1 != 0 { 0xEDB8_8320 } else { 0 };
            bit += 1;
        }
        #[expect(clippy::indexing_slicing, reason = "under 16, while compiling")]
        {
            table[nibble as usize] = value;
        }
        nibble += 1;
    }
    table
};

/// CRC-32/ISO-HDLC, as every frame and the configuration hash use it.
///
/// ```
/// assert_eq!(mcdpr_protocol::frame::crc32(b"123456789"), 0xCBF4_3926);
/// ```
#[must_use]
pub fn crc32(bytes: &[u8]) -> u32 {
    let mut digest = digest();
    digest.update(bytes);
    digest.finalize()
}

/// A running CRC-32 of the same kind.
pub(crate) const fn digest() -> Digest {
    // Begins with ones, so that leading zeros change the checksum.
    Digest(u32::MAX)
}

/// See [`digest`].
#[derive(Debug, Clone)]
pub(crate) struct Digest(u32);

impl Digest {
    pub(crate) fn update(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 ^= u32::from(*byte);
            for _ in 0..2 {
                // Two steps of four bits: a board has no room for the table of bytes, and a tick no
                // time for bits.
                let place = (self.0 & 15) as usize;
                self.0 = (self.0 >> 4) ^ CRC_TABLE.get(place).copied().unwrap_or(0);
            }
        }
    }

    pub(crate) const fn finalize(self) -> u32 {
        !self.0
    }
}

/// Type of a frame's body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Channel {
    /// Asks for the board's identity. Frozen.
    HelloQuery = 0x01,
    /// The answer. Frozen.
    Hello = 0x02,
    /// A request.
    Command = 0x10,
    /// Its outcome.
    Answer = 0x20,
    /// Samples of every tick.
    Samples = 0x30,
    /// State of the board.
    Status = 0x31,
}

impl Channel {
    const fn from_number(number: u8) -> Option<Self> {
        match number {
            0x01 => Some(Self::HelloQuery),
            0x02 => Some(Self::Hello),
            0x10 => Some(Self::Command),
            0x20 => Some(Self::Answer),
            0x30 => Some(Self::Samples),
            0x31 => Some(Self::Status),
            _ => None,
        }
    }
}

/// Why bytes are not a valid frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameError {
    /// The checksum does not match the bytes (L1).
    Checksum,
    /// No delimiter within [`MAX_FRAME`] bytes (L7).
    TooLong,
    /// Too short for a channel and a checksum, or not valid COBS (L6).
    Malformed,
    /// The checksum matches, but there is no such channel.
    UnknownChannel,
    /// The message is larger than a frame, or cannot be encoded.
    Encode,
}

/// Encodes a message into `out` as one frame and gives the bytes used, the delimiter included.
///
/// # Errors
/// [`FrameError::Encode`] if the message does not fit; every message of this crate does.
pub fn encode_frame<T: Serialize>(
    channel: Channel,
    message: &T,
    out: &mut [u8; MAX_FRAME],
) -> Result<usize, FrameError> {
    let mut body = [0; MAX_BODY];
    let used = postcard::to_slice(message, &mut body)
        .map_err(|_| FrameError::Encode)?
        .len();
    encode_bytes(channel, body.get(..used).unwrap_or_default(), out)
}

/// Encodes a body given as bytes; see [`encode_frame`].
///
/// # Errors
/// [`FrameError::Encode`] if the body is longer than [`MAX_BODY`].
pub fn encode_bytes(
    channel: Channel,
    body: &[u8],
    out: &mut [u8; MAX_FRAME],
) -> Result<usize, FrameError> {
    let head = [channel as u8];
    let mut digest = digest();
    digest.update(&head);
    digest.update(body);
    let checksum = digest.finalize().to_le_bytes();
    if body.len() > MAX_BODY {
        return Err(FrameError::Encode);
    }
    // One byte is kept for the delimiter.
    let (coded, _) = out.split_at_mut(MAX_FRAME - 1);
    let mut encoder = cobs::CobsEncoder::new(coded);
    for part in [&head, body, &checksum] {
        encoder.push(part).map_err(|_| FrameError::Encode)?;
    }
    let used = encoder.finalize();
    // COBS has no zero inside: the delimiter is unambiguous.
    *out.get_mut(used).ok_or(FrameError::Encode)? = 0;
    Ok(used + 1)
}

/// Collects bytes into frames. Work per byte is bounded; nothing is allocated.
#[derive(Debug)]
pub struct Deframer {
    buffer: [u8; MAX_FRAME],
    used: usize,
    overrun: bool,
}

impl Default for Deframer {
    fn default() -> Self {
        Self::new()
    }
}

impl Deframer {
    /// A receiver that waits for a frame's first byte.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            buffer: [0; MAX_FRAME],
            used: 0,
            overrun: false,
        }
    }

    /// Takes one byte; at a delimiter returns the frame that ends there, or why it is invalid.
    ///
    /// Empty frames (two delimiters in a row) are silently skipped, so that a sender may open with
    /// a delimiter.
    pub fn push(&mut self, byte: u8) -> Option<Result<(Channel, &[u8]), FrameError>> {
        if byte != 0 {
            match self.buffer.get_mut(self.used) {
                // The rest of a frame that is too long is skipped: its bytes must not be taken for
                // a frame of their own.
                Some(slot) if self.used < MAX_FRAME - 1 => {
                    *slot = byte;
                    self.used += 1;
                }
                _ => self.overrun = true,
            }
            return None;
        }
        let used = core::mem::take(&mut self.used);
        if core::mem::take(&mut self.overrun) {
            return Some(Err(FrameError::TooLong));
        }
        // Two delimiters in a row: a sender opens with one to end whatever noise came before.
        if used == 0 {
            return None;
        }
        Some(decode_frame(self.buffer.get_mut(..used)?))
    }
}

/// Decodes, in place, the bytes between two delimiters.
pub(crate) fn decode_frame(coded: &mut [u8]) -> Result<(Channel, &[u8]), FrameError> {
    let used = cobs::decode_in_place(coded).map_err(|_| FrameError::Malformed)?;
    let plain = coded.get(..used).ok_or(FrameError::Malformed)?;
    let (covered, checksum) = plain
        .split_last_chunk::<CRC_SIZE>()
        .ok_or(FrameError::Malformed)?;
    // The checksum before the channel: a damaged number must not select a decoder.
    if crc32(covered) != u32::from_le_bytes(*checksum) {
        return Err(FrameError::Checksum);
    }
    let (channel, body) = covered.split_first().ok_or(FrameError::Malformed)?;
    let channel = Channel::from_number(*channel).ok_or(FrameError::UnknownChannel)?;
    Ok((channel, body))
}
