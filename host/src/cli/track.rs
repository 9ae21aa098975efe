//! `--track`: the slow changes of a robot, tracked while it works; `mcdpr track`: what was found.

use super::eye::Eye;
use super::table::lay_out;
use super::{Common, Failed, Outcome, print_json};
use crate::experiment::{Experiment, Looking};
use crate::motion::Model;
use crate::robot::Robot;
use crate::run::tracking::{Lesson, Tracking};
use crate::tracked::Store;
use mcdpr_core::estimate::friction::{BOUNDS, Friction};
use mcdpr_core::estimate::track::{Estimates, Known, Prior, Tracker};
use std::cell::RefCell;

/// How a robot is tracked.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Track {
    /// Track creep, lengths, sensors, masses and anchors at every rest, and plan by what is tracked; each rest takes
    /// two seconds
    #[arg(long)]
    track: bool,
    /// Look at tags of known places at every rest: with the camera that --camera names, or the simulator's
    #[arg(long, requires = "track")]
    look: bool,
    /// What the cables are made of: how they creep
    #[arg(long, value_enum, default_value_t = Cables::Polymer, requires = "track")]
    cables: Cables,
    #[command(flatten)]
    eye: Eye,
}

/// Material of the cables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Cables {
    /// UHMWPE or another polymer: creeps by tenths of a percent
    Polymer,
    /// Steel: next to no creep
    Steel,
}

/// Lengths of a calibrated robot that was homed at a taught place, m.
const HOMED_M: f64 = 3e-4;
/// Greatest shift of the planned tool by one rest, m: laps last up to a minute, in which tight cables creep by that.
const STEP_M: f64 = 2e-3;
/// Final creep of steel at the tension set-point, standard deviation, strain: a hundredth of the elastic stretch.
const STEEL_CREEP: f64 = 1e-5;

/// What is assumed of a robot before its first rest.
pub(crate) fn prior(robot: &Robot) -> Prior {
    // A robot that is known by its file alone has lengths that are right at home, whatever its anchors and cables are.
    let homed = robot.calibrated.is_none();
    let known = Prior::default();
    Prior {
        length_m: if homed { known.length_m } else { HOMED_M },
        homed,
        step_m: STEP_M,
        ..known
    }
}

impl Track {
    /// Whether the robot is tracked.
    pub(crate) const fn is_on(&self) -> bool {
        self.track
    }

    /// Refuses what does not fit together.
    ///
    /// # Errors
    /// With the reason.
    pub(crate) fn check(&self, common: &Common, resumes: bool) -> Outcome {
        if self.track && resumes {
            let reason =
                "an interrupted task is continued without it: run the next task with --track";
            return Err(Failed::from_error("--track")(reason).into());
        }
        if common.on == "sim" {
            self.eye.refused_on_simulator("--camera")?;
        }
        if self.eye.is_given() && !self.look {
            let reason = "a camera is used for --track --look only";
            return Err(Failed::from_error("--camera")(reason).into());
        }
        Ok(())
    }

    /// What is assumed before the first rest.
    pub(crate) fn prior(&self, robot: &Robot) -> Prior {
        let mut prior = prior(robot);
        if self.cables == Cables::Steel {
            prior.creep = [0.0, STEEL_CREEP];
        }
        prior
    }

    /// The camera, if one was asked for.
    ///
    /// # Errors
    /// If there is none, or the places of its tags are not known.
    pub(crate) fn looking<'a>(
        &self,
        common: &Common,
        model: &Model,
    ) -> miette::Result<Looking<'a>> {
        if !self.look {
            return Ok(Looking::Blind);
        }
        let robot = model.robot();
        let failed = |reason: &str| Failed::from_error("--look")(reason.to_owned());
        if robot.tags.is_empty() {
            return Err(failed("this robot file has no tags").into());
        }
        if common.on == "sim" {
            return Ok(Looking::Simulated);
        }
        let Some(camera) = self.eye.tags(robot, &common.page)? else {
            return Err(failed("name the camera with --camera").into());
        };
        let places = robot.calibrated.as_ref().map(|c| c.places.clone());
        let places = places.filter(|places| !places.is_empty()).ok_or_else(|| {
            failed("the places of this robot's tags are not known: calibrate first, with `mcdpr calibrate all`")
        })?;
        Ok(Looking::By((Box::new(camera), places)))
    }

    /// What is tracked: the state that was kept beside the robot file, or a new one for a simulated robot.
    ///
    /// # Errors
    /// A kept state of another robot, or a damaged one.
    pub(crate) fn start(&self, common: &Common, model: &Model) -> miette::Result<Started> {
        let prior = self.prior(model.robot());
        if common.on == "sim" {
            let tracking = Tracking::new(model, &prior);
            return Ok(Started {
                tracking,
                kept_unix_s: None,
                store: None,
            });
        }
        let store = Store::beside(&common.robot);
        let (tracking, kept_unix_s) = store.resume(model, &prior)?;
        Ok(Started {
            tracking,
            kept_unix_s,
            store: Some(store),
        })
    }
}

