//! `mcdpr move`, `jog`, `park`, `home`, `arm`, `disarm`, `gripper`: one thing at a time.

use super::eye::Eye;
use super::numbers::{finite, length_mm, positive};
use super::progress::Bar;
use super::reach::with_session;
use super::{Common, Failed, Outcome, print_json};
use crate::link::{Link, describe_fault};
use crate::motion::{Model, Plan, PlanOptions, Shaping, Task};
use crate::recovery::{KnownTags, keep_reference, look_when_homed};
use crate::robot::TagPlace;
use crate::run::saved::board_name;
use crate::run::{Homing, Recorder, RunError, Session, jog};
use crate::sight::{SightError, TagSource, TagView};
use mcdpr_core::recovery::reference::Homed;
use nalgebra::Vector3;
use std::cell::RefCell;

/// Move the tool straight to a place, then close the brakes
#[derive(Debug, clap::Args)]
pub(crate) struct Move {
    /// Position of the tool in the world, mm or with a unit (-0.05m)
    #[arg(allow_hyphen_values = true, value_parser = length_mm)]
    x: f64,
    /// The same
    #[arg(allow_hyphen_values = true, value_parser = length_mm)]
    y: f64,
    /// The same
    #[arg(allow_hyphen_values = true, value_parser = length_mm)]
    z: f64,
    /// Greatest speed, mm/s; the robot file's limit if left out
    #[arg(long, value_name = "MM_S", value_parser = positive)]
    speed: Option<f64>,
    /// Shape the motion against swing
    #[arg(long, value_enum, default_value_t = Shaping::None)]
    shaping: Shaping,
}

/// Move the tool at a velocity for a while, within the limits; it stops by itself
#[derive(Debug, clap::Args)]
pub(crate) struct Jog {
    /// Velocity of the tool in the world, mm/s
    #[arg(num_args = 3, required = true, value_names = ["VX", "VY", "VZ"], allow_negative_numbers = true, value_parser = finite)]
    velocity_mm_s: Vec<f64>,
    /// For how long, s
    #[arg(long = "for", value_name = "S", default_value_t = 1.0, value_parser = positive)]
    seconds: f64,
}

/// Move the tool home, then close the brakes
#[derive(Debug, clap::Args)]
pub(crate) struct Park {}

/// Set the board's cable lengths from the tool's present position; nothing moves. With --camera it also keeps where
/// the tags are seen from here, for `mcdpr recover`
#[derive(Debug, clap::Args)]
pub(crate) struct Home {
    /// The tool hangs here, world, mm; the robot file's home if left out
    #[arg(long, num_args = 3, value_names = ["X", "Y", "Z"], allow_hyphen_values = true, value_parser = length_mm)]
    at: Option<Vec<f64>>,
    /// Use a tag whose pose is known: in view of --camera, or of the simulator's camera
    #[arg(long, conflicts_with = "at")]
    tag: bool,
    #[command(flatten)]
    eye: Eye,
}

/// Enable drives, check, open brakes and hold until Ctrl-C or `mcdpr stop`
#[derive(Debug, clap::Args)]
pub(crate) struct Arm {
    /// Disarm again after this long, s
    #[arg(long = "for", value_name = "S", value_parser = positive)]
    seconds: Option<f64>,
}

/// Close brakes and switch torque off, whichever program armed the robot
#[derive(Debug, clap::Args)]
pub(crate) struct Disarm {}

/// Open or close the gripper
#[derive(Debug, clap::Args)]
pub(crate) struct Gripper {
    /// The action
    #[arg(value_enum)]
    what: Fingers,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Fingers {
    /// Release
    Open,
    /// Grip
    Close,
}

fn place_m(values: &[f64]) -> Vector3<f64> {
    // A missing coordinate is refused, not taken for zero.
    Vector3::from_iterator(values.iter().copied().chain([f64::NAN; 3]).take(3)) * 1e-3
}

impl Move {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let options = PlanOptions {
            shaping: self.shaping,
            ..PlanOptions::default()
        };
        go(
            common,
            "move",
            place_m(&[self.x, self.y, self.z]),
            self.speed.map(|v| v * 1e-3),
            options,
        )
    }
}

