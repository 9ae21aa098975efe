//! Cables that slipped while samples were taken: a jump of one cable's length from one sample on.
//!
//! For every cable and every moment the gain in the sum of squares is computed that a jump there
//! would bring, from the solution's own rows (a score test; Rao, 1948). No problem is solved anew.

use super::fit::Fit;
use super::model::Group;
use super::solve::variance;
use super::unknowns::Break;
use nalgebra::DVector;

/// Gain in the sum of weighted squares from which on a jump is believed. The best of some 80 places
/// exceeds it by chance in fewer than 1 of 100 data sets.
pub const GAIN: f64 = 22.0;

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

/// Every jump that could be, with what it would gain.
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

/// The jump that gains most, where that is more than chance.
#[must_use]
pub fn largest(fit: &Fit) -> Option<Break> {
    candidates(fit)
        .into_iter()
        .max_by(|a, b| a.gain.total_cmp(&b.gain))
        .filter(|best| best.gain > GAIN)
        .map(|best| best.slip)
}
