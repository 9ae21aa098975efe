//! How far a cable's tension may be from its plan: room between what a plan asks for and the limits at which the board
//! stops, or at which a brake fails its test.

use super::model::StaticState;
use super::verdict::Broken;
use crate::robot::Robot;

/// A tension differs from its plan by up to this share: sensor gain, pulley loss and mass, each known to a percent or
/// two. Assumption, range 0.01 to 0.05; a calibrated `paper-table5` had 1.2 % too much where it stopped with C2.
const SHARE: f64 = 0.03;
/// And by this much, N: a sensor's zero and noise. Assumption, range 0.02 to 0.2.
const FIXED_N: f64 = 0.05;

/// Greatest expected difference of a tension from its plan, N.
pub(super) fn difference_n(tension_n: f64) -> f64 {
    SHARE * tension_n.abs() + FIXED_N
}

/// Least and greatest tension of a cable at which the board does not stop, N: the robot's limits (C1, C2), and what the
/// winch's sensor can be trusted to show.
pub(super) fn limits_n(robot: &Robot, cable: usize) -> [f64; 2] {
    let limits = &robot.limits;
    let sensor_n = robot
        .winch_of(cable)
        .map_or(f64::INFINITY, |winch| winch.trusted_tension_n());
    [limits.tension_min_n, limits.tension_max_n.min(sensor_n)]
}

/// Least and greatest tension that a plan may ask of a cable, N: the expected difference inside [`limits_n`].
pub(super) fn planned_n(robot: &Robot, cable: usize) -> [f64; 2] {
    let [low, high] = limits_n(robot, cable);
    [
        (low + FIXED_N) / (1.0 - SHARE),
        (high - FIXED_N) / (1.0 + SHARE),
    ]
}

/// The same for a motion that begins with the cable at a tension (N). Where that is nearer to a limit already, it must
/// not come nearer still, and the robot can leave.
pub(super) fn planned_from_n(robot: &Robot, cable: usize, from_n: Option<f64>) -> [f64; 2] {
    let [low, high] = planned_n(robot, cable);
    let [least, most] = limits_n(robot, cable);
    let from_n = from_n.unwrap_or(low).max(least).min(most);
    [low.min(from_n), high.max(from_n)]
}

