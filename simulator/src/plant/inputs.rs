//! External influences on the plant: the board's outputs, the operator, mishaps.

use super::Plant;
use super::bus::Feedback;
use super::cable::Tension;
use super::drive::DriveCommand;
use super::error::PlantError;
use super::lift::Lift;
use super::settle::Load;

impl Plant {
    /// Passes a command to the bus; it reaches the drive in the drive's next slot. A set-point
    /// replaces one still waiting; `Off` and `Reset` void everything waiting; others queue.
    ///
    /// # Errors
    /// [`PlantError::NoSuchCable`].
    pub fn command(&mut self, cable: usize, command: DriveCommand) -> Result<(), PlantError> {
        self.known(cable)?;
        self.ports[cable].submit(command);
        Ok(())
    }

    /// Passes a command to a drive at once: for callers with their own bus. A drive without power,
    /// or one that ignores commands by a fault, does not take it.
    ///
    /// # Errors
    /// [`PlantError::NoSuchCable`].
    pub(crate) fn command_drive(
        &mut self,
        cable: usize,
        command: DriveCommand,
    ) -> Result<(), PlantError> {
        self.known(cable)?;
        if self.drive_has_supply(cable) && !self.faults.cables[cable].drive.ignores_commands {
            let now_s = self.time_s();
            let winch = &mut self.winches[cable];
            let motor_rate = winch.motor_rate();
            winch.drive.receive(command, now_s, motor_rate);
        }
        Ok(())
    }

    /// Present measurements of a drive: for callers with their own bus.
    ///
    /// # Errors
    /// [`PlantError::NoSuchCable`].
    pub(crate) fn drive_feedback(&self, cable: usize) -> Result<Feedback, PlantError> {
        self.known(cable)?;
        let winch = &self.winches[cable];
        Ok(Feedback::measure(
            &winch.drive,
            winch.motor_m(),
            winch.motor_rate(),
            self.time_s(),
        ))
    }

    /// Whether a drive has its supply: that of the robot, over its contactor.
    #[must_use]
    pub fn drive_has_supply(&self, cable: usize) -> bool {
        self.powered && self.contactors.get(cable).is_some_and(|c| c.is_closed())
    }

    /// Sets the board's drive enable, which the contactor of this cable's drive follows after its
    /// delay. A drive that has lost its supply needs a reset.
    ///
    /// # Errors
    /// [`PlantError::NoSuchCable`].
    pub fn set_drive_enable(&mut self, cable: usize, on: bool) -> Result<(), PlantError> {
        self.known(cable)?;
        let now_s = self.time_s();
        let contactor = &mut self.contactors[cable];
        let was_closed = contactor.is_closed();
        contactor.ask(on, now_s);
        if was_closed && !contactor.is_closed() {
            self.winches[cable].drive.cut_power();
            self.ports[cable].clear();
        }
        Ok(())
    }

    /// Switches a brake's output pin; the brake follows after its delay.
    ///
    /// # Errors
    /// [`PlantError::NoSuchCable`].
    pub fn set_brake(&mut self, cable: usize, closed: bool) -> Result<(), PlantError> {
        self.known(cable)?;
        let now_s = self.time_s();
        // Spring-applied: without supply no output can open a brake.
        let closed = closed || !self.powered || self.fails_at_s.is_some();
        let fault = &self.faults.cables[cable].brake;
        self.winches[cable].brake.ask(closed, now_s, fault);
        Ok(())
    }

    /// The board's encoder counters start again at zero: incremental encoders know nothing of what
    /// they counted before the supply was gone.
    pub(crate) fn restart_encoders(&mut self, cables: &[usize]) {
        let all = self.sensors.iter_mut().zip(&self.winches).enumerate();
        for (cable, (sensors, winch)) in all {
            if cables.is_empty() || cables.contains(&cable) {
                sensors.restart(winch.drum_m);
            }
        }
    }

    /// Presses or releases the e-stop. If it is wired to the power (the default), drives lose
    /// theirs at once and brakes close after their delay; releasing restores the supply but
    /// nothing starts by itself: drives need a reset, brakes a new command.
    pub fn set_e_stop(&mut self, pressed: bool) {
        self.e_stop = pressed;
        if self.params.e_stop_cuts_power {
            self.set_power(!pressed);
        }
    }

