//! Checks a motion before it starts: the first limit that it would break, and its margin to the
//! others.

use super::allowance;
use super::flank;
use super::margin::{Margin, Margins, Moment};
use super::model::{Model, StaticState};
use super::options::Planner;
use super::plan::PlanError;
use super::timed::Timed;
use crate::holding::Freedom;
use mcdpr_kinematics::PlatformBox;
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// Interval at which states are checked, s.
/// At 0.5 m/s the tool moves 5 mm in it.
const CHECK_STEP_S: f64 = 0.01;
/// Cables may come this close to each other, m: they are a millimetre thick, and swing.
const CABLE_CLEARANCE_M: f64 = 0.005;
/// The last part of a cable touches the platform by design, m.
const STUB_M: f64 = 0.03;
/// Least share of a solid platform's box that a cable may enter: the inertia is rarely that of a
/// solid box, so only half of its edges are taken as solid.
const SOLID: f64 = 0.5;

/// Limits besides those of the robot file that a motion must keep.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Watch {
    /// A place (world, m) that the platform's camera must keep in its picture.
    pub in_view_m: Option<Vector3<f64>>,
}

/// Margin of a motion to its limits, SI.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Extremes {
    /// Duration, s.
    pub duration_s: f64,
    /// Greatest speed of the tool along its path, m/s.
    pub speed_mps: f64,
    /// Least tension of each cable, N.
    pub tension_min_n: Vec<f64>,
    /// Greatest tension of each cable, N.
    pub tension_max_n: Vec<f64>,
    /// Greatest motor speed of each winch, turns per minute.
    pub motor_rpm: Vec<f64>,
    /// Greatest motor current of each winch, gear losses left out, A.
    pub motor_current_a: Vec<f64>,
    /// Least force of each gear on the flank that the cable loads, at the cable, N; `None` without play in the gear.
    pub gear_load_n: Vec<Option<f64>>,
    /// Most turns of cable that are off each drum.
    pub drum_turns: Vec<f64>,
    /// Greatest tilt, rad.
    pub tilt_rad: f64,
    /// Least distance between two cables, m; `None` without a pair.
    pub cable_distance_m: Option<f64>,
    /// Where it comes closest to each limit, the closest first.
    pub margins: Vec<Margin>,
    /// The first limit that would be broken, in words.
    pub broken: Option<String>,
}

/// Judges one resting place of the tool (world, m) against every limit that needs no speed. From where the robot rests
/// now, if that is given, no tension may come nearer to a limit that is near already.
///
/// # Errors
/// [`PlanError::Limit`].
pub fn judge_place(
    model: &Model,
    tool_m: &Vector3<f64>,
    rest: &StaticState,
    now: Option<&StaticState>,
) -> Result<(), PlanError> {
    let from_n = now.map_or(&[][..], StaticState::tensions_n);
    let broken = judge_state(model, tool_m, rest, from_n, &Watch::default());
    match broken.or_else(|| allowance::judge_brakes(model.robot(), rest, from_n)) {
        None => Ok(()),
        Some((what, value, limit, unit)) => Err(PlanError::Limit {
            time_s: 0.0,
            x_mm: tool_m.x * 1e3,
            y_mm: tool_m.y * 1e3,
            z_mm: tool_m.z * 1e3,
            what,
            value,
            limit,
            unit,
        }),
    }
}

