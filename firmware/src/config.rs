//! Configuration: physical units from the wire, checked and turned into machine units once.

use mcdpr_protocol::config::ConfigDigest;
use mcdpr_protocol::{BoardKey, CableKey, ConfigEntry, ConfigHash, ConfigKey, KeyMeaning, Reject};

mod building;
pub mod schedule;

/// Collects entries and builds [`Active`] from them.
#[derive(Debug, Clone)]
pub struct ConfigStore<const N: usize> {
    board: Slots<{ BoardKey::ALL.len() }>,
    cables: [Slots<{ CableKey::ALL.len() }>; N],
    announced: u16,
    received: u16,
    last_key: Option<ConfigKey>,
    /// Finished slices of the build, and the hash so far.
    done: u8,
    digest: ConfigDigest,
}

impl<const N: usize> Default for ConfigStore<N> {
    fn default() -> Self {
        Self {
            board: Slots::EMPTY,
            cables: [Slots::EMPTY; N],
            announced: 0,
            received: 0,
            last_key: None,
            done: 0,
            digest: ConfigDigest::default(),
        }
    }
}

/// Optional values. An array of options would take twice the memory.
#[derive(Debug, Clone, Copy)]
struct Slots<const K: usize> {
    values: [i32; K],
    /// Bit n of word m: value 32 m + n is present. Two words: the chip shifts 64 bits by a call.
    present: [u32; 2],
}

impl<const K: usize> Slots<K> {
    const EMPTY: Self = {
        // One bit of `present` per value.
        assert!(K <= 64);
        Self {
            values: [0; K],
            present: [0; 2],
        }
    };

    fn get(&self, index: usize) -> Option<i32> {
        let value = self.values.get(index)?;
        let word = self.present.get(index >> 5)?;
        (word >> (index & 31) & 1 != 0).then_some(*value)
    }

    fn put(&mut self, index: usize, value: i32) {
        let word = self.present.get_mut(index >> 5);
        if let (Some(slot), Some(word)) = (self.values.get_mut(index), word) {
            *slot = value;
            *word |= 1 << (index & 31);
        }
    }
}

/// Drive kinds by their number on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriveKind {
    /// No drives: sensors only.
    None,
    /// RoboModule RMDS.
    Rmds,
    /// CiA 402 over CANopen.
    Cia402,
}

/// Type of tension law.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TensionLaw {
    /// Eq. 1 of the paper.
    Pd,
    /// Feed-forward, PI and damping about the planned motion.
    Default,
}

/// Type of command that a tension law sends to the drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TensionOutput {
    /// A current.
    Current,
    /// A speed; the drive's own loop fights the friction of a gear.
    Speed,
}

/// How a cable is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Control {
    /// By its length: the drive holds a position.
    Length,
    /// By its tension: the drive gives a current, or turns at a speed.
    Tension,
}

