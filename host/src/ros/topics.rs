//! The robot's state as messages: joint states, frames, wrenches, diagnostics, pictures.

use super::actions::{self, Actions};
use super::calls;
use super::pipe::{Outlet, ToNode};
use crate::motion::Model;
use crate::record::panel;
use crate::record::ros2::{self, Condition, Encoded, Frame};
use crate::serve::feed::{Live, ShownPose};
use crate::serve::{Feed, Picture};
use mcdpr_kinematics::Pose;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Time between two looks at the robot: ROS sees it 50 times a second.
const EVERY: Duration = Duration::from_millis(20);
/// Diagnostics come at least this often.
const DIAGNOSTICS: Duration = Duration::from_secs(1);
/// A board that was not heard for this long is stale, s.
const STALE_S: f64 = 1.0;
/// Speeds of cables are means over this time, s: the drum encoders' steps of 31 µm are then 0.3 mm/s.
const SPEED_S: f64 = 0.1;
/// The node's name.
const NODE: &str = "mcdpr";

/// Topics of the node, in the order of their numbers; one wrench for each cable follows.
const TOPICS: [(&str, &str); 6] = [
    ("/joint_states", "sensor_msgs/JointState"),
    ("/tf", "tf2_msgs/TFMessage"),
    ("/tf_static", "tf2_msgs/TFMessage"),
    ("/diagnostics", "diagnostic_msgs/DiagnosticArray"),
    ("/camera/image/compressed", "sensor_msgs/CompressedImage"),
    ("/camera/camera_info", "sensor_msgs/CameraInfo"),
];

fn id_of(topic: &str, cables: usize) -> Option<usize> {
    let fixed = TOPICS.iter().position(|(name, _)| *name == topic);
    fixed.or_else(|| {
        let wrench = (0..cables).position(|cable| wrench(cable) == topic)?;
        Some(TOPICS.len() + wrench)
    })
}

fn wrench(cable: usize) -> String {
    format!("/cables/cable_{}/wrench", cable + 1)
}

/// A type as DDS names it: `sensor_msgs/JointState` is `sensor_msgs::msg::dds_::JointState_`.
fn dds_type(kind: &str) -> String {
    let full = kind.replacen('/', "::msg::dds_::", 1);
    format!("{full}_")
}

/// Nanoseconds of Unix time: what ROS stamps messages with.
fn now_ns() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| {
        u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
    })
}

/// Publishes what viewers see, until it is dropped.
pub(crate) struct Topics {
    over: Option<SyncSender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Topics {
    /// The lines that make the node, its topics and services, and place the fixed frames.
    pub(crate) fn greeting(model: &Model) -> Vec<String> {
        let cables = model.robot().cables.len();
        let wrenches = (0..cables).map(|cable| (wrench(cable), "geometry_msgs/WrenchStamped"));
        let fixed = TOPICS
            .iter()
            .map(|(name, kind)| ((*name).to_owned(), *kind));
        let topics = fixed.chain(wrenches).enumerate();
        let writers = topics.map(|(id, (topic, kind))| {
            let keep = topic == "/tf_static";
            let (topic, kind) = (format!("rt{topic}"), dds_type(kind));
            ToNode::Writer {
                id,
                topic,
                kind,
                keep,
            }
            .line()
        });
        let mut lines = vec![ToNode::Node { name: NODE }.line()];
        let first = TOPICS.len() + cables;
        let of_actions = actions::topics().enumerate();
        let of_actions = of_actions.map(|(place, (topic, kind, keep))| {
            let id = first + place;
            ToNode::Writer {
                id,
                topic,
                kind,
                keep,
            }
            .line()
        });
        lines.extend(writers.chain(of_actions).chain(calls::greeting()));
        let frames = panel::fixed(model).map(|(child, pose)| frame("platform", child, &pose));
        let fixed = ros2::transforms(now_ns(), &frames);
        if let Some(id) = id_of("/tf_static", 0) {
            lines.push(ToNode::sample(id, &fixed).line());
        }
        lines
    }

    /// Starts to publish.
    ///
    /// # Errors
    /// If the system has no thread for it.
    pub(crate) fn start(
        outlet: Outlet,
        feed: Feed,
        actions: Actions,
        model: Model,
    ) -> std::io::Result<Self> {
        let (over, ended) = sync_channel(0);
        let mut source = Source::new(model);
        let thread = std::thread::Builder::new()
            .name("topics".to_owned())
            .spawn(move || {
                while ended.recv_timeout(EVERY) == Err(RecvTimeoutError::Timeout) {
                    let (live, age_s) = feed.now();
                    let picture = feed.picture_after(source.picture);
                    for (topic, message) in source.messages(&live, age_s, picture, now_ns()) {
                        if let Some(id) = id_of(&topic, source.cables()) {
                            outlet.send(&ToNode::sample(id, &message));
                        }
                    }
                    for (place, message) in actions.due(live.path_s, live.duration_s) {
                        let id = TOPICS.len() + source.cables() + place;
                        outlet.send(&ToNode::sample(id, &message));
                    }
                }
            })?;
        Ok(Self {
            over: Some(over),
            thread: Some(thread),
        })
    }
}

impl Drop for Topics {
    fn drop(&mut self) {
        drop(self.over.take());
        if let Some(thread) = self.thread.take() {
            // One that panicked has said so.
            let _ = thread.join();
        }
    }
}

fn frame<'a>(parent: &'a str, child: &str, pose: &Pose) -> Frame<'a> {
    let turn = pose.quaternion();
    Frame {
        parent,
        child: child.to_owned(),
        place_m: pose.position_m.into(),
        turn_xyzw: [turn.i, turn.j, turn.k, turn.w],
    }
}

