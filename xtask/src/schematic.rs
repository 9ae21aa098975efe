//! The board's schematic, written from its netlist, and KiCad's own check of it.

mod netlist;
mod sheet;
mod symbol;
mod write;

use crate::tools;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What the schematic is written from.
const NETLIST: &str = "docs/board.net";
const SCHEMATIC: &str = "docs/board.kicad_sch";
const CHECKER: &str = "kicad-cli";

/// Writes the schematic.
///
/// # Errors
/// If the netlist cannot be read or does not fit on the sheet.
pub(crate) fn write() -> Result<(), String> {
    let text = from_netlist(Path::new(NETLIST))?;
    std::fs::write(SCHEMATIC, text).map_err(|error| format!("{SCHEMATIC}: {error}"))?;
    println!("{SCHEMATIC}");
    Ok(())
}

fn from_netlist(file: &Path) -> Result<String, String> {
    let named = |error: String| format!("{}: {error}", file.display());
    let text = std::fs::read_to_string(file).map_err(|error| named(error.to_string()))?;
    let netlist = netlist::Netlist::read(&text).map_err(named)?;
    write::schematic(netlist).map_err(named)
}

/// Lets KiCad check the electrical rules of the schematic.
///
/// # Errors
/// If KiCad is not installed, or finds an error.
pub(crate) fn check() -> Result<(), String> {
    if !installed() {
        return Err(format!(
            "xtask: {CHECKER} is not installed: install KiCad 8 or later to check the electrical rules of {SCHEMATIC}"
        ));
    }
    // Beside the file, KiCad would leave its own settings.
    let folder = tools::target().join("schematic");
    let copy = copied(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let report = folder.join("erc.rpt");
    // One of an earlier check must not be taken for this one's.
    _ = std::fs::remove_file(&report);
    // Errors only: of the embedded symbols KiCad warns that their library is not installed.
    let outcome = crate::run(
        Command::new(CHECKER)
            .args(["sch", "erc", "--severity-error", "--exit-code-violations"])
            .arg("--output")
            .arg(&report)
            .arg(&copy),
    );
    let found = std::fs::read_to_string(&report).unwrap_or_default();
    outcome.map_err(|error| format!("{error}\n{found}"))
}

fn copied(folder: &Path) -> std::io::Result<PathBuf> {
    std::fs::create_dir_all(folder)?;
    let copy = folder.join("board.kicad_sch");
    std::fs::copy(SCHEMATIC, &copy)?;
    Ok(copy)
}

/// The check of the electrical rules in `cargo xtask test`: where KiCad is not installed, a line says so.
///
/// # Errors
/// If KiCad finds an error.
pub(crate) fn check_if_installed() -> Result<(), String> {
    if installed() {
        return check();
    }
    eprintln!(
        "xtask: {CHECKER} is not installed: the electrical rules of {SCHEMATIC} are NOT checked"
    );
    Ok(())
}

fn installed() -> bool {
    let version = Command::new(CHECKER).arg("version").output();
    version.is_ok_and(|output| output.status.success())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn root() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
    }

    #[test]
    fn the_schematic_is_the_one_that_its_netlist_gives() {
        let written = std::fs::read_to_string(root().join(SCHEMATIC)).unwrap();
        let expected = from_netlist(&root().join(NETLIST)).unwrap();
        assert!(
            written == expected,
            "{SCHEMATIC} is not that of {NETLIST}: run cargo xtask schematic"
        );
    }

    #[test]
    fn no_identifier_is_there_twice() {
        let text = from_netlist(&root().join(NETLIST)).unwrap();
        let after = |(at, key): (usize, &str)| text[at + key.len()..].split('"').next();
        let ids = text.match_indices("(uuid \"");
        let mut ids: Vec<_> = ids.filter_map(after).collect();
        let count = ids.len();
        assert!(count > 500, "{count}");
        ids.sort_unstable();
        ids.dedup();
        assert_eq!(ids.len(), count);
    }
}
