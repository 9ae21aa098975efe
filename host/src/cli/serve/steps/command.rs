//! The command line of a step, from what the page has sent.

use super::catalogue::{How, Kind, Opt, Step};
use crate::cli::Common;
use crate::hil::Wires;
use crate::machine::Controller;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Longest text of an option, bytes.
const LONGEST: usize = 300;

/// What all commands of a server have in common: its own options.
#[derive(Debug, Clone)]
pub(super) struct Base {
    robot: String,
    calibration: Option<String>,
    on: String,
    firmware: Option<PathBuf>,
    seed: u64,
    time_scale: Option<f64>,
}

impl Base {
    pub(super) fn of(common: &Common) -> Self {
        // The emulated chip and a board in the loop count as simulated robots once they were found.
        let on = match &common.controller {
            Controller::Chip(_) => "chip".to_owned(),
            Controller::Hil(wires) => format!("hil:{wires}"),
            Controller::InProcess => common.on.clone(),
        };
        Self {
            robot: common.robot.clone(),
            calibration: common.calibration.clone(),
            on,
            firmware: common.firmware.clone(),
            seed: common.seed,
            time_scale: common.time_scale,
        }
    }

    fn words(&self, has_seed: bool) -> Vec<String> {
        let mut words = vec!["--robot".to_owned(), self.robot.clone()];
        let mut add = |name: &str, value: String| words.extend([name.to_owned(), value]);
        if self.on != "sim" {
            add("--on", self.on.clone());
        }
        if let Some(file) = &self.firmware {
            add("--firmware", file.display().to_string());
        }
        if let Some(file) = &self.calibration {
            add("--calibration", file.clone());
        }
        if self.seed != 1 && !has_seed {
            add("--seed", self.seed.to_string());
        }
        if let Some(scale) = self.time_scale {
            add("--time-scale", scale.to_string());
        }
        words
    }
}

/// A command line that can be started.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Command {
    pub(super) words: Vec<String>,
    /// What it moves; empty: nothing.
    pub(super) moves: String,
    /// Files that it replaces.
    pub(super) replaces: Vec<PathBuf>,
}

impl Command {
    /// As somebody would type it.
    pub(super) fn line(&self) -> String {
        let words = self.words.iter().map(|word| {
            let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:,=+@".contains(c);
            if !word.is_empty() && word.chars().all(plain) {
                word.clone()
            } else {
                format!("'{}'", word.replace('\'', "'\\''"))
            }
        });
        let words: Vec<_> = words.collect();
        format!("mcdpr {}", words.join(" "))
    }
}

/// The command of a step with these options. `proposal` is where a calibration's result goes, `data` where its
/// measurements go.
///
/// # Errors
/// An option that does not exist, or its value, in words.
pub(super) fn command(
    step: &Step,
    given: &Value,
    base: &Base,
    proposal: &Path,
    data: &Path,
) -> Result<Command, String> {
    let known = |name: &String| step.options.iter().any(|option| option.name == name);
    if let Some(name) = given
        .as_object()
        .into_iter()
        .flat_map(|all| all.keys())
        .find(|name| !known(name))
    {
        return Err(format!("{} has no option {name}", step.id));
    }
    let has = |name: &str| !text_of(&given[name]).is_empty();
    let mut words: Vec<String> = step.words.iter().map(|word| (*word).to_owned()).collect();
    for option in step.options {
        let wanted = match (step.id, option.name) {
            // Only some of what `rig` does is done to one cable.
            ("rig", "cable") => ["attach", "spool"].contains(&text_of(&given["what"]).as_str()),
            ("rig", "length") => text_of(&given["what"]) == "spool",
            // Recorded data need no collecting.
            ("calibrate", "target" | "poses" | "candidates" | "target-error-mm" | "camera") => {
                !has("data")
            }
            // A robot on a port has its own objects.
            ("pick", "objects" | "seed") => {
                base.on == "sim" || base.on == "chip" || Wires::is_meant(&base.on)
            }
            _ => true,
        };
        if wanted {
            words.extend(option.words(&given[option.name])?);
        } else if step.id != "rig"
            && step.id != "calibrate"
            && step.id != "pick"
            && has(option.name)
        {
            return Err(format!("{} does not go with these options", option.name));
        }
    }
    let mut replaces = Vec::new();
    let moves = match step.id {
        "doctor" if given["arm"] == true => {
            "The robot arms: drives push against closed brakes, brakes open, and each \
                                             drum turns a little. Then it disarms."
        }
        "recover" if given["gentle"] == true => {
            "Where the evidence is not enough, each winch winds its cable by 0.4 mm, one after the other."
        }
        "calibrate" if has("data") => "",
        _ => step.moves,
    };
    match step.id {
        "calibrate" => {
            words.extend(["--out".to_owned(), proposal.display().to_string()]);
            if !has("data") {
                replaces.push(data.to_owned());
            }
        }
        "collect" if given["resume"] != true => replaces.push(data.to_owned()),
        "commission" | "target" => {
            let out = text_of(&given["out"]);
            let default = step.options.iter().find(|option| option.name == "out");
            let out = if out.is_empty() {
                default.map_or("", |out| out.default).to_owned()
            } else {
                out
            };
            replaces.push(PathBuf::from(out));
        }
        _ => {}
    }
    let has_seed = words.iter().any(|word| word == "--seed");
    words.extend(base.words(has_seed));
    Ok(Command {
        words,
        moves: moves.to_owned(),
        replaces,
    })
}

