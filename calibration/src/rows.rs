//! The rows of the joint estimate: each measurement as a function of the unknowns.
//!
//! Every row is whitened (divided by its standard deviation). Displacements of poses are those of
//! [`Pose::displaced`]. With t, u the direction and arm of a cable, H the Hessian of its length:
//! a change dA of the attachment's place and dB of the anchor turn t by H (dA - dB), a change of the
//! pulley's radius by (1 - cos theta)/s n.

use super::corner::{Corner, Entry, Places, Poses, put, spread};
use super::data::Data;
use super::stretch::encoder_sigmas_m;
use super::tilt::Attitude;
use super::unknowns::{Layout, State};
use mcdpr_kinematics::{Error, GRAVITY_MPS2, Inverse, Pose, Robot};
use nalgebra::{Matrix3, Vector3};

/// Most unknowns of one pose: its place and attitude, and its tensions.
pub(super) const OWN_MAX: usize = 6 + mcdpr_kinematics::MAX_CABLES;

/// Source of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// A cable's encoder (index of the cable).
    Encoder(usize),
    /// A cable's tension sensor (index of the cable).
    Tension(usize),
    /// The inclinometer: 0 = roll, 1 = pitch.
    Tilt(usize),
    /// Equilibrium: force x, y, z, moment x, y, z.
    Balance(usize),
    /// A corner: index into the pose's views, corner, axis (0 = u, 1 = v).
    Corner(usize, usize, usize),
}

/// One whitened row: residual = prediction minus measurement.
#[derive(Debug)]
pub struct Row<'a> {
    /// Its source.
    pub source: Source,
    /// Residual in standard deviations.
    pub residual: f64,
    /// Derivatives with respect to the pose's own unknowns, dense.
    pub own: &'a [f64],
    /// Derivatives with respect to shared unknowns.
    pub shared: &'a [Entry],
}

/// Standard deviations of the rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scatter {
    /// Force balance, N: the disturbance of the platform at rest; level and vertical.
    pub force_n: [f64; 2],
    /// Moment balance, N m; about level axes and about the vertical.
    pub moment_nm: [f64; 2],
    /// Relative uncertainty of a tension due to the sensor's position behind the pulley.
    pub tension_relative: f64,
}

impl Default for Scatter {
    fn default() -> Self {
        Self {
            force_n: [2e-3; 2],
            moment_nm: [1e-4; 2],
            tension_relative: 0.0,
        }
    }
}

/// All inputs of the rows besides the state.
#[derive(Debug, Clone)]
pub struct Model<'a> {
    /// The measurements.
    pub data: &'a Data,
    /// Order of the unknowns.
    pub layout: Layout,
    /// Scatter of the rows for which no sensor noise is stated.
    pub scatter: Scatter,
    /// The same as assumed before the data: it is widened by the data, and never below this.
    pub assumed: Scatter,
    /// Standard deviations of the encoders' lengths, m, by pose and cable.
    encoder_sigmas_m: Vec<Vec<f64>>,
}

/// One cable as a separate robot: the kinematics crate's closed form for any number of cables.
pub(crate) fn singles(state: &State) -> Result<Vec<Robot<1>>, Error> {
    super::lengths::singles(&state.cables)
}

/// A cable's geometry at a pose.
struct Path {
    length_m: f64,
    t: Vector3<f64>,
    u: Vector3<f64>,
    /// dL/d(radius) = theta - sin theta.
    by_radius: f64,
    /// dL/d(attachment) = R^T t.
    by_attachment: Vector3<f64>,
    turn: Matrix3<f64>,
    turn_by_radius: Vector3<f64>,
}

