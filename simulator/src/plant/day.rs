//! The plant at rest, for hours of work in seconds: the same cables, pulleys, friction and slow physics
//! as the plant that moves, without mass. Between two states of rest the drums turn slowly.
//!
//! The resting pose is where forces and moments of the plant's own force law vanish: Newton's method with
//! differences, from the state before. The drums are round and their play is not modelled.

use super::cable::Cable;
use super::error::PlantError;
use super::params::{MAX_CABLES, PlantParams};
use super::platform::{Body, Motion, Pose};
use super::slow::{Payload, Slow, checked};
use super::vec3::{V3, add, axpy, cross, mul, norm, q_matrix, q_mul, q_normalised, scale};

/// Forces (N), and moments over [`LEVER_M`], below this count as balanced. Cables of 50 kN/m then are
/// within a picometre; the softest swing of a platform, 20 N/m, within 5 nm.
const BALANCED_N: f64 = 1e-7;
/// Moments over this are compared with forces (m): about the size of a platform.
const LEVER_M: f64 = 0.1;
/// Drums turn by at most this between two states (m), so that Newton's method stays close and the
/// pulleys' friction follows the way.
const STEP_M: f64 = 0.01;
/// Newton's method has as many steps: it needs three or four, near a cable that becomes slack up to 25.
const NEWTON: usize = 60;
/// Friction and equilibrium are made consistent in at most this many rounds. One or two are the rule; 41 were the most in an
/// hour of eight cables.
const ROUNDS: usize = 200;
/// Friction counts as consistent within this share of its range: 0.02 mN at 10 N and 2 %.
const CONSISTENT: f64 = 1e-4;

/// What a winch does while the platform finds its rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DayHold {
    /// The drum stands at this displacement (m).
    Drum(f64),
    /// The winch holds this tension at its sensor (N).
    Tension(f64),
}

/// State of a resting robot. Entries beyond its cables are 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DayState {
    /// The platform's frame in the world.
    pub pose: Pose,
    /// Tool point, world (m).
    pub tool_position_m: [f64; 3],
    /// Cable paid out by each drum since the robot was placed (m).
    pub drum_positions_m: [f64; MAX_CABLES],
    /// Cable off the drum when it was placed, less the routing's length (m).
    pub paid_out_at_first_m: [f64; MAX_CABLES],
    /// Tension at each winch (N).
    pub tensions_winch_n: [f64; MAX_CABLES],
    /// Tension at the platform (N).
    pub tensions_platform_n: [f64; MAX_CABLES],
    /// Creep of each cable (strain, no unit).
    pub creep: [f64; MAX_CABLES],
}

/// A simulated robot that is always at rest.
#[derive(Debug, Clone)]
pub struct DayPlant {
    params: PlantParams,
    body: Body,
    motion: Motion,
    cables: Vec<Cable>,
    weight_n: V3,
    slow: Slow,
    drums_m: [f64; MAX_CABLES],
}

impl DayPlant {
    /// The robot at `pose` with cables cut so that they carry `tensions_n` there, without friction. The
    /// first [`DayPlant::rest`] finds the true rest.
    ///
    /// # Errors
    /// The first parameter out of range; [`PlantError::Length`]; [`PlantError::InsidePulley`].
    pub fn new(params: PlantParams, pose: &Pose, tensions_n: &[f64]) -> Result<Self, PlantError> {
        params.validate()?;
        let body = Body::new(&params.platform);
        let mut cables: Vec<Cable> = params
            .cables
            .iter()
            .map(|c| Cable::new(c, body.principal(c.attachment_m)))
            .collect();
        if tensions_n.len() != cables.len() {
            return Err(PlantError::Length {
                what: "tensions_n",
                given: tensions_n.len(),
                expected: cables.len(),
            });
        }
        let motion = Motion::at_rest(&body, &pose.checked()?);
        let rotation = q_matrix(motion.attitude);
        for (i, (cable, tension_n)) in cables.iter_mut().zip(tensions_n).enumerate() {
            let at = add(motion.center_m, mul(&rotation, cable.attachment));
            let path = cable.path(at, i)?;
            cable.cut_to(path.length_m, *tension_n);
        }
        Ok(Self {
            weight_n: scale(params.gravity_mps2, params.platform.mass_kg),
            slow: Slow::new(&params),
            body,
            motion,
            cables,
            params,
            drums_m: [0.0; MAX_CABLES],
        })
    }

