//! The servo drive of a winch: its states, its modes and the force they produce.
//!
//! Modelled after the RoboModule RMDS: reset, half a second; choice of a mode, half a second; then
//! the mode's commands are executed and all others ignored.

use super::params::WinchParams;

/// Controlled quantity of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Current, with the lag of the current loop.
    Current,
    /// Speed.
    Velocity,
    /// Position with a speed limit (the RMDS's speed-and-position mode).
    Position,
}

/// A command to one drive, as it leaves the board.
///
/// Positive counts, rpm and currents act in one direction: they pay out if the winch's
/// `motor_sign` is +1 and haul in if it is -1. A command of another mode than the chosen one is
/// ignored, as is any but `Reset` before the drive has been reset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DriveCommand {
    /// Torque off, no mode: the drum turns freely but for friction and rotor inertia. The drive
    /// keeps answering and counting; it needs `SelectMode` to act again.
    Off,
    /// Restart: torque off, silence for the reset time, then counts start again from 0.
    Reset,
    /// Choose a mode: torque off for the mode time, then until the first set-point.
    SelectMode(Mode),
    /// Current set-point (mA).
    Current {
        /// Motor current.
        milliamps: i16,
    },
    /// Speed set-point (motor rpm).
    Velocity {
        /// Motor speed.
        rpm: i16,
    },
    /// Position set-point since the last reset.
    Position {
        /// Motor counts.
        counts: i64,
        /// Largest motor speed on the way (rpm); the motor's own limit holds as well.
        rpm_limit: u16,
    },
}

impl DriveCommand {
    /// Set-points replace each other on the bus; the rest is delivered one by one, in order.
    pub(crate) fn is_set_point(self) -> bool {
        matches!(
            self,
            Self::Current { .. } | Self::Velocity { .. } | Self::Position { .. }
        )
    }
}

/// State of a drive between power-on and operation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum DriveState {
    /// No reset since power came on: silent, torque off.
    Unpowered,
    /// Restarting: silent, torque off.
    Resetting,
    /// Answering, no mode, torque off.
    Idle,
    /// Answering, entering a mode, torque off.
    Selecting(Mode),
    /// Executing commands of this mode; torque on from the first of them.
    Ready(Mode),
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum SetPoint {
    None,
    Current(f64),
    Velocity(f64),
    Position { target_m: f64, speed_mps: f64 },
}

/// A drive's constants and state; forces and speeds are at the cable, paying out positive.
#[derive(Debug, Clone)]
pub(crate) struct Drive {
    state: DriveState,
    state_until_s: f64,
    set_point: SetPoint,
    pub current_a: f64,
    zero_counts: f64,
    speed_reference: f64,
    integral_n: f64,
    // Constants.
    force_per_ampere: f64,
    metres_per_count: f64,
    mps_per_rpm: f64,
    max_speed: f64,
    max_current_a: f64,
    quantum_a: f64,
    current_share: f64,
    mass_kg: f64,
    inner_share: f64,
    bandwidth: f64,
    speed_gain: f64,
    integral_gain: f64,
    max_acceleration: f64,
    reset_time_s: f64,
    mode_time_s: f64,
}

