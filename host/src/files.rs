//! External files: read up to a size limit, written completely or not at all.

use std::ffi::OsString;
use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Most bytes of a text that people or other programs write (robots, tasks, data sets): far more
/// than any real one has, and few enough to be read at once.
pub const MOST_TEXT_BYTES: u64 = 32 << 20;

/// Most bytes of a robot file or a winch module: a hundred times what the longest takes.
pub(crate) const MOST_ROBOT_BYTES: u64 = 2 << 20;

/// The whole of a text file of at most [`MOST_TEXT_BYTES`].
///
/// # Errors
/// The system's; [`ErrorKind::FileTooLarge`] for a longer file; [`ErrorKind::InvalidInput`] for
/// anything that is not a file, [`ErrorKind::InvalidData`] for anything that is not UTF-8.
pub fn read_text(path: impl AsRef<Path>) -> Result<String> {
    read_text_to(path, MOST_TEXT_BYTES)
}

/// The whole of a text file of at most `most` bytes.
///
/// # Errors
/// As [`read_text`].
pub(crate) fn read_text_to(path: impl AsRef<Path>, most: u64) -> Result<String> {
    let bytes = read_bytes(path, most)?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        Error::new(
            ErrorKind::InvalidData,
            format!("byte {at} is not UTF-8 text"),
        )
    })
}

/// The whole of a file of at most `most` bytes.
///
/// # Errors
/// As [`read_text`].
pub(crate) fn read_bytes(path: impl AsRef<Path>, most: u64) -> Result<Vec<u8>> {
    let file = open(path.as_ref())?;
    let too_large = || {
        let reason = format!("it is longer than {most} bytes");
        Error::new(ErrorKind::FileTooLarge, reason)
    };
    if file.metadata()?.len() > most {
        return Err(too_large());
    }
    let mut bytes = Vec::new();
    // It may grow meanwhile, and special files of the system report no length.
    file.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(too_large());
    }
    Ok(bytes)
}

/// Opens a file for reading. A named pipe would block the caller until there is a writer, and a
/// device may have no end: anything that is not a file is refused before it is opened.
///
/// # Errors
/// The system's; [`ErrorKind::InvalidInput`] with what it is instead of a file.
pub fn open(path: &Path) -> Result<File> {
    let kind = std::fs::metadata(path)?.file_type();
    if !kind.is_file() {
        let what = if kind.is_dir() {
            "it is a folder"
        } else {
            "it is a pipe or a device, not a file"
        };
        return Err(Error::new(ErrorKind::InvalidInput, what));
    }
    File::open(path)
}

/// Writes a file so that every reader sees the old one or the new one, never a part of it: beside
/// it under a name that no other writer uses, flushed to the disk, then renamed. Of several
/// simultaneous writers the last one wins.
///
/// # Errors
/// The system's; an existing file is not changed.
pub(crate) fn write_atomically(path: &Path, contents: impl AsRef<[u8]>) -> Result<()> {
    let part = beside(path)?;
    let write = || {
        // An existing entry of this name, including a link, is not written through.
        let mut file = File::options().write(true).create_new(true).open(&part)?;
        file.write_all(contents.as_ref())?;
        file.sync_all()?;
        std::fs::rename(&part, path)
    };
    write().inspect_err(|_| {
        // A partial file must not stay; a failure to remove it is less important than the first
        // error.
        let _ = std::fs::remove_file(&part);
    })?;
    sync_folder_of(path)
}

/// A name beside a file for incomplete content: with the number of this process and of this write,
/// so that no two writers share it.
fn beside(path: &Path) -> Result<PathBuf> {
    static WRITINGS: AtomicU64 = AtomicU64::new(0);
    let name = path.file_name();
    let name = name.ok_or_else(|| Error::new(ErrorKind::InvalidInput, "it names no file"))?;
    let number = WRITINGS.fetch_add(1, Ordering::Relaxed);
    let mut part = OsString::from(".");
    part.push(name);
    part.push(format!(".{}-{number}.part", std::process::id()));
    Ok(path.with_file_name(part))
}

