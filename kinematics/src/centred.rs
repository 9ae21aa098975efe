//! Tensions well inside their limits that change smoothly with the pose.
//!
//! The distribution minimises `sum phi_i(T_i)` over the balanced tensions, with
//! `phi(T) = -(wish - min) log(T - min) - (max - wish) log(max - T)`: the analytic centre of the
//! limits (Boyd and Vandenberghe, Convex Optimization, 2004, 8.5.3), weighted so that a cable on its
//! own has the wished tension. `phi` is strictly convex and infinite at both limits. So the optimum is
//! unique, lies strictly inside the limits wherever a balanced distribution does, and is an analytic
//! function of the pose: its path has no kink, and it is the same forwards and backwards.
//!
//! The dual problem `min_v sum phi*_i((A^T v)_i) - b.v` has one unknown per equation and no limits;
//! `T_i` as a function of `(A^T v)_i` is the root of a quadratic. Newton's method with a line search
//! solves it in a bounded number of steps.

use nalgebra::{Matrix6, Vector3, Vector6};

use crate::any_robot::AnyRobot;
use crate::cable_vec::{CableVec, MAX_CABLES};
use crate::error::{Bound, Error, Solver};
use crate::linear::{cholesky, cholesky_solve};
use crate::math::{ln, sqrt};
use crate::pose::Pose;

/// Newton steps before the tensions count as impossible; 6 to 12 are usual.
const MOST_STEPS: usize = 60;
/// Balance relative to the load.
const BALANCED: f64 = 1e-11;
/// Equations of a rigid body.
const K: usize = 6;

/// Limits and wished tensions of a smooth distribution, one entry per cable, N.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Band<'a> {
    /// Lower limits.
    pub min_n: &'a [f64],
    /// Upper limits.
    pub max_n: &'a [f64],
    /// The tension that a cable has when it is free to choose, strictly inside its limits.
    pub wish_n: &'a [f64],
}

/// Weights of the barrier and the limits of one cable.
#[derive(Clone, Copy, Default)]
struct Barrier {
    min: f64,
    width: f64,
    low: f64,
    high: f64,
}

impl Barrier {
    /// Tension, its slope by `u`, and the conjugate `u T - phi(T)`, where `phi'(T) = u`.
    fn at(&self, u: f64) -> (f64, f64, f64) {
        let (a, b, w) = (self.low, self.high, self.width);
        // p = T - min and q = max - T: each from the form of the root that does not cancel.
        let (p, q) = if u > 0.0 {
            let c = a + b + u * w;
            let q = 2.0 * b * w / (c + sqrt(c * c - 4.0 * u * b * w));
            (w - q, q)
        } else {
            let c = a + b - u * w;
            let p = 2.0 * a * w / (c + sqrt(c * c + 4.0 * u * a * w));
            (p, w - p)
        };
        let tension = self.min + p;
        let slope = 1.0 / (a / (p * p) + b / (q * q));
        (tension, slope, u * tension + a * ln(p) + b * ln(q))
    }
}

impl AnyRobot {
    /// Tensions that balance gravity along some freedoms of the platform, see the module's text.
    ///
    /// `freedoms` are one to six independent twists `[velocity, angular velocity]` (world, about the
    /// platform's origin): the directions in which the cables must balance it. With as many cables as
    /// freedoms the tensions are unique, and the limits are not looked at.
    ///
    /// # Errors
    /// [`Error::CableCount`]; [`Error::InvalidInput`] for limits that are crossed;
    /// [`Error::TooFewCables`]; [`Error::Singular`]; [`Error::NegativeTension`] for unique tensions;
    /// [`Error::OutsideTensionLimits`] naming the cable that is furthest driven against a limit.
    pub fn centred_tensions(
        &self,
        pose: &Pose,
        freedoms: &[Vector6<f64>],
        band: &Band<'_>,
    ) -> Result<CableVec<f64>, Error> {
        let rows = self.twist_jacobian(pose)?;
        let count = rows.len();
        for list in [band.min_n, band.max_n, band.wish_n] {
            if list.len() != count {
                return Err(Error::CableCount {
                    expected: count,
                    got: list.len(),
                });
            }
        }
        let equations = freedoms.len().min(K);
        if count < equations {
            return Err(Error::TooFewCables {
                solver: Solver::TensionDistribution,
                needed: equations,
                got: count,
            });
        }
        let weight = Vector3::z() * -self.weight_n();
        let moment = (pose.rotation * self.platform().center_of_mass_m).cross(&weight);
        let gravity = Vector6::new(weight.x, weight.y, weight.z, moment.x, moment.y, moment.z);
        // A row of the Jacobian is the direction in which a cable gets longer; it pulls the other way.
        let mut a = [[0.0; MAX_CABLES]; K];
        let mut load = [0.0; K];
        for (k, twist) in freedoms.iter().take(K).enumerate() {
            load[k] = -twist.dot(&gravity);
            for (i, row) in rows.iter().enumerate() {
                a[k][i] = -(0..6).map(|j| row[j] * twist[j]).sum::<f64>();
            }
        }
        if count == equations {
            return unique(&a, &load, count);
        }
        centre(&a, &load, equations, band)
    }
}

