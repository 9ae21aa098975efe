//! The robot's mathematics for commands and programs: the kinematics crate's solvers with the robot
//! file's tool, set-points and limits, and with errors in the robot's terms.

mod error;
mod planned;

pub use error::ComputeError;
pub use planned::{Hanging, Judged, Planned};

use crate::machine;
use crate::robot::{Control, Robot};
use mcdpr_kinematics::{
    AnyGoal, AnyRobot, Balance, CableSet, CableVec, Equilibrium, EquilibriumGuess, Error, Forward,
    ForwardOptions, Held, MAX_CABLES, Pose, Solver, Stability, Start, StaticOptions,
    rotation_from_rpy,
};
use nalgebra::{Vector3, Vector6};

/// A robot and its geometry.
#[derive(Debug, Clone)]
pub struct Subject {
    /// The robot.
    pub robot: Robot,
    /// Its geometry.
    pub geometry: AnyRobot,
    /// Whether all anchors and attachments lie in one vertical plane.
    pub planar: bool,
}

impl Subject {
    /// Prepares a robot.
    ///
    /// # Errors
    /// What the geometry check finds; see [`AnyRobot::new`].
    pub fn new(robot: Robot) -> Result<Self, ComputeError> {
        let geometry = machine::geometry(&robot)?;
        let planar =
            mcdpr_core::holding::vertical_plane(&geometry).is_some() || geometry.cable_count() == 1;
        Ok(Self {
            robot,
            geometry,
            planar,
        })
    }

    /// Number of cables.
    #[must_use]
    pub fn count(&self) -> usize {
        self.geometry.cable_count()
    }

    /// An error of the solver, with its explanation for a planar robot.
    #[must_use]
    pub fn refused(&self, refusal: Error) -> ComputeError {
        match refusal {
            Error::Singular { .. }
            | Error::TooFewCables { .. }
            | Error::NotConverged { .. }
            | Error::WrenchNotBalanced { .. }
            | Error::Unbounded { .. }
                if self.planar =>
            {
                ComputeError::Planar { refusal }
            }
            _ => refusal.into(),
        }
    }

    /// The error for a number of length-held cables that the statics do not support.
    #[must_use]
    pub fn length_held(&self, held: usize) -> ComputeError {
        let count = self.count();
        if self.planar {
            return self.refused(Error::TooFewCables {
                solver: Solver::Equilibrium,
                needed: 3,
                got: held,
            });
        }
        ComputeError::LengthHeld {
            held,
            count,
            named: match count.checked_sub(3) {
                Some(1) => "1 tension-held cable".to_owned(),
                Some(more) => format!("{more} tension-held cables"),
                None => "none: this robot has too few cables".to_owned(),
            },
        }
    }

    /// The tool centre point, or the platform's origin.
    #[must_use]
    pub fn point(&self, tool: bool) -> Vector3<f64> {
        if tool {
            self.robot.tool.tcp_in_platform_m
        } else {
            Vector3::zeros()
        }
    }

    /// The robot file's own tension-held cables at their set-point, N; `None` for the others. Where six
    /// lengths hold the pose the tensions are distributed: then every entry is `None`.
    #[must_use]
    pub fn own_tensions(&self) -> CableVec<Option<f64>> {
        let cables = self.robot.cables.iter();
        // Six lengths leave no freedom: their tensions are distributed, not set.
        if cables.filter(|c| c.control == Control::Position).count() >= 6 {
            return CableVec::from_fn(self.count(), |_| None);
        }
        CableVec::from_fn(self.count(), |i| {
            let cable = self.robot.cables.get(i)?;
            (cable.control == Control::Tension).then_some(self.robot.tension.setpoint_n)
        })
    }
}

/// Angles that a geometric forward solver treats as unknown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Free {
    /// Yaw, for a given roll and pitch; four cables and more
    Yaw,
    /// The whole attitude; six cables and more
    All,
}

