//! The self-test of a board without a robot: chip identity, clocks, supply, bus, inputs and
//! outputs, each with the result, the permitted range, and the remedy.
//!
//! No drive has torque: the board refuses every test while it has a configuration, so that no drive
//! has received a command, and sets an output for 0.3 s at most.

mod outputs;
mod report;
mod seal;

use outputs::outputs;
pub use report::{BenchError, Channel, Report};
pub(crate) use seal::{seal, sha256, verify};

use crate::doctor::{Finding, Verdict, hash_of};
use crate::link::{Client, Link};
use crate::run::{RunError, status};
use crate::service::volts;
use mcdpr_protocol::{Bench, BenchTest, BoardState, CanErrors, Winch};

/// The device of an STM32F103x8 or xB in its identity (RM0008, 31.6.1).
const DEVICE: u32 = 0x410;
/// Revisions that ST has sold (RM0008, 31.6.1).
const REVISIONS: [u32; 4] = [0x0000, 0x2000, 0x2001, 0x2003];
/// The core of an ST chip: Cortex-M3 r1p1. Clones have r2p0 and later.
const CORE: u32 = 0x411F_C231;
/// ST's code in JEP106.
const ST: u16 = 0x20;
/// KiB that the firmware needs.
const FLASH_KIB: u16 = 64;
/// 3.3 V, with 2 % of the regulator and 3.4 % of the chip's reference, mV.
const SUPPLY_MV: std::ops::RangeInclusive<u16> = 3120..=3480;
/// The slow oscillator (data sheet, 5.3.7), Hz.
const SLOW_HZ: std::ops::RangeInclusive<u32> = 30_000..=60_000;
/// A quarter of a millisecond at 72 MHz.
const TICK_CYCLES: u32 = 18_000;
/// Least unused stack: a fault's handler needs that much.
const STACK_FREE: u16 = 1024;
/// Number of readings of every winch's inputs.
const LOOKS: usize = 100;
// 100 looks, 8 ms apart, last 0.8 s: 40 periods of a mains hum of 50 Hz.
const BETWEEN_US: u64 = 8_000;
/// Counts by which a drum at rest may flicker.
const FLICKER: i32 = 1;
/// More noise than this on a channel indicates bad wiring, V.
const NOISE_V: f64 = 0.008;
/// Within this of a rail a channel counts as open or shorted, V: the board's own bounds (S7, S8).
const RAIL_V: (f64, f64) = (0.0403, 3.268);
/// A tension input with 10 kOhm to 3.3 V and 22 kOhm to an output that is low or high, V, and how far it may
/// be off: resistors of 5 %, and the output's own drop.
const JUMPER_LOW_V: f64 = 3.3 * 22.0 / 32.0;
const JUMPER_HIGH_V: f64 = 3.3;
const JUMPER_OFF_V: f64 = 0.15;
/// Until the board has counted its slow oscillator, us.
const COUNTED_US: u64 = 2_300_000;

fn bad(part: &'static str, found: impl Into<String>, remedy: &str) -> Finding {
    Finding::with(Verdict::Bad, part, found, remedy)
}

/// Tests the board behind this client. `expects` is the commit that it should run; `confirm` is
/// called before each output is set, with its name, and `false` skips it. With `jumpers`, wires
/// lead from outputs to inputs: brake n to A of encoder n and over 22 kOhm to tension input n,
/// drive enable to B of all encoders. Then each output must be visible at its inputs, and nowhere
/// else.
///
/// # Errors
/// [`BenchError`]: nothing was tried, or the board stopped answering.
pub fn examine<L: Link>(
    client: &mut Client<L>,
    expects: Option<&str>,
    jumpers: bool,
    confirm: &mut dyn FnMut(&str) -> bool,
) -> Result<Report, BenchError> {
    let state = status(client)?.state;
    if !matches!(
        state,
        BoardState::Disarmed | BoardState::Fault | BoardState::EStop
    ) {
        return Err(BenchError::Armed { state });
    }
    let hello = *client.hello();
    let firmware = hash_of(&hello.git_hash);
    if let (Some(file), Some(board)) = (expects, &firmware)
        && file != board
    {
        return Err(BenchError::OtherFirmware {
            board: board.clone(),
            file: file.to_owned(),
        });
    }
    let first = ask(client, BenchTest::Look)?;
    // All zero: a board in software, which has no identity and no clocks to test.
    if first == Bench::default() {
        return Err(BenchError::NoChip);
    }
    // DBGMCU_IDCODE: bits 0 to 11 are the device, bits 16 to 31 the revision.
    if first.id_code & 0xFFF != DEVICE {
        return Err(BenchError::UnknownChip {
            id_code: first.id_code,
        });
    }
    wait(client, COUNTED_US)?;
    let mut findings = vec![chip(&first), start(&first)];
    if let Some(record) = status(client)?.fault {
        findings.push(bad(
            "state",
            crate::link::describe_fault(&record),
            crate::link::advice(record.fault),
        ));
    }
    let channels = inputs(client, &mut findings)?;
    can(client, &mut findings)?;
    let seen = ask(client, BenchTest::Look)?;
    findings.extend(clocks(&seen));
    findings.extend(pins(&seen));
    outputs(client, jumpers, confirm, &mut findings)?;
    // Last, so that longest tick and deepest stack include the tests themselves.
    let last = ask(client, BenchTest::Look)?;
    findings.push(tick(&last));
    findings.push(stack(&last));
    Ok(Report {
        serial: hello.board_id.iter().map(|b| format!("{b:02x}")).collect(),
        firmware,
        findings,
        channels,
        tick_cycles: last.tick_cycles,
        stack_free_bytes: last.stack_free,
        supply_mv: last.supply_mv,
        slow_hz: last.slow_hz,
    })
}

