//! The robot in messages of ROS 2, for bags and for the live bridge.
//!
//! Units are those of ROS (REP 103): m, m/s, N, rad; frames have x to the right of the robot file's world, z up.

use super::cdr::Cdr;

/// A message in CDR, with its encapsulation header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Encoded {
    /// Its type, such as `sensor_msgs/JointState`.
    pub(crate) kind: &'static str,
    /// Its bytes.
    pub(crate) data: Vec<u8>,
}

/// A frame in another.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Frame<'a> {
    /// The other.
    pub(crate) parent: &'a str,
    /// Its name.
    pub(crate) child: String,
    /// Its origin, m.
    pub(crate) place_m: [f64; 3],
    /// Its attitude, quaternion [x, y, z, w].
    pub(crate) turn_xyzw: [f64; 4],
}

/// Level of a `DiagnosticStatus`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Condition {
    /// Nothing to report.
    Ok = 0,
    /// A limit is touched.
    Warning = 1,
    /// A fault is latched.
    Error = 2,
    /// The board says nothing.
    Stale = 3,
}

fn encoded(kind: &'static str, cdr: &mut Cdr) -> Encoded {
    let data = cdr.done();
    Encoded { kind, data }
}

/// Winches as joints: position is the cable that is paid out (m), velocity its rate (m/s; may be empty), effort its
/// tension (N).
pub(crate) fn joint_state(
    time_ns: u64,
    lengths_m: &[f64],
    speeds_mps: &[f64],
    tensions_n: &[f64],
) -> Encoded {
    let mut out = Cdr::new();
    out.header(time_ns, "").count(lengths_m.len());
    for cable in 1..=lengths_m.len() {
        out.text(&format!("winch_{cable}"));
    }
    out.sequence(lengths_m)
        .sequence(speeds_mps)
        .sequence(tensions_n);
    encoded("sensor_msgs/JointState", &mut out)
}

/// Frames at one time.
pub(crate) fn transforms(time_ns: u64, frames: &[Frame<'_>]) -> Encoded {
    let mut out = Cdr::new();
    out.count(frames.len());
    for frame in frames {
        out.header(time_ns, frame.parent)
            .text(&frame.child)
            .f64s(&frame.place_m)
            .f64s(&frame.turn_xyzw);
    }
    encoded("tf2_msgs/TFMessage", &mut out)
}

/// What one cable pulls with.
pub(crate) struct Pull {
    /// Topic of the wrench.
    pub(crate) topic: String,
    /// Force on the platform at the attachment, world axes.
    pub(crate) wrench: Encoded,
    /// The frame in which it is: at the attachment, along the world's axes.
    pub(crate) frame: Frame<'static>,
}

/// What a cable (from 0) pulls with, from where it leaves its pulley to its attachment (world, m).
pub(crate) fn pull(
    time_ns: u64,
    cable: usize,
    from_m: &[f64; 3],
    to_m: &[f64; 3],
    tension_n: f64,
) -> Pull {
    let mut force_n = *from_m;
    // From the attachment towards the pulley: a cable pulls.
    for (value, end) in force_n.iter_mut().zip(to_m) {
        *value -= end;
    }
    let length_m = force_n.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-9);
    for value in &mut force_n {
        *value *= tension_n / length_m;
    }
    let child = format!("attachment_{}", cable + 1);
    let mut out = Cdr::new();
    out.header(time_ns, &child).f64s(&force_n).f64s(&[0.0; 3]);
    Pull {
        topic: format!("/cables/cable_{}/wrench", cable + 1),
        wrench: encoded("geometry_msgs/WrenchStamped", &mut out),
        frame: Frame {
            parent: "world",
            child,
            place_m: *to_m,
            turn_xyzw: [0.0, 0.0, 0.0, 1.0],
        },
    }
}

/// The state of the board in words, with values.
pub(crate) fn diagnostics(
    time_ns: u64,
    level: Condition,
    said: &str,
    robot: &str,
    values: &[(&str, String)],
) -> Encoded {
    let mut out = Cdr::new();
    out.header(time_ns, "")
        .count(1)
        .u8(level as u8)
        .text("mcdpr: board")
        .text(said)
        .text(robot)
        .count(values.len());
    for (key, value) in values {
        out.text(key).text(value);
    }
    encoded("diagnostic_msgs/DiagnosticArray", &mut out)
}

/// A picture in its file's format.
pub(crate) fn picture(time_ns: u64, format: &str, data: &[u8]) -> Encoded {
    let mut out = Cdr::new();
    out.header(time_ns, "camera").text(format).bytes(data);
    encoded("sensor_msgs/CompressedImage", &mut out)
}

/// The camera's lens: size in pixels, distortion, and the matrices K (9 numbers), R (9) and P (12), row by row.
pub(crate) fn lens(
    time_ns: u64,
    [width, height]: [u32; 2],
    model: &str,
    distortion: &[f64],
    matrices: &[Vec<f64>; 3],
) -> Encoded {
    let mut out = Cdr::new();
    out.header(time_ns, "camera")
        .u32(height)
        .u32(width)
        .text(model)
        .sequence(distortion);
    for (matrix, count) in matrices.iter().zip([9, 9, 12]) {
        let mut matrix = matrix.clone();
        // CDR has no count for arrays of fixed length: a short one would shift all that follows.
        matrix.resize(count, 0.0);
        out.f64s(&matrix);
    }
    // No binning, the whole picture, not rectified.
    out.u32(0).u32(0);
    out.u32(0).u32(0).u32(0).u32(0).u8(0);
    encoded("sensor_msgs/CameraInfo", &mut out)
}
