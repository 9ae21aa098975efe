//! Each output in turn, and what it does to the inputs through jumper wires.

use super::{BenchError, JUMPER_HIGH_V, JUMPER_LOW_V, JUMPER_OFF_V, ask, bad, wait};
use crate::doctor::{Finding, Verdict};
use crate::link::{Client, Link};
use crate::run::RunError;
use crate::service::volts;
use mcdpr_protocol::{BENCH_OUTPUT_MS, BENCH_OUTPUTS, BenchTest};

/// Names of the outputs, in the order of [`BenchTest::Output`].
const OUTPUTS: [&str; BENCH_OUTPUTS as usize] = [
    "brake 1",
    "brake 2",
    "brake 3",
    "brake 4",
    "gripper",
    "drive enable",
];

/// Each output in turn: it must rise alone, and fall by itself.
pub(super) fn outputs<L: Link>(
    client: &mut Client<L>,
    jumpers: bool,
    confirm: &mut dyn FnMut(&str) -> bool,
    findings: &mut Vec<Finding>,
) -> Result<(), BenchError> {
    for (output, name) in (1..).zip(OUTPUTS) {
        if !confirm(name) {
            findings.push(Finding::with(
                Verdict::Unseen,
                "output",
                format!("{name} was not tried"),
                "run this with --outputs, and type the output's name when it is asked for",
            ));
            continue;
        }
        let before = look(client)?;
        if let Err(error) = ask(client, BenchTest::Output { output }) {
            let found = format!("{name} was not tried: {error}");
            findings.push(bad(
                "output",
                found,
                "repair what is named above, press reset and run this again",
            ));
            continue;
        }
        // The board raises an output for 0.3 s: it is read after the first 0.1 s.
        wait(client, 100_000)?;
        let raised = ask(client, BenchTest::Look)?.outputs;
        let during = look(client)?;
        wait(client, 1000 * u64::from(BENCH_OUTPUT_MS))?;
        let after = ask(client, BenchTest::Look)?.outputs;
        findings.push(if raised == 1 << (output - 1) && after == 0 {
            Finding::good("output", format!("{name} rose alone and fell by itself"))
        } else {
            bad(
                "output",
                format!("{name}: levels {raised:06b} while it was raised, {after:06b} after"),
                "look for a short at the pin, or between it and its neighbour",
            )
        });
        if jumpers {
            findings.push(jumper(usize::from(output), name, &before, &during));
        }
    }
    Ok(())
}

/// Present inputs of every winch: encoder counts and the voltage of the tension input.
fn look<L: Link>(client: &mut Client<L>) -> Result<Vec<(i32, f64)>, RunError> {
    let mut inputs = Vec::new();
    for cable in 1..=client.info().cables {
        let winch = client.winch(cable)?;
        inputs.push((winch.drum_counts, volts(f64::from(winch.tension_adc))));
    }
    Ok(inputs)
}

/// Expected and actual inputs with jumper wires while an output is high.
fn jumper(output: usize, name: &str, before: &[(i32, f64)], during: &[(i32, f64)]) -> Finding {
    let drive_enable = usize::from(BENCH_OUTPUTS);
    for (winch, (before, during)) in (1..).zip(before.iter().zip(during)) {
        // The first edge of A counts up, that of B down.
        let (counts, volts) = match output {
            _ if output == drive_enable => (-1, JUMPER_LOW_V),
            _ if output == winch => (1, JUMPER_HIGH_V),
            _ => (0, JUMPER_LOW_V),
        };
        let counted = during.0 - before.0;
        let reads = |read_v: f64, wanted_v: f64| (read_v - wanted_v).abs() < JUMPER_OFF_V;
        if counted != counts {
            let found = format!("{name}: encoder {winch} counted {counted}, not {counts}");
            let remedy = "look at the wire from that output to A (brakes) or B (drive enable) of this encoder, at its buffer, and whether A and B are exchanged";
            return bad("jumper", found, remedy);
        }
        if !reads(before.1, JUMPER_LOW_V) || !reads(during.1, volts) {
            let found = format!(
                "{name}: tension input {winch} went from {:.2} V to {:.2} V, not from {JUMPER_LOW_V:.2} V to {volts:.2} V",
                before.1, during.1
            );
            let remedy = "look at the 22 kOhm from the brake's output to this input, and at the input's 10 kOhm to 3.3 V";
            return bad("jumper", found, remedy);
        }
    }
    Finding::good(
        "jumper",
        format!("{name} is seen where it leads to, and nowhere else"),
    )
}
