//! The lines of standard input and output, one JSON document each.
//!
//! `host/src/ros/pipe.rs` has the other end of both.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// What the other program asks for.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Order {
    /// The name of the node, without namespace.
    Node {
        /// Such as `mcdpr`.
        name: String,
    },
    /// A topic to publish.
    Writer {
        /// Number for its samples.
        id: u32,
        /// DDS name, such as `rt/joint_states`.
        topic: String,
        /// DDS type, such as `sensor_msgs::msg::dds_::JointState_`.
        kind: String,
        /// Whether a late subscriber receives the last samples (durability transient local).
        #[serde(default)]
        keep: bool,
    },
    /// A service to offer.
    Service {
        /// Number for its calls.
        id: u32,
        /// ROS name without the leading slash, such as `mcdpr/stop`.
        name: String,
        /// Type without the ending, such as `std_srvs::srv::dds_::Trigger`.
        kind: String,
    },
    /// A sample to send.
    Sample {
        /// The topic's number.
        id: u32,
        /// CDR, little-endian, without the encapsulation header.
        data: Hex,
    },
    /// The reply to a call.
    Reply {
        /// Number of the call.
        call: u64,
        /// CDR, little-endian, without the encapsulation header.
        data: Hex,
    },
}

/// A line to the other program.
#[derive(Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Said {
    /// A service was called.
    Call {
        /// The service's number.
        service: u32,
        /// Number of the call, for its reply.
        call: u64,
        /// CDR, little-endian, without the encapsulation header.
        data: Hex,
    },
}

/// Bytes as hexadecimal digits.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Hex(pub(crate) Vec<u8>);

impl Serialize for Hex {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let digits: String = self.0.iter().map(|byte| format!("{byte:02x}")).collect();
        to.serialize_str(&digits)
    }
}

impl<'de> Deserialize<'de> for Hex {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let digits = String::deserialize(from)?;
        read(&digits)
            .ok_or_else(|| serde::de::Error::custom("these are no hexadecimal digits in pairs"))
    }
}

fn read(digits: &str) -> Option<Hex> {
    let value = |digit: u8| {
        char::from(digit)
            .to_digit(16)
            .and_then(|d| u8::try_from(d).ok())
    };
    let pairs = digits.as_bytes().chunks(2).map(|pair| match pair {
        [high, low] => Some(value(*high)? << 4 | value(*low)?),
        _ => None,
    });
    pairs.collect::<Option<_>>().map(Hex)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_as_they_are_written() {
        let order = r#"{"sample":{"id":3,"data":"00ff7f"}}"#;
        let order: Order = serde_json::from_str(order).unwrap();
        assert!(matches!(order, Order::Sample { id: 3, data } if data.0 == [0, 255, 127]));
        for wrong in ["0", "0g", "é"] {
            let line = format!(r#"{{"reply":{{"call":1,"data":"{wrong}"}}}}"#);
            assert!(serde_json::from_str::<Order>(&line).is_err(), "{line}");
        }
        let said = Said::Call {
            service: 1,
            call: 2,
            data: Hex(vec![0, 171]),
        };
        let wanted = r#"{"call":{"service":1,"call":2,"data":"00ab"}}"#;
        assert_eq!(serde_json::to_string(&said).unwrap(), wanted);
    }
}
