//! The robot: cables, platform and their validation.

use nalgebra::{Matrix3, Vector3};

use crate::cable_vec::MAX_CABLES;
use crate::error::Error;

/// Standard acceleration of gravity, m/s^2.
/// General Conference on Weights and Measures, 1901.
pub const GRAVITY_MPS2: f64 = 9.806_65;

/// One cable: its anchor on the frame and its attachment on the platform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cable {
    /// Entry point of the cable on the swivel axis, world frame, m.
    pub anchor_m: Vector3<f64>,
    /// Direction in which the cable travels when it reaches the anchor, world frame. Any
    /// non-zero vector: [`Robot::new`] normalises it.
    pub swivel_axis: Vector3<f64>,
    /// Radius of the pulley's groove, m; 0 is a point anchor (an eyelet).
    pub pulley_radius_m: f64,
    /// Attachment on the platform, platform frame, m.
    pub attachment_m: Vector3<f64>,
}

/// The platform as a rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Platform {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass, platform frame, m.
    pub center_of_mass_m: Vector3<f64>,
    /// Inertia about the centre of mass, platform axes, kg m^2. Only the natural modes need it.
    pub inertia_kg_m2: Option<Matrix3<f64>>,
}

impl Platform {
    /// The inertia (kg m^2, about its centre, along its edges) of a homogeneous box.
    pub(crate) fn box_inertia(mass_kg: f64, size_m: Vector3<f64>) -> Matrix3<f64> {
        let s = size_m.component_mul(&size_m);
        Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.x + s.z, s.x + s.y)) * (mass_kg / 12.0)
    }
}

/// Component-wise arrays over the cables, for the vectorised loops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lanes<const N: usize> {
    pub anchor: [[f64; N]; 3],
    pub axis: [[f64; N]; 3],
    pub radius: [f64; N],
    pub attachment: [[f64; N]; 3],
}

/// A validated robot with `N` cables (1 to 16).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Robot<const N: usize> {
    cables: [Cable; N],
    platform: Platform,
    pub(crate) lanes: Lanes<N>,
    /// Root mean square of the attachments' distances from the platform's origin, at least 1 cm:
    /// the length that makes radians and metres comparable.
    pub(crate) lever_m: f64,
}

impl<const N: usize> Robot<N> {
    /// Validates and prepares a robot. Swivel axes are normalised.
    ///
    /// # Errors
    /// [`Error::CableCount`] unless 1 <= N <= 16; [`Error::InvalidCable`] for a number that is not
    /// finite, a zero axis or a negative radius; [`Error::InvalidPlatform`] for a mass that is not
    /// positive or an inertia that is not symmetric and positive definite.
    pub fn new(mut cables: [Cable; N], platform: Platform) -> Result<Self, Error> {
        if N == 0 || N > MAX_CABLES {
            return Err(Error::CableCount {
                expected: if N == 0 { 1 } else { MAX_CABLES },
                got: N,
            });
        }
        for (i, cable) in cables.iter_mut().enumerate() {
            validate_cable(cable).map_err(|(what, value)| Error::InvalidCable {
                cable: i + 1,
                what,
                value,
            })?;
        }
        validate_platform(&platform)?;
        let lanes = Lanes {
            anchor: core::array::from_fn(|k| cables.map(|c| c.anchor_m[k])),
            axis: core::array::from_fn(|k| cables.map(|c| c.swivel_axis[k])),
            radius: cables.map(|c| c.pulley_radius_m),
            attachment: core::array::from_fn(|k| cables.map(|c| c.attachment_m[k])),
        };
        // Cables that meet in the origin have no lever: 1 cm keeps moments comparable with forces.
        let sum: f64 = cables.iter().map(|c| c.attachment_m.norm_squared()).sum();
        Ok(Self {
            cables,
            platform,
            lanes,
            lever_m: crate::math::sqrt(sum / N as f64).max(0.01),
        })
    }

    /// The cables, with unit swivel axes.
    pub fn cables(&self) -> &[Cable; N] {
        &self.cables
    }

