//! `mcdpr reproduce`: the paper's experiments, compared with its numbers.

use super::table::lay_out;
use super::{Common, Failed, Outcome, print_json};
use crate::machine::Firmware;
use crate::report::RunFolder;
use crate::reproduce::{self, Bench, NOT_REPRODUCED};
use indicatif::{ProgressBar, ProgressStyle};
use std::time::Instant;

/// Run the paper's experiments on the simulator and print its numbers beside ours
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Only these experiments, separated by commas
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    only: Vec<String>,
    /// Number of seeds for random quantities
    #[arg(long, default_value_t = 5, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        // The chip has a separate column there.
        common.no_chip("reproduce")?;
        // A firmware that was named must exist; the default one may not have been built.
        let firmware = match &common.firmware {
            Some(path) => Some(Firmware::find(Some(path))?),
            None => Firmware::find(None).ok(),
        };
        let bench = Bench {
            seed: common.seed,
            seeds: self.seeds,
            firmware,
        };
        let began = Instant::now();
        let bar = ProgressBar::new(0);
        if let Ok(style) = ProgressStyle::with_template("{pos}/{len} [{wide_bar}] {msg}") {
            bar.set_style(style);
        }
        let outcomes = reproduce::reproduce(&bench, &self.only, |experiment, index, count| {
            bar.set_length(count as u64);
            bar.set_position(index as u64);
            bar.set_message(experiment.title);
        });
        bar.finish_and_clear();
        let outcomes = outcomes?;
        let failed = || Failed::from_error("writing the report");
        let folder = RunFolder::create(common.record.as_deref(), "reproduce").map_err(failed())?;
        folder
            .write("report.html", &reproduce::page(&outcomes, &bench))
            .map_err(failed())?;
        let not = NOT_REPRODUCED
            .iter()
            .map(|(what, why)| serde_json::json!({ "what": what, "why": why }));
        let document = serde_json::json!({
            "seed": bench.seed,
            "seeds": bench.seeds,
            "chip": bench.firmware.is_some(),
            "experiments": outcomes,
            "not_reproduced": not.collect::<Vec<_>>(),
            "report": folder.path().join("report.html").display().to_string(),
        });
        folder
            .write_json("report.json", &document)
            .map_err(failed())?;
        if common.json {
            return print_json(&document);
        }
        for outcome in &outcomes {
            say!("{}", outcome.title);
            super::write_out(&lay_out(&reproduce::table(outcome)));
            say!("");
        }
        if bench.firmware.is_none() {
            say!("no firmware file, so no column of the emulated chip: `cargo fw` builds it");
        }
        say!(
            "{} ({:.0} s)",
            folder.path().join("report.html").display(),
            began.elapsed().as_secs_f64()
        );
        Ok(())
    }
}
