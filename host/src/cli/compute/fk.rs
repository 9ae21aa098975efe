//! `mcdpr fk`: the platform's pose from cable lengths.

use super::super::{Common, Outcome};
use super::lists::{ByCable, List};
use super::statics::say_cables;
use super::{UNITS, batch, conclude, numbers, numbers_in_words, quantity, say_pose, triple};
use crate::compute::{ComputeError, Free, Subject};
use crate::units::Quantity;
use mcdpr_kinematics::{CableSet, ForwardOptions, Pose};
use serde::{Deserialize, Serialize};

/// Pose from cable lengths: for a given attitude, with free yaw, or hanging at rest
#[derive(Debug, clap::Args)]
#[command(after_help = UNITS)]
pub(in super::super) struct Cmd {
    /// Length of each cable, cable 1 first; `_` for a tension-held one with --static, or none
    #[arg(
        value_name = "LENGTH",
        required_unless_present = "batch",
        allow_negative_numbers = true
    )]
    lengths: Vec<String>,
    /// The attitude; with --free yaw its roll and pitch, with --free all the start
    #[arg(long, num_args = 3, value_names = ["RX", "RY", "RZ"], allow_hyphen_values = true)]
    attitude: Option<Vec<String>>,
    /// Unknowns that the lengths determine besides the position
    #[arg(long, value_enum, value_name = "WHAT")]
    free: Option<Free>,
    /// The pose at rest under gravity; cables may go slack
    #[arg(long = "static", conflicts_with_all = ["free", "attitude"])]
    at_rest: bool,
    /// With --static: this cable is held at this tension, not at a length
    #[arg(long = "tension", value_name = "CABLE=FORCE", requires = "at_rest")]
    tensions: Vec<String>,
    /// Refuse a pose that misses the lengths by more than this, root mean square
    #[arg(
        long,
        value_name = "LENGTH",
        default_value = "1mm",
        conflicts_with = "at_rest"
    )]
    max_residual: String,
    /// Answer JSON lines {"lengths_m":[...],"attitude_rad":[rx,ry,rz]} from standard input; with
    /// --static {"lengths_m":[...],"tensions_n":{"4":10.0}}
    #[arg(long, conflicts_with = "lengths")]
    batch: bool,
}

/// A batch line without `--static`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Question {
    lengths_m: List<f64>,
    attitude_rad: Option<[f64; 3]>,
}

/// A batch line with `--static`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct StaticQuestion {
    lengths_m: List<Option<f64>>,
    tensions_n: Option<ByCable>,
}

/// The result of a geometric solver, SI.
#[derive(Debug, Serialize)]
struct Answer {
    position_m: [f64; 3],
    residual_m: f64,
    iterations: usize,
    /// Attitude, if it was an unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    attitude_rad: Option<[f64; 3]>,
    #[serde(skip)]
    pose: Pose,
    /// Whether no attitude was given, and level was assumed.
    #[serde(skip)]
    taken_level: bool,
}