    /// A robot in the present state of a plant that moves, taken to be at rest, drums where they are.
    #[cfg(test)]
    pub(super) fn of(plant: &super::Plant) -> Self {
        Self {
            params: plant.params.clone(),
            body: plant.body.clone(),
            motion: plant.motion,
            cables: plant.cables.clone(),
            weight_n: plant.weight_n,
            slow: plant.slow.clone(),
            drums_m: std::array::from_fn(|i| plant.winches.get(i).map_or(0.0, |w| w.drum_m)),
        }
    }

    /// Lets the winches go to `holds`, one per cable, and the platform come to rest.
    ///
    /// # Errors
    /// [`PlantError::Length`]; [`PlantError::NoEquilibrium`], also where a cable would have to push: the
    /// state then is that before.
    pub fn rest(&mut self, holds: &[DayHold]) -> Result<(), PlantError> {
        self.rest_by_way_of(holds, &mut |_| ())
    }

    /// As [`DayPlant::rest`]; `seen` gets the robot at each state of rest on the way, the last one included.
    ///
    /// # Errors
    /// As [`DayPlant::rest`].
    pub fn rest_by_way_of(
        &mut self,
        holds: &[DayHold],
        seen: &mut dyn FnMut(&Self),
    ) -> Result<(), PlantError> {
        if holds.len() != self.cables.len() {
            return Err(PlantError::Length {
                what: "holds",
                given: holds.len(),
                expected: self.cables.len(),
            });
        }
        let mut farthest = 0.0_f64;
        for (i, hold) in holds.iter().enumerate() {
            if let DayHold::Drum(to) = hold {
                farthest = farthest.max((to - self.drums_m[i]).abs());
            }
        }
        let before = self.clone();
        let (drums, cables) = (self.drums_m, self.cables.clone());
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "small"
        )]
        let steps = (farthest / STEP_M).ceil().clamp(1.0, 1000.0) as usize;
        for step in 1..=steps {
            let share = step as f64 / steps as f64;
            let mut there = [DayHold::Drum(0.0); MAX_CABLES];
            for (i, hold) in holds.iter().enumerate() {
                there[i] = match *hold {
                    DayHold::Drum(to) => DayHold::Drum(drums[i] + share * (to - drums[i])),
                    DayHold::Tension(to) => {
                        let from = cables[i].tension.winch_n;
                        DayHold::Tension(from + share * (to - from))
                    }
                };
            }
            if let Err(error) = self.small_step(&there) {
                *self = before;
                return Err(error);
            }
            seen(self);
        }
        Ok(())
    }

    fn small_step(&mut self, holds: &[DayHold; MAX_CABLES]) -> Result<(), PlantError> {
        let count = self.cables.len();
        let starts: [f64; MAX_CABLES] =
            std::array::from_fn(|i| self.cables.get(i).map_or(0.0, |c| c.friction_state));
        // Where a tension is held, friction that turns moves the cable back, and full steps would go to and fro for ever:
        // they become shorter where they change their direction.
        let mut shares = [1.0_f64; MAX_CABLES];
        let mut before = [0.0_f64; MAX_CABLES];
        let mut changed = f64::INFINITY;
        for _ in 0..ROUNDS {
            self.balance(holds)?;
            changed = 0.0;
            for (i, start) in starts.iter().enumerate().take(count) {
                let cable = &mut self.cables[i];
                if cable.loss == 0.0 {
                    continue;
                }
                let by =
                    cable.rubbed(*start, cable.paid_out(self.drums_m[i])) - cable.friction_state;
                changed = changed.max(by.abs());
                if by * before[i] < 0.0 {
                    shares[i] *= (before[i] / (before[i] - by)).clamp(0.3, 0.9);
                }
                before[i] = by;
                cable.friction_state += shares[i] * by;
            }
            if changed < CONSISTENT {
                break;
            }
        }
        if changed >= CONSISTENT {
            let share = |cable: &Cable| cable.loss * cable.tension.platform_n * changed;
            return Err(PlantError::NoEquilibrium {
                simulated_s: 0.0,
                residual_n: self.cables.iter().map(share).fold(0.0, f64::max),
            });
        }
        for (cable, drum_m) in self.cables.iter_mut().zip(self.drums_m) {
            // The state is that at the end of this way; only the way is brought up to date.
            cable.paid_out_m = cable.paid_out(drum_m);
        }
        Ok(())
    }

    /// Newton's method on forces and moments; brings tensions and held drums up to date.
    fn balance(&mut self, holds: &[DayHold; MAX_CABLES]) -> Result<(), PlantError> {
        let mut motion = self.motion;
        let mut residual = self.residual(&motion, holds)?;
        for _ in 0..NEWTON {
            let size = greatest(&residual);
            if size < BALANCED_N {
                return self.accept(motion, holds);
            }
            let mut jacobian = [[0.0; 6]; 6];
            for column in 0..6 {
                // 0.1 um: the differences keep eight digits.
                let mut twist = [0.0; 6];
                twist[column] = if column < 3 { 1e-7 } else { 1e-6 };
                let there = self.residual(&displaced(&motion, &twist), holds)?;
                for (row, line) in jacobian.iter_mut().enumerate() {
                    line[column] = (there[row] - residual[row]) / twist[column];
                }
            }
            let Some(mut step) = solve(jacobian, residual) else {
                break;
            };
            let long =
                norm([step[0], step[1], step[2]]).max(LEVER_M * norm([step[3], step[4], step[5]]));
            // Beyond 20 mm the derivatives mean little.
            let shorter = (0.02 / long).min(1.0);
            let mut better = None;
            for v in &mut step {
                *v *= -shorter;
            }
            for _ in 0..6 {
                let trial = displaced(&motion, &step);
                if let Ok(found) = self.residual(&trial, holds) {
                    let now = greatest(&found);
                    // Large residuals may rise for a while, as the cables take up the way.
                    if now < size || size > 1.0 && now < 2.0 * size {
                        better = Some((trial, found));
                        break;
                    }
                }
                for v in &mut step {
                    *v *= 0.5;
                }
            }
            match better {
                Some((next, found)) => (motion, residual) = (next, found),
                // Only rounding is left.
                None if size < 1e-5 => return self.accept(motion, holds),
                None => break,
            }
        }
        Err(PlantError::NoEquilibrium {
            simulated_s: 0.0,
            residual_n: greatest(&residual),
        })
    }

    /// Force (world) and moment about the centre of mass (world, over [`LEVER_M`]), N. A cable may push
    /// here: the search passes through such states.
    fn residual(
        &self,
        motion: &Motion,
        holds: &[DayHold; MAX_CABLES],
    ) -> Result<[f64; 6], PlantError> {
        let rotation = q_matrix(motion.attitude);
        let mut force = self.weight_n;
        let mut moment = [0.0; 3];
        for (i, cable) in self.cables.iter().enumerate() {
            let arm = mul(&rotation, cable.attachment);
            let path = cable.path(add(motion.center_m, arm), i)?;
            let pull = scale(path.direction, -pull_n(cable, holds[i], path.length_m));
            force = add(force, pull);
            moment = axpy(moment, 1.0 / LEVER_M, cross(arm, pull));
        }
        Ok([
            force[0], force[1], force[2], moment[0], moment[1], moment[2],
        ])
    }

    fn accept(&mut self, motion: Motion, holds: &[DayHold; MAX_CABLES]) -> Result<(), PlantError> {
        self.motion = motion;
        let rotation = q_matrix(motion.attitude);
        for (i, cable) in self.cables.iter_mut().enumerate() {
            let arm = mul(&rotation, cable.attachment);
            let length_m = cable.path(add(motion.center_m, arm), i)?.length_m;
            let ratio = 1.0 + cable.loss * cable.friction_state;
            self.drums_m[i] = match holds[i] {
                DayHold::Drum(drum_m) => drum_m,
                DayHold::Tension(winch_n) => {
                    // The law of the cable solved for its unstretched length.
                    let tension_n = winch_n / ratio;
                    let total = length_m + cable.routing_m;
                    let unstretched = (cable.ea_n * total
                        - tension_n * cable.routing_m * (ratio - 1.0))
                        / (cable.ea_n + tension_n);
                    (unstretched / cable.growth - cable.unstretched_zero_m) / cable.winding_gain
                }
            };
            cable.tension = cable.tension(length_m, 0.0, self.drums_m[i], 0.0);
            if cable.tension.platform_n <= 0.0 {
                return Err(PlantError::CableParameter {
                    cable: i,
                    name: "tension_n of a resting robot",
                    value: cable.tension.platform_n,
                    rule: "above 0: it became slack",
                });
            }
        }
        Ok(())
    }

    /// Lets time pass under the present tensions: cables creep and recover. The next
    /// [`DayPlant::rest`] finds the pose.
    pub fn pass(&mut self, seconds: f64) {
        self.slow.pass(&mut self.cables, seconds);
    }

    /// Temperatures of frame and cables above the reference (K).
    pub fn warm(&mut self, frame_k: f64, cable_k: f64) {
        self.slow.warm(&mut self.cables, frame_k, cable_k);
    }

    /// Moves an anchor by `by_m` (world).
    ///
    /// # Errors
    /// [`PlantError::NoSuchCable`].
    pub fn knock_anchor(&mut self, cable: usize, by_m: [f64; 3]) -> Result<(), PlantError> {
        let count = self.cables.len();
        if cable >= count {
            return Err(PlantError::NoSuchCable { cable, count });
        }
        self.slow.knock(&mut self.cables, cable, by_m);
        Ok(())
    }

    /// Takes a payload, or sets it down.
    ///
    /// # Errors
    /// As [`super::Plant::carry`].
    pub fn carry(&mut self, payload: Option<&Payload>) -> Result<(), PlantError> {
        checked(payload)?;
        let pose = self.motion.pose(&self.body);
        let platform = self.slow.loaded(payload);
        self.body = Body::new(&platform);
        self.motion = Motion::at_rest(&self.body, &pose);
        for (cable, params) in self.cables.iter_mut().zip(&self.params.cables) {
            cable.attachment = self.body.principal(params.attachment_m);
        }
        self.weight_n = scale(self.params.gravity_mps2, platform.mass_kg);
        Ok(())
    }

    /// The true state.
    #[must_use]
    pub fn state(&self) -> DayState {
        let pose = self.motion.pose(&self.body);
        let each = |of: &dyn Fn(usize, &Cable) -> f64| {
            std::array::from_fn(|i| self.cables.get(i).map_or(0.0, |cable| of(i, cable)))
        };
        DayState {
            pose,
            tool_position_m: pose.point_in_world(self.params.platform.tcp_m),
            drum_positions_m: self.drums_m,
            paid_out_at_first_m: each(&|_, c| c.unstretched_zero_m - c.routing_m),
            tensions_winch_n: each(&|_, c| c.tension.winch_n),
            tensions_platform_n: each(&|_, c| c.tension.platform_n),
            creep: each(&|i, _| self.slow.strain(i)),
        }
    }
}

