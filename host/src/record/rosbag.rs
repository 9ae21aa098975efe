//! A recorded run as a bag of ROS 2: MCAP with messages in CDR, and `metadata.yaml` beside it.
//!
//! Source: rosbag2 (storage plugin mcap, metadata version 5) and the profile `ros2` of the MCAP registry.

use super::cdr::definition;
use super::mcap::{ChannelId, ReadError, Writer, read};
use super::ros2::{self, Condition, Encoded, Frame};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io;

/// Bytes of a chunk.
const CHUNK_BYTES: usize = 1 << 20;

/// A bag: the file, its description, and how many messages it has of each topic.
pub(crate) struct Bag {
    pub(crate) mcap: Vec<u8>,
    pub(crate) metadata: String,
    pub(crate) topics: Vec<Topic>,
}

/// A topic of a bag.
pub(crate) struct Topic {
    pub(crate) name: String,
    /// The message's type, as `sensor_msgs/JointState`.
    pub(crate) kind: &'static str,
    pub(crate) messages: u64,
}

/// What keeps a record from becoming a bag.
#[derive(Debug, thiserror::Error)]
pub(crate) enum BagError {
    #[error(transparent)]
    Read(#[from] ReadError),
    #[error("writing the bag: {0}")]
    Write(#[from] io::Error),
    #[error("the record has nothing that a bag could hold")]
    Empty,
}

/// A message on its way into the bag.
struct Message {
    topic: String,
    kind: &'static str,
    time_ns: u64,
    data: Vec<u8>,
}

/// Collects what a record's messages become.
#[derive(Default)]
struct Bagger {
    robot: String,
    out: Vec<Message>,
    tensions_n: Vec<f64>,
}

/// Makes a bag of a record's bytes. `robot` names the hardware; the file will be `file` in its folder.
pub(crate) fn bag(record: &[u8], robot: &str, file: &str) -> Result<Bag, BagError> {
    let contents = read(record)?;
    let mut bagger = Bagger {
        robot: robot.to_owned(),
        ..Bagger::default()
    };
    for message in &contents.messages {
        let topic = contents.topic(message.channel).unwrap_or_default();
        let Ok(body) = serde_json::from_slice::<Value>(&message.data) else {
            // The bytes of the line.
            continue;
        };
        bagger.take(topic, message.log_time_ns, &body);
    }
    write(bagger.out, file)
}

fn write(mut messages: Vec<Message>, file: &str) -> Result<Bag, BagError> {
    // Ticks are dated back from the end of their block: the record is not in order of time.
    messages.sort_by_key(|message| message.time_ns);
    let (Some(first), Some(last)) = (messages.first(), messages.last()) else {
        return Err(BagError::Empty);
    };
    let span_ns = (first.time_ns, last.time_ns);
    let mut mcap = Vec::new();
    let mut writer = Writer::new(&mut mcap, "ros2", CHUNK_BYTES)?;
    let mut schemas: BTreeMap<&str, u16> = BTreeMap::new();
    let mut channels: BTreeMap<&str, (ChannelId, &'static str, u64)> = BTreeMap::new();
    for message in &messages {
        if !channels.contains_key(message.topic.as_str()) {
            let schema = match schemas.get(message.kind) {
                Some(schema) => *schema,
                None => {
                    let text = definition(message.kind);
                    let full = full_name(message.kind);
                    let schema = writer.schema(&full, "ros2msg", text.as_bytes())?;
                    schemas.insert(message.kind, schema);
                    schema
                }
            };
            let channel = {
                // rosbag2 keeps the quality of service in the channel as well as in the metadata;
                // readers compare both.
                let qos = quality_of_service(&message.topic);
                let metadata = [("offered_qos_profiles", qos.as_str())];
                writer.channel(Some(schema), &message.topic, "cdr", &metadata)?
            };
            channels.insert(&message.topic, (channel, message.kind, 0));
        }
    }
    for message in &messages {
        if let Some((channel, _, count)) = channels.get_mut(message.topic.as_str()) {
            *count += 1;
            let sequence = u32::try_from(*count).unwrap_or(u32::MAX);
            writer.message(*channel, sequence, message.time_ns, &message.data)?;
        }
    }
    writer.finish()?;
    let topics: Vec<_> = channels
        .iter()
        .map(|(name, (_, kind, messages))| Topic {
            name: (*name).to_owned(),
            kind,
            messages: *messages,
        })
        .collect();
    drop(channels);
    Ok(Bag {
        mcap,
        metadata: metadata(&topics, span_ns, file),
        topics,
    })
}

/// `sensor_msgs/JointState` as ROS 2 names the type.
fn full_name(kind: &str) -> String {
    kind.replacen('/', "/msg/", 1)
}

/// What `metadata.yaml` says.
fn metadata(topics: &[Topic], (from_ns, to_ns): (u64, u64), file: &str) -> String {
    let total: u64 = topics.iter().map(|topic| topic.messages).sum();
    let mut text = String::from("rosbag2_bagfile_information:\n  version: 5\n");
    let span = |indent: &str| {
        format!(
            "{indent}starting_time:\n{indent}  nanoseconds_since_epoch: {from_ns}\n\
             {indent}duration:\n{indent}  nanoseconds: {}\n{indent}message_count: {total}\n",
            to_ns - from_ns
        )
    };
    text += "  storage_identifier: mcap\n";
    text += &span("  ");
    text += "  topics_with_message_count:\n";
    for Topic {
        name,
        kind,
        messages,
    } in topics
    {
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "    - topic_metadata:\n        name: {name}\n        type: {}\n        \
             serialization_format: cdr\n        offered_qos_profiles: \"{}\"\n      \
             message_count: {messages}\n",
            full_name(kind),
            quality_of_service(name).replace('\n', "\\n")
        );
    }
    text += "  compression_format: \"\"\n  compression_mode: \"\"\n";
    let _ = write!(
        text,
        "  relative_file_paths:\n    - {file}\n  files:\n    - path: {file}\n"
    );
    text += &span("      ");
    text
}

impl Bagger {
    fn put(&mut self, topic: &str, time_ns: u64, message: Encoded) {
        self.out.push(Message {
            topic: topic.to_owned(),
            kind: message.kind,
            time_ns,
            data: message.data,
        });
    }

    fn take(&mut self, topic: &str, time_ns: u64, body: &Value) {
        match topic {
            "/cables" => self.cables(time_ns, body),
            "/tf" => self.transform(time_ns, body),
            "/scene" => self.pulls(time_ns, body),
            "/status" => self.status(time_ns, body),
            "/camera/image" => self.image(time_ns, body),
            "/camera/calibration" => self.lens(time_ns, body),
            _ => {}
        }
    }

    fn cables(&mut self, time_ns: u64, body: &Value) {
        let lengths = numbers(&body["length_m"]);
        self.tensions_n = numbers(&body["tension_n"]);
        let message = ros2::joint_state(time_ns, &lengths, &[], &self.tensions_n);
        self.put("/joint_states", time_ns, message);
    }

    fn transform(&mut self, time_ns: u64, body: &Value) {
        let text = |key: &str| body[key].as_str().unwrap_or_default();
        let parent = text("parent_frame_id");
        let message = ros2::transforms(
            time_ns,
            &[Frame {
                parent,
                child: text("child_frame_id").to_owned(),
                place_m: part(&body["translation"], ["x", "y", "z"]),
                turn_xyzw: part(&body["rotation"], ["x", "y", "z", "w"]),
            }],
        );
        // Only frames in the world move; those on the platform are constant.
        let topic = if parent == "world" {
            "/tf"
        } else {
            "/tf_static"
        };
        self.put(topic, time_ns, message);
    }

    fn pulls(&mut self, time_ns: u64, body: &Value) {
        let cables = body["entities"]
            .as_array()
            .and_then(|entities| entities.iter().find(|entity| entity["id"] == "cables"));
        let Some(points) = cables.and_then(|cables| cables["lines"][0]["points"].as_array()) else {
            return;
        };
        let points: Vec<_> = points.iter().map(|p| part(p, ["x", "y", "z"])).collect();
        let pairs: Vec<_> = points.chunks_exact(2).map(<[_]>::to_vec).collect();
        for (cable, (ends, tension_n)) in pairs.iter().zip(self.tensions_n.clone()).enumerate() {
            let [from_m, to_m] = ends.as_slice() else {
                continue;
            };
            let pull = ros2::pull(time_ns, cable, from_m, to_m, tension_n);
            self.put(&pull.topic, time_ns, pull.wrench);
            self.put("/tf", time_ns, ros2::transforms(time_ns, &[pull.frame]));
        }
    }

    /// The board's state: an error while a fault is latched, a warning while a limit is touched.
    fn status(&mut self, time_ns: u64, body: &Value) {
        let state = body["state"].as_str().unwrap_or_default();
        let fault = body["fault"].as_str();
        let level = match (fault, body["limits"].as_u64()) {
            (Some(_), _) => Condition::Error,
            (None, Some(0) | None) => Condition::Ok,
            (None, Some(_)) => Condition::Warning,
        };
        let values = body.as_object().into_iter().flatten();
        let values = values.filter(|(key, _)| *key != "timestamp");
        let values: Vec<_> = values
            .map(|(key, value)| {
                let words = value.as_str();
                let words = words.map_or_else(|| value.to_string(), str::to_owned);
                (key.as_str(), words)
            })
            .collect();
        let said = fault.unwrap_or(state);
        let message = ros2::diagnostics(time_ns, level, said, &self.robot, &values);
        self.put("/diagnostics", time_ns, message);
    }

    fn image(&mut self, time_ns: u64, body: &Value) {
        let Some(data) = body["data"].as_str().and_then(from_base64) else {
            return;
        };
        let format = body["format"].as_str().unwrap_or("png");
        let message = ros2::picture(time_ns, format, &data);
        self.put("/camera/image/compressed", time_ns, message);
    }

    fn lens(&mut self, time_ns: u64, body: &Value) {
        let size = |key: &str| {
            let pixels = body[key].as_u64().unwrap_or(0);
            u32::try_from(pixels).unwrap_or(0)
        };
        let matrices = ["K", "R", "P"].map(|key| numbers(&body[key]));
        let model = body["distortion_model"].as_str().unwrap_or_default();
        let sizes = [size("width"), size("height")];
        let message = ros2::lens(time_ns, sizes, model, &numbers(&body["D"]), &matrices);
        self.put("/camera/camera_info", time_ns, message);
    }
}

fn numbers(value: &Value) -> Vec<f64> {
    let list = value.as_array().into_iter().flatten();
    list.map(|x| x.as_f64().unwrap_or(f64::NAN)).collect()
}

fn part<const N: usize>(value: &Value, keys: [&str; N]) -> [f64; N] {
    keys.map(|key| value[key].as_f64().unwrap_or(f64::NAN))
}

/// The bytes of a base64 text; `None` if it is not base64.
fn from_base64(text: &str) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(text.len() / 4 * 3);
    let (mut bits, mut count) = (0_u32, 0);
    for letter in text.trim_end_matches('=').bytes() {
        let value = match letter {
            b'A'..=b'Z' => letter - b'A',
            b'a'..=b'z' => letter - b'a' + 26,
            b'0'..=b'9' => letter - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        bits = (bits << 6) | u32::from(value);
        count += 6;
        if count >= 8 {
            count -= 8;
            out.push(u8::try_from((bits >> count) & 0xFF).ok()?);
        }
    }
    Some(out)
}

/// Quality of service of a topic, as YAML of rosbag2's versions before 9.
fn quality_of_service(topic: &str) -> String {
    // Transient local for what never changes: a late subscriber receives it, too.
    let durability = if topic == "/tf_static" { 1 } else { 2 };
    // Infinite, as rosbag2 writes a duration.
    let longest = "\n    sec: 2147483647\n    nsec: 4294967295";
    format!(
        "- history: 1\n  depth: 10\n  reliability: 1\n  durability: {durability}\n  deadline:{longest}\n  \
         lifespan:{longest}\n  liveliness: 1\n  liveliness_lease_duration:{longest}\n  \
         avoid_ros_namespace_conventions: false"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_read_and_nothing_else() {
        assert_eq!(from_base64("TWFu").as_deref(), Some(b"Man".as_slice()));
        assert_eq!(from_base64("TWE=").as_deref(), Some(b"Ma".as_slice()));
        assert_eq!(from_base64("T*"), None);
    }

    #[test]
    fn a_record_of_nothing_is_refused() {
        let mut bytes = Vec::new();
        Writer::new(&mut bytes, "mcdpr", 300)
            .unwrap()
            .finish()
            .unwrap();
        assert!(matches!(
            bag(&bytes, "robot", "a.mcap"),
            Err(BagError::Empty)
        ));
        assert!(matches!(
            bag(b"x", "robot", "a.mcap"),
            Err(BagError::Read(_))
        ));
    }
}
