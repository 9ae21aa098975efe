//! Drives, encoders, tension sensors and brakes, at rest.

use super::{Finding, Verdict};
use crate::link::{Client, Link};
use crate::robot::{DriveKind, Robot};
use crate::run::RunError;
use crate::service::{scan, volts};
use mcdpr_firmware::adc::{RAIL_HIGH, RAIL_LOW};
use mcdpr_protocol::{Status, Winch};

/// Number of readings of every winch, and the time between them, µs.
const LOOKS: usize = 40;
const BETWEEN_US: u64 = 20_000;
/// A drum at rest may flicker between counts.
const FLICKER: f64 = 2.0;
/// More noise of one reading than this indicates bad wiring, N.
const NOISE_N: f64 = 0.5;
/// A sensor without load may read this much below zero, N.
const BELOW_ZERO_N: f64 = 1.0;

/// The drives that answer, and their states.
pub(super) fn drives<L: Link>(
    client: &mut Client<L>,
    robot: &Robot,
) -> Result<Vec<Finding>, RunError> {
    // On a bus that cannot send the scan does not end: then no drive answers.
    let found = scan(client)?.unwrap_or_default();
    let names = |nodes: &mut dyn Iterator<Item = u8>| {
        let names: Vec<_> = nodes.map(|node| node.to_string()).collect();
        match names.as_slice() {
            [] => "none".to_owned(),
            names => names.join(", "),
        }
    };
    let mut findings = Vec::new();
    let mut expected = Vec::new();
    for index in 0..robot.cables.len() {
        let Some(winch) = robot.winch_of(index) else {
            continue;
        };
        expected.push(winch.node);
        let seen = look(client, index)?;
        let finding = if seen.bus_off {
            Finding::with(
                Verdict::Bad,
                "drive",
                "the board's CAN controller is off the bus",
                "look for a short between CAN-H and CAN-L, a wrong `bitrate` in [bus], missing 120 ohm ends",
            )
        } else if !found.contains(&winch.node) {
            Finding::with(
                Verdict::Bad,
                "drive",
                format!(
                    "number {} does not answer; on the bus: {}",
                    winch.node,
                    names(&mut found.iter().copied())
                ),
                if found.is_empty() {
                    "check the drives' supply, CAN-H and CAN-L (not swapped), 120 ohm at both ends, `bitrate` in [bus]".to_owned()
                } else {
                    format!(
                        "check this drive's supply and plug; if it has another number, correct `node` or find it with `mcdpr commission {}`",
                        index + 1
                    )
                },
            )
        } else if seen.fault {
            Finding::with(
                Verdict::Bad,
                "drive",
                format!("number {} reports a fault", winch.node),
                "read the drive's status lamp or use its maker's tool, remove the cause, switch its supply off and on",
            )
        } else if seen.hot {
            Finding::with(
                Verdict::Note,
                "drive",
                format!("number {} is hot", winch.node),
                "let it cool; less load, or more air",
            )
        } else {
            let kind = match winch.drive {
                DriveKind::Rmds => "rmds",
                DriveKind::Cia402 => "cia402",
            };
            Finding::good("drive", format!("number {} ({kind}) answers", winch.node))
        };
        findings.push(finding.of(index));
    }
    let mut strangers = found
        .iter()
        .copied()
        .filter(|n| !expected.contains(n))
        .peekable();
    if strangers.peek().is_some() {
        findings.push(Finding::with(
            Verdict::Note,
            "drives",
            format!("numbers that no winch of the robot file has: {}", names(&mut strangers)),
            "give it to a winch (`node`), or take it off the bus: two drives of one number are none",
        ));
    }
    Ok(findings)
}

fn look<L: Link>(client: &mut Client<L>, index: usize) -> Result<Winch, RunError> {
    let cable = u8::try_from(index + 1).unwrap_or(u8::MAX);
    Ok(client.winch(cable)?)
}

/// Readings of one winch over [`LOOKS`] samples.
pub(super) struct Watched {
    /// Drum positions, encoder counts.
    drum_counts: Vec<f64>,
    /// Readings of the tension channel, steps of the converter.
    readings: Vec<f64>,
}

