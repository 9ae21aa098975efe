//! `mcdpr calibrate collect`: measures poses on the robot.

use crate::calibration::check::POSES_MIN;
use crate::calibration::collect::{CollectError, Options, Step, collect};
use crate::calibration::result::{FileError, write_whole};
use crate::calibration::simulate::Target;
use crate::calibration::{Data, target};
use crate::cli::eye::Eye;
use crate::cli::numbers::{positive, whole};
use crate::cli::recorded::{Work, on_record};
use crate::cli::{Common, Failed, Outcome, print_json};
use crate::control::Handle;
use crate::experiment::SimulatedRobot;
use crate::link::ClientError;
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::record::Doing;
use crate::robot::Robot;
use crate::run::watch_for_interrupts;
use crate::sight::{Scene, SerialTilt, SimulatedTags, SimulatedTilt, TagSource, WithTilt};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;

/// Drive to well-chosen poses, wait for rest, and measure lengths, tensions and tags
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    #[command(flatten)]
    pub(crate) how: How,
    /// File to write, by default NAME.calibration-data.json beside the robot file
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// How data are collected.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct How {
    /// Number of poses, home included
    #[arg(long, default_value_t = 20, value_parser = whole::<1, 1000>)]
    poses: usize,
    /// Stop once the expected position error is below this; the next pose is then chosen during the
    /// collection
    #[arg(long, value_name = "MM", value_parser = positive)]
    target_error_mm: Option<f64>,
    /// The tags on the floor
    #[arg(long, value_enum, default_value_t = On::Robot)]
    target: On,
    /// Continue with the poses that the file has already
    #[arg(long)]
    resume: bool,
    /// Number of reachable poses to choose from
    #[arg(long, default_value_t = 300, value_parser = whole::<1, 100_000>)]
    candidates: usize,
    #[command(flatten)]
    eye: Eye,
    /// Serial port of the inclinometer on the platform ([imu] of the robot file): it sends lines of roll and pitch in
    /// degrees
    #[arg(long, value_name = "PORT")]
    imu: Option<String>,
    /// Simulator: noise of a corner in one picture, px
    #[arg(long, default_value_t = 0.1, value_name = "PX", value_parser = positive)]
    corner_px: f64,
}

/// The tags to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum On {
    /// Those of the robot file
    Robot,
    /// One tag of 100 mm, as `mcdpr calibrate target` prints it
    Tag,
    /// The board of 3 x 3 tags of 80 mm, as `mcdpr calibrate target` prints it (recommended)
    Board,
    /// Three loose tags of 80 mm
    Loose,
}

impl On {
    /// The tags, if they are not the robot's own.
    pub(crate) const fn target(self) -> Option<Target> {
        match self {
            Self::Robot => None,
            Self::Tag => Some(Target::Tag),
            Self::Board => Some(Target::Board),
            Self::Loose => Some(Target::Loose),
        }
    }
}

/// Where the data of a robot are kept by default.
pub(crate) fn data_path(robot: &str) -> PathBuf {
    let given = PathBuf::from(robot);
    if given.is_file() {
        return given.with_extension("calibration-data.json");
    }
    PathBuf::from(format!("{robot}.calibration-data.json"))
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let path = self.out.clone().unwrap_or_else(|| data_path(&common.robot));
        let data = self
            .how
            .run(&crate::robot::find(&common.robot)?, &path, common)?;
        if common.json {
            return print_json(&serde_json::json!({
                "data": path.display().to_string(), "poses": data.poses.len(),
            }));
        }
        let (count, path) = (data.poses.len(), path.display());
        if count < POSES_MIN {
            say!(
                "{count} poses in {path}, {POSES_MIN} are needed at least (20 is a good number): go on \
                 with --resume --poses 20"
            );
        } else {
            say!("{count} poses in {path}; `mcdpr calibrate all --data {path}` solves them");
        }
        Ok(())
    }
}

