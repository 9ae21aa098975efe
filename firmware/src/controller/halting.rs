//! Actions around closed brakes: the checks of arming, and the end of a stop.

use super::{
    Control, Controller, Event, FaultId, HOLD_TORQUE_MS, Inputs, Limit, Oscillation, Phase, Proof,
    State, Target, Verdict, is_plausible, slowest_brake_ms,
};
use crate::config::TensionLaw;
use crate::proof::play_ms;

/// Speed at which a length-held cable pays out in a stop, 0.1 µm per tick (20 mm/s), and the
/// greatest distance.
// Slow enough that a slack cable becomes tight without an impact, and 6 mm within a stop of 300 ms.
const GIVE_STEP: i32 = 200;
// 10 mm: a sensor that reads wrong must not move the platform far.
const GIVE_MOST: i32 = 100_000;
/// A tension-held drum has settled if it reels in no faster than this, µm/s, and its cable is at
/// most this below its tension, mN.
const CALM_UMPS: i32 = 3000;
const CALM_MN: i32 = 2000;
/// Ticks until a brake that slipped is tried again.
// 50 ms: the drive pulls the drum back meanwhile, and a slow brake closes a little further.
const RETRY_MS: u16 = 50;
/// A brake that slips again so many ticks after its first slip does not hold (B2); one that holds before was late (B3).
// By time: behind a gear with play one attempt takes 0.4 s. On eight cables of which four stopped at once, the platform
// swings so that good brakes are found to slip for almost a second.
const LATE_MS: u16 = 1500;
/// Ticks for a drive to push against a brake: a drive that gives no torque cannot lose it.
const PROOF_MS: u16 = 1500;

impl<const N: usize> Controller<N> {
    #[inline(never)]
    pub(super) fn act_arming(&mut self, inputs: &Inputs<N>) {
        // Not by `map`: that would copy all cables to the stack.
        // What the host's model expects at the reference: set with the lengths, before arming.
        let mut expected = [0; N];
        for (expected, cable) in expected.iter_mut().zip(&self.cables) {
            *expected = cable.reference_mn;
        }
        let before = self.arming.phase();
        let mut unproven = 0;
        match before {
            Phase::Proving => match self.prove(inputs) {
                (Verdict::Holds, _) => {}
                (Verdict::Pending, cable) => unproven = cable,
                // No brake has opened yet: torque stays on, and the other brakes stay closed.
                (Verdict::Slips(turned), cable) => {
                    self.unsound = cable;
                    self.forget_proofs();
                    return self.trip(FaultId::B2, cable, turned / 10, 0);
                }
            },
            Phase::Oscillating(cable) => self.oscillate(usize::from(cable)),
            _ => {}
        }
        let Some(active) = &self.active else { return };
        match self
            .arming
            .tick(active, inputs, &expected, self.service, unproven)
        {
            Err((fault, cable, value, limit)) => self.trip(fault, cable, value, limit),
            // Once: the set-points of all drives are taken where the drums are now.
            Ok(Phase::Preload) if before == Phase::Enabling => self.take_up(inputs),
            Ok(Phase::Done) => {
                // A bare winch carries no platform: there is nothing to be watched after it is
                // parked.
                if self.service.is_none() {
                    self.hangs();
                }
                self.raise(Event::Armed);
            }
            Ok(now) => {
                if let (Phase::Oscillating(cable), true) = (before, now != before) {
                    self.judge_oscillation(cable);
                }
            }
        }
    }

    /// Tests all brakes for a tick; returns the first that slips, and its cable, 1 for the first.
    fn prove(&mut self, inputs: &Inputs<N>) -> (Verdict, u8) {
        let mut all = (Verdict::Holds, 0);
        let opens = self.state == State::Arming;
        let Some(active) = &self.active else {
            return all;
        };
        let cables = self.cables.iter_mut().zip(&active.cables);
        let cables = cables.zip(inputs.drives.iter().zip(&inputs.tension_adc));
        for (number, ((cable, config), (drive, &adc))) in (1_u8..).zip(cables) {
            // Its drive may not give torque any more, so its brake cannot be tested.
            if cable.abandoned {
                continue;
            }
            // The load that hangs on the brake, if it can be read.
            let load = if cable.blind || !is_plausible(adc) {
                cable.setpoint_mn
            } else {
                cable.tension_mn
            };
            let verdict = cable
                .proof
                .tick(config, cable.length, drive.current_ma, load, opens);
            if verdict == Verdict::Holds {
                cable.axis.shift(cable.proof.take_carried());
            }
            // A brake that slips outweighs one that is still being tested.
            if verdict != Verdict::Holds && !matches!(all.0, Verdict::Slips(_)) {
                all = (verdict, number);
            }
        }
        all
    }

    /// Ends every push: the drives pull their drums back to where they were. A push that went on would pay out.
    #[inline(never)]
    fn forget_proofs(&mut self) {
        for cable in &mut self.cables {
            cable.proof = Proof::default();
        }
    }

    fn oscillate(&mut self, index: usize) {
        let Some(active) = &self.active else { return };
        // The phase's index is below N; a panic is not an option on the board.
        let (Some(cable), Some(config)) = (self.cables.get_mut(index), active.cables.get(index))
        else {
            return;
        };
        let motion = Oscillation::amplitude(config, cable.setpoint_mn);
        // Observed first: the displacement belongs to the set-points of the ticks before.
        self.oscillation.observe(cable.by_motor, cable.length);
        cable.target = self.oscillation.step(motion, cable.target.length);
    }

