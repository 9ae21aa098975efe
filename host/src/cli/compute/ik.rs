//! `mcdpr ik`: cable lengths at a pose.

use super::super::table::lay_out;
use super::super::{Common, Outcome, write_out};
use super::lists::List;
use super::{UNITS, batch, conclude, numbers_in_words, triple};
use crate::compute::{ComputeError, Subject};
use crate::units::Quantity;
use mcdpr_kinematics::{CableVec, Pose, rotation_from_rpy};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Cable lengths, wrap angles, directions and Jacobian at a pose
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
    /// Attitude, R = Rz Ry Rx: roll; level if all three are left out
    #[arg(allow_hyphen_values = true)]
    rx: Option<String>,
    /// Pitch
    #[arg(allow_hyphen_values = true)]
    ry: Option<String>,
    /// Yaw
    #[arg(allow_hyphen_values = true)]
    rz: Option<String>,
    /// The position is that of the tool (TCP)
    #[arg(long)]
    tool: bool,
    /// Columns 4 to 6 of the Jacobian: with respect to angular velocity, or to the rates of rx, ry,
    /// rz
    #[arg(long, value_enum, default_value_t = Turning::Twist, value_name = "KIND")]
    jacobian: Turning,
    /// Answer JSON lines {"position_m":[x,y,z],"attitude_rad":[rx,ry,rz]} from standard input
    #[arg(long, conflicts_with = "x")]
    batch: bool,
}

/// Variable of the last three columns of the Jacobian.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Turning {
    /// Angular velocity, world frame
    Twist,
    /// Rates of the angles rx, ry, rz
    Euler,
}

/// A batch line.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Question {
    position_m: [f64; 3],
    attitude_rad: Option<[f64; 3]>,
}

/// The result, SI.
#[derive(Debug, Serialize)]
struct Answer {
    lengths_m: List<f64>,
    wrap_rad: List<f64>,
    directions: List<[f64; 3]>,
    jacobian: List<[f64; 6]>,
}

impl Cmd {
    pub(in super::super) fn run(&self, common: &Common) -> Outcome {
        let subject = match super::find(common) {
            Ok(subject) => subject,
            Err(error) => return conclude::<Answer>(common, Err(error), |_| {}),
        };
        if self.batch {
            return batch::run(|question: Question| {
                let level = [0.0; 3];
                self.solve(
                    &subject,
                    question.position_m,
                    question.attitude_rad.unwrap_or(level),
                )
            });
        }
        let answer = self
            .pose()
            .and_then(|(position_m, attitude_rad)| self.solve(&subject, position_m, attitude_rad));
        conclude(common, answer.map_err(Into::into), show)
    }

    fn pose(&self) -> Result<([f64; 3], [f64; 3]), ComputeError> {
        let words =
            |all: [&Option<String>; 3]| all.into_iter().flatten().cloned().collect::<Vec<_>>();
        let position = triple(
            "position",
            Quantity::Length,
            &words([&self.x, &self.y, &self.z]),
        )?;
        let attitude = words([&self.rx, &self.ry, &self.rz]);
        if attitude.is_empty() {
            return Ok((position, [0.0; 3]));
        }
        let what = "attitude (RX RY RZ, or none)";
        if attitude.len() != 3 {
            return Err(ComputeError::Count {
                what,
                expected: "3 angles".to_owned(),
                got: attitude.len(),
            });
        }
        Ok((position, triple(what, Quantity::Angle, &attitude)?))
    }

    fn solve(
        &self,
        subject: &Subject,
        position_m: [f64; 3],
        attitude_rad: [f64; 3],
    ) -> Result<Answer, ComputeError> {
        let rotation = rotation_from_rpy(attitude_rad);
        let origin = Vector3::from(position_m) - rotation * subject.point(self.tool);
        let pose = Pose::new(origin, rotation);
        let paths = subject.geometry.paths(&pose)?;
        let jacobian = match self.jacobian {
            Turning::Twist => subject.geometry.twist_jacobian(&pose)?,
            Turning::Euler => subject.geometry.euler_jacobian(&pose)?,
        };
        let path = |i: usize| paths.get(i).copied().unwrap_or_default();
        let count = paths.len();
        Ok(Answer {
            lengths_m: List(CableVec::from_fn(count, |i| path(i).length_m)),
            wrap_rad: List(CableVec::from_fn(count, |i| path(i).wrap_rad)),
            directions: List(CableVec::from_fn(count, |i| path(i).direction.into())),
            jacobian: List(jacobian),
        })
    }
}

fn show(answer: &Answer) {
    let mut rows = vec![
        ["cable", "length, mm", "wrap, deg", "direction"]
            .map(str::to_owned)
            .to_vec(),
    ];
    let lists = answer
        .lengths_m
        .0
        .iter()
        .zip(&answer.wrap_rad.0)
        .zip(&answer.directions.0);
    for (index, ((length, wrap), direction)) in lists.enumerate() {
        rows.push(vec![
            (index + 1).to_string(),
            format!("{:.4}", length * 1e3),
            format!("{:.4}", wrap.to_degrees()),
            numbers_in_words(*direction, 1.0, 6),
        ]);
    }
    write_out(&lay_out(&rows));
}
