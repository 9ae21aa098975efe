//! Winch module files: the values that belong to a winch, whichever robot it is used in.

use std::path::{Component, Path};

/// Opens the winch module files that a robot file names.
pub trait ModuleFiles {
    /// Text of the module file `asked`, a path relative to the robot file that stays in its folder,
    /// with the name that messages use for it.
    ///
    /// # Errors
    /// What is wrong, and the remedy.
    fn open(&self, asked: &str) -> Result<(String, String), (String, String)>;
}

/// The module files that the program carries for its built-in robots.
#[derive(Debug, Clone, Copy)]
pub struct BuiltInModules;

const BUILT_IN: &[(&str, &str)] = &[
    (
        "modules/geared-371.toml",
        include_str!("../../../robots/modules/geared-371.toml"),
    ),
    (
        "modules/fast-27.toml",
        include_str!("../../../robots/modules/fast-27.toml"),
    ),
];

impl ModuleFiles for BuiltInModules {
    fn open(&self, asked: &str) -> Result<(String, String), (String, String)> {
        BUILT_IN
            .iter()
            .find(|(name, _)| *name == asked)
            .map(|(name, text)| ((*name).to_owned(), (*text).to_owned()))
            .ok_or_else(|| {
                let names: Vec<&str> = BUILT_IN.iter().map(|(name, _)| *name).collect();
                (
                    format!("there is no built-in winch module \"{asked}\""),
                    format!("the built-in ones: {}", names.join(", ")),
                )
            })
    }
}

/// Opens a module file, if its path stays in the robot file's folder.
pub(super) fn open(
    modules: &dyn ModuleFiles,
    asked: &str,
) -> Result<(String, String), (String, String)> {
    // A robot file of unknown origin must not read files outside its folder.
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
    modules.open(asked)
}
