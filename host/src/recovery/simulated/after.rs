//! The robot after the power is back: its journal, the recovery, the rest of its task.

use crate::experiment::{Experiment, Run, in_calibrated_frame, in_known_frame};
use crate::link::{Client, SimulatedLink};
use crate::motion::{Model, Task};
use crate::recovery::{
    Before, Journal, JournalError, KnownTags, MemoryDisk, Verdict, look_when_homed, recover,
};
use crate::report;
use crate::robot::TagPlace;
use crate::run::saved::scale_of;
use crate::run::{self, RunError};
use crate::sight::{Scene, SimulatedTags, TagSource};
use mcdpr_core::random::Random;
use mcdpr_core::recovery::journal::Mark;
use mcdpr_core::recovery::reference::{Homed, TagReference};
use mcdpr_protocol::{Request, SessionId};
use mcdpr_simulator::Simulation;
use nalgebra::Vector3;

/// Noise of a tag's corners, px.
const CORNER_PX: f64 = 0.1;
/// Error of the camera's mounting after a calibration: half width, m and rad.
const MOUNTING: [f64; 2] = [2e-4, 3e-4];

/// The place of a tag as a calibration has it, half width per axis, m: as that of anchors
/// ([`crate::machine::Mismatch::realistic`]).
const TAG_PLACE_M: f64 = 3e-4;

/// A robot whose power is back.
pub struct AfterCut {
    /// The line to the robot.
    pub link: SimulatedLink,
    /// The journal's bytes.
    pub journal: Vec<u8>,
    /// The last record that is certainly on the disk.
    pub mark: Option<Mark>,
    /// Number of its board.
    pub board: String,
    /// How far the tool fell below its planned motion, m.
    pub drop_m: f64,
    /// Speed of the tool at the cut, m/s.
    pub speed_mps: f64,
    /// Whether computer and robot lost their supply at the same time: a person who confirms what happened
    /// confirms that, too.
    pub together: bool,
    /// Whether drums may be wound gently where the evidence is not enough.
    pub gentle: bool,
    /// Where the camera saw the tags when the robot was homed.
    pub reference: Option<TagReference>,
    /// Where the robot was homed minus where its tool was, world, m.
    pub(in crate::recovery) homed_off_m: Vector3<f64>,
    pub(in crate::recovery) seed: u64,
}

/// The camera of a simulated robot, and the places of the tags as a calibration has them.
fn camera(model: &Model, link: &SimulatedLink, seed: u64) -> (SimulatedTags, Vec<TagPlace>) {
    let robot = model.robot();
    let calibrated = robot.calibrated.as_deref();
    let (scene, places) = match calibrated.filter(|found| found.simulated_seed.is_some()) {
        Some(found) => (Scene::of(robot, seed), found.places.clone()),
        None => {
            let scene = Scene::on_floor(robot, MOUNTING[0], MOUNTING[1], seed);
            let mut random = Random::new(seed ^ 0x7461_6773);
            let mut places = scene.places.clone();
            for place in &mut places {
                place.world_from_body.position_m +=
                    Vector3::from_fn(|_, _| random.within(TAG_PLACE_M));
            }
            (scene, places)
        }
    };
    (
        SimulatedTags::new(link.clone(), scene, CORNER_PX, seed),
        places,
    )
}

/// A look at the tags while the robot hangs at home, which it takes for `place_m`.
///
/// # Errors
/// As [`look_when_homed`].
pub(super) fn seen_at_home(
    model: &Model,
    link: &SimulatedLink,
    place_m: &Vector3<f64>,
    seed: u64,
) -> Result<Option<TagReference>, RunError> {
    let (mut camera, places) = camera(model, link, seed);
    let mut client = Client::connect(link.clone(), SessionId(5))?;
    run::configure(&mut client, model.robot())?;
    let lengths_m = model.rest(place_m, None)?.paid_out_m;
    let tags = KnownTags {
        camera: &mut camera,
        places,
    };
    let seen = look_when_homed(&mut client, model, tags, &lengths_m, Homed::Taught)?;
    client.request(Request::Close)?;
    Ok(seen)
}

