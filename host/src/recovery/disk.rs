//! Where a journal is written to: files of the user, or memory.

use super::{Journal, JournalError};
use mcdpr_core::recovery::journal::{MARK_BYTES, Mark};
use mcdpr_core::recovery::reference::TagReference;
use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Result, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most bytes of a journal that is read: a file is begun anew long before.
const MOST_BYTES: u64 = 8 << 20;

/// Takes a journal's bytes.
pub trait Disk: Send + 'static {
    /// A file begins with these bytes; the one before it is kept beside it.
    ///
    /// # Errors
    /// The system's; the file before stays as it is.
    fn begin(&mut self, bytes: &[u8]) -> Result<()>;

    /// Bytes at its end.
    ///
    /// # Errors
    /// The system's.
    fn append(&mut self, bytes: &[u8]) -> Result<()>;

    /// Flushes to the disk, then writes the mark of the last record.
    ///
    /// # Errors
    /// The system's.
    fn sync(&mut self, mark: Mark) -> Result<()>;
}

/// A folder with `journal`, the one before it as `journal.old`, and `mark`.
#[derive(Debug)]
pub(crate) struct FileDisk {
    folder: PathBuf,
    journal: Option<File>,
    mark: Option<File>,
    slot: u64,
}

/// The folder of a board's journal.
pub(super) fn folder_of(board: &str) -> Option<PathBuf> {
    Some(crate::run::state_folder()?.join(format!("journal-{board}")))
}

impl FileDisk {
    /// The files of a board, by its number in hexadecimal.
    ///
    /// # Errors
    /// Where the user has no home, or the folder cannot be made.
    pub fn of_board(board: &str) -> Result<Self> {
        let missing = || Error::new(ErrorKind::NotFound, "the user has no home folder");
        Self::in_folder(&folder_of(board).ok_or_else(missing)?)
    }

    /// The files in a folder.
    ///
    /// # Errors
    /// Where it cannot be made.
    pub(crate) fn in_folder(folder: &Path) -> Result<Self> {
        std::fs::create_dir_all(folder)?;
        Ok(Self {
            folder: folder.to_owned(),
            journal: None,
            mark: None,
            slot: 0,
        })
    }
}

impl Disk for FileDisk {
    fn begin(&mut self, bytes: &[u8]) -> Result<()> {
        let path = self.folder.join("journal");
        let part = self.folder.join("journal.part");
        let mut file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(true)
            .open(&part)?;
        file.write_all(bytes)?;
        // The content before the name: a cut leaves the old journal or the new one, not a part.
        file.sync_data()?;
        match std::fs::rename(&path, self.folder.join("journal.old")) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        std::fs::rename(&part, &path)?;
        // The names reach the disk with the folder; some systems have no handle for one.
        if let Ok(folder) = File::open(&self.folder) {
            folder.sync_all().or_else(|error| match error.kind() {
                ErrorKind::InvalidInput | ErrorKind::Unsupported => Ok(()),
                _ => Err(error),
            })?;
        }
        self.journal = Some(file);
        Ok(())
    }

    fn append(&mut self, bytes: &[u8]) -> Result<()> {
        match &mut self.journal {
            Some(file) => file.write_all(bytes),
            None => Err(Error::new(ErrorKind::NotFound, "no journal was begun")),
        }
    }

    fn sync(&mut self, mark: Mark) -> Result<()> {
        let Some(journal) = &self.journal else {
            return Ok(());
        };
        // The journal first: a mark must not name a record that the disk does not have.
        journal.sync_data()?;
        let file = match &mut self.mark {
            Some(file) => file,
            none => none.insert(
                OpenOptions::new()
                    .write(true)
                    .create(true)
                    .truncate(true)
                    .open(self.folder.join("mark"))?,
            ),
        };
        // In turn: a cut in the middle of a slot leaves the other.
        self.slot = (self.slot + 1) % 2;
        file.seek(SeekFrom::Start(self.slot * MARK_BYTES as u64))?;
        file.write_all(&mark.to_bytes())?;
        file.sync_data()
    }
}

/// The journal of a board, checked; `scale` is the robot's checksum.
///
/// # Errors
/// [`JournalError`] where there is no valid one. No file is changed.
pub fn load(board: &str, scale: u32) -> std::result::Result<Journal, JournalError> {
    let missing = || JournalError::Missing {
        board: board.to_owned(),
    };
    let folder = folder_of(board).ok_or_else(missing)?;
    let read = |name: &str| crate::files::read_bytes(folder.join(name), MOST_BYTES).ok();
    let bytes = read("journal").ok_or_else(missing)?;
    let journal = match Journal::read(&bytes) {
        // It was begun anew when the power went.
        Err(JournalError::Empty) => match read("journal.old") {
            Some(old) => Journal::read(&old)?,
            None => return Err(JournalError::Empty),
        },
        read => read?,
    };
    let mark = read("mark").and_then(|bytes| Mark::read(&bytes));
    journal.check(board, scale, mark, now_ms())?;
    Ok(journal)
}

/// Most bytes of it.
const MOST_VIEW_BYTES: u64 = 1 << 16;

/// Where the camera saw the tags when the robot of this board was homed, if that was kept.
pub(crate) fn load_reference(board: &str) -> Option<TagReference> {
    let path = folder_of(board)?.join(crate::run::TAG_VIEW);
    let bytes = crate::files::read_bytes(path, MOST_VIEW_BYTES).ok()?;
    serde_json::from_slice(&bytes).ok()
}

/// Keeps it, in place of the one before.
///
/// # Errors
/// The system's.
pub(crate) fn keep_reference(board: &str, reference: &TagReference) -> Result<()> {
    let missing = || Error::new(ErrorKind::NotFound, "the user has no home folder");
    let folder = folder_of(board).ok_or_else(missing)?;
    std::fs::create_dir_all(&folder)?;
    let text = serde_json::to_vec_pretty(reference)?;
    crate::files::write_atomically(&folder.join(crate::run::TAG_VIEW), text)
}

/// Wall clock, ms since 1970.
pub(super) fn now_ms() -> u64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.map_or(0, |since| {
        u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
    })
}

/// A journal in memory: for simulated robots in this process. Clones share it.
#[derive(Debug, Clone, Default)]
pub(crate) struct MemoryDisk(Arc<Mutex<Memory>>);

#[derive(Debug, Default)]
struct Memory {
    bytes: Vec<u8>,
    mark: Option<Mark>,
    synced: usize,
}

impl MemoryDisk {
    fn lock(&self) -> MutexGuard<'_, Memory> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Everything that was written.
    #[cfg(test)]
    pub(crate) fn bytes(&self) -> Vec<u8> {
        self.lock().bytes.clone()
    }

    /// The bytes that are certainly on the disk, and the mark.
    #[must_use]
    pub(crate) fn synced(&self) -> (Vec<u8>, Option<Mark>) {
        let memory = self.lock();
        let bytes = memory.bytes.get(..memory.synced).unwrap_or_default();
        (bytes.to_vec(), memory.mark)
    }
}

impl Disk for MemoryDisk {
    fn begin(&mut self, bytes: &[u8]) -> Result<()> {
        let mut memory = self.lock();
        memory.bytes = bytes.to_vec();
        memory.synced = bytes.len();
        Ok(())
    }

    fn append(&mut self, bytes: &[u8]) -> Result<()> {
        self.lock().bytes.extend(bytes);
        Ok(())
    }

    fn sync(&mut self, mark: Mark) -> Result<()> {
        let mut memory = self.lock();
        memory.synced = memory.bytes.len();
        memory.mark = Some(mark);
        Ok(())
    }
}