fn ask<L: Link>(client: &mut Client<L>, test: BenchTest) -> Result<Bench, RunError> {
    Ok(client.bench(test)?)
}

fn wait<L: Link>(client: &mut Client<L>, us: u64) -> Result<(), RunError> {
    let until = client.now_us() + us;
    Ok(client.pump(until)?)
}

fn chip(report: &Bench) -> Finding {
    let revision = report.id_code >> 16;
    let found = format!(
        "device 0x{:03x}, revision 0x{revision:04x}, core 0x{:08x}, maker 0x{:02x}, {} KiB of flash",
        report.id_code & 0xFFF,
        report.core_id,
        report.maker,
        report.flash_kib
    );
    let genuine = REVISIONS.contains(&revision) && report.core_id == CORE && report.maker == ST;
    if !genuine {
        bad(
            "chip",
            format!("a clone: {found}"),
            "use a board with ST's own chip: of a clone neither the tolerance of its pins nor its converter is known",
        )
    } else if report.flash_kib < FLASH_KIB {
        bad("chip", found, "use a chip with 64 KiB of flash")
    } else {
        Finding::good("chip", found)
    }
}

fn start(report: &Bench) -> Finding {
    let names = [
        "pin",
        "power",
        "software",
        "watchdog",
        "window watchdog",
        "low power",
    ];
    let set = names
        .iter()
        .zip(2..)
        .filter(|(_, bit)| report.reset_flags & (1 << bit) != 0);
    let causes: Vec<_> = set.map(|(name, _)| *name).collect();
    let found = format!("started by: {}", causes.join(", "));
    // Bits 5 to 7, both watchdogs and low power: a healthy board starts by none of them.
    if report.reset_flags & 0b1110_0000 != 0 {
        return bad(
            "start",
            found,
            "switch the supply off and on, and run this again; if the watchdog fires again, flash the firmware anew",
        );
    }
    Finding::good("start", found)
}

fn clocks(report: &Bench) -> [Finding; 3] {
    let crystal = if report.crystal {
        Finding::good("crystal", "runs, and the core from it")
    } else {
        bad(
            "crystal",
            "does not start: the core runs from its own oscillator",
            "replace crystal or board",
        )
    };
    let found = format!("{} mV by the internal reference", report.supply_mv);
    let supply = if SUPPLY_MV.contains(&report.supply_mv) {
        Finding::good("supply", found)
    } else {
        bad(
            "supply",
            found,
            "measure 3.3 V at the chip; replace the regulator",
        )
    };
    let found = format!("{} Hz", report.slow_hz);
    let slow = if SLOW_HZ.contains(&report.slow_hz) {
        Finding::good("slow clock", found)
    } else {
        bad(
            "slow clock",
            found,
            "the watchdog's time follows this oscillator: 30 to 60 kHz; replace the chip",
        )
    };
    [crystal, supply, slow]
}

fn can<L: Link>(client: &mut Client<L>, findings: &mut Vec<Finding>) -> Result<(), BenchError> {
    if let Err(error) = ask(client, BenchTest::CanLoop) {
        findings.push(bad(
            "CAN",
            format!("was not tried: {error}"),
            "repair what is named above, press reset and run this again: only a board without a configuration tests its bus and its outputs",
        ));
        return Ok(());
    }
    // The loop's result is read afterwards: 50 ms are ample for its frames.
    wait(client, 50_000)?;
    let seen = ask(client, BenchTest::Look)?;
    let CanErrors {
        transmit: sent,
        receive: received,
    } = seen.can_errors;
    let found = format!(
        "loop through the controller {}, error counters {sent} and {received}, {} frames lost",
        if seen.can_loop == Some(true) {
            "good"
        } else {
            "failed"
        },
        seen.can_lost
    );
    findings.push(if seen.can_loop == Some(true) && seen.can_lost == 0 {
        Finding::good("CAN", found)
    } else {
        bad(
            "CAN",
            found,
            "replace the chip: its CAN controller does not give back what it sends",
        )
    });
    Ok(())
}

