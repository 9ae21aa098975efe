//! The robot's mathematics for commands and programs: the kinematics crate's solvers with the robot
//! file's tool, set-points and limits, and with errors in the robot's terms.

mod error;

pub use error::ComputeError;

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
        let stability = self.geometry.stability(&found).map_err(refused)?;
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
        let stability = self.geometry.stability(&found).map_err(refused)?;
        Ok((found, stability))
    }

    /// Tensions for a chosen pose: within the robot's limits, nearest to their middle, those of
    /// `tensions_n` as given. The cables are elastic; otherwise there would be no vibration.
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
        let mut tension_held = CableSet::default();
        for index in (0..tensions_n.len()).filter(|&i| given(i).is_some()) {
            tension_held.insert(index);
        }
        let axial = |i: usize| {
            let cable = self.robot.cables.get(i)?;
            let length_m = lengths_m.get(i)? + cable.routing_length_m;
            given(i).is_none().then(|| cable.ea_n / length_m)
        };
        Ok(Equilibrium {
            pose: *pose,
            tensions_n: tensions,
            lengths_m,
            slack: CableSet::default(),
            tension_held,
            axial_stiffness_n_per_m: CableVec::from_fn(tensions_n.len(), |i| {
                axial(i).unwrap_or(0.0)
            }),
            residual_n: 0.0,
            residual_m: 0.0,
            iterations: 0,
            stable: false,
        })
    }
}
