//! `mcdpr pick`: empty a tray.

use super::eye::Eye;
use super::numbers::{positive, whole};
use super::progress::Phase;
use super::recorded::{About, Recorded};
use super::table::lay_out;
use super::{Common, Failed, Outcome, print_json};
use crate::control::Handle;
use crate::motion::Model;
use crate::pick::place::Places;
use crate::pick::study::{self, Knowledge, SceneReport, picking_robot};
use crate::pick::{End, Jaws, News, Outcome as Came, Report, Resumed};
use crate::record::{Doing, TaskSource};
use crate::robot::Robot;
use crate::run::watch_for_interrupts;
use crate::scenario::{Injection, When};
use board::Board;
use mcdpr_protocol::SessionId;
use mcdpr_simulator::camera::Order;
use mcdpr_vision::grasp::{Antipodal, Detector};
use nalgebra::Vector3;
use std::path::{Path, PathBuf};

mod board;
mod port;

/// No tray is farther away, mm.
const FURTHEST_MM: f64 = 100_000.0;

/// Pick objects from a tray until it is empty: look, choose, take, verify, carry, release
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    #[command(flatten)]
    eye: Eye,
    /// Objects in the simulated tray; fewer if there is no room for more
    #[arg(long, default_value_t = 6, value_parser = whole::<0, 40>)]
    objects: usize,
    /// Objects touch and lie on each other
    #[arg(long)]
    clutter: bool,
    /// Give up after this many attempts
    #[arg(long, value_name = "N")]
    attempts: Option<usize>,
    /// The program uses the parameters as assembled, not as calibrated
    #[arg(long, conflicts_with = "ideal")]
    nominal: bool,
    /// Simulate the machine exactly as described
    #[arg(long)]
    ideal: bool,
    /// The jaws cannot turn about the tool's axis (those of a robot on a port never do)
    #[arg(long)]
    fixed_jaws: bool,
    /// Look from this many places before each choice
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=3))]
    views: u8,
    /// Take the chosen grasp without a second look from nearby
    #[arg(long)]
    far_only: bool,
    /// The tray's floor has no printed tags for localisation
    #[arg(long)]
    no_mat: bool,
    /// Factor of the simulated objects' masses
    #[arg(long, default_value_t = 1.0, value_name = "X", value_parser = positive)]
    heavier: f64,
    /// Track mass and centre of each load, and the robot's slow changes, and plan by them
    #[arg(long)]
    track: bool,
    /// Middle of the tray's floor, world frame; without it, that of the robot file
    #[arg(long, num_args = 3, value_names = ["X", "Y", "Z"], allow_negative_numbers = true)]
    tray_mm: Option<Vec<f64>>,
    /// Where objects are released, world frame; without it, that of the robot file
    #[arg(long, num_args = 3, value_names = ["X", "Y", "Z"], allow_negative_numbers = true)]
    release_mm: Option<Vec<f64>>,
    /// What to pick: `tray`, or `paper` for the paper's one object at (252, -39, -517) mm
    #[arg(long, default_value = "tray", value_name = "tray|paper", value_parser = ["tray", "paper"])]
    task: String,
    /// Find grasps by this network, an ONNX file (needs a build with --features onnx)
    #[arg(
        long,
        value_name = "FILE",
        requires = "head",
        conflicts_with = "scenes"
    )]
    network: Option<PathBuf>,
    /// Format of the network's input and output
    #[arg(long, value_name = "affga|ggcnn", value_parser = ["affga", "ggcnn"], requires = "network")]
    head: Option<String>,
    /// Study: pick this many seeded scenes, 2/3 separate and 1/3 cluttered, with calibrated and
    /// with nominal parameters, or with --nominal or --ideal alone
    #[arg(long, value_name = "N", conflicts_with_all = ["objects", "clutter", "attempts"])]
    scenes: Option<usize>,
    /// Study: add every scene to this file when it is done, and skip the scenes that this program
    /// has already added
    #[arg(long, value_name = "FILE", requires = "scenes")]
    keep: Option<PathBuf>,
    /// Continue after a loss of power: on a port after `mcdpr recover`; on the simulator the power fails
    /// first, as --fault says
    #[arg(long, conflicts_with = "scenes")]
    resume: bool,
    /// On the simulator: the supply that fails before --resume, when and for how long
    #[arg(
        long,
        default_value = "power:drives@20s/1s",
        value_name = "power:WHOSE@TIME/DURATION"
    )]
    fault: String,
}

