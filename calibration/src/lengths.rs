//! Eq. 44 of the paper: anchors, initial lengths, tag and camera from lengths and tag poses, by
//! Levenberg-Marquardt. With the variances as weights it is the joint estimate for tag poses given.
//!
//! A length depends on its own cable's anchor and initial length and on the twelve unknowns of tag
//! and camera: the former are eliminated cable by cable (Schur complement), which leaves 12 x 12.

use super::error::Refusal;
use mcdpr_kinematics::{Attempt, Cable, Damping, Error, Platform, Pose, Robot, descend};
use nalgebra::{DMatrix, Matrix3, Matrix4, SMatrix, SVector, Vector3, Vector4};

/// Form of the penalty on the anchors' distance from nominal in Eq. 44.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AnchorTerm {
    /// Its coordinates in mm, like the lengths: a quadratic cost.
    #[default]
    Millimetres,
    /// Its square in m^2 beside lengths in m, as Eq. 41 is printed: a cost of fourth power,
    /// negligible for errors of millimetres.
    SquaredMetres,
}

/// Weights of Eq. 44.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// lambda_1, on lengths.
    pub lengths: f64,
    /// lambda_2, on anchors.
    pub anchors: f64,
    /// Form and unit of the anchors' term.
    pub term: AnchorTerm,
}

impl Default for Weights {
    fn default() -> Self {
        Self {
            lengths: 5.0,
            anchors: 1.0,
            term: AnchorTerm::default(),
        }
    }
}

/// Lengths and tag poses: the input of Eq. 44.
#[derive(Debug, Clone)]
pub struct Problem {
    /// Nominal cables.
    pub nominal: Vec<Cable>,
    /// Encoder readings per pose, m.
    pub encoder_m: Vec<Vec<Option<f64>>>,
    /// camera_from_tag per pose.
    pub camera_from_tag: Vec<Pose>,
}

/// The unknowns of Eq. 44.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// Cables with estimated anchors.
    pub cables: Vec<Cable>,
    /// Initial lengths, m.
    pub initial_length_m: Vec<f64>,
    /// world_from_tag.
    pub world_from_tag: Pose,
    /// camera_from_platform.
    pub camera_from_platform: Pose,
}

/// Damping relative to the diagonal.
const DAMPING: Damping = Damping {
    start: 1e-6,
    least: 1e-14,
    most: 1e8,
    after_success: 0.1,
    after_failure: 10.0,
    steps: 200,
};

/// Unknowns of tag and camera.
const SHARED: usize = 12;
/// Elements of a row: derivatives by tag and camera, by the initial length, residual. Those by the
/// anchor are those by the tag's position with the opposite sign. Two more fill vector registers.
const ROW: usize = 16;
/// Indices of the initial length and of the residual in a row.
const LENGTH: usize = SHARED;
const RESIDUAL: usize = SHARED + 1;

/// Sums of products of one cable's rows, lower triangle.
type Sums = [[f64; ROW]; ROW];

/// The term of one cable's anchor: cost, gradient, Gauss-Newton matrix.
type Anchor = (f64, Vector3<f64>, Matrix3<f64>);

/// Normal equations of Eq. 44, cable by cable.
pub(crate) struct Linear {
    /// Weighted sum of squares, mm^2.
    pub(crate) cost: f64,
    cables: Vec<(Sums, Anchor)>,
}

/// A step of all unknowns, and the decrease of the cost that it promises.
struct Step {
    /// Per cable: anchor, initial length.
    own: Vec<Vector4<f64>>,
    shared: SVector<f64, SHARED>,
    expected: f64,
}

pub(crate) fn singles(cables: &[Cable]) -> Result<Vec<Robot<1>>, Error> {
    cables
        .iter()
        .map(|cable| Robot::new([*cable], unloaded()))
        .collect()
}

fn unloaded() -> Platform {
    Platform {
        mass_kg: 1.0,
        center_of_mass_m: Vector3::zeros(),
        inertia_kg_m2: None,
    }
}

/// The estimate by Eq. 44.
pub struct Fitted {
    /// The unknowns.
    pub estimate: Estimate,
    /// Weighted sum of squares, mm².
    pub cost_mm2: f64,
    /// Steps tried.
    pub steps: usize,
}

impl Problem {
    /// world_from_platform at a pose: the camera's place in the platform gives the platform's.
    pub(crate) fn platform(&self, at: &Estimate, k: usize) -> Pose {
        let world_from_camera = at
            .world_from_tag
            .compose(&self.camera_from_tag[k].inverse());
        world_from_camera.compose(&at.camera_from_platform)
    }

