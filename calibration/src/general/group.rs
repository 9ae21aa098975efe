//! Kinds of readings.

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
}

/// Number of kinds.
pub const GROUPS: usize = 8;

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
    ];
    /// Its place in arrays.
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }
    /// In words, with the factor and the unit for printing.
    #[must_use]
    pub const fn words(self) -> (&'static str, f64, &'static str) {
        const DEGREES: f64 = 180.0 / std::f64::consts::PI;
        match self {
            Self::Length => ("length", 1e3, "mm"),
            Self::Tension => ("tension", 1.0, "N"),
            Self::Swivel => ("swivel angle", DEGREES, "deg"),
            Self::Tilt => ("tilt", DEGREES, "deg"),
            Self::Yaw => ("yaw", DEGREES, "deg"),
            Self::Force => ("balance of forces", 1.0, "N"),
            Self::Moment => ("balance of moments", 1.0, "N m"),
            Self::Corner => ("corner", 1.0, "px"),
        }
    }
    /// Whether a sensor reads it.
    #[must_use]
    pub(crate) const fn is_sensor(self) -> bool {
        !matches!(self, Self::Force | Self::Moment)
    }
}
