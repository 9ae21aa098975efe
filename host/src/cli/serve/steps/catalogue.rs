//! The steps that the page offers, with the words of their commands.

use serde_json::{Value, json};

/// A step: a command with the options that matter.
pub(super) struct Step {
    /// Its name in messages.
    pub(super) id: &'static str,
    /// Where the page has it.
    pub(super) tab: &'static str,
    pub(super) title: &'static str,
    /// What it is for, one sentence.
    pub(super) purpose: &'static str,
    /// What it moves, for the question before it starts; empty: nothing moves.
    pub(super) moves: &'static str,
    pub(super) words: &'static [&'static str],
    pub(super) options: &'static [Opt],
    /// Whether the command has a live page (`--serve`).
    pub(super) live: bool,
}

/// An option of a step.
pub(super) struct Opt {
    pub(super) name: &'static str,
    pub(super) label: &'static str,
    pub(super) kind: Kind,
    pub(super) default: &'static str,
}

/// Values that an option may have, and how they stand on the command line.
pub(super) enum Kind {
    /// `--name`, or nothing.
    Flag,
    /// One of these.
    Choice(&'static [&'static str], How),
    /// A number from, to; whole or not.
    Number(f64, f64, bool, How),
    /// So many numbers, mm.
    Numbers(usize),
    /// A file to read, or another text.
    Text,
    /// The same, as a word alone.
    Name,
    /// A file to write, beside the program: a plain name with this ending.
    File(&'static str),
}

/// How a value stands on the command line.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum How {
    /// As `--name value`.
    Named,
    /// As a word alone.
    Word,
    /// As `--value`, unless it is the default.
    Itself,
}

use How::{Itself, Named, Word};
use Kind::{Choice, File, Flag, Name, Number, Numbers, Text};

const fn opt(name: &'static str, label: &'static str, kind: Kind, default: &'static str) -> Opt {
    Opt {
        name,
        label,
        kind,
        default,
    }
}

/// Cables of the largest robot.
const MOST_CABLES: f64 = 8.0;
const TAGS: &[&str] = &["robot", "tag", "board", "loose"];
const CAMERA: Opt = opt(
    "camera",
    "Camera beside a robot on a port, such as folder:pictures",
    Text,
    "",
);

