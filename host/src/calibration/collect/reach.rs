//! Reachable resting poses of a robot, from its own file.

use super::super::plan::{Candidate, Halt};
use super::super::views::{MARGIN_PX, SEEN_PX, views_within};
use super::super::{Data, data::View};
use super::skeleton::ANCHOR_TOLERANCE_M;
use super::travel;
use crate::motion::{Model, PlanError, StaticState};
use mcdpr_core::holding::Freedom;
use mcdpr_core::random::Random;
use mcdpr_kinematics::{
    AnyRobot, Cable, Equilibrium, EquilibriumGuess, Held, Pose, Start, StaticOptions,
};
use nalgebra::{Rotation3, Vector3};

/// Margin to the tension limits for errors of sensors and pulleys, N, and as a share of the limit.
const TENSION_ROOM_N: f64 = 0.3;
const TENSION_ROOM: f64 = 0.05;
/// The margin to the least tension is at least this share of the sensor's full scale: its zero differs from session to
/// session by 0.7 % of its range on machines as found (`FoundMismatch`).
const ZERO_ROOM: f64 = 0.0075;
/// Number of varied robots that must stay within the limits as well. If all of them do at a pose, a
/// machine with workshop tolerances exceeds its limits in one of thousands of cases (tests).
const BUILDS: usize = 16;
/// Their errors besides the anchors: mass, the centre of mass per coordinate (m), and the effect of
/// sensor and pulley on the held tension.
const MASS: f64 = 0.02;
const CENTER_OF_MASS_M: f64 = 1e-3;
const FELT: f64 = 0.03;
/// Share of the tilt limit that is used.
const TILT_SHARE: f64 = 0.9;

/// Where a robot is asked to rest.
#[derive(Debug, Clone, Copy)]
pub struct Asked {
    /// The platform's origin, world, m.
    pub at_m: Vector3<f64>,
    /// Attitude (world_from_platform): where gravity decides it, one near to it.
    pub attitude: Rotation3<f64>,
    /// Tension of the tension-held cable of a platform that hangs, N. Otherwise the tensions follow from
    /// the pose.
    pub tension_n: f64,
}

/// The resting poses of a robot: of a platform that hangs any place and held tension, of one whose lengths hold
/// its attitude any place and attitude.
#[derive(Debug, Clone)]
pub struct Reach<'a> {
    model: &'a Model,
    /// The cable whose tension can be set freely.
    held: Option<usize>,
    least_n: f64,
    ceiling_n: f64,
    builds: Vec<Build>,
    /// A pose through which every move can lead, if the robot can hang there.
    home: Option<StaticState>,
}

/// A varied robot: each parameter off by its tolerance in some direction.
#[derive(Debug, Clone)]
struct Build {
    geometry: AnyRobot,
    /// Its lengths at home, less those of the nominal robot, m.
    offsets_m: Vec<f64>,
    /// The held tension at the platform per tension that is set.
    felt: f64,
}

fn builds(model: &Model) -> Vec<Build> {
    let mut random = Random::new(0x0062_7569_6C64);
    let Ok(home) = model.rest_at_home() else {
        return Vec::new();
    };
    let pose = home.equilibrium.pose;
    // A calibrated robot is known; then its own model is checked.
    let calibrated = model.robot().calibrated.is_some();
    let count = if calibrated { 0 } else { BUILDS };
    let mut off = |size: f64| size.copysign(random.within(1.0));
    let build = |_| {
        let shifted: Vec<Cable> = model
            .geometry()
            .cables()
            .iter()
            .map(|cable| Cable {
                anchor_m: cable.anchor_m + Vector3::from_fn(|_, _| off(ANCHOR_TOLERANCE_M)),
                ..*cable
            })
            .collect();
        let mut platform = *model.geometry().platform();
        platform.mass_kg *= 1.0 + off(MASS);
        platform.center_of_mass_m += Vector3::from_fn(|_, _| off(CENTER_OF_MASS_M));
        let geometry = AnyRobot::new(&shifted, platform).ok()?;
        let lengths = geometry.lengths_m(&pose).ok()?;
        let pairs = lengths.iter().zip(home.equilibrium.lengths_m.iter());
        Some(Build {
            offsets_m: pairs.map(|(a, b)| a - b).collect(),
            geometry,
            felt: 1.0 + off(FELT),
        })
    };
    (0..count).filter_map(build).collect()
}

