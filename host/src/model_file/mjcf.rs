//! MuJoCo's XML. A pulley is a sphere around which its cable wraps, on a hinge about its swivel
//! axis: the cable lies in the plane of the sphere's middle, the drum and the attachment, which at
//! rest is the pulley's own, so that its path equals that of the kinematics crate, without
//! approximation. On a cylinder MuJoCo's cables slide sideways, unlike in a groove, and turn the
//! pulley away. A winch is a slide behind the pulley that takes cable up.

use super::{Home, escaped, list, on_winch, platform_half_size_m, pulley_frame, quaternion};
use crate::robot::{Robot, TagPlace};
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::fmt::Write as _;

/// Time step, s: cables and winch drives are stiff.
const STEP_S: f64 = 2e-4;
/// Stiffness of a winch that holds a length, N/m: a micrometre under 100 N.
const HOLDING_N_PER_M: f64 = 1e8;
/// Mass and inertia of a swivelling pulley: enough to integrate, too little to matter.
const PULLEY_KG: f64 = 0.02;
const PULLEY_KG_M2: f64 = 2e-6;
/// Damping of a pulley's swivel, N m s/rad.
const SWIVEL_NMS: f64 = 2e-4;
/// Least distance from the drum's site to the anchor, in pulley radii and m.
const BEHIND_RADII: f64 = 3.0;
const BEHIND_M: f64 = 0.02;
/// Mass of a winch at its cable that is integrated at least, kg.
const WINCH_KG: f64 = 0.5;

/// The robot at home.
pub(super) fn write(robot: &Robot, home: &Home) -> String {
    let mut out = String::new();
    let _ = write!(
        out,
        r#"<?xml version="1.0"?>
<!-- Written by mcdpr {version}. SI units, world z up, cables counted from 1.

  cable_i     tendon from winch_i's drum around pulley_i to the platform. Pulleys are exact: where they
              have swivelled towards the platform, the tangent points are the robot's.
  winch_i     of a cable on a winch: how much it has taken up since home, m; paid-out length =
              home's less that. Its spring has the stiffness EA / (paid-out length + routing) of home:
              elsewhere EA is off by as much as that length has changed (set tendon_stiffness to follow).
  tension_i   of a tension-held cable: its tension, N; such a cable has no stretch of its own.
  Not in this file: friction, gears, drives, sensor errors; the lens's distortion and principal point;
  contacts. -->
<mujoco model="{name}">
  <compiler angle="radian" autolimits="true" inertiafromgeom="false"/>
  <option timestep="{STEP_S}" gravity="0 0 -{gravity}" integrator="implicitfast"/>
  <default>
    <geom contype="0" conaffinity="0" mass="0"/>
    <site size="0.004" rgba="0.8 0.3 0.1 1"/>
    <tendon width="0.0015" rgba="0.2 0.2 0.25 1"/>
  </default>
  <visual><global offwidth="{width}" offheight="{height}"/></visual>
  <worldbody>
    <light pos="0 0 3" dir="0 0 -1"/>
"#,
        version = env!("CARGO_PKG_VERSION"),
        name = escaped(&robot.name),
        gravity = mcdpr_kinematics::GRAVITY_MPS2,
        width = robot.camera.lens.size_px[0].max(640),
        height = robot.camera.lens.size_px[1].max(480),
    );
    for cable in 0..robot.cables.len() {
        winch(&mut out, robot, home, cable);
    }
    platform(&mut out, robot, home);
    tags(&mut out, robot, home);
    out.push_str("  </worldbody>\n  <tendon>\n");
    for cable in 0..robot.cables.len() {
        tendon(&mut out, robot, home, cable);
    }
    out.push_str("  </tendon>\n  <actuator>\n");
    for cable in 0..robot.cables.len() {
        actuator(&mut out, robot, home, cable);
    }
    out.push_str("  </actuator>\n  <sensor>\n");
    for number in 1..=robot.cables.len() {
        let _ = writeln!(
            out,
            "    <tendonpos name=\"length_{number}\" tendon=\"cable_{number}\"/>"
        );
        let _ = writeln!(
            out,
            "    <tendonvel name=\"speed_{number}\" tendon=\"cable_{number}\"/>"
        );
        let actuator = if on_winch(robot, home, number - 1) {
            "winch"
        } else {
            "tension"
        };
        let _ = writeln!(
            out,
            "    <actuatorfrc name=\"force_{number}\" actuator=\"{actuator}_{number}\"/>"
        );
    }
    out.push_str(
        "    <framepos name=\"tool_position\" objtype=\"site\" objname=\"tool\"/>\n    \
         <framequat name=\"tool_attitude\" objtype=\"site\" objname=\"tool\"/>\n  </sensor>\n",
    );
    keyframe(&mut out, robot, home);
    out.push_str("</mujoco>\n");
    out
}

