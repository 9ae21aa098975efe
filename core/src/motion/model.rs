//! The planner's model of the robot: tool position to cable lengths and tensions.

use super::bent::Plane;
use super::drift::Drift;
use super::options::{PlanOptions, Planner, Tensioning};
use super::plan::PlanError;
use super::schedule;
use crate::holding::{Freedom, Holding};
use crate::machine;
use crate::robot::{Control, Limits, Robot};
use mcdpr_kinematics::{AnyRobot, Equilibrium, EquilibriumGuess, Held, Pose, Start, StaticOptions};
use nalgebra::{Rotation3, Vector3};

/// Below this measured tension a cable gives no information about the platform's pose, N.
pub(super) const TAUT_N: f64 = 0.5;

/// A robot with its geometry.
#[derive(Debug, Clone)]
pub struct Model {
    robot: Robot,
    geometry: AnyRobot,
    holding: Holding,
    /// The plane in which it moves, if its cables are in one.
    plane: Option<Plane>,
    options: PlanOptions,
    /// One per cable; none without entries.
    pub(super) drift: Vec<Drift>,
    /// Whether plans let the board watch for contact (C5).
    contact: bool,
}

/// The robot at rest with its tool at one position.
#[derive(Debug, Clone)]
pub struct StaticState {
    /// Pose, taut lengths and tensions.
    pub equilibrium: Equilibrium,
    /// Paid-out length of each cable, m: what the drum encoders show.
    pub paid_out_m: Vec<f64>,
}

impl StaticState {
    /// Tension of each cable, N.
    #[must_use]
    pub fn tensions_n(&self) -> &[f64] {
        &self.equilibrium.tensions_n
    }
}

impl Model {
    /// Prepares a robot for planning.
    ///
    /// # Errors
    /// [`PlanError::Geometry`] if the geometry is invalid; [`PlanError::Holding`] if the cables held by
    /// length do not hold the platform, or are more than it takes; [`PlanError::Cables`] if there are
    /// more than a board drives.
    pub fn new(robot: &Robot) -> Result<Self, PlanError> {
        let cables = robot.cables.len();
        if cables > mcdpr_protocol::MAX_CABLES {
            return Err(PlanError::Cables { cables });
        }
        let geometry = machine::geometry(robot)?;
        let by_length: Vec<bool> = robot
            .cables
            .iter()
            .map(|cable| cable.control == Control::Position)
            .collect();
        let home = robot.tool.home_in_world_m - robot.tool.tcp_in_platform_m;
        let calibrated = robot.calibrated.as_deref();
        let designed = calibrated.map(|known| machine::geometry(&known.designed));
        let designed = designed.transpose()?;
        let meant = designed.as_ref().unwrap_or(&geometry);
        let holding = Holding::as_designed(&geometry, meant, &by_length, &Pose::level(home))?;
        let anchor_m = meant
            .cables()
            .first()
            .map_or(Vector3::zeros(), |c| c.anchor_m);
        let plane = Plane::of(&holding.freedom(), &anchor_m, calibrated.is_some());
        Ok(Self {
            robot: robot.clone(),
            geometry,
            holding,
            plane,
            options: PlanOptions::default(),
            drift: Vec::new(),
            contact: true,
        })
    }

    /// The robot.
    #[must_use]
    pub const fn robot(&self) -> &Robot {
        &self.robot
    }

    /// Its geometry.
    #[must_use]
    pub const fn geometry(&self) -> &AnyRobot {
        &self.geometry
    }

    /// Which cables are held by length, which by tension.
    #[must_use]
    pub const fn holding(&self) -> &Holding {
        &self.holding
    }

    pub(crate) const fn plane(&self) -> Option<&Plane> {
        self.plane.as_ref()
    }

    /// The first tension-held cable of a platform that hangs on three lengths, from 0; `what` needs it.
    ///
    /// # Errors
    /// [`PlanError::Hanging`] for any other robot.
    pub fn hanging(&self, what: &'static str) -> Result<usize, PlanError> {
        let held = self.holding.first_by_tension();
        held.filter(|_| self.holding.hangs())
            .ok_or_else(|| PlanError::Hanging {
                what,
                robot: self.robot.name.clone(),
            })
    }

    /// Refuses a robot that neither hangs on three lengths and a tension nor has lengths that hold its whole pose;
    /// `what` needs one of them.
    ///
    /// # Errors
    /// [`PlanError::Placed`].
    pub fn placed(&self, what: &'static str) -> Result<(), PlanError> {
        let hangs = self.holding.hangs() && self.holding.first_by_tension().is_some();
        if hangs || self.holding.freedom() == Freedom::Pose {
            return Ok(());
        }
        Err(PlanError::Placed {
            what,
            robot: self.robot.name.clone(),
        })
    }