impl<'a> Reach<'a> {
    /// The poses of a robot by its description, with margins for a machine that is built a little differently.
    ///
    /// # Errors
    /// [`PlanError::Placed`] for a robot that neither hangs on three lengths and a tension nor has lengths that hold
    /// its whole pose.
    pub fn new(model: &'a Model) -> Result<Self, PlanError> {
        model.comes_to_rest("collecting")?;
        let robot = model.robot();
        let held = model.holding().first_by_tension();
        let held = held.filter(|_| model.holding().hangs());
        let limits = &robot.limits;
        let winches = held.and_then(|held| robot.winch_of(held));
        let most = winches.map_or(limits.tension_max_n, |winch| {
            limits.tension_max_n.min(winch.tension_max_n)
        });
        let mut out = Self {
            model,
            held,
            least_n: robot.tension.floor_n.max(limits.tension_min_n),
            ceiling_n: robot.tension.ceiling_n.min(most),
            builds: builds(model),
            home: None,
        };
        let home = model.rest_at_home().ok();
        out.home = home.filter(|home| out.within(home) && out.robust(home));
        Ok(out)
    }

    /// The cable whose tension can be set freely, from 0; `None` where the tensions follow from the pose.
    #[must_use]
    pub const fn held(&self) -> Option<usize> {
        self.held
    }

    /// How the robot rests where it is asked to; `None` if it cannot, or not within its limits with a margin.
    #[must_use]
    pub fn rest(&self, asked: &Asked) -> Option<StaticState> {
        let rest = self.equilibrium(asked, EquilibriumGuess::Attitude(asked.attitude))?;
        self.within(&rest).then_some(rest)
    }

    /// As [`Reach::rest`], without checking its limits.
    pub(super) fn anyhow(&self, asked: &Asked) -> Option<StaticState> {
        let rest = self.equilibrium(asked, EquilibriumGuess::Attitude(asked.attitude))?;
        rest.equilibrium.stable.then_some(rest)
    }

    fn equilibrium(&self, asked: &Asked, guess: EquilibriumGuess) -> Option<StaticState> {
        let Some(held) = self.held else {
            let pose = Pose::new(asked.at_m, asked.attitude);
            return self.model.rest_at_pose(&pose).ok();
        };
        let robot = self.model.robot();
        let mut tensions = vec![None; robot.cables.len()];
        *tensions.get_mut(held)? = Some(asked.tension_n);
        let options = StaticOptions::default();
        let equilibrium = self
            .model
            .geometry()
            .equilibrium_at(&Vector3::zeros(), &asked.at_m, &tensions, guess, &options)
            .ok()?;
        Some(self.model.with_lengths(equilibrium))
    }

    /// Whether a resting state keeps clear of the robot's limits.
    fn within(&self, rest: &StaticState) -> bool {
        let robot = self.model.robot();
        let limits = &robot.limits;
        let tool = self.model.asked(&self.model.tool_m(rest));
        let inside = limits
            .box_in_world_m
            .is_none_or(|[low, high]| (0..3).all(|k| (low[k]..=high[k]).contains(&tool[k])));
        let tilt = rest.equilibrium.pose.tilt_rad();
        let cables = rest.tensions_n().iter().zip(&rest.paid_out_m).enumerate();
        let mut cables = cables.map(|(i, (&tension, &paid_out))| {
            let Some(winch) = robot.winch_of(i) else {
                return false;
            };
            let on_drum = winch.turns_max * std::f64::consts::TAU * winch.drum_radius_m;
            self.bearable(tension, i) && paid_out <= on_drum
        });
        rest.equilibrium.stable
            && inside
            && tilt <= limits.tilt_max_rad * TILT_SHARE
            && cables.all(|ok| ok)
    }

