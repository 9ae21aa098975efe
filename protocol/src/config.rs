//! Configuration as keyed numbers in physical units.
//!
//! The host sends `(key, value)` entries in chunks and then commits them with a hash over all of
//! them; the board checks the hash, builds machine units once, and refuses to arm without a
//! configuration. The board stores none of it over a reset. A key is `group << 8 | field`, where
//! group 0 is the board and group `n` is cable `n`, 1 for the first.

use crate::{MAX_CABLES, frame};
use postcard::experimental::max_size::MaxSize;
use serde::{Deserialize, Serialize};

/// A key on the wire; see [`BoardKey`] and [`CableKey`].
#[derive(
    Debug,
    Default,
    Clone,
    Copy,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Serialize,
    Deserialize,
    MaxSize,
)]
pub struct ConfigKey(pub u16);

/// One key with its value.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct ConfigEntry {
    /// Its key.
    pub key: ConfigKey,
    /// Its value in the key's unit.
    pub value: i32,
}

/// CRC-32 over all entries, sorted by key; see [`config_hash`].
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct ConfigHash(pub u32);

macro_rules! keys {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident = $number:literal,)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        #[repr(u8)]
        pub enum $name { $($(#[$field_doc])* $field = $number,)* }

        impl $name {
            /// Every key of this group.
            pub const ALL: &'static [Self] = &[$(Self::$field),*];

            /// The key with this field number.
            #[must_use]
            pub const fn from_number(number: u8) -> Option<Self> {
                match number { $($number => Some(Self::$field),)* _ => None }
            }

            /// Its name.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$field => stringify!($field),)* }
            }
        }
    };
}

keys! {
    /// Keys of the board as a whole (group 0).
    BoardKey {
        /// Number of cables on this board, 1 to 8.
        Cables = 1,
        /// 0 none, 1 RoboModule RMDS, 2 CiA 402.
        DriveKind = 2,
        /// Drive bus, bit/s.
        BusBitrate = 3,
        /// Time between two commands to one drive, µs, whole milliseconds.
        BusPeriodUs = 4,
        /// Time for a coordinated stop (STOP1), ms, at most 300.
        StopMs = 5,
        /// Time that a residual row may be over its limit before a stop, ms.
        ResidualMs = 6,
        /// Time for which drives may take to enable when the board arms, ms.
        EnableMs = 7,
        /// Drive feedback older than this is lost, ms.
        FeedbackTimeoutMs = 8,
        /// Time between two commands to a tension-held drive, µs; divides that of the others.
        TensionPeriodUs = 9,
        /// 1 closes the brakes under torque while the robot holds, 0 leaves them open.
        HoldBrakes = 10,
        /// 1: the board stops while the fault line between the boards is low, 0: it has no such line.
        FaultLine = 11,
    }
}