impl Subject {
    /// Pose of the platform, from cable lengths (m) alone.
    ///
    /// Without `free` the attitude (rad, R = Rz Ry Rx) is the given one, or level; robots of six and
    /// more cables find the attitude unless one is given.
    ///
    /// # Errors
    /// [`ComputeError`]; see [`AnyRobot::position`] and its like.
    pub fn forward(
        &self,
        lengths_m: &[f64],
        attitude_rad: Option<[f64; 3]>,
        free: Option<Free>,
        options: &ForwardOptions,
    ) -> Result<(Forward, Option<Free>), ComputeError> {
        let count = self.count();
        if lengths_m.len() != count {
            return Err(ComputeError::Count {
                what: "lengths (one per cable, cable 1 first)",
                expected: count.to_string(),
                got: lengths_m.len(),
            });
        }
        // Six cables and more determine the pose, unless the attitude is known.
        let free = match (free, attitude_rad) {
            (None, None) if count >= 6 => Some(Free::All),
            (free, _) => free,
        };
        let rotation = rotation_from_rpy(attitude_rad.unwrap_or([0.0; 3]));
        let start = Pose::new(Vector3::zeros(), rotation);
        let geometry = &self.geometry;
        let found = match free {
            None => geometry.position(lengths_m, &rotation, None, options),
            Some(Free::Yaw) => geometry.position_and_yaw(lengths_m, &start, false, options),
            Some(Free::All) if count < 6 => return Err(ComputeError::TooFewForAll { count }),
            Some(Free::All) => geometry.pose(lengths_m, &start, false, options),
        };
        Ok((found.map_err(|error| self.refused(error))?, free))
    }

    /// The pose at rest. `lengths_m` (m) has one entry per cable, or one per length-held cable;
    /// `tensions_n` (N) one per cable, `None` for the length-held ones.
    ///
    /// # Errors
    /// [`ComputeError`]; see [`AnyRobot::geometrico_static`].
    pub fn rest(
        &self,
        lengths_m: &[Option<f64>],
        tensions_n: &[Option<f64>],
    ) -> Result<(Equilibrium, Stability), ComputeError> {
        let count = self.count();
        let by_length = tensions_n.iter().filter(|t| t.is_none()).count();
        if lengths_m.len() != count && lengths_m.len() != by_length {
            let expected = if by_length == count {
                format!(
                    "{count} (fewer where --tension or \"tensions_n\" names tension-held cables)"
                )
            } else {
                format!("{by_length}, or {count} with gaps")
            };
            return Err(ComputeError::Count {
                what: "lengths",
                expected,
                got: lengths_m.len(),
            });
        }
        let has_gaps = lengths_m.len() == count;
        let mut lengths = lengths_m.iter().copied();
        let mut held = [Held::Tension(0.0); MAX_CABLES];
        for (index, (slot, tension)) in held.iter_mut().zip(tensions_n).enumerate() {
            let cable = index + 1;
            let length = if has_gaps || tension.is_none() {
                lengths.next().flatten()
            } else {
                None
            };
            *slot = match (length, tension) {
                (None, Some(tension)) => Held::Tension(*tension),
                (Some(length), None) => Held::Length(length),
                (Some(_), Some(_)) => return Err(ComputeError::BothHeld { cable }),
                (None, None) => return Err(ComputeError::NeitherHeld { cable }),
            };
        }
        let held = held.get(..count).unwrap_or_default();
        let refused = |error| self.refused(error);
        let found = self
            .geometry
            .geometrico_static(held, Start::Cold, &StaticOptions::default())
            .map_err(refused)?;
        let stability = self.stability(&found).map_err(refused)?;
        Ok((found, stability))
    }

