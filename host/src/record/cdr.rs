//! Messages of ROS 2 as bytes: little-endian CDR, and the definitions that a bag holds of them.
//!
//! Source: OMG, DDS-XTypes 1.3, clause 7.4.1 (plain CDR, version 1); the message definitions of common_interfaces
//! and geometry2 (ROS 2 Humble).

/// Bytes of one message.
pub(crate) struct Cdr(Vec<u8>);

impl Cdr {
    /// Begins with the encapsulation header: CDR, little-endian.
    pub(crate) fn new() -> Self {
        Self(vec![0, 1, 0, 0])
    }

    /// Each number begins at a multiple of its size, counted behind the header.
    fn align(&mut self, size: usize) {
        while !(self.0.len() - 4).is_multiple_of(size) {
            self.0.push(0);
        }
    }

    pub(crate) fn u8(&mut self, value: u8) -> &mut Self {
        self.0.push(value);
        self
    }

    pub(crate) fn u32(&mut self, value: u32) -> &mut Self {
        self.align(4);
        self.0.extend_from_slice(&value.to_le_bytes());
        self
    }

    pub(crate) fn f64(&mut self, value: f64) -> &mut Self {
        self.align(8);
        self.0.extend_from_slice(&value.to_le_bytes());
        self
    }

    /// Numbers of an array of fixed length: no count before them.
    pub(crate) fn f64s<'a>(&mut self, values: impl IntoIterator<Item = &'a f64>) -> &mut Self {
        for value in values {
            self.f64(*value);
        }
        self
    }

    /// A count before the elements of a sequence.
    pub(crate) fn count(&mut self, count: usize) -> &mut Self {
        self.u32(u32::try_from(count).unwrap_or(u32::MAX))
    }

    /// A sequence of numbers.
    pub(crate) fn sequence(&mut self, values: &[f64]) -> &mut Self {
        self.count(values.len()).f64s(values)
    }

    pub(crate) fn text(&mut self, text: &str) -> &mut Self {
        // A text's count includes its terminating zero.
        self.count(text.len() + 1);
        self.0.extend_from_slice(text.as_bytes());
        self.u8(0)
    }

    pub(crate) fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.count(bytes.len());
        self.0.extend_from_slice(bytes);
        self
    }

    /// `std_msgs/Header`.
    pub(super) fn header(&mut self, time_ns: u64, frame: &str) -> &mut Self {
        // `int32` in ROS: the same bits until 2038.
        let seconds = u32::try_from(time_ns / 1_000_000_000).unwrap_or(u32::MAX);
        let rest = u32::try_from(time_ns % 1_000_000_000).unwrap_or(0);
        self.u32(seconds).u32(rest).text(frame)
    }

    pub(crate) fn done(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.0)
    }
}

/// A type and the fields of it; those that it holds are named after it.
struct Kind {
    name: &'static str,
    fields: &'static str,
    holds: &'static [&'static str],
}

const KINDS: [Kind; 16] = [
    Kind {
        name: "builtin_interfaces/Time",
        fields: "int32 sec\nuint32 nanosec\n",
        holds: &[],
    },
    Kind {
        name: "std_msgs/Header",
        fields: "builtin_interfaces/Time stamp\nstring frame_id\n",
        holds: &["builtin_interfaces/Time"],
    },
    Kind {
        name: "sensor_msgs/JointState",
        fields: "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
        holds: &["std_msgs/Header"],
    },
    Kind {
        name: "geometry_msgs/Vector3",
        fields: "float64 x\nfloat64 y\nfloat64 z\n",
        holds: &[],
    },
    Kind {
        name: "geometry_msgs/Quaternion",
        fields: "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
        holds: &[],
    },
    Kind {
        name: "geometry_msgs/Transform",
        fields: "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
        holds: &["geometry_msgs/Vector3", "geometry_msgs/Quaternion"],
    },
    Kind {
        name: "geometry_msgs/TransformStamped",
        fields: "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
        holds: &["std_msgs/Header", "geometry_msgs/Transform"],
    },
    Kind {
        name: "tf2_msgs/TFMessage",
        fields: "geometry_msgs/TransformStamped[] transforms\n",
        holds: &["geometry_msgs/TransformStamped"],
    },
    Kind {
        name: "geometry_msgs/Wrench",
        fields: "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
        holds: &["geometry_msgs/Vector3"],
    },
    Kind {
        name: "geometry_msgs/WrenchStamped",
        fields: "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n",
        holds: &["std_msgs/Header", "geometry_msgs/Wrench"],
    },
    Kind {
        name: "diagnostic_msgs/KeyValue",
        fields: "string key\nstring value\n",
        holds: &[],
    },
    Kind {
        name: "diagnostic_msgs/DiagnosticStatus",
        fields: "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values\n",
        holds: &["diagnostic_msgs/KeyValue"],
    },
    Kind {
        name: "diagnostic_msgs/DiagnosticArray",
        fields: "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
        holds: &["std_msgs/Header", "diagnostic_msgs/DiagnosticStatus"],
    },
    Kind {
        name: "sensor_msgs/CompressedImage",
        fields: "std_msgs/Header header\nstring format\nuint8[] data\n",
        holds: &["std_msgs/Header"],
    },
    Kind {
        name: "sensor_msgs/RegionOfInterest",
        fields: "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n",
        holds: &[],
    },
    Kind {
        name: "sensor_msgs/CameraInfo",
        fields: "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n",
        holds: &["std_msgs/Header", "sensor_msgs/RegionOfInterest"],
    },
];

/// The definition of a type, such as `sensor_msgs/JointState`, with all that it holds, as bags have it.
pub(super) fn definition(name: &str) -> String {
    let find = |name: &str| KINDS.iter().find(|kind| kind.name == name);
    let Some(kind) = find(name) else {
        return String::new();
    };
    let mut text = kind.fields.to_owned();
    let mut seen = vec![name];
    let mut left: Vec<&str> = kind.holds.to_vec();
    while let Some(name) = left.pop() {
        if seen.contains(&name) {
            continue;
        }
        seen.push(name);
        if let Some(kind) = find(name) {
            text += &format!("{}\nMSG: {name}\n{}", "=".repeat(80), kind.fields);
            left.extend(kind.holds);
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_begin_at_multiples_of_their_size_behind_the_header() {
        let bytes = Cdr::new().u8(7).f64(1.0).text("ab").u32(5).done();
        let wanted = [
            [0, 1, 0, 0].as_slice(),
            &[7, 0, 0, 0, 0, 0, 0, 0],
            &1.0_f64.to_le_bytes(),
            &[3, 0, 0, 0, b'a', b'b', 0, 0],
            &[5, 0, 0, 0],
        ];
        assert_eq!(bytes, wanted.concat());
    }

    #[test]
    fn a_definition_holds_every_type_once() {
        let text = definition("tf2_msgs/TFMessage");
        for name in [
            "geometry_msgs/TransformStamped",
            "std_msgs/Header",
            "builtin_interfaces/Time",
        ] {
            assert_eq!(text.matches(&format!("MSG: {name}\n")).count(), 1, "{text}");
        }
        assert!(text.starts_with("geometry_msgs/TransformStamped[] transforms\n"));
    }
}
