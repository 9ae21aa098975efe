//! Reading MCAP, front to back, so that a file without its end gives what it has.

use super::{LZ4, MAGIC, MOST_CHUNK_BYTES, ZSTD, op};
use lz4_flex::frame::FrameDecoder;
use mcdpr_protocol::frame::crc32;
use std::collections::BTreeMap;
use std::io::Read;
use thiserror::Error;

/// One message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Number of its channel.
    pub channel: u16,
    /// Its number, as counted by its writer.
    pub sequence: u32,
    /// Its time, ns.
    pub log_time_ns: u64,
    /// Its content.
    pub data: Vec<u8>,
}

/// A file inside the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Attachment {
    /// Its name.
    pub name: String,
    /// Its bytes.
    pub data: Vec<u8>,
}

/// Damage of a file that was read all the same.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Damage {
    /// It is truncated: its writer did not finish.
    Truncated {
        /// Where the last whole record ends.
        at: u64,
    },
    /// A chunk or an attachment does not match its checksum, or a record is invalid; its content is
    /// left out.
    Corrupt {
        /// Where the record starts.
        at: u64,
    },
}

impl Damage {
    /// In words.
    #[must_use]
    pub fn words(&self) -> String {
        match self {
            Self::Truncated { at } => format!(
                "the record is cut short at byte {at}: whoever wrote it did not finish; what is there \
             is used"
            ),
            Self::Corrupt { at } => {
                format!("the record is corrupt at byte {at}: that part is left out")
            }
        }
    }
}

/// Content of a file.
#[derive(Debug, Clone, Default)]
pub struct Contents {
    /// Topic of each channel.
    pub topics: BTreeMap<u16, String>,
    /// Messages in the order in which they were written.
    pub messages: Vec<Message>,
    /// Files inside the file.
    pub attachments: Vec<Attachment>,
    /// Tables of names and values.
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// The first damage.
    pub damage: Option<Damage>,
}

impl Contents {
    /// The topic of a channel.
    #[must_use]
    pub fn topic(&self, channel: u16) -> Option<&str> {
        self.topics.get(&channel).map(String::as_str)
    }

    /// The bytes of an attachment.
    #[must_use]
    pub fn attachment(&self, name: &str) -> Option<&[u8]> {
        let found = self.attachments.iter().find(|file| file.name == name);
        found.map(|file| file.data.as_slice())
    }
}

/// Why a file cannot be read at all.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum ReadError {
    /// It is not an MCAP file.
    #[error("this is not an MCAP file: it does not start like one")]
    Magic,
    /// Its chunks use an unknown compression.
    #[error("its chunks are compressed ({how}), which this program does not read")]
    Compressed {
        /// The compression.
        how: String,
    },
}

/// Takes fields from the front of a record.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (head, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(head)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn bytes32(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(self.u32()?).ok()?;
        self.take(length)
    }

    fn bytes64(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(self.u64()?).ok()?;
        self.take(length)
    }

    fn text(&mut self) -> Option<String> {
        String::from_utf8(self.bytes32()?.to_vec()).ok()
    }

    fn record(&mut self) -> Option<(u8, &'a [u8])> {
        // Ahead: a record that is cut off leaves the position at its start.
        let mut ahead = Fields(self.0);
        let [kind] = ahead.array()?;
        let body = ahead.bytes64()?;
        self.0 = ahead.0;
        Some((kind, body))
    }
}

/// Reads a whole file.
///
/// # Errors
/// [`ReadError`]; a file that is only damaged or cut short is read as far as it goes, and
/// [`Contents::damage`] says so.
pub fn read(bytes: &[u8]) -> Result<Contents, ReadError> {
    let Some(rest) = bytes.strip_prefix(&MAGIC) else {
        return Err(ReadError::Magic);
    };
    let mut contents = Contents::default();
    let mut fields = Fields(rest);
    let position = |fields: &Fields| (bytes.len() - fields.0.len()) as u64;
    loop {
        let at = position(&fields);
        let Some((kind, body)) = fields.record() else {
            contents.damage.get_or_insert(Damage::Truncated { at });
            return Ok(contents);
        };
        if kind == op::FOOTER {
            if fields.0 != MAGIC {
                contents.damage.get_or_insert(Damage::Truncated { at });
            }
            return Ok(contents);
        }
        let understood = match kind {
            op::CHUNK => chunk(body, &mut contents)?.then_some(()),
            op::ATTACHMENT => attachment(body, &mut contents),
            op::METADATA => metadata(body, &mut contents),
            _ => plain(kind, body, &mut contents),
        };
        if understood.is_none() {
            contents.damage.get_or_insert(Damage::Corrupt { at });
        }
    }
}

