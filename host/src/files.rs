//! Files from outside: read to a bound, written whole or not at all.

use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result, Write};
use std::path::{Path, PathBuf};

/// Most bytes of a text that people or other programs write (robots, tasks, data sets): far more
/// than any real one has, and little enough to be read at once.
pub const MOST_TEXT_BYTES: u64 = 32 << 20;

/// The whole of a text file of at most [`MOST_TEXT_BYTES`].
///
/// # Errors
/// The system's; [`ErrorKind::FileTooLarge`] for a file that is longer, and for one without end;
/// [`ErrorKind::InvalidData`] for what is no UTF-8.
pub fn read_text(path: impl AsRef<Path>) -> Result<String> {
    let bytes = read_bytes(path, MOST_TEXT_BYTES)?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        Error::new(
            ErrorKind::InvalidData,
            format!("byte {at} is no UTF-8 text"),
        )
    })
}

/// The whole of a file of at most `most` bytes.
///
/// # Errors
/// As [`read_text`].
pub fn read_bytes(path: impl AsRef<Path>, most: u64) -> Result<Vec<u8>> {
    let file = File::open(path)?;
    let too_large = || {
        let reason = format!("it is longer than {most} bytes");
        Error::new(ErrorKind::FileTooLarge, reason)
    };
    if file.metadata()?.len() > most {
        return Err(too_large());
    }
    let mut bytes = Vec::new();
    // A device or a pipe says no length.
    file.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(too_large());
    }
    Ok(bytes)
}

/// Writes a file so that whoever reads it sees the old one or the new one, never half of it: beside
/// it, flushed to the disk, then renamed.
///
/// # Errors
/// The system's; what was there before stays.
pub fn write_atomically(path: &Path, contents: impl AsRef<[u8]>) -> Result<()> {
    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    let part = PathBuf::from(part);
    let write = || {
        let mut file = File::create(&part)?;
        file.write_all(contents.as_ref())?;
        file.sync_all()?;
        std::fs::rename(&part, path)
    };
    write().inspect_err(|_| {
        // Half a file must not stay, and the reason counts more than whether it could be removed.
        let _ = std::fs::remove_file(&part);
    })
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
    fn f8_a_write_that_fails_leaves_the_old_file_and_no_half_one() {
        let folder = folder("atomic");
        let path = folder.join("kept");
        write_atomically(&path, "old").unwrap();
        write_atomically(&path, "new").unwrap();
        assert_eq!(read_text(&path).unwrap(), "new");
        // A folder is in the way: the renaming fails.
        let blocked = folder.join("blocked");
        std::fs::create_dir_all(blocked.join("in")).unwrap();
        assert!(write_atomically(&blocked, "x").is_err());
        assert!(blocked.join("in").is_dir());
        let left = std::fs::read_dir(&folder).unwrap().count();
        assert_eq!(left, 2, "a half file stayed");
        std::fs::remove_dir_all(folder).unwrap();
    }
}
