//! From entries to machine units, in slices: a control tick has no time for all at once.
//!
//! One cable's entries after the other are hashed, then the board's values are checked, then each
//! cable is built and discarded. Only if everything is valid the configuration in use is
//! overwritten, cable by cable: a refusal does not change it.

use super::schedule::{MOST_LOAD_PERMILLE, load_permille};
use super::{
    Active, CableConfig, ConfigStore, Control, DriveKind, Slots, TensionLaw, TensionOutput,
};
use crate::adc;
use crate::fixed::{division, half, quotient, saturate};
use core::cell::Cell;
use core::ops::Range;
use mcdpr_protocol::config::ConfigDigest;
use mcdpr_protocol::{BoardKey, CableKey, ConfigEntry, ConfigHash, ConfigKey, Reject};

/// Longest coordinated stop, ms.
// 300 ms, the time that docs/safety.md states for every stop along the path.
const MAX_STOP_MS: i32 = 300;

/// Largest limit of a jerk, mm/s³: its products with a spacing stay in 64 bits.
// 10,000 m/s^3. Times a spacing of 4000 ms squared it is 1.6e14.
const MAX_JERK_MMPS3: i32 = 10_000_000;

/// Bit rates that the board's CAN clock gives exactly, bit/s.
pub(crate) const BIT_RATES: [u32; 4] = [125_000, 250_000, 500_000, 1_000_000];

/// Permitted ticks between two commands to a drive, by how its cable is held.
#[derive(Clone, Copy)]
struct Periods {
    by_length: u8,
    by_tension: u8,
}

/// Highest ceiling, in tenths of the reading at which a sensor counts as open.
// The margin of a tenth lets the prediction (C2) act before the reading reaches the rail.
const MOST_OF_RAIL_TENTHS: i64 = 9;

/// Step of one slice.
#[derive(Clone, Copy)]
enum Slice {
    /// Hashes the board's entries.
    HashBoard,
    /// Hashes a third of a cable's.
    HashCable { index: u8, third: u8 },
    /// Compares the hashes, checks the board's values.
    CheckBoard,
    /// Checks a cable.
    CheckCable(u8),
    /// Checks the drives' share of the bus, and activates the board's values.
    TakeBoard,
    /// Activates a cable.
    TakeCable(u8),
    /// The hash of the active configuration.
    TakeHash,
}

impl<const N: usize> ConfigStore<N> {
    const CABLES: u8 = N.to_le_bytes()[0];

    fn slice(&self) -> Slice {
        let mut at = self.done;
        let mut within = |count: u8| {
            let place = at;
            at = at.saturating_sub(count);
            (place < count).then_some(place)
        };
        if within(1).is_some() {
            Slice::HashBoard
        } else if let Some(place) = within(3 * Self::CABLES) {
            Slice::HashCable {
                index: place / 3,
                third: place % 3,
            }
        } else if within(1).is_some() {
            Slice::CheckBoard
        } else if let Some(index) = within(Self::CABLES) {
            Slice::CheckCable(index)
        } else if within(1).is_some() {
            Slice::TakeBoard
        } else if let Some(index) = within(Self::CABLES) {
            Slice::TakeCable(index)
        } else {
            Slice::TakeHash
        }
    }

    /// Whether the active configuration is being overwritten: it must not be followed then.
    #[must_use]
    pub const fn is_taking(&self) -> bool {
        // Hashes, checks and the board's values are done.
        self.done >= 3 + 4 * Self::CABLES
    }

    /// Checks, builds and activates in one call; see [`Self::build_slice`].
    ///
    /// # Errors
    /// As there.
    pub fn build_into(
        &mut self,
        host: ConfigHash,
        active: &mut Option<Active<N>>,
    ) -> Result<(), Reject> {
        loop {
            if let Some(result) = self.build_slice(host, active) {
                return result;
            }
        }
    }

