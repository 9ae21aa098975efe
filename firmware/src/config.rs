//! Configuration: physical units from the wire, checked and turned into machine units once.

use crate::drives::schedule::{MOST_LOAD_PERMILLE, load_permille};
use crate::fixed::{half, quotient, saturate};
use mcdpr_protocol::config::config_hash;
use mcdpr_protocol::{BoardKey, CableKey, ConfigEntry, ConfigHash, ConfigKey, KeyMeaning, Reject};

/// Collects entries and builds [`Active`] from them.
#[derive(Debug, Clone)]
pub struct ConfigStore<const N: usize> {
    board: Slots<{ BoardKey::ALL.len() }>,
    cables: [Slots<{ CableKey::ALL.len() }>; N],
    announced: u16,
    received: u16,
    last_key: Option<ConfigKey>,
}

impl<const N: usize> Default for ConfigStore<N> {
    fn default() -> Self {
        Self {
            board: Slots::EMPTY,
            cables: [Slots::EMPTY; N],
            announced: 0,
            received: 0,
            last_key: None,
        }
    }
}

/// Values that may be missing. An array of options would take the board twice the memory.
#[derive(Debug, Clone, Copy)]
struct Slots<const K: usize> {
    values: [i32; K],
    /// Bit n: value n is there.
    present: u32,
}

impl<const K: usize> Slots<K> {
    const EMPTY: Self = {
        assert!(K <= 32);
        Self {
            values: [0; K],
            present: 0,
        }
    };

    fn get(&self, index: usize) -> Option<i32> {
        let value = self.values.get(index)?;
        (self.present & (1 << index) != 0).then_some(*value)
    }

    fn put(&mut self, index: usize, value: i32) {
        if let Some(slot) = self.values.get_mut(index) {
            *slot = value;
            self.present |= 1 << index;
        }
    }

    fn iter(&self) -> impl Iterator<Item = Option<i32>> + '_ {
        (0..K).map(|index| self.get(index))
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

/// Which law holds a tension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TensionLaw {
    /// Eq. 1 of the paper, nothing else.
    Pd,
    /// Feed-forward, PI and damping about the planned motion.
    Default,
}

/// How a cable is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Control {
    /// By its length: the drive holds a position.
    Length,
    /// By its tension: the drive gives a current.
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
    /// Largest believable change of the encoder in a tick, counts.
    pub max_encoder_step: u16,
    /// Motor counts per 0.1 µm of length, 32 fractional bits, signed.
    pub motor_per_length_q32: i64,
    /// Length in 0.1 µm per motor count, 32 fractional bits, signed: the tick multiplies, a
    /// division would cost it as much as all the rest of an axis.
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
    /// What comes near to it, mA.
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
    /// Coulomb friction, mN.
    pub friction_mn: i32,
    /// Effective mass, g.
    pub mass_g: i32,
    /// Lead of position commands, µs.
    pub lead_us: i32,
    /// Its square, 1000 µs².
    pub lead_square: i32,
    /// Time the brake takes to close, ms.
    pub brake_close_ms: u16,
    /// Largest following error, 0.1 µm.
    pub following_error: i32,
    /// Largest speed, µm/s.
    pub max_speed_umps: i32,
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
    /// Motor current for a force that reels in, mA, rounded.
    #[must_use]
    pub fn current_ma(&self, force_mn: i32) -> i32 {
        crate::fixed::mul_q32(force_mn, self.current_per_force_q32)
    }
}

/// A configuration in use.
#[derive(Debug, Clone)]
pub struct Active<const N: usize> {
    /// What host and board agreed on.
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
    /// Cable by cable.
    pub cables: [CableConfig; N],
}

/// Longest coordinated stop, ms.
const MAX_STOP_MS: i32 = 300;

impl<const N: usize> ConfigStore<N> {
    /// Forgets everything and expects `entries` entries.
    ///
    /// # Errors
    /// [`Reject::ConfigSequence`] for none or more than exist.
    pub fn begin(&mut self, entries: u16) -> Result<(), Reject> {
        let most = BoardKey::ALL.len() + N * CableKey::ALL.len();
        if entries == 0 || usize::from(entries) > most {
            return Err(Reject::ConfigSequence);
        }
        self.clear();
        self.announced = entries;
        Ok(())
    }

    /// Forgets everything, in place: a fresh store would pass over the stack of the board.
    pub fn clear(&mut self) {
        self.board.present = 0;
        for fields in &mut self.cables {
            fields.present = 0;
        }
        self.announced = 0;
        self.received = 0;
        self.last_key = None;
    }