/// A state to go on from.
pub(crate) struct Started {
    tracking: Tracking,
    kept_unix_s: Option<u64>,
    store: Option<Store>,
}

impl Started {
    /// The model with the friction that was tracked before: plans and the board's configuration use it.
    pub(crate) fn rubbing_as_found(&self, model: Model) -> Model {
        self.tracking.rubbing_as_found(model)
    }

    /// The experiment, tracked. `rests` gets what each rest taught; the state of a real robot is kept after each.
    pub(crate) fn tracked<'a>(
        self,
        experiment: Experiment<'a>,
        looking: Looking<'a>,
        rests: &'a RefCell<Vec<Lesson>>,
    ) -> Experiment<'a> {
        let Self {
            tracking,
            kept_unix_s,
            store,
        } = self;
        let keep = store.map(|store| -> Box<dyn FnMut(&Tracking) + Send> {
            Box::new(move |tracking| {
                if let Err(error) = store.keep(tracking) {
                    eprintln!("warning: the tracked state was not kept: {error}");
                }
            })
        });
        let on_rest = |_: &Tracking, lesson: &Lesson| {
            if let Some(named) = &lesson.named {
                eprintln!("{named}");
            }
            rests.borrow_mut().push(lesson.clone());
        };
        experiment.tracked((tracking, kept_unix_s), looking, on_rest, keep)
    }
}

/// What is tracked of the robot with this file, now.
///
/// # Errors
/// Nothing is; the state is another robot's, or damaged, or of another description.
pub(crate) fn in_use(common: &Common, model: &Model) -> miette::Result<Tracking> {
    match Store::beside(&common.robot).resume(model, &prior(model.robot()))? {
        (tracking, Some(_)) => Ok(tracking),
        (_, None) => {
            let reason = "nothing is tracked of this robot yet; `mcdpr run TASK --track --on PORT` begins it";
            Err(Failed::from_error("--tracked")(reason.to_owned()).into())
        }
    }
}

/// Adds what a session on a port tracked to the history.
pub(crate) fn remember(common: &Common, task: &str, rests: &[Lesson]) {
    if common.on == "sim" || rests.is_empty() {
        return;
    }
    if let Err(error) = Store::beside(&common.robot).remember(task, rests) {
        eprintln!("warning: the history of tracked states was not continued: {error}");
    }
}

/// A session's rests in a sentence.
pub(crate) fn words(rests: &[Lesson]) -> String {
    let fit = rests.iter().filter(|lesson| lesson.fits).count();
    let seen = rests.iter().filter(|lesson| lesson.tags > 0).count();
    let step_mm: f64 = rests.iter().map(|lesson| lesson.step_mm).sum();
    let mut words = format!(
        "tracked: {} rests, {seen} with tags in view, {fit} fitted; plans moved by {step_mm:.2} mm in all",
        rests.len()
    );
    for line in rests
        .last()
        .map_or_else(Vec::new, |last| frictions(&last.frictions))
    {
        words.push('\n');
        words.push_str(&line);
    }
    words
}

/// Frictions that differ from the robot file by more than a tenth, in sentences.
fn frictions(all: &[Option<Friction>]) -> Vec<String> {
    let known = (1..)
        .zip(all)
        .filter_map(|(cable, found)| Some((cable, (*found)?)));
    let differs = known.filter(|(_, found)| {
        let by = (found.share - 1.0).abs();
        by > 0.1 && by > 2.0 * found.share_se
    });
    let words = differs.map(|(cable, found)| {
        let line = format!(
            "the winch of cable {cable} rubs {:.2} times as much as its file says (standard error {:.2})",
            found.share, found.share_se
        );
        if found.is_beyond() {
            let [least, most] = BOUNDS;
            format!(
                "{line}: beyond {least} to {most} times it is no change of temperature; look at the winch, and \
                 commission it again"
            )
        } else if (found.used() - 1.0).abs() > f64::EPSILON {
            format!("{line}; plans use it now, the board from the next tracked run on")
        } else {
            format!("{line}: not known well enough, plans keep the file's value")
        }
    });
    words.collect()
}

