//! How the robot hangs along a path: solved at some points, interpolated between them.
//!
//! Everything that a plan needs at a time follows from the distance along the path at that time. So
//! the statics are solved once per point, not once per millisecond, at a spacing that keeps lengths
//! within a micrometre.

use super::model::{Model, StaticState};
use super::options::{Planner, Tensioning};
use super::path::Path;
use super::plan::PlanError;
use super::schedule;
use super::spline::{Ends, Spline, SplineError};
use mcdpr_kinematics::Pose;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};

/// Greatest error of lengths between the solved points, m.
/// A thirtieth of an encoder count of the paper's robot (0.03 mm).
const TOLERANCE_M: f64 = 1e-6;
/// Greatest spacing of points, m.
const FURTHEST_M: f64 = 0.02;
/// Spacing of the points at which the tension rule is evaluated, m.
const RULE_SPACING_M: f64 = 0.02;
/// Most halvings of the spacing.
const MOST_HALVINGS: usize = 7;
/// Number of points of one track beyond which the spacing is not halved any more.
const MANY_PLACES: usize = 50_000;

/// A turn of the platform on the way along a path: about one fixed axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Turn {
    /// Attitude at the start, world_from_platform.
    pub from: Rotation3<f64>,
    /// Rotation vector from there to the attitude at the end, in the platform's frame at the start, rad.
    by: Vector3<f64>,
}

impl Turn {
    /// The shortest turn between two attitudes.
    #[must_use]
    pub fn between(from: Rotation3<f64>, to: Rotation3<f64>) -> Self {
        Self {
            from,
            by: UnitQuaternion::from_rotation_matrix(&(from.inverse() * to)).scaled_axis(),
        }
    }

    /// The whole angle, rad.
    #[must_use]
    pub fn angle_rad(&self) -> f64 {
        self.by.norm()
    }

    /// The attitude after a share of the way.
    #[must_use]
    pub fn at(&self, share: f64) -> Rotation3<f64> {
        self.from * Rotation3::new(self.by * share)
    }
}

/// The robot along one path.
#[derive(Debug, Clone)]
pub(crate) struct Track {
    length_m: f64,
    nodes: Vec<StaticState>,
    /// Over the distance along the path: lengths, tensions, rotation vector; of a robot that hangs beside its plane the
    /// tool across it.
    channels: Vec<Spline>,
    cables: usize,
    /// Normal of the plane beside which the robot hangs.
    normal: Option<Vector3<f64>>,
}

impl Track {
    /// Solves the statics along a path.
    ///
    /// # Errors
    /// [`PlanError::NoEquilibrium`] with the first point where the robot cannot hang.
    pub fn along(
        model: &Model,
        path: &Path,
        turn: &Turn,
        near: Option<&StaticState>,
    ) -> Result<Self, PlanError> {
        let length_m = path.length_m();
        let tension = Tension::along(model, path, near)?;
        let solve = |way_m: f64, near: Option<&StaticState>| {
            let tool_m = path.point(way_m)?.position_m;
            if !model.holding().hangs() {
                return model.rest_turned(&tool_m, &turn.at(way_m / length_m));
            }
            model.rest_planned(&tool_m, tension.at(way_m)?, near)
        };
        let mut count = segments(length_m, FURTHEST_M).max(4);
        let mut nodes: Vec<StaticState> = Vec::with_capacity(count + 1);
        for index in 0..=count {
            let near = nodes.last().or(near);
            nodes.push(solve(share(index, count) * length_m, near)?);
        }
        for _ in 0..MOST_HALVINGS {
            // A longer list would use up the points that one plan may solve (200 000).
            if count > MANY_PLACES {
                break;
            }
            let coarse = Self::through(model, length_m, &nodes)?;
            // Points between the nodes: they check the spline, and become nodes of the next one.
            let mut finer = Vec::with_capacity(2 * count + 1);
            let mut miss_m: f64 = 0.0;
            for (index, node) in nodes.iter().enumerate() {
                finer.push(node.clone());
                if index == count {
                    break;
                }
                let way_m = share(2 * index + 1, 2 * count) * length_m;
                let rest = solve(way_m, Some(node))?;
                let guess = coarse.lengths_m(way_m)?;
                for (exact, guess) in rest.paid_out_m.iter().zip(&guess) {
                    miss_m = miss_m.max((exact - guess).abs());
                }
                finer.push(rest);
            }
            nodes = finer;
            count *= 2;
            // Measured on the coarser spline: at half the spacing the error is about 1/16 (fourth
            // order).
            if miss_m <= TOLERANCE_M {
                break;
            }
        }
        Self::through(model, length_m, &nodes)
    }

