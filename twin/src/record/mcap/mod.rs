//! The MCAP container (version 0, `mcap.dev/spec`), read: only the parts that a run needs, with chunks
//! compressed by Zstandard, or by LZ4 as those of earlier versions.
//!
//! Own code, because the published crate adds three procedural-macro stacks to the first build.

mod read;

pub use read::{Attachment, Contents, Damage, Message, ReadError, read};

/// What every MCAP file starts and ends with.
pub const MAGIC: [u8; 8] = [0x89, b'M', b'C', b'A', b'P', b'0', b'\r', b'\n'];

/// The name of the packing in a chunk of records before version 0.2.
pub(crate) const LZ4: &str = "lz4";
/// That of records now.
pub const ZSTD: &str = "zstd";
/// Most bytes of an uncompressed chunk: far more than a writer collects.
pub(crate) const MOST_CHUNK_BYTES: u64 = 64 << 20;

/// Kinds of records.
#[allow(missing_docs, reason = "named as in the specification")]
pub mod op {
    pub const HEADER: u8 = 0x01;
    pub const FOOTER: u8 = 0x02;
    pub const SCHEMA: u8 = 0x03;
    pub const CHANNEL: u8 = 0x04;
    pub const MESSAGE: u8 = 0x05;
    pub const CHUNK: u8 = 0x06;
    pub const MESSAGE_INDEX: u8 = 0x07;
    pub const CHUNK_INDEX: u8 = 0x08;
    pub const ATTACHMENT: u8 = 0x09;
    pub const ATTACHMENT_INDEX: u8 = 0x0A;
    pub const STATISTICS: u8 = 0x0B;
    pub const METADATA: u8 = 0x0C;
    pub const METADATA_INDEX: u8 = 0x0D;
    pub const SUMMARY_OFFSET: u8 = 0x0E;
    pub const DATA_END: u8 = 0x0F;
}
