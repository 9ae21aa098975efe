//! Rows of positions and attitudes as poses of the platform.

use crate::failure::Failure;
use crate::rows::Table;
use mcdpr::compute::{ComputeError, Subject};
use mcdpr_kinematics::{AnyRobot, Pose, rotation_from_rpy};
use nalgebra::{Rotation3, Vector3};
use numpy::PyReadonlyArray2;
use pyo3::PyResult;
use std::ops::Range;

/// Poses of the platform, row by row.
pub(crate) struct Poses {
    position: Table,
    attitude: Option<Table>,
    point_m: Vector3<f64>,
    level: Rotation3<f64>,
}

impl Poses {
    /// Of positions (n, 3) of the platform, or of the tool, and attitudes (n, 3); level without any.
    pub(crate) fn of(
        subject: &Subject,
        position: &PyReadonlyArray2<'_, f64>,
        attitude: Option<&PyReadonlyArray2<'_, f64>>,
        tool: bool,
    ) -> PyResult<Self> {
        Ok(Self {
            position: Table::of("position_m", position, 3)?,
            attitude: table_of("attitude_rad", attitude, 3)?,
            point_m: subject.point(tool),
            level: rotation_from_rpy([0.0; 3]),
        })
    }

    /// Whether no attitude is given.
    pub(crate) const fn are_level(&self) -> bool {
        self.attitude.is_none()
    }

    #[inline]
    pub(crate) fn at(&self, index: usize) -> Pose {
        let position = Vector3::from(self.position.triple(index));
        let rotation = match &self.attitude {
            Some(attitude) => rotation_from_rpy(attitude.triple(index)),
            None => self.level,
        };
        Pose::new(position - rotation * self.point_m, rotation)
    }
}

/// Lengths of a level platform at some of the places: one pose that moves, straight into the rows of the
/// answer.
pub(crate) fn level_lengths(
    geometry: &AnyRobot,
    poses: &Poses,
    nan: bool,
    range: Range<usize>,
    out: &mut [f64],
) -> Result<(), Failure> {
    let mut pose = Pose::new(Vector3::zeros(), poses.level);
    let shift = poses.level * poses.point_m;
    let rows = out.chunks_exact_mut(geometry.cable_count());
    let places = poses.position.rows(range.clone());
    for (index, (place, row)) in range.zip(places.zip(rows)) {
        let [x, y, z] = place else { continue };
        pose.position_m = Vector3::new(*x, *y, *z) - shift;
        let done = match geometry {
            // The usual number of cables without a choice at every pose.
            AnyRobot::C4(robot) => robot.lengths_m(&pose).map(|got| row.copy_from_slice(&got)),
            robot => robot.lengths_into(&pose, row),
        };
        match done {
            Ok(()) => {}
            Err(_) if nan => row.fill(f64::NAN),
            Err(error) => {
                return Err(Failure::from(ComputeError::from(error)).with("index", index));
            }
        }
    }
    Ok(())
}

/// A table of an array that may be absent.
///
/// # Errors
/// As [`Table::of`].
pub(crate) fn table_of(
    name: &str,
    array: Option<&PyReadonlyArray2<'_, f64>>,
    width: usize,
) -> PyResult<Option<Table>> {
    array.map(|array| Table::of(name, array, width)).transpose()
}
