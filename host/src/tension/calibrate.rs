//! Calibration of a tension sensor by known weights: `y = k (u - u0)` (Eqs. 51, 52).

use crate::link::{Client, Link};
use crate::robot::Winch;
use crate::run::{self, RunError};
use miette::Diagnostic;
use thiserror::Error;

/// One load with the reading of the sensor's channel.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Reading {
    /// Mass that hung on the cable, kg, pan included.
    pub mass_kg: f64,
    /// Voltage of the channel, V.
    pub voltage_v: f64,
}

/// A sensor's law, fitted.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Fit {
    /// Gain k, N/V.
    pub gain_n_per_v: f64,
    /// Its standard error, N/V.
    pub gain_error_n_per_v: f64,
    /// Zero u0, V.
    pub zero_v: f64,
    /// Its standard error, V.
    pub zero_error_v: f64,
    /// Tension at 3.3 V, N.
    pub full_scale_n: f64,
    /// Error of each reading, N: what the fitted law says minus the weight.
    pub residuals_n: Vec<f64>,
    /// Greatest residual over the full scale.
    pub nonlinearity: f64,
    /// Greatest difference between two readings of one load, N, where a load was read twice.
    pub hysteresis_n: Option<f64>,
    /// The readings.
    pub readings: Vec<Reading>,
}

/// Why a calibration failed.
#[derive(Debug, Error, Diagnostic)]
pub enum CalibrationError {
    /// Too few loads.
    #[error("{found} different loads are too few: nothing was changed")]
    #[diagnostic(
        code(mcdpr::tension::loads),
        help("hang at least three different weights, spread over the range of use")
    )]
    Loads {
        /// Different loads found.
        found: usize,
    },
    /// A channel at its rail.
    #[error(
        "the channel reads {voltage_v:.3} V with {mass_kg} kg: it is at its rail, nothing was changed"
    )]
    #[diagnostic(
        code(mcdpr::tension::saturated),
        help(
            "near 3.3 V the amplifier is saturated or the sensor open: hang less, check the wiring; near 0 V it is shorted or without supply"
        )
    )]
    Saturated {
        /// Voltage, V.
        voltage_v: f64,
        /// With this load, kg.
        mass_kg: f64,
    },
    /// A channel that does not follow.
    #[error("the channel does not follow the weights ({what}): nothing was changed")]
    #[diagnostic(
        code(mcdpr::tension::dead),
        help(
            "check that the weights hang on this cable, that the sensor's bridge is wired with the right sign, and that the cable runs free"
        )
    )]
    Dead {
        /// The symptom.
        what: String,
    },
    /// An invalid reading.
    #[error("reading {number}: {what}")]
    #[diagnostic(
        code(mcdpr::tension::reading),
        help(
            "a data file has one reading a line, mass_kg,voltage_v, in the order in which the weights were hung"
        )
    )]
    Reading {
        /// Its line, from 1.
        number: usize,
        /// What is wrong.
        what: String,
    },
}

/// Reference of the converter, V.
const REFERENCE_V: f64 = 3.3;
/// Under this a channel is shorted (S8), V.
const RAIL_LOW_V: f64 = 0.04;
/// Over this a channel is open or saturated (S7), V.
const RAIL_HIGH_V: f64 = 3.267;
/// Loads closer than this count as the same, kg.
const SAME_LOAD_KG: f64 = 0.002;
/// A channel that follows spans at least this, V.
const LEAST_SPAN_V: f64 = 0.02;
/// A line explains at least this share of a channel that follows.
const LEAST_R2: f64 = 0.98;

