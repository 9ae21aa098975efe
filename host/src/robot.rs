//! Robot files: found by name or path, with the winch module files beside them.

pub use mcdpr_core::robot::*;

use crate::files::{MOST_ROBOT_BYTES, read_text_to};
use std::path::{Path, PathBuf};

/// The folder of a robot file, in which its winch module files lie.
struct Folder(PathBuf);

impl ModuleFiles for Folder {
    fn open(&self, asked: &str) -> Result<(String, String), (String, String)> {
        read_below(&self.0, asked)
    }
}

/// Text of a winch module that the program carries, by its path.
pub(crate) fn module_text(path: &str) -> Option<String> {
    BuiltInModules.open(path).ok().map(|(_, text)| text)
}

/// The texts that [`find`] reads for a robot: the robot file first, then the winch modules that it
/// names, each with its path relative to the robot file. Empty if there is no such robot.
pub fn sources(name_or_path: &str) -> Vec<(String, String)> {
    let as_path = PathBuf::from(name_or_path);
    let built_in = BUILT_IN.iter().find(|(name, _)| *name == name_or_path);
    let candidates = [
        as_path,
        PathBuf::from(format!("{name_or_path}.toml")),
        Path::new("robots").join(format!("{name_or_path}.toml")),
    ];
    let (first, rest) = candidates.split_at(1);
    let file = |paths: &[PathBuf]| paths.iter().find(|path| path.is_file()).cloned();
    let (name, text, modules) = match (file(first), built_in) {
        (None, Some((name, text))) => {
            let modules: Box<dyn ModuleFiles> = Box::new(BuiltInModules);
            (format!("{name}.toml"), (*text).to_owned(), modules)
        }
        (found, _) => {
            let Some(path) = found.or_else(|| file(rest)) else {
                return Vec::new();
            };
            let Ok(text) = read_text_to(&path, MOST_ROBOT_BYTES) else {
                return Vec::new();
            };
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let folder = path.parent().unwrap_or(Path::new("")).to_owned();
            (name.into_owned(), text, Box::new(Folder(folder)) as _)
        }
    };
    let mut files = vec![(name, text.clone())];
    let table: toml::Table = text.parse().unwrap_or_default();
    let winches = table.get("winch").and_then(toml::Value::as_array);
    let common = table.get("all_winches");
    for winch in winches.into_iter().flatten().chain(common) {
        let module = winch.get("module").and_then(toml::Value::as_str);
        let Some(asked) = module.filter(|asked| files.iter().all(|(name, _)| name != asked)) else {
            continue;
        };
        if let Ok((_, text)) = modules.open(asked) {
            files.push((asked.to_owned(), text));
        }
    }
    files
}

/// The file that [`find`] reads; `None` for a built-in robot, or if there is none.
pub(crate) fn file_of(name_or_path: &str) -> Option<PathBuf> {
    let as_path = PathBuf::from(name_or_path);
    if as_path.is_file() {
        return Some(as_path);
    }
    if BUILT_IN.iter().any(|(name, _)| *name == name_or_path) {
        return None;
    }
    let candidates = [
        PathBuf::from(format!("{name_or_path}.toml")),
        Path::new("robots").join(format!("{name_or_path}.toml")),
    ];
    candidates.into_iter().find(|path| path.is_file())
}

/// Loads a robot by path or by the name of a built-in one.
///
/// A file at that path comes first, then a built-in robot of that name, then `NAME.toml` here
/// and in `robots/`.
///
/// # Errors
/// [`RobotError::NotFound`] lists the paths that were tried and the built-in robots; otherwise as
/// [`load`].
pub fn find(name_or_path: &str) -> Result<Robot, RobotError> {
    let as_path = PathBuf::from(name_or_path);
    if as_path.is_file() {
        return load(&as_path);
    }
    if BUILT_IN.iter().any(|(name, _)| *name == name_or_path) {
        return Robot::built_in(name_or_path);
    }
    let mut tried = vec![as_path];
    if !name_or_path.is_empty() && !name_or_path.ends_with(".toml") {
        tried.push(PathBuf::from(format!("{name_or_path}.toml")));
        tried.push(Path::new("robots").join(format!("{name_or_path}.toml")));
    }
    match tried.iter().find(|path| path.exists()) {
        Some(path) => load(path),
        None => Err(RobotError::NotFound {
            asked: name_or_path.to_owned(),
            tried,
            built_in: BUILT_IN.iter().map(|(name, _)| *name).collect(),
        }),
    }
}

/// Loads the robot file at `path`; winch module files are sought from its folder on.
///
/// # Errors
/// [`RobotError::NotFound`] or [`RobotError::Unreadable`] for the file itself, and
/// [`RobotError::Invalid`] with every mistake in it.
pub fn load(path: &Path) -> Result<Robot, RobotError> {
    match read_text_to(path, MOST_ROBOT_BYTES) {
        Ok(text) => parse(&text, path),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Err(RobotError::NotFound {
            asked: path.display().to_string(),
            tried: vec![path.to_owned()],
            built_in: BUILT_IN.iter().map(|(name, _)| *name).collect(),
        }),
        Err(source) => Err(RobotError::Unreadable {
            path: path.to_owned(),
            source,
        }),
    }
}

/// Reads a robot from the text of a robot file.
///
/// `origin` names the text in messages, and winch module files are sought in its folder; it
/// need not exist.
///
/// # Errors
/// [`RobotError::Invalid`] with every mistake found: a text that is not TOML, unknown keys,
/// values of the wrong kind or range, and contradictions between keys.
pub fn parse(text: &str, origin: &Path) -> Result<Robot, RobotError> {
    let folder = origin.parent().unwrap_or(Path::new("")).to_owned();
    Robot::parse(text, &origin.display().to_string(), &Folder(folder))
}

