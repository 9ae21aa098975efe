//! A pinhole camera with lens distortion.

use nalgebra::{Matrix2, Matrix2x3, Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Invalid camera intrinsics.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("camera intrinsics: {name} is {value}, it must be {rule}")]
pub struct CameraError {
    /// Which number.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// What it must be.
    pub rule: &'static str,
}

/// A pinhole camera with radial and tangential distortion (Brown, 1971; OpenCV's order).
///
/// Pixels are counted from the picture's top left corner, the first pixel's centre lies at
/// (0.5, 0.5). The frame has x to the right, y down, z ahead.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Width and height of the picture, px.
    pub size_px: [usize; 2],
    /// Focal lengths along rows and columns, px.
    pub focal_px: [f64; 2],
    /// Principal point, px.
    pub center_px: [f64; 2],
    /// k1, k2, p1, p2, k3.
    #[serde(default)]
    pub distortion: [f64; 5],
}

/// A pixel and its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
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

/// A direction after distortion, with its derivative by the direction before it, which is
/// symmetric.
struct Bent {
    at: Vector2<f64>,
    xx: f64,
    xy: f64,
    yy: f64,
}

impl Camera {
    /// Checks the numbers.
    ///
    /// # Errors
    /// The first invalid value.
    pub fn validate(&self) -> Result<(), CameraError> {
        let fail = |name, value, rule| Err(CameraError { name, value, rule });
        for (value, name) in self.size_px.into_iter().zip(["width", "height"]) {
            if !(1..=16_384).contains(&value) {
                return fail(name, value as f64, "1 to 16384 px");
            }
        }
        for (value, name) in self.focal_px.into_iter().zip(["fx", "fy"]) {
            if !(value.is_finite() && value > 0.0) {
                return fail(name, value, "over 0 px");
            }
        }
        for ((value, name), size) in self
            .center_px
            .into_iter()
            .zip(["cx", "cy"])
            .zip(self.size_px)
        {
            if !(0.0..=size as f64).contains(&value) {
                return fail(name, value, "inside the picture, px");
            }
        }
        for value in self.distortion {
            if !(value.is_finite() && value.abs() < 10.0) {
                return fail("distortion", value, "finite and below 10");
            }
        }
        Ok(())
    }

