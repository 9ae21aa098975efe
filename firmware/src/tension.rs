//! Tension: the sensor's law and the laws that control a cable's tension.
//!
//! Signs: tensions and drum forces are positive as they pull; lengths and speeds are positive as
//! the cable pays out. So a positive damping force pulls back a drum that pays out faster than
//! planned.

mod speed;

use crate::config::{CableConfig, TensionLaw};
use crate::fixed::{LowPass, half, mul_q32, quotient, saturate};

/// Tension in mN from the ADC: `y = k (u - u0)` (Eq. 52).
#[must_use]
pub fn measured_mn(config: &CableConfig, adc: u16) -> i32 {
    // Example: k = 12.77 N/V is 0.643 mN per step of 3.3 V / 65,536. The truncated 24th bit of a
    // step adds up to less than 0.004 mN at full scale.
    let force_q24 = i64::from(adc) * config.tension_per_adc_q24 - config.tension_zero_q24;
    saturate((force_q24 + half(24)) >> 24)
}

/// Inputs of a tension law in a tick.
#[derive(Debug, Clone, Copy, Default)]
pub struct Demand {
    /// Set-point, mN.
    pub setpoint_mn: i32,
    /// Measured, mN.
    pub measured_mn: i32,
    /// Planned rate of the cable, µm/s.
    pub planned_speed_umps: i32,
    /// Planned acceleration of the cable, µm/s².
    pub planned_acceleration_umps2: i32,
    /// Measured rate of the drum's surface, from the motor, µm/s.
    pub measured_speed_umps: i32,
    /// Paid-out length, 0.1 µm.
    pub length: i32,
    /// The robot stops: a cable that was slack is needed soon.
    pub stops: bool,
    /// The measured tension is invalid (S7, S8, S11): it is not used.
    pub blind: bool,
}

/// Share of the friction that is compensated: more would cause stick-slip. Out of 256.
// 80 %: the file's friction may be above that of the winch. With more than twice the real friction
// the simulated loop is unstable (docs/tension.md).
const FRICTION_SHARE: i32 = 205;
/// Above this drum speed a drum certainly moves, µm/s; below it, the plan gives the sign of
/// friction.
// 4 mm/s. Between 0 and this speed the measured sign is blended in linearly.
const FRICTION_SPEED_UMPS: i32 = 4000;
/// After slack or overload the set-point returns this fast, mN per ms (20 N/s).
// Example: a cable that becomes tight at 3 N reaches its set-point of 10 N after 350 ms.
const RECOVERY_MNPMS: i32 = 20;
/// While the robot stops: a cable that is slack when the brakes close stays slack.
// 100 N/s: 7 N are recovered within 70 ms, well before the brakes of a stop of 300 ms close.
const STOP_RECOVERY_MNPMS: i32 = 100;
/// Below this planned speed friction feed-forward fades in linearly, µm/s.
// 0.5 mm/s. A step of the feed-forward at each reversal of the plan would excite the cable.
const FRICTION_FADE_UMPS: i32 = 500;

/// Largest error that is integrated unclipped, mN with 16 fractional bits (8 kN): its product with
/// the largest gain fits 64 bits.
// 2^39 times the largest ki (10,000,000) is 5.5e18, under 2^63 = 9.2e18.
const MOST_ERROR_Q16: i64 = 1 << 39;

/// State of one cable's tension law.
#[derive(Debug, Clone, Copy, Default)]
pub struct TensionLoop {
    filter: LowPass,
    /// Drum force of the integral, mN with 16 fractional bits.
    integral_q16: i64,
    /// Whether the last current was cut at its limit.
    pub saturated: bool,
    /// The force from which the last current was computed, mN.
    force_mn: i32,
    /// The last current, mA.
    current_ma: i32,
    /// Difference of the set-point in use from the requested one, mN: after slack it returns
    /// slowly.
    short_mn: i32,
    /// The cable was out of its band in the last tick: its drum is speed-controlled.
    led: bool,
    /// State of a law with speed output.
    speed: speed::Speed,
}

impl TensionLoop {
    /// Starts at rest with this tension, without a jump.
    #[must_use]
    pub const fn at(tension_mn: i32) -> Self {
        Self {
            filter: LowPass::at(tension_mn),
            integral_q16: 0,
            saturated: false,
            force_mn: 0,
            current_ma: 0,
            short_mn: 0,
            led: false,
            speed: speed::Speed::NONE,
        }
    }

