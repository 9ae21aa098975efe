//! Random losses of power over many seeds, and the errors of the recovery. `mcdpr study power` prints the
//! figures, docs/results/power.md quotes them.

use super::simulated::{AfterCut, Disturbance, SimulatedCut, simulate};
use super::{Journal, JournalError, Verdict};
use crate::experiment::Experiment;
use crate::machine::{Controller, Mismatch};
use crate::motion::{Model, Task};
use crate::run::RunError;
use crate::scenario::Supply;
use mcdpr_core::random::Random;
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::Serialize;

/// Accepted, and off by more than its bound and half as much again.
const WRONG: f64 = 1.5;

/// A kind of case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A cut, and a camera that sees a tag.
    Camera,
    /// A cut without a camera; nobody touches the robot, and the user confirms it.
    NoCamera,
    /// A brake that slips or closes late; a camera in every other case.
    Slipped,
    /// A person moves the platform; a camera in every other case.
    Moved,
    /// A journal of another board, calibration, run or time.
    Swapped,
    /// A journal with a changed byte, a hole, or without its end.
    Corrupted,
}

/// All kinds, in the order in which they take turns.
pub const KINDS: [Kind; 6] = [
    Kind::Camera,
    Kind::NoCamera,
    Kind::Slipped,
    Kind::Moved,
    Kind::Swapped,
    Kind::Corrupted,
];

/// One case.
#[derive(Debug, Clone, Serialize)]
pub struct Case {
    /// Its seed.
    pub seed: u64,
    /// Its kind.
    pub kind: Kind,
    /// Whether a camera saw a tag.
    pub camera: bool,
    /// The supply that failed.
    pub supply: &'static str,
    /// Whether a view at homing was kept.
    pub seen_at_home: bool,
    /// Whether the estimate used a tag.
    pub by_tag: bool,
    /// Speed of the tool at the cut, mm/s.
    pub speed_mm_s: f64,
    /// How far it fell, mm.
    pub drop_mm: f64,
    /// Whether the recovery accepted.
    pub accepted: bool,
    /// Its bound, mm.
    pub bound_mm: Option<f64>,
    /// What the estimate is off by, mm.
    pub error_mm: Option<f64>,
    /// What it is off by more than the robot was when it was homed, mm.
    pub since_homing_mm: Option<f64>,
    /// Swing of the platform at the tag while it was looked at, peak to peak, mm.
    pub swing_mm: Option<f64>,
    /// Largest swing of a tension meanwhile, peak to peak, N.
    pub swing_n: f64,
    /// Statistical bound, 95 %, mm.
    pub bound_95_mm: Option<f64>,
    /// Square of the error in units of its covariance, three degrees of freedom.
    pub normalised: Option<f64>,
    /// The verdict's sentence.
    pub sentence: String,
}

impl Case {
    /// Whether the board has lost its counts.
    pub(crate) fn counts_lost(&self) -> bool {
        matches!(self.supply, "board" | "all" | "dip")
    }

    fn wrong(&self) -> bool {
        let pair = self.error_mm.zip(self.bound_mm);
        self.accepted && pair.is_none_or(|(error, bound)| error > WRONG * bound)
    }
}

/// What a study simulates.
#[derive(Debug, Clone)]
pub struct What {
    /// The kinds; seeds of others are skipped.
    pub kinds: Vec<Kind>,
    /// Largest bound of the tool's position that the job allows, m.
    pub bound_m: f64,
    /// Whether a camera has seen the tags when the robot was homed.
    pub seen_at_home: bool,
    /// Every case has a brake that holds only this force, N.
    pub weak_brake_n: Option<f64>,
    /// Whether the board's backup registers have a battery.
    pub battery: bool,
}

impl What {
    /// The kind of a seed.
    fn kind_of(&self, seed: u64) -> Option<Kind> {
        if self.weak_brake_n.is_some() {
            return Some(Kind::Slipped);
        }
        let turn = usize::try_from(seed % KINDS.len() as u64).unwrap_or(0);
        KINDS.get(turn).copied()
    }
}

