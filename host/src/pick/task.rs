//! The task: look, choose, approach from above, descend, close, verify, lift, carry, release.

use super::budget::{Measuring, Uncertainty};
use super::choose::{Choice, Choices};
use super::mat::{Mat, MatSight};
use super::news::pads;
use super::report::{Attempt, End, Outcome, Report, Weighed};
use super::{Arm, Chosen, News, Phase, PickError, Refusal, Tell};
use crate::link::Link;
use crate::sight::Shown;
use mcdpr_vision::Source;
use mcdpr_vision::grasp::{Detector, Hand, NoGrasp};
use nalgebra::{Isometry3, Point3, Vector3};

mod reach;
mod resumed;
mod take_up;
mod view;

use view::Viewed;

/// Options of picking.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Tool position for looking at the tray, world, m.
    pub look_m: Vector3<f64>,
    /// Further positions to look from: grasps of all views compete.
    pub more_views_m: Vec<Vector3<f64>>,
    /// Height over a chosen grasp from which it is looked at again before it is taken, m: the
    /// robot's geometry error between there and the grasp is smaller than from further away.
    pub near_m: Option<f64>,
    /// A pixel of the first picture whose position in the world is wanted, px.
    pub probe_px: Option<[f64; 2]>,
    /// Tool position for releasing, world, m.
    pub release_m: Vector3<f64>,
    /// Final tool position, world, m, or as far below as its limits require; `None`: it stays at
    /// its last position.
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
    /// Failed attempts in a row after which picking ends.
    pub failures_max: usize,
    /// Maximum number of attempts.
    pub attempts_max: usize,
    /// The known errors.
    pub uncertainty: Uncertainty,
    /// Printed tags on the tray's floor.
    pub mat: Option<Mat>,
}

/// Callbacks during picking, for the simulated surroundings and for progress.
pub trait Watcher {
    /// A picture was just taken; [`Choice::view`] counts them.
    fn pictured(&mut self) {}
    /// A picture was taken, and a grasp chosen in it.
    fn looked(&mut self, _picture: &Shown) {}
    /// A grasp was chosen; the tool has not moved yet. The jaws must turn to `choice.wrist_rad`.
    fn chosen(&mut self, choice: &Choice);
    /// The jaws are about to close.
    fn closing(&mut self, choice: &Choice);
    /// An object was lifted.
    fn lifted(&mut self);
}

/// Picks on a robot with a camera.
pub(crate) struct Picker<'a, L: Link> {
    /// The robot.
    pub arm: &'a mut Arm<L>,
    /// The camera.
    pub eye: &'a mut dyn Source,
    /// Finds grasps.
    pub detector: &'a mut dyn Detector,
    /// Options.
    pub options: &'a Options,
    /// Receives the news.
    tell: Tell<'a>,
    /// The mat's pose, from the first look at it.
    world_from_mat: Option<Isometry3<f64>>,
    /// Pictures for grasps so far.
    views: usize,
    /// The mat in each of them, and in the very last picture.
    sights: Vec<Option<MatSight>>,
    last_sight: Option<MatSight>,
    /// Corrections learnt since the approach: the tool's deviation from its commanded position, and
    /// the mat's deviation from the lengths.
    bias_m: Vector3<f64>,
    seen_off_m: Vector3<f64>,
}

/// A grasp closer than this to a failed one is not tried again, m: it would probably slip too.
const AGAIN_M: f64 = 0.025;
/// A weight below this counts as zero, N: friction of the pulleys hides as much.
const WEIGHT_MIN_N: f64 = 0.05;
/// A lifted weight beyond this is not plausible, N.
const WEIGHT_MAX_N: f64 = 8.0;
/// Readings of the tensions after each.
const TRIAL_READINGS: u32 = 3;
/// Motion up and down by this before weighing, m: beyond the pulleys' presliding.
const OVERSHOOT_M: f64 = 0.01;
/// A final position that cannot be reached is tried this much lower, m.
const LOWER_M: f64 = 0.02;
/// Number of corrections above a grasp, and again at it.
const TRIES_ABOVE: usize = 1;
const TRIES: usize = 2;
/// A grasp that is seen again within this counts as the same, m, and sine of an angle.
const SAME_M: f64 = 0.02;
const SAME_TURN: f64 = 0.4;
/// Time for averaging the swing out, s.
const CALM_S: f64 = 0.3;

