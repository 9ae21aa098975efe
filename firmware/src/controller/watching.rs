//! Monitoring in every tick under torque: each cable, and the relations between them.

use super::relieving::horizon_us;
use super::{
    Cable, Control, Controller, Event, FaultId, Inputs, Limit, Limits, LinkHealth, Phase, concerns,
};
use crate::arming::name_silence;
use crate::config::{CableConfig, TensionLaw};
use crate::io::DriveInput;
use crate::watch::{BREAK_TICKS, CableView, Finding, Persist, is_deaf};
use mcdpr_protocol::ResidualRow;

/// Time of contact after which the robot stops, ticks (C5).
const CONTACT_TICKS: u16 = 20;
/// Deviation of a tension from its expected value that is a warning, mN.
// 3 N: more than the 2 N that arming accepts (S10). Only advice, since a pull at the platform
// causes it, too.
const TENSION_WARN_MN: i32 = 3000;
/// Deviation below which no further check is needed, mN.
const TENSION_CALM_MN: i32 = 2000;
// The integrator of a drive takes 26 ms to lead a geared drum over its friction from winding in to paying out at
// 4 mm/s, and the less the faster the command (eight-cable at the end of a motion).
/// Speed below which a drum that is commanded to turn may stick for a while, µm/s.
const SLOW_UMPS: i32 = 7000;
const _: () = assert!(TENSION_CALM_MN <= TENSION_WARN_MN);
const _: () = assert!(TENSION_CALM_MN <= crate::watch::LEAST_OFF_MN);

/// Inputs of a cable's check besides the cable.
struct Around {
    /// The drum that arming is moving, 1 for the first; 0 for none.
    oscillated: u8,
    /// A bare winch has no cable, and the sign of its encoder may be what is being determined.
    bare: bool,
    /// Brakes hold the drums, or are about to: the output of law and motor against them carries no
    /// information.
    braked: bool,
    feedback_timeout_ms: u16,
}

impl Cable {
    /// Whether everything is normal; then the check of this tick is complete. Otherwise nothing was
    /// changed, and [`Self::examine`] does the full check.
    #[inline]
    pub(super) fn is_well(
        &mut self,
        config: &CableConfig,
        drive: &DriveInput,
        adc: u16,
        timeout_ms: u16,
    ) -> bool {
        let off = self.tension_mn.saturating_sub(self.setpoint_mn);
        // For a tension-held cable, also above the relevant error.
        let error = match config.control {
            Control::Length => self.target.length.saturating_sub(self.length),
            Control::Tension => self.by_motor.saturating_sub(self.length),
        };
        // Without branches: in nearly every tick all of them are false.
        let odd = (drive.fault | drive.over_temperature | drive.warning)
            | (self.lost | self.tension_loop.saturated | self.axis.trim_saturated())
            | (drive.age_ms >= timeout_ms)
            | (i32::from(drive.current_ma).abs() > config.most_ma)
            | (self.tension_mn < config.floor_mn)
            | (self.tension_mn > config.ceiling_mn)
            | (off.unsigned_abs() > TENSION_CALM_MN.unsigned_abs())
            | (error.unsigned_abs() > config.following_error.cast_unsigned())
            | is_deaf(self.commanded(config), self.given(config, drive));
        !odd && self.watch.is_quiet(
            adc,
            self.tension_mn,
            self.by_motor,
            self.length,
            config.four_counts,
        )
    }

    /// Size of a tension-held drum's command, mA or µm/s; none if it is so small that a drive
    /// measures it inaccurately, or that static friction holds the drive for a while.
    #[inline]
    fn commanded(&self, config: &CableConfig) -> i32 {
        let (commanded, least) = if config.commands_speed() {
            (self.tension_loop.commanded_speed_umps().abs(), SLOW_UMPS)
        } else {
            (self.tension_loop.hold().abs(), config.most_ma >> 5)
        };
        // A thirty-second of the largest current: 15 mA of 0.5 A on the paper's drive.
        if commanded > least { commanded } else { 0 }
    }