/// Distance of a cable's drum behind its anchor, m.
fn behind_m(robot: &Robot, cable: usize) -> f64 {
    robot.cables.get(cable).map_or(BEHIND_M, |cable| {
        let clear = (BEHIND_RADII * cable.pulley_radius_m).max(BEHIND_M);
        cable.routing_length_m.max(clear)
    })
}

fn winch(out: &mut String, robot: &Robot, home: &Home, index: usize) {
    let number = index + 1;
    let Some((cable, frame)) = robot
        .cables
        .get(index)
        .zip(pulley_frame(robot, home, index))
    else {
        return;
    };
    let anchor = cable.anchor_in_world_m;
    let drum = anchor - cable.swivel_axis_in_world * behind_m(robot, index);
    if on_winch(robot, home, index) {
        let mass_kg = robot
            .winch_of(index)
            .map_or(WINCH_KG, |winch| winch.effective_mass_kg().max(WINCH_KG));
        let _ = write!(
            out,
            r#"    <body name="winch_{number}" pos="{at}" gravcomp="1">
      <inertial pos="0 0 0" mass="{mass_kg}" diaginertia="0.01 0.01 0.01"/>
      <joint name="winch_{number}" type="slide" axis="{axis}"/>
      <site name="drum_{number}"/>
    </body>
"#,
            at = list(&drum),
            axis = list(&-cable.swivel_axis_in_world),
        );
    } else {
        let _ = writeln!(
            out,
            "    <site name=\"drum_{number}\" pos=\"{}\"/>",
            list(&drum)
        );
    }
    let radius_m = cable.pulley_radius_m;
    if radius_m == 0.0 {
        let _ = writeln!(
            out,
            "    <site name=\"anchor_{number}\" pos=\"{}\"/>",
            list(&anchor)
        );
        return;
    }
    let _ = write!(
        out,
        r#"    <body name="pulley_{number}" pos="{at}" quat="{turn}" gravcomp="1">
      <inertial pos="0 0 0" mass="{PULLEY_KG}" diaginertia="{PULLEY_KG_M2} {PULLEY_KG_M2} {PULLEY_KG_M2}"/>
      <joint name="swivel_{number}" type="hinge" axis="0 0 1" damping="{SWIVEL_NMS}"/>
      <geom name="pulley_{number}" type="sphere" size="{radius_m}" pos="{radius_m} 0 0" rgba="0 0 0 0"/>
      <geom type="cylinder" size="{radius_m} {half}" pos="{radius_m} 0 0" zaxis="0 1 0" rgba="0.6 0.6 0.65 1"/>
      <site name="side_{number}" pos="{radius_m} 0 {side}" size="0.001" rgba="0 0 0 0"/>
    </body>
"#,
        at = list(&anchor),
        turn = quaternion(&frame),
        half = radius_m / 4.0,
        side = 3.0 * radius_m,
    );
}

fn platform(out: &mut String, robot: &Robot, home: &Home) {
    let platform = &robot.platform;
    let i: &Matrix3<f64> = &platform.inertia_kg_m2;
    let full = [
        i[(0, 0)],
        i[(1, 1)],
        i[(2, 2)],
        i[(0, 1)],
        i[(0, 2)],
        i[(1, 2)],
    ];
    let _ = write!(
        out,
        r#"    <body name="platform" pos="{at}" quat="{turn}">
      <freejoint name="platform"/>
      <inertial pos="{center}" mass="{mass}" fullinertia="{full}"/>
      <geom name="platform" type="box" pos="{center}" size="{half}" rgba="0.25 0.45 0.75 0.6"/>
      <site name="origin"/>
      <site name="tool" pos="{tool}" rgba="0.1 0.7 0.2 1"/>
"#,
        at = list(&home.pose.position_m),
        turn = quaternion(&home.pose.rotation),
        center = list(&platform.center_of_mass_m),
        mass = platform.mass_kg,
        full = list(&full),
        half = list(&platform_half_size_m(robot)),
        tool = list(&robot.tool.tcp_in_platform_m),
    );
    for (index, cable) in robot.cables.iter().enumerate() {
        let _ = writeln!(
            out,
            "      <site name=\"attachment_{}\" pos=\"{}\"/>",
            index + 1,
            list(&cable.attachment_in_platform_m)
        );
    }
    let lens = &robot.camera.lens;
    let platform_from_camera = robot.camera.camera_from_platform.inverse();
    // MuJoCo's cameras look along -z with y up, these along z with y down.
    let flip = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let _ = writeln!(
        out,
        "      <camera name=\"camera\" pos=\"{}\" quat=\"{}\" fovy=\"{}\" resolution=\"{} {}\"/>",
        list(&platform_from_camera.position_m),
        quaternion(&(platform_from_camera.rotation * flip)),
        // In degrees, whatever unit the model's other angles have (MuJoCo's XML reference).
        (2.0 * (lens.size_px[1] as f64 / 2.0 / lens.focal_px[1]).atan()).to_degrees(),
        lens.size_px[0],
        lens.size_px[1],
    );
    out.push_str("    </body>\n");
}