impl<'a, L: Link> Picker<'a, L> {
    /// A picker before its first picture.
    pub fn new(
        arm: &'a mut Arm<L>,
        eye: &'a mut dyn Source,
        detector: &'a mut dyn Detector,
        options: &'a Options,
    ) -> Self {
        Self {
            arm,
            eye,
            detector,
            options,
            tell: None,
            world_from_mat: None,
            views: 0,
            sights: Vec::new(),
            last_sight: None,
            bias_m: Vector3::zeros(),
            seen_off_m: Vector3::zeros(),
        }
    }

    /// With somebody who gets the news.
    pub(crate) fn telling(self, tell: Tell<'a>) -> Self {
        Self { tell, ..self }
    }

    fn tell(&self, news: &News) {
        if let Some(tell) = self.tell {
            tell(news);
        }
    }

    fn begins(&self, phase: Phase) {
        self.tell(&News::Phase(phase));
    }

    /// Picks until the tray is empty or an error ends it.
    ///
    /// # Errors
    /// Errors that stop the robot or the camera. An empty tray, unreachable objects and failed
    /// grasps are reported in the [`Report`].
    pub fn run(&mut self, watcher: &mut dyn Watcher) -> Result<Report, PickError> {
        let mut attempts: Vec<Attempt> = Vec::new();
        let mut failed: Vec<Vector3<f64>> = Vec::new();
        let mut probe = None;
        let options = self.options;
        self.tell(&News::Places {
            tray_m: options.tray_m.into(),
            half_m: options.tray_half_m,
            release_m: options.release_m.into(),
        });
        let end = loop {
            if attempts.len() >= self.options.attempts_max {
                break End::Enough;
            }
            // Failures in a row: a delivered object clears the list.
            if failed.len() >= self.options.failures_max {
                let count = failed.len();
                break End::Failures { count };
            }
            let choice = match self.look(&failed, &mut probe, watcher)? {
                Ok(choice) => self.look_again(choice, watcher)?,
                Err(end) => break end,
            };
            let attempt = self.attempt(&choice, watcher)?;
            if attempt.outcome == Outcome::Delivered {
                failed.clear();
            } else {
                failed.push(choice.tool_m);
            }
            self.tell(&News::Attempt {
                outcome: attempt.outcome,
                weight_n: attempt.lifted_n,
            });
            attempts.push(attempt);
        };
        let returned_m = match self.options.return_m {
            Some(place) => {
                self.begins(Phase::Returning);
                Some(self.go_back(place)?.into())
            }
            None => None,
        };
        self.tell(&News::End(end.clone()));
        Ok(Report {
            resumed: None,
            attempts,
            end,
            probe_m: probe,
            returned_m,
            duration_s: self.arm.time_s(),
        })
    }

    /// Moves to a position, or as little below it as its limits require.
    fn go_back(&mut self, mut place: Vector3<f64>) -> Result<Vector3<f64>, PickError> {
        let mut first = None;
        while place.z > self.options.look_m.z {
            match self.arm.judge(&[place]) {
                Ok(()) => {
                    self.arm.go(&[place])?;
                    return Ok(place);
                }
                Err(error) => first = first.or(Some(error)),
            }
            place.z -= LOWER_M;
        }
        match first {
            Some(error) => Err(error),
            None => Ok(self.arm.tool_m()),
        }
    }

