//! What happens on a line to a robot, and what the host knows besides, for records and live views.

use mcdpr_core::control::Order;
use mcdpr_core::link::RawFrame;
use mcdpr_core::motion::{Plan, Resumed};
use mcdpr_core::sight::Shown;
use mcdpr_simulator::TracePoint;
use serde::{Deserialize, Serialize};

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

/// Receives events.
pub trait Watcher: Send + 'static {
    /// An event.
    fn see(&mut self, event: &RunEvent);
    /// No events for a while: time for deferred work.
    fn idle(&mut self) {}
    /// The run is over.
    fn end(&mut self) {}
}
