//! `mcdpr config init`: a short robot file from a few answers.

use super::super::{Common, Failed, Outcome, print_json};
use super::answers::{Answers, ask};
use super::frame::{Frame, GEARED_GAINS, STIFF_GAINS, Winches, complete};
use super::{physics, reserve};
use std::path::{Path, PathBuf};

/// Writes the file, checks it, and says what comes next.
pub(super) fn init(file: &Path, answers: &Answers, common: &Common) -> Outcome {
    refuse_existing(file)?;
    let answers = if answers.is_empty() {
        ask(file, None)?
    } else {
        answers.clone()
    };
    let frame = complete(file, &answers).map_err(Failed::from_error("the answers"))?;
    let failed = || Failed::from_error("writing the robot file");
    let folder = file.parent().map(PathBuf::from).unwrap_or_default();
    let mut written = Vec::new();
    if let Winches::Alike(kind) = frame.winches {
        let module = folder.join(kind.file());
        if let Some(parent) = module.parent() {
            std::fs::create_dir_all(parent).map_err(failed())?;
        }
        // An existing module file belongs to the user.
        if !module.exists() {
            let text = crate::robot::module_text(kind.file());
            let text = text.ok_or("the program lacks this module");
            let text = text.map_err(Failed::from_error("writing the robot file"))?;
            crate::files::write_atomically(&module, text).map_err(failed())?;
            written.push(module.display().to_string());
        }
    }
    let judged = finish(file, &frame, common, &mut written)?;
    if common.json {
        return print_json(&serde_json::json!({ "written": written, "physics": judged }));
    }
    for path in written {
        say!("wrote {path}");
    }
    physics::show(&judged, &file.display().to_string());
    Ok(())
}

/// Writes the robot file with gains that hold, judges the robot and draws it.
pub(super) fn finish(
    file: &Path,
    frame: &Frame,
    common: &Common,
    written: &mut Vec<String>,
) -> miette::Result<physics::Physics> {
    let failed = || Failed::from_error("writing the robot file");
    let default = if frame.from_below { STIFF_GAINS } else { "" };
    crate::files::write_atomically(file, frame.text(default)).map_err(failed())?;
    written.push(file.display().to_string());
    let name = file.display().to_string();
    let mut robot = crate::robot::find(&name)?;
    // Behind a real gear a current says little about the cable's tension (docs/tension.md).
    if robot.winches.iter().all(|winch| winch.gear.is_some()) {
        crate::files::write_atomically(file, frame.text(GEARED_GAINS)).map_err(failed())?;
        robot = crate::robot::find(&name)?;
    }
    if let Some(gains) = reserve::softer_gains(&robot) {
        crate::files::write_atomically(file, frame.text(&gains)).map_err(failed())?;
        robot = crate::robot::find(&name)?;
    }
    let judged = physics::judge(&robot)?;
    // A picture that is there already belongs to the user.
    let kind = common.plots();
    let picture = file.with_extension(kind.ending());
    if !picture.exists() {
        let drawn = crate::report::draw_robot(&robot).file(kind)?;
        crate::files::write_atomically(&picture, drawn).map_err(failed())?;
        written.push(picture.display().to_string());
    }
    Ok(judged)
}

/// # Errors
/// If the file exists.
pub(super) fn refuse_existing(file: &Path) -> Result<(), Failed> {
    if file.exists() {
        let reason = format!("{} is there already; it was not touched", file.display());
        return Err(Failed::from_error("writing the robot file")(reason));
    }
    Ok(())
}
