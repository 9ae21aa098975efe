//! What a resting robot should measure, given slow states; linearised, without pose and tensions.
//!
//! At rest a robot of n cables has n lengths, n tensions and six equations of statics for its pose and
//! n true tensions: n more rows than unknowns for a hanging robot of four cables. Pose and tensions are
//! removed by reflections (the null space of their columns, as in Mourikis and Roumeliotis, 2007). What
//! is left tells of the slow states alone.

use super::creep::Creeping;
use super::layout::Layout;
use super::lines::Lines;
use super::pulleys::Rubbing;
use super::statics::{Leg, Statics, WEIGHT, moment_by_mass};
use crate::estimate::Measurements;
use crate::robot::{Control, Robot};
use mcdpr_kinematics::{AnyRobot, Pose};
use nalgebra::Vector3;

/// Standard deviations of one rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowSigmas {
    /// A length: the encoder's counts and what no state describes, m.
    pub length_m: f64,
    /// A tension, mean of a rest, N.
    pub tension_n: f64,
    /// What no state describes of a tension, as a share of it.
    pub tension_share: f64,
    /// Balance of forces, N.
    pub force_n: f64,
    /// An attachment, per axis, m: cables pull moments by it.
    pub attachment_m: f64,
}

impl Default for RowSigmas {
    fn default() -> Self {
        Self {
            length_m: 2e-5,
            tension_n: 0.02,
            tension_share: 0.001,
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
    /// Friction of each pulley.
    pub(super) rubbing: &'a [Rubbing],
    /// What each cable has crept by the tensions so far.
    pub(super) creeping: &'a [Creeping],
    /// Whether the tensions of length-held cables are used: not known before a rest.
    pub(super) every_tension: bool,
}

/// A slope of a row by a state.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slope {
    pub(super) row: usize,
    pub(super) state: usize,
    pub(super) value: f64,
}

/// Rows over their standard deviation.
pub(super) struct Rows {
    /// `[pose and tensions | residual]` of each row.
    pub(super) lines: Lines,
    /// Slopes by the states: most are zero, and are not here.
    pub(super) by_state: Vec<Slope>,
}

impl Rows {
    /// Notes a slope of a row by a state.
    pub(super) fn put(&mut self, row: usize, state: usize, value: f64) {
        self.by_state.push(Slope { row, state, value });
    }
}

impl Rest<'_> {
    pub(super) fn layout(&self) -> Layout {
        Layout {
            cables: self.robot.cables.len(),
        }
    }

    /// Pose and tensions.
    pub(super) fn unknowns(&self) -> usize {
        6 + self.robot.cables.len()
    }

    /// All rows at a pose and tensions of a robot of this geometry; slopes of the states only `with_states`.
    pub(super) fn rows(
        &self,
        geometry: &AnyRobot,
        x: &[f64],
        hanging: &Hanging,
        with_states: bool,
    ) -> Option<Rows> {
        let tensions_n = &hanging.tensions_n;
        let statics = Statics::at(
            self.robot,
            geometry,
            self.layout(),
            x,
            &hanging.pose,
            tensions_n,
        )?;
        let mut rows = Rows {
            lines: Lines::new(self.unknowns() + 1),
            by_state: Vec::new(),
        };
        for i in 0..self.robot.cables.len() {
            self.length_row(i, x, hanging, statics.legs.get(i)?, with_states, &mut rows)?;
        }
        for (i, cable) in self.robot.cables.iter().enumerate() {
            if self.every_tension || cable.control != Control::Position {
                self.tension_row(i, x, hanging, with_states, &mut rows)?;
            }
        }
        self.balance_rows(hanging, &statics, with_states, &mut rows);
        self.camera_rows(x, &hanging.pose, with_states, &mut rows)?;
        Some(rows)
    }

    /// The cable that its drum let out against its way from anchor to attachment.
    fn length_row(
        &self,
        i: usize,
        x: &[f64],
        hanging: &Hanging,
        leg: &Leg,
        with_states: bool,
        rows: &mut Rows,
    ) -> Option<()> {
        let (layout, unknowns) = (self.layout(), self.unknowns());
        let at = |k: usize| x.get(k).copied().unwrap_or(0.0);
        let cable = self.robot.cables.get(i)?;
        let read = *self.measured.lengths_m.get(i)?;
        let tension = *hanging.tensions_n.get(i)?;
        let creeping = self.creeping.get(i).copied().unwrap_or_default();
        let creep = creeping.strain(layout, x, i);
        let off_drum = read + cable.routing_length_m + at(layout.offset(i));
        let compliance = (1.0 + at(layout.compliance(i))) / cable.ea_n;
        let elastic = 1.0 + tension * compliance;
        let grown = off_drum * (1.0 + creep);
        // The routing carries the winch's tension: it stretches by the pulley's share more.
        let side = self.rubbing.get(i).map_or(0.0, |rubbing| rubbing.side);
        let extra_by_loss = cable.routing_length_m * side * compliance;
        let extra = extra_by_loss * at(layout.loss(i));
        let inverse = 1.0 / self.sigmas.length_m;
        let (index, row) = rows.lines.push();
        let by_pose = leg.length_by_pose().map(|slope| slope * inverse);
        row[..6].copy_from_slice(&by_pose);
        row[6 + i] = -(grown * compliance + extra) * inverse;
        let total = leg.length_m + cable.routing_length_m;
        row[unknowns] = (total - grown * elastic - extra * tension) * inverse;
        if with_states {
            let mut put = |state: usize, value: f64| rows.put(index, state, value);
            put(layout.offset(i), -(1.0 + creep) * elastic * inverse);
            for (state, slope) in creeping.slopes(layout, x, i) {
                put(state, -off_drum * elastic * slope * inverse);
            }
            put(
                layout.compliance(i),
                -grown * tension / cable.ea_n * inverse,
            );
            put(layout.loss(i), -extra_by_loss * tension * inverse);
            for (axis, slope) in by_pose.iter().take(3).enumerate() {
                // Only the way from anchor to attachment counts.
                put(layout.anchor(i) + axis, -slope);
            }
        }
        Some(())
    }

