//! What a robot can reach at rest, in the terms of its own file.

use super::super::plan::Candidate;
use super::super::simulate::{Dice, views_at};
use super::super::{Data, data::View};
use super::skeleton::ANCHOR_TOLERANCE_M;
use crate::motion::{Model, Rest};
use mcdpr_kinematics::{AnyRobot, Cable, EquilibriumGuess, Held, Pose, Start, StaticOptions};
use nalgebra::Vector3;

/// Room to the tension limits for what sensors and pulleys hide, N, and as a share of the limit.
const TENSION_ROOM_N: f64 = 0.3;
const TENSION_ROOM: f64 = 0.05;
/// Robots as they may have been built that must stay within the limits as well.
const BUILDS: usize = 8;
/// Share of the tilt limit that is used.
const TILT_SHARE: f64 = 0.9;

/// The resting places of a robot whose tension-held cable can be set as wanted.
#[derive(Debug, Clone)]
pub struct Reach<'a> {
    model: &'a Model,
    held: usize,
    least_n: f64,
    most_n: f64,
    builds: Vec<Build>,
}

/// The robot as it may have been built: every anchor off by the tolerance in some direction.
#[derive(Debug, Clone)]
struct Build {
    geometry: AnyRobot,
    /// Its lengths at home, less those of the robot as described, m.
    offsets_m: Vec<f64>,
}

fn builds(model: &Model) -> Vec<Build> {
    let mut dice = Dice::new(0x0062_7569_6C64);
    let Ok(home) = crate::experiment::home(model) else {
        return Vec::new();
    };
    let pose = home.equilibrium.pose;
    // A calibrated robot is known; what is checked is then its own model.
    let calibrated = model.robot().calibrated.is_some();
    let count = if calibrated { 0 } else { BUILDS };
    let build = |_| {
        let shifted: Vec<Cable> = model
            .geometry()
            .cables()
            .iter()
            .map(|cable| {
                let off = Vector3::from_fn(|_, _| ANCHOR_TOLERANCE_M.copysign(dice.within(1.0)));
                Cable {
                    anchor_m: cable.anchor_m + off,
                    ..*cable
                }
            })
            .collect();
        let geometry = AnyRobot::new(&shifted, *model.geometry().platform()).ok()?;
        let lengths = geometry.lengths_m(&pose).ok()?;
        let pairs = lengths.iter().zip(home.equilibrium.lengths_m.iter());
        Some(Build {
            offsets_m: pairs.map(|(a, b)| a - b).collect(),
            geometry,
        })
    };
    (0..count).filter_map(build).collect()
}

impl<'a> Reach<'a> {
    /// `None` for a robot without a tension-held cable.
    #[must_use]
    pub fn new(model: &'a Model) -> Option<Self> {
        let robot = model.robot();
        let held = model.tension_held()?;
        let winch = robot.winch_of(held)?;
        let limits = &robot.limits;
        let most = limits.tension_max_n.min(winch.tension_max_n);
        Some(Self {
            model,
            held,
            least_n: robot.tension.floor_n.max(limits.tension_min_n),
            most_n: robot.tension.ceiling_n.min(most),
            builds: builds(model),
        })
    }

    /// The tension-held cable, from 0.
    #[must_use]
    pub const fn held(&self) -> usize {
        self.held
    }

    /// How the robot hangs with the platform's origin at `at_m` (world) and the held cable at
    /// `tension_n`; `None` where it can not, or not within its limits with some room.
    #[must_use]
    pub fn rest(&self, at_m: &Vector3<f64>, tension_n: f64, near: Option<&Rest>) -> Option<Rest> {
        let robot = self.model.robot();
        let mut tensions = vec![None; robot.cables.len()];
        *tensions.get_mut(self.held)? = Some(tension_n);
        let guess = near.map_or(EquilibriumGuess::Cold, |rest| {
            EquilibriumGuess::Attitude(rest.equilibrium.pose.rotation)
        });
        let options = StaticOptions::default();
        let equilibrium = self
            .model
            .geometry()
            .equilibrium_at(&Vector3::zeros(), at_m, &tensions, guess, &options)
            .ok()?;
        let rest = self.model.with_lengths(equilibrium);
        self.within(&rest).then_some(rest)
    }