    /// Size of its output, likewise.
    #[inline]
    fn given(&self, config: &CableConfig, drive: &DriveInput) -> i32 {
        if config.commands_speed() {
            self.speed_umps.saturating_abs()
        } else {
            i32::from(drive.current_ma).abs()
        }
    }

    /// Commanded less measured length, 0.1 µm; for a tension-held cable, the difference between
    /// motor and drum.
    #[inline]
    fn length_error(&self, config: &CableConfig) -> i32 {
        if config.control == Control::Tension {
            self.axis.slipped(self.by_motor, self.length)
        } else {
            self.target.length.saturating_sub(self.length)
        }
    }

    /// Every detector; the first fault. Warnings go into `limits`.
    #[inline(never)]
    fn examine(
        &mut self,
        config: &CableConfig,
        (number, drive, adc): (u8, &DriveInput, u16),
        around: &Around,
        limits: &mut Limits,
    ) -> Option<Finding> {
        let by_tension = config.control == Control::Tension;
        // Out of range values switch a detector off for this tick, so that its counts go on in one
        // place.
        let view = CableView {
            adc,
            tension_mn: self.tension_mn,
            // No floor; and a cable that is meant to be slack cannot be too slack.
            floor_mn: if config.floor_mn == 0
                || (by_tension && self.setpoint_mn < config.floor_mn)
                || around.bare
            {
                i32::MIN
            } else {
                config.floor_mn
            },
            // During a motion a robot does not wait for that.
            reels_in: by_tension
                && !around.braked
                && config.law == TensionLaw::Default
                && self.target.speed_umps == 0,
            // Never switched off, not even on a bare winch: a cable may have been caught.
            ceiling_mn: config.ceiling_mn,
            horizon_us: horizon_us(config, self.speed_umps),
            length_error: self.length_error(config),
            length_error_max: config.following_error,
            // A tension-held drum follows no length: a difference can only be the encoder's (S2).
            motor_error: if by_tension {
                0
            } else {
                self.axis.motor_error(&self.target, self.by_motor)
            },
            commanded: if around.braked {
                0
            } else {
                self.commanded(config)
            },
            given: self.given(config, drive),
            // Either side: the law's limit, or the current of a drive that holds a position by
            // itself.
            saturated: !around.braked
                && (self.tension_loop.saturated
                    || i32::from(drive.current_ma).abs() > config.most_ma),
            feedback_age_ms: drive.age_ms,
            feedback_timeout_ms: around.feedback_timeout_ms,
            drive_fault: drive.fault,
            hot: drive.over_temperature,
            expected_mn: self.setpoint_mn,
            // A drum that arming moves pulls at a stiff cable on purpose. The paper's law leaves
            // half of the set-point to its error: that is not a runaway.
            by_tension: by_tension
                && !around.bare
                && !around.braked
                && config.law == TensionLaw::Default
                && around.oscillated != number,
            too_fast_umps: self.speed_umps.saturating_sub(self.target.speed_umps),
            motor_length: self.by_motor,
            drum_length: self.length,
            polarity_way: if around.bare | around.braked {
                i32::MAX
            } else {
                config.four_counts
            },
        };
        let fault = self.watch.update(&view);
        let off = self.tension_mn.saturating_sub(self.setpoint_mn);
        for (is, limit) in [
            (self.watch.slackens(), Limit::CableSlack),
            (self.watch.is_noisy(), Limit::TensionNoisy),
            (drive.warning || drive.over_temperature, Limit::DriveWarns),
            (view.saturated, Limit::CurrentSaturated),
            (self.axis.trim_saturated(), Limit::TrimSaturated),
            (off.saturating_abs() > TENSION_WARN_MN, Limit::TensionOff),
        ] {
            if is {
                limits.insert(limit);
            }
        }
        // Last: S6 is reported if no detector names another cause.
        fault.or_else(|| self.lost.then_some(Finding::new(FaultId::S6, 0, 0)))
    }
}

