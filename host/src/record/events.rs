//! Passes the events on a line to watchers, each on a separate thread.

use crate::control::{Handle, Order, ScriptedOrder};
use crate::link::{Direction, Link, LinkError, Note, RawFrame, SimulatedLink};
use crate::motion::{Plan, Resumed};
use crate::sight::Shown;
use mcdpr_simulator::TracePoint;
use serde::{Deserialize, Serialize};
use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Severity of a remark.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Level {
    /// For the record.
    Info,
    /// A warning.
    Warning,
    /// An error.
    Error,
}

/// One instant of a plan. SI, world frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlanPoint {
    /// Path time, s.
    pub time_s: f64,
    /// Planned position of the tool, m.
    pub tool_m: [f64; 3],
    /// Origin of the platform, m.
    pub position_m: [f64; 3],
    /// Attitude of the platform, quaternion [x, y, z, w].
    pub rotation_xyzw: [f64; 4],
    /// Expected tension of each cable, N.
    pub tensions_n: Vec<f64>,
}

/// The host's plan, as a watcher sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlanNote {
    /// Duration, s.
    pub duration_s: f64,
    /// Instants in order, the last at the end.
    pub points: Vec<PlanPoint>,
    /// The interrupted motion that it continues; not part of a record.
    #[serde(skip)]
    pub resumed: Option<Resumed>,
}

impl PlanNote {
    /// Time between points, s.
    const STEP_S: f64 = 0.02;

    /// The plan every 20 ms.
    #[must_use]
    pub fn of(plan: &Plan) -> Self {
        let duration_s = plan.timed.duration_s();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a plan lasts minutes"
        )]
        let count = (duration_s / Self::STEP_S).ceil() as u32;
        let points = (0..=count).filter_map(|index| {
            let time_s = (f64::from(index) * Self::STEP_S).min(duration_s);
            let tool = plan.timed.tool_m(time_s).ok()?;
            let rest = plan.state(time_s)?;
            let pose = &rest.equilibrium.pose;
            let turn = pose.quaternion();
            Some(PlanPoint {
                time_s,
                tool_m: tool.into(),
                position_m: pose.position_m.into(),
                rotation_xyzw: [turn.i, turn.j, turn.k, turn.w],
                tensions_n: rest.tensions_n().to_vec(),
            })
        });
        Self {
            duration_s,
            points: points.collect(),
            resumed: plan.resumed.clone(),
        }
    }

    /// Planned position of the tool at a path time, m, interpolated.
    #[must_use]
    pub(crate) fn tool_at(&self, time_s: f64) -> Option<[f64; 3]> {
        let after = self.points.partition_point(|point| point.time_s <= time_s);
        let from = self.points.get(after.checked_sub(1)?)?;
        let Some(to) = self.points.get(after) else {
            return Some(from.tool_m);
        };
        let share = (time_s - from.time_s) / (to.time_s - from.time_s).max(1e-9);
        let mut at = from.tool_m;
        for (value, end) in at.iter_mut().zip(to.tool_m) {
            *value += (end - *value) * share;
        }
        Some(at)
    }

    /// The point nearest to a path time.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Option<&PlanPoint> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturates"
        )]
        let index = (time_s / Self::STEP_S).round() as usize;
        self.points.get(index).or(self.points.last())
    }
}

/// True state of a simulated robot at one time. SI, world frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TruthPoint {
    /// Board tick.
    pub tick: u32,
    /// Path time, s; 0 while nothing moves.
    pub path_s: f64,
    /// Tool point, m.
    pub tool_m: [f64; 3],
    /// Origin of the platform, m.
    pub position_m: [f64; 3],
    /// Attitude of the platform, quaternion [x, y, z, w].
    pub rotation_xyzw: [f64; 4],
    /// Tension of each cable at the platform, N.
    pub tensions_n: Vec<f64>,
}

impl TruthPoint {
    /// From the simulator's trace, for a robot with this many cables.
    #[must_use]
    pub fn of(point: &TracePoint, cables: usize) -> Self {
        let [w, x, y, z] = point.truth.pose.rotation_wxyz;
        let tensions = point.truth.tensions_platform_n.iter().take(cables);
        Self {
            tick: point.tick.0,
            path_s: f64::from(point.path_ms) * 1e-3,
            tool_m: point.truth.tool_position_m,
            position_m: point.truth.pose.position_m,
            rotation_xyzw: [x, y, z, w],
            tensions_n: tensions.copied().collect(),
        }
    }
}

