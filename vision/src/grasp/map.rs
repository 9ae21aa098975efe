//! Heights over the ground, seen straight from above, independent of the camera's attitude.

use super::NoGrasp;
use super::ground::ground;
use super::rays::Rays;
use crate::align::Aligned;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

/// Side of a cell, m.
const CELL_M: f64 = 0.001;
/// Greater heights are not objects in a tray, m.
const HIGHEST_M: f64 = 0.25;
/// Largest map, cells.
/// Along one side: 0.7 m.
const CELLS_MAX: usize = 700;

/// A map of heights over the ground plane. Its frame lies in the plane, x along the camera's x,
/// z up towards the camera.
#[derive(Debug, Clone)]
pub struct HeightMap {
    /// camera_from_map, m.
    pub camera_from_map: Isometry3<f64>,
    /// Cells along x and y.
    pub size: [usize; 2],
    /// Corner of the first cell in the map's frame, m.
    pub corner_m: [f64; 2],
    /// Heights, m, row by row along x.
    heights_m: Vec<f32>,
    /// Colours there.
    grey: Vec<[u8; 3]>,
}

impl HeightMap {
    /// Side of a cell, m.
    pub const CELL_M: f64 = CELL_M;

    /// Finds the ground and maps the objects on it.
    ///
    /// # Errors
    /// [`NoGrasp::NoDepth`], [`NoGrasp::NoPlane`].
    pub fn new(picture: &Aligned) -> Result<Self, NoGrasp> {
        let share = picture.depth.measured_share();
        if share < 0.1 {
            return Err(NoGrasp::NoDepth { share });
        }
        let mut map = Self::empty(picture, ground(picture)?);
        map.project(picture);
        map.fill();
        map.smooth();
        Ok(map)
    }