    /// What a tension's sensor shows.
    fn tension_row(
        &self,
        i: usize,
        x: &[f64],
        hanging: &Hanging,
        with_states: bool,
        rows: &mut Rows,
    ) -> Option<()> {
        let (layout, unknowns) = (self.layout(), self.unknowns());
        let at = |k: usize| x.get(k).copied().unwrap_or(0.0);
        let read = *self.measured.tensions_n.get(i)?;
        let tension = *hanging.tensions_n.get(i)?;
        let Rubbing { side, unsure } = *self.rubbing.get(i)?;
        let (loss, gain) = (at(layout.loss(i)), at(layout.gain(i)));
        let rubbed = 1.0 + loss * side;
        let unsure_n = loss * tension * unsure;
        let scale = tension * self.sigmas.tension_share;
        let squares = self.sigmas.tension_n.powi(2) + unsure_n * unsure_n + scale * scale;
        let inverse = 1.0 / squares.sqrt();
        let (index, row) = rows.lines.push();
        row[6 + i] = rubbed * (1.0 + gain) * inverse;
        row[unknowns] = (tension * rubbed * (1.0 + gain) + at(layout.zero(i)) - read) * inverse;
        if with_states {
            let mut put = |state: usize, value: f64| rows.put(index, state, value);
            put(layout.zero(i), inverse);
            put(layout.gain(i), tension * rubbed * inverse);
            put(layout.loss(i), tension * side * (1.0 + gain) * inverse);
        }
        Some(())
    }

    /// Three rows of force and three of moment.
    fn balance_rows(
        &self,
        hanging: &Hanging,
        statics: &Statics,
        with_states: bool,
        rows: &mut Rows,
    ) {
        let (layout, unknowns) = (self.layout(), self.unknowns());
        let squares: f64 = hanging.tensions_n.iter().map(|t| t * t).sum();
        let moment_nm = squares.sqrt().max(1.0) * self.sigmas.attachment_m;
        let inverse: [f64; 6] = core::array::from_fn(|k| {
            1.0 / if k < 3 {
                self.sigmas.force_n
            } else {
                moment_nm
            }
        });
        let first = rows.lines.count();
        for (k, inverse) in inverse.iter().enumerate() {
            let (_, row) = rows.lines.push();
            for (slot, slope) in row.iter_mut().zip(statics.by_pose.row(k).iter()) {
                *slot = slope * inverse;
            }
            row[unknowns] = statics.balance[k] * inverse;
        }
        for (i, (leg, tension)) in statics.legs.iter().zip(&hanging.tensions_n).enumerate() {
            let pull = leg.wrench(&-leg.direction);
            for k in 0..6 {
                rows.lines.row_mut(first + k)[6 + i] = pull[k] * inverse[k];
            }
            for axis in (0..3).filter(|_| with_states) {
                // The direction turns by the anchor as by the attachment, the other way.
                let turned: Vector3<f64> = leg.bend_per_m.column(axis) * *tension;
                let pull = leg.wrench(&turned);
                for k in 0..6 {
                    rows.put(first + k, layout.anchor(i) + axis, pull[k] * inverse[k]);
                }
            }
        }
        if !with_states {
            return;
        }
        for mass in [layout.platform(), layout.payload()] {
            rows.put(first + 2, mass, WEIGHT.z * inverse[2]);
            for axis in 0..3 {
                let by = moment_by_mass(&hanging.pose.rotation, axis);
                for k in 0..3 {
                    rows.put(first + 3 + k, mass + 1 + axis, by[k] * inverse[3 + k]);
                }
            }
        }
    }
}

/// Three states as a vector.
pub(super) fn vector(x: &[f64], first: usize) -> Vector3<f64> {
    let at = |k: usize| x.get(first + k).copied().unwrap_or(0.0);
    Vector3::new(at(0), at(1), at(2))
}