fn read_below(folder: &Path, asked: &str) -> Result<(String, String), (String, String)> {
    let path = folder.join(asked);
    let unreadable = |error: std::io::Error| {
        (
            format!(
                "cannot read the winch module file {}: {error}",
                path.display()
            ),
            "`module` is relative to the folder of the robot file".to_owned(),
        )
    };
    let real = path.canonicalize().map_err(unreadable)?;
    // An empty folder is the current one; a link inside the folder may still point out of it.
    let home = if folder.as_os_str().is_empty() {
        Path::new(".").canonicalize()
    } else {
        folder.canonicalize()
    };
    if !real.starts_with(home.map_err(unreadable)?) {
        return Err((
            format!("`module` \"{asked}\" is a link that leaves the folder of the robot file"),
            "copy the module file into the robot file's folder".into(),
        ));
    }
    let text = read_text_to(&real, MOST_ROBOT_BYTES).map_err(unreadable)?;
    Ok((path.display().to_string(), text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use miette::Diagnostic as _;

    const LEAST: &str = r#"name = "least"
[platform]
[[cable]]
anchor_mm = [0, 0, 1000]
attachment_mm = [0, 0, 0]
[[cable]]
anchor_mm = [1000, 0, 1000]
attachment_mm = [0, 0, 0]
"#;

    #[test]
    fn a_missing_file_says_what_was_tried_and_what_there_is() {
        let error = find("no-such-robot").unwrap_err();
        let said = error.to_string();
        for part in [
            "no-such-robot,",
            "no-such-robot.toml",
            "robots/no-such-robot.toml",
        ] {
            assert!(said.contains(part), "{said}");
        }
        let help = error.help().unwrap().to_string();
        for (name, _) in BUILT_IN {
            assert!(help.contains(name), "{help}");
        }
        assert!(matches!(
            load(Path::new("missing.toml")),
            Err(RobotError::NotFound { .. })
        ));
        assert!(matches!(
            load(Path::new(env!("CARGO_MANIFEST_DIR"))),
            Err(RobotError::Unreadable { .. })
        ));
    }

    #[test]
    fn module_files_are_read_beside_the_robot_file_and_inline_keys_win() {
        let folder = std::env::temp_dir().join(format!("mcdpr-robot-{}", std::process::id()));
        std::fs::create_dir_all(folder.join("modules")).unwrap();
        let robot_path = folder.join("robot.toml");
        let with = |module: &str, robot: &str| {
            std::fs::write(folder.join("modules/w.toml"), module).unwrap();
            std::fs::write(&robot_path, format!("{LEAST}{robot}")).unwrap();
            load(&robot_path)
        };
        let use_it = "[[winch]]\nmodule = \"modules/w.toml\"\nfriction_n = 3\n[[winch]]\n";
        let robot = with("friction_n = 2\ndrum_radius_mm = 30\n", use_it).unwrap();
        assert_eq!(robot.winches[0].friction_n, 3.0, "inline wins");
        assert_eq!(robot.winches[0].drum_radius_m, 0.03, "module");
        assert_eq!(robot.winches[1].drum_radius_m, 0.02, "default");

        // A mistake in the module file is reported with the module file's name and line.
        let error = with("friction_n = 2\ndrum_radius = 30\n", use_it).unwrap_err();
        let said = error.to_string();
        assert!(
            said.contains("modules/w.toml:2: winch module: unknown key `drum_radius`"),
            "{said}"
        );
        let error = with("module = \"x.toml\"\n", use_it).unwrap_err();
        let said = error.to_string();
        let wanted = "w.toml:1: winch module: `module` does not belong";
        assert!(said.contains(wanted), "{said}");
        // The numbers of one winch stay with it, too; two winches cannot have them.
        let one = with("id = 1\nnode = 5\n", use_it).unwrap();
        assert_eq!((one.winches[0].id, one.winches[0].node), (1, 5));
        let twice = "[[winch]]\nmodule = \"modules/w.toml\"\n".repeat(2);
        let twice = format!("{twice}node = 9\n[[winch]]\nid = 2\n");
        let said = with("id = 1\n", &twice).unwrap_err().to_string();
        assert!(
            said.contains("`id` 1 is already the id of winch 1"),
            "{said}"
        );

        let error = parse(
            &format!("{LEAST}[[winch]]\nmodule = \"none.toml\"\n[[winch]]\n"),
            Path::new("my/robot.toml"),
        );
        let said = error.unwrap_err().to_string();
        let wanted = "my/robot.toml:10: winch 1: cannot read the winch module file my/none.toml";
        assert!(said.contains(wanted), "{said}");

        #[cfg(unix)]
        {
            let outside =
                std::env::temp_dir().join(format!("mcdpr-outside-{}", std::process::id()));
            std::fs::write(&outside, "friction_n = 2\n").unwrap();
            std::fs::remove_file(folder.join("modules/w.toml")).unwrap();
            std::os::unix::fs::symlink(&outside, folder.join("modules/w.toml")).unwrap();
            let error = load(&robot_path).unwrap_err();
            assert!(
                error
                    .to_string()
                    .contains("is a link that leaves the folder"),
                "{error}"
            );
            std::fs::remove_file(outside).unwrap();
        }
        std::fs::remove_dir_all(folder).unwrap();
    }
}
