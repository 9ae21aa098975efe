//! The tension of the tension-held cables at a place, by the rule that plans use.

use super::Subject;
use crate::motion::{Model, StaticState};
use crate::robot::Control;
use mcdpr_kinematics::CableVec;
use nalgebra::Vector3;

/// Chooses the tension that plans choose: the one that makes the smallest tension of all cables greatest.
#[derive(Debug, Clone)]
pub struct Planned {
    model: Model,
}

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
}
