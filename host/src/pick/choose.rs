//! Tool positions for the grasps of a picture.

use super::Refusal;
use super::arm::isometry;
use crate::motion::Model;
use mcdpr_vision::grasp::{Grasp, Hand, HeightMap};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// A grasp that the robot can execute.
#[derive(Debug, Clone)]
pub struct Choice {
    /// The grasp as detected.
    pub grasp: Grasp,
    /// The tool point of the grasp as seen, world, m (Eqs. 45 and 48).
    pub seen_m: Vector3<f64>,
    /// Direction from one contact to the other, world.
    pub closing: Vector3<f64>,
    /// Tool position, world, m: as low as its fingers have room there.
    pub tool_m: Vector3<f64>,
    /// The platform's origin then, world, m (Eq. 49 with the rotation).
    pub platform_m: Vector3<f64>,
    /// Turn of the jaws about the tool's axis, rad.
    pub wrist_rad: f64,
    /// Tilt of the tool there, rad.
    pub tilt_rad: f64,
    /// Height of contact on the pads, m.
    pub engaged_m: f64,
    /// Height over which pads that lean with the tool lie on an upright wall, m.
    pub lies_on_m: f64,
    /// Room between each open pad and the object, m.
    pub room_m: f64,
    /// Share of the contacts whose colour suggests another object.
    pub other: f64,
    /// Number of its picture, from 0.
    pub view: usize,
}

impl Choice {
    /// Rank, including the tilt of the tool: of the grasp, of the height on the pads, of the part
    /// of it that they lie on and of the room beside it.
    #[must_use]
    pub fn rank(&self) -> f64 {
        // From 12 mm on the pads and from 6 mm of room on, more is no better.
        let engaged = (self.engaged_m / 0.012).min(1.0);
        let room = (self.room_m / 0.006).min(1.0);
        let single = 1.0 - 0.9 * (self.other / 0.15).min(1.0);
        let flat = (self.lies_on_m / LIES_ON_M).min(1.0);
        self.grasp.quality * engaged * flat * room * single
    }
}

/// Result for all grasps of a picture.
#[derive(Debug, Clone, Default)]
pub(crate) struct Choices {
    /// The executable ones, best first.
    pub good: Vec<Choice>,
    /// Grasps out of the robot's reach.
    pub unreachable: usize,
    /// Grasps for which the tilted fingers have no room or no good hold.
    pub no_room: usize,
    /// The refused ones with their reasons, the first of them.
    pub refused: Vec<Refusal>,
}

/// Least contact height on the pads, m: less is lost to errors of a millimetre or two.
const ENGAGED_MIN_M: f64 = 0.005;
/// Pads that lie on a wall over so little of their height slip, m; from [`LIES_ON_M`] on more is no
/// better.
const LIES_ON_MIN_M: f64 = 0.0021;
const LIES_ON_M: f64 = 0.005;
/// Grasps whose middle is further from the tool than this are moved there once.
const OFF_M: f64 = 0.0005;
/// Grasps of a lower rank slip more often than they hold: mainly thin rods.
const RANK_MIN: f64 = 0.08;
/// Room between jaws and object that must be left on both sides, m.
const SIDE_M: f64 = 0.0025;
/// Jaws that cannot turn take grasps within this of their direction, rad.
const FIXED_TOLERANCE_RAD: f64 = 0.2;

/// Chooses among the grasps of one picture. `world_from_camera` is the colour camera's pose when
/// the picture was taken; `turns`: whether the gripper turns about its axis.
pub(super) fn choose(
    model: &Model,
    map: &HeightMap,
    grasps: &[Grasp],
    world_from_camera: &Isometry3<f64>,
    hand: &Hand,
    turns: bool,
) -> Choices {
    let mut choices = Choices::default();
    for grasp in grasps {
        let reason = match one(model, map, grasp, world_from_camera, hand, turns) {
            Ok(choice) if choice.rank() < RANK_MIN => LOW_RANK,
            Ok(choice) => {
                choices.good.push(choice);
                continue;
            }
            Err(reason) => reason,
        };
        if reason == OUT_OF_REACH {
            choices.unreachable += 1;
        } else {
            choices.no_room += 1;
        }
        if choices.refused.len() < REFUSED_MAX {
            choices.refused.push(Refusal {
                at_m: (world_from_camera * grasp.point_m).coords.into(),
                width_m: grasp.width_m,
                reason,
            });
        }
    }
    // The rank assumes upright fingers: the hold and room that remain for tilted ones count too.
    choices.good.sort_by(|a, b| b.rank().total_cmp(&a.rank()));
    choices
}

/// Why grasps are refused, for the report of a picture.
const OUT_OF_REACH: &str = "out of the robot's reach";
const NO_TURN: &str = "the jaws do not turn that way";
const NO_ROOM: &str = "no room for the tilted fingers";
const LITTLE_HOLD: &str = "less than 5 mm of it on the pads";
const LEANS: &str = "the leaning pads lie on too little of it";
const NARROW: &str = "less than 2.5 mm beside an open pad";
const LOW_RANK: &str = "a hold that would slip";
/// Refused grasps whose reasons are kept.
const REFUSED_MAX: usize = 40;

