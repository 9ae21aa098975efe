//! The task: look, choose, approach from above, descend, close, verify, lift, carry, release.

use super::choose::{Budget, Choice, Uncertainty, choose, of_transform};
use super::{Arm, PickError};
use crate::link::Link;
use mcdpr_vision::grasp::{Antipodal, Area, Closing, Detector, Hand, HeightMap, NoGrasp, Wanted};
use mcdpr_vision::{Source, align};
use nalgebra::{Isometry3, Vector3};
use serde::Serialize;

/// How to pick.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Where the tool hangs to look at the tray, world, m.
    pub look_m: Vector3<f64>,
    /// Where it releases, world, m.
    pub release_m: Vector3<f64>,
    /// Where it returns to in the end, world, m; `None`: where it looks.
    pub return_m: Option<Vector3<f64>>,
    /// Middle of the tray's floor, world, m.
    pub tray_m: Vector3<f64>,
    /// Half of the tray's sides, m.
    pub tray_half_m: [f64; 2],
    /// Height of approach and lift over the grasp, m.
    pub above_m: f64,
    /// The jaws.
    pub hand: Hand,
    /// Whether the gripper turns about its axis.
    pub turns: bool,
    /// Failed attempts in a row after which it gives up.
    pub failures_max: usize,
    /// Attempts in all.
    pub attempts_max: usize,
    /// What is known of the errors.
    pub uncertainty: Uncertainty,
}

/// What came of one attempt.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Taken, carried and released.
    Delivered,
    /// The jaws closed on nothing.
    Missed,
    /// It was gone after the lift.
    Lost,
}

/// One attempt.
#[derive(Debug, Clone, Serialize)]
pub struct Attempt {
    /// What came of it.
    pub outcome: Outcome,
    /// The grasp in the colour picture, px.
    pub pixel: [f64; 2],
    /// The tool point as seen, world, m.
    pub seen_m: [f64; 3],
    /// Where the tool went, world, m.
    pub tool_m: [f64; 3],
    /// The platform's origin then, world, m.
    pub platform_m: [f64; 3],
    /// Turn of the jaws, rad.
    pub wrist_rad: f64,
    /// Tilt of the tool, rad.
    pub tilt_rad: f64,
    /// Distance between the pads, m.
    pub width_m: f64,
    /// Rank of the grasp.
    pub quality: f64,
    /// Weight by the difference of tensions, N; `None` where nothing was lifted.
    pub lifted_n: Option<f64>,
    /// Error budget of the grasp point.
    pub budget: Budget,
}

/// Why picking ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "why", rename_all = "snake_case")]
pub enum End {
    /// Nothing left.
    Empty,
    /// Things are left that it can not take.
    Unreachable {
        /// Why not.
        reason: String,
    },
    /// Too many failures in a row.
    Failures {
        /// How many.
        count: usize,
    },
    /// As many attempts as were asked for.
    Enough,
}

/// All of a picking task.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Every attempt.
    pub attempts: Vec<Attempt>,
    /// Why it ended.
    pub end: End,
    /// Time on the link's clock, s.
    pub duration_s: f64,
}

impl Report {
    /// Attempts that ended with a delivery.
    #[must_use]
    pub fn delivered(&self) -> usize {
        let delivered = |attempt: &&Attempt| attempt.outcome == Outcome::Delivered;
        self.attempts.iter().filter(delivered).count()
    }
}

/// Told while picking goes on: for surroundings that must know, and for progress.
pub trait Watcher {
    /// A grasp was chosen; the tool has not moved yet. The jaws are to turn to `choice.wrist_rad`.
    fn chosen(&mut self, choice: &Choice);
    /// The jaws are about to close.
    fn closing(&mut self, choice: &Choice);
    /// Something was lifted off.
    fn lifted(&mut self);
}

/// Picks on a robot with a camera.
pub struct Picker<'a, L: Link> {
    /// The robot.
    pub arm: &'a mut Arm<L>,
    /// The camera.
    pub eye: &'a mut dyn Source,
    /// How.
    pub options: &'a Options,
}

/// A grasp closer than this to one that failed is not tried again, m.
const AGAIN_M: f64 = 0.012;
/// A weight below this is none, N: friction of the pulleys hides as much.
const WEIGHT_MIN_N: f64 = 0.05;
/// A lifted weight beyond this is not believed, N.
const WEIGHT_MAX_N: f64 = 8.0;
/// Time for the swing to fade into the average, s.
const CALM_S: f64 = 0.3;

