//! An object in the jaws while the power was off.

use crate::motion::{Model, PlanError, StaticState};
use mcdpr_kinematics::GRAVITY_MPS2;
use mcdpr_protocol::Status;

/// A weight beyond this is not that of an object in the jaws, N.
const MOST_N: f64 = 8.0;
/// A weight under this is friction and the error of the platform's mass, N.
const LEAST_N: f64 = 0.2;

/// The vertical force of a change of tensions with the robot at `rest`, N: the additional load. Pulleys'
/// radius is neglected.
pub(crate) fn lift_n(model: &Model, rest: &StaticState, before_n: &[f64], now_n: &[f64]) -> f64 {
    let pose = &rest.equilibrium.pose;
    let cables = model.robot().cables.iter();
    cables
        .zip(before_n.iter().zip(now_n))
        .map(|(cable, (before, now))| {
            let at = pose.transform(&cable.attachment_in_platform_m);
            let way = cable.anchor_in_world_m - at;
            (now - before) * way.z / way.norm().max(1e-9)
        })
        .sum()
}

/// The robot with this mass at its tool.
///
/// # Errors
/// Where no robot can be modelled with it.
pub(crate) fn loaded(model: &Model, mass_kg: f64) -> Result<Model, PlanError> {
    let mut robot = model.robot().clone();
    let platform = &mut robot.platform;
    let bare_kg = platform.mass_kg;
    platform.mass_kg = bare_kg + mass_kg;
    platform.center_of_mass_m = (platform.center_of_mass_m * bare_kg
        + robot.tool.tcp_in_platform_m * mass_kg)
        / platform.mass_kg;
    let loaded = Model::new(&robot)?.with_options(model.options());
    Ok(loaded.with_drift(model.drift()))
}

/// Mass in closed jaws at rest, kg, with these lengths (m) and mean tensions (N); 0 with open jaws, with jaws
/// whose switch says that they met, and where tensions and statics differ by more than an object.
pub(crate) fn in_jaws_kg(
    model: &Model,
    status: &Status,
    lengths_m: &[f64],
    tensions_n: &[f64],
) -> f64 {
    let met = model.robot().gripper.switch && status.gripper_switch;
    if !status.gripper_closed || met {
        return 0.0;
    }
    let Ok(rest) = model.rest_from_lengths(lengths_m, tensions_n) else {
        return 0.0;
    };
    let weight_n = lift_n(model, &rest, rest.tensions_n(), tensions_n);
    if (LEAST_N..MOST_N).contains(&weight_n) {
        weight_n / GRAVITY_MPS2
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    #[test]
    fn an_object_is_weighed_by_tensions_at_rest_and_only_in_closed_jaws() {
        let model = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
        let heavy = loaded(&model, 0.15).unwrap();
        let home_m = model.robot().tool.home_in_world_m;
        let rest = heavy.rest(&home_m, None).unwrap();
        let mut status = Status {
            gripper_closed: true,
            ..Status::default()
        };
        let weigh =
            |status: &Status| in_jaws_kg(&model, status, &rest.paid_out_m, rest.tensions_n());
        let kg = weigh(&status);
        // An eighth too little: the platform turns under the load, which is not counted.
        assert!((kg - 0.15).abs() < 0.025, "{kg} kg");
        status.gripper_switch = true;
        assert_eq!(weigh(&status), 0.0);
        (status.gripper_switch, status.gripper_closed) = (false, false);
        assert_eq!(weigh(&status), 0.0);
    }
}
