//! The depth picture as the colour camera would see it (Eq. 46 of the paper).
//!
//! Every measured pixel is a small square patch of surface at its distance. Its four corners are
//! taken through both cameras' intrinsics and the transform between them, and it covers the colour
//! pixels whose centres lie inside; the nearer patch wins. The remaining gaps:
//!
//! - **Cracks** up to one pixel wide, where the colour camera's pixels are finer: filled with the
//!   mean of the neighbours, if at least five of eight are known and agree within 1 % of the
//!   distance.
//! - **Edges and shadows**: all other gaps stay unknown (0). No distance is interpolated between an
//!   object and its background.

use crate::camera::Camera;
use crate::frame::Frame;
use crate::image::{DepthImage, Image, RgbImage};
use nalgebra::{Point3, Vector2};

/// Colour and depth in the same pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Aligned {
    /// The colour picture.
    pub color: RgbImage,
    /// Distances along the colour camera's z, in its pixels.
    pub depth: DepthImage,
    /// The colour camera.
    pub camera: Camera,
}

/// Known neighbours that a crack needs.
const NEIGHBOURS_MIN: usize = 5;
/// By how much they may differ, as a share of the distance.
/// 5 mm at half a metre.
const AGREE: f64 = 0.01;

/// Brings the depth picture into the colour camera's pixels.
#[must_use]
pub fn align(frame: &Frame) -> Aligned {
    let [width, height] = frame.cameras.color.size_px;
    let mut nearest = vec![f32::INFINITY; width * height];
    let depth = &frame.depth;
    let rays = Rays::new(frame);
    for y in 0..depth.steps.height() {
        let row = depth.steps.row(y);
        for (x, &steps) in row.iter().enumerate() {
            if steps == 0 {
                continue;
            }
            let depth_m = f64::from(steps) * depth.unit_m;
            let Some((low, high, z)) = rays.patch(x, y, depth_m) else {
                continue;
            };
            cover(&mut nearest, [width, height], low, high, z);
        }
    }
    fill_cracks(&mut nearest, width);
    let unit_m = depth.unit_m;
    let steps = nearest
        .into_iter()
        .map(|z| {
            let steps = (f64::from(z) / unit_m).round();
            // Infinity, a pixel that no patch covers, becomes 0: not measured.
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            let steps = if steps <= 65_535.0 { steps as u16 } else { 0 };
            steps
        })
        .collect();
    let steps = Image::new(width, height, steps).unwrap_or_else(|_| Image::filled(1, 1, 0));
    Aligned {
        color: frame.color.clone(),
        depth: DepthImage { steps, unit_m },
        camera: frame.cameras.color,
    }
}

/// Directions of the depth pixels' corners, turned into the colour camera's frame.
struct Rays<'a> {
    frame: &'a Frame,
    corners: Vec<[f64; 3]>,
    across: usize,
    shift: [f64; 3],
}

impl<'a> Rays<'a> {
    fn new(frame: &'a Frame) -> Self {
        let [width, height] = frame.cameras.depth.size_px;
        let turn = frame.cameras.color_from_depth.rotation.to_rotation_matrix();
        let mut corners = Vec::with_capacity((width + 1) * (height + 1));
        for y in 0..=height {
            for x in 0..=width {
                let pixel = Vector2::new(x as f64, y as f64);
                let ray = frame.cameras.depth.back_project(&pixel, 1.0);
                corners.push((turn * ray).coords.into());
            }
        }
        Self {
            frame,
            corners,
            across: width + 1,
            shift: frame.cameras.color_from_depth.translation.vector.into(),
        }
    }

    /// The patch of a depth pixel: two opposite corners in colour pixels, and its distance.
    fn patch(&self, x: usize, y: usize, depth_m: f64) -> Option<([f64; 2], [f64; 2], f64)> {
        let at = |x: usize, y: usize| {
            let ray = self.corners[y * self.across + x];
            let point = [0, 1, 2].map(|i| ray[i] * depth_m + self.shift[i]);
            let camera = &self.frame.cameras.color;
            if camera.distortion == [0.0; 5] {
                let inverse = 1.0 / point[2];
                let pixel =
                    [0, 1].map(|i| camera.focal_px[i] * point[i] * inverse + camera.center_px[i]);
                return (point[2] > 1e-6).then_some((pixel, point[2]));
            }
            let pixel = camera.project(&Point3::from(point))?;
            Some(([pixel.x, pixel.y], point[2]))
        };
        let (low, near) = at(x, y)?;
        let (high, far) = at(x + 1, y + 1)?;
        Some((low, high, 0.5 * (near + far)))
    }
}