impl How {
    /// Collects into a file, and returns the data.
    pub(crate) fn run(
        &self,
        designed: &Robot,
        path: &Path,
        common: &Common,
    ) -> miette::Result<Data> {
        if self.candidates < self.poses {
            return Err(Failed::from_error("--candidates")(format!(
                "{} candidates cannot give {} poses: name more, or leave it out",
                self.candidates, self.poses
            ))
            .into());
        }
        let mut robot = designed.clone();
        if let Some(target) = self.target.target() {
            robot.tags = target::tags(target);
        }
        self.imu_refused(&robot, common)?;
        let before = self.before(path)?;
        let model = Model::new(&robot)?;
        model.comes_to_rest("collecting")?;
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let mismatch = common.mismatch(Mismatch::as_built());
        let simulated = common.on == "sim";
        let (link, mut tags) = if simulated {
            self.eye.refused_on_simulator("--camera")?;
            let link = SimulatedRobot::new(mismatch, common.seed)
                .controller(&common.controller)
                .at_home(&model)?;
            let scene = Scene::of(&robot, common.seed);
            let tags = SimulatedTags::new(link.clone(), scene, self.corner_px, common.seed);
            let tilt = robot
                .imu
                .map(|imu| SimulatedTilt::new(link.clone(), imu.noise_rad, common.seed));
            (
                Some(link),
                Box::new(WithTilt { tags, tilt }) as Box<dyn TagSource>,
            )
        } else {
            let Some(tags) = self.eye.tags(&robot, &common.page)? else {
                return Err(Failed::from_error("calibrate collect")(format!(
                    "on {} the pictures of the tags come from a camera: name it with --camera; data \
                     from elsewhere are solved by `mcdpr calibrate all --data FILE`",
                    common.on
                ))
                .into());
            };
            let port = self.imu.as_ref().zip(robot.imu);
            let tilt = port.map(|(port, imu)| SerialTilt::open(port, imu.baud));
            let tilt = tilt.transpose()?;
            (
                None,
                Box::new(WithTilt { tags, tilt }) as Box<dyn TagSource>,
            )
        };
        let tilted = robot.imu.is_some() && (simulated || self.imu.is_some());
        let options = Options {
            poses: self.poses,
            candidates: self.candidates,
            target_error_m: self.target_error_mm.map(|mm| mm * 1e-3),
            seed: common.seed,
            simulated_seed: simulated.then_some(common.seed),
            simulated_machine: common.machine.clone().filter(|_| simulated),
            described: Some(designed.content_hash()),
            session: None,
            orders: Handle::new(),
        };
        #[cfg(unix)]
        let _listening = crate::cli::orders::listen(common, &options.orders)?;
        let mut keeper = Keeper::start(path.to_owned())?;
        // The pictures only changed the choice of poses.
        let orders = options.orders.clone();
        let work = Work::new("collect", Doing::Orders, mismatch, &model).with_orders(&orders);
        let (data, folder) = on_record(common, &work, |record| {
            let line = match link {
                Some(link) => record.simulated(link),
                None => record.line(common.open_port().map_err(ClientError::from)?),
            };
            let options = Options {
                session: Some(record.session),
                ..options
            };
            let progress = |step| print_step(&step, tilted);
            let keep = |data: &Data| keeper.keep(data);
            let done = collect(&model, line, &mut tags, &options, before, keep, progress);
            // Also if it ended early: the measurements so far are kept.
            let kept = keeper.finish();
            let data = done?;
            kept?;
            Ok(data)
        })?;
        eprintln!("run folder: {}", folder.path().display());
        Ok(data)
    }

    /// Refuses an inclinometer where there is none, and tells that one is left out.
    fn imu_refused(&self, robot: &Robot, common: &Common) -> miette::Result<()> {
        let given = self.imu.is_some();
        let reason = if given && common.on == "sim" {
            "the simulated robot in this process has its own inclinometer; --imu goes with --on PORT"
        } else if given && robot.imu.is_none() {
            "this robot file has no inclinometer: add [imu] with kind = \"serial\""
        } else {
            if robot.imu.is_some() && !given && common.on != "sim" {
                eprintln!(
                    "the inclinometer of this robot ([imu]) is left out: name its port with --imu PORT"
                );
            }
            return Ok(());
        };
        Err(Failed::from_error("--imu")(reason).into())
    }

    fn before(&self, path: &Path) -> miette::Result<Option<Data>> {
        if !self.resume {
            return Ok(None);
        }
        let what = format!("calibration data {}", path.display());
        let text = crate::files::read_text(path).map_err(Failed::from_error(&what))?;
        Ok(Some(Data::from_json(&text)?))
    }
}

/// Writes the data on a separate thread: a disk may take longer than a board waits for its host.
pub(crate) struct Keeper {
    texts: Option<Sender<String>>,
    thread: Option<JoinHandle<Result<(), FileError>>>,
}

impl Keeper {
    pub(crate) fn start(path: PathBuf) -> Result<Self, Failed> {
        let (texts, todo) = channel::<String>();
        let work = move || {
            while let Ok(text) = todo.recv() {
                // Each text has all data: of several the last is enough.
                write_whole(&path, todo.try_iter().last().unwrap_or(text))?;
            }
            Ok(())
        };
        let thread = std::thread::Builder::new().name("data".to_owned());
        let thread = thread
            .spawn(work)
            .map_err(Failed::from_error("a thread for the data"))?;
        Ok(Self {
            texts: Some(texts),
            thread: Some(thread),
        })
    }

    pub(crate) fn keep(&mut self, data: &Data) -> Result<(), CollectError> {
        let text = serde_json::to_string(&data.to_json()).unwrap_or_default();
        match self.texts.as_ref().map(|texts| texts.send(text)) {
            Some(Ok(())) => Ok(()),
            // The thread ended: its result has the reason.
            _ => self.finish(),
        }
    }

    /// Waits until everything is written.
    pub(crate) fn finish(&mut self) -> Result<(), CollectError> {
        self.texts = None;
        let written = self.thread.take().map(JoinHandle::join);
        match written {
            Some(Ok(written)) => Ok(written?),
            _ => Ok(()),
        }
    }
}

/// `tilted`: whether an inclinometer is read.
fn print_step(step: &Step, tilted: bool) {
    match step {
        Step::Going { .. } => {}
        Step::Measured {
            done,
            wanted,
            swing_m,
            averaged,
            tags,
            tilt_rad,
            expected_error_m,
        } => eprintln!(
            "pose {done} of {wanted}: {tags} tags, {}swing {:.3} mm{}, expected error {:.2} mm",
            match tilt_rad.map(|tilt| tilt.map(f64::to_degrees)) {
                Some([roll, pitch]) => format!("roll {roll:.2}, pitch {pitch:.2} degrees, "),
                None if tilted => "the inclinometer sent nothing, ".to_owned(),
                None => String::new(),
            },
            swing_m * 1e3,
            if *averaged {
                " (whole periods averaged)"
            } else {
                ""
            },
            expected_error_m * 1e3
        ),
        Step::Returned { apart_m } => eprintln!(
            "back at the first pose: lengths repeat within {:.3} mm",
            apart_m * 1e3
        ),
        Step::Skipped { reason } => eprintln!("pose left out: {reason}"),
    }
}
