//! A tool lowered onto a map of heights: its lowest position, and the contact of its pads there.

use super::Hand;
use super::map::HeightMap;
use nalgebra::{Isometry3, Point3, Vector3};

/// The lowest position of a tool, and its contact there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// Least height of the tool point over the ground with the open fingers clear, m.
    pub height_m: f64,
    /// Height of the contact on the pad with the smaller contact, m.
    pub engaged_m: f64,
    /// Distance between the pads when closed, m.
    pub width_m: f64,
    /// Middle between the edges, away from the tool point along the closing direction, m.
    pub off_m: f64,
    /// Share of the contacts whose colour differs from the others': possibly another object.
    pub other: f64,
}

impl HeightMap {
    /// Lowers a tool straight down at a position until its open fingers, with their shafts, are
    /// `hand.margin_m` above the surface, or to the best height above that, and closes it.
    /// `map_from_tool` has the tool's attitude (z up along the fingers, jaws along y) and position;
    /// only its height is not used. `None` if the pads then have no contact.
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
        // Higher up the contact may be larger: above a foot that they would touch first, or at the
        // upper of two objects.
        let mut best: Option<Fit> = None;
        for step in 0..LIFTS {
            let lifted_m = height_m + f64::from(step) * LIFT_M;
            let mut at = *map_from_tool;
            at.translation.vector.z = lifted_m;
            let Some(fit) = self.close(hand, &at) else {
                continue;
            };
            let enough = |fit: &Fit| fit.engaged_m.min(ENOUGH_M) - OTHER_M * fit.other;
            // Of equal contacts the highest: lower down there may be another object.
            if best.is_none_or(|best| enough(&fit) >= enough(&best)) {
                best = Some(fit);
            }
        }
        best
    }

    /// Contacts of the pads when they close at a position: every patch of a pad moves inwards until
    /// the map is higher than it.
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
                        way += Self::CELL_M * 0.5;
                    }
                }
            }
        }
        let [left, right] = ways;
        let width_m = hand.opening_m - left - right;
        // Without a contact on both sides the pads would meet each other.
        if width_m <= 0.0 {
            return None;
        }
        // The first contact stops a pad: patches that would meet a wall later do not touch it.
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
/// A contact larger than this is not better, m: deeper down there may be another object.
const ENOUGH_M: f64 = 0.0125;
/// A contact with a completely different colour counts like one that is smaller by this, m.
const OTHER_M: f64 = 0.02;
/// Patches of a pad, up.
const PATCHES_UP: u32 = 12;
/// A height smaller than this over a patch is noise of the map, m.
const NOISE_M: f64 = 0.001;
/// Walls this far behind the first contact count as touched with it, m: cells and their noise.
const SAME_WALL_M: f64 = 0.0012;
/// Colours are sampled this far inside a wall, m.
const INSIDE_M: f64 = 0.002;
/// Colours further apart than this indicate two objects (sum of three differences).
const OTHER_COLOR: f64 = 60.0;
/// Room beside a finger for the tool's position error, m.
const SIDEWAYS_M: f64 = 0.0015;
