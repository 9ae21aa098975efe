//! The reference: the closed form of the inverse kinematics transcribed term by term with nalgebra,
//! and the quantities that follow from it in the most direct way. Written once; not to be tuned.

use mcdpr_kinematics::{Cable, Pose};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

pub struct Plain {
    pub cables: [Cable; 4],
    pub weight_n: f64,
}

pub struct PlainInverse {
    pub lengths: SVector<f64, 4>,
    pub wraps: SVector<f64, 4>,
    pub directions: [Vector3<f64>; 4],
}

impl Plain {
    pub fn inverse(&self, pose: &Pose) -> Option<PlainInverse> {
        let mut out = PlainInverse {
            lengths: SVector::zeros(),
            wraps: SVector::zeros(),
            directions: [Vector3::zeros(); 4],
        };
        for (i, c) in self.cables.iter().enumerate() {
            let d = pose.position_m + pose.rotation * c.attachment_m - c.anchor_m;
            let h = d.dot(&c.swivel_axis);
            let across = d - c.swivel_axis * h;
            let rho = across.norm();
            let e = across / rho;
            let r = c.pulley_radius_m;
            let s2 = (rho - r).powi(2) + h.powi(2) - r.powi(2);
            if !(s2 >= 0.0 && rho > 0.0) {
                return None;
            }
            let s = s2.sqrt();
            let angle = std::f64::consts::PI - s.atan2(r) - h.atan2(rho - r);
            let theta = angle.rem_euclid(std::f64::consts::TAU);
            out.lengths[i] = r * theta + s;
            out.wraps[i] = theta;
            out.directions[i] = e * theta.sin() + c.swivel_axis * theta.cos();
        }
        Some(out)
    }

    /// Lengths and wraps only, two arc-tangents per cable.
    pub fn lengths(&self, pose: &Pose) -> Option<SVector<f64, 4>> {
        let mut out = SVector::zeros();
        for (i, c) in self.cables.iter().enumerate() {
            let d = pose.position_m + pose.rotation * c.attachment_m - c.anchor_m;
            let h = d.dot(&c.swivel_axis);
            let rho = (d - c.swivel_axis * h).norm();
            let r = c.pulley_radius_m;
            let s2 = (rho - r).powi(2) + h.powi(2) - r.powi(2);
            if !(s2 >= 0.0 && rho > 0.0) {
                return None;
            }
            let s = s2.sqrt();
            let angle = std::f64::consts::PI - s.atan2(r) - h.atan2(rho - r);
            out[i] = r * angle.rem_euclid(std::f64::consts::TAU) + s;
        }
        Some(out)
    }

    pub fn position(&self, lengths: &SVector<f64, 4>, start: &Pose) -> Option<Vector3<f64>> {
        let mut pose = *start;
        for _ in 0..50 {
            let inverse = self.inverse(&pose)?;
            let residual = lengths - inverse.lengths;
            let j = SMatrix::<f64, 4, 3>::from_fn(|i, k| inverse.directions[i][k]);
            let step = (j.transpose() * j).try_inverse()? * (j.transpose() * residual);
            pose.position_m += step;
            if step.norm() < 1e-10 {
                return Some(pose.position_m);
            }
        }
        None
    }

    /// Force balance at a level pose: tensions nearest to the middle of the limits.
    pub fn distribute(
        &self,
        directions: &[Vector3<f64>; 4],
        min: f64,
        max: f64,
    ) -> Option<SVector<f64, 4>> {
        let a = SMatrix::<f64, 3, 4>::from_fn(|k, i| -directions[i][k]);
        let load = Vector3::new(0.0, 0.0, self.weight_n);
        let middle = SVector::<f64, 4>::repeat(0.5 * (min + max));
        let inverse = (a * a.transpose()).try_inverse()?;
        let base = middle + a.transpose() * (inverse * (load - a * middle));
        let column = |i: usize| -> Vector3<f64> { a.column(i).into() };
        let det = |i, j, k| Matrix3::from_columns(&[column(i), column(j), column(k)]).determinant();
        let null = SVector::<f64, 4>::new(det(1, 2, 3), -det(0, 2, 3), det(0, 1, 3), -det(0, 1, 2));
        let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
        for i in 0..4 {
            let (p, q) = ((min - base[i]) / null[i], (max - base[i]) / null[i]);
            low = low.max(p.min(q));
            high = high.min(p.max(q));
        }
        (low <= high).then(|| base + null * 0.0_f64.max(low).min(high))
    }
}