    /// Normal equations of Eq. 44, lengths in mm. `None` outside the domain.
    pub(crate) fn linear(&self, at: &Estimate, weights: &Weights) -> Option<Linear> {
        let mut sums = vec![[[0.0; ROW]; ROW]; self.nominal.len()];
        let per_m = 1e3 * weights.lengths;
        // Four cables at once are one vectorised evaluation.
        if let Ok(cables) = <&[Cable; 4]>::try_from(at.cables.as_slice()) {
            let robot = Robot::new(*cables, unloaded()).ok()?;
            self.accumulate(at, &[robot], per_m, &mut sums)?;
        } else {
            self.accumulate(at, &singles(&at.cables).ok()?, per_m, &mut sums)?;
        }
        let mut out = Linear {
            cost: 0.0,
            cables: Vec::with_capacity(sums.len()),
        };
        for (sums, (now, nominal)) in sums.iter().zip(at.cables.iter().zip(&self.nominal)) {
            let anchor = weights.anchor(&(now.anchor_m - nominal.anchor_m));
            out.cost += sums[RESIDUAL][RESIDUAL] + anchor.0;
            out.cables.push((*sums, anchor));
        }
        out.cost.is_finite().then_some(out)
    }

    /// Adds the rows of all cables, which are those of `robots` one after another.
    fn accumulate<const N: usize>(
        &self,
        at: &Estimate,
        robots: &[Robot<N>],
        per_m: f64,
        sums: &mut [Sums],
    ) -> Option<()> {
        for (tag, readings) in self.camera_from_tag.iter().zip(&self.encoder_m) {
            let world_from_camera = at.world_from_tag.compose(&tag.inverse());
            let pose = world_from_camera.compose(&at.camera_from_platform);
            let from_tag = pose.position_m - at.world_from_tag.position_m;
            let turned = world_from_camera.rotation.inverse();
            for (first, robot) in robots.iter().enumerate() {
                let inverse = robot.inverse(&pose).ok()?;
                for c in 0..N {
                    let i = first * N + c;
                    let Some(reading) = readings[i] else { continue };
                    let t = inverse.direction(c) * per_m;
                    let arm = inverse.arm_m(c);
                    // Turning the tag turns platform points about it; turning the platform in the
                    // camera (left, camera axes) moves the attachment on the platform.
                    let turn_tag = (from_tag + arm).cross(&t);
                    let turn_camera = turned * arm.cross(&t);
                    let t_camera = turned * t;
                    let mut row = [0.0; ROW];
                    for j in 0..3 {
                        row[j] = t[j];
                        row[3 + j] = turn_tag[j];
                        row[6 + j] = t_camera[j];
                        row[9 + j] = turn_camera[j];
                    }
                    row[LENGTH] = -per_m;
                    let length = inverse.lengths_m[c] - at.initial_length_m[i];
                    row[RESIDUAL] = (length - reading) * per_m;
                    for (a, line) in sums[i].iter_mut().enumerate() {
                        // Whole vector registers; what is beyond the diagonal is not read.
                        let upto = (a / 4 + 1) * 4;
                        for (slot, other) in line[..upto].iter_mut().zip(&row[..upto]) {
                            *slot += row[a] * other;
                        }
                    }
                }
            }
        }
        Some(())
    }

    /// Levenberg-Marquardt on Eq. 44.
    ///
    /// # Errors
    /// [`Refusal::NotConverged`].
    pub fn solve(&self, start: &Estimate, weights: &Weights) -> Result<Fitted, Refusal> {
        let outside = || Refusal::NotConverged {
            what: "the start is outside the robot's domain".to_owned(),
        };
        let now = self.linear(start, weights).ok_or_else(outside)?;
        let attempt = |at: &Estimate, now: &Linear, damping: f64| {
            let little = 1e-9 * now.cost + 1e-12;
            let Some(step) = now.step(damping) else {
                return Some(Attempt::Worse);
            };
            let trial = at.stepped(&step);
            if step.expected < little && damping < 1e-5 {
                // The gain is below the rounding of the cost: the step is taken without evaluating
                // it.
                return Some(Attempt::Unseen(trial));
            }
            Some(match self.linear(&trial, weights) {
                Some(next) if next.cost <= now.cost => {
                    if now.cost - next.cost < little {
                        Attempt::Last(trial, next)
                    } else {
                        Attempt::Better(trial, next)
                    }
                }
                _ => Attempt::Worse,
            })
        };
        let found = descend(start.clone(), now, &DAMPING, attempt).ok_or_else(outside)?;
        Ok(Fitted {
            estimate: found.at,
            cost_mm2: found.linear.cost,
            steps: found.steps,
        })
    }
}

