//! Heights over the ground, seen straight from above whatever the camera's attitude.

use super::{Hand, NoGrasp};
use crate::align::Aligned;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, Vector2, Vector3};

/// Side of a cell, m.
const CELL_M: f64 = 0.001;
/// Share of the distances that the ground must hold.
const GROUND_SHARE: f64 = 0.2;
/// Points closer to a plane than this share of the distance belong to it.
const NEAR: f64 = 0.004;
/// Pixels between the points that vote for a plane.
const VOTE_STEP: usize = 9;
/// Planes that are tried.
const TRIES: usize = 48;
/// Heights beyond this are no objects in a tray, m.
const HIGHEST_M: f64 = 0.25;
/// Largest map, cells.
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
    /// Grey values seen there.
    grey: Vec<[u8; 3]>,
}

/// How low a tool can go, and what it then holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// Least height of the tool point over the ground with the open fingers clear, m.
    pub height_m: f64,
    /// Height of the contact on the pad that has less of it, m.
    pub engaged_m: f64,
    /// Distance between the pads when closed, m.
    pub width_m: f64,
    /// Middle between the edges, away from the tool point along the closing direction, m.
    pub off_m: f64,
    /// Share of the contacts whose colour is not that of the others: of another thing, perhaps.
    pub other: f64,
}

impl HeightMap {
    /// Side of a cell, m.
    pub const CELL_M: f64 = CELL_M;

    /// Finds the ground and maps what stands on it.
    ///
    /// # Errors
    /// [`NoGrasp::NoDepth`], [`NoGrasp::NoPlane`].
    pub fn new(picture: &Aligned) -> Result<Self, NoGrasp> {
        let share = picture.depth.measured_share();
        if share < 0.1 {
            return Err(NoGrasp::NoDepth { share });
        }
        let rays = rays(picture);
        let camera_from_map = ground(picture, &rays)?;
        Ok(Self::project(picture, &rays, camera_from_map))
    }

