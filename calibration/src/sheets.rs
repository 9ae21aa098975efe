//! A target on sheets of paper: A4 or A3, as many as it needs, with marks to join them.

use super::drawing::Drawing;
use super::target::{Drawn, TargetError, drawn, edge_mm, extent, put, ruler};
use mcdpr_core::robot::Tag;

/// Distance of everything from the edge of the paper, which printers leave white, mm.
const EDGE_MM: f64 = 8.0;
/// Height of the ruler and its text at the bottom of every sheet, mm.
const FOOT_MM: f64 = 25.0;
/// Both sheets show this much beyond the line where they are joined, mm.
const OVERLAP_MM: f64 = 5.0;
/// Half of a mark's width, mm.
const MARK_MM: f64 = 4.0;

/// A format of paper, ISO 216.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Paper {
    /// 210 x 297 mm.
    A4,
    /// 297 x 420 mm.
    A3,
}

impl Paper {
    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::A4 => "A4",
            Self::A3 => "A3",
        }
    }

    /// Width and height upright, mm.
    const fn size_mm(self) -> [f64; 2] {
        match self {
            Self::A4 => [210.0, 297.0],
            Self::A3 => [297.0, 420.0],
        }
    }
}

/// Sheets of one body, left to right, then down.
#[derive(Debug, Clone, PartialEq)]
pub struct Sheets {
    /// One drawing per sheet.
    pub drawings: Vec<Drawing>,
    /// Sheets side by side, and below each other.
    pub grid: [usize; 2],
    /// Whether the paper lies on its long side.
    pub landscape: bool,
}

/// The tags of one body on paper of this format: on one sheet if they fit, else on the fewest that do not cut a
/// tag. Sheets that are joined have a line to cut along, and crosses that must meet.
///
/// # Errors
/// [`TargetError`]; [`TargetError::TooLarge`] if a single tag is larger than the paper.
pub fn sheets(tags: &[Tag], body: u32, paper: Paper) -> Result<Sheets, TargetError> {
    let drawn = drawn(tags, body)?;
    let [width, height] = paper.size_mm();
    let tried = [([width, height], false), ([height, width], true)].map(|(size, landscape)| {
        let room = [size[0] - 2.0 * EDGE_MM, size[1] - 2.0 * EDGE_MM - FOOT_MM];
        let cuts = [cuts(&drawn, 0, room[0])?, cuts(&drawn, 1, room[1])?];
        Some((size, landscape, cuts))
    });
    let count = |cuts: &[Vec<f64>; 2]| (cuts[0].len() - 1) * (cuts[1].len() - 1);
    let best = tried.into_iter().flatten();
    let best = best.min_by_key(|(_, _, cuts)| count(cuts));
    let (size, landscape, cuts) = best.ok_or(TargetError::TooLarge {
        body,
        paper: paper.name(),
    })?;
    let grid = [cuts[0].len() - 1, cuts[1].len() - 1];
    let mut drawings = Vec::new();
    for row in 0..grid[1] {
        for column in 0..grid[0] {
            let place = [column, row];
            let mut out = page(&drawn, size, &cuts, place);
            ruler(
                [EDGE_MM, size[1] - EDGE_MM - FOOT_MM + 8.0],
                edge_mm(&drawn),
                &mut out,
            );
            let all = grid[0] * grid[1];
            let number = row * grid[0] + column + 1;
            let mut words = format!("{}, sheet {number} of {all}", paper.name());
            if all > 1 {
                words += &format!(
                    ": row {}, column {}; cut along the lines, let the crosses meet",
                    row + 1,
                    column + 1
                );
            }
            out.words([EDGE_MM, size[1] - EDGE_MM - 0.5], 3.0, &words);
            drawings.push(out);
        }
    }
    Ok(Sheets {
        drawings,
        grid,
        landscape,
    })
}

