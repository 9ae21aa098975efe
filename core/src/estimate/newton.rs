//! Normal equations of a least-squares search, and one damped step (Levenberg, 1944; Marquardt, 1963).

use super::fix::EstimateError;
use mcdpr_kinematics::Attempt;
use nalgebra::{DMatrix, DVector, SMatrix, SVector};

/// Normal equations of `N` unknowns.
pub(super) struct Linear<const N: usize> {
    pub(super) normal: SMatrix<f64, N, N>,
    pub(super) gradient: SVector<f64, N>,
}

impl<const N: usize> Linear<N> {
    /// Of the rows' derivatives (rows x `N`) and the rows.
    pub(super) fn of(jacobian: &DMatrix<f64>, residuals: &[f64]) -> Self {
        let right = DVector::from_column_slice(residuals);
        let normal = jacobian.transpose() * jacobian;
        let gradient = jacobian.transpose() * right;
        Self {
            normal: normal.fixed_view::<N, N>(0, 0).into_owned(),
            gradient: gradient.fixed_rows::<N>(0).into_owned(),
        }
    }

    /// The step under a damping.
    ///
    /// # Errors
    /// [`EstimateError::Rank`] if the rows do not determine every unknown.
    pub(super) fn step(&self, damping: f64) -> Result<SVector<f64, N>, EstimateError> {
        let mut damped = self.normal;
        for i in 0..N {
            damped[(i, i)] *= 1.0 + damping;
        }
        let factor = damped.cholesky().ok_or(EstimateError::Rank)?;
        Ok(factor.solve(&-self.gradient))
    }
}

/// What came of a step that led to `next`, a state that fits no worse; `last` if the step was too short for another.
pub(super) fn attempt<F, L>(
    next: Option<F>,
    last: bool,
    linear: impl FnOnce(&F) -> Result<L, EstimateError>,
) -> Result<Attempt<F, L>, EstimateError> {
    let Some(next) = next else {
        return Ok(if last {
            Attempt::Enough
        } else {
            Attempt::Worse
        });
    };
    let linear = linear(&next)?;
    Ok(if last {
        Attempt::Last(next, linear)
    } else {
        Attempt::Better(next, linear)
    })
}
