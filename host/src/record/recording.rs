//! The watcher that writes a run into an MCAP file.

use super::decode::{Decoder, Seen, Tick};
use super::events::{Level, RunEvent, Watcher};
use super::mcap::{ChannelId, Writer};
use super::schemas::{self, TOPICS};
use super::words::{LIMITS, limit};
use super::{PlanNote, Scenario, TruthPoint, panel, short};
use crate::link::{RawFrame, describe_fault, describe_reject};
use crate::motion::Model;
use crate::sight::{Shown, base64};
use mcdpr_kinematics::Pose;
use mcdpr_protocol::{BoardState, FaultRecord, Knot, Status};
use mcdpr_twin::record::WIRE;
use mcdpr_twin::record::pack::Pack;
use nalgebra::{Quaternion, UnitQuaternion};
use serde::Serialize;
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Topic of the line's bytes; see `pack`.
/// Bytes of a chunk.
const CHUNK_BYTES: usize = 256 * 1024;
/// Greatest part of the record that is only in memory.
const FLUSH_EVERY: Duration = Duration::from_millis(500);

/// Result of a recording.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Summary {
    /// Messages written.
    pub messages: u64,
    /// Why it ended before the run did, if it did.
    pub stopped: Option<String>,
    /// Whether the end of the file was written.
    pub complete: bool,
}

/// Writes the events into a file.
pub struct Recording<W: Write + Send + 'static = File> {
    writer: Option<Writer<W>>,
    channels: Vec<ChannelId>,
    wire: ChannelId,
    pack: Pack,
    sequence: u32,
    start_ns: u64,
    decoder: Decoder,
    model: Option<Model>,
    state: Option<BoardState>,
    fault: Option<FaultRecord>,
    limits: u16,
    plan: Option<PlanNote>,
    /// True pose of a simulated platform.
    true_pose: Option<Pose>,
    /// Whether the constant parts have been shown.
    shown: bool,
    flushed: Instant,
    sync: fn(&W) -> io::Result<()>,
    summary: Arc<Mutex<Summary>>,
}

#[derive(Serialize)]
struct Stamp {
    sec: u64,
    nsec: u64,
}

impl Stamp {
    const fn of(time_ns: u64) -> Self {
        Self {
            sec: time_ns / 1_000_000_000,
            nsec: time_ns % 1_000_000_000,
        }
    }
}

#[derive(Serialize)]
struct Stamped<T: Serialize> {
    timestamp: Stamp,
    #[serde(flatten)]
    body: T,
}

#[derive(Serialize)]
struct Cables<'a> {
    timestamp: Stamp,
    tick: u32,
    path_s: Option<f64>,
    length_m: &'a [f64],
    tension_n: &'a [f64],
    current_a: &'a [f64],
    planned_length_m: Vec<f64>,
    planned_tension_n: Vec<f64>,
}

impl Recording<File> {
    /// Starts a record at `path`, which must not exist; the scenario is written first.
    ///
    /// # Errors
    /// The system's: a folder that cannot be written, an existing record.
    pub fn create(path: &Path, scenario: &Scenario, model: Option<Model>) -> io::Result<Self> {
        let file = File::create_new(path)?;
        Self::start(file, scenario, model, |file| file.sync_data())
    }
}