    /// Takes some entries, in ascending order of keys.
    ///
    /// # Errors
    /// [`Reject::ConfigSequence`] out of order or beyond the announced count;
    /// [`Reject::ConfigUnknownKey`]. None of the entries is taken then.
    pub fn put(&mut self, entries: &[ConfigEntry]) -> Result<(), Reject> {
        let (mut last_key, mut received) = (self.last_key, self.received);
        for entry in entries {
            if last_key.is_some_and(|last| last >= entry.key) || received >= self.announced {
                return Err(Reject::ConfigSequence);
            }
            if !Self::knows(entry.key) {
                return Err(Reject::ConfigUnknownKey { key: entry.key.0 });
            }
            last_key = Some(entry.key);
            received += 1;
        }
        // All are good: only now is anything taken.
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
        Ok(())
    }

    fn knows(key: ConfigKey) -> bool {
        match key.meaning() {
            Some(KeyMeaning::Board(_)) => true,
            Some(KeyMeaning::Cable(index, _)) => usize::from(index) < N,
            None => false,
        }
    }

    /// Checks, builds and takes into use; `active` is left alone where it fails. Out of line, so
    /// that its temporaries are on the board's stack only while it runs.
    ///
    /// # Errors
    /// [`Reject::ConfigSequence`] where entries are missing, [`Reject::ConfigHash`] where the
    /// hashes differ, [`Reject::ConfigValue`] naming the first key that is missing or senseless.
    #[inline(never)]
    pub fn build_into(
        &self,
        host: ConfigHash,
        active: &mut Option<Active<N>>,
    ) -> Result<(), Reject> {
        if self.announced == 0 || self.received != self.announced {
            return Err(Reject::ConfigSequence);
        }
        let board = config_hash(self.entries());
        if board != host {
            return Err(Reject::ConfigHash { board, host });
        }
        let key = |key: BoardKey, low: i32, high: i32| {
            let value = self.board.get(key as usize - 1);
            checked(ConfigKey::board(key), value, low, high)
        };
        let cables = key(BoardKey::Cables, 1, 8)?;
        let expected = u8::try_from(N).unwrap_or(u8::MAX);
        if cables != i32::from(expected) {
            let got = u8::try_from(cables).unwrap_or(u8::MAX);
            return Err(Reject::CableCount { expected, got });
        }
        let drive_kind = match key(BoardKey::DriveKind, 0, 2)? {
            1 => DriveKind::Rmds,
            2 => DriveKind::Cia402,
            _ => DriveKind::None,
        };
        let bus_bitrate = key(BoardKey::BusBitrate, 125_000, 1_000_000)?.cast_unsigned();
        let by_length = ticks(
            BoardKey::BusPeriodUs,
            key(BoardKey::BusPeriodUs, 1000, 20_000)?,
        )?;
        let by_tension = key(BoardKey::TensionPeriodUs, 1000, 20_000)?;
        let by_tension = ticks(BoardKey::TensionPeriodUs, by_tension)?;
        let feedback_timeout_ms = small(key(BoardKey::FeedbackTimeoutMs, 2, 1000)?);
        // Feedback that comes more rarely would look lost between two of them. Who is asked less
        // often is asked in whole numbers of the other's periods.
        if by_length % by_tension != 0 || u16::from(by_length) * 2 >= feedback_timeout_ms {
            return refused(ConfigKey::board(BoardKey::BusPeriodUs));
        }
        // The first one is a placeholder for the others until they are built.
        let mut cables = [self.build_cable(0)?; N];
        for (index, slot) in (0_u8..).zip(cables.iter_mut()).skip(1) {
            *slot = self.build_cable(index)?;
        }
        spread(&mut cables, by_length, by_tension);
        let cycles = cables.iter().map(|cable| {
            let period_us = u32::from(cable.period_ticks) * 1000;
            (period_us, cable.control == Control::Tension)
        });
        if load_permille(drive_kind, bus_bitrate, cycles) > MOST_LOAD_PERMILLE {
            return refused(ConfigKey::board(BoardKey::BusPeriodUs));
        }
        let built = Active {
            hash: board,
            drive_kind,
            bus_bitrate,
            stop_ms: key(BoardKey::StopMs, 20, MAX_STOP_MS)?.cast_unsigned(),
            residual_ms: small(key(BoardKey::ResidualMs, 1, 10_000)?),
            enable_ms: key(BoardKey::EnableMs, 0, 10_000)?.cast_unsigned(),
            feedback_timeout_ms,
            hold_braked: key(BoardKey::HoldBrakes, 0, 1)? == 1,
            cables,
        };
        *active = Some(built);
        Ok(())
    }