    fn judge_oscillation(&mut self, number: u8) {
        let oscillation = core::mem::take(&mut self.oscillation);
        let index = usize::from(number);
        let Some(active) = &self.active else { return };
        let (Some(cable), Some(config)) = (self.cables.get_mut(index), active.cables.get(index))
        else {
            return;
        };
        // Exactly back to the length before: rounding of the test motion must not add up over the
        // drums.
        cable.target = Target {
            length: oscillation.base(cable.target.length),
            ..Target::default()
        };
        // The paper's law does not use the planned motion: its drum cannot be tested by moving.
        let can_oscillate = config.control == Control::Length || config.law == TensionLaw::Default;
        let (amplitude, _) = Oscillation::amplitude(config, cable.setpoint_mn);
        let verdict = oscillation.verdict(amplitude, config.commands_speed());
        if let (true, Err(found)) = (can_oscillate, verdict) {
            self.trip(found.fault, number + 1, found.value, found.limit);
        }
    }

    /// While the robot stops, a length-held cable pays out if its tension is too high and reels in
    /// if it is slack: by its measured tension, slowly, and not far (C1, C2). An invalid reading
    /// has no effect.
    ///
    /// Whether tensions allow the brakes to close: no cable is out of its band, and no tension-held
    /// drum still reels in. If braked earlier, a slack cable stays slack. A drum that pays out does
    /// not delay the brakes: it lowers the load. `set_anew`: a path has set this tick's targets, so
    /// that they lack what was given before.
    pub(super) fn give_way(&mut self, inputs: &Inputs<N>, set_anew: bool) -> bool {
        // Every cable moves in each tick, even after one was found that is not calm.
        let mut calm = true;
        let Some(active) = &self.active else {
            return true;
        };
        let cables = self.cables.iter_mut().zip(&active.cables);
        let cables = cables.zip(&inputs.tension_adc);
        for ((cable, config), &adc) in cables {
            // A drum behind a closed brake cannot move.
            if cable.blind | cable.abandoned | !is_plausible(adc) {
                continue;
            }
            let step = if cable.tension_mn > config.ceiling_mn {
                GIVE_STEP
            } else if cable.tension_mn.max(0) < config.floor_mn {
                // Without a floor no cable counts as slack, whatever the sensor's zero is.
                -GIVE_STEP
            } else {
                0
            };
            let mut settled = step == 0;
            if config.control == Control::Length {
                let given = if set_anew { 0 } else { cable.give };
                cable.give = (cable.give + step).clamp(-GIVE_MOST, GIVE_MOST);
                let missing = cable.give - given;
                cable.target.length = cable.target.length.saturating_add(missing);
                // 0.1 µm per ms is 100 µm/s.
                cable.target.speed_umps = cable.target.speed_umps.saturating_add(100 * step);
            } else if config.law == TensionLaw::Default {
                let missing = cable.setpoint_mn.saturating_sub(cable.tension_mn);
                // A quarter of the set-point, or 2 N: a law that still reels in would be stopped
                // half way.
                settled &= (missing <= (cable.setpoint_mn >> 2).max(CALM_MN))
                    & (cable.speed_umps >= -CALM_UMPS);
            }
            calm &= settled;
        }
        // Brakes that are not open hold what they held before.
        calm | (self.arming.phase() < Phase::Opening) | (self.opening > 0)
    }

    /// Brakes close under torque, torque is held, each brake must prove that it holds, then torque
    /// is switched off. If one does not hold, its drum is pulled back to its position and it is
    /// tried again (B3); if it never holds, the robot stays under torque (B2): a host may lower it.
    #[inline(never)]
    pub(super) fn close_brakes(&mut self, inputs: &Inputs<N>) {
        let (Some(ticks), Some(active)) = (self.closing, &self.active) else {
            return;
        };
        // Example: brakes of 30 ms are tested after 180 ms.
        let held = slowest_brake_ms(active) + HOLD_TORQUE_MS;
        let most = held + PROOF_MS + play_ms(active);
        // At most some 2000 + 150 + 1500 ms and the play's time, with the retries: 16 bits suffice.
        self.closing = Some(ticks + 1);
        // Ticks since the first slip; none before it.
        self.slips = self.slips.saturating_add(u16::from(self.slips > 0));
        if ticks < held {
            return;
        }
        if self.arming.phase() < Phase::Opening {
            if self.unsound > 0 {
                // Torque holds the load that this brake does not.
                self.arming.end();
                self.raise(Event::BrakeFails);
            } else {
                // Brakes that never opened hold what they held before.
                self.raise(Event::TorqueOff);
            }
            return;
        }
        // The proofs of arming are over: each brake is tested anew at its present place.
        if ticks == held {
            self.forget_proofs();
        }
        let (verdict, cable) = self.prove(inputs);
        let done = match verdict {
            Verdict::Slips(turned) => {
                self.slips = self.slips.max(1);
                self.limits.insert(Limit::BrakeSlips);
                self.forget_proofs();
                // Only the waiting time is repeated, not the brakes' whole closing time.
                self.closing = Some(held - RETRY_MS);
                // A brake that failed since arming gets no further attempts: the drum moves at each.
                if self.slips >= LATE_MS || self.unsound > 0 {
                    self.unsound = cable;
                    self.latch_fault(FaultId::B2, cable, turned / 10, 0);
                    self.raise(Event::BrakeFails);
                }
                false
            }
            Verdict::Holds => {
                if self.slips > 0 {
                    self.latch_fault(FaultId::B3, 0, i32::from(self.slips), i32::from(held));
                }
                true
            }
            // A drive without torque never reaches the push: the stop must end nevertheless.
            Verdict::Pending => ticks >= most,
        };
        if done {
            self.name_break();
            self.raise(Event::TorqueOff);
        }
    }
}
