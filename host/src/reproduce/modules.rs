//! The paper's measurements on a winch module: the motor's reduction (Eq. 50) and the tension
//! sensor's line (Figure 16), by the commands that measure them on a board.

use super::{Bench, Origin, Outcome, ReproduceError, Row, none, paper_robot};
use crate::calibration::study::median;
use crate::chart::{Chart, Curve};
use crate::experiment::SimulatedRobot;
use crate::link::{Client, SimulatedLink, plant_failed};
use crate::machine::{self, Controller, Firmware, Mismatch};
use crate::motion::Model;
use crate::robot::Robot;
use crate::run::{self, RunError};
use crate::service::{Ratio, ServiceError, measure_ratio};
use crate::tension::calibrate::{Fit, Reading, fit, read_voltage};
use mcdpr_protocol::{Request, SessionId};
use mcdpr_simulator::LinkOptions;
use mcdpr_simulator::plant::PlantError;
use rayon::prelude::*;

/// Turns of the drum each way.
const TURNS: u32 = 3;
/// Weights that are hung on the sensor, kg, up and down again.
const WEIGHTS_KG: [f64; 9] = [0.0, 0.5, 1.0, 2.0, 3.0, 2.0, 1.0, 0.5, 0.0];

/// The errors of the simulated robot, as for a run.
fn line(error: PlantError) -> RunError {
    RunError::Client(plant_failed(error).into())
}

/// The reduction of winch 1 of a bare machine, by turning its drum.
fn ratio(
    robot: &Robot,
    mismatch: &Mismatch,
    seed: u64,
    firmware: Option<&Firmware>,
) -> Result<Ratio, ServiceError> {
    let options = LinkOptions::default();
    let simulation =
        machine::simulate_unloaded(robot, mismatch, &options, seed, &Controller::of(firmware))
            .map_err(|error| ServiceError::Run(line(error)))?;
    let link = SimulatedLink::new(simulation);
    let mut client = Client::connect(link, SessionId(1))?;
    measure_ratio(&mut client, robot, 1, TURNS)
}

/// Section 3.3: motor counts per count of the drum's encoder.
pub(super) fn motor(bench: &Bench) -> Result<Outcome, ReproduceError> {
    let robot = paper_robot()?;
    let failed = |error: ServiceError| match error {
        ServiceError::Run(error) => ReproduceError::Run(error),
        other => ReproduceError::Service(other.to_string()),
    };
    let ideal = ratio(&robot, &Mismatch::default(), bench.seed, None).map_err(failed)?;
    let real: Result<Vec<_>, _> = (bench.seed..bench.seed + bench.seeds)
        .into_par_iter()
        .map(|seed| ratio(&robot, &Mismatch::realistic(), seed, None))
        .collect();
    let real = real.map_err(failed)?;
    let chip = bench
        .firmware
        .as_ref()
        .map(|firmware| ratio(&robot, &Mismatch::realistic(), bench.seed, Some(firmware)));
    let of = |ratio: &Ratio| {
        (
            ratio.rho.abs(),
            ratio.rho_sd,
            ratio.backlash_motor_counts.abs(),
        )
    };
    let text = |(rho, sd, _): (f64, f64, f64)| format!("{rho:.3} / {sd:.3}");
    let middle = |each: &dyn Fn(&Ratio) -> f64| median(real.iter().map(each).collect());
    let rho = middle(&|r| of(r).0);
    let sd = middle(&|r| of(r).1);
    let row = |quantity: &str, paper: &str, ours: [String; 3]| {
        let [as_described, realistic, chip] = ours;
        Row {
            quantity: quantity.to_owned(),
            paper: paper.to_owned(),
            origin: Origin::Hardware,
            as_described,
            realistic,
            chip,
        }
    };
    let on_chip = |show: &dyn Fn(&Ratio) -> String| match &chip {
        None => none(),
        Some(Ok(ratio)) => show(ratio),
        Some(Err(error)) => format!("failed: {error}"),
    };
    Ok(Outcome {
        id: "motor",
        title: "The motor's reduction (Section 3, Eq. 50)",
        rows: vec![
            row(
                "motor counts per encoder count, mean / sd of one turn",
                "371.13 / -",
                [
                    text(of(&ideal)),
                    text((rho, sd, 0.0)),
                    on_chip(&|r| text(of(r))),
                ],
            ),
            row(
                "backlash, motor counts (least that can be detected)",
                "-",
                [
                    format!("{:.0} ({:.0})", of(&ideal).2, ideal.backlash_resolution),
                    format!(
                        "{:.0} ({:.0})",
                        middle(&|r| of(r).2),
                        middle(&|r| r.backlash_resolution)
                    ),
                    on_chip(&|r| format!("{:.0} ({:.0})", of(r).2, r.backlash_resolution)),
                ],
            ),
        ],
        notes: vec![
            "The simulated winch has the paper's reduction, so the mean only shows that `mcdpr \
             calibrate winch` finds what is there: one drum turn at a time, three out and three \
             back, at rest at each end. What it adds is the spread: an encoder count is 371 motor \
             counts, and that is the resolution of one turn. 371.13 is not a gear ratio but motor \
             counts per encoder count: 1,520,148 per drum turn."
                .to_owned(),
        ],
        charts: Vec::new(),
        pictures: Vec::new(),
    })
}

