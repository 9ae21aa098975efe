//! Constant tension of cable 4: Figures 31 to 33.

use super::{Bench, Origin, Outcome, ReproduceError, Row, none, paper_robot};
use crate::calibration::study::median;
use crate::experiment;
use crate::link::{Client, Event, SimulatedLink};
use crate::machine::{self, Firmware, Mismatch};
use crate::motion::{Model, PlanOptions, Tensioning};
use crate::report::chart::{Chart, Curve};
use crate::run::{self, Recorder, RunError};
use mcdpr_protocol::{Request, SessionId};
use mcdpr_simulator::LinkOptions;
use rayon::prelude::*;

/// Time at rest, s.
const REST_S: f64 = 6.0;
/// The push: when it begins and ends after the samples begin, s.
const PUSH_S: (f64, f64) = (3.0, 3.2);
/// The push on the platform, world, N: a good tenth of its weight, sideways and up.
const PUSH_N: [f64; 3] = [1.2, 0.8, 0.6];
/// The band of the paper, N.
const BAND_N: f64 = 0.5;
/// Width of the mean that stands for what a control curve shows, samples: sensor noise is no
/// deviation of the tension.
const SMOOTH: usize = 20;

/// Time since holding (s) and tension of cable 4 (N).
type Trace = Vec<(f64, f64)>;

/// Arms the robot, holds, optionally pushes it, and gives cable 4's measured tension.
fn hold(
    model: &Model,
    mismatch: &Mismatch,
    seed: u64,
    push: bool,
    firmware: Option<&Firmware>,
) -> Result<Trace, ReproduceError> {
    let options = LinkOptions::default();
    let link = experiment::simulated_robot_on(model, mismatch, seed, &options, firmware)?;
    let mut client = Client::connect(link.clone(), SessionId(1)).map_err(RunError::from)?;
    let hash = run::configure(&mut client, model.robot())?;
    let home = experiment::home(model)?;
    let reference = machine::reference(&home.paid_out_m, home.tensions_n());
    client.request(reference).map_err(RunError::from)?;
    run::arm(&mut client, hash)?;
    let mut recorder = Recorder::default();
    let start_us = client.now_us();
    let at = |seconds: f64| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "some seconds"
        )]
        let us = (seconds * 1e6) as u64;
        start_us + us
    };
    let mut stage = |until_s: f64, client: &mut Client<SimulatedLink>| -> Result<(), RunError> {
        while client.now_us() < at(until_s) {
            client.pump((client.now_us() + 20_000).min(at(until_s)))?;
            while let Some(event) = client.next_event() {
                if let Event::Samples(block) = event {
                    recorder.take(&block, f64::MAX);
                }
            }
        }
        Ok(())
    };
    let load = |force: [f64; 3]| {
        link.with(|simulation| simulation.plant_mut().set_load(force, [0.0; 3], [0.0; 3]))
            .map_err(|error| RunError::Client(crate::link::LinkError::from(error).into()))
    };
    stage(PUSH_S.0, &mut client)?;
    if push {
        load(PUSH_N)?;
    }
    stage(PUSH_S.1, &mut client)?;
    if push {
        load([0.0; 3])?;
    }
    stage(REST_S, &mut client)?;
    client
        .request(Request::Samples { enabled: false })
        .map_err(RunError::from)?;
    run::disarm(&mut client)?;
    let held = model.tension_held().unwrap_or(3);
    let first = recorder.samples.first().map_or(0, |sample| sample.tick);
    let points = recorder.samples.iter().filter_map(|sample| {
        let time_s = f64::from(sample.tick.wrapping_sub(first)) * 1e-3;
        Some((time_s, *sample.tensions_n.get(held)?))
    });
    Ok(smooth(&points.collect::<Vec<_>>()))
}

/// The running mean.
fn smooth(points: &[(f64, f64)]) -> Trace {
    let windows = points.windows(SMOOTH);
    windows
        .map(|window| {
            let sum: f64 = window.iter().map(|(_, value)| value).sum();
            let middle = window.get(SMOOTH / 2).map_or(0.0, |(time, _)| *time);
            (middle, sum / window.len() as f64)
        })
        .collect()
}

/// Steady error (mean, greatest), N, over the last second before the push.
fn steady(trace: &Trace, setpoint_n: f64) -> Vec<f64> {
    let window = trace
        .iter()
        .filter(|(t, _)| (PUSH_S.0 - 1.0..PUSH_S.0).contains(t));
    let errors: Vec<_> = window.map(|(_, n)| (n - setpoint_n).abs()).collect();
    let mean = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
    vec![mean, errors.iter().copied().fold(0.0, f64::max)]
}

/// Greatest deviation after the push began (N), and time until the tension is in its band for
/// good (s after the push began).
fn recovery(trace: &Trace, setpoint_n: f64) -> Vec<f64> {
    let after = || trace.iter().filter(|(t, _)| *t >= PUSH_S.0);
    let greatest = after()
        .map(|(_, n)| (n - setpoint_n).abs())
        .fold(0.0, f64::max);
    let outside = after().filter(|(_, n)| (n - setpoint_n).abs() > BAND_N);
    let last = outside.map(|(t, _)| t - PUSH_S.0).fold(0.0, f64::max);
    vec![greatest, last]
}