    /// Does one slice of activating the entries; `None` as long as there is more. `active` does not
    /// change if it fails.
    ///
    /// # Errors
    /// [`Reject::ConfigSequence`] if entries are missing, [`Reject::ConfigHash`] if the hashes
    /// differ, [`Reject::ConfigValue`] with the first key that is missing or invalid.
    pub fn build_slice(
        &mut self,
        host: ConfigHash,
        active: &mut Option<Active<N>>,
    ) -> Option<Result<(), Reject>> {
        let slice = self.slice();
        let result = self.work(slice, host, active);
        self.done = match (slice, &result) {
            // From the beginning after a refusal: entries may come anew.
            (Slice::TakeHash, _) | (_, Err(_)) => 0,
            _ => self.done + 1,
        };
        (self.done == 0).then_some(result)
    }

    #[inline(never)]
    fn work(
        &mut self,
        slice: Slice,
        host: ConfigHash,
        active: &mut Option<Active<N>>,
    ) -> Result<(), Reject> {
        match slice {
            Slice::HashBoard => {
                if self.announced == 0 || self.received != self.announced {
                    return Err(Reject::ConfigSequence);
                }
                self.digest = ConfigDigest::default();
                let all = (BoardKey::ALL, 0..BoardKey::ALL.len());
                hash(&mut self.digest, &self.board, all, ConfigKey::board);
            }
            Slice::HashCable { index, third } => {
                // A third of a cable's entries per tick keeps the slice short.
                let all = CableKey::ALL.len();
                let first = usize::from(third) * THIRD;
                let places = first..(first + THIRD).min(all);
                if let Some(values) = self.cables.get(usize::from(index)) {
                    let keys = (CableKey::ALL, places);
                    hash(&mut self.digest, values, keys, |key| {
                        ConfigKey::cable(index, key)
                    });
                }
            }
            Slice::CheckBoard => {
                let board = self.digest.clone().finish();
                // Compared before any value is judged: a wrong transmission is to be reported as
                // such (L2).
                if board != host {
                    return Err(Reject::ConfigHash { board, host });
                }
                let cables = self.board_key(BoardKey::Cables, 1, 8)?;
                if cables != i32::from(Self::CABLES) {
                    return Err(Reject::CableCount {
                        expected: Self::CABLES,
                        got: u8::try_from(cables).unwrap_or(u8::MAX),
                    });
                }
                self.drive_kind()?;
                self.bus_bitrate()?;
                self.periods()?;
            }
            Slice::CheckCable(index) | Slice::TakeCable(index) => {
                let takes = matches!(slice, Slice::TakeCable(_));
                let active = active.as_mut().filter(|_| takes);
                let slot = active.and_then(|active| active.cables.get_mut(usize::from(index)));
                self.build_cable(index, self.periods()?, slot)?;
            }
            Slice::TakeBoard => self.take_board(active)?,
            Slice::TakeHash => {
                if let Some(active) = active {
                    active.hash = host;
                }
            }
        }
        Ok(())
    }

    fn board_key(&self, key: BoardKey, low: i32, high: i32) -> Result<i32, Reject> {
        let value = self.board.get(key as usize - 1);
        checked(ConfigKey::board(key), value, low, high)
    }

    fn drive_kind(&self) -> Result<DriveKind, Reject> {
        Ok(match self.board_key(BoardKey::DriveKind, 0, 2)? {
            1 => DriveKind::Rmds,
            2 => DriveKind::Cia402,
            _ => DriveKind::None,
        })
    }

    fn bus_bitrate(&self) -> Result<u32, Reject> {
        let bits_per_s = self.board_key(BoardKey::BusBitrate, 125_000, 1_000_000)?;
        let bits_per_s = bits_per_s.cast_unsigned();
        if BIT_RATES.contains(&bits_per_s) {
            return Ok(bits_per_s);
        }
        refused(ConfigKey::board(BoardKey::BusBitrate))
    }

    fn feedback_timeout_ms(&self) -> Result<u16, Reject> {
        Ok(small(self.board_key(
            BoardKey::FeedbackTimeoutMs,
            2,
            1000,
        )?))
    }

