//! `mcdpr export RUN --csv`: a recorded run as plain tables.

use super::{Common, Failed, Outcome, print_json};
use crate::record::RecordedRun;
use crate::report::tables;
use std::path::PathBuf;

/// Write a recorded run as CSV tables: cables, states, true states, log
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// The run's folder, or its run.mcap
    run: PathBuf,
    /// As comma-separated values, one file per topic
    #[arg(long, required = true)]
    csv: bool,
    /// Folder for the files, instead of the run's own
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let run = RecordedRun::load(&self.run)?;
        if let Some(damage) = &run.damage {
            eprintln!("{}", super::replay::describe(damage));
        }
        let folder = match &self.out {
            Some(folder) => folder.clone(),
            None => run.path.parent().map(PathBuf::from).unwrap_or_default(),
        };
        let failed = || Failed::from_error("writing the tables");
        std::fs::create_dir_all(&folder).map_err(failed())?;
        let mut written = Vec::new();
        for (name, text) in tables::all(&run) {
            let path = folder.join(name);
            crate::files::write_atomically(&path, &text).map_err(failed())?;
            written.push((path.display().to_string(), text.lines().count() - 1));
        }
        if common.json {
            let files = written
                .iter()
                .map(|(path, rows)| serde_json::json!({ "file": path, "rows": rows }));
            return print_json(&files.collect::<Vec<_>>());
        }
        for (path, rows) in written {
            say!("{path}: {rows} rows");
        }
        Ok(())
    }
}
