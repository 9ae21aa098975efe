//! Feasible sets on a grid of positions, with the cable that limits each position.

use nalgebra::{Rotation3, Vector3};

use crate::equilibrium::EquilibriumGuess;
use crate::equilibrium_state::StaticOptions;
use crate::error::{Bound, Error};
use crate::pose::Pose;
use crate::robot::Robot;
use crate::tension::{End, Goal, TensionLimits, limiting};

/// A box of positions, ends included; x runs fastest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Lowest corner, world, m.
    pub min_m: Vector3<f64>,
    /// Highest corner, world, m.
    pub max_m: Vector3<f64>,
    /// Number of points along x, y, z; 1 puts the points at the lowest value.
    pub counts: [usize; 3],
}

impl Grid {
    /// A horizontal slice at one height.
    pub fn slice(min_m: [f64; 2], max_m: [f64; 2], z_m: f64, counts: [usize; 2]) -> Self {
        Self {
            min_m: Vector3::new(min_m[0], min_m[1], z_m),
            max_m: Vector3::new(max_m[0], max_m[1], z_m),
            counts: [counts[0], counts[1], 1],
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.counts.iter().product()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Position of a point, world, m; indices beyond the last continue the pattern upwards.
    pub fn point_m(&self, index: usize) -> Vector3<f64> {
        let [nx, ny, _] = self.counts.map(|n| n.max(1));
        let at = [index % nx, index / nx % ny, index / nx / ny];
        Vector3::from_fn(|k, _| self.min_m[k] + self.step(k) * at[k] as f64)
    }

    fn step(&self, axis: usize) -> f64 {
        match self.counts[axis] {
            0 | 1 => 0.0,
            n => (self.max_m[axis] - self.min_m[axis]) / (n - 1) as f64,
        }
    }
}

/// Criterion for a feasible position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WorkspaceTest<const N: usize> {
    /// Tensions within limits balance gravity's force at a fixed attitude; moments are ignored (the
    /// paper's level platform). The position is the platform's origin.
    Forces {
        /// World_from_platform.
        rotation: Rotation3<f64>,
        /// Tension limits.
        limits: TensionLimits<N>,
    },
    /// Tensions within limits balance gravity's force and moment at a fixed attitude (wrench-feasible
    /// workspace, six equations). The position is the platform's origin.
    Wrench {
        /// World_from_platform.
        rotation: Rotation3<f64>,
        /// Tension limits.
        limits: TensionLimits<N>,
    },
    /// A stable equilibrium exists with the tool there, three cables length-held, the others at the
    /// given tensions, all tensions within limits and the tilt within its limit.
    Equilibrium {
        /// The point that is placed, platform frame, m.
        tool_in_platform_m: Vector3<f64>,
        /// `Some(T)` for tension-held cables, N.
        tensions_n: [Option<f64>; N],
        /// Tension limits.
        limits: TensionLimits<N>,
        /// Largest angle between the platform's z axis and the world's, rad.
        tilt_max_rad: f64,
    },
}

/// Result at a position.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Verdict {
    /// It is in the workspace.
    Feasible,
    /// A cable (1-based) would have to exceed its limit; for an equilibrium, the one that exceeds
    /// it most.
    Limited {
        /// Cable number, from 1.
        cable: u8,
        /// Which limit.
        bound: Bound,
    },
    /// The cable (1-based) has no taut path (inside a pulley, on a swivel axis).
    NoPath {
        /// Cable number, from 1.
        cable: u8,
    },
    /// The platform would tilt too far.
    Tilted,
    /// The equilibrium is unstable.
    Unstable,
    /// No equilibrium or no balance with any tensions.
    #[default]
    Unbalanced,
}

impl Verdict {
    /// Whether the position is in the workspace.
    pub fn is_feasible(self) -> bool {
        self == Verdict::Feasible
    }

    /// The limiting cable (1-based), if there is one.
    pub fn limiting_cable(self) -> Option<usize> {
        match self {
            Verdict::Limited { cable, .. } | Verdict::NoPath { cable } => Some(usize::from(cable)),
            _ => None,
        }
    }

