//! A robot whose number of cables is known at run time only.

use nalgebra::{Matrix3, Rotation3, Vector3, Vector6};

use crate::cable_vec::{CableVec, MAX_CABLES};
use crate::equilibrium::EquilibriumGuess;
use crate::equilibrium_state::{Equilibrium, Held, Start, StaticOptions};
use crate::error::Error;
use crate::forward::{Forward, ForwardOptions};
use crate::interference::{CablePair, CableToPlatform, PlatformBox};
use crate::inverse::CablePath;
use crate::jacobian::LengthDerivatives;
use crate::pose::{Pose, angular_velocity_from_rates};
use crate::robot::{Cable, Platform, Robot};
use crate::stability::{Linearisation, Stability, ToolSensitivity};
use crate::tension::{Goal, TensionLimits};
use crate::workspace::{Grid, Verdict, WorkspaceTest};

/// Equations that a tension distribution must satisfy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Balance {
    /// Forces only: the platform is assumed to keep its attitude (the paper's model).
    Forces,
    /// Forces and moments.
    Wrench,
}

/// [`Goal`] with a run-time number of cables.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AnyGoal<'a> {
    /// Nearest to the middle of the limits.
    Middle,
    /// Smallest sum of squares.
    MinimumNorm,
    /// Nearest to these tensions, N, one per cable.
    NearestTo(&'a [f64]),
}

/// [`WorkspaceTest`] with a run-time number of cables; limits in N, one entry per cable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AnyWorkspaceTest<'a> {
    /// As [`WorkspaceTest::Forces`] and [`WorkspaceTest::Wrench`].
    Fixed {
        /// Equations to satisfy.
        balance: Balance,
        /// World_from_platform.
        rotation: Rotation3<f64>,
        /// Lower tension limits, N.
        min_n: &'a [f64],
        /// Upper tension limits, N.
        max_n: &'a [f64],
    },
    /// As [`WorkspaceTest::Equilibrium`].
    Equilibrium {
        /// The point that is placed, platform frame, m.
        tool_in_platform_m: Vector3<f64>,
        /// `Some(T)` for tension-held cables, N.
        tensions_n: &'a [Option<f64>],
        /// Lower tension limits, N.
        min_n: &'a [f64],
        /// Upper tension limits, N.
        max_n: &'a [f64],
        /// Largest tilt, rad.
        tilt_max_rad: f64,
    },
}

impl AnyWorkspaceTest<'_> {
    fn sized<const N: usize>(&self) -> Result<WorkspaceTest<N>, Error> {
        Ok(match *self {
            AnyWorkspaceTest::Fixed {
                balance,
                rotation,
                min_n,
                max_n,
            } => {
                let limits = sized_limits(min_n, max_n)?;
                match balance {
                    Balance::Forces => WorkspaceTest::Forces { rotation, limits },
                    Balance::Wrench => WorkspaceTest::Wrench { rotation, limits },
                }
            }
            AnyWorkspaceTest::Equilibrium {
                tool_in_platform_m,
                tensions_n,
                min_n,
                max_n,
                tilt_max_rad,
            } => WorkspaceTest::Equilibrium {
                tool_in_platform_m,
                tensions_n: fixed(tensions_n)?,
                limits: sized_limits(min_n, max_n)?,
                tilt_max_rad,
            },
        })
    }
}

fn sized_limits<const N: usize>(min_n: &[f64], max_n: &[f64]) -> Result<TensionLimits<N>, Error> {
    Ok(TensionLimits {
        min_n: fixed(min_n)?,
        max_n: fixed(max_n)?,
    })
}

