//! The data for viewers.

use crate::decode::{Decoder, Seen};
use crate::events::{PlanNote, RunEvent, Watcher};
use crate::notices::Notices;
use crate::words;
use mcdpr_core::faults::{advice, describe_fault, describe_reject};
use mcdpr_core::motion::Model;
use mcdpr_core::robot::{Control, GripperKind, Robot};
use mcdpr_core::sight::Shown;
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Source of a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Source {
    /// The simulated robot's true pose.
    #[serde(rename = "simulated truth")]
    Truth,
    /// Estimated from lengths and tensions at rest.
    #[serde(rename = "estimated from cables")]
    Estimated,
}

/// Pose of platform and tool; world frame, SI.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ShownPose {
    /// Origin of the platform, m.
    pub position_m: [f64; 3],
    /// Attitude, quaternion [x, y, z, w].
    pub rotation_xyzw: [f64; 4],
    /// The tool, m.
    pub tool_m: [f64; 3],
    /// Its source.
    pub source: Source,
}

/// The robot now; SI.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Live {
    /// Grows with every change.
    pub revision: u64,
    /// The link's time, s.
    pub time_s: f64,
    /// State of the board.
    pub state: String,
    /// The state in words.
    pub words: &'static str,
    /// Path time reached, s.
    pub path_s: f64,
    /// Duration of the motion, s.
    pub duration_s: f64,
    /// Paid-out lengths, m.
    pub lengths_m: Vec<f64>,
    /// Measured minus commanded lengths, m; empty without a motion.
    pub length_errors_m: Vec<f64>,
    /// Tensions at the winches, N.
    pub tensions_n: Vec<f64>,
    /// Expected tensions or set-points, N; empty without a motion.
    pub expected_n: Vec<f64>,
    /// Motor currents, A.
    pub currents_a: Vec<f64>,
    /// Pose of the robot.
    pub pose: Option<ShownPose>,
    /// Distance of the tool from its planned position, m; only for a simulated robot.
    pub path_error_m: Option<f64>,
    /// The latched fault in words.
    pub fault: Option<String>,
    /// Its remedy.
    pub advice: Option<&'static str>,
    /// Values near their limits.
    pub limits: Vec<&'static str>,
    /// Bit set of open brakes.
    pub brakes_open: u8,
    /// Bit set of drives that give torque.
    pub torque_on: u8,
    /// Frames that arrived damaged.
    pub frames_bad: u64,
    /// Current activity of the program.
    pub task: String,
    /// Why the robot cannot be reached, or why the last order failed.
    pub trouble: Option<String>,
}

impl Live {
    /// Whether the program is using the robot: an order to start something else has to wait.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        let busy = ["Arming", "Moving", "Pausing", "Holding"].contains(&self.state.as_str());
        busy && !self.task.is_empty()
    }
}

#[derive(Debug, Default)]
struct Inner {
    live: Live,
    /// When the board was last heard, s.
    heard_s: Option<f64>,
    plan: Option<Arc<PlanNote>>,
    plans: u64,
    log: VecDeque<LogLine>,
    logged: u64,
    preview: Option<Arc<serde_json::Value>>,
    previews: u64,
    picture: Option<Arc<Picture>>,
    pictures: u64,
    viewers: usize,
}

/// A picture for viewers.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Its detections and size.
    pub about: serde_json::Value,
    /// The bytes of a PNG file.
    pub png: Vec<u8>,
}

/// The state that viewers share. Clones show the same.
#[derive(Debug, Clone)]
pub struct Feed {
    shared: Arc<Mutex<Inner>>,
    notices: Notices,
    /// Any time that only grows, s.
    clock_s: fn() -> f64,
}

/// A line of the log that viewers see.
#[derive(Debug, Clone, Serialize)]
pub struct LogLine {
    /// Its number, from 1.
    pub number: u64,
    /// Link time, s.
    time_s: f64,
    text: String,
}

/// Lines of the log that a new viewer gets.
const LOG: usize = 60;

