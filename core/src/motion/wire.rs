//! A plan as the integers that a board follows.

use super::allowance;
use super::knot::{self, milliseconds};
use super::knots::{self, FitOptions, Spacing};
use super::model::{Model, StaticState};
use super::options::Planner;
use super::plan::{PlanError, TOLERANCE_M};
use super::spline::{Ends, Spline};
use super::timed::Timed;
use crate::machine::CableRates;
use mcdpr_protocol::{
    CableKnot, Coefficient, Knot, List, Micrometres, Millinewtons, PerCable, ResidualRow,
    TenthMicrometres,
};

/// Knots are at least this far apart, ms: the board's buffer of 16 then holds over 300 ms.
const LEAST_SPACING_MS: usize = 21;
/// Knots are at most this far apart, ms: tensions and residual rows go straight between them.
const MOST_SPACING_MS: usize = 1000;
/// A cable that slips shows as a closure error; an error up to this, besides what inexact tensions explain, is not
/// reported as slip, m. Swing, friction and errors of the machine's dimensions stay below it.
const CLOSURE_LIMIT_M: f64 = 0.004;

/// Each further tension-held cable counts this much in the closure row: mirror images do not cancel.
const NEXT_CLOSURE: f64 = 0.6;
/// Share of the tensions' vertical parts that pulley losses and sensor gains may account for, where
/// cables pull against each other.
const LOSSES_SHARE: f64 = 0.08;

/// Force on the platform other than the cables' that is not yet reported as a contact, as a share
/// of its weight: pulley losses, sensor gains and an error of the mass stay below it.
const CONTACT_SHARE: f64 = 0.2;

/// Knots of the whole motion: clamped cubic splines from rest to rest (Eq. 53), as many knots as
/// the tolerance needs, rounded to the wire's units. Numbers wrap after 65,536 knots.
pub(super) fn knots(model: &Model, timed: &Timed) -> Result<Vec<Knot>, PlanError> {
    let mut knots: Vec<Knot> = Vec::new();
    let rests: Vec<_> = timed.rests_s().into_iter().map(milliseconds).collect();
    for pair in rests.windows(2) {
        let &[from, to] = pair else { continue };
        let splines = fit(model, timed, (from, to))?;
        let count = splines.first().map_or(0, |spline| spline.knots().len());
        // A step's first knot is the last one of the step before.
        for index in usize::from(!knots.is_empty())..count {
            let at_s = splines
                .first()
                .and_then(|s| s.knots().get(index))
                .map_or(0.0, |k| k.time_s);
            let state = timed.rest(model, at_s)?;
            let tensions = state.tensions_n().iter().enumerate();
            let readings_n: Vec<f64> = tensions
                .map(|(cable, &tension_n)| model.reading_n(cable, tension_n))
                .collect();
            let cables = knot::on_splines(&splines, index, &readings_n);
            knots.push(Knot {
                rows: rows(model, &state),
                ..knot::knot(knots.len(), milliseconds(at_s), cables)
            });
        }
    }
    knot::end(&mut knots);
    judge(model, timed, &knots)?;
    Ok(knots)
}

/// Checks that no cable's cubic exceeds the board's limits of acceleration and jerk (K3).
fn judge(model: &Model, timed: &Timed, knots: &[Knot]) -> Result<(), PlanError> {
    let most = CableRates::of(model.robot());
    for pair in knots.windows(2) {
        let [from, to] = pair else { continue };
        for (cable, (a, b)) in (1..).zip(from.cables.iter().zip(to.cables.iter())) {
            let spacing_s = f64::from(to.time_ms - from.time_ms) * 1e-3;
            let [start, end] = accelerations(a, b, spacing_s);
            // A cubic's acceleration is linear: its extremes are at the ends, and its slope is the
            // jerk.
            let largest = start.abs().max(end.abs());
            let jerk = (end - start).abs() / spacing_s;
            let (what, value, limit, unit) = if largest > most.acceleration_mps2 {
                ("acceleration", largest, most.acceleration_mps2, "m/s²")
            } else if jerk > most.jerk_mps3 {
                ("jerk", jerk, most.jerk_mps3, "m/s³")
            } else {
                continue;
            };
            let time_s = to.time_s();
            let at_m = timed.tool_m(time_s)?;
            return Err(PlanError::Limit {
                time_s,
                x_mm: at_m.x * 1e3,
                y_mm: at_m.y * 1e3,
                z_mm: at_m.z * 1e3,
                what: format!("the {what} of cable {cable}"),
                value,
                limit,
                unit,
            });
        }
    }
    Ok(())
}

/// Second derivative at both ends of the cubic between two knots, m/s².
fn accelerations(from: &CableKnot, to: &CableKnot, spacing_s: f64) -> [f64; 2] {
    let way = TenthMicrometres(to.length.0 - from.length.0).metres() / spacing_s;
    let [start, end] = [from, to].map(|knot| knot.velocity.metres_per_second());
    [
        (6.0 * way - 4.0 * start - 2.0 * end) / spacing_s,
        (2.0 * start + 4.0 * end - 6.0 * way) / spacing_s,
    ]
}

