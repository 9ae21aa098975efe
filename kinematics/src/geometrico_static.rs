//! The resting pose of a platform on unilateral cables (geometrico-static forward problem).
//!
//! The pose minimises W z_com + sum of T_j L_j over the tension-held cables, subject to
//! L_i <= l_i for the length-held ones (Berti, Merlet and Carricato, 2016, pose the same problem as
//! equations; the minimum picks the stable, unilateral solution). Method: a proximal augmented
//! Lagrangian. From a cold start its stages are minimised by Newton's method with a line search,
//! which cannot leave the unilateral problem; from a warm start, and at the end, full primal-dual
//! steps converge quadratically (Hintermueller, Ito and Kunisch, 2002, give the active-set view).

use nalgebra::Vector3;

use crate::cable_vec::{CableSet, CableVec};
use crate::energy::Gradient;
use crate::equilibrium_state::{Equilibrium, Held, Start, StaticOptions};
use crate::error::{Error, Solver};
use crate::inverse::{Inverse, evaluate, lanes_valid};
use crate::linear::{cholesky, cholesky_solve};
use crate::math::sqrt;
use crate::pose::Pose;
use crate::robot::Robot;

/// The held values as arrays: natural length, tension set-point, axial stiffness.
struct Problem<const N: usize> {
    natural: [f64; N],
    /// NaN for length-held cables.
    tension: [f64; N],
    /// Zero for inextensible cables.
    axial: [f64; N],
    /// The longest held length, or the anchors' extent: the size of the robot, m.
    size: f64,
}

/// State of the iteration.
struct State<const N: usize> {
    pose: Pose,
    inverse: Inverse<N>,
    tensions: [f64; N],
    iterations: usize,
}

struct Residual {
    force: f64,
    length: f64,
}

impl<const N: usize> Robot<N> {
    /// The resting pose for held lengths and tensions, cables unilateral.
    ///
    /// `held` has one entry per cable. Frame: world. Units: m, N.
    /// The answer is verified: wrench balance, held lengths, no negative tension, energy minimum. It
    /// is a local minimum: with much cable paid out a platform can also rest turned over, and a start
    /// near the expected pose decides which is found.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] (a value that is not finite or positive, cable named);
    /// [`Error::Unbounded`] if nothing holds the platform; [`Error::NotConverged`]; domain errors
    /// of [`Robot::inverse`] for the start.
    pub fn geometrico_static(
        &self,
        held: &[Held; N],
        start: Start<'_>,
        options: &StaticOptions,
    ) -> Result<Equilibrium, Error> {
        let problem = self.static_problem(held)?;
        let mut spent = 0;
        // Far from the answer the stages begin soft, so that no cable dominates; from a known pose
        // they begin stiff, so as not to leave its surroundings.
        let mut softness = 1e-3;
        let from = match start {
            Start::Warm(known) => {
                known.pose.check()?;
                let mut tensions = [0.0; N];
                if known.tensions_n.len() == N {
                    for i in 0..N {
                        let t = known.tensions_n[i];
                        tensions[i] = if t.is_finite() { t.max(0.0) } else { 0.0 };
                    }
                }
                if let Ok(mut state) = self.state(known.pose, tensions)
                    && let Some(residual) = self.polish(&problem, &mut state, options)
                {
                    return self.report(&problem, &state, &residual);
                }
                // A failed polish reports no count: it counts as all of its steps.
                spent += POLISH_STEPS;
                softness = 0.1;
                known.pose
            }
            Start::Pose(pose) => {
                pose.check()?;
                softness = 0.1;
                *pose
            }
            Start::Cold => self.cold_pose(&problem),
        };
        let mut last = Error::NotConverged {
            solver: Solver::GeometricoStatic,
            iterations: spent,
            residual: f64::INFINITY,
        };
        // The second and third starts serve geometries whose middle is not below the anchors.
        for drop in [0.0, 0.5, -1.0] {
            let mut pose = from;
            pose.position_m.z -= drop * problem.size;
            match self.descend(&problem, pose, softness, spent, options) {
                Ok((state, residual)) => return self.report(&problem, &state, &residual),
                Err(error) => last = error,
            }
            if matches!(last, Error::Unbounded { .. }) {
                return Err(last);
            }
        }
        Err(last)
    }

