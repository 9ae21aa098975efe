//! Grasps on opposite edges of a map of heights.
//!
//! At places all over what stands on the ground, for directions all around, the jaws are lowered
//! in thought: at some level of the finger tips the thing under the tool has two ends within the
//! opening, both ends are walls (the same a few millimetres higher up), the walls face the pads,
//! and the fingers have room beside them. Parts that touch or lie on each other need no outlines
//! of their own for that: an upper part ends where its height does, and a neighbour takes the
//! room of a finger.

use super::map::HeightMap;
use super::{Closing, Detector, Grasp, Hand, NoGrasp, Wanted};
use crate::align::Aligned;
use nalgebra::{Point3, Vector3};
use std::f64::consts::PI;

/// The default detector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Antipodal {
    /// Least height of an object over the ground, m.
    pub least_height_m: f64,
    /// Distance between the places that are tried, cells.
    pub spacing: usize,
    /// Directions that are tried over half a turn.
    pub directions: u32,
    /// Most grasps that are given.
    pub most: usize,
}

impl Default for Antipodal {
    fn default() -> Self {
        Self {
            least_height_m: 0.008,
            spacing: 5,
            directions: 16,
            most: 24,
        }
    }
}

/// Heights up to this are the ground's noise, m.
const GROUND_NOISE_M: f64 = 0.0025;
/// Contact on the pads below this is no grip, m.
const ENGAGED_MIN_M: f64 = 0.008;
/// Everything beside the grasp must be this much below the finger tips, m: the noise of heights.
const BELOW_TIP_M: f64 = 0.0015;
/// Walls must be the same this much higher up, m.
const WALL_M: f64 = 0.0075;
/// By how much an end may move over that height, m.
const WALL_SLACK_M: f64 = 0.0025;
/// Fingers reach this far down beside an object, measured from its top, m. What overhangs is not
/// seen from above: deeper than the pads are high they might close below it.
const DEPTHS_M: [f64; 3] = [0.021, 0.016, 0.011];
/// Colours further apart than this at the two pads are of two things (sum of three differences).
const OTHER_COLOR: f64 = 90.0;
/// Jaws that are tried in thought to tell a wide object from a crowded one, m.
const WIDEST_M: f64 = 0.2;
/// What is thinner than this may be a rod; twice as thick it holds all the same, m.
const THIN_M: f64 = 0.006;
/// Fully centred within this distance, m.
const CENTER_M: f64 = 0.02;

struct Candidate {
    place: [f64; 2],
    way: [f64; 2],
    tip_m: f64,
    top_m: f64,
    width_m: f64,
    clearance_m: f64,
    slope_rad: f64,
}

impl Detector for Antipodal {
    fn name(&self) -> String {
        "antipodal edges in the depth picture".to_owned()
    }

    fn detect(&mut self, picture: &Aligned, wanted: &Wanted) -> Result<Vec<Grasp>, NoGrasp> {
        let map = HeightMap::new(picture)?;
        self.detect_in(&map, picture, wanted)
    }
}

impl Antipodal {
    /// As [`Detector::detect`], in a map that is there already.
    ///
    /// # Errors
    /// Why there is no grasp.
    pub fn detect_in(
        &self,
        map: &HeightMap,
        picture: &Aligned,
        wanted: &Wanted,
    ) -> Result<Vec<Grasp>, NoGrasp> {
        let hand = &wanted.hand;
        let regions = Regions::new(map, self.least_height_m, &inside(map, wanted));
        if regions.sizes.iter().all(|size| size.cells < LEAST_CELLS) {
            return Err(NoGrasp::Empty);
        }
        let ways = self.ways(map, &wanted.closing);
        let mut ranked: Vec<(f64, Candidate)> = Vec::new();
        for row in (0..map.size[1]).step_by(self.spacing) {
            for column in (0..map.size[0]).step_by(self.spacing) {
                let label = regions.labels[row * map.size[0] + column];
                let Some(region) = regions.of(label) else {
                    continue;
                };
                let place = map.middle_m(column, row);
                for &way in &ways {
                    let found = candidate(map, hand, place, way);
                    let Some(found) = found else { continue };
                    let quality = quality(map, hand, &found, region);
                    if quality > 0.02 {
                        ranked.push((quality, found));
                    }
                }
            }
        }
        if ranked.is_empty() {
            return Err(self.why_none(map, picture, wanted));
        }
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut kept: Vec<(f64, Candidate)> = Vec::new();
        for (quality, found) in ranked {
            let alike = |other: &Candidate| {
                let apart =
                    (other.place[0] - found.place[0]).hypot(other.place[1] - found.place[1]);
                let turn = (other.way[0] * found.way[0] + other.way[1] * found.way[1]).abs();
                apart < 0.008 && turn > 0.85
            };
            if kept.len() < self.most && !kept.iter().any(|(_, other)| alike(other)) {
                kept.push((quality, found));
            }
        }
        Ok(kept
            .into_iter()
            .filter_map(|(quality, found)| to_grasp(map, picture, hand, quality, &found))
            .collect())
    }