    fn bearable(&self, tension_n: f64, cable: usize) -> bool {
        let least_n = self.least_n() + self.room_n(cable);
        (least_n..=self.most_n(cable) * (1.0 - TENSION_ROOM)).contains(&tension_n)
    }

    /// Margin to the least tension of a cable, N.
    fn room_n(&self, cable: usize) -> f64 {
        let winch = self.model.robot().winch_of(cable);
        winch.map_or(TENSION_ROOM_N, |winch| {
            (ZERO_ROOM * winch.tension_max_n).max(TENSION_ROOM_N)
        })
    }

    /// Least tension of a cable, N.
    pub(super) fn least_n(&self) -> f64 {
        self.model.robot().limits.tension_min_n
    }

    /// Whether a measured tension is nearer to a limit than half of the planning margin.
    pub(super) fn beyond(&self, cable: usize, tension_n: f64) -> bool {
        let least_n = self.least_n() + 0.5 * self.room_n(cable);
        let most_n = self.most_n(cable) * (1.0 - 0.5 * TENSION_ROOM);
        !(least_n..=most_n).contains(&tension_n)
    }

    /// The middle between the limits of a cable's tension, N.
    pub(super) fn middle_n(&self, cable: usize) -> f64 {
        0.5 * (self.least_n() + self.most_n(cable))
    }

    /// Greatest tension of a cable, N: the brake's test passes there, too.
    fn most_n(&self, cable: usize) -> f64 {
        let robot = self.model.robot();
        let winch = robot.winch_of(cable).map_or(f64::MAX, |winch| {
            winch.tension_max_n.min(winch.proven_tension_n())
        });
        robot.limits.tension_max_n.min(winch)
    }

    /// Whether varied robots keep within their tensions too, when their drums pay out the lengths
    /// of this resting state.
    #[must_use]
    pub(crate) fn robust(&self, rest: &StaticState) -> bool {
        self.builds.iter().all(|build| {
            self.hung(build, rest).is_some_and(|hung| {
                let mut pairs = hung.tensions_n.iter().enumerate();
                pairs.all(|(i, tension)| self.bearable(*tension, i))
            })
        })
    }

    /// How a varied robot hangs when its drums pay out the lengths of a resting state; `None` if it
    /// cannot.
    fn hung(&self, build: &Build, rest: &StaticState) -> Option<Equilibrium> {
        let taut = rest.equilibrium.lengths_m.iter().zip(&build.offsets_m);
        let held: Vec<Held> = taut
            .zip(rest.tensions_n())
            .enumerate()
            .map(|(i, ((length, offset), tension))| {
                if self.model.holding().by_tension().contains(&i) {
                    Held::Tension(tension * build.felt)
                } else {
                    Held::Length(length + offset)
                }
            })
            .collect();
        let start = Start::Pose(&rest.equilibrium.pose);
        let options = StaticOptions::default();
        build
            .geometry
            .geometrico_static(&held, start, &options)
            .ok()
    }

    /// A resting place at random: anywhere in the robot's box, and any tension in its range or any attitude within
    /// the limit of its tilt.
    fn random(&self, random: &mut Random) -> Option<StaticState> {
        let [low, high] = self.model.robot().search_box_in_world_m();
        let tool_m = Vector3::from_fn(|k, _| low[k] + (high[k] - low[k]) * random.unit());
        let tcp_m = self.model.robot().tool.tcp_in_platform_m;
        if self.held.is_none() {
            let attitude = self.turned(&Rotation3::identity(), 1.0, random);
            return self.rest(&Asked {
                at_m: tool_m - attitude * tcp_m,
                attitude,
                tension_n: 0.0,
            });
        }
        let tension_n = self.least_n * (self.ceiling_n / self.least_n).powf(random.unit());
        let asked = Asked {
            // The box is the tool's; the platform hangs above it.
            at_m: tool_m - tcp_m,
            attitude: Rotation3::identity(),
            tension_n,
        };
        let rest = self.equilibrium(&asked, EquilibriumGuess::Cold)?;
        self.within(&rest).then_some(rest)
    }

