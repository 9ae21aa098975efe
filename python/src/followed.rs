//! The record of a motion, as arrays.

use crate::failure::{Failure, to_python};
use crate::rows::array;
use mcdpr::report;
use mcdpr_core::motion::{Model, Plan};
use mcdpr_core::run::Measured;
use mcdpr_simulator::TracePoint;
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;

type Two = Py<PyArray2<f64>>;

/// What was measured of a motion, and what was true.
#[pyclass(frozen, name = "Followed", module = "mcdpr._mcdpr")]
pub(crate) struct Followed {
    samples: Vec<Measured>,
    trace: Vec<TracePoint>,
    figures: Value,
    cables: usize,
}

impl Followed {
    /// Judges a run; without a trace, by what was measured alone.
    pub(crate) fn new(
        model: &Model,
        plan: &Plan,
        samples: Vec<Measured>,
        trace: Option<Vec<TracePoint>>,
    ) -> Result<Self, Failure> {
        Ok(Self {
            figures: figures(model, plan, &samples, trace.as_deref())?,
            samples,
            trace: trace.unwrap_or_default(),
            cables: model.robot().cables.len(),
        })
    }
}

#[pymethods]
impl Followed {
    /// Errors of path, lengths and tensions, as `mcdpr demo --json` has them.
    fn figures<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.figures)
    }

    /// What the board measured, tick by tick.
    fn measured<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let flat = |pick: fn(&Measured) -> &Vec<f64>| -> PyResult<Two> {
            let rows = self.samples.iter().flat_map(|sample| pick(sample).clone());
            array(py, rows.collect(), self.cables)
        };
        let out = PyDict::new(py);
        let ticks = self.samples.iter().map(|sample| sample.tick).collect();
        out.set_item("tick", PyArray1::<u32>::from_vec(py, ticks))?;
        let path = self.samples.iter().map(|s| s.path_s.unwrap_or(f64::NAN));
        out.set_item("path_s", PyArray1::from_vec(py, path.collect()))?;
        out.set_item("lengths_m", flat(|sample| &sample.lengths_m)?)?;
        out.set_item("tensions_n", flat(|sample| &sample.tensions_n)?)?;
        out.set_item("currents_a", flat(|sample| &sample.currents_a)?)?;
        Ok(out)
    }

    /// What was true, tick by tick; empty on hardware.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        truth_arrays(py, &self.trace, self.cables)
    }
}

fn figures(
    model: &Model,
    plan: &Plan,
    samples: &[Measured],
    trace: Option<&[TracePoint]>,
) -> Result<Value, Failure> {
    let path = trace.map(report::true_path);
    let figures = report::measure(model, plan, samples, path.as_deref())?;
    serde_json::to_value(figures).map_err(|error| Failure::new("RunError", error.to_string()))
}

/// A trace as arrays.
pub(crate) fn truth_arrays<'py>(
    py: Python<'py>,
    trace: &[TracePoint],
    cables: usize,
) -> PyResult<Bound<'py, PyDict>> {
    let three =
        |pick: fn(&TracePoint) -> [f64; 3]| array(py, trace.iter().flat_map(pick).collect(), 3);
    let rows = |pick: fn(&TracePoint) -> &[f64]| {
        let each =
            |point: &TracePoint| pick(point).iter().take(cables).copied().collect::<Vec<_>>();
        array(py, trace.iter().flat_map(each).collect(), cables)
    };
    let out = PyDict::new(py);
    let ticks = trace.iter().map(|point| point.tick.0).collect();
    out.set_item("tick", PyArray1::<u32>::from_vec(py, ticks))?;
    let path = trace.iter().map(|point| f64::from(point.path_ms) * 1e-3);
    out.set_item("path_s", PyArray1::from_vec(py, path.collect()))?;
    let time = trace.iter().map(|point| point.truth.time_s);
    out.set_item("time_s", PyArray1::from_vec(py, time.collect()))?;
    out.set_item("tool_m", three(|point| point.truth.tool_position_m)?)?;
    out.set_item("position_m", three(|point| point.truth.pose.position_m)?)?;
    let turned = trace.iter().flat_map(|point| {
        let [w, x, y, z] = point.truth.pose.rotation_wxyz;
        [x, y, z, w]
    });
    out.set_item("rotation_xyzw", array(py, turned.collect(), 4)?)?;
    out.set_item("lengths_m", rows(|point| &point.truth.cable_lengths_m)?)?;
    out.set_item(
        "tensions_n",
        rows(|point| &point.truth.tensions_platform_n)?,
    )?;
    Ok(out)
}