/// A point of the world frame, m, from the numbers of an option, mm.
fn point(option: &str, mm: Option<&Vec<f64>>) -> Result<Option<Vector3<f64>>, Failed> {
    match mm.map(Vec::as_slice) {
        None => Ok(None),
        Some(&[x, y, z]) if [x, y, z].iter().all(|v| v.abs() <= FURTHEST_MM) => {
            Ok(Some(Vector3::new(x, y, z) * 1e-3))
        }
        Some(_) => Err(Failed::from_error(option)(format!(
            "a place is three numbers in mm, each within {FURTHEST_MM:.0} mm"
        ))),
    }
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        if common.on == "sim" {
            self.eye.refused_on_simulator("--camera")?;
        }
        // Without the calibration if it must not be used, and if every scene makes its own.
        let plain = self.nominal || self.ideal || self.scenes.is_some();
        let robot = if plain {
            crate::robot::find(&common.robot)?
        } else {
            common.robot()?
        };
        // Before its workcell is looked for: objects lie on either side of a plane.
        Model::new(&robot)?.moves_in_space("picking")?;
        let mut robot = picking_robot(&robot);
        let places = &mut robot.surroundings;
        places.tray_m = point("--tray-mm", self.tray_mm.as_ref())?.or(places.tray_m);
        places.release_m = point("--release-mm", self.release_mm.as_ref())?.or(places.release_m);
        // Before anything is connected: no room for the workcell moves nothing.
        Places::of(&robot)?;
        if common.on != "sim" {
            return self.on_port(common, &robot);
        }
        let knowledge = match (self.nominal, self.ideal) {
            (true, _) => Knowledge::Nominal,
            (_, true) => Knowledge::Exact,
            _ if common.machine.as_deref() == Some("as-found") => Knowledge::Found,
            _ => Knowledge::Calibrated,
        };
        let order = if self.clutter {
            Order::Cluttered
        } else {
            Order::Separate
        };
        if let Some(scenes) = self.scenes {
            if common.serve.is_some() {
                let reason = "a study of many scenes is not shown in a browser";
                return Err(Failed::from_error("--serve")(reason).into());
            }
            return self.study(common, &robot, scenes, knowledge);
        }
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let handle = Handle::new();
        #[cfg(unix)]
        let _listening = super::orders::listen(common, &handle)?;
        let wanted = study::Wanted {
            order,
            count: self.objects,
            knowledge,
            seed: common.seed,
            turns: !self.fixed_jaws,
            attempts_max: self.attempts,
            views: usize::from(self.views),
            near: !self.far_only,
            paper: self.task == "paper",
            mat: !self.no_mat,
            heavier: self.heavier,
            tracked: self.track,
        };
        let scene = if self.resume {
            self.after_cut(common, &robot, &wanted, &handle)?
        } else {
            self.watched(common, &robot, &wanted, &handle)?
        };
        if common.json {
            return print_json(&scene);
        }
        print_scene(&scene);
        Ok(())
    }
}

impl Cmd {
    /// Picks one scene, recorded, and shown in a browser if requested.
    fn watched(
        &self,
        common: &Common,
        robot: &Robot,
        wanted: &study::Wanted,
        handle: &Handle,
    ) -> miette::Result<SceneReport> {
        // Before anything is connected: an invalid network file moves nothing.
        let mut detector = self.detector()?;
        let model = Model::new(robot)?;
        let task = TaskSource {
            name: "pick".to_owned(),
            text: None,
            tool_z_m: 0.0,
        };
        let (mismatch, _) = wanted.knowledge.mismatch();
        let about = About {
            name: "pick",
            task,
            session: SessionId(1),
            mismatch: &mismatch,
            doing: Doing::Pictures,
            at_home: true,
            orders: Some(handle),
        };
        let recorded = Recorded::start(common, Some(&model), about)?;
        let board = recorded.feed().map(Board::new);
        let tell = |news: &News| {
            if let Some(board) = &board {
                board.take(news);
            }
        };
        let watching = study::Watching {
            events: Some(&recorded.events),
            time_scale: common.pace()?,
            keep: false,
            tell: board.is_some().then_some(&tell),
        };
        let phase = Phase::begin("picking on the simulator; Ctrl-C stops the robot");
        let outcome = study::scene_by(
            robot,
            wanted,
            handle,
            detector.as_mut(),
            &watching,
            &common.controller,
        );
        drop(phase);
        let folder = recorded.finish();
        if let Ok(scene) = &outcome
            && let Err(error) = folder.write_json("summary.json", scene)
        {
            super::run::incomplete(&error);
        }
        eprintln!("run folder: {}", folder.path().display());
        Ok(outcome?)
    }