fn path(robot: &Robot<1>, pose: &Pose, statics: bool) -> Result<Path, Error> {
    let inverse: Inverse<1> = robot.inverse(pose)?;
    let (mut turn, mut turn_by_radius) = (Matrix3::zeros(), Vector3::zeros());
    if statics {
        turn = inverse.point_hessian(robot, 0);
        let [cable] = robot.cables();
        let (sin, cos) = (inverse.wrap_sin[0], inverse.wrap_cos[0]);
        let across = inverse.swivel_direction(0) * cos - cable.swivel_axis * sin;
        turn_by_radius = across * ((1.0 - cos) / inverse.free_lengths_m[0]);
    }
    Ok(Path {
        length_m: inverse.lengths_m[0],
        t: inverse.direction(0),
        u: inverse.arm_m(0),
        by_radius: inverse.wraps_rad[0] - inverse.wrap_sin[0],
        by_attachment: pose
            .rotation
            .inverse_transform_vector(&inverse.direction(0)),
        turn,
        turn_by_radius,
    })
}

impl<'a> Model<'a> {
    /// The rows of these measurements.
    #[must_use]
    pub fn new(data: &'a Data, layout: Layout, scatter: Scatter) -> Self {
        Self {
            data,
            layout,
            scatter,
            assumed: scatter,
            encoder_sigmas_m: encoder_sigmas_m(data, layout.statics),
        }
    }
}

