//! Geometric paths of the tool: straight lines and arcs, joined, measured by arc length.

use std::f64::consts::TAU;
use std::sync::Arc;

use super::curve::Curve;
use nalgebra::{Rotation3, Vector3};

/// Two pieces join if the end of one and the start of the next are nearer than this, m.
const JOIN_M: f64 = 1e-6;

/// A piece shorter than this is refused, m.
pub(super) const LEAST_LENGTH_M: f64 = 1e-6;

/// No coordinate of a path is greater, m: twice what the wire's lengths can say. A number beyond it
/// is a typing error or an unfriendly file.
pub(crate) const FURTHEST_M: f64 = 400.0;

/// Most points of one curve; its table of arc lengths then takes 10 MB.
pub(crate) const MOST_CURVE_POINTS: usize = 10_000;

/// Why a path cannot be built.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PathError {
    /// A coordinate, radius or angle is NaN or infinite, or so large that the length overflows.
    #[error("{what} of the path is not a finite number: check the task's coordinates")]
    NotFinite {
        /// Which value.
        what: &'static str,
    },
    /// A coordinate is further away than any robot reaches.
    #[error(
        "{what} of the path is {:.3e} mm, beyond {:.0} mm: check the task's coordinates, which are in mm",
        .value_m * 1e3, FURTHEST_M * 1e3
    )]
    Far {
        /// Which value.
        what: &'static str,
        /// The value, m.
        value_m: f64,
    },
    /// A curve has more points than a plan takes.
    #[error("a curve of {points} points, more than {MOST_CURVE_POINTS}: cut it into several legs")]
    Points {
        /// How many it has.
        points: usize,
    },
    /// A piece has no length.
    #[error("a piece of the path has no length ({:.6} mm): leave it out", .length_m * 1e3)]
    NoLength {
        /// Its length, m.
        length_m: f64,
    },
    /// Two points of a curve in a row are the same.
    #[error("point {point} of the curve is the one before it: leave it out")]
    Repeated {
        /// The later point, from 1.
        point: usize,
    },
    /// The start of an arc is not on its circle.
    #[error(
        "the arc starts {:.3} mm from its centre and at height {:.3} mm over it, but its radius is \
         {:.3} mm and its plane horizontal: give a start on the circle",
        .distance_m * 1e3, .height_m * 1e3, .radius_m * 1e3
    )]
    OffCircle {
        /// Horizontal distance from the centre to the start, m.
        distance_m: f64,
        /// Height of the start above the centre, m.
        height_m: f64,
        /// Radius, m.
        radius_m: f64,
    },
    /// Two consecutive pieces do not meet.
    #[error(
        "piece {next} of the path starts {:.3} mm from where the piece before it ends: join them",
        .gap_m * 1e3
    )]
    Gap {
        /// The later piece, from 1.
        next: usize,
        /// Distance between end and start, m.
        gap_m: f64,
    },
    /// A path without pieces.
    #[error("the path has no pieces: give at least one line or arc")]
    Empty,
    /// An arc length outside the path.
    #[error("the arc length {:.3} mm is not on the path, which has {:.3} mm", .asked_m * 1e3, .length_m * 1e3)]
    OffPath {
        /// What was asked, m.
        asked_m: f64,
        /// The path's length, m.
        length_m: f64,
    },
}

/// A point of a path with the first two derivatives by arc length; world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    /// Position, m.
    pub position_m: Vector3<f64>,
    /// Direction of travel, unit vector.
    pub tangent: Vector3<f64>,
    /// Derivative of the tangent by arc length, 1/m: points to the centre of curvature.
    pub curvature_per_m: Vector3<f64>,
}

/// A piece of a path: straight, an arc in a horizontal plane, or a curve through points.
#[derive(Debug, Clone, PartialEq)]
pub struct Piece {
    shape: Shape,
    /// Arc length of the shape before the piece's start, m: over 0 for the rest of a piece.
    skip_m: f64,
    length_m: f64,
}

#[derive(Debug, Clone, PartialEq)]
enum Shape {
    Line {
        from_m: Vector3<f64>,
        direction: Vector3<f64>,
    },
    Arc {
        center_m: Vector3<f64>,
        radius_m: f64,
        start_rad: f64,
        /// 1 counter-clockwise seen from above, -1 clockwise.
        sense: f64,
    },
    Curve(Arc<Curve>),
    /// A turn in place.
    Turn {
        at_m: Vector3<f64>,
    },
}

