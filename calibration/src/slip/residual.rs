//! Residuals of a reading, and their derivatives by slips, sensors and the calibration.

use super::{Reading, Sigmas};
use crate::unknowns::Layout;
use mcdpr_core::machine;
use mcdpr_core::motion::{Model, PlanError};
use mcdpr_core::robot::{Control, Robot};
use mcdpr_kinematics::{Held, Pose, Start, StaticOptions};
use nalgebra::{DMatrix, DVector};

/// Steps of the derivatives: lengths and places (m), tensions (N), parts of a whole.
const STEP_M: f64 = 2e-4;
const TENSION_STEP_N: f64 = 0.02;
const STEP: f64 = 1e-3;

/// Uncertainty of a calibration.
#[derive(Debug, Clone)]
pub(super) struct Known {
    layout: Layout,
    /// A square root of the covariance of the shared unknowns.
    pub(super) factor: DMatrix<f64>,
}

impl Known {
    /// `None` for a robot without calibration, or whose calibration states no covariance.
    pub(super) fn of(robot: &Robot) -> Option<Self> {
        let calibrated = robot.calibrated.as_ref()?;
        let covariance = calibrated.covariance.as_ref()?;
        let layout = Layout::of(robot)?;
        // Rounding may have left a direction that is known exactly a little below zero.
        let eigen = covariance.clone().symmetric_eigen();
        let mut factor = eigen.eigenvectors;
        for (mut column, value) in factor.column_iter_mut().zip(eigen.eigenvalues.iter()) {
            column *= value.max(0.0).sqrt();
        }
        Some(Self { layout, factor })
    }
}

/// Rows of one reading that share their noise.
#[derive(Debug, Clone)]
pub(super) struct Block {
    /// Measured less expected: lengths of tension-held cables (m), tensions of length-held ones (N).
    pub(super) value: DVector<f64>,
    /// Derivative by each cable's length off the drum beyond the encoder's value, per m.
    pub(super) by_slip: DMatrix<f64>,
    /// Covariance from the sensors.
    pub(super) noise: DMatrix<f64>,
    /// Derivative by the calibration's shared unknowns; no columns without a covariance.
    pub(super) by_unknown: DMatrix<f64>,
}

/// Expected minus measured values of a reading, and the pose.
fn residual(
    model: &Model,
    reading: &Reading,
    near: Option<&Pose>,
) -> Result<(DVector<f64>, Pose), PlanError> {
    let cables = &model.robot().cables;
    let pairs = reading.lengths_m.iter().zip(&reading.tensions_n);
    let held: Vec<Held> = cables
        .iter()
        .zip(pairs)
        .map(|(cable, (length, tension))| match cable.control {
            // What a winch holds is given; what follows from it is compared with the reading.
            Control::Tension => Held::Tension(*tension),
            Control::Position => {
                let total = (length + cable.routing_length_m) * (1.0 + tension / cable.ea_n);
                Held::Length(total - cable.routing_length_m)
            }
        })
        .collect();
    let start = near.map_or(Start::Cold, Start::Pose);
    let found = model
        .geometry()
        .geometrico_static(&held, start, &StaticOptions::default())
        .map_err(|source| PlanError::Lengths { source })?;
    let rest = model.with_lengths(found);
    let value = cables
        .iter()
        .enumerate()
        .map(|(i, cable)| match cable.control {
            Control::Tension => reading.lengths_m[i] - rest.paid_out_m[i],
            Control::Position => reading.tensions_n[i] - rest.tensions_n()[i],
        });
    let value = DVector::from_iterator(cables.len(), value);
    Ok((value, rest.equilibrium.pose))
}

/// The rows of lengths and tensions.
///
/// # Errors
/// [`PlanError::Lengths`] if no resting pose fits the lengths.
pub(super) fn hung(
    model: &Model,
    reading: &Reading,
    sigmas: &Sigmas,
    known: Option<&Known>,
) -> Result<Block, PlanError> {
    let count = model.robot().cables.len();
    let (value, pose) = residual(model, reading, None)?;
    let slope = |step: f64, change: &dyn Fn(&mut Reading, f64)| {
        let at = |step: f64| {
            let mut moved = reading.clone();
            change(&mut moved, step);
            Ok::<_, PlanError>(residual(model, &moved, Some(&pose))?.0)
        };
        // Central differences: their error falls with the square of the step.
        Ok::<_, PlanError>((at(step)? - at(-step)?) / (2.0 * step))
    };
    let mut by_length = DMatrix::zeros(count, count);
    let mut by_tension = DMatrix::zeros(count, count);
    for j in 0..count {
        by_length.set_column(j, &slope(STEP_M, &|r, step| r.lengths_m[j] += step)?);
        by_tension.set_column(
            j,
            &slope(TENSION_STEP_N, &|r, step| r.tensions_n[j] += step)?,
        );
    }
    let sigma_n = reading.tensions_n.iter().map(|t| {
        let pulleys = sigmas.tension_relative * t;
        sigmas.tension_n.hypot(pulleys)
    });
    let spread = &by_tension * DMatrix::from_diagonal(&DVector::from_iterator(count, sigma_n));
    let off = &by_length * sigmas.length_m;
    let by_unknown = match known {
        Some(known) => by_unknown(model, reading, &pose, known, &by_length)?,
        None => DMatrix::zeros(count, 0),
    };
    Ok(Block {
        value,
        // The length off the drum beyond the encoder's value is missing in the reading.
        by_slip: -by_length,
        noise: &spread * spread.transpose() + &off * off.transpose(),
        by_unknown,
    })
}

