//! The colour picture.

use super::frame::Frame;
use super::lens::Lens;
use super::noise::RowNoise;
use super::scene::Scene;
use super::tracer::{Seen, Tracer};
use crate::plant::vec3::{axpy, sub};
use rayon::prelude::*;

/// Effects of lens and sensor on the light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optics {
    /// Standard deviation of the lens's blur, px.
    pub blur_px: f64,
    /// Noise in the dark, grey values.
    pub read_noise: f64,
    /// Variance of the noise per grey value of light.
    pub shot_noise: f64,
}

impl Default for Optics {
    fn default() -> Self {
        Self {
            blur_px: 0.6,
            read_noise: 1.0,
            shot_noise: 0.02,
        }
    }
}

/// A colour picture, rows from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColorPicture {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Red, green, blue.
    pub pixels: Vec<[u8; 3]>,
}

/// Rays for a pixel that an edge runs through. Their positions differ in every column and row.
const RAYS: usize = 36;
/// The same for a pixel of a sheet full of tags, most of whose pixels have an edge.
const RAYS_OF_ROWS: usize = 12;
/// Neighbours whose grey values differ by more than this have an edge between them.
const EDGE: f64 = 4.0;

/// The picture of a camera at `world_from_camera`.
#[must_use]
pub fn render_color(
    scene: &Scene,
    lens: &Lens,
    world_from_camera: &Frame,
    optics: &Optics,
    seed: u64,
) -> ColorPicture {
    let [width, height] = lens.size_px;
    let tracer = Tracer::new(scene, world_from_camera);
    let along = |u: f64, v: f64| world_from_camera.direction(lens.ray([u, v]));
    let look = |u: f64, v: f64| {
        let ray = lens.ray([u, v]);
        tracer.cast(ray).map_or(([0.0; 3], None), |hit| {
            let (color, lit) = tracer.shade(ray, &hit);
            let seen = Seen {
                body: hit.body,
                part: hit.part,
                lit,
            };
            (color, Some(seen))
        })
    };
    let (centers, met): (Vec<[f32; 3]>, Vec<_>) = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let (color, met) = look((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            (to_f32(color), met)
        })
        .unzip();
    // Steps without a common divisor with the count: each column and row is used once.
    let (offsets, few) = (offsets(RAYS, 13), offsets(RAYS_OF_ROWS, 5));
    let light: Vec<[f32; 3]> = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let (x, y) = (i % width, i / width);
            // Pixels without an edge need one ray: most of a picture.
            if !around(width, height, x, y).any(|other| apart(&centers[i], &centers[other])) {
                return centers[i];
            }
            // All neighbours show the same part under the same light: the edge is printed on it.
            let print =
                met[i].filter(|_| around(width, height, x, y).all(|other| met[other] == met[i]));
            if let Some(met) = print.filter(|met| tracer.is_rows(*met)) {
                // Within a pixel directions change evenly.
                let (u, v) = (x as f64, y as f64);
                let corner = along(u, v);
                let (right, down) = (
                    sub(along(u + 1.0, v), corner),
                    sub(along(u, v + 1.0), corner),
                );
                let rays = few
                    .iter()
                    .map(|(dx, dy)| axpy(axpy(corner, *dx, right), *dy, down));
                return to_f32(tracer.shade_on(rays, met));
            }
            let mut sum = [0.0; 3];
            for (dx, dy) in &offsets {
                let (u, v) = (x as f64 + dx, y as f64 + dy);
                let ray = match print {
                    Some(met) => tracer.shade_on(std::iter::once(along(u, v)), met),
                    None => look(u, v).0,
                };
                for (sum, value) in sum.iter_mut().zip(ray) {
                    *sum += value / RAYS as f64;
                }
            }
            to_f32(sum)
        })
        .collect();
    let light = blur(light, width, height, optics.blur_px);
    let mut pixels = vec![[0_u8; 3]; width * height];
    pixels
        .par_chunks_mut(width)
        .zip(light.par_chunks(width))
        .enumerate()
        .for_each(|(row, (out, light))| {
            let mut noise = RowNoise::new(seed ^ 0x636F_6C6F_7572, row);
            for (out, light) in out.iter_mut().zip(light) {
                for (out, &value) in out.iter_mut().zip(light) {
                    let value = f64::from(value);
                    // Photon noise grows with the light: sqrt(1 + 0.02 x 240) = 2.4 grey values
                    // near white.
                    let deviation = (optics.read_noise.powi(2) + optics.shot_noise * value).sqrt();
                    let seen = value + deviation * noise.normal();
                    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
                    let grey = seen.round().clamp(0.0, 255.0) as u8;
                    *out = grey;
                }
            }
        });
    ColorPicture {
        width,
        height,
        pixels,
    }
}

#[allow(clippy::cast_possible_truncation)]
fn to_f32(color: [f64; 3]) -> [f32; 3] {
    color.map(|value| value as f32)
}

