//! Lengths that were taken at home contain the errors that anchors and stiffness make there.

use super::layout::Layout;
use crate::motion::Model;

/// A state, the offset of a length that follows it, and by how much.
pub(super) type Follows = (usize, usize, f64);

/// How offsets follow anchors and compliances where the encoders were set to the lengths of the description at home, to first
/// order: `(paid out + routing + offset) (1 + tension / EA) = length + routing` holds there on the true machine, and
/// without offset on the described one. None for a robot that cannot hang at home.
pub(super) fn slopes(model: &Model, layout: Layout) -> Vec<Follows> {
    let mut out = Vec::new();
    let Ok(rest) = model.rest_at_home() else {
        return out;
    };
    let Ok(paths) = model.geometry().paths(&rest.equilibrium.pose) else {
        return out;
    };
    let cables = model.robot().cables.iter().zip(paths.iter());
    let rests = rest.paid_out_m.iter().zip(rest.tensions_n());
    for (i, ((cable, path), (paid_out_m, tension_n))) in cables.zip(rests).enumerate() {
        let strain = tension_n / cable.ea_n;
        let elastic = 1.0 + strain;
        let offset = layout.offset(i);
        let off_drum_m = paid_out_m + cable.routing_length_m;
        out.push((layout.compliance(i), offset, -off_drum_m * strain / elastic));
        for axis in 0..3 {
            // The way from an anchor is shorter by as much as the anchor moves along it.
            let slope = -path.direction[axis] / elastic;
            out.push((layout.anchor(i) + axis, offset, slope));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::tests::all_rub;
    use super::super::{Prior, Tracker};
    use super::*;
    use crate::estimate::Measurements;
    use crate::robot::Robot;
    use mcdpr_kinematics::Pose;
    use nalgebra::Vector3;

    fn layout(robot: &Robot) -> Layout {
        Layout {
            cables: robot.cables.len(),
        }
    }

    /// A robot with cables to spare, what its encoders and sensors show at home, and how it hangs there.
    fn at_home() -> (Model, Measurements, Pose) {
        let model = Model::new(&Robot::built_in("eight-cable").unwrap()).unwrap();
        let rest = model.rest_at_home().unwrap();
        let commanded = Measurements {
            lengths_m: rest.paid_out_m.clone(),
            tensions_n: rest.tensions_n().to_vec(),
            ..Measurements::default()
        };
        (model, commanded, rest.equilibrium.pose)
    }

    #[test]
    fn offsets_at_home_are_those_of_a_machine_with_these_errors() {
        let robot = Robot::built_in("eight-cable").unwrap();
        let described = Model::new(&robot).unwrap();
        let layout = layout(&robot);
        let told = slopes(&described, layout);
        for (cable, softer, anchor_m) in [
            (0, 0.1, Vector3::zeros()),
            (4, 0.0, Vector3::new(3e-4, -2e-4, 1e-4)),
            (7, -0.1, Vector3::new(0.0, 2e-4, 2e-4)),
        ] {
            let mut machine = robot.clone();
            machine.cables[cable].ea_n /= 1.0 + softer;
            machine.cables[cable].anchor_in_world_m += anchor_m;
            let there = Model::new(&machine).unwrap().rest_at_home().unwrap();
            let said = described.rest_at_home().unwrap();
            // The encoder shows what the description has at home.
            let offset_m = there.paid_out_m[cable] - said.paid_out_m[cable];
            let by_slopes: f64 = (told.iter())
                .filter(|(_, to, _)| *to == layout.offset(cable))
                .map(|(from, _, slope)| {
                    let axis = from.wrapping_sub(layout.anchor(cable));
                    slope * anchor_m.get(axis).copied().unwrap_or(softer)
                })
                .sum();
            assert!(
                (offset_m - by_slopes).abs() < 0.05 * offset_m.abs() && offset_m.abs() > 5e-6,
                "cable {cable}: {offset_m} {by_slopes}"
            );
        }
    }

    #[test]
    fn a_homed_robot_knows_where_it_is_at_home_whatever_its_cables_are() {
        let (model, commanded, pose) = at_home();
        let spread_m = |homed: bool, compliance: f64, anchor_m: f64| {
            let prior = Prior {
                homed,
                compliance,
                anchor_m,
                ..Prior::default()
            };
            let tracker = Tracker::new(&model, &prior);
            let region = tracker.region(&commanded, &all_rub(&model, 0.0), &pose);
            region.unwrap().covariance_m2.trace().sqrt()
        };
        let exact = spread_m(true, 0.0, 0.0);
        let (homed, free) = (spread_m(true, 0.12, 2e-4), spread_m(false, 0.12, 2e-4));
        assert!(
            homed < 1.05 * exact && free > 1.5 * exact,
            "{exact} {homed} {free}"
        );
    }

    #[test]
    fn a_homing_puts_the_robot_home_whatever_its_cables_are_known_to_be() {
        let (model, commanded, pose) = at_home();
        let prior = Prior {
            homed: true,
            ..Prior::default()
        };
        let mut tracker = Tracker::new(&model, &prior);
        let layout = layout(model.robot());
        // Cables have become soft since, and are known as well as before.
        for cable in 0..8 {
            tracker.now.mean[layout.compliance(cable)] = 0.1;
            tracker.now.reset(layout.offset(cable), 0.0, 1e-3);
        }
        let region = |tracker: &Tracker| {
            let there = tracker.region(&commanded, &all_rub(&model, 0.0), &pose);
            let there = there.unwrap();
            let off_m = (there.tool_m - model.robot().tool.home_in_world_m).norm();
            (off_m, there.covariance_m2.trace().sqrt())
        };
        let (before, at_first) = (region(&tracker), region(&Tracker::new(&model, &prior)));
        tracker.homed(&commanded.lengths_m);
        let after = region(&tracker);
        assert!(before.0 > 4e-5 && after.0 < 1e-6, "{before:?} {after:?}");
        assert!(after.1 < 1.05 * at_first.1, "{at_first:?} {after:?}");
    }
}