/// As many cables as equations.
fn unique(
    a: &[[f64; MAX_CABLES]; K],
    load: &[f64; K],
    count: usize,
) -> Result<CableVec<f64>, Error> {
    // Unused rows get the unit matrix: one fixed size serves every number of cables.
    let matrix = Matrix6::from_fn(|k, i| {
        if k < count && i < count {
            a[k][i]
        } else {
            f64::from(u8::from(k == i))
        }
    });
    let singular = Error::Singular {
        solver: Solver::TensionDistribution,
    };
    let solved = matrix
        .lu()
        .solve(&Vector6::from(*load))
        .filter(|t| t.iter().all(|x| x.is_finite()))
        .ok_or(singular)?;
    if let Some(cable) = (0..count).find(|&i| !(solved[i] >= 0.0)) {
        return Err(Error::NegativeTension {
            cable: cable + 1,
            tension_n: solved[cable],
        });
    }
    Ok(CableVec::from_fn(count, |i| solved[i]))
}

fn centre(
    a: &[[f64; MAX_CABLES]; K],
    load: &[f64; K],
    equations: usize,
    band: &Band<'_>,
) -> Result<CableVec<f64>, Error> {
    let count = band.min_n.len();
    let mut barriers = [Barrier::default(); MAX_CABLES];
    for i in 0..count {
        let (min, max, wish) = (band.min_n[i], band.max_n[i], band.wish_n[i]);
        // The distances from the wish are the barrier's weights: at a limit one of them would
        // vanish.
        if !(min >= 0.0 && min < wish && wish < max && max.is_finite()) {
            return Err(Error::InvalidInput {
                what: "tension limits must be 0 <= minimum < wished tension < maximum",
                cable: Some(i + 1),
                value: wish,
            });
        }
        barriers[i] = Barrier {
            min,
            width: max - min,
            low: wish - min,
            high: max - wish,
        };
    }
    let lift = |v: &[f64; K], i: usize| (0..equations).map(|k| a[k][i] * v[k]).sum::<f64>();
    let value = |v: &[f64; K]| {
        let sum: f64 = (0..count).map(|i| barriers[i].at(lift(v, i)).2).sum();
        sum - (0..equations).map(|k| load[k] * v[k]).sum::<f64>()
    };
    let scale = load.iter().fold(1.0_f64, |s, x| s.max(x.abs()));
    let mut v = [0.0; K];
    let mut now = value(&v);
    let mut off = f64::INFINITY;
    for _ in 0..MOST_STEPS {
        let mut hessian = [[0.0; K]; K];
        let mut gradient = [0.0; K];
        let mut tensions = [0.0; MAX_CABLES];
        for i in 0..count {
            let (tension, slope, _) = barriers[i].at(lift(&v, i));
            tensions[i] = tension;
            for k in 0..equations {
                gradient[k] += a[k][i] * tension;
                for c in 0..=k {
                    hessian[k][c] += a[k][i] * a[c][i] * slope;
                }
            }
        }
        off = 0.0;
        for k in 0..K {
            if k < equations {
                gradient[k] -= load[k];
                off = f64::max(off, gradient[k].abs());
            } else {
                hessian[k][k] = 1.0;
            }
        }
        if off <= BALANCED * scale {
            return Ok(CableVec::from_fn(count, |i| tensions[i]));
        }
        let mut step = gradient.map(|x| -x);
        if !cholesky(&mut hessian) {
            break;
        }
        cholesky_solve(&hessian, &mut step);
        let slope: f64 = (0..equations).map(|k| gradient[k] * step[k]).sum();
        let mut share = 1.0;
        let mut moved = false;
        for _ in 0..40 {
            let trial: [f64; K] = core::array::from_fn(|k| v[k] + share * step[k]);
            let next = value(&trial);
            // Sufficient decrease (Armijo, 1966); the last term is the rounding of the value.
            if next <= now + 1e-4 * share * slope + 1e-13 * now.abs() {
                (v, now, moved) = (trial, next, true);
                break;
            }
            share *= 0.5;
        }
        if !moved {
            break;
        }
    }
    // Rounding ends the line search a little before the tolerance: such an answer is as good.
    if off <= 1e3 * BALANCED * scale {
        return Ok(CableVec::from_fn(count, |i| barriers[i].at(lift(&v, i)).0));
    }
    Err(impossible(&barriers, count, off, |i| lift(&v, i)))
}