/// Where the drawing is cut along an axis, from its begin to its end, so that no part is wider than the room.
/// `None` if a tag is.
fn cuts(drawn: &[Drawn], axis: usize, room: f64) -> Option<Vec<f64>> {
    let [low, high] = extent(drawn).map(|corner| corner[axis]);
    let mut spans: Vec<[f64; 2]> = drawn
        .iter()
        .map(|tag| {
            let from = tag.at[axis];
            [from - tag.rim, from + tag.edge + tag.rim]
        })
        .collect();
    spans.sort_by(|a, b| a[0].total_cmp(&b[0]));
    // The middles of what is white from one side to the other.
    let mut between = Vec::new();
    let mut end = low;
    for [from, to] in spans {
        if from > end {
            between.push(f64::midpoint(end, from));
        }
        end = end.max(to);
    }
    let mut found = vec![low];
    let mut from = low;
    loop {
        let before = if from > low { OVERLAP_MM } else { 0.0 };
        if high - from + before <= room {
            found.push(high);
            return Some(found);
        }
        let fits = |cut: &&f64| **cut > from && **cut - from + before + OVERLAP_MM <= room;
        from = *between.iter().rfind(fits)?;
        found.push(from);
    }
}

/// One sheet: the tags of its part, and the marks where it is joined.
fn page(drawn: &[Drawn], size: [f64; 2], cuts: &[Vec<f64>; 2], place: [usize; 2]) -> Drawing {
    let mut out = Drawing::new(size);
    let part = [0, 1].map(|k| [cuts[k][place[k]], cuts[k][place[k] + 1]]);
    let inner = [0, 1].map(|k| [place[k] > 0, place[k] + 2 < cuts[k].len()]);
    let origin = [0, 1].map(|k| {
        let before = if inner[k][0] { OVERLAP_MM } else { 0.0 };
        EDGE_MM + before - part[k][0]
    });
    for tag in drawn {
        let is_here = (0..2).all(|k| tag.at[k] > part[k][0] - OVERLAP_MM && tag.at[k] < part[k][1]);
        if is_here {
            put(tag, origin, &mut out);
        }
    }
    for axis in 0..2 {
        let across = 1 - axis;
        let [from, to] = part[across].map(|at| at + origin[across]);
        for (at, _) in part[axis].iter().zip(inner[axis]).filter(|(_, is)| *is) {
            let at = at + origin[axis];
            let point = |along: f64| match axis {
                0 => [at, along],
                _ => [along, at],
            };
            out.line(point(from), point(to));
            // A quarter from both ends, where the neighbour has the same.
            for share in [0.25, 0.75] {
                let along = from + (to - from) * share;
                let [x, y] = point(along);
                out.line([x - MARK_MM, y], [x + MARK_MM, y]);
                out.line([x, y - MARK_MM], [x, y + MARK_MM]);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::simulate::Target;
    use super::super::target::tags;
    use super::*;

    fn numbers(svg: &str, begins: &str, keys: [&str; 4]) -> Vec<[f64; 4]> {
        let lines = svg.lines().filter(|line| line.starts_with(begins));
        lines
            .map(|line| {
                keys.map(|key| {
                    let value = line.split(&format!(" {key}=\"")).nth(1).unwrap();
                    value.split('"').next().unwrap().parse().unwrap()
                })
            })
            .collect()
    }

    /// Black squares of a sheet.
    fn squares(svg: &str) -> Vec<[f64; 4]> {
        let black: String = svg
            .lines()
            .filter(|line| line.contains("\"black\"/>"))
            .map(|line| format!("{line}\n"))
            .collect();
        numbers(&black, "<rect", ["x", "y", "width", "height"])
    }

    #[test]
    fn one_tag_is_one_sheet_and_the_board_two_of_a3_or_six_of_a4() {
        let grid = |target, paper| sheets(&tags(target), 0, paper).unwrap().grid;
        assert_eq!(grid(Target::Tag, Paper::A4), [1, 1]);
        let product = |[a, b]: [usize; 2]| a * b;
        assert_eq!(product(grid(Target::Board, Paper::A3)), 2);
        assert_eq!(product(grid(Target::Board, Paper::A4)), 6);
    }

    #[test]
    fn joined_at_their_crosses_sheets_give_the_whole_board() {
        for paper in [Paper::A4, Paper::A3] {
            let all = tags(Target::Board);
            let Sheets {
                drawings,
                grid,
                landscape,
            } = sheets(&all, 0, paper).unwrap();
            let [mut width, mut height] = paper.size_mm();
            if landscape {
                (width, height) = (height, width);
            }
            // Where each sheet's origin lies on the first one's.
            let mut places: Vec<[f64; 2]> = Vec::new();
            let marks = |k: usize| numbers(&drawings[k].svg(), "<line", ["x1", "y1", "x2", "y2"]);
            let cross = |k: usize, vertical: bool| -> Vec<[f64; 2]> {
                let lines = marks(k);
                let is = |l: &&[f64; 4]| {
                    let (dx, dy) = (l[2] - l[0], l[3] - l[1]);
                    // The horizontal strokes of crosses, above the ruler.
                    (dx - 2.0 * MARK_MM).abs() < 1e-9
                        && dy == 0.0
                        && l[1] < height - EDGE_MM - FOOT_MM
                };
                let middles = lines.iter().filter(is).map(|l| [(l[0] + l[2]) / 2.0, l[1]]);
                // On the right edge or the lower edge of the sheet's part; on the left or the upper one.
                let mut found: Vec<_> = middles.collect();
                found.sort_by(|a, b| {
                    a[usize::from(!vertical)].total_cmp(&b[usize::from(!vertical)])
                });
                found
            };
            for k in 0..drawings.len() {
                let (column, row) = (k % grid[0], k / grid[0]);
                let place = if column > 0 {
                    let (mine, before) = (cross(k, true), cross(k - 1, true));
                    let (mine, theirs) = (mine[0], *before.last().unwrap());
                    let base = places[k - 1];
                    [base[0] + theirs[0] - mine[0], base[1]]
                } else if row > 0 {
                    let (mine, above) = (cross(k, false), cross(k - grid[0], false));
                    let (mine, theirs) = (mine[0], *above.last().unwrap());
                    let base = places[k - grid[0]];
                    [base[0], base[1] + theirs[1] - mine[1]]
                } else {
                    [0.0; 2]
                };
                places.push(place);
            }
            let mut seen = Vec::new();
            for (drawing, place) in drawings.iter().zip(&places) {
                for [x, y, dx, dy] in squares(&drawing.svg()) {
                    assert!(x > EDGE_MM && x + dx < width - EDGE_MM);
                    assert!(y > EDGE_MM && y + dy < height - EDGE_MM - FOOT_MM);
                    seen.push([x + place[0], y + place[1]]);
                }
            }
            assert_eq!(seen.len(), 9, "{paper:?}");
            seen.sort_by(|a, b| {
                (a[0].round(), a[1])
                    .partial_cmp(&(b[0].round(), b[1]))
                    .unwrap()
            });
            for (k, at) in seen.iter().enumerate() {
                let wanted = [(k / 3) as f64 * 110.0, (k % 3) as f64 * 110.0];
                let first = seen[0];
                assert!(
                    (at[0] - first[0] - wanted[0]).abs() < 1e-3,
                    "{paper:?} {k}: {at:?}"
                );
                assert!(
                    (at[1] - first[1] - wanted[1]).abs() < 1e-3,
                    "{paper:?} {k}: {at:?}"
                );
            }
        }
    }

    #[test]
    fn a_tag_larger_than_the_paper_is_refused() {
        let mut all = tags(Target::Tag);
        for tag in &mut all {
            tag.size_m = 0.25;
            tag.corners_in_body_m = tag.corners_in_body_m.map(|corner| corner * 2.5);
        }
        let refused = sheets(&all, 0, Paper::A4).unwrap_err();
        assert_eq!(
            refused,
            TargetError::TooLarge {
                body: 0,
                paper: "A4"
            }
        );
        assert!(sheets(&all, 0, Paper::A3).is_err());
        assert!(super::super::target::sheet(&all, 0).is_ok());
    }
}