/// Positions in a pixel: every `rays`-th of its width and height is used once (a rank-1 lattice).
fn offsets(rays: usize, step: usize) -> Vec<(f64, f64)> {
    let count = rays as f64;
    (0..rays)
        .map(|k| {
            let x = (k as f64 + 0.5) / count;
            let y = ((step * k % rays) as f64 + 0.5) / count;
            (x, y)
        })
        .collect()
}

/// A pixel and its neighbours.
fn around(width: usize, height: usize, x: usize, y: usize) -> impl Iterator<Item = usize> {
    let columns = x.saturating_sub(1)..=(x + 1).min(width - 1);
    let rows = y.saturating_sub(1)..=(y + 1).min(height - 1);
    rows.flat_map(move |row| columns.clone().map(move |column| row * width + column))
}

fn apart(one: &[f32; 3], other: &[f32; 3]) -> bool {
    (0..3).any(|c| f64::from((one[c] - other[c]).abs()) > EDGE)
}

/// Blurs along rows, then along columns.
fn blur(light: Vec<[f32; 3]>, width: usize, height: usize, deviation_px: f64) -> Vec<[f32; 3]> {
    if deviation_px < 0.05 {
        return light;
    }
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    // Three standard deviations hold 99.7 % of the weight.
    let reach = (3.0 * deviation_px).ceil() as usize;
    let weight = |k: usize| libm::exp(-0.5 * (k as f64 / deviation_px).powi(2));
    let total = weight(0) + 2.0 * (1..=reach).map(weight).sum::<f64>();
    #[allow(clippy::cast_possible_truncation)]
    let weights: Vec<f32> = (0..=reach).map(|k| (weight(k) / total) as f32).collect();
    let mix = |at: &(dyn Fn(isize) -> [f32; 3] + Sync)| {
        let mut sum = at(0).map(|value| value * weights[0]);
        for (k, weight) in weights.iter().enumerate().skip(1) {
            #[allow(clippy::cast_possible_wrap)]
            let k = k as isize;
            let (before, after) = (at(-k), at(k));
            for c in 0..3 {
                sum[c] += weight * (before[c] + after[c]);
            }
        }
        sum
    };
    let shift =
        |value: usize, by: isize, count: usize| value.saturating_add_signed(by).min(count - 1);
    let rows: Vec<[f32; 3]> = (0..light.len())
        .into_par_iter()
        .map(|i| {
            let (x, y) = (i % width, i / width);
            mix(&|by| light[y * width + shift(x, by, width)])
        })
        .collect();
    (0..rows.len())
        .into_par_iter()
        .map(|i| {
            let (x, y) = (i % width, i / width);
            mix(&|by| rows[shift(y, by, height) * width + x])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::Body;
    use super::*;

    fn lens() -> Lens {
        Lens {
            size_px: [64, 48],
            focal_px: [60.0; 2],
            center_px: [32.0, 24.0],
            distortion: [0.0; 5],
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_picture_and_another_another() {
        let scene = Scene {
            bodies: vec![Body::tag(1, 0.1, Frame::looking_down([0.0; 3]))],
            ..Scene::default()
        };
        let camera = Frame::looking_down([0.0, 0.0, 0.2]);
        let take = |seed| render_color(&scene, &lens(), &camera, &Optics::default(), seed);
        assert_eq!(take(1), take(1));
        assert_ne!(take(1), take(2));
    }

    #[test]
    fn an_edge_through_a_pixel_gives_its_share() {
        // The box's edge lies at x = 0.1 px right of a pixel's left side.
        let quiet = Optics {
            blur_px: 0.0,
            read_noise: 0.0,
            shot_noise: 0.0,
        };
        let half = 0.5;
        let edge_m = 4.1 / 60.0;
        let place = Frame::at([edge_m - half, 0.0, -0.01]);
        let scene = Scene {
            bodies: vec![Body::fixed_box(
                "half plane",
                [half, half, 0.01],
                place,
                [1.0; 3],
            )],
            ..Scene::default()
        };
        let camera = Frame::looking_down([0.0, 0.0, 1.0]);
        let picture = render_color(&scene, &lens(), &camera, &quiet, 1);
        let row = |x: usize| f64::from(picture.pixels[24 * 64 + x][0]);
        let share = row(36) / row(30);
        assert!((share - 0.1).abs() < 0.02, "{share}");
        assert_eq!(row(37), 0.0);
    }

    #[test]
    fn shadows_are_darker() {
        let white = [0.9; 3];
        let mut scene = Scene {
            bodies: vec![Body::fixed_box(
                "floor",
                [1.0, 1.0, 0.01],
                Frame::at([0.0, 0.0, -0.01]),
                white,
            )],
            ..Scene::default()
        };
        let camera = Frame::looking_down([0.0, 0.0, 1.0]);
        let take = |scene: &Scene| {
            let picture = render_color(scene, &lens(), &camera, &Optics::default(), 1);
            picture.pixels[24 * 64 + 32][1]
        };
        let lit = take(&scene);
        let high = Frame::at([0.5, -0.7, 1.8]);
        scene
            .bodies
            .push(Body::fixed_box("cover", [0.1, 0.1, 0.01], high, white));
        assert!(take(&scene) < lit / 2);
    }
}