    /// Refuses a robot whose platform a camera on it cannot find at rest in an attitude that statics determine; `what`
    /// needs that. A load on one point turns about it: nothing but friction brings its yaw to rest.
    ///
    /// # Errors
    /// [`PlanError::Turning`] for a load on one point, else as [`Model::placed`].
    pub fn comes_to_rest(&self, what: &'static str) -> Result<(), PlanError> {
        match self.holding.freedom() {
            Freedom::Plane { .. } => Ok(()),
            Freedom::Point | Freedom::PlanePoint { .. } => Err(PlanError::Turning {
                what,
                robot: self.robot.name.clone(),
            }),
            Freedom::Hanging | Freedom::Pose => self.placed(what),
        }
    }

    /// Refuses a robot that cannot go to places on either side of a vertical plane; `what` needs that.
    ///
    /// # Errors
    /// [`PlanError::InPlane`] for a platform in a plane, else as [`Model::placed`].
    pub fn moves_in_space(&self, what: &'static str) -> Result<(), PlanError> {
        match self.holding.freedom() {
            Freedom::Plane { .. } => Err(PlanError::InPlane {
                what,
                robot: self.robot.name.clone(),
            }),
            _ => self.placed(what),
        }
    }

    /// The same robot with other planning options.
    #[must_use]
    pub fn with_options(mut self, options: PlanOptions) -> Self {
        self.options = options;
        self
    }

    /// The same robot, with plans that do not let the board watch for contact (C5): a load is about to be dropped.
    #[must_use]
    pub const fn without_contact(mut self) -> Self {
        self.contact = false;
        self
    }

    /// The same robot whose rotors and gears rub so many times as much, cable by cable; a missing value is 1.
    #[must_use]
    pub(crate) fn with_friction(mut self, shares: &[f64]) -> Self {
        for (cable, share) in self.robot.cables.iter().zip(shares) {
            let winch = self.robot.winches.get_mut(cable.winch_index);
            if let Some(gear) = winch.and_then(|winch| winch.gear.as_mut()) {
                gear.rotor_friction_nm *= share;
                gear.gear_friction_nm *= share;
            }
        }
        self
    }

    pub(super) const fn watches_contact(&self) -> bool {
        self.contact
    }

    /// The same robot with other limits of a motion.
    #[must_use]
    pub fn with_limits(mut self, change: impl FnOnce(&mut Limits)) -> Self {
        change(&mut self.robot.limits);
        self
    }

    /// How plans are made.
    #[must_use]
    pub const fn options(&self) -> PlanOptions {
        self.options
    }

    /// How the robot hangs with its tool at the robot file's home.
    ///
    /// # Errors
    /// If the robot cannot hang at home.
    pub fn rest_at_home(&self) -> Result<StaticState, PlanError> {
        self.rest(&self.robot.tool.home_in_world_m, None)
    }

    /// How the robot hangs with its tool at `tool_m` (world, m) and its tension-held cables at
    /// the tension that the options ask for; `near` is a state close by.
    ///
    /// # Errors
    /// [`PlanError::NoEquilibrium`] with the reason.
    pub fn rest(
        &self,
        tool_m: &Vector3<f64>,
        near: Option<&StaticState>,
    ) -> Result<StaticState, PlanError> {
        if !self.holding.hangs() {
            let attitude =
                near.map_or_else(Rotation3::identity, |rest| rest.equilibrium.pose.rotation);
            return self.rest_turned(tool_m, &attitude);
        }
        let tension_n = match self.options.tensioning {
            Tensioning::MaxMin => schedule::best_n(self, tool_m, near)?,
            Tensioning::Setpoint => self.robot.tension.setpoint_n,
        };
        self.rest_with(tool_m, tension_n, near)
    }

