//! Continuing after a loss of power: the journal in files, the readings of the board, the verdict.
//!
//! The mathematics is in [`mcdpr_core::recovery`], which knows no file and no clock.

mod cost;
mod disk;
pub(crate) mod load;
pub mod simulated;
pub mod study;
mod winding;
mod writer;

pub use cost::{Cost, cost};
pub use disk::{Disk, load};
pub(crate) use disk::{FileDisk, MemoryDisk, keep_reference, load_reference};
pub use mcdpr_core::recovery::*;
pub use writer::About;
pub(crate) use writer::JournalWriter;

use crate::estimate::Measurements;
use crate::link::{Client, Link};
use crate::motion::Model;
use crate::record::TaskSource;
use crate::robot::{Robot, TagPlace};
use crate::run::{self, RunError};
use crate::sight::TagSource;
use mcdpr_core::recovery::looks::{Looks, RestReadings};
use mcdpr_core::recovery::reference::{Homed, TagReference};
use mcdpr_core::recovery::verdict::{by_gentle_test, gentle_helps};
use mcdpr_protocol::{BoardState, ResetCause, Status};

/// Readings of the sensors, and the time between them, µs: several periods of a swinging platform.
const LOOKS: u32 = 60;
const APART_US: u64 = 50_000;

/// A platform that still moves is read for this many times three seconds: the means over a longer time have less
/// of its swing.
const MOST_LOOKS: u32 = 8;

/// A camera, and the places of the tags that it may see.
pub struct KnownTags<'a> {
    /// The camera.
    pub camera: &'a mut dyn TagSource,
    /// The tags' bodies.
    pub places: Vec<TagPlace>,
}

/// What a recovery uses besides the board's readings.
pub struct Before<'a> {
    /// The journal of this board, or why there is no valid one.
    pub journal: Result<Journal, JournalError>,
    /// A camera that sees tags whose places are known.
    pub tags: Option<KnownTags<'a>>,
    /// Where it saw them when the robot was homed, if that was kept.
    pub reference: Option<TagReference>,
    /// Whether the user states that nobody moved drums, brakes or platform without power.
    pub untouched: bool,
    /// Whether the user states that computer and robot lost their supply at the same time.
    pub together: bool,
    /// Whether drums may move: where the evidence is not enough, each cable is wound by some tenths of a
    /// millimetre.
    pub gentle: bool,
    /// Largest bound of the tool's position that the job allows, m.
    pub bound_m: f64,
}

