//! `mcdpr ik`, `fk`, `statics`, `workspace`: the robot's mathematics from the command line.
//!
//! One file per command; besides, [`batch`] reads JSON lines, [`lists`] are lists by cable without
//! allocation, [`slice`] draws. The mathematics is the kinematics crate's.

mod batch;
mod error;
pub(super) mod fk;
mod grid;
pub(super) mod ik;
mod lists;
mod slice;
pub(super) mod statics;
pub(super) mod workspace;

use super::{Common, Outcome, print_json};
use crate::machine;
use crate::robot::{Control, Robot};
use crate::units::Quantity;
use error::ComputeError;
use lists::{ByCable, List};
use mcdpr_kinematics::{AnyRobot, CableSet, CableVec, Error, Pose, Solver};
use nalgebra::Vector3;
use serde::Serialize;

/// A robot and its geometry.
struct Subject {
    robot: Robot,
    geometry: AnyRobot,
    /// Whether all anchors and attachments lie in one vertical plane.
    planar: bool,
}

impl Subject {
    fn find(common: &Common) -> miette::Result<Self> {
        let robot = crate::robot::find(&common.robot)?;
        let geometry = machine::geometry(&robot).map_err(ComputeError::from)?;
        let planar = is_planar(&geometry);
        Ok(Self {
            robot,
            geometry,
            planar,
        })
    }

    fn count(&self) -> usize {
        self.geometry.cable_count()
    }

    /// An error of the mathematics, with what a planar robot means for it.
    fn refused(&self, refusal: Error) -> ComputeError {
        match refusal {
            Error::Singular { .. }
            | Error::TooFewCables { .. }
            | Error::NotConverged { .. }
            | Error::WrenchNotBalanced { .. }
            | Error::Unbounded { .. }
                if self.planar =>
            {
                ComputeError::Planar { refusal }
            }
            _ => refusal.into(),
        }
    }

    /// The error for a number of length-held cables that the statics have no answer to.
    fn length_held(&self, held: usize) -> ComputeError {
        let count = self.count();
        if self.planar {
            return self.refused(Error::TooFewCables {
                solver: Solver::Equilibrium,
                needed: 3,
                got: held,
            });
        }
        ComputeError::LengthHeld {
            held,
            count,
            named: match count.checked_sub(3) {
                Some(1) => "1 tension-held cable".to_owned(),
                Some(more) => format!("{more} tension-held cables"),
                None => "none: this robot has too few cables".to_owned(),
            },
        }
    }

    /// The tool centre point, or the platform's origin.
    fn point(&self, tool: bool) -> Vector3<f64> {
        if tool {
            self.robot.tool.tcp_in_platform_m
        } else {
            Vector3::zeros()
        }
    }

    /// Tensions by cable from the command line; one entry per cable.
    fn tensions(&self, given: &[String]) -> Result<CableVec<Option<f64>>, ComputeError> {
        let mut out = CableVec::<Option<f64>>::filled(self.count());
        for text in given {
            let wrong = || ComputeError::Tension { text: text.clone() };
            let (cable, force) = text.split_once('=').ok_or_else(wrong)?;
            let number: usize = cable.trim().parse().map_err(|_| wrong())?;
            let entry = number.checked_sub(1).and_then(|index| out.get_mut(index));
            let entry = entry.ok_or_else(|| ComputeError::NoSuchCable {
                cable: number.to_string(),
                count: self.count(),
            })?;
            if entry.is_some() {
                return Err(ComputeError::Twice { cable: number });
            }
            *entry = Some(quantity("--tension", Quantity::Force, force)?);
        }
        Ok(out)
    }

    /// Tensions by cable from a batch line; one entry per cable.
    fn tensions_of_line(&self, given: &ByCable) -> Result<CableVec<Option<f64>>, ComputeError> {
        let beyond = given.tensions_n.iter().skip(self.count());
        if let Some(extra) = beyond.enumerate().find(|(_, t)| t.is_some()) {
            return Err(ComputeError::NoSuchCable {
                cable: (self.count() + extra.0 + 1).to_string(),
                count: self.count(),
            });
        }
        Ok(CableVec::from_fn(self.count(), |i| {
            given.tensions_n.get(i).copied().flatten()
        }))
    }

    /// The robot file's own tension-held cables at their set-point.
    fn own_tensions(&self) -> CableVec<Option<f64>> {
        CableVec::from_fn(self.count(), |i| {
            let cable = self.robot.cables.get(i)?;
            (cable.control == Control::Tension).then_some(self.robot.tension.setpoint_n)
        })
    }

    /// What the command line names, or else what the robot file does.
    fn tensions_or_own(&self, given: &[String]) -> Result<CableVec<Option<f64>>, ComputeError> {
        if given.is_empty() {
            Ok(self.own_tensions())
        } else {
            self.tensions(given)
        }
    }
}

/// Whether all anchors and attachments lie in one vertical plane through the platform's origin,
/// across which the cables then exert no force.
fn is_planar(geometry: &AnyRobot) -> bool {
    let cables = geometry.cables();
    let across = |v: &Vector3<f64>| Vector3::new(v.x, v.y, 0.0);
    let Some(first) = cables.first() else {
        return true;
    };
    let spread = cables
        .iter()
        .map(|cable| across(&(cable.anchor_m - first.anchor_m)));
    let widest = spread.fold(
        Vector3::zeros(),
        |a: Vector3<f64>, b| {
            if b.norm() > a.norm() { b } else { a }
        },
    );
    if widest.norm() == 0.0 {
        return true;
    }
    let normal = widest.cross(&Vector3::z()).normalize();
    let flat = 1e-6 * widest.norm();
    cables.iter().all(|cable| {
        let anchor = (cable.anchor_m - first.anchor_m).dot(&normal);
        anchor.abs() <= flat && cable.attachment_m.dot(&normal).abs() <= flat
    })
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

/// Prints one result: as JSON, or as `show` does it. With `--json`, a refusal is a document, too.
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

/// Numbers for people, separated by two spaces.
fn numbers_in_words(values: impl IntoIterator<Item = f64>, factor: f64, digits: usize) -> String {
    let words = values.into_iter().map(|value| {
        let value = value * factor;
        // A rounded -0 reads like a mistake.
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

/// Two lines that say where the platform is and how it is turned.
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
