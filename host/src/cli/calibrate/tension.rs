//! `mcdpr calibrate tension N`: a tension sensor's gain and zero from known weights.

use super::super::recorded::{Work, on_record};
use super::super::{Common, Failed, Outcome, print_json, table::lay_out};
use crate::chart::{Chart, Curve, Figure};
use crate::experiment::SimulatedRobot;
use crate::files::write_atomically;
use crate::link::{Client, ClientError, Link, plant_failed};
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::record::Doing;
use crate::report::RunFolder;
use crate::robot::Robot;
use crate::run::{self, RunError};
use crate::tension::calibrate::{Fit, Reading, fit, parse, read_voltage, written_into};
use mcdpr_protocol::SessionId;
use miette::{Diagnostic, IntoDiagnostic as _};
use std::io::{BufRead as _, Write as _};
use std::path::PathBuf;

/// Find a tension sensor's gain and zero by hanging known weights on its cable
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Number of the cable, from 1
    cable: usize,
    /// Readings from a file (mass_kg,voltage_v per line) instead of a robot
    #[arg(long, value_name = "FILE")]
    data: Option<PathBuf>,
    /// Weights to hang, kg, pan included, in this order; at least three different ones
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "KG,...",
        default_values_t = [0.0, 0.5, 1.0, 2.0, 3.0, 2.0, 1.0, 0.5, 0.0]
    )]
    masses_kg: Vec<f64>,
    /// Temperature at the sensor, kept with the result, degrees Celsius
    #[arg(long, value_name = "C", allow_negative_numbers = true)]
    temperature_c: Option<f64>,
    /// Winch module file to write the result into; other lines are not changed
    #[arg(long, value_name = "FILE")]
    module: Option<PathBuf>,
    /// Do not wait for confirmation at each weight (not needed with the simulator)
    #[arg(long)]
    yes: bool,
}

/// The number does not belong to a cable of this robot.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[error("there is no cable {cable}: {name} has {count}")]
#[diagnostic(code(mcdpr::tension::cable), help("cables are numbered from 1"))]
struct NoCable {
    cable: usize,
    name: String,
    count: usize,
}