    /// One tick: the motor current in mA.
    pub fn update(&mut self, config: &CableConfig, demand: &Demand) -> i32 {
        // A blind loop keeps the filter's last valid state: its slope is then 0, and a reading at
        // the rail does not enter the law.
        let before_q16 = self.filter.value_q16();
        if !demand.blind {
            self.filter
                .update(demand.measured_mn, config.filter_alpha_q16);
        }
        let after_q16 = self.filter.value_q16();
        // The derivative of the filtered tension is a filtered derivative; per ms to per s.
        let slope_mnps = saturate(((after_q16 - before_q16) * 1000) >> 16);
        let force_mn = match config.law {
            // It does not use the plan: the last current is kept.
            TensionLaw::Pd if demand.blind => return self.hold(),
            TensionLaw::Pd => {
                let error_q16 = (i64::from(demand.setpoint_mn) << 16) - after_q16;
                pd(config, error_q16, slope_mnps)
            }
            TensionLaw::Default => self.default_law(config, demand, slope_mnps),
        };
        let force_mn = saturate(force_mn);
        // The factor carries the sign of the winding: a positive force always reels in.
        let current = mul_q32(force_mn, config.current_per_force_q32);
        let limited = current.clamp(-config.max_current_ma, config.max_current_ma);
        // Read by the integral (anti-windup) and by the watch (D4).
        self.saturated = limited != current;
        self.force_mn = force_mn;
        self.current_ma = limited;
        limited
    }

    /// Feed-forward, PI and damping about the planned motion; out of the band of floor and ceiling,
    /// a separate slow law. Without a valid measurement: the plan's force, and damping. A current
    /// that was merely held would continue to accelerate the drum as the plan did at that moment.
    fn default_law(&mut self, config: &CableConfig, demand: &Demand, slope_mnps: i32) -> i64 {
        let tension_mn = self.filter.value();
        // Without a floor no cable counts as slack: a free end must not be reeled in because a
        // sensor's noise is below zero.
        // Neither is a cable whose set-point is under the floor: it is meant to be slack, as in
        // rigging.
        let slack = config.floor_mn > 0
            && tension_mn < config.floor_mn
            && demand.setpoint_mn >= config.floor_mn;
        if !demand.blind && (slack || tension_mn > config.ceiling_mn) {
            // A light drum without a counter-force becomes fast quickly, and the end of the slack
            // is then an impact: so the speed is controlled, in while slack, out while too tight.
            self.led = true;
            return lead(config, demand, tension_mn, slack);
        }
        if self.led {
            // The cable is tight again: continue from its actual tension, without the learnt
            // integral.
            // The integral was learnt on a slack cable: it does not fit the tight one.
            self.led = false;
            self.integral_q16 = 0;
            if !demand.blind {
                self.short_mn = demand.setpoint_mn.saturating_sub(tension_mn);
            }
        }
        // The jump to the full set-point would jerk the platform: the difference is worked off as a
        // ramp.
        self.short_mn = recovered(self.short_mn, demand.stops);
        let setpoint_mn = demand.setpoint_mn.saturating_sub(self.short_mn);
        let error_q16 = if demand.blind {
            0
        } else {
            // The fractions of a mN count: rounded, the integral would stop short of a zero mean
            // error.
            (i64::from(setpoint_mn) << 16) - self.filter.value_q16()
        };
        let ahead = i64::from(setpoint_mn)
            + feed_forward(config, demand)
            + pd(config, error_q16, slope_mnps);
        self.integrate(config, error_q16);
        ahead + ((self.integral_q16 + half(16)) >> 16)
    }

    /// Gives this drum force, mN, positive as it reels in: to relieve a cable with too high a
    /// tension. Returns the current, mA.
    pub fn give(&mut self, config: &CableConfig, force_mn: i32) -> i32 {
        let most = config.max_current_ma;
        self.force_mn = force_mn;
        self.current_ma = config.current_ma(force_mn).clamp(-most, most);
        // It is as large as the drum needs: D4 does not apply.
        self.saturated = false;
        self.current_ma
    }

    /// The current of the last tick, mA: behind a closed brake.
    #[must_use]
    pub const fn hold(&self) -> i32 {
        self.current_ma
    }

    fn integrate(&mut self, config: &CableConfig, error_q16: i64) {
        if self.saturated && (error_q16 > 0) == (self.force_mn > 0) {
            // More wind-up would only delay the return; the return itself is open.
            return;
        }
        // ki is in thousandths per second and a tick is a millisecond.
        let error_q16 = error_q16.clamp(-MOST_ERROR_Q16, MOST_ERROR_Q16);
        // Example: ki = 5 N/s per N (5000) and an error of 1 N add 5 mN per tick, 5 N/s.
        self.integral_q16 += quotient::<1_000_000>(error_q16 * i64::from(config.ki_milli));
        // A force over the ceiling is never useful: the bound limits how far the integral can wind
        // up.
        let most = i64::from(config.ceiling_mn) << 16;
        self.integral_q16 = self.integral_q16.clamp(-most, most);
    }
}