/// The result of the static solver, SI.
#[derive(Debug, Serialize)]
struct StaticAnswer {
    position_m: [f64; 3],
    attitude_rad: [f64; 3],
    tensions_n: List<f64>,
    lengths_m: List<f64>,
    slack: List<u8>,
    stable: bool,
    modes_hz: List<f64>,
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
            let tensions = super::tensions(&subject, &self.tensions)?;
            let options = ForwardOptions {
                max_residual_m: quantity("--max-residual", Quantity::Length, &self.max_residual)?,
                ..ForwardOptions::default()
            };
            Ok((subject, attitude, tensions, options))
        });
        let (subject, attitude, tensions, options) = match prepared {
            Ok(prepared) => prepared,
            Err(error) => return conclude::<Answer>(common, Err(error), |_| {}),
        };
        match (self.batch, self.at_rest) {
            (true, false) => batch::run(|question: Question| {
                let attitude = question.attitude_rad.or(attitude);
                self.solve(&subject, &question.lengths_m.0, attitude, &options)
            }),
            (true, true) => batch::run(|question: StaticQuestion| {
                let tensions = match &question.tensions_n {
                    Some(by_cable) => super::tensions_of_line(&subject, by_cable)?,
                    None => tensions,
                };
                rest(&subject, &question.lengths_m.0, &tensions)
            }),
            (false, false) => {
                let answer = self
                    .lengths()
                    .and_then(|lengths| self.solve(&subject, &lengths, attitude, &options));
                conclude(common, answer.map_err(Into::into), |answer| {
                    show(&subject, answer);
                })
            }
            (false, true) => {
                let answer = self
                    .lengths_or_gaps()
                    .and_then(|lengths| rest(&subject, &lengths, &tensions));
                conclude(common, answer.map_err(Into::into), |answer| {
                    show_rest(&subject, answer);
                })
            }
        }
    }

    fn lengths(&self) -> Result<Vec<f64>, ComputeError> {
        let each = |text: &String| quantity("length", Quantity::Length, text);
        self.lengths.iter().map(each).collect()
    }

    fn lengths_or_gaps(&self) -> Result<Vec<Option<f64>>, ComputeError> {
        let each = |text: &String| match text.as_str() {
            "_" => Ok(None),
            text => quantity("length", Quantity::Length, text).map(Some),
        };
        self.lengths.iter().map(each).collect()
    }

    fn solve(
        &self,
        subject: &Subject,
        lengths_m: &[f64],
        attitude_rad: Option<[f64; 3]>,
        options: &ForwardOptions,
    ) -> Result<Answer, ComputeError> {
        let (found, free) = subject.forward(lengths_m, attitude_rad, self.free, options)?;
        Ok(Answer {
            position_m: found.pose.position_m.into(),
            residual_m: found.residual_m,
            iterations: found.iterations,
            attitude_rad: free.map(|_| found.pose.rpy()),
            pose: found.pose,
            taken_level: attitude_rad.is_none() && free != Some(Free::All),
        })
    }
}

/// The answer for a pose at rest.
fn rest(
    subject: &Subject,
    lengths_m: &[Option<f64>],
    tensions_n: &[Option<f64>],
) -> Result<StaticAnswer, ComputeError> {
    let (found, stability) = subject.rest(lengths_m, tensions_n)?;
    let count = subject.count();
    Ok(StaticAnswer {
        position_m: found.pose.position_m.into(),
        attitude_rad: found.pose.rpy(),
        tensions_n: List(found.tensions_n),
        lengths_m: List(found.lengths_m),
        slack: numbers(found.slack, count),
        stable: stability.stable,
        modes_hz: List(stability.modes_hz),
        tension_held: found.tension_held,
        pose: found.pose,
    })
}

fn show(subject: &Subject, answer: &Answer) {
    say_pose(subject, &answer.pose);
    say!("residual, rms, mm        {:.3e}", answer.residual_m * 1e3);
    say!("iterations               {}", answer.iterations);
    if answer.taken_level {
        eprintln!(
            "no attitude was given: level was taken; --static gives the attitude in which the \
             platform hangs"
        );
    }
}

fn show_rest(subject: &Subject, answer: &StaticAnswer) {
    say_pose(subject, &answer.pose);
    let notes = |index: usize| {
        let slack = answer.slack.0.iter().any(|&n| usize::from(n) == index + 1);
        if slack {
            "slack"
        } else {
            held_in_words(answer.tension_held, index)
        }
    };
    say_cables(&answer.lengths_m.0, &answer.tensions_n.0, notes);
    say_rest(answer.stable, &answer.modes_hz.0);
}

/// The quantity that a cable's winch holds.
pub(super) fn held_in_words(tension_held: CableSet, index: usize) -> &'static str {
    if tension_held.contains(index) {
        "tension held"
    } else {
        "length held"
    }
}

/// Two lines on stability and modes.
pub(super) fn say_rest(stable: bool, modes_hz: &[f64]) {
    say!(
        "stable                   {}",
        if stable { "yes" } else { "no" }
    );
    let modes = match modes_hz {
        [] => "none: the cables leave no freedom".to_owned(),
        modes => numbers_in_words(modes.iter().copied(), 1.0, 3),
    };
    say!("natural modes, Hz        {modes}");
}
