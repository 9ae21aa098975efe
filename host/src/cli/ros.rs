//! `mcdpr ros`: the robot for ROS 2.

mod calibrate;
mod session;

use super::eye::{Eye, Kind};
use super::line::{Next, keep_open, refuse_for_a_while};
use super::run::tool_height_m;
use super::{Common, Failed, Outcome, print_json};
use crate::control::Handle;
use crate::experiment::{Experiment, SimulatedRobot};
use crate::link::{ClientError, Link, Paced};
use crate::machine::Mismatch;
use crate::motion::{BUILT_IN, Model, Task, find_task};
use crate::record::events::TruthTap;
use crate::ros::{Actions, Desk, Goals, Pipe, Program, Topics};
use crate::run::watch_for_interrupts;
use crate::serve::Feed;
use crate::sight::{Scene, SimulatedTags, TagSource};
use std::cell::{Cell, RefCell};
use std::io::Write as _;
use std::net::{IpAddr, Ipv4Addr};
use std::path::{Path, PathBuf};

/// Name of the program that speaks DDS.
const BRIDGE: &str = "mcdpr-ros";
/// Noise of a corner in one simulated picture, px, as in `mcdpr calibrate collect`.
const CORNER_PX: f64 = 0.1;
/// The largest domain whose ports exist.
const LAST_DOMAIN: u16 = 232;

/// The robot as a node of ROS 2: topics, and services that move it. See docs/ros.md
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Name of a built-in task, or a task file (TOML), that `/mcdpr/run_task` may run; may be repeated. Without it,
    /// the built-in tasks that this robot can run
    #[arg(long = "task", value_name = "TASK")]
    tasks: Vec<String>,
    /// Height of a built-in task: that of a level platform's origin; the tool is below it
    #[arg(long, value_name = "MM", default_value_t = -100.0, allow_negative_numbers = true)]
    z_mm: f64,
    /// DDS domain; else the environment's ROS_DOMAIN_ID, else 0
    #[arg(long, value_name = "N")]
    domain: Option<u16>,
    /// Address of a network interface; may be repeated. Whoever reaches it can move the robot: by default only this
    /// machine
    #[arg(long = "interface", value_name = "IP", default_values_t = [IpAddr::V4(Ipv4Addr::LOCALHOST)])]
    interfaces: Vec<IpAddr>,
    /// The program that speaks DDS; else `mcdpr-ros` beside this program, else on the path
    #[arg(long, value_name = "FILE")]
    bridge: Option<PathBuf>,
    /// Publish the pictures of the simulated robot's camera too, one a second
    #[arg(long)]
    camera: bool,
    /// Camera beside a robot on a port, for `/mcdpr/calibrate`; as `--camera` of `mcdpr calibrate collect`. The
    /// simulated robot has its own
    #[arg(long = "tags-from", value_name = "folder:DIR|realsense|v4l2:DEVICE")]
    tags_from: Option<Kind>,
    /// How long the robot holds under tension for another goal, before its brakes close, s
    #[arg(long, value_name = "S", default_value_t = 5.0)]
    hold: f64,
}

