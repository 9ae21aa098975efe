//! `mcdpr flash FIRMWARE.elf`: checks a firmware file, writes it to the board, waits for its hello.

use super::{Common, Outcome, print_json};
use crate::flash::{FlashError, Image};
use crate::link::ClientError;
use crate::machine::Firmware;
use crate::run::new_session;
use std::path::PathBuf;

/// Write firmware to the board through a debug probe, verify it, and wait until the board answers
///
/// The file is checked first, and executed on an emulated chip: a file that is not firmware of this
/// board is refused before a probe is searched for. With --dry-run that is all. With --on PORT the
/// board is asked first whether it is armed, and must answer there afterwards with the new firmware
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// The firmware's file (ELF), as `cargo fw` builds it
    #[arg(value_name = "FIRMWARE", required_unless_present = "list")]
    file: Option<PathBuf>,
    /// List the connected probes
    #[arg(long)]
    list: bool,
    /// Serial number of the probe, if there are several
    #[arg(long, value_name = "SERIAL")]
    probe: Option<String>,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        if self.list {
            return list(common);
        }
        let path = self.file.clone().unwrap_or_default();
        let shown = path.display().to_string();
        let firmware = Firmware::find(Some(&path))?;
        let image = Image::examine(&shown, &firmware)?;
        eprintln!(
            "{shown}: firmware {}, {} bytes of flash, protocol {}.{}; it runs on the emulated chip",
            image.commit(),
            image.flash.len(),
            image.hello.major,
            image.hello.minor,
        );
        let board = if common.dry_run {
            None
        } else {
            ask_before(common)?;
            write(&image, self.probe.as_deref(), common)?
        };
        if common.json {
            return print_json(&serde_json::json!({
                "firmware": image.commit(),
                "flash_bytes": image.flash.len(),
                "written": !common.dry_run,
                "board_id": board,
            }));
        }
        match (common.dry_run, board) {
            (true, _) => say!("the file is good; nothing was written"),
            (false, Some(id)) => say!("written, verified, started; board {id} says hello"),
            (false, None) => {
                say!("written, verified, started; `mcdpr doctor --on PORT` looks at the board");
            }
        }
        Ok(())
    }
}

/// Refuses to write a board that is armed, if there is a port to ask it on.
fn ask_before(common: &Common) -> Outcome {
    let warning = if common.on == "sim" {
        Some(
            "no port is named, so the board is not asked whether it is armed: brakes close as soon as it is written; `--on PORT` asks",
        )
    } else {
        let link = common.open_one_port().map_err(ClientError::from)?;
        crate::flash::ask_before(link, new_session())?
    };
    if let Some(warning) = warning {
        eprintln!("{warning}");
    }
    Ok(())
}

#[cfg(feature = "flash")]
fn list(common: &Common) -> Outcome {
    let probes = crate::flash::probes();
    if common.json {
        let all: Vec<_> = probes
            .iter()
            .map(|probe| serde_json::json!({ "name": probe.name(), "serial": probe.serial() }))
            .collect();
        return print_json(&all);
    }
    if probes.is_empty() {
        return Err(FlashError::NoProbe.into());
    }
    for probe in probes {
        say!("{}", probe.name());
    }
    Ok(())
}

#[cfg(feature = "flash")]
fn write(image: &Image, probe: Option<&str>, common: &Common) -> miette::Result<Option<String>> {
    use crate::link::Client;

    let mut written = 0;
    crate::flash::write(&image.flash, probe, |bytes| {
        written += bytes;
        if !common.json {
            eprint!("\r{written} bytes");
        }
    })?;
    eprintln!();
    if common.on == "sim" {
        return Ok(None);
    }
    let link = common.open_one_port().map_err(ClientError::from)?;
    let mut client = Client::connect(link, new_session())?;
    let hello = *client.hello();
    client.request(mcdpr_protocol::Request::Close)?;
    image.is_what_answers(&hello)?;
    let id = hello.board_id.iter().map(|b| format!("{b:02x}"));
    Ok(Some(id.collect()))
}

#[cfg(not(feature = "flash"))]
fn list(_common: &Common) -> Outcome {
    Err(FlashError::NoFeature.into())
}

#[cfg(not(feature = "flash"))]
fn write(_image: &Image, _probe: Option<&str>, _common: &Common) -> miette::Result<Option<String>> {
    Err(FlashError::NoFeature.into())
}