/// By the unknowns of the calibration on which lengths and tensions depend.
fn by_unknown(
    model: &Model,
    reading: &Reading,
    pose: &Pose,
    known: &Known,
    by_length: &DMatrix<f64>,
) -> Result<DMatrix<f64>, PlanError> {
    let robot = model.robot();
    let layout = &known.layout;
    let mut out = DMatrix::zeros(robot.cables.len(), layout.len());
    let mut set = |index: usize, step: f64, change: &dyn Fn(&mut Robot, f64)| {
        let at = |step: f64| {
            let mut other = robot.clone();
            change(&mut other, step);
            Ok::<_, PlanError>(residual(&Model::new(&other)?, reading, Some(pose))?.0)
        };
        out.set_column(index, &((at(step)? - at(-step)?) / (2.0 * step)));
        Ok::<_, PlanError>(())
    };
    for i in 0..robot.cables.len() {
        for k in 0..3 {
            set(layout.anchor(i) + k, STEP_M, &|r, step| {
                r.cables[i].anchor_in_world_m[k] += step;
            })?;
            set(layout.attachment(i) + k, STEP_M, &|r, step| {
                r.cables[i].attachment_in_platform_m[k] += step;
            })?;
        }
        set(layout.radius(i), STEP_M, &|r, step| {
            r.cables[i].pulley_radius_m += step;
        })?;
    }
    if layout.statics {
        let s = layout.statics();
        // 1/EA in steps of a thousandth of it.
        let ea_n = robot.cables.first().map_or(1.0, |cable| cable.ea_n);
        set(s, STEP / ea_n, &|r, step| {
            r.cables
                .iter_mut()
                .for_each(|c| c.ea_n = 1.0 / (1.0 / c.ea_n + step));
        })?;
        for i in 0..robot.cables.len() {
            set(layout.soft(i), STEP / ea_n, &|r, step| {
                let cable = &mut r.cables[i];
                cable.ea_n = 1.0 / (1.0 / cable.ea_n + step);
            })?;
        }
        let mass_kg = robot.platform.mass_kg;
        set(s + 1, STEP * mass_kg, &|r, step| r.platform.mass_kg += step)?;
        for k in 0..3 {
            set(s + 2 + k, STEP_M, &|r, step| {
                r.platform.center_of_mass_m[k] += step
            })?;
        }
    }
    let home_m = robot.calibrated.as_ref().map(|c| &c.home_lengths_m);
    for (i, column) in by_length.column_iter().enumerate() {
        out.set_column(layout.initial_length(i), &column);
        let home_m = home_m.and_then(|home| home.get(i)).copied();
        let wound_m = reading.lengths_m[i] - home_m.unwrap_or(reading.lengths_m[i]);
        for index in [layout.scales(), layout.drum(i)] {
            let mut drums = out.column_mut(index);
            drums += column * wound_m;
        }
    }
    Ok(out)
}

/// The rows of an observation of a tag: the lengths of the pose that it shows. `None` without one.
pub(super) fn looked(
    model: &Model,
    reading: &Reading,
    sigmas: &Sigmas,
    known: Option<&Known>,
) -> Option<Block> {
    let lengths = model.geometry().lengths_m(reading.seen.as_ref()?).ok()?;
    let count = lengths.len();
    let value = lengths.iter().enumerate().map(|(i, length)| {
        let paid_out = machine::paid_out_m(model.robot(), i, *length, reading.tensions_n[i]);
        paid_out - reading.lengths_m[i]
    });
    Some(Block {
        value: DVector::from_iterator(count, value),
        by_slip: DMatrix::identity(count, count),
        noise: DMatrix::identity(count, count) * (sigmas.seen_m * sigmas.seen_m),
        // The predicted error, which `seen_m` contains, covers the whole chain through the picture.
        by_unknown: DMatrix::zeros(count, known.map_or(0, |known| known.layout.len())),
    })
}
