//! Targets to print: the tags, their positions on the sheet, and the drawing at true scale.
//!
//! Tag family 36h11 (Olson, 2011); the code words are those of the detector.

use super::drawing::{Drawing, Mark};
use super::simulate::{Target, tags_of};
use mcdpr_core::robot::Tag;
use mcdpr_vision::tag::family::CODES;
use nalgebra::Vector3;
use std::fmt::Write as _;

/// Cells along a tag's edge: six bits and a black cell on both sides.
const CELLS: u32 = 8;
/// White space around everything, mm.
const MARGIN_MM: f64 = 15.0;
/// Height of the ruler's strip, mm.
const RULER_MM: f64 = 25.0;

/// Tags of a standard target as in the robot file.
#[must_use]
pub fn tags(target: Target) -> Vec<Tag> {
    let (tags, _) = tags_of(target);
    tags.into_iter()
        .map(|tag| Tag {
            id: tag.id,
            family: "36h11".to_owned(),
            size_m: tag.size_m,
            body: u32::try_from(tag.body).unwrap_or(0),
            corners_in_body_m: tag.corners_in_body_m,
        })
        .collect()
}

/// The `[[tag]]` tables of a robot file for these tags.
#[must_use]
pub fn tables(tags: &[Tag]) -> String {
    // Whole micrometres: the lines are for people, without the rounding of binary numbers.
    let mm = |metres: f64| (metres * 1e6).round() * 1e-3;
    let mut out = String::new();
    for tag in tags {
        let corner = |c: &Vector3<f64>| format!("[{}, {}, {}]", mm(c.x), mm(c.y), mm(c.z));
        let corners: Vec<String> = tag.corners_in_body_m.iter().map(corner).collect();
        let _ = writeln!(
            out,
            "[[tag]]\nid = {}\nfamily = \"{}\"\nsize_mm = {}\nbody = {}\ncorners_in_body_mm = [{}]\n",
            tag.id,
            tag.family,
            mm(tag.size_m),
            tag.body,
            corners.join(", ")
        );
    }
    out
}

/// Why a sheet cannot be drawn.
#[derive(Debug, Clone, PartialEq, thiserror::Error, miette::Diagnostic)]
pub enum TargetError {
    /// The sheet is empty.
    #[error("body {body} has no tag to draw")]
    #[diagnostic(
        code(mcdpr_calibration::target),
        help("the robot file's [[tag]] tables list bodies")
    )]
    Empty {
        /// The body asked for.
        body: u32,
    },
    /// The tag's family or number is not known.
    #[error("tag {id} of family {family} cannot be drawn")]
    #[diagnostic(
        code(mcdpr_calibration::target),
        help("family 36h11 has the numbers 0 to 586")
    )]
    Unknown {
        /// Its number.
        id: u32,
        /// Its family.
        family: String,
    },
    /// A tag is larger than the paper.
    #[error("a tag of body {body} is larger than a sheet of {paper}")]
    #[diagnostic(
        code(mcdpr_calibration::target),
        help("use --paper a3, or --paper one and a print shop")
    )]
    TooLarge {
        /// The body asked for.
        body: u32,
        /// The format.
        paper: &'static str,
    },
    /// The tags do not lie in one plane, square to its axes.
    #[error("tag {id} does not lie square in its body's x-y plane, so that no sheet shows it")]
    #[diagnostic(
        code(mcdpr_calibration::target),
        help("draw single tags, and measure where they are on the body")
    )]
    NotFlat {
        /// Its number.
        id: u32,
    },
}

/// A tag as it is drawn.
pub(crate) struct Drawn {
    /// Corner of the black square, mm.
    pub(crate) at: [f64; 2],
    /// Its edge, mm.
    pub(crate) edge: f64,
    /// Corners of its white cells, mm.
    cells: Vec<[f64; 2]>,
    /// Below it.
    pub(crate) caption: String,
    /// Its white rim, mm.
    pub(crate) rim: f64,
}

/// The tags of one body, each at its place in the body's plane, mm.
///
/// # Errors
/// [`TargetError`].
pub(crate) fn drawn(tags: &[Tag], body: u32) -> Result<Vec<Drawn>, TargetError> {
    let tags = tags.iter().filter(|tag| tag.body == body);
    let drawn: Vec<Drawn> = tags.map(draw).collect::<Result<_, _>>()?;
    if drawn.is_empty() {
        return Err(TargetError::Empty { body });
    }
    Ok(drawn)
}

