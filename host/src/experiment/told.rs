//! A calibration that knows what no calibration can: the constants of the simulated machine itself.
//!
//! It separates what a calibration costs from what remains after the best one: the judge's knowledge is given to the model,
//! whole ([`truth`]) or group by group ([`told`]). No real robot has it, and no figure with it is the robot's.

use super::over_board;
use crate::calibration::result::home_of;
use crate::machine::{self, Mismatch};
use crate::motion::Model;
use crate::robot::{Calibrated, Robot};
use crate::sight::Scene;
use clap::ValueEnum;
use mcdpr_simulator::plant::{GearParams, PlantParams};
use std::path::PathBuf;

/// A group of constants that a calibration is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Told {
    /// All of them; nothing is collected then
    All,
    /// Cable lengths at which the encoders were zeroed
    Lengths,
    /// Anchors, attachments and pulleys, and where the tags are
    Frame,
    /// Mass and centre of mass
    Platform,
    /// Radius of each drum
    Drums,
    /// Stiffness of each cable
    Stiffness,
    /// Gain and zero of each load cell
    Cells,
    /// Friction, loss, play and torsion of each gear, and the drives' bandwidth
    Gears,
}

/// Every group, the lengths last: where home is follows from them and all the others.
const GROUPS: [Told; 7] = [
    Told::Frame,
    Told::Platform,
    Told::Drums,
    Told::Stiffness,
    Told::Cells,
    Told::Gears,
    Told::Lengths,
];

/// A simulated machine as its builder knows it.
struct Machine {
    params: PlantParams,
    /// Unstretched cable between pulley and platform at home, m.
    home_lengths_m: Vec<f64>,
}

impl Machine {
    /// The machine of this name, drawn with `seed`, at rest at home in the session in which it is calibrated.
    fn of(designed: &Robot, kind: &str, seed: u64) -> Result<Self, String> {
        let mismatch = Mismatch::parse(kind)?;
        let model = Model::new(designed).map_err(|error| error.to_string())?;
        let plant = machine::at_rest(&model, designed, &mismatch, seed, None);
        let plant = plant.map_err(|error| error.to_string())?;
        let truth = plant.truth().map_err(|error| error.to_string())?;
        Ok(Self {
            params: plant.params().clone(),
            home_lengths_m: truth.unstretched_lengths_m[..designed.cables.len()].to_vec(),
        })
    }

    /// Tells a calibrated robot a group of the machine's constants.
    fn tell(&self, robot: &mut Robot, what: Told) {
        let params = &self.params;
        let cables = robot.cables.iter_mut().zip(&params.cables);
        match what {
            Told::All => {
                for group in GROUPS {
                    self.tell(robot, group);
                }
            }
            Told::Lengths => {
                if let Some(calibrated) = &mut robot.calibrated {
                    calibrated.home_lengths_m.clone_from(&self.home_lengths_m);
                }
            }
            Told::Frame => {
                for (known, built) in cables {
                    known.anchor_in_world_m = built.anchor_m.into();
                    known.attachment_in_platform_m = built.attachment_m.into();
                    known.pulley_radius_m = built.pulley_radius_m;
                    known.swivel_axis_in_world = built.swivel_axis.into();
                }
                // The tags relate the frames of judge and model, which are one now.
                let places = Scene::of(robot, 0).places;
                if let Some(calibrated) = &mut robot.calibrated {
                    calibrated.places = places;
                }
            }
            Told::Platform => {
                robot.platform.mass_kg = params.platform.mass_kg;
                robot.platform.center_of_mass_m = params.platform.center_of_mass_m.into();
                let inertia = params.platform.inertia_kg_m2;
                robot.platform.inertia_kg_m2 =
                    nalgebra::Matrix3::from_fn(|row, column| inertia[row][column]);
            }
            Told::Stiffness => {
                for (known, built) in cables {
                    known.ea_n = built.ea_n;
                }
            }
            Told::Drums | Told::Cells | Told::Gears => self.tell_winches(robot, what),
        }
    }

    /// The same of the winches, which the plant numbers as the cables.
    fn tell_winches(&self, robot: &mut Robot, what: Told) {
        for (cable, built) in robot.cables.iter().zip(&self.params.winches) {
            let Some(known) = robot.winches.get_mut(cable.winch_index) else {
                continue;
            };
            match what {
                Told::Drums => known.drum_radius_m = built.drum_radius_m,
                Told::Cells => {
                    known.tension_gain_n_per_v = built.sensor.gain_n_per_v;
                    known.tension_zero_v = built.sensor.zero_v;
                }
                _ => {
                    known.drive_bandwidth_rad_s = built.drive.position_bandwidth_rad_s;
                    if let Some((known, built)) = known.gear.as_mut().zip(built.gear.as_ref()) {
                        tell_gear(known, built);
                    }
                }
            }
        }
        if what == Told::Cells {
            // A cell that reads less far is trusted less far: the board refuses a limit beyond that.
            let trusted_n = robot.winches.iter().map(|w| w.trusted_tension_n());
            let most_n = trusted_n.fold(robot.limits.tension_max_n, f64::min);
            robot.limits.tension_max_n = most_n;
        }
    }
}