/// Marks the pixels whose centres lie between two corners, at least the one that holds the middle.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn cover(nearest: &mut [f32], [width, height]: [usize; 2], low: [f64; 2], high: [f64; 2], z: f64) {
    let range = |i: usize, size: usize| {
        let (from, to) = (low[i].min(high[i]), low[i].max(high[i]));
        let middle = 0.5 * (from + to);
        if !(middle >= 0.0 && middle < size as f64) {
            return None;
        }
        let first = (from - 0.5).ceil().min(middle.floor()).max(0.0) as usize;
        let last = ((to - 0.5).ceil() - 1.0).max(middle.floor()) as usize;
        // A patch covers at most a few pixels; a larger one means an invalid camera file.
        Some((first, last.min(size - 1).min(first + 4)))
    };
    let (Some((left, right)), Some((top, bottom))) = (range(0, width), range(1, height)) else {
        return;
    };
    for y in top..=bottom {
        for slot in &mut nearest[y * width + left..=y * width + right] {
            *slot = slot.min(z as f32);
        }
    }
}

fn fill_cracks(nearest: &mut [f32], width: usize) {
    let height = nearest.len() / width;
    // Collected first: a filled pixel must not support the next one.
    let mut fills = Vec::new();
    for y in 1..height.saturating_sub(1) {
        for x in 1..width - 1 {
            let at = y * width + x;
            if nearest[at].is_finite() {
                continue;
            }
            let (mut count, mut sum) = (0_usize, 0.0_f64);
            let (mut low, mut high) = (f64::INFINITY, 0.0_f64);
            for row in [at - width, at, at + width] {
                for &value in &nearest[row - 1..=row + 1] {
                    if value.is_finite() {
                        let value = f64::from(value);
                        count += 1;
                        sum += value;
                        low = low.min(value);
                        high = high.max(value);
                    }
                }
            }
            if count >= NEIGHBOURS_MIN && high - low < AGREE * low {
                #[allow(clippy::cast_possible_truncation)]
                fills.push((at, (sum / count as f64) as f32));
            }
        }
    }
    for (at, value) in fills {
        nearest[at] = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Cameras;
    use nalgebra::Isometry3;

    fn camera(focal: f64) -> Camera {
        Camera {
            size_px: [64, 48],
            focal_px: [focal; 2],
            center_px: [32.0, 24.0],
            distortion: [0.0; 5],
        }
    }

    /// A wall 0.5 m away with a step: the right half is 0.4 m away.
    fn frame(color_focal: f64, shift_m: f64) -> Frame {
        let mut steps = Image::filled(64, 48, 5000_u16);
        for y in 0..48 {
            for x in 32..64 {
                steps.set(x, y, 4000);
            }
        }
        Frame {
            color: RgbImage::filled(64, 48, [0; 3]),
            depth: DepthImage {
                steps,
                unit_m: 1e-4,
            },
            cameras: Cameras {
                color: camera(color_focal),
                depth: camera(50.0),
                color_from_depth: Isometry3::translation(shift_m, 0.0, 0.0),
            },
        }
    }

    #[test]
    fn the_same_camera_sees_the_same() {
        let frame = frame(50.0, 0.0);
        assert_eq!(align(&frame).depth, frame.depth);
    }

    #[test]
    fn a_finer_colour_camera_gets_no_cracks() {
        let aligned = align(&frame(70.0, 0.0));
        assert!((aligned.depth.measured_share() - 1.0).abs() < 1e-12);
        assert_eq!(aligned.depth.depth_m(20, 20), Some(0.5));
        assert_eq!(aligned.depth.depth_m(40, 20), Some(0.4));
    }

    #[test]
    fn beside_an_edge_nothing_is_made_up() {
        // The colour camera 20 mm to the left: points move right, the near half by 2.5 px, the far
        // half by 2; nearer surface hides, or an open strip stays unknown.
        let aligned = align(&frame(50.0, 0.2));
        let row: Vec<_> = (0..64).map(|x| aligned.depth.depth_m(x, 20)).collect();
        assert!(row[0].is_none(), "left of what was seen nothing is known");
        assert_eq!(row[30], Some(0.5));
        let unknown = row[50..58].iter().filter(|value| value.is_none()).count();
        assert!(
            unknown >= 4,
            "the strip behind the step is unknown: {unknown}"
        );
        assert_eq!(row[60], Some(0.4));
    }
}
