//! Forward kinematics from lengths alone (paper, Eqs. 13-16), for the determined problems:
//! position at a given attitude, position and yaw, all six degrees of freedom.
//!
//! Gauss-Newton on the length residuals: the lengths fit exactly or nearly so, which makes it
//! converge quadratically (cubically for the position, with the second derivatives along the step).
//! Cases that it cannot solve go to a damped (Levenberg-Marquardt) iteration from several starts.
//! For the resting pose of a hanging platform see [`Robot::geometrico_static`].

use nalgebra::{Rotation3, Vector3};

use crate::error::{Error, Solver};
use crate::inverse::{Inverse, evaluate, evaluate_arms, lanes_valid};
use crate::linear::{cholesky, cholesky_solve};
use crate::math::sqrt;
use crate::pose::Pose;
use crate::robot::Robot;

/// Acceptance criteria of the forward solvers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForwardOptions {
    /// Largest root-mean-square length residual of an accepted pose, m.
    pub max_residual_m: f64,
    /// Iterations of the damped method before giving up on one start.
    pub max_iterations: usize,
}

impl Default for ForwardOptions {
    /// 1 mm and 100 iterations.
    fn default() -> Self {
        Self {
            max_residual_m: 1e-3,
            max_iterations: 100,
        }
    }
}

/// A pose that fits the lengths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Forward {
    /// Pose world_from_platform.
    pub pose: Pose,
    /// Root mean square of the length residuals, m.
    pub residual_m: f64,
    /// Steps taken.
    pub iterations: usize,
}

impl<const N: usize> Robot<N> {
    /// Position of the platform for a given attitude; three cables or more.
    ///
    /// `lengths_m` are the lengths from anchor to attachment. `start_m` is a position nearby, or
    /// `None`: then the solution below the anchors is sought (with all anchors in one plane there is
    /// a mirror image above). Frame: world. Units: m. Source: paper, Eqs. 13-16.
    ///
    /// # Errors
    /// [`Error::TooFewCables`], [`Error::InvalidInput`], [`Error::ResidualTooLarge`],
    /// [`Error::Singular`], [`Error::NotConverged`].
    ///
    /// ```
    /// use mcdpr_kinematics::{ForwardOptions, Pose, four_cables};
    /// use nalgebra::Vector3;
    /// let robot = four_cables();
    /// let pose = Pose::level(Vector3::new(0.3, 0.05, -0.2));
    /// let lengths = robot.lengths_m(&pose)?;
    /// let found = robot.position(&lengths, &pose.rotation, None, &ForwardOptions::default())?;
    /// assert!((found.pose.position_m - pose.position_m).norm() < 1e-12);
    /// # Ok::<(), mcdpr_kinematics::Error>(())
    /// ```
    pub fn position(
        &self,
        lengths_m: &[f64; N],
        rotation: &Rotation3<f64>,
        start_m: Option<&Vector3<f64>>,
        options: &ForwardOptions,
    ) -> Result<Forward, Error> {
        self.check_lengths(lengths_m, Solver::Position, 3)?;
        let m = rotation.matrix();
        let att = &self.lanes.attachment;
        // The attitude is given: R A is the same in all steps.
        let mut arms = [[0.0; N]; 3];
        for k in 0..3 {
            for i in 0..N {
                arms[k][i] = m[(k, 0)] * att[0][i] + m[(k, 1)] * att[1][i] + m[(k, 2)] * att[2][i];
            }
        }
        let first = match start_m {
            Some(p) => *p,
            None => self.below(lengths_m, &arms),
        };
        if let Some((position, mean_square, iterations)) =
            self.gauss_newton(lengths_m, &arms, first)
            && mean_square <= options.max_residual_m * options.max_residual_m
        {
            return Ok(Forward {
                pose: Pose::new(position, *rotation),
                residual_m: sqrt(mean_square),
                iterations,
            });
        }
        self.damped_from_starts(
            lengths_m,
            Pose::new(first, *rotation),
            Solver::Position,
            options,
            |pose, d: &[f64; 3]| Pose::new(pose.position_m + Vector3::from(*d), pose.rotation),
            |inverse, i| inverse.direction(i).into(),
        )
    }

