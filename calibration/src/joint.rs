//! The joint estimate: the solution of one weighted problem, with further checks.

use super::answer::{Answer, Split};
use super::assay;
use super::data::Data;
use super::error::Refusal;
pub use super::fit::Options;
use super::fit::{fit, slipped};
use super::general::slip;
use super::judge::judge_cables;

fn slips_of(data: &Data, answer: &Answer) -> impl Iterator<Item = String> {
    let slips = slip::in_data(data, answer.solved.as_ref());
    slips.into_iter().map(|slip| slip.words)
}

/// Calibrates with one weighted problem over anchors, initial lengths, camera, bodies of tags, the
/// platform's pose at every measurement, and, with priors, all parameters that are never exactly
/// known. If the platform hung at rest and tensions are given, the tensions and the equations of
/// equilibrium are included.
///
/// # Errors
/// [`Refusal`] with the reason.
pub fn joint(data: &Data, options: &Options) -> Result<Answer, Refusal> {
    let mut answer = fit(data, options)?;
    if options.closer_looks {
        // A length that jumped makes every length after it wrong: there is no answer to give.
        let stretch = answer.rejected_stretch.clone().into_iter();
        let found: Vec<String> = stretch.chain(slips_of(data, &answer)).collect();
        if let Some(refusal) = slipped(&found) {
            return Err(refusal);
        }
    }
    // Only now: a slip is the better explanation.
    judge_cables(data, &answer.rejected)?;
    if options.closer_looks {
        answer.split = assay::split(data, options, &answer);
        let warning = answer.split.as_ref().and_then(Split::warning);
        answer.warnings.extend(warning);
        answer.map = assay::error_map(data, &answer);
        answer.next = assay::next_pose(data, &answer, options);
    }
    Ok(answer)
}
