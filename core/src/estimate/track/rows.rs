//! What a resting robot should measure, given slow states; linearised, without pose and tensions.
//!
//! At rest a robot of n cables has n lengths, n tensions and six equations of statics for its pose and
//! n true tensions: n more rows than unknowns for a hanging robot of four cables. Pose and tensions are
//! removed by reflections (the null space of their columns, as in Mourikis and Roumeliotis, 2007). What
//! is left tells of the slow states alone.

use super::gaussian::{Linear, triangulate};
use super::layout::Layout;
use crate::estimate::Measurements;
use crate::estimate::region::tool_per_pose;
use crate::robot::{Control, Robot};
use mcdpr_kinematics::{AnyRobot, Cable, GRAVITY_MPS2, Platform, Pose};
use nalgebra::{Matrix3, Matrix6, Rotation3, SVector, Vector3};

/// Standard deviations of one rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowSigmas {
    /// A length: the encoder's counts and what no state describes, m.
    pub length_m: f64,
    /// A tension, mean of a rest, N.
    pub tension_n: f64,
    /// What no state describes of a tension, as a share of it.
    pub tension_share: f64,
    /// How well the state of a turning pulley's friction is known, as a share of it; a third at its end.
    pub friction: f64,
    /// Balance of forces, N.
    pub force_n: f64,
    /// An attachment, per axis, m: cables pull moments by it.
    pub attachment_m: f64,
}

impl Default for RowSigmas {
    fn default() -> Self {
        Self {
            length_m: 3e-5,
            tension_n: 0.02,
            tension_share: 0.002,
            friction: 0.2,
            force_n: 0.01,
            attachment_m: 6e-5,
        }
    }
}

/// Pose and tensions of a rest.
#[derive(Debug, Clone)]
pub(super) struct Hanging {
    pub(super) pose: Pose,
    pub(super) tensions_n: Vec<f64>,
}

/// What the rows are made from.
pub(super) struct Rest<'a> {
    pub(super) robot: &'a Robot,
    pub(super) sigmas: &'a RowSigmas,
    pub(super) measured: &'a Measurements,
    /// Travel that each pulley's friction has seen last: 1 hauled in, -1 paid out.
    pub(super) hauled: &'a [f64],
    /// Whether the tensions of length-held cables are used: not known before a rest.
    pub(super) every_tension: bool,
}

/// Rows over their standard deviation: `[pose and tensions | residual | states]`.
struct Rows(Vec<Vec<f64>>);

/// Cable lengths less those measured, directions of the cables, and the balance of forces and moments.
type Balance = (Vec<f64>, Vec<Vector3<f64>>, [f64; 6]);

