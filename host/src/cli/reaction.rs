//! What `mcdpr demo --fault` prints: the timeline of the robot's reaction.

use super::{Common, Outcome, print_json};
use crate::experiment::SimulatedRobot;
use crate::link::advice;
use crate::machine::Mismatch;
use crate::motion::{Model, Task};
use crate::scenario::{self, Aftermath, How, Injection, Scenario, When, how};
use mcdpr_protocol::FaultId;
use serde::Serialize;

#[derive(Debug, Serialize)]
struct Document<'a> {
    scenario: &'a str,
    faults: Vec<String>,
    injected_ms: &'a [u64],
    noticed: Option<&'static str>,
    noticed_after_ms: Option<usize>,
    /// Fault and cable that the samples show as the cause, where they show another.
    probable_cause: Option<(&'static str, u8)>,
    timeline: Vec<(i64, String)>,
    /// Greatest distance of the tool from its path, and height lost against it, since the first fault, m.
    deviation_m: f64,
    drop_m: f64,
    largest_tension_over_limit: f64,
    over_limit_by_10_percent_ms: usize,
    slack_ms: usize,
    end: String,
    safe: bool,
    outcome: String,
    simulated: bool,
    seed: u64,
}

/// Runs the task with these faults and prints the robot's reaction.
pub(super) fn show(model: &Model, task: Task, scenario: &Scenario, common: &Common) -> Outcome {
    let robot =
        SimulatedRobot::new(Mismatch::realistic(), common.seed).controller(&common.controller);
    let after = scenario::run(model, task, &robot, scenario)?;
    if common.json {
        return print_json(&document(scenario, &after, common.seed));
    }
    let injections = scenario.injections.iter().map(describe);
    for line in injections {
        say!("{line}");
    }
    if after.injected_ms.is_empty() {
        say!("the run ended before any of it happened");
    }
    say!(
        "\n   time   (ms after the first fault; simulation, realistic machine, seed {})",
        common.seed
    );
    let moments = after.timeline();
    // Events before the fault are left out.
    for moment in moments.iter().filter(|moment| moment.after_ms >= 0) {
        say!("{:>+7}   {}", moment.after_ms, moment.what);
    }
    let (share, over_ms) = after.over_tension();
    let (slack_ms, cable) = after.slack();
    say!(
        "\nsince the fault the tool left its path by {:.2} mm at most, and dropped {:.2} mm",
        after.deviation_m() * 1e3,
        after.drop_m() * 1e3
    );
    say!(
        "largest tension {:.0} % of its limit, {over_ms} ms over it by more than 10 %",
        share * 100.0
    );
    match slack_ms {
        0 => say!("no cable was slack under torque"),
        _ => say!(
            "cable {} was slack for {slack_ms} ms under torque",
            cable + 1
        ),
    }
    match &after.error {
        None => say!("the motion went on to its end"),
        Some(error) => say!("the program ended: {error}"),
    }
    if let Some(record) = after.record() {
        let fault = after.cause().map_or(record.fault, |why| why.fault);
        say!("what to do: {}", advice(fault));
    }
    Ok(())
}

fn describe(injection: &Injection) -> String {
    let what = match how(injection.fault) {
        _ if injection.snag.is_some() => "a stiff hook catches the tool",
        How::Plant(what) | How::Line(what) | How::Host(what) => what,
        How::Not(why) => why,
    };
    let when = match injection.when {
        When::Start => "before it arms".to_owned(),
        When::Motion(at_s) => format!("{at_s} s into the motion"),
        When::After(phase, at_s) => format!("{at_s} s after {} began", phase.name()),
    };
    let whole = matches!(
        injection.fault,
        FaultId::C5 | FaultId::P2 | FaultId::P7 | FaultId::D1
    );
    let cable = match how(injection.fault) {
        How::Plant(_) if !whole && injection.snag.is_none() => {
            format!(" on cable {}", injection.cable + 1)
        }
        _ => String::new(),
    };
    format!("{}{cable}, {when}: {what}", injection.fault.name())
}

fn document<'a>(scenario: &'a Scenario, after: &'a Aftermath, seed: u64) -> Document<'a> {
    let (share, over_ms) = after.over_tension();
    let moments = after.timeline().into_iter();
    Document {
        scenario: &scenario.name,
        faults: scenario.injections.iter().map(describe).collect(),
        injected_ms: &after.injected_ms,
        noticed: after.record().map(|record| record.fault.name()),
        noticed_after_ms: after.detected_after_ms(),
        probable_cause: after.cause().map(|why| (why.fault.name(), why.cable)),
        timeline: moments.map(|m| (m.after_ms, m.what)).collect(),
        deviation_m: after.deviation_m(),
        drop_m: after.drop_m(),
        largest_tension_over_limit: share,
        over_limit_by_10_percent_ms: over_ms,
        slack_ms: after.slack().0,
        end: after
            .end()
            .map_or_else(String::new, |state| format!("{state:?}")),
        safe: after.is_safe(),
        outcome: after
            .error
            .as_ref()
            .map_or_else(|| "done".to_owned(), ToString::to_string),
        simulated: true,
        seed,
    }
}