    /// Whether wider jaws would find something.
    fn why_none(&self, map: &HeightMap, picture: &Aligned, wanted: &Wanted) -> NoGrasp {
        let fits_m = wanted.hand.opening_m - 2.0 * wanted.hand.margin_m;
        if wanted.hand.opening_m >= WIDEST_M {
            return NoGrasp::NoRoom;
        }
        let hand = Hand {
            opening_m: WIDEST_M,
            ..wanted.hand
        };
        let found = self.detect_in(map, picture, &Wanted { hand, ..*wanted });
        let widths = found.iter().flatten().map(|grasp| grasp.width_m);
        match widths.reduce(f64::min) {
            Some(narrowest_m) if narrowest_m > fits_m => NoGrasp::TooWide {
                narrowest_mm: narrowest_m * 1e3,
                opening_mm: fits_m * 1e3,
            },
            _ => NoGrasp::NoRoom,
        }
    }

    /// Closing directions in the map's plane.
    fn ways(&self, map: &HeightMap, closing: &Closing) -> Vec<[f64; 2]> {
        match closing {
            Closing::Any => (0..self.directions)
                .map(|k| {
                    let (s, c) = (PI * f64::from(k) / f64::from(self.directions)).sin_cos();
                    [c, s]
                })
                .collect(),
            Closing::Along(direction) => {
                let along = map.camera_from_map.rotation.inverse() * direction;
                let size = along.x.hypot(along.y).max(1e-9);
                vec![[along.x / size, along.y / size]]
            }
        }
    }
}

/// Which cells of the map lie in the area.
fn inside(map: &HeightMap, wanted: &Wanted) -> Vec<bool> {
    let [width, height] = map.size;
    let Some(area) = &wanted.area else {
        return vec![true; width * height];
    };
    let area_from_map = area.camera_from_area.inverse() * map.camera_from_map;
    let step = |i: usize, j: usize| {
        let [x, y] = map.middle_m(i, j);
        area_from_map * Point3::new(x, y, 0.0)
    };
    // Linear in the cells: three corners give all.
    let (origin, right, down) = (step(0, 0), step(1, 0), step(0, 1));
    let (right, down) = (right - origin, down - origin);
    (0..width * height)
        .map(|at| {
            let (i, j) = ((at % width) as f64, (at / width) as f64);
            let x = origin.x + i * right.x + j * down.x;
            let y = origin.y + i * right.y + j * down.y;
            x.abs() < area.half_m[0] && y.abs() < area.half_m[1]
        })
        .collect()
}

/// Regions with fewer cells are noise.
const LEAST_CELLS: usize = 40;

struct Region {
    cells: usize,
    middle: [f64; 2],
}

struct Regions {
    labels: Vec<u32>,
    sizes: Vec<Region>,
}