/// The journal of a program that continued, or whose computer failed too: then it has no end record, and
/// its last records had not reached the disk.
fn left_journal(disk: &MemoryDisk, alive: bool, seed: u64) -> (Vec<u8>, Option<Mark>) {
    let (bytes, mark) = disk.synced();
    if alive {
        return (bytes, mark);
    }
    let mut random = Random::new(seed ^ 0x6469_736B);
    let share = 0.5 + random.within(0.5);
    // An end of 11 bytes, and up to 50 ms of records of 92 bytes every 10 ms.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "some hundred bytes"
    )]
    let lost = 11 + (share * 5.0 * 92.0) as usize;
    let kept = bytes
        .get(..bytes.len().saturating_sub(lost))
        .unwrap_or_default();
    let mark = Journal::read(kept).ok().map(|journal| Mark {
        session: journal.identity.session,
        number: journal.number,
    });
    (kept.to_vec(), mark)
}

impl AfterCut {
    /// A robot behind `link` whose power is back, and what the journal on `disk` has kept of it: all of it
    /// if the host did not fail (`alive`).
    ///
    /// # Errors
    /// The client's.
    pub(crate) fn of(
        link: SimulatedLink,
        disk: &MemoryDisk,
        alive: bool,
        seed: u64,
    ) -> Result<Self, RunError> {
        let board = Client::connect(link.clone(), SessionId(2))
            .map(|client| run::saved::board_name(client.hello()))?;
        let (journal, mark) = left_journal(disk, alive, seed);
        Ok(Self {
            link,
            journal,
            mark,
            board,
            drop_m: 0.0,
            speed_mps: 0.0,
            together: false,
            gentle: false,
            reference: None,
            homed_off_m: Vector3::zeros(),
            seed,
        })
    }

    /// The journal as a recovery finds it.
    ///
    /// # Errors
    /// [`JournalError`].
    pub fn read(&self, model: &Model, now_ms: u64) -> Result<Journal, JournalError> {
        let journal = Journal::read(&self.journal)?;
        journal.check(&self.board, scale_of(model.robot()), self.mark, now_ms)?;
        Ok(journal)
    }

    /// Recovers; also the tool's true mean position meanwhile, m, in the world frame that the robot knows.
    ///
    /// # Errors
    /// As [`recover`].
    pub fn recover(
        &self,
        model: &Model,
        journal: Result<Journal, JournalError>,
        camera: bool,
        untouched: bool,
        bound_m: f64,
    ) -> Result<(Verdict, Vector3<f64>), RunError> {
        let (mut tags, places) = self::camera(model, &self.link, self.seed);
        let mut client = Client::connect(self.link.clone(), SessionId(3))?;
        if run::status(&mut client)?.fault.is_some() {
            client.request(Request::ClearFault)?;
        }
        self.link.with(Simulation::take_trace);
        let source: &mut dyn TagSource = &mut tags;
        let before = Before {
            journal,
            tags: camera.then_some(KnownTags {
                camera: source,
                places,
            }),
            reference: self.reference.clone(),
            untouched,
            together: untouched && self.together,
            gentle: self.gentle,
            bound_m,
        };
        let verdict = recover(&mut client, model, before)?;
        client.request(Request::Close)?;
        let trace = self.link.with(Simulation::take_trace);
        // A gentle test moves the tool and puts it back: its place afterwards counts, over three seconds.
        let last = if self.gentle { 3000 } else { trace.len() };
        let trace = &trace[trace.len().saturating_sub(last)..];
        let tools = trace
            .iter()
            .map(|point| Vector3::from(point.truth.tool_position_m));
        let mean = tools.sum::<Vector3<f64>>() / (trace.len().max(1)) as f64;
        Ok((verdict, in_known_frame(model.robot(), &mean)))
    }

    /// Continues the interrupted task, after an accepted recovery.
    ///
    /// # Errors
    /// As [`Experiment::run_on`]; [`crate::run::ResumeError`].
    pub fn resume(&self, model: &Model, task: Task, journal: Journal) -> Result<Run, RunError> {
        self.link.with(Simulation::take_trace);
        let hash = mcdpr_protocol::frame::crc32(task.name.as_bytes());
        let mut run = Experiment::new(model, task)
            .session(SessionId(4))
            .resume(hash, move |_| Ok(journal))
            .run_on(self.link.clone())?;
        let trace = self.link.with(Simulation::take_trace);
        run.simulated = true;
        run.true_path = Some(in_calibrated_frame(model, report::true_path(&trace)));
        Ok(run)
    }
}