impl Park {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let home = common.robot()?.tool.home_in_world_m;
        go(common, "park", home, None, PlanOptions::default())
    }
}

fn go(
    common: &Common,
    name: &'static str,
    to_m: Vector3<f64>,
    speed_mps: Option<f64>,
    options: PlanOptions,
) -> Outcome {
    let model = Model::new(&common.robot()?)?.with_options(options);
    let task = Task::go_to(name, to_m)?;
    if common.dry_run {
        let home = model.robot().tool.home_in_world_m;
        let plan = crate::run::plan_from(&model, task, &home, speed_mps);
        return match plan {
            Ok(plan) => report(common, name, &plan, "nothing was moved"),
            Err(RunError::Plan(error)) if is_there(&error) => there(common, name),
            Err(error) => Err(error.into()),
        };
    }
    let bar = Bar::new(name);
    let plan = with_session(common, &model, Some(name), None, |mut session| {
        let plan = match session.plan(task, speed_mps) {
            Err(RunError::Plan(error)) if is_there(&error) => {
                session.close()?;
                return Ok(None);
            }
            plan => plan?,
        };
        session.arm()?;
        session.follow(&plan, &mut Recorder::default(), |p| bar.update(p))?;
        session.disarm()?;
        Ok(Some(plan))
    })?;
    bar.finish();
    match plan {
        Some(plan) => report(common, name, &plan, "brakes closed"),
        None => there(common, name),
    }
}

/// A move of zero length: the tool is already there.
fn is_there(error: &crate::motion::PlanError) -> bool {
    use crate::motion::{PlanError, path::PathError};
    matches!(error, PlanError::Path(PathError::Empty))
}

fn there(common: &Common, name: &str) -> Outcome {
    if common.json {
        return print_json(&serde_json::json!({ "done": name, "duration_s": 0.0 }));
    }
    say!("{name}: the tool is already there");
    Ok(())
}

fn report(common: &Common, name: &str, plan: &Plan, end: &str) -> Outcome {
    let duration_s = plan.timed.duration_s();
    let at = plan.timed.tool_m(duration_s)?;
    if common.json {
        let tool: [f64; 3] = at.into();
        return print_json(
            &serde_json::json!({ "done": name, "duration_s": duration_s, "tool_m": tool }),
        );
    }
    let at = at * 1e3;
    say!(
        "{name}: tool at ({:.1}, {:.1}, {:.1}) mm after {duration_s:.2} s; {end}",
        at.x,
        at.y,
        at.z
    );
    Ok(())
}

impl Jog {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let model = Model::new(&common.robot()?)?;
        let velocity_mps = place_m(&self.velocity_mm_s);
        if velocity_mps.norm() == 0.0 {
            let reason = "a jog needs a speed over 0 mm/s in some direction";
            return Err(Failed::from_error("VX VY VZ")(reason).into());
        }
        jog::check(&model, &velocity_mps, self.seconds)?;
        if common.dry_run {
            if common.json {
                return print_json(&serde_json::json!({ "allowed": "jog" }));
            }
            say!(
                "jog: {:.0} mm/s for {} s is allowed; nothing was moved",
                velocity_mps.norm() * 1e3,
                self.seconds
            );
            return Ok(());
        }
        let (from, to, why) = with_session(common, &model, Some("jog"), None, |mut session| {
            session.arm()?;
            let from = session.tool_m();
            let why = session.jog(velocity_mps, self.seconds)?;
            let to = session.tool_m();
            session.disarm()?;
            Ok((from, to, why))
        })?;
        let way_mm = (to - from).norm() * 1e3;
        if common.json {
            let tool: [f64; 3] = to.into();
            return print_json(&serde_json::json!({
                "done": "jog", "way_m": way_mm * 1e-3, "tool_m": tool, "ended_by": why,
            }));
        }
        let at = to * 1e3;
        let why = why.map_or(String::new(), |why| format!(", stopped short: {why}"));
        say!(
            "jog: {way_mm:.1} mm, tool at ({:.1}, {:.1}, {:.1}) mm{why}; brakes closed",
            at.x,
            at.y,
            at.z
        );
        Ok(())
    }
}