    /// Equilibrium with the platform's origin, or its `tool`, at a position (world, m).
    /// `tensions_n` (N) has one entry per cable, `None` for the length-held ones. With three of
    /// those the attitude follows; with six and more it is `attitude_rad`, or level.
    ///
    /// # Errors
    /// [`ComputeError`]; see [`AnyRobot::equilibrium_at`] and [`AnyRobot::distribute`].
    pub fn hang(
        &self,
        place_m: &Vector3<f64>,
        tool: bool,
        tensions_n: &[Option<f64>],
        attitude_rad: Option<[f64; 3]>,
    ) -> Result<(Equilibrium, Stability), ComputeError> {
        let held = tensions_n.iter().filter(|t| t.is_none()).count();
        let point = self.point(tool);
        let found = match held {
            3 if attitude_rad.is_some() => return Err(ComputeError::AttitudeFollows),
            3 => self.geometry.equilibrium_at(
                &point,
                place_m,
                tensions_n,
                EquilibriumGuess::Cold,
                &StaticOptions::default(),
            ),
            6.. => {
                let rotation = rotation_from_rpy(attitude_rad.unwrap_or([0.0; 3]));
                let pose = Pose::new(place_m - rotation * point, rotation);
                self.distributed(&pose, tensions_n)
            }
            _ => return Err(self.length_held(held)),
        };
        let refused = |error| self.refused(error);
        let found = found.map_err(refused)?;
        let stability = self.stability(&found).map_err(refused)?;
        Ok((found, stability))
    }

    /// Stiffness and modes of a platform at rest. Length-held cables stretch by their EA in the modes,
    /// which are the slowest ones, as many as inextensible cables would leave: at 30 N the stretch makes
    /// them up to 3 % slower than rigid cables would.
    fn stability(&self, found: &Equilibrium) -> Result<Stability, Error> {
        let mut stability = self.geometry.stability(found)?;
        let mut elastic = *found;
        for (index, axial) in elastic.axial_stiffness_n_per_m.iter_mut().enumerate() {
            if !found.tension_held.contains(index) {
                *axial = self.axial_n_per_m(index, &found.lengths_m, &found.tensions_n);
            }
        }
        let modes_hz = self.geometry.stability(&elastic)?.modes_hz;
        let known = stability.modes_hz.len().min(modes_hz.len());
        stability.modes_hz = CableVec::from_fn(known, |k| modes_hz[k]);
        Ok(stability)
    }

    /// Axial stiffness of a taut cable with its routing, N/m: EA over the unstretched length.
    fn axial_n_per_m(&self, index: usize, lengths_m: &[f64], tensions_n: &[f64]) -> f64 {
        let taut = lengths_m.get(index).zip(tensions_n.get(index));
        let of = self.robot.cables.get(index).zip(taut);
        of.map_or(0.0, |(cable, (length_m, tension_n))| {
            // Unstretched l0 = l / (1 + T / EA), so that EA / l0 = (EA + T) / l.
            (cable.ea_n + tension_n) / (length_m + cable.routing_length_m)
        })
    }

