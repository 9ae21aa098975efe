//! The measurements, and what a resting state predicts for them.

use crate::motion::{Model, StaticState};
use crate::robot::{Control, TagPlace};
use crate::sight::TagView;
use mcdpr_kinematics::Pose;
use nalgebra::{Rotation3, Vector3};

/// Standard deviations of the measurements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sigmas {
    /// A drum encoder's length, m: half a count, and the error of an anchor.
    pub length_m: f64,
    /// A tension, N: the sensor, and the friction of a pulley.
    pub tension_n: f64,
    /// How far the attitude differs from that of statics, per axis, rad: the error of the centre of
    /// mass.
    pub attitude_rad: f64,
    /// How far a robot in a plane hangs from where statics have it across that plane, m: the errors of its anchors there.
    pub across_m: f64,
}

impl Default for Sigmas {
    fn default() -> Self {
        Self {
            length_m: 3e-4,
            tension_n: 0.3,
            attitude_rad: 3e-3,
            across_m: 2e-3,
        }
    }
}

/// All measurements of a robot at rest; what was not measured is empty.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Measurements {
    /// Paid-out lengths, one per cable, m.
    pub lengths_m: Vec<f64>,
    /// Tensions at the winches, one per cable, N.
    pub tensions_n: Vec<f64>,
    /// Tags in one or more pictures of the same resting pose.
    pub views: Vec<TagView>,
    /// The poses of their bodies.
    pub places: Vec<TagPlace>,
}

/// An assumed state of the resting robot.
#[derive(Clone, Copy)]
pub(crate) struct Supposed<'a> {
    /// By statics.
    pub(crate) rest: &'a StaticState,
    /// Difference of the attitude from that of statics, rotation vector, world, rad.
    pub(crate) turned: Vector3<f64>,
    /// The length of this cable (from 0) counts as not measured.
    pub(crate) skip: Option<usize>,
}

/// One row: the measured minus the predicted value over its standard deviation. `None` where the
/// state predicts nothing (a tag behind the camera). The last three rows hold the attitude near that of statics.
pub(crate) fn residuals(
    model: &Model,
    measured: &Measurements,
    sigmas: &Sigmas,
    supposed: Supposed<'_>,
    out: &mut Vec<f64>,
) -> Option<()> {
    out.clear();
    let Supposed { rest, turned, skip } = supposed;
    let lengths = measured.lengths_m.iter().zip(&rest.paid_out_m);
    out.extend(lengths.map(|(seen, said)| (seen - said) / sigmas.length_m));
    // Zero instead of removed: the other rows keep their places.
    if let Some(slot) = skip.and_then(|cable| out.get_mut(cable)) {
        *slot = 0.0;
    }
    let tensions = measured.tensions_n.iter().zip(rest.tensions_n());
    out.extend(
        tensions
            .enumerate()
            .map(|(cable, (seen, &said))| (seen - model.reading_n(cable, said)) / sigmas.tension_n),
    );
    // Turned about the tool, whose position is a separate unknown.
    let tool = &model.robot().tool.tcp_in_platform_m;
    let pose = &rest.equilibrium.pose;
    let rotation = Rotation3::new(turned) * pose.rotation;
    let seen_pose = Pose::new(pose.transform(tool) - rotation * tool, rotation);
    corners(model, measured, &seen_pose, out)?;
    out.extend(turned.iter().map(|angle| -angle / sigmas.attitude_rad));
    Some(())
}

/// The rows of the tags' corners (u, v) with the platform at a pose; `None` where a tag is behind the camera.
pub(super) fn corners(
    model: &Model,
    measured: &Measurements,
    seen_pose: &Pose,
    out: &mut Vec<f64>,
) -> Option<()> {
    let camera = &model.robot().camera;
    let camera_from_world = camera.camera_from_platform.compose(&seen_pose.inverse());
    for view in &measured.views {
        let Some(tag) = model.robot().tags.iter().find(|tag| tag.id == view.id) else {
            continue;
        };
        let Some(place) = measured.places.iter().find(|place| place.body == tag.body) else {
            continue;
        };
        let camera_from_body = camera_from_world.compose(&place.world_from_body);
        let corners = tag.corners_in_body_m.iter().zip(&view.corners_px);
        for ((corner, seen), covariance) in corners.zip(&view.covariance_px2) {
            let said = camera
                .lens
                .projection(&camera_from_body.transform(corner).into())?;
            for ((seen, said), variance) in [
                ((seen[0], said.pixel.x), covariance[0][0]),
                ((seen[1], said.pixel.y), covariance[1][1]),
            ] {
                // At least 0.001 px of noise: a perfect simulated corner must not get an infinite
                // weight.
                out.push((seen - said) / variance.max(1e-6).sqrt());
            }
        }
    }
    Some(())
}

/// The measured tension of the tension-held cable, or its set-point.
pub(super) fn held_tension_n(model: &Model, measured: &Measurements) -> f64 {
    let cables = model.robot().cables.iter().zip(&measured.tensions_n);
    let mut held = cables.filter(|(cable, _)| cable.control == Control::Tension);
    held.next()
        .map_or(model.robot().tension.setpoint_n, |(_, tension)| *tension)
        .max(0.2)
}
