//! `mcdpr calibrate plan`: poses to measure.

use crate::calibration::plan::{candidates, choose, work_poses};
use crate::calibration::space::Space;
use crate::calibration::{Data, Options, Refusal};
use crate::cli::numbers::whole;
use crate::cli::progress::Phase;
use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use std::path::PathBuf;

/// Choose the poses with the most information
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Calibration data that define robot, camera, tags and noise; their poses may be empty
    #[arg(long, value_name = "FILE")]
    data: PathBuf,
    /// Number of poses
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..))]
    poses: u16,
    /// Number of reachable poses to choose from
    #[arg(long, default_value_t = 500, value_parser = whole::<1, 100_000>)]
    candidates: usize,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let what = format!("calibration data {}", self.data.display());
        let text = crate::files::read_text(&self.data).map_err(Failed::from_error(&what))?;
        let phase = Phase::begin("choosing poses");
        let outcome = self.plan(&text, common.seed);
        drop(phase);
        let (found, plan) = match outcome {
            Ok(done) => done,
            Err(refusal) => {
                if common.json {
                    print_json(&serde_json::json!({ "refused": refusal.to_string() }))?;
                }
                return Err(refusal.into());
            }
        };
        let errors = &plan.expected_error_m;
        if common.json {
            let poses: Vec<_> = plan
                .chosen
                .iter()
                .zip(errors)
                .map(|(c, error)| {
                    serde_json::json!({
                        "position_m": <[f64; 3]>::from(c.pose.position_m),
                        "attitude_rad": c.pose.rpy(), "tension_cable": c.held + 1,
                        "tensions_n": c.tensions_n, "tags_in_view": c.views.len(),
                        "expected_error_m": error,
                    })
                })
                .collect();
            return print_json(&serde_json::json!({ "candidates": found, "poses": poses }));
        }
        let mut rows = vec![
            [
                "pose",
                "x, mm",
                "y",
                "z",
                "hold cable",
                "at N",
                "tags",
                "expected error, mm",
            ]
            .map(str::to_owned)
            .to_vec(),
        ];
        for (i, (c, error)) in plan.chosen.iter().zip(errors).enumerate() {
            let p = c.pose.position_m * 1e3;
            rows.push(vec![
                (i + 1).to_string(),
                format!("{:.1}", p.x),
                format!("{:.1}", p.y),
                format!("{:.1}", p.z),
                (c.held + 1).to_string(),
                format!("{:.2}", c.tensions_n[c.held]),
                c.views.len().to_string(),
                format!("{:.2}", error * 1e3),
            ]);
        }
        write_out(&lay_out(&rows));
        say!("\nout of {found} reachable poses with tags in view");
        Ok(())
    }

    fn plan(
        &self,
        text: &str,
        seed: u64,
    ) -> Result<(usize, crate::calibration::plan::Plan), Refusal> {
        let data = Data::from_json(text)?;
        let space = Space::of(&data);
        let all =
            candidates(&data, &space, self.candidates, seed).ok_or_else(|| Refusal::Field {
                path: "robot".to_owned(),
                what: "poses can be planned for four cables only".to_owned(),
            })?;
        let work = work_poses(&data, &space, 100, seed).unwrap_or_default();
        let plan = choose(
            &data,
            &space,
            &all,
            &work,
            self.poses.into(),
            &Options::default(),
        );
        let plan = plan.ok_or_else(|| Refusal::TooFewPoses {
            got: all.len(),
            total: self.candidates,
            needed: self.poses.into(),
            note:
                " (reachable poses with a tag wholly in view: more candidates, or tags elsewhere)"
                    .to_owned(),
        })?;
        Ok((all.len(), plan))
    }
}