    /// An attitude within `size` times the limit of the tilt of another, about every axis; of a robot in a plane about
    /// the plane's normal, within the limit.
    fn turned(&self, from: &Rotation3<f64>, size: f64, random: &mut Random) -> Rotation3<f64> {
        let limit_rad = self.model.robot().limits.tilt_max_rad * TILT_SHARE;
        let most_rad = limit_rad * size;
        if let Freedom::Plane { normal } = self.model.holding().freedom() {
            let turn_rad = from.scaled_axis().dot(&normal) + random.within(most_rad);
            return Rotation3::new(normal * turn_rad.clamp(-limit_rad, limit_rad));
        }
        from * Rotation3::new(Vector3::from_fn(|_, _| random.within(most_rad)))
    }

    /// A place of the platform's origin within `size` times 0.1 m of another, in the robot's plane if it has one.
    fn shifted(&self, from_m: &Vector3<f64>, size: f64, random: &mut Random) -> Vector3<f64> {
        let shift_m = Vector3::from_fn(|_, _| random.within(0.1 * size));
        match self.model.holding().freedom() {
            Freedom::Plane { normal } => from_m + shift_m - normal * normal.dot(&shift_m),
            _ => from_m + shift_m,
        }
    }

    /// Resting places with tags in view, at random; `data` has camera, tags and their places. Fewer if `halt` is
    /// wanted meanwhile.
    #[must_use]
    pub fn candidates(&self, data: &Data, count: usize, seed: u64, halt: &Halt) -> Vec<Candidate> {
        let mut random = Random::new(seed);
        // 200 draws per candidate: at most places it cannot hang, or sees no tag.
        let draws = (0..count * 200).take_while(|_| !halt.wanted());
        let draws = draws.filter_map(|_| self.seen(data, &self.random(&mut random)?));
        draws.take(count).collect()
    }

    /// A resting pose with tags in view near a candidate: within `size` times 0.1 m, and its
    /// tension within a factor of e to the `size`, or its attitude within `size` times the limit of the tilt.
    pub(super) fn near(
        &self,
        data: &Data,
        candidate: &Candidate,
        size: f64,
        random: &mut Random,
    ) -> Option<Candidate> {
        let at_m = self.shifted(&candidate.pose.position_m, size, random);
        let mut asked = Asked {
            at_m,
            attitude: candidate.pose.rotation,
            tension_n: 0.0,
        };
        match self.held {
            Some(held) => {
                let tension_n = candidate.tensions_n.get(held)? * random.within(size).exp();
                asked.tension_n = tension_n.clamp(self.least_n, self.ceiling_n);
            }
            None => asked.attitude = self.turned(&asked.attitude, size.min(1.0), random),
        }
        self.seen(data, &self.rest(&asked)?)
    }

    /// How the robot rests at a candidate.
    #[must_use]
    pub fn at(&self, candidate: &Candidate) -> Option<StaticState> {
        let tension_n = match self.held {
            Some(held) => *candidate.tensions_n.get(held)?,
            None => 0.0,
        };
        self.rest(&Asked {
            at_m: candidate.pose.position_m,
            attitude: candidate.pose.rotation,
            tension_n,
        })
    }

    /// The candidate at a resting pose, if the varied robots can hang there and move there, and see
    /// a tag there.
    fn seen(&self, data: &Data, rest: &StaticState) -> Option<Candidate> {
        let pose = rest.equilibrium.pose;
        let mut views = views(data, &pose, MARGIN_PX);
        let open = || match &self.home {
            Some(home) => travel::open(self, home, rest),
            None => self.robust(rest),
        };
        if views.is_empty() || !open() {
            return None;
        }
        for build in &self.builds {
            let there = self::views(data, &self.hung(build, rest)?.pose, SEEN_PX);
            let found = |other: &&View| rim_in_view(data, other);
            let there: Vec<usize> = there.iter().filter(found).map(|other| other.tag).collect();
            views.retain(|view| there.contains(&view.tag));
        }
        (!views.is_empty()).then(|| Candidate {
            pose,
            tensions_n: rest.tensions_n().to_vec(),
            held: self.held.unwrap_or(0),
            views,
        })
    }

