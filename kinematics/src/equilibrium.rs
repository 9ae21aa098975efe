//! The inverse problem of an under-constrained robot: the resting pose of the platform for a given
//! tool position.
//!
//! Given the position of a platform point and the tensions of all but three cables, the six
//! equations of equilibrium fix the attitude and the other three tensions; lengths follow. The
//! forces are linear in those three tensions, which leaves three moment equations in the attitude
//! for Newton's method (analytic derivative, damped, with continuation from the middle of the
//! robot when the direct attempt fails).

use nalgebra::{Matrix3, Rotation3, Vector3};

use crate::cable_vec::{CableSet, CableVec};
use crate::equilibrium_state::{Equilibrium, StaticOptions};
use crate::error::{Error, Solver};
use crate::inverse::Inverse;
use crate::pose::Pose;
use crate::robot::{Platform, Robot};

/// Where the equilibrium solver starts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum EquilibriumGuess {
    /// Level, with continuation if that fails.
    #[default]
    Cold,
    /// From this attitude (that of a neighbouring equilibrium), with the cold start as a fallback.
    Attitude(Rotation3<f64>),
}

struct Hanging<const N: usize> {
    rotation: Rotation3<f64>,
    inverse: Inverse<N>,
    tensions: [f64; N],
    moment: Vector3<f64>,
    iterations: usize,
}

impl<const N: usize> Robot<N> {
    /// Equilibrium with a platform point at a given place.
    ///
    /// `point_in_platform_m` is the point (zero for the platform's origin, the TCP for the tool),
    /// `point_in_world_m` its required position. `tensions_n[i]` is `Some(T)` for a tension-held
    /// cable and `None` for a length-held one; exactly three cables must be length-held (for four
    /// cables: one tension is given). Robots with more length-held cables choose their attitude and
    /// use [`Robot::distribute`] instead.
    ///
    /// The answer may be unstable: see [`Equilibrium::stable`].
    /// Frame: world. Units: m, N.
    ///
    /// # Errors
    /// [`Error::InvalidInput`]; [`Error::TooFewCables`] unless three are length-held;
    /// [`Error::NegativeTension`] naming the cable that would have to push;
    /// [`Error::Singular`]; [`Error::NotConverged`]; domain errors of [`Robot::inverse`].
    ///
    /// ```
    /// use mcdpr_kinematics::{EquilibriumGuess, four_cables};
    /// use nalgebra::Vector3;
    /// let robot = four_cables();
    /// let hang = robot.equilibrium_at(
    ///     &Vector3::zeros(),
    ///     &Vector3::new(0.3, 0.0, -0.1),
    ///     &[None, None, None, Some(10.0)],
    ///     EquilibriumGuess::Cold,
    ///     &Default::default(),
    /// )?;
    /// assert!(hang.stable && hang.tensions_n.iter().all(|t| *t > 0.0));
    /// # Ok::<(), mcdpr_kinematics::Error>(())
    /// ```
    pub fn equilibrium_at(
        &self,
        point_in_platform_m: &Vector3<f64>,
        point_in_world_m: &Vector3<f64>,
        tensions_n: &[Option<f64>; N],
        guess: EquilibriumGuess,
        options: &StaticOptions,
    ) -> Result<Equilibrium, Error> {
        for (what, v) in [
            ("the tool point must be finite", point_in_platform_m),
            ("the position must be finite", point_in_world_m),
        ] {
            if let Some(&value) = v.iter().find(|x| !x.is_finite()) {
                return Err(Error::InvalidInput {
                    what,
                    cable: None,
                    value,
                });
            }
        }
        let free = free_cables(tensions_n)?;
        let shifted = self.about(point_in_platform_m)?;
        let solve = |at: &Vector3<f64>, from: Rotation3<f64>| {
            shifted.hang(at, tensions_n, &free, from, options)
        };
        let direct = match guess {
            EquilibriumGuess::Attitude(rotation) => {
                Pose::new(*point_in_world_m, rotation).check()?;
                solve(point_in_world_m, rotation)
                    .or_else(|_| solve(point_in_world_m, Rotation3::identity()))
            }
            EquilibriumGuess::Cold => solve(point_in_world_m, Rotation3::identity()),
        };
        let hanging = match direct {
            Ok(hanging) => hanging,
            // An invalid position stays invalid along the way.
            Err(error @ (Error::InsidePulley { .. } | Error::OnSwivelAxis { .. })) => {
                return Err(error);
            }
            Err(error) => shifted
                .continued(point_in_world_m, tensions_n, &free, options)
                .ok_or(error)?,
        };
        for i in 0..N {
            // The balance of forces is linear and lets a cable push: only here that becomes an
            // error.
            let tension_n = hanging.tensions[i];
            if tension_n < 0.0 {
                return Err(Error::NegativeTension {
                    cable: i + 1,
                    tension_n,
                });
            }
        }
        self.verified(point_in_platform_m, point_in_world_m, tensions_n, &hanging)
    }