    /// Picks one scene in which the power fails.
    fn after_cut(
        &self,
        common: &Common,
        robot: &Robot,
        wanted: &study::Wanted,
        handle: &Handle,
    ) -> miette::Result<SceneReport> {
        let wrong = |reason: &str| Failed::from_error("--fault")(reason.to_owned());
        if common.serve.is_some() {
            let reason = "the simulator's loss of power is not shown in a browser";
            return Err(Failed::from_error("--serve")(reason).into());
        }
        let cut = Injection::parse(&self.fault, robot.cables.len())?;
        if cut.supply.is_none() {
            return Err(wrong(
                "it cuts no supply: give power:board, power:drives, power:host, power:all, power:dip or power:crash",
            )
            .into());
        }
        if !matches!(cut.when, When::Motion(_)) {
            return Err(wrong("give a time after the first motion's start, such as 20s").into());
        }
        let mut detector = self.detector()?;
        let (scene, verdict) = study::scene_after_cut(
            robot,
            wanted,
            detector.as_mut(),
            handle,
            &common.controller,
            &cut,
        )?;
        eprintln!("recovered: {}", verdict.sentence);
        Ok(scene)
    }

    fn detector(&self) -> miette::Result<Box<dyn Detector>> {
        match (&self.network, &self.head) {
            (Some(file), Some(head)) => network(file, head),
            _ => Ok(Box::new(Antipodal::default())),
        }
    }

    fn study(&self, common: &Common, robot: &Robot, scenes: usize, known: Knowledge) -> Outcome {
        common.no_chip("pick --scenes")?;
        let both = [Knowledge::Calibrated, Knowledge::Nominal];
        let knowledges = if self.ideal || self.nominal || known == Knowledge::Found {
            vec![known]
        } else {
            both.to_vec()
        };
        let study = study::Study {
            scenes,
            knowledges,
            first_seed: common.seed,
            turns: !self.fixed_jaws,
            near: !self.far_only,
            mat: !self.no_mat,
            keep: self.keep.clone(),
        };
        let lines = study.run(robot, |tally, done| {
            let line = study::Line::of(done, tally.cluttered, tally.knowledge);
            let figures = &line.figures;
            eprintln!(
                "scene {}: {} of {} in {} attempts, {}; so far {} of {} attempts in {} such scenes",
                tally.seed,
                tally.picked,
                tally.objects,
                tally.attempts,
                tally.end,
                figures.picked,
                figures.attempts,
                figures.scenes
            );
        })?;
        if common.json {
            return print_json(&lines);
        }
        let words = [
            "objects",
            "parameters",
            "scenes",
            "attempts",
            "picked",
            "picks per attempt",
            "cleared",
            "error median",
            "error p95",
            "stopped",
        ];
        let mut rows = vec![words.map(str::to_owned).to_vec()];
        for line in &lines {
            let f = &line.figures;
            let known = match line.knowledge {
                Knowledge::Calibrated => "calibrated",
                Knowledge::Found => "as found, calibrated",
                Knowledge::Nominal => "nominal",
                Knowledge::Exact => "exact",
            };
            let order = if line.cluttered {
                "cluttered"
            } else {
                "separate"
            };
            rows.push(vec![
                order.to_owned(),
                known.to_owned(),
                f.scenes.to_string(),
                f.attempts.to_string(),
                f.picked.to_string(),
                format!("{:.1} %", 100.0 * f.rate),
                format!("{:.1} %", 100.0 * f.cleared),
                format!("{:.2} mm", 1e3 * f.error_median_m),
                format!("{:.2} mm", 1e3 * f.error_p95_m),
                f.stopped.to_string(),
            ]);
        }
        super::write_out(&lay_out(&rows));
        say!("simulation, {}, seeds from {}", robot.name, common.seed);
        for failure in lines.iter().flat_map(|line| &line.failures) {
            eprintln!("{failure}");
        }
        Ok(())
    }
}

/// Most bytes of a network's file.
#[cfg(feature = "onnx")]
const MOST_NETWORK_BYTES: u64 = 1 << 30;

#[cfg(feature = "onnx")]
fn network(file: &Path, head: &str) -> miette::Result<Box<dyn Detector>> {
    use mcdpr_vision::grasp::network::{Head, Network};
    let failed = |reason: String| Failed::from_error("loading the network")(reason);
    let Some(head) = Head::of(head) else {
        return Err(failed(format!("there is no head `{head}`")).into());
    };
    let bytes = crate::files::read_bytes(file, MOST_NETWORK_BYTES)
        .map_err(|error| failed(format!("{}: {error}", file.display())))?;
    match Network::read(&bytes, head, &file.display().to_string()) {
        Ok(network) => Ok(Box::new(network)),
        Err(error) => Err(failed(error.to_string()).into()),
    }
}

