//! `mcdpr statics`: attitude, lengths and tensions of the platform at a position.

use super::super::table::lay_out;
use super::super::{Common, Outcome, write_out};
use super::fk::{held_in_words, say_rest};
use super::lists::{ByCable, List};
use super::{UNITS, batch, conclude, say_pose, triple};
use crate::compute::{ComputeError, Subject};
use crate::units::Quantity;
use mcdpr_kinematics::{
    CableMaterial, CableSet, CableVec, Correction, GRAVITY_MPS2, Pose, corrected_length,
};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Attitude, lengths and tensions at equilibrium, for a position and the tension-held cables'
/// tensions
#[derive(Debug, clap::Args)]
#[command(after_help = UNITS)]
pub(in super::super) struct Cmd {
    /// Position of the platform's origin (of the tool with --tool), world frame
    #[arg(allow_hyphen_values = true, required_unless_present = "batch")]
    x: Option<String>,
    /// Its y
    #[arg(allow_hyphen_values = true, required_unless_present = "batch")]
    y: Option<String>,
    /// Its z
    #[arg(allow_hyphen_values = true, required_unless_present = "batch")]
    z: Option<String>,
    /// This cable is held at this tension; without any: those of the robot file at the tension that a plan
    /// chooses there
    #[arg(long = "tension", value_name = "CABLE=FORCE")]
    tensions: Vec<String>,
    /// The robot file's tension-held cables are at its set-point
    #[arg(long, conflicts_with = "tensions")]
    setpoint: bool,
    /// The position is that of the tool (TCP)
    #[arg(long)]
    tool: bool,
    /// The attitude, if six or more length-held cables allow a choice; level if left out
    #[arg(long, num_args = 3, value_names = ["RX", "RY", "RZ"], allow_hyphen_values = true)]
    attitude: Option<Vec<String>>,
    /// Also compute the length to pay out: corrected for stretch (EA and routing of the robot
    /// file), or for stretch and sag, with the size of each correction
    #[arg(long, value_name = "CORRECTION")]
    correct: Option<Corrections>,
    /// Weight of the cable for the sag, in grams per metre
    #[arg(long, value_name = "G/M", default_value_t = 1.0)]
    cable_g_per_m: f64,
    /// Answer JSON lines {"position_m":[x,y,z],"tensions_n":{"4":10.0}} from standard input
    #[arg(long, conflicts_with = "x")]
    batch: bool,
}

/// Values of `--correct`.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Corrections {
    /// Stretch under tension, routing included
    Stretch,
    /// Stretch, and sag as a parabola
    Parabola,
    /// Stretch, and sag as a catenary
    Catenary,
}

impl From<Corrections> for Correction {
    fn from(corrections: Corrections) -> Self {
        match corrections {
            Corrections::Stretch => Self::Elastic,
            Corrections::Parabola => Self::Parabola,
            Corrections::Catenary => Self::Catenary,
        }
    }
}

/// Lengths to pay out, and the contributions of the corrections, cable by cable, m.
#[derive(Debug, Serialize)]
struct Corrected {
    unstretched_m: List<f64>,
    stretch_m: List<f64>,
    sag_m: List<f64>,
}

/// A batch line.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Question {
    position_m: [f64; 3],
    tensions_n: Option<ByCable>,
    attitude_rad: Option<[f64; 3]>,
}

/// The result, SI.
#[derive(Debug, Serialize)]
struct Answer {
    attitude_rad: [f64; 3],
    lengths_m: List<f64>,
    tensions_n: List<f64>,
    stable: bool,
    modes_hz: List<f64>,
    #[serde(flatten)]
    corrected: Option<Corrected>,
    #[serde(skip)]
    tension_held: CableSet,
    #[serde(skip)]
    pose: Pose,
}

impl Cmd {
    pub(in super::super) fn run(&self, common: &Common) -> Outcome {
        let prepared = super::find(common).and_then(|subject| {
            let attitude = self.attitude.as_deref();
            let attitude = attitude
                .map(|texts| triple("--attitude", Quantity::Angle, texts))
                .transpose()?;
            let tensions = super::tensions_or_own(&subject, &self.tensions)?;
            let planned = (self.tensions.is_empty() && !self.setpoint)
                .then(|| subject.planned(self.tool))
                .flatten();
            Ok((subject, attitude, tensions, planned))
        });
        let (subject, attitude, tensions, planned) = match prepared {
            Ok(prepared) => prepared,
            Err(error) => return conclude::<Answer>(common, Err(error), |_| {}),
        };
        let solve = |place: [f64; 3], tensions: &[Option<f64>], attitude| {
            let mut answer = solve(&subject, &place.into(), self.tool, tensions, attitude)?;
            answer.corrected = self.corrected(&subject, &answer)?;
            Ok::<_, ComputeError>(answer)
        };
        let at = |place: [f64; 3]| match &planned {
            Some(planned) => planned.tensions_n(&place.into(), &mut None),
            None => tensions,
        };
        if self.batch {
            return batch::run(|question: Question| {
                let tensions = match &question.tensions_n {
                    Some(by_cable) => super::tensions_of_line(&subject, by_cable)?,
                    None => at(question.position_m),
                };
                solve(
                    question.position_m,
                    &tensions,
                    question.attitude_rad.or(attitude),
                )
            });
        }
        let words: Vec<_> = [&self.x, &self.y, &self.z]
            .into_iter()
            .flatten()
            .cloned()
            .collect();
        let answer = triple("position", Quantity::Length, &words)
            .and_then(|place| solve(place, &at(place), attitude));
        conclude(common, answer.map_err(Into::into), |answer| {
            show(&subject, answer);
        })
    }
}