// One variant per number of cables: the solvers have fixed sizes, without an allocator.
macro_rules! any_robot {
    ($($variant:ident = $n:literal),*) => {
        /// A robot of 1 to 16 cables, for programs that load it from a file. Each call is one
        /// dispatch to the code of the fixed size.
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[allow(clippy::large_enum_variant)] // Without an allocator there is nowhere else to put it.
        #[non_exhaustive]
        pub enum AnyRobot {
            $(#[doc = concat!("A robot with ", stringify!($n), " cables.")] $variant(Robot<$n>),)*
        }

        impl AnyRobot {
            /// Validates and prepares a robot; the number of cables is that of the slice.
            ///
            /// # Errors
            /// As [`Robot::new`].
            pub fn new(cables: &[Cable], platform: Platform) -> Result<Self, Error> {
                match cables.len() {
                    $($n => Ok(Self::$variant(Robot::new(fixed::<Cable, $n>(cables)?, platform)?)),)*
                    got => Err(Error::CableCount {
                        expected: if got == 0 { 1 } else { MAX_CABLES },
                        got,
                    }),
                }
            }
        }

        macro_rules! dispatch {
            ($self:expr, $robot:ident => $body:expr) => {
                match $self { $(AnyRobot::$variant($robot) => $body,)* }
            };
        }
    };
}

any_robot!(
    C1 = 1,
    C2 = 2,
    C3 = 3,
    C4 = 4,
    C5 = 5,
    C6 = 6,
    C7 = 7,
    C8 = 8,
    C9 = 9,
    C10 = 10,
    C11 = 11,
    C12 = 12,
    C13 = 13,
    C14 = 14,
    C15 = 15,
    C16 = 16
);

/// A slice as an array, or the error that counts its entries.
pub(crate) fn fixed<T: Copy, const N: usize>(values: &[T]) -> Result<[T; N], Error> {
    <[T; N]>::try_from(values).map_err(|_| Error::CableCount {
        expected: N,
        got: values.len(),
    })
}

fn list<T: Copy + Default, const N: usize>(values: &[T; N]) -> CableVec<T> {
    CableVec::from_fn(N, |i| values[i])
}

impl AnyRobot {
    /// Number of cables.
    pub fn cable_count(&self) -> usize {
        self.cables().len()
    }

    /// The cables, with unit swivel axes.
    pub fn cables(&self) -> &[Cable] {
        dispatch!(self, r => r.cables())
    }

    /// The platform.
    pub fn platform(&self) -> &Platform {
        dispatch!(self, r => r.platform())
    }

    /// Weight of the platform, N.
    pub fn weight_n(&self) -> f64 {
        dispatch!(self, r => r.weight_n())
    }

    /// As [`Robot::lengths_m`].
    ///
    /// # Errors
    /// As [`Robot::inverse`].
    pub fn lengths_m(&self, pose: &Pose) -> Result<CableVec<f64>, Error> {
        dispatch!(self, r => Ok(list(&r.lengths_m(pose)?)))
    }

    /// As [`Robot::lengths_of_places`].
    pub fn lengths_of_places(
        &self,
        rotation: &Rotation3<f64>,
        places_m: impl IntoIterator<Item = Vector3<f64>>,
        out: &mut [f64],
    ) -> Option<(usize, Error)> {
        dispatch!(self, r => r.lengths_of_places(rotation, places_m, out))
    }

    /// As [`Robot::lengths_of_poses`].
    pub fn lengths_of_poses(
        &self,
        poses: impl IntoIterator<Item = Pose>,
        out: &mut [f64],
    ) -> Option<(usize, Error)> {
        dispatch!(self, r => r.lengths_of_poses(poses, out))
    }

    /// As [`Self::lengths_m`], into a slice, as many as both have: without a list between, for batches.
    ///
    /// # Errors
    /// As [`Robot::inverse`].
    #[inline]
    pub fn lengths_into(&self, pose: &Pose, out: &mut [f64]) -> Result<(), Error> {
        dispatch!(self, r => {
            for (slot, length_m) in out.iter_mut().zip(r.lengths_m(pose)?) {
                *slot = length_m;
            }
            Ok(())
        })
    }

    /// As [`Robot::paths`].
    ///
    /// # Errors
    /// As [`Robot::inverse`].
    pub fn paths(&self, pose: &Pose) -> Result<CableVec<CablePath>, Error> {
        dispatch!(self, r => Ok(list(&r.paths(pose)?)))
    }

    /// Calls `each` with every cable's number, zero-based, its path and the slopes (1/m, world) of its direction by the place
    /// of its attachment: the Hessian of its length. See [`crate::Inverse::point_hessian`].
    ///
    /// # Errors
    /// As [`Robot::inverse`]; then `each` is not called.
    pub fn each_path(
        &self,
        pose: &Pose,
        mut each: impl FnMut(usize, &CablePath, &Matrix3<f64>),
    ) -> Result<(), Error> {
        dispatch!(self, r => {
            let inverse = r.inverse(pose)?;
            for i in 0..r.cables().len() {
                each(i, &r.path_of(pose, &inverse, i), &inverse.point_hessian(r, i));
            }
            Ok(())
        })
    }

    /// Rows of the twist Jacobian, one per cable. See [`crate::Inverse::twist_jacobian`].
    ///
    /// # Errors
    /// As [`Robot::inverse`].
    pub fn twist_jacobian(&self, pose: &Pose) -> Result<CableVec<[f64; 6]>, Error> {
        dispatch!(self, r => {
            let inverse = r.inverse(pose)?;
            Ok(CableVec::from_fn(r.cables().len(), |i| inverse.twist_row(i).into()))
        })
    }

    /// Rows of the Jacobian with respect to `[x, y, z, rx, ry, rz]`, one per cable, at the attitude
    /// angles of the pose. See [`crate::Inverse::euler_jacobian`].
    ///
    /// # Errors
    /// As [`Robot::inverse`].
    pub fn euler_jacobian(&self, pose: &Pose) -> Result<CableVec<[f64; 6]>, Error> {
        let mut rows = self.twist_jacobian(pose)?;
        let e = angular_velocity_from_rates(pose.rpy());
        for row in rows.iter_mut() {
            let turning = e.tr_mul(&Vector3::new(row[3], row[4], row[5]));
            row[3..].copy_from_slice(turning.as_slice());
        }
        Ok(rows)
    }

    /// As [`Robot::length_derivatives`].
    ///
    /// # Errors
    /// As [`Robot::inverse`].
    pub fn length_derivatives(&self, pose: &Pose) -> Result<CableVec<LengthDerivatives>, Error> {
        dispatch!(self, r => Ok(list(&r.length_derivatives(pose)?)))
    }

    /// As [`Robot::geometrico_static`], one entry of `held` per cable.
    ///
    /// # Errors
    /// [`Error::CableCount`], and as [`Robot::geometrico_static`].
    pub fn geometrico_static(
        &self,
        held: &[Held],
        start: Start<'_>,
        options: &StaticOptions,
    ) -> Result<Equilibrium, Error> {
        dispatch!(self, r => r.geometrico_static(&fixed(held)?, start, options))
    }

    /// As [`Robot::equilibrium_at`], one entry of `tensions_n` per cable.
    ///
    /// # Errors
    /// [`Error::CableCount`], and as [`Robot::equilibrium_at`].
    pub fn equilibrium_at(
        &self,
        point_in_platform_m: &Vector3<f64>,
        point_in_world_m: &Vector3<f64>,
        tensions_n: &[Option<f64>],
        guess: EquilibriumGuess,
        options: &StaticOptions,
    ) -> Result<Equilibrium, Error> {
        dispatch!(self, r => r.equilibrium_at(
            point_in_platform_m, point_in_world_m, &fixed(tensions_n)?, guess, options
        ))
    }

    /// As [`Robot::linearise`].
    ///
    /// # Errors
    /// As [`Robot::linearise`].
    pub fn linearise(&self, equilibrium: &Equilibrium) -> Result<Linearisation, Error> {
        dispatch!(self, r => r.linearise(equilibrium))
    }

    /// As [`Robot::tool_sensitivity`].
    ///
    /// # Errors
    /// As [`Robot::tool_sensitivity`].
    pub fn tool_sensitivity(
        &self,
        equilibrium: &Equilibrium,
        tool_in_platform_m: &Vector3<f64>,
    ) -> Result<ToolSensitivity, Error> {
        dispatch!(self, r => r.tool_sensitivity(equilibrium, tool_in_platform_m))
    }

    /// As [`Robot::stability`].
    ///
    /// # Errors
    /// As [`Robot::stability`].
    pub fn stability(&self, equilibrium: &Equilibrium) -> Result<Stability, Error> {
        dispatch!(self, r => r.stability(equilibrium))
    }

    /// As [`Robot::position`].
    ///
    /// # Errors
    /// [`Error::CableCount`], and as [`Robot::position`].
    pub fn position(
        &self,
        lengths_m: &[f64],
        rotation: &Rotation3<f64>,
        start_m: Option<&Vector3<f64>>,
        options: &ForwardOptions,
    ) -> Result<Forward, Error> {
        dispatch!(self, r => r.position(&fixed(lengths_m)?, rotation, start_m, options))
    }

    /// As [`Robot::position_and_yaw`].
    ///
    /// # Errors
    /// [`Error::CableCount`], and as [`Robot::position_and_yaw`].
    pub fn position_and_yaw(
        &self,
        lengths_m: &[f64],
        start: &Pose,
        position_known: bool,
        options: &ForwardOptions,
    ) -> Result<Forward, Error> {
        dispatch!(self, r => r.position_and_yaw(
            &fixed(lengths_m)?, start, position_known, options
        ))
    }

    /// As [`Robot::pose`].
    ///
    /// # Errors
    /// [`Error::CableCount`], and as [`Robot::pose`].
    pub fn pose(
        &self,
        lengths_m: &[f64],
        start: &Pose,
        position_known: bool,
        options: &ForwardOptions,
    ) -> Result<Forward, Error> {
        dispatch!(self, r => r.pose(&fixed(lengths_m)?, start, position_known, options))
    }

    /// Tensions that balance gravity and an external wrench (`[force, moment]`, N, N m, world, about
    /// the platform's origin; with [`Balance::Forces`] its moment is ignored). See
    /// [`Robot::distribute`] and [`Robot::distribute_forces`].
    ///
    /// # Errors
    /// [`Error::CableCount`], and as [`Robot::distribute`].
    pub fn distribute(
        &self,
        pose: &Pose,
        external_wrench: &Vector6<f64>,
        balance: Balance,
        min_n: &[f64],
        max_n: &[f64],
        goal: AnyGoal<'_>,
    ) -> Result<CableVec<f64>, Error> {
        dispatch!(self, r => {
            let limits = sized_limits(min_n, max_n)?;
            let goal = match goal {
                AnyGoal::Middle => Goal::Middle,
                AnyGoal::MinimumNorm => Goal::MinimumNorm,
                AnyGoal::NearestTo(t) => Goal::NearestTo(fixed(t)?),
            };
            let found = match balance {
                Balance::Wrench => r.distribute(pose, external_wrench, &limits, &goal)?,
                Balance::Forces => r.distribute_forces(
                    pose, &external_wrench.fixed_rows::<3>(0).into_owned(), &limits, &goal
                )?,
            };
            Ok(list(&found.tensions_n))
        })
    }

    /// As [`Robot::assess`].
    ///
    /// # Errors
    /// [`Error::CableCount`], and as [`Robot::assess`].
    pub fn assess(
        &self,
        position_m: &Vector3<f64>,
        test: &AnyWorkspaceTest<'_>,
    ) -> Result<Verdict, Error> {
        dispatch!(self, r => r.assess(position_m, &test.sized()?))
    }

    /// As [`Robot::assess_range`].
    ///
    /// # Errors
    /// [`Error::CableCount`], and as [`Robot::assess_range`].
    pub fn assess_range(
        &self,
        grid: &Grid,
        test: &AnyWorkspaceTest<'_>,
        first: usize,
        out: &mut [Verdict],
    ) -> Result<(), Error> {
        dispatch!(self, r => r.assess_range(grid, &test.sized()?, first, out))
    }

    /// As [`Robot::workspace`].
    ///
    /// # Errors
    /// [`Error::CableCount`], and as [`Robot::workspace`].
    #[cfg(feature = "std")]
    pub fn workspace(
        &self,
        grid: &Grid,
        test: &AnyWorkspaceTest<'_>,
    ) -> Result<Vec<Verdict>, Error> {
        dispatch!(self, r => r.workspace(grid, &test.sized()?))
    }

    /// As [`Robot::workspace_parallel`].
    ///
    /// # Errors
    /// [`Error::CableCount`], and as [`Robot::workspace_parallel`].
    #[cfg(feature = "rayon")]
    pub fn workspace_parallel(
        &self,
        grid: &Grid,
        test: &AnyWorkspaceTest<'_>,
    ) -> Result<Vec<Verdict>, Error> {
        dispatch!(self, r => r.workspace_parallel(grid, &test.sized()?))
    }

    /// As [`Robot::closest_cables`].
    ///
    /// # Errors
    /// As [`Robot::inverse`].
    pub fn closest_cables(&self, pose: &Pose) -> Result<Option<CablePair>, Error> {
        dispatch!(self, r => r.closest_cables(pose))
    }

    /// As [`Robot::closest_to_platform`].
    ///
    /// # Errors
    /// As [`Robot::closest_to_platform`].
    pub fn closest_to_platform(
        &self,
        pose: &Pose,
        body: &PlatformBox,
        stub_m: f64,
    ) -> Result<CableToPlatform, Error> {
        dispatch!(self, r => r.closest_to_platform(pose, body, stub_m))
    }
}
