//! Directions of all pixels, row by row.

use crate::camera::Camera;
use nalgebra::Vector2;

/// Distortion is undone at every so many pixels, and linear between them: a lens bends less than a
/// fiftieth of a pixel away from that.
const STEP: usize = 16;

/// Directions x/z, y/z of a camera's pixels.
pub(super) struct Rays<'a> {
    camera: &'a Camera,
    xs: Vec<f32>,
    ys: Vec<f32>,
    /// Directions at the grid's columns in the grid's rows above and below.
    above: Vec<Vector2<f64>>,
    below: Vec<Vector2<f64>>,
}

impl<'a> Rays<'a> {
    pub(super) fn new(camera: &'a Camera) -> Self {
        let width = camera.size_px[0];
        let mut rays = Self {
            camera,
            xs: vec![0.0; width],
            ys: vec![0.0; width],
            above: Vec::new(),
            below: Vec::new(),
        };
        if !rays.bends() {
            rays.above = (0..width).map(|x| rays.at(x, 0)).collect();
            #[allow(clippy::cast_possible_truncation)]
            for (x, ray) in rays.xs.iter_mut().zip(&rays.above) {
                *x = ray.x as f32;
            }
        }
        rays
    }

    fn bends(&self) -> bool {
        self.camera.distortion != [0.0; 5]
    }

    fn at(&self, x: usize, y: usize) -> Vector2<f64> {
        let pixel = Vector2::new(x as f64 + 0.5, y as f64 + 0.5);
        self.camera.direction(&pixel)
    }

    /// x/z and y/z of the pixels of a row. Rows must be requested from the top.
    #[allow(clippy::cast_possible_truncation)]
    pub(super) fn row(&mut self, y: usize) -> (&[f32], &[f32]) {
        if !self.bends() {
            let ray = self.at(0, y);
            self.ys.fill(ray.y as f32);
            return (&self.xs, &self.ys);
        }
        let columns = self.xs.len() / STEP + 2;
        let grid = |row: usize| (0..columns).map(|k| self.at(k * STEP, row)).collect();
        if y.is_multiple_of(STEP) {
            (self.above, self.below) = (grid(y), grid(y + STEP));
        }
        let down = (y % STEP) as f64 / STEP as f64;
        let mixed = |k: usize| self.above[k] * (1.0 - down) + self.below[k] * down;
        let (mut left, mut right) = (mixed(0), mixed(1));
        for x in 0..self.xs.len() {
            if x.is_multiple_of(STEP) {
                (left, right) = (mixed(x / STEP), mixed(x / STEP + 1));
            }
            let share = (x % STEP) as f64 / STEP as f64;
            let ray = left * (1.0 - share) + right * share;
            (self.xs[x], self.ys[x]) = (ray.x as f32, ray.y as f32);
        }
        (&self.xs, &self.ys)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_have_the_directions_of_their_pixels() {
        for distortion in [[0.0; 5], [0.08, -0.05, 0.001, -0.0015, 0.01]] {
            let camera = Camera {
                size_px: [650, 470],
                focal_px: [610.0, 605.0],
                center_px: [318.0, 243.0],
                distortion,
            };
            let mut rays = Rays::new(&camera);
            for y in 0..470 {
                let (xs, ys) = rays.row(y);
                for x in (0..650).step_by(7) {
                    let pixel = Vector2::new(x as f64 + 0.5, y as f64 + 0.5);
                    let wanted = camera.direction(&pixel);
                    let off = Vector2::new(f64::from(xs[x]), f64::from(ys[x])) - wanted;
                    assert!(610.0 * off.norm() < 0.02, "{x} {y}: {off}");
                }
            }
        }
    }
}