/// The broken limit: quantity, value, limit, unit.
pub(super) type Broken = (String, f64, f64, &'static str);

/// The first limit that the motion would break.
pub(super) fn judge(model: &Model, timed: &Timed) -> Result<(), PlanError> {
    look(model, timed, &Watch::default(), true).map(|_| ())
}

/// Margin of a motion to every limit; the first broken one is in the answer.
///
/// # Errors
/// Never for a motion that was timed.
pub(super) fn extremes(model: &Model, timed: &Timed, watch: &Watch) -> Result<Extremes, PlanError> {
    look(model, timed, watch, false)
}

/// The first limit that the motion would break, the watched ones included.
pub(super) fn judge_watched(model: &Model, timed: &Timed, watch: &Watch) -> Result<(), PlanError> {
    look(model, timed, watch, true).map(|_| ())
}

fn look(model: &Model, timed: &Timed, watch: &Watch, refuse: bool) -> Result<Extremes, PlanError> {
    let body = platform_box(model);
    let count = model.robot().cables.len();
    let mut seen = Extremes {
        duration_s: timed.duration_s(),
        tension_min_n: vec![f64::MAX; count],
        tension_max_n: vec![0.0; count],
        motor_rpm: vec![0.0; count],
        motor_current_a: vec![0.0; count],
        gear_load_n: vec![None; count],
        drum_turns: vec![0.0; count],
        ..Extremes::default()
    };
    let mut margins = (!refuse).then(Margins::default);
    let mut before: Option<(f64, StaticState, Vec<f64>)> = None;
    let end_s = timed.duration_s();
    let mut last = false;
    let mut from_n = Vec::new();
    // Counted, not summed: 0.01 s added 100 000 times would drift from the end.
    for index in 0_u32.. {
        let time_s = (f64::from(index) * CHECK_STEP_S).min(end_s);
        let rest = timed.rest(model, time_s)?;
        let tool_m = timed.tool_m(time_s)?;
        let step_s = before.as_ref().map_or(0.0, |(at, ..)| time_s - at);
        let speeds = before
            .as_ref()
            .map(|(_, old, _)| speeds(old, &rest, step_s));
        if index == 0 {
            from_n = rest.tensions_n().to_vec();
        }
        let mut broken = judge_state(model, &tool_m, &rest, &from_n, watch)
            .or_else(|| speeds.as_ref().and_then(|v| judge_speed(model, v)));
        // After a motion the robot parks sooner or later.
        if last {
            broken = broken.or_else(|| allowance::judge_brakes(model.robot(), &rest, &from_n));
        }
        seen.take(model, &rest, timed.speed_mps(time_s));
        let at = Moment { time_s, tool_m };
        if let Some(margins) = &mut margins {
            margins.take_state(model, &rest, at);
        }
        if let Some(now) = &speeds {
            let then = before.as_ref().map(|(_, _, then)| then.as_slice());
            let then = then.unwrap_or_default();
            let forces = forces(model, &rest, now, then, step_s);
            let flanks = flank::forces_n(model, rest.tensions_n(), now, then, step_s);
            seen.take_speeds(model, now, &forces);
            seen.take_flanks(&flanks);
            if let Some(margins) = &mut margins {
                margins.take_speeds(model, now, &forces, at);
                margins.take_flanks(model, &flanks, at);
            }
            broken = broken
                .or_else(|| judge_force(model, &forces))
                .or_else(|| flank::judge(model, &flanks));
        }
        // Distances change slowly: every fifth state is enough.
        if index % 5 == 0 && model.options().planner == Planner::Equilibrium && !meets(model) {
            let (near, touching) = clearances(model, &rest, &body)?;
            if let Some(near) = near {
                let least = seen.cable_distance_m.unwrap_or(f64::MAX);
                seen.cable_distance_m = Some(least.min(near));
                if let Some(margins) = &mut margins {
                    margins.take_distance(near, CABLE_CLEARANCE_M, at);
                }
            }
            broken = broken.or(touching);
        }
        if let Some((what, value, limit, unit)) = broken.filter(|_| seen.broken.is_none()) {
            let error = PlanError::Limit {
                time_s,
                x_mm: tool_m.x * 1e3,
                y_mm: tool_m.y * 1e3,
                z_mm: tool_m.z * 1e3,
                what,
                value,
                limit,
                unit,
            };
            if refuse {
                return Err(error);
            }
            seen.broken = Some(error.to_string());
        }
        before = Some((time_s, rest, speeds.unwrap_or_else(|| vec![0.0; count])));
        if last {
            break;
        }
        // One more pass, cut to the end: the last state is always judged.
        last = f64::from(index + 1) * CHECK_STEP_S >= end_s;
    }
    seen.margins = margins.map_or_else(Vec::new, Margins::sorted);
    Ok(seen)
}

impl Extremes {
    fn take(&mut self, model: &Model, rest: &StaticState, speed_mps: f64) {
        self.speed_mps = self.speed_mps.max(speed_mps);
        self.tilt_rad = self.tilt_rad.max(rest.equilibrium.pose.tilt_rad());
        let bounds = self.tension_min_n.iter_mut().zip(&mut self.tension_max_n);
        for ((low, high), tension) in bounds.zip(rest.tensions_n()) {
            *low = low.min(*tension);
            *high = high.max(*tension);
        }
        let turns = self.drum_turns.iter_mut().zip(&rest.paid_out_m);
        for (index, (most, paid_out)) in turns.enumerate() {
            if let Some(winch) = model.robot().winch_of(index) {
                *most = most.max(paid_out / (std::f64::consts::TAU * winch.drum_radius_m));
            }
        }
    }

    fn take_flanks(&mut self, flanks: &[Option<f64>]) {
        for (least, flank) in self.gear_load_n.iter_mut().zip(flanks) {
            *least = flank.map(|force| least.map_or(force, |least| least.min(force)));
        }
    }

    fn take_speeds(&mut self, model: &Model, speeds: &[f64], forces: &[f64]) {
        let rows = self.motor_rpm.iter_mut().zip(&mut self.motor_current_a);
        for (index, ((rpm, current), (speed, force))) in
            rows.zip(speeds.iter().zip(forces)).enumerate()
        {
            if let Some(winch) = model.robot().winch_of(index) {
                let share = speed.abs() / winch.max_cable_speed_mps();
                *rpm = rpm.max(share * winch.max_motor_rpm);
                *current = current.max(force / winch.force_per_current_n_per_a());
            }
        }
    }
}

/// Pay-out speeds of the cables, m/s.
fn speeds(old: &StaticState, new: &StaticState, step_s: f64) -> Vec<f64> {
    let pairs = old.paid_out_m.iter().zip(&new.paid_out_m);
    pairs
        .map(|(before, after)| (after - before) / step_s.max(1e-9))
        .collect()
}

/// Force that each winch must give at the cable: tension, friction, and the inertia of drum and
/// rotor, N.
fn forces(model: &Model, rest: &StaticState, now: &[f64], then: &[f64], step_s: f64) -> Vec<f64> {
    let tensions = rest.tensions_n().iter();
    tensions
        .enumerate()
        .map(|(index, tension)| {
            let Some(winch) = model.robot().winch_of(index) else {
                return *tension;
            };
            let pick = |list: &[f64]| list.get(index).copied().unwrap_or(0.0);
            // Of either sign: the motor drives or brakes the drum, and both need current.
            let change = (pick(now) - pick(then)).abs() / step_s.max(1e-9);
            winch.driving_force_n(*tension) + winch.effective_mass_kg() * change
        })
        .collect()
}

fn judge_force(model: &Model, forces: &[f64]) -> Option<Broken> {
    forces.iter().enumerate().find_map(|(index, force)| {
        let winch = model.robot().winch_of(index)?;
        let current = force / winch.force_per_current_n_per_a();
        (current > winch.max_current_a).then(|| {
            let what = format!("the motor current of cable {}", index + 1);
            (what, current, winch.max_current_a, "A")
        })
    })
}

fn judge_speed(model: &Model, speeds: &[f64]) -> Option<Broken> {
    speeds.iter().enumerate().find_map(|(index, speed)| {
        let winch = model.robot().winch_of(index)?;
        let most = winch.max_cable_speed_mps();
        // Rounding must not refuse a plan at exactly the limit.
        (speed.abs() > most * (1.0 + 1e-6)).then(|| {
            let rpm = speed.abs() / most * winch.max_motor_rpm;
            let what = format!("the speed of cable {} ({rpm:.0} motor rpm)", index + 1);
            (what, speed.abs() * 1e3, most * 1e3, "mm/s")
        })
    })
}

fn judge_state(
    model: &Model,
    tool_m: &Vector3<f64>,
    rest: &StaticState,
    from_n: &[f64],
    watch: &Watch,
) -> Option<Broken> {
    let robot = model.robot();
    let limits = &robot.limits;
    if let Some([low, high]) = &limits.box_in_world_m {
        // Nothing brings a robot closer to the plane beside which it hangs.
        let tool_m = model.asked(tool_m);
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            let (value, low, high) = (tool_m[axis], low[axis], high[axis]);
            if value < low || value > high {
                let limit = if value < low { low } else { high };
                let what = format!("the tool's {name} (limits.box_mm)");
                return Some((what, value * 1e3, limit * 1e3, "mm"));
            }
        }
    }
    let tilt = rest.equilibrium.pose.tilt_rad();
    if tilt > limits.tilt_max_rad {
        let degrees = (tilt.to_degrees(), limits.tilt_max_rad.to_degrees());
        return Some((
            "the platform's tilt".to_owned(),
            degrees.0,
            degrees.1,
            "deg",
        ));
    }
    // From an unstable equilibrium the platform falls to another one: no motion could follow it.
    if !rest.equilibrium.stable {
        return Some((
            "the stability of the platform (1 stable)".to_owned(),
            0.0,
            1.0,
            "",
        ));
    }
    let cables = rest.tensions_n().iter().zip(&rest.paid_out_m);
    for (index, (&tension, &paid_out)) in cables.enumerate() {
        let Some(winch) = robot.winch_of(index) else {
            continue;
        };
        let number = index + 1;
        let [low, high] = allowance::planned_from_n(robot, index, from_n.get(index).copied());
        if tension > high || tension < low {
            let [stops_low, stops_high] = allowance::limits_n(robot, index);
            let (limit, stops) = if tension > high {
                (high, stops_high)
            } else {
                (low, stops_low)
            };
            let what = format!("the tension of cable {number} (the board stops at {stops:.2} N)");
            return Some((what, tension, limit, "N"));
        }
        let most = winch.turns_max * std::f64::consts::TAU * winch.drum_radius_m;
        if paid_out > most {
            let what = format!("the length of cable {number} on its drum (turns_max)");
            return Some((what, paid_out * 1e3, most * 1e3, "mm"));
        }
    }
    watch
        .in_view_m
        .and_then(|place_m| out_of_view(model, rest, &place_m))
}

