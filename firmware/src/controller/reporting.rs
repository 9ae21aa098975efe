//! Reports of the board: state, measurements, warnings.

use super::{Cable, Controller};
use crate::io::Brake;
use crate::sampler::Measured;
use mcdpr_protocol::{Limits, Millinewtons, PerCable, Status, TenthMicrometres};

impl<const N: usize> Controller<N> {
    /// The measurements of this tick.
    #[must_use]
    pub fn measured(&self) -> [Measured; N] {
        let mut rows = [Measured::default(); N];
        for (row, cable) in rows.iter_mut().zip(&self.cables) {
            *row = Measured {
                length: cable.length,
                tension_mn: cable.tension_mn,
                current_ma: cable.current_ma,
            };
        }
        rows
    }

    /// Path time of the motion in progress, ms.
    #[must_use]
    pub fn path_ms(&self) -> u32 {
        self.motion.path_ms()
    }

    /// Clears the warnings collected so far, after they were reported.
    pub(crate) fn forget_limits(&mut self) {
        self.limits = Limits::default();
    }

    /// State for a host; the counters of the link are the server's.
    #[must_use]
    pub fn status(&self) -> Status {
        let each = |value: fn(&Cable) -> i32| self.cables.iter().map(value);
        Status {
            tick: self.now,
            state: self.state,
            path_ms: self.motion.path_ms(),
            setpoints: PerCable::collect(each(|c| c.target.length).map(TenthMicrometres)),
            lengths: PerCable::collect(each(|c| c.length).map(TenthMicrometres)),
            tensions: PerCable::collect(each(|c| c.tension_mn).map(Millinewtons)),
            knots_free: self.motion.free(),
            next_knot: self.motion.next_index(),
            fault: self.latch.get(),
            limits: self.limits,
            config: self.active.as_ref().map(|active| active.hash),
            referenced: self.referenced,
            brakes_open: bits(&self.outputs.brakes.map(|brake| brake == Brake::Open)),
            // The drives' feedback, not their commands.
            torque_on: bits(&self.drives.map(|drive| drive.torque)),
            gripper_closed: self.gripper_closed,
            gripper_switch: self.gripper_switch,
            tick_overruns: self.overruns,
            ..Status::default()
        }
    }
}

/// Bit 0 is cable 1.
pub(super) fn bits(values: &[bool]) -> u8 {
    let pairs = (0_u8..8).zip(values);
    pairs.fold(0_u8, |bits, (bit, &set)| bits | (u8::from(set) << bit))
}