/// A turn counts as the way of a point at this distance from the tool, m: limits of speed, acceleration
/// and jerk apply to it.
/// A limit of 0.1 m/s allows 0.5 rad/s, 29 degrees a second.
pub(super) const TURN_LEVER_M: f64 = 0.2;

impl Piece {
    /// The place at which the platform turns by an angle without moving its tool: its length is that
    /// angle times 0.2 m.
    ///
    /// # Errors
    /// [`PathError::NotFinite`], [`PathError::NoLength`].
    pub fn turn(at_m: Vector3<f64>, angle_rad: f64) -> Result<Self, PathError> {
        near(&at_m)?;
        let length_m = finite("an angle", angle_rad.abs() * TURN_LEVER_M)?;
        if length_m < LEAST_LENGTH_M {
            return Err(PathError::NoLength { length_m });
        }
        Ok(Self {
            shape: Shape::Turn { at_m },
            skip_m: 0.0,
            length_m,
        })
    }

    /// The straight piece between two points of the world frame, m.
    ///
    /// # Errors
    /// [`PathError::NotFinite`], [`PathError::NoLength`].
    pub fn line(from_m: Vector3<f64>, to_m: Vector3<f64>) -> Result<Self, PathError> {
        let step = to_m - from_m;
        let length_m = finite("a point", step.norm())?;
        near(&from_m)?;
        near(&to_m)?;
        if length_m < LEAST_LENGTH_M {
            return Err(PathError::NoLength { length_m });
        }
        let direction = step / length_m;
        Ok(Self {
            shape: Shape::Line { from_m, direction },
            skip_m: 0.0,
            length_m,
        })
    }

    /// The arc about `center_m` from `start_m` on, in the horizontal plane of both, through
    /// `sweep_rad` (positive: counter-clockwise seen from above; 2 pi: the whole circle).
    ///
    /// # Errors
    /// [`PathError::OffCircle`] if `start_m` is not at `radius_m` from the centre within 1 um,
    /// [`PathError::NotFinite`], [`PathError::NoLength`].
    pub fn arc(
        center_m: Vector3<f64>,
        radius_m: f64,
        start_m: Vector3<f64>,
        sweep_rad: f64,
    ) -> Result<Self, PathError> {
        let arm = start_m - center_m;
        let distance_m = finite("a point", libm::hypot(arm.x, arm.y))?;
        finite("a point", arm.z)?;
        finite("a radius", radius_m)?;
        let length_m = finite("an angle", radius_m * sweep_rad.abs())?;
        near(&center_m)?;
        near(&start_m)?;
        if (distance_m - radius_m).abs() > JOIN_M || arm.z.abs() > JOIN_M {
            return Err(PathError::OffCircle {
                distance_m,
                height_m: arm.z,
                radius_m,
            });
        }
        if length_m < LEAST_LENGTH_M {
            return Err(PathError::NoLength { length_m });
        }
        Ok(Self {
            shape: Shape::Arc {
                center_m,
                radius_m,
                start_rad: libm::atan2(arm.y, arm.x),
                sense: sweep_rad.signum(),
            },
            skip_m: 0.0,
            length_m,
        })
    }

    /// The smooth curve through points of the world frame, m: its tangent and curvature have no
    /// jumps. With two points it is the straight line between them.
    ///
    /// # Errors
    /// [`PathError::Empty`] for fewer than two points, [`PathError::Repeated`],
    /// [`PathError::NotFinite`].
    pub fn curve(points_m: &[Vector3<f64>]) -> Result<Self, PathError> {
        match points_m {
            [] | [_] => Err(PathError::Empty),
            [from, to] => Self::line(*from, *to),
            _ => {
                let points = points_m.len();
                if points > MOST_CURVE_POINTS {
                    return Err(PathError::Points { points });
                }
                let curve = Curve::through(points_m)?;
                Ok(Self {
                    length_m: finite("a point", curve.length_m())?,
                    shape: Shape::Curve(Arc::new(curve)),
                    skip_m: 0.0,
                })
            }
        }
    }

    /// Arc length of the piece, m; greater than 0.
    pub fn length_m(&self) -> f64 {
        self.length_m
    }