/// Figures over cases.
#[derive(Debug, Clone, Serialize)]
pub struct Figures {
    /// How many.
    pub cases: usize,
    /// How many were accepted.
    pub accepted: usize,
    /// How many were accepted and are off by over one and a half times their bound.
    pub accepted_wrongly: usize,
    /// Share that was refused.
    pub refused: f64,
    /// Median error of the accepted, mm.
    pub median_mm: Option<f64>,
    /// Largest error of the accepted, mm.
    pub most_mm: Option<f64>,
    /// How many of the accepted used a tag.
    pub by_tag: usize,
    /// Their median error, mm.
    pub by_tag_median_mm: Option<f64>,
    /// How many of these are off by at most 1 mm.
    pub within_1_mm: usize,
    /// Median of their errors over that of homing, mm.
    pub since_homing_median_mm: Option<f64>,
    /// How many of those are at most 1 mm.
    pub since_homing_within_1_mm: usize,
    /// Share of the accepted whose error is within the greater of both bounds.
    pub inside: Option<f64>,
    /// Share of the accepted whose error is within the statistical bound (95 %).
    pub inside_95: Option<f64>,
    /// Mean of the squared errors in units of their covariance; three if that is right.
    pub normalised_mean: Option<f64>,
    /// Median of the statistical bound of the accepted, mm.
    pub bound_95_median_mm: Option<f64>,
    /// Share of the accepted for which the integrity bound is the greater one.
    pub by_integrity: Option<f64>,
    /// Median and largest bound of the accepted, mm.
    pub bound_median_mm: Option<f64>,
    /// The largest.
    pub bound_most_mm: Option<f64>,
    /// The largest of cuts under 0.1 m/s.
    pub bound_most_slow_mm: Option<f64>,
    /// Largest drop, mm.
    pub drop_max_mm: f64,
    /// Median drop, mm.
    pub drop_median_mm: Option<f64>,
    /// How many drops are over 5 mm.
    pub drops_over_5_mm: usize,
}

fn most(values: impl Iterator<Item = f64>) -> Option<f64> {
    values.fold(None, |most: Option<f64>, value| {
        Some(most.map_or(value, |most| most.max(value)))
    })
}

/// The figures of some cases.
#[must_use]
pub fn figures<'a>(cases: impl Iterator<Item = &'a Case>) -> Figures {
    let cases: Vec<_> = cases.collect();
    let accepted: Vec<_> = cases.iter().filter(|case| case.accepted).collect();
    let errors: Vec<f64> = accepted.iter().filter_map(|case| case.error_mm).collect();
    let seen = || accepted.iter().filter(|case| case.by_tag);
    let by_tag: Vec<f64> = seen().filter_map(|case| case.error_mm).collect();
    let since_homing = seen().filter_map(|case| case.since_homing_mm);
    let since_homing: Vec<f64> = since_homing.collect();
    let drops: Vec<f64> = cases.iter().map(|case| case.drop_mm).collect();
    let bounds: Vec<f64> = accepted.iter().filter_map(|case| case.bound_mm).collect();
    let share = |count: usize| (!accepted.is_empty()).then(|| count as f64 / accepted.len() as f64);
    let inside = |bound: fn(&Case) -> Option<f64>| {
        let pairs = accepted
            .iter()
            .filter_map(|case| case.error_mm.zip(bound(case)));
        share(pairs.filter(|(error, bound)| error <= bound).count())
    };
    let bounds_95: Vec<f64> = accepted
        .iter()
        .filter_map(|case| case.bound_95_mm)
        .collect();
    let normalised: Vec<f64> = accepted.iter().filter_map(|case| case.normalised).collect();
    let integrity = accepted
        .iter()
        .filter(|case| case.bound_mm > case.bound_95_mm);
    let slow = accepted.iter().filter(|case| case.speed_mm_s < 100.0);
    let median = |values: &[f64]| {
        (!values.is_empty()).then(|| crate::calibration::study::median(values.to_vec()))
    };
    Figures {
        cases: cases.len(),
        accepted: accepted.len(),
        accepted_wrongly: cases.iter().filter(|case| case.wrong()).count(),
        refused: 1.0 - accepted.len() as f64 / cases.len().max(1) as f64,
        median_mm: median(&errors),
        most_mm: most(errors.iter().copied()),
        by_tag: by_tag.len(),
        by_tag_median_mm: median(&by_tag),
        within_1_mm: by_tag.iter().filter(|error| **error <= 1.0).count(),
        since_homing_median_mm: median(&since_homing),
        since_homing_within_1_mm: since_homing.iter().filter(|error| **error <= 1.0).count(),
        inside: inside(|case| case.bound_mm),
        inside_95: inside(|case| case.bound_95_mm),
        normalised_mean: (!normalised.is_empty())
            .then(|| normalised.iter().sum::<f64>() / normalised.len() as f64),
        bound_95_median_mm: median(&bounds_95),
        by_integrity: share(integrity.count()),
        bound_median_mm: median(&bounds),
        bound_most_mm: most(bounds.iter().copied()),
        bound_most_slow_mm: most(slow.filter_map(|case| case.bound_mm)),
        drop_max_mm: most(drops.iter().copied()).unwrap_or(0.0),
        drop_median_mm: median(&drops),
        drops_over_5_mm: drops.iter().filter(|drop| **drop > 5.0).count(),
    }
}