    /// How the robot hangs with its tool at `tool_m` (world, m) and its tension-held cables at
    /// `tension_n`; `near` is a state close by.
    ///
    /// # Errors
    /// [`PlanError::NoEquilibrium`] with the reason.
    pub(crate) fn rest_with(
        &self,
        tool_m: &Vector3<f64>,
        tension_n: f64,
        near: Option<&StaticState>,
    ) -> Result<StaticState, PlanError> {
        if !self.holding.hangs() {
            return self.rest(tool_m, near);
        }
        let mut tensions = [None; mcdpr_kinematics::MAX_CABLES];
        let count = self.robot.cables.len();
        for (slot, cable) in tensions.iter_mut().zip(&self.robot.cables) {
            *slot = (cable.control == Control::Tension).then_some(tension_n);
        }
        // A level platform is not in equilibrium in general.
        let near = near.filter(|_| self.options.planner == Planner::Equilibrium);
        let guess = near.map_or(EquilibriumGuess::Cold, |rest| {
            EquilibriumGuess::Attitude(rest.equilibrium.pose.rotation)
        });
        let equilibrium = self
            .geometry
            .equilibrium_at(
                &self.robot.tool.tcp_in_platform_m,
                tool_m,
                tensions.get(..count).unwrap_or_default(),
                guess,
                &StaticOptions::default(),
            )
            .map_err(|source| PlanError::NoEquilibrium {
                x_mm: tool_m.x * 1e3,
                y_mm: tool_m.y * 1e3,
                z_mm: tool_m.z * 1e3,
                source,
            })?;
        Ok(self.with_lengths(equilibrium))
    }

    /// The state that a plan commands: at equilibrium, or with the lengths of a level platform.
    pub(super) fn rest_planned(
        &self,
        tool_m: &Vector3<f64>,
        tension_n: f64,
        near: Option<&StaticState>,
    ) -> Result<StaticState, PlanError> {
        let hanging = self.rest_with(tool_m, tension_n, near)?;
        match self.options.planner {
            Planner::Equilibrium => Ok(hanging),
            Planner::Level => self.level(tool_m, hanging),
        }
    }

    /// The lengths of a level platform (Eqs. 2 to 11), rigid cables; tensions as it really hangs.
    fn level(
        &self,
        tool_m: &Vector3<f64>,
        mut hanging: StaticState,
    ) -> Result<StaticState, PlanError> {
        let tool = &self.robot.tool.tcp_in_platform_m;
        let pose = Pose::new(tool_m - tool, Rotation3::identity());
        let lengths_m = self.geometry.lengths_m(&pose)?;
        hanging.paid_out_m = lengths_m.iter().copied().collect();
        hanging.equilibrium.pose = pose;
        hanging.equilibrium.lengths_m = lengths_m;
        Ok(hanging)
    }

    /// How the robot hangs when its drums have paid out `paid_out_m` under `tensions_n`, as
    /// measured. A tension-held cable without a measured tension is assumed to be at its set-point.
    ///
    /// # Errors
    /// [`PlanError::Lengths`] where no resting pose fits these lengths.
    pub fn rest_from_lengths(
        &self,
        paid_out_m: &[f64],
        tensions_n: &[f64],
    ) -> Result<StaticState, PlanError> {
        if !self.holding.hangs() {
            return self.rest_fitting(paid_out_m, tensions_n);
        }
        let cables = self.robot.cables.iter().enumerate();
        let held: Vec<_> = cables
            .zip(paid_out_m.iter().zip(tensions_n))
            .map(|((index, cable), (&paid_out, &reading))| {
                let tension = self.tension_n(index, reading);
                match cable.control {
                    Control::Tension if tension > TAUT_N => Held::Tension(tension),
                    Control::Tension => Held::Tension(self.robot.tension.setpoint_n),
                    // Statics need taut lengths. With EA = 50 kN, 10 N stretch a metre by 0.2 mm.
                    Control::Position => Held::Length(self.taut_m(index, paid_out, tension)),
                }
            })
            .collect();
        let equilibrium = self
            .geometry
            .geometrico_static(&held, Start::Cold, &StaticOptions::default())
            .map_err(|source| PlanError::Lengths { source })?;
        Ok(self.with_lengths(equilibrium))
    }

    /// Tool position of a resting state, world, m.
    #[must_use]
    pub fn tool_m(&self, rest: &StaticState) -> Vector3<f64> {
        let tool = &self.robot.tool.tcp_in_platform_m;
        rest.equilibrium.pose.transform(tool)
    }

    /// Place of the platform with its tool at `tool_m` and an attitude.
    pub(super) fn pose_of(&self, tool_m: &Vector3<f64>, attitude: &Rotation3<f64>) -> Pose {
        let tool = &self.robot.tool.tcp_in_platform_m;
        Pose::new(tool_m - attitude * tool, *attitude)
    }

    /// A resting state with the lengths that the drums have paid out for it.
    #[must_use]
    pub fn with_lengths(&self, equilibrium: Equilibrium) -> StaticState {
        let pairs = equilibrium.lengths_m.iter().zip(&equilibrium.tensions_n);
        let paid_out_m = pairs
            .enumerate()
            .map(|(index, (&length, &tension))| self.paid_out_m(index, length, tension))
            .collect();
        StaticState {
            equilibrium,
            paid_out_m,
        }
    }
}