    fn static_problem(&self, held: &[Held; N]) -> Result<Problem<N>, Error> {
        let mut problem = Problem {
            natural: [0.0; N],
            tension: [f64::NAN; N],
            axial: [0.0; N],
            size: 0.0,
        };
        for (i, h) in held.iter().enumerate() {
            let check = |what, value: f64, ok: bool| {
                if ok && value.is_finite() {
                    Ok(value)
                } else {
                    Err(Error::InvalidInput {
                        what,
                        cable: Some(i + 1),
                        value,
                    })
                }
            };
            match *h {
                Held::Length(l) => {
                    problem.natural[i] = check("the held length must be positive", l, l > 0.0)?;
                    problem.size = problem.size.max(l);
                }
                Held::Tension(t) => {
                    problem.tension[i] =
                        check("the held tension must be zero or positive", t, t >= 0.0)?;
                }
                Held::Elastic {
                    unstretched_m: l,
                    ea_n,
                    routing_m,
                } => {
                    problem.natural[i] =
                        check("the unstretched length must be positive", l, l > 0.0)?;
                    let ea = check("the stiffness EA must be positive", ea_n, ea_n > 0.0)?;
                    let routing = check(
                        "the routing length must be zero or positive",
                        routing_m,
                        routing_m >= 0.0,
                    )?;
                    problem.axial[i] = ea / (l + routing);
                    problem.size = problem.size.max(l);
                }
            }
        }
        if problem.size == 0.0 {
            // Only tensions are held: the anchors' spread is the scale.
            let a0 = self.cables()[0].anchor_m;
            let spread = self.cables().iter().map(|c| (c.anchor_m - a0).norm());
            problem.size = spread.fold(self.lever_m, f64::max);
        }
        Ok(problem)
    }

    fn cold_pose(&self, problem: &Problem<N>) -> Pose {
        let n = N as f64;
        let middle = self
            .cables()
            .iter()
            .map(|c| c.anchor_m - c.attachment_m)
            .sum::<Vector3<f64>>()
            / n;
        let (mut drop2, mut count) = (0.0, 0.0);
        for (i, c) in self.cables().iter().enumerate() {
            if problem.natural[i] > 0.0 {
                let d = c.anchor_m - c.attachment_m - middle;
                drop2 += problem.natural[i] * problem.natural[i] - d.x * d.x - d.y * d.y;
                count += 1.0;
            }
        }
        // Cables near the level carry no weight: the start is a fifth of the robot's size below, at
        // least.
        let floor = 0.2 * problem.size;
        let drop2 = if count > 0.0 { drop2 / count } else { 0.0 };
        let drop = sqrt(drop2.max(floor * floor));
        Pose::level(middle - Vector3::z() * drop)
    }

    fn state(&self, pose: Pose, tensions: [f64; N]) -> Result<State<N>, Error> {
        let inverse = self.inverse(&pose)?;
        Ok(State {
            pose,
            inverse,
            tensions,
            iterations: 0,
        })
    }

    #[inline(always)]
    fn residual(&self, problem: &Problem<N>, state: &State<N>, g: &Gradient) -> Residual {
        let mut length = 0.0_f64;
        for i in 0..N {
            if problem.tension[i].is_nan() {
                let excess = state.inverse.lengths_m[i] - problem.natural[i];
                // Elastic: Hooke's law. Taut: the length must fit exactly. Slack: the cable may
                // only be too long.
                let miss = if problem.axial[i] > 0.0 {
                    (excess.max(0.0) - state.tensions[i] / problem.axial[i]).abs()
                } else if state.tensions[i] > 0.0 {
                    excess.abs()
                } else {
                    excess.max(0.0)
                };
                length = length.max(miss);
            }
        }
        Residual {
            force: self.wrench_norm(g),
            length,
        }
    }