#[cfg(not(feature = "onnx"))]
fn network(file: &Path, _: &str) -> miette::Result<Box<dyn Detector>> {
    let why = format!(
        "{}: this build has no support for networks: cargo build --release --features onnx",
        file.display()
    );
    Err(Failed::from_error("loading the network")(why).into())
}

/// One line per attempt, with the simulated jaws' result if it is known.
fn table(report: &Report, grips: &[String]) {
    let words = [
        "", "pixel", "tool, mm", "tilt", "width", "weight", "outcome", "the jaws",
    ];
    let columns = if grips.is_empty() { 7 } else { 8 };
    let mut rows = vec![words.map(str::to_owned)[..columns].to_vec()];
    for (index, attempt) in report.attempts.iter().enumerate() {
        let [x, y, z] = attempt.tool_m.map(|value| value * 1e3);
        let mut row = vec![
            (index + 1).to_string(),
            format!("{:.0}, {:.0}", attempt.pixel[0], attempt.pixel[1]),
            format!("{x:.1}, {y:.1}, {z:.1}"),
            format!("{:.1} deg", attempt.tilt_rad.to_degrees()),
            format!("{:.1} mm", attempt.width_m * 1e3),
            attempt
                .lifted_n
                .map_or("-".to_owned(), |n| format!("{n:.2} N")),
            match attempt.outcome {
                Came::Delivered => "delivered",
                Came::Missed => "missed",
                Came::Lost => "lost",
                Came::TooHeavy => "too heavy",
            }
            .to_owned(),
        ];
        if columns > row.len() {
            row.push(grips.get(index).cloned().unwrap_or_default());
        }
        rows.push(row);
    }
    super::write_out(&lay_out(&rows));
}

/// How picking continued after a loss of power.
fn continued(resumed: &Resumed) -> String {
    let weight = resumed
        .weight_n
        .map_or_else(String::new, |weight_n| format!(" ({weight_n:.1} N)"));
    match (resumed.jaws, resumed.outcome) {
        (Jaws::Empty, _) => "the jaws were empty".to_owned(),
        (Jaws::Dropped, _) => {
            "the jaws have opened without power: what they held has fallen".to_owned()
        }
        (Jaws::Holding, Some(Came::Delivered)) => {
            format!("the jaws held an object{weight}; it was delivered")
        }
        (Jaws::Holding, _) => format!("the jaws held an object{weight}; it was lost on the way"),
    }
}

/// Results from the pictures: the error budget, and the paper's numbers.
fn seen(report: &Report) {
    if let Some(attempt) = report.attempts.first() {
        let budget = &attempt.budget;
        let mm = |part_m: f64| format!("{:.2} mm", part_m * 1e3);
        let (where_from, part_m) = if budget.mat_m > 0.0 {
            ("mat", budget.mat_m)
        } else {
            ("geometry", budget.geometry_m)
        };
        say!(
            "error budget of a grasp point (1 sd): depth {}, hand-eye {}, {where_from} {}, together {}",
            mm(budget.depth_m),
            mm(budget.hand_eye_m),
            mm(part_m),
            mm(budget.total_m)
        );
    }
    if let Some(seen) = report.probe_m {
        let [x, y, z] = seen.map(|value| value * 1e3);
        say!("pixel (360, 285) is ({x:.1}, {y:.1}, {z:.1}) mm; the paper has (252, -39, -517) mm");
    }
    if let Some(place) = report.returned_m {
        let [x, y, z] = place.map(|value| value * 1e3);
        say!("returned to ({x:.0}, {y:.0}, {z:.0}) mm; the paper returns to (335, 0, -9) mm");
    }
}

fn end(end: &End) -> String {
    match end {
        End::Empty => "the tray is empty".to_owned(),
        End::Unreachable { reason } => format!("stopped: {reason}"),
        End::Failures { count } => format!("stopped after {count} failures in a row"),
        End::Enough => "as many attempts as were asked for".to_owned(),
    }
}

fn print_scene(scene: &SceneReport) {
    if let Some(resumed) = &scene.report.resumed {
        say!("continued: {}", continued(resumed));
    }
    table(&scene.report, &scene.grips);
    seen(&scene.report);
    if let (Some(least), Some(most)) = (
        scene.errors_m.iter().copied().reduce(f64::min),
        scene.errors_m.iter().copied().reduce(f64::max),
    ) {
        say!(
            "the tool closed {:.2} to {:.2} mm from where it should (the simulator's truth)",
            least * 1e3,
            most * 1e3
        );
    }
    say!(
        "{} of {} objects picked in {} attempts and {:.0} s (simulation); {}",
        scene.carried_off,
        scene.objects,
        scene.report.attempts.len(),
        scene.report.duration_s,
        end(&scene.report.end)
    );
}