impl Home {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = common.robot()?;
        let model = Model::new(&robot)?;
        let place = self
            .at
            .as_deref()
            .map_or(robot.tool.home_in_world_m, place_m);
        // A position where the robot cannot hang is refused before a board is even opened.
        let rest = model.rest(&place, None)?;
        if common.dry_run {
            let home = "the board was not changed";
            return homed(common, (place, rest.paid_out_m), home);
        }
        if common.on == "sim" {
            self.eye.refused_on_simulator("--camera")?;
            if self.tag {
                model.comes_to_rest("homing by tags")?;
                return home_by_tag(common, &model);
            }
        }
        let mut camera = self.eye.tags(model.robot(), &common.page)?;
        let Some(camera) = &mut camera else {
            if self.tag {
                let reason = "there is no camera behind this port; name one with --camera, or give the place with --at X Y Z";
                return Err(Failed::from_error("--tag")(reason).into());
            }
            let session = with_session(common, &model, None, Some(Homing::Place(place)), ended)?;
            return homed(common, session, "homed");
        };
        model.comes_to_rest("homing with tags in view")?;
        let calibrated = robot.calibrated.as_ref();
        let places = calibrated.map_or(Vec::new(), |calibrated| calibrated.places.clone());
        if places.is_empty() {
            let reason =
                "this robot file has no places of tags: calibrate first, with `mcdpr calibrate`";
            return Err(Failed::from_error("--camera")(reason).into());
        }
        // Homing and the look after it use the same camera, one after the other.
        let camera = RefCell::new(camera);
        let mut first = InTurn(&camera);
        let (homing, how) = if self.tag {
            say_one_tag(&robot, &places);
            let places = places.clone();
            let camera: &mut dyn TagSource = &mut first;
            (Homing::Tags { camera, places }, Homed::ByTag)
        } else {
            (Homing::Place(place), Homed::Taught)
        };
        let found = with_session(common, &model, None, Some(homing), |mut session| {
            keep_view(&mut session, &mut InTurn(&camera), places, how)?;
            ended(session)
        })?;
        homed(common, found, "homed")
    }
}

/// A camera that two users have in turn.
struct InTurn<'a, S>(&'a RefCell<&'a mut S>);

impl<S: TagSource> TagSource for InTurn<'_, S> {
    fn look(&mut self) -> Result<Vec<TagView>, SightError> {
        self.0.borrow_mut().look()
    }
}

/// Keeps where the camera sees the tags of a robot that has just been homed; nothing moves.
fn keep_view<L: Link>(
    session: &mut Session<'_, L>,
    camera: &mut dyn TagSource,
    places: Vec<TagPlace>,
    how: Homed,
) -> Result<(), RunError> {
    let (model, lengths_m) = (session.model(), session.at().paid_out_m.clone());
    let board = board_name(session.client().hello());
    let tags = KnownTags { camera, places };
    match look_when_homed(session.client(), model, tags, &lengths_m, how)? {
        Some(view) => {
            if let Err(error) = keep_reference(&board, &view) {
                eprintln!("warning: the view of the tags was not kept: {error}");
            }
        }
        None => eprintln!(
            "the view of the tags was not kept: no tag stays in view, the platform moves, or camera and tags are off by more than a calibration leaves"
        ),
    }
    Ok(())
}

/// Reports the robot's position; nothing moved.
fn ended<'a>(
    session: Session<'a, Box<dyn Link + 'a>>,
) -> Result<(Vector3<f64>, Vec<f64>), RunError> {
    let found = (session.tool_m(), session.at().paid_out_m.clone());
    session.close()?;
    Ok(found)
}

