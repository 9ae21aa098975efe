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

/// Lengths at some of the poses, straight into the rows of the answer.
pub(crate) fn lengths(
    geometry: &AnyRobot,
    poses: &Poses,
    nan: bool,
    range: Range<usize>,
    out: &mut [f64],
) -> Result<(), Failure> {
    let first = range.start;
    let refused = if poses.attitude.is_some() {
        geometry.lengths_of_poses(range.map(|index| poses.at(index)), out)
    } else {
        let shift = poses.level * poses.point_m;
        let places = poses.position.rows(range);
        let places = places.map(|place| match place {
            [x, y, z] => Vector3::new(*x, *y, *z) - shift,
            _ => Vector3::repeat(f64::NAN),
        });
        geometry.lengths_of_places(&poses.level, places, out)
    };
    match refused {
        Some((index, error)) if !nan => {
            Err(Failure::from(ComputeError::from(error)).with("index", first + index))
        }
        _ => Ok(()),
    }
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
