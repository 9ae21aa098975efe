//! A camera's lens: projection of its points to pixels, with derivatives.

use nalgebra::{Matrix2x3, Vector2, Vector3};

/// A pinhole camera: pixel = f X/Z + c, with radial and tangential distortion (Brown, 1971).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Focal lengths, px.
    pub focal_px: [f64; 2],
    /// Principal point, px.
    pub center_px: [f64; 2],
    /// Picture size, px.
    pub size_px: [f64; 2],
    /// k1, k2, p1, p2, k3.
    pub distortion: [f64; 5],
}

/// A pixel and its derivatives.
#[derive(Debug, Clone, Copy)]
pub struct Projection {
    /// Where the point appears, px.
    pub pixel: Vector2<f64>,
    /// Derivative with respect to the point in the camera's frame, px/m.
    pub by_point: Matrix2x3<f64>,
    /// Derivative with respect to a common relative change of both focal lengths, px.
    pub by_focal: Vector2<f64>,
    /// Derivative with respect to k1, px.
    pub by_k1: Vector2<f64>,
}

impl Lens {
    /// Projects a point (camera frame, m, z ahead). `None` at and behind the camera.
    #[must_use]
    pub fn project(&self, point: &Vector3<f64>) -> Option<Projection> {
        if !(point.z > 1e-6 && point.iter().all(|x| x.is_finite())) {
            return None;
        }
        let inv = 1.0 / point.z;
        let (x, y) = (point.x * inv, point.y * inv);
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3);
        let xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
        let yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
        let xx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x;
        let xy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        let yy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x;
        let [fx, fy] = self.focal_px;
        Some(Projection {
            pixel: Vector2::new(fx * xd + self.center_px[0], fy * yd + self.center_px[1]),
            by_point: Matrix2x3::new(
                fx * xx * inv,
                fx * xy * inv,
                -fx * (xx * x + xy * y) * inv,
                fy * xy * inv,
                fy * yy * inv,
                -fy * (xy * x + yy * y) * inv,
            ),
            by_focal: Vector2::new(fx * xd, fy * yd),
            by_k1: Vector2::new(fx * x * r2, fy * y * r2),
        })
    }

    /// Direction (x/z, y/z) of a pixel: the distortion undone by Newton's method.
    #[must_use]
    pub fn direction(&self, pixel: [f64; 2]) -> Vector2<f64> {
        let wanted = Vector2::from(pixel);
        let mut at = Vector2::new(
            (pixel[0] - self.center_px[0]) / self.focal_px[0],
            (pixel[1] - self.center_px[1]) / self.focal_px[1],
        );
        for _ in 0..10 {
            let Some(p) = self.project(&Vector3::new(at.x, at.y, 1.0)) else {
                break;
            };
            let step = p.by_point.fixed_columns::<2>(0).into_owned().try_inverse();
            let Some(step) = step.map(|inverse| inverse * (wanted - p.pixel)) else {
                break;
            };
            at += step;
            if step.norm() < 1e-14 {
                break;
            }
        }
        at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens() -> Lens {
        Lens {
            focal_px: [920.0, 915.0],
            center_px: [640.0, 360.0],
            size_px: [1280.0, 720.0],
            distortion: [0.05, -0.02, 0.001, -0.002, 0.01],
        }
    }

    #[test]
    fn derivatives_match_differences() {
        let (camera, point) = (lens(), Vector3::new(0.12, -0.08, 0.4));
        let at = camera.project(&point).unwrap();
        for k in 0..3 {
            let step = Vector3::from_fn(|i, _| if i == k { 1e-6 } else { 0.0 });
            let (a, b) = (
                camera.project(&(point + step)),
                camera.project(&(point - step)),
            );
            let slope = (a.unwrap().pixel - b.unwrap().pixel) / 2e-6;
            assert!((slope - at.by_point.column(k)).norm() < 1e-4);
        }
        let mut other = camera;
        other.distortion[0] += 1e-6;
        let slope = (other.project(&point).unwrap().pixel - at.pixel) / 1e-6;
        assert!((slope - at.by_k1).norm() < 1e-5);
    }

    #[test]
    fn directions_undo_the_projection() {
        let point = Vector3::new(0.12, -0.08, 0.4);
        let pixel = lens().project(&point).unwrap().pixel;
        let direction = lens().direction([pixel.x, pixel.y]);
        assert!((direction - point.xy() / point.z).norm() < 1e-12);
        assert!(lens().project(&Vector3::new(0.0, 0.0, -1.0)).is_none());
    }
}