/// An event for a watcher.
#[derive(Debug, Clone, PartialEq)]
pub enum RunEvent {
    /// Bytes went over the line, or a wait for them ended.
    Wire {
        /// Number of the call of the line, from 0: a hole in the numbers is a hole in the record.
        call: u32,
        /// The bytes.
        frame: RawFrame,
    },
    /// The host has made a plan and is about to run it.
    Plan {
        /// The link's time, µs.
        time_us: u64,
        /// The plan.
        plan: PlanNote,
    },
    /// The true state of the simulated robot.
    Truth {
        /// The link's time, µs.
        time_us: u64,
        /// The truth.
        truth: TruthPoint,
    },
    /// An order came to the thread that feeds the board.
    Order {
        /// The link's time, µs.
        time_us: u64,
        /// How often that thread had polled for orders before.
        looks: u64,
        /// The order.
        order: Order,
    },
    /// A picture was taken.
    Picture {
        /// The link's time, µs.
        time_us: u64,
        /// The picture, with what was found in it.
        picture: Shown,
    },
    /// A text of the host.
    Remark {
        /// The link's time, µs.
        time_us: u64,
        /// Its severity.
        level: Level,
        /// The text.
        text: String,
    },
}

/// Receives events, on a separate thread.
pub trait Watcher: Send + 'static {
    /// An event.
    fn see(&mut self, event: &RunEvent);
    /// No events for a while: time for deferred work.
    fn idle(&mut self) {}
    /// The run is over.
    fn end(&mut self) {}
}

/// Action if a watcher does not keep up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Patience {
    /// Wait for it: the line's time is virtual, so nothing is late.
    Wait,
    /// Drop events and count them: a robot is moving.
    Drop,
}

/// Greatest number of events waiting for a watcher: ten seconds of a busy line.
const QUEUE: usize = 20_000;
/// After this time without events a watcher gets its idle call.
const IDLE: Duration = Duration::from_millis(250);

/// Events gather for this long before a watcher sees them: a busy line has thousands of short reads a second,
/// and to wake a thread for each took more time than the watchers' work (4 % of a core for a journal).
const GATHER: Duration = Duration::from_millis(5);

struct Watching {
    sender: SyncSender<Arc<RunEvent>>,
    patience: Patience,
    lost: Arc<AtomicU64>,
    thread: JoinHandle<()>,
}

/// The watchers of a run.
#[derive(Default)]
pub struct EventBus {
    watchers: Vec<Watching>,
}

impl EventBus {
    /// Adds a watcher, and returns the count of its missed events.
    ///
    /// # Errors
    /// If the system has no thread for it.
    pub fn add(
        &mut self,
        watcher: impl Watcher,
        patience: Patience,
    ) -> std::io::Result<Arc<AtomicU64>> {
        let (sender, receiver) = sync_channel(QUEUE);
        let lost = Arc::new(AtomicU64::new(0));
        let thread = std::thread::Builder::new()
            .name("watcher".to_owned())
            .spawn(move || watch(watcher, &receiver))?;
        self.watchers.push(Watching {
            sender,
            patience,
            lost: Arc::clone(&lost),
            thread,
        });
        Ok(lost)
    }

    /// Whether there are no watchers.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.watchers.is_empty()
    }

    /// Sends an event to every watcher.
    pub fn publish(&self, event: RunEvent) {
        if self.watchers.is_empty() {
            return;
        }
        let event = Arc::new(event);
        for watching in &self.watchers {
            let copy = Arc::clone(&event);
            match watching.patience {
                // A watcher that ended by itself has reported why.
                Patience::Wait => drop(watching.sender.send(copy)),
                Patience::Drop => {
                    if let Err(TrySendError::Full(_)) = watching.sender.try_send(copy) {
                        watching.lost.fetch_add(1, Ordering::Relaxed);
                    }
                }
            }
        }
    }

    /// Ends the run: every watcher processes its waiting events and ends.
    pub fn finish(self) {
        for watching in self.watchers {
            drop(watching.sender);
            // A watcher that panicked has printed its message; the run is not affected.
            let _ = watching.thread.join();
        }
    }
}

fn watch(mut watcher: impl Watcher, receiver: &Receiver<Arc<RunEvent>>) {
    loop {
        match receiver.recv_timeout(IDLE) {
            Ok(event) => {
                watcher.see(&event);
                while let Ok(event) = receiver.try_recv() {
                    watcher.see(&event);
                }
                std::thread::sleep(GATHER);
            }
            Err(RecvTimeoutError::Timeout) => watcher.idle(),
            Err(RecvTimeoutError::Disconnected) => {
                watcher.end();
                return;
            }
        }
    }
}

