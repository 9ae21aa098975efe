//! Predictions of a calibration: cable lengths at platform poses given in the tags' frame, which do
//! not depend on the choice of the world frame, and the expected position error.

use super::rows::singles;
use super::unknowns::{Layout, State};
use mcdpr_kinematics::{Cable, Error, Pose, Robot};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix4, Vector3};

/// Anchors and attachments this near to a vertical plane, as a share of its width, are those of a robot in a plane whose
/// anchors are off.
const FLAT: f64 = 0.02;

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
    let moves = Moves::of(&cables);
    let mut motion = DMatrix::zeros(n, moves.twists.len());
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
        }
        for (k, [shift, turned]) in moves.twists.iter().enumerate() {
            motion[(i, k)] = (t.dot(shift) + u.cross(&t).dot(turned)) * scale;
        }
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
    let slopes = moves.position_from_lengths(&motion) * &by;
    Ok(Prediction {
        encoder_m,
        position_covariance_m2: of_position(&slopes, covariance),
        position_slopes: slopes,
    })
}

/// Covariance of a position that has these slopes (3 x unknowns), m^2. The position does not depend on a third of the
/// unknowns (camera, masses, sensors' zeros): their columns are left out.
fn of_position(slopes: &DMatrix<f64>, covariance: &DMatrix<f64>) -> Matrix3<f64> {
    let mut products = [(); 3].map(|()| vec![0.0; slopes.ncols()]);
    for j in 0..slopes.ncols() {
        let by: [f64; 3] = [0, 1, 2].map(|r| slopes[(r, j)]);
        if by == [0.0; 3] {
            continue;
        }
        let column = &covariance.as_slice()[j * covariance.nrows()..][..covariance.nrows()];
        for (by, product) in by.iter().zip(&mut products) {
            for (slot, value) in product.iter_mut().zip(column) {
                *slot += by * value;
            }
        }
    }
    Matrix3::from_fn(|r, c| {
        let terms = slopes.row(r).into_iter().zip(&products[c]);
        terms.map(|(slope, product)| slope * product).sum()
    })
}

/// Displacement of the platform (m, world axes, and its turn, rad) when the commanded lengths are wrong
/// by `error_m`: x, y, z and yaw change, roll and pitch stay (reading of the paper, section 3,
/// (ii)). A robot in a plane moves and turns in it.
///
/// # Errors
/// Domain errors of the geometry.
pub(crate) fn displacement(
    cables: &[mcdpr_kinematics::Robot<1>],
    pose: &Pose,
    error_m: &[f64],
) -> Result<(Vector3<f64>, f64), Error> {
    let moves = Moves::of(cables);
    let mut motion = DMatrix::zeros(cables.len(), moves.twists.len());
    for (i, cable) in cables.iter().enumerate() {
        let inverse = cable.inverse(pose).map_err(|error| named(error, i))?;
        let (t, u) = (inverse.direction(0), inverse.arm_m(0));
        for (k, [shift, turned]) in moves.twists.iter().enumerate() {
            motion[(i, k)] = t.dot(shift) + u.cross(&t).dot(turned);
        }
    }
    let moved = motion_from_lengths(&motion) * DVector::from_column_slice(error_m);
    let shifts = moves.twists.iter().zip(moved.iter());
    let turn_rad = moved.iter().next_back().copied().unwrap_or(0.0);
    Ok((
        shifts.fold(Vector3::zeros(), |sum, ([shift, _], by)| sum + shift * *by),
        turn_rad,
    ))
}

/// The motions of a platform that its lengths decide.
struct Moves {
    /// Shift and turn (world) of each; the last one turns, the others do not.
    twists: Vec<[Vector3<f64>; 2]>,
}

impl Moves {
    /// Of a robot in a plane across and up in it, and the turn in it: across it statics decide, and the few
    /// millimetres that its anchors are beside it make lengths tell of that as good as nothing. Of others x, y, z and yaw.
    fn of(cables: &[Robot<1>]) -> Self {
        let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
        let shift = |axis| [axis, Vector3::zeros()];
        let turn = |axis| [Vector3::zeros(), axis];
        let plane = normal(cables.iter().flat_map(|cable| cable.cables()));
        Self {
            twists: match plane {
                Some(normal) => vec![shift(normal.cross(&z)), shift(z), turn(normal)],
                None => vec![shift(x), shift(y), shift(z), turn(z)],
            },
        }
    }

    /// 3 x n: motion of the position (world axes) per change of lengths.
    fn position_from_lengths(&self, motion: &DMatrix<f64>) -> DMatrix<f64> {
        let back = motion_from_lengths(motion);
        if self.twists.len() == 4 {
            return back.rows(0, 3).into_owned();
        }
        let axes = DMatrix::from_fn(3, self.twists.len(), |k, twist| self.twists[twist][0][k]);
        axes * back
    }
}

/// Unit normal of the vertical plane near which all anchors and attachments are; `None` if there is none.
pub(crate) fn normal<'a>(cables: impl Iterator<Item = &'a Cable> + Clone) -> Option<Vector3<f64>> {
    let first = cables.clone().next()?.anchor_m;
    let level = |cable: &Cable| (cable.anchor_m - first).xy().push(0.0);
    let widest = cables.clone().map(level);
    let widest = widest.max_by(|a, b| a.norm().total_cmp(&b.norm()))?;
    let normal = widest.cross(&Vector3::z()).try_normalize(1e-12)?;
    let most_m = FLAT * widest.norm();
    cables
        .into_iter()
        .all(|cable| {
            let anchor_m = (cable.anchor_m - first).dot(&normal);
            anchor_m.abs() <= most_m && cable.attachment_m.dot(&normal).abs() <= most_m
        })
        .then_some(normal)
}

/// Motion along each twist per change of lengths (least squares), the last of them a turn. With three cables, or if
/// they do not determine the yaw, it stays.
fn motion_from_lengths(motion: &DMatrix<f64>) -> DMatrix<f64> {
    // A lever of 0.1 m makes yaw and position comparable.
    let lever = 0.1;
    let turn = motion.ncols() - 1;
    let mut scaled = motion.clone();
    scaled.column_mut(turn).scale_mut(1.0 / lever);
    let mut back = if motion.shape() == (4, 4) {
        // The usual number of cables, without allocation.
        let square = Matrix4::from_iterator(scaled.iter().copied());
        let back = square.pseudo_inverse(1e-6).unwrap_or_default();
        DMatrix::from_column_slice(4, 4, back.as_slice())
    } else {
        scaled
            .pseudo_inverse(1e-6)
            .unwrap_or_else(|_| DMatrix::zeros(motion.ncols(), motion.nrows()))
    };
    back.row_mut(turn).scale_mut(1.0 / lever);
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