/// A record that may be in a chunk or outside.
fn plain(kind: u8, body: &[u8], contents: &mut Contents) -> Option<()> {
    let mut fields = Fields(body);
    match kind {
        op::CHANNEL => {
            let id = fields.u16()?;
            let _schema = fields.u16()?;
            let topic = fields.text()?;
            contents.topics.entry(id).or_insert(topic);
        }
        op::MESSAGE => {
            let channel = fields.u16()?;
            let sequence = fields.u32()?;
            let log_time_ns = fields.u64()?;
            let _published_ns = fields.u64()?;
            contents.messages.push(Message {
                channel,
                sequence,
                log_time_ns,
                data: fields.0.to_vec(),
            });
        }
        // Headers, indexes and additions of later versions are not needed to read front to back.
        _ => {}
    }
    Some(())
}

/// The records of a compressed chunk, if its size is as stated and within the limit.
fn unpack(decoder: impl Read, size: u64) -> Option<Vec<u8>> {
    // Before memory is taken: a damaged size may be any number.
    if size > MOST_CHUNK_BYTES {
        return None;
    }
    let mut records = Vec::new();
    // One byte more shows a chunk that is longer than it says.
    decoder.take(size + 1).read_to_end(&mut records).ok()?;
    (records.len() as u64 == size).then_some(records)
}

/// Returns whether the chunk is whole.
fn chunk(body: &[u8], contents: &mut Contents) -> Result<bool, ReadError> {
    let mut fields = Fields(body);
    let mut head = || {
        let _start_ns = fields.u64()?;
        let _end_ns = fields.u64()?;
        let size = fields.u64()?;
        let checksum = fields.u32()?;
        let compression = fields.text()?;
        Some((size, checksum, compression, fields.bytes64()?))
    };
    let Some((size, checksum, compression, stored)) = head() else {
        return Ok(false);
    };
    let unpacked = match compression.as_str() {
        "" => None,
        how @ (LZ4 | ZSTD) => {
            let records = if how == LZ4 {
                unpack(FrameDecoder::new(stored), size)
            } else {
                zstandard(stored).and_then(|decoder| unpack(decoder, size))
            };
            match records {
                Some(records) => Some(records),
                None => return Ok(false),
            }
        }
        _ => return Err(ReadError::Compressed { how: compression }),
    };
    let records = unpacked.as_deref().unwrap_or(stored);
    // 0 means that its writer made no checksum (MCAP).
    if checksum != 0 && crc32(records) != checksum {
        return Ok(false);
    }
    let mut inside = Fields(records);
    while !inside.0.is_empty() {
        let Some((kind, body)) = inside.record() else {
            return Ok(false);
        };
        if plain(kind, body, contents).is_none() {
            return Ok(false);
        }
    }
    Ok(true)
}

fn attachment(body: &[u8], contents: &mut Contents) -> Option<()> {
    let (covered, checksum) = body.split_at_checked(body.len().checked_sub(4)?)?;
    let checksum = u32::from_le_bytes(checksum.try_into().ok()?);
    if checksum != 0 && crc32(covered) != checksum {
        return None;
    }
    let mut fields = Fields(covered);
    let _logged_ns = fields.u64()?;
    let _created_ns = fields.u64()?;
    let name = fields.text()?;
    let _media_type = fields.text()?;
    let data = fields.bytes64()?.to_vec();
    contents.attachments.push(Attachment { name, data });
    Some(())
}

fn metadata(body: &[u8], contents: &mut Contents) -> Option<()> {
    let mut fields = Fields(body);
    let name = fields.text()?;
    let mut pairs = Fields(fields.bytes32()?);
    let mut table = BTreeMap::new();
    while !pairs.0.is_empty() {
        let key = pairs.text()?;
        table.insert(key, pairs.text()?);
    }
    contents.metadata.insert(name, table);
    Some(())
}

/// The C library where there is one: it is three times as fast.
#[cfg(not(target_arch = "wasm32"))]
fn zstandard(stored: &[u8]) -> Option<impl Read> {
    zstd::stream::read::Decoder::new(stored).ok()
}

#[cfg(target_arch = "wasm32")]
fn zstandard(stored: &[u8]) -> Option<impl Read> {
    ruzstd::decoding::StreamingDecoder::new(stored).ok()
}