    fn periods(&self) -> Result<Periods, Reject> {
        let period = |key| ticks(key, self.board_key(key, 1000, 20_000)?);
        let by_length = period(BoardKey::BusPeriodUs)?;
        let by_tension = period(BoardKey::TensionPeriodUs)?;
        // Feedback at longer intervals would look lost between two of them. The longer interval
        // must be a whole number of the shorter ones.
        let timeout_ms = self.feedback_timeout_ms()?;
        if by_length % by_tension != 0 || u16::from(by_length) * 2 >= timeout_ms {
            return refused(ConfigKey::board(BoardKey::BusPeriodUs));
        }
        Ok(Periods {
            by_length,
            by_tension,
        })
    }

    /// The board's values, into the active configuration; its cables stay as they were.
    #[inline(never)]
    fn take_board(&self, active: &mut Option<Active<N>>) -> Result<(), Reject> {
        let (drive_kind, bus_bitrate) = (self.drive_kind()?, self.bus_bitrate()?);
        let periods = self.periods()?;
        let cycles = self.cables.iter().map(|values| {
            // Every cable was checked by the slices before: a missing value cannot occur here.
            let by_tension = values.get(CableKey::Control as usize - 1) != Some(0);
            let by_force =
                by_tension && values.get(CableKey::TensionOutput as usize - 1) != Some(1);
            let ticks = if by_tension {
                periods.by_tension
            } else {
                periods.by_length
            };
            (u32::from(ticks) * 1000, by_force)
        });
        // A bus beyond its capacity would delay commands by more and more until feedback is lost
        // (D3).
        if load_permille(drive_kind, bus_bitrate, cycles) > MOST_LOAD_PERMILLE {
            return refused(ConfigKey::board(BoardKey::BusPeriodUs));
        }
        let stop_ms = self.board_key(BoardKey::StopMs, 20, MAX_STOP_MS)?;
        let residual_ms = self.board_key(BoardKey::ResidualMs, 1, 10_000)?;
        let enable_ms = self.board_key(BoardKey::EnableMs, 0, 10_000)?;
        let hold_braked = self.board_key(BoardKey::HoldBrakes, 0, 1)? == 1;
        let fault_line = self.board_key(BoardKey::FaultLine, 0, 1)? == 1;
        let feedback_timeout_ms = self.feedback_timeout_ms()?;
        if active.is_none() {
            // From a constant: it would otherwise be built on the stack first.
            *active = const { Some(Active::NOTHING) };
        }
        let Some(active) = active else {
            return Ok(());
        };
        active.drive_kind = drive_kind;
        active.bus_bitrate = bus_bitrate;
        active.stop_ms = stop_ms.cast_unsigned();
        active.residual_ms = small(residual_ms);
        active.enable_ms = enable_ms.cast_unsigned();
        active.feedback_timeout_ms = feedback_timeout_ms;
        active.hold_braked = hold_braked;
        active.fault_line = fault_line;
        Ok(())
    }