/// Fits the law. The weights are taken as exact and the voltages as noisy, so the voltage is
/// regressed on the weight: `u = y / k + u0`.
///
/// # Errors
/// [`CalibrationError`] with the reason.
pub fn fit(readings: &[Reading]) -> Result<Fit, CalibrationError> {
    for (number, reading) in (1..).zip(readings) {
        let what = match *reading {
            Reading { mass_kg, .. } if !(0.0..=100.0).contains(&mass_kg) => {
                format!("mass_kg is {mass_kg}, it must be 0 to 100")
            }
            Reading { voltage_v, .. } if !voltage_v.is_finite() => {
                format!("voltage_v is {voltage_v}")
            }
            _ => continue,
        };
        return Err(CalibrationError::Reading { number, what });
    }
    let mut loads: Vec<f64> = readings.iter().map(|reading| reading.mass_kg).collect();
    loads.sort_by(f64::total_cmp);
    loads.dedup_by(|a, b| (*a - *b).abs() < SAME_LOAD_KG);
    // Through two points there is always a line: the third shows whether it is one.
    if loads.len() < 3 {
        return Err(CalibrationError::Loads { found: loads.len() });
    }
    for reading in readings {
        let (voltage_v, mass_kg) = (reading.voltage_v, reading.mass_kg);
        if !(RAIL_LOW_V..=RAIL_HIGH_V).contains(&voltage_v) {
            return Err(CalibrationError::Saturated { voltage_v, mass_kg });
        }
    }
    let weight = |reading: &Reading| reading.mass_kg * mcdpr_kinematics::GRAVITY_MPS2;
    #[expect(clippy::cast_precision_loss, reason = "some readings")]
    let count = readings.len() as f64;
    let mean_n = readings.iter().map(weight).sum::<f64>() / count;
    let mean_v = readings.iter().map(|r| r.voltage_v).sum::<f64>() / count;
    let mut spread_n2 = 0.0;
    let mut spread_v2 = 0.0;
    let mut together = 0.0;
    for reading in readings {
        let (n, v) = (weight(reading) - mean_n, reading.voltage_v - mean_v);
        spread_n2 += n * n;
        spread_v2 += v * v;
        together += n * v;
    }
    let slope = together / spread_n2;
    let dead = |what: String| Err(CalibrationError::Dead { what });
    let highest = readings
        .iter()
        .map(|r| r.voltage_v)
        .fold(f64::MIN, f64::max);
    let lowest = readings
        .iter()
        .map(|r| r.voltage_v)
        .fold(f64::MAX, f64::min);
    if highest - lowest < LEAST_SPAN_V {
        return dead(format!(
            "its voltage moved by {:.1} mV",
            (highest - lowest) * 1e3
        ));
    }
    if slope <= 0.0 {
        return dead("its voltage falls as the weight rises".to_owned());
    }
    let explained = together * together / (spread_n2 * spread_v2);
    if explained < LEAST_R2 {
        return dead(format!("a line explains only {:.1} %", explained * 100.0));
    }
    let zero_v = mean_v - slope * mean_n;
    let gain = 1.0 / slope;
    let squares: f64 = readings
        .iter()
        .map(|r| (r.voltage_v - zero_v - slope * weight(r)).powi(2))
        .sum();
    // Two values were fitted: two readings fewer count.
    let variance_v2 = squares / (count - 2.0).max(1.0);
    let residuals_n: Vec<f64> = readings
        .iter()
        .map(|r| gain * (r.voltage_v - zero_v) - weight(r))
        .collect();
    let full_scale_n = gain * (REFERENCE_V - zero_v);
    let worst = residuals_n.iter().map(|r| r.abs()).fold(0.0, f64::max);
    Ok(Fit {
        gain_n_per_v: gain,
        // dk = k^2 d(1/k): the fit is for the slope, 1/k.
        gain_error_n_per_v: (variance_v2 / spread_n2).sqrt() * gain * gain,
        zero_v,
        zero_error_v: (variance_v2 * (1.0 / count + mean_n * mean_n / spread_n2)).sqrt(),
        full_scale_n,
        nonlinearity: worst / full_scale_n,
        hysteresis_n: hysteresis(readings, gain),
        residuals_n,
        readings: readings.to_vec(),
    })
}