    fn of_error(error: &Error) -> Self {
        let number = |cable: usize| cable.min(16) as u8;
        match *error {
            Error::OutsideTensionLimits { cable, bound, .. } => Verdict::Limited {
                cable: number(cable),
                bound,
            },
            Error::NegativeTension { cable, .. } => Verdict::Limited {
                cable: number(cable),
                bound: Bound::Minimum,
            },
            Error::InsidePulley { cable, .. } | Error::OnSwivelAxis { cable } => Verdict::NoPath {
                cable: number(cable),
            },
            _ => Verdict::Unbalanced,
        }
    }
}

/// Positions tested side by side in the vectorised test.
/// Eight `f64` fill one register of AVX-512, or two of AVX2.
const LANES: usize = 8;

impl<const N: usize> Robot<N> {
    /// Tests one position (world, m).
    ///
    /// # Errors
    /// [`Error::InvalidInput`] for invalid limits or a position that is not finite.
    pub fn assess(
        &self,
        position_m: &Vector3<f64>,
        test: &WorkspaceTest<N>,
    ) -> Result<Verdict, Error> {
        check_test(test)?;
        Pose::level(*position_m).check()?;
        Ok(self.assess_checked(position_m, test))
    }

    /// Tests the grid's points `first..first + out.len()`, in order, on this thread.
    ///
    /// # Errors
    /// As [`Robot::assess`].
    pub fn assess_range(
        &self,
        grid: &Grid,
        test: &WorkspaceTest<N>,
        first: usize,
        out: &mut [Verdict],
    ) -> Result<(), Error> {
        check_test(test)?;
        Pose::level(grid.min_m).check()?;
        Pose::level(grid.max_m).check()?;
        match test {
            WorkspaceTest::Forces { rotation, limits } if N == 4 => {
                self.forces_in_lanes(grid, rotation, limits, first, out);
            }
            _ => {
                for (k, verdict) in out.iter_mut().enumerate() {
                    *verdict = self.assess_checked(&grid.point_m(first + k), test);
                }
            }
        }
        Ok(())
    }

    /// Tests a whole grid: one verdict per point, x fastest.
    ///
    /// # Errors
    /// As [`Robot::assess`].
    #[cfg(feature = "std")]
    pub fn workspace(&self, grid: &Grid, test: &WorkspaceTest<N>) -> Result<Vec<Verdict>, Error> {
        let mut out = vec![Verdict::default(); grid.len()];
        self.assess_range(grid, test, 0, &mut out)?;
        Ok(out)
    }

    /// As [`Robot::workspace`], on all cores; the same verdicts in the same order.
    ///
    /// # Errors
    /// As [`Robot::assess`].
    #[cfg(feature = "rayon")]
    pub fn workspace_parallel(
        &self,
        grid: &Grid,
        test: &WorkspaceTest<N>,
    ) -> Result<Vec<Verdict>, Error> {
        use rayon::prelude::*;
        const CHUNK: usize = 4096;
        let mut out = vec![Verdict::default(); grid.len()];
        out.par_chunks_mut(CHUNK)
            .enumerate()
            .try_for_each(|(k, part)| self.assess_range(grid, test, k * CHUNK, part))?;
        Ok(out)
    }

