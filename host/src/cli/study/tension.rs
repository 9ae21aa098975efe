//! `mcdpr study tension`: every figure of the tension loop.

use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use crate::robot::Robot;
use crate::tension::{columns, study};

/// Every figure of the tension loop: laws side by side, light and geared winches
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Simulated runs per figure
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let seeds = self.seeds;
        let (light, geared) = (
            Robot::built_in("lab-direct")?,
            Robot::built_in("paper-optimistic")?,
        );
        let table = study(&light, &geared, seeds)?;
        let text = serde_json::to_string(&table).map_err(Failed::from_error("the result"))?;
        let hash = mcdpr_protocol::frame::crc32(text.as_bytes());
        if common.json {
            return print_json(&serde_json::json!({
                "study": "tension",
                "seeds": format!("1 to {seeds}"),
                "crc32_of_rows": format!("{hash:08x}"),
                "rows": table,
            }));
        }
        let mut head = vec!["simulation, medians".to_owned(), String::new()];
        head.extend(columns().iter().map(|column| column.name.to_owned()));
        head.push("paper".to_owned());
        let mut rows = vec![head];
        for row in table {
            let mut cells = vec![row.figure, row.unit.to_owned()];
            let medians = row.medians.iter().zip(&row.ended);
            cells.extend(medians.map(|(median, &ended)| {
                let short = u64::try_from(ended).is_ok_and(|ended| ended < seeds);
                let runs = if short {
                    format!(" ({ended} runs)")
                } else {
                    String::new()
                };
                median.map_or_else(|| "fault".to_owned(), |v| format!("{v:.3}")) + &runs
            }));
            cells.push(row.paper.to_owned());
            rows.push(cells);
        }
        write_out(&lay_out(&rows));
        say!(
            "seeds 1 to {seeds}, hash {hash:08x}; a fault: half of the runs or more were stopped \
             by the board"
        );
        Ok(())
    }
}