/// Readings from a file.
fn readings(path: &std::path::Path) -> miette::Result<Vec<Reading>> {
    let what = format!("reading {}", path.display());
    let text = crate::files::read_text(path).map_err(Failed::from_error(&what))?;
    Ok(parse(&text)?)
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = crate::robot::find(&common.robot)?;
        let index = self.cable.wrapping_sub(1);
        let winch = robot.winch_of(index).ok_or_else(|| NoCable {
            cable: self.cable,
            name: robot.name.clone(),
            count: robot.cables.len(),
        })?;
        let name = format!("tension-sensor-{}", self.cable);
        if common.dry_run {
            return self.judged(common);
        }
        let model = Model::new(&robot)?;
        let folder = RunFolder::create(common.record.as_deref(), &name).into_diagnostic()?;
        let readings = match &self.data {
            Some(path) => readings(path)?,
            None => {
                let common = Common {
                    record: Some(folder.path().to_owned()),
                    ..common.clone()
                };
                self.read(&model, winch, &common)?
            }
        };
        let fit = fit(&readings)?;
        self.report(&robot, &fit, &folder, common)
    }

    /// The fit of readings from a file; nothing is written.
    fn judged(&self, common: &Common) -> Outcome {
        let Some(path) = &self.data else {
            let words = "calibrate tension` without `--data";
            return Err(crate::cli::dry::refusal(words).into());
        };
        let fit = fit(&readings(path)?)?;
        if common.json {
            return print_json(&fit);
        }
        say!(
            "gain {:.4} +- {:.4} N/V, zero {:.4} V; nothing was written",
            fit.gain_n_per_v,
            fit.gain_error_n_per_v,
            fit.zero_v
        );
        Ok(())
    }

    /// Reads the channel under every weight, on record.
    fn read(
        &self,
        model: &Model,
        winch: &crate::robot::Winch,
        common: &Common,
    ) -> miette::Result<Vec<Reading>> {
        let robot = model.robot();
        let about = Work {
            name: "tension-sensor",
            doing: Doing::Hands,
            mismatch: Mismatch::realistic(),
            cables: robot.cables.len(),
            model: None,
            orders: None,
            plans_first: false,
        };
        let (readings, _) = on_record(common, &about, |record| {
            if common.on != "sim" {
                let line = common.open_port().map_err(ClientError::from)?;
                let line = (record.line(line), record.session);
                return self.guide(robot, winch, line, |mass_kg| {
                    if !self.yes {
                        confirm(self.cable, mass_kg);
                    }
                    Ok(())
                });
            }
            // The sensor of the simulated machine is off by up to 1 %, so that there is an error to
            // find.
            let link = SimulatedRobot::new(about.mismatch, common.seed)
                .controller(&common.controller)
                .at_home(model)?;
            let line = (record.simulated(link.clone()), record.session);
            self.guide(robot, winch, line, |mass_kg| {
                let weight_n = mass_kg * mcdpr_kinematics::GRAVITY_MPS2;
                link.with(|s| s.plant_mut().hang_weight(self.cable - 1, Some(weight_n)))
                    .map_err(|error| ClientError::from(plant_failed(error)).into())
            })
        })?;
        Ok(readings)
    }

    /// Reads the channel under each weight; nothing is armed.
    fn guide<L: Link>(
        &self,
        robot: &Robot,
        winch: &crate::robot::Winch,
        (link, session): (L, SessionId),
        mut hang: impl FnMut(f64) -> Result<(), RunError>,
    ) -> miette::Result<Vec<Reading>> {
        let mut client = Client::connect(link, session).map_err(RunError::from)?;
        run::configure(&mut client, robot)?;
        let mut readings = Vec::new();
        for &mass_kg in &self.masses_kg {
            hang(mass_kg)?;
            let voltage_v = read_voltage(&mut client, winch, self.cable - 1)?;
            eprintln!("{mass_kg:.3} kg: {voltage_v:.4} V");
            readings.push(Reading { mass_kg, voltage_v });
        }
        client
            .request(mcdpr_protocol::Request::Close)
            .map_err(RunError::from)?;
        Ok(readings)
    }

    fn report(&self, robot: &Robot, fit: &Fit, folder: &RunFolder, common: &Common) -> Outcome {
        let newtons = |r: &Reading| r.mass_kg * mcdpr_kinematics::GRAVITY_MPS2;
        let ends = [fit.zero_v, 3.3].map(|v| (v, fit.gain_n_per_v * (v - fit.zero_v)));
        let weights = fit.readings.iter().map(|r| (r.voltage_v, newtons(r)));
        let chart = Chart::new("weights and line", "voltage u, V", "tension y, N").with([
            Curve::new("y = k (u - u0)", 0, ends),
            Curve::new("weights", 1, weights).crosses(),
        ]);
        let title = format!("{}, tension sensor of cable {}", robot.name, self.cable);
        folder
            .plot("sensor", &Figure::new(title, 1, [chart]), common.plots())
            .into_diagnostic()?;
        folder.write_json("sensor.json", fit).into_diagnostic()?;
        let at = self
            .temperature_c
            .map_or(String::new(), |c| format!(" at {c} degrees C"));
        let note = format!(
            "calibrated{at} with {} readings, +- {:.4}",
            fit.readings.len(),
            fit.gain_error_n_per_v
        );
        folder
            .write("winch.toml", &written_into("", fit, &note))
            .into_diagnostic()?;
        if let Some(path) = &self.module {
            let old = match crate::files::read_text(path) {
                Ok(text) => text,
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
                Err(error) => {
                    return Err(Failed::from_error("reading the module file")(error).into());
                }
            };
            write_atomically(path, written_into(&old, fit, &note))
                .map_err(Failed::from_error("writing the module file"))?;
        }
        if common.json {
            return print_json(fit);
        }
        let row = |name: &str, value: String| vec![name.to_owned(), value];
        let residuals = fit.residuals_n.iter();
        let worst = residuals.map(|r| r.abs()).fold(0.0, f64::max);
        super::super::write_out(&lay_out(&[
            row(
                "gain k, N/V",
                format!("{:.4} +- {:.4}", fit.gain_n_per_v, fit.gain_error_n_per_v),
            ),
            row(
                "zero u0, V",
                format!("{:.5} +- {:.5}", fit.zero_v, fit.zero_error_v),
            ),
            row("full scale at 3.3 V, N", format!("{:.2}", fit.full_scale_n)),
            row("greatest residual, N", format!("{worst:.3}")),
            row(
                "nonlinearity, % of full scale",
                format!("{:.2}", fit.nonlinearity * 100.0),
            ),
            row(
                "hysteresis, N",
                fit.hysteresis_n
                    .map_or("no load was read twice".to_owned(), |h| format!("{h:.3}")),
            ),
        ]));
        say!(
            "a strain gauge's zero drifts with temperature: calibrate warm, and again when arming \
             finds a tension off (S10)"
        );
        match &self.module {
            Some(path) => say!("written into {}", path.display()),
            None => say!(
                "nothing was changed; {}/winch.toml has the lines for the winch, or give --module FILE",
                folder.path().display()
            ),
        }
        Ok(())
    }
}

fn confirm(cable: usize, mass_kg: f64) {
    eprint!("hang {mass_kg} kg on cable {cable}, let it come to rest, press Enter ");
    let _ = std::io::stderr().flush();
    let mut line = String::new();
    let _ = std::io::stdin().lock().read_line(&mut line);
}