fn one(
    model: &Model,
    map: &HeightMap,
    grasp: &Grasp,
    world_from_camera: &Isometry3<f64>,
    hand: &Hand,
    turns: bool,
) -> Result<Choice, &'static str> {
    let seen_m = (world_from_camera * grasp.point_m).coords;
    let closing = world_from_camera.rotation * grasp.closing;
    let map_from_world = (world_from_camera * map.camera_from_map).inverse();
    let mut tool_m = seen_m;
    let mut result = None;
    // The attitude depends on the position and the position on the attitude: solved by fixed-point
    // iteration.
    for _ in 0..3 {
        let rest = model.rest(&tool_m, None).map_err(|_| OUT_OF_REACH)?;
        let world_from_platform = isometry(&rest);
        let wrist_rad = wrist(&world_from_platform, &closing, turns).ok_or(NO_TURN)?;
        let spin = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), wrist_rad);
        let world_from_tool = Isometry3::from_parts(
            Translation3::from(tool_m),
            world_from_platform.rotation * spin,
        );
        let map_from_tool = map_from_world * world_from_tool;
        let fit = map.fit(hand, &map_from_tool).ok_or(NO_ROOM)?;
        let room_m = 0.5 * (hand.opening_m - fit.width_m);
        let jaw = map_from_tool.rotation * Vector3::y();
        let lies_on_m = hand.lies_on_m(jaw.z.clamp(-1.0, 1.0).asin());
        if fit.engaged_m < ENGAGED_MIN_M {
            return Err(LITTLE_HOLD);
        }
        if lies_on_m < LIES_ON_MIN_M {
            return Err(LEANS);
        }
        if room_m < SIDE_M {
            return Err(NARROW);
        }
        let mut place = map_from_tool.translation.vector;
        let flat = Vector3::new(jaw.x, jaw.y, 0.0).normalize();
        place += flat * fit.off_m;
        place.z = fit.height_m;
        let next = map_from_world.inverse_transform_point(&place.into()).coords;
        let moved = (next - tool_m).norm();
        tool_m = next;
        result = Some(Choice {
            grasp: grasp.clone(),
            seen_m,
            closing,
            tool_m,
            platform_m: tool_m
                - world_from_platform.rotation * model.robot().tool.tcp_in_platform_m,
            wrist_rad,
            tilt_rad: rest.equilibrium.pose.tilt_rad(),
            engaged_m: fit.engaged_m,
            lies_on_m,
            room_m,
            other: fit.other,
            view: 0,
        });
        if moved < OFF_M {
            break;
        }
    }
    result.ok_or(NO_ROOM)
}

/// Turn of the jaws (tool's y) about the tool's axis towards a direction of the world.
fn wrist(world_from_platform: &Isometry3<f64>, closing: &Vector3<f64>, turns: bool) -> Option<f64> {
    let on_tool = world_from_platform.rotation.inverse() * closing;
    // tool y after a turn by a is (-sin a, cos a).
    let mut angle = (-on_tool.x).atan2(on_tool.y);
    let half = std::f64::consts::FRAC_PI_2;
    // Jaws turned by half a turn are the same: a quarter turn is the most that is needed.
    if angle > half {
        angle -= 2.0 * half;
    } else if angle < -half {
        angle += 2.0 * half;
    }
    if turns {
        return Some(angle);
    }
    (angle.abs() < FIXED_TOLERANCE_RAD).then_some(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector2};

    fn choice(lies_on_m: f64) -> Choice {
        Choice {
            grasp: Grasp {
                pixel: Vector2::zeros(),
                point_m: Point3::origin(),
                closing: Vector3::y(),
                width_m: 0.03,
                clearance_m: 0.015,
                top_m: 0.03,
                height_m: 0.02,
                quality: 0.6,
            },
            seen_m: Vector3::zeros(),
            closing: Vector3::y(),
            tool_m: Vector3::zeros(),
            platform_m: Vector3::zeros(),
            wrist_rad: 0.0,
            tilt_rad: 0.0,
            engaged_m: 0.012,
            lies_on_m,
            room_m: 0.015,
            other: 0.0,
            view: 0,
        }
    }

    #[test]
    fn of_two_grasps_the_one_whose_pads_lie_flat_comes_first() {
        let hand = Hand::default();
        let at = |degrees: f64| choice(hand.lies_on_m(degrees.to_radians()));
        assert_eq!(at(0.0).rank(), at(5.0).rank());
        assert!(at(9.0).rank() < 0.7 * at(5.0).rank());
        assert!(at(9.0).lies_on_m > LIES_ON_MIN_M && at(14.0).lies_on_m < LIES_ON_MIN_M);
    }
}