    /// Working poses: random resting poses, with or without tags in view. Fewer if `halt` is wanted meanwhile.
    #[must_use]
    pub fn work(&self, count: usize, seed: u64, halt: &Halt) -> Vec<Pose> {
        let mut random = Random::new(seed ^ 0x776F_726B);
        let draws = (0..count * 200).take_while(|_| !halt.wanted());
        let draws = draws.filter_map(|_| self.random(&mut random));
        draws
            .map(|rest| rest.equilibrium.pose)
            .take(count)
            .collect()
    }
}

/// Whether the white margin of a tag is in the picture as well, which a detector needs: a cell of
/// its eight, by the tag's own edge there.
fn rim_in_view(data: &Data, view: &View) -> bool {
    let [a, b, ..] = view.corners_px;
    let rim_px = (b[0] - a[0]).hypot(b[1] - a[1]) / 8.0;
    let inside = |corner: &[f64; 2]| {
        let mut axes = corner.iter().zip(&data.camera.size_px);
        axes.all(|(at, size)| (rim_px..=*size as f64 - rim_px).contains(at))
    };
    view.corners_px.iter().all(inside)
}

/// The tags completely in view at a pose by nominal values, with this margin to the picture's edge.
fn views(data: &Data, pose: &Pose, margin_px: f64) -> Vec<View> {
    let from_world = data.camera_from_platform.compose(&pose.inverse());
    let bodies = &data.world_from_body;
    views_within(
        &data.camera,
        &data.tags,
        bodies,
        &from_world,
        1.0,
        margin_px,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::{self, Mismatch};
    use crate::robot::Robot;
    use mcdpr_kinematics::Platform;

    /// A machine with workshop tolerances, its drums locked at home.
    fn machine(model: &Model, home: &StaticState, seed: u64) -> Build {
        let params = machine::plant_params(model.robot(), &Mismatch::as_built(), seed);
        let cables: Vec<Cable> = model
            .geometry()
            .cables()
            .iter()
            .zip(&params.cables)
            .map(|(cable, made)| Cable {
                anchor_m: made.anchor_m.into(),
                attachment_m: made.attachment_m.into(),
                ..*cable
            })
            .collect();
        let platform = Platform {
            mass_kg: params.platform.mass_kg,
            center_of_mass_m: params.platform.center_of_mass_m.into(),
            inertia_kg_m2: None,
        };
        let geometry = AnyRobot::new(&cables, platform).unwrap();
        let lengths = geometry.lengths_m(&home.equilibrium.pose).unwrap();
        let pairs = lengths.iter().zip(home.equilibrium.lengths_m.iter());
        Build {
            offsets_m: pairs.map(|(a, b)| a - b).collect(),
            geometry,
            // Gain and pulley against each other or together: seed by seed.
            felt: if seed.is_multiple_of(2) { 1.02 } else { 0.98 },
        }
    }

    #[test]
    fn machines_as_built_keep_within_their_tensions_where_the_builds_do() {
        let robot = Robot::built_in("lab-fast").unwrap();
        let model = Model::new(&robot).unwrap();
        let home = model.rest_at_home().unwrap();
        let reach = Reach::new(&model).unwrap();
        let mut machines = reach.clone();
        machines.builds = (1..=100).map(|seed| machine(&model, &home, seed)).collect();
        let mut random = Random::new(5);
        let (mut kept, mut left, mut out) = (0, 0, 0);
        for _ in 0..4000 {
            let Some(rest) = reach.random(&mut random) else {
                continue;
            };
            if !reach.robust(&rest) {
                left += 1;
                continue;
            }
            kept += 1;
            // The board's limits, less the errors of a sensor at the winch.
            let fine = |hung: Equilibrium| hung.tensions_n.iter().all(|t| (1.1..37.6).contains(t));
            let hung = machines.builds.iter().map(|m| machines.hung(m, &rest));
            out += hung.filter(|hung| !hung.is_some_and(fine)).count();
        }
        println!(
            "{kept} places borne, {left} not; of {} out {out}",
            kept * 100
        );
        // Random poses near the limits fail: the test can fail.
        assert!(kept > 150 && left > 10, "{kept} {left}");
        assert!(out * 2000 < kept * 100, "{out}");
    }
}