impl Weights {
    fn anchor(&self, off: &Vector3<f64>) -> Anchor {
        let w = (1e3 * self.anchors).powi(2);
        let square = off.norm_squared();
        match self.term {
            AnchorTerm::Millimetres => (w * square, off * w, Matrix3::identity() * w),
            // In m^2, but the other rows are in mm: both times 1000.
            AnchorTerm::SquaredMetres => (
                w * square * square,
                off * (2.0 * w * square),
                off * off.transpose() * (4.0 * w),
            ),
        }
    }
}

impl Estimate {
    fn stepped(&self, step: &Step) -> Self {
        let three = |j: usize| step.shared.fixed_rows::<3>(j).into_owned();
        let mut out = self.clone();
        for (i, own) in step.own.iter().enumerate() {
            out.cables[i].anchor_m += own.xyz();
            out.initial_length_m[i] += own.w;
        }
        out.world_from_tag = self.world_from_tag.displaced(&three(0), &three(3));
        out.camera_from_platform = self.camera_from_platform.displaced(&three(6), &three(9));
        out
    }
}

/// One cable's part of the normal equations.
struct Part {
    own: Matrix4<f64>,
    own_g: Vector4<f64>,
    cross: SMatrix<f64, 4, SHARED>,
}

/// Index of each of a cable's own unknowns in a row, and its sign there.
const OWN: [(usize, f64); 4] = [(0, -1.0), (1, -1.0), (2, -1.0), (LENGTH, 1.0)];

impl Linear {
    fn part(&self, cable: usize) -> Part {
        let (sums, (_, anchor_g, anchor_h)) = &self.cables[cable];
        let of = |a: usize, b: usize| sums[a.max(b)][a.min(b)];
        let mut own = Matrix4::from_fn(|p, q| OWN[p].1 * OWN[q].1 * of(OWN[p].0, OWN[q].0));
        let mut own_g = Vector4::from_fn(|p, _| OWN[p].1 * of(OWN[p].0, RESIDUAL));
        let mut block = own.fixed_view_mut::<3, 3>(0, 0);
        block += anchor_h;
        let mut g = own_g.fixed_rows_mut::<3>(0);
        g += anchor_g;
        Part {
            own,
            own_g,
            cross: SMatrix::from_fn(|p, q| OWN[p].1 * of(OWN[p].0, q)),
        }
    }

    /// The step with Marquardt's damping (relative to the diagonal).
    fn step(&self, damping: f64) -> Option<Step> {
        // The literal fourth-power term has no curvature at nominal.
        let damped = |x: f64| x * (1.0 + damping) + 1e-12;
        let mut h = SMatrix::<f64, SHARED, SHARED>::zeros();
        let mut g = SVector::<f64, SHARED>::zeros();
        for (sums, _) in &self.cables {
            for a in 0..SHARED {
                for b in 0..=a {
                    h[(a, b)] += sums[a][b];
                }
                g[a] += sums[RESIDUAL][a];
            }
        }
        let mut expected = 0.0;
        for j in 0..SHARED {
            h[(j, j)] = damped(h[(j, j)]);
        }
        let mut eliminated = Vec::with_capacity(self.cables.len());
        for cable in 0..self.cables.len() {
            let mut part = self.part(cable);
            for j in 0..4 {
                part.own[(j, j)] = damped(part.own[(j, j)]);
            }
            let l = part.own.cholesky()?.unpack();
            let cross = l.solve_lower_triangular(&part.cross)?;
            let own_g = l.solve_lower_triangular(&part.own_g)?;
            h -= cross.tr_mul(&cross);
            g -= cross.tr_mul(&own_g);
            expected += own_g.norm_squared();
            eliminated.push((l, cross, own_g));
        }
        let shared = h.cholesky()?.solve(&-g);
        expected += -g.dot(&shared);
        let mut own = Vec::with_capacity(eliminated.len());
        for (l, cross, own_g) in eliminated {
            own.push(l.tr_solve_lower_triangular(&-(own_g + cross * shared))?);
        }
        Some(Step {
            own,
            shared,
            expected,
        })
    }

