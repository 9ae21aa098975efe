//! Studies in the simulator: many seeds, medians, kept with seed and hash.

pub mod calibrated;
pub mod iso9283;
pub mod motion;
pub(crate) mod robots;
pub mod tube;

/// The value below which a share of them lies, by the nearest place in their order; not a number if there is none.
#[must_use]
pub(crate) fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a small count"
    )]
    let index = (share * values.len().saturating_sub(1) as f64).round() as usize;
    values.get(index).copied().unwrap_or(f64::NAN)
}
