//! Solids, and their intersections with rays.

use super::codes::CODES;
use crate::plant::vec3::V3;

/// A solid in its own frame, centred at the origin; lengths in m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// A box.
    Box {
        /// Half of each side.
        half_m: [f64; 3],
    },
    /// A cylinder along z.
    Cylinder {
        /// Its radius.
        radius_m: f64,
        /// Half of its height.
        half_m: f64,
    },
    /// A sheet without thickness in the plane z = 0, seen from both sides.
    Sheet {
        /// Half of its sides along x and y.
        half_m: [f64; 2],
    },
}

/// Appearance of a part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Surface {
    /// One colour: share of red, green, blue light that it reflects.
    Plain([f64; 3]),
    /// A printed tag of AprilTag 36h11 on a white sheet, centred at the part's origin, x to the
    /// right and y down as one looks at it.
    Tag {
        /// Its number.
        id: usize,
        /// Edge of its black square, m.
        size_m: f64,
    },
    /// Rows of such tags about the part's origin, numbered on from the first, row by row.
    Tags(TagRows),
}

/// Rows of printed tags.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TagRows {
    /// Number of the first.
    pub first: usize,
    /// Tags in a row, and rows.
    pub count: [usize; 2],
    /// Edge of a tag's black square, m.
    pub size_m: f64,
    /// From one tag's middle to the next one's, m.
    pub pitch_m: f64,
}

impl TagRows {
    /// Middle of the tag in a column and a row, m.
    #[must_use]
    pub fn middle_m(&self, at: [usize; 2]) -> [f64; 2] {
        [0, 1].map(|i| (at[i] as f64 + 0.5 - 0.5 * self.count[i] as f64) * self.pitch_m)
    }

    fn color(&self, point_m: V3) -> [f64; 3] {
        let cell = [0, 1].map(|i| point_m[i] / self.pitch_m + 0.5 * self.count[i] as f64);
        if (0..2).any(|i| cell[i] < 0.0 || cell[i] >= self.count[i] as f64) {
            return [WHITE; 3];
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let at = cell.map(|value| value as usize);
        let middle = self.middle_m(at);
        let tag = Surface::Tag {
            id: self.first + at[1] * self.count[0] + at[0],
            size_m: self.size_m,
        };
        tag.color([point_m[0] - middle[0], point_m[1] - middle[1], 0.0])
    }
}

/// Paper white and printer's black.
const WHITE: f64 = 0.85;
const BLACK: f64 = 0.06;

impl Surface {
    /// Colour at a point of the part.
    pub(super) fn color(&self, point_m: V3) -> [f64; 3] {
        match *self {
            Self::Plain(color) => color,
            Self::Tags(rows) => rows.color(point_m),
            Self::Tag { id, size_m } => {
                // Eight cells across: six of data in a black border of one (AprilTag 36h11).
                let cell = |value: f64| (value / size_m * 8.0 + 4.0).floor();
                let (x, y) = (cell(point_m[0]), cell(point_m[1]));
                let inside = |value: f64, low: f64, high: f64| value >= low && value < high;
                let white = if !(inside(x, 0.0, 8.0) && inside(y, 0.0, 8.0)) {
                    true
                } else if inside(x, 1.0, 7.0) && inside(y, 1.0, 7.0) {
                    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
                    let place = ((y - 1.0) * 6.0 + x - 1.0) as u32;
                    // Bit 35 is the cell at the top left.
                    CODES[id % CODES.len()] >> (35 - place) & 1 == 1
                } else {
                    false
                };
                [if white { WHITE } else { BLACK }; 3]
            }
        }
    }
}

impl Shape {
    /// Radius of the sphere around the origin that holds the solid, m.
    #[must_use]
    pub fn radius_m(&self) -> f64 {
        match *self {
            Self::Box { half_m: [x, y, z] } => (x * x + y * y + z * z).sqrt(),
            Self::Cylinder { radius_m, half_m } => libm::hypot(radius_m, half_m),
            Self::Sheet { half_m: [x, y] } => libm::hypot(x, y),
        }
    }

    /// Half of the sides of the box around the origin that holds the solid, m.
    pub(super) const fn half_box_m(&self) -> V3 {
        match *self {
            Self::Box { half_m } => half_m,
            Self::Cylinder { radius_m, half_m } => [radius_m, radius_m, half_m],
            Self::Sheet { half_m: [x, y] } => [x, y, 0.0],
        }
    }

    /// Whether a point lies in the solid or closer to it than `margin_m`.
    #[must_use]
    pub fn contains(&self, point_m: [f64; 3], margin_m: f64) -> bool {
        let [x, y, z] = point_m;
        match *self {
            Self::Box { half_m } => (0..3).all(|i| point_m[i].abs() < half_m[i] + margin_m),
            Self::Cylinder { radius_m, half_m } => {
                libm::hypot(x, y) < radius_m + margin_m && z.abs() < half_m + margin_m
            }
            Self::Sheet { .. } => false,
        }
    }