    /// The dense matrix: anchors, initial lengths, tag, camera.
    pub(crate) fn matrix(&self) -> DMatrix<f64> {
        let n = self.cables.len();
        let mut out = DMatrix::zeros(4 * n + SHARED, 4 * n + SHARED);
        for i in 0..n {
            let (part, sums) = (self.part(i), &self.cables[i].0);
            let at = |p: usize| if p < 3 { 3 * i + p } else { 3 * n + i };
            for p in 0..4 {
                for q in 0..4 {
                    out[(at(p), at(q))] = part.own[(p, q)];
                }
                for q in 0..SHARED {
                    out[(at(p), 4 * n + q)] = part.cross[(p, q)];
                    out[(4 * n + q, at(p))] = part.cross[(p, q)];
                }
            }
            for a in 0..SHARED {
                for b in 0..SHARED {
                    out[(4 * n + a, 4 * n + b)] += sums[a.max(b)][a.min(b)];
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DVector;

    /// A state off the minimum in every unknown.
    fn case() -> (Problem, Estimate) {
        let (problem, mut estimate) = super::super::paper::tests::case();
        estimate.cables[2].anchor_m.x += 3e-3;
        (problem, estimate)
    }

    fn terms() -> [Weights; 2] {
        [AnchorTerm::Millimetres, AnchorTerm::SquaredMetres].map(|term| Weights {
            term,
            ..Weights::default()
        })
    }

    /// A step from its dense form: anchors, initial lengths, tag, camera.
    fn dense_step(cables: usize, v: &DVector<f64>) -> Step {
        let at = |i: usize| Vector4::new(v[3 * i], v[3 * i + 1], v[3 * i + 2], v[3 * cables + i]);
        Step {
            own: (0..cables).map(at).collect(),
            shared: v.fixed_rows::<SHARED>(4 * cables).into_owned(),
            expected: 0.0,
        }
    }

    /// Half the cost's slopes by differences.
    fn slopes(problem: &Problem, at: &Estimate, weights: &Weights) -> DVector<f64> {
        let n = problem.nominal.len();
        DVector::from_fn(4 * n + SHARED, |j, _| {
            let cost = |size: f64| {
                let mut v = DVector::zeros(4 * n + SHARED);
                v[j] = size;
                let moved = at.stepped(&dense_step(n, &v));
                problem.linear(&moved, weights).unwrap().cost
            };
            (cost(1e-6) - cost(-1e-6)) / 4e-6
        })
    }

    #[test]
    fn a_step_solves_the_dense_system_of_slopes_by_differences() {
        let (problem, estimate) = case();
        for weights in terms() {
            let linear = problem.linear(&estimate, &weights).unwrap();
            let step = linear.step(1e-3).unwrap();
            let mut h = linear.matrix();
            for j in 0..h.nrows() {
                h[(j, j)] = h[(j, j)] * (1.0 + 1e-3) + 1e-12;
            }
            let mut v = DVector::zeros(h.nrows());
            for (i, own) in step.own.iter().enumerate() {
                v.rows_mut(3 * i, 3).copy_from(&own.xyz());
                v[12 + i] = own.w;
            }
            v.rows_mut(16, SHARED).copy_from(&step.shared);
            let slopes = slopes(&problem, &estimate, &weights);
            let error = (&h * &v + &slopes).amax() / (1.0 + slopes.amax());
            assert!(error < 1e-6, "{:?}: {error:e}", weights.term);
            assert!((step.expected + slopes.dot(&v)).abs() < 1e-5 * step.expected);
        }
    }

    #[test]
    fn a_readings_absence_leaves_its_row_out() {
        let (mut problem, estimate) = case();
        let weights = Weights::default();
        let all = problem.linear(&estimate, &weights).unwrap().cost;
        problem.encoder_m[3][1] = None;
        let fewer = problem.linear(&estimate, &weights).unwrap().cost;
        assert!(fewer < all);
        // One cable after another gives the same result as all at once.
        let (five, more) = (&mut problem.clone(), &mut estimate.clone());
        five.nominal.push(five.nominal[0]);
        more.cables.push(more.cables[0]);
        more.initial_length_m.push(0.0);
        five.encoder_m.iter_mut().for_each(|r| r.push(None));
        let same = five.linear(more, &weights).unwrap().cost;
        assert!((same - fewer).abs() < 1e-9 * fewer);
    }
}