fn pins(report: &Bench) -> [Finding; 2] {
    let emergency = if report.inputs & 1 == 0 {
        Finding::good("emergency", "the emergency input is closed")
    } else {
        bad(
            "emergency",
            "the emergency input is open",
            "release the emergency stop, or bridge PB5 to ground on a bench",
        )
    };
    let outputs = if report.outputs == 0 {
        Finding::good("outputs", "all low")
    } else {
        bad(
            "outputs",
            format!("high at rest: {:06b}", report.outputs),
            "look for a short to 3.3 V, or a missing pull-down",
        )
    };
    [emergency, outputs]
}

fn tick(report: &Bench) -> Finding {
    let found = format!("{} of {TICK_CYCLES} cycles at most", report.tick_cycles);
    if report.tick_cycles > 0 && report.tick_cycles <= TICK_CYCLES {
        Finding::good("tick", found)
    } else {
        bad(
            "tick",
            found,
            "flash the firmware of this release; a probe that halts the core counts, too",
        )
    }
}

fn stack(report: &Bench) -> Finding {
    let found = format!("{} bytes were never used", report.stack_free);
    if report.stack_free >= STACK_FREE {
        Finding::good("stack", found)
    } else {
        bad("stack", found, "flash the firmware of this release")
    }
}

/// Encoders and tension channels, which must not move meanwhile.
fn inputs<L: Link>(
    client: &mut Client<L>,
    findings: &mut Vec<Finding>,
) -> Result<Vec<Channel>, BenchError> {
    let count = client.info().cables;
    let mut looks: Vec<Vec<Winch>> = vec![Vec::with_capacity(LOOKS); usize::from(count)];
    for _ in 0..LOOKS {
        wait(client, BETWEEN_US)?;
        for (cable, looks) in (1..=count).zip(&mut looks) {
            looks.push(client.winch(cable).map_err(RunError::from)?);
        }
    }
    let channels: Vec<_> = looks
        .iter()
        .enumerate()
        .map(|(index, looks)| channel(index + 1, looks))
        .collect();
    for channel in &channels {
        let found = format!(
            "at {} counts, flickers by {}",
            channel.drum_counts, channel.flicker
        );
        let encoder = if channel.flicker <= FLICKER {
            Finding::good("encoder", found)
        } else {
            bad(
                "encoder",
                found,
                "an input that counts at rest is open, or disturbed: check plug, buffer and pull-ups",
            )
        };
        let found = format!(
            "mean {:.4} V, sigma {:.2} mV",
            channel.mean_v,
            channel.sigma_v * 1e3
        );
        let tension = if channel.mean_v <= RAIL_V.0 || channel.mean_v >= RAIL_V.1 {
            bad(
                "tension",
                found,
                "at a rail: an open wire reads 3.3 V, a short or an amplifier without supply 0 V",
            )
        } else if channel.sigma_v > NOISE_V {
            bad(
                "tension",
                found,
                "noise: check shield, ground and the 10 nF at the pin",
            )
        } else {
            Finding::good("tension", found)
        };
        for finding in [encoder, tension] {
            findings.push(Finding {
                cable: Some(channel.winch),
                ..finding
            });
        }
    }
    Ok(channels)
}

fn channel(winch: usize, looks: &[Winch]) -> Channel {
    let count = looks.len().max(1) as f64;
    let read: Vec<_> = looks
        .iter()
        .map(|look| volts(f64::from(look.tension_adc)))
        .collect();
    let mean_v = read.iter().sum::<f64>() / count;
    let squares = read.iter().map(|volts| (volts - mean_v).powi(2));
    let sigma_v = (squares.sum::<f64>() / count).sqrt();
    let mut histogram = [0; 8];
    for volts in &read {
        // Eight bins of a standard deviation each about the mean.
        let bin = ((volts - mean_v) / sigma_v.max(1e-9))
            .floor()
            .clamp(-4.0, 3.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "0 to 7"
        )]
        let bin = (bin + 4.0) as usize;
        histogram[bin] += 1;
    }
    let drum_counts = looks.first().map_or(0, |look| look.drum_counts);
    let ways = looks
        .iter()
        .map(|look| (look.drum_counts - drum_counts).abs());
    Channel {
        winch,
        mean_v,
        sigma_v,
        histogram,
        drum_counts,
        flicker: ways.max().unwrap_or(0),
    }
}
