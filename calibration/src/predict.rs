//! Predictions of a calibration: cable lengths at platform poses given in the tags' frame, which do
//! not depend on the choice of the world frame, and the expected position error.

use super::rows::singles;
use super::unknowns::{Layout, State};
use mcdpr_kinematics::{Error, Pose};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix4, Vector3};

/// Prediction at one pose.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// Change of each cable's length from its initial length as its encoder would report it, m.
    pub encoder_m: Vec<f64>,
    /// Covariance of the platform's position (world axes) when those lengths are commanded, m^2.
    pub position_covariance_m2: Matrix3<f64>,
    /// 3 x shared unknowns: change of that position per change of each unknown.
    pub position_slopes: DMatrix<f64>,
}

/// Predicts the encoder readings at a platform pose in the frame of body 0.
///
/// `mean_tension_n` are the tensions at which the cables were measured on average: the stretch at
/// them is part of the prediction.
///
/// # Errors
/// Domain errors of the geometry, with the cable named.
pub fn predict(
    state: &State,
    layout: &Layout,
    covariance: &DMatrix<f64>,
    mean_tension_n: &[f64],
    tag_from_platform: &Pose,
) -> Result<Prediction, Error> {
    let cables = singles(state)?;
    let body = &state.world_from_body[0];
    let pose = body.compose(tag_from_platform);
    let from_body = pose.position_m - body.position_m;
    let n = cables.len();
    let mut encoder_m = Vec::with_capacity(n);
    let mut by = DMatrix::zeros(n, layout.len());
    let mut motion = DMatrix::zeros(n, 4);
    for (i, cable) in cables.iter().enumerate() {
        let inverse = cable.inverse(&pose).map_err(|error| named(error, i))?;
        let (t, u) = (inverse.direction(0), inverse.arm_m(0));
        let length = inverse.lengths_m[0];
        let drum = state.scale(i);
        let taut = 1.0 - state.compliance(i) * mean_tension_n[i];
        let stretch = state.compliance(i) * mean_tension_n[i] * state.routing_m[i];
        let reading = (length * taut - stretch - state.initial_length_m[i]) / drum;
        encoder_m.push(reading);
        let scale = taut / drum;
        let in_platform = pose.rotation.inverse_transform_vector(&t);
        let turn = (from_body + u).cross(&t);
        for k in 0..3 {
            by[(i, layout.anchor(i) + k)] = -t[k] * scale;
            by[(i, layout.attachment(i) + k)] = in_platform[k] * scale;
            by[(i, layout.body(0) + k)] = t[k] * scale;
            by[(i, layout.body(0) + 3 + k)] = turn[k] * scale;
            motion[(i, k)] = t[k] * scale;
        }
        motion[(i, 3)] = u.cross(&t).z * scale;
        by[(i, layout.radius(i))] = (inverse.wraps_rad[0] - inverse.wrap_sin[0]) * scale;
        by[(i, layout.initial_length(i))] = -1.0 / drum;
        by[(i, layout.scales())] = -reading / drum;
        by[(i, layout.drum(i))] = -reading / drum;
        if layout.statics {
            let by_compliance = -(length + state.routing_m[i]) * mean_tension_n[i] / drum;
            by[(i, layout.statics())] = by_compliance;
            by[(i, layout.soft(i))] = by_compliance;
        }
    }
    let slopes = motion_from_lengths(&motion).rows(0, 3) * &by;
    // Multiplied in this order because tall columns vectorise.
    let cov = &slopes * (covariance * slopes.transpose());
    Ok(Prediction {
        encoder_m,
        position_covariance_m2: cov.fixed_view::<3, 3>(0, 0).into_owned(),
        position_slopes: slopes,
    })
}

/// Displacement of the platform (m, world axes, and yaw, rad) when the commanded lengths are wrong
/// by `error_m`: x, y, z and yaw change, roll and pitch stay (reading of the paper, section 3,
/// (ii)).
///
/// # Errors
/// Domain errors of the geometry.
pub(crate) fn displacement(
    cables: &[mcdpr_kinematics::Robot<1>],
    pose: &Pose,
    error_m: &[f64],
) -> Result<(Vector3<f64>, f64), Error> {
    let mut motion = DMatrix::zeros(cables.len(), 4);
    for (i, cable) in cables.iter().enumerate() {
        let inverse = cable.inverse(pose).map_err(|error| named(error, i))?;
        let (t, u) = (inverse.direction(0), inverse.arm_m(0));
        motion
            .fixed_view_mut::<1, 3>(i, 0)
            .copy_from(&t.transpose());
        motion[(i, 3)] = u.cross(&t).z;
    }
    let moved = motion_from_lengths(&motion) * DVector::from_column_slice(error_m);
    Ok((Vector3::new(moved[0], moved[1], moved[2]), moved[3]))
}

/// 4 x n: motion of x, y, z and yaw per change of lengths (least squares). With three cables, or if
/// they do not determine the yaw, it stays.
fn motion_from_lengths(motion: &DMatrix<f64>) -> DMatrix<f64> {
    // A lever of 0.1 m makes yaw and position comparable.
    let lever = 0.1;
    let mut scaled = motion.clone();
    scaled.column_mut(3).scale_mut(1.0 / lever);
    let mut back = if motion.nrows() == 4 {
        // The usual number of cables, without allocation.
        let square = Matrix4::from_iterator(scaled.iter().copied());
        let back = square.pseudo_inverse(1e-6).unwrap_or_default();
        DMatrix::from_column_slice(4, 4, back.as_slice())
    } else {
        scaled
            .pseudo_inverse(1e-6)
            .unwrap_or_else(|_| DMatrix::zeros(4, motion.nrows()))
    };
    back.row_mut(3).scale_mut(1.0 / lever);
    back
}

fn named(error: Error, cable: usize) -> Error {
    match error {
        Error::InsidePulley {
            distance_m,
            radius_m,
            ..
        } => Error::InsidePulley {
            cable: cable + 1,
            distance_m,
            radius_m,
        },
        Error::OnSwivelAxis { .. } => Error::OnSwivelAxis { cable: cable + 1 },
        other => other,
    }
}
