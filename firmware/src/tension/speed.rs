//! The tension laws with the drum's speed as their output.
//!
//! A geared winch has tens of newtons of friction: its current is not proportional to the cable's
//! force. The speed loop in its drive overcomes the friction, and the law commands the drum's
//! speed. Gains are then speeds per tension, mm/s per N and N/s; where the drum pays out with the
//! plan, the error contains only what the plan does not include.

use super::{Demand, TensionLoop, lead_speed, pd, recovered};
use crate::config::{CableConfig, TensionLaw};
use crate::fixed::{LowPass, half, mul_q32, saturate};

/// Share of a new error in the slow filter that decides whether a drum may rest: 5 Hz.
// 2000 / 65,536 of each sample at 1 kHz: w = 0.0315 per ms, that is 5.0 Hz.
const SLOW_ALPHA_Q16: i32 = 2000;
/// A drum rests while the slow error is within this, mN, and turns again when it exceeds the
/// second, or the error itself the third. A drum that turned for less would repeatedly break loose
/// and stick, because its friction is higher at rest than in motion.
// Wider than the error that remains at rest: 2 mN in the median and 9 mN in the 95th percentile of
// the simulated winches (docs/tension.md).
const REST_MN: i32 = 20;
// Beyond twice REST_MN: between the two the drum keeps the state that it has.
const WAKE_MN: i32 = 45;
// A pull shows in the error at once; the slow mean follows with a time constant of 32 ms.
const JUMP_MN: i32 = 150;

/// State of the speed output.
#[derive(Debug, Clone, Copy)]
pub(super) struct Speed {
    slow: LowPass,
    rests: bool,
    /// The law's part of the speed, after the low-pass.
    answer: LowPass,
    /// Remainder of the last rounding to whole turns per minute, 16 fractional bits.
    carry_q16: i32,
    commanded_umps: i32,
}

impl Speed {
    pub(super) const NONE: Self = Self {
        slow: LowPass::at(0),
        rests: false,
        answer: LowPass::at(0),
        carry_q16: 0,
        commanded_umps: 0,
    };
}

impl Default for Speed {
    fn default() -> Self {
        Self::NONE
    }
}

impl TensionLoop {
    /// One tick of a cable whose law commands the drum's speed: µm/s, positive as it pays out.
    pub fn update_speed(&mut self, config: &CableConfig, demand: &Demand) -> i32 {
        let before_q16 = self.filter.value_q16();
        if !demand.blind {
            self.filter
                .update(demand.measured_mn, config.filter_alpha_q16);
        }
        let slope_mnps = saturate(((self.filter.value_q16() - before_q16) * 1000) >> 16);
        let speed = match config.law {
            // Without a plan and without a reading the only safe speed is none.
            TensionLaw::Pd if demand.blind => 0,
            TensionLaw::Pd => {
                let error_q16 = (i64::from(demand.setpoint_mn) << 16) - self.filter.value_q16();
                saturate(-pd(config, error_q16, slope_mnps))
            }
            TensionLaw::Default => self.default_speed(config, demand, slope_mnps),
        };
        let most = config.max_speed_umps;
        let limited = speed.clamp(-most, most);
        // The law gives no current: D4 is judged by the drive's feedback.
        self.saturated = false;
        (self.current_ma, self.force_mn) = (0, 0);
        self.speed.commanded_umps = limited;
        limited
    }

