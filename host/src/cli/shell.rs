//! `mcdpr completions` and `mcdpr man`: support for shells.

use super::order::command;
use super::{Common, Failed, Outcome, write_out};
use std::path::PathBuf;

/// Print a shell's completion script
#[derive(Debug, clap::Args)]
pub(crate) struct Completions {
    /// bash, zsh, fish, elvish or powershell
    shell: clap_complete::Shell,
}

/// Print the manual page, or write one for every command
#[derive(Debug, clap::Args)]
pub(crate) struct Man {
    /// Folder for mcdpr.1 and a page for every command, instead of printing
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

impl Completions {
    pub(crate) fn run(&self, _common: &Common) -> Outcome {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut command(), "mcdpr", &mut script);
        write_out(&String::from_utf8_lossy(&script));
        Ok(())
    }
}

impl Man {
    pub(crate) fn run(&self, _common: &Common) -> Outcome {
        let failed = || Failed::from_error("writing the manual pages");
        if let Some(folder) = &self.out {
            std::fs::create_dir_all(folder).map_err(failed())?;
            clap_mangen::generate_to(command(), folder).map_err(failed())?;
            return Ok(());
        }
        let mut page = Vec::new();
        clap_mangen::Man::new(command())
            .render(&mut page)
            .map_err(failed())?;
        write_out(&String::from_utf8_lossy(&page));
        Ok(())
    }
}
