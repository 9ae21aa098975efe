//! Lengths kept over a loss of power, in a file for each board.

use mcdpr_core::run::saved::{LengthStore, Saved};
use std::path::PathBuf;

/// Lengths in files of the user: `$XDG_STATE_HOME/mcdpr/lengths-BOARD.json`, by default under
/// `~/.local/state`.
#[derive(Debug, Clone, Copy)]
pub struct LengthFiles;

/// Name of the file with the view of tags at homing, beside the board's journal.
pub(crate) const TAG_VIEW: &str = "tag-view.json";

impl LengthStore for LengthFiles {
    fn load(&self, board: &str) -> Option<Saved> {
        let text = std::fs::read(path_of(board)?).ok()?;
        serde_json::from_slice(&text).ok()
    }

    fn keep(&self, saved: &Saved) {
        if let Err(error) = store(saved) {
            eprintln!("the lengths were not kept, home again after a loss of power: {error}");
        }
    }

    fn homed(&self, board: &str) {
        if let Err(error) = mark_homed(board) {
            eprintln!("warning: when the robot was homed was not kept: {error}");
        }
        let path =
            state_folder().map(|folder| folder.join(format!("journal-{board}")).join(TAG_VIEW));
        let Some(path) = path else {
            return;
        };
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                eprintln!("warning: {} cannot be removed: {error}", path.display());
            }
            _ => {}
        }
    }

    fn homed_unix_s(&self, board: &str) -> Option<u64> {
        let text = std::fs::read_to_string(homed_path(board)?).ok()?;
        text.trim().parse().ok()
    }

    fn forget(&self, board: &str) {
        let Some(path) = path_of(board) else {
            return;
        };
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                eprintln!("warning: {} cannot be removed: {error}", path.display());
            }
            _ => {}
        }
    }
}

fn homed_path(board: &str) -> Option<PathBuf> {
    Some(state_folder()?.join(format!("homed-{board}")))
}

/// Keeps the time of a homing.
fn mark_homed(board: &str) -> std::io::Result<()> {
    let path = homed_path(board).ok_or(std::io::ErrorKind::NotFound)?;
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    crate::files::write_atomically(&path, format!("{}\n", crate::stamp::unix_s()))
}

/// Saves them completely, in place of the old ones.
fn store(saved: &Saved) -> std::io::Result<()> {
    let path = path_of(&saved.board).ok_or(std::io::ErrorKind::NotFound)?;
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    crate::files::write_atomically(&path, serde_json::to_vec_pretty(saved)?)
}

fn path_of(board: &str) -> Option<PathBuf> {
    Some(state_folder()?.join(format!("lengths-{board}.json")))
}

/// Where the user's state of this program is: `$XDG_STATE_HOME/mcdpr`, by default under
/// `~/.local/state`.
pub(crate) fn state_folder() -> Option<PathBuf> {
    let given = std::env::var_os("XDG_STATE_HOME").filter(|dir| !dir.is_empty());
    let folder = match given {
        Some(folder) => PathBuf::from(folder),
        None => PathBuf::from(std::env::var_os("HOME")?).join(".local/state"),
    };
    Some(folder.join("mcdpr"))
}