    /// Position and yaw for a given roll and pitch; four cables or more.
    ///
    /// `start` gives roll and pitch (kept exactly), and the position and yaw to start from; with
    /// `position_known` false, only its yaw is used, and the position is the one that fits best at
    /// that attitude. Frame: world. Units: m, rad.
    ///
    /// # Errors
    /// As [`Robot::position`].
    pub fn position_and_yaw(
        &self,
        lengths_m: &[f64; N],
        start: &Pose,
        position_known: bool,
        options: &ForwardOptions,
    ) -> Result<Forward, Error> {
        self.check_lengths(lengths_m, Solver::PositionYaw, 4)?;
        let start = self.start_pose(lengths_m, start, position_known);
        self.damped_from_starts(
            lengths_m,
            start,
            Solver::PositionYaw,
            options,
            |pose, d: &[f64; 4]| {
                pose.displaced(&Vector3::new(d[0], d[1], d[2]), &(Vector3::z() * d[3]))
            },
            |inverse, i| {
                let row = inverse.twist_row(i);
                [row[0], row[1], row[2], row[5]]
            },
        )
    }

    /// All six degrees of freedom; six cables or more.
    ///
    /// `start` is a pose nearby; with `position_known` false only its attitude is used.
    /// Frame: world. Units: m.
    ///
    /// # Errors
    /// As [`Robot::position`].
    pub fn pose(
        &self,
        lengths_m: &[f64; N],
        start: &Pose,
        position_known: bool,
        options: &ForwardOptions,
    ) -> Result<Forward, Error> {
        self.check_lengths(lengths_m, Solver::Pose, 6)?;
        let start = self.start_pose(lengths_m, start, position_known);
        self.damped_from_starts(
            lengths_m,
            start,
            Solver::Pose,
            options,
            |pose, d: &[f64; 6]| {
                pose.displaced(
                    &Vector3::new(d[0], d[1], d[2]),
                    &Vector3::new(d[3], d[4], d[5]),
                )
            },
            |inverse, i| inverse.twist_row(i).into(),
        )
    }

    fn check_lengths(&self, l: &[f64; N], solver: Solver, needed: usize) -> Result<(), Error> {
        if N < needed {
            return Err(Error::TooFewCables {
                solver,
                needed,
                got: N,
            });
        }
        for (i, &value) in l.iter().enumerate() {
            // Negated, so that NaN is refused, too; the upper bound refuses infinity.
            if !(value > 0.0 && value < 1e9) {
                return Err(Error::InvalidInput {
                    what: "the length must be positive",
                    cable: Some(i + 1),
                    value,
                });
            }
        }
        Ok(())
    }

    /// Start for a pose with unknown angles. Lengths may fit several poses exactly, some with the
    /// cables twisted about each other; from the position that fits them best at the start's
    /// attitude the one nearest to that attitude is found.
    fn start_pose(&self, lengths_m: &[f64; N], start: &Pose, position_known: bool) -> Pose {
        if position_known {
            return *start;
        }
        // At a wrong attitude the lengths cannot fit: any residual is good enough for a start.
        let loose = ForwardOptions {
            max_residual_m: f64::MAX,
            ..ForwardOptions::default()
        };
        if let Ok(found) = self.position(lengths_m, &start.rotation, None, &loose) {
            return found.pose;
        }
        let arms = evaluate(&self.lanes, &start.position_m, start.rotation.matrix()).arms_m;
        Pose::new(self.below(lengths_m, &arms), start.rotation)
    }

