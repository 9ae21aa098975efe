//! Connected regions of objects over the ground.

use super::Wanted;
use super::map::HeightMap;
use nalgebra::Point3;

/// Regions with fewer cells are noise.
/// 40 mm^2.
const LEAST_CELLS: usize = 40;

/// A connected piece.
#[derive(Debug, Clone, Copy)]
pub(super) struct Region {
    pub cells: usize,
    /// Mean place of its cells in the map's frame, m.
    pub middle: [f64; 2],
}

/// Cells side by side in a row: `start` belongs to it, `end` does not.
#[derive(Debug, Clone, Copy)]
struct Run {
    start: usize,
    end: usize,
    /// An earlier run of the same piece, or itself.
    of: usize,
}

/// All pieces, row by row.
pub(super) struct Regions {
    runs: Vec<Run>,
    /// Number of each row's first run, and of the run after the last.
    rows: Vec<usize>,
    /// The piece of each run.
    regions: Vec<Region>,
}

impl Regions {
    /// Connected cells over the least height in the area.
    pub(super) fn new(map: &HeightMap, least_m: f64, wanted: &Wanted) -> Self {
        let [width, height] = map.size;
        #[allow(clippy::cast_possible_truncation)]
        let least = least_m as f32;
        let inside = Inside::new(map, wanted);
        let (mut runs, mut rows) = (Vec::<Run>::new(), vec![0]);
        for y in 0..height {
            let row = &map.heights()[y * width..(y + 1) * width];
            let above = rows.len().checked_sub(2).map_or(0, |r| rows[r])..runs.len();
            let mut over = above.start;
            let mut x = 0;
            while x < width {
                if !(row[x] > least && inside.holds(x, y)) {
                    x += 1;
                    continue;
                }
                let start = x;
                while x < width && row[x] > least && inside.holds(x, y) {
                    x += 1;
                }
                let number = runs.len();
                runs.push(Run {
                    start,
                    end: x,
                    of: number,
                });
                // Runs of the row above that share a column.
                while over < above.end && runs[over].end <= start {
                    over += 1;
                }
                let mut touching = over;
                while touching < above.end && runs[touching].start < x {
                    join(&mut runs, touching, number);
                    touching += 1;
                }
            }
            rows.push(runs.len());
        }
        let regions = Self::sum(map, &mut runs, &rows);
        Self {
            runs,
            rows,
            regions,
        }
    }

    /// The piece that each run belongs to.
    fn sum(map: &HeightMap, runs: &mut [Run], rows: &[usize]) -> Vec<Region> {
        let mut sums = vec![(0_usize, [0.0; 2]); runs.len()];
        for (y, row) in rows.windows(2).enumerate() {
            for number in row[0]..row[1] {
                let Run { start, end, .. } = runs[number];
                let root = root(runs, number);
                let (cells, sum) = &mut sums[root];
                let count = end - start;
                *cells += count;
                sum[0] += count as f64 * 0.5 * (start + end - 1) as f64;
                sum[1] += count as f64 * y as f64;
            }
        }
        (0..runs.len())
            .map(|number| {
                let (cells, sum) = sums[root(runs, number)];
                let middle = [0, 1].map(|i| {
                    map.corner_m[i] + (sum[i] / cells.max(1) as f64 + 0.5) * HeightMap::CELL_M
                });
                Region { cells, middle }
            })
            .collect()
    }

    /// Whether there is only noise.
    pub(super) fn is_empty(&self) -> bool {
        self.regions.iter().all(|region| region.cells < LEAST_CELLS)
    }

    /// Every `spacing`-th cell of every `spacing`-th row that belongs to a piece, with it.
    pub(super) fn places(
        &self,
        spacing: usize,
    ) -> impl Iterator<Item = (usize, usize, &Region)> + '_ {
        let rows = self.rows.windows(2).enumerate().step_by(spacing);
        rows.flat_map(move |(y, row)| {
            (row[0]..row[1])
                .filter(|&number| self.regions[number].cells >= LEAST_CELLS)
                .flat_map(move |number| {
                    let Run { start, end, .. } = self.runs[number];
                    let columns = (start.next_multiple_of(spacing)..end).step_by(spacing);
                    columns.map(move |x| (x, y, &self.regions[number]))
                })
        })
    }
}

