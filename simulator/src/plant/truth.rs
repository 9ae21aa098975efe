//! The true state, for reports and tests; a board cannot see it.

use super::Plant;
use super::cable::Tension;
use super::error::PlantError;
use super::params::MAX_CABLES;
use super::platform::Pose;
use super::vec3::{add, cross, dot, mul, q_matrix};

/// The plant's exact state at one instant. Entries beyond the robot's cables are 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Simulated time since the robot was placed (s).
    pub time_s: f64,
    /// The platform's frame in the world.
    pub pose: Pose,
    /// Tool point, world frame (m).
    pub tool_position_m: [f64; 3],
    /// Velocity of the platform frame's origin, world frame (m/s).
    pub velocity_mps: [f64; 3],
    /// Angular velocity, world frame (rad/s).
    pub angular_velocity_rad_s: [f64; 3],
    /// Length of each cable's path from its entry point `B` to the attachment, arc included (m).
    pub cable_lengths_m: [f64; MAX_CABLES],
    /// Unstretched cable from the entry point to the attachment (m): all cable off the drum, less
    /// the routing's nominal length.
    pub unstretched_lengths_m: [f64; MAX_CABLES],
    /// Tension between pulley and platform (N).
    pub tensions_platform_n: [f64; MAX_CABLES],
    /// Tension between winch and pulley (N), as the sensor measures it.
    pub tensions_winch_n: [f64; MAX_CABLES],
    /// Cable paid out by each drum since the robot was placed (m).
    pub drum_positions_m: [f64; MAX_CABLES],
    /// Pay-out speed of each drum (m/s).
    pub drum_speeds_mps: [f64; MAX_CABLES],
    /// Motor displacements, as cable at the drum (m); the drums' own without a gear between.
    pub motor_positions_m: [f64; MAX_CABLES],
    /// Motor current of each winch (A).
    pub motor_currents_a: [f64; MAX_CABLES],
    /// Whether each brake is engaged.
    pub brakes_closed: [bool; MAX_CABLES],
    /// Kinetic energy of platform, drums and rotors, potential energy, elastic energy of the
    /// cables (J), less the potential of the constant external force. Height zero is the world's.
    pub energy_j: f64,
}

impl Plant {
    /// The exact state now.
    ///
    /// # Errors
    /// The error that stopped [`Plant::advance`], if one has: the state is then invalid.
    pub fn truth(&self) -> Result<Truth, PlantError> {
        if let Some(error) = &self.failed {
            return Err(error.clone());
        }
        let motion = &self.motion;
        let rotation = q_matrix(motion.attitude);
        let spin = motion.spin(&self.body);
        let pose = motion.pose(&self.body);
        let (velocity_mps, angular_velocity_rad_s) = motion.twist(&self.body);
        let load_point = add(motion.center_m, mul(&rotation, self.load.point));
        let mut truth = Truth {
            time_s: self.time_s(),
            pose,
            tool_position_m: pose.point_in_world(self.params.platform.tcp_m),
            velocity_mps,
            angular_velocity_rad_s,
            cable_lengths_m: [0.0; MAX_CABLES],
            unstretched_lengths_m: [0.0; MAX_CABLES],
            tensions_platform_n: [0.0; MAX_CABLES],
            tensions_winch_n: [0.0; MAX_CABLES],
            drum_positions_m: [0.0; MAX_CABLES],
            drum_speeds_mps: [0.0; MAX_CABLES],
            motor_positions_m: [0.0; MAX_CABLES],
            motor_currents_a: [0.0; MAX_CABLES],
            brakes_closed: [false; MAX_CABLES],
            energy_j: motion.kinetic_energy(&self.body)
                - dot(self.weight_n, motion.center_m)
                - dot(self.load.force_n, load_point),
        };
        for (i, (cable, winch)) in self.cables.iter().zip(&self.winches).enumerate() {
            let path = cable.path(add(motion.center_m, mul(&rotation, cable.attachment)), i)?;
            let velocity = add(
                motion.velocity,
                mul(&rotation, cross(spin, cable.attachment)),
            );
            let rate = dot(path.direction, velocity);
            let off_drum = winch.paid_out();
            // An external engine's tensions do not follow from this plant's own geometry.
            let tension: Tension = match self.outside_tension(i) {
                Some(_) => cable.tension,
                None => cable.tension(path.length_m, rate, off_drum.length_m, off_drum.rate_mps),
            };
            truth.cable_lengths_m[i] = path.length_m;
            truth.unstretched_lengths_m[i] =
                cable.unstretched_m(off_drum.length_m) - self.params.cables[i].routing_length_m;
            truth.tensions_platform_n[i] = tension.platform_n;
            truth.tensions_winch_n[i] = tension.winch_n;
            truth.drum_positions_m[i] = winch.drum_m;
            truth.drum_speeds_mps[i] = winch.drum_rate;
            truth.motor_positions_m[i] = winch.motor_m();
            truth.motor_currents_a[i] = winch.drive.current_a;
            truth.brakes_closed[i] = winch.brake.engaged;
            truth.energy_j += cable.energy(&tension, off_drum.length_m) + winch.energy_j();
        }
        Ok(truth)
    }
}
