//! First and second derivatives of the potential energy W z_com + sum of tension times length.
//!
//! Coordinates are the displacement `[dp, phi]` of [`Pose::displaced`]. The gradient is minus the
//! wrench on the platform (about its origin), so its zero is equilibrium.

use nalgebra::Vector3;

use crate::inverse::Inverse;
use crate::jacobian::lifted;
use crate::pose::Pose;
use crate::robot::Robot;

pub(crate) type Gradient = [f64; 6];
/// Only the lower triangle is filled.
pub(crate) type Hessian = [[f64; 6]; 6];

impl<const N: usize> Robot<N> {
    /// Height of the centre of mass times the weight, J.
    #[inline(always)]
    pub(crate) fn gravity_energy(&self, pose: &Pose) -> f64 {
        self.weight_n() * pose.transform(&self.platform().center_of_mass_m).z
    }

    /// Gradient of gravity and of the given tensions.
    #[inline(always)]
    pub(crate) fn gradient(
        &self,
        pose: &Pose,
        inverse: &Inverse<N>,
        tensions: &[f64; N],
    ) -> Gradient {
        let w = self.weight_n();
        let c = pose.rotation * self.platform().center_of_mass_m;
        // A rotation phi moves the centre of mass by phi x c: its height changes by phi_x c_y -
        // phi_y c_x.
        let mut g = [0.0, 0.0, w, w * c.y, -w * c.x, 0.0];
        let (t, u) = (&inverse.directions, &inverse.arms_m);
        for i in 0..N {
            let s = tensions[i];
            let f = [s * t[0][i], s * t[1][i], s * t[2][i]];
            g[0] += f[0];
            g[1] += f[1];
            g[2] += f[2];
            g[3] += u[1][i] * f[2] - u[2][i] * f[1];
            g[4] += u[2][i] * f[0] - u[0][i] * f[2];
            g[5] += u[0][i] * f[1] - u[1][i] * f[0];
        }
        g
    }

    /// Hessian of gravity and of cables with the given tensions, plus `stiffness` J^T J.
    #[inline(always)]
    pub(crate) fn hessian(
        &self,
        pose: &Pose,
        inverse: &Inverse<N>,
        tensions: &[f64; N],
        stiffness: &[f64; N],
    ) -> Hessian {
        let mut h = [[0.0; 6]; 6];
        let c = pose.rotation * self.platform().center_of_mass_m;
        add_turning(&mut h, &Vector3::z(), &c, self.weight_n());
        for i in 0..N {
            let (sigma, k) = (tensions[i], stiffness[i]);
            let u = inverse.arm_m(i);
            let t = inverse.direction(i);
            // Without tension a cable's curvature has no effect: its frame is not computed.
            if sigma != 0.0 {
                let f = inverse.frame(self, i);
                add_square(&mut h, &lifted(&f.n, &u).data.0[0], sigma * f.n_curvature);
                add_square(&mut h, &lifted(&f.b, &u).data.0[0], sigma * f.b_curvature);
                add_turning(&mut h, &t, &u, sigma);
            }
            if k != 0.0 {
                add_square(&mut h, &lifted(&t, &u).data.0[0], k);
            }
        }
        h
    }
}

#[inline(always)]
fn add_square(h: &mut Hessian, v: &[f64; 6], weight: f64) {
    for i in 0..6 {
        let w = weight * v[i];
        for j in 0..=i {
            h[i][j] += w * v[j];
        }
    }
}

/// Second-order effect of a rotation on the force `weight * t` at the arm u:
/// (t u^T + u t^T)/2 - (t.u) I.
#[inline(always)]
fn add_turning(h: &mut Hessian, t: &Vector3<f64>, u: &Vector3<f64>, weight: f64) {
    let dot = t.dot(u);
    for i in 0..3 {
        for j in 0..i {
            h[3 + i][3 + j] += 0.5 * weight * (t[i] * u[j] + u[i] * t[j]);
        }
        h[3 + i][3 + i] += weight * (t[i] * u[i] - dot);
    }
}
