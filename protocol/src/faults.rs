//! Stable numbers of all faults.
//!
//! A fault's number is `16 * group + row`: L = 0 and 1 (19 rows), S = 2, D = 3, B = 4, P = 5,
//! C = 6, K = 7, F = 8. Numbers are never reused.

use crate::Tick;
use postcard::experimental::max_size::MaxSize;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

macro_rules! faults {
    ($($id:ident = $number:literal, $what:literal;)*) => {
        /// A fault by its row in `docs/faults.md`; the number is stable for all versions.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u8)]
        pub enum FaultId {
            $(#[doc = $what] $id = $number,)*
        }

        impl FaultId {
            /// Every fault, in the order of the table.
            pub const ALL: &'static [Self] = &[$(Self::$id),*];

            /// The fault with this number, if there is one.
            #[must_use]
            pub const fn from_number(number: u8) -> Option<Self> {
                match number {
                    $($number => Some(Self::$id),)*
                    _ => None,
                }
            }

            /// The row's name, such as `S2`.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$id => stringify!($id),)*
                }
            }

            /// What happened, in a few words.
            #[must_use]
            pub const fn what(self) -> &'static str {
                match self {
                    $(Self::$id => $what,)*
                }
            }
        }
    };
}

faults! {
    L1 = 1, "bit flips in a frame";
    L2 = 2, "value out of range in a frame with a valid checksum";
    L3 = 3, "frame dropped";
    L4 = 4, "frame duplicated";
    L5 = 5, "frames reordered";
    L6 = 6, "frame truncated";
    L7 = 7, "frame oversized or without an end";
    L8 = 8, "random bytes on the link";
    L9 = 9, "heartbeat late";
    L10 = 10, "no heartbeat from the host";
    L11 = 11, "link disconnected in mid frame";
    L12 = 12, "host crashed";
    L13 = 13, "host restarted while the robot was enabled";
    L14 = 14, "second host";
    L15 = 15, "host stalled with the port open";
    L16 = 16, "host does not read telemetry";
    L17 = 17, "protocol version mismatch";
    L18 = 18, "noise on the serial line";
    L19 = 19, "another board has stopped: the fault line is low";
    S1 = 33, "encoder glitch";
    S2 = 34, "encoder stuck while the drum is commanded to move";
    S3 = 35, "encoder counter wrap";
    S4 = 36, "encoder or motor sign reversed";
    S5 = 37, "lost counts or slip: measured lengths and tensions do not close";
    S6 = 38, "encoder disconnected";
    S7 = 39, "tension sensor reads above its range (open)";
    S8 = 40, "tension sensor reads below its range (short)";
    S9 = 41, "tension sensor noisy";
    S10 = 42, "tension sensor drifted";
    S11 = 43, "tension reading frozen";
    S12 = 44, "camera or tag lost";
    D1 = 49, "drive bus off";
    D2 = 50, "drive reports a fault";
    D3 = 51, "drive feedback lost";
    D4 = 52, "motor current saturated";
    D5 = 53, "drive did not enable in time";
    D6 = 54, "drive too hot";
    D7 = 55, "drum does not follow its command";
    B1 = 65, "brake does not open";
    B2 = 66, "brake does not hold";
    B3 = 67, "brake closes too slowly";
    P1 = 81, "supply voltage low";
    P2 = 82, "power lost";
    P3 = 83, "watchdog reset";
    P4 = 84, "firmware panic, hard fault or stack overflow";
    P5 = 85, "control tick overrun";
    P6 = 86, "clock failure";
    P7 = 87, "emergency stop";
    C1 = 97, "cable slack";
    C2 = 98, "cable over its tension limit";
    C3 = 99, "cable broken";
    C4 = 100, "drum mis-wound";
    C5 = 101, "platform in contact";
    K1 = 113, "target outside the workspace";
    K2 = 114, "number is not finite";
    K3 = 115, "speed, acceleration or jerk over its limit";
    K4 = 116, "motion does not start where the robot is";
    K5 = 117, "motion time runs backwards, overlaps or lies in the past";
    K6 = 118, "motion buffer ran empty";
    K7 = 119, "motion buffer overflow";
    K8 = 120, "command in the wrong state";
    K9 = 121, "tick counter wrap";
    K10 = 122, "stop together with another command";
    F1 = 129, "configuration malformed";
    F2 = 130, "configuration implausible";
    F3 = 131, "stored configuration corrupt";
    F4 = 132, "power cut while storing";
    F5 = 133, "calibration outliers";
    F6 = 134, "calibration poses degenerate";
    F7 = 135, "calibration rows missing or repeated";
    F8 = 136, "disk full";
    F9 = 137, "calibration of another machine or firmware";
}

impl FaultId {
    /// The stable number.
    #[must_use]
    pub const fn number(self) -> u8 {
        self as u8
    }
}

impl Serialize for FaultId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        // By its stable number, not by the position of the variant: rows may be inserted.
        serializer.serialize_u8(self.number())
    }
}

impl<'de> Deserialize<'de> for FaultId {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // An unknown number is refused: a host of an older version must not name another fault.
        let number = u8::deserialize(deserializer)?;
        Self::from_number(number).ok_or_else(|| serde::de::Error::custom("unknown fault number"))
    }
}

impl MaxSize for FaultId {
    const POSTCARD_MAX_SIZE: usize = 1;
}

/// A latched fault: the first cause, where and when.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct FaultRecord {
    /// Which fault.
    pub fault: FaultId,
    /// The cable, 1 for the first; 0 if no single cable is the cause.
    pub cable: u8,
    /// When it was detected.
    pub tick: Tick,
    /// The measured value that broke the limit, in the unit of the check (µm, mN, ms, mA).
    pub value: i32,
    /// The limit that it broke, in the same unit.
    pub limit: i32,
}

/// Warning: nothing was refused or stopped, but a value is near its limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Limit {
    /// The last heartbeat is 20 ms old or older.
    HeartbeatLate = 0,
    /// A motor current is at its limit.
    CurrentSaturated = 1,
    /// A tension deviates from its expected value by more than the warning band.
    TensionOff = 2,
    /// A residual row is over half its limit.
    ResidualHigh = 3,
    /// A cable is under its floor.
    CableSlack = 4,
    /// Telemetry was dropped because the link was full.
    TelemetryDropped = 5,
    /// The motion buffer is shorter than the braking distance.
    BufferShort = 6,
    /// The correction between motor counts and drum encoder is at its bound.
    TrimSaturated = 7,
    /// A brake slipped before torque was switched off; torque stays on.
    BrakeSlips = 8,
    /// A tension reading is noisy.
    TensionNoisy = 9,
    /// A drive warns, of heat or another condition.
    DriveWarns = 10,
    /// The fault line between the boards was low.
    FaultLine = 11,
}

/// A set of [`Limit`]s, one bit each.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Limits(pub u16);

impl Limits {
    /// Adds one.
    pub const fn insert(&mut self, limit: Limit) {
        // Bits are only ever set here: a status reports every warning since the last one.
        self.0 |= 1 << (limit as u8);
    }

    /// Whether it is in the set.
    #[must_use]
    pub const fn contains(self, limit: Limit) -> bool {
        self.0 & (1 << (limit as u8)) != 0
    }
}