    fn assess_checked(&self, position_m: &Vector3<f64>, test: &WorkspaceTest<N>) -> Verdict {
        let tried = match test {
            // Only the existence of tensions counts, so any goal would do: the middle is far from
            // the limits.
            WorkspaceTest::Forces { rotation, limits } => self
                .distribute_forces(
                    &Pose::new(*position_m, *rotation),
                    &Vector3::zeros(),
                    limits,
                    &Goal::Middle,
                )
                .map(|_| Verdict::Feasible),
            WorkspaceTest::Wrench { rotation, limits } => self
                .distribute(
                    &Pose::new(*position_m, *rotation),
                    &nalgebra::Vector6::zeros(),
                    limits,
                    &Goal::Middle,
                )
                .map(|_| Verdict::Feasible),
            WorkspaceTest::Equilibrium {
                tool_in_platform_m,
                tensions_n,
                limits,
                tilt_max_rad,
            } => self
                .equilibrium_at(
                    tool_in_platform_m,
                    position_m,
                    tensions_n,
                    // From a neighbour the verdict would depend on the order of the grid.
                    EquilibriumGuess::Cold,
                    &StaticOptions::default(),
                )
                .map(|eq| {
                    let mut worst = (0.0, Verdict::Feasible);
                    for i in 0..N {
                        for (excess, bound) in [
                            (limits.min_n[i] - eq.tensions_n[i], Bound::Minimum),
                            (eq.tensions_n[i] - limits.max_n[i], Bound::Maximum),
                        ] {
                            if excess > worst.0 {
                                let cable = i as u8 + 1;
                                worst = (excess, Verdict::Limited { cable, bound });
                            }
                        }
                    }
                    if worst.0 > 0.0 {
                        worst.1
                    } else if !eq.stable {
                        Verdict::Unstable
                    } else if eq.pose.tilt_rad() > *tilt_max_rad {
                        Verdict::Tilted
                    } else {
                        Verdict::Feasible
                    }
                }),
        };
        tried.unwrap_or_else(|error| Verdict::of_error(&error))
    }

    /// The force test of four cables, several positions at a time. The fourth cable's tension is
    /// the parameter of the line of balanced tensions.
    fn forces_in_lanes(
        &self,
        grid: &Grid,
        rotation: &Rotation3<f64>,
        limits: &TensionLimits<N>,
        first: usize,
        out: &mut [Verdict],
    ) {
        // Attachment minus anchor: only the position changes from point to point.
        let offsets: [Vector3<f64>; N] = self
            .cables()
            .map(|c| rotation * c.attachment_m - c.anchor_m);
        let weight = self.weight_n();
        let mut index = first;
        for part in out.chunks_mut(LANES) {
            let mut p = [[0.0; LANES]; 3];
            let nx = grid.counts[0].max(1);
            // All lanes in one row of the grid: x alone changes, and no index is divided per lane.
            if index % nx + LANES <= nx {
                let base = grid.point_m(index);
                let (start, step) = ((index % nx) as f64, grid.step(0));
                for l in 0..LANES {
                    p[0][l] = grid.min_m.x + step * (start + l as f64);
                    p[1][l] = base.y;
                    p[2][l] = base.z;
                }
            } else {
                for l in 0..LANES {
                    // Beyond the last point of the part: repeat it.
                    let at = grid.point_m(index + l.min(part.len() - 1));
                    for k in 0..3 {
                        p[k][l] = at[k];
                    }
                }
            }
            let lanes = self.force_lanes(&p, &offsets, limits, weight);
            for (l, verdict) in part.iter_mut().enumerate() {
                *verdict = if lanes.width[l] >= 0.0 {
                    Verdict::Feasible
                } else if lanes.width[l] < 0.0 {
                    let (low, high) = (lanes.low_cable[l], lanes.high_cable[l]);
                    let null: [f64; N] = core::array::from_fn(|i| lanes.null[i % 4][l]);
                    let end = |at, cable| End {
                        at,
                        cable: cable as usize % N,
                    };
                    let worst = limiting(end(-lanes.width[l], low), end(0.0, high), &null);
                    Verdict::Limited {
                        cable: worst.cable as u8 + 1,
                        bound: if worst.toward * null[worst.cable] > 0.0 {
                            Bound::Minimum
                        } else {
                            Bound::Maximum
                        },
                    }
                } else {
                    // NaN: outside the domain, or the first three cables in one plane.
                    let at = grid.point_m(index + l);
                    let test = WorkspaceTest::Forces {
                        rotation: *rotation,
                        limits: *limits,
                    };
                    self.assess_checked(&at, &test)
                };
            }
            index += part.len();
        }
    }