impl<const N: usize> Controller<N> {
    /// Whether only the drives hold the drums, or did: brakes take time to open.
    pub(super) fn watches_cables(&self) -> bool {
        // By the decision, not by the pins: one axis that is braked because its drive is lost must
        // not disable the monitoring of the others.
        self.arming.phase().is_free()
    }

    #[inline(never)]
    pub(super) fn watch(&mut self, inputs: &Inputs<N>) {
        if inputs.overrun || self.late_ticks.ticks() > 0 {
            // One late tick is made up for by the next; two in a row are 2 ms without control (P5).
            let late = self.late_ticks.update(inputs.overrun, 2);
            if late {
                self.trip(FaultId::P5, 0, 2, 1);
            }
        }
        let phase = self.arming.phase();
        if inputs.drives.iter().any(|drive| drive.bus_off) {
            // Feedback of a bus that is off is old: judging it would add D3 for every drive.
            self.trip(FaultId::D1, 0, 1, 0);
            if phase > Phase::Enabling {
                return;
            }
        }
        let Some(active) = &self.active else { return };
        if !self.watches_cables() {
            self.residuals = Default::default();
            return;
        }
        let around = Around {
            oscillated: match phase {
                Phase::Oscillating(cable) => cable + 1,
                _ => 0,
            },
            bare: self.service.is_some(),
            braked: self.is_braked(),
            feedback_timeout_ms: active.feedback_timeout_ms,
        };
        let mut found = None;
        let mut tight = None;
        // A cable that has just lost its tension shifts load to the others: that is not a snag,
        // unless these rose with it.
        // Taken before the loop: the loop changes the counts cable by cable.
        let (mut breaks, mut suspect) = (0, 0);
        for (number, cable) in (1_u8..).zip(&self.cables) {
            if cable.watch.breaks_ticks() > breaks {
                (breaks, suspect) = (cable.watch.breaks_ticks(), number);
            }
        }
        // The robot stops before it is known whether the cable broke.
        let suspected = breaks >= BREAK_TICKS;
        let (mut eased, mut falls) = (false, suspected);
        let readings = inputs.drives.iter().zip(&inputs.tension_adc);
        let configs = active.cables.iter().zip(readings);
        for (number, (cable, (config, (drive, &adc)))) in
            (1_u8..).zip(self.cables.iter_mut().zip(configs))
        {
            if cable.well {
                if cable.watch.is_noisy() {
                    self.limits.insert(Limit::TensionNoisy);
                }
                continue;
            }
            if !concerns(self.service, number) {
                continue;
            }
            let pins = (number, drive, adc);
            let fault = cable.examine(config, pins, &around, &mut self.limits);
            // A slack cable under a closed brake stays slack until it is pulled: that is only a
            // warning.
            // And a cable that may be broken unloads others, and loads others: those drums run away from its
            // load, not by a reversed sign.
            let consequence = suspected && number != suspect;
            let fault = fault.filter(|found| match found.fault {
                FaultId::C1 => !(around.braked || consequence),
                FaultId::S4 => !consequence,
                _ => true,
            });
            eased |= cable.watch.saturates();
            falls |= cable.watch.breaks_ticks() >= BREAK_TICKS;
            let (tension, ceiling) = (cable.tension_mn, config.ceiling_mn);
            if fault.is_some_and(|found| found.fault == FaultId::C2) {
                // It rose after the break and is still below its ceiling: its load came from the
                // broken cable.
                if cable.watch.snag_ticks() < breaks && tension <= ceiling {
                    continue;
                }
                tight = tight.or(Some((FaultId::C2, number, tension, ceiling)));
            }
            if found.is_none() && !(suspected && tight.is_some()) {
                found = fault.map(|found| (found.fault, number, found.value, found.limit));
            }
        }
        if let Some((fault @ FaultId::D3, cable, value, limit)) = found {
            // Only brakes hold the drums of a robot whose drives lost their supply.
            let (most, bare) = (around.feedback_timeout_ms, around.bare);
            let (fault, cable) = name_silence(most, inputs, bare, (fault, cable));
            found = Some((fault, cable, value, limit));
        }
        // One saturated motor slows the common clock: the tool stays on its path (D4).
        self.motion.ease(eased);
        let residual = self.watch_residuals().filter(|_| !suspected);
        if let Some((fault, cable, value, limit)) = found.or(residual) {
            self.trip(fault, cable, value, limit);
        }
        // Independent of the first fault found: a cable with too high a tension is paid out.
        if let Some((fault, cable, value, limit)) = tight.filter(|_| !suspected) {
            self.trip(fault, cable, value, limit);
        }
        // The name follows when the cable is tight again, or stays slack.
        if falls {
            self.stop_for(tight.is_some());
        }
    }

