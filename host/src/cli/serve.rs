//! `mcdpr serve`: the live page, and a robot behind it.

mod desk;
mod history;
mod library;
mod planning;
mod reload;
mod robot_file;
mod steps;

pub(crate) use desk::PageDesk;

use desk::Work;
use history::History;
use library::Library;
use planning::{Chosen, Planning};
use reload::{Prepared, Reload};
use robot_file::RobotFile;
use steps::Steps;

use super::line::{Next, in_words, keep_open, refuse_for_a_while, watched};
use super::recorded::{About, Recorded};
use super::token::Token;
use super::{Common, Failed, Outcome, print_json};
use crate::control::Handle;
use crate::experiment::{Experiment, SimulatedRobot};
use crate::link::{Client, ClientError, Link, Paced};
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::record::events::{Patience, TruthTap};
use crate::record::{Doing, EventBus, TaskSource, task_source};
use crate::report::RUNS;
use crate::run::{
    self, Homing, LengthFiles, RunError, interrupted, new_session, watch_for_interrupts,
};
use crate::serve::{CameraWatcher, Feed, FeedWatcher, Server};
use mcdpr_protocol::SessionId;
use mcdpr_twin::attend::{Attendant, Wanted};
use std::cell::Cell;
#[cfg(unix)]
use std::cell::RefCell;
use std::io::Write as _;
use std::net::IpAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Default port of the page.
pub(crate) const PORT: u16 = 8650;

/// Show the robot in a browser, live, with buttons; the simulated one goes around its circle
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Cmd {
    /// Name of a built-in task, or a task file (TOML), for the Start button; without one, as `demo`
    task: Option<String>,
    /// Port of the page on this machine; 0 takes a free one
    #[arg(long, default_value_t = PORT)]
    port: u16,
    /// Folder of the task files that the page offers, reads and saves
    #[arg(long, value_name = "FOLDER", default_value = "tasks")]
    tasks: PathBuf,
    /// Address to listen on; others than this machine's own let other machines look, and give orders
    /// with the token (the connection is not encrypted)
    #[arg(long, value_name = "IP", default_value = "127.0.0.1")]
    host: IpAddr,
    /// Wait for Start, also on the simulator
    #[arg(long)]
    idle: bool,
    #[command(flatten)]
    token: Token,
    /// Height of a built-in task: that of a level platform's origin; the tool is below it
    #[arg(long, value_name = "MM", default_value_t = -100.0, allow_negative_numbers = true)]
    z_mm: f64,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let mut prepared = Prepared::read(self, common)?;
        let token = self.token.chosen()?;
        if common.dry_run {
            eprintln!("the task is within every limit; nothing was started");
            if common.json {
                return print_json(&serde_json::json!({ "allowed": prepared.task.name }));
            }
            return Ok(());
        }
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        if !self.host.is_loopback() {
            eprintln!(
                "warning: other machines can reach this page at {}; whoever reads the unencrypted \
                 connection reads the token",
                self.host
            );
        }
        let feed = crate::serve::feed();
        let place = Place {
            steps: Steps::new(common, feed.clone()),
            feed,
            handle: Handle::new(),
            reload: Reload::new(self, common),
        };
        let mut at = Address {
            port: self.port,
            token,
            again: false,
        };
        // Robot file and calibration are read again on request: everything that knows the robot is made anew,
        // at the same address.
        loop {
            self.show(common, &prepared, &place, &mut at)?;
            match place.reload.take() {
                Some(read) => prepared = read,
                None => return Ok(()),
            }
        }
    }

    /// Serves a robot until the program ends or its description was read again.
    fn show(
        &self,
        common: &Common,
        prepared: &Prepared,
        place: &Place,
        at: &mut Address,
    ) -> Outcome {
        let simulated = common.on == "sim";
        let (model, robot) = (&prepared.model, prepared.model.robot());
        let (feed, handle) = (place.feed.clone(), place.handle.clone());
        let start = Arc::new(AtomicBool::new(simulated && !self.idle && !at.again));
        let planning = Planning::start(model.clone(), feed.clone())
            .map_err(Failed::from_error("starting the planner's thread"))?;
        let work = Work {
            steps: place.steps.clone(),
            model: model.clone(),
            feed: feed.clone(),
            start: Arc::clone(&start),
            library: Library::new(self.tasks.clone(), prepared.height_m),
            planning: planning.clone(),
            history: History::new(PathBuf::from(RUNS), robot),
            robot_file: RobotFile::new(&common.robot),
            reload: place.reload.clone(),
        };
        let desk = PageDesk {
            handle: handle.clone(),
            work: Some(work),
            most_mps: robot.limits.speed_mps,
        };
        let token = at.token.clone();
        let desk = Arc::new(desk);
        let server = Server::start_on(self.host, at.port, token, robot, feed.clone(), desk)?;
        #[cfg(unix)]
        let listening = super::orders::listen(common, &handle)?;
        if at.again {
            feed.set_preview(serde_json::json!({ "type": "preview", "id": null }));
            feed.say("robot file and calibration are read again and in use");
        } else {
            announce(&server, common)?;
            // One line of the log: what the cables have done so far.
            let wear = crate::care::load(robot).ok();
            if let Some(sentence) = wear.as_ref().and_then(crate::care::sentence) {
                feed.say(&format!("care: {sentence}"));
            }
        }
        // A page that is open reaches the next server, too.
        (at.port, at.token) = (server.port(), Some(server.token().to_owned()));
        let source = task_source(&prepared.name, prepared.height_m);
        let show = Show {
            common,
            model,
            default: Chosen {
                task: prepared.task.clone(),
                source,
            },
            planning,
            feed,
            handle,
            start,
            steps: place.steps.clone(),
            reload: place.reload.clone(),
            again: std::mem::replace(&mut at.again, true),
            #[cfg(unix)]
            listening: RefCell::new(listening),
            lost: Cell::new(false),
            cut: Cell::new(false),
        };
        let scale = common.checked_time_scale()?.unwrap_or(1.0);
        if simulated {
            let mismatch = Mismatch::realistic();
            let link = SimulatedRobot::new(mismatch, common.seed)
                .controller(&common.controller)
                .at_home(model)?;
            let tap = TruthTap::forgetful(link.clone(), robot.cables.len());
            show.go(|| Ok(Paced::new(link.clone(), scale)), Some(&tap))
        } else {
            show.go(|| Ok(common.open_port()?), None)
        }
    }
}