    /// An empty map of the ground within the picture's corners.
    fn empty(picture: &Aligned, camera_from_map: Isometry3<f64>) -> Self {
        let map_from_camera = camera_from_map.inverse();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let [width, height] = picture.camera.size_px.map(|size| size as f64);
        for pixel in [[0.5, 0.5], [width, 0.5], [0.5, height], [width, height]] {
            let ray = picture.camera.direction(&pixel.into());
            let along = map_from_camera.rotation * Vector3::new(ray.x, ray.y, 1.0);
            let from = map_from_camera.translation.vector;
            let way = -from.z / along.z.min(-1e-6);
            for i in 0..2 {
                // A ray near the horizon meets the ground far away, or never: 5 m are enough for a
                // tray.
                let value = from[i] + way.clamp(0.0, 5.0) * along[i];
                low[i] = low[i].min(value);
                high[i] = high[i].max(value);
            }
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let size =
            [0, 1].map(|i| (((high[i] - low[i]) / CELL_M).ceil() as usize).clamp(1, CELLS_MAX));
        // A larger view is cropped about its middle.
        let corner_m = [0, 1].map(|i| 0.5 * (low[i] + high[i]) - 0.5 * size[i] as f64 * CELL_M);
        Self {
            camera_from_map,
            size,
            corner_m,
            heights_m: vec![f32::NEG_INFINITY; size[0] * size[1]],
            grey: vec![[0; 3]; size[0] * size[1]],
        }
    }

    /// A map with known heights.
    #[cfg(test)]
    pub(super) fn of_heights(size: [usize; 2], heights_m: Vec<f32>) -> Self {
        Self {
            camera_from_map: Isometry3::identity(),
            size,
            corner_m: [0.0; 2],
            grey: vec![[0; 3]; heights_m.len()],
            heights_m,
        }
    }

    /// Puts every measured pixel into its cell; the highest stays.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        clippy::cast_sign_loss,
        reason = "single precision, and cells that are compared with the map's size first"
    )]
    fn project(&mut self, picture: &Aligned) {
        let map_from_camera = self.camera_from_map.inverse();
        let cells = 1.0 / CELL_M;
        // Coordinates along x and y in cells from the corner, heights in m.
        let turn = map_from_camera.rotation.to_rotation_matrix();
        let scale = Vector3::new(cells, cells, 1.0);
        let turn: Matrix3<f32> =
            (Matrix3::from_diagonal(&scale) * turn.matrix()).map(|value| value as f32);
        let corner = Vector3::new(self.corner_m[0], self.corner_m[1], 0.0);
        let shift = (map_from_camera.translation.vector - corner).component_mul(&scale);
        let shift: Vector3<f32> = shift.map(|value| value as f32);
        let unit_m = picture.depth.unit_m as f32;
        let (columns, rows) = (self.size[0] as i32, self.size[1] as i32);
        let width = picture.camera.size_px[0];
        let mut rays = Rays::new(&picture.camera);
        // Points outside the map go into one extra cell.
        let nowhere = self.heights_m.len() as i32;
        let mut highest = vec![0_u64; self.heights_m.len() + 1];
        let (mut cells, mut heights) = (vec![0_i32; width], vec![0_u32; width]);
        let [to_u, to_v, to_high] =
            [0, 1, 2].map(|i| [turn[(i, 0)], turn[(i, 1)], turn[(i, 2)], shift[i]]);
        for y in 0..picture.camera.size_px[1] {
            let (xs, ys) = rays.row(y);
            let steps = picture.depth.steps.row(y);
            let out = cells.iter_mut().zip(heights.iter_mut());
            // Without branches, so that several pixels go at once.
            for ((((cell, ordered), &steps), x), y) in out.zip(steps).zip(xs).zip(ys) {
                let z = f32::from(steps) * unit_m;
                let on = |to: [f32; 4]| z * (to[0] * x + to[1] * y + to[2]) + to[3];
                let (u, v) = (on(to_u), on(to_v));
                let high = on(to_high);
                *ordered = in_order(high);
                let (column, row) = (whole(u), whole(v));
                // The border's outer half is left out: there `whole` is less than 0.
                let inside = (steps > 0)
                    & (u >= 0.5)
                    & (v >= 0.5)
                    & (column < columns)
                    & (row < rows)
                    & (high < HIGHEST_M as f32);
                let at = row.wrapping_mul(columns).wrapping_add(column);
                *cell = if inside { at } else { nowhere };
            }
            // Without branches here, too: the processor cannot predict which pixel is the highest
            // of a cell. Of equally high pixels the first is kept.
            let last = !((y * width) as u32);
            for ((&cell, &high), last) in cells.iter().zip(&heights).zip((0..=last).rev()) {
                if let Some(slot) = highest.get_mut(cell as u32 as usize) {
                    *slot = (*slot).max(u64::from(high) << 32 | u64::from(last));
                }
            }
        }
        let out = self.heights_m.iter_mut().zip(&mut self.grey);
        for ((high, grey), &seen) in out.zip(&highest) {
            let pixel = !(seen as u32) as usize;
            if let Some(color) = picture.color.pixels().get(pixel) {
                *high = of_order((seen >> 32) as u32);
                *grey = *color;
            }
        }
    }

    /// Unknown cells get the lowest of the nearest known heights in the four directions: a shadow
    /// gets the ground behind it, a hole in an object the object's height.
    fn fill(&mut self) {
        let width = self.size[0];
        let mut lowest = vec![f32::INFINITY; self.heights_m.len()];
        let known = |high: f32, last: f32| if high > f32::NEG_INFINITY { high } else { last };
        let less = |a: f32, b: f32| if a < b { a } else { b };
        let mut last = vec![f32::INFINITY; width];
        let mut sweep = |heights: &[f32], lowest: &mut [f32]| {
            for ((last, &high), low) in last.iter_mut().zip(heights).zip(lowest) {
                *last = known(high, *last);
                *low = less(*low, *last);
            }
        };
        let rows = || self.heights_m.chunks_exact(width);
        for (heights, lowest) in rows().zip(lowest.chunks_exact_mut(width)) {
            sweep(heights, lowest);
        }
        last.fill(f32::INFINITY);
        let mut sweep = |heights: &[f32], lowest: &mut [f32]| {
            for ((last, &high), low) in last.iter_mut().zip(heights).zip(lowest) {
                *last = known(high, *last);
                *low = less(*low, *last);
            }
        };
        for (heights, lowest) in rows().rev().zip(lowest.chunks_exact_mut(width).rev()) {
            sweep(heights, lowest);
        }
        for (heights, lowest) in rows().zip(lowest.chunks_exact_mut(width)) {
            let mut last = f32::INFINITY;
            for (&high, low) in heights.iter().zip(lowest.iter_mut()) {
                last = known(high, last);
                *low = less(*low, last);
            }
            let mut last = f32::INFINITY;
            for (&high, low) in heights.iter().zip(lowest).rev() {
                last = known(high, last);
                *low = less(*low, last);
            }
        }
        for (value, low) in self.heights_m.iter_mut().zip(lowest) {
            // Without any known height in four directions: ground.
            let filled = if low < f32::INFINITY { low } else { 0.0 };
            *value = known(*value, filled);
        }
    }

    /// The median of each cell and its neighbours above, below, left and right removes noise and
    /// keeps edges.
    fn smooth(&mut self) {
        let width = self.size[0];
        let old = self.heights_m.clone();
        let Some(count) = old.len().checked_sub(2 * width) else {
            return;
        };
        let from = |start: usize| old[start..start + count].iter();
        let beside = from(width - 1).zip(from(width + 1));
        let across = from(0).zip(from(2 * width));
        let all = from(width).zip(beside.zip(across));
        for (value, (at, ((left, right), (up, down)))) in
            self.heights_m[width..width + count].iter_mut().zip(all)
        {
            *value = median_of_5([*at, *left, *right, *up, *down]);
        }
    }

    /// Height at a point of the map's frame, m; 0 outside.
    #[must_use]
    pub fn height_m(&self, x_m: f64, y_m: f64) -> f64 {
        self.index(x_m, y_m)
            .map_or(0.0, |at| f64::from(self.heights_m[at]))
    }

    /// Colour at a point of the map's frame.
    pub(super) fn color(&self, x_m: f64, y_m: f64) -> [f64; 3] {
        self.index(x_m, y_m)
            .map_or([0.0; 3], |at| self.grey[at].map(f64::from))
    }

    fn index(&self, x_m: f64, y_m: f64) -> Option<usize> {
        let x = (x_m - self.corner_m[0]) * (1.0 / CELL_M);
        let y = (y_m - self.corner_m[1]) * (1.0 / CELL_M);
        if !(x >= 0.0 && y >= 0.0) {
            return None;
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let (column, row) = (x as usize, y as usize);
        (column < self.size[0] && row < self.size[1]).then(|| row * self.size[0] + column)
    }

    pub(super) fn heights(&self) -> &[f32] {
        &self.heights_m
    }

    /// Middle of a cell in the map's frame, m.
    pub(super) fn middle_m(&self, column: usize, row: usize) -> [f64; 2] {
        let middle = |i: usize, cell: usize| self.corner_m[i] + (cell as f64 + 0.5) * CELL_M;
        [middle(0, column), middle(1, row)]
    }

    /// A point of the map's frame in the camera's, m.
    #[must_use]
    pub fn to_camera(&self, x_m: f64, y_m: f64, z_m: f64) -> Point3<f64> {
        self.camera_from_map * Point3::new(x_m, y_m, z_m)
    }
}