/// Difference of the set-point in use from the requested one a tick later, mN.
fn recovered(short_mn: i32, stops: bool) -> i32 {
    let step = if stops {
        STOP_RECOVERY_MNPMS
    } else {
        RECOVERY_MNPMS
    };
    // From either side: after slack it is positive, after an overload negative.
    short_mn - short_mn.clamp(-step, step)
}

/// Eq. 1: `Kp e + Kd de/dt`, as a drum force in mN or, with the gains of a speed output, as a speed in
/// µm/s. The set-point is constant between knots to
/// within their slope, so `de/dt` is minus the slope of the measured tension.
fn pd(config: &CableConfig, error_q16: i64, slope_mnps: i32) -> i64 {
    // Largest error 76 kN (sensor range, zero and set-point at their bounds) times the largest kp,
    // in 1/2^16 mN, is 5.0e18: it fits 64 bits.
    let proportional = quotient::<1000>(error_q16 * i64::from(config.kp_milli));
    // Example: kd = 10 ms (10,000 us) and a slope of 100 N/s give 1 N.
    let derivative = quotient::<1_000_000>(i64::from(slope_mnps) * i64::from(config.kd_us));
    ((proportional + half(16)) >> 16) - derivative
}

/// Speed at which a slack cable is reeled in, or one that is too tight paid out, µm/s: its reel speed on top of a
/// planned motion in the same direction. Reeled in more slowly than planned, a slack cable would become slacker.
// Once in the chip's memory, not in each of its callers.
#[inline(never)]
fn lead_speed(config: &CableConfig, demand: &Demand, slack: bool) -> i32 {
    let (planned, reel) = (demand.planned_speed_umps, config.reel_speed_umps);
    if slack {
        planned.min(0).saturating_sub(reel)
    } else {
        planned.max(0).saturating_add(reel)
    }
}

/// Force that drives a drum at the cable's reel speed: balances tension and friction, and corrects
/// the speed.
fn lead(config: &CableConfig, demand: &Demand, tension_mn: i32, slack: bool) -> i64 {
    // Lengths grow as the cable pays out: reeling in is a negative speed.
    let sign = if slack { -1 } else { 1 };
    let wanted = lead_speed(config, demand, slack);
    let too_fast = i64::from(demand.measured_speed_umps) - i64::from(wanted);
    // Tension and friction are balanced, so only the speed's error accelerates the drum.
    i64::from(tension_mn) - sign * i64::from(config.friction_mn)
        + quotient::<1_000_000>(i64::from(config.damping_mns_per_m) * too_fast)
}

/// Force for the planned motion without any error: friction, inertia; and damping of the drum about
/// its planned speed.
fn feed_forward(config: &CableConfig, demand: &Demand) -> i64 {
    let planned = demand.planned_speed_umps;
    let measured = i64::from(demand.measured_speed_umps);
    // If the drum certainly moves, friction acts against its motion; if it seems to be at rest, the
    // plan gives the coming direction. A swinging platform reverses drums that no plan moves.
    // 256 stands for 1. At 2 mm/s the measured sign counts half, and the plan supplies the other
    // half.
    let moves = demand
        .measured_speed_umps
        .clamp(-FRICTION_SPEED_UMPS, FRICTION_SPEED_UMPS)
        * 256
        / FRICTION_SPEED_UMPS;
    let fade = planned.clamp(-FRICTION_FADE_UMPS, FRICTION_FADE_UMPS);
    let sign_q8 = moves + fade * (256 - moves.abs()) / FRICTION_FADE_UMPS;
    // A drum that pays out is held back by friction, so the motor needs less force.
    // 52,480 (205 x 256) times the largest friction, 1 kN, is 5.2e10: the product needs 64 bits.
    let friction =
        i64::from(config.friction_mn) * i64::from(FRICTION_SHARE * sign_q8) / (256 * 256);
    // g times µm/s² is nN; 1e6 of them are one mN.
    let acceleration = i64::from(demand.planned_acceleration_umps2);
    let inertia = quotient::<1_000_000>(i64::from(config.mass_g) * acceleration);
    let too_fast = measured - i64::from(planned);
    // Example: 20 N s/m (20,000 mN s/m) at 5 mm/s too fast are 100 mN.
    let damping = quotient::<1_000_000>(i64::from(config.damping_mns_per_m) * too_fast);
    damping - friction - inertia
}
