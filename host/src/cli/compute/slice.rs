//! A slice of the workspace as a picture.

use super::grid::{Axis, Cell};
use mcdpr_kinematics::{Bound, Grid, Verdict};
use plotters::prelude::*;

/// Size of the picture, px: a square map and the legend beside it.
const SIZE: (u32, u32) = (1100, 700);
const MAP: u32 = 760;

/// Hues that distinguish cables; cable 9 begins anew.
const CABLES: [RGBColor; 8] = [
    RGBColor(214, 69, 65),
    RGBColor(65, 105, 214),
    RGBColor(222, 148, 40),
    RGBColor(140, 80, 180),
    RGBColor(40, 150, 160),
    RGBColor(200, 90, 150),
    RGBColor(120, 110, 50),
    RGBColor(90, 100, 110),
];

/// Meaning of one colour.
fn meaning(cell: Cell) -> (RGBColor, String) {
    let cable_color = |cable: u8, lighter: bool| {
        let index = usize::from(cable).saturating_sub(1) % CABLES.len();
        let RGBColor(r, g, b) = CABLES.get(index).copied().unwrap_or(BLACK);
        let mix = |c: u8| if lighter { c / 2 + 127 } else { c };
        RGBColor(mix(r), mix(g), mix(b))
    };
    match cell {
        Cell::Judged(Verdict::Feasible) => (RGBColor(120, 190, 110), "feasible".to_owned()),
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
            (RGBColor(60, 60, 60), format!("cable {cable} has no path"))
        }
        Cell::Judged(Verdict::Tilted) => (RGBColor(240, 225, 120), "tilted too far".to_owned()),
        Cell::Judged(Verdict::Unstable) => (RGBColor(255, 150, 200), "unstable".to_owned()),
        Cell::Judged(Verdict::Unbalanced) => (RGBColor(225, 225, 225), "no equilibrium".to_owned()),
        Cell::CablesNear([a, b]) => (RGBColor(0, 0, 0), format!("cables {a} and {b} too near")),
        Cell::PlatformNear(cable) => (
            RGBColor(30, 30, 90),
            format!("cable {cable} too near to the platform"),
        ),
    }
}

/// Draws one layer of a grid.
///
/// # Errors
/// The drawing library's error.
pub(super) fn draw(title: &str, axis: Axis, grid: &Grid, cells: &[Cell]) -> Result<String, String> {
    let mut svg = String::new();
    render(title, axis, grid, cells, &mut svg)?;
    Ok(svg)
}

fn render(
    title: &str,
    axis: Axis,
    grid: &Grid,
    cells: &[Cell],
    svg: &mut String,
) -> Result<(), String> {
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE).map_err(|e| e.to_string())?;
    let root = root
        .titled(title, ("sans-serif", 18))
        .map_err(|e| e.to_string())?;
    let (map, legend) = root.split_horizontally(MAP);
    let found = draw_map(&map, axis, grid, cells)?;
    for (row, (color, words, points)) in (0_i32..).zip(found) {
        let top = 20 + 24 * row;
        legend
            .draw(&Rectangle::new([(5, top), (21, top + 16)], color.filled()))
            .map_err(|e| e.to_string())?;
        let text = format!("{words} ({points})");
        legend
            .draw(&Text::new(text, (28, top + 2), ("sans-serif", 14)))
            .map_err(|e| e.to_string())?;
    }
    root.present().map_err(|e| e.to_string())
}

/// Colour, meaning and number of points of every category in the picture, most frequent first.
type Legend = Vec<(RGBColor, String, usize)>;

fn draw_map(
    map: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    axis: Axis,
    grid: &Grid,
    cells: &[Cell],
) -> Result<Legend, String> {
    let [across, up] = axis.others();
    let count = |k: usize| grid.counts.get(k).copied().unwrap_or(1).max(1);
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let step_mm = |k: usize| match count(k) {
        // A single row of points must still be visible.
        1 => 1.0,
        n => (grid.max_m[k] - grid.min_m[k]) * 1e3 / (n - 1) as f64,
    };
    let (dx, dy) = (step_mm(across), step_mm(up));
    let span = |k: usize, step: f64| {
        (grid.min_m[k] * 1e3 - step / 2.0)..(grid.max_m[k] * 1e3 + step / 2.0)
    };
    // One scale for both axes.
    let (x, y) = (span(across, dx), span(up, dy));
    let half = 0.5 * (x.end - x.start).max(y.end - y.start);
    let about = |range: &std::ops::Range<f64>| {
        let middle = 0.5 * (range.start + range.end);
        (middle - half)..(middle + half)
    };
    let mut chart = ChartBuilder::on(map)
        .margin(10)
        .x_label_area_size(40)
        .y_label_area_size(60)
        .build_cartesian_2d(about(&x), about(&y))
        .map_err(|e| e.to_string())?;
    let name = |k: usize| {
        ["x, mm", "y, mm", "z, mm"]
            .get(k)
            .copied()
            .unwrap_or_default()
    };
    chart
        .configure_mesh()
        .x_desc(name(across))
        .y_desc(name(up))
        .light_line_style(WHITE)
        .draw()
        .map_err(|e| e.to_string())?;

    let mut found: Legend = Vec::new();
    let mut rectangles = Vec::new();
    // Points with x (or y) fastest; neighbours of the same kind in a row become one rectangle.
    for row in cells.chunks(count(across)).enumerate() {
        let (row, cells) = row;
        let mut column = 0;
        for run in cells.chunk_by(|a, b| a == b) {
            let (color, words) = run.first().map_or((WHITE, String::new()), |c| meaning(*c));
            match found.iter_mut().find(|(_, known, _)| *known == words) {
                Some((_, _, points)) => *points += run.len(),
                None => found.push((color, words, run.len())),
            }
            #[expect(clippy::cast_precision_loss, reason = "small counts")]
            let (from, to, row) = (column as f64, (column + run.len()) as f64, row as f64);
            let corners = [
                (x.start + from * dx, y.start + row * dy),
                (x.start + to * dx, y.start + (row + 1.0) * dy),
            ];
            rectangles.push(Rectangle::new(corners, color.filled()));
            column += run.len();
        }
    }
    chart.draw_series(rectangles).map_err(|e| e.to_string())?;
    found.sort_by_key(|(_, _, points)| std::cmp::Reverse(*points));
    Ok(found)
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
        let svg = draw("a <b>", Axis::Z, &grid, &cells).unwrap();
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