fn pose_of(shown: &ShownPose) -> Pose {
    let [x, y, z, w] = shown.rotation_xyzw;
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    Pose {
        position_m: Vector3::from(shown.position_m),
        rotation: turn.to_rotation_matrix(),
    }
}

/// Makes messages of what changes.
struct Source {
    model: Model,
    revision: u64,
    /// Number of the last picture.
    picture: u64,
    /// Lengths of the last moments, with their time on the line, s.
    lengths: VecDeque<(f64, Vec<f64>)>,
    diagnosed: Option<(Instant, Vec<String>)>,
}

impl Source {
    fn new(model: Model) -> Self {
        Self {
            model,
            revision: 0,
            picture: 0,
            lengths: VecDeque::new(),
            diagnosed: None,
        }
    }

    fn cables(&self) -> usize {
        self.model.robot().cables.len()
    }

    fn messages(
        &mut self,
        live: &Live,
        age_s: Option<f64>,
        picture: Option<(u64, Arc<Picture>)>,
        time_ns: u64,
    ) -> Vec<(String, Encoded)> {
        let mut out = Vec::new();
        let mut put = |topic: &str, message| out.push((topic.to_owned(), message));
        if live.revision != self.revision && live.lengths_m.len() == self.cables() {
            self.revision = live.revision;
            let speeds_mps = self.speeds_mps(live);
            let (lengths_m, tensions_n) = (&live.lengths_m, &live.tensions_n);
            let joints = ros2::joint_state(time_ns, lengths_m, &speeds_mps, tensions_n);
            put("/joint_states", joints);
            if let Some(shown) = &live.pose {
                let mut frames = vec![frame("world", "platform", &pose_of(shown))];
                for pull in self.pulls(shown, tensions_n, time_ns) {
                    put(&pull.topic, pull.wrench);
                    frames.push(pull.frame);
                }
                put("/tf", ros2::transforms(time_ns, &frames));
            }
        }
        if let Some(message) = self.diagnostics(live, age_s, time_ns) {
            put("/diagnostics", message);
        }
        if let Some((number, picture)) = picture {
            self.picture = number;
            put(
                "/camera/image/compressed",
                ros2::picture(time_ns, "png", &picture.png),
            );
            put("/camera/camera_info", self.lens(&picture, time_ns));
        }
        out
    }

