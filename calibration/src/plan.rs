//! Choice of poses: out of many that the mechanism can reach, those that leave the least expected
//! position error, see `design`.

use super::data::Data;
pub use super::design::{Candidate, Design, Halt, Search};
use super::fit::Options;
use super::space::{Hanging, Space};
use super::views::views_at;
use mcdpr_core::random::Random;
use mcdpr_kinematics::{Cable, Platform, Pose, Robot};
use nalgebra::Vector3;

/// A choice of poses.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The poses, most valuable first.
    pub chosen: Vec<Candidate>,
    /// Expected root mean square position error after each of them, m.
    pub expected_error_m: Vec<f64>,
    /// The next most valuable ones, to replace poses that turn out to be unreachable or to show no
    /// tag.
    pub spare: Vec<Candidate>,
}

/// Poses of the nominal robot within `space` with tags in view, at random.
///
/// `None` unless the robot has four cables.
#[must_use]
pub fn candidates(data: &Data, space: &Space, count: usize, seed: u64) -> Option<Vec<Candidate>> {
    let robot = nominal(data)?;
    let mut random = Random::new(seed);
    let mut out = Vec::with_capacity(count);
    // If no tag is ever in view, the search must end.
    for _ in 0..count * 200 {
        if out.len() == count {
            break;
        }
        if let Some(hung) = space.random(&robot, &mut random) {
            out.extend(seen(data, &hung));
        }
    }
    Some(out)
}

/// Working poses: random poses of the nominal robot within `space`, with or without tags in view.
///
/// `None` unless the robot has four cables.
#[must_use]
pub fn work_poses(data: &Data, space: &Space, count: usize, seed: u64) -> Option<Vec<Pose>> {
    let robot = nominal(data)?;
    // Another sequence than that of the candidates: a plan is not judged at the poses it may
    // choose.
    let mut random = Random::new(seed ^ 0x776F_726B);
    let mut out = Vec::with_capacity(count);
    for _ in 0..count * 200 {
        if out.len() == count {
            break;
        }
        out.extend(space.random(&robot, &mut random).map(|hung| hung.pose));
    }
    Some(out)
}

fn nominal(data: &Data) -> Option<Robot<4>> {
    let cables = <[Cable; 4]>::try_from(data.robot.cables.clone()).ok()?;
    let platform = Platform {
        mass_kg: data.robot.mass_kg,
        center_of_mass_m: data.robot.center_of_mass_m,
        inertia_kg_m2: None,
    };
    Robot::new(cables, platform).ok()
}

/// A reachable pose of the nominal robot with tags in view near a candidate: within `size` times
/// 0.1 m, and its tension within a factor of e to the `size`; sometimes held by another cable.
fn near(
    data: &Data,
    (robot, space): (&Robot<4>, &Space),
    random: &mut Random,
    candidate: &Candidate,
    size: f64,
) -> Option<Candidate> {
    let at = candidate.pose.position_m + Vector3::from_fn(|_, _| random.within(0.1 * size));
    // One try in four draws the held cable anew.
    let other = ((random.unit() * 16.0) as usize).min(15);
    let held = if other < 4 { other } else { candidate.held };
    let held_n = candidate.tensions_n[held] * random.within(size).exp();
    seen(data, &space.nearest(robot, &at, held, held_n)?)
}

/// The candidate at a pose, if a tag is in view there.
fn seen(data: &Data, hung: &Hanging) -> Option<Candidate> {
    let views = views_at(
        &data.camera,
        &data.tags,
        &data.world_from_body,
        &data.camera_from_platform,
        &hung.pose,
        1.0,
    );
    (!views.is_empty()).then(|| Candidate {
        pose: hung.pose,
        tensions_n: hung.tensions_n.to_vec(),
        held: hung.held,
        views,
    })
}

/// Chooses `count` of the candidates, or of others near them in `space`, for the robot, camera, tags and noise of `data` (its poses are
/// not read), to be accurate at `work`. `None` where the candidates are too few or the information
/// cannot be computed.
#[must_use]
pub fn choose(
    data: &Data,
    space: &Space,
    all: &[Candidate],
    work: &[Pose],
    count: usize,
    options: &Options,
) -> Option<Plan> {
    if all.len() < count || count == 0 {
        return None;
    }
    let mut all = all.to_vec();
    let mut design = Design::new(data, &all, work, options)?;
    for _ in 0..count {
        let (k, _) = design.best(|_| true)?;
        design.take(k);
    }
    // The first poses were chosen without the later ones: together others may be better.
    design.exchange(0);
    if let Some(robot) = nominal(data) {
        let mut random = Random::new(0x6E65_6172);
        design.refine(
            data,
            &mut all,
            options,
            0,
            Search::THOROUGH,
            |candidate, size| near(data, (&robot, space), &mut random, candidate, size),
        );
    }
    // In the order of their worth.
    let chosen = design.taken().to_vec();
    design.release(0);
    let mut out = Plan {
        chosen: Vec::new(),
        expected_error_m: Vec::new(),
        spare: Vec::new(),
    };
    for _ in 0..count {
        let (k, expected) = design.best(|k| chosen.contains(&k))?;
        design.take(k);
        out.chosen.push(all[k].clone());
        out.expected_error_m.push(expected);
    }
    for _ in 0..count.div_ceil(2) {
        let Some((k, _)) = design.best(|k| !chosen.contains(&k)) else {
            break;
        };
        design.take(k);
        out.spare.push(all[k].clone());
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::super::simulate::{Setup, Target, simulate};
    use super::*;

    #[test]
    fn what_a_plan_expects_is_what_the_estimate_then_states() {
        let (mut data, truth) = simulate(&Setup::default()).unwrap();
        let options = Options::default();
        let stated = super::super::joint::joint(&data, &options).unwrap();
        let measured = data.poses.drain(..).zip(&truth.poses);
        let all: Vec<Candidate> = measured
            .map(|(seen, pose)| Candidate {
                pose: *pose,
                tensions_n: seen.tension_n.unwrap(),
                held: 3,
                views: seen.views,
            })
            .collect();
        let mut design = Design::new(&data, &all, &truth.holdout, &options).unwrap();
        (0..all.len()).for_each(|k| design.take(k));
        let ratio = design.expected_error_m().unwrap() / stated.predicted_error_m;
        assert!((0.95..1.05).contains(&ratio), "{ratio}");
    }

    #[test]
    fn poses_near_the_best_at_random_are_better_still_and_within_reach() {
        let setup = Setup {
            target: Target::Tag,
            ..Setup::default()
        };
        let (data, _) = simulate(&setup).unwrap();
        let options = Options::default();
        let space = Space::of(&data);
        let all = candidates(&data, &space, 120, 3).unwrap();
        let work = work_poses(&data, &space, 40, 3).unwrap();
        let mut design = Design::new(&data, &all, &work, &options).unwrap();
        for _ in 0..10 {
            let (k, _) = design.best(|_| true).unwrap();
            design.take(k);
        }
        design.exchange(0);
        let at_random = design.expected_error_m().unwrap();
        let plan = choose(&data, &space, &all, &work, 10, &options).unwrap();
        let refined = *plan.expected_error_m.last().unwrap();
        assert!(refined < 0.9 * at_random, "{refined} {at_random}");
        for candidate in plan.chosen.iter().chain(&plan.spare) {
            assert!(!candidate.views.is_empty());
            let [least_n, most_n] = space.tension_n;
            let in_range = |t: &f64| (least_n..most_n).contains(t);
            assert!(candidate.tensions_n.iter().all(in_range));
            assert!(candidate.pose.position_m.z <= space.corners_m()[1].z);
        }
    }
}
