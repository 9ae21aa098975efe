//! A robot whose number of cables is known at run time only.

use nalgebra::Vector3;

use crate::cable_vec::{CableVec, MAX_CABLES};
use crate::equilibrium::EquilibriumGuess;
use crate::error::Error;
use crate::geometrico_static::{Equilibrium, Held, Start, StaticOptions};
use crate::inverse::CablePath;
use crate::jacobian::LengthDerivatives;
use crate::pose::{Pose, angular_velocity_from_rates};
use crate::robot::{Cable, Platform, Robot};
use crate::stability::{Linearisation, Stability, ToolSensitivity};

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

    /// As [`Robot::paths`].
    ///
    /// # Errors
    /// As [`Robot::inverse`].
    pub fn paths(&self, pose: &Pose) -> Result<CableVec<CablePath>, Error> {
        dispatch!(self, r => Ok(list(&r.paths(pose)?)))
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
}