    fn project(picture: &Aligned, rays: &[[f32; 2]], camera_from_map: Isometry3<f64>) -> Self {
        let map_from_camera = camera_from_map.inverse();
        // The map covers what the picture's corners see of the ground.
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let (width, height) = (picture.camera.size_px[0], picture.camera.size_px[1]);
        for at in [0, width - 1, (height - 1) * width, height * width - 1] {
            let ray = Vector3::new(f64::from(rays[at][0]), f64::from(rays[at][1]), 1.0);
            let along = map_from_camera.rotation * ray;
            let from = map_from_camera.translation.vector;
            let way = -from.z / along.z.min(-1e-6);
            for i in 0..2 {
                let value = from[i] + way.clamp(0.0, 5.0) * along[i];
                low[i] = low[i].min(value);
                high[i] = high[i].max(value);
            }
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let size =
            [0, 1].map(|i| (((high[i] - low[i]) / CELL_M).ceil() as usize).clamp(1, CELLS_MAX));
        // A larger view is cut about its middle.
        let corner_m = [0, 1].map(|i| 0.5 * (low[i] + high[i]) - 0.5 * size[i] as f64 * CELL_M);
        let unknown = f32::NEG_INFINITY;
        let mut map = Self {
            camera_from_map,
            size,
            corner_m,
            heights_m: vec![unknown; size[0] * size[1]],
            grey: vec![[0; 3]; size[0] * size[1]],
        };
        #[allow(clippy::cast_possible_truncation)]
        let turn: Matrix3<f32> = map_from_camera
            .rotation
            .to_rotation_matrix()
            .matrix()
            .map(|value| value as f32);
        #[allow(clippy::cast_possible_truncation)]
        let shift: Vector3<f32> = map_from_camera.translation.vector.map(|value| value as f32);
        #[allow(clippy::cast_possible_truncation)]
        let (unit, cell, corner) = (
            picture.depth.unit_m as f32,
            1.0 / CELL_M as f32,
            corner_m.map(|value| value as f32),
        );
        let pixels = picture.depth.steps.pixels().iter().zip(rays);
        for ((&steps, ray), color) in pixels.zip(picture.color.pixels()) {
            if steps == 0 {
                continue;
            }
            let z = f32::from(steps) * unit;
            let p = turn * Vector3::new(ray[0] * z, ray[1] * z, z) + shift;
            let (x, y) = ((p.x - corner[0]) * cell, (p.y - corner[1]) * cell);
            if !(x >= 0.0 && y >= 0.0 && f64::from(p.z) < HIGHEST_M) {
                continue;
            }
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            let (column, row) = (x as usize, y as usize);
            if column < size[0] && row < size[1] {
                let at = row * size[0] + column;
                if p.z > map.heights_m[at] {
                    map.heights_m[at] = p.z;
                    map.grey[at] = *color;
                }
            }
        }
        map.fill();
        map.smooth();
        map
    }

    /// Unknown cells get the lowest of the nearest known heights in the four directions: a shadow
    /// gets the ground behind it, a hole in an object the object's height.
    fn fill(&mut self) {
        let [width, height] = self.size;
        let mut lowest = vec![f32::INFINITY; self.heights_m.len()];
        let mut sweep = |start: usize, step: isize, count: usize, heights: &[f32]| {
            let (mut at, mut last) = (start, f32::INFINITY);
            for _ in 0..count {
                if heights[at] > f32::NEG_INFINITY {
                    last = heights[at];
                } else {
                    lowest[at] = lowest[at].min(last);
                }
                at = at.wrapping_add_signed(step);
            }
        };
        let down = isize::try_from(width).unwrap_or(1);
        for row in 0..height {
            sweep(row * width, 1, width, &self.heights_m);
            sweep(row * width + width - 1, -1, width, &self.heights_m);
        }
        for column in 0..width {
            sweep(column, down, height, &self.heights_m);
            sweep(
                (height - 1) * width + column,
                -down,
                height,
                &self.heights_m,
            );
        }
        for (value, low) in self.heights_m.iter_mut().zip(lowest) {
            if *value == f32::NEG_INFINITY {
                *value = if low.is_finite() { low } else { 0.0 };
            }
        }
    }

    /// The median of each cell and its neighbours above, below, left and right takes noise away
    /// and leaves edges.
    fn smooth(&mut self) {
        let width = self.size[0];
        let old = self.heights_m.clone();
        for at in width..old.len().saturating_sub(width) {
            let five = [
                old[at],
                old[at - 1],
                old[at + 1],
                old[at - width],
                old[at + width],
            ];
            self.heights_m[at] = median_of_5(five);
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
        [column, row]
            .iter()
            .zip(self.corner_m)
            .map(|(&cell, corner)| corner + (cell as f64 + 0.5) * CELL_M)
            .collect::<Vec<_>>()
            .try_into()
            .unwrap_or([0.0; 2])
    }

    /// Where the thing at a place begins and ends along a direction at heights over `level_m`:
    /// ways from the place against and along the direction, m. `None` where the place itself is
    /// lower; infinite ends beyond `reach_m`.
    pub(super) fn extent(
        &self,
        at: [f64; 2],
        way: [f64; 2],
        level_m: f64,
        reach_m: f64,
    ) -> Option<[f64; 2]> {
        if self.height_m(at[0], at[1]) <= level_m {
            return None;
        }
        let walk = |sign: f64| {
            let mut s = 0.0;
            while s < reach_m {
                s += CELL_M * 0.5;
                let (x, y) = (at[0] + sign * s * way[0], at[1] + sign * s * way[1]);
                if self.height_m(x, y) <= level_m {
                    return s - CELL_M * 0.25;
                }
            }
            f64::INFINITY
        };
        Some([walk(-1.0), walk(1.0)])
    }

    /// Lowers a tool straight down at a place until its open fingers, with their shafts, are
    /// `hand.margin_m` over what is below, or as far as is best, and closes it. `map_from_tool` has the tool's attitude (z up along the
    /// fingers, jaws along y) and place; only its height is not used. `None` where the pads then
    /// hold nothing.
    #[must_use]
    pub fn fit(&self, hand: &Hand, map_from_tool: &Isometry3<f64>) -> Option<Fit> {
        let place = map_from_tool.translation.vector;
        let half = hand.opening_m / 2.0;
        let mut height_m = hand.below_m + hand.margin_m;
        // Fingers lean with the tool: higher up they stand elsewhere than their tips.
        let finger = |x: f64, y: f64, z: f64| map_from_tool.rotation * Vector3::new(x, y, z);
        let long_m = hand.below_m + hand.shaft_m;
        for side in [-1.0, 1.0] {
            for i in 0..5 {
                let reach = hand.pad_half_width_m + SIDEWAYS_M;
                let x = reach * (f64::from(i) / 2.0 - 1.0);
                for j in 0..6 {
                    let wide_m = hand.finger_m + 2.0 * SIDEWAYS_M;
                    let y = half - SIDEWAYS_M + wide_m * f64::from(j) / 5.0;
                    for k in 0..6 {
                        let z = long_m * f64::from(k) / 5.0 - hand.below_m;
                        let arm = finger(x, side * y, z);
                        let ground = self.height_m(place.x + arm.x, place.y + arm.y);
                        height_m = height_m.max(ground + hand.margin_m - arm.z);
                    }
                }
            }
        }
        // Higher up the pads may hold more: over a foot that they would meet first, or beside the
        // upper of two things.
        let mut best: Option<Fit> = None;
        for step in 0..LIFTS {
            let lifted_m = height_m + f64::from(step) * LIFT_M;
            let mut at = *map_from_tool;
            at.translation.vector.z = lifted_m;
            let Some(fit) = self.close(hand, &at) else {
                continue;
            };
            let enough = |fit: &Fit| fit.engaged_m.min(ENOUGH_M) - OTHER_M * fit.other;
            if best.is_none_or(|best| enough(&fit) >= enough(&best)) {
                best = Some(fit);
            }
        }
        best
    }

    /// What the pads meet when they close at a place: every patch of a pad goes inwards until the
    /// map is higher than it.
    fn close(&self, hand: &Hand, map_from_tool: &Isometry3<f64>) -> Option<Fit> {
        let half = hand.opening_m / 2.0;
        let rise = (hand.below_m + hand.above_m) / f64::from(PATCHES_UP);
        let inward = map_from_tool.rotation * Vector3::y();
        let mut ways = [f64::INFINITY; 2];
        let mut met: Vec<(usize, u32, f64, [f64; 2])> = Vec::new();
        for (side, sign) in [(0, -1.0), (1, 1.0)] {
            for row in 0..PATCHES_UP {
                let z = (f64::from(row) + 0.5) * rise - hand.below_m;
                for column in 0..5 {
                    let x = hand.pad_half_width_m * (f64::from(column) / 2.0 - 1.0);
                    let start = map_from_tool * Point3::new(x, sign * half, z);
                    let mut way = 0.0;
                    while way < hand.opening_m {
                        let p = start - inward * (sign * way);
                        if self.height_m(p.x, p.y) > p.z + NOISE_M {
                            let inside = p - inward * (sign * INSIDE_M);
                            met.push((side, row, way, [inside.x, inside.y]));
                            ways[side] = ways[side].min(way);
                            break;
                        }
                        way += CELL_M * 0.5;
                    }
                }
            }
        }
        let [left, right] = ways;
        let width_m = hand.opening_m - left - right;
        if width_m <= 0.0 {
            return None;
        }
        met.retain(|(side, _, way, _)| *way <= ways[*side] + SAME_WALL_M);
        let engaged = |wanted: usize| {
            let mut rows: Vec<u32> = met
                .iter()
                .filter(|(side, ..)| *side == wanted)
                .map(|(_, row, ..)| *row)
                .collect();
            rows.sort_unstable();
            rows.dedup();
            rows.len() as f64 * rise
        };
        let colors: Vec<[f64; 3]> = met.iter().map(|(.., [x, y])| self.color(*x, *y)).collect();
        let mut mean = [0.0; 3];
        for color in &colors {
            for (mean, value) in mean.iter_mut().zip(color) {
                *mean += value / colors.len() as f64;
            }
        }
        let apart = |color: &&[f64; 3]| {
            let sum: f64 = color.iter().zip(&mean).map(|(a, b)| (a - b).abs()).sum();
            sum > OTHER_COLOR
        };
        Some(Fit {
            height_m: map_from_tool.translation.vector.z,
            engaged_m: engaged(0).min(engaged(1)),
            width_m,
            off_m: 0.5 * (left - right),
            other: colors.iter().filter(apart).count() as f64 / colors.len().max(1) as f64,
        })
    }
}

/// Heights that are tried over the lowest, and their distance, m.
const LIFTS: u32 = 11;
const LIFT_M: f64 = 0.002;
/// More than this on the pads is no better, m: deeper down there may be another thing.
const ENOUGH_M: f64 = 0.0125;
/// A grip whose contacts all have another colour is as bad as one with so much less on the pads, m.
const OTHER_M: f64 = 0.02;
/// Patches of a pad, up.
const PATCHES_UP: u32 = 12;
/// What is less than this over a patch is noise of the map, m.
const NOISE_M: f64 = 0.001;
/// Walls this much behind the first contact are met with it, m: cells and their noise.
const SAME_WALL_M: f64 = 0.0012;
/// Colours are looked at so far inside a wall, m.
const INSIDE_M: f64 = 0.002;
/// Colours further apart than this are of two things (sum of three differences).
const OTHER_COLOR: f64 = 60.0;
/// Room beside a finger for what the tool is off, m.
const SIDEWAYS_M: f64 = 0.0015;

fn median_of_5(mut values: [f32; 5]) -> f32 {
    let mut order = |a: usize, b: usize| {
        let (low, high) = (values[a].min(values[b]), values[a].max(values[b]));
        (values[a], values[b]) = (low, high);
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

/// Directions x/z, y/z of all pixels.
fn rays(picture: &Aligned) -> Vec<[f32; 2]> {
    let camera = &picture.camera;
    let [width, height] = camera.size_px;
    let mut rays = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let pixel = Vector2::new(x as f64 + 0.5, y as f64 + 0.5);
            let direction = camera.direction(&pixel);
            #[allow(clippy::cast_possible_truncation)]
            rays.push([direction.x as f32, direction.y as f32]);
        }
    }
    rays
}

/// The plane that holds most distances. In inverse distance a plane is linear in the directions,
/// 1/z = a x + b y + c, and the noise of a stereo camera is the same everywhere.
fn ground(picture: &Aligned, rays: &[[f32; 2]]) -> Result<Isometry3<f64>, NoGrasp> {
    let width = picture.camera.size_px[0];
    let points: Vec<Vector3<f64>> = (VOTE_STEP / 2..picture.camera.size_px[1])
        .step_by(VOTE_STEP)
        .flat_map(|y| {
            (VOTE_STEP / 2..width)
                .step_by(VOTE_STEP)
                .map(move |x| (x, y))
        })
        .filter_map(|(x, y)| {
            let depth_m = picture.depth.depth_m(x, y)?;
            let [rx, ry] = rays[y * width + x].map(f64::from);
            Some(Vector3::new(rx, ry, 1.0 / depth_m))
        })
        .collect();
    let near = |plane: &Vector3<f64>, p: &Vector3<f64>| {
        let on = plane.x * p.x + plane.y * p.y + plane.z;
        (on - p.z).abs() < NEAR * p.z
    };
    let mut best = (0, Vector3::zeros());
    // A fixed sequence of triples: the same picture gives the same plane.
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut draw = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let high = usize::try_from(state >> 33).unwrap_or(0);
        high % points.len().max(1)
    };
    for _ in 0..TRIES {
        let three = [draw(), draw(), draw()].map(|i| points.get(i).copied().unwrap_or_default());
        if let Some(plane) = through(&three) {
            let count = points.iter().filter(|p| near(&plane, p)).count();
            if count > best.0 {
                best = (count, plane);
            }
        }
    }
    let share = best.0 as f64 / points.len().max(1) as f64;
    if share < GROUND_SHARE || points.len() < 50 {
        return Err(NoGrasp::NoPlane {
            best: share,
            wanted: GROUND_SHARE,
        });
    }
    let mut plane = best.1;
    for _ in 0..3 {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for p in points.iter().filter(|p| near(&plane, p)) {
            let row = Vector3::new(p.x, p.y, 1.0);
            normal += row * row.transpose();
            right += row * p.z;
        }
        if let Some(inverse) = normal.try_inverse() {
            plane = inverse * right;
        }
    }
    frame_of(&plane).ok_or(NoGrasp::NoPlane {
        best: share,
        wanted: GROUND_SHARE,
    })
}

fn through(three: &[Vector3<f64>; 3]) -> Option<Vector3<f64>> {
    let rows = Matrix3::from_rows(&three.map(|p| Vector3::new(p.x, p.y, 1.0).transpose()));
    if rows.determinant().abs() < 1e-4 {
        return None;
    }
    Some(rows.try_inverse()? * Vector3::new(three[0].z, three[1].z, three[2].z))
}

/// camera_from_map of a plane a x + b y + c = 1/z, that is a X + b Y + c Z = 1.
fn frame_of(plane: &Vector3<f64>) -> Option<Isometry3<f64>> {
    if plane.z < 1e-3 {
        return None;
    }
    let up = -plane / plane.norm();
    let origin = Vector3::new(0.0, 0.0, 1.0 / plane.z);
    let x = (Vector3::x() - up * up.x).normalize();
    let rotation = Matrix3::from_columns(&[x, up.cross(&x), up]);
    Some(Isometry3::from_parts(
        Translation3::from(origin),
        Rotation3::from_matrix_unchecked(rotation).into(),
    ))
}

impl HeightMap {
    /// A point of the map's frame in the camera's, m.
    #[must_use]
    pub fn to_camera(&self, x_m: f64, y_m: f64, z_m: f64) -> Point3<f64> {
        self.camera_from_map * Point3::new(x_m, y_m, z_m)
    }
}