/// Pull of a cable on the platform, negative where it would have to push (N).
fn pull_n(cable: &Cable, hold: DayHold, length_m: f64) -> f64 {
    let ratio = 1.0 + cable.loss * cable.friction_state;
    match hold {
        DayHold::Tension(winch_n) => winch_n / ratio,
        DayHold::Drum(drum_m) => {
            let unstretched = cable.unstretched_m(drum_m);
            cable.ea_n * (length_m + cable.routing_m - unstretched)
                / (unstretched + cable.routing_m * (ratio - 1.0))
        }
    }
}

fn greatest(values: &[f64; 6]) -> f64 {
    values.iter().fold(0.0, |most, v| v.abs().max(most))
}

/// The state moved by a small twist about the centre of mass, world (m, rad).
fn displaced(motion: &Motion, twist: &[f64; 6]) -> Motion {
    let turn = [1.0, 0.5 * twist[3], 0.5 * twist[4], 0.5 * twist[5]];
    Motion {
        center_m: add(motion.center_m, [twist[0], twist[1], twist[2]]),
        attitude: q_normalised(q_mul(turn, motion.attitude)),
        ..*motion
    }
}

/// Gauss' elimination with the largest pivot of each column.
fn solve(mut a: [[f64; 6]; 6], mut b: [f64; 6]) -> Option<[f64; 6]> {
    for column in 0..6 {
        let mut best = column;
        for row in column + 1..6 {
            if a[row][column].abs() > a[best][column].abs() {
                best = row;
            }
        }
        let pivot = a[best][column].abs();
        if pivot.is_nan() || pivot <= 1e-12 {
            return None;
        }
        a.swap(best, column);
        b.swap(best, column);
        for row in column + 1..6 {
            let factor = a[row][column] / a[column][column];
            let above = a[column];
            for (entry, over) in a[row].iter_mut().zip(above).skip(column) {
                *entry -= factor * over;
            }
            b[row] -= factor * b[column];
        }
    }
    for row in (0..6).rev() {
        let mut sum = b[row];
        for k in row + 1..6 {
            sum -= a[row][k] * b[k];
        }
        b[row] = sum / a[row][row];
    }
    Some(b)
}