/// Flushes the folder of a file, without which a new name may be lost after a power cut.
#[cfg(unix)]
fn sync_folder_of(path: &Path) -> Result<()> {
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let synced = File::open(folder.unwrap_or(Path::new("."))).and_then(|folder| folder.sync_all());
    match synced {
        // Some file systems do not support it, and some folders may be written but not read.
        Err(error)
            if matches!(
                error.kind(),
                ErrorKind::InvalidInput | ErrorKind::PermissionDenied | ErrorKind::Unsupported
            ) =>
        {
            Ok(())
        }
        other => other,
    }
}

/// Other systems flush names themselves, or not at all.
#[cfg(not(unix))]
fn sync_folder_of(_: &Path) -> Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("mcdpr-files-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        path
    }

    #[test]
    fn a_file_is_read_to_its_bound_and_one_without_end_is_refused() {
        let folder = folder("bound");
        let path = folder.join("text");
        std::fs::write(&path, "12345").unwrap();
        assert_eq!(read_bytes(&path, 5).unwrap(), b"12345");
        let error = read_bytes(&path, 4).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::FileTooLarge);
        assert_eq!(read_text(&path).unwrap(), "12345");
        std::fs::write(&path, b"ab\xFFc").unwrap();
        assert!(read_text(&path).unwrap_err().to_string().contains("byte 2"));
        #[cfg(unix)]
        assert!(read_bytes("/dev/zero", 1000).is_err());
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    #[cfg(unix)]
    fn a_named_pipe_without_a_writer_is_refused_at_once() {
        let folder = folder("pipe");
        let pipe = folder.join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.unwrap().success());
        let error = read_text(&pipe).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidInput);
        assert!(error.to_string().contains("not a file"), "{error}");
        assert!(read_text(&folder).is_err());
        std::fs::remove_dir_all(folder).unwrap();
    }

    /// Simultaneous writers of different sizes: every reader sees one of them completely, and no
    /// temporary file stays.
    #[test]
    fn f8_several_writers_and_readers_never_see_a_torn_file() {
        let folder = folder("stress");
        let path = folder.join("shared");
        let content = |writer: usize, round: usize| {
            let line = format!("writer {writer} round {round}\n");
            line.repeat(1 + 997 * writer + round)
        };
        let whole = |text: &str| {
            let first = text.lines().next().unwrap_or("");
            let mut numbers = first.split(' ').filter_map(|word| word.parse().ok());
            let (writer, round) = (numbers.next().unwrap(), numbers.next().unwrap());
            text == content(writer, round)
        };
        write_atomically(&path, content(0, 0)).unwrap();
        let left = AtomicU64::new(4);
        let (reads, torn) = (AtomicU64::new(0), AtomicU64::new(0));
        std::thread::scope(|scope| {
            for writer in 0..4 {
                let (path, left) = (&path, &left);
                scope.spawn(move || {
                    for round in 0..60 {
                        write_atomically(path, content(writer, round)).unwrap();
                    }
                    left.fetch_sub(1, Ordering::SeqCst);
                });
            }
            for _ in 0..3 {
                scope.spawn(|| {
                    while left.load(Ordering::SeqCst) > 0 {
                        let text = read_text(&path).unwrap();
                        reads.fetch_add(1, Ordering::Relaxed);
                        torn.fetch_add(u64::from(!whole(&text)), Ordering::Relaxed);
                    }
                });
            }
        });
        let (reads, torn) = (reads.into_inner(), torn.into_inner());
        assert!(reads > 100, "{reads} reads prove nothing");
        assert_eq!(torn, 0, "of {reads} reads");
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn f8_a_write_that_fails_leaves_the_old_file_and_no_half_one() {
        let folder = folder("atomic");
        let path = folder.join("kept");
        write_atomically(&path, "old").unwrap();
        write_atomically(&path, "new").unwrap();
        assert_eq!(read_text(&path).unwrap(), "new");
        // A folder is in the way: renaming fails.
        let blocked = folder.join("blocked");
        std::fs::create_dir_all(blocked.join("in")).unwrap();
        assert!(write_atomically(&blocked, "x").is_err());
        assert!(blocked.join("in").is_dir());
        let left = std::fs::read_dir(&folder).unwrap().count();
        assert_eq!(left, 2, "a half file stayed");
        std::fs::remove_dir_all(folder).unwrap();
    }
}
