//! The space in which the robot of some data can hang: planned poses, the map of the expected error
//! and the recommended next pose are taken from it.

use super::data::{Data, Limits};
use mcdpr_core::random::Random;
use mcdpr_kinematics::{EquilibriumGuess, GRAVITY_MPS2, Pose, Robot, StaticOptions};
use nalgebra::Vector3;

/// Resting poses of a robot of four cables, one of them held by its tension.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Space {
    /// Middle of the box of the platform's origin, world, m.
    pub(crate) middle_m: Vector3<f64>,
    /// Half sizes of the box, m.
    pub(crate) half_m: Vector3<f64>,
    /// Least and greatest tension of any cable, N.
    pub(crate) tension_n: [f64; 2],
    /// Least and greatest tension of the held cable, N.
    pub(crate) held_n: [f64; 2],
    /// Greatest tilt of the platform, rad.
    pub(crate) tilt_max_rad: f64,
}

/// How a robot hangs in its space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Hanging {
    /// world_from_platform.
    pub pose: Pose,
    /// Tensions, N.
    pub tensions_n: [f64; 4],
    /// The cable (from 0) whose tension is held.
    pub held: usize,
}

/// Share of the anchors' width left free at either side if the robot's box is not known, and of the
/// height between the tags and the lowest anchor.
const SIDE: f64 = 0.15;
/// The same below the lowest anchor: near it cables become flat.
const TOP: f64 = 0.1;
/// Tensions and the held tension as shares of the platform's weight if no limits are known. The
/// paper's robot has 0.05 to 4 with a platform of 1 kg and sensors of 39 N.
const TENSIONS: [f64; 2] = [0.05, 4.0];
const HELD: [f64; 2] = [0.05, 3.0];
/// Greatest tilt if no limit is known, rad.
const TILT_RAD: f64 = 25.0 * std::f64::consts::PI / 180.0;

impl Space {
    /// The space of the data's robot: from the limits in the data; without them, the region between
    /// the anchors and above the tags, with tensions in proportion to the weight.
    #[must_use]
    pub fn of(data: &Data) -> Self {
        match &data.robot.limits {
            Some(limits) => Self::within(limits),
            None => Self::by_geometry(data),
        }
    }

    fn within(limits: &Limits) -> Self {
        let [low, high] = limits.box_in_world_m;
        Self {
            middle_m: (low + high) / 2.0,
            half_m: (high - low) / 2.0,
            tension_n: limits.tension_n,
            held_n: limits.held_n,
            tilt_max_rad: limits.tilt_max_rad,
        }
    }

