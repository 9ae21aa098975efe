//! The letters of plots that are not SVG: a font in the program, so that a plot is the same on every machine.

use super::shapes::{Anchor, Words};
use ttf_parser::{Face, FaceParsingError, GlyphId, OutlineBuilder};

/// Latin, Greek and a few signs of DejaVu Sans; see `font/LICENSE`.
pub(super) const FONT: &[u8] = include_bytes!("font/dejavu-sans-subset.ttf");
/// The font's name in files that contain it.
pub(super) const NAME: &str = "DejaVuSans";
/// Width of the line about bold letters, of their size: the font has no bold ones.
pub(super) const BOLD: f64 = 0.035;

/// The font, read.
pub(super) struct Letters {
    pub(super) face: Face<'static>,
}

/// A letter in its place.
pub(super) struct Placed {
    pub(super) glyph: GlyphId,
    pub(super) letter: char,
    /// Distance from the begin of the words, px.
    pub(super) along: f64,
}

impl Letters {
    pub(super) fn new() -> Result<Self, FaceParsingError> {
        let face = Face::parse(FONT, 0)?;
        Ok(Self { face })
    }

    /// Units of the font, of the size of a letter.
    pub(super) fn unit(&self) -> f64 {
        1.0 / f64::from(self.face.units_per_em())
    }

    /// Width of a letter, of its size.
    pub(super) fn width(&self, glyph: GlyphId) -> f64 {
        f64::from(self.face.glyph_hor_advance(glyph).unwrap_or(0)) * self.unit()
    }

    /// The letters of words, and how far before the words' place they begin, px.
    pub(super) fn place(&self, words: &Words) -> (Vec<Placed>, f64) {
        let (mut placed, mut along) = (Vec::new(), 0.0);
        for letter in words.text.chars() {
            // Glyph 0 is the box of a letter that the font does not have.
            let glyph = self.face.glyph_index(letter).unwrap_or_default();
            placed.push(Placed {
                glyph,
                letter,
                along,
            });
            along += self.width(glyph) * words.size;
        }
        let before = match words.anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => 0.5 * along,
            Anchor::End => along,
        };
        (placed, before)
    }

    /// Draws a letter's outline, in units of the font, y up.
    pub(super) fn outline(&self, glyph: GlyphId, into: &mut impl OutlineBuilder) {
        // A space has none.
        let _ = self.face.outline_glyph(glyph, into);
    }
}