    /// One cable in machine units, into a slot if there is one. Out of line: its temporaries leave
    /// the stack again.
    #[inline(never)]
    fn build_cable(
        &self,
        index: u8,
        periods: Periods,
        slot: Option<&mut CableConfig>,
    ) -> Result<(), Reject> {
        let Some(values) = self.cables.get(usize::from(index)) else {
            return Ok(());
        };
        let fields = Fields {
            values,
            refused: Cell::new(None),
        };
        let key = |key, low, high| fields.take(key, low, high);
        // A divisor, or a sign.
        let not_zero = |key, low, high| match fields.take(key, low, high) {
            0 => fields.refuse(key, high),
            value => value,
        };
        // 1 mm to 500 mm keeps every product below in 64 bits; 312689/49766 is 2 pi to 1e-11.
        // Largest radius: 5,000,000 x 312,689 x 2^20 is 1.6e18, under 2^63.
        let radius = key(CableKey::DrumRadius, 10_000, 5_000_000);
        let circumference_q20 = quotient::<49_766>((i64::from(radius) * 312_689) << 20);
        let circumference_q8 = (circumference_q20 + half(12)) >> 12;
        let counts = key(CableKey::EncoderCountsPerTurn, 16, 1_000_000);
        let sign = not_zero(CableKey::EncoderSign, -1, 1);
        // Example: 20 mm and 4096 counts give 306.8 of 0.1 um, 30.7 um per count.
        let per_count_q24 = i64::from(sign) * rounded(circumference_q20 << 4, i64::from(counts));
        let motor_counts = not_zero(CableKey::MotorCountsPerTurn, -8_000_000, 8_000_000);
        let per_rev = key(CableKey::MotorCountsPerRev, 4, 1_000_000);
        // Counts per 0.1 um: 1,520,148 per turn of 125.7 mm are 1.21.
        let motor_per_length_q32 = division(i64::from(motor_counts) << 40, circumference_q8);
        // µm/s to rpm: ten 0.1 µm per µm, 60 s per minute.
        // Example: 4096 counts per turn and 1.21 per 0.1 um are 0.177 rpm per um/s.
        let rpm_per_speed_q32 = division(motor_per_length_q32.abs() * 600, i64::from(per_rev));
        let force = not_zero(CableKey::ForcePerCurrent, -100_000_000, 100_000_000);
        let gain = i64::from(key(CableKey::TensionGain, 1, 10_000_000));
        let zero_uv = i64::from(key(CableKey::TensionZeroUv, -3_300_000, 3_300_000));
        let tension_max_mn = key(CableKey::TensionMax, 1, 10_000_000);
        let floor_mn = key(CableKey::TensionFloor, 0, tension_max_mn);
        // Sixteen conversions of 12 bits, summed: 65,536 steps would be 3.3 V, so a step is
        // k[mN/V] * 3.3 / 65,536, with 24 fractional bits.
        // 3.3 x 2^24 / 65,536 is 844.8.
        let tension_per_adc_q24 = quotient::<10>(gain * 8448);
        // mN/V times uV are 1e-6 mN. Example: 12.77 N/V and 0.2355 V are 3.007 N at 0 V.
        let tension_zero_q24 = quotient::<1000>(quotient::<1000>(gain * zero_uv) << 24);
        // Above the rail a reading is not a tension (S7): a ceiling that can never be reached does
        // not protect.
        let rail_q24 = i64::from(adc::RAIL_HIGH) * tension_per_adc_q24 - tension_zero_q24;
        let trusted_mn = quotient::<10>(MOST_OF_RAIL_TENTHS * (rail_q24 >> 24));
        let most_mn = tension_max_mn.min(saturate(trusted_mn));
        let ceiling_mn = key(CableKey::TensionCeiling, floor_mn + 1, most_mn);
        let max_speed_umps = key(CableKey::MaxSpeed, 1, 20_000_000);
        let filter_mhz = i64::from(key(CableKey::TensionFilterMhz, 100, 400_000));
        let alpha_q16 = alpha_q16_of(filter_mhz);
        let corner_alpha_q16 = match key(CableKey::SpeedCornerMhz, 0, 400_000) {
            // A share of 1: no low-pass.
            0 => 1 << 16,
            corner_mhz => alpha_q16_of(i64::from(corner_mhz)),
        };
        // Example: 244,336 for 0.45 m. In 32 bits, for the chip's divider.
        let gain_per_length_q40 = match key(CableKey::GainLength, 0, 2_000_000_000) {
            0 => 0,
            length => i32::MAX / (length.max(LEAST_GAIN_LENGTH) >> 8) * 2,
        };
        let length_min = key(CableKey::LengthMin, -2_000_000_000, 2_000_000_000);
        // One millisecond at one and a half times the largest speed, and a count of rounding.
        // um/s are 0.01 of 0.1 um per ms; one and a half of that is 15 / 1000.
        let step = quotient::<1000>(i64::from(max_speed_umps) * 15 * (1 << 24));
        let step = division(step, per_count_q24).abs() + 2;
        let max_current_ma = key(CableKey::MaxCurrentMa, 1, 32_000);
        // mA times mN/A is µN.
        // Example: 0.5 A at 112 N/A are 56 N.
        let most_force_mn =
            quotient::<1000>(i64::from(max_current_ma) * i64::from(force.abs())).max(1);
        let mass_g = key(CableKey::DrumMass, 0, 100_000_000);
        // g times µm/s over mN is µs.
        // Example: 34 kg and 56 N are 0.61 us per um/s, 18 ms from 30 mm/s.
        let stop_q16 = division(i64::from(mass_g) << 16, most_force_mn);
        let lead_us = key(CableKey::LeadUs, 0, 100_000);
        // A bus has no drive 0: that number addresses all of them. 127 is the board itself.
        let node = key(CableKey::Node, 1, 126);
        // Numbers with four bits of 0 address every RMDS of a group.
        if node & 15 == 0 && self.drive_kind()? == DriveKind::Rmds {
            fields.refuse(CableKey::Node, 0);
        }
        let control = match key(CableKey::Control, 0, 1) {
            0 => Control::Length,
            _ => Control::Tension,
        };
        // Slots are spread evenly over the drives' period.
        // The SYNC comes with the shorter period: a drive of the longer one answers every so many.
        let (period, syncs) = match control {
            Control::Length => (periods.by_length, periods.by_length / periods.by_tension),
            Control::Tension => (periods.by_tension, 1),
        };
        let brake_play = key(CableKey::BrakePlay, 0, MOST_PLAY);
        let built = CableConfig {
            control,
            per_count_q24,
            half_count: exact(per_count_q24.abs() >> 25),
            four_counts: exact(per_count_q24.abs() >> 22),
            // Under half of the counter's range, beyond which a step's direction is ambiguous.
            max_encoder_step: u16::try_from(step.min(16_000)).unwrap_or(16_000),
            motor_per_length_q32,
            length_per_motor_q32: division(circumference_q8 << 24, i64::from(motor_counts)),
            rpm_per_speed_q32,
            speed_per_rpm_q16: division(1 << 48, rpm_per_speed_q32.max(1)),
            motor_reversed: motor_counts < 0,
            max_rpm: small(key(CableKey::MaxMotorRpm, 1, 30_000)),
            max_current_ma,
            // 31 / 32: a drive at its limit reports a little less than the limit.
            most_ma: max_current_ma - max_current_ma / 32,
            current_per_force_q32: division(1000 << 32, i64::from(force)),
            tension_per_adc_q24,
            tension_zero_q24,
            tension_max_mn,
            floor_mn,
            ceiling_mn,
            law: match key(CableKey::TensionLaw, 0, 1) {
                0 => TensionLaw::Pd,
                _ => TensionLaw::Default,
            },
            output: match key(CableKey::TensionOutput, 0, 1) {
                0 => TensionOutput::Current,
                _ => TensionOutput::Speed,
            },
            kp_milli: key(CableKey::TensionKp, 0, 1_000_000),
            kd_us: key(CableKey::TensionKd, 0, 10_000_000),
            ki_milli: key(CableKey::TensionKi, 0, 10_000_000),
            damping_mns_per_m: key(CableKey::TensionDamping, 0, 100_000_000),
            filter_alpha_q16: exact(alpha_q16),
            corner_alpha_q16: exact(corner_alpha_q16),
            gain_per_length_q40,
            friction_mn: key(CableKey::Friction, 0, 1_000_000),
            mass_g,
            play: key(CableKey::Play, 0, MOST_PLAY),
            brake_play,
            lead_us,
            lead_square: exact(quotient::<1000>(i64::from(lead_us) * i64::from(lead_us))),
            most_force_mn: saturate(most_force_mn),
            stop_q16: saturate(stop_q16),
            brake_close_ms: small(key(CableKey::BrakeCloseMs, 1, 2000)),
            following_error: key(CableKey::FollowingError, 10, 1_000_000) * 10,
            max_speed_umps,
            max_acceleration_umps2: key(CableKey::MaxAcceleration, 1, 1_000_000_000),
            max_jerk_mmps3: key(CableKey::MaxJerk, 1, MAX_JERK_MMPS3),
            reel_speed_umps: key(CableKey::ReelSpeed, 1, 1_000_000),
            length_min,
            length_max: key(CableKey::LengthMax, length_min, 2_000_000_000),
            node: u8::try_from(node).unwrap_or(u8::MAX),
            period_ticks: period,
            // Example: four drives with a period of 2 ticks get slots 0, 0, 1, 1.
            slot: index * period / N.to_le_bytes()[0],
            syncs,
            // Counts per ms, times 60,000 ms per minute.
            rpm_per_count_q16: exact(division(60_000 << 16, i64::from(per_rev))),
        };
        if let Some(key) = fields.refused.get() {
            return refused(ConfigKey::cable(index, key));
        }
        if let Some(slot) = slot {
            *slot = built;
        }
        Ok(())
    }
}