    #[inline(always)]
    fn force_lanes(
        &self,
        p: &[[f64; LANES]; 3],
        offsets: &[Vector3<f64>; N],
        limits: &TensionLimits<N>,
        weight: f64,
    ) -> ForceLanes {
        // Directions from the platform to the frame, per cable and component.
        let mut c = [[[0.0; LANES]; 3]; 4];
        for (i, cable) in self.cables().iter().enumerate().take(4) {
            let (o, a, r) = (&offsets[i], &cable.swivel_axis, cable.pulley_radius_m);
            for l in 0..LANES {
                let (dx, dy, dz) = (p[0][l] + o.x, p[1][l] + o.y, p[2][l] + o.z);
                let h = dx * a.x + dy * a.y + dz * a.z;
                let (ex, ey, ez) = (dx - h * a.x, dy - h * a.y, dz - h * a.z);
                let rho = crate::math::sqrt(ex * ex + ey * ey + ez * ez);
                let x = rho - r;
                let s = crate::math::sqrt(rho * (rho - 2.0 * r) + h * h);
                let inv = -1.0 / ((x * x + h * h) * rho);
                let sin = (s * x + r * h) * inv;
                let cos = (s * h - r * x) * rho * inv;
                c[i][0][l] = sin * ex + cos * a.x;
                c[i][1][l] = sin * ey + cos * a.y;
                c[i][2][l] = sin * ez + cos * a.z;
            }
        }
        let mut out = ForceLanes {
            width: [0.0; LANES],
            low_cable: [0.0; LANES],
            high_cable: [0.0; LANES],
            null: [[0.0; LANES]; 4],
        };
        for l in 0..LANES {
            let v = |i: usize| [c[i][0][l], c[i][1][l], c[i][2][l]];
            let (c0, c1, c2, c3) = (v(0), v(1), v(2), v(3));
            let (c01, c12, c20) = (cross(c0, c1), cross(c1, c2), cross(c2, c0));
            let det = dot(c2, c01);
            // NaN for a plane of directions sends the lane to the scalar test.
            let det = if det.abs() > 1e-9 { det } else { f64::NAN };
            let inv = 1.0 / det;
            // Cramer's rule for the first three cables; the load has a z component only.
            let base = [
                weight * c12[2] * inv,
                weight * c20[2] * inv,
                weight * c01[2] * inv,
            ];
            // Change of the first three tensions per newton in the fourth.
            let null = [
                -dot(c3, c12) * inv,
                -dot(c3, c20) * inv,
                -dot(c3, c01) * inv,
                1.0,
            ];
            let (mut low, mut high) = (limits.min_n[3 % N], limits.max_n[3 % N]);
            let (mut low_cable, mut high_cable) = (3.0, 3.0);
            for i in 0..3 {
                let inv = 1.0 / (null[i] + 1e-280);
                let a = (limits.min_n[i % N] - base[i]) * inv;
                let b = (limits.max_n[i % N] - base[i]) * inv;
                let (a, b) = if a < b { (a, b) } else { (b, a) };
                // As a number like the others: all lanes stay in one kind of register.
                let number = i as f64;
                low_cable = if a > low { number } else { low_cable };
                low = if a > low { a } else { low };
                high_cable = if b < high { number } else { high_cable };
                high = if b < high { b } else { high };
            }
            // NaN anywhere must survive the comparisons above.
            out.width[l] = high - low + 0.0 * (base[0] + base[1] + base[2] + null[0]);
            out.low_cable[l] = low_cable;
            out.high_cable[l] = high_cable;
            for i in 0..4 {
                out.null[i][l] = null[i];
            }
        }
        out
    }
}

struct ForceLanes {
    width: [f64; LANES],
    low_cable: [f64; LANES],
    high_cable: [f64; LANES],
    null: [[f64; LANES]; 4],
}

#[inline(always)]
fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

#[inline(always)]
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn check_test<const N: usize>(test: &WorkspaceTest<N>) -> Result<(), Error> {
    let (limits, number) = match test {
        WorkspaceTest::Forces { rotation, limits } | WorkspaceTest::Wrench { rotation, limits } => {
            (limits, rotation.matrix().sum())
        }
        WorkspaceTest::Equilibrium {
            limits,
            tilt_max_rad,
            tool_in_platform_m,
            ..
        } => (limits, tilt_max_rad + tool_in_platform_m.sum()),
    };
    limits.check()?;
    if number.is_finite() {
        Ok(())
    } else {
        Err(Error::InvalidInput {
            what: "attitude, tool and tilt limit must be finite",
            cable: None,
            value: number,
        })
    }
}
