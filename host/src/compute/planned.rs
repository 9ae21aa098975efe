//! The tension of the tension-held cables at a place, by the rule that plans use.

use super::Subject;
use crate::motion::{Model, StaticState};
use crate::robot::Control;
use mcdpr_kinematics::{AnyRobot, AnyWorkspaceTest, CableVec, Error, Grid, Verdict};
use nalgebra::Vector3;
use rayon::prelude::*;

/// Chooses the tension that plans choose: the one that makes the smallest tension of all cables greatest.
#[derive(Debug, Clone)]
pub struct Planned {
    model: Model,
}

/// Limits within which a place counts.
#[derive(Debug, Clone, Copy)]
pub struct Hanging<'a> {
    /// The point whose places are judged, platform's frame, m.
    pub tool_in_platform_m: Vector3<f64>,
    /// Least tension of each cable, N.
    pub min_n: &'a [f64],
    /// Greatest tension of each cable, N.
    pub max_n: &'a [f64],
    /// Greatest tilt, rad.
    pub tilt_max_rad: f64,
}

/// A verdict, and the tensions (N) of the tension-held cables that it is for.
pub type Judged = (Verdict, CableVec<Option<f64>>);

impl Subject {
    /// The rule of plans for the tool's places, or the origin's; `None` for a robot without tension-held
    /// cables, and for one that six or more lengths hold.
    #[must_use]
    pub fn planned(&self, tool: bool) -> Option<Planned> {
        let mut robot = self.robot.clone();
        robot.tool.tcp_in_platform_m = self.point(tool);
        let model = Model::new(&robot).ok()?;
        let held = model.holding().first_by_tension();
        (model.holding().hangs() && held.is_some()).then_some(Planned { model })
    }
}

impl Planned {
    /// Tensions for a place (world, m): `None` for length-held cables, N for the others. Where the platform
    /// cannot hang with any tension it is the robot file's set-point. `near` is a state close by; it becomes
    /// the one found.
    #[must_use]
    pub fn tensions_n(
        &self,
        place_m: &Vector3<f64>,
        near: &mut Option<StaticState>,
    ) -> CableVec<Option<f64>> {
        let robot = self.model.robot();
        let found = self.model.rest(place_m, near.as_ref()).ok();
        let tensions_n = CableVec::from_fn(robot.cables.len(), |index| {
            let cable = robot.cables.get(index)?;
            let chosen = found.as_ref().and_then(|rest| rest.tensions_n().get(index));
            (cable.control == Control::Tension)
                .then(|| chosen.copied().unwrap_or(robot.tension.setpoint_n))
        });
        // A place without equilibrium leaves the last start: it is better than none.
        if found.is_some() {
            *near = found;
        }
        tensions_n
    }

    /// Verdicts on the places of a grid, each with its own tensions, x fastest; on all cores.
    ///
    /// # Errors
    /// Those of invalid limits.
    pub fn workspace(
        &self,
        geometry: &AnyRobot,
        grid: &Grid,
        limits: &Hanging<'_>,
    ) -> Result<Vec<Judged>, Error> {
        let count = grid.len();
        let [row, ..] = grid.counts.map(|points| points.max(1));
        let starts: Vec<usize> = (0..count).step_by(row).collect();
        // Along a row, x, each place starts from the one before it.
        let judged = starts.par_iter().flat_map_iter(|&start| {
            let mut near = None;
            (start..(start + row).min(count)).map(move |index| {
                let place_m = grid.point_m(index);
                let tensions_n = self.tensions_n(&place_m, &mut near);
                let one = Grid {
                    min_m: place_m,
                    max_m: place_m,
                    counts: [1; 3],
                };
                let test = AnyWorkspaceTest::Equilibrium {
                    tool_in_platform_m: limits.tool_in_platform_m,
                    tensions_n: &tensions_n,
                    min_n: limits.min_n,
                    max_n: limits.max_n,
                    tilt_max_rad: limits.tilt_max_rad,
                };
                let verdict = geometry.workspace(&one, &test)?.first().copied();
                Ok((verdict.unwrap_or(Verdict::Unbalanced), tensions_n))
            })
        });
        judged.collect()
    }
}
