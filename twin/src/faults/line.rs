//! A line to the simulator that injects faults at their times.

use super::inject::{HostSide, apply, mend};
use super::{Injection, Phase, When};
use crate::line::{SimulatedLink, plant_failed};
use mcdpr_core::link::{Link, LinkError};
use mcdpr_firmware::State;
use std::cell::RefCell;
use std::rc::Rc;

/// Resolution of the search for the motion's start, µs: a control tick.
const LOOK_US: u64 = 1000;

#[derive(Debug, Default)]
struct Schedule {
    pending: Vec<Injection>,
    /// Times of removal, µs.
    mends: Vec<(u64, Injection)>,
    motion_us: Option<u64>,
    /// Times at which the board entered each phase of [`Phase::ALL`], µs.
    phases_us: [Option<u64>; Phase::ALL.len()],
    last: Option<State>,
    /// Brakes that were closed when this state began.
    braked_before: Option<usize>,
    /// The host sends nothing before this time, µs.
    silent_until_us: u64,
    injected_us: Vec<u64>,
}

impl Schedule {
    /// Observes the board's state, and the brakes: `braked` counts those that are closed.
    fn see(&mut self, state: State, braked: impl FnOnce() -> usize, now_us: u64) {
        let within = match state {
            State::Arming => Some((Phase::Arming, Phase::Stirring)),
            State::Stopping => Some((Phase::Stopping, Phase::Closing)),
            _ => None,
        };
        // A phase within a state: brakes of the first arming open, those of the stop close.
        if let Some((of, inner)) = within
            && self.last == Some(state)
            && self.phases_us[of as usize].is_some()
            && self.phases_us[Phase::Rearming as usize].is_none()
            && self.phases_us[inner as usize].is_none()
        {
            let braked = braked();
            let before = *self.braked_before.get_or_insert(braked);
            if braked != before {
                self.phases_us[inner as usize] = Some(now_us);
                self.braked_before = None;
            }
        }
        if self.last == Some(state) {
            return;
        }
        self.braked_before = None;
        self.last = Some(state);
        let armed_before = self.phases_us[Phase::Arming as usize].is_some();
        let stopped = self.phases_us[Phase::Stopping as usize].is_some();
        let phase = match state {
            State::Moving => {
                self.motion_us.get_or_insert(now_us);
                return;
            }
            State::Arming if armed_before => Phase::Rearming,
            State::Arming => Phase::Arming,
            State::Holding => Phase::Holding,
            State::Stopping if self.motion_us.is_some() => Phase::Stopping,
            State::Disarmed | State::Fault if stopped => Phase::Parked,
            _ => return,
        };
        self.phases_us[phase as usize].get_or_insert(now_us);
    }
}

/// A [`SimulatedLink`] that injects faults on time. Clones share all state.
#[derive(Clone)]
pub struct FaultyLink {
    inner: SimulatedLink,
    schedule: Rc<RefCell<Schedule>>,
}

impl FaultyLink {
    /// Faults on this line; those of [`When::Start`] are injected with the first byte.
    #[must_use]
    pub fn new(inner: SimulatedLink, injections: &[Injection]) -> Self {
        let schedule = Schedule {
            pending: injections.to_vec(),
            ..Schedule::default()
        };
        Self {
            inner,
            schedule: Rc::new(RefCell::new(schedule)),
        }
    }

    /// One more fault; one of [`When::Start`] is injected with the next byte or wait.
    pub fn add(&self, injection: Injection) {
        self.schedule.borrow_mut().pending.push(injection);
    }

    /// Injection time of each fault, ms since power-on, in order.
    #[must_use]
    pub fn injected_ms(&self) -> Vec<u64> {
        let schedule = self.schedule.borrow();
        schedule.injected_us.iter().map(|us| us / 1000).collect()
    }

    /// Time since power-on, ms.
    #[must_use]
    pub fn now_ms(&self) -> usize {
        usize::try_from(self.inner.now_us() / 1000).unwrap_or(usize::MAX)
    }

    /// Advances time with an inactive host.
    ///
    /// # Errors
    /// The plant's.
    pub fn settle(&self, for_us: u64) -> Result<(), LinkError> {
        let mut link = self.clone();
        let until = link.now_us() + for_us;
        let mut unread = Vec::new();
        while link.now_us() < until {
            link.receive(until, &mut unread)?;
        }
        Ok(())
    }

    /// Injects and removes the faults that are due, and returns the time of the next check.
    fn work(&self) -> Result<u64, LinkError> {
        let now = self.inner.now_us();
        let mut schedule = self.schedule.borrow_mut();
        let state = self.inner.with(|s| s.state());
        let braked = || {
            self.inner.with(|s| {
                let closed = s.plant().truth().map(|truth| truth.brakes_closed);
                closed.map_or(0, |closed| closed.iter().filter(|is| **is).count())
            })
        };
        schedule.see(state, braked, now);
        let (motion_us, phases_us) = (schedule.motion_us, schedule.phases_us);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "times are 0 to an hour"
        )]
        let due_us = |injection: &Injection| match injection.when {
            When::Start => Some(0),
            When::Motion(at_s) => motion_us.map(|start| start + (at_s * 1e6) as u64),
            When::After(phase, at_s) => {
                let start = phases_us.get(phase as usize).copied().flatten();
                start.map(|start| start + (at_s * 1e6) as u64)
            }
        };
        let mut waiting = Vec::new();
        for injection in std::mem::take(&mut schedule.pending) {
            // A phase that has not begun has no due time yet.
            if due_us(&injection).is_none_or(|due| due > now) {
                waiting.push(injection);
                continue;
            }
            let side = self
                .inner
                .with(|s| apply(s, &injection))
                .map_err(plant_failed)?;
            schedule.injected_us.push(now);
            if let HostSide::Silent(for_us) = side {
                schedule.silent_until_us = now.saturating_add(for_us);
            }
            if let Some(lasts_s) = injection.lasts_s {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "at most an hour"
                )]
                let end = now + (lasts_s * 1e6) as u64;
                schedule.mends.push((end, injection));
            }
        }
        schedule.pending = waiting;
        let (over, left): (Vec<_>, Vec<_>) =
            schedule.mends.drain(..).partition(|(end, _)| *end <= now);
        schedule.mends = left;
        for (_, injection) in over {
            // A program whose computer was off does not go on by itself.
            if injection.supply.is_none() {
                schedule.silent_until_us = schedule.silent_until_us.min(now);
            }
            self.inner
                .with(|s| mend(s, &injection))
                .map_err(plant_failed)?;
        }
        let idle = schedule.pending.is_empty() && schedule.mends.is_empty();
        // While a fault waits, the state is looked at in every tick: phases begin between bytes.
        Ok(if idle { u64::MAX } else { now + LOOK_US })
    }

    fn is_silent(&self) -> bool {
        self.inner.now_us() < self.schedule.borrow().silent_until_us
    }
}

impl Link for FaultyLink {
    fn now_us(&self) -> u64 {
        self.inner.now_us()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.work()?;
        if self.is_silent() {
            return Ok(());
        }
        self.inner.send(bytes)
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        let before = into.len();
        loop {
            let look_us = self.work()?;
            let now = self.inner.receive(until_us.min(look_us), into)?;
            // A host that is silent hears nothing either: what arrived is lost.
            if self.is_silent() {
                into.truncate(before);
            }
            if into.len() > before || now >= until_us {
                return Ok(now);
            }
        }
    }
}