    /// Least radius of curvature, m; `None` for a straight piece.
    pub fn radius_m(&self) -> Option<f64> {
        match &self.shape {
            Shape::Line { .. } | Shape::Turn { .. } => None,
            Shape::Arc { radius_m, .. } => Some(*radius_m),
            Shape::Curve(curve) => Some(curve.least_radius_m()),
        }
    }

    /// First point.
    pub fn start(&self) -> PathPoint {
        self.evaluate(0.0)
    }

    /// Last point.
    pub fn end(&self) -> PathPoint {
        self.evaluate(self.length_m)
    }

    /// The point at arc length `s_m` from the piece's start.
    ///
    /// # Errors
    /// [`PathError::OffPath`] outside `0..=length_m` by more than rounding.
    pub fn point(&self, s_m: f64) -> Result<PathPoint, PathError> {
        Ok(self.evaluate(on_path(s_m, self.length_m)?))
    }

    /// The rest of the piece from arc length `s_m` on.
    fn tail(&self, s_m: f64) -> Self {
        Self {
            shape: self.shape.clone(),
            skip_m: self.skip_m + s_m,
            length_m: self.length_m - s_m,
        }
    }

    fn evaluate(&self, s_m: f64) -> PathPoint {
        let s_m = s_m + self.skip_m;
        match &self.shape {
            Shape::Curve(curve) => curve.at(s_m),
            Shape::Turn { at_m } => PathPoint {
                position_m: *at_m,
                tangent: Vector3::zeros(),
                curvature_per_m: Vector3::zeros(),
            },
            Shape::Line { from_m, direction } => PathPoint {
                position_m: from_m + direction * s_m,
                tangent: *direction,
                curvature_per_m: Vector3::zeros(),
            },
            Shape::Arc {
                center_m,
                radius_m,
                start_rad,
                sense,
            } => {
                let (sin, cos) = libm::sincos(start_rad + sense * s_m / radius_m);
                let (radius_m, sense) = (*radius_m, *sense);
                let outward = Vector3::new(cos, sin, 0.0);
                PathPoint {
                    position_m: center_m + outward * radius_m,
                    tangent: Vector3::new(-sin, cos, 0.0) * sense,
                    curvature_per_m: -outward / radius_m,
                }
            }
        }
    }
}

/// A path of one or more pieces, each starting where the one before it ends.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    pieces: Vec<Piece>,
    length_m: f64,
    attitude: Option<Rotation3<f64>>,
}

impl Path {
    /// Joins the pieces.
    ///
    /// # Errors
    /// [`PathError::Empty`], or [`PathError::Gap`] where two pieces are more than 1 um apart.
    pub fn new(pieces: Vec<Piece>) -> Result<Self, PathError> {
        if pieces.is_empty() {
            return Err(PathError::Empty);
        }
        for (index, pair) in pieces.windows(2).enumerate() {
            if let [before, after] = pair {
                let gap = after.start().position_m - before.end().position_m;
                let gap_m = gap.norm();
                if gap_m > JOIN_M {
                    return Err(PathError::Gap {
                        next: index + 2,
                        gap_m,
                    });
                }
            }
        }
        let length_m = pieces.iter().map(Piece::length_m).sum();
        Ok(Self {
            pieces,
            length_m,
            attitude: None,
        })
    }

    /// The same path with an attitude (world_from_platform) at its end: the platform turns on the way,
    /// about one axis, in proportion to the way. Without it the attitude stays as it is.
    #[must_use]
    pub(crate) fn turning_to(mut self, attitude: Option<Rotation3<f64>>) -> Self {
        self.attitude = attitude;
        self
    }

    /// The attitude at its end, if one is asked for.
    #[must_use]
    pub fn attitude(&self) -> Option<Rotation3<f64>> {
        self.attitude
    }

    /// Straight lines through the points in turn, world frame, m.
    ///
    /// # Errors
    /// [`PathError::Empty`] for fewer than two points, otherwise as [`Piece::line`].
    pub fn through(points_m: &[Vector3<f64>]) -> Result<Self, PathError> {
        let lines: Result<Vec<Piece>, PathError> = points_m
            .windows(2)
            .filter_map(|pair| match pair {
                [from, to] => Some(Piece::line(*from, *to)),
                _ => None,
            })
            .collect();
        Self::new(lines?)
    }