    /// Distances along the ray at which it enters and leaves the solid, with the outward normal at
    /// the entry. `None` if it misses.
    pub(super) fn span(&self, from: V3, along: V3) -> Option<Span> {
        let mut span = Span::default();
        match *self {
            Self::Box { half_m } => {
                for axis in 0..3 {
                    span.slab(from[axis], along[axis], half_m[axis], axis)?;
                }
            }
            Self::Cylinder { radius_m, half_m } => {
                span.slab(from[2], along[2], half_m, 2)?;
                span.tube(from, along, radius_m)?;
            }
            Self::Sheet { half_m } => {
                if along[2].abs() < 1e-12 {
                    return None;
                }
                let way = -from[2] / along[2];
                let (x, y) = (from[0] + way * along[0], from[1] + way * along[1]);
                if x.abs() > half_m[0] || y.abs() > half_m[1] {
                    return None;
                }
                let normal = [0.0, 0.0, -along[2].signum()];
                return Some(Span {
                    near: way,
                    far: way,
                    normal,
                });
            }
        }
        Some(span)
    }
}

/// The part of a ray that is inside a shape: distances along it, m, and the normal where it enters.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    pub(super) near: f64,
    pub(super) far: f64,
    pub(super) normal: V3,
}

impl Default for Span {
    fn default() -> Self {
        Self {
            near: f64::NEG_INFINITY,
            far: f64::INFINITY,
            normal: [0.0; 3],
        }
    }
}

impl Span {
    fn cut(&mut self, near: f64, far: f64, normal: V3) -> Option<()> {
        if near > self.near {
            (self.near, self.normal) = (near, normal);
        }
        self.far = self.far.min(far);
        (self.near < self.far).then_some(())
    }

    fn slab(&mut self, from: f64, along: f64, half: f64, axis: usize) -> Option<()> {
        // Parallel to the slab: the whole ray is inside or outside.
        if along.abs() < 1e-15 {
            return (from.abs() < half).then_some(());
        }
        let (a, b) = ((-half - from) / along, (half - from) / along);
        let mut normal = [0.0; 3];
        normal[axis] = -along.signum();
        self.cut(a.min(b), a.max(b), normal)
    }

    fn tube(&mut self, from: V3, along: V3, radius: f64) -> Option<()> {
        let a = along[0] * along[0] + along[1] * along[1];
        let b = from[0] * along[0] + from[1] * along[1];
        let c = from[0] * from[0] + from[1] * from[1] - radius * radius;
        // Along the axis: as above.
        if a < 1e-18 {
            return (c < 0.0).then_some(());
        }
        // a t^2 + 2 b t + c = 0: a negative root misses the tube.
        let root = b * b - a * c;
        if root <= 0.0 {
            return None;
        }
        let root = root.sqrt();
        let (near, far) = ((-b - root) / a, (-b + root) / a);
        let normal = [
            (from[0] + near * along[0]) / radius,
            (from[1] + near * along[1]) / radius,
            0.0,
        ];
        self.cut(near, far, normal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_meet_solids_where_they_are() {
        let cube = Shape::Box { half_m: [1.0; 3] };
        let Span { near, far, normal } = cube.span([0.2, 0.3, 5.0], [0.0, 0.0, -1.0]).unwrap();
        assert_eq!((near, far, normal), (4.0, 6.0, [0.0, 0.0, 1.0]));
        assert!(cube.span([1.2, 0.3, 5.0], [0.0, 0.0, -1.0]).is_none());
        let can = Shape::Cylinder {
            radius_m: 0.5,
            half_m: 1.0,
        };
        let Span { near, far, normal } = can.span([-3.0, 0.3, 0.0], [1.0, 0.0, 0.0]).unwrap();
        assert!((near - 2.6).abs() < 1e-12 && (far - 3.4).abs() < 1e-12);
        assert!((normal[0] + 0.8).abs() < 1e-12 && (normal[1] - 0.6).abs() < 1e-12);
        assert!(can.contains([0.0, 0.49, 0.9], 0.0) && !can.contains([0.0, 0.51, 0.9], 0.0));
    }

    #[test]
    fn a_tag_has_a_black_frame_and_a_white_rim() {
        let tag = Surface::Tag {
            id: 0,
            size_m: 0.08,
        };
        assert_eq!(tag.color([-0.039, 0.0, 0.0]), [BLACK; 3]);
        assert_eq!(tag.color([-0.041, 0.0, 0.0]), [WHITE; 3]);
        // The first code word begins with 1101 0101 1101: the first row reads 110101.
        let row: Vec<bool> = (0..6)
            .map(|column| tag.color([-0.025 + 0.01 * f64::from(column), -0.025, 0.0])[0] > 0.5)
            .collect();
        assert_eq!(row, [true, true, false, true, false, true]);
    }
}
