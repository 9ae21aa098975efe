//! The robot file on the page: its values, a changed text with its differences, and saving.

use crate::files::{MOST_ROBOT_BYTES, read_text_to, write_atomically};
use crate::robot::{self, Robot};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// The robot that the program was started with.
pub(crate) struct RobotFile {
    name: String,
    /// Its file; `None` for a robot that the program carries.
    file: Option<PathBuf>,
}

impl RobotFile {
    /// By path or by name, as `--robot` has it.
    pub(crate) fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            file: robot::file_of(name),
        }
    }

    fn text(&self) -> Result<String, String> {
        match &self.file {
            Some(path) => read_text_to(path, MOST_ROBOT_BYTES)
                .map_err(|error| format!("{} cannot be read: {error}", path.display())),
            None => robot::sources(&self.name)
                .into_iter()
                .next()
                .map(|(_, text)| text)
                .ok_or_else(|| format!("there is no robot {}", self.name)),
        }
    }

    /// The text and its values.
    pub(super) fn read(&self) -> Result<Value, String> {
        let text = self.text()?;
        Ok(json!({
            "file": self.file.as_ref().map(|path| path.display().to_string()),
            "name": self.name,
            "settings": robot::settings(&text)?,
            "mark": mark(&text),
            "text": text,
        }))
    }

    /// Whether a text is a robot: what differs from the file, or what is wrong with it.
    pub(super) fn check(&self, text: &str) -> Result<Value, String> {
        self.parsed(text)?;
        Ok(json!({ "changes": robot::changes(&self.text()?, text)? }))
    }

    /// Replaces the file's text, which must still have the mark `before` that it was read with. The old text is
    /// kept beside it.
    pub(super) fn save(&self, text: &str, before: &str) -> Result<Value, String> {
        let Some(path) = &self.file else {
            return Err(format!(
                "{} is built into the program: `mcdpr config init FILE --copy --robot {}` makes a file of it",
                self.name, self.name
            ));
        };
        self.parsed(text)?;
        let old = self.text()?;
        if mark(&old) != before {
            return Err(format!(
                "{} was changed by someone else meanwhile: read it again",
                path.display()
            ));
        }
        let kept = with_ending(path, "before");
        let failed = |path: &Path, error: std::io::Error| format!("{}: {error}", path.display());
        write_atomically(&kept, &old).map_err(|error| failed(&kept, error))?;
        write_atomically(path, text).map_err(|error| failed(path, error))?;
        Ok(json!({ "file": path.display().to_string(), "kept": kept.display().to_string() }))
    }

    fn parsed(&self, text: &str) -> Result<Robot, String> {
        let parsed = match &self.file {
            Some(path) => robot::parse(text, path),
            None => Robot::parse(text, &self.name, &robot::BuiltInModules),
        };
        parsed.map_err(|error| error.plain_words())
    }
}

/// Distinguishes two texts of a file, CRC-32.
fn mark(text: &str) -> String {
    format!("{:08x}", mcdpr_protocol::frame::crc32(text.as_bytes()))
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(format!(".{ending}"));
    PathBuf::from(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_checked_compared_and_saved_once() {
        let folder = std::env::temp_dir().join(format!("mcdpr-robot-file-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("own.toml");
        let (_, text) = robot::BUILT_IN[0];
        // Without modules of its own: a file alone.
        std::fs::write(&path, text).unwrap();
        let file = RobotFile::new(path.to_str().unwrap());
        assert_eq!(file.read().unwrap()["text"], text);
        assert_eq!(file.check(text).unwrap()["changes"], json!([]));
        let heavier = text.replacen("mass_kg = ", "mass_kg = 1", 1);
        assert_ne!(heavier, text);
        let changes = file.check(&heavier).unwrap();
        assert_eq!(changes["changes"][0]["key"], "platform.mass_kg");
        // Nonsense is refused in words, and nothing is written.
        let wrong = text.replacen("mass_kg = ", "mass_kg = -", 1);
        assert!(file.check(&wrong).unwrap_err().contains("mass_kg"));
        let own = mark(text);
        assert!(file.save(&wrong, &own).is_err() && file.save(&heavier, "another").is_err());
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        file.save(&heavier, &own).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), heavier);
        let kept = std::fs::read_to_string(folder.join("own.toml.before")).unwrap();
        assert_eq!(kept, text);
        assert!(file.save(text, &own).unwrap_err().contains("meanwhile"));
        std::fs::remove_dir_all(&folder).unwrap();
        let built_in = RobotFile::new("lab-fast");
        let text = built_in.text().unwrap();
        assert!(
            built_in
                .save(&text, &mark(&text))
                .unwrap_err()
                .contains("config init")
        );
    }
}
