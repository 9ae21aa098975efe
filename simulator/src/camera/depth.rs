//! The picture of a stereo depth camera.

use super::frame::Frame;
use super::lens::Lens;
use super::noise::RowNoise;
use super::scene::Scene;
use super::tracer::Tracer;
use crate::plant::vec3::{add, axpy, norm, scale, sub};
use rayon::prelude::*;

/// Effects of stereo matching on distances. The default is close to a RealSense D415 with an
/// advanced depth unit of 0.1 mm; noise and steps are chosen to give its data sheet's scatter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stereo {
    /// Distance of the second imager, to the right of the first, m.
    pub baseline_m: f64,
    /// Scatter of the disparity from pixel to pixel, px.
    pub fine_noise_px: f64,
    /// Scatter of the disparity that neighbouring pixels share, px.
    pub coarse_noise_px: f64,
    /// Over how many pixels they share it.
    pub coarse_px: usize,
    /// Steps of the disparity, px.
    pub step_px: f64,
    /// Unit of the picture, m.
    pub unit_m: f64,
    /// Least and greatest distance, m.
    pub range_m: [f64; 2],
    /// Relative error of all distances.
    pub scale_error: f64,
}

impl Default for Stereo {
    fn default() -> Self {
        Self {
            baseline_m: 0.055,
            fine_noise_px: 0.04,
            coarse_noise_px: 0.05,
            coarse_px: 6,
            step_px: 1.0 / 32.0,
            unit_m: 1e-4,
            range_m: [0.15, 3.0],
            scale_error: 0.0,
        }
    }
}

/// A depth picture, rows from the top: distances along the camera's z, 0 where no distance is known.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthPicture {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Distances in units.
    pub steps: Vec<u16>,
    /// The unit, m.
    pub unit_m: f64,
}

/// The depth picture of a stereo camera whose first imager is at `world_from_camera`.
#[must_use]
pub(crate) fn render_depth(
    scene: &Scene,
    lens: &Lens,
    world_from_camera: &Frame,
    stereo: &Stereo,
    seed: u64,
) -> DepthPicture {
    let [width, height] = lens.size_px;
    let tracer = Tracer::new(scene, world_from_camera);
    let from = world_from_camera.position_m;
    let second = world_from_camera.point([stereo.baseline_m, 0.0, 0.0]);
    let coarse = Coarse::new(width, height, stereo, seed);
    let mut steps = vec![0_u16; width * height];
    steps
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(y, row)| {
            let mut noise = RowNoise::new(seed ^ 0x6465_7074_6800, y);
            for (x, out) in row.iter_mut().enumerate() {
                // Drawn whether or not they are used, so that one pixel does not change the others.
                let (fine, luck) = (noise.normal(), noise.uniform());
                let ray = lens.ray([x as f64 + 0.5, y as f64 + 0.5]);
                let along = world_from_camera.direction(ray);
                let Some(hit) = tracer.cast(ray) else {
                    continue;
                };
                let part = &tracer.scene().bodies[hit.body].parts[hit.part];
                if luck < part.drop_out {
                    continue;
                }
                // The ray's z is 1, so its parameter is the distance along the axis.
                let depth_m = hit.way;
                let point = axpy(from, depth_m, along);
                let to = sub(second, point);
                let way = norm(to);
                let seen = lens.pixel([
                    ray[0] * depth_m - stereo.baseline_m,
                    ray[1] * depth_m,
                    depth_m,
                ]);
                // 1 um off the surface: the ray must not meet the point it starts from.
                let start = add(point, scale(hit.normal, 1e-6));
                // Stereo needs both imagers: what the second cannot see has no distance.
                if !seen.is_some_and(|pixel| lens.holds(pixel))
                    || tracer.blocked(start, scale(to, 1.0 / way), 1e-6, way)
                {
                    continue;
                }
                let focal_baseline = lens.focal_px[0] * stereo.baseline_m;
                // f b / z: 607 px x 55 mm at 0.5 m are 66.8 px; a step of 1/32 px is then 0.23 mm.
                let disparity =
                    focal_baseline / depth_m + stereo.fine_noise_px * fine + coarse.at(x, y);
                let stepped = (disparity / stereo.step_px).round() * stereo.step_px;
                let measured_m = focal_baseline / stepped.max(1e-6) * (1.0 + stereo.scale_error);
                let [least, most] = stereo.range_m;
                if (least..most).contains(&measured_m) {
                    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
                    let value = (measured_m / stereo.unit_m).round().min(65_535.0) as u16;
                    *out = value;
                }
            }
        });
    DepthPicture {
        width,
        height,
        steps,
        unit_m: stereo.unit_m,
    }
}