impl<W: Write + Send + 'static> Recording<W> {
    /// Starts a record into any writer; `sync` makes the data written last durable.
    ///
    /// # Errors
    /// The system's.
    pub fn start(
        out: W,
        scenario: &Scenario,
        model: Option<Model>,
        sync: fn(&W) -> io::Result<()>,
    ) -> io::Result<Self> {
        let mut writer = Writer::new(out, "mcdpr", CHUNK_BYTES)?;
        let start_ns = scenario.started_unix_us.saturating_mul(1000);
        let pairs = [
            ("program", scenario.program.as_str()),
            ("protocol", scenario.protocol.as_str()),
            ("task", scenario.task.name.as_str()),
        ];
        writer.metadata("mcdpr", &pairs)?;
        let json = serde_json::to_vec_pretty(scenario)?;
        writer.attachment("scenario.json", "application/json", &json, start_ns)?;
        for file in &scenario.robot {
            let name = format!("robot/{}", file.name);
            writer.attachment(&name, "application/toml", file.text.as_bytes(), start_ns)?;
        }
        if let Some(text) = &scenario.task.text {
            writer.attachment("task.toml", "application/toml", text.as_bytes(), start_ns)?;
        }
        let mut channels = Vec::new();
        let mut known: Vec<(&str, u16)> = Vec::new();
        for topic in &TOPICS {
            let id = match known.iter().find(|(name, _)| *name == topic.schema) {
                Some((_, id)) => *id,
                None => {
                    let body = (topic.body)().to_string();
                    let id = writer.schema(topic.schema, "jsonschema", body.as_bytes())?;
                    known.push((topic.schema, id));
                    id
                }
            };
            channels.push(writer.channel(Some(id), topic.topic, "json", &[])?);
        }
        let wire = writer.channel(None, WIRE, "mcdpr-wire", &[])?;
        Ok(Self {
            writer: Some(writer),
            channels,
            wire,
            pack: Pack::default(),
            sequence: 0,
            start_ns,
            decoder: Decoder::default(),
            model,
            state: None,
            fault: None,
            limits: 0,
            plan: None,
            true_pose: None,
            shown: false,
            flushed: Instant::now(),
            sync,
            summary: Arc::default(),
        })
    }

    /// Where the outcome is stored.
    #[must_use]
    pub fn summary(&self) -> Arc<Mutex<Summary>> {
        Arc::clone(&self.summary)
    }

    /// Uses the file; an error ends the record, and only the record.
    fn with_writer(&mut self, work: impl FnOnce(&mut Writer<W>) -> io::Result<()>) {
        let Some(writer) = &mut self.writer else {
            return;
        };
        if let Err(error) = work(writer) {
            self.writer = None;
            if let Ok(mut summary) = self.summary.lock() {
                summary.stopped = Some(error.to_string());
            }
        }
    }

    fn write(&mut self, topic: usize, time_ns: u64, body: &impl Serialize) {
        let Some(&channel) = self.channels.get(topic) else {
            return;
        };
        self.sequence = self.sequence.wrapping_add(1);
        let sequence = self.sequence;
        // Plan and truth keep every digit: replays and reports compute with them.
        let exact = matches!(topic, schemas::PLAN | schemas::TRUTH);
        let text = if exact {
            serde_json::to_vec(body)
        } else {
            short::to_vec(body)
        };
        match text {
            Ok(data) => {
                self.with_writer(|writer| writer.message(channel, sequence, time_ns, &data));
                if let Ok(mut summary) = self.summary.lock() {
                    summary.messages += 1;
                }
            }
            // Numbers and texts always have a form in JSON.
            Err(_) => debug_assert!(false, "a message without JSON"),
        }
    }

    fn log(&mut self, time_ns: u64, level: Level, text: &str) {
        let body = serde_json::json!({
            "timestamp": Stamp::of(time_ns),
            "level": match level { Level::Info => 2, Level::Warning => 3, Level::Error => 4 },
            "message": text,
            "name": "mcdpr",
            "file": "",
            "line": 0,
        });
        self.write(schemas::LOG, time_ns, &body);
    }

    fn wire(&mut self, call: u32, frame: &RawFrame, time_ns: u64) {
        let pack = self.pack.push(call, frame);
        self.write_pack(pack);
        for seen in self.decoder.take(frame) {
            self.seen(seen, time_ns);
        }
    }

    fn write_pack(&mut self, pack: Option<(u64, Vec<u8>)>) {
        let Some((first_us, bytes)) = pack else {
            return;
        };
        self.sequence = self.sequence.wrapping_add(1);
        let (channel, sequence) = (self.wire, self.sequence);
        let time_ns = self.start_ns.saturating_add(first_us * 1000);
        self.with_writer(|writer| writer.message(channel, sequence, time_ns, &bytes));
    }

    fn seen(&mut self, seen: Seen, time_ns: u64) {
        match seen {
            Seen::Ticks(ticks) => {
                // The block's last tick is the youngest; those before it are a millisecond apart.
                let last = ticks.last().map_or(0, |tick| tick.tick);
                for tick in &ticks {
                    let age_ns = u64::from(last.wrapping_sub(tick.tick)) * 1_000_000;
                    self.cables(tick, time_ns.saturating_sub(age_ns));
                }
                let path_s = ticks.last().and_then(|tick| tick.path_s);
                if let Some((plan, path_s)) = self.plan.as_ref().zip(path_s)
                    && let Some(point) = plan.at(path_s)
                {
                    let (at, turn) = (point.position_m, point.rotation_xyzw);
                    self.pose(schemas::POSE_PLANNED, at, turn, time_ns);
                }
            }
            Seen::Status(status) => self.status(&status, time_ns),
            Seen::Knot(knot) => self.knot(&knot, time_ns),
            Seen::Asked(request) => {
                let body = serde_json::json!({
                    "timestamp": Stamp::of(time_ns), "request": format!("{request:?}"),
                });
                self.write(schemas::COMMAND, time_ns, &body);
            }
            Seen::Refused(reject) => {
                let text = format!("the board refused: {}", describe_reject(&reject));
                self.log(time_ns, Level::Error, &text);
            }
            Seen::Hello(hello) => {
                let text = format!("board speaks protocol {}.{}", hello.major, hello.minor);
                self.log(time_ns, Level::Info, &text);
            }
            Seen::Beat { .. } => {}
        }
    }

    fn cables(&mut self, tick: &Tick, time_ns: u64) {
        let body = Cables {
            timestamp: Stamp::of(time_ns),
            tick: tick.tick,
            path_s: tick.path_s,
            length_m: &tick.lengths_m,
            tension_n: &tick.tensions_n,
            current_a: &tick.currents_a,
            planned_length_m: tick.planned.iter().map(|p| p.length_m).collect(),
            planned_tension_n: tick.planned.iter().map(|p| p.tension_n).collect(),
        };
        self.write(schemas::CABLES, time_ns, &body);
    }

    fn knot(&mut self, knot: &Knot, time_ns: u64) {
        let cables = || knot.cables.iter();
        let body = serde_json::json!({
            "timestamp": Stamp::of(time_ns),
            "index": knot.index,
            "time_s": knot.time_s(),
            "last": knot.last,
            "length_m": cables().map(|c| c.length.metres()).collect::<Vec<_>>(),
            "speed_mps": cables().map(|c| c.velocity.metres_per_second()).collect::<Vec<_>>(),
            "tension_n": cables().map(|c| c.tension.newtons()).collect::<Vec<_>>(),
        });
        self.write(schemas::KNOT, time_ns, &body);
    }

    fn status(&mut self, status: &Status, time_ns: u64) {
        let metres: Vec<_> = status.lengths_m().collect();
        let newtons: Vec<_> = status.tensions_n().collect();
        let setpoints = status.setpoints_m();
        let fault = status.fault.as_ref().map(describe_fault);
        let body = serde_json::json!({
            "timestamp": Stamp::of(time_ns),
            "tick": status.tick.0,
            "state": format!("{:?}", status.state),
            "path_s": f64::from(status.path_ms) * 1e-3,
            "setpoint_m": setpoints.collect::<Vec<_>>(),
            "length_m": metres,
            "tension_n": newtons,
            "fault": fault,
            "limits": status.limits.0,
            "brakes_open": status.brakes_open,
            "torque_on": status.torque_on,
            "referenced": status.referenced,
            "gripper_closed": status.gripper_closed,
            "frames_ok": status.frames_ok,
            "frames_bad": status.frames_bad,
            "tick_overruns": status.tick_overruns,
            "telemetry_dropped": status.telemetry_dropped,
        });
        self.write(schemas::STATUS, time_ns, &body);
        if self.state.replace(status.state) != Some(status.state) {
            self.log(time_ns, Level::Info, &format!("state {:?}", status.state));
        }
        if status.fault != self.fault {
            self.fault = status.fault;
            let (level, text) = match fault {
                Some(text) => (Level::Error, format!("fault {text}")),
                None => (Level::Info, "fault cleared".to_owned()),
            };
            self.log(time_ns, level, &text);
        }
        // Only bits that are new: a limit that stays reached is one line of the log.
        let new = status.limits.0 & !self.limits;
        self.limits = status.limits.0;
        for one in LIMITS {
            if new & (1 << (one as u8)) != 0 {
                self.log(time_ns, Level::Warning, &format!("warning: {}", limit(one)));
            }
        }
        self.estimated(status, &metres, &newtons, time_ns);
    }

    /// Pose of the platform by its lengths and tensions, and its display in a 3-D panel.
    fn estimated(&mut self, status: &Status, lengths_m: &[f64], tensions_n: &[f64], time_ns: u64) {
        let Some(model) = self.model.take() else {
            return;
        };
        let referenced = status.referenced;
        let rest = referenced.then(|| model.rest_from_lengths(lengths_m, tensions_n).ok());
        let estimate = rest.flatten().map(|rest| rest.equilibrium.pose);
        if let Some(pose) = &estimate {
            let turn = pose.quaternion();
            let (at, turn) = (pose.position_m.into(), [turn.i, turn.j, turn.k, turn.w]);
            self.pose(schemas::POSE_ESTIMATED, at, turn, time_ns);
            // A simulated platform has its true pose: one frame must not have two.
            if self.true_pose.is_none() {
                self.transform("world", "platform", pose, time_ns);
            }
        }
        let stamp = Stamp::of(time_ns);
        if !std::mem::replace(&mut self.shown, true) {
            self.write(schemas::SCENE, time_ns, &panel::frame(&model, &stamp));
            self.write(schemas::SCENE, time_ns, &panel::platform(&model, &stamp));
            let lens = panel::calibration(&model, &stamp);
            self.write(schemas::LENS, time_ns, &lens);
            for (name, platform_from_it) in panel::fixed(&model) {
                self.transform("platform", name, &platform_from_it, time_ns);
            }
        }
        let pose = self.true_pose.or(estimate);
        let cables = pose.and_then(|pose| panel::cables(&model, &pose, tensions_n, &stamp));
        if let Some(cables) = cables {
            self.write(schemas::SCENE, time_ns, &cables);
        }
        self.model = Some(model);
    }

    fn transform(&mut self, parent: &str, child: &str, pose: &Pose, time_ns: u64) {
        let turn = pose.quaternion();
        let body = serde_json::json!({
            "timestamp": Stamp::of(time_ns),
            "parent_frame_id": parent,
            "child_frame_id": child,
            "translation": xyz(pose.position_m.into()),
            "rotation": xyzw([turn.i, turn.j, turn.k, turn.w]),
        });
        self.write(schemas::TRANSFORM, time_ns, &body);
    }

    fn pose(&mut self, topic: usize, at: [f64; 3], turn: [f64; 4], time_ns: u64) {
        let body = serde_json::json!({
            "timestamp": Stamp::of(time_ns),
            "frame_id": "world",
            "pose": { "position": xyz(at), "orientation": xyzw(turn) },
        });
        self.write(topic, time_ns, &body);
    }

    fn truth(&mut self, truth: &TruthPoint, time_ns: u64) {
        self.pose(
            schemas::POSE_TRUE,
            truth.position_m,
            truth.rotation_xyzw,
            time_ns,
        );
        let [x, y, z, w] = truth.rotation_xyzw;
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let pose = Pose::from_quaternion(truth.position_m.into(), turn);
        self.transform("world", "platform", &pose, time_ns);
        self.true_pose = Some(pose);
        let timestamp = Stamp::of(time_ns);
        self.write(
            schemas::TRUTH,
            time_ns,
            &Stamped {
                timestamp,
                body: truth,
            },
        );
    }

    fn picture(&mut self, picture: &Shown, time_ns: u64) {
        let stamp = || Stamp::of(time_ns);
        let image = serde_json::json!({
            "timestamp": stamp(),
            "frame_id": "camera",
            "data": base64(&picture.png()),
            "format": "png",
        });
        self.write(schemas::IMAGE, time_ns, &image);
        let (tags, grasps) = (picture.tags.iter(), picture.grasp.iter());
        let color = |[r, g, b]: [f64; 3]| serde_json::json!({ "r": r, "g": g, "b": b, "a": 1.0 });
        let outline = |corners: &[[f64; 2]; 4], rgb: [f64; 3]| {
            let points = corners.map(|[x, y]| serde_json::json!({ "x": x, "y": y }));
            serde_json::json!({
                "timestamp": stamp(), "type": 2, "points": points, "outline_color": color(rgb),
                "outline_colors": [], "fill_color": { "r": 0.0, "g": 0.0, "b": 0.0, "a": 0.0 },
                "thickness": 2.0,
            })
        };
        let (tag_rgb, grasp_rgb) = ([0.2, 0.9, 0.3], [1.0, 0.7, 0.1]);
        let outlines = tags
            .clone()
            .map(|tag| outline(&tag.corners_px, tag_rgb))
            .chain(grasps.map(|grasp| outline(&grasp.corners_px(), grasp_rgb)));
        let texts = tags.map(|tag| {
            let [x, y] = tag.corners_px[0];
            serde_json::json!({
                "timestamp": stamp(), "position": { "x": x, "y": y },
                "text": format!("tag {}", tag.id), "font_size": 14.0,
                "text_color": color(tag_rgb),
                "background_color": { "r": 0.0, "g": 0.0, "b": 0.0, "a": 0.5 },
            })
        });
        let marks = serde_json::json!({
            "circles": [],
            "points": outlines.collect::<Vec<_>>(),
            "texts": texts.collect::<Vec<_>>(),
        });
        self.write(schemas::MARKS, time_ns, &marks);
    }

    fn flush(&mut self) {
        // At most half a second of the record is lost with the power.
        if self.flushed.elapsed() >= FLUSH_EVERY {
            self.flushed = Instant::now();
            let pack = self.pack.take();
            self.write_pack(pack);
            let sync = self.sync;
            self.with_writer(|writer| {
                if writer.pending() > 0 {
                    writer.flush()?;
                    sync(writer.get_ref())?;
                }
                Ok(())
            });
        }
    }
}