    /// The robot at one point: a track without length.
    #[must_use]
    pub fn still(rest: StaticState) -> Self {
        Self {
            length_m: 0.0,
            cables: rest.paid_out_m.len(),
            nodes: vec![rest],
            channels: Vec::new(),
            normal: None,
        }
    }

    fn through(model: &Model, length_m: f64, nodes: &[StaticState]) -> Result<Self, PlanError> {
        let normal = model.beside();
        let count = nodes.len().saturating_sub(1);
        let ways_m: Vec<_> = (0..=count).map(|i| share(i, count) * length_m).collect();
        let rows: Vec<Vec<f64>> = nodes
            .iter()
            .map(|rest| {
                let turned = rotation_vector(&rest.equilibrium.pose.rotation);
                let lengths = rest.paid_out_m.iter().copied();
                let tensions = rest.tensions_n().iter().copied();
                let rotation = [turned.x, turned.y, turned.z];
                let across = normal.map(|normal| normal.dot(&model.tool_m(rest)));
                let all = lengths.chain(tensions).chain(rotation);
                all.chain(across).collect()
            })
            .collect();
        let cables = model.robot().cables.len();
        let channels: Result<Vec<_>, SplineError> =
            (0..2 * cables + 3 + usize::from(normal.is_some()))
                .map(|channel| {
                    let values: Vec<_> = rows
                        .iter()
                        .map(|row| row.get(channel).copied().unwrap_or(f64::NAN))
                        .collect();
                    // Over the way nothing rests at the ends: clamped or natural ends would bend the
                    // lengths there.
                    Spline::interpolate(&ways_m, &values, Ends::NotAKnot)
                })
                .collect();
        Ok(Self {
            length_m,
            nodes: nodes.to_vec(),
            channels: channels?,
            cables,
            normal,
        })
    }

    /// The states that were solved, from start to end.
    #[must_use]
    pub fn nodes(&self) -> &[StaticState] {
        &self.nodes
    }

    /// The solved state nearest to a point.
    #[must_use]
    pub fn nearest(&self, way_m: f64) -> Option<&StaticState> {
        let last = self.nodes.len().saturating_sub(1);
        let scaled = way_m / self.length_m.max(1e-12) * last as f64;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturates, then cut to the list"
        )]
        let index = (scaled.round() as usize).min(last);
        self.nodes.get(index)
    }

    /// Greatest change of each cable's length per distance along the path: its speed is at most
    /// this times the tool's.
    #[must_use]
    pub fn slopes(&self) -> Vec<f64> {
        let step_m = self.length_m / self.nodes.len().saturating_sub(1).max(1) as f64;
        let mut most = vec![0.0_f64; self.cables];
        for pair in self.nodes.windows(2) {
            let [a, b] = pair else { continue };
            let lengths = a.paid_out_m.iter().zip(&b.paid_out_m);
            for (slot, (before, after)) in most.iter_mut().zip(lengths) {
                // A chord is a little flatter than the steepest place between its nodes: see
                // `DRUM_SHARE`.
                *slot = slot.max((after - before).abs() / step_m.max(1e-12));
            }
        }
        most
    }

    /// Paid-out lengths at a point, m.
    ///
    /// # Errors
    /// [`PlanError::Spline`] off the path.
    pub fn lengths_m(&self, way_m: f64) -> Result<Vec<f64>, PlanError> {
        if self.channels.is_empty() {
            return Ok(self
                .nodes
                .first()
                .map_or_else(Vec::new, |n| n.paid_out_m.clone()));
        }
        let at = way_m.clamp(0.0, self.length_m);
        let lengths = self.channels.iter().take(self.cables);
        let values: Result<_, SplineError> = lengths
            .map(|channel| Ok(channel.sample(at)?.value))
            .collect();
        Ok(values?)
    }

    /// Where the tool is at a point of the path, `at_m` (world, m): beside it, if the robot hangs beside its plane.
    ///
    /// # Errors
    /// [`PlanError::Spline`] off the path.
    pub fn tool_m(&self, way_m: f64, at_m: Vector3<f64>) -> Result<Vector3<f64>, PlanError> {
        let Some((normal, channel)) = self.normal.zip(self.channels.last()) else {
            return Ok(at_m);
        };
        let across_m = channel.sample(way_m.clamp(0.0, self.length_m))?.value;
        Ok(at_m + normal * (across_m - normal.dot(&at_m)))
    }

    /// How the robot hangs at a point; `tool_m` is where the tool is there.
    ///
    /// # Errors
    /// [`PlanError::Spline`] off the path.
    pub fn rest(
        &self,
        model: &Model,
        way_m: f64,
        tool_m: &Vector3<f64>,
    ) -> Result<StaticState, PlanError> {
        let nearest = self.nearest(way_m).ok_or(super::path::PathError::Empty)?;
        let mut rest = nearest.clone();
        if self.channels.is_empty() {
            return Ok(rest);
        }
        let at = way_m.clamp(0.0, self.length_m);
        let values: Result<Vec<f64>, SplineError> = self
            .channels
            .iter()
            .map(|c| Ok(c.sample(at)?.value))
            .collect();
        let values = values?;
        let mut values = values.into_iter();
        for slot in &mut rest.paid_out_m {
            *slot = values.next().unwrap_or(*slot);
        }
        for slot in rest.equilibrium.tensions_n.iter_mut() {
            *slot = values.next().unwrap_or(*slot);
        }
        let turned = Vector3::from_iterator(values.chain([0.0; 3]).take(3));
        let rotation = Rotation3::new(turned);
        let tool = &model.robot().tool.tcp_in_platform_m;
        rest.equilibrium.pose = Pose::new(tool_m - rotation * tool, rotation);
        let pairs = rest.paid_out_m.iter().zip(&rest.equilibrium.tensions_n);
        let slots = rest.equilibrium.lengths_m.iter_mut();
        for (index, (slot, (&paid_out, &tension))) in slots.zip(pairs).enumerate() {
            // Paid out is unstretched cable. All of it stretches, the routing included, and the
            // stretch comes out at the anchor.
            *slot = model.taut_m(index, paid_out, tension);
        }
        Ok(rest)
    }
}