    /// The larger of |force| and |moment| / lever of a gradient, N.
    #[inline(always)]
    pub(crate) fn wrench_norm(&self, g: &Gradient) -> f64 {
        let force = g[0] * g[0] + g[1] * g[1] + g[2] * g[2];
        let moment = (g[3] * g[3] + g[4] * g[4] + g[5] * g[5]) / (self.lever_m * self.lever_m);
        sqrt(force.max(moment))
    }

    /// Full primal-dual steps. `None` if they do not converge: the state is then invalid.
    fn polish(
        &self,
        problem: &Problem<N>,
        state: &mut State<N>,
        options: &StaticOptions,
    ) -> Option<Residual> {
        let weight = self.weight_n();
        let penalty = STIFFEST * weight / problem.size;
        let mut stiffness = [0.0; N];
        for _ in 0..POLISH_STEPS {
            for i in 0..N {
                if !problem.tension[i].is_nan() {
                    state.tensions[i] = problem.tension[i];
                }
            }
            let mut g = self.gradient(&state.pose, &state.inverse, &state.tensions);
            let residual = self.residual(problem, state, &g);
            if residual.force <= options.force_tolerance * weight
                && residual.length <= options.length_tolerance_m
            {
                return Some(residual);
            }
            // Prediction of the tension at zero step; the step adds stiffness * J d.
            let mut predicted = [0.0; N];
            for i in 0..N {
                stiffness[i] = 0.0;
                if problem.tension[i].is_nan() {
                    let excess = state.inverse.lengths_m[i] - problem.natural[i];
                    let (k, base) = if problem.axial[i] > 0.0 {
                        (problem.axial[i], 0.0)
                    } else {
                        (penalty, state.tensions[i])
                    };
                    // A taut cable stays in the active set until its tension has become negative;
                    // being slightly too long at a warm start does not indicate slack.
                    let active = state.tensions[i] > 0.0 || excess > 0.0;
                    stiffness[i] = if active { k } else { 0.0 };
                    predicted[i] = if active { base + k * excess } else { 0.0 };
                    // The gradient was taken with the old multiplier.
                    let change = predicted[i] - state.tensions[i];
                    let row = state.inverse.twist_row(i);
                    for k in 0..6 {
                        g[k] += change * row[k];
                    }
                }
            }
            let mut h = self.hessian(&state.pose, &state.inverse, &state.tensions, &stiffness);
            if !cholesky(&mut h) {
                return None;
            }
            let mut d = g.map(|x| -x);
            cholesky_solve(&h, &mut d);
            let (dp, phi) = (
                Vector3::new(d[0], d[1], d[2]),
                Vector3::new(d[3], d[4], d[5]),
            );
            // Half the robot's size or 0.5 rad is beyond quadratic convergence: the stages take
            // over.
            if !(dp.norm_squared() < 0.25 * problem.size * problem.size
                && phi.norm_squared() < 0.25)
            {
                return None;
            }
            for i in 0..N {
                if problem.tension[i].is_nan() {
                    let row = state.inverse.twist_row(i);
                    let mut t = predicted[i];
                    for k in 0..6 {
                        t += stiffness[i] * row[k] * d[k];
                    }
                    // A cable cannot push: without tension it leaves the active set in the next
                    // step.
                    state.tensions[i] = t.max(0.0);
                }
            }
            state.pose = state.pose.displaced(&dp, &phi);
            state.inverse = evaluate(
                &self.lanes,
                &state.pose.position_m,
                state.pose.rotation.matrix(),
            );
            state.iterations += 1;
            if !lanes_valid(&state.inverse) {
                return None;
            }
        }
        None
    }