/// Whether a watched point has left the camera's picture, and by how much.
fn out_of_view(model: &Model, rest: &StaticState, place_m: &Vector3<f64>) -> Option<Broken> {
    let camera = &model.robot().camera;
    let pose = &rest.equilibrium.pose;
    let in_platform = pose.rotation.inverse() * (place_m - pose.position_m);
    let in_camera = camera.camera_from_platform.transform(&in_platform);
    let [width, height] = camera.lens.size_px.map(|size| size as f64);
    let Some(seen) = camera.lens.projection(&in_camera.into()) else {
        let what = "the watched place, which is behind the camera,".to_owned();
        return Some((what, in_camera.z * 1e3, 0.0, "mm in front of it"));
    };
    for (value, size, name) in [(seen.pixel.x, width, "u"), (seen.pixel.y, height, "v")] {
        if !(0.0..=size).contains(&value) {
            let limit = if value < 0.0 { 0.0 } else { size };
            let what = format!("the watched place's {name} in the camera's picture");
            return Some((what, value, limit, "px"));
        }
    }
    None
}

/// The platform as a box with the same mass and inertia.
fn platform_box(model: &Model) -> PlatformBox {
    let platform = &model.robot().platform;
    let inertia: Matrix3<f64> = platform.inertia_kg_m2;
    let diagonal = inertia.diagonal();
    // I_x = m (b^2 + c^2) / 12, and so on: solved for the edges.
    let sum = diagonal.sum() / 2.0;
    let edges = diagonal.map(|moment| (12.0 / platform.mass_kg * (sum - moment)).max(0.0).sqrt());
    PlatformBox {
        center_m: platform.center_of_mass_m,
        half_size_m: edges * (0.5 * SOLID),
    }
}

