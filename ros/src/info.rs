//! Which node has which topics: `ros_discovery_info`, by which `ros2 node list` knows a node.
//!
//! Source: rmw_dds_common, `ParticipantEntitiesInfo.msg` with the `Gid` of 16 bytes (ROS 2 Iron and later; that of
//! Humble has 24 bytes, and its graph does not show this node).

use rustdds::GUID;

pub(crate) const TOPIC: &str = "ros_discovery_info";
pub(crate) const KIND: &str = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";

/// The node, and what it reads and writes.
#[derive(Debug, Default)]
pub(crate) struct Entities {
    pub(crate) name: String,
    pub(crate) readers: Vec<GUID>,
    pub(crate) writers: Vec<GUID>,
}

impl Entities {
    /// The message, for the participant that has the node.
    pub(crate) fn encoded(&self, participant: GUID) -> Vec<u8> {
        let mut bytes = participant.to_bytes().to_vec();
        count(&mut bytes, 1);
        text(&mut bytes, "/");
        text(&mut bytes, &self.name);
        for guids in [&self.readers, &self.writers] {
            count(&mut bytes, guids.len());
            for guid in guids {
                bytes.extend(guid.to_bytes());
            }
        }
        bytes
    }
}

fn count(bytes: &mut Vec<u8>, count: usize) {
    while !bytes.len().is_multiple_of(4) {
        bytes.push(0);
    }
    let count = u32::try_from(count).unwrap_or(u32::MAX);
    bytes.extend(count.to_le_bytes());
}

fn text(bytes: &mut Vec<u8>, text: &str) {
    count(bytes, text.len() + 1);
    bytes.extend(text.as_bytes());
    bytes.push(0);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_message_is_that_of_rmw_dds_common() {
        let guid = |last| GUID::from_bytes([1, 18, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, last, 3]);
        let entities = Entities {
            name: "abc".to_owned(),
            readers: vec![guid(1)],
            writers: vec![],
        };
        let wanted = [
            &guid(9).to_bytes()[..],
            &[1, 0, 0, 0, 2, 0, 0, 0, b'/', 0, 0, 0],
            &[4, 0, 0, 0, b'a', b'b', b'c', 0],
            &[1, 0, 0, 0],
            &guid(1).to_bytes(),
            &[0, 0, 0, 0],
        ];
        assert_eq!(entities.encoded(guid(9)), wanted.concat());
    }
}
