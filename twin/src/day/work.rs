//! The work of a day, and its judge.

use super::machine::{Knock, Machine, mat};
use super::robot::Side;
use crate::plant::Mismatch;
use mcdpr_core::estimate::track::{Moved, Named};
use mcdpr_core::motion::{Model, PlanError};
use mcdpr_core::random::Random;
use mcdpr_core::robot::{Robot, TagPlace};
use mcdpr_kinematics::Pose;
use mcdpr_simulator::plant::{Payload, PlantError};
use nalgebra::{Rotation3, Vector3};
use thiserror::Error;

/// Seconds between two judged states.
const SAMPLE_S: f64 = 1.0;
/// Speed of the tool, m/s.
const SPEED_MPS: f64 = 0.1;
/// A rest that is measured lasts this long, s: a second of waiting, a second of averaging.
const REST_S: f64 = 2.0;
/// Largest payload as a share of the platform's mass.
const HEAVIEST: f64 = 0.5;
/// A load is lifted by this before it is weighed, m.
const LIFT_M: f64 = 0.01;
/// Height of the tool above the mat at a look, m.
const LOOK_M: f64 = 0.45;
/// The mat lies this far below the tool's box, m.
const MAT_BELOW_M: f64 = 0.05;

/// Why a day ended early.
#[derive(Debug, Error)]
pub enum DayError {
    /// The robot could not plan its next place.
    #[error("after {hours:.2} h: {source}")]
    Plan {
        /// When.
        hours: f64,
        /// Why.
        source: Box<PlanError>,
    },
    /// The machine could not hang where it was told to.
    #[error("the machine: {0}")]
    Machine(#[from] PlantError),
    /// The robot has no space to work in.
    #[error("{robot}: a day of work needs [limits] box_mm in the robot file")]
    NoBox {
        /// Its name.
        robot: String,
    },
}

impl From<PlanError> for DayError {
    fn from(source: PlanError) -> Self {
        Self::Plan {
            hours: 0.0,
            source: Box::new(source),
        }
    }
}

/// How the robot works.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// By its file alone, from the lengths of the morning.
    Untracked,
    /// It tracks its state, and never looks.
    Blind,
    /// It tracks its state, and looks at the mat now and then.
    Seeing,
}

/// A day's work.
#[derive(Debug, Clone)]
pub struct Work {
    /// The robot.
    pub model: Model,
    /// Its machine's errors, constant and slow.
    pub mismatch: Mismatch,
    /// Hours of work.
    pub hours: f64,
    /// Seconds between two looks.
    pub look_every_s: f64,
    /// How it works.
    pub kind: Kind,
    /// Knocks to try once an hour, on a copy of the machine: how far, m; 0 for none.
    pub knock_m: f64,
}

/// One judged second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Since the start, s.
    pub at_s: f64,
    /// Distance of the tool from where it should be, m.
    pub error_m: f64,
    /// Whether it is in the tracked 95 % region; `None` without one.
    pub inside: Option<bool>,
}

/// Error of a payload's estimate, two seconds after lifting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadError {
    /// True mass, kg.
    pub mass_kg: f64,
    /// Relative error of the mass.
    pub mass: f64,
    /// Error of the centre across and along gravity's direction at a level platform, m.
    pub across_m: f64,
    /// The same, vertical.
    pub along_m: f64,
}

/// One trial with a knock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Knocked {
    /// Anchor from 1; 0 for the camera.
    pub anchor: usize,
    /// Looks until something was named; `None` if nothing was within two.
    pub looks: Option<usize>,
    /// Whether what was named is what was knocked.
    pub right: bool,
    /// Distance between the named and the true displacement, m.
    pub off_m: f64,
}

/// What a day showed.
#[derive(Debug, Clone, Default)]
pub struct Day {
    /// Every second that was judged.
    pub samples: Vec<Sample>,
    /// Every payload.
    pub loads: Vec<LoadError>,
    /// Every trial with a knock.
    pub knocks: Vec<Knocked>,
    /// Names given although nothing was knocked: a false alarm each.
    pub false_names: Vec<(f64, String)>,
    /// Rests and looks, and how many of them did not fit.
    pub rests: usize,
    /// Of these doubted.
    pub doubted: usize,
    /// Looks that saw the mat.
    pub looks: usize,
}

