//! Targets to print: the tags, their positions on the sheet, and the drawing at true scale.
//!
//! Tag family 36h11 (Olson, 2011); the code words are those of the detector.

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

/// A rectangle of a drawing, mm.
pub(crate) struct Block {
    pub(crate) at: [f64; 2],
    pub(crate) size: [f64; 2],
    pub(crate) fill: &'static str,
}

/// A tag as it is drawn.
pub(crate) struct Drawn {
    /// The black square with its white cells; the first block is the square.
    pub(crate) blocks: Vec<Block>,
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

/// A sheet with the tags of one body as SVG, as large as they need: millimetres are millimetres, y points down
/// as in the tags' frame. A ruler of 100 mm shows whether the printer kept the scale.
///
/// # Errors
/// [`TargetError`].
pub fn sheet(tags: &[Tag], body: u32) -> Result<String, TargetError> {
    let drawn = drawn(tags, body)?;
    let [low, high] = extent(&drawn);
    let origin = low.map(|v| MARGIN_MM - v);
    // A small tag's sheet must still hold the ruler of 100 mm.
    let width = (high[0] - low[0] + 2.0 * MARGIN_MM).max(100.0 + 2.0 * MARGIN_MM + 10.0);
    let height = high[1] - low[1] + 2.0 * MARGIN_MM + RULER_MM;
    let mut out = opening([width, height]);
    for tag in &drawn {
        write(tag, origin, &mut out);
    }
    ruler(
        [MARGIN_MM, height - RULER_MM + 5.0],
        square_mm(&drawn),
        &mut out,
    );
    out.push_str("</svg>\n");
    Ok(out)
}

/// Lowest and highest corner of tags with their rims, mm.
pub(crate) fn extent(drawn: &[Drawn]) -> [[f64; 2]; 2] {
    let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
    for tag in drawn {
        for square in tag.blocks.iter().take(1) {
            for k in 0..2 {
                low[k] = low[k].min(square.at[k] - tag.rim);
                high[k] = high[k].max(square.at[k] + square.size[k] + tag.rim);
            }
        }
    }
    [low, high]
}

/// Edge of the first black square, mm.
pub(crate) fn square_mm(drawn: &[Drawn]) -> f64 {
    let square = drawn.first().and_then(|tag| tag.blocks.first());
    square.map_or(0.0, |square| square.size[0])
}

/// The beginning of a white drawing of this size, mm.
pub(crate) fn opening([width, height]: [f64; 2]) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.3}mm\" height=\"{height:.3}mm\" \
         viewBox=\"0 0 {width:.3} {height:.3}\">\n\
         <rect x=\"0\" y=\"0\" width=\"{width:.3}\" height=\"{height:.3}\" fill=\"white\"/>\n"
    )
}

/// Writes a tag whose body's origin is at `origin` of the sheet, mm.
pub(crate) fn write(tag: &Drawn, origin: [f64; 2], out: &mut String) {
    for Block { at, size, fill } in &tag.blocks {
        let [x, y] = [0, 1].map(|k| at[k] + origin[k]);
        let [width, height] = size;
        let _ = writeln!(
            out,
            "<rect x=\"{x:.4}\" y=\"{y:.4}\" width=\"{width:.4}\" height=\"{height:.4}\" fill=\"{fill}\"/>"
        );
    }
    for square in tag.blocks.iter().take(1) {
        let below = square.size[1] + tag.rim + 3.0;
        let at = [square.at[0] + origin[0], square.at[1] + origin[1] + below];
        text(at, 3.0, &tag.caption, out);
    }
}

/// Writes a line of text with this height, mm.
pub(crate) fn text([x, y]: [f64; 2], size: f64, words: &str, out: &mut String) {
    let _ = writeln!(
        out,
        "<text x=\"{x:.2}\" y=\"{y:.2}\" font-size=\"{size}\" font-family=\"sans-serif\">{words}</text>"
    );
}

/// Writes a thin line, mm.
pub(crate) fn line([x1, y1]: [f64; 2], [x2, y2]: [f64; 2], out: &mut String) {
    let _ = writeln!(
        out,
        "<line x1=\"{x1:.3}\" y1=\"{y1:.3}\" x2=\"{x2:.3}\" y2=\"{y2:.3}\" stroke=\"black\" \
         stroke-width=\"0.2\"/>"
    );
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
    let mut blocks = vec![Block {
        at: [a.x, a.y],
        size: [size; 2],
        fill: "black",
    }];
    for row in 0..CELLS - 2 {
        for column in 0..CELLS - 2 {
            // The most significant of the 36 bits is the cell at the top left.
            let bit = 35 - (row * 6 + column);
            if code >> bit & 1 == 1 {
                let at = |k: u32| f64::from(k + 1) * cell;
                blocks.push(Block {
                    at: [a.x + at(column), a.y + at(row)],
                    size: [cell; 2],
                    fill: "white",
                });
            }
        }
    }
    Ok(Drawn {
        blocks,
        caption: format!("36h11 {}", tag.id),
        rim: cell,
    })
}

/// 100 mm with a mark every 10, and a note on what to compare.
pub(crate) fn ruler([x, y]: [f64; 2], square_mm: f64, out: &mut String) {
    line([x, y], [x + 100.0, y], out);
    for k in 0..=10 {
        let at = x + f64::from(k) * 10.0;
        let long = if k % 5 == 0 { 4.0 } else { 2.0 };
        line([at, y], [at, y + long], out);
    }
    let words = "Print at 100 %. This line must be 100.0 mm long,";
    text([x, y + 8.5], 3.5, words, out);
    let words = format!("a black square {square_mm:.1} mm wide; else correct size_mm.");
    text([x, y + 13.0], 3.5, &words, out);
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
                let picture = picture(&sheet(&all, body).unwrap(), scale);
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