/// Whether all cables meet in one point of the platform: they touch there by design.
fn meets(model: &Model) -> bool {
    let freedom = model.holding().freedom();
    matches!(freedom, Freedom::Point | Freedom::PlanePoint { .. })
}

/// Distance of the closest cables, and the first contact.
fn clearances(
    model: &Model,
    rest: &StaticState,
    body: &PlatformBox,
) -> Result<(Option<f64>, Option<Broken>), PlanError> {
    let pose = &rest.equilibrium.pose;
    let pair = model.geometry().closest_cables(pose)?;
    let touching = pair
        .filter(|pair| pair.distance_m < CABLE_CLEARANCE_M)
        .map(|pair| {
            let [a, b] = pair.cables;
            let what = format!("the distance between cables {a} and {b}");
            (what, pair.distance_m * 1e3, CABLE_CLEARANCE_M * 1e3, "mm")
        });
    let touching = match touching {
        Some(broken) => Some(broken),
        None => {
            let found = model.geometry().closest_to_platform(pose, body, STUB_M)?;
            (found.distance_m <= 0.0).then(|| {
                let what = format!("the distance of cable {} from the platform", found.cable);
                (what, found.distance_m * 1e3, 0.0, "mm")
            })
        }
    };
    Ok((pair.map(|pair| pair.distance_m), touching))
}