/// The line of cable 1's sensor from weights on its cable.
fn sensor_line(
    model: &Model,
    mismatch: &Mismatch,
    seed: u64,
    firmware: Option<&Firmware>,
) -> Result<Fit, ReproduceError> {
    let robot = model.robot();
    let Some(winch) = robot.winch_of(0) else {
        return Err(ReproduceError::Service("the robot has no winch".to_owned()));
    };
    let link = SimulatedRobot::new(*mismatch, seed)
        .controller(&Controller::of(firmware))
        .at_home(model)?;
    let mut client = Client::connect(link.clone(), SessionId(1)).map_err(RunError::from)?;
    run::configure(&mut client, robot)?;
    let mut readings = Vec::new();
    for mass_kg in WEIGHTS_KG {
        let weight_n = mass_kg * mcdpr_kinematics::GRAVITY_MPS2;
        link.with(|s| s.plant_mut().hang_weight(0, Some(weight_n)))
            .map_err(line)?;
        let voltage_v = read_voltage(&mut client, winch, 0)?;
        readings.push(Reading { mass_kg, voltage_v });
    }
    client.request(Request::Close).map_err(RunError::from)?;
    fit(&readings).map_err(|error| ReproduceError::Service(error.to_string()))
}

/// Figure 16.
pub(super) fn sensor(bench: &Bench) -> Result<Outcome, ReproduceError> {
    let model = Model::new(&paper_robot()?)?;
    let ideal = sensor_line(&model, &Mismatch::default(), bench.seed, None)?;
    let mut real = Vec::new();
    for seed in bench.seed..bench.seed + bench.seeds {
        real.push(sensor_line(&model, &Mismatch::realistic(), seed, None)?);
    }
    let chip = bench
        .firmware
        .as_ref()
        .map(|firmware| sensor_line(&model, &Mismatch::realistic(), bench.seed, Some(firmware)));
    let row = |quantity: &str, paper: &str, of: &dyn Fn(&Fit) -> f64| Row {
        quantity: quantity.to_owned(),
        paper: paper.to_owned(),
        origin: Origin::Hardware,
        as_described: format!("{:.4}", of(&ideal)),
        realistic: format!("{:.4}", median(real.iter().map(of).collect())),
        chip: match &chip {
            None => none(),
            Some(Ok(fit)) => format!("{:.4}", of(fit)),
            Some(Err(error)) => format!("failed: {error}"),
        },
    };
    let newtons = |r: &Reading| r.mass_kg * mcdpr_kinematics::GRAVITY_MPS2;
    let first = real.first().unwrap_or(&ideal);
    let weights = first.readings.iter().map(|r| (r.voltage_v, newtons(r)));
    let ends = [first.zero_v, 3.3].map(|v| (v, first.gain_n_per_v * (v - first.zero_v)));
    Ok(Outcome {
        id: "sensor",
        title: "Calibration of a tension sensor (Figure 16)",
        rows: vec![
            row("gain k, N/V", "12.77", &|fit| fit.gain_n_per_v),
            row("zero u0, V", "0.2355", &|fit| fit.zero_v),
            row("full scale at 3.3 V, N", "39.1434", &|fit| fit.full_scale_n),
            row("nonlinearity, % of full scale", "-", &|fit| {
                fit.nonlinearity * 100.0
            }),
        ],
        notes: vec![
            "The simulated sensor has the paper's line (realistic: gain off by up to 1 %, 2 % of \
             the tension lost at the pulley, noise of 0.05 N), and `mcdpr calibrate tension` finds \
             it from weights of 0 to 3 kg, up and down. With k and u0 as printed the full scale is \
             39.13 N."
                .to_owned(),
        ],
        charts: vec![
            Chart::new(
                "Figure 16: weights and the line through them, realistic",
                "voltage, V",
                "tension, N",
            )
            .with([
                Curve::new("line", 0, ends),
                Curve::new("weights", 3, weights).crosses(),
            ]),
        ],
        pictures: Vec::new(),
    })
}