impl Drive {
    pub(crate) fn new(p: &WinchParams, step_s: f64) -> Self {
        let sign = f64::from(p.motor_sign);
        let d = &p.drive;
        let tuned_kg = p.effective_mass_kg() + d.tuned_load_kg;
        let mass_kg = p.mass_on_drive_kg();
        // Gain over mass is the speed loop's bandwidth: 4 x 150 = 600 rad/s on the tuned mass.
        let speed_gain = 4.0 * d.position_bandwidth_rad_s * tuned_kg;
        let strongest = p.max_current_a * p.force_per_ampere_n();
        Self {
            state: DriveState::Unpowered,
            state_until_s: 0.0,
            set_point: SetPoint::None,
            current_a: 0.0,
            zero_counts: 0.0,
            speed_reference: 0.0,
            integral_n: 0.0,
            force_per_ampere: sign * p.force_per_ampere_n(),
            metres_per_count: sign * p.metres_per_motor_count(),
            mps_per_rpm: sign * p.mps_per_rpm(),
            max_speed: p.max_speed_mps(),
            max_current_a: p.max_current_a,
            quantum_a: d.current_quantum_a,
            current_share: if d.current_lag_s > 0.0 {
                // Exact for a first-order lag: 3 ms in steps of 0.1 ms give 3.3 % per step.
                -libm::expm1(-step_s / d.current_lag_s)
            } else {
                1.0
            },
            mass_kg,
            inner_share: if d.inner_lag_s > 0.0 {
                -libm::expm1(-step_s / d.inner_lag_s)
            } else {
                1.0
            },
            bandwidth: d.position_bandwidth_rad_s,
            speed_gain,
            // A third of the position bandwidth: removes the sag under load, hardly overshoots.
            integral_gain: speed_gain * d.position_bandwidth_rad_s / 3.0,
            // A profile that the motor cannot follow would only wind up the loop.
            max_acceleration: d.max_acceleration_mps2.min(0.7 * strongest / tuned_kg),
            reset_time_s: d.reset_time_s,
            mode_time_s: d.mode_time_s,
        }
    }

    pub(crate) fn state(&self) -> DriveState {
        self.state
    }

    /// Whether the drive answers on the bus.
    pub(crate) fn answers(&self) -> bool {
        !matches!(self.state, DriveState::Unpowered | DriveState::Resetting)
    }

    /// Power is lost: the state is cleared.
    pub(crate) fn cut_power(&mut self) {
        self.state = DriveState::Unpowered;
        self.set_point = SetPoint::None;
    }

    /// Motor counts since the last reset for a displacement of the motor.
    pub(crate) fn counts(&self, motor_m: f64) -> f64 {
        (motor_m / self.metres_per_count - self.zero_counts).floor()
    }

    pub(crate) fn rpm(&self, motor_rate: f64) -> f64 {
        motor_rate / self.mps_per_rpm
    }

    /// Advances the state's timer; `late_s` is a fault that lengthens both waits.
    #[inline(always)]
    pub(crate) fn tick(&mut self, now_s: f64, motor_m: f64, late_s: f64) {
        match self.state {
            DriveState::Resetting if now_s >= self.state_until_s + late_s => {
                self.state = DriveState::Idle;
                // Counts start where the motor stands now: an incremental encoder has no other
                // zero.
                self.zero_counts = motor_m / self.metres_per_count;
            }
            DriveState::Selecting(mode) if now_s >= self.state_until_s + late_s => {
                self.state = DriveState::Ready(mode);
            }
            _ => {}
        }
    }

    /// Takes a command.
    pub(crate) fn receive(&mut self, command: DriveCommand, now_s: f64, motor_rate: f64) {
        // Before all other checks: a reset is the only command that a silent drive obeys.
        if command == DriveCommand::Reset {
            self.state = DriveState::Resetting;
            self.state_until_s = now_s + self.reset_time_s;
            self.set_point = SetPoint::None;
            return;
        }
        if !self.answers() {
            return;
        }
        match (command, self.state) {
            (DriveCommand::Off, _) => {
                self.state = DriveState::Idle;
                self.set_point = SetPoint::None;
            }
            // The mode is already active: nothing changes, including the set-point.
            (
                DriveCommand::SelectMode(mode),
                DriveState::Ready(now) | DriveState::Selecting(now),
            ) if mode == now => {}
            (DriveCommand::SelectMode(mode), _) => {
                self.state = DriveState::Selecting(mode);
                self.state_until_s = now_s + self.mode_time_s;
                self.set_point = SetPoint::None;
            }
            (DriveCommand::Current { milliamps }, DriveState::Ready(Mode::Current)) => {
                let asked = f64::from(milliamps) * 1e-3;
                let stepped = if self.quantum_a > 0.0 {
                    (asked / self.quantum_a).round() * self.quantum_a
                } else {
                    asked
                };
                self.set_point =
                    SetPoint::Current(stepped.clamp(-self.max_current_a, self.max_current_a));
            }
            (DriveCommand::Velocity { rpm }, DriveState::Ready(Mode::Velocity)) => {
                self.start_loops(motor_rate);
                let speed = f64::from(rpm) * self.mps_per_rpm;
                self.set_point = SetPoint::Velocity(speed.clamp(-self.max_speed, self.max_speed));
            }
            (DriveCommand::Position { counts, rpm_limit }, DriveState::Ready(Mode::Position)) => {
                self.start_loops(motor_rate);
                // A count is 0.1 um at most; no cable reaches 2^53 counts.
                #[allow(clippy::cast_precision_loss)]
                let counts = counts as f64;
                self.set_point = SetPoint::Position {
                    target_m: (counts + self.zero_counts) * self.metres_per_count,
                    speed_mps: (f64::from(rpm_limit) * self.mps_per_rpm.abs()).min(self.max_speed),
                };
            }
            _ => {}
        }
    }