fn xyz([x, y, z]: [f64; 3]) -> serde_json::Value {
    serde_json::json!({ "x": x, "y": y, "z": z })
}

fn xyzw([x, y, z, w]: [f64; 4]) -> serde_json::Value {
    serde_json::json!({ "x": x, "y": y, "z": z, "w": w })
}

impl<W: Write + Send + 'static> Watcher for Recording<W> {
    fn see(&mut self, event: &RunEvent) {
        let at = |time_us: u64, start_ns: u64| start_ns.saturating_add(time_us * 1000);
        let start_ns = self.start_ns;
        match event {
            RunEvent::Wire { call, frame } => {
                self.wire(*call, frame, at(frame.time_us, start_ns));
            }
            RunEvent::Truth { time_us, truth } => self.truth(truth, at(*time_us, start_ns)),
            RunEvent::Order {
                time_us,
                looks,
                order,
            } => {
                let time_ns = at(*time_us, start_ns);
                let body = serde_json::json!({
                    "timestamp": Stamp::of(time_ns), "looks": looks, "order": order,
                });
                self.write(schemas::ORDER, time_ns, &body);
                self.log(time_ns, Level::Info, &format!("order: {}", order.name()));
            }
            RunEvent::Remark {
                time_us,
                level,
                text,
            } => self.log(at(*time_us, start_ns), *level, text),
            RunEvent::Picture { time_us, picture } => {
                self.picture(picture, at(*time_us, start_ns));
            }
            RunEvent::Plan { time_us, plan } => {
                let time_ns = at(*time_us, start_ns);
                let timestamp = Stamp::of(time_ns);
                self.write(
                    schemas::PLAN,
                    time_ns,
                    &Stamped {
                        timestamp,
                        body: plan,
                    },
                );
                let path = panel::path(plan, &Stamp::of(time_ns));
                self.write(schemas::SCENE, time_ns, &path);
                self.plan = Some(plan.clone());
            }
        }
        self.flush();
    }

    fn idle(&mut self) {
        self.flush();
    }

    fn end(&mut self) {
        let pack = self.pack.take();
        self.write_pack(pack);
        let Some(writer) = self.writer.take() else {
            return;
        };
        let sync = self.sync;
        let ended = writer.finish().and_then(|out| sync(&out));
        if let Ok(mut summary) = self.summary.lock() {
            match ended {
                Ok(()) => summary.complete = true,
                Err(error) => summary.stopped = Some(error.to_string()),
            }
        }
    }
}