/// A value as text; empty for none.
fn text_of(value: &Value) -> String {
    match value {
        Value::String(text) => text.trim().to_owned(),
        Value::Number(number) => number.to_string(),
        _ => String::new(),
    }
}

impl Opt {
    /// Its words for a value; none for the default.
    fn words(&self, value: &Value) -> Result<Vec<String>, String> {
        let wrong = |reason: String| Err(format!("{}: {reason}", self.label));
        if let Kind::Flag = self.kind {
            return match value {
                Value::Null | Value::Bool(false) => Ok(Vec::new()),
                Value::Bool(true) => Ok(vec![format!("--{}", self.name)]),
                other => wrong(format!("{other} is neither true nor false")),
            };
        }
        let given = text_of(value);
        let text = if given.is_empty() {
            self.default.to_owned()
        } else {
            given
        };
        if text.len() > LONGEST || text.chars().any(char::is_control) {
            return wrong(
                "this text is too long, or has characters that a command line has not".to_owned(),
            );
        }
        let how = match self.kind {
            Kind::Choice(_, how) | Kind::Number(.., how) => how,
            Kind::Name => How::Word,
            _ => How::Named,
        };
        if text.is_empty() {
            return match how {
                How::Word => wrong("a value is missing".to_owned()),
                _ => Ok(Vec::new()),
            };
        }
        match self.kind {
            Kind::Choice(choices, _) if !choices.contains(&text.as_str()) => {
                return wrong(format!("{text} is none of {}", choices.join(", ")));
            }
            Kind::Number(least, most, whole, _) => {
                let number: Option<f64> = text.parse().ok();
                let fits = |v: &f64| (least..=most).contains(v) && (!whole || v.fract() == 0.0);
                if number.filter(fits).is_none() {
                    let whole = if whole { "whole " } else { "" };
                    return wrong(format!(
                        "{text} is not a {whole}number from {least} to {most}"
                    ));
                }
            }
            Kind::Numbers(count) => {
                let numbers: Option<Vec<f64>> = text
                    .split([' ', ','])
                    .filter(|word| !word.is_empty())
                    .map(|word| word.parse().ok())
                    .collect();
                let numbers =
                    numbers.filter(|all| all.len() == count && all.iter().all(|v| v.is_finite()));
                let Some(numbers) = numbers else {
                    return wrong(format!("{text} is not {count} numbers"));
                };
                let words = numbers.iter().map(ToString::to_string);
                return Ok(std::iter::once(format!("--{}", self.name))
                    .chain(words)
                    .collect());
            }
            Kind::File(ending) => {
                let path = Path::new(&text);
                let plain = path.file_name().is_some_and(|name| name == text.as_str());
                if !plain || path.extension().is_none_or(|found| found != ending) {
                    return wrong(format!(
                        "{text} is not a plain file name that ends with .{ending}"
                    ));
                }
            }
            // It would be taken for an option.
            Kind::Text | Kind::Name if text.starts_with('-') => {
                return wrong(format!("{text} begins with a dash"));
            }
            _ => {}
        }
        // What the command does anyway need not be said.
        let is_default = text == self.default;
        Ok(match how {
            How::Word => vec![text],
            How::Itself if is_default => Vec::new(),
            How::Itself => vec![format!("--{text}")],
            How::Named => vec![format!("--{}", self.name), text],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::catalogue::{STEPS, find};
    use super::*;
    use serde_json::json;

    fn base(on: &str) -> Base {
        Base {
            robot: "my robot.toml".to_owned(),
            calibration: None,
            on: on.to_owned(),
            firmware: None,
            seed: 7,
            time_scale: Some(5.0),
        }
    }

    fn of(id: &str, given: &Value, on: &str) -> Result<Command, String> {
        let (proposal, data) = (
            Path::new("r.calibration.new.json"),
            Path::new("r.data.json"),
        );
        command(find(id)?, given, &base(on), proposal, data)
    }

    #[test]
    fn a_command_line_is_as_somebody_would_type_it() {
        let doctor = of("doctor", &json!({}), "sim").unwrap();
        let line = "mcdpr doctor --robot 'my robot.toml' --seed 7 --time-scale 5";
        assert_eq!((doctor.line().as_str(), doctor.moves.as_str()), (line, ""));
        let arm = of("doctor", &json!({ "arm": true }), "/dev/ttyACM0").unwrap();
        assert!(arm.line().contains("doctor --arm") && arm.line().contains("--on /dev/ttyACM0"));
        assert!(arm.moves.contains("arms"));
        let rig = of(
            "rig",
            &json!({ "what": "spool", "cable": 2, "length": "-30" }),
            "sim",
        );
        assert_eq!(rig.unwrap().words[..4], ["rig", "spool", "2", "-30"]);
        let rig = of("rig", &json!({ "what": "lower", "cable": 2 }), "sim").unwrap();
        assert_eq!(rig.words[..3], ["rig", "lower", "--robot"]);
        let home = of("home", &json!({ "at": "10 -20.5, 3" }), "sim").unwrap();
        assert_eq!(home.words[..5], ["home", "--at", "10", "-20.5", "3"]);
        let track = of("track", &json!({ "laps": 5, "look": true }), "sim").unwrap();
        let words = ["run", "--track", "fitting", "--laps", "5", "--look"];
        assert_eq!(track.words[..6], words);
        // The seed of a scene stands for the server's.
        let pick = of(
            "pick",
            &json!({ "seed": 3, "knows": "ideal", "objects": 2 }),
            "sim",
        )
        .unwrap();
        let line = pick.line();
        assert!(
            line.contains("--seed 3 --ideal") && !line.contains("--seed 7"),
            "{line}"
        );
        let pick = of(
            "pick",
            &json!({ "seed": 3, "camera": "folder:here" }),
            "/dev/x",
        )
        .unwrap();
        assert!(!pick.line().contains("--objects") && pick.line().contains("--camera folder:here"));
    }

    #[test]
    fn recorded_data_move_nothing_and_a_result_replaces_nothing() {
        let all = of("calibrate", &json!({ "poses": 8 }), "sim").unwrap();
        assert!(all.line().contains("--poses 8") && !all.moves.is_empty());
        assert!(all.line().contains("--out r.calibration.new.json"));
        assert_eq!(all.replaces, [PathBuf::from("r.data.json")]);
        let solved = of("calibrate", &json!({ "poses": 8, "data": "d.json" }), "sim").unwrap();
        assert!(!solved.line().contains("--poses") && solved.moves.is_empty());
        assert!(solved.replaces.is_empty());
    }

    #[test]
    fn wrong_values_are_refused_with_the_option() {
        for (id, given, part) in [
            ("commission", json!({ "winch": 9 }), "from 1 to 8"),
            ("commission", json!({ "winch": 1.5 }), "whole number"),
            (
                "commission",
                json!({ "out": "../a.toml" }),
                "plain file name",
            ),
            ("commission", json!({ "out": "a.sh" }), ".toml"),
            ("rig", json!({ "what": "attach" }), "missing"),
            ("rig", json!({ "what": "dance" }), "none of"),
            ("home", json!({ "at": "1 2" }), "3 numbers"),
            ("verify", json!({ "poses": "--out" }), "dash"),
            ("track", json!({ "task": "--out" }), "dash"),
            ("track", json!({ "laps": 0 }), "from 1 to"),
            ("verify", json!({ "poses": "a\nb" }), "characters"),
            ("doctor", json!({ "arm": "yes" }), "neither"),
            ("doctor", json!({ "yes": true }), "no option yes"),
        ] {
            let error = of(id, &given, "sim").unwrap_err();
            assert!(error.contains(part), "{id} {given}: {error}");
        }
        assert!(of("dance", &json!({}), "sim").is_err());
    }

    #[test]
    fn the_defaults_of_every_step_are_accepted_by_its_command() {
        for step in STEPS {
            let command = of(step.id, &json!({}), "sim").unwrap();
            let words = std::iter::once("mcdpr".to_owned()).chain(command.words);
            let known = crate::cli::order::command().try_get_matches_from(words);
            assert!(known.is_ok(), "{}: {:?}", step.id, known.err());
        }
    }
}