/// The tracked state of a robot on a port, and its history; `--back-to` uses an earlier state again
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Use the state with this number of the history again; the present one is kept there
    #[arg(long, value_name = "N", conflicts_with = "forget")]
    back_to: Option<usize>,
    /// Move the state in use into the history: tracking begins anew
    #[arg(long)]
    forget: bool,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = common.robot()?;
        let model = Model::new(&robot)?;
        let prior = prior(model.robot());
        let store = Store::beside(&common.robot);
        if common.dry_run && (self.forget || self.back_to.is_some()) {
            return Err(super::dry::refusal("track --back-to and --forget").into());
        }
        if let Some(number) = self.back_to {
            store.back_to(&model, &prior, number)?;
        }
        if self.forget {
            store.forget()?;
        }
        let (entries, torn) = store.history()?;
        let in_use = store.in_use()?;
        let state = in_use
            .as_ref()
            .map(|kept| Tracker::resume(&model, &prior, &kept.state));
        // A state of an older description is shown as what it is.
        let (state, refused) = match state {
            Some(Ok(tracker)) => (Some(tracker.estimates(&prior)), None),
            Some(Err(error)) => (None, Some(error.to_string())),
            None => (None, None),
        };
        if common.json {
            let entries: Vec<_> = entries
                .iter()
                .map(|entry| {
                    serde_json::json!({
                        "number": entry.number, "date": entry.date, "cause": entry.cause,
                        "rests": entry.rests[0], "fitted": entry.rests[1],
                        "step_m": entry.step_mm * 1e-3, "named": entry.named,
                    })
                })
                .collect();
            return print_json(&serde_json::json!({
                "file": store.file(), "history": store.history_file(),
                "kept": in_use.as_ref().map(|kept| &kept.date), "state": state, "refused": refused,
                "frictions": in_use.as_ref().map(|kept| &kept.frictions),
                "entries": entries, "torn_lines": torn,
            }));
        }
        match (&in_use, &state, refused) {
            (Some(kept), Some(state), _) => {
                say!("state of {} in use, kept {}", robot.name, kept.date);
                super::write_out(&lay_out(&rows(state)));
                say!(
                    "platform {:+.0} g (sd {:.0})",
                    state.mass_kg.value * 1e3,
                    state.mass_kg.sigma * 1e3
                );
                say!("(-): nothing that was measured has told of it yet");
                for (cable, found) in (1..).zip(&kept.frictions) {
                    if let Some(found) = found {
                        say!(
                            "friction of the winch of cable {cable}: {:.2} times that of the file (standard error {:.2})",
                            found.share,
                            found.share_se
                        );
                    }
                }
            }
            (Some(_), None, Some(refused)) => say!("the state in use does not apply: {refused}"),
            _ => say!("nothing is tracked yet; `mcdpr run TASK --track --on PORT` begins it"),
        }
        for entry in &entries {
            let [rests, fitted] = entry.rests;
            say!(
                "{}  {}  {}: {rests} rests, {fitted} fitted, plans moved by {:.2} mm{}",
                entry.number,
                entry.date,
                entry.cause,
                entry.step_mm,
                entry
                    .named
                    .iter()
                    .map(|n| format!("; {n}"))
                    .collect::<String>()
            );
        }
        for line in torn {
            say!("line {line} of the history is torn and was skipped");
        }
        Ok(())
    }
}

/// A table of the state, one row per cable.
fn rows(state: &Estimates) -> Vec<Vec<String>> {
    let head = [
        "cable",
        "anchor x, y, z, mm",
        "length, mm",
        "creep, %",
        "stiffness, %",
        "sensor gain, %",
        "sensor zero, N",
        "pulley loss, %",
    ];
    let mut table = vec![head.map(str::to_owned).to_vec()];
    let cell = |known: &Known, factor: f64| {
        let mark = if known.observed { "" } else { " (-)" };
        format!(
            "{:+.2} +-{:.2}{mark}",
            known.value * factor,
            known.sigma * factor
        )
    };
    for (number, cable) in (1..).zip(&state.cables) {
        let anchor: Vec<_> = cable
            .anchor_m
            .iter()
            .map(|known| cell(known, 1e3))
            .collect();
        table.push(vec![
            i32::to_string(&number),
            anchor.join(", "),
            cell(&cable.offset_m, 1e3),
            cell(&cable.strain, 1e2),
            cell(&cable.stiffness, 1e2),
            cell(&cable.sensor_gain, 1e2),
            cell(&cable.sensor_zero_n, 1.0),
            cell(&cable.pulley_loss, 1e2),
        ]);
    }
    table
}
