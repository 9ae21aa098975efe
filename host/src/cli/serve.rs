//! `mcdpr serve`: the live page, and a robot behind it.

use super::recorded::Recorded;
use super::run::tool_height_m;
use super::{Common, Failed, Outcome, print_json};
use crate::control::{Handle, Order};
use crate::experiment;
use crate::link::{Client, ClientError, Link, Paced, SerialLink};
use crate::machine::Mismatch;
use crate::motion::{Model, Task};
use crate::record::witness::{Patience, TruthTap, Watched};
use crate::record::{TaskSource, Witness};
use crate::robot::Robot;
use crate::run::{self, RunError, interrupted, new_session, watch_for_interrupts};
use crate::serve::{Desk, Feed, FeedWatcher, Server};
use mcdpr_protocol::Request;
use mcdpr_simulator::LinkOptions;
use std::io::Write as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// The port that the page has, unless another is asked for.
pub(crate) const PORT: u16 = 8650;
/// Time that an order may take before the page is told that it is under way.
const ANSWER: Duration = Duration::from_millis(400);
/// Time between looks at an idle board, µs.
const LOOK_US: u64 = 40_000;

/// Show the robot in a browser, live, with buttons; the simulated one goes around its circle
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Name of a built-in task, or a task file (TOML): what Start runs
    #[arg(default_value = "paper:table7")]
    task: String,
    /// Port of the page on this machine; 0 takes a free one
    #[arg(long, default_value_t = PORT)]
    port: u16,
    /// Wait for Start, also on the simulator
    #[arg(long)]
    idle: bool,
    /// Token for orders, in place of a random one
    #[arg(long, value_name = "TEXT")]
    token: Option<String>,
    /// Height of a built-in task: that of a level platform's origin; the tool is below it
    #[arg(long, value_name = "MM", default_value_t = -100.0, allow_negative_numbers = true)]
    z_mm: f64,
}

/// Takes the page's orders to the thread that moves the robot.
pub(crate) struct PageDesk {
    pub(crate) handle: Handle,
    /// Whether Start was pressed; `None` where a page can not start anything.
    pub(crate) start: Option<Arc<AtomicBool>>,
}

impl Desk for PageDesk {
    fn order(&self, name: &str, _message: &serde_json::Value) -> Result<(), String> {
        let ticket = match name {
            "stop" => {
                if let Some(start) = &self.start {
                    start.store(false, Ordering::SeqCst);
                }
                // A stop is not waited for: it is under way.
                self.handle.stop();
                return Ok(());
            }
            "hold" => self.handle.pause(),
            "resume" => self.handle.resume(),
            "clear" => self.handle.clear(),
            "start" => {
                let start = self.start.as_ref();
                let start = start.ok_or("this page can not start a task")?;
                start.store(true, Ordering::SeqCst);
                return Ok(());
            }
            other => return Err(format!("there is no order {other}")),
        };
        self.handle.wait(ticket, ANSWER).unwrap_or(Ok(()))
    }

    fn orders(&self) -> Vec<&'static str> {
        let mut orders = vec!["stop", "hold", "resume", "clear"];
        if self.start.is_some() {
            orders.push("start");
        }
        orders
    }
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = Robot::find(&common.robot)?;
        let model = Model::new(&robot)?;
        let height_m = tool_height_m(&robot, self.z_mm);
        let task = Task::find(&self.task, height_m)?;
        // A task that would be refused is refused before anything is shown.
        experiment::plan_from_home(&model, task.clone())?;
        if common.dry_run {
            eprintln!("the task is within every limit; nothing was started");
            return Ok(());
        }
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let simulated = common.on == "sim";
        let feed = Feed::default();
        let handle = Handle::new();
        let start = Arc::new(AtomicBool::new(simulated && !self.idle));
        let desk = PageDesk {
            handle: handle.clone(),
            start: Some(Arc::clone(&start)),
        };
        let token = self.token.clone();
        let server = Server::start(self.port, token, &robot, feed.clone(), Arc::new(desk))?;
        #[cfg(unix)]
        let _listening = super::orders::listen(common, &handle)?;
        announce(&server, common)?;
        let source = TaskSource::of(&self.task, height_m);
        let show = Show {
            common,
            model: &model,
            task,
            source,
            feed,
            handle,
            start,
        };
        let scale = common.checked_time_scale()?.unwrap_or(1.0);
        if simulated {
            let options = LinkOptions::default();
            let mismatch = Mismatch::realistic();
            let link = experiment::simulated_robot(&model, &mismatch, common.seed, &options)?;
            let tap = TruthTap::forgetful(link.clone(), robot.cables.len());
            show.go(&mut Paced::new(link, scale), Some(&tap))
        } else {
            let mut link = SerialLink::open(&common.on).map_err(ClientError::from)?;
            show.go(&mut link, None)
        }
    }
}