/// A day in progress.
struct Running<'a> {
    work: &'a Work,
    machine: Machine,
    side: Side,
    random: Random,
    day: Day,
    at_s: f64,
    tool_m: Vector3<f64>,
    looked_s: f64,
    looks: usize,
    low: Vector3<f64>,
    high: Vector3<f64>,
    look_m: Vector3<f64>,
    carried: bool,
    judged: bool,
    /// The first that was named.
    named: Option<Named>,
}

impl Work {
    /// The robot with the mat's tags and where the mat lies.
    fn with_mat(robot: &Robot) -> Result<(Robot, TagPlace, [Vector3<f64>; 2]), DayError> {
        let mut robot = robot.clone();
        robot.tags = mat();
        let [low, high] = robot.limits.box_in_world_m.ok_or_else(|| DayError::NoBox {
            robot: robot.name.clone(),
        })?;
        let home = robot.tool.home_in_world_m;
        let middle = (low + high) / 2.0;
        let at = Vector3::new(
            0.5 * (home.x + middle.x),
            0.5 * (home.y + middle.y),
            low.z - MAT_BELOW_M,
        );
        let face_up = Rotation3::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
        let place = TagPlace {
            body: 0,
            world_from_body: Pose::new(at, face_up),
        };
        Ok((robot, place, [low, high]))
    }

    /// Works for a day on the machine of a seed. `progress` gets the share done and may end the day.
    ///
    /// # Errors
    /// [`DayError`].
    pub fn run(&self, seed: u64, progress: &mut dyn FnMut(f64) -> bool) -> Result<Day, DayError> {
        let (robot, place, [low, high]) = Self::with_mat(self.model.robot())?;
        let model = Model::new(&robot)?.with_options(self.model.options());
        let rest = model.rest_at_home()?;
        let held = model.holding().by_tension();
        let mut machine = Machine::new(
            &robot,
            &self.mismatch,
            seed,
            &rest.equilibrium.pose,
            rest.tensions_n(),
            held,
            place,
        )?;
        let lengths_m = machine.lengths_at_first_m();
        let tracked = self.kind != Kind::Untracked;
        let look_m = place.world_from_body.position_m + Vector3::new(0.0, 0.0, LOOK_M);
        let side = Side::new(&model, tracked, &lengths_m, &machine.drums_m(), rest, place);
        let mut running = Running {
            work: self,
            machine,
            side,
            random: Random::new(seed ^ 0x776F_726B),
            day: Day::default(),
            at_s: 0.0,
            tool_m: robot.tool.home_in_world_m,
            looked_s: f64::NEG_INFINITY,
            looks: 0,
            low,
            high,
            look_m,
            carried: false,
            judged: true,
            named: None,
        };
        running.whole(progress).map_err(|error| match error {
            DayError::Plan { source, .. } => DayError::Plan {
                hours: running.at_s / 3600.0,
                source,
            },
            other => other,
        })?;
        Ok(running.day)
    }
}