impl Cmd {
    /// The correction requested by `--correct`, at the pose and the tensions of the answer.
    fn corrected(
        &self,
        subject: &Subject,
        answer: &Answer,
    ) -> Result<Option<Corrected>, ComputeError> {
        let Some(correction) = self.correct else {
            return Ok(None);
        };
        let refused = |error| subject.refused(error);
        let paths = subject.geometry.paths(&answer.pose).map_err(refused)?;
        let count = paths.len();
        let mut all = [(); 3].map(|()| CableVec::filled(count));
        let cables = subject.robot.cables.iter().zip(&answer.tensions_n.0);
        for (index, (path, (cable, &tension_n))) in paths.iter().zip(cables).enumerate() {
            let material = CableMaterial {
                ea_n: Some(cable.ea_n),
                routing_length_m: cable.routing_length_m,
                weight_n_per_m: self.cable_g_per_m * 1e-3 * GRAVITY_MPS2,
            };
            let got = corrected_length(path, tension_n, &material, correction.into());
            let got = got.map_err(refused)?;
            let [unstretched, stretch, sag] = &mut all;
            unstretched[index] = got.unstretched_m;
            stretch[index] = got.stretch_m;
            sag[index] = got.sag_m;
        }
        let [unstretched_m, stretch_m, sag_m] = all.map(List);
        Ok(Some(Corrected {
            unstretched_m,
            stretch_m,
            sag_m,
        }))
    }
}

/// The answer for a position.
fn solve(
    subject: &Subject,
    place_m: &Vector3<f64>,
    tool: bool,
    tensions_n: &[Option<f64>],
    attitude_rad: Option<[f64; 3]>,
) -> Result<Answer, ComputeError> {
    let (found, stability) = subject.hang(place_m, tool, tensions_n, attitude_rad)?;
    Ok(Answer {
        attitude_rad: found.pose.rpy(),
        lengths_m: List(found.lengths_m),
        tensions_n: List(found.tensions_n),
        stable: stability.stable,
        modes_hz: List(stability.modes_hz),
        corrected: None,
        tension_held: found.tension_held,
        pose: found.pose,
    })
}

fn show(subject: &Subject, answer: &Answer) {
    say_pose(subject, &answer.pose);
    let limits = &subject.robot.limits;
    say_cables(
        &answer.lengths_m.0,
        &answer.tensions_n.0,
        |index| match answer.tensions_n.0.get(index) {
            Some(&t) if t < limits.tension_min_n => "below its limit",
            Some(&t) if t > limits.tension_max_n => "over its limit",
            _ => held_in_words(answer.tension_held, index),
        },
    );
    say_rest(answer.stable, &answer.modes_hz.0);
    if let Some(corrected) = &answer.corrected {
        say_corrected(corrected);
    }
}

/// The length to pay out, and why it differs from the geometric length.
fn say_corrected(corrected: &Corrected) {
    let head = ["cable", "to pay out, mm", "stretch, mm", "sag, mm"];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    let columns = [
        &corrected.unstretched_m,
        &corrected.stretch_m,
        &corrected.sag_m,
    ];
    for index in 0..corrected.unstretched_m.0.len() {
        let cells = columns.map(|column| format!("{:.5}", column.0[index] * 1e3));
        rows.push(
            std::iter::once((index + 1).to_string())
                .chain(cells)
                .collect(),
        );
    }
    write_out(&lay_out(&rows));
}

/// A table of the cables.
pub(super) fn say_cables(
    lengths_m: &[f64],
    tensions_n: &[f64],
    note: impl Fn(usize) -> &'static str,
) {
    let mut rows = vec![
        ["cable", "length, mm", "tension, N", ""]
            .map(str::to_owned)
            .to_vec(),
    ];
    for (index, (length, tension)) in lengths_m.iter().zip(tensions_n).enumerate() {
        rows.push(vec![
            (index + 1).to_string(),
            format!("{:.4}", length * 1e3),
            format!("{tension:.4}"),
            note(index).to_owned(),
        ]);
    }
    write_out(&lay_out(&rows));
}