    /// Switches the supply of drives and brakes.
    pub fn set_power(&mut self, on: bool) {
        self.powered = on;
        self.fails_at_s = None;
        if on {
            return;
        }
        self.close_brakes();
        for (winch, port) in self.winches.iter_mut().zip(&mut self.ports) {
            winch.drive.cut_power();
            // A command that waits must not move a drive when the supply returns.
            port.clear();
        }
    }

    /// The supply before the rail fails: brakes lose theirs at once, and drives when the rail's
    /// capacitors are empty, after the least `hold_up_s` of them.
    pub fn lose_supply(&mut self) {
        let held = self
            .params
            .winches
            .iter()
            .map(|winch| winch.drive.hold_up_s);
        let hold_up_s = held.fold(f64::INFINITY, f64::min);
        if !(self.powered && hold_up_s > 0.0) {
            self.set_power(false);
            return;
        }
        self.fails_at_s = Some(self.time_s() + hold_up_s);
        self.close_brakes();
    }

    fn close_brakes(&mut self) {
        let now_s = self.time_s();
        for (winch, fault) in self.winches.iter_mut().zip(&self.faults.cables) {
            winch.brake.ask(true, now_s, &fault.brake);
        }
    }

    /// A constant load on the platform until changed: `force_n` (world) at `point_m` (platform
    /// frame) and a pure `torque_nm` (world).
    ///
    /// # Errors
    /// [`PlantError::Parameter`] if a value is not finite.
    pub fn set_load(
        &mut self,
        force_n: [f64; 3],
        point_m: [f64; 3],
        torque_nm: [f64; 3],
    ) -> Result<(), PlantError> {
        for value in force_n.into_iter().chain(point_m).chain(torque_nm) {
            if !value.is_finite() {
                return Err(PlantError::Parameter {
                    name: "external load",
                    value,
                    rule: "finite",
                });
            }
        }
        self.load = Load {
            force_n,
            torque_nm,
            point: self.body.principal(point_m),
        };
        Ok(())
    }

    /// Applies a force on the middle of a cable's free part, across the cable, until changed:
    /// `force_n` in the world frame; zero releases it. The caller chooses a direction across the
    /// cable: a component along it is not modelled, only its size stretches the cable.
    ///
    /// # Errors
    /// [`PlantError::NoSuchCable`]; [`PlantError::CableParameter`] if not finite or over 100 N.
    pub fn pull_cable(&mut self, cable: usize, force_n: [f64; 3]) -> Result<(), PlantError> {
        self.known(cable)?;
        let size = super::vec3::norm(force_n);
        if !size.is_finite() || size > 100.0 {
            return Err(PlantError::CableParameter {
                cable,
                name: "side pull",
                value: size,
                rule: "finite and at most 100 N",
            });
        }
        self.cables[cable].side_pull_n = force_n;
        Ok(())
    }

    /// Takes a cable off the platform and hangs a weight on it, at rest over its pulley, its drum
    /// braked: the tension sensor measures `weight_n` plus or minus the pulley's friction,
    /// depending on whether the weight before was lighter or heavier. `None` restores the robot's
    /// cable. The platform does not change: it should be on a stand meanwhile. Without cables on the
    /// robot the weight also pulls at the drum, braked or not.
    ///
    /// # Errors
    /// [`PlantError::NoSuchCable`]; [`PlantError::CableParameter`] unless 0 to 1000 N.
    pub fn hang_weight(&mut self, cable: usize, weight_n: Option<f64>) -> Result<(), PlantError> {
        self.known(cable)?;
        self.lifts[cable] = None;
        let Some(weight) = weight_n else {
            self.hung_n[cable] = None;
            return Ok(());
        };
        if !(0.0..=1000.0).contains(&weight) {
            return Err(PlantError::CableParameter {
                cable,
                name: "hung weight",
                value: weight,
                rule: "0 to 1000 N",
            });
        }
        let loss = self.params.cables[cable].pulley_loss;
        if !self.params.cables_attached {
            self.lifts[cable] = Some(Lift {
                weight_n: weight,
                loss,
            });
        }
        // A weight that is added sinks a little, against the friction; one that is taken rises.
        let sinks = self.hung_n[cable].is_none_or(|before| weight >= before);
        self.hung_n[cable] = Some(weight * if sinks { 1.0 - loss } else { 1.0 + loss });
        Ok(())
    }

    /// Puts a stand under the platform where it is now, or takes it away. The stand carries the
    /// platform's weight, keeps it from sliding and tilting, and lets it be lifted.
    pub fn set_stand(&mut self, present: bool) {
        let motion = &self.motion;
        let weight_n = super::vec3::norm(self.weight_n);
        let rotation = super::vec3::q_matrix(motion.attitude);
        self.stand =
            present.then(|| super::stand::Stand::under(motion.center_m, rotation, weight_n));
    }

