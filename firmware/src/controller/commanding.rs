//! Demands to drives and brakes, from the targets and the state.

use super::{Axis, Control, Controller, Inputs, Phase, State, concerns, is_plausible};
use crate::config::TensionLaw;
use crate::io::{Brake, DriveDemand};
use crate::tension::Demand;
use mcdpr_protocol::BENCH_FAULT_LINE;

impl<const N: usize> Controller<N> {
    #[inline(never)]
    pub(super) fn command(&mut self, inputs: &Inputs<N>) {
        let armed = self.is_armed();
        let outputs = &mut self.outputs;
        outputs.gripper_closed = self.gripper_closed;
        outputs.well = !self.latch.is_set();
        // The contactor opens with an emergency stop, in addition to the stop's own contacts.
        outputs.drive_enable = self.active.is_some() && self.state != State::EStop;
        outputs.scan = core::mem::take(&mut self.scan_asked);
        let Some(active) = self.active.as_ref().filter(|_| armed) else {
            for (demand, brake) in outputs.drives.iter_mut().zip(&mut outputs.brakes) {
                // Set anew in every tick without torque: no output may survive from the tick
                // before.
                (*demand, *brake) = (DriveDemand::Off, Brake::Closed);
            }
            outputs.can_loop = core::mem::take(&mut self.loop_asked);
            if self.trial.1 > 0 {
                self.try_output();
            }
            return;
        };
        let phase = self.arming.phase();
        let brake = match (self.state, self.closing, phase) {
            (State::Stopping, Some(_), _) => Brake::Closed,
            // No brake opens before every one has passed its test.
            (_, _, Phase::Enabling | Phase::Preload | Phase::Proving) => Brake::Closed,
            (State::Holding, ..) if active.hold_braked || self.unsound > 0 => Brake::Closed,
            _ => Brake::Open,
        };
        // Drives enable without torque: the set-point is taken up only when all of them are ready.
        let torque = phase != Phase::Enabling;
        let slots = outputs.drives.iter_mut().zip(&mut outputs.brakes);
        let slots = slots.zip(active.cables.iter().zip(&inputs.drives));
        let cables = self.cables.iter_mut().zip(&inputs.tension_adc);
        for (number, ((cable, &adc), ((demand, brake_slot), (config, drive)))) in
            (1_u8..).zip(cables.zip(slots))
        {
            if cable.reversed || !concerns(self.service, number) {
                (*demand, *brake_slot) = (DriveDemand::Off, Brake::Closed);
                continue;
            }
            // A drive that is lost holds nothing: its brake must close now, independent of the
            // others.
            let gone = drive.fault || drive.age_ms >= active.feedback_timeout_ms;
            // A drive that is still enabling may be silent: it is not lost.
            cable.abandoned |= torque && gone;
            *brake_slot = if cable.abandoned {
                Brake::Closed
            } else {
                brake
            };
            *demand = match (config.control, torque) {
                (Control::Length, false) => DriveDemand::EnablePosition,
                (Control::Tension, false) if config.commands_speed() => DriveDemand::EnableSpeed,
                (Control::Tension, false) => DriveDemand::EnableCurrent,
                (Control::Length, true) => {
                    // Sign and scale of the encoder may be what is being determined: it must not
                    // correct anything.
                    if brake == Brake::Open && self.service.is_none() {
                        cable
                            .axis
                            .learn(config, &cable.target, cable.by_motor, cable.length);
                    }
                    let mut target = cable.target;
                    // The brake's test lets the drive pay out against the closed brake.
                    target.length = target.length.saturating_add(cable.proof.relief());
                    DriveDemand::Position {
                        counts: cable.axis.counts(config, &target),
                        rpm: Axis::rpm(config, &target),
                    }
                }
                (Control::Tension, true) => {
                    // A law that commands a speed would take back arming's test motion, which is a step of the
                    // tension: while its own drum is tested, it follows the plan alone.
                    let tested = config.commands_speed()
                        && config.law == TensionLaw::Default
                        && phase == Phase::Oscillating(number.wrapping_sub(1));
                    let blind = cable.blind || !is_plausible(adc) || tested;
                    let measured = Demand {
                        setpoint_mn: cable.setpoint_mn,
                        measured_mn: cable.tension_mn,
                        planned_speed_umps: cable.target.speed_umps,
                        planned_acceleration_umps2: cable.target.acceleration_umps2,
                        measured_speed_umps: cable.speed_umps,
                        length: cable.length,
                        stops: self.state == State::Stopping,
                        blind,
                    };
                    // Against a closed brake a law would only wind up.
                    let held = (brake == Brake::Closed && phase == Phase::Done) || self.opening > 0;
                    // If a brake does not hold, the law carries the load.
                    let held = held && self.unsound != number;
                    let relief = cable.proof.relief();
                    if config.commands_speed() {
                        // Before the brakes open, the drive must not wind up against them.
                        // A drive's speed loop has an integral of its own.
                        let closed = brake == Brake::Closed && phase <= Phase::Opening;
                        let umps = if relief != 0 {
                            relief
                        } else if held | closed | (phase == Phase::Opening) {
                            0
                        } else {
                            cable.tension_loop.update_speed(config, &measured)
                        };
                        let rpm = cable.tension_loop.rpm(config, umps);
                        *demand = DriveDemand::Speed { rpm };
                        continue;
                    }
                    // From the current that was held: the release is a change of it.
                    let ma = if relief > 0 {
                        cable.tension_loop.hold() + config.current_ma(-relief)
                    } else if self.relieving && self.closing.is_none() {
                        let force = cable.relief_mn(config);
                        cable.tension_loop.give(config, force)
                    } else if held || (blind && self.service.is_some()) {
                        // A bare winch has no plan to continue.
                        cable.tension_loop.hold()
                    } else {
                        cable.tension_loop.update(config, &measured)
                    };
                    DriveDemand::Current {
                        // The configuration allows 32 A at most: only the sum with a release could
                        // exceed 16 bits.
                        ma: crate::fixed::saturate_i16(ma),
                    }
                }
            };
        }
    }

    /// Sets the output that the self-test tries; it falls by itself, and at once if anything else
    /// begins.
    #[inline(never)]
    fn try_output(&mut self) {
        let (output, ticks) = self.trial;
        self.trial.1 = ticks - 1;
        let outputs = &mut self.outputs;
        // Moves nothing: hosts prove the line before they arm.
        if self.state == State::Disarmed && output == BENCH_FAULT_LINE {
            outputs.well = false;
            return;
        }
        if self.state != State::Disarmed || self.active.is_some() {
            self.trial.1 = 0;
            return;
        }
        match output {
            5 => outputs.gripper_closed = true,
            6 => outputs.drive_enable = true,
            _ => {
                let brake = outputs.brakes.get_mut(usize::from(output).wrapping_sub(1));
                if let Some(brake) = brake {
                    *brake = Brake::Open;
                }
            }
        }
    }
}
