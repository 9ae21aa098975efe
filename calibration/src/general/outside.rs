//! Instruments beside the robot: trackers with a frame of their own, and tapes.
//!
//! With p and R the platform's pose, F and f the tracker's (`tracker_from_world`), m the target on the
//! platform and M its attitude there: a tracker reads F (p + R m) + f and, if it reads attitudes, F R M. A
//! tape from point a of the frame to point b of the platform reads |p + R b - a| + z, with a zero z.

use super::data::{Sample, Set, Tracker};
use super::group::Group;
use super::model::{Model, Row, State, three};
use super::unknowns::Layout;
use crate::corner::{Entry, put, spread};
use crate::pnp::nearest_rotation;
use crate::verify::best_motion;
use mcdpr_kinematics::Pose;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Least distance of a tracker's positions from their best line, root mean square, m: below it the turn of its
/// frame about that line is not determined.
const ASIDE_M: f64 = 0.01;

impl Layout {
    /// First of the six unknowns of a tracker's frame; `slot` counts the trackers that take part.
    pub(crate) fn frame(&self, slot: usize) -> usize {
        self.after_camera() + TRACKER * slot
    }
    /// First of the three coordinates of its target.
    pub(crate) fn target(&self, slot: usize) -> usize {
        self.frame(slot) + 6
    }
    /// First of the three angles of its target.
    pub(crate) fn target_turn(&self, slot: usize) -> usize {
        self.frame(slot) + 9
    }
    /// Zero of a tape.
    pub(crate) fn tape(&self, slot: usize) -> usize {
        self.frame(self.trackers.len()) + slot
    }
    /// The first index after all of these.
    pub(crate) fn after_outside(&self) -> usize {
        self.tape(self.tapes.len())
    }
}

/// Unknowns of a tracker: its frame, its target's place and attitude.
pub(crate) const TRACKER: usize = 12;

impl Model<'_> {
    /// Rows of trackers and tapes.
    pub(crate) fn outside(&self, state: &State, sample: &Sample, pose: &Pose, out: &mut Vec<Row>) {
        for (slot, &index) in self.layout.trackers.iter().enumerate() {
            self.position(state, sample, pose, (slot, index), out);
            self.turn(state, sample, pose, (slot, index), out);
        }
        for (slot, &index) in self.layout.tapes.iter().enumerate() {
            let reading = sample.distance_m.get(index).copied().flatten();
            let (Some(reading), Some(tape)) = (reading, self.set.tapes.get(index)) else {
                continue;
            };
            let arm = pose.rotation * tape.to_m;
            let way = pose.position_m + arm - tape.from_m;
            let length = way.norm();
            // At its own beginning a tape has no direction.
            let Some(along) = way.try_normalize(1e-6) else {
                continue;
            };
            let at = self.layout.tape(slot);
            let mut own = vec![0.0; self.layout.own()];
            put(&mut own, 0, &along);
            put(&mut own, 3, &arm.cross(&along));
            out.push(Row {
                group: Group::Distance,
                index,
                residual: length + state.theta[at] - reading,
                own,
                shared: vec![Entry::new(at, 1.0)],
                scale: [1.0, 0.0],
            });
        }
    }

    /// The target's coordinates in the tracker's frame.
    fn position(
        &self,
        state: &State,
        sample: &Sample,
        pose: &Pose,
        (slot, index): (usize, usize),
        out: &mut Vec<Row>,
    ) {
        let Some(seen) = sample.position_m.get(index) else {
            return;
        };
        let layout = &self.layout;
        let frame = &state.tracker_from_world[slot];
        let f = frame.rotation.matrix();
        let target = self.set.trackers[index].target_m.unwrap_or_default()
            + three(&state.theta, layout.target(slot));
        let arm = pose.rotation * target;
        let place = pose.position_m + arm;
        let turned = frame.rotation * place;
        let predicted = turned + frame.position_m;
        for (axis, reading) in seen.iter().enumerate() {
            let Some(reading) = reading else {
                continue;
            };
            // The row of the frame's rotation is this axis of the tracker in the world's frame.
            let aim: Vector3<f64> = f.row(axis).transpose();
            let mut own = vec![0.0; layout.own()];
            put(&mut own, 0, &aim);
            put(&mut own, 3, &arm.cross(&aim));
            let mut shared = Vec::with_capacity(9);
            let unit = Vector3::ith(axis, 1.0);
            spread(&mut shared, layout.frame(slot), &unit);
            spread(&mut shared, layout.frame(slot) + 3, &turned.cross(&unit));
            let by_target = pose.rotation.inverse() * aim;
            spread(&mut shared, layout.target(slot), &by_target);
            out.push(Row {
                group: Group::Position,
                index: 3 * index + axis,
                residual: predicted[axis] - reading,
                own,
                shared,
                scale: [1.0, 0.0],
            });
        }
    }

    /// The target's attitude in the tracker's frame: the rotation vector from the reading to the prediction.
    fn turn(
        &self,
        state: &State,
        sample: &Sample,
        pose: &Pose,
        (slot, index): (usize, usize),
        out: &mut Vec<Row>,
    ) {
        let Some(Some(reading)) = sample.turned.get(index) else {
            return;
        };
        let layout = &self.layout;
        let frame = &state.tracker_from_world[slot].rotation;
        let predicted = frame * pose.rotation * state.platform_from_target[slot];
        let off = (predicted * reading.inverse()).scaled_axis();
        let by_target = frame * pose.rotation;
        for axis in 0..3 {
            let mut own = vec![0.0; layout.own()];
            put(&mut own, 3, &frame.matrix().row(axis).transpose());
            let mut shared = Vec::with_capacity(6);
            spread(
                &mut shared,
                layout.frame(slot) + 3,
                &Vector3::ith(axis, 1.0),
            );
            let by: Vector3<f64> = by_target.matrix().row(axis).transpose();
            spread(&mut shared, layout.target_turn(slot), &by);
            out.push(Row {
                group: Group::Turn,
                index: 3 * index + axis,
                residual: off[axis],
                own,
                shared,
                scale: [1.0, 0.0],
            });
        }
    }
}

