//! Walks over a map of heights, to where a thing ends.

use super::map::HeightMap;

/// A step, m: half a cell.
pub(super) const STEP_M: f64 = 0.5 * HeightMap::CELL_M;
/// Cells in whole numbers: this many parts each.
const PARTS: f64 = 65_536.0;
const BITS: u32 = 16;

/// Walks in one direction over a map.
pub(super) struct Walk<'a> {
    heights_m: &'a [f32],
    size: [usize; 2],
    corner_m: [f64; 2],
    /// A step, in parts of a cell.
    step: [i32; 2],
}

/// Where a walk ends.
#[derive(Clone, Copy)]
pub(super) struct Until {
    /// It ends where the map is no higher than this, m.
    pub level_m: f64,
    /// The thing's wall reaches this high, m, ...
    pub upper_m: f64,
    /// ... and less than so many steps before the end.
    pub slack: u32,
}

impl Until {
    /// Wherever the map is no higher than this, m.
    pub(super) const fn level(level_m: f64) -> Self {
        Self {
            level_m,
            upper_m: level_m,
            slack: 1,
        }
    }
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "cells in parts, compared with the map's size before they are used"
)]
impl<'a> Walk<'a> {
    pub(super) fn new(map: &'a HeightMap, way: [f64; 2]) -> Self {
        Self {
            heights_m: map.heights(),
            size: map.size,
            corner_m: map.corner_m,
            step: way.map(|way| (way * STEP_M / HeightMap::CELL_M * PARTS).round() as i32),
        }
    }

    /// Steps from a place forwards (`sign` 1) or backwards (-1) to where the thing there ends, at
    /// most `most`. `None` where it does not, or its wall slopes.
    pub(super) fn steps(
        &self,
        from_m: [f64; 2],
        sign: i32,
        until: Until,
        most: u32,
    ) -> Option<u32> {
        let [mut u, mut v] = self.parts(from_m);
        let [du, dv] = self.step.map(|step| sign * step);
        let (level, upper) = (until.level_m as f32, until.upper_m as f32);
        let mut slope_from = u32::MAX;
        for step in 1..=most {
            u += du;
            v += dv;
            let high = self.height(u, v);
            if high <= upper {
                slope_from = slope_from.min(step);
                if step - slope_from >= until.slack {
                    return None;
                }
                if high <= level {
                    return Some(step);
                }
            }
        }
        None
    }

    /// Whether the map is higher than a level at a place.
    pub(super) fn higher(&self, at_m: [f64; 2], level_m: f64) -> bool {
        let [u, v] = self.parts(at_m);
        self.height(u, v) > level_m as f32
    }

    fn parts(&self, at_m: [f64; 2]) -> [i32; 2] {
        [0, 1].map(|i| ((at_m[i] - self.corner_m[i]) * (PARTS / HeightMap::CELL_M)) as i32)
    }

    /// The first place at which the map is no higher than a level, of those `every` steps apart up to
    /// `most`, in steps.
    pub(super) fn drops(
        &self,
        at_m: [f64; 2],
        sign: i32,
        (every, most): (u32, u32),
        level_m: f64,
    ) -> Option<u32> {
        let ([u, v], level) = (self.parts(at_m), level_m as f32);
        let [du, dv] = self.step.map(|step| sign * step);
        let mut step = every;
        while step <= most {
            let far = step as i32;
            if self.height(u + far * du, v + far * dv) <= level {
                return Some(step);
            }
            step += every;
        }
        None
    }

    /// Whether the map is nowhere higher than a level on the way from `from` to `to` steps away, looked
    /// at every `every` steps.
    pub(super) fn is_clear(
        &self,
        at_m: [f64; 2],
        sign: i32,
        (from, to, every): (u32, u32, u32),
        level_m: f64,
    ) -> bool {
        let ([u, v], level) = (self.parts(at_m), level_m as f32);
        let [du, dv] = self.step.map(|step| sign * step);
        let mut step = from;
        while step <= to {
            let far = step as i32;
            if self.height(u + far * du, v + far * dv) > level {
                return false;
            }
            step += every;
        }
        true
    }

    fn height(&self, u: i32, v: i32) -> f32 {
        // What is negative becomes larger than any map, and a row too far is past its end.
        let (column, row) = ((u >> BITS) as u32 as usize, (v >> BITS) as u32 as usize);
        if column >= self.size[0] {
            return 0.0;
        }
        let cell = self.heights_m.get(row * self.size[0] + column);
        cell.copied().unwrap_or(0.0)
    }
}

/// Length of a way that ended with a step, m: the end lies somewhere in that step.
pub(super) fn length_m(steps: u32) -> f64 {
    f64::from(steps) * STEP_M - 0.5 * STEP_M
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_walk_ends_at_the_wall_and_not_on_a_slope() {
        // 20 mm high from 10 to 30 mm; beyond, a slope of 1 in 2 down to the ground.
        let profile = |x: usize| match x {
            0..10 => 0.0,
            10..30 => 0.02,
            30..70 => 0.02 - 0.0005 * (x as f32 - 30.0),
            _ => 0.0,
        };
        let heights = (0..5 * 100).map(|at| profile(at % 100)).collect();
        let map = HeightMap::of_heights([100, 5], heights);
        let walk = Walk::new(&map, [1.0, 0.0]);
        let from = [0.0203, 0.0025];
        let level = Until::level(0.005);
        let back = walk.steps(from, -1, level, 120).unwrap();
        assert!((length_m(back) - 0.0103).abs() < 0.0005);
        // 0.005 is reached 30 mm down the slope.
        let on = walk.steps(from, 1, level, 120).unwrap();
        assert!((length_m(on) - 0.0397).abs() < 0.001, "{}", length_m(on));
        let wall = Until {
            upper_m: 0.0125,
            slack: 5,
            ..level
        };
        assert_eq!(walk.steps(from, -1, wall, 120), Some(back));
        assert_eq!(walk.steps(from, 1, wall, 120), None);
        // Not as far as that, and out of the map.
        assert_eq!(walk.steps(from, 1, level, on - 1), None);
        // Between 10 and 20 mm from here it is high up to 30 mm, and lower than 5 mm from 60 mm on.
        assert!(!walk.is_clear(from, 1, (0, 40, 4), 0.005));
        assert!(!walk.is_clear(from, 1, (60, 120, 4), 0.005));
        assert!(walk.is_clear(from, 1, (82, 400, 4), 0.005));
        assert!(walk.is_clear(from, -1, (22, 400, 4), 0.005));
        assert_eq!(walk.drops(from, -1, (6, 120), 0.005), Some(24));
        assert_eq!(walk.drops(from, -1, (6, 20), 0.005), None);
        let across = Walk::new(&map, [0.0, 1.0]);
        assert_eq!(across.steps(from, 1, level, 120), Some(5));
        assert_eq!(across.steps(from, -1, level, 120), Some(6));
    }
}
