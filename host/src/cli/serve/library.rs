//! Tasks that the page offers: the built-in ones, and the files of one folder.

use crate::files::{read_text_to, write_atomically};
use crate::motion::{BUILT_IN, FITTING, GCODE_ENDINGS, Model, Task, find_task_for, is_gcode};
use crate::record::{TaskSource, task_source};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Most files that are listed.
const MOST_FILES: usize = 200;
/// Longest name of a file.
const LONGEST_NAME: usize = 60;
/// Most bytes of a file that the page edits.
pub(super) const MOST_BYTES: u64 = 48 * 1024;

/// The tasks.
#[derive(Debug, Clone)]
pub(crate) struct Library {
    folder: PathBuf,
    /// Height of the tool for the built-in tasks, world, m.
    height_m: f64,
}

impl Library {
    /// Of the files in a folder, which need not exist yet.
    pub(crate) const fn new(folder: PathBuf, height_m: f64) -> Self {
        Self { folder, height_m }
    }

    /// All tasks: name, origin, and a description of the built-in ones.
    pub(super) fn list(&self) -> Value {
        let built_in = BUILT_IN
            .iter()
            .map(|(name, about)| json!({ "name": name, "built_in": true, "about": about }));
        let files = self.files().into_iter();
        let files = files.map(|name| json!({ "name": name, "built_in": false }));
        json!({
            "folder": self.folder.display().to_string(),
            "tasks": built_in.chain(files).collect::<Vec<_>>(),
        })
    }

    fn files(&self) -> Vec<String> {
        let entries = std::fs::read_dir(&self.folder).into_iter().flatten();
        let names = entries.flatten().map(|entry| entry.file_name());
        let names = names.filter_map(|name| name.into_string().ok());
        let mut names: Vec<_> = names.filter(|name| check_name(name).is_ok()).collect();
        names.sort();
        names.truncate(MOST_FILES);
        names
    }

    /// A file's text.
    pub(super) fn read(&self, name: &str) -> Result<String, String> {
        check_name(name)?;
        read_text_to(self.folder.join(name), MOST_BYTES)
            .map_err(|error| format!("{name} cannot be read: {error}"))
    }

    /// Saves a task's text, if it is one. An existing file is only replaced on request.
    pub(super) fn save(&self, name: &str, text: &str, replace: bool) -> Result<(), String> {
        check_name(name)?;
        parse(name, text)?;
        let path = self.folder.join(name);
        if path.exists() && !replace {
            return Err(format!("{name} exists already: save again to replace it"));
        }
        let failed = |error| {
            format!(
                "{name} cannot be saved in {}: {error}",
                self.folder.display()
            )
        };
        std::fs::create_dir_all(&self.folder).map_err(failed)?;
        write_atomically(&path, text).map_err(failed)
    }

    /// A built-in task, or one from a file.
    pub(super) fn find(&self, model: &Model, name: &str) -> Result<(Task, TaskSource), String> {
        if name == FITTING || BUILT_IN.iter().any(|(known, _)| *known == name) {
            let task = find_task_for(model, name, self.height_m);
            let task = task.map_err(|error| error.to_string())?;
            return Ok((task, task_source(name, self.height_m)));
        }
        let text = self.read(name)?;
        self.of_text(name, text)
    }

    /// A task from its text.
    pub(super) fn of_text(&self, name: &str, text: String) -> Result<(Task, TaskSource), String> {
        let task = parse(name, &text)?;
        let source = TaskSource {
            name: name.to_owned(),
            text: Some(text),
            tool_z_m: self.height_m,
        };
        Ok((task, source))
    }
}

fn parse(name: &str, text: &str) -> Result<Task, String> {
    Task::parse_file(text, name.into()).map_err(|error| error.to_string())
}

/// A name of a file in the folder, not a way out of it.
fn check_name(name: &str) -> Result<(), String> {
    let path = Path::new(name);
    let is_toml = path
        .extension()
        .is_some_and(|end| end.eq_ignore_ascii_case("toml"));
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    if name.len() > LONGEST_NAME || name.starts_with('.') || !name.chars().all(plain) {
        return Err(format!(
            "{name:?} is not a file name for a task: use up to {LONGEST_NAME} letters, digits, -, _ and ."
        ));
    }
    if is_toml || is_gcode(path) {
        return Ok(());
    }
    Err(format!(
        "a task's file ends in .toml, or in .{} for G-code",
        GCODE_ENDINGS.join(", .")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = "start_mm = [0, 0, -200]\n[[leg]]\nto_mm = [50, 0, -200]\n";

    fn library(name: &str) -> Library {
        let folder = format!("mcdpr-library-{name}-{}", std::process::id());
        let folder = std::env::temp_dir().join(folder);
        let _ = std::fs::remove_dir_all(&folder);
        Library::new(folder, -0.2)
    }

    #[test]
    fn a_saved_task_is_listed_read_and_found() {
        let library = library("saved");
        library.save("line.toml", LINE, false).unwrap();
        let listed = library.list();
        let mut names = listed["tasks"].as_array().unwrap().iter();
        assert!(names.any(|task| task["name"] == "line.toml"));
        assert_eq!(library.read("line.toml").unwrap(), LINE);
        let model =
            Model::new(&crate::robot::Robot::built_in("paper-optimistic").unwrap()).unwrap();
        let (task, source) = library.find(&model, "line.toml").unwrap();
        assert_eq!((task.steps.len(), source.text.as_deref()), (1, Some(LINE)));
        assert!(library.find(&model, "paper:table8").is_ok());
        std::fs::remove_dir_all(&library.folder).unwrap();
    }

    #[test]
    fn bad_names_and_texts_are_refused_and_no_file_is_replaced_by_mistake() {
        let library = library("bad");
        for name in [
            "../line.toml",
            "a/b.toml",
            ".toml",
            "line.txt",
            "",
            "line",
            "l ine.toml",
        ] {
            assert!(library.save(name, LINE, true).is_err(), "{name}");
            assert!(library.read(name).is_err(), "{name}");
        }
        let error = library
            .save("line.toml", "start_mm = 3", false)
            .unwrap_err();
        assert!(error.contains("line.toml"), "{error}");
        assert!(!library.folder.exists(), "a refused task leaves no file");
        library.save("line.toml", LINE, false).unwrap();
        let other = LINE.replace("50", "60");
        let error = library.save("line.toml", &other, false).unwrap_err();
        assert!(error.contains("exists already"), "{error}");
        assert_eq!(library.read("line.toml").unwrap(), LINE);
        library.save("line.toml", &other, true).unwrap();
        assert_eq!(library.read("line.toml").unwrap(), other);
        std::fs::remove_dir_all(&library.folder).unwrap();
    }
}