    /// A start below the middle of the anchors, as deep as the lengths allow on average.
    #[inline(always)]
    fn below(&self, lengths_m: &[f64; N], arms: &[[f64; N]; 3]) -> Vector3<f64> {
        let per = 1.0 / N as f64;
        let b = &self.lanes.anchor;
        let mut middle = Vector3::zeros();
        for k in 0..3 {
            for i in 0..N {
                middle[k] += (b[k][i] - arms[k][i]) * per;
            }
        }
        let (mut drop2, mut mean) = (0.0_f64, 0.0_f64);
        for i in 0..N {
            let (dx, dy) = (
                b[0][i] - arms[0][i] - middle.x,
                b[1][i] - arms[1][i] - middle.y,
            );
            drop2 += (lengths_m[i] * lengths_m[i] - dx * dx - dy * dy) * per;
            mean += lengths_m[i] * lengths_m[i] * per;
        }
        // Lengths shorter than the anchors' spread give a negative square: then a tenth of the rms
        // length.
        middle.z -= sqrt(drop2.max(0.01 * mean));
        middle
    }

    /// Undamped steps while they converge. Returns the position, the mean square residual and the
    /// number of steps; `None` hands over to the damped method.
    #[inline(always)]
    fn gauss_newton(
        &self,
        lengths_m: &[f64; N],
        arms: &[[f64; N]; 3],
        start: Vector3<f64>,
    ) -> Option<(Vector3<f64>, f64, usize)> {
        let mut p = start;
        let mut last = f64::INFINITY;
        for iteration in 1..=16 {
            let inverse = evaluate_arms(&self.lanes, &p, arms);
            let [tx, ty, tz] = &inverse.directions;
            let (mut xx, mut xy, mut xz) = (0.0, 0.0, 0.0);
            let (mut yy, mut yz, mut zz) = (0.0, 0.0, 0.0);
            let (mut gx, mut gy, mut gz, mut cost) = (0.0, 0.0, 0.0, 0.0);
            for i in 0..N {
                let r = lengths_m[i] - inverse.lengths_m[i];
                xx += tx[i] * tx[i];
                xy += tx[i] * ty[i];
                xz += tx[i] * tz[i];
                yy += ty[i] * ty[i];
                yz += ty[i] * tz[i];
                zz += tz[i] * tz[i];
                gx += tx[i] * r;
                gy += ty[i] * r;
                gz += tz[i] * r;
                cost += r * r;
            }
            // NaN (outside the domain) fails this comparison, too.
            if !(cost < last) {
                return None;
            }
            last = cost;
            let (c00, c01, c02) = (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy);
            let det = xx * c00 + xy * c01 + xz * c02;
            // The trace is N: a determinant this small means a plane of directions.
            if !(det > 1e-9) {
                return None;
            }
            let (c11, c12, c22) = (xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy);
            let inv = 1.0 / det;
            let solve = |gx: f64, gy: f64, gz: f64| {
                [
                    (c00 * gx + c01 * gy + c02 * gz) * inv,
                    (c01 * gx + c11 * gy + c12 * gz) * inv,
                    (c02 * gx + c12 * gy + c22 * gz) * inv,
                ]
            };
            let [dx, dy, dz] = solve(gx, gy, gz);
            // The lengths bend along the step: repeat it with their second-order change, which costs
            // far less than another evaluation and makes the convergence cubic.
            let first2 = dx * dx + dy * dy + dz * dz;
            let mut bend = [0.0; N];
            let [ex, ey, ez] = &inverse.swivel_directions;
            let axis = &self.lanes.axis;
            for i in 0..N {
                let along = tx[i] * dx + ty[i] * dy + tz[i] * dz;
                let outward = ex[i] * dx + ey[i] * dy + ez[i] * dz;
                let axial = axis[0][i] * dx + axis[1][i] * dy + axis[2][i] * dz;
                let normal = inverse.wrap_cos[i] * outward - inverse.wrap_sin[i] * axial;
                let across2 = first2 - along * along - normal * normal;
                bend[i] = 0.5
                    * (normal * normal / inverse.free_lengths_m[i]
                        + across2 * inverse.wrap_sin[i] / inverse.axis_distances_m[i]);
                gx -= tx[i] * bend[i];
                gy -= ty[i] * bend[i];
                gz -= tz[i] * bend[i];
            }
            let [dx, dy, dz] = solve(gx, gy, gz);
            p += Vector3::new(dx, dy, dz);
            let step2 = dx * dx + dy * dy + dz * dz;
            let mut predicted = 0.0;
            let mut shortest = f64::MAX;
            for i in 0..N {
                let along = tx[i] * dx + ty[i] * dy + tz[i] * dz;
                let left = lengths_m[i] - inverse.lengths_m[i] - bend[i] - along;
                predicted += left * left;
                let s = inverse.free_lengths_m[i];
                shortest = if s < shortest { s } else { shortest };
            }
            // Squared estimate of what is left: step (step^2 / length + residual) / length, over the
            // squared worst amplification of the normal equations.
            let per2 = 1.0 / (shortest * shortest);
            let left2 = step2 * per2 * (step2 * step2 * per2 + predicted) / (det * det);
            // 1e-13 m: the next step would only move by rounding.
            if left2 < 1e-26 {
                // The residual predicted for this step stands for another evaluation of all
                // lengths.
                return Some((p, predicted / N as f64, iteration));
            }
        }
        None
    }