    /// A direction (x/z, y/z) after the lens's distortion.
    fn bend(&self, direction: &Vector2<f64>) -> Bent {
        let (x, y) = (direction.x, direction.y);
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3);
        Bent {
            at: Vector2::new(
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ),
            xx: radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            xy: 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y,
            yy: radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        }
    }

    fn pixel(&self, bent: &Vector2<f64>) -> Vector2<f64> {
        let [fx, fy] = self.focal_px;
        Vector2::new(
            fx * bent.x + self.center_px[0],
            fy * bent.y + self.center_px[1],
        )
    }

    /// Where a point (camera frame, m) appears, px. `None` at and behind the camera.
    ///
    /// ```
    /// use mcdpr_vision::Camera;
    /// let camera = Camera { size_px: [640, 480], focal_px: [600.0; 2], center_px: [320.0, 240.0], distortion: [0.0; 5] };
    /// let pixel = camera.project(&nalgebra::Point3::new(0.1, 0.0, 0.5)).unwrap();
    /// assert_eq!([pixel.x, pixel.y], [440.0, 240.0]); // 320 + 600 x 0.1 / 0.5
    /// ```
    #[must_use]
    pub fn project(&self, point_m: &Point3<f64>) -> Option<Vector2<f64>> {
        // A point behind the camera would appear mirrored.
        if !(point_m.z > 1e-6 && point_m.iter().all(|value| value.is_finite())) {
            return None;
        }
        let direction = Vector2::new(point_m.x, point_m.y) / point_m.z;
        Some(self.pixel(&self.bend(&direction).at))
    }

    /// As [`Camera::project`], with the derivatives of the pixel.
    ///
    /// ```
    /// use mcdpr_vision::Camera;
    /// let camera = Camera { size_px: [640, 480], focal_px: [600.0; 2], center_px: [320.0, 240.0], distortion: [0.0; 5] };
    /// let seen = camera.projection(&nalgebra::Point3::new(0.1, 0.0, 0.5)).unwrap();
    /// assert_eq!(seen.by_point[(0, 0)], 1200.0); // 600 px / 0.5 m
    /// assert_eq!(seen.by_point[(0, 2)], -240.0); // -600 px x 0.1 / 0.5^2
    /// assert_eq!(seen.by_focal.x, 120.0); // the distance from the principal point
    /// ```
    #[inline]
    #[must_use]
    pub fn projection(&self, point_m: &Point3<f64>) -> Option<Projection> {
        if !(point_m.z > 1e-6 && point_m.iter().all(|value| value.is_finite())) {
            return None;
        }
        let inv = 1.0 / point_m.z;
        let (x, y) = (point_m.x * inv, point_m.y * inv);
        let Bent { at, xx, xy, yy } = self.bend(&Vector2::new(x, y));
        let r2 = x * x + y * y;
        let [fx, fy] = self.focal_px;
        Some(Projection {
            pixel: self.pixel(&at),
            by_point: Matrix2x3::new(
                fx * xx * inv,
                fx * xy * inv,
                -fx * (xx * x + xy * y) * inv,
                fy * xy * inv,
                fy * yy * inv,
                -fy * (xy * x + yy * y) * inv,
            ),
            by_focal: Vector2::new(fx * at.x, fy * at.y),
            by_k1: Vector2::new(fx * x * r2, fy * y * r2),
        })
    }

    /// Direction (x/z, y/z) of a pixel: distortion undone by Newton's method.
    #[must_use]
    pub fn direction(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        let mut at = Vector2::new(
            (pixel.x - self.center_px[0]) / self.focal_px[0],
            (pixel.y - self.center_px[1]) / self.focal_px[1],
        );
        if self.distortion == [0.0; 5] {
            return at;
        }
        for _ in 0..10 {
            let bent = self.bend(&at);
            let [fx, fy] = self.focal_px;
            let slope = Matrix2::new(fx * bent.xx, fx * bent.xy, fy * bent.xy, fy * bent.yy);
            // Beyond its range a lens's polynomial folds back: its slope vanishes there.
            let Some(inverse) = slope.try_inverse() else {
                break;
            };
            let step = inverse * (pixel - self.pixel(&bent.at));
            at += step;
            // 1e-10 px at a focal length of 1000 px.
            if step.norm() < 1e-13 {
                break;
            }
        }
        at
    }

    /// The point at a distance along z that appears at a pixel, camera frame, m: Eq. 48 of the
    /// paper before the camera's pose is applied, with z in place of the printed 1/z.
    ///
    /// ```
    /// use mcdpr_vision::Camera;
    /// let camera = Camera { size_px: [640, 480], focal_px: [600.0; 2], center_px: [320.0, 240.0], distortion: [0.0; 5] };
    /// let point = camera.back_project(&nalgebra::Vector2::new(440.0, 240.0), 0.5);
    /// assert!((point - nalgebra::Point3::new(0.1, 0.0, 0.5)).norm() < 1e-15);
    /// ```
    #[must_use]
    pub fn back_project(&self, pixel: &Vector2<f64>, depth_m: f64) -> Point3<f64> {
        let direction = self.direction(pixel);
        Point3::from(Vector3::new(direction.x, direction.y, 1.0) * depth_m)
    }

    /// The same camera with its picture cropped about the middle to the shape of `size_px` and
    /// then scaled to it, as RGB-D cameras make their smaller modes.
    #[must_use]
    pub fn mode(&self, size_px: [usize; 2]) -> Self {
        let [w, h] = self.size_px.map(|value| value as f64);
        let [to_w, to_h] = size_px.map(|value| value as f64);
        // The larger scale fills the new shape; what stands out is cropped.
        let scale = (to_w / w).max(to_h / h);
        let cropped = [(w * scale - to_w) / 2.0, (h * scale - to_h) / 2.0];
        Self {
            size_px,
            focal_px: self.focal_px.map(|value| value * scale),
            center_px: [
                self.center_px[0] * scale - cropped[0],
                self.center_px[1] * scale - cropped[1],
            ],
            distortion: self.distortion,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens() -> Camera {
        Camera {
            size_px: [1280, 720],
            focal_px: [920.0, 915.0],
            center_px: [640.0, 360.0],
            distortion: [0.05, -0.02, 0.001, -0.002, 0.01],
        }
    }

    #[test]
    fn slopes_match_differences() {
        let point = Point3::new(0.12, -0.08, 0.4);
        let seen = lens().projection(&point).unwrap();
        assert!((seen.pixel - lens().project(&point).unwrap()).norm() < 1e-12);
        for k in 0..3 {
            let step = Vector3::from_fn(|i, _| if i == k { 1e-6 } else { 0.0 });
            let ahead = lens().project(&(point + step)).unwrap();
            let behind = lens().project(&(point - step)).unwrap();
            assert!(((ahead - behind) / 2e-6 - seen.by_point.column(k)).norm() < 1e-4);
        }
        let mut other = lens();
        other.distortion[0] += 1e-6;
        let slope = (other.project(&point).unwrap() - seen.pixel) / 1e-6;
        assert!((slope - seen.by_k1).norm() < 1e-5);
        let mut other = lens();
        other.focal_px = other.focal_px.map(|f| f * (1.0 + 1e-6));
        let slope = (other.project(&point).unwrap() - seen.pixel) / 1e-6;
        assert!((slope - seen.by_focal).norm() < 1e-5);
    }

    #[test]
    fn back_projection_undoes_projection() {
        let point = Point3::new(0.12, -0.08, 0.4);
        let pixel = lens().project(&point).unwrap();
        assert!((lens().back_project(&pixel, 0.4) - point).norm() < 1e-12);
        assert!(lens().project(&Point3::new(0.0, 0.0, -1.0)).is_none());
    }

    #[test]
    fn a_smaller_mode_sees_the_same_along_the_axis() {
        let small = lens().mode([640, 480]);
        assert_eq!(small.center_px, [320.0, 240.0]);
        assert!((small.focal_px[0] - 920.0 / 1.5).abs() < 1e-12);
    }

    #[test]
    fn what_is_no_camera_is_reported() {
        let mut camera = lens();
        camera.focal_px[1] = f64::NAN;
        assert_eq!(camera.validate().unwrap_err().name, "fy");
        let mut camera = lens();
        camera.center_px[0] = -3.0;
        assert_eq!(camera.validate().unwrap_err().name, "cx");
    }
}
