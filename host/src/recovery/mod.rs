//! Going on after a loss of power: the journal in files, what a board shows now, the verdict.
//!
//! The mathematics is in [`mcdpr_core::recovery`], which knows no file and no clock.

mod disk;
pub mod story;
pub mod study;
mod writer;

pub use disk::{Disk, load};
pub(crate) use disk::{FileDisk, MemoryDisk};
pub use mcdpr_core::recovery::*;
pub use writer::About;
pub(crate) use writer::JournalWriter;

use crate::estimate::{Measurements, TagPlace};
use crate::link::{Client, Link};
use crate::motion::Model;
use crate::run::{self, RunError};
use crate::sight::TagSource;
use mcdpr_core::recovery::looks::{Looks, Rest};

/// Looks at the sensors: this many, so far apart, µs. A platform swings some times meanwhile.
const LOOKS: u32 = 60;
const APART_US: u64 = 50_000;

/// A platform that still moves is given this many times three seconds to come to rest.
const MOST_LOOKS: u32 = 5;

/// What is known before the board is asked.
pub struct Before<'a> {
    /// The journal of this board, or why none is believed.
    pub journal: Result<Journal, JournalError>,
    /// A camera that sees tags whose places are known.
    pub camera: Option<(&'a mut dyn TagSource, Vec<TagPlace>)>,
    /// Whether somebody vouches that no hand moved drums or platform meanwhile.
    pub untouched: bool,
    /// Largest bound of the tool's place that the job allows, m.
    pub bound_m: f64,
}

/// Judges where a disarmed robot hangs, and on acceptance references the board's lengths. Nothing
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
    let places = before
        .camera
        .as_ref()
        .map(|(_, places)| places.clone())
        .unwrap_or_default();
    let mut camera = before.camera.map(|(camera, _)| camera);
    let (looks, rest) = look_until_still(client, model, &mut camera, &places)?;
    let seen = Measurements {
        views: looks.steady_views(),
        places,
        ..Measurements::default()
    };
    let source = if status.referenced {
        Source::Board {
            lengths_m: status.lengths_m().collect(),
        }
    } else {
        match &before.journal {
            Ok(journal) => Source::Journal(journal),
            Err(reason) => Source::Refused(reason.clone()),
        }
    };
    let evidence = Evidence {
        source,
        rest,
        seen,
        untouched: before.untouched,
        bound_m: before.bound_m,
    };
    let mut verdict = judge(model, &evidence)?;
    if looks.lost_tag() {
        let lost = "the tag leaves the camera's picture while the platform swings: it was not used";
        verdict.contradicts.push(lost.to_owned());
    }
    if std::env::var_os("DEBUG_LOOKS").is_some() {
        let seen = looks.pictures.iter().filter(|p| !p.is_empty()).count();
        eprintln!(
            "SEEN {seen} of {} VERDICT {verdict:?}",
            looks.pictures.len()
        );
    }
    if verdict.accepted {
        let reference = crate::machine::reference(&verdict.lengths_m, &verdict.tensions_n);
        client.request(reference)?;
    }
    Ok(verdict)
}

/// Looks again while the platform moves, [`MOST_LOOKS`] times at most.
fn look_until_still<L: Link>(
    client: &mut Client<L>,
    model: &Model,
    camera: &mut Option<&mut dyn TagSource>,
    places: &[TagPlace],
) -> Result<(Looks, Rest), RunError> {
    let mut number = 0;
    loop {
        let looks = look(client, model, camera, places)?;
        let rest = looks.rest(model.robot());
        number += 1;
        if rest.is_still() || number >= MOST_LOOKS {
            return Ok((looks, rest));
        }
    }
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
