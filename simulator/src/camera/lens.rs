//! The lens: from pixels to rays.

/// A pinhole lens with radial and tangential distortion k1, k2, p1, p2, k3 (Brown, 1971).
///
/// The formulas are implemented a second time, and inverted in another way, on purpose: pictures of
/// the simulator test the camera model of the vision crate, which shares no code with them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Width and height, px.
    pub size_px: [usize; 2],
    /// Focal lengths, px.
    pub focal_px: [f64; 2],
    /// Principal point, px.
    pub center_px: [f64; 2],
    /// k1, k2, p1, p2, k3.
    pub distortion: [f64; 5],
}

impl Lens {
    /// Shift of a direction (x/z, y/z) by the lens, and the radial factor.
    fn bend(&self, x: f64, y: f64) -> (f64, f64, f64) {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let factor = 1.0 + k1 * r2 + k2 * r2 * r2 + k3 * r2 * r2 * r2;
        let dx = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
        let dy = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
        (factor, dx, dy)
    }

    /// Direction of a pixel, with z = 1: the distortion undone by iteration.
    #[must_use]
    pub fn ray(&self, pixel: [f64; 2]) -> [f64; 3] {
        let far = [0, 1].map(|i| (pixel[i] - self.center_px[i]) / self.focal_px[i]);
        let (mut x, mut y) = (far[0], far[1]);
        if self.distortion != [0.0; 5] {
            // A round leaves about 2 |k1| r^2 of the error: with k1 = 0.1 and r = 0.5 a twentieth.
            for _ in 0..20 {
                let (factor, dx, dy) = self.bend(x, y);
                (x, y) = ((far[0] - dx) / factor, (far[1] - dy) / factor);
            }
        }
        [x, y, 1.0]
    }

    /// Where a point of the camera's frame appears, px; `None` behind the camera.
    #[must_use]
    pub fn pixel(&self, point_m: [f64; 3]) -> Option<[f64; 2]> {
        let [x, y, z] = point_m;
        if z < 1e-6 {
            return None;
        }
        let (x, y) = (x / z, y / z);
        let (factor, dx, dy) = self.bend(x, y);
        Some([
            self.focal_px[0] * (x * factor + dx) + self.center_px[0],
            self.focal_px[1] * (y * factor + dy) + self.center_px[1],
        ])
    }

    /// Whether a pixel is in the picture.
    #[must_use]
    pub fn holds(&self, pixel: [f64; 2]) -> bool {
        (0..2).all(|i| pixel[i] >= 0.0 && pixel[i] < self.size_px[i] as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_go_through_their_pixels() {
        let lens = Lens {
            size_px: [640, 480],
            focal_px: [600.0, 605.0],
            center_px: [318.0, 243.0],
            distortion: [0.06, -0.03, 0.001, -0.0015, 0.004],
        };
        for pixel in [[0.5, 0.5], [320.0, 240.0], [639.5, 100.0]] {
            let back = lens.pixel(lens.ray(pixel)).unwrap();
            assert!((0..2).all(|i| (back[i] - pixel[i]).abs() < 1e-9));
        }
        assert!(lens.pixel([0.0, 0.0, -1.0]).is_none());
        assert!(lens.holds([0.0, 479.9]) && !lens.holds([640.0, 1.0]));
    }
}