/// The floor of a number from 0.5 to four million that is not a whole number: added to such a large
/// number, its fraction is rounded off. A conversion, which checks the range, takes several times
/// as long.
const fn whole(value: f32) -> i32 {
    const LARGE: f32 = 8_388_608.0;
    let bits = (value - 0.5 + LARGE).to_bits();
    bits.wrapping_sub(LARGE.to_bits()).cast_signed()
}

/// A height as a whole number: of two heights the greater has the greater.
const fn in_order(high: f32) -> u32 {
    let bits = high.to_bits();
    bits ^ ((bits.cast_signed() >> 31).cast_unsigned() | 1 << 31)
}

/// The height of [`in_order`].
const fn of_order(ordered: u32) -> f32 {
    let below_0 = (ordered.cast_signed() >> 31).cast_unsigned();
    f32::from_bits(ordered ^ (!below_0 | 1 << 31))
}

fn median_of_5(mut values: [f32; 5]) -> f32 {
    let mut order = |a: usize, b: usize| {
        let (one, other) = (values[a], values[b]);
        // Not f32::min, which would check for NaN.
        values[a] = if one < other { one } else { other };
        values[b] = if one < other { other } else { one };
    };
    order(0, 1);
    order(3, 4);
    order(0, 3);
    order(1, 4);
    order(1, 2);
    order(2, 3);
    order(1, 2);
    values[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_keep_their_order_and_come_back() {
        let heights = [-1.5, -0.003, -0.0, 0.0, 1e-9, 0.02, 0.2499];
        for pair in heights.windows(2) {
            assert!(in_order(pair[0]) < in_order(pair[1]), "{pair:?}");
        }
        for high in heights {
            assert_eq!(of_order(in_order(high)), high);
        }
    }

    #[test]
    fn whole_numbers_are_those_below() {
        for value in [0.5, 0.75, 1.0001, 6.9999, 639.5, 699.999] {
            assert_eq!(f64::from(whole(value)), f64::from(value.floor()), "{value}");
        }
    }
}