    /// Table 7 of the paper at height `z_m`: from (255, -105) mm straight to the nearest point of
    /// the circle of 65 mm about (335, 0) mm, then once around it, counter-clockwise.
    ///
    /// The table's start lies 132 mm from the centre, so it cannot be on the circle; the approach
    /// is 67 mm long.
    ///
    /// # Errors
    /// [`PathError::NotFinite`] for a height that is NaN or infinite.
    pub fn paper_circle(z_m: f64) -> Result<Self, PathError> {
        let start_m = Vector3::new(0.255, -0.105, z_m);
        let center_m = Vector3::new(0.335, 0.0, z_m);
        let radius_m = 0.065;
        let outward = (start_m - center_m)
            .try_normalize(0.0)
            .ok_or(PathError::NotFinite { what: "the height" })?;
        let entry_m = center_m + outward * radius_m;
        Self::new(vec![
            Piece::line(start_m, entry_m)?,
            Piece::arc(center_m, radius_m, entry_m, TAU)?,
        ])
    }

    /// Table 8 of the paper at height `z_m`: the line from (0.5, 0.2) m to (0.2, -0.2) m.
    ///
    /// # Errors
    /// [`PathError::NotFinite`] for a height that is NaN or infinite.
    pub fn paper_line(z_m: f64) -> Result<Self, PathError> {
        Self::through(&[Vector3::new(0.5, 0.2, z_m), Vector3::new(0.2, -0.2, z_m)])
    }

    /// The pieces, at least one.
    pub fn pieces(&self) -> &[Piece] {
        &self.pieces
    }

    /// Arc length of the whole path, m.
    pub fn length_m(&self) -> f64 {
        self.length_m
    }

    /// Least radius of curvature on the path, m; `None` if all of it is straight. At speed v the
    /// acceleration across the path is up to v^2 over this radius. A time law along the path does
    /// not include it: keep the speed below `sqrt(acceleration radius)`.
    pub(crate) fn least_radius_m(&self) -> Option<f64> {
        self.pieces
            .iter()
            .filter_map(Piece::radius_m)
            .min_by(f64::total_cmp)
    }

    /// The rest of the path from arc length `s_m` on.
    ///
    /// # Errors
    /// [`PathError::OffPath`]; [`PathError::Empty`] at the path's end.
    pub(crate) fn tail(&self, s_m: f64) -> Result<Self, PathError> {
        let mut before_m = on_path(s_m, self.length_m)?;
        let mut pieces = Vec::new();
        for piece in &self.pieces {
            let rest_m = piece.length_m - before_m;
            // A shorter rest would be refused as a piece of no length.
            if rest_m >= LEAST_LENGTH_M {
                pieces.push(piece.tail(before_m));
            }
            before_m = (-rest_m).max(0.0);
        }
        Self::new(pieces)
    }

    /// The point at arc length `s_m` from the start. At a join, the start of the later piece.
    ///
    /// # Errors
    /// [`PathError::OffPath`] outside `0..=length_m` by more than rounding.
    pub fn point(&self, s_m: f64) -> Result<PathPoint, PathError> {
        let mut rest_m = on_path(s_m, self.length_m)?;
        for piece in &self.pieces {
            if rest_m < piece.length_m {
                return Ok(piece.evaluate(rest_m));
            }
            rest_m -= piece.length_m;
        }
        // Only the very end, and rounding beyond it, reaches this line.
        self.pieces.last().map(Piece::end).ok_or(PathError::Empty)
    }
}

fn finite(what: &'static str, value: f64) -> Result<f64, PathError> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(PathError::NotFinite { what })
    }
}

/// Checks that a point is no further away than [`FURTHEST_M`] along any axis.
pub(super) fn near(point_m: &Vector3<f64>) -> Result<(), PathError> {
    match point_m.iter().find(|value| value.abs() > FURTHEST_M) {
        Some(&value_m) => Err(PathError::Far {
            what: "a coordinate",
            value_m,
        }),
        None => Ok(()),
    }
}

/// The arc length if it lies on the path; an excess from sums of rounded lengths is cut off.
fn on_path(s_m: f64, length_m: f64) -> Result<f64, PathError> {
    let slack_m = 1e-9 * length_m;
    if (-slack_m..=length_m + slack_m).contains(&s_m) {
        Ok(s_m.clamp(0.0, length_m))
    } else {
        Err(PathError::OffPath {
            asked_m: s_m,
            length_m,
        })
    }
}

#[cfg(test)]
mod tests;
