//! Kinds of readings.

use super::unknowns::Unit;

/// Kinds of readings, each with a scatter of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Group {
    /// Encoder lengths, m.
    Length,
    /// Load cells, N.
    Tension,
    /// Swivel angles, rad.
    Swivel,
    /// Roll and pitch, rad.
    Tilt,
    /// Yaw, rad.
    Yaw,
    /// Balance of forces, N.
    Force,
    /// Balance of moments about the centre of mass, N m.
    Moment,
    /// Corners of tags, px.
    Corner,
    /// Coordinates by a tracker, m.
    Position,
    /// Attitudes by a tracker, rad.
    Turn,
    /// Distances by a tape, m.
    Distance,
}

/// Number of kinds.
pub const GROUPS: usize = 11;

impl Group {
    /// All kinds.
    pub const ALL: [Self; GROUPS] = [
        Self::Length,
        Self::Tension,
        Self::Swivel,
        Self::Tilt,
        Self::Yaw,
        Self::Force,
        Self::Moment,
        Self::Corner,
        Self::Position,
        Self::Turn,
        Self::Distance,
    ];
    /// Its place in arrays.
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }
    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Length => "length",
            Self::Tension => "tension",
            Self::Swivel => "swivel angle",
            Self::Tilt => "tilt",
            Self::Yaw => "yaw",
            Self::Force => "balance of forces",
            Self::Moment => "balance of moments",
            Self::Corner => "corner",
            Self::Position => "tracker position",
            Self::Turn => "tracker attitude",
            Self::Distance => "distance",
        }
    }

    /// How its values are printed.
    #[must_use]
    pub const fn unit(self) -> Unit {
        match self {
            Self::Length | Self::Position | Self::Distance => Unit::new(1e3, "mm"),
            Self::Tension | Self::Force => Unit::new(1.0, "N"),
            Self::Swivel | Self::Tilt | Self::Yaw | Self::Turn => {
                Unit::new(180.0 / std::f64::consts::PI, "deg")
            }
            Self::Moment => Unit::new(1.0, "N m"),
            Self::Corner => Unit::new(1.0, "px"),
        }
    }

    /// Whether a sensor reads it.
    #[must_use]
    pub const fn is_sensor(self) -> bool {
        !matches!(self, Self::Force | Self::Moment)
    }
}