fn root(runs: &mut [Run], mut number: usize) -> usize {
    while runs[number].of != number {
        // Every second step is left out the next time.
        runs[number].of = runs[runs[number].of].of;
        number = runs[number].of;
    }
    number
}

fn join(runs: &mut [Run], one: usize, other: usize) {
    let (one, other) = (root(runs, one), root(runs, other));
    runs[one.max(other)].of = one.min(other);
}

/// Which cells of the map lie in the area.
struct Inside {
    half_m: [f64; 2],
    origin: [f64; 2],
    /// From a cell to the next one along x, and along y.
    right: [f64; 2],
    down: [f64; 2],
}

impl Inside {
    fn new(map: &HeightMap, wanted: &Wanted) -> Self {
        let Some(area) = &wanted.area else {
            return Self {
                half_m: [f64::INFINITY; 2],
                origin: [0.0; 2],
                right: [0.0; 2],
                down: [0.0; 2],
            };
        };
        let area_from_map = area.camera_from_area.inverse() * map.camera_from_map;
        let at = |i: usize, j: usize| {
            let [x, y] = map.middle_m(i, j);
            let point = area_from_map * Point3::new(x, y, 0.0);
            [point.x, point.y]
        };
        // Linear in the cells: three corners give all.
        let (origin, right, down) = (at(0, 0), at(1, 0), at(0, 1));
        let less = |a: [f64; 2]| [a[0] - origin[0], a[1] - origin[1]];
        Self {
            half_m: area.half_m,
            origin,
            right: less(right),
            down: less(down),
        }
    }

    fn holds(&self, column: usize, row: usize) -> bool {
        let (i, j) = (column as f64, row as f64);
        (0..2).all(|k| {
            let at = self.origin[k] + i * self.right[k] + j * self.down[k];
            at.abs() < self.half_m[k]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::Hand;
    use super::*;

    /// Cells marked `#` are 20 mm high.
    fn map(rows: &[&str]) -> HeightMap {
        let cells = rows.iter().flat_map(|row| row.chars());
        let heights = cells.map(|cell| if cell == '#' { 0.02 } else { 0.0 });
        HeightMap::of_heights([rows[0].len(), rows.len()], heights.collect())
    }

    #[test]
    fn pieces_that_meet_further_down_are_one() {
        let wide = "#".repeat(30);
        let gap = format!("{}{}{}", "#".repeat(10), " ".repeat(10), "#".repeat(10));
        let none = " ".repeat(30);
        let wanted = Wanted::anywhere(Hand::default());
        // A fork, and a bar below it.
        let rows = [&gap, &gap, &gap, &wide, &none, &wide, &wide].map(String::as_str);
        let regions = Regions::new(&map(&rows), 0.008, &wanted);
        let cells: Vec<usize> = regions.places(1).map(|(.., region)| region.cells).collect();
        assert_eq!(cells.len(), 150);
        assert!(cells[..90].iter().all(|&cells| cells == 90));
        assert!(cells[90..].iter().all(|&cells| cells == 60));
        let (_, _, fork) = regions.places(1).next().unwrap();
        assert!((fork.middle[0] - 0.015).abs() < 1e-12);
        // Rows 0 to 2 have 20 cells each, row 3 has 30.
        let mean = (20.0 * (0.5 + 1.5 + 2.5) + 30.0 * 3.5) / 90.0;
        assert!((fork.middle[1] - mean * 1e-3).abs() < 1e-12);
        let every: Vec<_> = regions.places(5).map(|(x, y, _)| (x, y)).collect();
        assert_eq!(every[..4], [(0, 0), (5, 0), (20, 0), (25, 0)]);
        assert_eq!(every.len(), 4 + 6);
    }
}