fn hysteresis(readings: &[Reading], gain: f64) -> Option<f64> {
    let mut worst: Option<f64> = None;
    for (index, a) in readings.iter().enumerate() {
        for b in readings.iter().skip(index + 1) {
            if (a.mass_kg - b.mass_kg).abs() < SAME_LOAD_KG {
                let gap_n = gain * (a.voltage_v - b.voltage_v).abs();
                worst = Some(worst.map_or(gap_n, |w: f64| w.max(gap_n)));
            }
        }
    }
    worst
}

/// Reads a data file: `mass_kg,voltage_v` per line; empty lines, a heading and lines that start
/// with # are skipped.
///
/// # Errors
/// [`CalibrationError::Reading`] names the first invalid line.
pub fn parse(text: &str) -> Result<Vec<Reading>, CalibrationError> {
    let mut readings = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') || line.starts_with("mass_kg") {
            continue;
        }
        let numbers: Vec<Result<f64, _>> = line.split(',').map(|w| w.trim().parse()).collect();
        match numbers.as_slice() {
            [Ok(mass_kg), Ok(voltage_v)] => readings.push(Reading {
                mass_kg: *mass_kg,
                voltage_v: *voltage_v,
            }),
            _ => {
                return Err(CalibrationError::Reading {
                    number,
                    what: format!("line {number} is \"{line}\", not mass_kg,voltage_v"),
                });
            }
        }
    }
    Ok(readings)
}

/// Readings of the channel that are averaged.
const AVERAGED: u32 = 100;
/// Time between them, µs.
const PAUSE_US: u64 = 10_000;

/// Reads a channel's voltage while the robot is disarmed, V: the mean over a second.
///
/// The board sends tensions by its configured law; that law is inverted.
///
/// # Errors
/// The client's.
pub(crate) fn read_voltage<L: Link>(
    client: &mut Client<L>,
    winch: &Winch,
    cable: usize,
) -> Result<f64, RunError> {
    // 100 readings in a second: noise of 0.05 N falls to 5 mN.
    let mut sum_n = 0.0;
    for _ in 0..AVERAGED {
        let status = run::status(client)?;
        let tension = status.tensions.get(cable).map_or(0, |t| t.0);
        sum_n += f64::from(tension) * 1e-3;
        let until = client.now_us() + PAUSE_US;
        client.pump(until)?;
    }
    let mean_n = sum_n / f64::from(AVERAGED);
    Ok(mean_n / winch.tension_gain_n_per_v + winch.tension_zero_v)
}