/// Judges where a disarmed robot hangs. If it is accepted, the board's lengths are referenced. Nothing
/// moves.
///
/// # Errors
/// The client's; [`RunError::Latched`] while a fault is latched; [`RunError::Sight`] and
/// [`RunError::Estimate`].
pub fn recover<L: Link>(
    client: &mut Client<L>,
    model: &Model,
    before: Before<'_>,
) -> Result<Verdict, RunError> {
    run::configure(client, model.robot())?;
    let status = run::status(client)?;
    if let Some(record) = status.fault {
        return Err(RunError::Latched { record });
    }
    let (mut camera, places) = match before.tags {
        Some(KnownTags { camera, places }) => (Some(camera), places),
        None => (None, Vec::new()),
    };
    let scale = run::saved::scale_of(model.robot());
    let reference = before.reference.as_ref();
    let reference = reference.filter(|of| of.belongs_to(model.robot(), &places, scale));
    let (looks, rest) = look_until_still(client, model, &mut camera, &places)?;
    let seen = Measurements {
        views: looks.steady_views(),
        places,
        ..Measurements::default()
    };
    let kept = kept_by_board(client, model)?;
    // Those of the last tick: by a battery, or before a supply that dipped. A processor that hung kept older ones, and
    // nobody knows how long the button was pressed.
    let cause = client.hello().reset_cause;
    let of_last_tick = matches!(cause, ResetCause::Power | ResetCause::Panic);
    let registers_m = kept
        .as_ref()
        .filter(|kept| of_last_tick && !kept.counted && !status.referenced)
        .map(|kept| kept.lengths.iter().map(|length| length.metres()).collect());
    // A board that kept its counts knows more than any file.
    let source = if status.referenced {
        Source::Board {
            lengths_m: status.lengths_m().collect(),
        }
    } else if let Some(source) = kept
        .as_ref()
        .filter(|kept| kept.counted)
        .map(|kept| counted_on(&status, kept, model, &before.journal))
    {
        source
    } else {
        match &before.journal {
            Ok(journal) => Source::Journal(journal),
            Err(reason) => Source::Refused(reason.clone()),
        }
    };
    // Statics with the object that the jaws hold: without it tensions contradict the lengths.
    let lengths_m: Vec<f64> = match &source {
        Source::Board { lengths_m } | Source::Reset { lengths_m, .. } => lengths_m.clone(),
        Source::Journal(journal) => {
            let cables = journal.last.iter().flat_map(|last| &last.cables);
            cables.map(|cable| cable.length_m).collect()
        }
        Source::Refused(_) => Vec::new(),
    };
    let load_kg = load::in_jaws_kg(model, &status, &lengths_m, &rest.tensions_n);
    let with_load;
    let model = if load_kg > 0.0 {
        with_load = load::loaded(model, load_kg)?;
        &with_load
    } else {
        model
    };
    let evidence = Evidence {
        source,
        rest,
        seen,
        reference,
        untouched: before.untouched,
        together: before.together,
        registers_m,
        bound_m: before.bound_m,
    };
    let mut verdict = judge(model, &evidence)?;
    if load_kg > 0.0 {
        let weight_n = load_kg * mcdpr_kinematics::GRAVITY_MPS2;
        let used = format!("{weight_n:.1} N in the jaws, by tensions and statics");
        verdict.used.push(used);
    }
    if before.gentle && !verdict.accepted && gentle_helps(&evidence) {
        let guess = &model.rest_at_home()?.paid_out_m;
        let known = match verdict.lengths_m.len() == guess.len() {
            true => &verdict.lengths_m,
            false => guess,
        };
        let tested = winding::test(client, model, &evidence.rest, known)?;
        // The test has changed the configuration of the winches.
        run::configure(client, model.robot())?;
        verdict = match tested {
            winding::Tested::Responses(responses) => {
                by_gentle_test(model, &evidence, verdict, &responses)?
            }
            winding::Tested::Refused(reason) => Verdict {
                sentence: format!("{}; no gentle test: {reason}", verdict.sentence),
                ..verdict
            },
        };
    }
    if looks.lost_tag() {
        let lost = "the tag leaves the camera's picture while the platform swings: it was not used";
        verdict.contradicts.push(lost.to_owned());
    }
    if verdict.accepted {
        let reference = crate::machine::reference(&verdict.lengths_m, &verdict.tensions_n);
        client.request(reference)?;
    }
    Ok(verdict)
}

/// The lengths that the board kept over its last reset; `None` without valid ones for every cable.
///
/// # Errors
/// The client's.
fn kept_by_board<L: Link>(
    client: &mut Client<L>,
    model: &Model,
) -> Result<Option<mcdpr_protocol::Kept>, RunError> {
    let kept = client.kept()?;
    let whole = kept.lengths.len() == model.robot().cables.len();
    Ok(Some(kept).filter(|_| whole))
}

/// The lengths of a board that was reset while its supply lasted, with its status since: without a reference its
/// lengths are the way since its start. The speeds at the reset are those of the journal's last record; without a
/// valid journal any up to the robot's greatest.
fn counted_on<'a>(
    since: &Status,
    kept: &mcdpr_protocol::Kept,
    model: &Model,
    journal: &Result<Journal, JournalError>,
) -> Source<'a> {
    let before = kept.lengths.iter().map(|length| length.metres());
    let lengths_m: Vec<f64> = before.zip(since.lengths_m()).map(|(a, b)| a + b).collect();
    let last = journal
        .as_ref()
        .ok()
        .and_then(|journal| journal.last.as_ref());
    let speed = |cable: usize| {
        if kept.brakes_open >> cable & 1 == 0 {
            return [0.0, 0.0];
        }
        match last.and_then(|last| last.cables.get(cable)) {
            // The last record is some 10 ms old.
            Some(cable) => [cable.speed_mps, 0.1 * cable.speed_mps.abs()],
            None => [0.0, model.robot().limits.speed_mps],
        }
    };
    let speeds_mps = (0..kept.lengths.len()).map(speed).collect();
    Source::Reset {
        lengths_m,
        speeds_mps,
    }
}

/// Looks at tags while the robot rests with known lengths, m, as it does after homing; nothing moves. `None`
/// where no tag is in view, the platform moves, or camera and tags are off by more than a calibration leaves.
///
/// # Errors
/// The client's; [`RunError::Sight`] and [`RunError::Estimate`].
pub(crate) fn look_when_homed<L: Link>(
    client: &mut Client<L>,
    model: &Model,
    tags: KnownTags<'_>,
    lengths_m: &[f64],
    homed: Homed,
) -> Result<Option<TagReference>, RunError> {
    let KnownTags { camera, places } = tags;
    let (looks, rest) = look_until_still(client, model, &mut Some(camera), &places)?;
    if looks.lost_tag() || !rest.is_still() {
        return Ok(None);
    }
    let seen = Measurements {
        views: looks.steady_views(),
        places,
        ..Measurements::default()
    };
    let scale = run::saved::scale_of(model.robot());
    Ok(reference_of(model, lengths_m, &rest, &seen, homed, scale)?)
}