    /// Looks from every view and chooses; returns the reason if there is nothing to choose.
    fn look(
        &mut self,
        failed: &[Vector3<f64>],
        probe: &mut Option<[f64; 3]>,
        watcher: &mut dyn Watcher,
    ) -> Result<Result<Choice, End>, PickError> {
        let options = self.options;
        let mut all = Choices::default();
        let mut reason: Option<NoGrasp> = None;
        let (mut count, mut empty) = (0, true);
        for view in std::iter::once(&options.look_m).chain(&options.more_views_m) {
            self.begins(Phase::Looking);
            self.arm.go(&[*view])?;
            match self.view(probe, watcher)? {
                Viewed::Grasps {
                    count: grasps,
                    choices,
                } => {
                    count += grasps;
                    empty = false;
                    all.good.extend(choices.good);
                    all.unreachable += choices.unreachable;
                    all.no_room += choices.no_room;
                    all.refused.extend(choices.refused);
                }
                Viewed::Nothing(NoGrasp::Empty) => {}
                Viewed::Nothing(other) => {
                    empty = false;
                    reason = Some(other);
                }
            }
        }
        if empty {
            return Ok(Err(End::Empty));
        }
        all.good.sort_by(|a, b| b.rank().total_cmp(&a.rank()));
        self.tell(&News::Judged {
            grasps: count,
            possible: all.good.len(),
            refused: std::mem::take(&mut all.refused),
        });
        let fresh = |choice: &Choice| {
            let near = |place: &Vector3<f64>| (place - choice.tool_m).norm() < AGAIN_M;
            !failed.iter().any(near)
        };
        for choice in all.good {
            let way = self.way_there(&choice);
            let reason = if !fresh(&choice) {
                "an attempt there has failed"
            } else if self.arm.judge(&way).is_err() {
                "the way there comes too near a limit"
            } else if self.arm.judge(&self.whole_way(&choice)).is_err() {
                "the way from there to the release place comes too near a limit"
            } else {
                return Ok(Ok(choice));
            };
            self.tell(&News::Refused(Refusal {
                at_m: choice.seen_m.into(),
                width_m: choice.grasp.width_m,
                reason,
            }));
        }
        let reason = match reason {
            Some(reason) if count == 0 => reason.to_string(),
            _ => format!(
                "of {count} grasps the robot reaches none that has not failed already: {} out of \
                 reach, {} without room or hold for the tilted fingers",
                all.unreachable, all.no_room
            ),
        };
        Ok(Err(End::Unreachable { reason }))
    }

    /// Looks at a chosen grasp from nearby; returns the same grasp as seen from there, or the first
    /// one if it is not found again.
    fn look_again(
        &mut self,
        choice: Choice,
        watcher: &mut dyn Watcher,
    ) -> Result<Choice, PickError> {
        let Some(near_m) = self.options.near_m else {
            return Ok(choice);
        };
        let place = choice.tool_m + Vector3::new(0.0, 0.0, near_m);
        if self.arm.judge(&[place]).is_err() {
            return Ok(choice);
        }
        self.begins(Phase::LookingAgain);
        self.arm.go(&[place])?;
        let Viewed::Grasps { choices, .. } = self.view(&mut None, watcher)? else {
            return Ok(choice);
        };
        let off = |other: &Choice| (other.tool_m - choice.tool_m).norm();
        // Jaws turned by half a turn are the same.
        let turned = |other: &Choice| (other.wrist_rad - choice.wrist_rad).sin().abs();
        let again = choices
            .good
            .into_iter()
            .filter(|other| off(other) < SAME_M && turned(other) < SAME_TURN)
            .max_by(|a, b| a.rank().total_cmp(&b.rank()));
        let Some(again) = again else {
            return Ok(choice);
        };
        let way = self.way_there(&again);
        Ok(match self.arm.judge(&way) {
            Ok(()) => again,
            Err(_) => choice,
        })
    }

