//! Plots as PNG.

use super::file::PlotError;
use super::letters::{BOLD, Letters};
use super::shapes::{Shape, Words, rgb};
use super::{COLUMN_MM, WIDTH};
use tiny_skia::{
    Color, FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Rect, Stroke, StrokeDash,
    Transform,
};
use ttf_parser::OutlineBuilder;

/// Pixels per inch, as journals ask for.
const DPI: f64 = 300.0;

/// Shapes on white as the bytes of a PNG file. The libraries compute without SIMD: every machine gives the same.
pub(super) fn png(
    shapes: &[Shape],
    [width, height]: [f64; 2],
    letters: &Letters,
) -> Result<Vec<u8>, PlotError> {
    let scale = COLUMN_MM / 25.4 * DPI / WIDTH;
    let mut canvas = Canvas {
        pixels: whole(width * scale)
            .zip(whole(height * scale))
            .and_then(|(width, height)| Pixmap::new(width, height))
            .ok_or(PlotError::Size { width, height })?,
        scale,
        letters,
    };
    canvas.pixels.fill(Color::WHITE);
    for shape in shapes {
        canvas.draw(shape);
    }
    encode(&canvas.pixels)
}

/// Most pixels of a side.
const MOST: f64 = 20_000.0;

fn whole(value: f64) -> Option<u32> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the range was checked"
    )]
    (1.0..=MOST).contains(&value).then(|| value.round() as u32)
}

/// As the library counts.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a tenth of a pixel is enough"
)]
const fn short(value: f64) -> f32 {
    value as f32
}

struct Canvas<'a> {
    pixels: Pixmap,
    scale: f64,
    letters: &'a Letters,
}

impl Canvas<'_> {
    fn draw(&mut self, shape: &Shape) {
        let scale = Transform::from_scale(short(self.scale), short(self.scale));
        match shape {
            Shape::Rect {
                at: [x, y],
                size: [width, height],
                fill,
                opacity,
                crisp,
                ..
            } => {
                let mut edges = [*x, *y, x + width, y + height].map(|edge| edge * self.scale);
                if *crisp {
                    edges = edges.map(f64::round);
                }
                let [left, top, right, bottom] = edges.map(short);
                // One without an area is not drawn.
                let Some(rect) = Rect::from_ltrb(left, top, right, bottom) else {
                    return;
                };
                let paint = paint(fill, *opacity);
                self.pixels
                    .fill_rect(rect, &paint, Transform::identity(), None);
            }
            Shape::Lines {
                lines,
                stroke,
                width,
                dash,
                ..
            } => {
                let mut builder = PathBuilder::new();
                for line in lines {
                    for (index, at) in line.iter().enumerate() {
                        let [x, y] = at.map(short);
                        if index == 0 {
                            builder.move_to(x, y);
                        } else {
                            builder.line_to(x, y);
                        }
                    }
                }
                let Some(path) = builder.finish() else { return };
                let pen = Stroke {
                    width: short(*width),
                    line_cap: LineCap::Butt,
                    line_join: LineJoin::Round,
                    dash: StrokeDash::new(dash.to_vec(), 0.0),
                    ..Stroke::default()
                };
                self.pixels
                    .stroke_path(&path, &paint(stroke, 1.0), &pen, scale, None);
            }
            Shape::Words(words) => self.words(words, scale),
        }
    }

    fn words(&mut self, words: &Words, scale: Transform) {
        let (placed, before) = self.letters.place(words);
        let unit = self.letters.unit() * words.size;
        let [x, y] = words.at.map(short);
        let mut here = scale.pre_translate(x, y);
        if words.upwards {
            here = here.pre_rotate(-90.0);
        }
        let paint = paint(words.fill, 1.0);
        for letter in placed {
            let mut outline = Outline(PathBuilder::new());
            self.letters.outline(letter.glyph, &mut outline);
            let Some(path): Option<Path> = outline.0.finish() else {
                continue;
            };
            let at = here
                .pre_translate(short(letter.along - before), 0.0)
                .pre_scale(short(unit), short(-unit));
            self.pixels
                .fill_path(&path, &paint, FillRule::Winding, at, None);
            if words.bold {
                let pen = Stroke {
                    width: short(BOLD * words.size / unit),
                    ..Stroke::default()
                };
                self.pixels.stroke_path(&path, &paint, &pen, at, None);
            }
        }
    }
}