/// What one program needs for its rounds.
struct Node<'a> {
    common: &'a Common,
    model: &'a Model,
    feed: Feed,
    handle: Handle,
    goals: Goals,
    hold_s: f64,
    camera: bool,
    simulated: bool,
    /// The tags that a calibration measures.
    tags: RefCell<Option<Box<dyn TagSource>>>,
    /// The line is lost, and viewers were informed.
    lost: Cell<bool>,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = common.robot()?;
        let model = Model::new(&robot)?;
        let domain = self.chosen_domain()?;
        if !(0.0..=600.0).contains(&self.hold) {
            let reason = format!("{} s is not between 0 and 600", self.hold);
            return Err(Failed::from_error("--hold")(reason).into());
        }
        let simulated = common.on == "sim";
        if self.camera && !simulated {
            let reason = "only the simulated robot's pictures are published";
            return Err(Failed::from_error("--camera")(reason).into());
        }
        let eye = Eye::of(self.tags_from.clone());
        if simulated {
            eye.refused_on_simulator("--tags-from")?;
        }
        let tasks = self.judged_tasks(&model)?;
        let names: Vec<_> = tasks.iter().map(|(name, _)| name.clone()).collect();
        if common.dry_run {
            eprintln!("the tasks are within every limit; nothing was started");
            if common.json {
                return print_json(&serde_json::json!({ "allowed": names }));
            }
            return Ok(());
        }
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let (feed, handle, goals) = (crate::serve::feed(), Handle::new(), Goals::default());
        let failed = || Failed::from_error("starting a thread");
        let actions = Actions::default();
        let desk = Desk::new(&handle, &goals, &actions, &feed, tasks).map_err(failed())?;
        let program = self.program(domain);
        let pipe = Pipe::start(
            program.clone(),
            Topics::greeting(&model),
            move |outlet, call| {
                desk.called(outlet, call);
            },
        );
        let pipe = pipe.map_err(|error| no_bridge(&program.path, &error))?;
        let topics = Topics::start(pipe.outlet(), feed.clone(), actions, model.clone());
        let _topics = topics.map_err(failed())?;
        if self.camera {
            // Pictures are rendered for viewers only.
            feed.viewer(true);
        }
        #[cfg(unix)]
        let _listening = super::orders::listen(common, &handle)?;
        self.announce(common, domain, &names)?;
        let mut node = Node {
            common,
            model: &model,
            feed,
            handle,
            goals,
            hold_s: self.hold,
            camera: self.camera,
            simulated,
            tags: RefCell::default(),
            lost: Cell::new(false),
        };
        let scale = common.checked_time_scale()?.unwrap_or(1.0);
        if simulated {
            let link = SimulatedRobot::new(Mismatch::realistic(), common.seed)
                .controller(&common.controller)
                .at_home(&model)?;
            let scene = Scene::of(&robot, common.seed);
            let tags = SimulatedTags::new(link.clone(), scene, CORNER_PX, common.seed);
            node.tags = RefCell::new(Some(Box::new(tags)));
            let tap = TruthTap::forgetful(link.clone(), robot.cables.len());
            node.go(|| Ok(Paced::new(link.clone(), scale)), Some(&tap))
        } else {
            let tags = eye.tags(&robot, &common.page)?;
            node.tags = RefCell::new(tags.map(|tags| Box::new(tags) as Box<dyn TagSource>));
            node.go(|| Ok(common.open_port()?), None)
        }
    }

    /// The domain: a number whose ports exist.
    fn chosen_domain(&self) -> Result<u16, Failed> {
        let (what, domain) = match (self.domain, std::env::var("ROS_DOMAIN_ID")) {
            (Some(domain), _) => ("--domain", Some(domain)),
            (None, Ok(text)) if !text.is_empty() => ("ROS_DOMAIN_ID", text.parse().ok()),
            (None, _) => ("--domain", Some(0)),
        };
        let domain = domain.filter(|domain| *domain <= LAST_DOMAIN);
        domain.ok_or_else(|| {
            let reason = format!("a domain is a number from 0 to {LAST_DOMAIN}");
            Failed::from_error(what)(reason)
        })
    }

    /// The tasks by name. Those that were asked for must be possible from home; of the built-in ones, those that are.
    fn judged_tasks(&self, model: &Model) -> miette::Result<Vec<(String, Task)>> {
        let height_m = tool_height_m(model.robot(), self.z_mm);
        let mut tasks = Vec::new();
        for name in &self.tasks {
            let task = find_task(name, height_m)?;
            Experiment::new(model, task.clone()).plan()?;
            tasks.push((name.clone(), task));
        }
        if self.tasks.is_empty() {
            let found = BUILT_IN.iter().filter_map(|(name, _)| {
                let task = find_task(name, height_m).ok()?;
                let possible = Experiment::new(model, task.clone()).plan().is_ok();
                possible.then(|| ((*name).to_owned(), task))
            });
            tasks.extend(found);
        }
        Ok(tasks)
    }

    fn program(&self, domain: u16) -> Program {
        let beside = || {
            let folder = std::env::current_exe().ok()?.parent()?.join(BRIDGE);
            folder.is_file().then_some(folder)
        };
        let path = self.bridge.clone().or_else(beside);
        let mut arguments = vec!["--domain".to_owned(), domain.to_string()];
        for interface in &self.interfaces {
            arguments.extend(["--interface".to_owned(), interface.to_string()]);
        }
        Program {
            path: path.unwrap_or_else(|| PathBuf::from(BRIDGE)),
            arguments,
        }
    }

    fn announce(&self, common: &Common, domain: u16, tasks: &[String]) -> Outcome {
        let interfaces: Vec<_> = self.interfaces.iter().map(ToString::to_string).collect();
        if common.json {
            print_json(&serde_json::json!({
                "node": "/mcdpr",
                "domain": domain,
                "interfaces": interfaces,
                "tasks": tasks,
            }))?;
        } else {
            say!(
                "node /mcdpr in domain {domain} on {}",
                interfaces.join(", ")
            );
            say!("tasks: {}", tasks.join(", "));
        }
        // A reader that waits for this line must not wait for a full buffer.
        let _ = std::io::stdout().flush();
        Ok(())
    }
}

fn no_bridge(path: &Path, error: &std::io::Error) -> miette::Report {
    miette::miette!(
        code = "mcdpr::ros::bridge",
        help = "it is a program of its own: `cargo xtask ros --build` puts it beside mcdpr; --bridge FILE names another",
        "{} cannot be started: {error}",
        path.display()
    )
}

impl Node<'_> {
    /// Executes goals until the program is interrupted. A lost line is opened again, and subscribers learn the reason.
    fn go<L: Link>(
        &self,
        open: impl FnMut() -> Result<L, ClientError>,
        tap: Option<&TruthTap>,
    ) -> Outcome {
        let round = |line: &mut L| {
            let goes_on = self.round(line, tap)?;
            Ok(if goes_on { Next::Again } else { Next::End })
        };
        let lost = |reason: &str| {
            self.lost.set(true);
            self.feed.set_trouble(reason);
            refuse_for_a_while(|| {
                self.handle.close(reason);
                self.goals.refuse(reason);
            })
        };
        keep_open(open, false, round, lost, || {})
    }
}