/// One cable in machine units.
#[derive(Debug, Clone, Copy)]
pub struct CableConfig {
    /// How it is held.
    pub control: Control,
    /// Length per encoder count, 0.1 µm with 24 fractional bits; carries the encoder's sign.
    pub per_count_q24: i64,
    /// Length of half an encoder count, and of four, 0.1 µm.
    pub half_count: i32,
    /// Of four.
    pub four_counts: i32,
    /// Largest plausible change of the encoder in a tick, counts.
    pub max_encoder_step: u16,
    /// Motor counts per 0.1 µm of length, 32 fractional bits, signed.
    pub motor_per_length_q32: i64,
    /// Length in 0.1 µm per motor count, 32 fractional bits, signed: the tick multiplies; a
    /// division would cost as much as the rest of an axis.
    pub length_per_motor_q32: i64,
    /// Motor rpm per µm/s, 32 fractional bits, positive.
    pub rpm_per_speed_q32: i64,
    /// µm/s per motor rpm, 16 fractional bits, positive.
    pub speed_per_rpm_q16: i64,
    /// Whether the motor counts down as the cable pays out.
    pub motor_reversed: bool,
    /// Largest motor speed, rpm.
    pub max_rpm: u16,
    /// Largest motor current, mA.
    pub max_current_ma: i32,
    /// Threshold for a current near the limit, mA.
    pub most_ma: i32,
    /// mA per mN of force that reels in, 32 fractional bits, signed.
    pub current_per_force_q32: i64,
    /// mN per ADC step, 24 fractional bits.
    pub tension_per_adc_q24: i64,
    /// mN at 0 V, 24 fractional bits, subtracted.
    pub tension_zero_q24: i64,
    /// Full scale of the sensor, mN.
    pub tension_max_mn: i32,
    /// Floor, mN.
    pub floor_mn: i32,
    /// Ceiling, mN.
    pub ceiling_mn: i32,
    /// Law.
    pub law: TensionLaw,
    /// Type of command to the drive.
    pub output: TensionOutput,
    /// Proportional gain, thousandths.
    pub kp_milli: i32,
    /// Derivative gain, µs.
    pub kd_us: i32,
    /// Integral gain, 1/s, thousandths.
    pub ki_milli: i32,
    /// Damping, mN s/m.
    pub damping_mns_per_m: i32,
    /// Share of a new tension sample in the filter, 16 fractional bits.
    pub filter_alpha_q16: i32,
    /// Share of a new speed in the low-pass behind a law with speed output, 16 fractional bits.
    pub corner_alpha_q16: i32,
    /// Share of a speed law's gains per length, 1 / 0.1 µm with 40 fractional bits; 0: all of them at any length.
    pub gain_per_length_q40: i32,
    /// Coulomb friction, mN.
    pub friction_mn: i32,
    /// Effective mass, g.
    pub mass_g: i32,
    /// Play between motor and drum, 0.1 µm.
    pub play: i32,
    /// How far the drum turns in its closed brake, 0.1 µm.
    pub brake_play: i32,
    /// Lead of position commands, µs.
    pub lead_us: i32,
    /// Its square, 1000 µs².
    pub lead_square: i32,
    /// Largest force of the motor at the drum's surface, mN.
    pub most_force_mn: i32,
    /// Time in which that force stops the drum, µs per µm/s with 16 fractional bits.
    pub stop_q16: i32,
    /// Time the brake takes to close, ms.
    pub brake_close_ms: u16,
    /// Largest following error, 0.1 µm.
    pub following_error: i32,
    /// Largest speed, µm/s.
    pub max_speed_umps: i32,
    /// Largest acceleration, µm/s².
    pub max_acceleration_umps2: i32,
    /// Largest jerk, mm/s³.
    pub max_jerk_mmps3: i32,
    /// Speed out of the band of floor and ceiling, µm/s.
    pub reel_speed_umps: i32,
    /// Shortest length, 0.1 µm.
    pub length_min: i32,
    /// Longest length, 0.1 µm.
    pub length_max: i32,
    /// Number of the drive on its bus.
    pub node: u8,
    /// Ticks between two commands to the drive.
    pub period_ticks: u8,
    /// Tick of the period in which the drive has its slot.
    pub slot: u8,
    /// SYNCs for one feedback (CiA 402).
    pub syncs: u8,
    /// Motor rpm per count in a millisecond, 16 fractional bits.
    pub rpm_per_count_q16: i32,
}

impl CableConfig {
    /// All zeros, which need no copy in the board's memory.
    pub(crate) const NOTHING: Self = Self {
        control: Control::Length,
        per_count_q24: 0,
        half_count: 0,
        four_counts: 0,
        max_encoder_step: 0,
        motor_per_length_q32: 0,
        length_per_motor_q32: 0,
        rpm_per_speed_q32: 0,
        speed_per_rpm_q16: 0,
        motor_reversed: false,
        max_rpm: 0,
        max_current_ma: 0,
        most_ma: 0,
        current_per_force_q32: 0,
        tension_per_adc_q24: 0,
        tension_zero_q24: 0,
        tension_max_mn: 0,
        floor_mn: 0,
        ceiling_mn: 0,
        law: TensionLaw::Pd,
        output: TensionOutput::Current,
        kp_milli: 0,
        kd_us: 0,
        ki_milli: 0,
        damping_mns_per_m: 0,
        filter_alpha_q16: 0,
        corner_alpha_q16: 0,
        gain_per_length_q40: 0,
        friction_mn: 0,
        mass_g: 0,
        play: 0,
        brake_play: 0,
        lead_us: 0,
        lead_square: 0,
        most_force_mn: 0,
        stop_q16: 0,
        brake_close_ms: 0,
        following_error: 0,
        max_speed_umps: 0,
        max_acceleration_umps2: 0,
        max_jerk_mmps3: 0,
        reel_speed_umps: 0,
        length_min: 0,
        length_max: 0,
        node: 0,
        period_ticks: 0,
        slot: 0,
        syncs: 0,
        rpm_per_count_q16: 0,
    };

