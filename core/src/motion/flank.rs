//! Which flank of a gear's teeth carries the load. A cable pulls its drum outwards, so that a gear with play rests on
//! one flank. If it has to push the drum out instead, the load changes sides, and the cable moves by the play.

use super::model::Model;
use crate::robot::Winch;

/// Force by which the gear of a winch holds its drum back, at the cable, N: positive on the flank that the cable loads,
/// 0 or less where the gear must push the drum out. From the tension (N), the pay-out speed (m/s) and its
/// rate (m/s2). `None` without a gear that has play.
///
/// Newton's law of the drum alone: the friction of rotor and gear acts on the motor's side of the play.
pub(super) fn force_n(
    winch: &Winch,
    tension_n: f64,
    speed_mps: f64,
    rate_mps2: f64,
) -> Option<f64> {
    if winch.play_m() <= 0.0 {
        return None;
    }
    let friction_n = if speed_mps == 0.0 {
        0.0
    } else {
        winch.friction_n.copysign(speed_mps)
    };
    let drum_kg = winch.drum_inertia_kg_m2 / winch.drum_radius_m.powi(2);
    Some(tension_n - friction_n - drum_kg * rate_mps2)
}

/// The same for every winch, from tensions, the pay-out speeds of now and of `step_s` earlier.
pub(super) fn forces_n(
    model: &Model,
    tensions_n: &[f64],
    now_mps: &[f64],
    then_mps: &[f64],
    step_s: f64,
) -> Vec<Option<f64>> {
    let pick = |list: &[f64], index: usize| list.get(index).copied().unwrap_or(0.0);
    let of = |(index, tension_n): (usize, &f64)| {
        let winch = model.robot().winch_of(index)?;
        let now = pick(now_mps, index);
        let rate = (now - pick(then_mps, index)) / step_s.max(1e-9);
        force_n(winch, *tension_n, now, rate)
    };
    tensions_n.iter().enumerate().map(of).collect()
}

/// The first gear whose load would change sides, as quantity, value, limit and unit.
pub(super) fn judge(
    model: &Model,
    flanks_n: &[Option<f64>],
) -> Option<(String, f64, f64, &'static str)> {
    flanks_n.iter().enumerate().find_map(|(index, force)| {
        let force_n = force.filter(|force| *force <= 0.0)?;
        let play_mm = model.robot().winch_of(index)?.play_m() * 1e3;
        let what = format!(
            "the load on the gear of cable {} (it changes sides, and the cable moves by its play of {play_mm:.2} mm)",
            index + 1
        );
        Some((what, force_n, 0.0, "N"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Plan, PlanError, Task};
    use crate::robot::Robot;

    #[test]
    fn a_drum_is_held_back_unless_its_friction_or_inertia_exceeds_the_tension() {
        let robot = Robot::built_in("paper-table5").unwrap();
        // Friction of 0.5 N, and a drum that acts like 0.1 kg.
        let winch = &robot.winches[0];
        let near = |a: Option<f64>, b: f64| assert!((a.unwrap() - b).abs() < 1e-9, "{a:?} {b}");
        near(force_n(winch, 5.0, 0.0, 0.0), 5.0);
        near(force_n(winch, 5.0, 0.01, 0.0), 4.5);
        near(force_n(winch, 5.0, -0.01, 0.0), 5.5);
        // Paid out ever faster, the drum needs a part of the tension.
        near(force_n(winch, 5.0, 0.01, 20.0), 2.5);
        near(force_n(winch, 0.3, 0.01, 0.0), -0.2);
        let rigid = Robot::built_in("paper-optimistic").unwrap();
        assert_eq!(force_n(&rigid.winches[0], 5.0, 0.01, 0.0), None);
    }

    #[test]
    fn a_plan_that_would_change_a_gears_flank_is_refused_with_the_cable_and_the_play() {
        let mut robot = Robot::built_in("paper-table5").unwrap();
        let planned = |robot: &Robot| {
            let model = Model::new(robot).unwrap();
            let task = Task::built_in("paper:table7", robot.tool.home_in_world_m.z).unwrap();
            let start = robot.tool.home_in_world_m;
            let task = task.approached_from(&start, None).unwrap();
            Plan::unjudged(&model, &start, &task.steps).unwrap()
        };
        let plan = planned(&robot);
        let seen = plan.extremes(&crate::motion::Watch::default()).unwrap();
        assert_eq!(seen.broken, None);
        // Never less than the least tension, less friction and some inertia.
        for (flank, tension) in seen.gear_load_n.iter().zip(&seen.tension_min_n) {
            let flank = flank.unwrap();
            assert!(
                (tension - 0.7..tension + 0.7).contains(&flank),
                "{flank} {tension}"
            );
        }
        // Bearings that hold the drum against more than its cable pulls.
        let least = seen.tension_min_n[1];
        robot.winches[1].friction_n = least + 1.0;
        let refused = planned(&robot).judged().unwrap_err();
        let PlanError::Limit { what, value, .. } = &refused else {
            panic!("{refused}");
        };
        assert!(
            what.starts_with("the load on the gear of cable 2"),
            "{what}"
        );
        assert!(what.contains("0.35 mm") && *value < 0.0, "{what} {value}");
        // Without play nothing moves.
        robot.winches[1].gear.as_mut().unwrap().play_rad = 0.0;
        assert!(planned(&robot).judged().is_ok());
    }
}
