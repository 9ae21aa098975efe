//! Requests and replies of services, as the two implementations of ROS 2 on DDS send them.
//!
//! rmw_fastrtps leaves the message as it is and names the request in the reply's inline parameters (DDS-RPC
//! 1.0, clause 7.8.2, "enhanced"). rmw_cyclonedds has 16 bytes before the message, which the reply repeats. The first two
//! bytes of a writer's identity are its vendor (DDSI-RTPS 2.5, clause 9.3.1.5), so that each call gets a reply of its own
//! kind.
//!
//! Source of both headers: rmw_fastrtps_shared_cpp (`custom_service_info.hpp`, `rmw_response.cpp`), rmw_cyclonedds_cpp
//! (`serdata.hpp`, `cdds_request_header_t`).

use rustdds::{GUID, SampleIdentity, SampleInfo, WriteOptions, WriteOptionsBuilder};

/// Vendor of Eclipse Cyclone DDS.
const CYCLONE: [u8; 2] = [0x01, 0x10];
/// Bytes before a message of rmw_cyclonedds: half of the client's identity, and the number of the request.
const HEADER: usize = 16;

/// What a reply must have for its caller to take it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Caller {
    /// Of rmw_cyclonedds, or of Cyclone DDS: this header.
    Cyclone([u8; HEADER]),
    /// Of all others.
    Enhanced(SampleIdentity),
}

/// The caller of a request, and its message; `None` for a request that is too short.
pub(crate) fn received(info: &SampleInfo, data: Vec<u8>) -> Option<(Caller, Vec<u8>)> {
    if info.writer_guid().to_bytes().starts_with(&CYCLONE) {
        let (header, message) = data.split_first_chunk::<HEADER>()?;
        return Some((Caller::Cyclone(*header), message.to_vec()));
    }
    let request = info.sample_identity();
    // A client of Fast DDS names the reader that waits for the reply.
    let named = info
        .related_sample_identity()
        .map(|named| named.writer_guid);
    let named = named.filter(|guid| *guid != GUID::GUID_UNKNOWN);
    let identity = SampleIdentity {
        writer_guid: named.unwrap_or(request.writer_guid),
        sequence_number: request.sequence_number,
    };
    Some((Caller::Enhanced(identity), data))
}

impl Caller {
    /// The bytes of a reply, and the options to send it with.
    pub(crate) fn reply(self, message: Vec<u8>) -> (Vec<u8>, WriteOptions) {
        match self {
            Self::Cyclone(header) => ([&header[..], &message].concat(), WriteOptions::default()),
            Self::Enhanced(request) => {
                let options = WriteOptionsBuilder::new().related_sample_identity(request);
                (message, options.build())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustdds::SequenceNumber;

    #[test]
    fn a_reply_has_what_its_caller_looks_for() {
        let header = [7; HEADER];
        let (bytes, options) = Caller::Cyclone(header).reply(vec![1, 2]);
        assert_eq!(bytes, [&header[..], &[1, 2]].concat());
        assert_eq!(options.related_sample_identity(), None);
        let request = SampleIdentity {
            writer_guid: GUID::from_bytes([3; 16]),
            sequence_number: SequenceNumber::new(5),
        };
        let (bytes, options) = Caller::Enhanced(request).reply(vec![1, 2]);
        assert_eq!(bytes, [1, 2]);
        assert_eq!(options.related_sample_identity(), Some(request));
    }
}