/// A winch file's text with this calibration in place of its old values, every other line
/// unchanged.
#[must_use]
pub(crate) fn written_into(text: &str, fit: &Fit, note: &str) -> String {
    let values = [
        ("tension_gain_n_per_v", format!("{:.5}", fit.gain_n_per_v)),
        ("tension_zero_v", format!("{:.6}", fit.zero_v)),
        ("tension_max_n", format!("{:.3}", fit.full_scale_n)),
    ];
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    for (key, value) in values {
        let new = format!("{key} = {value}   # {note}");
        let is_key = |line: &String| {
            line.trim_start()
                .strip_prefix(key)
                .is_some_and(|rest| rest.trim_start().starts_with('='))
        };
        match lines.iter_mut().find(|line| is_key(line)) {
            Some(line) => *line = new,
            None => lines.push(new),
        }
    }
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paper(masses: &[f64]) -> Vec<Reading> {
        let volts = |kg: f64| kg * mcdpr_kinematics::GRAVITY_MPS2 / 12.77 + 0.2355;
        masses
            .iter()
            .map(|&mass_kg| Reading {
                mass_kg,
                voltage_v: volts(mass_kg),
            })
            .collect()
    }

    #[test]
    fn the_papers_constants_come_back() {
        let fit = fit(&paper(&[0.0, 0.5, 1.0, 2.0, 3.0, 2.0, 0.5])).unwrap();
        assert!((fit.gain_n_per_v - 12.77).abs() < 1e-9);
        assert!((fit.zero_v - 0.2355).abs() < 1e-9);
        // 12.77 (3.3 - 0.2355) = 39.13 N.
        assert!((fit.full_scale_n - 39.134).abs() < 1e-3);
        assert!(fit.hysteresis_n.unwrap() < 1e-9 && fit.nonlinearity < 1e-9);
    }

    #[test]
    fn standard_errors_are_those_of_many_repetitions() {
        // Deterministic "noise" of 1 mV: the scatter of k and u0 over many draws is what one fit
        // claims, to a fifth.
        let masses = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5];
        let mut state = 1_u64;
        let mut unit = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            f64::from(u32::try_from(state >> 33).unwrap()) / f64::from(1_u32 << 31) - 0.5
        };
        let (mut gains, mut zeros) = (Vec::new(), Vec::new());
        let (mut claimed_k, mut claimed_u) = (0.0, 0.0);
        for _ in 0..400 {
            let mut readings = paper(&masses);
            for reading in &mut readings {
                reading.voltage_v += 2e-3 * 3_f64.sqrt() * unit();
            }
            let fit = fit(&readings).unwrap();
            gains.push(fit.gain_n_per_v);
            zeros.push(fit.zero_v);
            claimed_k += fit.gain_error_n_per_v / 400.0;
            claimed_u += fit.zero_error_v / 400.0;
        }
        let sd = |values: &[f64], about: f64| {
            (values.iter().map(|v| (v - about).powi(2)).sum::<f64>() / 400.0).sqrt()
        };
        let (k, u) = (sd(&gains, 12.77), sd(&zeros, 0.2355));
        assert!((claimed_k / k - 1.0).abs() < 0.2, "{claimed_k} {k}");
        assert!((claimed_u / u - 1.0).abs() < 0.2, "{claimed_u} {u}");
    }

    #[test]
    fn bad_channels_and_too_few_loads_are_refused() {
        assert!(matches!(
            fit(&paper(&[0.5, 1.0, 0.5])),
            Err(CalibrationError::Loads { found: 2 })
        ));
        assert!(matches!(
            fit(&paper(&[0.0, 1.0, 4.2])),
            Err(CalibrationError::Saturated { .. })
        ));
        let mut shorted = paper(&[0.0, 1.0, 2.0]);
        shorted[0].voltage_v = 0.0;
        assert!(matches!(
            fit(&shorted),
            Err(CalibrationError::Saturated { .. })
        ));
        let mut dead = paper(&[0.0, 1.0, 2.0]);
        dead.iter_mut().for_each(|r| r.voltage_v = 0.2355);
        assert!(matches!(fit(&dead), Err(CalibrationError::Dead { .. })));
        let mut reversed = paper(&[0.0, 1.0, 2.0]);
        reversed
            .iter_mut()
            .for_each(|r| r.voltage_v = 1.0 - r.voltage_v * 0.5);
        assert!(matches!(fit(&reversed), Err(CalibrationError::Dead { .. })));
        let mut wild = paper(&[0.0, 1.0, 2.0, 3.0]);
        wild[1].voltage_v = f64::NAN;
        assert!(matches!(
            fit(&wild),
            Err(CalibrationError::Reading { number: 2, .. })
        ));
        assert!(parse("mass_kg,voltage_v\n0.5,0.6\nx,1").is_err());
        assert_eq!(
            parse("# h\nmass_kg,voltage_v\n\n0.5, 0.6\n").unwrap().len(),
            1
        );
    }

    #[test]
    fn only_the_calibrated_keys_change_in_a_winch_file() {
        let fit = fit(&paper(&[0.0, 1.0, 2.0])).unwrap();
        let text = "# a comment\ndrum_radius_mm = 20\ntension_gain_n_per_v = 13 # old\n";
        let new = written_into(text, &fit, "calibrated");
        assert!(new.starts_with("# a comment\ndrum_radius_mm = 20\n"));
        assert!(new.contains("tension_gain_n_per_v = 12.77000   # calibrated"));
        assert!(new.contains("tension_zero_v = 0.235500") && !new.contains("old"));
        assert!(new.parse::<toml::Table>().is_ok());
    }
}