impl Running<'_> {
    fn whole(&mut self, progress: &mut dyn FnMut(f64) -> bool) -> Result<(), DayError> {
        let end_s = self.work.hours * 3600.0;
        let mut knocked_h = 0.0;
        // The morning's first look: the robot was calibrated, then it looks once more.
        self.look_if_due()?;
        while self.at_s < end_s {
            if !progress(self.at_s / end_s) {
                return Ok(());
            }
            self.pick()?;
            self.look_if_due()?;
            self.circle()?;
            self.look_if_due()?;
            if self.work.knock_m > 0.0 && self.at_s / 3600.0 >= knocked_h + 1.0 {
                knocked_h += 1.0;
                self.try_knocks()?;
            }
        }
        Ok(())
    }

    /// A place in the inner part of the work space, in the lower or upper half of its height.
    fn place(&mut self, lower: bool) -> Vector3<f64> {
        let middle = (self.low + self.high) / 2.0;
        let half = (self.high - self.low) / 2.0;
        let z = if lower { -0.3 } else { 0.1 };
        Vector3::new(
            middle.x + half.x * self.random.within(0.35),
            middle.y + half.y * self.random.within(0.35),
            middle.z + half.z * (z + self.random.within(0.1)),
        )
    }

    fn pick(&mut self) -> Result<(), DayError> {
        let (from, to) = (self.place(true), self.place(true));
        self.go_to(&from)?;
        self.measure(false)?;
        let platform_kg = self.work.model.robot().platform.mass_kg;
        let tcp = self.work.model.robot().tool.tcp_in_platform_m;
        let load = Payload {
            mass_kg: platform_kg * (0.1 + (HEAVIEST - 0.1) * self.random.unit()),
            center_m: [
                tcp.x + self.random.within(0.015),
                tcp.y + self.random.within(0.015),
                tcp.z - 0.02 - 0.03 * self.random.unit(),
            ],
        };
        self.machine.carry(Some(&load))?;
        self.carried = true;
        self.side.lift();
        // Up by a little in the first second: all pulleys then rub the same way.
        let up = from + Vector3::new(0.0, 0.0, LIFT_M);
        self.step(&up)?;
        self.step(&up)?;
        self.measure(false)?;
        if let Some(found) = self.side.tracker().and_then(|t| t.load()) {
            let off = found.center_m - Vector3::from(load.center_m);
            self.day.loads.push(LoadError {
                mass_kg: load.mass_kg,
                mass: found.mass_kg / load.mass_kg - 1.0,
                across_m: off.xy().norm(),
                along_m: off.z.abs(),
            });
        }
        self.go_to(&to)?;
        self.hold(REST_S)?;
        self.measure(false)?;
        self.machine.carry(None)?;
        self.carried = false;
        self.side.set_down()?;
        self.hold(REST_S)?;
        self.measure(false)
    }

    fn circle(&mut self) -> Result<(), DayError> {
        let center = self.place(false);
        let half = (self.high - self.low) / 2.0;
        let radius = 0.25 * half.x.min(half.y);
        let points = (std::f64::consts::TAU * radius / (SPEED_MPS * SAMPLE_S)).ceil();
        let at = |k: f64| {
            let (sine, cosine) = libm::sincos(std::f64::consts::TAU * k / points);
            center + Vector3::new(radius * cosine, radius * sine, 0.0)
        };
        self.go_to(&at(0.0))?;
        for _ in 0..3 {
            let mut k = 1.0;
            while k <= points {
                self.step(&at(k))?;
                k += 1.0;
            }
        }
        self.hold(REST_S)?;
        self.measure(false)
    }

    fn look_if_due(&mut self) -> Result<(), DayError> {
        if self.work.kind != Kind::Seeing || self.at_s - self.looked_s < self.work.look_every_s {
            return Ok(());
        }
        self.looked_s = self.at_s;
        self.look()
    }

    /// Goes above the mat, to one of four places in turn, and looks.
    fn look(&mut self) -> Result<(), DayError> {
        self.looks += 1;
        let by = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]][self.looks % 4];
        let at = self.look_m + Vector3::new(0.06 * by[0], 0.06 * by[1], 0.0);
        self.go_to(&at)?;
        self.hold(REST_S)?;
        self.measure(true)
    }

    fn go_to(&mut self, to: &Vector3<f64>) -> Result<(), DayError> {
        let from = self.tool_m;
        let steps = ((to - from).norm() / (SPEED_MPS * SAMPLE_S))
            .ceil()
            .max(1.0);
        let mut k = 1.0;
        while k <= steps {
            self.step(&(from + (to - from) * (k / steps)))?;
            k += 1.0;
        }
        Ok(())
    }

    /// Stays where it is, with what it knows now.
    fn hold(&mut self, seconds: f64) -> Result<(), DayError> {
        let at = self.tool_m;
        let mut left = seconds;
        while left > 0.0 {
            self.step(&at)?;
            left -= SAMPLE_S;
        }
        Ok(())
    }

    /// One second of motion or rest, and its judgement.
    fn step(&mut self, to: &Vector3<f64>) -> Result<(), DayError> {
        let command = self.side.go(to)?;
        let way = self.machine.go(&command.drums_m, &command.readings_n)?;
        let readings_n = self.machine.readings_n();
        let encoders_m = self.machine.encoders_m();
        self.side.feel(&way, &encoders_m, &readings_n);
        self.tool_m = *to;
        self.machine.pass(SAMPLE_S);
        self.side.pass(SAMPLE_S);
        self.at_s += SAMPLE_S;
        if self.judged {
            let truth = Vector3::from(self.machine.truth().tool_position_m);
            let region = self.side.region();
            self.day.samples.push(Sample {
                at_s: self.at_s,
                error_m: (truth - to).norm(),
                inside: region.map(|region| region.holds(&truth)),
            });
        }
        Ok(())
    }

    fn measure(&mut self, look: bool) -> Result<(), DayError> {
        let views = if look {
            self.machine.look()
        } else {
            Vec::new()
        };
        self.day.looks += usize::from(!views.is_empty());
        let readings_n = self.machine.readings_n();
        let report = self
            .side
            .measure(&self.machine.encoders_m(), readings_n, views)?;
        if let Some(report) = report {
            self.day.rests += 1;
            self.day.doubted += usize::from(!report.fits);
            self.named = self.named.or(report.named);
            if let (Some(named), true) = (report.named, self.judged) {
                self.day.false_names.push((
                    self.at_s,
                    format!("{:?} by {:.2?} mm", named.what, (named.by * 1e3).as_slice()),
                ));
            }
        }
        Ok(())
    }

    /// Works until a look is due, and looks; ends where something is named.
    fn work_and_look(&mut self) -> Result<(), DayError> {
        let mut picks = true;
        while self.named.is_none() && self.at_s - self.looked_s < self.work.look_every_s {
            if picks {
                self.pick()?;
            } else {
                self.circle()?;
            }
            picks = !picks;
        }
        if self.named.is_none() {
            self.looked_s = self.at_s;
            self.look()?;
        }
        Ok(())
    }

    /// Knocks every anchor and the camera in turn, each on a copy of machine and robot, which goes on with its work until it
    /// has looked twice.
    fn try_knocks(&mut self) -> Result<(), DayError> {
        let cables = self.work.model.robot().cables.len();
        for which in 0..=cables {
            let direction = Vector3::from_fn(|_, _| self.random.normal()).normalize();
            let by = direction * self.work.knock_m;
            let mut trial = Running {
                work: self.work,
                machine: self.machine.clone(),
                side: self.side.clone(),
                random: Random::new(self.at_s.to_bits() ^ which as u64),
                day: Day::default(),
                judged: false,
                named: None,
                ..*self
            };
            let knock = if which < cables {
                Knock::Anchor(which, by.into())
            } else {
                Knock::Camera(by.into(), [0.0; 3])
            };
            trial.machine.knock(&knock)?;
            let what = if which < cables {
                Moved::Anchor(which + 1)
            } else {
                Moved::Camera
            };
            let mut result = Knocked {
                anchor: if which < cables { which + 1 } else { 0 },
                looks: None,
                right: false,
                off_m: f64::NAN,
            };
            for looks in 1..=2 {
                match trial.work_and_look() {
                    // A cable went slack: a board would stop the robot.
                    Err(DayError::Machine(_)) => break,
                    other => other?,
                }
                if let Some(named) = trial.named {
                    result.looks = Some(looks);
                    result.right = named.what == what;
                    result.off_m = (named.by - by).norm();
                    break;
                }
            }
            self.day.knocks.push(result);
        }
        Ok(())
    }
}