    /// Latches a cable that may be broken when the watch under torque ends.
    pub(super) fn name_break(&mut self) {
        for number in 1_u8.. {
            let Some(cable) = self.cables.get(usize::from(number) - 1) else {
                return;
            };
            if cable.watch.breaks_ticks() >= BREAK_TICKS {
                let tension = cable.tension_mn;
                self.latch_fault(FaultId::C3, number, tension, 0);
            }
        }
    }

    fn watch_residuals(&mut self) -> Option<(FaultId, u8, i32, i32)> {
        let residual_ms = self.active.as_ref()?.residual_ms;
        let mut found = None;
        // The first row relates lengths and tensions (S5); the second, of tensions alone, gives the
        // force on the platform besides the cables' (C5).
        let kinds = [(FaultId::S5, residual_ms), (FaultId::C5, CONTACT_TICKS)];
        let rows = self.rows.iter().zip(self.residuals.iter_mut()).zip(kinds);
        for ((row, persist), (fault, ticks)) in rows {
            // No row: the count of an earlier segment must not go on with the next one.
            if row.limit_um <= 0 {
                *persist = Persist::default();
                continue;
            }
            let (mut by_lengths, mut by_tensions) = (0_i64, 0_i64);
            let coefficients = row.lengths.iter().zip(&row.tensions);
            for (cable, (&by_length, &by_tension)) in self.cables.iter().zip(coefficients) {
                let length = cable.length.saturating_sub(cable.target.length);
                let tension = cable.tension_mn.saturating_sub(cable.setpoint_mn);
                by_lengths += i64::from(length) * i64::from(by_length);
                by_tensions += i64::from(tension) * i64::from(by_tension);
            }
            // 0.1 µm and 1/4096 against µm and 1/256, which is what tensions have.
            const { assert!(ResidualRow::TENSION_SCALE == 256) };
            const RATIO: i32 = 10 * ResidualRow::LENGTH_SCALE / 256;
            // Example: a coefficient of 1 (4096) and 100 um (1000 of 0.1 um) are 4,096,000 / 160 =
            // 25,600, that is 100 um in 1/256.
            let sum_q8 = crate::fixed::quotient::<RATIO>(by_lengths) + by_tensions;
            let residual_um = crate::fixed::saturate(sum_q8 >> 8);
            let limit = row.limit_um.unsigned_abs();
            if residual_um.unsigned_abs() > limit / 2 {
                self.limits.insert(Limit::ResidualHigh);
            }
            let over = residual_um.unsigned_abs() > limit;
            if persist.update(over, ticks) && found.is_none() {
                found = Some((fault, 0, residual_um, row.limit_um));
            }
        }
        found
    }

    pub(super) fn watch_link(&mut self) {
        match self.heartbeat.health(self.now) {
            LinkHealth::Good => {}
            LinkHealth::Late => self.limits.insert(Limit::HeartbeatLate),
            LinkHealth::Lost => {
                self.limits.insert(Limit::HeartbeatLate);
                // In every tick while it lasts: the latch keeps the first record, and Hold is
                // accepted where the robot still moves.
                self.trip(FaultId::L10, 0, self.heartbeat.age_ms(self.now), 100);
            }
            LinkHealth::Expired => {
                self.trip(FaultId::L10, 0, self.heartbeat.age_ms(self.now), 100);
                // Without torque the load would drop: the lost host is the smaller danger.
                if !self.stands_for_its_brake() {
                    self.raise(Event::Stop);
                }
            }
        }
    }
}
