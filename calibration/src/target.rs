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

/// A sheet with the tags of one body as SVG: millimetres are millimetres, y points down as in the
/// tags' frame. A ruler of 100 mm shows whether the printer kept the scale.
///
/// # Errors
/// [`TargetError`].
pub fn sheet(tags: &[Tag], body: u32) -> Result<String, TargetError> {
    let tags: Vec<&Tag> = tags.iter().filter(|tag| tag.body == body).collect();
    if tags.is_empty() {
        return Err(TargetError::Empty { body });
    }
    let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
    for tag in &tags {
        let rim = tag.size_m * 1e3 / f64::from(CELLS);
        for corner in &tag.corners_in_body_m {
            for k in 0..2 {
                low[k] = low[k].min(corner[k] * 1e3 - rim);
                high[k] = high[k].max(corner[k] * 1e3 + rim);
            }
        }
    }
    let origin = low.map(|v| MARGIN_MM - v);
    // A small tag's sheet must still hold the ruler of 100 mm.
    let width = (high[0] - low[0] + 2.0 * MARGIN_MM).max(100.0 + 2.0 * MARGIN_MM + 10.0);
    let height = high[1] - low[1] + 2.0 * MARGIN_MM + RULER_MM;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.3}mm\" height=\"{height:.3}mm\" \
         viewBox=\"0 0 {width:.3} {height:.3}\">\n\
         <rect x=\"0\" y=\"0\" width=\"{width:.3}\" height=\"{height:.3}\" fill=\"white\"/>\n"
    );
    for tag in &tags {
        draw(tag, origin, &mut out)?;
    }
    ruler(MARGIN_MM, height - RULER_MM + 5.0, &tags, &mut out);
    out.push_str("</svg>\n");
    Ok(out)
}

fn draw(tag: &Tag, origin: [f64; 2], out: &mut String) -> Result<(), TargetError> {
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
    let (x, y) = (a.x + origin[0], a.y + origin[1]);
    let mut rect = |x: f64, y: f64, w: f64, h: f64, fill: &str| {
        let _ = writeln!(
            out,
            "<rect x=\"{x:.4}\" y=\"{y:.4}\" width=\"{w:.4}\" height=\"{h:.4}\" fill=\"{fill}\"/>"
        );
    };
    rect(x, y, size, size, "black");
    for row in 0..CELLS - 2 {
        for column in 0..CELLS - 2 {
            // The most significant of the 36 bits is the cell at the top left.
            let bit = 35 - (row * 6 + column);
            if code >> bit & 1 == 1 {
                let at = |k: u32| f64::from(k + 1) * cell;
                rect(x + at(column), y + at(row), cell, cell, "white");
            }
        }
    }
    let ids = format!("36h11 {}", tag.id);
    let _ = writeln!(
        out,
        "<text x=\"{x:.2}\" y=\"{:.2}\" font-size=\"3\" font-family=\"sans-serif\">{ids}</text>",
        y + size + cell + 3.0
    );
    Ok(())
}

/// 100 mm with a mark every 10, and a note on what to compare.
fn ruler(x: f64, y: f64, tags: &[&Tag], out: &mut String) {
    let mut line = |x1: f64, y1: f64, x2: f64, y2: f64| {
        let _ = writeln!(
            out,
            "<line x1=\"{x1:.3}\" y1=\"{y1:.3}\" x2=\"{x2:.3}\" y2=\"{y2:.3}\" stroke=\"black\" \
             stroke-width=\"0.2\"/>"
        );
    };
    line(x, y, x + 100.0, y);
    for k in 0..=10 {
        let at = x + f64::from(k) * 10.0;
        line(at, y, at, y + if k % 5 == 0 { 4.0 } else { 2.0 });
    }
    let size = tags.first().map_or(0.0, |tag| tag.size_m * 1e3);
    let _ = writeln!(
        out,
        "<text x=\"{x:.2}\" y=\"{:.2}\" font-size=\"3.5\" font-family=\"sans-serif\">Print at 100 %. This \
         line must be 100.0 mm long, a black square {size:.1} mm wide; else correct size_mm.</text>",
        y + 9.0
    );
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