/// The rotation vector of an attitude, rad.
fn rotation_vector(rotation: &Rotation3<f64>) -> Vector3<f64> {
    let turned = rotation.scaled_axis();
    if turned.iter().all(|x| x.is_finite()) {
        return turned;
    }
    // Rounding next to no turn at all leaves the domain of the arc-cosine.
    UnitQuaternion::from_rotation_matrix(rotation).scaled_axis()
}

/// The scheduled tension along a path.
enum Tension {
    Constant(f64),
    Smooth(Spline, f64),
}

impl Tension {
    fn along(model: &Model, path: &Path, near: Option<&StaticState>) -> Result<Self, PlanError> {
        let options = model.options();
        let setpoint_n = model.robot().tension.setpoint_n;
        if !model.holding().hangs() {
            return Ok(Self::Constant(setpoint_n));
        }
        if options.tensioning == Tensioning::Setpoint || options.planner == Planner::Level {
            return Ok(Self::Constant(setpoint_n));
        }
        let length_m = path.length_m();
        let count = segments(length_m, RULE_SPACING_M).max(8);
        let mut ruled: Vec<f64> = Vec::with_capacity(count + 1);
        let mut before: Option<StaticState> = near.cloned();
        for index in 0..=count {
            let tool_m = path.point(share(index, count) * length_m)?.position_m;
            let best_n = schedule::best_n(model, &tool_m, before.as_ref())?;
            before = model.rest_with(&tool_m, best_n, before.as_ref()).ok();
            ruled.push(best_n);
        }
        // The rule has kinks where another cable becomes the one with the least tension. The ends
        // are not moved, so that legs join.
        for _ in 0..3 {
            let old = ruled.clone();
            for (slot, three) in ruled.iter_mut().skip(1).zip(old.windows(3)) {
                if let &[a, b, c] = three {
                    *slot = 0.25 * a + 0.5 * b + 0.25 * c;
                }
            }
        }
        let ways_m: Vec<_> = (0..=count).map(|i| share(i, count) * length_m).collect();
        let spline = Spline::interpolate(&ways_m, &ruled, Ends::NotAKnot)?;
        Ok(Self::Smooth(spline, length_m))
    }

    fn at(&self, way_m: f64) -> Result<f64, PlanError> {
        match self {
            Self::Constant(n) => Ok(*n),
            Self::Smooth(spline, length_m) => Ok(spline.sample(way_m.clamp(0.0, *length_m))?.value),
        }
    }
}

fn share(index: usize, of: usize) -> f64 {
    index as f64 / of.max(1) as f64
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a small count"
)]
fn segments(length_m: f64, spacing_m: f64) -> usize {
    (length_m / spacing_m).ceil() as usize
}
