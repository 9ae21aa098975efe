//! What a machine is used for besides holding a tension: paths of the tool, `tune tension`, `calibrate collect`.

use super::Ran;
use crate::calibration::collect::Options;
use crate::calibration::simulate::Target;
use crate::calibration::target;
use crate::experiment::{self, SimulatedRobot};
use crate::machine::Mismatch;
use crate::motion::{Model, Planner, Shaping};
use crate::robot::Robot;
use crate::study::motion::{Case, Job, Known, Outcome, run_as};
use crate::tension::rig::Rig;
use crate::tension::tune::{excitation, excite};
use mcdpr_protocol::SessionId;

/// Poses that are collected, and candidates for them.
const POSES: usize = 20;
const CANDIDATES: usize = 100;
/// Height of the steps of `tune tension`, N: its default.
const STEP_N: f64 = 2.0;

/// Circle and line of the tool on a machine with every realistic error.
pub(super) fn follow(told: &Robot, built: &Robot, seed: u64, run: &mut Ran) {
    let base = Case {
        job: Job::Circle10s,
        robot: "paper-optimistic",
        every_error: true,
        known: Known::Absolute,
        pulley_loss: Mismatch::realistic().pulley_loss,
        shaping: Shaping::Zv,
        frictionless: false,
        planner: Planner::Equilibrium,
    };
    for (name, job, known) in [
        ("circle of the tool", Job::Circle10s, Known::Absolute),
        ("circle of the tool, homed", Job::Circle10s, Known::Homed),
        ("line of the tool", Job::LineAtLimit, Known::Absolute),
    ] {
        let case = Case { job, known, ..base };
        let outcome = run_as(&case, told.clone(), Some(built), seed);
        let values = |of: &Outcome| {
            let mut values = vec![of.path_mean_m, of.path_max_m];
            if (job, known) == (Job::Circle10s, Known::Absolute) {
                values.push(of.reversal_m);
            }
            values
        };
        match outcome {
            Ok(outcome) => {
                let mm = values(&outcome).into_iter().map(|m| Some(m * 1e3));
                run.figures.extend(mm);
            }
            Err(error) => {
                run.faults.push(format!("{name}: {error}"));
                let count = if known == Known::Absolute && job == Job::Circle10s {
                    3
                } else {
                    2
                };
                run.figures.extend(std::iter::repeat_n(None, count));
            }
        }
    }
}

/// The steps of `tune tension` with the gains of the file, and `calibrate collect` with the board of tags.
pub(super) fn tune_and_collect(told: &Robot, built: &Robot, seed: u64, run: &mut Ran) {
    match steps(told, built, seed) {
        Ok(values) => run.figures.extend(values.map(Some)),
        Err(error) => {
            run.faults.push(format!("tune: {error}"));
            run.figures.extend([None, None]);
        }
    }
    match collected(told, built, seed) {
        Ok(count) => run.figures.push(Some(count)),
        Err(error) => {
            run.faults.push(format!("collect: {error}"));
            run.figures.push(None);
        }
    }
}

/// Error and ringing of the steps, rms, N.
fn steps(told: &Robot, built: &Robot, seed: u64) -> Result<[f64; 2], String> {
    let words = |error: &dyn std::fmt::Display| error.to_string();
    let model = Model::new(told).map_err(|error| words(&error))?;
    let cable = model.holding().first_by_tension();
    let cable = cable.ok_or("no cable is held by its tension")?;
    let link = SimulatedRobot::new(Mismatch::realistic(), seed).machine(built);
    let link = link.at_home(&model).map_err(|error| words(&error))?;
    let home = model.rest_at_home().map_err(|error| words(&error))?;
    let (lengths_m, tensions_n) = (&home.paid_out_m, home.tensions_n());
    let mut rig = Rig::start(told, link, SessionId(1), lengths_m, tensions_n)
        .map_err(|error| words(&error))?;
    let stages = excitation(told.tension.setpoint_n, STEP_N);
    let answer = excite(&mut rig, cable, &stages).map_err(|error| words(&error))?;
    rig.finish().map_err(|error| words(&error))?;
    Ok([answer.rms_n(), answer.ringing_n()])
}

/// Number of poses that were collected.
fn collected(told: &Robot, built: &Robot, seed: u64) -> Result<f64, String> {
    let words = |error: &dyn std::fmt::Display| error.to_string();
    let mut with_board = told.clone();
    with_board.tags = target::tags(Target::Board);
    let model = Model::new(&with_board).map_err(|error| words(&error))?;
    let machine = SimulatedRobot::new(Mismatch::as_built(), seed).machine(built);
    let options = Options {
        poses: POSES,
        candidates: CANDIDATES,
        seed,
        simulated_seed: Some(seed),
        session: Some(SessionId(1)),
        ..Options::default()
    };
    let data = experiment::collected(&model, &machine, seed, &options);
    let data = data.map_err(|error| words(&error))?;
    #[expect(clippy::cast_precision_loss, reason = "some poses")]
    let count = data.poses.len() as f64;
    Ok(count)
}
