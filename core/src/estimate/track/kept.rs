//! A tracked state that outlasts the program.

use super::creep::Creeping;
use super::gaussian::Gaussian;
use super::{Prior, Tracker};
use crate::motion::Model;
use crate::robot::Robot;
use mcdpr_protocol::frame::crc32;
use miette::Diagnostic;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Name of the format.
const SCHEMA: &str = "mcdpr-tracked-3";

/// The states of a tracker, to be kept in a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    schema: String,
    /// Name of the robot.
    pub robot: String,
    /// Checksum of the description that the states are relative to.
    pub description: u32,
    mean: Vec<f64>,
    /// Row by row.
    covariance: Vec<f64>,
    planned: Vec<f64>,
    /// What the cables have crept by the tensions so far.
    #[serde(default)]
    creeping: Vec<Creeping>,
}

/// Why kept states are not used.
#[derive(Debug, Clone, PartialEq, Eq, Error, Diagnostic)]
pub enum KeptError {
    /// Another robot's.
    #[error("the tracked state is of robot {theirs}, this is {ours}")]
    #[diagnostic(
        code(mcdpr::track::robot),
        help("name the other robot, or move the file away: tracking then begins anew")
    )]
    Robot {
        /// Name in the state.
        theirs: String,
        /// Name of this robot.
        ours: String,
    },
    /// The description has changed.
    #[error("the robot's file or calibration has changed since this state was tracked")]
    #[diagnostic(
        code(mcdpr::track::description),
        help("`mcdpr track --forget` moves it away: tracking then begins anew")
    )]
    Description,
    /// Not a valid state.
    #[error("the tracked state is damaged: {what}")]
    #[diagnostic(
        code(mcdpr::track::damaged),
        help("`mcdpr track --back-to N` goes back to an earlier one, `--forget` begins anew")
    )]
    Damaged {
        /// What is wrong.
        what: &'static str,
    },
}

/// Checksum of everything that the states are relative to: geometry, cables, masses, sensors, tool, camera.
fn description_of(robot: &Robot) -> u32 {
    let winches: Vec<_> = robot
        .winches
        .iter()
        .map(|w| {
            serde_json::json!([
                w.id,
                w.drum_radius_m,
                w.encoder_counts_per_turn,
                w.encoder_sign,
                w.tension_gain_n_per_v,
                w.tension_zero_v,
            ])
        })
        .collect();
    let text = serde_json::json!([
        robot.platform,
        robot.cables,
        winches,
        robot.tool,
        robot.camera,
    ]);
    crc32(text.to_string().as_bytes())
}

impl Tracker {
    /// The states, to be kept. A payload is not kept: what the gripper holds later is not known.
    #[must_use]
    pub fn kept(&self) -> Kept {
        let mut bare = self.clone();
        bare.set_down();
        Kept {
            schema: SCHEMA.to_owned(),
            robot: self.robot.name.clone(),
            description: description_of(&self.robot),
            mean: bare.now.mean,
            covariance: bare.now.covariance,
            creeping: bare.now.creeping,
            planned: bare.planned,
        }
    }