/// All conditions: the ideal trace and the figures of every column.
fn conditions(
    bench: &Bench,
    push: bool,
    of: fn(&Trace, f64) -> Vec<f64>,
) -> Result<(Trace, f64, [String; 3]), ReproduceError> {
    // The paper holds 10 N, wherever the robot hangs.
    let options = PlanOptions {
        tensioning: Tensioning::Setpoint,
        ..PlanOptions::default()
    };
    let model = Model::new(&paper_robot()?)?.with_options(options);
    let setpoint_n = model.robot().tension.setpoint_n;
    let ideal = hold(&model, &Mismatch::default(), bench.seed, push, None)?;
    let real: Result<Vec<_>, ReproduceError> = (0..bench.seeds)
        .into_par_iter()
        .map(|number| {
            let seed = bench.seed + number;
            hold(&model, &Mismatch::realistic(), seed, push, None)
                .map(|trace| of(&trace, setpoint_n))
        })
        .collect();
    let real = real?;
    let chip = bench.firmware.as_ref().map(|firmware| {
        hold(
            &model,
            &Mismatch::realistic(),
            bench.seed,
            push,
            Some(firmware),
        )
        .map(|trace| of(&trace, setpoint_n))
    });
    let text = |values: &[f64]| {
        let cells: Vec<_> = values.iter().map(|v| format!("{v:.3}")).collect();
        cells.join(" / ")
    };
    let columns = real.first().map_or(0, Vec::len);
    let medians: Vec<_> = (0..columns)
        .map(|c| median(real.iter().filter_map(|v| v.get(c).copied()).collect()))
        .collect();
    let cells = [
        text(&of(&ideal, setpoint_n)),
        text(&medians),
        match chip {
            None => none(),
            Some(Ok(values)) => text(&values),
            Some(Err(error)) => format!("failed: {error}"),
        },
    ];
    Ok((ideal, setpoint_n, cells))
}

fn outcome(
    id: &'static str,
    title: &'static str,
    (quantity, paper, figure): (&str, &str, &str),
    (trace, setpoint_n, [as_described, realistic, chip]): (Trace, f64, [String; 3]),
    note: &str,
) -> Outcome {
    Outcome {
        id,
        title,
        rows: vec![Row {
            quantity: quantity.to_owned(),
            paper: paper.to_owned(),
            origin: Origin::Hardware,
            as_described,
            realistic,
            chip,
        }],
        notes: vec![note.to_owned()],
        charts: vec![Chart {
            title: format!("{figure}: tension of cable 4 and the band of 0.5 N"),
            axes: ("time, s".to_owned(), "N".to_owned()),
            curves: vec![Curve::new("measured", 3, trace)],
            band: Some((setpoint_n - BAND_N, setpoint_n + BAND_N)),
            ..Chart::default()
        }],
    }
}

/// Figures 31a and 32.
pub(super) fn at_rest(bench: &Bench) -> Result<Outcome, ReproduceError> {
    Ok(outcome(
        "tension-static",
        "Constant tension at rest (Figures 31a and 32)",
        (
            "steady tension error, mean / max, N",
            "0.2 / -",
            "Figure 32",
        ),
        conditions(bench, false, steady)?,
        "The robot hangs at home and holds; the last second of three. Means over 20 ms, so that \
         the sensor's noise is not taken for a deviation. Medians over the seeds.",
    ))
}

/// Figures 31b and 33.
pub(super) fn disturbed(bench: &Bench) -> Result<Outcome, ReproduceError> {
    Ok(outcome(
        "tension-disturbed",
        "Constant tension under disturbance (Figures 31b and 33)",
        (
            "greatest deviation, N / back in the band for good after, s",
            "0.5 / about 1",
            "Figure 33",
        ),
        conditions(bench, true, recovery)?,
        "The paper's disturbance, a hand, is not described. Ours: (1.2, 0.8, 0.6) N at the \
         platform for 0.2 s, after which it swings: nothing damps the swing of an \
         under-constrained platform but the winches. Medians over the seeds.",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recovery_is_measured_to_the_last_time_outside_the_band() {
        let trace: Trace = (0..6000)
            .map(|ms| {
                let time = f64::from(ms) * 1e-3;
                let pushed = (3.0..3.4).contains(&time) || (time - 3.9).abs() < 2e-3;
                (time, if pushed { 11.5 } else { 10.1 })
            })
            .collect();
        let [greatest, last] = recovery(&trace, 10.0)[..] else {
            panic!("two figures");
        };
        assert!(
            (greatest - 1.5).abs() < 1e-9 && (last - 0.9).abs() < 5e-3,
            "{greatest} {last}"
        );
        let [mean, max] = steady(&trace, 10.0)[..] else {
            panic!("two figures");
        };
        assert!((mean - 0.1).abs() < 1e-9 && (max - 0.1).abs() < 1e-9);
    }
}