/// Tells where the page is.
pub(crate) fn announce(server: &Server, common: &Common) -> Outcome {
    if common.json {
        print_json(&serde_json::json!({
            "address": server.address(),
            "address_with_token": server.address_with_token(),
        }))?;
    } else {
        say!("to look:         {}", server.address());
        say!("to give orders:  {}", server.address_with_token());
    }
    // A reader that waits for the address must not wait for a full buffer.
    let _ = std::io::stdout().flush();
    Ok(())
}

struct Show<'a> {
    common: &'a Common,
    model: &'a Model,
    task: Task,
    source: TaskSource,
    feed: Feed,
    handle: Handle,
    start: Arc<AtomicBool>,
}

impl Show<'_> {
    /// Runs the task whenever it is wanted, until the program is interrupted.
    fn go(&self, link: &mut impl Link, tap: Option<&TruthTap>) -> Outcome {
        let watcher = || FeedWatcher::new(self.feed.clone(), self.model.clone());
        // On the simulator the circle goes on for days: it is recorded only where asked.
        let record = tap.is_none() || self.common.record.is_some();
        loop {
            let mut idle = Witness::default();
            let failed = || Failed::from_error("starting the viewers' thread");
            idle.add(watcher(), Patience::Drop).map_err(failed())?;
            let more = self.wait(watched(&mut *link, &idle, tap));
            idle.finish();
            if !more? {
                return Ok(());
            }
            let session = new_session();
            let recorded = record
                .then(|| {
                    let source = self.source.clone();
                    let mismatch = Mismatch::realistic();
                    Recorded::start(self.common, self.model, source, session, &mismatch)
                })
                .transpose()?;
            let (mut witness, rest) = match recorded.map(Recorded::split) {
                Some((witness, rest)) => (witness, Some(rest)),
                None => (Witness::default(), None),
            };
            witness.add(watcher(), Patience::Drop).map_err(failed())?;
            self.feed.set_task(&self.task.name);
            let line = watched(&mut *link, &witness, tap).with_orders(&self.handle);
            let (task, handle) = (self.task.clone(), &self.handle);
            let outcome =
                experiment::on_link_with(self.model, task, line, Some(session), handle, |_| {});
            self.feed.set_task("");
            witness.finish();
            if let Some(rest) = rest {
                rest.finish();
            }
            match outcome {
                // The simulated robot goes around again; a real one waits to be asked.
                Ok(_) => {
                    self.feed.say("the task is done");
                    if tap.is_some() && self.handle.stop_ordered().is_none() {
                        self.start.store(true, Ordering::SeqCst);
                    }
                }
                Err(RunError::Interrupted) if interrupted() => return Ok(()),
                Err(RunError::Interrupted) => self.feed.say("stopped; Start goes on"),
                Err(error @ (RunError::Fault { .. } | RunError::Latched { .. })) => {
                    self.feed.say(&error.to_string());
                }
                Err(error) if tap.is_some() => return Err(error.into()),
                Err(error) => {
                    // The line or the board is gone: say so, and end with the reason.
                    self.feed.say(&error.to_string());
                    return Err(error.into());
                }
            }
        }
    }

    /// Looks at the idle robot until a task is wanted; `false` where the program shall end.
    fn wait(&self, link: impl Link) -> Result<bool, RunError> {
        let mut client = Client::connect(link, new_session())?;
        let outcome = loop {
            if interrupted() {
                break false;
            }
            while let Some((ticket, order)) = self.handle.take() {
                let outcome = match order {
                    Order::Clear => match client.request(Request::ClearFault) {
                        Ok(_) => Ok(()),
                        Err(refused @ ClientError::Refused { .. }) => Err(refused.to_string()),
                        Err(error) => return Err(error.into()),
                    },
                    Order::Stop | Order::Emergency => Ok(()),
                    other => Err(format!("{} is not possible: nothing moves", other.name())),
                };
                self.handle.done(ticket, outcome);
            }
            // Whoever stopped the last task has been obeyed, also where Start came at once.
            self.handle.start_anew();
            let status = run::status(&mut client)?;
            if self.start.swap(false, Ordering::SeqCst) {
                if status.fault.is_none() {
                    break true;
                }
                self.feed
                    .say("start: a fault is latched; mend its cause, then clear it");
            }
            let look = client.now_us() + LOOK_US;
            client.pump(look)?;
        };
        client.request(Request::Close)?;
        Ok(outcome)
    }
}

fn watched<'a, L: Link>(link: L, witness: &'a Witness, tap: Option<&TruthTap>) -> Watched<'a, L> {
    let watched = Watched::new(link, witness);
    match tap {
        Some(tap) => watched.with_truth(tap.clone()),
        None => watched,
    }
}