/// Noise that neighbours share: random numbers on a coarse grid, linear between them.
struct Coarse {
    values: Vec<f64>,
    across: usize,
    spacing: usize,
}

impl Coarse {
    fn new(width: usize, height: usize, stereo: &Stereo, seed: u64) -> Self {
        let spacing = stereo.coarse_px.max(1);
        let (across, down) = (width / spacing + 2, height / spacing + 2);
        let values = (0..down)
            .flat_map(|row| {
                let mut noise = RowNoise::new(seed ^ 0x636F_6172_7365, row);
                // Linear mixing of four lowers the scatter to two thirds on the average.
                let size = 1.5 * stereo.coarse_noise_px;
                (0..across)
                    .map(|_| size * noise.normal())
                    .collect::<Vec<_>>()
            })
            .collect();
        Self {
            values,
            across,
            spacing,
        }
    }

    fn at(&self, x: usize, y: usize) -> f64 {
        let (column, row) = (x / self.spacing, y / self.spacing);
        let share = |value: usize| (value % self.spacing) as f64 / self.spacing as f64;
        let (fx, fy) = (share(x), share(y));
        let value = |dx: usize, dy: usize| self.values[(row + dy) * self.across + column + dx];
        (value(0, 0) * (1.0 - fx) + value(1, 0) * fx) * (1.0 - fy)
            + (value(0, 1) * (1.0 - fx) + value(1, 1) * fx) * fy
    }
}

#[cfg(test)]
mod tests {
    use super::super::Body;
    use super::*;

    fn lens() -> Lens {
        Lens {
            size_px: [160, 120],
            focal_px: [150.0; 2],
            center_px: [80.0, 60.0],
            distortion: [0.0; 5],
        }
    }

    fn floor_and_block() -> Scene {
        let grey = [0.5; 3];
        let floor = Frame::at([0.0, 0.0, -0.01]);
        let block = Frame::at([0.0, 0.0, 0.05]);
        Scene {
            bodies: vec![
                Body::fixed_box("floor", [1.0, 1.0, 0.01], floor, grey),
                Body::fixed_box("block", [0.03, 0.03, 0.05], block, grey),
            ],
            ..Scene::default()
        }
    }

    #[test]
    fn distances_are_right_within_the_noise_and_shadows_have_none() {
        let camera = Frame::looking_down([0.0, 0.0, 0.4]);
        let picture = render_depth(&floor_and_block(), &lens(), &camera, &Stereo::default(), 3);
        let at = |x: usize, y: usize| f64::from(picture.steps[y * 160 + x]) * picture.unit_m;
        assert!((at(80, 60) - 0.3).abs() < 0.01, "{}", at(80, 60));
        assert!((at(80, 20) - 0.4).abs() < 0.02, "{}", at(80, 20));
        // The second imager is on the right and sees less of the floor left of the block.
        let (mut left, mut right) = (0, 0);
        for x in 20..80 {
            left += usize::from(at(x, 60) == 0.0);
            right += usize::from(at(159 - x, 60) == 0.0);
        }
        assert!(left >= 3 && right == 0, "{left} {right}");
    }

    #[test]
    fn the_scatter_is_that_of_the_disparity() {
        let camera = Frame::looking_down([0.0, 0.0, 0.4]);
        let scene = Scene {
            bodies: floor_and_block().bodies[..1].to_vec(),
            ..Scene::default()
        };
        let stereo = Stereo::default();
        let picture = render_depth(&scene, &lens(), &camera, &stereo, 9);
        let seen: Vec<f64> = picture
            .steps
            .iter()
            .filter(|&&steps| steps > 0)
            .map(|&steps| f64::from(steps) * picture.unit_m - 0.4)
            .collect();
        let deviation = (seen.iter().map(|v| v * v).sum::<f64>() / seen.len() as f64).sqrt();
        // z^2 / (f b) per px of disparity.
        let noise_px = stereo.fine_noise_px.hypot(stereo.coarse_noise_px);
        let expected = 0.16 / (150.0 * 0.055) * noise_px;
        assert!(
            (deviation / expected - 1.0).abs() < 0.15,
            "{deviation} {expected}"
        );
    }
}
