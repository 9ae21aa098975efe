//! Integer units of the wire. Each is a newtype with its unit in its name, so that a length
//! cannot be sent where a speed is meant.
//!
//! | unit | range that messages accept | resolution | SI |
//! |---|---|---|---|
//! | [`TenthMicrometres`] | ±200 m | 0.1 µm | m |
//! | [`Micrometres`] | ±2147 m | 1 µm | m |
//! | [`MicrometresPerSecond`] | ±20 m/s | 1 µm/s | m/s |
//! | [`Millinewtons`] | ±2 MN | 1 mN | N |
//! | [`Milliamps`] | ±2 MA | 1 mA | A |
//! | [`Tick`] | 0 to 49.7 days, wraps | 1 ms | |
//!
//! The signed units convert to and from SI in `f64`. This is for hosts and tests: the control core
//! has no floating point, and unused functions take no flash.

use postcard::experimental::max_size::MaxSize;
use serde::{Deserialize, Serialize};

macro_rules! unit {
    ($(#[$doc:meta])* $name:ident($inner:ty)) => {
        $(#[$doc])*
        #[derive(
            Debug, Default, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash,
            Serialize, Deserialize, MaxSize,
        )]
        pub struct $name(
            /// The number in the unit of the type's name.
            pub $inner,
        );

        impl From<$inner> for $name {
            fn from(value: $inner) -> Self {
                Self(value)
            }
        }
    };
}

/// A signed unit with its conversion: the names of both functions, the SI unit in words, the number
/// of wire units in one SI unit, and its inverse.
macro_rules! si {
    ($name:ident, $to:ident, $from:ident, $si:literal, $per_si:literal, $in_si:literal) => {
        impl $name {
            #[doc = concat!("The value in ", $si, ".")]
            #[must_use]
            pub fn $to(self) -> f64 {
                f64::from(self.0) * $in_si
            }

            #[doc = concat!(
                "From a value in ", $si, ", rounded to the nearest, halves away from zero. ",
                "What is out of range saturates, and a value that is not a number gives zero: \
                 the board refuses either where it matters."
            )]
            #[must_use]
            pub fn $from(value: f64) -> Self {
                Self(nearest(value * $per_si))
            }
        }
    };
}

unit!(/** Length in 0.1 µm.
```
use mcdpr_protocol::TenthMicrometres;
assert_eq!(TenthMicrometres::from_metres(0.25), TenthMicrometres(2_500_000));
assert_eq!(TenthMicrometres(2_500_000).metres(), 0.25);
```
*/ TenthMicrometres(i32));
unit!(/** Length in µm.
```
use mcdpr_protocol::Micrometres;
assert_eq!(Micrometres::from_metres(-0.004), Micrometres(-4000));
```
*/ Micrometres(i32));
unit!(/** Speed in µm/s.
```
use mcdpr_protocol::MicrometresPerSecond;
assert_eq!(MicrometresPerSecond::from_metres_per_second(0.05), MicrometresPerSecond(50_000));
```
*/ MicrometresPerSecond(i32));
unit!(/** Force in mN.
```
use mcdpr_protocol::Millinewtons;
assert_eq!(Millinewtons::from_newtons(9.81), Millinewtons(9810));
assert_eq!(Millinewtons(12_500).newtons(), 12.5);
```
*/ Millinewtons(i32));
unit!(/** Current in mA. */ Milliamps(i32));
unit!(/** A board's control tick (1 ms), wrapping after 49.7 days. */ Tick(u32));

si!(TenthMicrometres, metres, from_metres, "m", 1e7, 1e-7);
si!(Micrometres, metres, from_metres, "m", 1e6, 1e-6);
si!(
    MicrometresPerSecond,
    metres_per_second,
    from_metres_per_second,
    "m/s",
    1e6,
    1e-6
);
si!(Millinewtons, newtons, from_newtons, "N", 1e3, 1e-3);
si!(Milliamps, amperes, from_amperes, "A", 1e3, 1e-3);

/// The nearest whole number, halves away from zero (`f64::round` is not in `core`).
#[expect(
    clippy::cast_possible_truncation,
    reason = "truncates towards zero and saturates, as is wanted"
)]
fn nearest(value: f64) -> i32 {
    // A cast of NaN gives 0, and one out of range the nearest bound.
    let whole = value as i32;
    // Exact within the range of i32; beyond it the sum saturates.
    let rest = value - f64::from(whole);
    if rest >= 0.5 {
        whole.saturating_add(1)
    } else if rest <= -0.5 {
        whole.saturating_sub(1)
    } else {
        whole
    }
}

impl Tick {
    /// Ticks from `earlier` to `self`, across the wrap of the counter.
    ///
    /// ```
    /// use mcdpr_protocol::Tick;
    /// assert_eq!(Tick(3).since(Tick(u32::MAX)), 4);
    /// assert_eq!(Tick(3).since(Tick(5)), -2);
    /// ```
    #[must_use]
    pub const fn since(self, earlier: Self) -> i32 {
        // Correct up to 24.8 days in either direction (K9).
        self.0.wrapping_sub(earlier.0).cast_signed()
    }

    /// The tick `ticks` later, across the wrap.
    #[must_use]
    pub const fn after(self, ticks: u32) -> Self {
        Self(self.0.wrapping_add(ticks))
    }
}
