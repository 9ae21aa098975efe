//! A slice of the workspace as a picture.

use super::grid::{Axis, Cell};
use crate::chart::{Chart, Figure, Patch};
use mcdpr_kinematics::{Bound, Grid, Verdict};

/// Red, green and blue.
type Rgb = [u8; 3];

const WHITE: Rgb = [255, 255, 255];

/// Hues that distinguish cables; cable 9 begins anew.
const CABLES: [Rgb; 8] = [
    [214, 69, 65],
    [65, 105, 214],
    [222, 148, 40],
    [140, 80, 180],
    [40, 150, 160],
    [200, 90, 150],
    [120, 110, 50],
    [90, 100, 110],
];

/// Meaning of one colour.
fn meaning(cell: Cell) -> (Rgb, String) {
    let cable_color = |cable: u8, lighter: bool| {
        let index = usize::from(cable).saturating_sub(1) % CABLES.len();
        let [r, g, b] = CABLES.get(index).copied().unwrap_or([0, 0, 0]);
        let mix = |c: u8| if lighter { c / 2 + 127 } else { c };
        [mix(r), mix(g), mix(b)]
    };
    match cell {
        Cell::Judged(Verdict::Feasible) => ([120, 190, 110], "feasible".to_owned()),
        Cell::Judged(Verdict::Limited { cable, bound }) => match bound {
            Bound::Minimum => (
                cable_color(cable, true),
                format!("cable {cable} below its least tension"),
            ),
            Bound::Maximum => (
                cable_color(cable, false),
                format!("cable {cable} over its greatest tension"),
            ),
        },
        Cell::Judged(Verdict::NoPath { cable }) => {
            ([60, 60, 60], format!("cable {cable} has no path"))
        }
        Cell::Judged(Verdict::Tilted) => ([240, 225, 120], "tilted too far".to_owned()),
        Cell::Judged(Verdict::Unstable) => ([255, 150, 200], "unstable".to_owned()),
        Cell::Judged(Verdict::Unbalanced) => ([225, 225, 225], "no equilibrium".to_owned()),
        Cell::CablesNear([a, b]) => ([0, 0, 0], format!("cables {a} and {b} too near")),
        Cell::PlatformNear(cable) => (
            [30, 30, 90],
            format!("cable {cable} too near to the platform"),
        ),
    }
}

/// Draws one layer of a grid.
pub(super) fn draw(title: &str, axis: Axis, grid: &Grid, cells: &[Cell]) -> Figure {
    let [across, up] = axis.others();
    let count = |k: usize| grid.counts.get(k).copied().unwrap_or(1).max(1);
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let step_mm = |k: usize| match count(k) {
        // A single row of points must still be visible.
        1 => 1.0,
        n => (grid.max_m[k] - grid.min_m[k]) * 1e3 / (n - 1) as f64,
    };
    let step = [step_mm(across), step_mm(up)];
    let start = [
        grid.min_m[across] * 1e3 - step[0] / 2.0,
        grid.min_m[up] * 1e3 - step[1] / 2.0,
    ];
    let mut found: Vec<Category> = Vec::new();
    let mut patches = Vec::new();
    // Points with x (or y) fastest; neighbours of the same kind in a row become one rectangle.
    for (row, cells) in cells.chunks(count(across)).enumerate() {
        let mut column = 0;
        for run in cells.chunk_by(|a, b| a == b) {
            let (color, words) = run.first().map_or((WHITE, String::new()), |c| meaning(*c));
            match found.iter_mut().find(|known| known.words == words) {
                Some(known) => known.points += run.len(),
                None => found.push(Category {
                    color,
                    words,
                    points: run.len(),
                }),
            }
            #[expect(clippy::cast_precision_loss, reason = "small counts")]
            let corner =
                |x: usize, y: usize| [start[0] + x as f64 * step[0], start[1] + y as f64 * step[1]];
            patches.push(Patch {
                min: corner(column, row),
                max: corner(column + run.len(), row + 1),
                color: hex(color),
            });
            column += run.len();
        }
    }
    found.sort_by_key(|category| std::cmp::Reverse(category.points));
    let legend = found
        .into_iter()
        .map(|of| (hex(of.color), format!("{} ({})", of.words, of.points)));
    let names = ["x, mm", "y, mm", "z, mm"];
    let name = |k: usize| names.get(k).copied().unwrap_or_default();
    let chart = Chart::new("", name(across), name(up))
        .map(patches, legend)
        .square();
    Figure::new(title, 1, [chart])
}

/// A colour of the picture, its meaning, and its number of points.
struct Category {
    color: Rgb,
    words: String,
    points: usize,
}

fn hex([red, green, blue]: Rgb) -> String {
    format!("#{red:02X}{green:02X}{blue:02X}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn a_picture_shows_every_kind_with_its_count() {
        let grid = Grid {
            min_m: Vector3::new(0.0, 0.0, -0.1),
            max_m: Vector3::new(0.2, 0.1, -0.1),
            counts: [3, 2, 1],
        };
        let cells = [
            Cell::Judged(Verdict::Feasible),
            Cell::Judged(Verdict::Feasible),
            Cell::Judged(Verdict::Tilted),
            Cell::Judged(Verdict::Feasible),
            Cell::CablesNear([1, 4]),
            Cell::Judged(Verdict::Tilted),
        ];
        let svg = draw("a <b>", Axis::Z, &grid, &cells).svg();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
        for words in [
            "feasible (3)",
            "tilted too far (2)",
            "cables 1 and 4 too near (1)",
        ] {
            assert!(svg.contains(words), "{words}");
        }
        // The title is text, not markup.
        assert!(!svg.contains("<b>"));
        let green = svg.matches("#78BE6E").count();
        assert_eq!(green, 3, "two runs of feasible cells and the legend");
    }
}
