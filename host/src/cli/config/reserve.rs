//! The reserve of a robot's tension loop: whether the simulated robot holds, and moves, with greater gains than its own.

use super::physics::Physics;
use crate::cli::progress::Phase;
use crate::experiment::{Experiment, SimulatedRobot};
use crate::machine::Mismatch;
use crate::motion::{Model, PlanOptions, Task};
use crate::robot::{Robot, TensionOutput};
use std::error::Error as _;
use std::path::PathBuf;

/// How long the simulated robot holds, s.
const HOLD_S: f64 = 2.0;
/// This many times its gains, a tension loop must not shake: a gain margin of 6 dB, the least that textbooks ask
/// (Åström and Murray, "Feedback Systems", 2nd ed., 2021, section 10.3: 2 to 5).
const RESERVE: f64 = 2.0;
/// Machines on which the reserve is tried.
const SEEDS: u64 = 3;
/// A tension error over this share of the set-point while the robot rests is shaking.
const MOST_SHAKING: f64 = 0.25;
/// Proportional gains that are tried where those of the file shake, N/N.
const KPS: [f64; 6] = [0.7, 0.5, 0.3, 0.2, 0.1, 0.05];
/// The same where the law commands a speed, mm/s per N.
const SPEED_KPS: [f64; 5] = [3.0, 2.0, 1.5, 1.0, 0.5];

/// Lines of `[tension]` beside its gains where the law commands a speed; they are those of
/// [`super::frame::GEARED_GAINS`].
const SPEED_LAW: &str = "ki = 0\nfilter_hz = 150\n\
    output = \"velocity\"                # the drive's own loop overcomes friction and loss of the gears\n";

/// What the simulated robot does: it rests at home, and moves as `mcdpr run fitting`.
struct Trial {
    rest: Option<Task>,
    /// Or why it cannot move, in words.
    moves: Result<Task, String>,
}

impl Trial {
    fn new(model: &Model) -> Self {
        let [x, y, z] = [0, 1, 2].map(|axis| model.robot().tool.home_in_world_m[axis] * 1e3);
        let text = format!("start_mm = [{x:?}, {y:?}, {z:?}]\n[[leg]]\ndwell_s = {HOLD_S:?}\n");
        Self {
            rest: Task::parse(&text, PathBuf::from("holding at home")).ok(),
            moves: Task::fitting(model).map_err(|error| match error.source() {
                Some(cause) => format!("{error}: {cause}"),
                None => error.to_string(),
            }),
        }
    }

    /// Whether a robot that differs from its file as realistic ones do holds, and moves.
    ///
    /// # Errors
    /// What happens instead, in words.
    fn passes(&self, model: &Model, seeds: u64) -> Result<(), String> {
        for seed in 1..=seeds {
            let simulated = SimulatedRobot::new(Mismatch::realistic(), seed);
            let run = |task: &Task| {
                let run = Experiment::new(model, task.clone()).simulate(&simulated);
                run.map_err(|error| error.to_string())
            };
            if let Some(rest) = &self.rest {
                let figures = run(rest)?.run.figures(model);
                let figures = figures.map_err(|error| error.to_string())?;
                // NaN without a cable that is held by tension: such a robot has no tension loop.
                let most_n = figures.tension_error_n.p999_abs;
                if most_n > MOST_SHAKING * model.robot().tension.setpoint_n {
                    return Err(format!("the tension shakes by {most_n:.1} N at rest"));
                }
            }
            if let Ok(moves) = &self.moves {
                run(moves)?;
            }
        }
        Ok(())
    }

    /// As [`Self::passes`], with [`RESERVE`] times the gains of this robot's tension loop.
    fn passes_with_reserve(&self, robot: &Robot) -> Result<(), String> {
        let mut eager = robot.clone();
        let law = &mut eager.tension;
        for gain in [
            &mut law.kp,
            &mut law.ki,
            &mut law.kd,
            &mut law.damping_ns_per_m,
        ] {
            *gain *= RESERVE;
        }
        let model = Model::new(&eager).map_err(|error| error.to_string())?;
        self.passes(&model.with_options(PlanOptions::default()), SEEDS)
    }
}

/// Arms the simulated robot, and lets it hold and move: a loop that shakes shows. With greater gains, its
/// reserve shows.
pub(super) fn judge(model: &Model, out: &mut Physics) {
    let phase = Phase::begin("simulating the robot");
    let trial = Trial::new(model);
    if let Err(error) = trial.passes(model, 1) {
        out.problems.push(format!(
            "simulation: it does not hold at home, or cannot move: {error}; {}: softer cables (ea_n), or other gains of \
             [tension] (`mcdpr tune tension`)",
            gains_and_play(model)
        ));
        return;
    }
    let does = match &trial.moves {
        Ok(_) => "holds at home and moves".to_owned(),
        Err(error) => {
            out.facts.push(format!(
                "warning: not even a small circle is within its limits ({error}): a heavier platform, another \
                 set-point, or other limits of tension"
            ));
            "holds at home".to_owned()
        }
    };
    let reserve = trial.passes_with_reserve(model.robot());
    drop(phase);
    out.facts.push(match reserve {
        Ok(()) => format!("simulation: it {does}, also with {RESERVE} times the gains of [tension]"),
        Err(error) => format!(
            "simulation: it {does}\nwarning: the tension loop has little reserve: with {RESERVE} times its gains, {error}; a \
             smaller kp of [tension] has more"
        ),
    });
}

/// The gains of the tension loop and the widest play of the winches that it turns: what may make it hunt.
fn gains_and_play(model: &Model) -> String {
    let robot = model.robot();
    let unit = match robot.tension.output {
        TensionOutput::Velocity => "mm/s per N",
        TensionOutput::Current => "N/N",
    };
    let held = model.holding().by_tension().iter();
    let gears = held.filter_map(|&cable| robot.winch_of(cable)?.gear.as_ref());
    let play_deg = gears
        .map(|gear| gear.play_rad.to_degrees())
        .fold(0.0, f64::max);
    format!(
        "kp is {} {unit}, and the gears behind it have up to {play_deg:.2} degrees of play",
        robot.tension.kp
    )
}

/// Lines of `[tension]` with softer gains for a robot that has too little reserve; `None` where its own are
/// fine, and where none of those tried are better.
pub(super) fn softer_gains(robot: &Robot) -> Option<String> {
    let model = Model::new(robot).ok()?;
    model.rest_at_home().ok()?;
    let _phase = Phase::begin("trying gains in the simulator");
    let trial = Trial::new(&model);
    if trial.passes_with_reserve(robot).is_ok() {
        return None;
    }
    let mut tried = robot.clone();
    // The derivative of a noisy tension costs margin, and damping does not need it.
    tried.tension.kd = 0.0;
    let by_speed = robot.tension.output == TensionOutput::Velocity;
    let mut fine = |kp: &f64| {
        tried.tension.kp = *kp;
        trial.passes_with_reserve(&tried).is_ok()
    };
    let kps: &[f64] = if by_speed { &SPEED_KPS } else { &KPS };
    let kp = kps.iter().copied().find(&mut fine)?;
    let gains = format!(
        "kp = {kp:<4}                         # of those tried, the greatest with which twice the gains\n\
         kd = 0                            # hold and move in the simulator\n"
    );
    // The other lines of such a law are those that were tried.
    let law = if by_speed { SPEED_LAW } else { "" };
    Some(gains + law)
}