/// A sheet with the tags of one body, as large as they need: millimetres are millimetres, y points down
/// as in the tags' frame. A ruler of 100 mm shows whether the printer kept the scale.
///
/// # Errors
/// [`TargetError`].
pub fn sheet(tags: &[Tag], body: u32) -> Result<Drawing, TargetError> {
    let drawn = drawn(tags, body)?;
    let [low, high] = extent(&drawn);
    let origin = low.map(|v| MARGIN_MM - v);
    // A small tag's sheet must still hold the ruler of 100 mm.
    let width = (high[0] - low[0] + 2.0 * MARGIN_MM).max(100.0 + 2.0 * MARGIN_MM + 10.0);
    let height = high[1] - low[1] + 2.0 * MARGIN_MM + RULER_MM;
    let mut out = Drawing::new([width, height]);
    for tag in &drawn {
        put(tag, origin, &mut out);
    }
    ruler(
        [MARGIN_MM, height - RULER_MM + 5.0],
        edge_mm(&drawn),
        &mut out,
    );
    Ok(out)
}

/// Lowest and highest corner of tags with their rims, mm.
pub(crate) fn extent(drawn: &[Drawn]) -> [[f64; 2]; 2] {
    let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
    for tag in drawn {
        for k in 0..2 {
            low[k] = low[k].min(tag.at[k] - tag.rim);
            high[k] = high[k].max(tag.at[k] + tag.edge + tag.rim);
        }
    }
    [low, high]
}

/// Edge of the first black square, mm.
pub(crate) fn edge_mm(drawn: &[Drawn]) -> f64 {
    drawn.first().map_or(0.0, |tag| tag.edge)
}

/// Draws a tag whose body's origin is at `origin` of the sheet, mm.
pub(crate) fn put(tag: &Drawn, origin: [f64; 2], out: &mut Drawing) {
    let on_sheet = |at: &[f64; 2]| [at[0] + origin[0], at[1] + origin[1]];
    let at = on_sheet(&tag.at);
    out.marks.push(Mark::Block {
        at,
        size: [tag.edge; 2],
        black: true,
    });
    let cells = tag.cells.iter().map(|cell| Mark::Block {
        at: on_sheet(cell),
        size: [tag.edge / f64::from(CELLS); 2],
        black: false,
    });
    out.marks.extend(cells);
    out.words([at[0], at[1] + tag.edge + tag.rim + 3.0], 3.0, &tag.caption);
}

fn draw(tag: &Tag) -> Result<Drawn, TargetError> {
    let index = usize::try_from(tag.id).unwrap_or(usize::MAX);
    let code = CODES.get(index).filter(|_| tag.family == "36h11");
    let code = *code.ok_or_else(|| TargetError::Unknown {
        id: tag.id,
        family: tag.family.clone(),
    })?;
    let [a, b, _, d] = tag.corners_in_body_m.map(|corner| corner * 1e3);
    let size = tag.size_m * 1e3;
    let square = (b - a - Vector3::x() * size).norm() < 1e-3
        && (d - a - Vector3::y() * size).norm() < 1e-3
        && a.z.abs() < 1e-3;
    if !square {
        return Err(TargetError::NotFlat { id: tag.id });
    }
    let cell = size / f64::from(CELLS);
    let mut cells = Vec::new();
    for row in 0..CELLS - 2 {
        for column in 0..CELLS - 2 {
            // The most significant of the 36 bits is the cell at the top left.
            let bit = 35 - (row * 6 + column);
            if code >> bit & 1 == 1 {
                let at = |k: u32| f64::from(k + 1) * cell;
                cells.push([a.x + at(column), a.y + at(row)]);
            }
        }
    }
    Ok(Drawn {
        at: [a.x, a.y],
        edge: size,
        cells,
        caption: format!("36h11 {}", tag.id),
        rim: cell,
    })
}

