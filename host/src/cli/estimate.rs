//! `mcdpr estimate`: the platform's pose, from the board's measurements at rest.

use super::reach::with_session;
use super::{Common, Outcome, print_json};
use crate::estimate::{Measurements, Sigmas, estimate, find_slip};
use crate::motion::Model;
use crate::run;

/// Estimate the platform's pose from lengths and tensions at rest, and name a cable that slipped
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let model = Model::new(&common.robot()?)?;
        model.comes_to_rest("the estimate from lengths, tensions and tags")?;
        let (measured, start_m) = with_session(common, &model, None, None, |mut session| {
            let status = run::status(session.client())?;
            let start_m = session.tool_m();
            session.close()?;
            let measured = Measurements {
                lengths_m: status.lengths_m().collect(),
                tensions_n: status.tensions_n().collect(),
                ..Measurements::default()
            };
            Ok((measured, start_m))
        })?;
        let sigmas = Sigmas::default();
        let found = estimate(&model, &measured, &sigmas, &start_m)?;
        let slip = find_slip(&model, &measured, &sigmas, &found)?;
        let sigma_m = found.covariance_m2.diagonal().map(|v| v.max(0.0).sqrt());
        let turn = found.rest.equilibrium.pose.rpy();
        if common.json {
            let (tool, sigma): ([f64; 3], [f64; 3]) = (found.tool_m.into(), sigma_m.into());
            let rows: Vec<Vec<f64>> = found
                .covariance_m2
                .row_iter()
                .map(|row| row.iter().copied().collect())
                .collect();
            return print_json(&serde_json::json!({
                "tool_m": tool,
                "sigma_m": sigma,
                "covariance_m2": rows,
                "attitude_rpy_rad": [turn[0], turn[1], turn[2]],
                "redundancy": found.redundancy(),
                "slip_cable": slip.map(|s| s.cable),
                "slip_m": slip.map(|s| s.slip_m),
            }));
        }
        let (at, by) = (found.tool_m * 1e3, sigma_m * 1e3);
        say!(
            "tool at ({:.2}, {:.2}, {:.2}) mm, standard deviation ({:.2}, {:.2}, {:.2}) mm",
            at.x,
            at.y,
            at.z,
            by.x,
            by.y,
            by.z
        );
        say!(
            "roll {:.2}, pitch {:.2}, yaw {:.2} deg",
            turn[0].to_degrees(),
            turn[1].to_degrees(),
            turn[2].to_degrees()
        );
        if let Some(redundancy) = found.redundancy() {
            say!("redundancy residual {redundancy:.2} (about 1 where all is well)");
        }
        match slip {
            Some(slip) => say!(
                "cable {} is {:+.1} mm from what its encoder says{}",
                slip.cable,
                slip.slip_m * 1e3,
                if slip.clear {
                    ""
                } else {
                    "; another cable explains it nearly as well"
                }
            ),
            None => say!("no cable has slipped"),
        }
        Ok(())
    }
}
