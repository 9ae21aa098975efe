//! Grasps on opposite edges of a map of heights.
//!
//! At positions all over the objects on the ground, for directions all around, closing jaws are
//! simulated: at some level of the finger tips the object under the tool has two ends within the
//! opening, both ends are walls (the same a few millimetres higher up), the walls face the pads,
//! and the fingers have room beside them. Touching or overlapping parts need no separate outlines:
//! an upper part ends where its height does, and a neighbour takes the room of a finger.

use super::map::HeightMap;
use super::regions::{Region, Regions};
use super::walk::{STEP_M, Until, Walk, length_m};
use super::{Closing, Detector, Grasp, Hand, NoGrasp, Wanted};
use crate::align::Aligned;
use nalgebra::{Point3, Vector3};
use std::f64::consts::PI;

/// The default detector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Antipodal {
    /// Least height of an object over the ground, m.
    pub least_height_m: f64,
    /// Distance between the positions that are tried, cells.
    pub spacing: usize,
    /// Directions that are tried over half a turn.
    pub directions: u32,
    /// Greatest number of grasps returned.
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
/// A contact on the pads lower than this does not hold, m.
const ENGAGED_MIN_M: f64 = 0.008;
/// Everything beside the grasp must be this much below the finger tips, m: the noise of heights.
const BELOW_TIP_M: f64 = 0.0015;
/// Walls must be the same this much higher up, m.
const WALL_M: f64 = 0.0075;
/// Greatest shift of an end over that height, steps of half a millimetre.
/// 2.5 mm over 7.5 mm: a wall may lean by 18 degrees.
const WALL_SLACK: u32 = 5;
/// Steps between the places at which room for a finger is looked for: 2 mm.
const LOOK_EVERY: u32 = 4;
/// Near the edge walls may slope; from this distance on no object may be higher, m.
const PAST_WALL_M: f64 = 0.0035;
/// Grasps closer than this in nearly the same direction count as the same, m.
const ALIKE_M: f64 = 0.008;
/// Narrower objects count as noise, m.
const NARROWEST_M: f64 = 0.003;
/// An edge whose ends move further than this along a pad does not count as a wall, m.
const BEYOND_M: f64 = 0.015;
/// Fingers reach this far down beside an object, measured from its top, m. Overhangs are not
/// visible from above: deeper than the height of the pads the fingers might close below one.
const DEPTHS_M: [f64; 3] = [0.021, 0.016, 0.011];
/// Colours further apart than this at the two pads indicate two objects (sum of three differences).
const OTHER_COLOR: f64 = 90.0;
/// Wider jaws that are tried to distinguish a wide object from a crowded one, m.
const WIDEST_M: f64 = 0.2;
/// Thinner objects may be a rod; at twice this thickness they are held in any case, m. A rod of 6
/// mm appears up to 7.5 mm wide.
const THIN_M: f64 = 0.007;
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
    /// As [`Detector::detect`], in an existing map.
    ///
    /// # Errors
    /// Why there is no grasp.
    pub(crate) fn detect_in(
        &self,
        map: &HeightMap,
        picture: &Aligned,
        wanted: &Wanted,
    ) -> Result<Vec<Grasp>, NoGrasp> {
        let hand = &wanted.hand;
        let regions = Regions::new(map, self.least_height_m, wanted);
        if regions.is_empty() {
            return Err(NoGrasp::Empty);
        }
        let ways = self.ways(map, &wanted.closing);
        let most = most_steps(hand);
        let walks: Vec<Walk> = ways.iter().map(|way| Walk::new(map, *way, most)).collect();
        let mut ranked: Vec<(f64, Candidate)> = Vec::new();
        for (column, row, region) in regions.places(self.spacing) {
            for (&way, walk) in ways.iter().zip(&walks) {
                let Some(found) = candidate(map, hand, [column, row], way, walk) else {
                    continue;
                };
                let quality = quality(map, hand, &found, region);
                if quality > 0.02 {
                    ranked.push((quality, found));
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
                let [x, y] = [0, 1].map(|i| other.place[i] - found.place[i]);
                // Either way round is the same grasp; 0.85 is 32 degrees.
                let turn = (other.way[0] * found.way[0] + other.way[1] * found.way[1]).abs();
                x * x + y * y < ALIKE_M * ALIKE_M && turn > 0.85
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
        // This call was the one with the widest jaws: it ends the recursion.
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
            // Half a turn is enough: both jaws are alike.
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

fn along(place: [f64; 2], way: [f64; 2], s: f64) -> [f64; 2] {
    [place[0] + s * way[0], place[1] + s * way[1]]
}

/// The best level for the finger tips at a position and direction, if there is one.
fn candidate(
    map: &HeightMap,
    hand: &Hand,
    cell: [usize; 2],
    way: [f64; 2],
    walk: &Walk,
) -> Option<Candidate> {
    let place = map.middle_m(cell[0], cell[1]);
    let top_m = map.height_m(place[0], place[1]);
    let mut tried_m = f64::NAN;
    for depth_m in DEPTHS_M {
        // A flat object: the tips stop above the ground by the margin.
        let tip_m = (top_m - depth_m).max(hand.margin_m);
        if tip_m == tried_m || top_m - tip_m < ENGAGED_MIN_M {
            continue;
        }
        tried_m = tip_m;
        let level_m = tip_m - BELOW_TIP_M;
        let Some(ends) = wall_to_wall(hand, walk, cell, level_m) else {
            continue;
        };
        let width_m = ends[0] + ends[1];
        if width_m < NARROWEST_M {
            continue;
        }
        // From here on about the middle between the ends.
        let middle = along(place, way, 0.5 * (ends[1] - ends[0]));
        let half = width_m / 2.0;
        if !has_room(hand, middle, way, walk, level_m, half) {
            continue;
        }
        let slope_rad = slope(hand, middle, way, walk, level_m, half)?;
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

/// Most steps from one wall of an object to the other that the jaws can span.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn most_steps(hand: &Hand) -> u32 {
    let fits_m = hand.opening_m - 2.0 * hand.margin_m;
    // Both lengths together are half a step less each than their steps.
    (fits_m / STEP_M + 1.0 + 1e-9) as u32
}

/// Distances from a cell's middle back and on to the walls of the object there, m, if both are
/// walls and the jaws fit.
fn wall_to_wall(hand: &Hand, walk: &Walk, cell: [usize; 2], level_m: f64) -> Option<[f64; 2]> {
    let until = Until {
        level_m,
        upper_m: level_m + WALL_M,
        slack: WALL_SLACK,
    };
    let most = most_steps(hand);
    let back = walk.steps_from_cell(cell, -1, until, most.saturating_sub(1))?;
    let on = walk.steps_from_cell(cell, 1, until, most - back)?;
    Some([length_m(back), length_m(on)])
}

/// Whether the fingers are free of obstacles from their open to their closed position.
fn has_room(
    hand: &Hand,
    middle: [f64; 2],
    way: [f64; 2],
    walk: &Walk,
    level_m: f64,
    half_m: f64,
) -> bool {
    let side = [-way[1], way[0]];
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let steps = |way_m: f64| (way_m / STEP_M) as u32;
    let (near, far) = (half_m + PAST_WALL_M, hand.opening_m / 2.0 + hand.finger_m);
    let range = (steps(near).saturating_add(1), steps(far), LOOK_EVERY);
    // Noise of the ground does not count as an obstacle.
    let level_m = level_m.max(GROUND_NOISE_M);
    [-1.0, 1.0, 0.0, -0.5, 0.5].into_iter().all(|i| {
        let lane = along(middle, side, i * (hand.pad_half_width_m + 0.001));
        walk.is_clear(lane, range, level_m)
    })
}

/// Greatest angle between the walls and the pads, rad, from their positions along the pads' width;
/// only of the first wall if that is too steep.
fn slope(
    hand: &Hand,
    middle: [f64; 2],
    way: [f64; 2],
    walk: &Walk,
    level_m: f64,
    half_m: f64,
) -> Option<f64> {
    let side = [-way[1], way[0]];
    let reach = hand.pad_half_width_m;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let most = ((half_m + BEYOND_M) / STEP_M).ceil() as u32;
    let until = Until::level(level_m);
    let lanes = [-reach, reach].map(|offset| along(middle, side, offset));
    // The object must lie between both ends of the pads, not only in their middle.
    if !lanes.iter().all(|lane| walk.higher(*lane, level_m)) {
        return None;
    }
    let mut steepest: f64 = 0.0;
    for sign in [-1, 1] {
        let [low, high] = lanes.map(|lane| walk.steps(lane, sign, until, most).map(length_m));
        let moved_m = (high? - low?).abs();
        steepest = steepest.max((moved_m / (2.0 * reach)).atan());
        if steepest > hand.slope_max_rad {
            break;
        }
    }
    Some(steepest)
}

/// Rank of a candidate from 0 to 1.
fn quality(map: &HeightMap, hand: &Hand, found: &Candidate, region: &Region) -> f64 {
    let facing = 1.0 - 0.6 * (found.slope_rad / hand.slope_max_rad).powi(2);
    let [x, y] = [0, 1].map(|i| found.place[i] - region.middle[i]);
    // In a pile the middle of a region is not that of a part: it counts less the larger the region.
    let trust = (2500.0 / region.cells as f64).min(1.0);
    let centered =
        1.0 - 0.7 * trust * (1.0 - (-0.5 * (x * x + y * y) / (CENTER_M * CENTER_M)).exp());
    let engaged = ((found.top_m - found.tip_m) / 0.015).min(1.0);
    let room = (found.clearance_m / 0.006).clamp(0.1, 1.0);
    let high = 0.7 + 0.3 * (found.top_m / 0.06).min(1.0);
    let narrow = 1.0 - 0.3 * (found.width_m / hand.opening_m).powi(2);
    let thick = thick(found.width_m);
    facing * centered * engaged * room * high * narrow * thick * single(map, found)
}

/// From above a thin rod looks like a wall, but a pad touches it only along a line.
fn thick(width_m: f64) -> f64 {
    ((width_m - THIN_M) / THIN_M).clamp(0.05, 1.0)
}

/// 1 if everything between the pads looks like one object; less if colours or heights change, as at
/// a boundary between parts.
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
            // An unknown cell has a height that was filled in, but no colour.
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

#[cfg(test)]
mod tests {
    use super::thick;

    #[test]
    fn what_is_seen_as_wide_as_a_rod_of_6_mm_counts_as_one() {
        assert!(thick(0.006) < 0.08 && thick(0.0075) < 0.08);
        assert_eq!(thick(0.014), 1.0);
    }
}