    fn verified(
        &self,
        point_in_platform_m: &Vector3<f64>,
        point_in_world_m: &Vector3<f64>,
        tensions_n: &[Option<f64>; N],
        hanging: &Hanging<N>,
    ) -> Result<Equilibrium, Error> {
        let pose = Pose::new(
            point_in_world_m - hanging.rotation * point_in_platform_m,
            hanging.rotation,
        );
        let inverse = self.inverse(&pose)?;
        let residual_n = self.wrench_norm(&self.gradient(&pose, &inverse, &hanging.tensions));
        let mut out = Equilibrium {
            pose,
            tensions_n: CableVec::from_fn(N, |i| hanging.tensions[i]),
            lengths_m: CableVec::from_fn(N, |i| inverse.lengths_m[i]),
            slack: CableSet::default(),
            tension_held: CableSet::default(),
            axial_stiffness_n_per_m: CableVec::filled(N),
            residual_n,
            residual_m: 0.0,
            iterations: hanging.iterations,
            stable: false,
        };
        for (i, t) in tensions_n.iter().enumerate() {
            if t.is_some() {
                out.tension_held.insert(i);
            }
        }
        out.stable = self.is_minimum(&out, &inverse);
        // The moments were balanced about the tool; about the origin they must be, too.
        if residual_n > 1e-8 * self.weight_n() {
            return Err(Error::NotConverged {
                solver: Solver::Equilibrium,
                iterations: hanging.iterations,
                residual: residual_n,
            });
        }
        Ok(out)
    }

    /// The same robot with its platform frame moved to a platform point.
    pub(crate) fn about(&self, point_in_platform_m: &Vector3<f64>) -> Result<Self, Error> {
        let mut cables = *self.cables();
        for c in &mut cables {
            c.attachment_m -= point_in_platform_m;
        }
        let platform = Platform {
            center_of_mass_m: self.platform().center_of_mass_m - point_in_platform_m,
            ..*self.platform()
        };
        Robot::new(cables, platform)
    }

    /// Newton's method on the moments at a fixed position of the origin.
    fn hang(
        &self,
        at: &Vector3<f64>,
        given: &[Option<f64>; N],
        free: &[usize; 3],
        from: Rotation3<f64>,
        options: &StaticOptions,
    ) -> Result<Hanging<N>, Error> {
        // N m: the tolerance of a force, at the lever.
        let tolerance = options.force_tolerance * self.weight_n() * self.lever_m;
        let mut now = self.balance_forces(&Pose::new(*at, from), given, free)?;
        let mut best = now.moment.norm();
        let mut converged = 0;
        for iteration in 0..40 {
            if best <= tolerance {
                converged += 1;
                // One more step costs little and brings the attitude to rounding level.
                if converged == 2 {
                    return Ok(now);
                }
            }
            let phi = self.moment_step(at, &now, free)?;
            // 0.35 rad (20 degrees) at most: further away the linearised moments mean little.
            let mut step = (0.35 / phi.norm()).min(1.0);
            let mut moved = false;
            for _ in 0..12 {
                let pose = Pose::new(*at, now.rotation).displaced(&Vector3::zeros(), &(phi * step));
                if let Ok(mut trial) = self.balance_forces(&pose, given, free) {
                    let size = trial.moment.norm();
                    // Within the tolerance only rounding is left, and rounding need not decrease.
                    if size < best * (1.0 - 0.1 * step) || (best <= tolerance && size <= tolerance)
                    {
                        trial.iterations = iteration + 1;
                        now = trial;
                        best = size;
                        moved = true;
                        break;
                    }
                }
                step *= 0.5;
            }
            if !moved {
                // Rounding stopped the search: 50 tolerances are 1e-9 of the weight by default, and
                // `verified` accepts 1e-8.
                if best <= tolerance * 50.0 {
                    return Ok(now);
                }
                break;
            }
        }
        Err(Error::NotConverged {
            solver: Solver::Equilibrium,
            iterations: now.iterations,
            residual: best / self.lever_m,
        })
    }

