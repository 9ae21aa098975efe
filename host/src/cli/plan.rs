//! `mcdpr plan TASK`: plans, judges and draws a task; nothing is connected.

use super::run::tool_height_m;
use super::table::{COLUMNS, lay_out, wrap};
use super::{Common, Failed, Outcome, print_json};
use crate::chart::PlotFormat;
use crate::motion::{
    Extremes, Margin, Model, Plan, PlanOptions, Planner, Shaping, Task, Tensioning, Watch,
};
use crate::report::{RunFolder, plan_figure};
use mcdpr_core::estimate::tube::{Belief, Doubts, Tube};
use nalgebra::Vector3;
use std::path::{Path, PathBuf};

/// Plan a task, report its margin to every limit, and draw it; nothing moves
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Name of a built-in task, or a task file (TOML or G-code)
    task: String,
    /// Height of a built-in task: that of a level platform's origin; the tool is below it
    #[arg(long, value_name = "MM", default_value_t = -100.0, allow_negative_numbers = true)]
    z_mm: f64,
    #[command(flatten)]
    options: Options,
    /// Draw the plan into this file, too: .svg, .png (300 dpi at a column of 85 mm) or .pdf
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// A position in the world, mm, that the platform's camera must keep in its picture
    #[arg(long, num_args = 3, value_names = ["X", "Y", "Z"], allow_negative_numbers = true)]
    keep_in_view: Option<Vec<f64>>,
    #[command(flatten)]
    known: Known,
    /// Plan by what was tracked of the robot with this file (`run --track`), and state the tube by it
    #[arg(long, conflicts_with = "anchors_within_mm")]
    tracked: bool,
}

/// What is known of the machine, for the tube around the path.
#[derive(Debug, Clone, Copy, PartialEq, clap::Args)]
pub(crate) struct Known {
    /// Within how many mm the robot file's anchors are known, where no calibration is applied
    #[arg(long, value_name = "MM", default_value_t = 5.0)]
    anchors_within_mm: f64,
    /// A load that the tool may carry, up to this mass
    #[arg(long, value_name = "KG", default_value_t = 0.0)]
    payload_kg: f64,
}

impl Default for Known {
    fn default() -> Self {
        Self {
            anchors_within_mm: 5.0,
            payload_kg: 0.0,
        }
    }
}

impl Known {
    pub(crate) fn belief(&self, robot: &crate::robot::Robot) -> miette::Result<Belief> {
        for (name, value, most) in [
            ("--anchors-within-mm", self.anchors_within_mm, 1000.0),
            ("--payload-kg", self.payload_kg, 1000.0),
        ] {
            if !(0.0..=most).contains(&value) {
                let reason = format!("{value}: give 0 to {most}");
                return Err(Failed::from_error(name)(reason).into());
            }
        }
        let doubts = doubts(self.anchors_within_mm, self.payload_kg);
        Ok(Belief::of(robot, &doubts))
    }
}

/// A machine built by hand, its anchors known within this half width.
pub(crate) fn doubts(anchors_within_mm: f64, payload_kg: f64) -> Doubts {
    Doubts {
        payload_kg,
        ..Doubts::within(anchors_within_mm * 1e-3)
    }
}

/// How to plan.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(crate) struct Options {
    /// Model of the platform
    #[arg(long, value_enum, default_value_t = Planner::Equilibrium)]
    planner: Planner,
    /// Shape the motion against swing
    #[arg(long, value_enum, default_value_t = Shaping::None)]
    shaping: Shaping,
    /// Tension of the tension-held cable
    #[arg(long, value_enum, default_value_t = Tensioning::MaxMin)]
    tensioning: Tensioning,
}

impl Options {
    pub(crate) const fn chosen(self) -> PlanOptions {
        PlanOptions {
            planner: self.planner,
            tensioning: self.tensioning,
            shaping: self.shaping,
        }
    }
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        // A wrong name is refused before a plan is made.
        let file = self.plot.as_deref();
        let file = file.map(|path| PlotFormat::of(path).map(|kind| (path, kind)));
        let file = file.transpose()?;
        let robot = common.robot()?;
        let model = Model::new(&robot)?.with_options(self.options.chosen());
        let task = {
            let height_m = tool_height_m(&robot, self.z_mm);
            crate::motion::find_task_for(&model, &self.task, height_m)?
        };
        let watch = Watch {
            in_view_m: self.keep_in_view.as_deref().map(|mm| {
                Vector3::from_iterator(mm.iter().copied().chain([f64::NAN; 3]).take(3)) * 1e-3
            }),
        };
        let drawing = if common.dry_run {
            Drawing::OnRequest
        } else {
            Drawing::Always
        };
        let belief = self.known.belief(&robot)?;
        let (model, belief) = if self.tracked {
            let tracking = super::track::in_use(common, &model)?;
            let start = robot.tool.home_in_world_m;
            let task = task.clone().approached_from(&start, None)?;
            let seconds = Plan::unjudged(tracking.model(), &start, &task.steps)?
                .timed
                .duration_s();
            let doubts = doubts(self.known.anchors_within_mm, self.known.payload_kg);
            (tracking.model().clone(), tracking.belief(seconds, &doubts))
        } else {
            (model, belief)
        };
        show(common, &model, task, &watch, drawing, file, &belief)?;
        if drawing == Drawing::Always && !common.json {
            say!(
                "next: mcdpr run {} --robot {}",
                quoted(&self.task),
                quoted(&common.robot)
            );
        }
        Ok(())
    }
}

