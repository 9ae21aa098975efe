//! `mcdpr export RUN --csv`: a recorded run as plain tables; `--to rosbag2`: as a bag of ROS 2.

use super::{Common, Failed, Outcome, print_json};
use crate::record::{self, RecordedRun, rosbag};
use crate::report::tables;
use std::path::{Path, PathBuf};

/// What a run can become besides tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Format {
    /// A folder with metadata.yaml and MCAP in CDR, as `ros2 bag` has it
    Rosbag2,
}

/// Most bytes of a record that becomes a bag: it is made in memory.
const MOST_BYTES: u64 = 1 << 30;

/// Write a recorded run as CSV tables, or as a bag of ROS 2
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// The run's folder, or its run.mcap
    run: PathBuf,
    /// As comma-separated values, one file per topic
    #[arg(long, required_unless_present = "to")]
    csv: bool,
    /// As a bag: joint states, transforms, wrenches of the cables, diagnostics, pictures
    #[arg(long, value_name = "FORMAT", conflicts_with = "csv")]
    to: Option<Format>,
    /// Folder for the files, instead of the run's own; for a bag, instead of `rosbag2` there
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let run = record::load(&self.run)?;
        if let Some(damage) = &run.damage {
            eprintln!("{}", damage.words());
        }
        let folder = match &self.out {
            Some(folder) => folder.clone(),
            None => run.path.parent().map(PathBuf::from).unwrap_or_default(),
        };
        if self.to == Some(Format::Rosbag2) {
            let folder = match &self.out {
                Some(_) => folder,
                None => folder.join("rosbag2"),
            };
            return bag(common, &run, &folder);
        }
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

fn bag(common: &Common, run: &RecordedRun, folder: &Path) -> Outcome {
    let failed = || Failed::from_error("writing the bag");
    let record = crate::files::read_bytes(&run.path, MOST_BYTES).map_err(failed())?;
    let name = folder.file_name().map(|name| name.to_string_lossy());
    let file = format!("{}_0.mcap", name.as_deref().unwrap_or("rosbag2"));
    let robot = run
        .scenario
        .robot
        .first()
        .map_or("", |file| file.name.as_str());
    let bag = rosbag::bag(&record, robot, &file);
    let bag = bag.map_err(Failed::from_error("writing the bag"))?;
    std::fs::create_dir_all(folder).map_err(failed())?;
    crate::files::write_atomically(&folder.join(&file), &bag.mcap).map_err(failed())?;
    let about = folder.join("metadata.yaml");
    crate::files::write_atomically(&about, &bag.metadata).map_err(failed())?;
    if common.json {
        let topics = bag.topics.iter().map(|topic| {
            serde_json::json!({
                "topic": topic.name, "type": topic.kind, "messages": topic.messages,
            })
        });
        let topics: Vec<_> = topics.collect();
        return print_json(&serde_json::json!({ "folder": folder, "topics": topics }));
    }
    for topic in &bag.topics {
        say!(
            "{}: {} messages of {}",
            topic.name,
            topic.messages,
            topic.kind
        );
    }
    say!("{}", folder.display());
    Ok(())
}
