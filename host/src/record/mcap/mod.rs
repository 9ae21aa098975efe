//! The MCAP container (version 0, `mcap.dev/spec`): only the parts that a run needs, with chunks
//! compressed by Zstandard; those of earlier versions, by LZ4, are read.
//!
//! Own code, because the published crate adds three procedural-macro stacks to the first build and
//! does not control when a chunk reaches the disk, which is needed to be "readable after a crash".
//! The reference reader for Python is used to test that other readers open these files.

mod write;

pub use mcdpr_twin::record::mcap::{Attachment, Contents, Damage, Message, ReadError, read};
pub use write::ChannelId;
pub(crate) use write::Writer;

#[cfg(test)]
mod tests {
    use super::{Writer, read};
    use mcdpr_protocol::frame::crc32;
    use mcdpr_twin::record::mcap::{MAGIC, op};

    fn file(messages: u32) -> Vec<u8> {
        let mut out = Vec::new();
        let mut writer = Writer::new(&mut out, "mcdpr", 300).unwrap();
        writer.metadata("run", &[("seed", "7")]).unwrap();
        writer
            .attachment("robot.toml", "application/toml", b"name = \"r\"", 5)
            .unwrap();
        let schema = writer.schema("S", "jsonschema", b"{}").unwrap();
        let one = writer.channel(Some(schema), "/one", "json", &[]).unwrap();
        let raw = writer.channel(None, "/raw", "octet-stream", &[]).unwrap();
        for number in 0..messages {
            let channel = if number % 3 == 0 { raw } else { one };
            let body = [number.to_le_bytes().as_slice(), &[7; 20]].concat();
            writer
                .message(channel, number, u64::from(number) * 10, &body)
                .unwrap();
        }
        writer.finish().unwrap();
        out
    }

    #[test]
    fn what_was_written_is_read_in_order() {
        let bytes = file(100);
        let contents = read(&bytes).unwrap();
        assert!(contents.damage.is_none());
        assert_eq!(contents.messages.len(), 100);
        for (number, message) in (0_u32..).zip(&contents.messages) {
            assert_eq!(message.sequence, number);
            assert_eq!(message.log_time_ns, u64::from(number) * 10);
            assert_eq!(message.data[..4], number.to_le_bytes());
            let topic = if number % 3 == 0 { "/raw" } else { "/one" };
            assert_eq!(contents.topic(message.channel), Some(topic));
        }
        assert_eq!(contents.metadata["run"]["seed"], "7");
        assert_eq!(contents.attachments[0].name, "robot.toml");
        assert_eq!(contents.attachments[0].data, b"name = \"r\"");
    }

    #[test]
    fn chunks_packed_by_lz4_are_read() {
        let mut message = vec![op::MESSAGE];
        message.extend_from_slice(&27_u64.to_le_bytes());
        message.extend_from_slice(&1_u16.to_le_bytes());
        message.extend_from_slice(&9_u32.to_le_bytes());
        message.extend_from_slice(&[3_u64.to_le_bytes(), 3_u64.to_le_bytes()].concat());
        message.extend_from_slice(b"hello");
        let mut packer = lz4_flex::frame::FrameEncoder::new(Vec::new());
        std::io::Write::write_all(&mut packer, &message).unwrap();
        let packed = packer.finish().unwrap();
        let mut chunk = [3_u64.to_le_bytes(), 3_u64.to_le_bytes()].concat();
        chunk.extend_from_slice(&(message.len() as u64).to_le_bytes());
        chunk.extend_from_slice(&crc32(&message).to_le_bytes());
        chunk.extend_from_slice(&3_u32.to_le_bytes());
        chunk.extend_from_slice(b"lz4");
        chunk.extend_from_slice(&(packed.len() as u64).to_le_bytes());
        chunk.extend_from_slice(&packed);
        let mut bytes = MAGIC.to_vec();
        bytes.push(op::CHUNK);
        bytes.extend_from_slice(&(chunk.len() as u64).to_le_bytes());
        bytes.extend_from_slice(&chunk);
        let contents = read(&bytes).unwrap();
        assert_eq!(contents.messages.len(), 1);
        assert_eq!(contents.messages[0].data, b"hello");
        assert_eq!(contents.messages[0].sequence, 9);
    }

    #[test]
    fn a_file_cut_anywhere_gives_every_whole_chunk_before_the_cut() {
        let bytes = file(100);
        let mut most = 0;
        for cut in 0..bytes.len() {
            match read(&bytes[..cut]) {
                Err(_) => assert!(cut < 8, "a file with its magic is readable, cut at {cut}"),
                Ok(contents) => {
                    assert!(contents.damage.is_some(), "cut at {cut}");
                    assert!(contents.messages.len() >= most, "cut at {cut}");
                    most = contents.messages.len();
                    for (number, message) in (0_u32..).zip(&contents.messages) {
                        assert_eq!(message.sequence, number, "cut at {cut}");
                    }
                }
            }
        }
        assert_eq!(most, 100);
    }

    #[test]
    fn any_flipped_byte_is_found_or_harmless_and_never_a_panic() {
        let bytes = file(30);
        let whole = read(&bytes).unwrap();
        for at in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x41;
            let Ok(contents) = read(&damaged) else {
                continue;
            };
            // A message that is given is one that was written.
            for message in &contents.messages {
                let same = whole.messages.get(message.sequence as usize);
                assert_eq!(same.map(|m| &m.data), Some(&message.data), "byte {at}");
            }
        }
    }
}
