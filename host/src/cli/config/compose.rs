//! `mcdpr config compose`: a robot from winch modules that exist.
//!
//! The robot file names each module's file and repeats none of its values: they stay with the module, whichever robot it
//! belongs to.

use super::super::{Common, Failed, Outcome, print_json};
use super::answers::{Answers, ask, can_ask};
use super::frame::{OwnWinch, Winches, complete};
use super::{init, physics};
use crate::motion::Model;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The modules of a robot.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Modules {
    /// Folder of the module files, in the folder of the new robot file or below it; all of them are used, by their `id`
    /// and then by name
    #[arg(long, value_name = "DIR")]
    modules: PathBuf,
    /// A module file of that folder, with or without .toml; once for each cable, in order
    #[arg(long, value_name = "NAME")]
    module: Vec<String>,
}

/// A module file.
#[derive(Debug, Clone)]
struct Found {
    /// Its name in the folder.
    name: String,
    id: Option<u8>,
    node: Option<u8>,
}

/// Writes the file, checks it, and says what comes next.
pub(super) fn compose(
    file: &Path,
    modules: &Modules,
    answers: &Answers,
    common: &Common,
) -> Outcome {
    init::refuse_existing(file)?;
    let bad = |reason: String| Failed::from_error("the modules")(reason);
    if answers.winch.is_some() {
        let reason = "the winches are those of the module files: leave out --winch";
        return Err(bad(reason.to_owned()).into());
    }
    let below = below(file, &modules.modules).map_err(bad)?;
    let found = modules.find().map_err(bad)?;
    let answers = if answers.is_empty() && can_ask() {
        ask(file, Some(found.len()))?
    } else {
        answers.clone()
    };
    let mut frame = complete(file, &answers).map_err(Failed::from_error("the answers"))?;
    modules.one_each(&found, frame.cables.len()).map_err(bad)?;
    unlike(&found).map_err(bad)?;
    frame.winches = Winches::Own(numbered(&found, &below).map_err(bad)?);
    // Everything that is wrong with a module is found before the file is written.
    let robot = crate::robot::parse(&frame.text(""), file)?;
    let sensors = robot.winches.iter().map(|winch| winch.tension_max_n);
    frame.most_n = sensors.fold(f64::MAX, f64::min);
    let mut written = Vec::new();
    let judged = init::finish(file, &frame, common, &mut written)?;
    let used: Vec<&str> = found.iter().map(|found| found.name.as_str()).collect();
    if common.json {
        return print_json(
            &serde_json::json!({ "written": written, "modules": used, "physics": judged }),
        );
    }
    for path in written {
        say!("wrote {path}");
    }
    for (index, found) in used.iter().enumerate() {
        say!("cable {}: {found}", index + 1);
    }
    physics::show(&judged, &file.display().to_string());
    say!("the modules keep their constants: of the robot only the frame is to be identified");
    if Model::new(&robot)?.comes_to_rest("collecting").is_ok() {
        say!("by mcdpr calibrate frame, with a camera on the platform");
    }
    Ok(())
}

impl Modules {
    /// The module files, in the order of the cables.
    fn find(&self) -> Result<Vec<Found>, String> {
        let folder = self.modules.display();
        let mut names: Vec<String> = std::fs::read_dir(&self.modules)
            .map_err(|error| format!("{folder}: {error}"))?
            .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
            .filter(|name| name.ends_with(".toml"))
            .collect();
        names.sort();
        if names.is_empty() {
            return Err(format!("{folder} has no module files (.toml)"));
        }
        if self.module.is_empty() {
            let found = names.iter().map(|name| self.read(name));
            let mut found: Vec<Found> = found.collect::<Result<_, _>>()?;
            found.sort_by_key(|found| found.id.unwrap_or(u8::MAX));
            return Ok(found);
        }
        let mut used = BTreeSet::new();
        let mut found = Vec::new();
        for asked in &self.module {
            let name = names
                .iter()
                .find(|name| *name == asked || name.strip_suffix(".toml") == Some(asked))
                .ok_or_else(|| {
                    format!(
                        "--module {asked}: {folder} has no such file; there are {}",
                        names.join(", ")
                    )
                })?;
            if !used.insert(name) {
                return Err(format!(
                    "--module {asked}: it is named twice, and a winch drives one cable"
                ));
            }
            found.push(self.read(name)?);
        }
        Ok(found)
    }