    /// Whether a resting state keeps clear of the robot's limits.
    fn within(&self, rest: &Rest) -> bool {
        let robot = self.model.robot();
        let limits = &robot.limits;
        let tool = self.model.tool_m(rest);
        let inside = limits
            .box_in_world_m
            .is_none_or(|[low, high]| (0..3).all(|k| (low[k]..=high[k]).contains(&tool[k])));
        let tilt = rest.equilibrium.pose.tilt_rad();
        let cables = rest.tensions_n().iter().zip(&rest.paid_out_m).enumerate();
        let mut cables = cables.map(|(i, (&tension, &paid_out))| {
            let Some(winch) = robot.winch_of(i) else {
                return false;
            };
            let most = limits.tension_max_n.min(winch.tension_max_n);
            let on_drum = winch.turns_max * std::f64::consts::TAU * winch.drum_radius_m;
            self.bearable(tension, most) && paid_out <= on_drum
        });
        rest.equilibrium.stable
            && inside
            && tilt <= limits.tilt_max_rad * TILT_SHARE
            && cables.all(|ok| ok)
    }

    fn bearable(&self, tension_n: f64, most_n: f64) -> bool {
        let least_n = self.model.robot().limits.tension_min_n + TENSION_ROOM_N;
        (least_n..=most_n * (1.0 - TENSION_ROOM)).contains(&tension_n)
    }

    /// Whether robots as they may have been built keep within their tensions too, when their drums
    /// pay out what this resting state says.
    #[must_use]
    pub fn robust(&self, rest: &Rest) -> bool {
        let robot = self.model.robot();
        self.builds.iter().all(|build| {
            let taut = rest.equilibrium.lengths_m.iter().zip(&build.offsets_m);
            let held: Vec<Held> = taut
                .zip(rest.tensions_n())
                .enumerate()
                .map(|(i, ((length, offset), tension))| {
                    if i == self.held {
                        Held::Tension(*tension)
                    } else {
                        Held::Length(length + offset)
                    }
                })
                .collect();
            let start = Start::Pose(&rest.equilibrium.pose);
            let options = StaticOptions::default();
            let found = build.geometry.geometrico_static(&held, start, &options);
            found.is_ok_and(|found| {
                let pairs = found.tensions_n.iter().enumerate();
                let mut fine = pairs.map(|(i, tension)| {
                    let winch = robot.winch_of(i).map_or(f64::MAX, |w| w.tension_max_n);
                    self.bearable(*tension, robot.limits.tension_max_n.min(winch))
                });
                fine.all(|ok| ok)
            })
        })
    }

    /// A resting place at random: anywhere in the robot's box, any tension in its range.
    fn random(&self, dice: &mut Dice) -> Option<Rest> {
        let [low, high] = self.model.robot().search_box_in_world_m();
        let tool = Vector3::from_fn(|k, _| low[k] + (high[k] - low[k]) * dice.unit());
        let tension_n = self.least_n * (self.most_n / self.least_n).powf(dice.unit());
        // The box is the tool's; the platform hangs above it.
        let at = tool - self.model.robot().tool.tcp_in_platform_m;
        self.rest(&at, tension_n, None)
    }

    /// Resting places with tags in view, at random; `data` has camera, tags and their places.
    #[must_use]
    pub fn candidates(&self, data: &Data, count: usize, seed: u64) -> Vec<(Candidate, Rest)> {
        let mut dice = Dice::new(seed);
        let mut out = Vec::with_capacity(count);
        for _ in 0..count * 200 {
            if out.len() == count {
                break;
            }
            let Some(rest) = self.random(&mut dice) else {
                continue;
            };
            let pose = rest.equilibrium.pose;
            let views = views(data, &pose);
            if !views.is_empty() && self.robust(&rest) {
                let candidate = Candidate {
                    pose,
                    tensions_n: rest.tensions_n().to_vec(),
                    held: self.held,
                    views,
                };
                out.push((candidate, rest));
            }
        }
        out
    }

    /// Where the robot will work: resting places at random, tags in view or not.
    #[must_use]
    pub fn work(&self, count: usize, seed: u64) -> Vec<Pose> {
        let mut dice = Dice::new(seed ^ 0x776F_726B);
        let draws = (0..count * 200).filter_map(|_| self.random(&mut dice));
        draws
            .map(|rest| rest.equilibrium.pose)
            .take(count)
            .collect()
    }
}

/// The tags wholly in view at a pose, 40 px from the picture's edge, by nominal values.
#[must_use]
pub fn views(data: &Data, pose: &Pose) -> Vec<View> {
    views_at(
        &data.camera,
        &data.tags,
        &data.world_from_body,
        &data.camera_from_platform,
        pose,
        1.0,
    )
}
