//! What `commission` finds on the winches of a drawn machine, beside the parameters of the simulated plant.

use crate::link::{Client, SimulatedLink};
use crate::machine::{Controller, Mismatch, plant_params, simulate_unloaded};
use crate::robot::Robot;
use crate::service::{Asked, Commissioned, Operator, commission};
use mcdpr_protocol::SessionId;
use mcdpr_simulator::LinkOptions;
use serde::Serialize;

/// Weight that is hung on each drum, kg.
const WEIGHT_KG: f64 = 1.0;

/// Errors of the identification of one winch: found less true.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Identified {
    /// Friction at the motor as a share of the true one; `None` if it is not known.
    pub friction_error: Option<f64>,
    /// Its stated standard error, likewise.
    pub friction_se: Option<f64>,
    /// Play, degrees.
    pub play_error_deg: f64,
    /// Motor counts per drum turn as a share; those of the robot file are the true ones.
    pub ratio_error: f64,
    /// Efficiency, a share of the power; `None` if it was not measured.
    pub efficiency_error: Option<f64>,
    /// Its stated standard error.
    pub efficiency_se: Option<f64>,
    /// Efficiency when driven, likewise.
    pub backdrive_error: Option<f64>,
    /// Its stated standard error.
    pub backdrive_se: Option<f64>,
    /// Torsional stiffness, as a share of the true one; `None` if it is not known.
    pub stiffness_error: Option<f64>,
    /// Its stated standard error, likewise.
    pub stiffness_se: Option<f64>,
    /// Why it is not known.
    pub stiffness_unknown: Option<String>,
}

/// Whoever watches a simulated drum while it is commissioned, and hangs the weight on it.
struct Watcher {
    link: SimulatedLink,
    winch: usize,
    before_m: f64,
}

impl Watcher {
    fn drum_m(&self) -> Option<f64> {
        let truth = self.link.with(|simulation| simulation.plant().truth());
        truth.ok()?.drum_positions_m.get(self.winch).copied()
    }
}

impl Operator for Watcher {
    fn paid_out(&mut self) -> Option<bool> {
        Some(self.drum_m()? > self.before_m)
    }

    fn hang(&mut self, weight_n: f64) -> bool {
        let hung = |plant: &mut mcdpr_simulator::plant::Plant| {
            plant.hang_weight(self.winch, Some(weight_n))
        };
        self.link
            .with(|simulation| hung(simulation.plant_mut()).is_ok())
    }
}

/// What `commission` finds on every winch of a machine by the robot file alone, and how wrong that is.
///
/// # Errors
/// In words, with the winch's number.
pub(crate) fn commissioned(
    robot: &Robot,
    built: &Robot,
    seed: u64,
) -> Result<Vec<(Commissioned, Identified)>, String> {
    let mismatch = Mismatch::realistic();
    let truth = plant_params(built, &mismatch, seed).winches;
    let mut all = Vec::new();
    for (index, real) in truth.iter().enumerate() {
        let words = |error: &dyn std::fmt::Display| format!("winch {}: {error}", index + 1);
        let (options, core) = (LinkOptions::default(), Controller::InProcess);
        let simulation = simulate_unloaded(built, &mismatch, &options, seed, &core);
        let link = SimulatedLink::new(simulation.map_err(|error| words(&error))?);
        let mut eyes = Watcher {
            link: link.clone(),
            winch: index,
            before_m: 0.0,
        };
        eyes.before_m = eyes.drum_m().unwrap_or(0.0);
        let client = Client::connect(link, SessionId(1));
        let mut client = client.map_err(|error| words(&error))?;
        let asked = Asked {
            node: None,
            weight_n: Some(WEIGHT_KG * mcdpr_kinematics::GRAVITY_MPS2),
        };
        let found = commission(&mut client, robot, index + 1, &asked, &mut eyes);
        let found = found.map_err(|error| words(&error))?;
        let rubs = found
            .rubbing
            .as_ref()
            .ok_or_else(|| words(&"no friction found"))?;
        let Some(gear) = &real.gear else { continue };
        // Of the motor and, through the gear, of the drum.
        let drum_nm = real.friction_n * real.drum_radius_m / real.gear_ratio;
        let true_nm =
            gear.rotor_friction_nm + gear.gear_friction_nm + drum_nm / gear.efficiency_driving;
        let friction = rubs.friction.as_ref();
        let counts = robot
            .winch_of(index)
            .map_or(f64::NAN, |winch| winch.motor_counts_per_turn.abs());
        let (loss, yields) = (&found.loss, &found.stiffness);
        let true_stiffness = gear.stiffness_nm_per_rad;
        let errors = Identified {
            friction_error: friction.map(|friction| friction.friction_nm / true_nm - 1.0),
            friction_se: friction.map(|friction| friction.friction_se_nm / true_nm),
            play_error_deg: rubs.play_deg - gear.play_rad.to_degrees(),
            ratio_error: found.motor_counts_per_turn.abs() / counts - 1.0,
            efficiency_error: loss
                .as_ref()
                .map(|loss| loss.efficiency - gear.efficiency_driving),
            efficiency_se: loss.as_ref().map(|loss| loss.efficiency_se),
            backdrive_error: loss
                .as_ref()
                .map(|loss| loss.backdrive_efficiency - gear.efficiency_driven),
            backdrive_se: loss.as_ref().map(|loss| loss.backdrive_efficiency_se),
            stiffness_error: yields
                .map(|yields| yields.stiffness_nm_per_rad / true_stiffness - 1.0),
            stiffness_unknown: found.stiffness_unknown.clone(),
            stiffness_se: yields.map(|yields| yields.stiffness_se_nm_per_rad / true_stiffness),
        };
        all.push((found, errors));
    }
    Ok(all)
}

/// The robot file with what was found on its winches.
#[must_use]
pub(crate) fn described(robot: &Robot, found: &[(Commissioned, Identified)]) -> Robot {
    let mut told = robot.clone();
    for (index, (found, _)) in found.iter().enumerate() {
        let winch = told.cables.get(index).map(|cable| cable.winch_index);
        if let Some(winch) = winch.and_then(|at| told.winches.get_mut(at)) {
            found.describe(winch);
        }
    }
    told
}
