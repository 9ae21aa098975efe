//! Motion on the wire: time-stamped Hermite knots.
//!
//! Between two knots the board evaluates the cubic with these end values and end velocities for
//! each cable, every tick. Two segments share their knot, so they join exactly, and a late frame
//! has no effect on a motor.

use crate::{List, Micrometres, MicrometresPerSecond, Millinewtons, PerCable, TenthMicrometres};
use postcard::experimental::max_size::MaxSize;
use serde::{Deserialize, Serialize};

/// State of one cable at a knot.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct CableKnot {
    /// Paid-out length from the drum's reference, as the drum encoder sees it (unstretched).
    pub length: TenthMicrometres,
    /// Its rate; positive pays out.
    pub velocity: MicrometresPerSecond,
    /// Expected tension at the winch; the set-point if the cable is held by tension.
    pub tension: Millinewtons,
}

/// One point of a motion in time.
#[derive(Debug, Default, Clone, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Knot {
    /// Position in the sequence of this motion's knots, 0 for the first.
    pub index: u16,
    /// Milliseconds of path time since the motion's first knot, which is at 0.
    pub time_ms: u32,
    /// Whether the motion ends here, at rest.
    pub last: bool,
    /// Cable by cable.
    pub cables: PerCable<CableKnot>,
    /// Consistency checks that apply from this knot to the next.
    pub rows: List<ResidualRow, { ResidualRow::PER_KNOT }>,
}

impl CableKnot {
    /// From SI: paid-out length in m, its rate in m/s, tension in N.
    ///
    /// ```
    /// use mcdpr_protocol::{CableKnot, Millinewtons};
    /// let knot = CableKnot::from_si(0.5, -0.02, 10.0);
    /// assert_eq!((knot.length.0, knot.velocity.0), (5_000_000, -20_000));
    /// assert_eq!(knot.tension, Millinewtons(10_000));
    /// ```
    #[must_use]
    pub fn from_si(length_m: f64, velocity_mps: f64, tension_n: f64) -> Self {
        Self {
            length: TenthMicrometres::from_metres(length_m),
            velocity: MicrometresPerSecond::from_metres_per_second(velocity_mps),
            tension: Millinewtons::from_newtons(tension_n),
        }
    }
}

impl Knot {
    /// Path time since the motion's first knot, s.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        f64::from(self.time_ms) * 1e-3
    }
}

/// A coefficient of a [`ResidualRow`]; always two bytes on the wire.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Coefficient(#[serde(with = "postcard::fixint::le")] pub i16);

impl MaxSize for Coefficient {
    const POSTCARD_MAX_SIZE: usize = 2;
}

/// One linear consistency check between measured lengths and tensions, linearised by the host about
/// the planned state: `sum(a_i dl_i) + sum(b_i dT_i)` must stay within ±`limit`, where `dl_i` and
/// `dT_i` are measured minus planned. It detects a slipping cable (S5).
#[derive(Debug, Default, Clone, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct ResidualRow {
    /// `a_i` in µm per µm, times [`ResidualRow::LENGTH_SCALE`].
    pub lengths: PerCable<Coefficient>,
    /// `b_i` in µm per mN, times [`ResidualRow::TENSION_SCALE`].
    pub tensions: PerCable<Coefficient>,
    /// Largest residual that is not a fault.
    pub limit: Micrometres,
}

impl ResidualRow {
    /// Rows that one knot can carry.
    // S5 and C5 need one row each.
    pub const PER_KNOT: usize = 2;
    /// Scale of [`ResidualRow::lengths`]: coefficients reach ±8 in steps of 1/4096.
    // 2^15 / 4096 = 8 in 16 bits.
    pub const LENGTH_SCALE: i32 = 4096;
    /// Scale of [`ResidualRow::tensions`]: coefficients reach ±128 µm/mN in steps of 1/256.
    pub const TENSION_SCALE: i32 = 256;
}