    /// Whether the tension law of this cable sends a speed to the drive.
    #[must_use]
    pub(crate) fn commands_speed(&self) -> bool {
        self.control == Control::Tension && self.output == TensionOutput::Speed
    }

    /// Motor current for a force that reels in, mA, rounded.
    #[must_use]
    pub fn current_ma(&self, force_mn: i32) -> i32 {
        crate::fixed::mul_q32(force_mn, self.current_per_force_q32)
    }
}

/// A configuration in use.
#[derive(Debug, Clone)]
pub struct Active<const N: usize> {
    /// The hash that host and board agreed on.
    pub hash: ConfigHash,
    /// Drives.
    pub drive_kind: DriveKind,
    /// Bit rate of the drives' bus, bit/s.
    pub bus_bitrate: u32,
    /// Duration of a coordinated stop, ms.
    pub stop_ms: u32,
    /// Time a residual may be over its limit, ms.
    pub residual_ms: u16,
    /// Time for drives to enable, ms.
    pub enable_ms: u32,
    /// Age at which feedback counts as lost, ms.
    pub feedback_timeout_ms: u16,
    /// Whether brakes close under torque while the robot holds.
    pub hold_braked: bool,
    /// Whether the board has a fault line in common with others.
    pub fault_line: bool,
    /// Cable by cable.
    pub cables: [CableConfig; N],
}

impl<const N: usize> Active<N> {
    const NOTHING: Self = Self {
        hash: ConfigHash(0),
        drive_kind: DriveKind::None,
        bus_bitrate: 0,
        stop_ms: 0,
        residual_ms: 0,
        enable_ms: 0,
        feedback_timeout_ms: 0,
        hold_braked: false,
        fault_line: false,
        cables: [CableConfig::NOTHING; N],
    };
}

impl<const N: usize> ConfigStore<N> {
    /// Discards all entries and expects `entries` new ones.
    ///
    /// # Errors
    /// [`Reject::ConfigSequence`] for none or more than exist.
    pub fn begin(&mut self, entries: u16) -> Result<(), Reject> {
        // Every key once: an announcement of more can only be damaged or of another version.
        let most = BoardKey::ALL.len() + N * CableKey::ALL.len();
        if entries == 0 || usize::from(entries) > most {
            return Err(Reject::ConfigSequence);
        }
        self.clear();
        self.announced = entries;
        Ok(())
    }

    /// Discards all entries, in place: a fresh store would go over the board's stack.
    pub fn clear(&mut self) {
        self.board.present = [0; 2];
        for fields in &mut self.cables {
            fields.present = [0; 2];
        }
        self.announced = 0;
        self.received = 0;
        self.last_key = None;
        self.done = 0;
    }

    /// Takes some entries, in ascending order of keys.
    ///
    /// # Errors
    /// [`Reject::ConfigSequence`] out of order or beyond the announced count;
    /// [`Reject::ConfigUnknownKey`]. None of the entries is taken then.
    pub fn put(&mut self, entries: &[ConfigEntry]) -> Result<(), Reject> {
        let (mut last_key, mut received) = (self.last_key, self.received);
        for entry in entries {
            // Ascending keys exclude repetitions, and both sides hash in the same order.
            if last_key.is_some_and(|last| last >= entry.key) || received >= self.announced {
                return Err(Reject::ConfigSequence);
            }
            if !Self::knows(entry.key) {
                return Err(Reject::ConfigUnknownKey { key: entry.key.0 });
            }
            last_key = Some(entry.key);
            received += 1;
        }
        // All entries are valid: only now are they taken.
        for entry in entries {
            match entry.key.meaning() {
                Some(KeyMeaning::Board(key)) => self.board.put(key as usize - 1, entry.value),
                Some(KeyMeaning::Cable(index, key)) => {
                    if let Some(fields) = self.cables.get_mut(usize::from(index)) {
                        fields.put(key as usize - 1, entry.value);
                    }
                }
                None => {}
            }
        }
        (self.last_key, self.received) = (last_key, received);
        // The hash covers all entries: a build that has begun is void.
        self.done = 0;
        Ok(())
    }

    fn knows(key: ConfigKey) -> bool {
        match key.meaning() {
            Some(KeyMeaning::Board(_)) => true,
            Some(KeyMeaning::Cable(index, _)) => usize::from(index) < N,
            None => false,
        }
    }
}