fn home_by_tag(common: &Common, model: &Model) -> Outcome {
    use crate::sight::{Scene, SimulatedTags};
    let options = mcdpr_simulator::LinkOptions::default();
    let mismatch = crate::machine::Mismatch::realistic();
    let link = crate::experiment::SimulatedRobot::new(mismatch, common.seed)
        .line(options)
        .controller(&common.controller)
        .at_home(model)?;
    let scene = Scene::on_floor(model.robot(), 0.0, 0.0, common.seed);
    let places = scene.places.clone();
    say_one_tag(model.robot(), &places);
    let mut camera = SimulatedTags::new(link.clone(), scene, 0.1, common.seed);
    let boxed: Box<dyn Link> = Box::new(link.clone());
    let session = Session::open(
        model,
        boxed,
        crate::run::new_session(),
        &crate::control::Handle::new(),
        Homing::Tags {
            camera: &mut camera,
            places,
        },
        &crate::run::LengthFiles,
    )?;
    homed(common, ended(session)?, "homed")
}

/// Tells what homing by a single tag is worth (docs/results/motion.md).
fn say_one_tag(robot: &crate::robot::Robot, places: &[TagPlace]) {
    let known = |body: u32| places.iter().any(|place| place.body == body);
    if robot.tags.iter().filter(|tag| known(tag.body)).count() == 1 {
        eprintln!(
            "in simulation a single tag places the tool to 0.8 mm, and a fifth of the runs ended with a fault; the board of \
             tags gives 0.2 mm (`mcdpr calibrate target`)"
        );
    }
}

fn homed(common: &Common, (at_m, lengths_m): (Vector3<f64>, Vec<f64>), done: &str) -> Outcome {
    if common.json {
        let tool: [f64; 3] = at_m.into();
        return print_json(&serde_json::json!({ "tool_m": tool, "lengths_m": lengths_m }));
    }
    let at = at_m * 1e3;
    let lengths: Vec<_> = lengths_m
        .iter()
        .map(|l| format!("{:.2}", l * 1e3))
        .collect();
    say!(
        "{done}: tool at ({:.2}, {:.2}, {:.2}) mm, cables {} mm",
        at.x,
        at.y,
        at.z,
        lengths.join(", ")
    );
    Ok(())
}

impl Arm {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let model = Model::new(&common.robot()?)?;
        if let Some(seconds) = self.seconds.filter(|s| !(s.is_finite() && *s >= 0.0)) {
            return Err(Failed::from_error("--for")(format!("{seconds} is not a time")).into());
        }
        // A simulated robot in this process is not used by other terminals.
        let seconds = self.seconds.or((common.on == "sim").then_some(1.0));
        with_session(common, &model, Some("arm"), None, |mut session| {
            session.arm()?;
            if !common.json {
                eprintln!("armed: it holds under tension; Ctrl-C or `mcdpr stop` ends it");
            }
            session.hold(seconds)?;
            session.disarm()
        })?;
        done(common, "disarmed", "armed, held, disarmed: brakes closed")
    }
}

impl Disarm {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let model = Model::new(&common.robot()?)?;
        with_session(common, &model, None, None, |mut session| {
            session.client().stop(mcdpr_protocol::StopKind::Stop)?;
            crate::run::wait_for(
                session.client(),
                mcdpr_protocol::BoardState::Disarmed,
                crate::run::PARKS_S,
            )?;
            session.close()
        })?;
        done(common, "disarmed", "disarmed: brakes closed, torque off")
    }
}

impl Gripper {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let model = Model::new(&common.robot()?)?;
        let closed = self.what == Fingers::Close;
        let fault = with_session(common, &model, None, None, |mut session| {
            session.gripper(closed)?;
            let status = crate::run::status(session.client())?;
            session.close()?;
            Ok(status.fault)
        })?;
        if let Some(record) = fault {
            return Err(Failed::from_error("the gripper")(describe_fault(&record)).into());
        }
        let what = if closed { "closed" } else { "open" };
        done(common, what, &format!("gripper {what}"))
    }
}

fn done(common: &Common, json: &str, words: &str) -> Outcome {
    if common.json {
        return print_json(&serde_json::json!({ "done": json }));
    }
    say!("{words}");
    Ok(())
}
