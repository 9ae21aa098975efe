//! Answers row by row: one pose in, one row of each result out, without Python's lock.

use crate::batch::in_parts;
use crate::failure::Failure;
use mcdpr::compute::ComputeError;
use numpy::{PyArray2, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::ops::Range;

/// A two-dimensional array of numbers, row after row.
pub(crate) struct Table {
    values: Vec<f64>,
    width: usize,
}

impl Table {
    /// From an array with this many columns.
    pub(crate) fn of(
        name: &str,
        array: &PyReadonlyArray2<'_, f64>,
        width: usize,
    ) -> PyResult<Self> {
        let [_, got] = [array.shape()[0], array.shape()[1]];
        if got != width {
            let words = format!("{name}: {got} numbers along the last axis, {width} needed");
            return Err(Failure::input(words).into());
        }
        // A copy: another thread of Python may change the array while this one computes without the lock.
        let values = match array.as_slice() {
            Ok(values) => values.to_vec(),
            // Whatever its strides are.
            Err(_) => array.as_array().iter().copied().collect(),
        };
        Ok(Self { values, width })
    }

    /// Every number, row after row.
    pub(crate) fn values_mut(&mut self) -> impl Iterator<Item = &mut f64> {
        self.values.iter_mut()
    }

    /// Some of the rows.
    pub(crate) fn rows(&self, range: Range<usize>) -> impl Iterator<Item = &[f64]> {
        let part = range.start * self.width..range.end * self.width;
        let part = self.values.get(part).unwrap_or_default();
        part.chunks_exact(self.width)
    }

    /// One row.
    pub(crate) fn row(&self, index: usize) -> &[f64] {
        let from = index * self.width;
        self.values.get(from..from + self.width).unwrap_or_default()
    }

    /// One row of three.
    pub(crate) fn triple(&self, index: usize) -> [f64; 3] {
        <[f64; 3]>::try_from(self.row(index)).unwrap_or([f64::NAN; 3])
    }
}

/// What a batch came to: one table per result, and the first refusal if refusals do not become NaN.
pub(crate) struct Answers<const K: usize> {
    tables: [Vec<f64>; K],
    widths: [usize; K],
}

impl<const K: usize> Answers<K> {
    /// `count` rows by `solve`, which fills the row of each result, on all processors where there are
    /// several times `least` rows. A row that is refused stays NaN if `nan`; otherwise it ends the batch, and
    /// the exception has its `index`.
    pub(crate) fn solve(
        py: Python<'_>,
        (count, least): (usize, usize),
        widths: [usize; K],
        nan: bool,
        solve: impl Fn(usize, [&mut [f64]; K]) -> Result<(), ComputeError> + Sync,
    ) -> PyResult<Self> {
        // Zeros come from the system when they are first written.
        let mut tables = widths.map(|width| vec![0.0; width * count]);
        let part = |range: Range<usize>, mut rows: [&mut [f64]; K]| {
            for (offset, index) in range.enumerate() {
                let mut which = widths.iter();
                let own = rows.each_mut().map(|part| {
                    let width = which.next().copied().unwrap_or(0);
                    let row = part.get_mut(offset * width..(offset + 1) * width);
                    let row = row.unwrap_or_default();
                    row.fill(f64::NAN);
                    row
                });
                match solve(index, own) {
                    Err(error) if !nan => return Err(Failure::from(error).with("index", index)),
                    _ => {}
                }
            }
            Ok(())
        };
        py.detach(|| in_parts(&mut tables, widths, count, least, part))?;
        Ok(Self { tables, widths })
    }

    /// As arrays with one row each.
    pub(crate) fn arrays(self, py: Python<'_>) -> PyResult<[Py<PyArray2<f64>>; K]> {
        let mut failed = None;
        let mut widths = self.widths.into_iter();
        let arrays = self.tables.map(|table| {
            let width = widths.next().unwrap_or(0);
            match array(py, table, width) {
                Ok(array) => array,
                Err(error) => {
                    failed = Some(error);
                    PyArray2::zeros(py, [0, 0], false).unbind()
                }
            }
        });
        failed.map_or(Ok(arrays), Err)
    }
}

/// Numbers, row after row, as an array.
pub(crate) fn array(py: Python<'_>, values: Vec<f64>, width: usize) -> PyResult<Py<PyArray2<f64>>> {
    use numpy::{PyArray1, PyArrayMethods};
    let rows = values.len() / width.max(1);
    let flat = PyArray1::from_vec(py, values);
    Ok(flat.reshape([rows, width])?.unbind())
}

/// Copies numbers into a row, as many as both have.
pub(crate) fn fill<'a>(row: &mut [f64], values: impl IntoIterator<Item = &'a f64>) {
    for (slot, value) in row.iter_mut().zip(values) {
        *slot = *value;
    }
}