    /// Stages of rising penalty, each minimised with a line search, then [`Robot::polish`].
    fn descend(
        &self,
        problem: &Problem<N>,
        pose: Pose,
        softness: f64,
        spent: usize,
        options: &StaticOptions,
    ) -> Result<(State<N>, Residual), Error> {
        let weight = self.weight_n();
        let mut state = self.state(pose, [0.0; N])?;
        state.iterations = spent;
        let mut multipliers = [0.0; N];
        let stiffest = STIFFEST * weight / problem.size;
        let mut penalty = softness * stiffest;
        let mut worst = f64::INFINITY;
        for stage in 0..12 {
            worst = self.minimise(problem, &mut state, &multipliers, penalty, options)?;
            for i in 0..N {
                // An elastic cable has a stiffness of its own: its tension needs no multiplier.
                multipliers[i] = if problem.axial[i] > 0.0 {
                    0.0
                } else {
                    state.tensions[i]
                };
            }
            if stage >= 1 {
                let mut trial = State {
                    pose: state.pose,
                    inverse: state.inverse,
                    tensions: state.tensions,
                    iterations: state.iterations,
                };
                if let Some(residual) = self.polish(problem, &mut trial, options) {
                    return Ok((trial, residual));
                }
                state.iterations += POLISH_STEPS;
            }
            // From a softness of 1e-3 this takes four stages, from 0.1 two.
            penalty = (penalty * 8.0).min(stiffest);
            if state.iterations > options.max_iterations {
                break;
            }
        }
        Err(Error::NotConverged {
            solver: Solver::GeometricoStatic,
            iterations: state.iterations,
            residual: worst,
        })
    }

    /// Minimises the augmented Lagrangian; leaves the penalised tensions in the state and returns
    /// the force residual.
    fn minimise(
        &self,
        problem: &Problem<N>,
        state: &mut State<N>,
        multipliers: &[f64; N],
        penalty: f64,
        options: &StaticOptions,
    ) -> Result<f64, Error> {
        let weight = self.weight_n();
        let mut worst = f64::INFINITY;
        for _ in 0..60 {
            let (energy, tensions, stiffness) =
                self.penalised(problem, &state.pose, &state.inverse, multipliers, penalty);
            state.tensions = tensions;
            let g = self.gradient(&state.pose, &state.inverse, &tensions);
            worst = self.wrench_norm(&g);
            // 1e-5 of the weight is enough: the multipliers are estimates, and `polish` makes them
            // exact.
            if worst < 1e-5 * weight {
                break;
            }
            let d = self.descent_direction(state, &stiffness, &g);
            let slope: f64 = d.iter().zip(&g).map(|(a, b)| a * b).sum();
            let (dp, phi) = (
                Vector3::new(d[0], d[1], d[2]),
                Vector3::new(d[3], d[4], d[5]),
            );
            let mut step = (0.25 * problem.size / dp.norm())
                .min(0.4 / phi.norm())
                .min(1.0);
            let mut moved = false;
            for _ in 0..40 {
                let pose = state.pose.displaced(&(dp * step), &(phi * step));
                let inverse = evaluate(&self.lanes, &pose.position_m, pose.rotation.matrix());
                if lanes_valid(&inverse) {
                    let (trial, ..) =
                        self.penalised(problem, &pose, &inverse, multipliers, penalty);
                    // Sufficient decrease (Armijo, 1966); the last term is the rounding of the
                    // energy.
                    if trial <= energy + 1e-4 * step * slope + 1e-15 * energy.abs() {
                        state.pose = pose;
                        state.inverse = inverse;
                        moved = true;
                        break;
                    }
                }
                step *= 0.5;
            }
            state.iterations += 1;
            // Held lengths bound the platform: 50 sizes away nothing holds it, and the energy has
            // no minimum.
            if (state.pose.position_m - self.cables()[0].anchor_m).norm() > 50.0 * problem.size {
                return Err(Error::Unbounded {
                    solver: Solver::GeometricoStatic,
                });
            }
            if !moved || state.iterations > options.max_iterations {
                break;
            }
        }
        Ok(worst)
    }

