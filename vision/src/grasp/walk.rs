//! Walks over a map of heights, to the end of an object.

use super::map::HeightMap;

/// A step, m: half a cell.
pub(super) const STEP_M: f64 = 0.5 * HeightMap::CELL_M;
/// Cells in whole numbers: this many parts each.
const PARTS: f64 = 65_536.0;
const BITS: u32 = 16;
const HALF: i32 = 1 << (BITS - 1);

/// Walks in one direction over a map.
pub(super) struct Walk<'a> {
    heights_m: &'a [f32],
    size: [usize; 2],
    corner_m: [f64; 2],
    /// A step, in parts of a cell.
    step: [i32; 2],
    /// What is added to a cell's number by each step from its middle, forwards and backwards.
    ahead: [Vec<i32>; 2],
}

/// Where a walk ends.
#[derive(Clone, Copy)]
pub(super) struct Until {
    /// It ends where the map is no higher than this, m.
    pub level_m: f64,
    /// The object's wall reaches this high, m, ...
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

    /// After how many of these heights it ends; `None` where it does not, or a wall slopes.
    #[allow(
        clippy::cast_possible_truncation,
        reason = "heights in single precision"
    )]
    fn end(self, heights: impl Iterator<Item = f32>) -> Option<u32> {
        let (level, upper) = (self.level_m as f32, self.upper_m as f32);
        let mut slope_from = u32::MAX;
        for (step, high) in (1..).zip(heights) {
            if high <= upper {
                slope_from = slope_from.min(step);
                if step - slope_from >= self.slack {
                    return None;
                }
                if high <= level {
                    return Some(step);
                }
            }
        }
        None
    }
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "cells in parts, compared with the map's size before they are used"
)]
impl<'a> Walk<'a> {
    /// Walks that are quick for up to `most` steps from a cell's middle.
    pub(super) fn new(map: &'a HeightMap, way: [f64; 2], most: u32) -> Self {
        // Fixed point: a step is two additions and two shifts, without a conversion from floating
        // point.
        let step = way.map(|way| (way * STEP_M / HeightMap::CELL_M * PARTS).round() as i32);
        let ahead = [1, -1].map(|sign: i32| {
            let cells = |far: i32| step.map(|step| (HALF + sign * far * step) >> BITS);
            let number = |[column, row]: [i32; 2]| row * map.size[0] as i32 + column;
            (1..=most as i32).map(|far| number(cells(far))).collect()
        });
        Self {
            heights_m: map.heights(),
            size: map.size,
            corner_m: map.corner_m,
            step,
            ahead,
        }
    }

    /// What is added to a cell's number by each of `most` steps from its middle, where none of them
    /// leaves the map.
    fn ahead(&self, cell: [usize; 2], sign: i32, most: u32) -> Option<&[i32]> {
        let inside = (0..2).all(|i| {
            let off = (HALF + sign * most as i32 * self.step[i]) >> BITS;
            cell[i].wrapping_add_signed(off as isize) < self.size[i]
        });
        let ahead = &self.ahead[usize::from(sign < 0)];
        inside.then(|| ahead.get(..most as usize)).flatten()
    }

    /// Steps from a cell's middle forwards (`sign` 1) or backwards (-1) to where the thing there
    /// ends, at most `most`. `None` where it does not, or its wall slopes.
    pub(super) fn steps_from_cell(
        &self,
        cell: [usize; 2],
        sign: i32,
        until: Until,
        most: u32,
    ) -> Option<u32> {
        let Some(ahead) = self.ahead(cell, sign, most) else {
            let middle = cell.map(|cell| ((cell as i32) << BITS) + HALF);
            return until.end(self.on_the_way(middle, sign, most));
        };
        let number = cell[1] * self.size[0] + cell[0];
        until.end(ahead.iter().map(|&more| self.numbered(number, more)))
    }

    /// Height of the cell whose number is so much more than another's, m.
    fn numbered(&self, number: usize, more: i32) -> f32 {
        let cell = self
            .heights_m
            .get(number.wrapping_add_signed(more as isize));
        cell.copied().unwrap_or(0.0)
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
        until.end(self.on_the_way(self.parts(from_m), sign, most))
    }

    /// Heights after 1, 2 ... `most` steps, m.
    fn on_the_way(
        &self,
        [mut u, mut v]: [i32; 2],
        sign: i32,
        most: u32,
    ) -> impl Iterator<Item = f32> {
        let [du, dv] = self.step.map(|step| sign * step);
        (0..most).map(move |_| {
            (u, v) = (u + du, v + dv);
            self.height(u, v)
        })
    }

    /// Whether the map is higher than a level at a place.
    pub(super) fn higher(&self, at_m: [f64; 2], level_m: f64) -> bool {
        let [u, v] = self.parts(at_m);
        self.height(u, v) > level_m as f32
    }

    fn parts(&self, at_m: [f64; 2]) -> [i32; 2] {
        [0, 1].map(|i| ((at_m[i] - self.corner_m[i]) * (PARTS / HeightMap::CELL_M)) as i32)
    }

    /// Whether the map is nowhere higher than a level on the ways from `from` to `to` steps away, back
    /// and on, looked at every `every` steps.
    pub(super) fn is_clear(
        &self,
        at_m: [f64; 2],
        (from, to, every): (u32, u32, u32),
        level_m: f64,
    ) -> bool {
        let ([u, v], level) = (self.parts(at_m), level_m as f32);
        let [du, dv] = self.step;
        let higher = |far: i32| self.height(u + far * du, v + far * dv) > level;
        let mut step = from;
        while step <= to {
            let far = step as i32;
            // Both are asked for: a branch less.
            if higher(-far) | higher(far) {
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
        let walk = Walk::new(&map, [1.0, 0.0], 100);
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
        // Back from here it is high up to 10 mm away, and on lower than 5 mm from 40 mm on.
        assert!(!walk.is_clear(from, (0, 19, 4), 0.005));
        assert!(!walk.is_clear(from, (22, 76, 4), 0.005));
        assert!(walk.is_clear(from, (82, 400, 4), 0.005));
        // The other way round.
        let turned = Walk::new(&map, [-1.0, 0.0], 100);
        assert!(!turned.is_clear(from, (22, 76, 4), 0.005));
        assert!(turned.is_clear(from, (82, 400, 4), 0.005));
        // From the middle of a cell, also where that leads out of the map.
        let cell = [20, 2];
        let middle = [0.0205, 0.0025];
        for most in [10, 90, 100] {
            for sign in [-1, 1] {
                let slow = walk.steps(middle, sign, level, most);
                assert_eq!(walk.steps_from_cell(cell, sign, level, most), slow);
            }
        }
        let back = walk.steps_from_cell(cell, -1, level, 100);
        assert_eq!(back, walk.steps_from_cell(cell, -1, level, 22));
        assert!(back.is_some() && walk.steps_from_cell(cell, -1, level, 19).is_none());
        assert!(walk.steps_from_cell(cell, 1, wall, 100).is_none());
        let across = Walk::new(&map, [0.0, 1.0], 100);
        assert_eq!(across.steps(from, 1, level, 120), Some(5));
        assert_eq!(across.steps(from, -1, level, 120), Some(6));
    }
}
