//! Tension experiments from a task file: how long the robot holds, and the disturbances.

use super::bench::{Action, Script};
use miette::Diagnostic;
use serde::Deserialize;
use std::path::Path;
use thiserror::Error;

/// Names of the built-in experiments, with what they are and the file that says it.
pub const BUILT_IN: &[(&str, &str, &str)] = &[
    (
        "hold",
        "hold the set-point and nothing else (the paper's static test)",
        "name = \"hold\"\nhold_s = 4\n",
    ),
    (
        "platform",
        "pull sideways on the platform with 2 N for half a second (Figure 32)",
        "name = \"platform\"\nhold_s = 4\n\n[[pull]]\non = \"platform\"\nforce_n = [2, 0, 0]\nfrom_s = 0.5\nto_s = 1\n",
    ),
    (
        "cable",
        "pull across the tension-held cable with 1 N for half a second (Figure 33)",
        "name = \"cable\"\nhold_s = 4\n\n[[pull]]\non = \"cable\"\nforce_n = [0.7, 0.7, 0]\nfrom_s = 0.5\nto_s = 1\n",
    ),
    (
        "slack",
        "let 10 mm of the tension-held cable creep off its drum within 0.2 s",
        "name = \"slack\"\nhold_s = 4\n\n[[slip]]\nlonger_mm = 10\nfrom_s = 0.5\nto_s = 0.7\n",
    ),
];

/// An experiment: a robot that holds, and its disturbances.
#[derive(Debug, Clone, PartialEq)]
pub struct Experiment {
    /// Its name.
    pub name: String,
    /// The disturbances.
    pub script: Script,
    /// First disturbance and the end of the last one, s.
    pub disturbed_s: Option<[f64; 2]>,
    /// Instructions for the operator of a real robot, in time order.
    pub prompts: Vec<Prompt>,
}

/// An instruction for the operator of a real robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Prompt {
    /// Time since the robot holds, s.
    pub at_s: f64,
    /// The instruction.
    pub text: String,
}

/// Why an experiment cannot be loaded.
#[derive(Debug, Error, Diagnostic)]
pub enum ExperimentError {
    /// Neither built in nor a file.
    #[error("there is no tension experiment {name}")]
    #[diagnostic(
        code(mcdpr::tension::experiment),
        help(
            "built in are {}; anything else must be a task file (TOML) with hold_s and [[pull]], see docs/tension.md",
            names()
        )
    )]
    Unknown {
        /// What was asked for.
        name: String,
    },
    /// The file cannot be read.
    #[error("task file {path} cannot be read")]
    #[diagnostic(code(mcdpr::tension::unreadable))]
    Unreadable {
        /// Which.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not a valid experiment.
    #[error("task file {path} is not a tension experiment: {message}")]
    #[diagnostic(
        code(mcdpr::tension::malformed),
        help(
            "it has hold_s, and [[pull]] with on, force_n, from_s, to_s, or [[slip]] with longer_mm, from_s, to_s; see docs/tension.md"
        )
    )]
    Malformed {
        /// Which.
        path: String,
        /// What is wrong.
        message: String,
    },
}

