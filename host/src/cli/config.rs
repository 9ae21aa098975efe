//! `mcdpr config`: the robot file.

mod answers;
mod compose;
mod frame;
mod init;
mod physics;
mod reserve;

use super::{Common, Failed, Outcome, print_json, write_out};
use crate::machine;
use crate::robot::json_schema;
use clap::Subcommand;
use std::path::PathBuf;

/// Create, check and show a robot file, and print its schema for an editor
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Write a robot file: a short one from a few answers (options, or questions on a terminal), or with
    /// --copy, or without a terminal, the commented one of --robot
    Init {
        /// The new file; an existing one is not overwritten
        file: PathBuf,
        /// Copy the file of --robot with its comments
        #[arg(long)]
        copy: bool,
        #[command(flatten)]
        answers: answers::Answers,
    },
    /// Write a robot file from winch modules that exist, which keep their constants, and a new frame (options, or
    /// questions on a terminal)
    Compose {
        /// The new file; an existing one is not overwritten
        file: PathBuf,
        #[command(flatten)]
        modules: compose::Modules,
        #[command(flatten)]
        answers: answers::Answers,
    },
    /// Check a robot file: keys, ranges, geometry, limits of the board, and whether such a robot can
    /// work
    Check {
        /// The file, or the name of a built-in robot; --robot without it
        file: Option<String>,
    },
    /// Print the JSON schema of robot files
    Schema,
    /// Show every value of a robot file, defaults included, in SI units
    Show {
        /// The file, or the name of a built-in robot; --robot without it
        file: Option<String>,
    },
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let named = |file: &Option<String>| file.clone().unwrap_or_else(|| common.robot.clone());
        match &self.what {
            What::Init {
                file,
                copy,
                answers,
            } => {
                if *copy && !answers.is_empty() {
                    let reason = "it copies a file as it is: give the answers without it";
                    return Err(Failed::from_error("--copy")(reason).into());
                }
                if *copy || (answers.is_empty() && !answers::can_ask()) {
                    return copied(file, common);
                }
                init::init(file, answers, common)
            }
            What::Compose {
                file,
                modules,
                answers,
            } => compose::compose(file, modules, answers, common),
            What::Check { file } => check(&named(file), common),
            What::Schema => {
                let text = serde_json::to_string_pretty(&json_schema());
                write_out(&(text.map_err(Failed::from_error("the schema"))? + "\n"));
                Ok(())
            }
            What::Show { file } => {
                let robot = crate::robot::find(&named(file))?;
                if common.json {
                    return print_json(&robot);
                }
                let text = serde_json::to_string_pretty(&robot);
                write_out(&(text.map_err(Failed::from_error("the robot"))? + "\n"));
                Ok(())
            }
        }
    }
}

fn copied(file: &std::path::Path, common: &Common) -> Outcome {
    init::refuse_existing(file)?;
    crate::robot::find(&common.robot)?;
    let folder = file.parent().map(PathBuf::from).unwrap_or_default();
    let failed = || Failed::from_error("writing the robot file");
    let mut written = Vec::new();
    for (index, (name, text)) in crate::robot::sources(&common.robot).into_iter().enumerate() {
        let path = if index == 0 {
            file.to_owned()
        } else {
            folder.join(name)
        };
        if path.exists() {
            // An existing module file belongs to the user.
            continue;
        }
        if let Some(parent) = path
            .parent()
            .filter(|parent| !parent.as_os_str().is_empty())
        {
            std::fs::create_dir_all(parent).map_err(failed())?;
        }
        crate::files::write_atomically(&path, text).map_err(failed())?;
        written.push(path.display().to_string());
    }
    if common.json {
        return print_json(&serde_json::json!({ "written": written }));
    }
    for path in written {
        say!("wrote {path}");
    }
    Ok(())
}

fn check(name: &str, common: &Common) -> Outcome {
    let robot = crate::robot::find(name)?;
    machine::geometry(&robot).map_err(Failed::from_error("the robot's geometry"))?;
    let entries = machine::configuration(&robot)?;
    let (entries, board_hash) = (entries.len(), machine::hash_of(&entries).0);
    let judged = physics::judge(&robot)?;
    let problems = judged.problems.clone();
    if common.json {
        print_json(&serde_json::json!({
            "name": robot.name,
            "cables": robot.cables.len(),
            "board_entries": entries,
            "board_hash": format!("{board_hash:08x}"),
            "hash": format!("{:08x}", robot.content_hash()),
            "physics": judged,
        }))?;
    } else {
        say!(
            "{}: hash {:08x} of every value; {entries} values for the board, hash {board_hash:08x}",
            robot.name,
            robot.content_hash(),
        );
        physics::show(&judged, name);
    }
    if problems.is_empty() {
        return Ok(());
    }
    let name = name.to_owned();
    Err(physics::Unfit { name, problems }.into())
}