/// What stays when the robot's description is read again.
struct Place {
    feed: Feed,
    steps: Steps,
    handle: Handle,
    reload: Reload,
}

/// Where the page is.
struct Address {
    port: u16,
    token: Option<String>,
    /// Not for the first time.
    again: bool,
}

/// Prints the address of the page.
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
    /// The task of Start while the page has not chosen one.
    default: Chosen,
    planning: Planning,
    feed: Feed,
    handle: Handle,
    start: Arc<AtomicBool>,
    steps: Steps,
    reload: Reload,
    /// The robot's description was read again: a line that cannot be opened does not end the program.
    again: bool,
    /// Orders from other terminals, while this program has the robot.
    #[cfg(unix)]
    listening: RefCell<Option<crate::control::Server>>,
    /// The line is lost, and viewers were informed.
    lost: Cell<bool>,
    /// The board has lost its lengths, and viewers were informed.
    cut: Cell<bool>,
}

impl Show<'_> {
    /// Runs the task whenever it is requested, until the program is interrupted. A lost line is
    /// opened again, and viewers see the reason; only at the start it must exist.
    fn go<L: Link>(
        &self,
        open: impl FnMut() -> Result<L, ClientError>,
        tap: Option<&TruthTap>,
    ) -> Outcome {
        let round = |line: &mut L| self.round(line, tap);
        let lost = |reason: &str| {
            self.lost.set(true);
            self.feed.set_trouble(reason);
            // A step such as `doctor` says why a line cannot be opened.
            if self.steps.is_due() {
                self.release();
            }
            refuse_for_a_while(|| {
                self.handle.close(reason);
                self.start.store(false, Ordering::SeqCst);
            })
        };
        keep_open(open, self.again, round, lost, || self.release())
    }

    /// Lets a step have the robot, until its command has ended.
    fn release(&self) {
        self.handle.close("a step of set-up has the robot");
        // One program listens for the orders to a robot.
        #[cfg(unix)]
        drop(self.listening.take());
        self.steps.carry_out();
        #[cfg(unix)]
        match super::orders::listen(self.common, &self.handle) {
            Ok(listening) => drop(self.listening.replace(listening)),
            Err(error) => self.feed.set_trouble(&in_words(&error)),
        }
    }

    /// Waits for a request and executes it once; returns what follows.
    fn round<L: Link>(&self, link: &mut L, tap: Option<&TruthTap>) -> miette::Result<Next> {
        let watcher = || FeedWatcher::new(self.feed.clone(), self.model.clone());
        // On the simulator the circle runs for days: it is recorded only on request.
        let record = tap.is_none() || self.common.record.is_some();
        let mut idle = EventBus::default();
        let failed = || Failed::from_error("starting the viewers' thread");
        idle.add(watcher(), Patience::Drop).map_err(failed())?;
        if tap.is_some() {
            idle.add(self.camera(), Patience::Drop).map_err(failed())?;
        }
        let attendant = Attendant {
            model: self.model,
            feed: &self.feed,
            handle: &self.handle,
            start: &self.start,
            hands_over: &|| self.steps.is_due() || self.reload.is_due(),
        };
        let wanted = attendant.wait(watched(&mut *link, &idle, tap), new_session(), |client| {
            self.greeted(client)
        });
        idle.finish();
        let (jogs, referenced) = match wanted? {
            Wanted::Nothing => return Ok(Next::End),
            Wanted::Line if self.reload.is_due() => return Ok(Next::End),
            Wanted::Line => return Ok(Next::Release),
            Wanted::Task { referenced } => (false, referenced),
            Wanted::Jogs { referenced } => (true, referenced),
        };
        self.feed.clear_trouble();
        let session = new_session();
        let chosen = self.planning.begun();
        // A default task is repeated on the simulator, one that the page chose is not.
        let repeats = tap.is_some() && chosen.is_none();
        let Chosen { task, source } = chosen.unwrap_or_else(|| self.default.clone());
        // A chip's firmware does not know that its robot is simulated.
        let at_home = tap.is_some() && !referenced;
        let recorded = record
            .then(|| self.record(jogs, &source, session, at_home))
            .transpose()?;
        let (mut events, rest) = match recorded.map(Recorded::split) {
            Some((events, rest)) => (events, Some(rest)),
            None => (EventBus::default(), None),
        };
        events.add(watcher(), Patience::Drop).map_err(failed())?;
        if tap.is_some() {
            events
                .add(self.camera(), Patience::Drop)
                .map_err(failed())?;
        }
        let name = if jogs { "jogging" } else { &task.name };
        self.feed.set_task(name);
        let homing = if at_home {
            Homing::Place(self.model.robot().tool.home_in_world_m)
        } else {
            Homing::Known
        };
        let line = watched(&mut *link, &events, tap).with_orders(&self.handle);
        let handle = &self.handle;
        let outcome = if jogs {
            attendant.jog(line, session, homing, &LengthFiles)
        } else {
            Experiment::new(self.model, task)
                .session(session)
                .handle(handle)
                .homing(homing)
                .run_on(line)
                .map(|_| ())
        };
        self.feed.set_task("");
        events.finish();
        if let Some(rest) = rest {
            rest.finish();
        }
        match outcome {
            // The simulated robot repeats the task; a real one waits for a request.
            Ok(()) if jogs => self.feed.say("jogging is over: brakes closed"),
            Ok(()) => {
                self.feed.say("the task is done");
                if repeats && self.handle.stop_ordered().is_none() {
                    self.start.store(true, Ordering::SeqCst);
                }
            }
            Err(RunError::Interrupted) if interrupted() => return Ok(Next::End),
            Err(RunError::Interrupted) => self.feed.say("stopped; Start goes on"),
            // The robot answers, but the request failed.
            Err(error @ RunError::Client(ClientError::Refused { .. })) => {
                self.feed.set_trouble(&in_words(&error));
            }
            Err(error @ RunError::Client(_)) => return Err(error.into()),
            Err(error) => self.feed.set_trouble(&in_words(&error)),
        }
        Ok(Next::Again)
    }

    /// Starts the record of a task or of jogs.
    fn record(
        &self,
        jogs: bool,
        source: &TaskSource,
        session: SessionId,
        at_home: bool,
    ) -> Result<Recorded, Failed> {
        let mismatch = Mismatch::realistic();
        let about = About {
            name: if jogs { "jog" } else { &source.name },
            task: source.clone(),
            session,
            mismatch: &mismatch,
            doing: if jogs { Doing::Orders } else { Doing::Task },
            at_home,
            orders: None,
        };
        Recorded::start(self.common, Some(self.model), about)
    }

    /// The idle robot has answered.
    fn greeted<L: Link>(&self, client: &mut Client<L>) -> Result<(), RunError> {
        if self.lost.replace(false) {
            self.feed.clear_trouble();
            self.feed.say("the robot answers again");
        }
        // A simulated robot in this process is placed at home by the program.
        if self.common.on != "sim" && !run::status(client)?.referenced {
            if let Some(sentence) = crate::recovery::after_cut(client, self.model.robot())? {
                self.feed
                    .set_trouble(&format!("{sentence}; next: `mcdpr recover`"));
                self.cut.set(true);
            }
        } else if self.cut.replace(false) {
            self.feed.clear_trouble();
        }
        Ok(())
    }

    fn camera(&self) -> CameraWatcher {
        CameraWatcher::new(self.feed.clone(), self.model.robot(), self.common.seed)
    }
}