fn names() -> String {
    let names: Vec<_> = BUILT_IN.iter().map(|(name, ..)| *name).collect();
    names.join(", ")
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: Option<String>,
    hold_s: f64,
    #[serde(default)]
    pull: Vec<Pull>,
    #[serde(default)]
    slip: Vec<Slip>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Pull {
    on: String,
    cable: Option<usize>,
    force_n: [f64; 3],
    from_s: f64,
    to_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Slip {
    cable: Option<usize>,
    longer_mm: f64,
    from_s: f64,
    to_s: f64,
}

/// Longest experiment, s.
const LONGEST_S: f64 = 600.0;
/// Strongest hand, N.
const STRONGEST_N: f64 = 50.0;

impl Experiment {
    /// A built-in experiment by name, or a task file by path. `held` is the index of the default
    /// cable, of `cables` cables.
    ///
    /// # Errors
    /// [`ExperimentError`] with what is wrong.
    pub fn find(name: &str, held: usize, cables: usize) -> Result<Self, ExperimentError> {
        if let Some((_, _, text)) = BUILT_IN.iter().find(|(known, ..)| *known == name) {
            return Self::parse(text, name, held, cables);
        }
        match crate::files::read_text(Path::new(name)) {
            Ok(text) => Self::parse(&text, name, held, cables),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                Err(ExperimentError::Unknown {
                    name: name.to_owned(),
                })
            }
            Err(source) => Err(ExperimentError::Unreadable {
                path: name.to_owned(),
                source,
            }),
        }
    }

    /// Reads an experiment from the text of a file; `path` names it in messages.
    ///
    /// # Errors
    /// [`ExperimentError::Malformed`].
    pub fn parse(
        text: &str,
        path: &str,
        held: usize,
        cables: usize,
    ) -> Result<Self, ExperimentError> {
        let malformed = |message: String| ExperimentError::Malformed {
            path: path.to_owned(),
            message,
        };
        let file: File = toml::from_str(text).map_err(|error| malformed(error.to_string()))?;
        if !(0.1..=LONGEST_S).contains(&file.hold_s) {
            return Err(malformed(format!(
                "hold_s is {}, it must be 0.1 to {LONGEST_S}",
                file.hold_s
            )));
        }
        let index = |number: Option<usize>| match number {
            None => Ok(held),
            Some(n) if (1..=cables).contains(&n) => Ok(n - 1),
            Some(n) => Err(malformed(format!("there is no cable {n} of {cables}"))),
        };
        let times = |what: &str, from_s: f64, to_s: f64| {
            if from_s >= 0.0 && to_s > from_s && to_s <= file.hold_s {
                Ok(())
            } else {
                Err(malformed(format!(
                    "a {what} lasts from {from_s} s to {to_s} s; it must end after it starts and \
                     within hold_s"
                )))
            }
        };
        let mut scripts = Vec::new();
        let mut prompts = Vec::new();
        let mut disturbed_s: Option<[f64; 2]> = None;
        for pull in &file.pull {
            times("pull", pull.from_s, pull.to_s)?;
            let size = pull.force_n.iter().map(|f| f * f).sum::<f64>().sqrt();
            // Negated, so that a size that is not a number is refused as well.
            if !(size > 0.0 && size <= STRONGEST_N) {
                return Err(malformed(format!(
                    "a pull has {size} N; it must be over 0 and at most {STRONGEST_N} N"
                )));
            }
            let what = match pull.on.as_str() {
                "platform" => {
                    scripts.push(Script::platform_pull(
                        pull.force_n,
                        pull.from_s,
                        pull.to_s,
                        file.hold_s,
                    ));
                    "on the platform".to_owned()
                }
                "cable" => {
                    let cable = index(pull.cable)?;
                    let script = Script::cable_pull(
                        cable,
                        pull.force_n,
                        pull.from_s,
                        pull.to_s,
                        file.hold_s,
                    );
                    scripts.push(script);
                    format!("across cable {}", cable + 1)
                }
                other => {
                    return Err(malformed(format!(
                        "a pull is on \"platform\" or \"cable\", not on \"{other}\""
                    )));
                }
            };
            let prompt = |at_s, text| Prompt { at_s, text };
            let begin = format!("pull {what} with {size:.1} N now");
            prompts.push(prompt(pull.from_s, begin));
            prompts.push(prompt(pull.to_s, "let go now".to_owned()));
            disturbed_s = Some(merge(disturbed_s, pull.from_s, pull.to_s));
        }
        for slip in &file.slip {
            times("slip", slip.from_s, slip.to_s)?;
            let cable = index(slip.cable)?;
            if !(slip.longer_mm.abs() > 0.0 && slip.longer_mm.abs() <= 100.0) {
                return Err(malformed(format!(
                    "a slip is {} mm; it must be at most 100 mm, and not 0",
                    slip.longer_mm
                )));
            }
            scripts.push(Script::slip(
                cable,
                slip.longer_mm * 1e-3,
                slip.from_s,
                slip.to_s,
                file.hold_s,
            ));
            let text = format!(
                "give cable {} {} mm of slack now",
                cable + 1,
                slip.longer_mm
            );
            prompts.push(Prompt {
                at_s: slip.from_s,
                text,
            });
            disturbed_s = Some(merge(disturbed_s, slip.from_s, slip.to_s));
        }
        let mut hands: Vec<Action> = scripts.into_iter().flat_map(|s| s.hands).collect();
        // Pulls and slips may overlap: their actions are put in the order of time.
        hands.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        prompts.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        Ok(Self {
            name: file.name.unwrap_or_else(|| path.to_owned()),
            script: Script {
                hands,
                duration_s: file.hold_s,
            },
            disturbed_s,
            prompts,
        })
    }
}

fn merge(known: Option<[f64; 2]>, from_s: f64, to_s: f64) -> [f64; 2] {
    known.map_or([from_s, to_s], |[a, b]| [a.min(from_s), b.max(to_s)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_experiment_reads() {
        for (name, ..) in BUILT_IN {
            let experiment = Experiment::find(name, 3, 4).unwrap();
            assert_eq!(&experiment.name, name);
            assert!(experiment.script.duration_s > 0.0);
        }
        let pull = Experiment::find("platform", 3, 4).unwrap();
        assert_eq!(pull.disturbed_s, Some([0.5, 1.0]));
        assert_eq!(pull.prompts.len(), 2);
    }

    #[test]
    fn mistakes_are_named() {
        let wrong = |text: &str| {
            Experiment::parse(text, "t.toml", 3, 4)
                .unwrap_err()
                .to_string()
        };
        assert!(wrong("hold_s = 0").contains("hold_s is 0"));
        assert!(wrong("hold_s = 2\nspeed = 1").contains("unknown field"));
        let pull = |on: &str, force: &str, to: f64| {
            wrong(&format!(
                "hold_s = 2\n[[pull]]\non = \"{on}\"\nforce_n = {force}\nfrom_s = 1\nto_s = {to}"
            ))
        };
        assert!(pull("drum", "[1, 0, 0]", 1.5).contains("not on \"drum\""));
        assert!(pull("platform", "[0, 0, 0]", 1.5).contains("0 N"));
        assert!(pull("platform", "[nan, 0, 0]", 1.5).contains("NaN N"));
        assert!(pull("platform", "[1, 0, 0]", 0.5).contains("must end after"));
        let slip = "hold_s = 2\n[[slip]]\ncable = 9\nlonger_mm = 1\nfrom_s = 0\nto_s = 1";
        assert!(wrong(slip).contains("no cable 9"));
        assert!(matches!(
            Experiment::find("nothing-of-that-name", 3, 4),
            Err(ExperimentError::Unknown { .. })
        ));
    }
}
