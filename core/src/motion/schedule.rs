//! The tension that the tension-held cable should have at a position of the tool.
//!
//! The rule: maximise the smallest tension of all cables, within the limits of plan and winch. Only
//! the ratio of tension to weight matters, so the rule is independent of the mass.

use super::allowance;
use super::model::{Model, StaticState};
use super::plan::PlanError;
use crate::robot::Control;
use nalgebra::Vector3;

/// Steps of the search; from a nearby position it takes two or three.
const MOST_STEPS: usize = 30;
/// Tolerance of the tension, N.
/// A sensor's noise is 20 to 100 times as large.
const CLOSE_N: f64 = 1e-3;
/// One step changes the tension by at most this share of the platform's weight.
/// That is 3.4 N for the paper's platform of 13.7 N.
const STEP_SHARE: f64 = 0.25;

/// Least and greatest tension that a plan may ask of the tension-held cable, N.
pub(super) fn bounds_n(model: &Model) -> (f64, f64) {
    let robot = model.robot();
    let (mut low, mut high) = (robot.tension.floor_n, robot.tension.ceiling_n);
    for (index, cable) in robot.cables.iter().enumerate() {
        if cable.control == Control::Tension {
            let [least, greatest] = allowance::planned_n(robot, index);
            low = low.max(least);
            high = high.min(greatest);
        }
    }
    // `clamp` panics for crossed bounds: with a contradictory robot file the ceiling decides.
    low = low.min(high);
    (low, high)
}

/// The tension that the rule gives with the tool at `tool_m`, N.
///
/// # Errors
/// [`PlanError::NoEquilibrium`] where the robot cannot hang there with any tension tried.
pub(super) fn best_n(
    model: &Model,
    tool_m: &Vector3<f64>,
    near: Option<&StaticState>,
) -> Result<f64, PlanError> {
    let (low, high) = bounds_n(model);
    let Some(held) = model.holding().first_by_tension() else {
        return Ok(model.robot().tension.setpoint_n);
    };
    let weight_n = model.geometry().weight_n();
    let start = near.and_then(|rest| rest.tensions_n().get(held).copied());
    let mut tension_n = start
        .unwrap_or(model.robot().tension.setpoint_n)
        .clamp(low, high);
    let mut rest = match model.rest_with(tool_m, tension_n, near) {
        Ok(rest) => rest,
        // The set-point may be impossible here although another tension is not.
        Err(error) => {
            // 0.15 to 1.2 of the weight: the best ratios of the paper's robot are 0.25 to 0.7.
            let tries = (1..=8).map(|share| weight_n * 0.15 * f64::from(share));
            let found = tries
                .filter(|n| (low..=high).contains(n))
                .find_map(|n| Some((n, model.rest_with(tool_m, n, None).ok()?)));
            let Some((n, rest)) = found else {
                return Err(error);
            };
            tension_n = n;
            rest
        }
    };
    let mut reach_n = STEP_SHARE * weight_n;
    for _ in 0..MOST_STEPS {
        let tool = &model.robot().tool.tcp_in_platform_m;
        let Ok(slopes) = model.geometry().tool_sensitivity(&rest.equilibrium, tool) else {
            break;
        };
        let column = |cable: usize| slopes.tensions_per_tension[(cable, held)];
        let lines: Vec<_> = rest
            .tensions_n()
            .iter()
            .enumerate()
            .map(|(cable, &n)| (n, if cable == held { 1.0 } else { column(cable) }))
            .collect();
        let range = (
            (low - tension_n).max(-reach_n),
            (high - tension_n).min(reach_n),
        );
        // Tensions are nearly linear in the held one: the least of some lines is greatest at a
        // crossing.
        let step_n = highest_minimum(&lines, range);
        if step_n.abs() < CLOSE_N {
            break;
        }
        let least = |rest: &StaticState| rest.tensions_n().iter().copied().fold(f64::MAX, f64::min);
        match model.rest_with(tool_m, tension_n + step_n, Some(&rest)) {
            // The lines are only tangents: a step counts if the solved tensions gain by it.
            Ok(next) if least(&next) > least(&rest) => {
                tension_n += step_n;
                rest = next;
            }
            _ if reach_n < CLOSE_N => break,
            _ => reach_n = step_n.abs() / 4.0,
        }
    }
    Ok(tension_n)
}

/// The position in a range at which the minimum of some lines (value at 0, slope) is greatest.
fn highest_minimum(lines: &[(f64, f64)], (from, to): (f64, f64)) -> f64 {
    let least = |x: f64| {
        let values = lines.iter().map(|(value, slope)| value + slope * x);
        values.fold(f64::MAX, f64::min)
    };
    let mut best = (from, least(from));
    let mut consider = |x: f64| {
        let value = least(x);
        if x.is_finite() && (from..=to).contains(&x) && value > best.1 {
            best = (x, value);
        }
    };
    consider(to);
    for (index, (value, slope)) in lines.iter().enumerate() {
        for (other, other_slope) in lines.iter().skip(index + 1) {
            consider((other - value) / (slope - other_slope));
        }
    }
    best.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    #[test]
    fn the_rule_beats_every_other_tension_and_gives_the_known_ratios() {
        let model = Model::new(&Robot::built_in("paper-optimistic").unwrap()).unwrap();
        let weight = model.geometry().weight_n();
        let least = |at: &Vector3<f64>, n: f64| {
            let rest = model.rest_with(at, n, None).ok()?;
            Some(rest.tensions_n().iter().copied().fold(f64::MAX, f64::min))
        };
        let tcp = model.robot().tool.tcp_in_platform_m.z;
        // Heights of the platform, and the ratio of tension to weight found on another robot.
        for (z, ratio) in [(-0.1, 0.7), (-0.2, 0.4), (-0.517, 0.25)] {
            let at = Vector3::new(0.335, 0.0, z + tcp);
            let best = best_n(&model, &at, None).unwrap();
            assert!(
                (best / weight - ratio).abs() < 0.12,
                "{z}: {}",
                best / weight
            );
            let reached = least(&at, best).unwrap();
            let (low, high) = bounds_n(&model);
            for step in 0..=200 {
                let n = low + (high - low) * f64::from(step) / 200.0;
                if let Some(other) = least(&at, n) {
                    assert!(
                        other <= reached + 1e-2,
                        "{z}: {n} N gives {other}, {reached}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_highest_minimum_is_where_lines_cross() {
        assert_eq!(
            highest_minimum(&[(0.0, 1.0), (2.0, -1.0)], (-5.0, 5.0)),
            1.0
        );
        assert_eq!(highest_minimum(&[(0.0, 1.0), (9.0, 2.0)], (-1.0, 3.0)), 3.0);
    }
}
