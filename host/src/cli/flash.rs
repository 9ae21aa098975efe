//! `mcdpr flash FIRMWARE.elf`: checks a firmware file, writes it to the board, waits for its hello.

use super::{Common, Outcome, print_json};
use crate::flash::{FlashError, Image};
use crate::machine::Firmware;
use std::path::PathBuf;

/// Write firmware to the board through a debug probe, verify it, and wait until it says hello
///
/// The file is checked first, and executed on an emulated chip: what is no firmware of this board is
/// refused before a probe is looked for. With --dry-run that is all. With --on PORT the board must
/// answer there, with what was written.
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// The firmware's file (ELF), as `cargo fw` or `cargo fw-service` builds it
    #[arg(value_name = "FIRMWARE", required_unless_present = "list")]
    file: Option<PathBuf>,
    /// List the probes that are plugged in
    #[arg(long)]
    list: bool,
    /// Serial number of the probe, where there are several
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
        let kind = if image.has_service {
            "for the first day of winches"
        } else {
            "for motion"
        };
        eprintln!(
            "{shown}: firmware {}, {} bytes of flash, protocol {}.{}, the image {kind}; it runs on the emulated chip",
            image.commit(),
            image.flash.len(),
            image.hello.major,
            image.hello.minor,
        );
        let board = if common.dry_run {
            None
        } else {
            write(&image, self.probe.as_deref(), common)?
        };
        if common.json {
            return print_json(&serde_json::json!({
                "firmware": image.commit(),
                "flash_bytes": image.flash.len(),
                "has_service": image.has_service,
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
    use crate::link::{Client, ClientError};
    use crate::run::new_session;

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
    let link = common.open_port().map_err(ClientError::from)?;
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
