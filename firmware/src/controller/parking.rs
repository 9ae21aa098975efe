//! A robot that hangs on its brakes: faults that can still occur there are latched and reported.
//! Nothing is switched on because of them.

use super::{Controller, Event, FaultId, Inputs, Limit, slowest_brake_ms};
use crate::watch::{CableView, Finding};

/// Ticks that drums have for coming to rest after their brakes have closed.
// 50 ms beyond the slowest brake's time: drums settle into the play of their brakes.
const REST_TICKS: u16 = 50;
/// A drum that turns by more than this many times four encoder counts is not at rest.
// Eight counts are 0.25 mm on the paper's drum.
const MOST_FOURS: i32 = 2;

/// State of a robot that hangs on its brakes.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Parked {
    /// It was held by its drives before, and its lengths have not been set anew since: drums and
    /// sensors describe a robot that hangs.
    hangs: bool,
    /// Ticks since torque was switched off.
    ticks: u16,
}

impl<const N: usize> Controller<N> {
    /// The robot is held by its drives.
    pub(super) const fn hangs(&mut self) {
        self.parked.hangs = true;
    }

    /// Its lengths are set anew, or its drums turn one by one: it may be anywhere.
    pub(super) const fn forget_parked(&mut self) {
        self.parked.hangs = false;
    }

    /// Torque is being switched off, or is off.
    pub(super) fn park(&mut self) {
        self.parked.ticks = 0;
        for cable in &mut self.cables {
            cable.watch = crate::watch::CableWatch::default();
        }
    }

    /// Checks a robot without torque.
    #[inline(never)]
    pub(super) fn watch_parked(&mut self, inputs: &Inputs<N>) {
        let taking = self.store.is_taking();
        // Half a configuration has no valid scale.
        let Some(active) = self.active.as_ref().filter(|_| !taking) else {
            return;
        };
        // A robot that was never armed may be moved by hand: its readings prove nothing.
        if !self.parked.hangs {
            return;
        }
        let rests = slowest_brake_ms(active) + REST_TICKS;
        // Saturating: a robot may hang for days.
        self.parked.ticks = self.parked.ticks.saturating_add(1);
        let settled = self.parked.ticks > rests;
        let mut found = None;
        let cables = self.cables.iter_mut().zip(&active.cables);
        for (number, ((cable, config), &adc)) in (1_u8..).zip(cables.zip(&inputs.tension_adc)) {
            // Until then the rest position follows the drum: it may turn while its brake closes.
            if !settled {
                cable.target.length = cable.length;
            }
            let turned = cable.length.saturating_sub(cable.target.length);
            let most = MOST_FOURS * config.four_counts + config.brake_play;
            let fault = if cable.lost {
                Some(Finding::new(FaultId::S6, 0, 0))
            } else if turned.unsigned_abs() > most.unsigned_abs() {
                Some(Finding::new(FaultId::B2, turned / 10, most / 10))
            } else {
                let view = CableView {
                    adc,
                    tension_mn: cable.tension_mn,
                    floor_mn: config.floor_mn,
                    ceiling_mn: config.ceiling_mn,
                    // No plan is in force: the tension is compared with its rails, floor and
                    // ceiling only.
                    expected_mn: cable.tension_mn,
                    // Checks that need torque are made ineffective: no command, no feedback, no
                    // direction.
                    length_error_max: 1,
                    feedback_timeout_ms: u16::MAX,
                    polarity_way: i32::MAX,
                    ..CableView::default()
                };
                cable.watch.update(&view).filter(|_| settled)
            };
            // A lifted platform is not a fault.
            let slack = cable.watch.slackens();
            if slack {
                self.limits.insert(Limit::CableSlack);
            }
            // The first cable's fault is reported; the others are still watched in this tick.
            found = found.or(fault
                .filter(|found| found.fault != FaultId::C1)
                .map(|found| (found.fault, number, found.value, found.limit)));
        }
        if let Some((fault, cable, value, limit)) = found {
            self.latch_fault(fault, cable, value, limit);
            // Brakes are closed and torque is off already: the event only leads to `Fault`.
            self.raise(Event::Emergency);
        }
    }
}