impl Rest<'_> {
    fn layout(&self) -> Layout {
        Layout {
            cables: self.robot.cables.len(),
        }
    }

    fn unknowns(&self) -> usize {
        6 + self.robot.cables.len()
    }

    /// The robot with the anchors of the states.
    fn geometry(&self, x: &[f64]) -> Option<AnyRobot> {
        let layout = self.layout();
        let cables: Vec<Cable> = self
            .robot
            .cables
            .iter()
            .enumerate()
            .map(|(i, cable)| Cable {
                anchor_m: cable.anchor_in_world_m + vector(x, layout.anchor(i)),
                swivel_axis: cable.swivel_axis_in_world,
                pulley_radius_m: cable.pulley_radius_m,
                attachment_m: cable.attachment_in_platform_m,
            })
            .collect();
        let platform = Platform {
            mass_kg: self.robot.platform.mass_kg,
            center_of_mass_m: self.robot.platform.center_of_mass_m,
            inertia_kg_m2: None,
        };
        AnyRobot::new(&cables, platform).ok()
    }

    /// Lengths less those of the cables, and the balance, at one pose.
    fn balance(&self, geometry: &AnyRobot, x: &[f64], hanging: &Hanging) -> Option<Balance> {
        let layout = self.layout();
        let paths = geometry.paths(&hanging.pose).ok()?;
        let at = |k: usize| x.get(k).copied().unwrap_or(0.0);
        let platform = &self.robot.platform;
        let mass = platform.mass_kg + at(layout.platform()) + at(layout.payload());
        let moment_of_mass = platform.center_of_mass_m * platform.mass_kg
            + vector(x, layout.platform() + 1)
            + vector(x, layout.payload() + 1);
        let weight = Vector3::new(0.0, 0.0, -GRAVITY_MPS2);
        let mut force = weight * mass;
        let mut moment = (hanging.pose.rotation * moment_of_mass).cross(&weight);
        let mut lengths = Vec::with_capacity(paths.len());
        let mut directions = Vec::with_capacity(paths.len());
        let pairs = paths.iter().zip(&hanging.tensions_n);
        for (i, (path, tension)) in pairs.enumerate() {
            let pull = path.direction * -*tension;
            force += pull;
            let attachment = self.robot.cables.get(i)?.attachment_in_platform_m;
            moment += (hanging.pose.rotation * attachment).cross(&pull);
            lengths.push(path.length_m);
            directions.push(path.direction);
        }
        let f = [force.x, force.y, force.z, moment.x, moment.y, moment.z];
        Some((lengths, directions, f))
    }

    /// All rows at a pose and tensions; slopes of the states only `with_states`.
    fn rows(&self, x: &[f64], hanging: &Hanging, with_states: bool) -> Option<Rows> {
        let layout = self.layout();
        let (count, unknowns) = (layout.cables, self.unknowns());
        let geometry = self.geometry(x)?;
        let at = |k: usize| x.get(k).copied().unwrap_or(0.0);
        let (lengths, directions, balance) = self.balance(&geometry, x, hanging)?;
        let width = unknowns + 1 + if with_states { layout.size() } else { 0 };
        let state = |k: usize| unknowns + 1 + k;
        // Differences by the pose: 1 um, and 1 urad.
        const STEP: f64 = 1e-6;
        let mut moved = Vec::with_capacity(6);
        for k in 0..6 {
            let mut twist = SVector::<f64, 6>::zeros();
            twist[k] = STEP;
            let pose = hanging.pose.displaced(
                &twist.fixed_rows::<3>(0).into_owned(),
                &twist.fixed_rows::<3>(3).into_owned(),
            );
            let near = Hanging {
                pose,
                tensions_n: hanging.tensions_n.clone(),
            };
            moved.push(self.balance(&geometry, x, &near)?);
        }
        let mut rows = Vec::with_capacity(2 * count + 12);
        for i in 0..count {
            let mut row = vec![0.0; width];
            let cable = self.robot.cables.get(i)?;
            let read = *self.measured.lengths_m.get(i)?;
            let tension = *hanging.tensions_n.get(i)?;
            let creep = at(layout.creep(i, 0)) + at(layout.creep(i, 1));
            let off_drum = read + cable.routing_length_m + at(layout.offset(i));
            let compliance = (1.0 + at(layout.compliance(i))) / cable.ea_n;
            let elastic = 1.0 + tension * compliance;
            let grown = off_drum * (1.0 + creep);
            // The routing carries the winch's tension: it stretches by the pulley's share more.
            let rubbing = at(layout.loss()) * self.hauled.get(i).copied().unwrap_or(0.0);
            let extra = cable.routing_length_m * rubbing * compliance;
            let inverse = 1.0 / self.sigmas.length_m;
            for (k, (there, _, _)) in moved.iter().enumerate() {
                row[k] = (there[i] - lengths[i]) / STEP * inverse;
            }
            row[6 + i] = -(grown * compliance + extra) * inverse;
            let total = lengths[i] + cable.routing_length_m;
            row[unknowns] = (total - grown * elastic - extra * tension) * inverse;
            if with_states {
                row[state(layout.offset(i))] = -(1.0 + creep) * elastic * inverse;
                for element in 0..2 {
                    row[state(layout.creep(i, element))] = -off_drum * elastic * inverse;
                }
                row[state(layout.compliance(i))] = -grown * tension / cable.ea_n * inverse;
                for k in 0..3 {
                    // Only the way from anchor to attachment counts.
                    row[state(layout.anchor(i) + k)] = -row[k];
                }
            }
            rows.push(row);
        }
        for i in 0..count {
            let cable = self.robot.cables.get(i)?;
            if !self.every_tension && cable.control == Control::Position {
                continue;
            }
            let mut row = vec![0.0; width];
            let read = *self.measured.tensions_n.get(i)?;
            let tension = *hanging.tensions_n.get(i)?;
            let side = self.hauled.get(i).copied().unwrap_or(0.0);
            let (loss, gain) = (at(layout.loss()), at(layout.gain(i)));
            let rubbed = 1.0 + loss * side;
            let turning = 0.3 + (1.0 - side.abs());
            let unsure = loss * tension * self.sigmas.friction * turning;
            let scale = tension * self.sigmas.tension_share;
            let squares = self.sigmas.tension_n.powi(2) + unsure * unsure + scale * scale;
            let inverse = 1.0 / squares.sqrt();
            row[6 + i] = rubbed * (1.0 + gain) * inverse;
            row[unknowns] = (tension * rubbed * (1.0 + gain) + at(layout.zero(i)) - read) * inverse;
            if with_states {
                row[state(layout.zero(i))] = inverse;
                row[state(layout.gain(i))] = tension * rubbed * inverse;
                row[state(layout.loss())] = tension * side * (1.0 + gain) * inverse;
            }
            rows.push(row);
        }
        let weight = Vector3::new(0.0, 0.0, -GRAVITY_MPS2);
        let rotation = hanging.pose.rotation;
        let squares: f64 = hanging.tensions_n.iter().map(|t| t * t).sum();
        let pulls_n = squares.sqrt().max(1.0);
        for k in 0..6 {
            let mut row = vec![0.0; width];
            let sigma = if k < 3 {
                self.sigmas.force_n
            } else {
                pulls_n * self.sigmas.attachment_m
            };
            let inverse = 1.0 / sigma;
            for (column, (_, _, there)) in moved.iter().enumerate() {
                row[column] = (there[k] - balance[k]) / STEP * inverse;
            }
            for i in 0..count {
                let arm = rotation * self.robot.cables.get(i)?.attachment_in_platform_m;
                let part = |force: Vector3<f64>| {
                    let turn = arm.cross(&force);
                    [force.x, force.y, force.z, turn.x, turn.y, turn.z][k]
                };
                row[6 + i] = part(-directions[i]) * inverse;
                if with_states {
                    let tension = hanging.tensions_n[i];
                    for axis in 0..3 {
                        let turned = (moved[axis].1[i] - directions[i]) / STEP;
                        row[state(layout.anchor(i) + axis)] = part(turned * tension) * inverse;
                    }
                }
            }
            row[unknowns] = balance[k] * inverse;
            if with_states {
                for first in [layout.platform(), layout.payload()] {
                    if k < 3 {
                        row[state(first)] = weight[k] * inverse;
                    } else {
                        for axis in 0..3 {
                            let by: Vector3<f64> = rotation.matrix().column(axis).cross(&weight);
                            row[state(first + 1 + axis)] = by[k - 3] * inverse;
                        }
                    }
                }
            }
            rows.push(row);
        }
        self.camera_rows(x, &hanging.pose, width, with_states, &mut rows)?;
        Some(Rows(rows))
    }

    /// Six rows that say what all corners of all tags say about the camera's pose.
    fn camera_rows(
        &self,
        x: &[f64],
        pose: &Pose,
        width: usize,
        with_states: bool,
        rows: &mut Vec<Vec<f64>>,
    ) -> Option<()> {
        let camera = &self.robot.camera;
        let first = self.layout().camera();
        let unknowns = self.unknowns();
        let shift = vector(x, first);
        let turn = Rotation3::new(vector(x, first + 3));
        let mount = &camera.camera_from_platform;
        let mut corners: Vec<Vec<f64>> = Vec::new();
        for view in &self.measured.views {
            let tag = self.robot.tags.iter().find(|tag| tag.id == view.id);
            let place = tag.and_then(|t| {
                self.measured
                    .places
                    .iter()
                    .find(|place| place.body == t.body)
            });
            let (Some(tag), Some(place)) = (tag, place) else {
                continue;
            };
            let seen = view.corners_px.iter().zip(&view.covariance_px2);
            for (corner, (seen, covariance)) in tag.corners_in_body_m.iter().zip(seen) {
                let in_world = place.world_from_body.transform(corner);
                let in_camera = mount.transform(&pose.inverse().transform(&in_world));
                let there = turn * in_camera + shift;
                let said = camera.lens.projection(&there.into())?;
                for (axis, seen) in seen.iter().enumerate() {
                    let sigma = covariance[axis][axis].max(1e-6).sqrt();
                    let by: Vector3<f64> = said.by_point.row(axis).transpose();
                    let turned = there.cross(&by);
                    let line = [by.x, by.y, by.z, turned.x, turned.y, turned.z];
                    let mut row: Vec<f64> = line.iter().map(|v| v / sigma).collect();
                    let pixel = [said.pixel.x, said.pixel.y][axis];
                    row.push((pixel - seen) / sigma);
                    corners.push(row);
                }
            }
        }
        if corners.len() < 8 || !triangulate(&mut corners, 6) {
            return Some(());
        }
        // Twist of the camera frame by a twist of the platform (world, about its origin).
        let to_camera = turn.matrix() * mount.rotation.matrix();
        let back = pose.rotation.matrix().transpose();
        let rotate = to_camera * back;
        let origin = turn * mount.position_m + shift;
        let mut by_pose = Matrix6::zeros();
        by_pose.fixed_view_mut::<3, 3>(0, 0).copy_from(&-rotate);
        by_pose.fixed_view_mut::<3, 3>(3, 3).copy_from(&-rotate);
        // A turn about the platform's origin moves the camera's own: dX = -R (phi x (X_w - p)).
        let lever: Matrix3<f64> = origin.cross_matrix() * rotate;
        by_pose.fixed_view_mut::<3, 3>(0, 3).copy_from(&-lever);
        for corner in corners.iter().take(6) {
            let mut row = vec![0.0; width];
            let slopes = SVector::<f64, 6>::from_column_slice(&corner[..6]);
            for (entry, column) in row.iter_mut().zip(by_pose.column_iter()) {
                *entry = slopes.dot(&column);
            }
            row[unknowns] = corner[6];
            if with_states {
                for k in 0..6 {
                    row[unknowns + 1 + first + k] = corner[k];
                }
            }
            rows.push(row);
        }
        Some(())
    }

    /// Pose and tensions that fit best, from a guess. `loose` are the variances of the states: rows
    /// that unknown states can shift count less.
    pub(super) fn hang(&self, x: &[f64], start: &Hanging, loose: &[f64]) -> Option<Hanging> {
        let unknowns = self.unknowns();
        let mut hanging = start.clone();
        let weights: Vec<f64> = self
            .rows(x, &hanging, true)?
            .0
            .iter()
            .map(|row| {
                let slopes = row.iter().skip(unknowns + 1).zip(loose);
                let variance: f64 = slopes.map(|(slope, v)| slope * slope * v).sum();
                1.0 / (1.0 + variance).sqrt()
            })
            .collect();
        for round in 0..30 {
            let mut rows = self.rows(x, &hanging, false)?.0;
            for (row, weight) in rows.iter_mut().zip(&weights) {
                for value in row.iter_mut() {
                    *value *= weight;
                }
            }
            if !triangulate(&mut rows, unknowns) {
                return None;
            }
            let step = back_substituted(&rows, unknowns, unknowns);
            let move_m = Vector3::new(-step[0], -step[1], -step[2]);
            let turn = Vector3::new(-step[3], -step[4], -step[5]);
            // Beyond 50 mm, or 0.2 rad, the slopes mean little.
            let shorter = (0.05 / move_m.norm()).min(0.2 / turn.norm()).min(1.0);
            hanging.pose = hanging
                .pose
                .displaced(&(move_m * shorter), &(turn * shorter));
            for (tension, by) in hanging.tensions_n.iter_mut().zip(&step[6..]) {
                *tension -= by * shorter;
            }
            if !hanging.pose.position_m.iter().all(|v| v.is_finite()) {
                return None;
            }
            // A hundredth of a micrometre; later a micrometre, where rounding is all that is left.
            let enough = if round < 15 { 1e-8 } else { 1e-6 };
            if move_m.norm() < enough && turn.norm() < 10.0 * enough {
                return Some(hanging);
            }
        }
        None
    }

    /// The rows without pose and tensions.
    pub(super) fn linear(&self, x: &[f64], hanging: &Hanging) -> Option<Linear> {
        let unknowns = self.unknowns();
        let mut rows = self.rows(x, hanging, true)?.0;
        if !triangulate(&mut rows, unknowns) {
            return None;
        }
        let left = rows.split_off(unknowns);
        Some(Linear {
            at: x.to_vec(),
            residual: left.iter().map(|row| row[unknowns]).collect(),
            slopes: left
                .iter()
                .map(|row| row[unknowns + 1..].to_vec())
                .collect(),
        })
    }

    /// Slopes of the tool's position by the states, and its covariance by the rows' noise, m2.
    pub(super) fn tool(
        &self,
        x: &[f64],
        hanging: &Hanging,
    ) -> Option<([Vec<f64>; 3], Matrix3<f64>)> {
        let unknowns = self.unknowns();
        let mut rows = self.rows(x, hanging, true)?.0;
        if !triangulate(&mut rows, unknowns) {
            return None;
        }
        let arm = hanging.pose.rotation * self.robot.tool.tcp_in_platform_m;
        let by_twist = tool_per_pose(&arm);
        let size = self.layout().size();
        let mut slopes = [vec![0.0; size], vec![0.0; size], vec![0.0; size]];
        let mut all = Vec::with_capacity(3);
        // Row by row of the inverse of the triangle: tool = -T inverse (residual + H x + noise).
        for (axis, slope) in slopes.iter_mut().enumerate() {
            let mut weights = vec![0.0; unknowns];
            for k in 0..unknowns {
                let own = if k < 6 { by_twist[(axis, k)] } else { 0.0 };
                let before: f64 = (0..k).map(|j| weights[j] * rows[j][k]).sum();
                weights[k] = (own - before) / rows[k][k];
            }
            for (row, weight) in rows.iter().zip(&weights) {
                for (slot, value) in slope.iter_mut().zip(&row[unknowns + 1..]) {
                    *slot -= weight * value;
                }
            }
            all.push(weights);
        }
        let noise = Matrix3::from_fn(|i, j| super::gaussian::dot(&all[i], &all[j]));
        Some((slopes, noise))
    }
}

/// Solves the triangle for the column `right`.
fn back_substituted(rows: &[Vec<f64>], unknowns: usize, right: usize) -> Vec<f64> {
    let mut out = vec![0.0; unknowns];
    for row in (0..unknowns).rev() {
        let sum: f64 = (row + 1..unknowns).map(|k| rows[row][k] * out[k]).sum();
        out[row] = (rows[row][right] - sum) / rows[row][row];
    }
    out
}

/// Three states as a vector.
pub(super) fn vector(x: &[f64], first: usize) -> Vector3<f64> {
    let at = |k: usize| x.get(first + k).copied().unwrap_or(0.0);
    Vector3::new(at(0), at(1), at(2))
}
