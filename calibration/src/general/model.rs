//! The rows of each reading of a sample, with derivatives by the unknowns.
//!
//! With t the cable's direction, u its arm, l its length, T its tension at the platform and H the
//! Hessian of its length: a reading of the encoder is r + (l - r)(1 - d) + o - c T (l + routing), of
//! the load cell z + (1 + g) T (1 - a m sin(w/2)), with a the sign of the last motion (+1 paid out), w
//! the wrap angle and m the loss over half a turn: the friction of a pulley's bearing is
//! proportional to the force 2 T sin(w/2) on it.

pub use super::group::{GROUPS, Group};

use super::data::{Sample, Set};
use super::unknowns::Layout;
use crate::corner::{Corner, Entry, Places, Poses, put, spread};
use crate::tilt::Attitude;
use mcdpr_kinematics::{Cable, Error, GRAVITY_MPS2, Platform, Pose, Robot};
use mcdpr_vision::Camera;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// One row, not yet divided by its scatter.
#[derive(Debug, Clone)]
pub struct Row {
    /// Its kind.
    pub group: Group,
    /// Cable or axis; for corners 8 times the view, plus twice the corner, plus the axis.
    pub index: usize,
    /// Prediction minus reading.
    pub residual: f64,
    /// Derivatives with respect to the sample's own unknowns.
    pub own: Vec<f64>,
    /// Derivatives with respect to shared unknowns.
    pub shared: Vec<Entry>,
    /// Standard deviation per scatter of the kind, and what is added to it in quadrature.
    pub scale: [f64; 2],
}

/// Values of all unknowns.
#[derive(Debug, Clone)]
pub struct State {
    /// Those of the layout; those of poses are zero.
    pub theta: Vec<f64>,
    /// camera_from_platform.
    pub camera_from_platform: Pose,
    /// world_from_body.
    pub world_from_body: Vec<Pose>,
    /// Frame of each tracker that takes part.
    pub tracker_from_world: Vec<Pose>,
    /// Attitude of its target on the platform.
    pub platform_from_target: Vec<Rotation3<f64>>,
    /// world_from_platform per sample.
    pub poses: Vec<Pose>,
    /// Tension of each cable at the platform per sample, N.
    pub tensions_n: Vec<Vec<f64>>,
}

/// All inputs of the rows besides the state.
#[derive(Debug, Clone)]
pub struct Model<'a> {
    /// The measurements.
    pub set: &'a Set,
    /// Order of the unknowns.
    pub layout: Layout,
    /// Length at which the drums' gains have no effect, m: decouples them from the offsets.
    pub middle_m: f64,
}

/// Force per speed of the fastest cable that a moving platform's inertia may need, N s/m per kg:
/// the platform swings at 1.5 rad/s and more.
const SWING_PER_S: f64 = 1.5;
/// Arm of that force, m.
const SWING_ARM_M: f64 = 0.1;

/// The direction in which a swivel sensor reads zero, and the one where it reads 90 degrees: for an
/// axis k that is not vertical straight down and k x down, otherwise x and k x x.
#[must_use]
pub(crate) fn swivel_reference(axis: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let k = axis.normalize();
    let aim = if k.z.abs() < 0.9 {
        -Vector3::z()
    } else {
        Vector3::x()
    };
    let first = (aim - k * aim.dot(&k)).normalize();
    [first, k.cross(&first)]
}

/// A cable's geometry at a pose.
struct Path {
    length_m: f64,
    wrap_rad: f64,
    t: Vector3<f64>,
    u: Vector3<f64>,
    by_radius: f64,
    turn: Matrix3<f64>,
    turn_by_radius: Vector3<f64>,
}

impl Path {
    fn new(cable: Cable, pose: &Pose) -> Result<Self, Error> {
        let platform = Platform {
            mass_kg: 1.0,
            center_of_mass_m: Vector3::zeros(),
            inertia_kg_m2: None,
        };
        let robot = Robot::new([cable], platform)?;
        let inverse = robot.inverse(pose)?;
        let (sin, cos) = (inverse.wrap_sin[0], inverse.wrap_cos[0]);
        let [cable] = robot.cables();
        let across = inverse.swivel_direction(0) * cos - cable.swivel_axis * sin;
        Ok(Self {
            length_m: inverse.lengths_m[0],
            wrap_rad: inverse.wraps_rad[0],
            t: inverse.direction(0),
            u: inverse.arm_m(0),
            by_radius: inverse.wraps_rad[0] - sin,
            turn: inverse.point_hessian(&robot, 0),
            turn_by_radius: across * ((1.0 - cos) / inverse.free_lengths_m[0]),
        })
    }
}