fn tell_gear(known: &mut mcdpr_core::robot::Gear, built: &GearParams) {
    known.rotor_friction_nm = built.rotor_friction_nm;
    known.gear_friction_nm = built.gear_friction_nm;
    known.efficiency = built.efficiency_driving;
    known.backdrive_efficiency = built.efficiency_driven;
    known.play_rad = built.play_rad;
    known.stiffness_nm_per_rad = built.stiffness_nm_per_rad;
}

/// A robot with the perfect calibration of the machine of this name (`kind` as [`Mismatch::parse`] reads it), drawn with
/// `seed`: it is told everything, and represents that machine from then on. Nothing is collected.
///
/// # Errors
/// In words: a machine that cannot hang at home.
pub(crate) fn truth(robot: &Robot, kind: &str, seed: u64) -> Result<Robot, String> {
    let designed = over_board(robot);
    let mut known = designed.clone();
    known.calibrated = Some(Box::new(Calibrated {
        designed,
        places: Vec::new(),
        simulated_seed: Some(seed),
        simulated_machine: Some(kind.to_owned()),
        date: String::new(),
        predicted_error_m: None,
        home_lengths_m: Vec::new(),
        drum_scales: vec![1.0; robot.cables.len()],
        covariance: None,
        errors: None,
        file: PathBuf::new(),
    }));
    told(known, &[Told::All])
}

/// A robot that was calibrated on the simulator, told these groups of its machine's constants. The rest stays as the
/// calibration estimated it, although it was estimated together with what is replaced: one group alone may do harm.
///
/// # Errors
/// In words: a robot that is no simulated machine's, or a machine that cannot hang at home.
pub(crate) fn told(mut robot: Robot, groups: &[Told]) -> Result<Robot, String> {
    let known = robot.calibrated.as_deref();
    let machine = known.and_then(|known| {
        let kind = known.simulated_machine.as_deref().unwrap_or("as-built");
        Some(Machine::of(&known.designed, kind, known.simulated_seed?))
    });
    let machine = machine.ok_or("it was not calibrated on the simulator")??;
    for group in groups {
        machine.tell(&mut robot, *group);
    }
    let home_m = robot
        .calibrated
        .as_deref()
        .map(|c| c.home_lengths_m.clone());
    let home = home_of(&robot, &home_m.unwrap_or_default());
    robot.tool.home_in_world_m = home.map_err(|error| error.to_string())?;
    Ok(robot)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// Distance of the machine's tool at home from where the model has it with the home lengths that it knows, m; both with
    /// the tensions that the machine has there.
    fn off_at_home_m(robot: &Robot) -> f64 {
        let model = Model::new(robot).unwrap();
        let (machine, mismatch, seed) = machine::of_calibration(robot, 0).unwrap();
        let plant = machine::at_rest(&model, machine, &mismatch, seed, None).unwrap();
        let truth = plant.truth().unwrap();
        let home_m = &robot.calibrated.as_ref().unwrap().home_lengths_m;
        let tensions_n = &truth.tensions_platform_n[..home_m.len()];
        let known = model.rest_from_lengths(home_m, tensions_n).unwrap();
        (model.tool_m(&known) - Vector3::from(truth.tool_position_m)).norm()
    }

    #[test]
    fn who_is_told_everything_hangs_where_the_machine_does_but_for_what_nobody_knows() {
        let robot = Robot::built_in("paper-table5").unwrap();
        let quiet = truth(&robot, "as-found,wrench=0,pulleys=0", 3).unwrap();
        let off_m = off_at_home_m(&quiet);
        assert!(off_m < 2e-5, "{off_m}");
        // Without one group it is as far off as machines as found are.
        for group in [Told::Lengths, Told::Frame, Told::Platform] {
            let others: Vec<_> = GROUPS.into_iter().filter(|g| *g != group).collect();
            let mut known = quiet.clone();
            let designed = known.calibrated.as_ref().unwrap().designed.clone();
            known.cables.clone_from(&designed.cables);
            known.winches.clone_from(&designed.winches);
            known.platform.clone_from(&designed.platform);
            let at_home = Model::new(&designed).unwrap().rest_at_home().unwrap();
            let calibrated = known.calibrated.as_mut().unwrap();
            calibrated.home_lengths_m.clone_from(&at_home.paid_out_m);
            let off_m = off_at_home_m(&told(known, &others).unwrap());
            assert!(off_m > 1e-4, "without {group:?}: {off_m}");
        }
        let pulled = truth(&robot, "as-found", 3).unwrap();
        let off_m = off_at_home_m(&pulled);
        assert!(off_m > 1e-4, "{off_m}");
    }

    #[test]
    fn the_frames_of_judge_and_model_are_one_after_the_truth_was_told() {
        let robot = Robot::built_in("paper-table5").unwrap();
        let known = truth(&robot, "as-found", 5).unwrap();
        let at_m = Vector3::new(0.3, -0.1, -0.2);
        let same_m = super::super::in_known_frame(&known, &at_m);
        assert!((same_m - at_m).norm() < 1e-12, "{same_m}");
    }

    #[test]
    fn a_robot_of_no_machine_is_told_nothing() {
        let robot = Robot::built_in("paper-table5").unwrap();
        assert!(told(robot.clone(), &[Told::All]).is_err());
        assert!(truth(&robot, "as-found,wind=0", 1).is_err());
    }
}
