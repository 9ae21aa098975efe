//! Cables that slipped while samples were taken: a jump of one cable's length from one sample on.
//!
//! For every cable and every moment the gain in the sum of squares that a jump there would bring is
//! computed from the solution's own rows (a score test; Rao, 1948). No problem is solved anew.

use super::data::Set;
use super::fit::{Fit, Options, fit};
use super::model::Group;
use super::solve::variance;
use super::unknowns::{Break, Priors};
use super::verdict::slip_words;
use crate::answer::Solved;
use crate::data::Data;
use nalgebra::DVector;

/// Gain in the sum of weighted squares above which a jump is reported. The best of about 80
/// candidates exceeds it by chance in fewer than 1 of 100 data sets.
/// That is a jump of 4.7 standard deviations.
pub(crate) const GAIN: f64 = 22.0;

/// A jump that a cable may have made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Where and when.
    pub slip: Break,
    /// Gain in the sum of weighted squares.
    pub gain: f64,
    /// Size, m.
    pub size_m: f64,
    /// Standard deviation of the size, m.
    pub sigma_m: f64,
}

/// Every possible jump, with its gain.
#[must_use]
pub fn candidates(fit: &Fit) -> Vec<Candidate> {
    let solution = &fit.solution;
    let shared = solution.covariance.nrows();
    let samples = &fit.set.samples;
    let mut out = Vec::new();
    for &session in &fit.layout.sessions {
        let members: Vec<usize> = (0..samples.len())
            .filter(|&k| samples[k].session == session)
            .collect();
        for cable in 0..fit.layout.cables {
            // From the last sample back: each step adds one sample to the rows that a jump there
            // would shift.
            let (mut score, mut information) = (0.0, 0.0);
            let mut coupling = DVector::zeros(shared);
            // A jump before the first sample is the cable's offset.
            for (place, &k) in members.iter().enumerate().skip(1).rev() {
                let block = &solution.blocks[k];
                let found = block
                    .rows
                    .iter()
                    .zip(&fit.trust[k])
                    .find(|(row, _)| row.group == Group::Length && row.index == cable);
                let Some((row, trust)) = found else {
                    continue;
                };
                let w = trust / variance(row, &fit.scatter);
                let own = DVector::from_column_slice(&row.own);
                score += w * row.residual;
                information += w - w * w * own.dot(&(&block.inverse * &own));
                coupling += block.total(row) * w;
                if place == 0 {
                    continue;
                }
                let fixed = information - coupling.dot(&(&solution.covariance * &coupling));
                // The other unknowns explain such a jump completely: it cannot be distinguished from them.
                if fixed < 1e-9 * information.max(1.0) {
                    continue;
                }
                out.push(Candidate {
                    slip: Break {
                        cable,
                        session,
                        from: k,
                    },
                    gain: score * score / fixed,
                    size_m: -score / fixed,
                    sigma_m: fixed.sqrt().recip(),
                });
            }
        }
    }
    out
}

/// The jump that gains most, if that is more than chance.
#[must_use]
pub fn largest(fit: &Fit) -> Option<Break> {
    candidates(fit)
        .into_iter()
        .max_by(|a, b| a.gain.total_cmp(&b.gain))
        .filter(|best| best.gain > GAIN)
        .map(|best| best.slip)
}

/// Weight below which a length is far off: 8 times its scatter.
const FAR: f64 = 0.1;

/// A cable whose lengths have lost their weight before or after some sample, and only there. A large jump
/// takes the weight of the very readings that would show it to [`largest`].
#[must_use]
pub(crate) fn distrusted(fit: &Fit) -> Option<Break> {
    let mut best: Option<(usize, Break)> = None;
    for &session in &fit.layout.sessions {
        for cable in 0..fit.layout.cables {
            let mut far: Vec<(usize, bool)> = Vec::new();
            for (k, block) in fit.solution.blocks.iter().enumerate() {
                let mut rows = block.rows.iter().zip(&fit.trust[k]);
                let row = rows.find(|(row, _)| row.group == Group::Length && row.index == cable);
                if let (Some((_, trust)), true) = (row, fit.set.samples[k].session == session) {
                    far.push((k, *trust < FAR));
                }
            }
            let all = far.iter().filter(|(_, far)| *far).count();
            let last = far.iter().rev().take_while(|(_, far)| *far).count();
            let first = far.iter().take_while(|(_, far)| *far).count();
            // One more elsewhere may be an outlier of its own.
            let side = last.max(first);
            if side == 0 || side + 1 < all || 2 * all > far.len() + 1 {
                continue;
            }
            let from = if last >= first {
                far.len() - last
            } else {
                first
            };
            let jump = Break {
                cable,
                session,
                from: far[from].0,
            };
            if best.is_none_or(|(most, _)| side > most) {
                best = Some((side, jump));
            }
        }
    }
    best.map(|(_, jump)| jump)
}

/// A cable that slipped.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Slipped {
    /// The cable, from 0.
    pub cable: usize,
    /// Cable, size and moment in words.
    pub words: String,
}

/// Rounds of estimating the scatter: data of version 1 state the scatter of their sensors.
const ROUNDS: usize = 10;

/// Standard deviation of each cable's compliance about that of all, as a share. Tensions of some 60 N stretch 3 m of
/// fibre cable by 4 mm: a cable that is stiffer than the others must not pass for one that slips.
const OWN_COMPLIANCE: f64 = 0.15;

/// The cables that slipped while data of version 1 were collected, in words, the earliest first.
/// `solved` is the result of another estimate; without it the search starts from the nominal robot.
#[must_use]
pub fn in_data(data: &Data, solved: Option<&Solved>) -> Vec<Slipped> {
    let (true, Ok(mut set)) = (data.has_statics(), Set::from_data(data)) else {
        return Vec::new();
    };
    if let (Some(solved), Some(eye)) = (solved, &mut set.eye) {
        let state = &solved.state;
        eye.camera_from_platform = state.camera_from_platform;
        eye.world_from_body.clone_from(&state.world_from_body);
        for (sample, pose) in set.samples.iter_mut().zip(&state.poses) {
            sample.start = Some(*pose);
        }
    }
    let options = Options {
        rounds: ROUNDS,
        priors: Priors {
            own_compliance_per_n: OWN_COMPLIANCE * data.robot.compliance_per_n.max(1e-9),
            ..Priors::default()
        },
        ..Options::default()
    };
    let Ok(found) = fit(&set, &options) else {
        return Vec::new();
    };
    let mut order: Vec<usize> = (0..found.layout.breaks.len()).collect();
    order.sort_by_key(|&j| found.layout.breaks[j].from);
    let slip = |j: usize| Slipped {
        cable: found.layout.breaks[j].cable,
        words: slip_words(&found, j),
    };
    order.into_iter().map(slip).collect()
}
