//! The tags that the camera sees completely at a pose of the platform.

use super::data::{Tag, View};
use mcdpr_kinematics::Pose;
use mcdpr_vision::Camera;

/// Margin that a tag keeps from the picture's edge when poses are planned, px.
pub const MARGIN_PX: f64 = 40.0;
/// The same for a real picture: a detector needs some paper around the tag. The rest of the planned
/// margin allows for the deviation of the real pose from the planned one.
pub const SEEN_PX: f64 = 10.0;

/// The tags that are completely in the picture at a platform pose, 40 px from its edge, with their
/// corners.
#[must_use]
pub fn views_at(
    camera: &Camera,
    tags: &[Tag],
    world_from_body: &[Pose],
    camera_from_platform: &Pose,
    world_from_platform: &Pose,
    tag_scale: f64,
) -> Vec<View> {
    let camera_from_world = camera_from_platform.compose(&world_from_platform.inverse());
    let (from_world, bodies) = (&camera_from_world, world_from_body);
    views_within(camera, tags, bodies, from_world, tag_scale, MARGIN_PX)
}

/// The tags that keep `margin_px` from the picture's edge; negative: that may lie outside of it.
#[must_use]
pub fn views_within(
    camera: &Camera,
    tags: &[Tag],
    world_from_body: &[Pose],
    camera_from_world: &Pose,
    tag_scale: f64,
    margin_px: f64,
) -> Vec<View> {
    let see = |(index, tag): (usize, &Tag)| {
        let camera_from_body = camera_from_world.compose(&world_from_body[tag.body]);
        let mut corners_px = [[0.0; 2]; 4];
        for (slot, corner) in corners_px.iter_mut().zip(&tag.corners_in_body_m) {
            let seen =
                camera.projection(&camera_from_body.transform(&(corner * tag_scale)).into())?;
            for (k, value) in slot.iter_mut().enumerate() {
                let inside = margin_px..camera.size_px[k] as f64 - margin_px;
                // A tag in part is not seen: a detector needs all four corners and the rim.
                if !inside.contains(&seen.pixel[k]) {
                    return None;
                }
                *value = seen.pixel[k];
            }
        }
        Some(View {
            tag: index,
            corners_px,
        })
    };
    tags.iter().enumerate().filter_map(see).collect()
}