/// 100 mm with a mark every 10, and a note on what to compare.
pub(crate) fn ruler([x, y]: [f64; 2], edge_mm: f64, out: &mut Drawing) {
    out.line([x, y], [x + 100.0, y]);
    for k in 0..=10 {
        let at = x + f64::from(k) * 10.0;
        let long = if k % 5 == 0 { 4.0 } else { 2.0 };
        out.line([at, y], [at, y + long]);
    }
    let words = "Print at 100 %. This line must be 100.0 mm long,";
    out.words([x, y + 8.5], 3.5, words);
    let words = format!("a black square {edge_mm:.1} mm wide; else correct size_mm.");
    out.words([x, y + 13.0], 3.5, &words);
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcdpr_vision::image::GrayImage;
    use mcdpr_vision::tag::{self, Options};

    fn value(line: &str, key: &str) -> f64 {
        let text = line.split(&format!(" {key}=\"")).nth(1).unwrap();
        text.split('"')
            .next()
            .unwrap()
            .trim_end_matches("mm")
            .parse()
            .unwrap()
    }

    /// The sheet's rectangles as a picture with `scale` px a mm, 4 x 4 samples a pixel.
    fn picture(svg: &str, scale: f64) -> GrayImage {
        let head = svg.lines().next().unwrap();
        let size = ["width", "height"].map(|key| (value(head, key) * scale).ceil() as usize);
        let fine = 4;
        let (w, h) = (size[0] * fine, size[1] * fine);
        let mut samples = vec![255_u8; w * h];
        for line in svg.lines().filter(|line| line.starts_with("<rect")) {
            let grey = if line.contains("black") { 0 } else { 255 };
            let [x, y, dx, dy] = ["x", "y", "width", "height"].map(|key| value(line, key));
            let at = |mm: f64| (mm * scale * fine as f64).round() as usize;
            for row in at(y)..at(y + dy).min(h) {
                samples[row * w + at(x)..row * w + at(x + dx).min(w)].fill(grey);
            }
        }
        let mut pixels = Vec::with_capacity(size[0] * size[1]);
        for row in 0..size[1] {
            for column in 0..size[0] {
                let mut sum = 0_u32;
                for k in 0..fine * fine {
                    let (r, c) = (row * fine + k / fine, column * fine + k % fine);
                    sum += u32::from(samples[r * w + c]);
                }
                pixels.push((sum / 16) as u8);
            }
        }
        GrayImage::new(size[0], size[1], pixels).unwrap()
    }

    #[test]
    fn every_printed_tag_is_detected_where_the_robot_file_says() {
        for target in [Target::Tag, Target::Board, Target::Loose] {
            let all = tags(target);
            let bodies = all.iter().map(|tag| tag.body).max().unwrap();
            for body in 0..=bodies {
                let wanted: Vec<&Tag> = all.iter().filter(|tag| tag.body == body).collect();
                let scale = 3.0;
                let picture = picture(&sheet(&all, body).unwrap().svg(), scale);
                let found = tag::detect(&picture, None, &Options::default());
                assert_eq!(found.len(), wanted.len(), "{target:?}, body {body}");
                // The sheet is shifted, never turned or scaled.
                let first = found.iter().find(|f| f.id == wanted[0].id).unwrap();
                let shift = |k: usize| {
                    first.corners_px[0][k] - wanted[0].corners_in_body_m[0][k] * 1e3 * scale
                };
                for tag in &wanted {
                    let seen = found.iter().find(|f| f.id == tag.id).unwrap();
                    for (corner, pixel) in tag.corners_in_body_m.iter().zip(&seen.corners_px) {
                        for k in 0..2 {
                            let off = pixel[k] - corner[k] * 1e3 * scale - shift(k);
                            assert!(off.abs() < 0.15, "{target:?} tag {}: {off} px", tag.id);
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn what_can_not_be_drawn_is_said() {
        let mut all = tags(Target::Tag);
        assert_eq!(sheet(&all, 3), Err(TargetError::Empty { body: 3 }));
        all[0].id = 587;
        assert!(matches!(
            sheet(&all, 0),
            Err(TargetError::Unknown { id: 587, .. })
        ));
        all[0].id = 5;
        all[0].corners_in_body_m[1].z = 0.01;
        assert!(matches!(
            sheet(&all, 0),
            Err(TargetError::NotFlat { id: 5 })
        ));
    }
}
