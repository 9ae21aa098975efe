//! Integer units of the wire. Each is a newtype with its unit in its name, so that a length can
//! not be sent where a speed is meant.
//!
//! | unit | range that messages accept | resolution |
//! |---|---|---|
//! | [`TenthMicrometres`] | ±200 m | 0.1 µm |
//! | [`Micrometres`] | ±2147 m | 1 µm |
//! | [`MicrometresPerSecond`] | ±20 m/s | 1 µm/s |
//! | [`Millinewtons`] | ±2 MN | 1 mN |
//! | [`Milliamps`] | ±2 MA | 1 mA |
//! | [`Microseconds`] | 0 to 71 min, wraps | 1 µs |
//! | [`Tick`] | 0 to 49.7 days, wraps | 1 ms |

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

unit!(/** Length in 0.1 µm. */ TenthMicrometres(i32));
unit!(/** Length in µm. */ Micrometres(i32));
unit!(/** Speed in µm/s. */ MicrometresPerSecond(i32));
unit!(/** Force in mN. */ Millinewtons(i32));
unit!(/** Current in mA. */ Milliamps(i32));
unit!(/** Time in µs, wrapping. */ Microseconds(u32));
unit!(/** A board's control tick (1 ms), wrapping after 49.7 days. */ Tick(u32));

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
        self.0.wrapping_sub(earlier.0).cast_signed()
    }

    /// The tick `ticks` later, across the wrap.
    #[must_use]
    pub const fn after(self, ticks: u32) -> Self {
        Self(self.0.wrapping_add(ticks))
    }
}