pub(super) fn three(theta: &[f64], at: usize) -> Vector3<f64> {
    Vector3::new(theta[at], theta[at + 1], theta[at + 2])
}

impl Model<'_> {
    /// A cable with its current anchor, radius and attachment.
    #[must_use]
    pub fn cable(&self, theta: &[f64], i: usize) -> Cable {
        let nominal = self.set.robot.cables[i];
        Cable {
            anchor_m: nominal.anchor_m + three(theta, self.layout.anchor(i)),
            attachment_m: nominal.attachment_m + three(theta, self.layout.attachment(i)),
            // A step may make the radius of a small pulley negative, which has no geometry.
            pulley_radius_m: (nominal.pulley_radius_m + theta[self.layout.radius(i)]).max(0.0),
            ..nominal
        }
    }

    /// The lens with its current intrinsics.
    #[must_use]
    pub fn lens(&self, theta: &[f64]) -> Option<Camera> {
        let mut camera = self.set.eye.as_ref()?.camera;
        let at = self.layout.camera() + 6;
        for k in 0..2 {
            camera.focal_px[k] *= 1.0 + theta[at];
            camera.center_px[k] += theta[at + 1 + k];
        }
        camera.distortion[0] += theta[at + 3];
        Some(camera)
    }

    /// The rows of a sample at a pose with these tensions; missing readings have no row.
    ///
    /// # Errors
    /// [`Error`] if a cable has no geometry at the pose, or a corner is behind the camera.
    pub fn rows(
        &self,
        state: &State,
        sample: &Sample,
        k: usize,
        pose: &Pose,
        tensions_n: &[f64],
    ) -> Result<Vec<Row>, Error> {
        let (layout, theta) = (&self.layout, &state.theta);
        let mut out = Vec::with_capacity(6 + 3 * layout.cables + 3 + 8 * sample.views.len());
        let slot = layout.slot(sample.session);
        let paths = (0..layout.cables)
            .map(|i| Path::new(self.cable(theta, i), pose))
            .collect::<Result<Vec<_>, _>>()?;
        let r = pose.rotation.matrix();
        let own = || vec![0.0; layout.own()];
        for (i, path) in paths.iter().enumerate() {
            let d = pose.position_m + path.u - self.cable(theta, i).anchor_m;
            if let Some(reading) = sample.length_m[i] {
                out.push(self.length(
                    theta,
                    slot,
                    sample.session,
                    k,
                    i,
                    path,
                    r,
                    tensions_n[i],
                    reading,
                ));
            }
            if let Some(reading) = sample.tension_n[i] {
                let sign = sample.arrived[i].unwrap_or(0.0);
                let gain = 1.0 + theta[layout.gain(i)];
                let feels = (path.wrap_rad / 2.0).sin();
                // When cable is paid out, the pulley's friction carries a part: the winch reads
                // less.
                let kept = 1.0 - sign * theta[layout.loss(i)] * feels;
                let tension = tensions_n[i];
                let mut own = own();
                own[6 + i] = gain * kept;
                let mut shared = vec![
                    Entry::new(layout.zero(i), 1.0),
                    Entry::new(layout.gain(i), tension * kept),
                    Entry::new(layout.loss(i), -gain * tension * sign * feels),
                ];
                let mut zero = theta[layout.zero(i)];
                if let Some(slot) = slot {
                    let at = layout.zero_of(slot, i);
                    zero += theta[at];
                    shared.push(Entry::new(at, 1.0));
                }
                // If the direction of the cable's last motion is unknown, its loss counts as
                // scatter.
                let unsure = if sample.arrived[i].is_none() {
                    0.02 * tension * feels
                } else {
                    0.0
                };
                out.push(Row {
                    group: Group::Tension,
                    index: i,
                    residual: zero + gain * tension * kept - reading,
                    own,
                    shared,
                    scale: [sample.noise_factor, unsure],
                });
            }
            if let Some(reading) = sample.swivel_rad[i] {
                let [first, second] = swivel_reference(&self.set.robot.cables[i].swivel_axis);
                let (x, y) = (d.dot(&first), d.dot(&second));
                let by = (second * x - first * y) / (x * x + y * y);
                let mut own = own();
                put(&mut own, 0, &by);
                put(&mut own, 3, &path.u.cross(&by));
                let mut shared = vec![Entry::new(layout.swivel(i), 1.0)];
                spread(&mut shared, layout.anchor(i), &-by);
                spread(&mut shared, layout.attachment(i), &r.tr_mul(&by));
                let mut offset = theta[layout.swivel(i)];
                if let Some(slot) = slot {
                    let at = layout.swivel_of(slot, i);
                    offset += theta[at];
                    shared.push(Entry::new(at, 1.0));
                }
                out.push(Row {
                    group: Group::Swivel,
                    index: i,
                    // A difference across 180 degrees must not count as a whole turn.
                    residual: turned(y.atan2(x) + offset - reading),
                    own,
                    shared,
                    scale: [1.0, 0.0],
                });
            }
        }
        self.attitude(theta, slot, sample, pose, &mut out);
        self.balance(theta, sample, pose, tensions_n, &paths, &mut out);
        self.corners(state, sample, pose, &mut out)?;
        self.outside(state, sample, pose, &mut out);
        Ok(out)
    }

    #[allow(clippy::too_many_arguments)]
    fn length(
        &self,
        theta: &[f64],
        slot: Option<usize>,
        session: usize,
        k: usize,
        i: usize,
        path: &Path,
        r: &Matrix3<f64>,
        tension: f64,
        reading: f64,
    ) -> Row {
        let layout = &self.layout;
        let compliance = theta[layout.compliance()] + theta[layout.own_compliance(i)];
        let stretching = path.length_m + self.set.robot.routing_m[i];
        // About the middle length a drum's gain does not act like an offset.
        let beyond = path.length_m - self.middle_m;
        let drum = theta[layout.drum(i)];
        let slope = 1.0 - drum - compliance * tension;
        let mut own = vec![0.0; layout.own()];
        put(&mut own, 0, &(path.t * slope));
        put(&mut own, 3, &(path.u.cross(&path.t) * slope));
        own[6 + i] = -compliance * stretching;
        let mut shared = vec![
            Entry::new(layout.drum(i), -beyond),
            Entry::new(layout.offset(i), 1.0),
            Entry::new(layout.compliance(), -tension * stretching),
            Entry::new(layout.own_compliance(i), -tension * stretching),
            Entry::new(layout.radius(i), path.by_radius * slope),
        ];
        spread(&mut shared, layout.anchor(i), &(path.t * -slope));
        spread(
            &mut shared,
            layout.attachment(i),
            &(r.tr_mul(&path.t) * slope),
        );
        let mut offset = theta[layout.offset(i)];
        if let Some(slot) = slot {
            let at = layout.offset_of(slot, i);
            offset += theta[at];
            shared.push(Entry::new(at, 1.0));
        }
        for (j, jump) in layout.breaks.iter().enumerate() {
            if jump.cable == i && jump.session == session && k >= jump.from {
                offset += theta[layout.jump(j)];
                shared.push(Entry::new(layout.jump(j), 1.0));
            }
        }
        let predicted =
            self.middle_m + beyond * (1.0 - drum) + offset - compliance * tension * stretching;
        Row {
            group: Group::Length,
            index: i,
            residual: predicted - reading,
            own,
            shared,
            scale: [1.0, 0.0],
        }
    }

    fn attitude(
        &self,
        theta: &[f64],
        slot: Option<usize>,
        sample: &Sample,
        pose: &Pose,
        out: &mut Vec<Row>,
    ) {
        if sample.rpy_rad.iter().all(Option::is_none) {
            return;
        }
        let layout = &self.layout;
        let mut mount = three(theta, layout.mount());
        if let Some(slot) = slot {
            for k in 0..2 {
                mount[k] += theta[layout.mount_of(slot) + k];
            }
        }
        let Some(seen) = Attitude::of(pose, mount) else {
            return;
        };
        let (by_turn, by_mount) = (seen.by_turn, seen.by_mount);
        for axis in 0..3 {
            let Some(reading) = sample.rpy_rad[axis] else {
                continue;
            };
            let mut own = vec![0.0; layout.own()];
            put(&mut own, 3, &by_turn.row(axis).transpose());
            let mut shared = Vec::with_capacity(7);
            spread(&mut shared, layout.mount(), &by_mount.row(axis).transpose());
            let mut predicted = seen.rpy_rad[axis];
            if let Some(slot) = slot {
                for k in 0..2 {
                    shared.push(Entry::new(layout.mount_of(slot) + k, by_mount[(axis, k)]));
                }
                if axis == 2 {
                    let at = layout.yaw_of(slot);
                    let time = sample.time_s.unwrap_or(0.0);
                    predicted += theta[at] + theta[at + 1] * time;
                    shared.push(Entry::new(at, 1.0));
                    shared.push(Entry::new(at + 1, time));
                }
            }
            out.push(Row {
                group: if axis < 2 { Group::Tilt } else { Group::Yaw },
                index: axis,
                residual: turned(predicted - reading),
                own,
                shared,
                scale: [1.0, 0.0],
            });
        }
    }

    /// The six equations of equilibrium: forces, and moments about the centre of mass, world axes.
    fn balance(
        &self,
        theta: &[f64],
        sample: &Sample,
        pose: &Pose,
        tensions_n: &[f64],
        paths: &[Path],
        out: &mut Vec<Row>,
    ) {
        let layout = &self.layout;
        let r = pose.rotation.matrix();
        let center = r * (self.set.robot.center_of_mass_m + three(theta, layout.center_of_mass()));
        let down = Vector3::z() * -(GRAVITY_MPS2 * self.set.robot.mass_kg);
        let mut force = down * (1.0 + theta[layout.mass()]);
        let mut moment = Vector3::zeros();
        let mut pull = Vector3::zeros();
        // Columns: the six unknowns of the pose, then the tensions.
        let mut own = vec![[Vector3::zeros(); 2]; layout.own()];
        let mut shared: Vec<(usize, [Vector3<f64>; 2])> =
            vec![(layout.mass(), [down, Vector3::zeros()])];
        let mut spread = |at: usize, force: &Matrix3<f64>, moment: &Matrix3<f64>| {
            for j in 0..3 {
                shared.push((at + j, [force.column(j).into(), moment.column(j).into()]));
            }
        };
        let mut radius = Vec::with_capacity(paths.len());
        for (i, path) in paths.iter().enumerate() {
            let tension = tensions_n[i];
            let (t, arm) = (&path.t, path.u - center);
            force -= t * tension;
            moment -= arm.cross(t) * tension;
            pull += t * tension;
            own[6 + i] = [-t, -arm.cross(t)];
            let (cross_arm, cross_t) = (arm.cross_matrix(), t.cross_matrix());
            let force_by_place = path.turn * -tension;
            let moment_by_place = cross_arm * force_by_place;
            let turn = -path.u.cross_matrix();
            let force_by_turn = force_by_place * turn;
            let moment_by_turn = moment_by_place * turn - cross_t * tension * arm.cross_matrix();
            for j in 0..3 {
                own[j][0] += force_by_place.column(j);
                own[j][1] += moment_by_place.column(j);
                own[3 + j][0] += force_by_turn.column(j);
                own[3 + j][1] += moment_by_turn.column(j);
            }
            spread(layout.anchor(i), &-force_by_place, &-moment_by_place);
            let moment_by_attachment = moment_by_place + cross_t * tension;
            spread(
                layout.attachment(i),
                &(force_by_place * r),
                &(moment_by_attachment * r),
            );
            let by_radius = path.turn_by_radius * -tension;
            radius.push((layout.radius(i), [by_radius, arm.cross(&by_radius)]));
        }
        spread(
            layout.center_of_mass(),
            &Matrix3::zeros(),
            &(-pull.cross_matrix() * r),
        );
        shared.extend(radius);
        // In motion the inertia takes part of the balance: it counts as scatter, not as a force.
        let swing = sample.speed_mps.unwrap_or(0.0) * SWING_PER_S * self.set.robot.mass_kg;
        for (block, (group, residual, extra)) in [
            (Group::Force, force, swing),
            (Group::Moment, moment, swing * SWING_ARM_M),
        ]
        .into_iter()
        .enumerate()
        {
            for axis in 0..3 {
                out.push(Row {
                    group,
                    index: axis,
                    residual: residual[axis],
                    own: own.iter().map(|column| column[block][axis]).collect(),
                    shared: shared
                        .iter()
                        .map(|(at, by)| Entry::new(*at, by[block][axis]))
                        .collect(),
                    scale: [sample.noise_factor, extra],
                });
            }
        }
    }

    fn corners(
        &self,
        state: &State,
        sample: &Sample,
        pose: &Pose,
        out: &mut Vec<Row>,
    ) -> Result<(), Error> {
        let (layout, theta) = (&self.layout, &state.theta);
        let (Some(eye), Some(lens)) = (&self.set.eye, self.lens(theta)) else {
            return Ok(());
        };
        let at = layout.camera();
        let scale = 1.0 + theta[at + 10];
        let camera_from_world =
            state.camera_from_platform.rotation.matrix() * pose.rotation.matrix().transpose();
        for (v, view) in sample.views.iter().enumerate() {
            let tag = &eye.tags[view.tag];
            let body = &state.world_from_body[tag.body];
            let at_places = Places {
                camera: at,
                body: layout.body(tag.body),
            };
            for (c, (corner, pixel)) in tag
                .corners_in_body_m
                .iter()
                .zip(view.corners_px)
                .enumerate()
            {
                let poses = Poses {
                    world_from_platform: pose,
                    camera_from_platform: &state.camera_from_platform,
                    world_from_body: body,
                };
                let corner = Corner::new(&lens, &camera_from_world, poses, corner, scale)?;
                let seen = &corner.seen;
                for (axis, measured) in pixel.iter().enumerate() {
                    let mut own = vec![0.0; layout.own()];
                    let mut shared = Vec::with_capacity(16);
                    let by_world = corner.derivatives(axis, 1.0, &mut own, &mut shared, &at_places);
                    // `by_focal` is per change of the present focal length; the unknown is a share
                    // of the stated one.
                    let focal = 1.0 / (1.0 + theta[at + 6]);
                    shared.push(Entry::new(at + 6, seen.by_focal[axis] * focal));
                    shared.push(Entry::new(at + 7 + axis, 1.0));
                    shared.push(Entry::new(at + 9, seen.by_k1[axis]));
                    shared.push(Entry::new(at + 10, by_world.dot(&corner.arm)));
                    out.push(Row {
                        group: Group::Corner,
                        index: 8 * v + 2 * c + axis,
                        residual: seen.pixel[axis] - measured,
                        own,
                        shared,
                        scale: [sample.noise_factor, 0.0],
                    });
                }
            }
        }
        Ok(())
    }

    /// The state after a step of the shared unknowns; the samples' own are stepped apart.
    #[must_use]
    pub fn stepped(&self, state: &State, shared: &[f64]) -> State {
        let mut out = state.clone();
        for (value, step) in out.theta.iter_mut().zip(shared) {
            *value += step;
        }
        if let Some(bodies) = self.layout.bodies {
            let mut place = |pose: &Pose, at: usize| {
                let moved = pose.displaced(&three(shared, at), &three(shared, at + 3));
                // The step is in the pose now: counted again from the vector it would act twice.
                out.theta[at..at + 6].fill(0.0);
                moved
            };
            let camera = place(&state.camera_from_platform, self.layout.camera());
            let moved: Vec<Pose> = (0..bodies)
                .map(|b| place(&state.world_from_body[b], self.layout.body(b)))
                .collect();
            out.camera_from_platform = camera;
            out.world_from_body = moved;
        }
        for slot in 0..self.layout.trackers.len() {
            let (frame, turn) = (self.layout.frame(slot), self.layout.target_turn(slot));
            let moved = state.tracker_from_world[slot]
                .displaced(&three(shared, frame), &three(shared, frame + 3));
            out.tracker_from_world[slot] = moved;
            out.platform_from_target[slot] =
                Rotation3::new(three(shared, turn)) * state.platform_from_target[slot];
            out.theta[frame..frame + 6].fill(0.0);
            out.theta[turn..turn + 3].fill(0.0);
        }
        out
    }
}

/// A pose and tensions after a step of a sample's own unknowns.
#[must_use]
pub(crate) fn stepped_own(pose: &Pose, tensions_n: &[f64], step: &[f64]) -> (Pose, Vec<f64>) {
    let pose = pose.displaced(&three(step, 0), &three(step, 3));
    let tensions = tensions_n.iter().zip(&step[6..]).map(|(t, s)| t + s);
    (pose, tensions.collect())
}

/// An angle brought into +-180 degrees.
fn turned(angle: f64) -> f64 {
    let whole = std::f64::consts::TAU;
    angle - (angle / whole).round() * whole
}