    /// A tracker that goes on from kept states.
    ///
    /// # Errors
    /// [`KeptError`]: another robot, another description, or numbers that no filter leaves.
    pub fn resume(model: &Model, prior: &Prior, kept: &Kept) -> Result<Self, KeptError> {
        let mut tracker = Self::new(model, prior);
        let robot = model.robot();
        if kept.robot != robot.name {
            return Err(KeptError::Robot {
                theirs: kept.robot.clone(),
                ours: robot.name.clone(),
            });
        }
        if kept.description != description_of(robot) {
            return Err(KeptError::Description);
        }
        let damaged = |what| Err(KeptError::Damaged { what });
        let size = tracker.layout.size();
        if kept.schema != SCHEMA {
            return damaged("it has another format");
        }
        if kept.mean.len() != size
            || kept.planned.len() != size
            || kept.covariance.len() != size * size
        {
            return damaged("its number of states is not that of this robot");
        }
        if kept.creeping.len() != tracker.layout.cables {
            return damaged("its number of creeping cables is not that of this robot");
        }
        let elements = kept.creeping.iter().flat_map(|creeping| &creeping.0);
        let crept = elements.flat_map(|element| [&element.unit, &element.by_time]);
        let numbers = kept.mean.iter().chain(&kept.planned).chain(crept);
        if numbers.chain(&kept.covariance).any(|x| !x.is_finite()) {
            return damaged("it has a number that is not finite");
        }
        if kept
            .covariance
            .iter()
            .step_by(size + 1)
            .any(|v| *v < -1e-12)
        {
            return damaged("it has a negative variance");
        }
        tracker.now = Gaussian {
            mean: kept.mean.clone(),
            covariance: kept.covariance.clone(),
            creeping: kept.creeping.clone(),
        };
        tracker.planned.clone_from(&kept.planned);
        Ok(tracker)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::all_rub;
    use super::*;
    use crate::estimate::Measurements;
    use crate::motion::StaticState;

    fn model(name: &str) -> Model {
        Model::new(&Robot::built_in(name).unwrap()).unwrap()
    }

    fn rest(model: &Model) -> (Measurements, StaticState) {
        let rest = model.rest_at_home().unwrap();
        let measured = Measurements {
            lengths_m: rest.paid_out_m.iter().map(|l| l + 1e-4).collect(),
            tensions_n: rest.tensions_n().to_vec(),
            ..Measurements::default()
        };
        (measured, rest)
    }

    fn taught() -> (Model, Tracker) {
        let model = model("lab-fast");
        let mut tracker = Tracker::new(&model, &Prior::default());
        let (measured, rest) = rest(&model);
        let report = tracker.rest(&measured, &all_rub(&model, 0.0), &rest.equilibrium.pose);
        assert!(report.fits, "{report:?}");
        (model, tracker)
    }

    #[test]
    fn a_kept_state_goes_on_as_if_the_program_had_not_ended() {
        let (model, mut tracker) = taught();
        let kept = tracker.kept();
        let text = serde_json::to_string(&kept).unwrap();
        let read: Kept = serde_json::from_str(&text).unwrap();
        // The last digit of a number may differ after a file.
        for (then, now) in kept.covariance.iter().zip(&read.covariance) {
            assert!((then - now).abs() <= 1e-15 * then.abs());
        }
        let mut resumed = Tracker::resume(&model, &Prior::default(), &kept).unwrap();
        let prior = Prior::default();
        assert_eq!(resumed.estimates(&prior), tracker.estimates(&prior));
        let (measured, rest) = rest(&model);
        for tracker in [&mut tracker, &mut resumed] {
            tracker.pass(60.0, rest.tensions_n());
            tracker.rest(&measured, &all_rub(&model, 0.0), &rest.equilibrium.pose);
        }
        assert_eq!(resumed.estimates(&prior), tracker.estimates(&prior));
        assert_eq!(resumed.drift(), tracker.drift());
    }

    #[test]
    fn other_robots_and_damaged_states_are_refused() {
        let (model, tracker) = taught();
        let kept = tracker.kept();
        let of = |model: &Model, kept: &Kept| {
            Tracker::resume(model, &Prior::default(), kept).map(|_| ())
        };
        assert_eq!(of(&model, &kept), Ok(()));
        let other = self::model("paper-optimistic");
        let refused = of(&other, &kept).unwrap_err();
        assert!(matches!(&refused, KeptError::Robot { theirs, .. } if theirs == "lab-fast"));
        // The same name, another geometry: an anchor was measured again.
        let mut moved = model.robot().clone();
        moved.cables[2].anchor_in_world_m.x += 1e-3;
        let moved = Model::new(&moved).unwrap();
        assert_eq!(of(&moved, &kept), Err(KeptError::Description));
        // A gain of the tension loop is no part of it.
        let mut tuned = model.robot().clone();
        tuned.tension.kp *= 2.0;
        assert_eq!(of(&Model::new(&tuned).unwrap(), &kept), Ok(()));
        let spoilt: [fn(&mut Kept); 7] = [
            |kept| kept.mean[7] = f64::NAN,
            |kept| kept.covariance[0] = -1.0,
            |kept| kept.planned.truncate(3),
            |kept| kept.creeping.truncate(3),
            |kept| kept.creeping[1].0[0].unit = f64::INFINITY,
            |kept| kept.covariance.push(0.0),
            |kept| kept.schema.push('2'),
        ];
        for spoil in spoilt {
            let mut kept = kept.clone();
            spoil(&mut kept);
            let refused = of(&model, &kept).unwrap_err();
            assert!(matches!(refused, KeptError::Damaged { .. }), "{refused}");
        }
    }

    #[test]
    fn a_homing_takes_the_creep_into_the_lengths() {
        let (model, mut tracker) = taught();
        tracker.pass(3600.0, &[14.0; 4]);
        let (measured, _) = rest(&model);
        tracker.homed(&measured.lengths_m);
        let planner = {
            // Only what the plans follow counts: lengths of now are as before the creep.
            let mut kept = tracker.kept();
            kept.planned.fill(0.0);
            let mut as_described = Tracker::resume(&model, &Prior::default(), &kept).unwrap();
            as_described.homed(&measured.lengths_m);
            as_described.model(&model).unwrap()
        };
        for (i, length_m) in measured.lengths_m.iter().enumerate() {
            assert!(planner.drift()[i].strain > 1e-4, "{:?}", planner.drift()[i]);
            let (now, then) = (
                planner.taut_m(i, *length_m, 12.0),
                model.taut_m(i, *length_m, 12.0),
            );
            assert!((now - then).abs() < 2e-6, "cable {}: {now} {then}", i + 1);
        }
    }

    #[test]
    fn after_a_homing_the_creep_so_far_makes_no_length_uncertain() {
        let (model, mut tracker) = taught();
        tracker.pass(7200.0, &[14.0; 4]);
        let (measured, _) = rest(&model);
        let sigma_m = |tracker: &Tracker, cable: usize| {
            let layout = tracker.layout;
            let off_drum_m =
                measured.lengths_m[cable] + model.robot().cables[cable].routing_length_m;
            let mut row = vec![0.0; layout.size()];
            row[layout.offset(cable)] = 1.0;
            let creeping = tracker.now.creeping(cable);
            for (state, slope) in creeping.slopes(layout, &tracker.now.mean, cable) {
                row[state] = slope * off_drum_m;
            }
            tracker.now.spread(&[row])[0][0].sqrt()
        };
        let before = sigma_m(&tracker, 1);
        tracker.homed(&measured.lengths_m);
        let prior = Prior::default();
        let after = sigma_m(&tracker, 1);
        assert!(before > 3.0 * after, "{before} {after}");
        assert!((after / prior.length_m - 1.0).abs() < 1e-6, "{after}");
        // What creeps later is as uncertain as before.
        tracker.pass(3600.0, &[14.0; 4]);
        assert!(sigma_m(&tracker, 1) > 1.5 * after);
    }
}