    /// Bumpless start: the loops take over at the motor's present speed.
    fn start_loops(&mut self, motor_rate: f64) {
        if self.set_point == SetPoint::None {
            self.speed_reference = motor_rate;
            self.integral_n = 0.0;
        }
    }

    /// Force of the motor at the cable over the next step of `h` seconds, given the motor's state
    /// and what pulls on it.
    #[inline(always)]
    pub(crate) fn force(&mut self, motor_m: f64, motor_rate: f64, pull_n: f64, h: f64) -> f64 {
        let goal = match self.set_point {
            SetPoint::None => {
                // Torque off: the current decays with its own lag and is then exactly zero.
                if self.current_a != 0.0 {
                    self.lag_toward(0.0);
                }
                return self.current_a * self.force_per_ampere;
            }
            SetPoint::Current(asked) => {
                self.lag_toward(asked);
                let force = self.current_a * self.force_per_ampere;
                return force * self.headroom(motor_rate, force);
            }
            SetPoint::Velocity(speed) => speed,
            SetPoint::Position {
                target_m,
                speed_mps,
            } => {
                let error = target_m - motor_m;
                // Proportional near the target, and never faster than it can stop.
                let speed = (self.bandwidth * error.abs())
                    .min((2.0 * self.max_acceleration * error.abs()).sqrt())
                    .min(speed_mps);
                speed.copysign(error)
            }
        };
        let change = self.max_acceleration * h;
        self.speed_reference += (goal - self.speed_reference).clamp(-change, change);
        // The speed loop is far faster than the step for a light drum: solve it implicitly.
        let hm = h / self.mass_kg;
        let drive = self.speed_gain * self.speed_reference + self.integral_n;
        // Implicit Euler of m dv/dt = pull + gain (reference - v) + integral.
        let speed_after = (motor_rate + hm * (pull_n + drive)) / (1.0 + hm * self.speed_gain);
        let error = self.speed_reference - speed_after;
        let wanted = self.speed_gain * error + self.integral_n;
        let strongest = self.max_current_a * self.force_per_ampere.abs();
        let force = wanted.clamp(-strongest, strongest);
        // At the current limit the integral waits, or it would wind up and overshoot.
        if force == wanted {
            // The integral uses the measured speed: the forecast above does not include friction.
            let missing = self.speed_reference - motor_rate;
            self.integral_n =
                (self.integral_n + self.integral_gain * missing * h).clamp(-strongest, strongest);
        }
        let wanted_a = force * self.headroom(motor_rate, force) / self.force_per_ampere;
        self.current_a += (wanted_a - self.current_a) * self.inner_share;
        self.current_a * self.force_per_ampere
    }

    #[inline(always)]
    fn lag_toward(&mut self, asked: f64) {
        self.current_a += (asked - self.current_a) * self.current_share;
        // An exponential never reaches zero: below 1 nA the decay ends.
        if self.current_a.abs() < 1e-9 && asked == 0.0 {
            self.current_a = 0.0;
        }
    }

    /// Share of the torque that the motor's back-EMF leaves at this speed: all up to the speed
    /// limit, none from 5 % above it, for torque along the motion.
    #[inline(always)]
    fn headroom(&self, motor_rate: f64, force: f64) -> f64 {
        if motor_rate * force <= 0.0 || motor_rate.abs() <= self.max_speed {
            return 1.0;
        }
        (1.0 - (motor_rate.abs() / self.max_speed - 1.0) / 0.05).max(0.0)
    }
}