impl<L: Link> Picker<'_, L> {
    /// Picks until the tray is empty or something ends it.
    ///
    /// # Errors
    /// What stops the robot or the camera. An empty tray, unreachable things and failed grasps are
    /// told in the [`Report`].
    pub fn run(&mut self, watcher: &mut dyn Watcher) -> Result<Report, PickError> {
        let mut attempts: Vec<Attempt> = Vec::new();
        let mut failed: Vec<Vector3<f64>> = Vec::new();
        let end = loop {
            if attempts.len() >= self.options.attempts_max {
                break End::Enough;
            }
            if failed.len() >= self.options.failures_max {
                let count = failed.len();
                break End::Failures { count };
            }
            self.arm.go(&[self.options.look_m])?;
            let choice = match self.look(&failed)? {
                Ok(choice) => choice,
                Err(end) => break end,
            };
            let attempt = self.attempt(&choice, watcher)?;
            if attempt.outcome == Outcome::Delivered {
                failed.clear();
            } else {
                failed.push(choice.tool_m);
            }
            attempts.push(attempt);
        };
        if let Some(place) = self.options.return_m {
            self.arm.go(&[place])?;
        }
        Ok(Report {
            attempts,
            end,
            duration_s: self.arm.time_s(),
        })
    }

    /// Takes a picture and chooses; the reason where there is nothing to choose.
    fn look(&mut self, failed: &[Vector3<f64>]) -> Result<Result<Choice, End>, PickError> {
        self.arm.wait(CALM_S)?;
        let world_from_platform = self.arm.world_from_platform()?;
        let frame = self.eye.frame()?;
        let picture = align(&frame);
        let robot = self.arm.model().robot();
        let platform_from_camera = of_transform(&robot.camera.camera_from_platform).inverse();
        let world_from_camera = world_from_platform * platform_from_camera;
        let options = self.options;
        let tray = Isometry3::translation(options.tray_m.x, options.tray_m.y, options.tray_m.z);
        let closing = if options.turns {
            Closing::Any
        } else {
            let jaw = world_from_platform.rotation * Vector3::y();
            Closing::Along(world_from_camera.rotation.inverse() * jaw)
        };
        let wanted = Wanted {
            hand: options.hand,
            closing,
            area: Some(Area {
                camera_from_area: world_from_camera.inverse() * tray,
                half_m: options.tray_half_m,
            }),
        };
        let unreachable = |reason: String| Ok(Err(End::Unreachable { reason }));
        let map = match HeightMap::new(&picture) {
            Ok(map) => map,
            Err(reason) => return unreachable(reason.to_string()),
        };
        let mut detector = Antipodal::default();
        let grasps = match detector.detect(&picture, &wanted) {
            Ok(grasps) => grasps,
            Err(NoGrasp::Empty) => return Ok(Err(End::Empty)),
            Err(reason) => return unreachable(reason.to_string()),
        };
        let count = grasps.len();
        let choices = choose(
            self.arm.model(),
            &map,
            &grasps,
            &world_from_camera,
            &options.hand,
            options.turns,
        );
        let fresh = |choice: &Choice| {
            let near = |place: &Vector3<f64>| (place - choice.tool_m).norm() < AGAIN_M;
            !failed.iter().any(near)
        };
        for choice in choices.good {
            if fresh(&choice) && self.arm.judge(&self.way_there(&choice)).is_ok() {
                return Ok(Ok(choice));
            }
        }
        unreachable(format!(
            "of {count} grasps the robot reaches none that has not failed already: {} out of \
             reach, {} without room for the tilted fingers",
            choices.unreachable, choices.no_room
        ))
    }

    fn way_there(&self, choice: &Choice) -> [Vector3<f64>; 2] {
        let above = choice.tool_m + Vector3::new(0.0, 0.0, self.options.above_m);
        [above, choice.tool_m]
    }

    fn attempt(
        &mut self,
        choice: &Choice,
        watcher: &mut dyn Watcher,
    ) -> Result<Attempt, PickError> {
        watcher.chosen(choice);
        let [above, at] = self.way_there(choice);
        self.arm.go(&[above])?;
        let before_n = self.arm.mean_tensions_n()?;
        self.arm.go(&[at])?;
        watcher.closing(choice);
        let met = self.arm.grip(true)?;
        let has_switch = self.arm.model().robot().gripper.switch;
        let mut lifted_n = None;
        let outcome = if has_switch && met {
            Outcome::Missed
        } else {
            self.arm.go(&[above])?;
            let now_n = self.arm.mean_tensions_n()?;
            let weight_n = self.arm.lift_n(&before_n, &now_n)?;
            lifted_n = Some(weight_n);
            // The switch is sure; the weight is what there is without one, and tells a loss later.
            let held = if has_switch {
                true
            } else {
                weight_n > WEIGHT_MIN_N
            };
            if held {
                Outcome::Delivered
            } else {
                Outcome::Missed
            }
        };
        let outcome = if outcome == Outcome::Delivered {
            watcher.lifted();
            self.deliver(lifted_n.unwrap_or(0.0))?
        } else {
            self.arm.grip(false)?;
            self.arm.go(&[above])?;
            outcome
        };
        let robot = self.arm.model().robot();
        let distance_m = choice.grasp.point_m.coords.norm();
        Ok(Attempt {
            outcome,
            pixel: choice.grasp.pixel.into(),
            seen_m: choice.seen_m.into(),
            tool_m: choice.tool_m.into(),
            platform_m: choice.platform_m.into(),
            wrist_rad: choice.wrist_rad,
            tilt_rad: choice.tilt_rad,
            width_m: choice.grasp.width_m,
            quality: choice.grasp.quality,
            lifted_n,
            budget: self
                .options
                .uncertainty
                .budget(distance_m, robot.cables.len()),
        })
    }

    /// Carries what hangs in the jaws to the place of release.
    fn deliver(&mut self, weight_n: f64) -> Result<Outcome, PickError> {
        let gravity = mcdpr_kinematics::GRAVITY_MPS2;
        self.arm
            .carry(weight_n.clamp(0.0, WEIGHT_MAX_N) / gravity)?;
        let release = self.options.release_m;
        let above = release + Vector3::new(0.0, 0.0, self.options.above_m);
        let level = self.arm.tool_m().z.max(above.z);
        let over = Vector3::new(release.x, release.y, level);
        self.arm.go(&[over, release])?;
        // A switch that closes on the way tells that the jaws are empty now.
        let lost = self.arm.grip(true)? && self.arm.model().robot().gripper.switch;
        self.arm.grip(false)?;
        self.arm.carry(0.0)?;
        self.arm.go(&[over])?;
        Ok(if lost {
            Outcome::Lost
        } else {
            Outcome::Delivered
        })
    }
}