/// Whether a plan is drawn where no folder is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Drawing {
    /// In a new folder below `runs`.
    Always,
    /// Only into the folder of `--record`.
    OnRequest,
}

/// Plans, judges, draws and reports; fails if a limit would be broken. A refused plan is drawn into the
/// folder of `--record` only.
pub(crate) fn show(
    common: &Common,
    model: &Model,
    task: Task,
    watch: &Watch,
    drawing: Drawing,
    file: Option<(&Path, PlotFormat)>,
    belief: &Belief,
) -> Outcome {
    let name = task.name.clone();
    super::run::say_choice(model);
    let start = model.robot().tool.home_in_world_m;
    let task = task.approached_from(&start, None)?;
    let plan = Plan::unjudged(model, &start, &task.steps)?;
    let seen = plan.extremes(watch)?;
    // The refusal itself, with its code and help.
    let judged = plan.clone().judged().and_then(|plan| plan.watched(watch));
    let draws = common.record.is_some() || (drawing == Drawing::Always && judged.is_ok());
    // A refused plan is drawn without one: what is wrong with it is said first.
    let tube = match &judged {
        Ok(plan) => Tube::along(plan, belief)?,
        Err(_) => None,
    };
    let folder = draws
        .then(|| draw(common, &name, &plan, &seen, tube.as_ref()))
        .transpose()?;
    let plan = judged?;
    if let Some((path, kind)) = file {
        let bytes = plan_figure(&name, &plan, tube.as_ref())?.file(kind)?;
        crate::files::write_atomically(path, bytes)
            .map_err(Failed::from_error("writing the plot"))?;
    }
    if common.json {
        return print_json(&serde_json::json!({
            "task": name,
            "duration_s": seen.duration_s,
            "knots": plan.knots.len(),
            "tilt_max_rad": seen.tilt_rad,
            "tension_min_n": seen.tension_min_n.iter().copied().fold(f64::MAX, f64::min),
            "tension_max_n": seen.tension_max_n.iter().copied().fold(0.0, f64::max),
            "verdict": seen,
            "tube": tube,
            "folder": folder,
        }));
    }
    say!(
        "{name}: {:.2} s, tool up to {:.1} mm/s, tilt up to {:.1} deg; within \
         every limit, nothing was moved",
        seen.duration_s,
        seen.speed_mps * 1e3,
        seen.tilt_rad.to_degrees()
    );
    super::write_out(&lay_out(&rows(&seen.margins)));
    match &tube {
        // As wide as the table above it, also where a program reads.
        Some(tube) => super::write_out(&wrap(&(tube.words() + "\n"), COLUMNS)),
        None => say!("no tube of the tool's error: the platform does not hang firmly everywhere"),
    }
    if let Some(folder) = folder {
        let ending = common.plots().ending();
        say!("drawn in {folder}/plan.{ending}: path, lengths, tensions, tilt");
    }
    Ok(())
}

/// A word as a shell takes it.
fn quoted(name: &str) -> String {
    if name.contains(char::is_whitespace) {
        format!("\"{name}\"")
    } else {
        name.to_owned()
    }
}

/// Writes picture and figures; gives the folder.
fn draw(
    common: &Common,
    name: &str,
    plan: &Plan,
    seen: &Extremes,
    tube: Option<&Tube>,
) -> miette::Result<String> {
    let failed = || Failed::from_error("writing the plan's folder");
    let picture = plan_figure(name, plan, tube)?;
    let folder = RunFolder::create(common.record.as_deref(), name).map_err(failed())?;
    folder
        .plot("plan", &picture, common.plots())
        .map_err(failed())?;
    folder.write_json("plan.json", seen).map_err(failed())?;
    if let Some(tube) = tube {
        folder
            .write_json(super::report::TUBE, tube)
            .map_err(failed())?;
    }
    Ok(folder.path().display().to_string())
}

/// A table of all limits, the tightest first.
fn rows(margins: &[Margin]) -> Vec<Vec<String>> {
    let head = ["limit", "value", "limit at", "left, %", "at, s", "tool, mm"];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    rows.extend(margins.iter().map(|margin| {
        let digits = if margin.unit == "A" { 2 } else { 1 };
        let place = margin.tool_m.map(|v| format!("{:.0}", v * 1e3)).join(" ");
        vec![
            format!("{}, {}", margin.what, margin.unit),
            format!("{:.digits$}", margin.value),
            format!("{:.digits$}", margin.limit),
            format!("{:.0}", margin.left_percent),
            format!("{:.2}", margin.time_s),
            place,
        ]
    }));
    rows
}
