//! Plots and sheets as PDF, with the letters as letters. A plot is one page of a column's width for each column
//! of charts; a sheet is a page at true scale.

use super::file::PlotError;
use super::letters::{BOLD, FONT, Letters, NAME};
use super::shapes::{Shape, Words, rgb};
use super::{COLUMN_MM, WIDTH};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use pdf_writer::types::{
    CidFontType, FontFlags, LineJoinStyle, SystemInfo, TextRenderingMode, UnicodeCmap,
};
use pdf_writer::{Content, Filter, Finish as _, Name, Pdf, Rect, Ref, Str, TextStr};
use std::collections::BTreeMap;
use std::io::Write as _;

/// Names of what the page uses.
const LETTERS: Name = Name(b"F");
const BAND: Name = Name(b"B");

/// Numbers of the file's objects.
struct Ids {
    catalog: Ref,
    pages: Ref,
    font: Ref,
    glyphs: Ref,
    descriptor: Ref,
    file: Ref,
    unicode: Ref,
    info: Ref,
}

/// Points of 1/72 inch for a pixel of a plot.
pub(super) const PLOT_POINTS: f64 = COLUMN_MM / 25.4 * 72.0 / WIDTH;
/// The same for a millimetre of a sheet.
pub(super) const SHEET_POINTS: f64 = 72.0 / 25.4;

/// Pages of shapes and their width and height as the bytes of a PDF file; `points` is the length of a unit. It
/// has no date: the same plot gives the same bytes.
pub(super) fn pdf(
    title: &str,
    pages: &[(Vec<Shape>, [f64; 2])],
    points: f64,
    letters: &Letters,
) -> Result<Vec<u8>, PlotError> {
    let mut number = 0;
    let mut next = || {
        number += 1;
        Ref::new(number)
    };
    let ids = Ids {
        catalog: next(),
        pages: next(),
        font: next(),
        glyphs: next(),
        descriptor: next(),
        file: next(),
        unicode: next(),
        info: next(),
    };
    let places: Vec<[Ref; 2]> = pages.iter().map(|_| [next(), next()]).collect();
    let mut file = Pdf::new();
    file.catalog(ids.catalog).pages(ids.pages);
    let count = i32::try_from(pages.len()).unwrap_or(i32::MAX);
    file.pages(ids.pages)
        .kids(places.iter().map(|[page, _]| *page))
        .count(count);
    let mut used = BTreeMap::new();
    for ((shapes, [width, height]), [id, content]) in pages.iter().zip(places) {
        let mut page = Page {
            content: Content::new(),
            letters,
            used: &mut used,
        };
        // From here on as in the picture: px or mm, y down.
        let [unit, right, top] = [points, width * points, height * points].map(short);
        page.content.transform([unit, 0.0, 0.0, -unit, 0.0, top]);
        let opacities = shapes.iter().filter_map(|shape| match shape {
            Shape::Rect { opacity, .. } if *opacity < 1.0 => Some(short(*opacity)),
            _ => None,
        });
        let opacity = opacities.fold(1.0, f32::min);
        for shape in shapes {
            page.draw(shape);
        }
        let packed = packed(&page.content.finish())?;
        let mut sheet = file.page(id);
        sheet
            .parent(ids.pages)
            .media_box(Rect::new(0.0, 0.0, right, top))
            .contents(content);
        let mut resources = sheet.resources();
        resources.fonts().pair(LETTERS, ids.font);
        resources
            .ext_g_states()
            .insert(BAND)
            .start::<pdf_writer::writers::ExtGraphicsState>()
            .non_stroking_alpha(opacity);
        resources.finish();
        sheet.finish();
        file.stream(content, &packed).filter(Filter::FlateDecode);
    }
    let mut info = file.document_info(ids.info);
    info.title(TextStr(title)).producer(TextStr("mcdpr"));
    info.finish();
    embed(&mut file, &ids, letters, &used)?;
    Ok(file.finish())
}

/// As the library counts.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a tenth of a pixel is enough"
)]
const fn short(value: f64) -> f32 {
    value as f32
}

fn packed(bytes: &[u8]) -> Result<Vec<u8>, PlotError> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes)?;
    Ok(encoder.finish()?)
}

