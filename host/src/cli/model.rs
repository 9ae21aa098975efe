//! `mcdpr model export`: the robot as a model file for other programs.

use super::{Common, Failed, Outcome, print_json};
use crate::model_file::{self, Format, Winches};
use clap::Subcommand;
use std::path::PathBuf;

/// The robot as a model for other simulators and viewers
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Write the robot (with its calibration, if there is one) as it hangs at home
    Export {
        /// The format
        #[arg(long, value_enum, value_name = "FORMAT")]
        to: Format,
        /// MJCF: which cables are elastic and hang on a winch; the others are forces
        #[arg(long, value_enum, value_name = "WHICH", default_value_t = Winches::Held)]
        winches: Winches,
        /// The file
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let What::Export { to, winches, out } = &self.what;
        let robot = common.robot()?;
        let text = model_file::write(&robot, *to, *winches)?;
        crate::files::write_atomically(out, &text)
            .map_err(Failed::from_error("writing the model"))?;
        let path = out.display().to_string();
        if common.json {
            return print_json(&serde_json::json!({ "written": path, "robot": robot.name }));
        }
        say!("{}: written to {path}", robot.name);
        Ok(())
    }
}
