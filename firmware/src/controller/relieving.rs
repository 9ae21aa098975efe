//! Over-tension (C2): the path ends at once, no drum reels in any more, and each cable with too
//! high a tension is paid out until it is below its limit. Brakes wait for it: closed earlier, they
//! would preserve the tension.

use super::{Cable, Control, Controller, Inputs, Target, is_plausible};
use crate::adc;
use crate::config::CableConfig;
use crate::fixed::{quotient, saturate};

/// Speed at which a cable is paid out, µm/s for each 2 mN above its goal: with a cable of 40 N/mm
/// the excess is gone within about 10 ms.
// 2.5 mm/s per N. With 40 N/mm the excess decays with a time constant of 1 / (2.5 x 40) s = 10 ms.
const LET_OUT_UMPS: i64 = 5;
/// Greatest length that a length-held cable pays out, 0.1 µm: a sensor that reads too high must not
/// lower the load.
// 10 mm.
const LET_OUT_MOST: i32 = 100_000;
/// A tension-held drum reaches its commanded speed within about this many microseconds.
// 20 ms. Example: a drum of 34 kg that is 5 mm/s too slow gets 8.5 N.
const FOLLOW_US: i32 = 20_000;
/// Ticks that every cable must have been below its limit before brakes close.
const CALM_TICKS: u16 = 20;
/// Ticks after which brakes close in any case: the external force is too strong.
const LONGEST_TICKS: u16 = 2000;
/// A drum that turns slower than this, µm/s, counts as at rest.
const STANDS_UMPS: i32 = 3000;

/// Time until a drum that is commanded to stop no longer pulls, µs: transmission of the command,
/// and the time that the motor needs for the drum's mass.
pub(super) fn horizon_us(config: &CableConfig, speed_umps: i32) -> i32 {
    // A drum that pays out does not raise the tension: only the drive's lead remains.
    let reels_in = speed_umps.saturating_neg().max(0);
    // Example: 34 kg at 30 mm/s against 56 N stop within 18 ms.
    let stops_us = (i64::from(reels_in) * i64::from(config.stop_q16)) >> 16;
    saturate(i64::from(config.lead_us) + stops_us)
}

impl Cable {
    /// Tension at which paying out ends, mN: well below the ceiling, but not below the plan.
    fn goal_mn(&self, config: &CableConfig) -> i32 {
        let most = config.ceiling_mn - config.ceiling_mn / 8;
        // Seven eighths at most: paying out must end below the ceiling even if the plan is close to
        // it.
        let planned = self.setpoint_mn.min(most);
        (config.ceiling_mn - config.ceiling_mn / 4).max(planned)
    }

    /// Pays out for a tick; returns whether the cable is below its limit and its drum at rest.
    fn let_out(&mut self, config: &CableConfig, adc: u16) -> bool {
        // A reading at the upper rail counts if the tension rose to it. A jump to the rail is an
        // open sensor (S7), and no cable is let out because of it.
        let is_tension = is_plausible(adc) || (adc >= adc::RAIL_HIGH && self.watch.rose_to_rail());
        self.letting_umps = 0;
        self.target.speed_umps = 0;
        // Without a drive or a reading nothing can be let out, and the brakes must not wait for it.
        if self.abandoned | self.blind | !is_tension {
            return true;
        }
        let rise = i64::from(self.watch.rise_mn(self.tension_mn).max(0));
        let horizon = i64::from(horizon_us(config, self.speed_umps));
        // The tension at the time at which the drum will have followed the command.
        let coming = saturate(i64::from(self.tension_mn) + quotient::<1000>(rise * horizon));
        let goal = self.goal_mn(config);
        let over = i64::from(coming.saturating_sub(goal).max(0));
        let speed = (over * LET_OUT_UMPS) >> 1;
        let speed = saturate(speed).min(config.max_speed_umps);
        if self.give < LET_OUT_MOST {
            self.letting_umps = speed;
            self.target.speed_umps = speed;
            // µm/s are 0.01 of 0.1 µm per tick.
            let step = saturate(quotient::<100>(i64::from(speed)));
            self.give = self.give.saturating_add(step);
            self.target.length = self.target.length.saturating_add(step);
        }
        (coming <= config.ceiling_mn) & (self.speed_umps.abs() <= STANDS_UMPS)
    }

    /// Drum force of a tension-held cable that is relieved, mN: the cable's own, so that the drum
    /// is balanced, and the force that accelerates it to the pay-out speed. It never reels in.
    pub(super) fn relief_mn(&self, config: &CableConfig) -> i32 {
        let too_slow = i64::from(self.letting_umps) - i64::from(self.speed_umps);
        // g times µm/s over µs is mN.
        let push = quotient::<FOLLOW_US>(i64::from(config.mass_g) * too_slow);
        let goal = self.goal_mn(config);
        // Not more than the goal: the balance itself must not hold a tension that is too high.
        let balance = self.tension_mn.clamp(0, goal);
        // Down to the motor's full force outwards; at most the goal inwards.
        saturate(i64::from(balance) - push).clamp(-config.most_force_mn, goal)
    }
}

impl<const N: usize> Controller<N> {
    /// The path is over: from now on drums only pay out.
    pub(super) fn relieve(&mut self) {
        if self.relieving {
            return;
        }
        self.relieving = true;
        // Every cable has to be below its limit for the whole time from now on.
        self.calm_ticks = 0;
        // Their expectations belong to a point of the path.
        self.rows = Default::default();
        for cable in &mut self.cables {
            cable.give = 0;
            // From where the drum is: a set-point of the path that lies behind it would reel in.
            cable.target = Target {
                length: cable.length,
                ..Target::default()
            };
        }
    }

    /// Relieves all cables for a tick; returns whether brakes may close.
    pub(super) fn let_out(&mut self, inputs: &Inputs<N>) -> bool {
        let Some(active) = &self.active else {
            return true;
        };
        let mut calm = true;
        let cables = self.cables.iter_mut().zip(&active.cables);
        for ((cable, config), &adc) in cables.zip(&inputs.tension_adc) {
            calm &= cable.let_out(config, adc);
            if config.control == Control::Tension {
                // Its force pays it out, not its set-point; the set-point follows for the status.
                cable.target.length = cable.length;
            }
        }
        self.calm_ticks = if calm { self.calm_ticks + 1 } else { 0 };
        // A snag that pulls without end must not keep the robot under torque for ever.
        self.calm_ticks >= CALM_TICKS || self.stopping >= LONGEST_TICKS
    }
}
