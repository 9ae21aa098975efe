//! What a seed draws: the task, the moment and the faults.

use super::super::{How, Injection, Phase, Scenario, When, how};
use mcdpr_core::motion::{Model, Task};
use mcdpr_core::random::Random;
use mcdpr_core::run::plan_from;
use mcdpr_protocol::FaultId;

/// Phases of a robot's work in which faults are injected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Moment {
    /// Before the host connects.
    Off,
    /// It arms behind closed brakes.
    Arming,
    /// Its brakes are open, and it turns its drums a little.
    Stirring,
    /// On a straight line.
    Moving,
    /// On a curve through places.
    Blending,
    /// At rest under tension.
    Holding,
    /// It decelerates after a host's stop.
    Stopping,
    /// Brakes close under torque.
    Closing,
    /// Brakes are closed, torque is off.
    Parked,
    /// It arms for the second time.
    Rearming,
}

impl Moment {
    /// Every phase, in the order of a day.
    pub const ALL: [Self; 10] = [
        Self::Off,
        Self::Arming,
        Self::Stirring,
        Self::Moving,
        Self::Blending,
        Self::Holding,
        Self::Stopping,
        Self::Closing,
        Self::Parked,
        Self::Rearming,
    ];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Arming => "arming",
            Self::Stirring => "stirring",
            Self::Moving => "moving",
            Self::Blending => "blending",
            Self::Holding => "holding",
            Self::Stopping => "stopping",
            Self::Closing => "closing",
            Self::Parked => "parked",
            Self::Rearming => "re-arming",
        }
    }
}

/// What a seed draws.
#[derive(Debug, Clone)]
pub struct Drawn {
    /// The seed.
    pub seed: u64,
    /// The phase of the first fault.
    pub moment: Moment,
    /// The faults, one or two.
    pub injections: Vec<Injection>,
    /// The task: a line from home, a curve back, a rest.
    pub task: Task,
    /// When the host orders a stop, s of path time.
    pub stop_s: Option<f64>,
}

/// Rest at the end of a task, s.
const REST_S: f64 = 0.6;

/// Draws a run. `None` if no motion was found.
pub(super) fn draw(model: &Model, seed: u64) -> Option<Drawn> {
    let mut draw = Random::new(seed ^ 0x7375_7276);
    let (task, line_s, all_s) = task(&mut draw, model)?;
    let moment = Moment::ALL.get(draw.below(Moment::ALL.len())).copied();
    let moment = moment.unwrap_or(Moment::Moving);
    let stop_s = (moment == Moment::Stopping).then(|| draw.between(0.2, 0.8) * (all_s - REST_S));
    let at = |draw: &mut Random| match moment {
        Moment::Off => When::Start,
        Moment::Arming => When::After(Phase::Arming, draw.between(0.0, 0.9)),
        Moment::Stirring => When::After(Phase::Stirring, draw.between(0.0, 0.8)),
        Moment::Moving => When::Motion(draw.between(0.0, line_s)),
        Moment::Blending => When::Motion(draw.between(line_s, all_s - REST_S)),
        Moment::Holding => When::Motion(draw.between(all_s - REST_S, all_s)),
        Moment::Stopping => When::After(Phase::Stopping, draw.between(0.0, 0.28)),
        Moment::Closing => When::After(Phase::Closing, draw.between(0.0, 0.25)),
        Moment::Parked => When::After(Phase::Parked, draw.between(0.0, 1.5)),
        Moment::Rearming => When::After(Phase::Rearming, draw.between(0.0, 1.8)),
    };
    // Every tenth run has two faults in the same phase.
    let count = if draw.unit() < 0.1 { 2 } else { 1 };
    let mut injections = Vec::new();
    while injections.len() < count {
        let known = rows(model);
        let fault = *known.get(draw.below(known.len()))?;
        // Half of them as the table describes them, half weaker.
        let strength = if draw.unit() < 0.5 {
            1.0
        } else {
            draw.between(0.3, 1.0)
        };
        let injection = Injection {
            cable: draw.below(model.robot().cables.len()),
            strength,
            ..Injection::new(fault, at(&mut draw))
        };
        injections.push(injection);
    }
    Some(Drawn {
        seed,
        moment,
        injections,
        task,
        stop_s,
    })
}

/// The rows that can be injected into this robot.
fn rows(model: &Model) -> Vec<FaultId> {
    let all = FaultId::ALL.iter().copied();
    all.filter(|fault| {
        let alone = Scenario {
            name: String::new(),
            injections: vec![Injection::new(*fault, When::Start)],
        };
        !matches!(how(*fault), How::Not(_)) && alone.suits(model.robot()).is_ok()
    })
    .collect()
}

/// A line from home, a curve back to it, and a rest; with the durations of the line and of all. The
/// first of some draws that the robot can do.
fn task(draw: &mut Random, model: &Model) -> Option<(Task, f64, f64)> {
    let home = model.robot().tool.home_in_world_m * 1e3;
    // A robot in a plane moves in its plane only.
    let masks = [
        [1.0, 1.0, 1.0],
        [1.0, 0.0, 1.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 1.0],
    ];
    for attempt in 0..40 {
        let mask = masks.get(attempt / 10)?;
        let mut place = || {
            let low = [-40.0, -40.0, -25.0];
            let high = [40.0, 40.0, 20.0];
            let mut place = [home.x, home.y, home.z];
            for axis in 0..3 {
                place[axis] += mask[axis] * draw.between(low[axis], high[axis]);
            }
            place
        };
        let [to, by] = [place(), place()];
        let home = [home.x, home.y, home.z];
        let line = format!("start_mm = {home:?}\n[[leg]]\nto_mm = {to:?}\n");
        let whole = format!(
            "{line}[[leg]]\nthrough_mm = [{by:?}, {home:?}]\n[[leg]]\ndwell_s = {REST_S:?}\n"
        );
        let parse = |text: &str| Task::parse(text, "drawn.toml".into()).ok();
        let (Some(line), Some(whole)) = (parse(&line), parse(&whole)) else {
            continue;
        };
        let lasts_s = |task: Task| {
            let plan = plan_from(model, task, &model.robot().tool.home_in_world_m, None);
            Some(plan.ok()?.timed.duration_s())
        };
        if let (Some(line_s), Some(all_s)) = (lasts_s(line), lasts_s(whole.clone())) {
            return Some((whole, line_s.min(all_s - REST_S), all_s));
        }
    }
    None
}