    /// What a file says about itself. Its keys and values are checked with the whole robot.
    fn read(&self, name: &str) -> Result<Found, String> {
        let path = self.modules.join(name);
        let text = crate::files::read_text(&path)
            .map_err(|error| format!("{}: {error}", path.display()))?;
        let table: toml::Table = text
            .parse()
            .map_err(|error| format!("{} is not a module file: {error}", path.display()))?;
        if table.is_empty() {
            return Err(format!(
                "{} is not a module file: it has no key of a winch (docs/robot-file.md)",
                path.display()
            ));
        }
        let number = |key: &str| {
            let number = table.get(key).and_then(toml::Value::as_integer);
            number.and_then(|number| u8::try_from(number).ok())
        };
        Ok(Found {
            name: name.to_owned(),
            id: number("id"),
            node: number("node"),
        })
    }

    /// Every cable has a module, and every module a cable.
    fn one_each(&self, found: &[Found], cables: usize) -> Result<(), String> {
        let names: Vec<&str> = found.iter().map(|found| found.name.as_str()).collect();
        let folder = self.modules.display();
        if let Some(cable) = (found.len() < cables).then_some(found.len() + 1) {
            return Err(format!(
                "cable {cable} has no module: the frame has {cables} cables, and {folder} gives {} ({})",
                found.len(),
                names.join(", ")
            ));
        }
        names.get(cables).map_or(Ok(()), |name| {
            Err(format!(
                "{name} has no cable: the frame has {cables} cables, and {folder} gives {}; name the modules to use \
                 with --module NAME, once for each cable",
                found.len()
            ))
        })
    }
}

/// The folder as robot files name it: relative to their own.
fn below(file: &Path, modules: &Path) -> Result<PathBuf, String> {
    let folder = match file.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let whole = |path: &Path| {
        path.canonicalize()
            .map_err(|error| format!("{}: {error}", path.display()))
    };
    let (here, there) = (whole(folder)?, whole(modules)?);
    let below = there.strip_prefix(&here).map_err(|_| {
        format!(
            "{} is not in the folder of {} or below it, where a robot file may name modules: write the robot file beside \
             that folder",
            modules.display(),
            file.display()
        )
    })?;
    Ok(below.to_owned())
}

/// Refuses two modules with one number.
fn unlike(found: &[Found]) -> Result<(), String> {
    for (index, module) in found.iter().enumerate() {
        for other in &found[..index] {
            let both = [
                ("id", module.id, other.id, "every winch"),
                ("node", module.node, other.node, "every drive on the bus"),
            ];
            for (key, number, same, what) in both {
                if let Some(number) = number.filter(|number| Some(*number) == same) {
                    return Err(format!(
                        "{}: `{key}` {number} is already that of {}; give {what} its own",
                        module.name, other.name
                    ));
                }
            }
        }
    }
    Ok(())
}

/// Gives the modules without numbers those that are free.
fn numbered(found: &[Found], below: &Path) -> Result<Vec<OwnWinch>, String> {
    let mut ids: BTreeSet<u8> = found.iter().filter_map(|found| found.id).collect();
    let mut nodes: BTreeSet<u8> = found.iter().filter_map(|found| found.node).collect();
    let free = |used: &mut BTreeSet<u8>, wanted: u8| {
        let number = std::iter::once(wanted)
            .chain(1..=u8::MAX)
            .find(|number| *number > 0 && !used.contains(number))
            .ok_or("there are too many modules")?;
        used.insert(number);
        Ok::<u8, String>(number)
    };
    let winch = |found: &Found| {
        let id = match found.id {
            Some(id) => id,
            None => free(&mut ids, 1)?,
        };
        let node = match found.node {
            Some(node) => node,
            // A drive has the number of its winch, if no other one has.
            None => free(&mut nodes, id)?,
        };
        let file = below.join(&found.name);
        let parts: Vec<_> = file
            .components()
            .map(|part| part.as_os_str().to_string_lossy().into_owned())
            .collect();
        Ok(OwnWinch {
            file: parts.join("/"),
            id: (id, found.id.is_some()),
            node: (node, found.node.is_some()),
        })
    };
    found.iter().map(winch).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modules_keep_their_numbers_and_others_get_free_ones() {
        let found = |name: &str, id, node| Found {
            name: name.to_owned(),
            id,
            node,
        };
        let list = [
            found("a.toml", Some(2), None),
            found("b.toml", None, Some(2)),
            found("c.toml", None, None),
        ];
        let winches = numbered(&list, Path::new("modules")).unwrap();
        let numbers: Vec<_> = winches.iter().map(|w| (w.id, w.node)).collect();
        let wanted = [
            ((2, true), (1, false)),
            ((1, false), (2, true)),
            ((3, false), (3, false)),
        ];
        assert_eq!(numbers, wanted);
        assert_eq!(winches[0].file, "modules/a.toml");
    }
}
