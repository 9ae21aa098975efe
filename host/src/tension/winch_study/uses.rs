//! What a machine is used for besides holding a tension: paths of the tool, `tune tension`, `calibrate collect`.

use super::Ran;
use crate::experiment::SimulatedRobot;
use crate::machine::Mismatch;
use crate::motion::{Model, Planner, Shaping};
use crate::robot::Robot;
use crate::study::calibrated;
use crate::study::motion::{Case, Job, Known, Machine, Outcome, run_as};
use crate::tension::rig::Rig;
use crate::tension::tune::{excitation, excite};
use mcdpr_protocol::SessionId;

/// Poses that are collected.
const POSES: usize = 20;
/// Height of the steps of `tune tension`, N: its default.
const STEP_N: f64 = 2.0;

/// Circle and line of the tool on a machine with every realistic error.
pub(super) fn follow(told: &Robot, built: &Robot, seed: u64, run: &mut Ran) {
    let machine = Machine {
        built,
        mismatch: Mismatch::realistic(),
        known_from_true: None,
        lengths_off_m: &[],
    };
    for (name, job, known) in [
        ("circle of the tool", Job::Circle10s, Known::Absolute),
        ("circle of the tool, homed", Job::Circle10s, Known::Homed),
        ("line of the tool", Job::LineAtLimit, Known::Absolute),
    ] {
        let reverses = (job, known) == (Job::Circle10s, Known::Absolute);
        path(name, &case(job, known), told, machine, seed, reverses, run);
    }
}

fn case(job: Job, known: Known) -> Case {
    Case {
        job,
        robot: "paper-optimistic",
        every_error: true,
        known,
        pulley_loss: Mismatch::realistic().pulley_loss,
        shaping: Shaping::Zv,
        frictionless: false,
        planner: Planner::Equilibrium,
    }
}

/// Mean and greatest error of a path, mm, and the reversal error of a cable, if that is asked for.
fn path(
    name: &str,
    case: &Case,
    told: &Robot,
    machine: Machine<'_>,
    seed: u64,
    reverses: bool,
    run: &mut Ran,
) {
    let values = |of: &Outcome| {
        let mut values = vec![of.path_mean_m, of.path_max_m];
        if reverses {
            values.push(of.reversal_m);
        }
        values
    };
    match run_as(case, told.clone(), Some(machine), seed) {
        Ok(outcome) => {
            let mm = values(&outcome).into_iter().map(|m| Some(m * 1e3));
            run.figures.extend(mm);
        }
        Err(error) => {
            run.faults.push(format!("{name}: {error}"));
            let count = if reverses { 3 } else { 2 };
            run.figures.extend(std::iter::repeat_n(None, count));
        }
    }
}

/// The steps of `tune tension` with the gains of the file, `calibrate collect` with the board of tags, and circle and line
/// of the tool with what `calibrate all` makes of the poses that were collected.
pub(super) fn tune_collect_and_follow(told: &Robot, built: &Robot, seed: u64, run: &mut Ran) {
    match steps(told, built, seed) {
        Ok(values) => run.figures.extend(values.map(Some)),
        Err(error) => {
            run.faults.push(format!("tune: {error}"));
            run.figures.extend([None, None]);
        }
    }
    let as_built = Mismatch::as_built();
    let simulated = SimulatedRobot::new(as_built, seed).machine(built);
    let data = match calibrated::collected(told, &simulated, POSES, seed) {
        Ok(data) => data,
        Err(error) => {
            run.faults.push(format!("collect: {error}"));
            run.figures.extend([None; 5]);
            return;
        }
    };
    #[expect(clippy::cast_precision_loss, reason = "some poses")]
    run.figures.push(Some(data.poses.len() as f64));
    let known = match calibrated::known(told, &simulated, seed, &data) {
        Ok(known) => known,
        Err(error) => {
            run.faults.push(format!("calibrate: {error}"));
            run.figures.extend([None; 4]);
            return;
        }
    };
    let machine = Machine {
        built,
        mismatch: as_built,
        known_from_true: known.known_from_true,
        lengths_off_m: &known.lengths_off_m,
    };
    for (name, job) in [
        ("circle of the tool, calibrated", Job::Circle10s),
        ("line of the tool, calibrated", Job::LineAtLimit),
    ] {
        path(
            name,
            &case(job, Known::Absolute),
            &known.robot,
            machine,
            seed,
            false,
            run,
        );
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