/// The values of a cable, and the first key that is missing or out of range. Out of line, and without a way out at each
/// of them: that took 1 KB of flash.
struct Fields<'a> {
    values: &'a Slots<{ CableKey::ALL.len() }>,
    refused: Cell<Option<CableKey>>,
}

impl Fields<'_> {
    /// A value in its range; else the least that is permitted, and the key is refused.
    #[inline(never)]
    fn take(&self, key: CableKey, low: i32, high: i32) -> i32 {
        match self.values.get(key as usize - 1) {
            Some(value) if (low..=high).contains(&value) => value,
            _ => self.refuse(key, low),
        }
    }

    /// Notes the key, unless one was noted before; the configuration goes on with `instead` until its end.
    fn refuse(&self, key: CableKey, instead: i32) -> i32 {
        if self.refused.get().is_none() {
            self.refused.set(Some(key));
        }
        instead
    }
}

/// Share of a new sample in a low-pass with this corner, 16 fractional bits.
const fn alpha_q16_of(corner_mhz: i64) -> i64 {
    // alpha = w dt / (1 + w dt) with w dt = 2 pi f / 1000, f in mHz: 1e6 in the denominator.
    // 2 pi 2^24 is 105,414,357. Example: 5 Hz give an alpha of 0.030, 400 Hz one of 0.715.
    let w_dt_q24 = quotient::<1_000_000>(corner_mhz * 105_414_357);
    rounded(w_dt_q24 << 16, (1 << 24) + w_dt_q24)
}

