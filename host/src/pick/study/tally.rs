//! Summary of many scenes.

use super::{Knowledge, SceneReport};
use crate::pick::{End, Outcome, PickError};
use serde::{Deserialize, Serialize};

/// A study's record of one scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// The scene's seed.
    pub seed: u64,
    /// Arrangement of the objects.
    pub cluttered: bool,
    /// The program's knowledge.
    pub knowledge: Knowledge,
    /// Objects at first.
    pub objects: usize,
    /// Attempts.
    pub attempts: usize,
    /// Objects truly put down beside the tray.
    pub picked: usize,
    /// How it ended, in words.
    pub end: String,
    /// Whether the tray was empty then.
    pub emptied: bool,
    /// Whether the robot stopped.
    pub stopped: bool,
    /// True errors of the grasp point, m.
    pub errors_m: Vec<f64>,
    /// Every failed attempt, in words.
    pub failures: Vec<String>,
}

impl Tally {
    /// From a scene that was picked, or from one in which the robot stopped.
    #[must_use]
    pub fn new(
        seed: u64,
        cluttered: bool,
        knowledge: Knowledge,
        scene: &Result<SceneReport, PickError>,
    ) -> Self {
        let nothing = Self {
            seed,
            cluttered,
            knowledge,
            objects: 0,
            attempts: 0,
            picked: 0,
            end: String::new(),
            emptied: false,
            stopped: false,
            errors_m: Vec::new(),
            failures: Vec::new(),
        };
        match scene {
            Ok(scene) => Self {
                objects: scene.objects,
                attempts: scene.report.attempts.len(),
                picked: scene.carried_off,
                end: words(&scene.report.end),
                emptied: scene.report.end == End::Empty,
                errors_m: scene.errors_m.clone(),
                failures: failures(scene),
                ..nothing
            },
            Err(error) => Self {
                end: error.to_string(),
                stopped: true,
                ..nothing
            },
        }
    }
}

fn words(end: &End) -> String {
    match end {
        End::Empty => "empty".to_owned(),
        End::Unreachable { reason } => reason.clone(),
        End::Failures { count } => format!("{count} failures in a row"),
        End::Enough => "as many attempts as were allowed".to_owned(),
    }
}

fn failures(scene: &SceneReport) -> Vec<String> {
    let attempts = scene.report.attempts.iter().enumerate();
    attempts
        .filter(|(_, attempt)| attempt.outcome != Outcome::Delivered)
        .map(|(index, attempt)| {
            let grip = scene.grips.get(index).map_or("", String::as_str);
            let error_m = scene.errors_m.get(index).copied().unwrap_or(f64::NAN);
            format!(
                "attempt {}, pixel ({:.0}, {:.0}), {:.1} mm wide, {:.2} mm off: {grip}",
                index + 1,
                attempt.pixel[0],
                attempt.pixel[1],
                attempt.width_m * 1e3,
                error_m * 1e3
            )
        })
        .collect()
}

/// Figures over many scenes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// Scenes.
    pub scenes: usize,
    /// Objects, without those of scenes that a stop ended.
    pub objects: usize,
    /// Attempts.
    pub attempts: usize,
    /// Objects truly put down beside the tray.
    pub picked: usize,
    /// Picks per attempt.
    pub rate: f64,
    /// Share of the objects that left the tray.
    pub cleared: f64,
    /// Scenes that ended with an empty tray.
    pub emptied: usize,
    /// Grasp point error, median, m.
    pub error_median_m: f64,
    /// Grasp point error, 95th percentile, m.
    pub error_p95_m: f64,
    /// Scenes that were ended by a stop of the robot.
    pub stopped: usize,
}

impl Figures {
    /// Sums up.
    #[must_use]
    pub fn of<'a>(tallies: impl Iterator<Item = &'a Tally>) -> Self {
        let mut sum = Self {
            scenes: 0,
            objects: 0,
            attempts: 0,
            picked: 0,
            rate: 0.0,
            cleared: 0.0,
            emptied: 0,
            error_median_m: 0.0,
            error_p95_m: 0.0,
            stopped: 0,
        };
        let mut errors_m = Vec::new();
        for tally in tallies {
            sum.scenes += 1;
            sum.objects += tally.objects;
            sum.attempts += tally.attempts;
            sum.picked += tally.picked;
            sum.emptied += usize::from(tally.emptied);
            sum.stopped += usize::from(tally.stopped);
            errors_m.extend_from_slice(&tally.errors_m);
        }
        errors_m.sort_by(f64::total_cmp);
        let quantile = |share: f64| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "an index"
            )]
            let at = (errors_m.len().saturating_sub(1) as f64 * share).round() as usize;
            errors_m.get(at).copied().unwrap_or(f64::NAN)
        };
        sum.rate = sum.picked as f64 / sum.attempts.max(1) as f64;
        sum.cleared = sum.picked as f64 / sum.objects.max(1) as f64;
        (sum.error_median_m, sum.error_p95_m) = (quantile(0.5), quantile(0.95));
        sum
    }
}

/// One line of a study: scenes of one arrangement with one knowledge of the machine.
#[derive(Debug, Clone, Serialize)]
pub struct Line {
    /// Arrangement of the objects.
    pub cluttered: bool,
    /// The program's knowledge.
    pub knowledge: Knowledge,
    /// Its results.
    pub figures: Figures,
    /// Every failed attempt with its scene's seed, in words, and every stop.
    pub failures: Vec<String>,
}

impl Line {
    /// The scenes of one arrangement and one knowledge among others.
    #[must_use]
    pub fn of(tallies: &[Tally], cluttered: bool, knowledge: Knowledge) -> Self {
        let mut of: Vec<&Tally> = tallies
            .iter()
            .filter(|tally| (tally.cluttered, tally.knowledge) == (cluttered, knowledge))
            .collect();
        // Scenes end in any order.
        of.sort_by_key(|tally| tally.seed);
        let mut failures = Vec::new();
        for tally in &of {
            let seed = tally.seed;
            let words = |failure: &String| format!("scene {seed}, {failure}");
            failures.extend(tally.failures.iter().map(words));
            if tally.stopped {
                failures.push(format!("scene {seed} stopped: {}", tally.end));
            }
        }
        Self {
            cluttered,
            knowledge,
            figures: Figures::of(of.into_iter()),
            failures,
        }
    }
}
