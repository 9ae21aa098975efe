//! Verdicts on a grid of places.

use crate::failure::Failure;
use mcdpr::compute::{Hanging, Subject};
use mcdpr_kinematics::{
    AnyWorkspaceTest, Balance, Bound as Side, Error, Grid, Solver, Verdict, rotation_from_rpy,
};
use nalgebra::Vector3;
use numpy::PyArray1;
use pyo3::prelude::*;

/// Codes of the verdicts of a grid, and the cable that limits each (from 1; 0: none).
pub(crate) type Verdicts = (Py<PyArray1<u8>>, Py<PyArray1<u8>>);

/// What a place must satisfy.
pub(crate) struct Asked<'a> {
    /// The grid holds places of the tool instead of the platform's origin.
    pub(crate) tool: bool,
    /// Attitude of tests without statics: roll, pitch, yaw.
    pub(crate) attitude_rad: [f64; 3],
    /// Tensions by cable, `None` where the length is held; without them those of a plan.
    pub(crate) tensions_n: Option<Vec<Option<f64>>>,
    pub(crate) min_n: &'a [f64],
    pub(crate) max_n: &'a [f64],
    pub(crate) tilt_max_rad: f64,
}

/// The verdicts between two corners (world, m), x fastest. `test` is "wrench", "forces" or "rest".
pub(crate) fn verdicts(
    py: Python<'_>,
    subject: &Subject,
    test: &str,
    [min_m, max_m]: [Vector3<f64>; 2],
    counts: [usize; 3],
    asked: &Asked<'_>,
) -> PyResult<Verdicts> {
    if subject.planar {
        let error = subject.refused(Error::TooFewCables {
            solver: Solver::TensionDistribution,
            needed: 6,
            got: subject.count(),
        });
        return Err(Failure::from(error).into());
    }
    let own = subject.own_tensions();
    let tensions = asked.tensions_n.as_deref().unwrap_or(&own);
    let tool_in_platform_m = subject.point(asked.tool);
    let rotation = rotation_from_rpy(asked.attitude_rad);
    let fixed = |balance| AnyWorkspaceTest::Fixed {
        balance,
        rotation,
        min_n: asked.min_n,
        max_n: asked.max_n,
    };
    // The place of the tool at this attitude, as a place of the platform's origin.
    let origin_m = rotation * tool_in_platform_m;
    let (test, shift) = match test {
        "wrench" => (fixed(Balance::Wrench), origin_m),
        "forces" => (fixed(Balance::Forces), origin_m),
        _ => {
            let by_length = tensions.iter().filter(|t| t.is_none()).count();
            if by_length != 3 {
                return Err(Failure::from(subject.length_held(by_length)).into());
            }
            let test = AnyWorkspaceTest::Equilibrium {
                tool_in_platform_m,
                tensions_n: tensions,
                min_n: asked.min_n,
                max_n: asked.max_n,
                tilt_max_rad: asked.tilt_max_rad,
            };
            (test, Vector3::zeros())
        }
    };
    let grid = Grid {
        min_m: min_m - shift,
        max_m: max_m - shift,
        counts,
    };
    let planned = match (&asked.tensions_n, &test) {
        (None, AnyWorkspaceTest::Equilibrium { .. }) => subject.planned(asked.tool),
        _ => None,
    };
    let geometry = &subject.geometry;
    let found = py.detach(|| match planned {
        Some(planned) => {
            let limits = Hanging {
                tool_in_platform_m,
                min_n: asked.min_n,
                max_n: asked.max_n,
                tilt_max_rad: asked.tilt_max_rad,
            };
            let judged = planned.workspace(geometry, &grid, &limits)?;
            Ok(judged.into_iter().map(|(verdict, _)| verdict).collect())
        }
        None => geometry.workspace_parallel(&grid, &test),
    });
    let found: Vec<Verdict> = found.map_err(Failure::from)?;
    let codes = found.iter().map(|verdict| code(*verdict)).collect();
    let cable = |verdict: &Verdict| verdict.limiting_cable().unwrap_or(0).try_into();
    let cables = found.iter().map(|verdict| cable(verdict).unwrap_or(0));
    Ok((
        PyArray1::from_vec(py, codes).unbind(),
        PyArray1::from_vec(py, cables.collect()).unbind(),
    ))
}

/// A verdict as a number; `mcdpr.robot.VERDICTS` has the names.
fn code(verdict: Verdict) -> u8 {
    match verdict {
        Verdict::Feasible => 0,
        Verdict::Limited {
            bound: Side::Minimum,
            ..
        } => 1,
        Verdict::Limited {
            bound: Side::Maximum,
            ..
        } => 2,
        Verdict::NoPath { .. } => 3,
        Verdict::Tilted => 4,
        Verdict::Unstable => 5,
        Verdict::Unbalanced => 6,
    }
}