    /// Puts a stand under the platform that just touches it and carries nothing yet: for a hanging
    /// platform that is going to be lowered.
    pub fn touch_stand(&mut self) {
        let rotation = super::vec3::q_matrix(self.motion.attitude);
        self.stand = Some(super::stand::Stand::under(
            self.motion.center_m,
            rotation,
            0.0,
        ));
    }

    /// A stiff hook catches the platform at its present pose, at `point_m` (platform frame), and
    /// blocks motion along `along` (world, of any length but zero), or in every direction. It stays
    /// until [`Plant::unhook`] or until the robot is placed again.
    ///
    /// # Errors
    /// [`PlantError::Parameter`] if a value is not finite or the direction has no length.
    pub fn hook(&mut self, point_m: [f64; 3], along: Option<[f64; 3]>) -> Result<(), PlantError> {
        let length = along.map_or(1.0, super::vec3::norm);
        let finite = point_m.into_iter().all(f64::is_finite) && length.is_finite();
        if !finite || length < 1e-9 {
            return Err(PlantError::Parameter {
                name: "hook",
                value: length,
                rule: "a finite point and a direction that has a length",
            });
        }
        let point = self.body.principal(point_m);
        let rotation = super::vec3::q_matrix(self.motion.attitude);
        let arm = super::vec3::mul(&rotation, point);
        self.hook = Some(super::hook::Hook::new(
            super::vec3::add(self.motion.center_m, arm),
            point,
            along.map(|along| super::vec3::scale(along, 1.0 / length)),
        ));
        Ok(())
    }

    /// Removes the hook.
    pub fn unhook(&mut self) {
        self.hook = None;
    }

    /// Breaks a cable for good (until the robot is placed again).
    ///
    /// # Errors
    /// [`PlantError::NoSuchCable`].
    pub fn break_cable(&mut self, cable: usize) -> Result<(), PlantError> {
        self.known(cable)?;
        self.cables[cable].broken = true;
        self.cables[cable].tension = Tension::default();
        Ok(())
    }

    /// Lets cable slip off (positive, longer) or onto the drum without turning the drum.
    ///
    /// # Errors
    /// [`PlantError::NoSuchCable`]; [`PlantError::CableParameter`] if not finite.
    pub fn slip_cable(&mut self, cable: usize, longer_m: f64) -> Result<(), PlantError> {
        self.known(cable)?;
        if !longer_m.is_finite() {
            return Err(PlantError::CableParameter {
                cable,
                name: "slip longer_m",
                value: longer_m,
                rule: "finite",
            });
        }
        self.cables[cable].unstretched_zero_m += longer_m;
        Ok(())
    }

    /// From now on the drum winds `gain` metres of cable per metre of its nominal circumference:
    /// 1 is right, 1.05 a layer that lies on another.
    ///
    /// # Errors
    /// [`PlantError::NoSuchCable`]; [`PlantError::CableParameter`] unless 0.5 to 2.
    pub fn set_winding_gain(&mut self, cable: usize, gain: f64) -> Result<(), PlantError> {
        self.known(cable)?;
        if !(0.5..=2.0).contains(&gain) {
            return Err(PlantError::CableParameter {
                cable,
                name: "winding gain",
                value: gain,
                rule: "0.5 to 2",
            });
        }
        let drum_m = self.winches[cable].paid_out().length_m;
        let c = &mut self.cables[cable];
        // The cable's length stays continuous: the new gain acts on what is wound from now on.
        c.unstretched_zero_m += (c.winding_gain - gain) * drum_m;
        c.winding_gain = gain;
        Ok(())
    }

    /// Switches the gripper's output pin. The workcell decides what the jaws hold.
    pub const fn set_gripper(&mut self, closed: bool) {
        self.gripper_closed = closed;
    }

    /// Whether the gripper is commanded closed.
    #[must_use]
    pub const fn gripper_closed(&self) -> bool {
        self.gripper_closed
    }

    /// Presses or releases the gripper's switch, which reports that the jaws closed on nothing.
    pub(crate) const fn set_gripper_switch(&mut self, pressed: bool) {
        self.gripper_switch = pressed;
    }

    /// Whether the gripper's switch is pressed.
    #[must_use]
    pub const fn gripper_switch(&self) -> bool {
        self.gripper_switch
    }
}