/// The true state of a simulated robot, sampled while its time passes.
#[derive(Clone)]
pub(crate) struct TruthTap {
    link: SimulatedLink,
    cables: usize,
    kept: Option<Rc<RefCell<Vec<TracePoint>>>>,
}

impl TruthTap {
    /// Ticks between the points that are shown.
    const EVERY: u32 = 10;

    /// Starts sampling.
    #[must_use]
    pub fn new(link: SimulatedLink, cables: usize) -> Self {
        link.with(mcdpr_simulator::Simulation::record_truth);
        Self {
            link,
            cables,
            kept: Some(Rc::default()),
        }
    }

    /// Starts sampling for watchers, and stores nothing: for a robot that runs for days.
    #[must_use]
    pub(crate) fn forgetful(link: SimulatedLink, cables: usize) -> Self {
        Self {
            kept: None,
            ..Self::new(link, cables)
        }
    }

    fn show(&self, events: &EventBus) {
        let (new, now_us) = self
            .link
            .with(|simulation| (simulation.take_trace(), simulation.now_us()));
        if !events.is_empty() {
            for point in new.iter().filter(|p| p.tick.0.is_multiple_of(Self::EVERY)) {
                events.publish(RunEvent::Truth {
                    time_us: now_us,
                    truth: TruthPoint::of(point, self.cables),
                });
            }
        }
        if let Some(kept) = &self.kept {
            kept.borrow_mut().extend(new);
        }
    }

    /// All stored samples, tick by tick.
    #[must_use]
    pub fn take(&self) -> Vec<TracePoint> {
        let new = self.link.with(mcdpr_simulator::Simulation::take_trace);
        let kept = self.kept.as_ref();
        let mut all = kept.map_or_else(Vec::new, |kept| kept.take());
        all.extend(new);
        all
    }
}

/// A line observed by an event bus.
pub struct Watched<'a, L> {
    inner: L,
    events: &'a EventBus,
    truth: Option<TruthTap>,
    calls: u32,
    orders: Option<Handle>,
}

impl<'a, L: Link> Watched<'a, L> {
    /// Shows the traffic of `inner`.
    pub const fn new(inner: L, events: &'a EventBus) -> Self {
        Self {
            inner,
            events,
            truth: None,
            calls: 0,
            orders: None,
        }
    }

    /// Shows the true state of the simulated robot as well.
    #[must_use]
    pub(crate) fn with_truth(mut self, tap: TruthTap) -> Self {
        self.truth = Some(tap);
        self
    }

    /// Shows the orders to this handle as well; a new run begins.
    #[must_use]
    pub(crate) fn with_orders(mut self, handle: &Handle) -> Self {
        handle.count_anew();
        self.orders = Some(handle.clone());
        self
    }

    fn show_orders(&self) {
        let new = self.orders.as_ref().map(Handle::arrived);
        for ScriptedOrder { polls, order } in new.unwrap_or_default() {
            self.events.publish(RunEvent::Order {
                time_us: self.inner.now_us(),
                looks: polls,
                order,
            });
        }
    }

    fn wire(&mut self, direction: Direction, bytes: &[u8]) {
        if !self.events.is_empty() {
            let frame = RawFrame {
                time_us: self.inner.now_us(),
                direction,
                bytes: bytes.to_vec(),
            };
            let call = self.calls;
            self.events.publish(RunEvent::Wire { call, frame });
        }
        self.calls = self.calls.wrapping_add(1);
    }
}

impl<L: Link> Link for Watched<'_, L> {
    fn goes_on(&self) -> bool {
        self.inner.goes_on()
    }

    fn now_us(&self) -> u64 {
        self.inner.now_us()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.inner.send(bytes)?;
        self.wire(Direction::ToBoard, bytes);
        Ok(())
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        let before = into.len();
        let time_us = self.inner.receive(until_us, into)?;
        self.wire(Direction::ToHost, into.get(before..).unwrap_or_default());
        if let Some(tap) = &self.truth {
            tap.show(self.events);
        }
        self.show_orders();
        Ok(time_us)
    }

    fn note(&mut self, note: Note<'_>) {
        let time_us = self.inner.now_us();
        if self.events.is_empty() {
            return;
        }
        match note {
            Note::Plan(plan) => self.events.publish(RunEvent::Plan {
                time_us,
                plan: PlanNote::of(plan),
            }),
            Note::Remark(text) => self.events.publish(RunEvent::Remark {
                time_us,
                level: Level::Info,
                text: text.to_owned(),
            }),
            Note::Picture(picture) => self.events.publish(RunEvent::Picture {
                time_us,
                picture: picture.clone(),
            }),
        }
        self.inner.note(note);
    }
}
