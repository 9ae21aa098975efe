//! The robot as a model file for other simulators and viewers.
//!
//! | format | purpose | limitations |
//! |---|---|---|
//! | MJCF | MuJoCo: platform, swivelling pulleys, elastic cables on winches, sensors, camera, tags | a stiffness EA over a length that changes; distortion of the lens |
//! | URDF | viewers: platform, anchors, attachments, tool, camera, tags | cables: a URDF is a tree |
//!
//! Formats: the MuJoCo 3 XML reference (mujoco.readthedocs.io) and the URDF XML specification
//! (wiki.ros.org/urdf/XML).

mod mjcf;
mod urdf;

use crate::compute::{ComputeError, Subject};
use crate::machine;
use crate::robot::{Control, Robot, TagPlace};
use crate::sight::Scene;
use mcdpr_kinematics::{CablePath, Pose};
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::fmt::Write as _;

/// A format to write.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// MuJoCo's XML
    Mjcf,
    /// The Unified Robot Description Format: for display, it has no cables
    Urdf,
}

/// The cables that are elastic and hang on a winch, in MJCF; the others are forces.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Winches {
    /// Those that hold a length; a tension-held cable's actuator is its tension
    #[default]
    Held,
    /// All: for your own controller that holds tensions by the winches
    All,
}

/// The robot as a file of a format, hanging at its home with its tension-held cables at their
/// set-point (robots with six and more length-held cables: level, tensions in the middle).
///
/// # Errors
/// [`ComputeError`] if it cannot hang there, or its cables all lie in one plane.
pub fn write(robot: &Robot, format: Format, winches: Winches) -> Result<String, ComputeError> {
    let home = Home::of(robot, winches)?;
    Ok(match format {
        Format::Mjcf => mjcf::write(robot, &home),
        Format::Urdf => urdf::write(robot, &home),
    })
}

/// The robot at home.
struct Home {
    pose: Pose,
    paths: Vec<CablePath>,
    tensions_n: Vec<f64>,
    paid_out_m: Vec<f64>,
    winches: Winches,
    places: Vec<TagPlace>,
}

impl Home {
    fn of(robot: &Robot, winches: Winches) -> Result<Self, ComputeError> {
        let subject = Subject::new(robot.clone())?;
        let at_m = robot.tool.home_in_world_m;
        let (found, _) = subject.hang(&at_m, true, &subject.own_tensions(), None)?;
        let paths = subject.geometry.paths(&found.pose)?;
        let pairs = found.lengths_m.iter().zip(&found.tensions_n).enumerate();
        let places = match &robot.calibrated {
            Some(calibrated) => calibrated.places.clone(),
            None => Scene::on_floor(robot, 0.0, 0.0, 1).places,
        };
        Ok(Self {
            pose: found.pose,
            paths: paths.to_vec(),
            paid_out_m: pairs
                .map(|(i, (length, tension))| machine::paid_out_m(robot, i, *length, *tension))
                .collect(),
            tensions_n: found.tensions_n.to_vec(),
            winches,
            places,
        })
    }
}

/// Whether a cable is elastic and hangs on a winch.
fn on_winch(robot: &Robot, home: &Home, cable: usize) -> bool {
    let cable = robot.cables.get(cable);
    home.winches == Winches::All || cable.is_some_and(|cable| cable.control == Control::Position)
}

/// Half edges of the homogeneous box that has the platform's mass and inertia, m; 1 mm at least.
pub(crate) fn platform_half_size_m(robot: &Robot) -> Vector3<f64> {
    let moments: Vector3<f64> = robot.platform.inertia_kg_m2.diagonal();
    let sum = moments.sum() / 2.0;
    // I_x = m (y^2 + z^2) / 12 and its like, solved for the edges.
    let edges = moments.map(|moment| (12.0 / robot.platform.mass_kg * (sum - moment)).max(0.0));
    edges.map(|square| (square.sqrt() / 2.0).max(1e-3))
}

/// The frame of a swivelling pulley: x towards the attachment, z along the cable's way to the
/// anchor, which is the swivel axis.
fn pulley_frame(robot: &Robot, home: &Home, cable: usize) -> Option<Rotation3<f64>> {
    let axis = robot.cables.get(cable)?.swivel_axis_in_world;
    let path = home.paths.get(cable)?;
    let away = path.attachment_m - robot.cables.get(cable)?.anchor_in_world_m;
    let x = (away - axis * axis.dot(&away)).normalize();
    Some(Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[
        x,
        axis.cross(&x),
        axis,
    ])))
}

/// Numbers with spaces between, each in the shortest form that reads back exactly.
fn list<'a>(values: impl IntoIterator<Item = &'a f64>) -> String {
    let mut text = String::new();
    for value in values {
        let gap = if text.is_empty() { "" } else { " " };
        // Minus zero looks like a mistake.
        let _ = write!(text, "{gap}{}", value + 0.0);
    }
    text
}

/// A rotation as a quaternion w x y z.
fn quaternion(rotation: &Rotation3<f64>) -> String {
    let q = nalgebra::UnitQuaternion::from_rotation_matrix(rotation);
    list(&[q.w, q.i, q.j, q.k])
}

/// A text as the value of an attribute.
fn escaped(text: &str) -> String {
    let mut out = String::new();
    for letter in text.chars() {
        match letter {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            letter if letter.is_control() => out.push(' '),
            letter => out.push(letter),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_cannot_break_the_file() {
        let mut robot = Robot::built_in("paper-optimistic").unwrap();
        robot.name = "a \"b\" <c> & d--e\n".to_owned();
        for format in [Format::Mjcf, Format::Urdf] {
            let text = write(&robot, format, Winches::Held).unwrap();
            assert!(
                text.contains("a &quot;b&quot; &lt;c&gt; &amp; d--e"),
                "{text}"
            );
        }
    }

    #[test]
    fn a_robot_in_one_plane_is_refused() {
        let robot = Robot::built_in("planar-four").unwrap();
        let error = write(&robot, Format::Mjcf, Winches::All).unwrap_err();
        assert!(error.to_string().contains("planar"), "{error}");
    }
}