    fn default_speed(&mut self, config: &CableConfig, demand: &Demand, slope_mnps: i32) -> i32 {
        if demand.blind {
            // Without a reading the plan alone gives the speed, as for a length-held cable.
            return demand.planned_speed_umps;
        }
        let tension_mn = self.filter.value();
        let slack = config.floor_mn > 0
            && tension_mn < config.floor_mn
            && demand.setpoint_mn >= config.floor_mn;
        if slack || tension_mn > config.ceiling_mn {
            self.led = true;
            // Back in the band the drum has to come to rest anew.
            self.speed.rests = false;
            // The low-pass must not carry the last correction into the tight cable.
            self.speed.answer = LowPass::at(0);
            return lead_speed(config, demand, slack);
        }
        if self.led {
            self.led = false;
            self.integral_q16 = 0;
            self.short_mn = demand.setpoint_mn.saturating_sub(tension_mn);
        }
        self.short_mn = recovered(self.short_mn, demand.stops);
        let setpoint_mn = demand.setpoint_mn.saturating_sub(self.short_mn);
        let error_q16 = (i64::from(setpoint_mn) << 16) - self.filter.value_q16();
        let error_mn = saturate(error_q16 >> 16);
        self.speed.slow.update(error_mn, SLOW_ALPHA_Q16);
        let slow_mn = self.speed.slow.value();
        let within = if self.speed.rests { WAKE_MN } else { REST_MN };
        // Only without a planned motion and without a set-point that still rises: there the drum
        // turns anyway, and its friction is that of motion.
        self.speed.rests = demand.planned_speed_umps == 0
            && slow_mn.abs() <= within
            && error_mn.abs() <= JUMP_MN
            && self.short_mn == 0;
        if self.speed.rests {
            self.speed.answer = LowPass::at(0);
            return 0;
        }
        // Not while it rests: the integral would grow with an error that friction hides, and break
        // the drum loose.
        self.integrate(config, error_q16);
        let answer = pd(config, error_q16, slope_mnps) + ((self.integral_q16 + half(16)) >> 16);
        // With the low-pass the drum responds like a mass: large for slow errors, small where
        // cables ring.
        let most = i64::from(config.max_speed_umps);
        let answer = saturate(answer.clamp(-most, most));
        let answer = gained(config, answer, demand.length);
        let answer = self.speed.answer.update(answer, config.corner_alpha_q16);
        // The drive follows late, and a drum that is late pulls: 3 ms at 1 m/s2 are 3 mm/s, which a law of
        // 4 mm/s per N answers by 0.7 N. The lead is that of a drive's position loop; the speed loop inside is
        // some four times as fast, and with the waiting for the bus half of the lead is left.
        // us times um/s2, by 2^21 instead of 2 10^6: 5 % less, within what is known of a drive's bandwidth.
        let late = i64::from(demand.planned_acceleration_umps2) * i64::from(config.lead_us);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "2^31 times 100 ms are 2^27"
        )]
        let ahead = (late >> 21) as i32;
        demand
            .planned_speed_umps
            .saturating_add(ahead)
            .saturating_sub(answer)
    }

    /// The speed of the last tick, µm/s.
    #[must_use]
    pub(crate) const fn commanded_speed_umps(&self) -> i32 {
        self.speed.commanded_umps
    }

    /// Motor speed for a speed of the cable (µm/s), rpm. The remainder of the rounding is added to
    /// the next ones, so that the mean of slow speeds is exact.
    pub fn rpm(&mut self, config: &CableConfig, speed_umps: i32) -> i16 {
        // Zero is exact: no remainder of an earlier rounding may turn a drum that is commanded to stand still.
        if speed_umps == 0 {
            self.speed.carry_q16 = 0;
            return 0;
        }
        // 32 fractional bits and 65,536 times: at most 30,000 rpm are left in 31 bits.
        let exact_q16 = mul_q32(speed_umps, config.rpm_per_speed_q32 << 16)
            .saturating_add(self.speed.carry_q16);
        // Example: 1 rpm is 5.6 um/s behind 371:1. A command of 2 um/s is 0.36 rpm: the remainders
        // make it one turn per minute in about every third tick.
        let whole = (exact_q16.saturating_add(1 << 15)) >> 16;
        self.speed.carry_q16 = exact_q16.wrapping_sub(whole << 16);
        // After the remainder is taken: a command over the bound must not be made up for later.
        let most = i32::from(config.max_rpm);
        let rpm = crate::fixed::saturate_i16(whole.clamp(-most, most));
        if config.motor_reversed { -rpm } else { rpm }
    }
}

/// The law's answer for a cable of this length, 0.1 µm. Its stiffness is inverse to its length: with the same gains a
/// short cable would swing up, in motion, where no static friction damps it.
fn gained(config: &CableConfig, answer: i32, length: i32) -> i32 {
    if config.gain_per_length_q40 == 0 {
        return answer;
    }
    let share_q16 = mul_q32(length, i64::from(config.gain_per_length_q40) << 8);
    // At least an eighth: a wrong length must not take the loop away.
    mul_q32(answer, i64::from(share_q16.clamp(1 << 13, 1 << 16)) << 16)
}