impl Regions {
    /// Connected cells over the least height.
    fn new(map: &HeightMap, least_m: f64, inside: &[bool]) -> Self {
        let [width, height] = map.size;
        let mut labels = vec![0_u32; width * height];
        let mut sizes = Vec::new();
        let mut stack = Vec::new();
        #[allow(clippy::cast_possible_truncation)]
        let least = least_m as f32;
        for start in 0..labels.len() {
            if labels[start] != 0 || map.heights()[start] <= least || !inside[start] {
                continue;
            }
            let label = u32::try_from(sizes.len() + 1).unwrap_or(u32::MAX);
            let (mut cells, mut sum) = (0_usize, [0.0; 2]);
            labels[start] = label;
            stack.push(start);
            while let Some(at) = stack.pop() {
                let (x, y) = (at % width, at / width);
                cells += 1;
                sum[0] += x as f64;
                sum[1] += y as f64;
                let neighbours = [
                    (x > 0).then(|| at - 1),
                    (x + 1 < width).then_some(at + 1),
                    (y > 0).then(|| at - width),
                    (y + 1 < height).then_some(at + width),
                ];
                for next in neighbours.into_iter().flatten() {
                    if labels[next] == 0 && map.heights()[next] > least && inside[next] {
                        labels[next] = label;
                        stack.push(next);
                    }
                }
            }
            let middle =
                [0, 1].map(|i| map.corner_m[i] + (sum[i] / cells as f64 + 0.5) * HeightMap::CELL_M);
            sizes.push(Region { cells, middle });
        }
        Self { labels, sizes }
    }

    fn of(&self, label: u32) -> Option<&Region> {
        let index = usize::try_from(label).ok()?.checked_sub(1)?;
        self.sizes.get(index).filter(|r| r.cells >= LEAST_CELLS)
    }
}

fn along(place: [f64; 2], way: [f64; 2], s: f64) -> [f64; 2] {
    [place[0] + s * way[0], place[1] + s * way[1]]
}

/// The best level for the finger tips at a place and direction, if there is one.
fn candidate(map: &HeightMap, hand: &Hand, place: [f64; 2], way: [f64; 2]) -> Option<Candidate> {
    let top_m = map.height_m(place[0], place[1]);
    let fits_m = hand.opening_m - 2.0 * hand.margin_m;
    let mut tried_m = f64::NAN;
    for depth_m in DEPTHS_M {
        let tip_m = (top_m - depth_m).max(hand.margin_m);
        if tip_m == tried_m || top_m - tip_m < ENGAGED_MIN_M {
            continue;
        }
        tried_m = tip_m;
        let level_m = tip_m - BELOW_TIP_M;
        let ends = map.extent(place, way, level_m, hand.opening_m)?;
        let width_m = ends[0] + ends[1];
        if width_m > fits_m || width_m < 0.003 {
            continue;
        }
        // From here on about the middle between the ends.
        let middle = along(place, way, 0.5 * (ends[1] - ends[0]));
        let half = width_m / 2.0;
        let upper = map.extent(place, way, level_m + WALL_M, hand.opening_m);
        let is_wall = upper.is_some_and(|upper| {
            (upper[0] - ends[0]).abs() < WALL_SLACK_M && (upper[1] - ends[1]).abs() < WALL_SLACK_M
        });
        if !is_wall {
            continue;
        }
        if !has_room(map, hand, middle, way, level_m, half) {
            continue;
        }
        let slope_rad = slope(map, hand, middle, way, level_m, half)?;
        if slope_rad > hand.slope_max_rad {
            continue;
        }
        return Some(Candidate {
            place: middle,
            way,
            tip_m,
            top_m,
            width_m,
            clearance_m: hand.opening_m / 2.0 - half,
            slope_rad,
        });
    }
    None
}

/// Whether nothing is in the way of the fingers, from where they stand open to where they close.
fn has_room(
    map: &HeightMap,
    hand: &Hand,
    middle: [f64; 2],
    way: [f64; 2],
    level_m: f64,
    half_m: f64,
) -> bool {
    let side = [-way[1], way[0]];
    let far = hand.opening_m / 2.0 + hand.finger_m;
    // Noise of the ground is no obstacle.
    let level_m = level_m.max(GROUND_NOISE_M);
    [-1.0, -0.5, 0.0, 0.5, 1.0].into_iter().all(|i| {
        let lane = along(middle, side, i * (hand.pad_half_width_m + 0.001));
        [-1.0, 1.0].into_iter().all(|sign| {
            // Near the edge walls may slope; further out nothing may stand.
            let mut s = half_m + 0.0035;
            while s <= far {
                let [x, y] = along(lane, way, sign * s);
                if map.height_m(x, y) > level_m {
                    return false;
                }
                s += 0.002;
            }
            true
        })
    })
}

