//! The targets of every cable, by the state: hold, follow the path, take up, rest.

use super::{Axis, Controller, Event, Inputs, State, Target};
use crate::motion::Progress;
use crate::segment::Point;
use crate::tension::TensionLoop;
use mcdpr_protocol::{FaultId, Limit};

impl<const N: usize> Controller<N> {
    #[inline(never)]
    pub(super) fn act(&mut self, inputs: &Inputs<N>) {
        let Some(stop_ms) = self.active.as_ref().map(|active| active.stop_ms) else {
            return;
        };
        match self.state {
            State::Arming => self.act_arming(inputs),
            // The path clock stops until the brakes that held are open.
            State::Moving if self.opening > 0 => self.opening -= 1,
            State::Moving | State::Pausing => {
                self.follow(stop_ms);
                if self.state == State::Moving && !self.motion.covers_a_stop(stop_ms) {
                    // Advice while there is time: if no knot follows, the buffer runs empty (K6).
                    self.limits.insert(Limit::BufferShort);
                }
            }
            State::Stopping => {
                if self.closing.is_none() {
                    self.stopping = self.stopping.saturating_add(1);
                    let stands = if self.relieving {
                        self.let_out(inputs)
                    } else {
                        let set_anew = self.motion.has_path();
                        let rests = self.follow(stop_ms);
                        let calm = self.give_way(inputs, set_anew);
                        rests && (calm || u32::from(self.stopping) >= stop_ms)
                    };
                    if stands {
                        self.rest();
                        self.closing = Some(0);
                    }
                }
                self.close_brakes(inputs);
            }
            _ => {}
        }
    }

    /// Torque is switched on at the present position: no set-point jumps.
    pub(super) fn take_up(&mut self, inputs: &Inputs<N>) {
        let Some(active) = &self.active else { return };
        let cables = self.cables.iter_mut().zip(&active.cables);
        for ((cable, config), drive) in cables.zip(&inputs.drives) {
            cable.target = Target {
                length: cable.length,
                ..Target::default()
            };
            // Motor counts have no absolute meaning: they are tied to the drum's length when torque
            // begins.
            cable.axis = Axis::zeroed(drive.counts, cable.length);
            cable.sense_motor(config, drive);
            cable.tension_loop = TensionLoop::at(cable.tension_mn);
            // The static model's tension for the reference, with which the measured one has just
            // been compared.
            cable.setpoint_mn = cable.reference_mn;
        }
    }

    /// Follows the motion for a tick; returns whether it is at rest.
    pub(super) fn follow(&mut self, stop_ms: u32) -> bool {
        let Some(progress) = self.motion.tick(stop_ms) else {
            self.rest();
            return true;
        };
        let cables = &mut self.cables;
        self.motion.evaluate(|index, point, tension_mn| {
            if let Some(cable) = cables.get_mut(index) {
                cable.target = target(point);
                cable.setpoint_mn = tension_mn;
            }
        });
        // Coefficients are linearised about the plan between two knots: they change with the
        // segment.
        if let Some(rows) = self.motion.take_rows() {
            self.rows = *rows;
        }
        match progress {
            Progress::Running => return false,
            Progress::Done => {
                self.motion.clear();
                // Either is impossible in the other's state: Moving ends with the first, Pausing
                // with the second.
                self.raise(Event::MotionDone);
                self.raise(Event::AtRest);
            }
            Progress::Paused => {
                self.raise(Event::AtRest);
            }
            Progress::RanEmpty => {
                // Not at rest yet: the stop segment follows the tangent from here.
                self.trip(FaultId::K6, 0, 0, 0);
                return false;
            }
            Progress::Stopped => {
                // The stop segment has left the path: nothing of the motion can be resumed.
                self.motion.clear();
                self.raise(Event::AtRest);
            }
        }
        self.rest();
        true
    }

    pub(super) fn rest(&mut self) {
        for cable in &mut self.cables {
            cable.target.speed_umps = 0;
            cable.target.acceleration_umps2 = 0;
        }
    }
}

fn target(point: &Point) -> Target {
    Target {
        length: point.length(),
        speed_umps: point.velocity_umps,
        acceleration_umps2: point.acceleration_umps2,
    }
}