/// The first cable whose brake might fail its test where the robot rests (B2), the expected difference included. From where
/// one might already the robot can leave: `from_n` are the tensions at which the motion begins, N.
pub(super) fn judge_brakes(robot: &Robot, rest: &StaticState, from_n: &[f64]) -> Option<Broken> {
    let mut cables = rest.tensions_n().iter().enumerate();
    cables.find_map(|(index, &tension_n)| {
        let winch = robot.winch_of(index)?;
        let from_n = from_n.get(index).copied().unwrap_or(0.0);
        let proven_n = (winch.proven_tension_n() - FIXED_N) / (1.0 + SHARE);
        let most_n = proven_n.max(from_n);
        (tension_n > most_n).then(|| {
            let what = format!(
                "the tension of cable {} where its brake has to pass its test (brake_holding_n = {})",
                index + 1,
                winch.brake_holding_n
            );
            (what, tension_n, most_n, "N")
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::path::Path;
    use crate::motion::{Model, Plan, Step, judge_place};
    use nalgebra::Vector3;

    #[test]
    fn a_motion_may_begin_near_a_limit_but_not_beyond_it() {
        let robot = Robot::built_in("paper-table5").unwrap();
        let [low, high] = planned_n(&robot, 0);
        let [least, most] = limits_n(&robot, 0);
        let from = |from_n| planned_from_n(&robot, 0, Some(from_n));
        assert_eq!(from(10.0), [low, high]);
        let near = 0.5 * (high + most);
        assert_eq!(from(near), [low, near]);
        assert_eq!(from(most + 5.0), [low, most]);
        assert_eq!(from(0.0), [least, high]);
        assert_eq!(planned_from_n(&robot, 0, None), [low, high]);
    }

    /// A plan into the room below a limit is refused, and one out of it is not: by verdict and by place.
    #[test]
    fn the_verdict_keeps_the_room_and_lets_a_robot_leave_it() {
        let model = Model::new(&Robot::built_in("paper-table5").unwrap()).unwrap();
        let home_m = model.robot().tool.home_in_world_m;
        let [_, high] = planned_n(model.robot(), 0);
        let [_, most] = limits_n(model.robot(), 0);
        let greatest_n = |rest: &StaticState| rest.tensions_n().iter().copied().fold(0.0, f64::max);
        // Higher up cables become flat, and tensions rise.
        let (near_m, near) = (0..400)
            .map(|step| home_m + Vector3::new(0.0, 0.0, f64::from(step) * 1e-3))
            .filter_map(|at_m| Some((at_m, model.rest(&at_m, None).ok()?)))
            .find(|(_, rest)| greatest_n(rest) > high)
            .unwrap();
        assert!(greatest_n(&near) < most, "{:?}", near.tensions_n());
        let go = |from_m: Vector3<f64>, to_m: Vector3<f64>| {
            let step = Step::Move {
                path: Path::through(&[from_m, to_m]).unwrap(),
                duration_s: None,
                speed_mps: Some(0.02),
            };
            Plan::new(&model, &from_m, &[step])
        };
        let refused = go(home_m, near_m).unwrap_err().to_string();
        assert!(refused.contains("the board stops at 34.00 N"), "{refused}");
        go(near_m, home_m).unwrap();
        let nearer_m = near_m + Vector3::new(0.0, 0.0, 2e-3);
        go(near_m, nearer_m).unwrap_err();
        let place = |at_m, rest, now| judge_place(&model, at_m, rest, now).is_ok();
        assert!(!place(&near_m, &near, None) && place(&near_m, &near, Some(&near)));
    }

    /// A plan ends where every brake holds 1.6875 times its tension, with 3 % and 0.05 N of room, or, from where one does not,
    /// lower.
    #[test]
    fn a_plan_ends_only_where_every_brake_passes_its_test() {
        let mut robot = Robot::built_in("eight-cable").unwrap();
        let home_m = robot.tool.home_in_world_m;
        let go = |robot: &Robot, from_m: Vector3<f64>, to_m: Vector3<f64>| {
            let model = Model::new(robot).unwrap();
            let path = Path::through(&[from_m, to_m]).unwrap();
            let step = Step::Move {
                path,
                duration_s: None,
                speed_mps: Some(0.1),
            };
            Plan::new(&model, &from_m, &[step]).map(|_| ())
        };
        let most_n = |at_m: &Vector3<f64>| {
            let model = Model::new(&Robot::built_in("eight-cable").unwrap()).unwrap();
            let rest = model.rest(at_m, None).unwrap();
            rest.tensions_n().iter().copied().fold(0.0, f64::max)
        };
        let far_m = home_m + Vector3::new(0.15, 0.15, 0.1);
        let [home_n, far_n] = [most_n(&home_m), most_n(&far_m)];
        assert!(far_n > home_n + 2.0, "{home_n} {far_n}");
        go(&robot, home_m, far_m).unwrap();
        let least_n = 1.6875 * (1.03 * far_n + 0.05);
        for (holds_n, ends) in [(least_n + 0.1, true), (least_n - 0.1, false)] {
            for winch in &mut robot.winches {
                winch.brake_holding_n = holds_n;
            }
            let ended = go(&robot, home_m, far_m);
            assert_eq!(ended.is_ok(), ends, "{ended:?}");
            let said = ended
                .err()
                .map(|error| error.to_string())
                .unwrap_or_default();
            assert_eq!(
                said.contains("its brake has to pass its test"),
                !ends,
                "{said}"
            );
            go(&robot, far_m, home_m).unwrap();
        }
    }

    #[test]
    fn a_planned_tension_and_its_difference_stay_within_the_limits() {
        let robot = Robot::built_in("paper-table5").unwrap();
        let [low, high] = limits_n(&robot, 0);
        let [least, greatest] = planned_n(&robot, 0);
        assert!((least - difference_n(least) - low).abs() < 1e-12);
        assert!((greatest + difference_n(greatest) - high).abs() < 1e-12);
        assert!(low < least && greatest < high, "{least} {greatest}");
    }
}
