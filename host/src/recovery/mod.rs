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

/// Looks at the sensors: this many, so far apart, µs. A platform swings some times meanwhile.
const LOOKS: u32 = 60;
const APART_US: u64 = 50_000;
/// Pictures of a look at tags.
const PICTURES: u32 = 30;

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
    let (tensions_n, tension_errors_n) = tensions(client)?;
    let mut seen = Measurements::default();
    if let Some((camera, places)) = before.camera {
        for _ in 0..PICTURES {
            let until_us = client.now_us() + APART_US;
            client.pump(until_us)?;
            let views = camera.look().map_err(RunError::Sight)?;
            let known = |id: u32| {
                let mut tags = model.robot().tags.iter();
                tags.any(|tag| tag.id == id && places.iter().any(|place| place.body == tag.body))
            };
            seen.views
                .extend(views.into_iter().filter(|view| known(view.id)));
        }
        seen.places = places;
    }
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
        tensions_n,
        tension_errors_n,
        seen,
        untouched: before.untouched,
        bound_m: before.bound_m,
    };
    let verdict = judge(model, &evidence)?;
    if verdict.accepted {
        let reference = crate::machine::reference(&verdict.lengths_m, &verdict.tensions_n);
        client.request(reference)?;
    }
    Ok(verdict)
}

/// Mean tensions and the standard errors of the means, N.
fn tensions<L: Link>(client: &mut Client<L>) -> Result<(Vec<f64>, Vec<f64>), RunError> {
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for _ in 0..LOOKS {
        rows.push(run::status(client)?.tensions_n().collect());
        let until_us = client.now_us() + APART_US;
        client.pump(until_us)?;
    }
    let count = rows.len() as f64;
    let cables = rows.first().map_or(0, Vec::len);
    let column = |cable: usize| rows.iter().filter_map(move |row| row.get(cable).copied());
    let figures = (0..cables).map(|cable| {
        let mean = column(cable).sum::<f64>() / count;
        let squares: f64 = column(cable).map(|value| (value - mean).powi(2)).sum();
        // A swing makes neighbours alike: ten readings count as one.
        (mean, (squares / count / (count / 10.0)).sqrt())
    });
    Ok(figures.unzip())
}