    /// Energy of the augmented Lagrangian, the tensions it implies and the stiffness of each cable.
    fn penalised(
        &self,
        problem: &Problem<N>,
        pose: &Pose,
        inverse: &Inverse<N>,
        multipliers: &[f64; N],
        penalty: f64,
    ) -> (f64, [f64; N], [f64; N]) {
        let mut energy = self.gravity_energy(pose);
        let (mut tensions, mut stiffness) = ([0.0; N], [0.0; N]);
        for i in 0..N {
            if problem.tension[i].is_nan() {
                let k = if problem.axial[i] > 0.0 {
                    // A stiff elastic cable takes part in the stages: never stiffer than they are.
                    problem.axial[i].min(penalty)
                } else {
                    penalty
                };
                let sigma = multipliers[i] + k * (inverse.lengths_m[i] - problem.natural[i]);
                if sigma > 0.0 {
                    energy += 0.5 * sigma * sigma / k;
                    tensions[i] = sigma;
                    stiffness[i] = k;
                }
            } else {
                energy += problem.tension[i] * inverse.lengths_m[i];
                tensions[i] = problem.tension[i];
            }
        }
        (energy, tensions, stiffness)
    }

    /// Newton's direction, shifted until the Hessian is positive definite.
    fn descent_direction(&self, state: &State<N>, stiffness: &[f64; N], g: &Gradient) -> [f64; 6] {
        let h = self.hessian(&state.pose, &state.inverse, &state.tensions, stiffness);
        let lever2 = self.lever_m * self.lever_m;
        let mut scale = 0.0;
        for k in 0..6 {
            scale += h[k][k].abs() / if k < 3 { 1.0 } else { lever2 };
        }
        let mut shift = 0.0;
        for _ in 0..30 {
            let mut trial = h;
            for k in 0..6 {
                trial[k][k] += shift * if k < 3 { 1.0 } else { lever2 };
            }
            if cholesky(&mut trial) {
                let mut d = g.map(|x| -x);
                cholesky_solve(&trial, &mut d);
                return d;
            }
            shift = if shift == 0.0 {
                1e-4 * scale
            } else {
                4.0 * shift
            };
        }
        // Steepest descent in scaled coordinates.
        core::array::from_fn(|k| -g[k] / if k < 3 { scale } else { scale * lever2 })
    }

    fn report(
        &self,
        problem: &Problem<N>,
        state: &State<N>,
        residual: &Residual,
    ) -> Result<Equilibrium, Error> {
        let mut out = Equilibrium {
            pose: state.pose,
            tensions_n: CableVec::from_fn(N, |i| state.tensions[i]),
            lengths_m: CableVec::from_fn(N, |i| state.inverse.lengths_m[i]),
            slack: CableSet::default(),
            tension_held: CableSet::default(),
            axial_stiffness_n_per_m: CableVec::from_fn(N, |i| problem.axial[i]),
            residual_n: residual.force,
            residual_m: residual.length,
            iterations: state.iterations,
            stable: false,
        };
        // Rounding leaves a slack cable with a multiplier of the order of the force tolerance.
        let nothing = 1e-9 * self.weight_n();
        for i in 0..N {
            if !problem.tension[i].is_nan() {
                out.tension_held.insert(i);
            } else if state.tensions[i] <= nothing {
                out.slack.insert(i);
            }
        }
        out.stable = self.is_minimum(&out, &state.inverse);
        Ok(out)
    }

    /// Whether the Hessian reduced to the null space of the taut length-held cables is positive
    /// definite: with a large stiffness along those cables the whole Hessian must be.
    pub(crate) fn is_minimum(&self, eq: &Equilibrium, inverse: &Inverse<N>) -> bool {
        let mut tensions = [0.0; N];
        let mut stiffness = [0.0; N];
        for i in 0..N {
            tensions[i] = eq.tensions_n[i];
            if !eq.tension_held.contains(i) && !eq.slack.contains(i) {
                let k = eq.axial_stiffness_n_per_m[i];
                stiffness[i] = if k > 0.0 {
                    k
                } else {
                    1e8 * self.weight_n() / inverse.lengths_m[i]
                };
            }
        }
        let mut h = self.hessian(&eq.pose, inverse, &tensions, &stiffness);
        cholesky(&mut h)
    }
}

// Three or four are usual; the others are for cables that become slack or taut on the way.
const POLISH_STEPS: usize = 16;

/// Penalty of a held length, in weights per size of the robot: high enough that the multipliers
/// settle in three or four steps, low enough that the rounding of a length, times this, stays below
/// the force tolerance.
const STIFFEST: f64 = 2e4;
