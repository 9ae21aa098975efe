//! Pose and tensions of a rest, and what is left of its rows without them.

use super::gaussian::{Linear, dot};
use super::lines::Lines;
use super::rows::{Hanging, Rest, Slope};
use super::statics::geometry;
use crate::estimate::region::tool_per_pose;
use nalgebra::{Matrix3, Vector3};

impl Rest<'_> {
    /// Pose and tensions that fit best, from a guess. `loose` are the variances of the states: rows
    /// that unknown states can shift count less.
    pub(super) fn hang(&self, x: &[f64], start: &Hanging, loose: &[f64]) -> Option<Hanging> {
        let unknowns = self.unknowns();
        let geometry = geometry(self.robot, self.layout(), x)?;
        let mut hanging = start.clone();
        let mut rows = self.rows(&geometry, x, &hanging, true)?;
        let mut weights = vec![1.0; rows.lines.count()];
        for slope in &rows.by_state {
            weights[slope.row] += slope.value * slope.value * loose[slope.state];
        }
        weights
            .iter_mut()
            .for_each(|weight| *weight = 1.0 / weight.sqrt());
        for round in 0..30 {
            for (row, weight) in rows.lines.iter_mut().zip(&weights) {
                row.iter_mut().for_each(|value| *value *= weight);
            }
            if !rows.lines.triangulate(unknowns) {
                return None;
            }
            let step = rows.lines.solved(unknowns);
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
            rows = self.rows(&geometry, x, &hanging, false)?;
        }
        None
    }

    /// All rows with pose and tensions as a triangle, each followed by its row of the reflections, and the slopes by the states
    /// as they were before.
    fn turned(&self, x: &[f64], hanging: &Hanging) -> Option<(Lines, Vec<Slope>)> {
        let geometry = geometry(self.robot, self.layout(), x)?;
        let rows = self.rows(&geometry, x, hanging, true)?;
        let mut turned = rows.lines.with_unit();
        let full = turned.triangulate(self.unknowns());
        full.then_some((turned, rows.by_state))
    }

    /// The rows without pose and tensions.
    pub(super) fn linear(&self, x: &[f64], hanging: &Hanging) -> Option<Linear> {
        let unknowns = self.unknowns();
        let (turned, by_state) = self.turned(x, hanging)?;
        let mut linear = Linear::new(x, turned.count() - unknowns);
        for (index, row) in turned.iter().skip(unknowns).enumerate() {
            linear.residual[index] = row[unknowns];
            let parts = &row[unknowns + 1..];
            for slope in &by_state {
                *linear.slope_mut(index, slope.state) += parts[slope.row] * slope.value;
            }
        }
        Some(linear)
    }

    /// Slopes of the tool's position by the states, and its covariance by the rows' noise, m2.
    pub(super) fn tool(
        &self,
        x: &[f64],
        hanging: &Hanging,
    ) -> Option<([Vec<f64>; 3], Matrix3<f64>)> {
        let unknowns = self.unknowns();
        let (turned, by_state) = self.turned(x, hanging)?;
        let arm = hanging.pose.rotation * self.robot.tool.tcp_in_platform_m;
        let by_twist = tool_per_pose(&arm);
        let size = self.layout().size();
        let mut slopes = [vec![0.0; size], vec![0.0; size], vec![0.0; size]];
        let mut all = Vec::with_capacity(3);
        // Row by row of the inverse of the triangle: tool = -T inverse (residual + H x + noise).
        for (axis, slope) in slopes.iter_mut().enumerate() {
            let mut weights = vec![0.0; unknowns];
            let mut by_row = vec![0.0; turned.count()];
            for k in 0..unknowns {
                let own = if k < 6 { by_twist[(axis, k)] } else { 0.0 };
                let before: f64 = (0..k).map(|j| weights[j] * turned.row(j)[k]).sum();
                weights[k] = (own - before) / turned.row(k)[k];
                for (slot, part) in by_row.iter_mut().zip(&turned.row(k)[unknowns + 1..]) {
                    *slot += weights[k] * part;
                }
            }
            for entry in &by_state {
                slope[entry.state] -= by_row[entry.row] * entry.value;
            }
            all.push(weights);
        }
        let noise = Matrix3::from_fn(|i, j| dot(&all[i], &all[j]));
        Some((slopes, noise))
    }
}