    /// Levenberg-Marquardt from the given start, and from a few others if that fails.
    fn damped_from_starts<const K: usize>(
        &self,
        lengths_m: &[f64; N],
        start: Pose,
        solver: Solver,
        options: &ForwardOptions,
        apply: impl Fn(&Pose, &[f64; K]) -> Pose,
        row: impl Fn(&Inverse<N>, usize) -> [f64; K],
    ) -> Result<Forward, Error> {
        start.check()?;
        let arms = evaluate(&self.lanes, &start.position_m, start.rotation.matrix()).arms_m;
        let below = self.below(lengths_m, &arms);
        let longest = lengths_m.iter().fold(0.0_f64, |a, &b| a.max(b));
        let mut best: Option<Error> = None;
        for k in 0..4 {
            // Lengths may fit poses on both sides of the anchors: lower starts are tried first.
            let mut from = start;
            match k {
                0 => {}
                1 => from.position_m = below,
                2 => from.position_m = below - Vector3::z() * 0.5 * longest,
                _ => from.position_m = below + Vector3::z() * 0.2 * longest,
            }
            match self.damped(lengths_m, from, solver, options, &apply, &row) {
                Ok(found) if found.residual_m <= options.max_residual_m => return Ok(found),
                Ok(found) => {
                    let better = match best {
                        Some(Error::ResidualTooLarge { residual_m, .. }) => {
                            found.residual_m < residual_m
                        }
                        _ => true,
                    };
                    if better {
                        best = Some(Error::ResidualTooLarge {
                            solver,
                            residual_m: found.residual_m,
                            limit_m: options.max_residual_m,
                        });
                    }
                }
                Err(error) => best = best.or(Some(error)),
            }
        }
        Err(best.unwrap_or(Error::Singular { solver }))
    }