    fn by_geometry(data: &Data) -> Self {
        let (mut low, mut high) = (Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN));
        for cable in &data.robot.cables {
            low = low.inf(&cable.anchor_m);
            high = high.sup(&cable.anchor_m);
        }
        // Without tags below the anchors it reaches as far down as the anchors are wide.
        let heights = data.world_from_body.iter().map(|body| body.position_m.z);
        let floor = heights.filter(|z| *z < low.z).fold(f64::MAX, f64::min);
        let room = if floor < low.z {
            low.z - floor
        } else {
            (high.x - low.x).hypot(high.y - low.y)
        };
        let side = (high - low) * SIDE;
        let least = Vector3::new(low.x + side.x, low.y + side.y, low.z - room * (1.0 - SIDE));
        let most = Vector3::new(high.x - side.x, high.y - side.y, low.z - room * TOP);
        let weight_n = data.robot.mass_kg * GRAVITY_MPS2;
        Self::within(&Limits {
            box_in_world_m: [least, most],
            tension_n: TENSIONS.map(|share| share * weight_n),
            held_n: HELD.map(|share| share * weight_n),
            tilt_max_rad: TILT_RAD,
        })
    }

    /// Least and greatest corner of the box of the platform's origin, world, m.
    #[must_use]
    pub fn corners_m(&self) -> [Vector3<f64>; 2] {
        [self.middle_m - self.half_m, self.middle_m + self.half_m]
    }

    /// A random resting pose; `None` if the drawn position and tension have none.
    pub(crate) fn random(&self, robot: &Robot<4>, random: &mut Random) -> Option<Hanging> {
        let at = Vector3::new(
            self.middle_m.x + random.within(self.half_m.x),
            self.middle_m.y + random.within(self.half_m.y),
            self.middle_m.z - random.within(self.half_m.z),
        );
        // Log-uniform.
        let [least_n, most_n] = self.held_n;
        let held_n = least_n * (most_n / least_n).powf(random.unit());
        let held = ((random.unit() * 4.0) as usize).min(3);
        self.hang(robot, &at, held, held_n)
    }

    /// The resting pose nearest to a position and a tension of the held cable that lies in this
    /// space.
    pub(crate) fn nearest(
        &self,
        robot: &Robot<4>,
        at_m: &Vector3<f64>,
        held: usize,
        held_n: f64,
    ) -> Option<Hanging> {
        let [low, high] = self.corners_m();
        let [least_n, most_n] = self.held_n;
        let at_m = at_m.sup(&low).inf(&high);
        self.hang(robot, &at_m, held, held_n.clamp(least_n, most_n))
    }

    /// How the robot hangs with the platform's origin at a position and one cable's tension held;
    /// `None` if it cannot, is not stable, or a tension or the tilt is out of range.
    pub(crate) fn hang(
        &self,
        robot: &Robot<4>,
        at_m: &Vector3<f64>,
        held: usize,
        held_n: f64,
    ) -> Option<Hanging> {
        let mut tensions = [None; 4];
        tensions[held] = Some(held_n);
        let hang = robot
            .equilibrium_at(
                &Vector3::zeros(),
                at_m,
                &tensions,
                EquilibriumGuess::Cold,
                &StaticOptions::default(),
            )
            .ok()?;
        let [least_n, most_n] = self.tension_n;
        let in_range = hang
            .tensions_n
            .iter()
            .all(|t| (least_n..most_n).contains(t));
        // An unstable pose is never reached: the platform falls to another one.
        (hang.stable && in_range && hang.pose.tilt_rad() < self.tilt_max_rad).then(|| Hanging {
            pose: hang.pose,
            tensions_n: std::array::from_fn(|i| hang.tensions_n[i]),
            held,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::assay::next_pose;
    use super::super::joint::{Options, joint};
    use super::super::plan::{candidates, choose, work_poses};
    use super::super::simulate::{Setup, simulate};
    use super::*;

    /// The same robot `factor` times as large, of `mass` times the mass.
    fn enlarged(data: &Data, factor: f64, mass: f64) -> Data {
        let mut out = data.clone();
        for cable in &mut out.robot.cables {
            cable.anchor_m *= factor;
            cable.attachment_m *= factor;
            cable.pulley_radius_m *= factor;
        }
        out.robot.mass_kg *= mass;
        out.robot.center_of_mass_m *= factor;
        for tag in &mut out.tags {
            tag.size_m *= factor;
            tag.corners_in_body_m = tag.corners_in_body_m.map(|corner| corner * factor);
        }
        for body in &mut out.world_from_body {
            body.position_m *= factor;
        }
        out.camera_from_platform.position_m *= factor;
        out
    }

    #[test]
    fn a_robot_twice_as_large_is_planned_for_in_its_own_space() {
        let (data, _) = simulate(&Setup::default()).unwrap();
        let large = enlarged(&data, 2.0, 8.0);
        let plans = [&data, &large].map(|data| {
            let space = Space::of(data);
            let all = candidates(data, &space, 40, 5).unwrap();
            assert_eq!(all.len(), 40);
            let work = work_poses(data, &space, 20, 5).unwrap();
            let plan = choose(data, &space, &all, &work, 8, &Options::default()).unwrap();
            let [low, high] = space.corners_m();
            for candidate in plan.chosen.iter().chain(&plan.spare) {
                let at = candidate.pose.position_m;
                assert!((0..3).all(|k| (low[k]..=high[k]).contains(&at[k])), "{at}");
            }
            all
        });
        // The same poses, twice as far apart, with tensions in proportion to the weights.
        for (small, large) in plans[0].iter().zip(&plans[1]) {
            let off = large.pose.position_m - small.pose.position_m * 2.0;
            assert!(off.norm() < 1e-9, "{off}");
            for (a, b) in small.tensions_n.iter().zip(&large.tensions_n) {
                assert!((b - 8.0 * a).abs() < 1e-6, "{a} {b}");
            }
        }
        // Poses that the paper's robot cannot reach.
        let beyond = |c: &super::super::plan::Candidate| c.pose.position_m.z < -0.724;
        assert!(plans[1].iter().any(beyond));
    }

    #[test]
    fn limits_that_data_carry_bound_the_next_pose_and_the_file_keeps_them() {
        let (mut data, _) = simulate(&Setup::default()).unwrap();
        let limits = Limits {
            box_in_world_m: [
                Vector3::new(0.25, -0.1, -0.35),
                Vector3::new(0.4, 0.1, -0.2),
            ],
            tension_n: [1.0, 20.0],
            held_n: [1.5, 12.0],
            tilt_max_rad: 0.3,
        };
        data.robot.limits = Some(limits);
        let read = Data::from_json(&data.to_json().to_string()).unwrap();
        let kept = read.robot.limits.unwrap();
        for k in 0..2 {
            let off = kept.box_in_world_m[k] - limits.box_in_world_m[k];
            assert!(off.norm() < 1e-12);
            assert_eq!(kept.tension_n[k], limits.tension_n[k]);
            assert_eq!(kept.held_n[k], limits.held_n[k]);
        }
        assert!((kept.tilt_max_rad - limits.tilt_max_rad).abs() < 1e-12);
        let options = Options::default();
        let answer = joint(&data, &options).unwrap();
        let next = next_pose(&data, &answer, &options).unwrap();
        let [low, high] = limits.box_in_world_m;
        let at = next.pose.position_m;
        assert!((0..3).all(|k| (low[k]..=high[k]).contains(&at[k])), "{at}");
        assert!((1.5..=12.0).contains(&next.tension_n), "{}", next.tension_n);
        let [without, with] = next.expected_error_m;
        assert!(with < without);
    }
}