    /// Tensions for a chosen pose: within the robot's limits, nearest to their middle, those of
    /// `tensions_n` as given. Without any given, the robot file says which cables are held by tension:
    /// these keep the tension that they get here, whatever the platform does, and add no axial stiffness.
    /// The others are elastic; otherwise there would be no vibration.
    fn distributed(&self, pose: &Pose, tensions_n: &[Option<f64>]) -> Result<Equilibrium, Error> {
        let limits = &self.robot.limits;
        let given = |i: usize| tensions_n.get(i).copied().flatten();
        let bound = |limit: f64| CableVec::from_fn(tensions_n.len(), |i| given(i).unwrap_or(limit));
        let tensions = self.geometry.distribute(
            pose,
            &Vector6::zeros(),
            Balance::Wrench,
            &bound(limits.tension_min_n),
            &bound(limits.tension_max_n),
            AnyGoal::Middle,
        )?;
        let lengths_m = self.geometry.lengths_m(pose)?;
        let chosen = tensions_n.iter().any(Option::is_some);
        let by_tension = |i: usize| match self.robot.cables.get(i) {
            Some(cable) if !chosen => cable.control == Control::Tension,
            _ => given(i).is_some(),
        };
        let mut tension_held = CableSet::default();
        for index in (0..tensions_n.len()).filter(|&i| by_tension(i)) {
            tension_held.insert(index);
        }
        Ok(Equilibrium {
            pose: *pose,
            tensions_n: tensions,
            lengths_m,
            slack: CableSet::default(),
            tension_held,
            axial_stiffness_n_per_m: CableVec::from_fn(tensions_n.len(), |i| {
                if by_tension(i) {
                    0.0
                } else {
                    self.axial_n_per_m(i, &lengths_m, &tensions)
                }
            }),
            residual_n: 0.0,
            residual_m: 0.0,
            iterations: 0,
            stable: false,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Energy of elastic length-held cables, tension-held cables and the weight, J, with the platform
    /// moved from a pose at rest. It needs lengths alone, and shares nothing with the Hessian.
    fn energy_j(subject: &Subject, rest: &Equilibrium, by_m: Vector3<f64>) -> f64 {
        let pose = Pose::new(rest.pose.position_m + by_m, rest.pose.rotation);
        let lengths_m = subject.geometry.lengths_m(&pose).unwrap();
        let weight_n = subject.robot.platform.mass_kg * mcdpr_kinematics::GRAVITY_MPS2;
        let mut energy_j = weight_n * by_m.z;
        for (index, cable) in subject.robot.cables.iter().enumerate() {
            let longer_m = lengths_m[index] - rest.lengths_m[index];
            energy_j += rest.tensions_n[index] * longer_m;
            if cable.control == Control::Position {
                let strain = rest.tensions_n[index] / cable.ea_n;
                let taut_m = rest.lengths_m[index] + cable.routing_length_m;
                energy_j += 0.5 * cable.ea_n * (1.0 + strain) / taut_m * longer_m * longer_m;
            }
        }
        energy_j
    }

    #[test]
    fn the_stiffness_of_eight_cables_is_that_of_six_lengths_and_two_tensions() {
        let subject = Subject::new(Robot::built_in("eight-cable").unwrap()).unwrap();
        let own = subject.own_tensions();
        for place in [[0.0, 0.0, 0.85], [0.2, -0.15, 0.7], [-0.3, 0.1, 0.95]] {
            let (rest, stability) = subject.hang(&place.into(), false, &own, None).unwrap();
            let step_m = 1e-4;
            for i in 0..3 {
                for j in 0..3 {
                    let at = |a: f64, b: f64| {
                        let mut by_m = Vector3::zeros();
                        by_m[i] += a * step_m;
                        by_m[j] += b * step_m;
                        energy_j(&subject, &rest, by_m)
                    };
                    let found = (at(1.0, 1.0) - at(1.0, -1.0) - at(-1.0, 1.0) + at(-1.0, -1.0))
                        / (4.0 * step_m * step_m);
                    let stated = stability.stiffness[(i, j)];
                    assert!(
                        (found - stated).abs() < 0.01,
                        "{place:?} {i}{j}: {found} {stated}"
                    );
                }
            }
        }
    }

    #[test]
    fn stiff_cables_swing_as_rigid_ones_and_soft_ones_more_slowly() {
        let mut robot = Robot::built_in("paper-optimistic").unwrap();
        let place = robot.tool.home_in_world_m;
        let swings = |robot: &Robot| {
            let subject = Subject::new(robot.clone()).unwrap();
            let own = subject.own_tensions();
            let (rest, stability) = subject.hang(&place, true, &own, None).unwrap();
            let rigid = subject.geometry.stability(&rest).unwrap();
            assert_eq!(stability.modes_hz.len(), 3);
            let ratio = |k: usize| stability.modes_hz[k] / rigid.modes_hz[k];
            [ratio(0), ratio(1), ratio(2)]
        };
        let soft = swings(&robot);
        for cable in &mut robot.cables {
            cable.ea_n *= 1e4;
        }
        let stiff = swings(&robot);
        for (soft, stiff) in soft.into_iter().zip(stiff) {
            assert!((0.97..0.9999).contains(&soft), "{soft}");
            assert!((stiff - 1.0).abs() < 1e-5, "{stiff}");
        }
    }
}
