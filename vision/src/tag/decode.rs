//! The code inside a quadrangle.

use super::Options;
use super::family::CODES;
use crate::image::GrayImage;
use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};

/// The content of a quadrangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Code {
    pub id: u32,
    pub errors: u32,
    /// Which of the quadrangle's corners is the tag's top left one.
    pub first_corner: usize,
    pub contrast: f64,
}

/// Cells of the tag's edge: six bits and a black cell on both sides.
const CELLS: i32 = 8;
/// Bits of a row.
const BITS: usize = 6;

/// Reads the code, if there is one with few enough wrong bits.
pub(super) fn read(
    picture: &GrayImage,
    corners_px: &[Vector2<f64>; 4],
    options: &Options,
) -> Option<Code> {
    let picture_from_cells = homography(corners_px)?;
    let grey = |x: f64, y: f64| {
        let p = picture_from_cells * Vector3::new(x, y, 1.0);
        let (u, v) = (p.x / p.z, p.y / p.z);
        // Outside the picture `sample` repeats the border, which could pass for a white rim.
        let inside =
            u >= 0.0 && v >= 0.0 && u <= picture.width() as f64 && v <= picture.height() as f64;
        inside.then(|| picture.sample(u, v))
    };
    // Brightness of the white rim and of the black frame, as planes over the tag.
    let (mut white, mut black) = (Plane::default(), Plane::default());
    for k in -1..=CELLS {
        let along = f64::from(k) + 0.5;
        let far = f64::from(CELLS) + 0.5;
        for (x, y) in [(along, -0.5), (along, far), (-0.5, along), (far, along)] {
            white.add(x, y, grey(x, y)?);
        }
        if (0..CELLS).contains(&k) {
            let far = far - 1.0;
            for (x, y) in [(along, 0.5), (along, far), (0.5, along), (far, along)] {
                black.add(x, y, grey(x, y)?);
            }
        }
    }
    let (white, black) = (white.fit()?, black.fit()?);
    let middle = Vector3::new(1.0, f64::from(CELLS) / 2.0, f64::from(CELLS) / 2.0);
    let contrast = (white - black).dot(&middle);
    if contrast < options.contrast_min {
        return None;
    }
    let limit = (white + black) * 0.5;
    // A frame that is not black all around, or a rim that is not white, does not belong to a tag.
    let mut wrong = 0;
    for k in 0..CELLS {
        let along = f64::from(k) + 0.5;
        let far = f64::from(CELLS) - 0.5;
        for (x, y) in [(along, 0.5), (along, far), (0.5, along), (far, along)] {
            wrong += u32::from(grey(x, y)? > limit.dot(&Vector3::new(1.0, x, y)));
        }
    }
    if wrong > 2 {
        return None;
    }
    let mut bits = [[false; BITS]; BITS];
    for (row, line) in bits.iter_mut().enumerate() {
        for (column, bit) in line.iter_mut().enumerate() {
            let (x, y) = (column as f64 + 1.5, row as f64 + 1.5);
            // Five places of the cell outvote single noisy pixels.
            let mut sum = 0.0;
            for (dx, dy) in [
                (0.0, 0.0),
                (0.2, 0.2),
                (-0.2, 0.2),
                (0.2, -0.2),
                (-0.2, -0.2),
            ] {
                sum += grey(x + dx, y + dy)?;
            }
            *bit = sum / 5.0 > limit.dot(&Vector3::new(1.0, x, y));
        }
    }
    let mut best = (u32::MAX, 0_usize, 0_usize);
    for turn in 0..4 {
        let word = word(&bits, turn);
        for (id, code) in CODES.iter().enumerate() {
            let errors = (code ^ word).count_ones();
            if errors < best.0 {
                best = (errors, id, turn);
            }
        }
    }
    let (errors, id, first_corner) = best;
    (errors <= options.errors_max).then(|| Code {
        id: u32::try_from(id).unwrap_or(0),
        errors,
        first_corner,
        contrast,
    })
}

/// The 36 bits as read when corner `turn` is the top left one.
fn word(bits: &[[bool; BITS]; BITS], turn: usize) -> u64 {
    let last = BITS - 1;
    let mut word = 0;
    for row in 0..BITS {
        for column in 0..BITS {
            let (x, y) = match turn {
                0 => (column, row),
                1 => (last - row, column),
                2 => (last - column, last - row),
                _ => (row, last - column),
            };
            word = word << 1 | u64::from(bits[y][x]);
        }
    }
    word
}

/// Takes cells (x to the right, y down, 0 to 8) to pixels.
fn homography(corners_px: &[Vector2<f64>; 4]) -> Option<Matrix3<f64>> {
    let far = f64::from(CELLS);
    let cells = [(0.0, 0.0), (far, 0.0), (far, far), (0.0, far)];
    let mut left = SMatrix::<f64, 8, 8>::zeros();
    let mut right = SVector::<f64, 8>::zeros();
    for (i, ((x, y), p)) in cells.into_iter().zip(corners_px).enumerate() {
        let (u, v) = (p.x, p.y);
        left.set_row(
            2 * i,
            &SMatrix::from_row_slice(&[x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y]),
        );
        left.set_row(
            2 * i + 1,
            &SMatrix::from_row_slice(&[0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y]),
        );
        (right[2 * i], right[2 * i + 1]) = (u, v);
    }
    let h = left.lu().solve(&right)?;
    let whole = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0);
    whole.iter().all(|value| value.is_finite()).then_some(whole)
}

/// Least squares for a + b x + c y.
#[derive(Default)]
struct Plane {
    normal: Matrix3<f64>,
    right: Vector3<f64>,
}

impl Plane {
    fn add(&mut self, x: f64, y: f64, value: f64) {
        let row = Vector3::new(1.0, x, y);
        self.normal += row * row.transpose();
        self.right += row * value;
    }

    fn fit(&self) -> Option<Vector3<f64>> {
        Some(self.normal.try_inverse()? * self.right)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_turn_of_a_tag_is_read() {
        let pixels_per_cell = 6;
        let side = 12 * pixels_per_cell;
        let code = CODES[17];
        let mut picture = GrayImage::filled(side, side, 220);
        for y in 0..side {
            for x in 0..side {
                let (column, row) = (x / pixels_per_cell, y / pixels_per_cell);
                if !(2..10).contains(&column) || !(2..10).contains(&row) {
                    continue;
                }
                let bit = (3..9).contains(&column) && (3..9).contains(&row) && {
                    let place = (row - 3) * 6 + column - 3;
                    code >> (35 - place) & 1 == 1
                };
                picture.set(x, y, if bit { 220 } else { 30 });
            }
        }
        let (low, high) = (12.0, 60.0);
        let corners = [[low, low], [high, low], [high, high], [low, high]].map(Vector2::from);
        for turn in 0..4 {
            let turned = [0, 1, 2, 3].map(|i| corners[(i + turn) % 4]);
            let read = read(&picture, &turned, &Options::default()).unwrap();
            assert_eq!((read.id, read.errors), (17, 0));
            assert_eq!((read.first_corner + turn) % 4, 0);
        }
    }
}