/// Reads every winch for most of a second.
pub(super) fn watch<L: Link>(
    client: &mut Client<L>,
    robot: &Robot,
) -> Result<Vec<Watched>, RunError> {
    let mut watched: Vec<_> = (0..robot.cables.len())
        .map(|_| Watched {
            drum_counts: Vec::with_capacity(LOOKS),
            readings: Vec::with_capacity(LOOKS),
        })
        .collect();
    for _ in 0..LOOKS {
        let until = client.now_us() + BETWEEN_US;
        client.pump(until)?;
        for (index, watched) in watched.iter_mut().enumerate() {
            let winch = look(client, index)?;
            watched.drum_counts.push(f64::from(winch.drum_counts));
            watched.readings.push(f64::from(winch.tension_adc));
        }
    }
    Ok(watched)
}

fn span(values: &[f64]) -> f64 {
    let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    most - least
}

/// Drums must be at rest while their brakes are closed.
pub(super) fn encoders(watched: &[Watched]) -> Vec<Finding> {
    let each = watched.iter().enumerate().map(|(index, watched)| {
        let moved = span(&watched.drum_counts);
        let finding = if moved > FLICKER {
            Finding::with(
                Verdict::Bad,
                "encoder",
                format!("the drum moved by {moved:.0} counts under its closed brake"),
                "the brake slips, or the encoder's wires pick up noise: hold the drum and look again; shield, 5 V and ground at the encoder (docs/wiring.md)",
            )
        } else {
            Finding::good(
                "encoder",
                "stands still under its brake; that it counts shows when the robot arms",
            )
        };
        finding.of(index)
    });
    each.collect()
}

/// Sensor readings must be plausible.
pub(super) fn tensions(watched: &[Watched], robot: &Robot) -> Vec<Finding> {
    let each = watched.iter().enumerate().filter_map(|(index, watched)| {
        let winch = robot.winch_of(index)?;
        let count = watched.readings.len() as f64;
        let mean = watched.readings.iter().sum::<f64>() / count;
        let squares = watched.readings.iter().map(|r| (r - mean).powi(2)).sum::<f64>();
        let read_v = volts(mean);
        let newtons = (read_v - winch.tension_zero_v) * winch.tension_gain_n_per_v;
        let noise_n = volts((squares / count).sqrt()) * winch.tension_gain_n_per_v;
        let reads = format!("{newtons:.2} N ({read_v:.3} V)");
        let broken = "check the sensor's plug, its amplifier's supply and the wire to the board (docs/wiring.md)";
        let bad = |found: String, remedy: &str| {
            Some(Finding::with(Verdict::Bad, "tension", found, remedy).of(index))
        };
        if mean >= f64::from(RAIL_HIGH) {
            return bad(format!("{read_v:.3} V is the upper rail: an open wire"), broken);
        }
        if mean <= f64::from(RAIL_LOW) {
            return bad(format!("{read_v:.3} V is the lower rail: a short"), broken);
        }
        // The converter's own noise changes its readings: 40 equal ones are a dead channel.
        if span(&watched.readings) == 0.0 {
            return bad(format!("{reads}, {LOOKS} times the very same: it does not measure"), broken);
        }
        if newtons > winch.tension_max_n {
            let found = format!("{reads}, over its {:.1} N", winch.tension_max_n);
            return bad(found, "relieve the cable before anything else");
        }
        if newtons < -BELOW_ZERO_N {
            let remedy = format!(
                "`tension_zero_v` is not this sensor's: `mcdpr commission {}` with no cable on it, or `mcdpr calibrate tension`",
                index + 1
            );
            return bad(format!("{reads}: cables do not push"), &remedy);
        }
        if noise_n > NOISE_N {
            let found = format!("{reads}, one reading varies by {noise_n:.2} N");
            let remedy = "shield the sensor's cable and keep it away from motor cables";
            return Some(Finding::with(Verdict::Note, "tension", found, remedy).of(index));
        }
        let found = format!("{reads}, one reading varies by {noise_n:.2} N");
        Some(Finding::good("tension", found).of(index))
    });
    each.collect()
}

/// Brakes must be closed and drives off while no program has armed the board.
pub(super) fn brakes(status: &Status) -> Finding {
    if status.brakes_open != 0 || status.torque_on != 0 {
        return Finding::with(
            Verdict::Bad,
            "brakes",
            format!(
                "open: {:04b}, torque: {:04b} (bit 0 is winch 1) while {:?}",
                status.brakes_open, status.torque_on, status.state
            ),
            "disarm: `mcdpr disarm --on PORT`; if that changes nothing, press the emergency stop",
        );
    }
    Finding::good(
        "brakes",
        "closed, no drive gives torque; that they hold and open shows when the robot arms",
    )
}
