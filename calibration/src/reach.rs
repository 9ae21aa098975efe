//! Where the platform hangs at rest, and which tags its camera sees there.

use super::data::{Camera, Tag, View, compose, inverse};
use mcdpr_core::random::Dice;
use mcdpr_kinematics::{EquilibriumGuess, Pose, Robot, StaticOptions};
use nalgebra::Vector3;

/// Margin that a tag keeps from the picture's edge where poses are planned, px.
pub const MARGIN_PX: f64 = 40.0;
/// The same where a picture is looked at: a detector needs some paper around the tag. The rest of
/// the planned margin is what the robot hangs elsewhere than planned.
pub const SEEN_PX: f64 = 10.0;

/// The tags wholly in the picture at a platform pose, 40 px from its edge, with their corners.
#[must_use]
pub fn views_at(
    camera: &Camera,
    tags: &[Tag],
    world_from_body: &[Pose],
    camera_from_platform: &Pose,
    world_from_platform: &Pose,
    tag_scale: f64,
) -> Vec<View> {
    let poses = (world_from_body, camera_from_platform, world_from_platform);
    views_within(camera, tags, poses, tag_scale, MARGIN_PX)
}

/// The tags that keep `margin_px` from the picture's edge; negative: that may lie outside of it.
#[must_use]
pub fn views_within(
    camera: &Camera,
    tags: &[Tag],
    (world_from_body, camera_from_platform, world_from_platform): (&[Pose], &Pose, &Pose),
    tag_scale: f64,
    margin_px: f64,
) -> Vec<View> {
    let camera_from_world = compose(camera_from_platform, &inverse(world_from_platform));
    let see = |(index, tag): (usize, &Tag)| {
        let camera_from_body = compose(&camera_from_world, &world_from_body[tag.body]);
        let mut corners_px = [[0.0; 2]; 4];
        for (slot, corner) in corners_px.iter_mut().zip(&tag.corners_in_body_m) {
            let seen = camera.project(&camera_from_body.transform(&(corner * tag_scale)))?;
            for (k, value) in slot.iter_mut().enumerate() {
                let inside = margin_px..camera.size_px[k] - margin_px;
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

/// A random reachable pose: stable equilibrium with every tension between 0.5 and 39 N, tilted by 25
/// degrees at most.
pub(crate) fn random_equilibrium(
    robot: &Robot<4>,
    dice: &mut Dice,
) -> Option<(Pose, [f64; 4], usize)> {
    let at = Vector3::new(
        MIDDLE_M.x + dice.within(SPACE_M.x),
        MIDDLE_M.y + dice.within(SPACE_M.y),
        MIDDLE_M.z - dice.within(SPACE_M.z),
    );
    // Log-uniform.
    let held = HELD_N[0] * (HELD_N[1] / HELD_N[0]).powf(dice.unit());
    let cable = ((dice.unit() * 4.0) as usize).min(3);
    let (pose, tensions) = hang(robot, &at, cable, held)?;
    Some((pose, tensions, cable))
}

/// Middle and half sizes of the space of reachable poses, m; range of the held tension, N.
const MIDDLE_M: Vector3<f64> = Vector3::new(0.335, 0.0, -0.295);
const SPACE_M: Vector3<f64> = Vector3::new(0.19, 0.19, 0.235);
const HELD_N: [f64; 2] = [0.5, 28.0];

/// As [`random_equilibrium`] with a place and a tension given, which are brought within the bounds
/// that random ones have.
pub(crate) fn equilibrium_within(
    robot: &Robot<4>,
    at: &Vector3<f64>,
    cable: usize,
    held_n: f64,
) -> Option<(Pose, [f64; 4])> {
    let at = at.sup(&(MIDDLE_M - SPACE_M)).inf(&(MIDDLE_M + SPACE_M));
    hang(robot, &at, cable, held_n.clamp(HELD_N[0], HELD_N[1]))
}

/// The resting pose with the platform's origin at a place and one cable's tension held.
fn hang(
    robot: &Robot<4>,
    at: &Vector3<f64>,
    cable: usize,
    held_n: f64,
) -> Option<(Pose, [f64; 4])> {
    let mut tensions = [None; 4];
    tensions[cable] = Some(held_n);
    let hang = robot
        .equilibrium_at(
            &Vector3::zeros(),
            at,
            &tensions,
            EquilibriumGuess::Cold,
            &StaticOptions::default(),
        )
        .ok()?;
    let in_range = hang.tensions_n.iter().all(|t| (0.5..39.0).contains(t));
    (hang.stable && in_range && hang.pose.tilt_rad() < 25f64.to_radians())
        .then(|| (hang.pose, std::array::from_fn(|i| hang.tensions_n[i])))
}