impl Feed {
    /// An empty feed; `clock_s` gives any time that only grows, s.
    #[must_use]
    pub fn new(clock_s: fn() -> f64) -> Self {
        Self {
            shared: Arc::default(),
            notices: Notices::new(clock_s),
            clock_s,
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // A viewer that panicked must not affect the others.
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn change(&self, heard: bool, change: impl FnOnce(&mut Inner)) {
        let mut inner = self.lock();
        change(&mut inner);
        if heard {
            inner.heard_s = Some((self.clock_s)());
        }
        inner.live.revision += 1;
    }

    /// What viewers get besides the robot's state.
    pub const fn notices(&self) -> &Notices {
        &self.notices
    }

    /// Sets the current activity of the program.
    pub fn set_task(&self, task: &str) {
        self.change(false, |inner| task.clone_into(&mut inner.live.task));
    }

    /// Shows viewers beside the buttons why the robot cannot be reached or an order failed; a new
    /// text is also added to the log.
    pub fn set_trouble(&self, reason: &str) {
        // The same reason again, as of a port that stays closed, is logged once.
        if self.lock().live.trouble.as_deref() == Some(reason) {
            return;
        }
        self.change(false, |inner| {
            inner.live.trouble = Some(reason.to_owned());
            push(inner, reason);
        });
    }

    /// Removes that text again.
    pub fn clear_trouble(&self) {
        if self.lock().live.trouble.is_some() {
            self.change(false, |inner| inner.live.trouble = None);
        }
    }

    /// Shows viewers what a task would do.
    pub fn set_preview(&self, preview: serde_json::Value) {
        self.change(false, |inner| {
            inner.preview = Some(Arc::new(preview));
            inner.previews += 1;
        });
    }

    /// The preview and its number, if it is newer than this number.
    pub fn preview_after(&self, number: u64) -> Option<(u64, Arc<serde_json::Value>)> {
        let inner = self.lock();
        let preview = inner.preview.as_ref();
        let new = preview.filter(|_| inner.previews > number);
        new.map(|preview| (inner.previews, Arc::clone(preview)))
    }

    /// Adds a line to the log that viewers see.
    pub fn say(&self, text: &str) {
        self.change(false, |inner| push(inner, text));
    }

    /// The present state, and the age of the board's last message, s.
    #[must_use]
    pub fn now(&self) -> (Live, Option<f64>) {
        let inner = self.lock();
        let age = inner.heard_s.map(|heard_s| (self.clock_s)() - heard_s);
        (inner.live.clone(), age)
    }

    /// The plan, if it has another number than this.
    #[must_use]
    pub(crate) fn plan_after(&self, number: u64) -> Option<(u64, Arc<PlanNote>)> {
        let inner = self.lock();
        let plan = inner.plan.as_ref().filter(|_| inner.plans != number)?;
        Some((inner.plans, Arc::clone(plan)))
    }

    /// Shows a picture instead of the last.
    pub fn show(&self, picture: &Shown) {
        let [width, height] = picture.size_px();
        let grasp = picture.grasp.as_ref().map(|grasp| {
            serde_json::json!({
                "middle_px": grasp.middle_px,
                "pads_px": grasp.pads_px,
                "corners_px": grasp.corners_px(),
                "width_m": grasp.width_m,
            })
        });
        let about = serde_json::json!({
            "type": "camera",
            "width": width,
            "height": height,
            "source": picture.source,
            "tags": picture.tags,
            "grasp": grasp,
        });
        self.show_png(about, picture.png());
    }

    /// Shows a picture in its final form, the text about it and the bytes of a PNG file, instead of the last.
    pub fn show_png(&self, about: serde_json::Value, png: Vec<u8>) {
        self.change(false, |inner| {
            inner.picture = Some(Arc::new(Picture { about, png }));
            inner.pictures += 1;
        });
    }

    /// The picture, if it has another number than this.
    #[must_use]
    pub fn picture_after(&self, number: u64) -> Option<(u64, Arc<Picture>)> {
        let inner = self.lock();
        let picture = inner
            .picture
            .as_ref()
            .filter(|_| inner.pictures != number)?;
        Some((inner.pictures, Arc::clone(picture)))
    }

    /// A viewer was connected (`true`) or disconnected.
    pub fn viewer(&self, came: bool) {
        let mut inner = self.lock();
        inner.viewers = if came {
            inner.viewers + 1
        } else {
            inner.viewers.saturating_sub(1)
        };
    }

    /// Whether there are viewers.
    #[must_use]
    pub fn is_watched(&self) -> bool {
        self.lock().viewers > 0
    }

    /// Lines of the log after this number.
    #[must_use]
    pub(crate) fn log_after(&self, number: u64) -> Vec<LogLine> {
        let inner = self.lock();
        let new = inner.log.iter().filter(|line| line.number > number);
        new.cloned().collect()
    }
}

fn push(inner: &mut Inner, text: &str) {
    inner.logged += 1;
    inner.log.push_back(LogLine {
        number: inner.logged,
        time_s: inner.live.time_s,
        text: text.to_owned(),
    });
    if inner.log.len() > LOG {
        inner.log.pop_front();
    }
}

/// Collects the data for viewers from the traffic on the line.
pub struct FeedWatcher {
    feed: Feed,
    model: Model,
    decoder: Decoder,
    truth_known: bool,
}

impl FeedWatcher {
    /// For a robot.
    #[must_use]
    pub fn new(feed: Feed, model: Model) -> Self {
        Self {
            feed,
            model,
            decoder: Decoder::default(),
            truth_known: false,
        }
    }

    fn seen(&self, seen: Seen, time_s: f64) {
        match seen {
            Seen::Ticks(ticks) => {
                // The youngest tick only: a page shows 60 states a second.
                let Some(tick) = ticks.into_iter().next_back() else {
                    return;
                };
                self.feed.change(true, |inner| {
                    let live = &mut inner.live;
                    live.time_s = time_s;
                    let pairs = tick.lengths_m.iter().zip(&tick.planned);
                    live.length_errors_m = pairs.map(|(l, p)| l - p.length_m).collect();
                    live.expected_n = tick.planned.iter().map(|p| p.tension_n).collect();
                    live.lengths_m = tick.lengths_m;
                    live.tensions_n = tick.tensions_n;
                    live.currents_a = tick.currents_a;
                    live.path_s = tick.path_s.unwrap_or(live.path_s);
                });
            }
            Seen::Status(status) => {
                let metres = status.lengths_m();
                let metres: Vec<_> = metres.collect();
                let newtons = status.tensions_n();
                let newtons: Vec<_> = newtons.collect();
                // Lengths mean nothing before the reference, and the simulator's truth needs no
                // estimate.
                let estimate = (!self.truth_known && status.referenced)
                    .then(|| self.estimate(&metres, &newtons))
                    .flatten();
                self.feed.change(true, |inner| {
                    let state = format!("{:?}", status.state);
                    let fault = status.fault.as_ref().map(describe_fault);
                    if inner.live.state != state {
                        push(inner, &format!("{state}: {}", words::state(status.state)));
                    }
                    if inner.live.fault != fault
                        && let Some(fault) = &fault
                    {
                        push(inner, &format!("fault {fault}"));
                    }
                    let live = &mut inner.live;
                    live.time_s = time_s;
                    live.state = state;
                    live.words = words::state(status.state);
                    live.fault = fault;
                    live.advice = status.fault.map(|record| advice(record.fault));
                    live.limits = words::LIMITS
                        .into_iter()
                        .filter(|limit| status.limits.contains(*limit))
                        .map(words::limit)
                        .collect();
                    live.brakes_open = status.brakes_open;
                    live.torque_on = status.torque_on;
                    live.path_s = f64::from(status.path_ms) * 1e-3;
                    live.lengths_m = metres;
                    live.tensions_n = newtons;
                    // Without an estimate the last pose stays on the page.
                    if estimate.is_some() {
                        live.pose = estimate;
                    }
                });
            }
            Seen::Beat { path_ms, state } => self.feed.change(true, |inner| {
                inner.live.time_s = time_s;
                inner.live.path_s = f64::from(path_ms) * 1e-3;
                let name = format!("{state:?}");
                if inner.live.state != name {
                    push(inner, &format!("{name}: {}", words::state(state)));
                    inner.live.state = name;
                    inner.live.words = words::state(state);
                }
            }),
            Seen::Refused(reject) => self
                .feed
                .say(&format!("the board refused: {}", describe_reject(&reject))),
            Seen::Hello(_) | Seen::Asked(_) | Seen::Knot(_) => {}
        }
    }

    fn estimate(&self, lengths_m: &[f64], tensions_n: &[f64]) -> Option<ShownPose> {
        let rest = self.model.rest_from_lengths(lengths_m, tensions_n).ok()?;
        let pose = &rest.equilibrium.pose;
        let turn = pose.quaternion();
        Some(ShownPose {
            position_m: pose.position_m.into(),
            rotation_xyzw: [turn.i, turn.j, turn.k, turn.w],
            tool_m: self.model.tool_m(&rest).into(),
            source: Source::Estimated,
        })
    }
}

impl Watcher for FeedWatcher {
    fn see(&mut self, event: &RunEvent) {
        match event {
            RunEvent::Wire { frame, .. } => {
                let time_s = frame.time_us as f64 * 1e-6;
                for seen in self.decoder.take(frame) {
                    self.seen(seen, time_s);
                }
                let damaged = self.decoder.damaged();
                if self.feed.lock().live.frames_bad != damaged {
                    self.feed.lock().live.frames_bad = damaged;
                }
            }
            RunEvent::Plan { plan, .. } => {
                let plan = Arc::new(plan.clone());
                self.feed.change(false, |inner| {
                    inner.live.duration_s = plan.duration_s;
                    inner.plan = Some(plan);
                    inner.plans += 1;
                });
            }
            RunEvent::Truth { truth, .. } => {
                self.truth_known = true;
                self.feed.change(false, |inner| {
                    // Before the motion begins there is no planned position to compare with.
                    let planned = inner.plan.as_ref().filter(|_| truth.path_s > 0.0);
                    let shall = planned.and_then(|plan| plan.tool_at(truth.path_s));
                    inner.live.path_error_m = shall.map(|shall| {
                        let gaps = shall
                            .iter()
                            .zip(&truth.tool_m)
                            .map(|(a, b)| (a - b).powi(2));
                        gaps.sum::<f64>().sqrt()
                    });
                    inner.live.pose = Some(ShownPose {
                        position_m: truth.position_m,
                        rotation_xyzw: truth.rotation_xyzw,
                        tool_m: truth.tool_m,
                        source: Source::Truth,
                    });
                });
            }
            RunEvent::Order { .. } => {}
            RunEvent::Picture { picture, .. } => self.feed.show(picture),
            RunEvent::Remark { text, .. } => self.feed.say(text),
        }
    }
}

/// The constant data of a robot, for the drawing.
#[must_use]
pub fn describe(robot: &Robot) -> serde_json::Value {
    let cables = robot.cables.iter().enumerate().map(|(index, cable)| {
        let most = robot.winch_of(index).map(|winch| winch.tension_max_n);
        serde_json::json!({
            "anchor_m": cable.anchor_in_world_m.as_slice(),
            "axis": cable.swivel_axis_in_world.as_slice(),
            "pulley_radius_m": cable.pulley_radius_m,
            "attachment_m": cable.attachment_in_platform_m.as_slice(),
            "tension_held": cable.control == Control::Tension,
            "tension_max_n": most,
        })
    });
    serde_json::json!({
        "name": robot.name,
        "cables": cables.collect::<Vec<_>>(),
        "tcp_m": robot.tool.tcp_in_platform_m.as_slice(),
        "tension_min_n": robot.limits.tension_min_n,
        "tension_max_n": robot.limits.tension_max_n,
        "setpoint_n": robot.tension.setpoint_n,
        "speed_mps": robot.limits.speed_mps,
        "mass_kg": robot.platform.mass_kg,
        "home_m": robot.tool.home_in_world_m.as_slice(),
        "gripper": robot.gripper.kind != GripperKind::None,
    })
}