/// Greatest angle between the walls and the pads, rad, from their places along the pads' width.
fn slope(
    map: &HeightMap,
    hand: &Hand,
    middle: [f64; 2],
    way: [f64; 2],
    level_m: f64,
    half_m: f64,
) -> Option<f64> {
    let side = [-way[1], way[0]];
    let reach = hand.pad_half_width_m;
    let ends = |offset: f64| {
        let lane = along(middle, side, offset);
        map.extent(lane, way, level_m, half_m + 0.015)
    };
    let (low, high) = (ends(-reach)?, ends(reach)?);
    let angle = |i: usize| ((high[i] - low[i]) / (2.0 * reach)).atan().abs();
    let worst = angle(0).max(angle(1));
    worst.is_finite().then_some(worst)
}

/// Rank of a candidate from 0 to 1.
fn quality(map: &HeightMap, hand: &Hand, found: &Candidate, region: &Region) -> f64 {
    let facing = 1.0 - 0.6 * (found.slope_rad / hand.slope_max_rad).powi(2);
    let off = (found.place[0] - region.middle[0]).hypot(found.place[1] - region.middle[1]);
    // In a pile the region's middle is not the part's: it counts less the larger the region.
    let trust = (2500.0 / region.cells as f64).min(1.0);
    let centered = 1.0 - 0.7 * trust * (1.0 - (-0.5 * (off / CENTER_M).powi(2)).exp());
    let engaged = ((found.top_m - found.tip_m) / 0.015).min(1.0);
    let room = (found.clearance_m / 0.006).clamp(0.1, 1.0);
    let high = 0.7 + 0.3 * (found.top_m / 0.06).min(1.0);
    let narrow = 1.0 - 0.3 * (found.width_m / hand.opening_m).powi(2);
    // From above a thin rod looks like a wall, and a pad meets it along a line.
    let thick = ((found.width_m - THIN_M) / THIN_M).clamp(0.05, 1.0);
    facing * centered * engaged * room * high * narrow * thick * single(map, found)
}

/// 1 where all between the pads looks like one thing; less where colours or heights change, as
/// they do from one part to the next.
fn single(map: &HeightMap, found: &Candidate) -> f64 {
    let side = [-found.way[1], found.way[0]];
    let reach = found.width_m / 2.0 - 0.002;
    let mut worst: f64 = 1.0;
    for offset in [-0.004, 0.0, 0.004] {
        let lane = along(found.place, side, offset);
        let mut before: Option<([f64; 3], f64)> = None;
        let mut first: Option<[f64; 3]> = None;
        let mut s = -reach;
        while s <= reach {
            let [x, y] = along(lane, found.way, s);
            let (color, height) = (map.color(x, y), map.height_m(x, y));
            s += 0.002;
            if color == [0.0; 3] {
                continue;
            }
            let apart =
                |other: &[f64; 3]| -> f64 { (0..3).map(|i| (color[i] - other[i]).abs()).sum() };
            if apart(first.get_or_insert(color)) > OTHER_COLOR {
                worst = worst.min(0.25);
            }
            if let Some((_, low)) = before
                && (height - low).abs() > 0.006
            {
                worst = worst.min(0.5);
            }
            before = Some((color, height));
        }
    }
    worst
}

fn to_grasp(
    map: &HeightMap,
    picture: &Aligned,
    hand: &Hand,
    quality: f64,
    found: &Candidate,
) -> Option<Grasp> {
    let height_m = found.tip_m + hand.below_m;
    let [x, y] = found.place;
    let point_m = map.to_camera(x, y, height_m);
    let seen: Point3<f64> = map.to_camera(x, y, found.top_m);
    Some(Grasp {
        pixel: picture.camera.project(&seen)?,
        point_m,
        closing: map.camera_from_map.rotation * Vector3::new(found.way[0], found.way[1], 0.0),
        width_m: found.width_m,
        clearance_m: found.clearance_m,
        top_m: found.top_m,
        height_m,
        quality,
    })
}
