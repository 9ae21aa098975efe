//! Ranges, round steps and the grid of a chart.

use super::shapes::{Anchor, Shape, Words};
use super::{HEIGHT, WIDTH};

const LEFT: f64 = 56.0;
const RIGHT: f64 = 12.0;
const BOTTOM: f64 = 40.0;

/// A range of values, empty at first.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    low: f64,
    high: f64,
}

impl Default for Span {
    fn default() -> Self {
        Self {
            low: f64::INFINITY,
            high: f64::NEG_INFINITY,
        }
    }
}

impl Span {
    pub(super) const fn include(&mut self, value: f64) {
        self.low = self.low.min(value);
        self.high = self.high.max(value);
    }

    /// Adds a share of its width at both ends.
    pub(super) fn widen(&mut self, share: f64) {
        let margin = ((self.high - self.low) * share).max(1e-6);
        self.low -= margin;
        self.high += margin;
    }

    /// A range that can be drawn: an empty one becomes 0 to 1, a point a range about it.
    fn drawable(self) -> Self {
        if !(self.low.is_finite() && self.high.is_finite() && self.low <= self.high) {
            return Self {
                low: 0.0,
                high: 1.0,
            };
        }
        if self.high - self.low < 1e-9 {
            return Self {
                low: self.low - 0.5,
                high: self.high + 0.5,
            };
        }
        self
    }

    const fn width(self) -> f64 {
        self.high - self.low
    }

    /// The same middle with another width.
    fn about_middle(self, width: f64) -> Self {
        let middle = 0.5 * (self.low + self.high);
        Self {
            low: middle - 0.5 * width,
            high: middle + 0.5 * width,
        }
    }

    /// Round values within, about `count` of them, and the digits that tell them apart.
    fn ticks(self, count: f64) -> (Vec<f64>, usize) {
        let step = round_step(self.width(), count);
        let mut values = Vec::new();
        let mut value = (self.low / step).ceil() * step;
        while value <= self.high && values.len() < 100 {
            // No minus in front of a zero.
            values.push(if value.abs() < step * 1e-6 {
                0.0
            } else {
                value
            });
            value += step;
        }
        let digits = (0..6_i32).find(|digits| step >= 0.999 * 10_f64.powi(-digits));
        (values, usize::try_from(digits.unwrap_or(6)).unwrap_or(6))
    }
}

/// Steps of 1, 2 or 5 times a power of ten, about this many over a range.
fn round_step(range: f64, count: f64) -> f64 {
    let raw = (range / count).max(1e-12);
    let power = 10_f64.powf(raw.log10().floor());
    let rest = raw / power;
    let factors = [1.0, 2.0, 5.0];
    power * factors.into_iter().find(|f| rest <= *f).unwrap_or(10.0)
}

/// Where values are in the picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    across: Span,
    up: Span,
    top: f64,
    inner_height: f64,
}

impl Frame {
    /// A frame for these ranges below `top`, px.
    pub(super) fn new(across: Span, up: Span, top: f64, square: bool) -> Self {
        let (mut across, mut up) = (across.drawable(), up.drawable());
        let inner_width = WIDTH - LEFT - RIGHT;
        let inner_height = if square { inner_width } else { HEIGHT };
        if square {
            let width = across.width().max(up.width()) * 1.05;
            across = across.about_middle(width);
            up = up.about_middle(width);
        }
        Self {
            across,
            up,
            top,
            inner_height,
        }
    }

    /// Height of the whole picture, px.
    pub(super) const fn height(&self) -> f64 {
        self.top + self.inner_height + BOTTOM
    }

    /// Left and right edge of the plotting area, px.
    #[expect(clippy::unused_self, reason = "the counterpart of `ends`")]
    pub(super) const fn sides(&self) -> [f64; 2] {
        [LEFT, WIDTH - RIGHT]
    }

    /// Upper and lower edge of the plotting area, px.
    pub(super) const fn ends(&self) -> [f64; 2] {
        [self.top, self.top + self.inner_height]
    }

    /// A point of the chart in the picture, px.
    pub(super) fn px(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [left, right] = self.sides();
        [
            left + (x - self.across.low) / self.across.width() * (right - left),
            self.top + (self.up.high - y) / self.up.width() * self.inner_height,
        ]
    }

    /// Grid lines, their values, and the names of the axes.
    pub(super) fn draw_grid(&self, shapes: &mut Vec<Shape>, across: &str, up: &str) {
        let ([left, right], [top, bottom]) = (self.sides(), self.ends());
        let line = |from: [f64; 2], to: [f64; 2]| Shape::Lines {
            class: "grid".to_owned(),
            lines: vec![vec![from, to]],
            stroke: "#dde3ea".to_owned(),
            width: 1.0,
            dash: &[],
            tip: None,
        };
        let (values, digits) = self.up.ticks(5.0);
        for value in values {
            let [_, at] = self.px([0.0, value]);
            shapes.push(line([left, at], [right, at]));
            let text = format!("{value:.digits$}");
            let words = Words::new("y", Anchor::End, [left - 5.0, at + 4.0], text);
            shapes.push(Shape::Words(words));
        }
        let (values, digits) = self.across.ticks(7.0);
        for value in values {
            let [at, _] = self.px([value, 0.0]);
            shapes.push(line([at, top], [at, bottom]));
            let text = format!("{value:.digits$}");
            let words = Words::new("x", Anchor::Middle, [at, bottom + 15.0], text);
            shapes.push(Shape::Words(words));
        }
        let below = [0.5 * (left + right), bottom + 33.0];
        let name = Words::new("x", Anchor::Middle, below, across);
        shapes.push(Shape::Words(name));
        let beside = [13.0, 0.5 * (top + bottom)];
        shapes.push(Shape::Words(Words {
            upwards: true,
            ..Words::new("x", Anchor::Middle, beside, up)
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_round() {
        for (range, wanted) in [(10.0, 2.0), (1.0, 0.2), (0.04, 0.01), (70.0, 20.0)] {
            let step = round_step(range, 5.0);
            assert!((step - wanted).abs() < 1e-9 * wanted, "{range}");
        }
    }

    #[test]
    fn labels_of_a_small_range_differ() {
        let (values, digits) = Span {
            low: 1.0,
            high: 1.000_4,
        }
        .ticks(5.0);
        let texts: std::collections::BTreeSet<_> =
            values.iter().map(|v| format!("{v:.digits$}")).collect();
        assert!(
            values.len() >= 4 && texts.len() == values.len(),
            "{texts:?}"
        );
    }

    #[test]
    fn a_point_and_nothing_at_all_have_a_frame() {
        for span in [
            Span::default(),
            Span {
                low: 2.0,
                high: 2.0,
            },
        ] {
            let frame = Frame::new(span, span, 30.0, false);
            assert!(frame.px([2.0, 2.0]).iter().all(|value| value.is_finite()));
        }
    }
}