/// Runs the seeds on the control core in this process or on emulated chips; the kinds take turns, and those that are not in `kinds`
/// are skipped. Cases for whose seed no motion was found, or whose motion was over before the cut, are left
/// out.
///
/// # Errors
/// Where the robot cannot hang at home.
pub fn study(
    model: &Model,
    seeds: std::ops::Range<u64>,
    what: &What,
    controller: &Controller,
) -> Result<Vec<Case>, RunError> {
    model.rest_at_home()?;
    let cases: Result<Vec<_>, RunError> = seeds
        .into_par_iter()
        .filter(|seed| {
            what.kind_of(*seed)
                .is_some_and(|kind| what.kinds.contains(&kind))
        })
        .map(|seed| case(model, seed, what, controller))
        .collect();
    Ok(cases?.into_iter().flatten().collect())
}

/// A short way from home that the robot can go, and how long it takes, s.
fn task(random: &mut Random, model: &Model) -> Option<(Task, f64)> {
    let home = model.robot().tool.home_in_world_m * 1e3;
    for _ in 0..20 {
        let limit = model.robot().limits.speed_mps.min(0.3) * 1e3;
        // From a tenth of what it can to all of it.
        let speed = limit * 10.0_f64.powf(-0.5 + random.within(0.5));
        let to = [
            home.x + random.within(110.0),
            home.y + random.within(110.0),
            home.z + random.within(50.0),
        ];
        let leg = if random.within(1.0) > 0.3 {
            let radius = 40.0 + random.within(20.0);
            format!(
                "circle_center_mm = [{}, {}, {}]\nsweep_deg = 120",
                home.x + radius,
                home.y,
                home.z
            )
        } else {
            format!("to_mm = [{}, {}, {}]", to[0], to[1], to[2])
        };
        let text = format!(
            "start_mm = [{}, {}, {}]\n[[leg]]\n{leg}\nspeed_mm_s = {speed}\n",
            home.x, home.y, home.z
        );
        let Ok(task) = Task::parse(&text, "drawn.toml".into()) else {
            continue;
        };
        let Ok(plan) = Experiment::new(model, task.clone()).plan() else {
            continue;
        };
        return Some((task, plan.timed.duration_s()));
    }
    None
}