keys! {
    /// Keys of one cable (groups 1 to 8).
    CableKey {
        /// 0 length-held (position mode), 1 tension-held (current or speed mode).
        Control = 1,
        /// Drum radius, 0.1 µm.
        DrumRadius = 2,
        /// Counts of the drum encoder per turn (four per line).
        EncoderCountsPerTurn = 3,
        /// +1 or -1: sign of the encoder count when the cable pays out.
        EncoderSign = 4,
        /// Motor counts per drum turn; negative if the motor counts down as the cable pays out.
        MotorCountsPerTurn = 5,
        /// Largest motor speed, rpm.
        MaxMotorRpm = 6,
        /// Largest motor current, mA.
        MaxCurrentMa = 7,
        /// Force at the drum's surface per motor current, mN/A; negative if a positive current pays
        /// out.
        ForcePerCurrent = 8,
        /// Tension sensor gain k, mN/V (Eq. 52).
        TensionGain = 9,
        /// Tension sensor zero voltage u0, µV (Eq. 52).
        TensionZeroUv = 10,
        /// Full scale of the tension sensor, mN.
        TensionMax = 11,
        /// Under this tension a cable is slack, mN.
        TensionFloor = 12,
        /// Over this tension a cable is in danger, mN.
        TensionCeiling = 13,
        /// 0 the PD law of Eq. 1, 1 the default law.
        TensionLaw = 14,
        /// Proportional gain, N of drum force per N of error, times 1000.
        TensionKp = 15,
        /// Derivative gain, N per N/s, times 1e6 (µs).
        TensionKd = 16,
        /// Integral gain, N/s per N, times 1000.
        TensionKi = 17,
        /// Damping of the drum relative to its planned speed, mN s/m.
        TensionDamping = 18,
        /// Corner of the tension filter, mHz.
        TensionFilterMhz = 19,
        /// Coulomb friction of the drum, mN at its surface.
        Friction = 20,
        /// Effective mass of drum and rotor at the drum's surface, g.
        DrumMass = 21,
        /// Time by which a position command leads, to cover the drive's lag, µs.
        LeadUs = 22,
        /// Time that the brake takes to close, ms.
        BrakeCloseMs = 23,
        /// Largest difference of measured and commanded length, µm (S2, D7).
        FollowingError = 24,
        /// Largest speed of the cable, µm/s.
        MaxSpeed = 25,
        /// Shortest length that may be commanded, 0.1 µm.
        LengthMin = 26,
        /// Longest length that may be commanded, 0.1 µm.
        LengthMax = 27,
        /// Number of the drive on its bus.
        Node = 28,
        /// Motor counts per turn of the motor's own shaft.
        MotorCountsPerRev = 29,
        /// Speed at which a slack cable is reeled in, or a too tight one paid out, µm/s.
        ReelSpeed = 30,
        /// Largest acceleration of the cable that may be commanded, µm/s².
        MaxAcceleration = 31,
        /// Largest jerk of the cable that may be commanded, mm/s³.
        MaxJerk = 32,
        /// Command of a tension law to the drive: 0 a current, 1 a speed. With a speed, gains are
        /// in mm/s per N, mm/N and mm/s per N s.
        TensionOutput = 33,
        /// Play between motor and drum, 0.1 µm of cable.
        Play = 34,
        /// Corner of the low-pass behind a default law with speed output, mHz; 0 is none.
        SpeedCornerMhz = 35,
        /// How far the drum turns in its closed brake, 0.1 µm of cable.
        BrakePlay = 36,
        /// Length of the cable at which the gains of a default law with speed output hold, 0.1 µm; a
        /// shorter cable is stiffer and gets less in proportion. 0: the same gains at any length.
        GainLength = 37,
    }
}

impl ConfigKey {
    /// The key of the board as a whole.
    #[must_use]
    pub const fn board(key: BoardKey) -> Self {
        Self(key as u16)
    }

    /// The key of a cable, `index` 0 for the first.
    #[must_use]
    pub const fn cable(index: u8, key: CableKey) -> Self {
        // Group 0 is the board's.
        Self(((index as u16 + 1) << 8) | key as u16)
    }

    /// What the key means, or `None` for a key that this version does not know.
    #[must_use]
    pub fn meaning(self) -> Option<KeyMeaning> {
        // Upper byte first, so that keys in ascending order go cable by cable.
        let [group, field] = self.0.to_be_bytes();
        match group {
            0 => BoardKey::from_number(field).map(KeyMeaning::Board),
            n if usize::from(n) <= MAX_CABLES => {
                CableKey::from_number(field).map(|key| KeyMeaning::Cable(n - 1, key))
            }
            _ => None,
        }
    }
}

/// A key, split into its parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum KeyMeaning {
    /// Of the board.
    Board(BoardKey),
    /// Of the cable with this index, 0 for the first.
    Cable(u8, CableKey),
}

/// The hash both sides must agree on before the robot arms: CRC-32 over key (u16) and value (i32),
/// little-endian, in ascending order of keys.
///
/// The entries must be sorted; two hosts that send the same settings in another order agree.
#[must_use]
pub fn config_hash(sorted: impl IntoIterator<Item = ConfigEntry>) -> ConfigHash {
    let mut digest = ConfigDigest::default();
    for entry in sorted {
        digest.add(entry);
    }
    digest.finish()
}

/// [`config_hash`] entry by entry, for code that cannot process all of them at once.
#[derive(Debug, Clone)]
pub struct ConfigDigest(frame::Digest);

impl Default for ConfigDigest {
    fn default() -> Self {
        Self(frame::digest())
    }
}

impl ConfigDigest {
    /// Takes the next entry, in ascending order of keys.
    pub fn add(&mut self, entry: ConfigEntry) {
        // Fixed widths, not varints: the hash does not depend on the encoding of a message.
        self.0.update(&entry.key.0.to_le_bytes());
        self.0.update(&entry.value.to_le_bytes());
    }

    /// The hash of the entries so far.
    #[must_use]
    pub fn finish(self) -> ConfigHash {
        ConfigHash(self.0.finalize())
    }
}