    /// The platform.
    pub fn platform(&self) -> &Platform {
        &self.platform
    }

    /// Weight of the platform, N.
    pub fn weight_n(&self) -> f64 {
        self.platform.mass_kg * GRAVITY_MPS2
    }
}

fn validate_cable(c: &mut Cable) -> Result<(), (&'static str, f64)> {
    for (v, what) in [
        (&c.anchor_m, "the anchor must be finite"),
        (&c.swivel_axis, "the swivel axis must be finite"),
        (&c.attachment_m, "the attachment must be finite"),
    ] {
        if let Some(&bad) = v.iter().find(|x| !x.is_finite()) {
            return Err((what, bad));
        }
    }
    let r = c.pulley_radius_m;
    if !(r >= 0.0 && r.is_finite()) {
        return Err(("the pulley radius must be zero or positive", r));
    }
    let norm = c.swivel_axis.norm();
    if norm < 1e-9 {
        return Err(("the swivel axis must not be zero", norm));
    }
    c.swivel_axis /= norm;
    Ok(())
}

fn validate_platform(p: &Platform) -> Result<(), Error> {
    let bad = |what, value| Err(Error::InvalidPlatform { what, value });
    if !(p.mass_kg > 0.0 && p.mass_kg.is_finite()) {
        return bad("the mass must be positive", p.mass_kg);
    }
    if let Some(&x) = p.center_of_mass_m.iter().find(|x| !x.is_finite()) {
        return bad("the centre of mass must be finite", x);
    }
    if let Some(inertia) = &p.inertia_kg_m2 {
        if let Some(&x) = inertia.iter().find(|x| !x.is_finite()) {
            return bad("the inertia must be finite", x);
        }
        let asymmetry = (inertia - inertia.transpose()).norm();
        if asymmetry > 1e-9 * inertia.norm() {
            return bad("the inertia must be symmetric", asymmetry);
        }
        if inertia.cholesky().is_none() {
            return bad(
                "the inertia must be positive definite",
                inertia.determinant(),
            );
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::four_cables;

    #[test]
    fn a_bad_cable_is_named() {
        let robot = four_cables();
        let mut cables = *robot.cables();
        cables[2].pulley_radius_m = -0.01;
        let error = Robot::new(cables, *robot.platform()).unwrap_err();
        assert!(matches!(error, Error::InvalidCable { cable: 3, .. }));
        assert!(error.to_string().starts_with("cable 3: the pulley radius"));
        let mut cables = *robot.cables();
        cables[0].swivel_axis = Vector3::zeros();
        assert!(matches!(
            Robot::new(cables, *robot.platform()),
            Err(Error::InvalidCable { cable: 1, .. })
        ));
        let mut cables = *robot.cables();
        cables[3].attachment_m.y = f64::INFINITY;
        assert!(matches!(
            Robot::new(cables, *robot.platform()),
            Err(Error::InvalidCable { cable: 4, .. })
        ));
    }

    #[test]
    fn a_bad_platform_is_refused() {
        let robot = four_cables();
        let mut platform = *robot.platform();
        platform.mass_kg = 0.0;
        assert!(Robot::new(*robot.cables(), platform).is_err());
        let mut platform = *robot.platform();
        platform.inertia_kg_m2 = Some(-Matrix3::identity());
        assert!(Robot::new(*robot.cables(), platform).is_err());
    }

    #[test]
    fn the_count_is_checked() {
        let platform = *four_cables().platform();
        assert!(Robot::<0>::new([], platform).is_err());
        let cable = four_cables().cables()[0];
        assert!(Robot::<17>::new([cable; 17], platform).is_err());
    }

    #[test]
    fn axes_are_normalised() {
        let robot = four_cables();
        let mut cables = *robot.cables();
        cables[1].swivel_axis = Vector3::new(0.0, 3.0, 4.0);
        let robot = Robot::new(cables, *robot.platform()).unwrap();
        assert!((robot.cables()[1].swivel_axis - Vector3::new(0.0, 0.6, 0.8)).norm() < 1e-15);
    }
}