impl Model<'_> {
    /// At least as many as one pose has rows: lists of that size do not grow.
    pub(crate) fn row_bound(&self, k: usize) -> usize {
        2 * self.layout.cables + 8 + 8 * self.data.poses[k].views.len()
    }

    /// Calls `take` with every row of one pose, always in the same order.
    ///
    /// # Errors
    /// [`Error`] where a cable has no geometry at the pose, or a corner is behind the camera.
    pub fn rows(
        &self,
        state: &State,
        cables: &[Robot<1>],
        k: usize,
        mut take: impl FnMut(&Row<'_>),
    ) -> Result<(), Error> {
        let pose = &state.poses[k];
        let seen = &self.data.poses[k];
        let statics = self.layout.statics && seen.tension_n.is_some();
        let mut own = vec![0.0; self.layout.local()];
        let mut shared: Vec<Entry> = Vec::with_capacity(64);
        let mut paths = [const { None }; mcdpr_kinematics::MAX_CABLES];
        for (slot, cable) in paths.iter_mut().zip(cables) {
            *slot = Some(path(cable, pose, statics)?);
        }
        let paths = paths.iter().flatten();

        let s = self.layout.scales();
        for (i, path) in paths.clone().enumerate() {
            let Some(reading) = seen.encoder_m[i] else {
                continue;
            };
            let tension = match (&seen.tension_n, self.layout.statics) {
                (Some(t), true) => t[i],
                _ => 0.0,
            };
            let weight = 1.0 / self.encoder_sigmas_m[k][i];
            // The encoder measures the paid-out length, without the stretch.
            let taut = 1.0 - state.compliance(i) * tension;
            own.fill(0.0);
            put(&mut own, 0, &(path.t * (taut * weight)));
            put(&mut own, 3, &(path.u.cross(&path.t) * (taut * weight)));
            shared.clear();
            spread(
                &mut shared,
                self.layout.anchor(i),
                &(path.t * (-taut * weight)),
            );
            spread(
                &mut shared,
                self.layout.attachment(i),
                &(path.by_attachment * (taut * weight)),
            );
            shared.push(Entry::new(
                self.layout.radius(i),
                path.by_radius * taut * weight,
            ));
            shared.push(Entry::new(self.layout.initial_length(i), -weight));
            shared.push(Entry::new(s, -reading * weight));
            shared.push(Entry::new(self.layout.drum(i), -reading * weight));
            if self.layout.statics {
                let stretching = path.length_m + state.routing_m[i];
                let by_compliance = -stretching * tension * weight;
                shared.push(Entry::new(self.layout.statics(), by_compliance));
                shared.push(Entry::new(self.layout.soft(i), by_compliance));
            }
            // The length off the drum, less the routing's nominal length: (L + r)(1 - c T) - r.
            let stretch = state.compliance(i) * tension * state.routing_m[i];
            let predicted = path.length_m * taut - stretch - state.initial_length_m[i];
            take(&Row {
                source: Source::Encoder(i),
                residual: (predicted - state.scale(i) * reading) * weight,
                own: &own,
                shared: &shared,
            });
        }
        if let (true, Some(tension_n), Some(sigma)) =
            (statics, &seen.tension_n, self.data.noise.tension_n)
        {
            for (i, reading) in tension_n.iter().enumerate() {
                // The relative part is the friction of the pulleys between sensor and platform.
                let weight = 1.0
                    / (sigma.hypot(self.scatter.tension_relative * reading) * seen.noise_factor);
                own.fill(0.0);
                own[6 + i] = weight;
                shared.clear();
                shared.push(Entry::new(self.layout.loss(i), reading * weight));
                shared.push(Entry::new(self.layout.zero(i), weight));
                let expected = reading * (1.0 - state.loss[i]) - state.zero_n[i];
                take(&Row {
                    source: Source::Tension(i),
                    residual: (state.tensions_n[k][i] - expected) * weight,
                    own: &own,
                    shared: &shared,
                });
            }
            self.balance(state, k, paths, (&mut own[..], &mut shared), &mut take);
        }
        self.tilt(state, k, &mut own, &mut shared, &mut take);
        self.corners(state, k, &mut own, &mut shared, &mut take)
    }

    /// Roll and pitch of an inclinometer on the platform.
    fn tilt(
        &self,
        state: &State,
        k: usize,
        own: &mut [f64],
        shared: &mut Vec<Entry>,
        take: &mut impl FnMut(&Row<'_>),
    ) {
        let seen = &self.data.poses[k];
        let (true, Some(reading), Some(sigma)) =
            (self.layout.tilt, seen.tilt_rad, self.data.noise.tilt_rad)
        else {
            return;
        };
        let Some(attitude) = Attitude::of(&state.poses[k], state.mount_rad) else {
            return;
        };
        let weight = 1.0 / (sigma * seen.noise_factor);
        for (axis, reading) in reading.iter().enumerate() {
            own.fill(0.0);
            put(own, 3, &(attitude.by_turn.row(axis).transpose() * weight));
            shared.clear();
            let by_mount = attitude.by_mount.row(axis).transpose() * weight;
            spread(shared, self.layout.mount(), &by_mount);
            take(&Row {
                source: Source::Tilt(axis),
                residual: (attitude.rpy_rad[axis] - reading) * weight,
                own,
                shared,
            });
        }
    }

    /// The six equations of equilibrium about the platform's origin, world axes.
    fn balance<'p>(
        &self,
        state: &State,
        k: usize,
        paths: impl Iterator<Item = &'p Path>,
        (row_own, row_shared): (&mut [f64], &mut Vec<Entry>),
        take: &mut impl FnMut(&Row<'_>),
    ) {
        let (layout, pose) = (&self.layout, &state.poses[k]);
        let r = pose.rotation.matrix();
        let factor = self.data.poses[k].noise_factor;
        let sigmas = [self.scatter.force_n, self.scatter.moment_nm];
        let weight = sigmas
            .map(|[level, vertical]| [level, level, vertical].map(|sigma| 1.0 / (sigma * factor)));
        let down = Vector3::z() * -GRAVITY_MPS2;
        let arm = r * state.center_of_mass_m;
        let load = down * state.mass_kg;
        let mut residual = [load, arm.cross(&load)];
        // Per block (force, moment): the derivatives by the shared unknowns, six rows at a time.
        let mut own = [[[0.0; 3]; 6 + mcdpr_kinematics::MAX_CABLES]; 2];
        let mut shared: Vec<(usize, [Vector3<f64>; 2])> = Vec::with_capacity(64);
        // d(arm x load) = -load x d(arm), d(arm) = phi x arm + R dc.
        let by_arm = -load.cross_matrix();
        add_own(&mut own, 1, 3, &(by_arm * -arm.cross_matrix()));
        let s = layout.statics();
        shared.push((s + 1, [down, arm.cross(&down)]));
        let by_center = by_arm * r;
        for j in 0..3 {
            shared.push((
                s + 2 + j,
                [Vector3::zeros(), by_center.column(j).into_owned()],
            ));
        }
        for (i, path) in paths.enumerate() {
            let tension = state.tensions_n[k][i];
            let (t, u) = (&path.t, &path.u);
            let moment = u.cross(t);
            residual[0] -= t * tension;
            residual[1] -= moment * tension;
            let (cross_t, cross_u) = (t.cross_matrix(), u.cross_matrix());
            let force_by_place = path.turn * -tension;
            let moment_by_place = cross_u * force_by_place;
            // If the arm changes by du (the attachment moves along), T [t]x du is added to the
            // moment.
            let moment_by_arm = cross_t * tension + moment_by_place;
            add_own(&mut own, 0, 0, &force_by_place);
            add_own(&mut own, 0, 3, &(force_by_place * -cross_u));
            add_own(&mut own, 1, 0, &moment_by_place);
            add_own(&mut own, 1, 3, &(moment_by_arm * -cross_u));
            for (block, by) in [-t, -moment].iter().enumerate() {
                own_column(&mut own[block], 6 + i, by);
            }
            let (a, b) = (force_by_place * r, moment_by_arm * r);
            for j in 0..3 {
                shared.push((
                    layout.anchor(i) + j,
                    [
                        -force_by_place.column(j).into_owned(),
                        -moment_by_place.column(j).into_owned(),
                    ],
                ));
                shared.push((
                    layout.attachment(i) + j,
                    [a.column(j).into_owned(), b.column(j).into_owned()],
                ));
            }
            let by_radius = path.turn_by_radius * -tension;
            shared.push((layout.radius(i), [by_radius, u.cross(&by_radius)]));
        }
        for axis in 0..6 {
            let (block, i) = (axis / 3, axis % 3);
            for (slot, column) in row_own.iter_mut().zip(&own[block]) {
                *slot = column[i] * weight[block][i];
            }
            row_shared.clear();
            row_shared.extend(
                shared
                    .iter()
                    .map(|(index, by)| Entry::new(*index, by[block][i] * weight[block][i])),
            );
            take(&Row {
                source: Source::Balance(axis),
                residual: residual[block][i] * weight[block][i],
                own: row_own,
                shared: row_shared,
            });
        }
    }

    fn corners(
        &self,
        state: &State,
        k: usize,
        own: &mut [f64],
        shared: &mut Vec<Entry>,
        take: &mut impl FnMut(&Row<'_>),
    ) -> Result<(), Error> {
        let (layout, pose) = (&self.layout, &state.poses[k]);
        let weight = 1.0 / (self.data.noise.corner_px * self.data.poses[k].noise_factor);
        let s = layout.scales();
        let camera_r = *state.camera_from_platform.rotation.matrix();
        let camera_from_world = camera_r * pose.rotation.matrix().transpose();
        own.fill(0.0);
        for (v, view) in self.data.poses[k].views.iter().enumerate() {
            let tag = &self.data.tags[view.tag];
            let body = &state.world_from_body[tag.body];
            let at = Places {
                camera: layout.camera(),
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
                let camera = &state.camera;
                let corner =
                    Corner::new(camera, &camera_from_world, poses, corner, state.tag_scale)?;
                let seen = &corner.seen;
                for (axis, measured) in pixel.iter().enumerate() {
                    let by_world = corner.derivatives(axis, weight, own, shared, &at);
                    // `by_focal` is per change of the present focal length; the unknown is a share
                    // of the stated one.
                    let nominal = self.data.camera.focal_px[axis] / state.camera.focal_px[axis];
                    shared.extend([
                        Entry::new(s + 1, seen.by_focal[axis] * nominal * weight),
                        Entry::new(s + 2 + axis, weight),
                        Entry::new(s + 4, seen.by_k1[axis] * weight),
                        Entry::new(s + 5, by_world.dot(&corner.arm)),
                    ]);
                    take(&Row {
                        source: Source::Corner(v, c, axis),
                        residual: (seen.pixel[axis] - measured) * weight,
                        own,
                        shared,
                    });
                }
            }
        }
        Ok(())
    }
}

/// Derivatives of a pose's own unknowns: force and moment, columns of three.
type OwnColumns = [[[f64; 3]; 6 + mcdpr_kinematics::MAX_CABLES]; 2];

fn add_own(own: &mut OwnColumns, block: usize, at: usize, m: &Matrix3<f64>) {
    for j in 0..3 {
        for i in 0..3 {
            own[block][at + j][i] += m[(i, j)];
        }
    }
}

fn own_column(own: &mut [[f64; 3]], at: usize, by: &Vector3<f64>) {
    own[at] = [by.x, by.y, by.z];
}

#[cfg(test)]
mod tests {
    use super::super::simulate::{Setup, Silent, Target, simulate};
    use super::super::unknowns::State;
    use super::*;

    /// A state off every nominal value, so that every derivative matters.
    fn case(data: &Data, layout: &Layout) -> State {
        let usable = super::super::check::usable(data).unwrap();
        let mut state = super::super::fit::start(&usable, layout);
        let wave = |k: usize, size: f64| (k as f64 * 1.7 + 0.3).sin() * size;
        let shared: Vec<f64> = (0..layout.len()).map(|k| wave(k, 1e-3)).collect();
        let own: Vec<f64> = (0..layout.local() * data.poses.len())
            .map(|k| wave(k, 2e-3))
            .collect();
        state = state.stepped(data, layout, &shared, &own);
        state.loss[1] = 0.01;
        state.zero_n[2] = 0.3;
        state.drum_own[0] = 0.02;
        state.soft_per_n[3] = 1e-5;
        state.compliance_per_n = 2e-5;
        state
    }

    fn residuals(model: &Model<'_>, state: &State, k: usize) -> Vec<f64> {
        let mut out = Vec::new();
        let cables = singles(state).unwrap();
        model
            .rows(state, &cables, k, |row| out.push(row.residual))
            .unwrap();
        out
    }

    #[test]
    fn every_derivative_matches_differences() {
        let setup = Setup {
            target: Target::Loose,
            poses: 8,
            tilt_rad: Some(1e-3),
            silent: Silent {
                k1: 0.01,
                ..Silent::default()
            },
            ..Setup::default()
        };
        let (data, _) = simulate(&setup).unwrap();
        let layout = Layout {
            cables: 4,
            bodies: 3,
            statics: true,
            tilt: true,
        };
        let model = Model::new(&data, layout, Scatter::default());
        let state = case(&data, &layout);
        let (own, shared) = (layout.local(), layout.len());
        for k in 0..data.poses.len() {
            let mut rows: Vec<(Source, Vec<f64>)> = Vec::new();
            model
                .rows(&state, &singles(&state).unwrap(), k, |row| {
                    let mut dense = vec![0.0; own + shared];
                    dense[..own].copy_from_slice(row.own);
                    for &Entry {
                        at: j,
                        slope: value,
                    } in row.shared
                    {
                        dense[own + j] += value;
                    }
                    rows.push((row.source, dense));
                })
                .unwrap();
            for j in 0..own + shared {
                let moved = |step: f64| {
                    let mut a = vec![0.0; shared];
                    let mut b = vec![0.0; own * data.poses.len()];
                    if j < own {
                        b[own * k + j] = step;
                    } else {
                        a[j - own] = step;
                    }
                    residuals(&model, &state.stepped(&data, &layout, &a, &b), k)
                };
                let (up, down) = (moved(1e-6), moved(-1e-6));
                for (i, (source, row)) in rows.iter().enumerate() {
                    let slope = (up[i] - down[i]) / 2e-6;
                    let scale = 1.0 + rows[i].1.iter().fold(0.0_f64, |a, x| a.max(x.abs()));
                    assert!(
                        (slope - row[j]).abs() < 1e-6 * scale,
                        "pose {k}, {source:?}, unknown {j}: {slope} {}",
                        row[j]
                    );
                }
            }
        }
    }
}