/// Goes on looking while the platform moves, [`MOST_LOOKS`] times at most. The means are those of all readings,
/// unless the platform comes to rest: then those of the last three seconds. What moves, sinks or goes slack is
/// judged by the last three seconds.
fn look_until_still<L: Link>(
    client: &mut Client<L>,
    model: &Model,
    camera: &mut Option<&mut dyn TagSource>,
    places: &[TagPlace],
) -> Result<(Looks, RestReadings), RunError> {
    let mut all = Looks::default();
    for _ in 0..MOST_LOOKS {
        let last = look(client, model, camera, places)?;
        let rest = last.rest(model.robot());
        if rest.is_still() {
            return Ok((last, rest));
        }
        all.then(last);
    }
    let rest = all.rest_of_last(model.robot(), LOOKS as usize);
    Ok((all, rest))
}

/// Reads the sensors for three seconds, and takes a picture at every second reading.
fn look<L: Link>(
    client: &mut Client<L>,
    model: &Model,
    camera: &mut Option<&mut dyn TagSource>,
    places: &[TagPlace],
) -> Result<Looks, RunError> {
    let known = |id: u32| {
        let mut tags = model.robot().tags.iter();
        tags.any(|tag| tag.id == id && places.iter().any(|place| place.body == tag.body))
    };
    let mut looks = Looks::default();
    for number in 0..LOOKS {
        looks
            .tensions_n
            .push(run::status(client)?.tensions_n().collect());
        let until_us = client.now_us() + APART_US;
        client.pump(until_us)?;
        if let Some(camera) = camera.as_mut().filter(|_| number % 2 == 1) {
            let views = camera.look().map_err(RunError::Sight)?;
            looks
                .pictures
                .push(views.into_iter().filter(|view| known(view.id)).collect());
        }
    }
    Ok(looks)
}

/// Checksum of a task: of its text; of name and height for a built-in one.
pub(crate) fn task_hash(task: &TaskSource) -> u32 {
    let text = match &task.text {
        Some(text) => text.clone(),
        None => format!("{} at {} m", task.name, task.tool_z_m),
    };
    mcdpr_protocol::frame::crc32(text.as_bytes())
}

/// One sentence on a board without a reference: it has lost its lengths, or kept them over its reset. `None` where it
/// kept none and has no journal.
///
/// # Errors
/// The client's.
pub(crate) fn after_cut<L: Link>(
    client: &mut Client<L>,
    robot: &Robot,
) -> Result<Option<String>, RunError> {
    let kept = client.kept()?;
    if kept.counted && kept.lengths.len() == robot.cables.len() {
        let sentence = "the board has reset itself: it kept its lengths, and has counted since";
        return Ok(Some(sentence.to_owned()));
    }
    let board = run::saved::board_name(client.hello());
    Ok(by_journal(&board, run::saved::scale_of(robot)))
}

/// The same by the journal.
fn by_journal(board: &str, scale: u32) -> Option<String> {
    let journal = match load(board, scale) {
        Ok(journal) => journal,
        Err(JournalError::Missing { .. }) => return None,
        Err(reason) => {
            return Some(format!(
                "the board lost its lengths, and its journal is not valid: {reason}"
            ));
        }
    };
    let last = journal.last.as_ref()?;
    let (hour, minute) = crate::stamp::utc_clock(journal.identity.wall_ms / 1000);
    let doing = match last.state {
        BoardState::Moving | BoardState::Pausing | BoardState::Stopping => {
            format!(
                "moving at path time {:.1} s",
                f64::from(journal.path_ms) * 1e-3
            )
        }
        BoardState::Disarmed => "parked".to_owned(),
        BoardState::Fault | BoardState::EStop if journal.path_ms > 0 => {
            format!(
                "stopped at path time {:.1} s",
                f64::from(journal.path_ms) * 1e-3
            )
        }
        state => format!("{state:?}").to_lowercase(),
    };
    Some(format!(
        "the board lost its lengths; the journal of {hour:02}:{minute:02} UTC says that it was {doing} ({})",
        journal.identity.task
    ))
}