struct Page<'a> {
    content: Content,
    letters: &'a Letters,
    /// Letters that are on a page, by their number in the font.
    used: &'a mut BTreeMap<u16, char>,
}

impl Page<'_> {
    fn draw(&mut self, shape: &Shape) {
        match shape {
            Shape::Rect {
                at,
                size,
                fill,
                opacity,
                ..
            } => {
                let ([x, y], [width, height]) = (at.map(short), size.map(short));
                self.content.save_state();
                if *opacity < 1.0 {
                    self.content.set_parameters(BAND);
                }
                let [red, green, blue] = color(fill);
                self.content
                    .set_fill_rgb(red, green, blue)
                    .rect(x, y, width, height)
                    .fill_nonzero()
                    .restore_state();
            }
            Shape::Lines {
                lines,
                stroke,
                width,
                dash,
                ..
            } => {
                let [red, green, blue] = color(stroke);
                self.content
                    .set_stroke_rgb(red, green, blue)
                    .set_line_width(short(*width))
                    .set_line_join(LineJoinStyle::RoundJoin)
                    .set_dash_pattern(dash.iter().copied(), 0.0);
                for line in lines {
                    for (index, at) in line.iter().enumerate() {
                        let [x, y] = at.map(short);
                        if index == 0 {
                            self.content.move_to(x, y);
                        } else {
                            self.content.line_to(x, y);
                        }
                    }
                }
                self.content.stroke();
            }
            Shape::Words(words) => self.words(words),
        }
    }

    fn words(&mut self, words: &Words) {
        let (placed, before) = self.letters.place(words);
        let mut codes = Vec::new();
        for letter in &placed {
            codes.extend(letter.glyph.0.to_be_bytes());
            self.used.insert(letter.glyph.0, letter.letter);
        }
        let [x, y] = words.at.map(short);
        let back = short(-before);
        // Letters stand upright although y is down.
        let place = if words.upwards {
            [0.0, -1.0, -1.0, 0.0, x, y - back]
        } else {
            [1.0, 0.0, 0.0, -1.0, x + back, y]
        };
        let [red, green, blue] = color(words.fill);
        let content = &mut self.content;
        content.set_fill_rgb(red, green, blue).begin_text();
        if words.bold {
            content
                .set_stroke_rgb(red, green, blue)
                .set_line_width(short(BOLD * words.size))
                .set_dash_pattern([], 0.0)
                .set_text_rendering_mode(TextRenderingMode::FillStroke);
        } else {
            content.set_text_rendering_mode(TextRenderingMode::Fill);
        }
        content
            .set_font(LETTERS, short(words.size))
            .set_text_matrix(place)
            .show(Str(&codes))
            .end_text();
    }
}

fn color(hex: &str) -> [f32; 3] {
    rgb(hex).map(|part| f32::from(part) / 255.0)
}

/// The font with what readers need to draw, find and copy its letters.
fn embed(
    file: &mut Pdf,
    ids: &Ids,
    letters: &Letters,
    used: &BTreeMap<u16, char>,
) -> Result<(), PlotError> {
    let name = Name(NAME.as_bytes());
    let system = SystemInfo {
        registry: Str(b"Adobe"),
        ordering: Str(b"Identity"),
        supplement: 0,
    };
    file.type0_font(ids.font)
        .base_font(name)
        .encoding_predefined(Name(b"Identity-H"))
        .descendant_font(ids.glyphs)
        .to_unicode(ids.unicode);
    let mut glyphs = file.cid_font(ids.glyphs);
    glyphs
        .subtype(CidFontType::Type2)
        .base_font(name)
        .system_info(system)
        .font_descriptor(ids.descriptor)
        .cid_to_gid_map_predefined(Name(b"Identity"));
    let mut widths = glyphs.widths();
    for &glyph in used.keys() {
        let width = letters.width(ttf_parser::GlyphId(glyph)) * 1e3;
        widths.same(glyph, glyph, short(width));
    }
    widths.finish();
    glyphs.finish();
    let face = &letters.face;
    let per_mille = |units: i16| short(f64::from(units) * letters.unit() * 1e3);
    let bounds = face.global_bounding_box();
    let [left, low, right, high] =
        [bounds.x_min, bounds.y_min, bounds.x_max, bounds.y_max].map(per_mille);
    file.font_descriptor(ids.descriptor)
        .name(name)
        .flags(FontFlags::NON_SYMBOLIC)
        .bbox(Rect::new(left, low, right, high))
        .italic_angle(0.0)
        .ascent(per_mille(face.ascender()))
        .descent(per_mille(face.descender()))
        .cap_height(per_mille(face.capital_height().unwrap_or(0)))
        // Readers use it only if they have to replace the font.
        .stem_v(80.0)
        .font_file2(ids.file);
    let font = packed(FONT)?;
    let size = i32::try_from(FONT.len()).unwrap_or(i32::MAX);
    let mut stream = file.stream(ids.file, &font);
    stream.filter(Filter::FlateDecode);
    stream.pair(Name(b"Length1"), size);
    stream.finish();
    let mut unicode = UnicodeCmap::<u16>::new(Name(b"Letters"), system);
    for (&glyph, &letter) in used {
        unicode.pair(glyph, letter);
    }
    file.cmap(ids.unicode, &unicode.finish());
    Ok(())
}