    fn entries(&self) -> impl Iterator<Item = ConfigEntry> + '_ {
        let board = BoardKey::ALL.iter().zip(self.board.iter());
        let board = board.filter_map(|(key, value)| {
            value.map(|value| ConfigEntry {
                key: ConfigKey::board(*key),
                value,
            })
        });
        let cables = (0_u8..).zip(self.cables.iter());
        board.chain(cables.flat_map(|(index, fields)| {
            let fields = CableKey::ALL.iter().zip(fields.iter());
            fields.filter_map(move |(key, value)| {
                value.map(|value| ConfigEntry {
                    key: ConfigKey::cable(index, *key),
                    value,
                })
            })
        }))
    }

    fn build_cable(&self, index: u8) -> Result<CableConfig, Reject> {
        let fields = self.cables.get(usize::from(index));
        let key = |key: CableKey, low: i32, high: i32| {
            let value = fields.and_then(|fields| fields.get(key as usize - 1));
            checked(ConfigKey::cable(index, key), value, low, high)
        };
        let refuse = |key: CableKey| Reject::ConfigValue {
            key: ConfigKey::cable(index, key).0,
        };
        // 1 mm to 500 mm keeps every product below in 64 bits; 312689/49766 is 2 pi to 1e-11.
        let radius = key(CableKey::DrumRadius, 10_000, 5_000_000)?;
        let circumference_q20 = ((i64::from(radius) * 312_689) << 20) / 49_766;
        let circumference_q8 = (circumference_q20 + half(12)) >> 12;
        let counts = key(CableKey::EncoderCountsPerTurn, 16, 1_000_000)?;
        let sign = key(CableKey::EncoderSign, -1, 1)?;
        if sign == 0 {
            return Err(refuse(CableKey::EncoderSign));
        }
        let per_count_q24 = i64::from(sign) * rounded(circumference_q20 << 4, i64::from(counts));
        let motor_counts = key(CableKey::MotorCountsPerTurn, -8_000_000, 8_000_000)?;
        if motor_counts == 0 {
            return Err(refuse(CableKey::MotorCountsPerTurn));
        }
        let per_rev = key(CableKey::MotorCountsPerRev, 4, 1_000_000)?;
        let motor_per_length_q32 = (i64::from(motor_counts) << 40) / circumference_q8;
        // µm/s to rpm: ten 0.1 µm per µm, 60 s per minute.
        let rpm_per_speed_q32 = motor_per_length_q32.abs() * 600 / i64::from(per_rev);
        let force = key(CableKey::ForcePerCurrent, -100_000_000, 100_000_000)?;
        if force == 0 {
            return Err(refuse(CableKey::ForcePerCurrent));
        }
        let gain = i64::from(key(CableKey::TensionGain, 1, 10_000_000)?);
        let zero_uv = i64::from(key(CableKey::TensionZeroUv, -3_300_000, 3_300_000)?);
        let tension_max_mn = key(CableKey::TensionMax, 1, 10_000_000)?;
        let floor_mn = key(CableKey::TensionFloor, 0, tension_max_mn)?;
        let ceiling_mn = key(CableKey::TensionCeiling, floor_mn + 1, tension_max_mn)?;
        let max_speed_umps = key(CableKey::MaxSpeed, 1, 20_000_000)?;
        let filter_mhz = i64::from(key(CableKey::TensionFilterMhz, 100, 400_000)?);
        // alpha = w dt / (1 + w dt) with w dt = 2 pi f / 1000, f in mHz: 1e6 in the denominator.
        let w_dt_q24 = filter_mhz * 105_414_357 / 1_000_000;
        let alpha_q16 = rounded(w_dt_q24 << 16, (1 << 24) + w_dt_q24);
        let length_min = key(CableKey::LengthMin, -2_000_000_000, 2_000_000_000)?;
        // One millisecond at one and a half times the largest speed, and a count of rounding.
        let step = i64::from(max_speed_umps) * 15 * (1 << 24) / 1000 / per_count_q24.abs() + 2;
        let max_current_ma = key(CableKey::MaxCurrentMa, 1, 32_000)?;
        let lead_us = key(CableKey::LeadUs, 0, 100_000)?;
        // A bus has no drive 0: that number calls all of them. 127 is the board itself.
        let node = key(CableKey::Node, 1, 126)?;
        Ok(CableConfig {
            control: match key(CableKey::Control, 0, 1)? {
                0 => Control::Length,
                _ => Control::Tension,
            },
            per_count_q24,
            half_count: saturate(per_count_q24.abs() >> 25),
            four_counts: saturate(per_count_q24.abs() >> 22),
            max_encoder_step: u16::try_from(step.min(16_000)).unwrap_or(16_000),
            motor_per_length_q32,
            length_per_motor_q32: (circumference_q8 << 24) / i64::from(motor_counts),
            rpm_per_speed_q32,
            speed_per_rpm_q16: (1 << 48) / rpm_per_speed_q32.max(1),
            motor_reversed: motor_counts < 0,
            max_rpm: small(key(CableKey::MaxMotorRpm, 1, 30_000)?),
            max_current_ma,
            most_ma: max_current_ma - max_current_ma / 32,
            current_per_force_q32: (1000 << 32) / i64::from(force),
            // Sixteen conversions of 12 bits, summed: 65,536 steps would be 3.3 V, so a step is
            // k[mN/V] * 3.3 / 65,536, with 24 fractional bits.
            tension_per_adc_q24: gain * 8448 / 10,
            tension_zero_q24: ((gain * zero_uv / 1000) << 24) / 1000,
            tension_max_mn,
            floor_mn,
            ceiling_mn,
            law: match key(CableKey::TensionLaw, 0, 1)? {
                0 => TensionLaw::Pd,
                _ => TensionLaw::Default,
            },
            kp_milli: key(CableKey::TensionKp, 0, 1_000_000)?,
            kd_us: key(CableKey::TensionKd, 0, 10_000_000)?,
            ki_milli: key(CableKey::TensionKi, 0, 10_000_000)?,
            damping_mns_per_m: key(CableKey::TensionDamping, 0, 100_000_000)?,
            filter_alpha_q16: saturate(alpha_q16),
            friction_mn: key(CableKey::Friction, 0, 1_000_000)?,
            mass_g: key(CableKey::DrumMass, 0, 100_000_000)?,
            lead_us,
            lead_square: saturate(quotient::<1000>(i64::from(lead_us) * i64::from(lead_us))),
            brake_close_ms: small(key(CableKey::BrakeCloseMs, 1, 2000)?),
            following_error: key(CableKey::FollowingError, 10, 1_000_000)? * 10,
            max_speed_umps,
            reel_speed_umps: key(CableKey::ReelSpeed, 1, 1_000_000)?,
            length_min,
            length_max: key(CableKey::LengthMax, length_min, 2_000_000_000)?,
            node: u8::try_from(node).unwrap_or(u8::MAX),
            period_ticks: 1,
            slot: 0,
            syncs: 1,
            // Counts per ms, times 60,000 ms per minute.
            rpm_per_count_q16: saturate((60_000 << 16) / i64::from(per_rev)),
        })
    }
}