    /// Mean speeds over a tenth of a second, m/s; empty without an earlier length.
    fn speeds_mps(&mut self, live: &Live) -> Vec<f64> {
        // Another session's clock may begin anew.
        if self
            .lengths
            .back()
            .is_some_and(|(time_s, _)| *time_s > live.time_s)
        {
            self.lengths.clear();
        }
        self.lengths
            .push_back((live.time_s, live.lengths_m.clone()));
        while self
            .lengths
            .get(1)
            .is_some_and(|(time_s, _)| live.time_s - time_s >= SPEED_S)
        {
            self.lengths.pop_front();
        }
        let Some((time_s, before_m)) = self.lengths.front() else {
            return Vec::new();
        };
        let passed_s = live.time_s - time_s;
        if passed_s <= 0.0 {
            return Vec::new();
        }
        let pairs = live.lengths_m.iter().zip(before_m);
        pairs
            .map(|(now, before)| (now - before) / passed_s)
            .collect()
    }

    fn pulls(&self, shown: &ShownPose, tensions_n: &[f64], time_ns: u64) -> Vec<ros2::Pull> {
        let Ok(paths) = self.model.geometry().paths(&pose_of(shown)) else {
            return Vec::new();
        };
        let cables = paths.iter().zip(tensions_n).enumerate();
        let pulls = cables.map(|(cable, (path, tension_n))| {
            let (from_m, to_m) = (path.tangent_point_m.into(), path.attachment_m.into());
            ros2::pull(time_ns, cable, &from_m, &to_m, *tension_n)
        });
        pulls.collect()
    }

    /// Once a second, and when its words change.
    fn diagnostics(&mut self, live: &Live, age_s: Option<f64>, time_ns: u64) -> Option<Encoded> {
        let stale = age_s.is_none_or(|age_s| age_s > STALE_S);
        let level = if live.fault.is_some() || live.trouble.is_some() {
            Condition::Error
        } else if stale {
            Condition::Stale
        } else if live.limits.is_empty() {
            Condition::Ok
        } else {
            Condition::Warning
        };
        let said = match (&live.fault, &live.trouble) {
            (Some(fault), _) => fault.as_str(),
            (None, Some(trouble)) => trouble.as_str(),
            (None, None) if stale => "the board says nothing",
            (None, None) => live.words,
        };
        let some = |text: &Option<String>| text.clone().unwrap_or_default();
        let words = [
            ("state", live.state.clone()),
            ("task", live.task.clone()),
            ("fault", some(&live.fault)),
            ("advice", live.advice.unwrap_or_default().to_owned()),
            ("limits", live.limits.join(", ")),
            ("trouble", some(&live.trouble)),
            ("brakes_open", format!("{:#b}", live.brakes_open)),
            ("torque_on", format!("{:#b}", live.torque_on)),
        ];
        let mut shown: Vec<_> = words.iter().map(|(_, word)| word.clone()).collect();
        shown.push(said.to_owned());
        let now = Instant::now();
        let again = self
            .diagnosed
            .as_ref()
            .is_some_and(|(at, last)| *last == shown && now.duration_since(*at) < DIAGNOSTICS);
        if again {
            return None;
        }
        self.diagnosed = Some((now, shown));
        let mut values = words.to_vec();
        values.push(("path_s", format!("{:.2}", live.path_s)));
        values.push(("duration_s", format!("{:.2}", live.duration_s)));
        values.push(("frames_bad", live.frames_bad.to_string()));
        let robot = &self.model.robot().name;
        Some(ros2::diagnostics(time_ns, level, said, robot, &values))
    }