impl Set {
    /// Indices of the trackers with readings.
    pub(crate) fn tracking(&self) -> Vec<usize> {
        let reads = |t: &usize| self.samples.iter().any(|sample| sample.is_tracked(*t));
        (0..self.trackers.len()).filter(reads).collect()
    }

    /// Indices of the tapes with readings.
    pub(crate) fn taped(&self) -> Vec<usize> {
        let read = |sample: &Sample, t: usize| sample.distance_m.get(t).copied().flatten();
        let reads = |t: &usize| self.samples.iter().any(|s| read(s, *t).is_some());
        (0..self.tapes.len()).filter(reads).collect()
    }

    /// The set without readings of trackers and tapes.
    pub(crate) fn alone(&self) -> Self {
        let mut out = self.clone();
        for sample in &mut out.samples {
            sample.position_m.clear();
            sample.turned.clear();
            sample.distance_m.clear();
        }
        out
    }

    /// The set with a start value of every tracker's frame and target, from approximate poses of all samples.
    ///
    /// # Errors
    /// In words, where a tracker's positions do not determine its frame.
    pub(crate) fn placed(&self, poses: &[Pose]) -> Result<Self, String> {
        let mut out = self.clone();
        for index in self.tracking() {
            let tracker = &mut out.trackers[index];
            let frame = self.frame_of(index, tracker, poses)?;
            let mut sum = Matrix3::zeros();
            for (sample, pose) in self.samples.iter().zip(poses) {
                if let Some(Some(turned)) = sample.turned.get(index) {
                    sum +=
                        (pose.rotation.inverse() * frame.rotation.inverse() * turned).into_inner();
                }
            }
            let target = nearest_rotation(&sum).unwrap_or_else(Rotation3::identity);
            tracker.start = Some((frame, target));
        }
        Ok(out)
    }

    fn frame_of(&self, index: usize, tracker: &Tracker, poses: &[Pose]) -> Result<Pose, String> {
        let target = tracker.target_m.unwrap_or_default();
        let (mut here, mut seen) = (Vec::new(), Vec::new());
        for (sample, pose) in self.samples.iter().zip(poses) {
            if let Some([Some(x), Some(y), Some(z)]) = sample.position_m.get(index) {
                here.push(pose.position_m + pose.rotation * target);
                seen.push(Vector3::new(*x, *y, *z));
            }
        }
        let name = &tracker.name;
        let n = seen.len();
        if n < 3 {
            return Err(format!(
                "tracker {name} has {n} whole positions; its frame needs 3 that do not lie on one line"
            ));
        }
        let middle = seen.iter().sum::<Vector3<f64>>() / n as f64;
        let spread: Matrix3<f64> = seen
            .iter()
            .map(|p| (p - middle) * (p - middle).transpose())
            .sum();
        let aside_m = (spread.singular_values()[1] / n as f64).sqrt();
        if aside_m < ASIDE_M {
            return Err(format!(
                "the positions of tracker {name} lie within {:.1} mm of one line, so its frame is not determined; \
                 add positions beside that line",
                aside_m * 1e3
            ));
        }
        let (rotation, shift) = best_motion(&here, &seen).ok_or_else(|| {
            format!("the positions of tracker {name} do not fit the lengths; check their unit")
        })?;
        Ok(Pose::new(shift, Rotation3::from_matrix_unchecked(rotation)))
    }
}