/// All steps in their order.
pub(super) const STEPS: &[Step] = &[
    Step {
        id: "doctor",
        tab: "setup",
        title: "Doctor",
        purpose: "Checks port, board, firmware, drives, encoders, tensions and brakes, and says what to do.",
        moves: "",
        words: &["doctor"],
        options: &[opt(
            "arm",
            "Then arm the hanging robot and disarm it again",
            Flag,
            "",
        )],
        live: false,
    },
    Step {
        id: "recover",
        tab: "setup",
        title: "Recover after a loss of power",
        purpose: "Finds where the tool is after a loss of power and tells the board, or says what to measure.",
        moves: "",
        words: &["recover"],
        options: &[
            opt(
                "untouched",
                "Nobody touched drums, brakes or platform without power",
                Flag,
                "",
            ),
            opt(
                "together",
                "Computer and robot lost their supply at the same time",
                Flag,
                "",
            ),
            opt(
                "gentle",
                "Where that is not enough: wind each cable by 0.4 mm",
                Flag,
                "",
            ),
            opt(
                "bound-mm",
                "Largest error that the task allows, mm",
                Number(0.1, 100.0, false, Named),
                "5",
            ),
            CAMERA,
        ],
        live: false,
    },
    Step {
        id: "commission",
        tab: "setup",
        title: "Commission a winch",
        purpose: "Brings up one bare winch: finds its drive, directions, brake and sensor zero; writes its module file.",
        moves: "This winch turns, slowly, at most three eighths of a turn, and pushes against its brake. No cable may be on its drum; a weight is asked for at the end.",
        words: &["commission"],
        options: &[
            opt("winch", "Winch", Number(1.0, MOST_CABLES, true, Word), "1"),
            opt(
                "node",
                "Number of its drive, if several answer",
                Number(0.0, 127.0, true, Named),
                "",
            ),
            opt(
                "out",
                "Module file to write",
                File("toml"),
                "winch-module.toml",
            ),
            opt(
                "weight-kg",
                "Weight to hang on the drum at the end, for the gear's loss, kg",
                Number(0.0, 100.0, false, Named),
                "",
            ),
            opt(
                "temperature-c",
                "Temperature at the winch, degrees Celsius",
                Number(-40.0, 100.0, false, Named),
                "",
            ),
        ],
        live: true,
    },
    Step {
        id: "rig",
        tab: "setup",
        title: "Rig",
        purpose: "Puts cables on the robot: spools and attaches them, tensions them evenly, or lowers the platform.",
        moves: "Winches turn and cables are pulled. Each part of it asks before it moves.",
        words: &["rig"],
        options: &[
            opt(
                "what",
                "What to do",
                Choice(&["tension", "attach", "spool", "lower"], Word),
                "tension",
            ),
            opt(
                "cable",
                "Cable (attach, spool)",
                Number(1.0, MOST_CABLES, true, Word),
                "",
            ),
            opt(
                "length",
                "Length, mm, paid out positive (spool)",
                Number(-1000.0, 1000.0, false, Word),
                "",
            ),
        ],
        live: true,
    },
    Step {
        id: "home",
        tab: "setup",
        title: "Home",
        purpose: "Sets the board's cable lengths from the place where the tool hangs now; nothing moves.",
        moves: "",
        words: &["home"],
        options: &[opt(
            "at",
            "The tool hangs here, mm (x y z); without it, at the robot file's home",
            Numbers(3),
            "",
        )],
        live: false,
    },
    Step {
        id: "target",
        tab: "setup",
        title: "Calibration: print the target",
        purpose: "Draws the tags to print, at true scale, and the lines for the robot file.",
        moves: "",
        words: &["calibrate", "target"],
        options: &[
            opt("target", "Target", Choice(TAGS, Word), "board"),
            opt("paper", "Paper", Choice(&["a4", "a3", "one"], Named), "a4"),
            opt("out", "File to write", File("svg"), "target.svg"),
        ],
        live: false,
    },
    Step {
        id: "collect",
        tab: "setup",
        title: "Calibration: collect",
        purpose: "Drives to well-chosen poses, waits for rest, and measures lengths, tensions and tags.",
        moves: "The robot arms and moves to every pose.",
        words: &["calibrate", "collect"],
        options: &[
            opt("target", "Tags on the floor", Choice(TAGS, Named), "board"),
            opt("poses", "Poses", Number(1.0, 200.0, true, Named), "20"),
            opt(
                "candidates",
                "Poses to choose from",
                Number(10.0, 5000.0, true, Named),
                "300",
            ),
            opt(
                "target-error-mm",
                "Stop below this expected error, mm",
                Number(0.01, 100.0, false, Named),
                "",
            ),
            opt("resume", "Continue with the poses of the file", Flag, ""),
            CAMERA,
        ],
        live: true,
    },
    Step {
        id: "calibrate",
        tab: "setup",
        title: "Calibration: solve",
        purpose: "Finds anchors, initial lengths, camera and tags: from recorded data, or collecting them first.",
        moves: "Without recorded data the robot arms and moves to every pose.",
        words: &["calibrate", "all"],
        options: &[
            opt(
                "data",
                "Recorded data; without a file they are collected first",
                Text,
                "",
            ),
            opt("target", "Tags on the floor", Choice(TAGS, Named), "board"),
            opt("poses", "Poses", Number(1.0, 200.0, true, Named), "20"),
            opt(
                "candidates",
                "Poses to choose from",
                Number(10.0, 5000.0, true, Named),
                "300",
            ),
            opt(
                "target-error-mm",
                "Stop below this expected error, mm",
                Number(0.01, 100.0, false, Named),
                "",
            ),
            CAMERA,
        ],
        live: true,
    },
    Step {
        id: "tune",
        tab: "setup",
        title: "Tune the tension loop",
        purpose: "Finds good gains: the robot holds, steps its set-point, and a model is fitted to the response.",
        moves: "The robot arms, and the tension of the tension-held cable steps up and down.",
        words: &["tune", "tension"],
        options: &[opt(
            "step-n",
            "Height of the steps, N",
            Number(0.1, 100.0, false, Named),
            "2",
        )],
        live: true,
    },
    Step {
        id: "check",
        tab: "setup",
        title: "Check the calibration",
        purpose: "Checks on the running robot that its calibration still holds, and names a cable that slipped.",
        moves: "The robot arms, moves to a few places and back.",
        words: &["calibrate", "check"],
        options: &[
            opt(
                "places",
                "Places, the present one included",
                Number(1.0, 9.0, true, Named),
                "5",
            ),
            opt("no-tags", "Without the tags", Flag, ""),
            CAMERA,
        ],
        live: true,
    },
    Step {
        id: "verify",
        tab: "setup",
        title: "Verify the calibration",
        purpose: "Compares the calibration with poses measured by other means, such as an external camera.",
        moves: "",
        words: &["calibrate", "verify"],
        options: &[opt(
            "poses",
            "CSV file with the measured poses",
            Text,
            "poses.csv",
        )],
        live: false,
    },
    Step {
        id: "track",
        tab: "setup",
        title: "Work and track changes",
        purpose: "Does a task again and again, takes note of every rest, and plans by what it learns: creep, sensors, knocks, friction.",
        moves: "The robot arms and does the task as many times as you ask for.",
        words: &["run", "--track"],
        options: &[
            opt("task", "Task: a name, or a file", Name, "fitting"),
            opt("laps", "Times", Number(1.0, 10_000.0, true, Named), "3"),
            opt(
                "look",
                "Look at tags of known places at every rest",
                Flag,
                "",
            ),
            CAMERA,
        ],
        live: true,
    },
    Step {
        id: "tracked",
        tab: "setup",
        title: "What was tracked",
        purpose: "Shows the tracked state of a robot on a port and its history; uses an earlier state again, or begins anew.",
        moves: "",
        words: &["track"],
        options: &[
            opt(
                "back-to",
                "Use the state with this number of the history",
                Number(1.0, 1e6, true, Named),
                "",
            ),
            opt(
                "forget",
                "Begin anew; the state in use is kept in the history",
                Flag,
                "",
            ),
        ],
        live: false,
    },
    Step {
        id: "pick",
        tab: "pick",
        title: "Pick",
        purpose: "Picks objects from a tray until it is empty: look, choose, take, verify, carry, release.",
        moves: "The robot arms and picks. It repeats by itself until the tray is empty or it gives up.",
        words: &["pick"],
        options: &[
            opt(
                "objects",
                "Objects in the simulated tray",
                Number(1.0, 20.0, true, Named),
                "3",
            ),
            opt("clutter", "Objects touch and lie on each other", Flag, ""),
            opt(
                "seed",
                "Seed of scene, machine and noise",
                Number(0.0, 1e9, true, Named),
                "",
            ),
            opt(
                "attempts",
                "Give up after so many attempts",
                Number(1.0, 1000.0, true, Named),
                "",
            ),
            opt(
                "knows",
                "Parameters",
                Choice(&["calibrated", "nominal", "ideal"], Itself),
                "calibrated",
            ),
            opt("task", "Task", Choice(&["tray", "paper"], Named), "tray"),
            opt(
                "views",
                "Views before each choice",
                Number(1.0, 3.0, true, Named),
                "1",
            ),
            opt("fixed-jaws", "The jaws do not turn", Flag, ""),
            opt("far-only", "No second look from nearby", Flag, ""),
            opt("no-mat", "No printed tags under the objects", Flag, ""),
            opt(
                "tray-mm",
                "Middle of the tray's floor, mm (x y z)",
                Numbers(3),
                "",
            ),
            opt("release-mm", "Release place, mm (x y z)", Numbers(3), ""),
            opt(
                "network",
                "Weights of a grasp network (ONNX file)",
                Text,
                "",
            ),
            opt(
                "head",
                "Format of that network",
                Choice(&["", "affga", "ggcnn"], Named),
                "",
            ),
            CAMERA,
        ],
        live: true,
    },
];

