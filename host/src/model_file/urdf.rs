//! URDF, for display. Its joints form a tree, so it contains no cables, but the anchors, and the
//! attachments on a floating platform.

use super::{Home, escaped, list, platform_half_size_m, pulley_frame};
use crate::robot::Robot;
use mcdpr_kinematics::{Pose, rpy_from_rotation};
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::fmt::Write as _;

/// Radius of the ball that represents a point, m.
const BALL_M: f64 = 0.004;

/// The robot at home.
pub(super) fn write(robot: &Robot, home: &Home) -> String {
    let mut out = format!(
        "<?xml version=\"1.0\"?>\n<!-- Written by mcdpr {}, for display: a URDF is a tree and holds no \
         cables. -->\n<robot name=\"{}\">\n  <link name=\"world\"/>\n",
        env!("CARGO_PKG_VERSION"),
        escaped(&robot.name)
    );
    for (index, cable) in robot.cables.iter().enumerate() {
        let number = index + 1;
        let frame = pulley_frame(robot, home, index).unwrap_or_else(Rotation3::identity);
        let at = Pose::new(cable.anchor_in_world_m, frame);
        let radius = cable.pulley_radius_m;
        let shape = if radius > 0.0 {
            // A cylinder's axis is its z: here the pulley's y.
            format!(
                "<origin xyz=\"{radius} 0 0\" rpy=\"{} 0 0\"/><geometry><cylinder radius=\"{radius}\" \
                 length=\"{}\"/></geometry>",
                std::f64::consts::FRAC_PI_2,
                radius / 2.0
            )
        } else {
            ball()
        };
        link(&mut out, &format!("anchor_{number}"), &shape);
        joint(&mut out, "fixed", "world", &format!("anchor_{number}"), &at);
    }
    let platform = &robot.platform;
    let i = &platform.inertia_kg_m2;
    let center = list(&platform.center_of_mass_m);
    let _ = write!(
        out,
        r#"  <link name="platform">
    <inertial>
      <origin xyz="{center}"/><mass value="{}"/>
      <inertia ixx="{}" iyy="{}" izz="{}" ixy="{}" ixz="{}" iyz="{}"/>
    </inertial>
    <visual><origin xyz="{center}"/><geometry><box size="{}"/></geometry></visual>
  </link>
"#,
        platform.mass_kg,
        i[(0, 0)],
        i[(1, 1)],
        i[(2, 2)],
        i[(0, 1)],
        i[(0, 2)],
        i[(1, 2)],
        list(&(platform_half_size_m(robot) * 2.0)),
    );
    joint(&mut out, "floating", "world", "platform", &home.pose);
    let level = |at: &Vector3<f64>| Pose::level(*at);
    for (index, cable) in robot.cables.iter().enumerate() {
        let name = format!("attachment_{}", index + 1);
        link(&mut out, &name, &ball());
        let at = level(&cable.attachment_in_platform_m);
        joint(&mut out, "fixed", "platform", &name, &at);
    }
    link(&mut out, "tool", &ball());
    let tool = level(&robot.tool.tcp_in_platform_m);
    joint(&mut out, "fixed", "platform", "tool", &tool);
    // Its frame is that of the picture: x right, y down, z forward (camera_optical_frame of REP 103).
    out.push_str("  <link name=\"camera\"/>\n");
    let camera = robot.camera.camera_from_platform.inverse();
    joint(&mut out, "fixed", "platform", "camera", &camera);
    for place in &home.places {
        for tag in robot.tags.iter().filter(|tag| tag.body == place.body) {
            let [a, b, c, d] = &tag.corners_in_body_m;
            let x = (b - a).normalize();
            let z = x.cross(&(d - a)).normalize();
            let frame = Matrix3::from_columns(&[x, z.cross(&x), z]);
            let body_from_tag = Pose::new(
                (a + b + c + d) / 4.0,
                Rotation3::from_matrix_unchecked(frame),
            );
            let name = format!("tag_{}", tag.id);
            let size = tag.size_m;
            let shape = format!("<geometry><box size=\"{size} {size} 0.001\"/></geometry>");
            link(&mut out, &name, &shape);
            let place = place.world_from_body.compose(&body_from_tag);
            joint(&mut out, "fixed", "world", &name, &place);
        }
    }
    out.push_str("</robot>\n");
    out
}

fn ball() -> String {
    format!("<geometry><sphere radius=\"{BALL_M}\"/></geometry>")
}

fn link(out: &mut String, name: &str, shape: &str) {
    let _ = writeln!(
        out,
        "  <link name=\"{name}\"><visual>{shape}</visual></link>"
    );
}

fn joint(out: &mut String, kind: &str, parent: &str, child: &str, at: &Pose) {
    let _ = writeln!(
        out,
        "  <joint name=\"{child}\" type=\"{kind}\"><parent link=\"{parent}\"/><child \
         link=\"{child}\"/><origin xyz=\"{}\" rpy=\"{}\"/></joint>",
        list(&at.position_m),
        list(&rpy_from_rotation(&at.rotation))
    );
}
