//! Tables 7 and 8 at z = 24 mm, where only geometry can be computed.

use super::{Bench, Origin, Outcome, ReproduceError, Row, none, paper_robot};
use crate::machine;
use crate::motion::path::Path;
use crate::motion::spline::{Ends, Spline};
use crate::motion::{Model, judge_place};
use mcdpr_kinematics::{AnyRobot, ForwardOptions, Pose};
use nalgebra::{Rotation3, Vector3};

/// The paper's height, m.
const HEIGHT_M: f64 = 0.024;
/// Cubic segments of a path.
const SEGMENTS: u32 = 32;
/// Points between two knots at which the path is compared.
const BETWEEN: u32 = 16;

/// The error, in its own words.
fn failed(error: impl std::fmt::Display) -> ReproduceError {
    ReproduceError::Service(error.to_string())
}

/// Greatest distance, m, between a path of the level platform and the result of cubic splines of
/// the cable lengths through [`SEGMENTS`] + 1 of its points. `law` gives the share of the path at a
/// share of the time.
fn deviation_m(
    robot: &AnyRobot,
    at: &dyn Fn(f64) -> Result<Vector3<f64>, ReproduceError>,
    law: &dyn Fn(f64) -> f64,
    ends: Ends,
) -> Result<f64, ReproduceError> {
    let lengths = |time: f64| {
        let place = at(law(time))?;
        robot.lengths_m(&Pose::level(place)).map_err(failed)
    };
    let times: Vec<f64> = (0..=SEGMENTS)
        .map(|knot| f64::from(knot) / f64::from(SEGMENTS))
        .collect();
    let mut splines = Vec::new();
    for cable in 0..robot.cable_count() {
        let mut values = Vec::new();
        for time in &times {
            values.push(lengths(*time)?.get(cable).copied().unwrap_or_default());
        }
        splines.push(Spline::interpolate(&times, &values, ends).map_err(failed)?);
    }
    let mut worst_m = 0.0_f64;
    for step in 0..=SEGMENTS * BETWEEN {
        let time = f64::from(step) / f64::from(SEGMENTS * BETWEEN);
        let mut made = Vec::new();
        for spline in &splines {
            made.push(spline.sample(time).map_err(failed)?.value);
        }
        let wanted = at(law(time))?;
        let options = ForwardOptions::default();
        let level = Rotation3::identity();
        let found = robot
            .position(&made, &level, Some(&wanted), &options)
            .map_err(failed)?;
        worst_m = worst_m.max((found.pose.position_m - wanted).norm());
    }
    Ok(worst_m)
}

/// Both tables at the paper's own height.
pub(super) fn at_24_mm(_bench: &Bench) -> Result<Outcome, ReproduceError> {
    let model = Model::new(&paper_robot()?)?;
    let robot = machine::geometry(model.robot()).map_err(failed)?;
    let circle = Path::paper_circle(HEIGHT_M).map_err(failed)?;
    let line = Path::paper_line(HEIGHT_M).map_err(failed)?;
    let along = |path: &Path, arcs: bool, share: f64| {
        let pieces = path.pieces().iter();
        let mut wanted = pieces.filter(|piece| piece.radius_m().is_some() == arcs);
        let Some(piece) = wanted.next() else {
            return Err(failed("the path has no such piece"));
        };
        let s_m = (share * piece.length_m()).clamp(0.0, piece.length_m());
        Ok(piece.point(s_m).map_err(failed)?.position_m)
    };
    let on_circle = |share: f64| along(&circle, true, share);
    let on_line = |share: f64| along(&line, false, share);
    let steady = |t: f64| t;
    // From rest to rest: speed and acceleration are zero at both ends.
    let quintic = |t: f64| t.powi(3) * (10.0 - 15.0 * t + 6.0 * t * t);
    let clamped = Ends::Clamped {
        start: 0.0,
        end: 0.0,
    };
    let row = |quantity: &str, value_m: f64| Row {
        quantity: quantity.to_owned(),
        paper: "-".to_owned(),
        origin: Origin::Arithmetic,
        as_described: format!("{:.4}", value_m * 1e3),
        realistic: none(),
        chip: none(),
    };
    let platform = on_circle(0.0)?;
    let tool_m = platform + model.robot().tool.tcp_in_platform_m;
    let verdict = match model.rest(&tool_m, None) {
        Ok(rest) => match judge_place(&model, &tool_m, &rest, None) {
            Ok(()) => "It would be within every limit.".to_owned(),
            Err(error) => format!("With physics it is refused: {error}."),
        },
        Err(error) => format!("With physics it is refused: {error}."),
    };
    Ok(Outcome {
        id: "geometry",
        title: "The circle and the line at z = 24 mm, kinematics only (Tables 7 and 8)",
        rows: vec![
            row(
                "circle: deviation of 32 cubic segments, constant speed, not-a-knot ends, mm",
                deviation_m(&robot, &on_circle, &steady, Ends::NotAKnot)?,
            ),
            row(
                "circle: the same with natural ends, mm",
                deviation_m(&robot, &on_circle, &steady, Ends::Natural)?,
            ),
            row(
                "circle: from rest to rest (a quintic in time), clamped ends, mm",
                deviation_m(&robot, &on_circle, &quintic, clamped)?,
            ),
            row(
                "line: deviation of 32 cubic segments, constant speed, not-a-knot ends, mm",
                deviation_m(&robot, &on_line, &steady, Ends::NotAKnot)?,
            ),
            row(
                "line: the same with natural ends, mm",
                deviation_m(&robot, &on_line, &steady, Ends::Natural)?,
            ),
            row(
                "line: from rest to rest (a quintic in time), clamped ends, mm",
                deviation_m(&robot, &on_line, &quintic, clamped)?,
            ),
        ],
        notes: vec![format!(
            "The paper's platform height lies 10 mm below the pulleys' tops. Its cable lengths at \
             a level attitude are splined (Eqs. 53, 54) and led back through forward kinematics; \
             the project's bound is 0.01 mm, and its \
             planner takes as many knots as that needs. {verdict} So the same paths are run at z = -100 mm."
        )],
        charts: Vec::new(),
        pictures: Vec::new(),
    })
}
