//! `mcdpr calibrate all`: solves recorded data.

use super::Method;
use crate::calibration::paper::{AnchorTerm, Weights, paper};
use crate::calibration::{Answer, Data, Options, Refusal, joint};
use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use std::path::PathBuf;

/// Find anchors, initial lengths, camera and tags from recorded data
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Calibration data (format mcdpr-calibration-data-1)
    #[arg(long, value_name = "FILE")]
    data: PathBuf,
    /// Estimator
    #[arg(long, value_enum, default_value_t = Method::Joint)]
    method: Method,
    /// joint: leave tensions and the equations of equilibrium out
    #[arg(long)]
    no_statics: bool,
    /// paper: the anchors' distance squared, in m^2 beside lengths in m, as Eq. 41 is printed
    #[arg(long)]
    literal: bool,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let what = format!("calibration data {}", self.data.display());
        let text = std::fs::read_to_string(&self.data).map_err(Failed::from_error(&what))?;
        let answer = self.solve(&text);
        match answer {
            Ok((data, answer)) => {
                if common.json {
                    print_json(&answer.to_json())
                } else {
                    show(&data, &answer);
                    Ok(())
                }
            }
            Err(refusal) => {
                if common.json {
                    print_json(&serde_json::json!({ "refused": refusal.to_string() }))?;
                }
                Err(refusal.into())
            }
        }
    }

    fn solve(&self, text: &str) -> Result<(Data, Answer), Refusal> {
        let data = Data::from_json(text)?;
        let answer = match self.method {
            Method::Joint => joint(
                &data,
                &Options {
                    without_statics: self.no_statics,
                    ..Options::default()
                },
            ),
            Method::Paper => paper(
                &data,
                &Weights {
                    term: if self.literal {
                        AnchorTerm::SquaredMetres
                    } else {
                        AnchorTerm::Millimetres
                    },
                    ..Weights::default()
                },
            ),
        }?;
        Ok((data, answer))
    }
}

fn show(data: &Data, answer: &Answer) {
    let mut rows = vec![
        [
            "cable",
            "anchor x",
            "y",
            "z",
            "from nominal",
            "initial length",
        ]
        .map(str::to_owned)
        .to_vec(),
    ];
    for (i, (cable, nominal)) in answer.cables.iter().zip(&data.robot.cables).enumerate() {
        let off = (cable.anchor_m - nominal.anchor_m) * 1e3;
        rows.push(vec![
            (i + 1).to_string(),
            format!("{:.3}", cable.anchor_m.x * 1e3),
            format!("{:.3}", cable.anchor_m.y * 1e3),
            format!("{:.3}", cable.anchor_m.z * 1e3),
            format!("{:+.2} {:+.2} {:+.2}", off.x, off.y, off.z),
            format!("{:.3}", answer.initial_length_m[i] * 1e3),
        ]);
    }
    say!("method {}, lengths in mm\n", answer.method);
    write_out(&lay_out(&rows));
    let place = |what: &str, pose: &mcdpr_kinematics::Pose| {
        let (p, a) = (pose.position_m * 1e3, pose.rpy().map(f64::to_degrees));
        say!(
            "{what:<24} {:9.3} {:9.3} {:9.3} mm  {:8.3} {:8.3} {:8.3} deg",
            p.x,
            p.y,
            p.z,
            a[0],
            a[1],
            a[2]
        );
    };
    say!("");
    for (i, body) in answer.world_from_body.iter().enumerate() {
        place(&format!("tags of body {i} in world"), body);
    }
    place("platform in camera", &answer.camera_from_platform);
    if let Some(further) = &answer.further {
        say!(
            "drums {:+.3} %, tags {:+.3} %, f {:.2} px, centre {:.2} {:.2} px, k1 {:+.5}",
            (further.drum_scale - 1.0) * 100.0,
            (further.tag_scale - 1.0) * 100.0,
            further.camera.focal_px[0],
            further.camera.center_px[0],
            further.camera.center_px[1],
            further.camera.distortion[0]
        );
        if let Some((mass, center, compliance, _)) = &further.statics {
            say!(
                "mass {mass:.4} kg, centre of mass {:.2} {:.2} {:.2} mm, 1/EA {:.2} per MN",
                center.x * 1e3,
                center.y * 1e3,
                center.z * 1e3,
                compliance * 1e6
            );
        }
    }
    if let (Some(chi), Some(freedom)) = (answer.chi_square, answer.degrees_of_freedom) {
        say!(
            "\nchi-square {chi:.1} for {freedom:.0} degrees of freedom; rank {} of {} core unknowns",
            answer.rank,
            answer.core_unknowns
        );
    }
    if answer.predicted_error_m.is_finite() {
        say!(
            "predicted position error {:.2} mm, at the worst pose {:.2} mm",
            answer.predicted_error_m * 1e3,
            answer.worst_predicted_error_m * 1e3
        );
    }
    for words in &answer.unobservable {
        say!("not observable: {words}");
    }
    const SHOWN: usize = 20;
    for row in answer.rejected.iter().take(SHOWN) {
        let mut who = format!("pose {} {}", row.pose, row.kind);
        if let Some(cable) = row.cable {
            who += &format!(" of cable {cable}");
        }
        if let (Some(tag), Some(corner)) = (row.tag, row.corner) {
            who += &format!(" {corner} of tag {tag}");
        }
        say!("rejected: {who}, {:.1} standard deviations off", row.sigmas);
    }
    if answer.rejected.len() > SHOWN {
        say!(
            "rejected: {} more, see --json",
            answer.rejected.len() - SHOWN
        );
    }
    for words in &answer.warnings {
        say!("warning: {words}");
    }
    say!(
        "verdict: accepted{}",
        if answer.warnings.is_empty() {
            ""
        } else {
            " with warnings"
        }
    );
}