/// A step by its name.
pub(super) fn find(id: &str) -> Result<&'static Step, String> {
    let found = STEPS.iter().find(|step| step.id == id);
    found.ok_or_else(|| format!("there is no step {id}"))
}

/// The steps for the page.
pub(super) fn listed() -> Value {
    let steps = STEPS.iter().map(|step| {
        let options = step.options.iter().map(Opt::listed);
        json!({
            "id": step.id, "tab": step.tab, "title": step.title, "purpose": step.purpose,
            "options": options.collect::<Vec<_>>(),
        })
    });
    steps.collect()
}

impl Opt {
    fn listed(&self) -> Value {
        let mut listed = json!({ "name": self.name, "label": self.label, "default": self.default });
        let rest = match self.kind {
            Flag => json!({ "kind": "flag" }),
            Choice(choices, _) => json!({ "kind": "choice", "choices": choices }),
            Number(least, most, whole, _) => {
                json!({ "kind": "number", "least": least, "most": most, "whole": whole })
            }
            Numbers(count) => json!({ "kind": "numbers", "count": count }),
            Text | Name | File(_) => json!({ "kind": "text" }),
        };
        if let (Some(all), Value::Object(rest)) = (listed.as_object_mut(), rest) {
            all.extend(rest);
        }
        listed
    }
}