fn case(
    model: &Model,
    seed: u64,
    what: &What,
    controller: &Controller,
) -> Result<Option<Case>, RunError> {
    let mut random = Random::new(seed ^ 0x7077_7263);
    let Some(kind) = what.kind_of(seed) else {
        return Ok(None);
    };
    let Some((task, duration_s)) = task(&mut random, model) else {
        return Ok(None);
    };
    let unit = |random: &mut Random| 0.5 + random.within(0.5);
    let pick = |random: &mut Random, count: usize| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a small count"
        )]
        let index = (unit(random) * count as f64) as usize;
        index.min(count - 1)
    };
    let at_s = duration_s * unit(&mut random);
    let even = (seed / KINDS.len() as u64).is_multiple_of(2);
    // A journal and an unnoticed slip matter only where the board has lost its lengths.
    let lost = [Supply::Board, Supply::All];
    let any = Supply::ALL.map(|(supply, _)| supply);
    let supply = match kind {
        Kind::Camera | Kind::NoCamera => any[pick(&mut random, any.len())],
        _ => lost[pick(&mut random, lost.len())],
    };
    let cable = pick(&mut random, model.robot().cables.len());
    let disturbance = match kind {
        Kind::Slipped if what.weak_brake_n.is_some() => Disturbance::Weak {
            cable,
            holds_n: what.weak_brake_n.unwrap_or_default(),
        },
        Kind::Slipped if unit(&mut random) < 0.5 => Disturbance::Weak {
            cable,
            holds_n: 0.5 + 8.0 * unit(&mut random),
        },
        Kind::Slipped => Disturbance::Late {
            cable,
            by_s: 0.03 + 0.27 * unit(&mut random),
        },
        Kind::Moved => {
            let far_m = 0.005 + 0.06 * unit(&mut random);
            let way = [random.normal(), random.normal(), 0.5 * random.normal()];
            let norm = way
                .iter()
                .map(|part| part * part)
                .sum::<f64>()
                .sqrt()
                .max(0.1);
            Disturbance::Moved {
                by_m: way.map(|part| part / norm * far_m),
            }
        }
        _ => Disturbance::None,
    };
    let camera = match kind {
        Kind::Camera => true,
        Kind::NoCamera => false,
        _ => even,
    };
    let cut = SimulatedCut {
        battery: what.battery,
        task,
        mismatch: Mismatch::realistic(),
        seed,
        supply,
        at_s,
        lasts_s: 1.0,
        disturbance,
        seen_at_home: what.seen_at_home && camera,
        controller: controller.clone(),
    };
    let after = match simulate(model, &cut) {
        Ok(Some(after)) => after,
        // From where the robot is homed the way may be one that no plan fits.
        Ok(None) | Err(RunError::Plan(_)) => return Ok(None),
        Err(error) => return Err(error),
    };
    let journal = found(&mut random, model, &after, kind);
    // A person who moved the platform does not confirm that nobody did.
    let untouched = kind != Kind::Moved;
    let (verdict, truth_m) = after.recover(model, journal, camera, untouched, what.bound_m)?;
    let normalised = mcdpr_core::recovery::verdict::normalised_error(&verdict, &truth_m);
    let error_m = mcdpr_core::recovery::verdict::error_m(&verdict, &truth_m);
    let since_homing_mm = verdict.tool_mm.map(|tool_mm| {
        let off_m = Vector3::from(tool_mm) * 1e-3 - truth_m - after.homed_off_m;
        off_m.norm() * 1e3
    });
    let by_tag = verdict.used.iter().any(|used| used.contains("tags"));
    let name = Supply::ALL.iter().find(|(known, _)| *known == supply);
    let Verdict {
        accepted,
        sentence,
        bound_mm,
        bound_95_mm,
        swing_mm,
        swing_n,
        ..
    } = verdict;
    Ok(Some(Case {
        seed,
        kind,
        camera,
        supply: name.map_or("", |(_, name)| name),
        seen_at_home: after.reference.is_some(),
        by_tag,
        speed_mm_s: after.speed_mps * 1e3,
        drop_mm: after.drop_m * 1e3,
        accepted,
        bound_mm,
        bound_95_mm,
        normalised,
        error_mm: error_m.map(|error| error * 1e3),
        since_homing_mm,
        swing_mm,
        swing_n: swing_n.into_iter().fold(0.0, f64::max),
        sentence,
    }))
}

/// The journal that the recovery reads, changed according to the kind.
fn found(
    random: &mut Random,
    model: &Model,
    after: &AfterCut,
    kind: Kind,
) -> Result<Journal, JournalError> {
    let now_ms = super::disk::now_ms();
    let mut spoiled = AfterCut {
        link: after.link.clone(),
        journal: after.journal.clone(),
        board: after.board.clone(),
        reference: None,
        ..*after
    };
    let which = 0.5 + random.within(0.5);
    let share = 0.5 + random.within(0.5);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "an index"
    )]
    let at = (share * spoiled.journal.len() as f64) as usize;
    match kind {
        Kind::Swapped if which < 0.25 => spoiled.board.push('0'),
        Kind::Swapped if which < 0.5 => {
            let mut other = model.robot().clone();
            if let Some(cable) = other.cables.first_mut() {
                // Another calibration by a millimetre: its checksum differs.
                cable.anchor_in_world_m.x += 1e-3;
            }
            let scale = crate::run::saved::scale_of(&other);
            let journal = Journal::read(&spoiled.journal)?;
            journal.check(&spoiled.board, scale, spoiled.mark, now_ms)?;
            return Ok(journal);
        }
        Kind::Swapped if which < 0.75 => {
            if let Some(mark) = &mut spoiled.mark {
                mark.session += 1;
            }
        }
        // A clock ten minutes behind: the journal then comes from the future.
        Kind::Swapped => return spoiled.read(model, now_ms.saturating_sub(600_000)),
        Kind::Corrupted if which < 0.4 => {
            if let Some(byte) = spoiled.journal.get_mut(at) {
                *byte ^= 0x10;
            }
        }
        Kind::Corrupted if which < 0.7 => spoiled.journal.truncate(at),
        Kind::Corrupted => {
            // A block of 512 bytes that the disk has lost.
            let hole = spoiled.journal.iter_mut().skip(at).take(512);
            hole.for_each(|byte| *byte = 0);
        }
        _ => {}
    }
    spoiled.read(model, now_ms)
}