/// Greatest play between motor and drum, and of a brake, 0.1 µm.
// 2 mm each: with both, the brakes' test takes 7.2 s longer.
const MOST_PLAY: i32 = 20_000;
/// Least length for which gains of a speed law may be given, 0.1 µm.
// 20 mm: without its lowest 8 bits it is right to 0.13 %.
const LEAST_GAIN_LENGTH: i32 = 200_000;

/// Entries of a cable that are hashed in one tick, at most.
const THIRD: usize = CableKey::ALL.len().div_ceil(3);

/// Hashes the values that are present, of keys at these indices.
fn hash<K: Copy, const M: usize>(
    digest: &mut ConfigDigest,
    values: &Slots<M>,
    (keys, places): (&[K], Range<usize>),
    key: impl Fn(K) -> ConfigKey,
) {
    for place in places {
        if let (Some(&each), Some(value)) = (keys.get(place), values.get(place)) {
            let key = key(each);
            digest.add(ConfigEntry { key, value });
        }
    }
}

fn refused<T>(key: ConfigKey) -> Result<T, Reject> {
    Err(Reject::ConfigValue { key: key.0 })
}

/// Whole ticks of a period.
fn ticks(key: BoardKey, us: i32) -> Result<u8, Reject> {
    // The schedule knows whole ticks only: 1.5 ms is refused instead of rounded.
    let ticks = u8::try_from(us / 1000).ok().filter(|_| us % 1000 == 0);
    ticks.map_or(refused(ConfigKey::board(key)), Ok)
}

/// The quotient of two positive numbers, rounded to nearest.
const fn rounded(dividend: i64, divisor: i64) -> i64 {
    division(dividend + (divisor >> 1), divisor)
}

fn checked(key: ConfigKey, value: Option<i32>, low: i32, high: i32) -> Result<i32, Reject> {
    value
        .filter(|value| (low..=high).contains(value))
        .ok_or(Reject::ConfigValue { key: key.0 })
}

/// A value that was just checked to be small.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "it was checked"
)]
fn small(value: i32) -> u16 {
    debug_assert!(u16::try_from(value).is_ok());
    value as u16
}

/// A value that 32 bits hold by the ranges of its factors, which were checked. Host builds assert it.
#[expect(
    clippy::cast_possible_truncation,
    reason = "it follows from its factors' ranges"
)]
fn exact(value: i64) -> i32 {
    debug_assert!(i32::try_from(value).is_ok());
    value as i32
}