/// Gives every drive its slot, evenly over its period.
fn spread<const N: usize>(cables: &mut [CableConfig; N], by_length: u8, by_tension: u8) {
    for (index, cable) in (0_u8..).zip(cables) {
        (cable.period_ticks, cable.syncs) = match cable.control {
            Control::Length => (by_length, by_length / by_tension),
            Control::Tension => (by_tension, 1),
        };
        cable.slot = index * cable.period_ticks / N.to_le_bytes()[0];
    }
}

fn refused<T>(key: ConfigKey) -> Result<T, Reject> {
    Err(Reject::ConfigValue { key: key.0 })
}

/// Whole ticks of a period.
fn ticks(key: BoardKey, us: i32) -> Result<u8, Reject> {
    let ticks = u8::try_from(us / 1000).ok().filter(|_| us % 1000 == 0);
    ticks.map_or(refused(ConfigKey::board(key)), Ok)
}

/// The quotient of two positive numbers, rounded to nearest.
const fn rounded(dividend: i64, divisor: i64) -> i64 {
    (dividend + divisor / 2) / divisor
}

fn checked(key: ConfigKey, value: Option<i32>, low: i32, high: i32) -> Result<i32, Reject> {
    value
        .filter(|value| (low..=high).contains(value))
        .ok_or(Reject::ConfigValue { key: key.0 })
}

/// A value that was just checked to be small.
fn small(value: i32) -> u16 {
    u16::try_from(value).unwrap_or(u16::MAX)
}