    /// The lens of a picture, which may be smaller than the camera's.
    fn lens(&self, picture: &Picture, time_ns: u64) -> Encoded {
        let lens = &self.model.robot().camera.lens;
        let size = |key: &str| {
            let pixels = picture.about[key].as_u64().unwrap_or(0);
            u32::try_from(pixels).unwrap_or(0)
        };
        let sizes = [size("width"), size("height")];
        let [full, _] = lens.size_px;
        let share = f64::from(sizes[0]) / (full.max(1) as f64);
        let [fx, fy] = lens.focal_px.map(|x| x * share);
        let [cx, cy] = lens.center_px.map(|x| x * share);
        let matrices = [
            vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        ];
        ros2::lens(time_ns, sizes, "plumb_bob", &lens.distortion, &matrices)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;
    use crate::serve::feed::Source as PoseSource;

    fn source() -> Source {
        let robot = Robot::built_in("paper-optimistic").unwrap();
        Source::new(Model::new(&robot).unwrap())
    }

    fn live(source: &Source, revision: u64, time_s: f64, longer_m: f64) -> Live {
        let rest = source.model.rest_at_home().unwrap();
        let pose = &rest.equilibrium.pose;
        let turn = pose.quaternion();
        Live {
            revision,
            time_s,
            lengths_m: rest.paid_out_m.iter().map(|l| l + longer_m).collect(),
            tensions_n: rest.tensions_n().to_vec(),
            pose: Some(ShownPose {
                position_m: pose.position_m.into(),
                rotation_xyzw: [turn.i, turn.j, turn.k, turn.w],
                tool_m: source.model.tool_m(&rest).into(),
                source: PoseSource::Truth,
            }),
            state: "Holding".to_owned(),
            ..Live::default()
        }
    }

    #[test]
    fn every_message_has_a_topic_and_what_does_not_change_is_not_sent() {
        let mut source = source();
        let first = live(&source, 1, 1.0, 0.0);
        let sent = source.messages(&first, Some(0.0), None, 5);
        let topics: Vec<_> = sent.iter().map(|(topic, _)| topic.as_str()).collect();
        let wanted = [
            "/joint_states",
            "/cables/cable_1/wrench",
            "/cables/cable_2/wrench",
            "/cables/cable_3/wrench",
            "/cables/cable_4/wrench",
            "/tf",
            "/diagnostics",
        ];
        assert_eq!(topics, wanted);
        assert!(topics.iter().all(|topic| id_of(topic, 4).is_some()));
        assert!(source.messages(&first, Some(0.0), None, 6).is_empty());
        // A fault is published at once.
        let faulty = Live {
            fault: Some("S2".to_owned()),
            ..first
        };
        let sent = source.messages(&faulty, Some(0.0), None, 7);
        assert_eq!(sent.len(), 1);
    }

    #[test]
    fn speeds_are_means_over_a_tenth_of_a_second() {
        let mut source = source();
        for step in 0..20_u32 {
            let time_s = 1.0 + 0.02 * f64::from(step);
            let live = live(&source, 1, time_s, 0.05 * (time_s - 1.0));
            let speeds_mps = source.speeds_mps(&live);
            assert_eq!(speeds_mps.is_empty(), step == 0);
            for speed_mps in speeds_mps {
                assert!((speed_mps - 0.05).abs() < 1e-9, "{speed_mps}");
            }
        }
        let kept_s = source.lengths.back().unwrap().0 - source.lengths.front().unwrap().0;
        assert!((0.099..0.13).contains(&kept_s), "{kept_s}");
        // A clock that begins anew makes no speeds.
        let anew = live(&source, 1, 0.0, 0.0);
        assert!(source.speeds_mps(&anew).is_empty());
    }

    #[test]
    fn wrenches_carry_the_platform() {
        let mut source = source();
        let rest = live(&source, 1, 1.0, 0.0);
        let sent = source.messages(&rest, Some(0.0), None, 5);
        let wrenches = sent.iter().filter(|(topic, _)| topic.ends_with("wrench"));
        // The message: stamp (8), name of 13 bytes with its count, then the force at a multiple of 8.
        let up_n: f64 = wrenches
            .map(|(_, message)| {
                let z = message.data.get(4 + 32 + 16..4 + 32 + 24).unwrap();
                f64::from_le_bytes(z.try_into().unwrap())
            })
            .sum();
        let weight_n = source.model.robot().platform.mass_kg * 9.806_65;
        assert!(
            (up_n - weight_n).abs() < 0.01 * weight_n,
            "{up_n} N, {weight_n} N"
        );
    }

    #[test]
    fn types_are_named_as_in_dds() {
        assert_eq!(
            dds_type("sensor_msgs/JointState"),
            "sensor_msgs::msg::dds_::JointState_"
        );
    }
}
