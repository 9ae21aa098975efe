//! `mcdpr ik`, `fk`, `statics`, `workspace`: the robot's mathematics from the command line.
//!
//! One file per command; in addition [`batch`] reads JSON lines, [`lists`] are lists by cable
//! without allocation, [`slice`] draws. The mathematics is that of [`crate::compute`].

mod batch;
pub(super) mod fk;
mod grid;
pub(super) mod ik;
mod lists;
mod slice;
pub(super) mod statics;
pub(super) mod workspace;

use super::{Common, Outcome, print_json};
use crate::compute::{ComputeError, Subject};
use crate::units::Quantity;
use lists::{ByCable, List};
use mcdpr_kinematics::{CableSet, CableVec, Pose};
use nalgebra::Vector3;
use serde::Serialize;

/// The robot that the options name.
fn find(common: &Common) -> miette::Result<Subject> {
    let robot = crate::robot::find(&common.robot)?;
    Ok(Subject::new(robot)?)
}

/// Tensions by cable from the command line; one entry per cable.
fn tensions(subject: &Subject, given: &[String]) -> Result<CableVec<Option<f64>>, ComputeError> {
    let mut out = CableVec::<Option<f64>>::filled(subject.count());
    for text in given {
        let wrong = || ComputeError::Tension { text: text.clone() };
        let (cable, force) = text.split_once('=').ok_or_else(wrong)?;
        let number: usize = cable.trim().parse().map_err(|_| wrong())?;
        let entry = number.checked_sub(1).and_then(|index| out.get_mut(index));
        let entry = entry.ok_or_else(|| ComputeError::NoSuchCable {
            cable: number.to_string(),
            count: subject.count(),
        })?;
        if entry.is_some() {
            return Err(ComputeError::Twice { cable: number });
        }
        *entry = Some(quantity("--tension", Quantity::Force, force)?);
    }
    Ok(out)
}

/// Tensions by cable from a batch line; one entry per cable.
fn tensions_of_line(
    subject: &Subject,
    given: &ByCable,
) -> Result<CableVec<Option<f64>>, ComputeError> {
    let beyond = given.tensions_n.iter().skip(subject.count());
    if let Some(extra) = beyond.enumerate().find(|(_, t)| t.is_some()) {
        return Err(ComputeError::NoSuchCable {
            cable: (subject.count() + extra.0 + 1).to_string(),
            count: subject.count(),
        });
    }
    Ok(CableVec::from_fn(subject.count(), |i| {
        given.tensions_n.get(i).copied().flatten()
    }))
}

/// The tensions of the command line, or else those of the robot file.
fn tensions_or_own(
    subject: &Subject,
    given: &[String],
) -> Result<CableVec<Option<f64>>, ComputeError> {
    if given.is_empty() {
        Ok(subject.own_tensions())
    } else {
        tensions(subject, given)
    }
}

/// A number with a unit from the command line.
fn quantity(what: &'static str, kind: Quantity, text: &str) -> Result<f64, ComputeError> {
    kind.parse(text)
        .map_err(|wrong| ComputeError::Quantity { what, wrong })
}

/// Three numbers with units from the command line.
fn triple(what: &'static str, kind: Quantity, texts: &[String]) -> Result<[f64; 3], ComputeError> {
    let mut out = [0.0; 3];
    if texts.len() != out.len() {
        return Err(ComputeError::Count {
            what,
            expected: "3".to_owned(),
            got: texts.len(),
        });
    }
    for (value, text) in out.iter_mut().zip(texts) {
        *value = quantity(what, kind, text)?;
    }
    Ok(out)
}

/// Prints one result: as JSON, or by `show`. With `--json`, a refusal is printed as a document,
/// too.
fn conclude<A: Serialize>(
    common: &Common,
    answer: miette::Result<A>,
    show: impl FnOnce(&A),
) -> Outcome {
    match answer {
        Ok(answer) if common.json => print_json(&answer),
        Ok(answer) => {
            show(&answer);
            Ok(())
        }
        Err(error) => {
            if common.json {
                print_json(&serde_json::json!({ "error": error.to_string() }))?;
            }
            Err(error)
        }
    }
}

/// Numbers (1-based) of the cables in a set.
fn numbers(set: CableSet, count: usize) -> List<u8> {
    let mut out = CableVec::filled(set.len().min(count));
    for (slot, index) in out.iter_mut().zip(set.iter()) {
        *slot = u8::try_from(index + 1).unwrap_or(u8::MAX);
    }
    List(out)
}

/// Numbers for display, separated by two spaces.
fn numbers_in_words(values: impl IntoIterator<Item = f64>, factor: f64, digits: usize) -> String {
    let words = values.into_iter().map(|value| {
        let value = value * factor;
        // A rounded -0 looks like a mistake.
        let text = format!("{value:.digits$}");
        let zero = text
            .trim_start_matches('-')
            .chars()
            .all(|c| "0.".contains(c));
        if zero {
            text.trim_start_matches('-').to_owned()
        } else {
            text
        }
    });
    words.collect::<Vec<_>>().join("  ")
}

/// Two lines with position and attitude of the platform.
fn say_pose(subject: &Subject, pose: &Pose) {
    let mm = |v: Vector3<f64>| numbers_in_words(v.iter().copied(), 1e3, 4);
    say!("platform's origin, mm    {}", mm(pose.position_m));
    let tool = subject.robot.tool.tcp_in_platform_m;
    if tool != Vector3::zeros() {
        say!("tool (TCP), mm           {}", mm(pose.transform(&tool)));
    }
    let degrees = numbers_in_words(pose.rpy(), 180.0 / std::f64::consts::PI, 4);
    say!("attitude rx ry rz, deg   {degrees}");
}

/// Hint under every pose argument of `--help`.
const UNITS: &str = "Numbers are mm, degrees and N, or carry a unit: 0.255m, 12cm, 0.1rad, 5deg, \
                     0.01kN. What the results mean: docs/compute.md.";
