//! Messages that are encoded already, for rustdds.

use rustdds::RepresentationIdentifier;
use rustdds::bytes::Bytes;
use rustdds::no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};
use std::convert::Infallible;

/// The bytes of a message: CDR, little-endian, without the encapsulation header.
pub(crate) type Raw = Vec<u8>;

/// Passes the bytes on.
pub(crate) struct AsIs;

impl SerializerAdapter<Raw> for AsIs {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(value: &Raw) -> Result<Bytes, Infallible> {
        Ok(Bytes::copy_from_slice(value))
    }
}

impl DeserializerAdapter<Raw> for AsIs {
    type Error = Infallible;
    type Decoded = Raw;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE]
    }

    fn transform_decoded(decoded: Raw) -> Raw {
        decoded
    }
}

impl DefaultDecoder<Raw> for AsIs {
    type Decoder = Copies;
    const DECODER: Copies = Copies;
}

/// Copies the bytes.
#[derive(Clone)]
pub(crate) struct Copies;

impl Decode<'_, Raw> for Copies {
    type Error = Infallible;

    fn decode_bytes(self, bytes: &[u8], _: RepresentationIdentifier) -> Result<Raw, Infallible> {
        Ok(bytes.to_owned())
    }
}
