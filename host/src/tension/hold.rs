//! Holds a tension on the robot behind a link, and records the board's measurements.

use super::bench::Trace;
use super::task::{Experiment, Prompt};
use crate::link::{Client, Event, Link};
use crate::machine;
use crate::motion::Model;
use crate::run::{self, Recorder, RunError};
use mcdpr_protocol::SessionId;

/// Arms the robot at its present position and holds as long as the experiment requires; `note` gets
/// the instructions for the operator. The trace has measured tensions only.
///
/// # Errors
/// As a run. Afterwards the brakes are closed and the session is ended.
pub fn hold<L: Link>(
    model: &Model,
    link: L,
    session: SessionId,
    experiment: &Experiment,
    mut note: impl FnMut(&str),
) -> Result<Trace, RunError> {
    let mut client = Client::connect(link, session)?;
    let hash = run::configure(&mut client, model.robot())?;
    let status = run::status(&mut client)?;
    if let Some(record) = status.fault {
        return Err(RunError::Latched { record });
    }
    if !status.referenced {
        let home = model.rest_at_home()?;
        client.request(machine::reference(&home.paid_out_m, home.tensions_n()))?;
    }
    run::arm(&mut client, hash)?;
    // Samples of arming are not part of the trace.
    while client.next_event().is_some() {}
    let begin_us = client.now_us();
    let mut recorder = Recorder::default();
    let end = Prompt {
        at_s: experiment.script.duration_s,
        text: String::new(),
    };
    for Prompt { at_s, text } in experiment.prompts.iter().chain([&end]) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "some seconds"
        )]
        let until_us = begin_us + (at_s * 1e6) as u64;
        client.pump(until_us)?;
        while let Some(event) = client.next_event() {
            if let Event::Samples(block) = event {
                recorder.take(&block, 0.0);
            }
        }
        if !text.is_empty() {
            note(text);
        }
        if run::interrupted() {
            break;
        }
    }
    let fault = run::status(&mut client)?.fault;
    // After a fault the board has stopped and closed its brakes by itself.
    if fault.is_none() {
        run::disarm(&mut client)?;
    }
    let watched = model.holding().first_by_tension().unwrap_or(0);
    let first = recorder.samples.first().map_or(0, |sample| sample.tick);
    let mut trace = Trace {
        setpoint_n: model.robot().tension.setpoint_n,
        fault: fault.map(|record| crate::link::describe_fault(&record)),
        ..Trace::default()
    };
    for sample in &recorder.samples {
        let tension = sample.tensions_n.get(watched).copied().unwrap_or(0.0);
        let at_s = f64::from(sample.tick.wrapping_sub(first)) * 1e-3;
        trace.time_s.push(at_s);
        trace.measured_s.push(at_s);
        trace.setpoints_n.push(trace.setpoint_n);
        trace.tension_n.push(tension);
        trace.measured_n.push(tension);
        let least = sample.tensions_n.iter().copied();
        trace.least_n.push(least.fold(f64::INFINITY, f64::min));
        trace
            .current_a
            .push(sample.currents_a.get(watched).copied().unwrap_or(0.0));
    }
    Ok(trace)
}
