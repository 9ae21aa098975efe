//! `mcdpr calibrate verify`: a calibration against poses measured by other means.

use crate::calibration::verify::{distances, rows};
use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use std::path::PathBuf;

/// Compare the calibration with poses measured by other means, such as an external camera
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// CSV with the columns dl1_mm to dlN_mm, x_mm, y_mm, z_mm and, if wanted, tension_N
    #[arg(long, value_name = "FILE")]
    poses: PathBuf,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let what = format!("measured poses {}", self.poses.display());
        let text = crate::files::read_text(&self.poses).map_err(Failed::from_error(&what))?;
        let designed = crate::robot::find(&common.robot)?;
        let rows = rows(&text, designed.cables.len())?;
        let calibrated = common.robot()?;
        let nominal = distances(&designed, &rows)?;
        let now = match calibrated.calibrated {
            Some(_) => Some(distances(&calibrated, &rows)?),
            None => None,
        };
        let mean = |all: &[f64]| all.iter().sum::<f64>() / all.len().max(1) as f64;
        let worst = |all: &[f64]| all.iter().copied().fold(0.0, f64::max);
        if common.json {
            let part = |all: &Vec<f64>| serde_json::json!({ "distance_m": all, "mean_m": mean(all), "max_m": worst(all) });
            return print_json(&serde_json::json!({
                "poses": rows.len(), "described": part(&nominal), "calibrated": now.as_ref().map(part),
            }));
        }
        let row = |name: &str, all: &[f64]| {
            let mm = |v: f64| format!("{:.3}", v * 1e3);
            vec![name.to_owned(), mm(mean(all)), mm(worst(all))]
        };
        let mut table = vec![["distance, mm", "mean", "max"].map(str::to_owned).to_vec()];
        table.push(row("as described", &nominal));
        if let Some(now) = &now {
            table.push(row("calibrated", now));
        }
        write_out(&lay_out(&table));
        say!(
            "{} poses, after the best rigid motion between both frames{}",
            rows.len(),
            if now.is_some() {
                ""
            } else {
                "; this robot has no calibration yet"
            }
        );
        Ok(())
    }
}