#[cfg(test)]
mod tests {
    use crate::chart::{Chart, Curve, Figure, PlotFormat};
    use std::io::Read as _;

    /// Every object of a file by the table at its end; each must be where the table says.
    fn objects(bytes: &[u8]) -> Vec<&[u8]> {
        let find = |what: &[u8], from: usize| {
            let found = bytes[from..].windows(what.len()).position(|w| w == what);
            from + found.unwrap()
        };
        assert!(bytes.starts_with(b"%PDF-1.") && bytes.trim_ascii_end().ends_with(b"%%EOF"));
        let last = bytes.windows(9).rposition(|w| w == b"startxref").unwrap();
        let tail = std::str::from_utf8(&bytes[last + 9..]).unwrap();
        let table: usize = tail.split_whitespace().next().unwrap().parse().unwrap();
        assert!(bytes[table..].starts_with(b"xref"));
        let rows = std::str::from_utf8(&bytes[table..find(b"trailer", table)]).unwrap();
        let rows = rows
            .lines()
            .skip(3)
            .map(|row| row[..10].parse::<usize>().unwrap());
        (1..)
            .zip(rows)
            .map(|(number, at): (usize, usize)| {
                assert!(
                    bytes[at..].starts_with(format!("{number} 0 obj").as_bytes()),
                    "{number}"
                );
                &bytes[at..find(b"endobj", at)]
            })
            .collect()
    }

    fn unpacked(object: &[u8]) -> Vec<u8> {
        let begin = object.windows(7).position(|w| w == b"stream\n").unwrap() + 7;
        let mut out = Vec::new();
        let mut decoder = flate2::read::ZlibDecoder::new(&object[begin..]);
        decoder.read_to_end(&mut out).unwrap();
        out
    }

    #[test]
    fn the_file_is_complete_and_its_words_are_letters() {
        let curve = Curve::new("a curve", 0, [(0.0, 1.0), (1.0, 2.0)]);
        let chart = Chart::new("a chart", "time, s", "N")
            .with([curve])
            .band(1.2, 1.4);
        let figure = Figure::new("A title", 1, [chart]);
        let bytes = figure.file(PlotFormat::Pdf).unwrap();
        assert_eq!(bytes, figure.file(PlotFormat::Pdf).unwrap());
        let objects = objects(&bytes);
        assert_eq!(objects.len(), 10);
        let page = String::from_utf8_lossy(objects[8]);
        let size = page.split("/MediaBox [").nth(1).unwrap();
        let width: f64 = size.split_whitespace().nth(2).unwrap().parse().unwrap();
        assert!((width / 72.0 * 25.4 - 85.0).abs() < 0.1, "{page}");
        let content = String::from_utf8_lossy(&unpacked(objects[9])).into_owned();
        assert!(content.matches(" Tj").count() > 8, "{content}");
        assert!(
            content.contains(" 0.44705883 0.69803923 RG"),
            "the curve\n{content}"
        );
        assert_eq!(unpacked(objects[5]), super::FONT);
        let unicode = String::from_utf8_lossy(objects[6]);
        for letter in "Atitle".chars() {
            assert!(
                unicode.contains(&format!("<{:04X}>", u32::from(letter))),
                "{letter}"
            );
        }
    }
}