/// The cable that is driven furthest against a limit.
#[cold]
fn impossible(
    barriers: &[Barrier; MAX_CABLES],
    count: usize,
    off: f64,
    lift: impl Fn(usize) -> f64,
) -> Error {
    // The barrier's slope is infinite at both limits: its size shows how near a cable is to one.
    let pressed = |i: usize| lift(i).abs();
    let worst = (0..count).fold(0, |w, i| if pressed(i) > pressed(w) { i } else { w });
    if !off.is_finite() || barriers[worst].width <= 0.0 {
        return Error::Singular {
            solver: Solver::TensionDistribution,
        };
    }
    Error::OutsideTensionLimits {
        cable: worst + 1,
        bound: if lift(worst) > 0.0 {
            Bound::Maximum
        } else {
            Bound::Minimum
        },
        violation_n: off,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::eight_cables;

    fn freedoms() -> [Vector6<f64>; 6] {
        core::array::from_fn(|k| Vector6::from_fn(|j, _| f64::from(u8::from(j == k))))
    }

    #[test]
    fn tensions_balance_lie_inside_and_do_not_depend_on_the_way() {
        let robot = eight_cables();
        let any = AnyRobot::new(robot.cables(), *robot.platform()).unwrap();
        let (min, max, wish) = ([5.0; 8], [176.0; 8], [40.0; 8]);
        let band = Band {
            min_n: &min,
            max_n: &max,
            wish_n: &wish,
        };
        let middle = robot
            .cables()
            .iter()
            .map(|c| c.anchor_m)
            .sum::<Vector3<f64>>()
            / 8.0;
        let mut before: Option<CableVec<f64>> = None;
        for step in 0..=200 {
            let along = f64::from(step) / 200.0 - 0.5;
            let pose = Pose::level(middle + Vector3::new(0.4 * along, 0.2 * along, 0.1 * along));
            let t = any.centred_tensions(&pose, &freedoms(), &band).unwrap();
            let rows = any.twist_jacobian(&pose).unwrap();
            for k in 0..6 {
                let pull: f64 = (0..8).map(|i| -rows[i][k] * t[i]).sum();
                let weight = if k == 2 { robot.weight_n() } else { 0.0 };
                let lever = pose.rotation * robot.platform().center_of_mass_m;
                let tilt = match k {
                    3 => lever.y * robot.weight_n(),
                    4 => -lever.x * robot.weight_n(),
                    _ => 0.0,
                };
                assert!((pull - weight - tilt).abs() < 1e-8, "{k}: {pull}");
            }
            for i in 0..8 {
                assert!(t[i] > 5.0 && t[i] < 176.0);
                if let Some(old) = &before {
                    assert!((t[i] - old[i]).abs() < 1.7, "a jump of cable {i}");
                }
            }
            before = Some(t);
        }
    }

    #[test]
    fn a_load_that_no_tension_holds_names_a_cable() {
        let robot = eight_cables();
        let any = AnyRobot::new(robot.cables(), *robot.platform()).unwrap();
        let middle = robot
            .cables()
            .iter()
            .map(|c| c.anchor_m)
            .sum::<Vector3<f64>>()
            / 8.0;
        let band = Band {
            min_n: &[0.1; 8],
            max_n: &[1.0; 8],
            wish_n: &[0.5; 8],
        };
        let error = any.centred_tensions(&Pose::level(middle), &freedoms(), &band);
        assert!(
            matches!(error, Err(Error::OutsideTensionLimits { .. })),
            "{error:?}"
        );
    }
}