/// Splines of all cables over one step, with common knots at whole milliseconds.
fn fit(model: &Model, timed: &Timed, (from, to): (u32, u32)) -> Result<Vec<Spline>, PlanError> {
    let seconds = |time_ms: u32| f64::from(time_ms) * 1e-3;
    let span_ms = (to - from) as usize;
    let most_segments = (span_ms / LEAST_SPACING_MS).max(1);
    let options = FitOptions {
        ends: Ends::Clamped {
            start: 0.0,
            end: 0.0,
        },
        spacing: Spacing::Ticks,
        tolerance: TOLERANCE_M,
        // A wait, too, has knots a second apart at most: tensions and rows are linear between them.
        least_segments: span_ms.div_ceil(MOST_SPACING_MS).max(4).min(most_segments),
        most_segments,
    };
    let cables = model.robot().cables.len();
    let fit = knots::fit(
        cables,
        (seconds(from), seconds(to)),
        options,
        |time_s, values| {
            values.copy_from_slice(&timed.lengths_m(time_s)?);
            Ok::<(), PlanError>(())
        },
    )?;
    Ok(fit.splines)
}

/// The consistency checks that a knot carries: the board takes the first for S5, the second for C5.
/// A plan that does not ask for equilibrium has none.
fn rows(model: &Model, rest: &StaticState) -> List<ResidualRow, { ResidualRow::PER_KNOT }> {
    let closure = (model.options().planner == Planner::Equilibrium)
        .then(|| closure_row(model, rest))
        .flatten();
    let Some(closure) = closure else {
        return List::new();
    };
    let contact = model.watches_contact().then(|| contact_row(model, rest));
    let both = [Some(closure), contact.flatten()];
    List::collect(both.into_iter().flatten())
}

/// The sum of the tensions' vertical parts is the platform's weight. A deficit means that something
/// else supports the platform, an excess that something pulls on it. The row's µm are mN here.
fn contact_row(model: &Model, rest: &StaticState) -> Option<ResidualRow> {
    let count = model.robot().cables.len();
    let jacobian = model
        .geometry()
        .twist_jacobian(&rest.equilibrium.pose)
        .ok()?;
    let mut tensions = PerCable::new();
    let mut lengths = PerCable::new();
    let mut vertical_n = 0.0;
    for cable in 0..count {
        // A row begins with the direction in which the cable gets longer; the cable pulls the other
        // way.
        let upward = -jacobian.get(cable)?[2];
        vertical_n += upward.abs() * rest.tensions_n().get(cable).copied().unwrap_or(0.0);
        let scaled = rounded(upward * f64::from(ResidualRow::TENSION_SCALE));
        tensions
            // A coefficient beyond the wire's range leaves the row out: the motion goes without
            // this check.
            .push(Coefficient(i16::try_from(scaled).ok()?))
            .ok()?;
        lengths.push(Coefficient(0)).ok()?;
    }
    let platform = &model.robot().platform;
    let weight_n = platform.mass_kg * mcdpr_kinematics::GRAVITY_MPS2;
    Some(ResidualRow {
        lengths,
        tensions,
        // The row's µm are mN.
        limit: Micrometres(
            Millinewtons::from_newtons((CONTACT_SHARE * weight_n).max(LOSSES_SHARE * vertical_n)).0,
        ),
    })
}