    /// The three free tensions from the force balance, and the remaining moment.
    fn balance_forces(
        &self,
        pose: &Pose,
        given: &[Option<f64>; N],
        free: &[usize; 3],
    ) -> Result<Hanging<N>, Error> {
        let inverse = self.inverse(pose)?;
        let mut tensions = [0.0; N];
        let mut load = Vector3::z() * -self.weight_n();
        for i in 0..N {
            if let Some(t) = given[i] {
                tensions[i] = t;
                load -= inverse.direction(i) * t;
            }
        }
        // Three cables in one plane balance no load across it.
        let solved = directions(&inverse, free)
            .try_inverse()
            .map(|m| m * load)
            .filter(|s| s.iter().all(|x| x.is_finite()))
            .ok_or(Error::Singular {
                solver: Solver::Equilibrium,
            })?;
        for (k, &i) in free.iter().enumerate() {
            tensions[i] = solved[k];
        }
        let g = self.gradient(pose, &inverse, &tensions);
        Ok(Hanging {
            rotation: pose.rotation,
            inverse,
            tensions,
            moment: Vector3::new(g[3], g[4], g[5]),
            iterations: 0,
        })
    }

    /// Rotation that cancels the moment to first order, the free tensions following.
    fn moment_step(
        &self,
        at: &Vector3<f64>,
        now: &Hanging<N>,
        free: &[usize; 3],
    ) -> Result<Vector3<f64>, Error> {
        let pose = Pose::new(*at, now.rotation);
        let h = self.hessian(&pose, &now.inverse, &now.tensions, &[0.0; N]);
        // Lower triangle: rows 3..6 hold the rotation block and its coupling to translations.
        let turning = Matrix3::from_fn(|i, j| h[3 + i.max(j)][3 + i.min(j)]);
        let coupling = Matrix3::from_fn(|i, j| h[3 + j][i]);
        let levers = Matrix3::from_fn(|i, k| now.inverse.twist_row(free[k])[3 + i]);
        let singular = Error::Singular {
            solver: Solver::Equilibrium,
        };
        let inverse = directions(&now.inverse, free)
            .try_inverse()
            .ok_or(singular)?;
        // Schur complement: the three free tensions follow the rotation, so that forces stay
        // balanced.
        let jacobian = turning - levers * inverse * coupling;
        let phi = jacobian.try_inverse().ok_or(singular)? * -now.moment;
        if phi.iter().all(|x| x.is_finite()) {
            Ok(phi)
        } else {
            Err(singular)
        }
    }

    /// Walks from below the middle of the anchors to the target, halving the steps that fail.
    fn continued(
        &self,
        target: &Vector3<f64>,
        given: &[Option<f64>; N],
        free: &[usize; 3],
        options: &StaticOptions,
    ) -> Option<Hanging<N>> {
        let n = N as f64;
        let mut middle = self
            .cables()
            .iter()
            .map(|c| c.anchor_m)
            .sum::<Vector3<f64>>()
            / n;
        // Level cables cannot carry the weight: the walk begins clearly below the anchors.
        let highest = middle.z - 0.2 * (self.cables()[0].anchor_m - middle).norm();
        middle.z = target.z.min(highest);
        let mut now = self
            .hang(&middle, given, free, Rotation3::identity(), options)
            .ok()?;
        let (mut done, mut step) = (0.0, 0.25);
        let mut iterations = now.iterations;
        while done < 1.0 {
            let next = f64::min(done + step, 1.0);
            let at = middle + (target - middle) * next;
            match self.hang(&at, given, free, now.rotation, options) {
                Ok(hanging) => {
                    iterations += hanging.iterations;
                    now = hanging;
                    done = next;
                    step *= 1.5;
                }
                Err(_) => {
                    step *= 0.5;
                    // The equilibria end before the target: smaller steps would only come closer to
                    // that end.
                    if step < 1e-3 {
                        return None;
                    }
                }
            }
        }
        now.iterations = iterations;
        Some(now)
    }
}

fn directions<const N: usize>(inverse: &Inverse<N>, free: &[usize; 3]) -> Matrix3<f64> {
    Matrix3::from_columns(&free.map(|i| inverse.direction(i)))
}

fn free_cables<const N: usize>(given: &[Option<f64>; N]) -> Result<[usize; 3], Error> {
    let mut free = [0; 3];
    let mut count = 0;
    for (i, t) in given.iter().enumerate() {
        match *t {
            Some(t) if !(t >= 0.0 && t.is_finite()) => {
                return Err(Error::InvalidInput {
                    what: "the held tension must be zero or positive",
                    cable: Some(i + 1),
                    value: t,
                });
            }
            Some(_) => {}
            None => {
                if count < 3 {
                    free[count] = i;
                }
                count += 1;
            }
        }
    }
    if count < 3 {
        return Err(Error::TooFewCables {
            solver: Solver::Equilibrium,
            needed: 3,
            got: count,
        });
    }
    if count > 3 {
        return Err(Error::InvalidInput {
            what: "exactly three cables may be length-held here: give the other tensions",
            cable: None,
            value: count as f64,
        });
    }
    Ok(free)
}