/// Thin plates at the tags' poses: the calibrated ones, else those of the simulator.
fn tags(out: &mut String, robot: &Robot, home: &Home) {
    for TagPlace {
        body,
        world_from_body,
    } in &home.places
    {
        let of_body = robot.tags.iter().filter(|tag| tag.body == *body);
        let of_body: Vec<_> = of_body.collect();
        if of_body.is_empty() {
            continue;
        }
        let _ = writeln!(
            out,
            "    <body name=\"tags_{body}\" pos=\"{}\" quat=\"{}\">",
            list(&world_from_body.position_m),
            quaternion(&world_from_body.rotation)
        );
        for tag in of_body {
            let [a, b, c, d] = &tag.corners_in_body_m;
            let x = (b - a).normalize();
            let z = x.cross(&(d - a)).normalize();
            let frame =
                Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
            let half = tag.size_m / 2.0;
            let _ = writeln!(
                out,
                "      <geom name=\"tag_{}\" type=\"box\" pos=\"{}\" quat=\"{}\" size=\"{half} {half} \
                 0.0005\" rgba=\"0.95 0.95 0.9 1\"/>",
                tag.id,
                list(&((a + b + c + d) / 4.0)),
                quaternion(&frame),
            );
        }
        out.push_str("    </body>\n");
    }
}

fn tendon(out: &mut String, robot: &Robot, home: &Home, index: usize) {
    let number = index + 1;
    let Some((cable, paid_out)) = robot.cables.get(index).zip(home.paid_out_m.get(index)) else {
        return;
    };
    let spring = if on_winch(robot, home, index) {
        let stiffness = cable.ea_n / (paid_out + cable.routing_length_m);
        // From zero length on: a cable pulls and does not push.
        format!(
            " stiffness=\"{stiffness}\" springlength=\"0 {}\" damping=\"{}\"",
            paid_out + behind_m(robot, index),
            stiffness * cable.damping_time_s
        )
    } else {
        String::new()
    };
    let around = if cable.pulley_radius_m == 0.0 {
        format!("<site site=\"anchor_{number}\"/>")
    } else {
        format!("<geom geom=\"pulley_{number}\" sidesite=\"side_{number}\"/>")
    };
    let _ = writeln!(
        out,
        "    <spatial name=\"cable_{number}\"{spring}><site site=\"drum_{number}\"/>{around}<site \
         site=\"attachment_{number}\"/></spatial>"
    );
}

fn actuator(out: &mut String, robot: &Robot, home: &Home, index: usize) {
    let number = index + 1;
    let Some(winch) = robot.winch_of(index) else {
        return;
    };
    if on_winch(robot, home, index) {
        let mass_kg = winch.effective_mass_kg().max(WINCH_KG);
        // 2 sqrt(k m): critical damping.
        let damping = 2.0 * (HOLDING_N_PER_M * mass_kg).sqrt();
        let _ = writeln!(
            out,
            "    <position name=\"winch_{number}\" joint=\"winch_{number}\" kp=\"{HOLDING_N_PER_M}\" \
             kv=\"{damping}\"/>"
        );
    } else {
        let most_n = robot.limits.tension_max_n.min(winch.tension_max_n);
        let _ = writeln!(
            out,
            "    <motor name=\"tension_{number}\" tendon=\"cable_{number}\" gear=\"-1\" ctrlrange=\"0 \
             {most_n}\"/>"
        );
    }
}

/// The robot at rest at home.
fn keyframe(out: &mut String, robot: &Robot, home: &Home) {
    let mut places = Vec::new();
    let mut controls = Vec::new();
    for (index, cable) in robot.cables.iter().enumerate() {
        let held = on_winch(robot, home, index);
        if held {
            places.push(0.0);
        }
        if cable.pulley_radius_m > 0.0 {
            places.push(0.0);
        }
        let tension = home.tensions_n.get(index).copied().unwrap_or(0.0);
        controls.push(if held { 0.0 } else { tension });
    }
    places.extend(home.pose.position_m.iter());
    let q = home.pose.quaternion();
    places.extend([q.w, q.i, q.j, q.k]);
    let _ = writeln!(
        out,
        "  <keyframe>\n    <key name=\"home\" qpos=\"{}\" ctrl=\"{}\"/>\n  </keyframe>",
        list(&places),
        list(&controls)
    );
}