/// Consistency of measured lengths and tensions: at equilibrium the lengths of the tension-held cables
/// follow from the other lengths and their tensions. A robot without tension-held cables has a row of
/// zeros, which never fires.
fn closure_row(model: &Model, rest: &StaticState) -> Option<ResidualRow> {
    let holding = model.holding();
    let count = model.robot().cables.len();
    // m, and m/N.
    let (mut by_length, mut by_tension) = (vec![0.0; count], vec![0.0; count]);
    if holding.first_by_tension().is_some() {
        let response = model.geometry().linearise(&rest.equilibrium).ok()?.response;
        let mut weight = 1.0;
        for &held in holding.by_tension() {
            let row = response.row(held)?;
            for (cable, &by_input) in row.iter().enumerate() {
                let column = if holding.by_tension().contains(&cable) {
                    &mut by_tension
                } else {
                    &mut by_length
                };
                *column.get_mut(cable)? -= weight * by_input;
            }
            *by_length.get_mut(held)? += weight;
            // A cable that six lengths keep taut stretches by more than the platform gives way.
            if !holding.hangs() {
                let cable = model.robot().cables.get(held)?;
                let length_m = rest.equilibrium.lengths_m.get(held)? + cable.routing_length_m;
                *by_tension.get_mut(held)? += weight * length_m / cable.ea_n;
            }
            weight *= NEXT_CLOSURE;
        }
        // A platform that accelerates or swings pulls its cables by other tensions than at rest, and they
        // stretch accordingly: in a frame of 5 m this is more than the limit. The reaction of tensions to
        // lengths, which the response contains already, is far smaller where the platform hangs.
        if holding.hangs() {
            for (index, cable) in model.robot().cables.iter().enumerate() {
                if !holding.by_tension().contains(&index) {
                    let length_m = rest.equilibrium.lengths_m.get(index)? + cable.routing_length_m;
                    *by_tension.get_mut(index)? += by_length.get(index)? * length_m / cable.ea_n;
                }
            }
        }
    }
    // Where the platform hangs weakly a small error of a tension moves it far: up to 11 mm per N near the edge of
    // `paper-table5`'s space. That is no slip.
    let by_tensions_m = by_tension.iter().zip(rest.tensions_n());
    let by_tensions_m =
        by_tensions_m.map(|(m_per_n, n)| m_per_n.abs() * allowance::difference_n(*n));
    let limit_m = CLOSURE_LIMIT_M + by_tensions_m.sum::<f64>();
    let mut lengths = PerCable::new();
    let mut tensions = PerCable::new();
    for (length, tension) in by_length.iter().zip(&by_tension) {
        let scaled = |value: f64, scale: i32| {
            i16::try_from(rounded(value * f64::from(scale)))
                .ok()
                .map(Coefficient)
        };
        lengths
            .push(scaled(*length, ResidualRow::LENGTH_SCALE)?)
            .ok()?;
        // m/N is 1000 µm/mN.
        tensions
            .push(scaled(tension * 1e3, ResidualRow::TENSION_SCALE)?)
            .ok()?;
    }
    Some(ResidualRow {
        lengths,
        tensions,
        limit: Micrometres::from_metres(limit_m),
    })
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "saturates beyond any robot"
)]
fn rounded(value: f64) -> i32 {
    value.round() as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::path::{Path, Piece};
    use crate::motion::{Plan, Step};
    use crate::robot::Robot;
    use nalgebra::Vector3;

    #[test]
    fn motions_of_a_hundredth_of_a_millimetre_up_to_a_centimetre_can_be_planned() {
        for robot in ["paper-table5", "lab-fast", "lab-direct", "eight-cable"] {
            let robot = Robot::built_in(robot).unwrap();
            let model = Model::new(&robot).unwrap();
            let start_m = robot.tool.home_in_world_m;
            // Two segments of 25 ms were not enough from 0.142 to 0.147 mm.
            for step in 0..600 {
                let way_m = 1e-5 * f64::powf(10.0, f64::from(step) * 0.005);
                let end_m = start_m + Vector3::new(0.6, -0.64, 0.48) * way_m;
                let step = Step::Move {
                    path: Path::new(vec![Piece::line(start_m, end_m).unwrap()]).unwrap(),
                    duration_s: None,
                    speed_mps: None,
                };
                if let Err(error) = Plan::new(&model, &start_m, &[step]) {
                    panic!("{}, {way_m} m: {error}", robot.name);
                }
            }
        }
    }

    #[test]
    fn the_closure_limit_grows_where_a_tension_moves_the_platform_far() {
        let model = Model::new(&Robot::built_in("paper-table5").unwrap()).unwrap();
        let limit_um = |x: f64, y: f64, z: f64| {
            let rest = model.rest(&Vector3::new(x, y, z), None).unwrap();
            closure_row(&model, &rest).unwrap().limit.0
        };
        let home = model.robot().tool.home_in_world_m;
        let at_home = limit_um(home.x, home.y, home.z);
        let at_the_edge = limit_um(0.55, -0.26, -0.16);
        assert!((4000..4300).contains(&at_home), "{at_home}");
        assert!((5000..40_000).contains(&at_the_edge), "{at_the_edge}");
    }

    #[test]
    fn k3_a_length_that_is_off_by_a_millimetre_breaks_the_acceleration_or_the_jerk() {
        for robot in ["paper-optimistic", "lab-fast"] {
            let model = Model::new(&Robot::built_in(robot).unwrap()).unwrap();
            let start_m = Vector3::new(0.335, 0.0, -0.3);
            let end_m = start_m + Vector3::new(0.05, -0.05, 0.0);
            let step = Step::Move {
                path: Path::new(vec![Piece::line(start_m, end_m).unwrap()]).unwrap(),
                duration_s: None,
                speed_mps: None,
            };
            let plan = Plan::new(&model, &start_m, &[step]).unwrap();
            assert!(plan.knots.len() > 8);
            judge(&model, &plan.timed, &plan.knots).unwrap();
            for knot in 1..plan.knots.len() - 1 {
                let mut knots = plan.knots.clone();
                knots[knot].cables[1].length.0 += 10_000;
                let error = judge(&model, &plan.timed, &knots).unwrap_err().to_string();
                assert!(
                    error.contains("of cable 2 would be"),
                    "{robot}, {knot}: {error}"
                );
            }
        }
    }
}