    /// Levenberg-Marquardt from one start. `apply` displaces a pose by K unknowns, `row` gives a
    /// length's slopes by them.
    fn damped<const K: usize>(
        &self,
        lengths_m: &[f64; N],
        start: Pose,
        solver: Solver,
        options: &ForwardOptions,
        apply: &impl Fn(&Pose, &[f64; K]) -> Pose,
        row: &impl Fn(&Inverse<N>, usize) -> [f64; K],
    ) -> Result<Forward, Error> {
        let cost_at = |inverse: &Inverse<N>| -> f64 {
            (0..N)
                .map(|i| {
                    (lengths_m[i] - inverse.lengths_m[i]) * (lengths_m[i] - inverse.lengths_m[i])
                })
                .sum()
        };
        // Radians count as metres at the lever, so that one damping suits both.
        let scale = |k: usize| {
            if k < 3 {
                1.0
            } else {
                self.lever_m * self.lever_m
            }
        };
        let found = |pose, cost, iteration| Forward {
            pose,
            residual_m: sqrt(cost / N as f64),
            iterations: iteration + 1,
        };
        let mut pose = start;
        let mut inverse = self.inverse(&pose)?;
        let mut cost = cost_at(&inverse);
        // Undamped first: near the answer this is Gauss-Newton with its fast convergence.
        let mut damping = 0.0;
        for iteration in 0..options.max_iterations {
            let (normal, g) = normal_equations(lengths_m, &inverse, row);
            let mut accepted = false;
            for _ in 0..24 {
                let mut m = normal;
                for (k, line) in m.iter_mut().enumerate() {
                    line[k] += damping * scale(k);
                }
                let mut d = g;
                if cholesky(&mut m) {
                    cholesky_solve(&m, &mut d);
                    let size2: f64 = (0..K).map(|k| d[k] * d[k] * scale(k)).sum();
                    // Long steps leave the region where the lengths are nearly linear.
                    let shortest = lengths_m.iter().fold(f64::MAX, |a, &b| a.min(b));
                    if size2 < 0.25 * shortest * shortest {
                        let trial_pose = apply(&pose, &d);
                        let trial = evaluate(
                            &self.lanes,
                            &trial_pose.position_m,
                            trial_pose.rotation.matrix(),
                        );
                        let trial_cost = cost_at(&trial);
                        // A step of 1e-12 of the shortest length is rounding: the cost may rise by
                        // rounding, too.
                        let tiny = size2 < 1e-24 * shortest * shortest;
                        if lanes_valid(&trial) && (trial_cost < cost || tiny) {
                            // What is left after this step is about step (step + residual) /
                            // length: here below 1e-15 m.
                            let done = tiny || size2 * (size2 + cost) < 1e-30 * shortest * shortest;
                            if trial_cost <= cost {
                                pose = trial_pose;
                                inverse = trial;
                                cost = trial_cost;
                            }
                            if done {
                                self.check_determined(&normal, solver)?;
                                return Ok(found(pose, cost, iteration));
                            }
                            damping *= 0.1;
                            // A remaining trace of damping would make the last steps converge
                            // linearly.
                            if damping < 1e-9 {
                                damping = 0.0;
                            }
                            accepted = true;
                            break;
                        }
                    }
                }
                damping = f64::max(4.0 * damping, 1e-6);
            }
            if !accepted {
                // No further descent: a minimum to rounding, if the gradient agrees.
                let slope: f64 = (0..K).map(|k| g[k] * g[k] / scale(k)).sum();
                if slope <= 1e-20 * (cost + 1e-20) {
                    self.check_determined(&normal, solver)?;
                    return Ok(found(pose, cost, iteration));
                }
                break;
            }
        }
        Err(Error::NotConverged {
            solver,
            iterations: options.max_iterations,
            residual: sqrt(cost / N as f64),
        })
    }

    /// Refuses a pose that the lengths do not fix: nearly singular normal equations.
    fn check_determined<const K: usize>(
        &self,
        normal: &[[f64; K]; K],
        solver: Solver,
    ) -> Result<(), Error> {
        let mut m = *normal;
        for a in 0..K {
            for b in 0..=a {
                // Radians as metres at the lever, then remove the redundancy of a regular robot.
                let scale = |k: usize| if k < 3 { 1.0 } else { self.lever_m };
                m[a][b] /= scale(a) * scale(b);
            }
            m[a][a] -= 1e-9;
        }
        if cholesky(&mut m) {
            Ok(())
        } else {
            Err(Error::Singular { solver })
        }
    }
}

/// The lower half of the normal matrix, and the gradient, of the lengths' residuals at a pose.
fn normal_equations<const N: usize, const K: usize>(
    lengths_m: &[f64; N],
    inverse: &Inverse<N>,
    row: &impl Fn(&Inverse<N>, usize) -> [f64; K],
) -> ([[f64; K]; K], [f64; K]) {
    let mut normal = [[0.0; K]; K];
    let mut g = [0.0; K];
    for i in 0..N {
        let r = lengths_m[i] - inverse.lengths_m[i];
        let j = row(inverse, i);
        for a in 0..K {
            g[a] += j[a] * r;
            for b in 0..=a {
                normal[a][b] += j[a] * j[b];
            }
        }
    }
    (normal, g)
}