fn paint(color: &str, opacity: f64) -> Paint<'static> {
    let [red, green, blue] = rgb(color);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "from 0 to 255"
    )]
    let alpha = (opacity.clamp(0.0, 1.0) * 255.0).round() as u8;
    let mut paint = Paint::default();
    paint.set_color_rgba8(red, green, blue, alpha);
    paint.anti_alias = true;
    paint
}

struct Outline(PathBuilder);

impl OutlineBuilder for Outline {
    fn move_to(&mut self, x: f32, y: f32) {
        self.0.move_to(x, y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.0.line_to(x, y);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        self.0.quad_to(x1, y1, x, y);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        self.0.cubic_to(x1, y1, x2, y2, x, y);
    }

    fn close(&mut self) {
        self.0.close();
    }
}

fn encode(pixels: &Pixmap) -> Result<Vec<u8>, PlotError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, pixels.width(), pixels.height());
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    // Programs for text place the picture in its true size by this.
    let per_metre = whole(DPI / 0.0254);
    encoder.set_pixel_dims(per_metre.map(|per_metre| png::PixelDimensions {
        xppu: per_metre,
        yppu: per_metre,
        unit: png::Unit::Meter,
    }));
    let mut writer = encoder.write_header()?;
    // On white, nothing is transparent.
    let colors = pixels.data().chunks_exact(4);
    let colors: Vec<u8> = colors
        .flat_map(|rgba| rgba.iter().copied().take(3))
        .collect();
    writer.write_image_data(&colors)?;
    writer.finish()?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use crate::chart::{Chart, Curve, Figure, PlotFormat};

    fn read(bytes: &[u8]) -> (png::OutputInfo, Vec<u8>, Option<png::PixelDimensions>) {
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
            .read_info()
            .unwrap();
        let mut colors = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut colors).unwrap();
        (info, colors, reader.info().pixel_dims)
    }

    fn figure(title: &str) -> Figure {
        let curve = Curve::new("a curve", 0, [(0.0, 1.0), (1.0, 2.0)]);
        let chart = Chart::new("a chart", "time, s", "N")
            .with([curve])
            .band(1.2, 1.4);
        Figure::new(title, 1, [chart])
    }

    #[test]
    fn a_column_has_300_pixels_per_inch_and_its_words_are_drawn() {
        let (info, colors, size) = read(&figure("A title").file(PlotFormat::Png).unwrap());
        assert_eq!(info.width, 1004, "85 mm");
        assert_eq!(size.unwrap().xppu, 11_811);
        let (_, other, _) = read(&figure("").file(PlotFormat::Png).unwrap());
        // The title is at the upper left, and nothing else differs.
        let width = info.width as usize;
        let (mut title, mut rest) = (0, 0);
        for (index, (a, b)) in colors.chunks(3).zip(other.chunks(3)).enumerate() {
            let (row, column) = (index / width, index % width);
            if a != b && row < 56 && column < 250 {
                title += 1;
            } else if a != b {
                rest += 1;
            }
        }
        assert!(title > 300 && rest == 0, "{title} {rest}");
        let has = |color: [u8; 3]| colors.chunks(3).any(|pixel| pixel == color);
        assert!(has([0xff; 3]) && has([0x00, 0x72, 0xb2]), "paper and curve");
    }

    #[test]
    fn names_of_axes_and_values_are_dark_where_they_belong() {
        let (info, colors, _) = read(&figure("").file(PlotFormat::Png).unwrap());
        let width = info.width as usize;
        let dark = |rows: std::ops::Range<usize>, columns: std::ops::Range<usize>| {
            let all = rows.flat_map(|row| {
                columns
                    .clone()
                    .map(move |column| 3 * (row * width + column))
            });
            all.filter(|at| colors[*at] < 0x90).count()
        };
        let height = info.height as usize;
        // Below: the name of the axis in the middle; at its left: that of the other one, upwards.
        assert!(dark(height - 60..height, 400..700) > 100);
        assert!(dark(height / 2 - 60..height / 2 + 60, 5..35) > 30);
        assert_eq!(
            dark(height - 60..height - 25, 750..width),
            0,
            "nothing there"
        );
    }
}