    /// There, up again, and to the release position.
    fn whole_way(&self, choice: &Choice) -> [Vector3<f64>; 5] {
        let [above, at] = self.way_there(choice);
        let [over, release] = self.way_out(above.z);
        [above, at, above, over, release]
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
        self.tell(&News::Chosen(Chosen {
            tool_m: choice.tool_m.into(),
            pads_m: pads(&choice.seen_m, &choice.closing, choice.grasp.width_m),
            width_m: choice.grasp.width_m,
            wrist_rad: choice.wrist_rad,
            tilt_rad: choice.tilt_rad,
            rank: choice.rank(),
        }));
        self.begins(Phase::Approaching);
        let [above, at] = self.way_there(choice);
        (self.bias_m, self.seen_off_m) = (Vector3::zeros(), Vector3::zeros());
        self.arm.go(&[above])?;
        // At the height of the second weighing: their difference is the object alone.
        let before_n = self.arm.mean_tensions_n()?;
        self.reach(&above, TRIES_ABOVE)?;
        self.begins(Phase::Descending);
        let left_m = self.reach(&at, TRIES)?;
        let budget = self.options.uncertainty.budget(&self.measuring(choice));
        let bare_n = self.arm.tensions_over(TRIAL_READINGS)?;
        watcher.closing(choice);
        self.begins(Phase::Closing);
        let met = self.arm.grip(true)?;
        let has_switch = self.arm.model().robot().gripper.switch;
        let up = Vector3::new(0.0, 0.0, OVERSHOOT_M);
        let (mut lifted_n, mut load) = (None, None);
        let outcome = if has_switch && met {
            Outcome::Missed
        } else if let Err(load_n) = self.take_up(&bare_n, above + up)? {
            self.tell(&News::Weighed { weight_n: load_n });
            lifted_n = Some(load_n);
            Outcome::TooHeavy
        } else {
            // Down to the height of the first weighing, in the same direction: friction is the same
            // and cancels.
            self.begins(Phase::Lifting);
            self.arm.go(&[above + up, above])?;
            self.arm.lifted();
            let now_n = self.arm.mean_tensions_n()?;
            let weight_n = self.arm.lift_n(&before_n, &now_n)?;
            lifted_n = Some(weight_n);
            load = self.arm.load().map(Weighed::from);
            self.tell(&News::Weighed { weight_n });
            // A switch detects when the jaws meet, also on the way up; without one the weight does.
            let slipped = has_switch && self.arm.grip(true)?;
            if slipped {
                Outcome::Lost
            } else if has_switch || weight_n > WEIGHT_MIN_N {
                Outcome::Delivered
            } else {
                Outcome::Missed
            }
        };
        let outcome = if outcome == Outcome::Delivered {
            watcher.lifted();
            self.deliver(lifted_n.unwrap_or(0.0))?
        } else {
            self.begins(Phase::Returning);
            self.arm.let_go()?;
            self.arm.expect_load(0.0)?;
            self.arm.go(&[above])?;
            outcome
        };
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
            load,
            weight_agrees: lifted_n
                .map(|weight_n| (weight_n > WEIGHT_MIN_N) == (outcome != Outcome::Missed)),
            left_m,
            budget,
        })
    }

    /// How a grasp was measured, up to the last look before the jaws close.
    fn measuring(&self, choice: &Choice) -> Measuring {
        let robot = self.arm.model().robot();
        let tool = Point3::from(robot.tool.tcp_in_platform_m);
        let to_tool = Isometry3::from(robot.camera.camera_from_platform) * tool;
        let look = self.sights.get(choice.view).copied().flatten();
        let world_from_mat = self.world_from_mat;
        let by_mat_m =
            look.zip(self.last_sight)
                .zip(world_from_mat)
                .map(|((look, grasp), world_from_mat)| {
                    let at = world_from_mat.inverse_transform_point(&choice.tool_m.into());
                    [look, grasp].map(|sight| sight.error_m(&at.coords))
                });
        Measuring {
            distance_m: choice.grasp.point_m.coords.norm(),
            to_tool_m: to_tool.coords.norm(),
            cables: robot.cables.len(),
            by_mat_m,
        }
    }

    /// Carries the object in the jaws to the release position.
    fn deliver(&mut self, weight_n: f64) -> Result<Outcome, PickError> {
        let gravity = mcdpr_kinematics::GRAVITY_MPS2;
        self.arm
            .carry(weight_n.clamp(0.0, WEIGHT_MAX_N) / gravity)?;
        let [over, release] = self.way_out(self.arm.tool_m().z);
        self.begins(Phase::Carrying);
        self.arm.go(&[over, release])?;
        // A switch that closes during the move indicates that the jaws are empty now.
        let lost = self.arm.grip(true)? && self.arm.model().robot().gripper.switch;
        self.begins(Phase::Releasing);
        self.arm.let_go()?;
        self.arm.carry(0.0)?;
        self.arm.go(&[over])?;
        Ok(if lost {
            Outcome::Lost
        } else {
            Outcome::Delivered
        })
    }
}
