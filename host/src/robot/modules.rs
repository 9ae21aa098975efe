//! Winch module files: what travels with a winch from robot to robot.

use std::path::{Component, Path, PathBuf};

/// Where the winch module files of a robot lie.
#[derive(Debug, Clone)]
pub(super) enum Modules {
    /// In the folder of the robot file.
    Folder(PathBuf),
    /// In the program, for a built-in robot.
    BuiltIn,
}

const BUILT_IN: &[(&str, &str)] = &[(
    "modules/geared-371.toml",
    include_str!("../../../robots/modules/geared-371.toml"),
)];

impl Modules {
    /// Text of the module file, with the name that messages use for it; else what is wrong and
    /// what to do about it.
    pub fn open(&self, asked: &str) -> Result<(String, String), (String, String)> {
        let inside = Path::new(asked)
            .components()
            .all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
        if !inside {
            return Err((
                format!("`module` \"{asked}\" leaves the folder of the robot file"),
                "put the module file into the robot file's folder or a folder below it, and name \
                 it relative to that"
                    .into(),
            ));
        }
        match self {
            Modules::BuiltIn => BUILT_IN
                .iter()
                .find(|(name, _)| *name == asked)
                .map(|(name, text)| ((*name).to_owned(), (*text).to_owned()))
                .ok_or_else(|| {
                    let names: Vec<&str> = BUILT_IN.iter().map(|(name, _)| *name).collect();
                    (
                        format!("there is no built-in winch module \"{asked}\""),
                        format!("the built-in ones: {}", names.join(", ")),
                    )
                }),
            Modules::Folder(folder) => read_below(folder, asked),
        }
    }
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
    let text =
        crate::files::read_text_to(&real, crate::files::MOST_ROBOT_BYTES).map_err(unreadable)?;
    Ok((path.display().to_string(), text))
}
