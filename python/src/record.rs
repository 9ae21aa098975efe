//! Recorded runs as arrays.

use crate::failure::{Failure, to_python};
use crate::rows::array;
use mcdpr::record::RecordedRun;
use mcdpr::record::decode::Seen;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;
use std::path::Path;

/// A recorded run, read back.
#[pyclass(frozen, name = "Record", module = "mcdpr._mcdpr")]
pub(crate) struct Record {
    run: RecordedRun,
}

#[pymethods]
impl Record {
    /// A run's folder or file.
    #[staticmethod]
    fn load(py: Python<'_>, path: &str) -> PyResult<Self> {
        let run = py.detach(|| mcdpr::record::load(Path::new(path)).map_err(Failure::from))?;
        Ok(Self { run })
    }

    #[getter]
    fn path(&self) -> String {
        self.run.path.display().to_string()
    }

    #[getter]
    fn duration_s(&self) -> f64 {
        self.run.duration_s()
    }

    #[getter]
    fn gaps(&self) -> u64 {
        self.run.gaps
    }

    /// What the end of the file lacks, in words.
    #[getter]
    fn damage(&self) -> Option<String> {
        self.run.damage.as_ref().map(|damage| format!("{damage:?}"))
    }

    fn scenario<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let value = serde_json::to_value(&self.run.scenario)
            .map_err(|error| Failure::new("RecordError", error.to_string()))?;
        to_python(py, &value)
    }

    /// What the board measured, tick by tick.
    fn ticks<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let ticks = py.detach(|| self.run.ticks());
        let n = ticks.first().map_or(0, |tick| tick.lengths_m.len());
        let flat = |pick: &dyn Fn(&mcdpr::record::decode::Tick) -> &[f64]| -> Vec<f64> {
            let rows = ticks.iter().flat_map(|tick| pick(tick).iter().copied());
            rows.collect()
        };
        let planned = |pick: fn(&mcdpr::record::decode::Planned) -> f64| -> Vec<f64> {
            let of_tick = |tick: &mcdpr::record::decode::Tick| -> Vec<f64> {
                (0..n)
                    .map(|cable| tick.planned.get(cable).map_or(f64::NAN, pick))
                    .collect()
            };
            ticks.iter().flat_map(of_tick).collect()
        };
        let out = PyDict::new(py);
        out.set_item("tick", column(py, ticks.iter().map(|tick| tick.tick)))?;
        let path = ticks.iter().map(|tick| tick.path_s.unwrap_or(f64::NAN));
        out.set_item("path_s", column(py, path))?;
        out.set_item("lengths_m", array(py, flat(&|tick| &tick.lengths_m), n)?)?;
        out.set_item("tensions_n", array(py, flat(&|tick| &tick.tensions_n), n)?)?;
        out.set_item("currents_a", array(py, flat(&|tick| &tick.currents_a), n)?)?;
        out.set_item("planned_lengths_m", array(py, planned(|p| p.length_m), n)?)?;
        out.set_item(
            "planned_speeds_mps",
            array(py, planned(|p| p.speed_mps), n)?,
        )?;
        out.set_item(
            "planned_tensions_n",
            array(py, planned(|p| p.tension_n), n)?,
        )?;
        Ok(out)
    }

    /// Where a simulated robot truly was, tick by tick; empty for a real one.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let truth = &self.run.truth;
        let n = truth.first().map_or(0, |point| point.tensions_n.len());
        let out = PyDict::new(py);
        out.set_item("tick", column(py, truth.iter().map(|point| point.tick)))?;
        out.set_item("path_s", column(py, truth.iter().map(|point| point.path_s)))?;
        let tool = truth.iter().flat_map(|point| point.tool_m).collect();
        out.set_item("tool_m", array(py, tool, 3)?)?;
        let position = truth.iter().flat_map(|point| point.position_m).collect();
        out.set_item("position_m", array(py, position, 3)?)?;
        let rotation = truth.iter().flat_map(|point| point.rotation_xyzw).collect();
        out.set_item("rotation_xyzw", array(py, rotation, 4)?)?;
        let tensions = truth.iter().flat_map(|point| point.tensions_n.clone());
        out.set_item("tensions_n", array(py, tensions.collect(), n)?)?;
        Ok(out)
    }

    /// What was planned, every 20 ms; empty without a plan.
    fn plan<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let points = self.run.plan.as_ref().map_or(&[][..], |plan| &plan.points);
        let n = points.first().map_or(0, |point| point.tensions_n.len());
        let out = PyDict::new(py);
        out.set_item(
            "path_s",
            column(py, points.iter().map(|point| point.time_s)),
        )?;
        let tool = points.iter().flat_map(|point| point.tool_m).collect();
        out.set_item("tool_m", array(py, tool, 3)?)?;
        let position = points.iter().flat_map(|point| point.position_m).collect();
        out.set_item("position_m", array(py, position, 3)?)?;
        let rotation = points
            .iter()
            .flat_map(|point| point.rotation_xyzw)
            .collect();
        out.set_item("rotation_xyzw", array(py, rotation, 4)?)?;
        let tensions = points.iter().flat_map(|point| point.tensions_n.clone());
        out.set_item("tensions_n", array(py, tensions.collect(), n)?)?;
        Ok(out)
    }

    /// The board's states, ten a second.
    fn status<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let seen = py.detach(|| self.run.seen());
        let states: Vec<_> = seen
            .iter()
            .filter_map(|report| match &report.seen {
                Seen::Status(status) => Some((report.time_s, status)),
                _ => None,
            })
            .collect();
        let out = PyDict::new(py);
        out.set_item(
            "time_s",
            column(py, states.iter().map(|(time_s, _)| *time_s)),
        )?;
        out.set_item("tick", column(py, states.iter().map(|(_, s)| s.tick.0)))?;
        let path = states.iter().map(|(_, s)| f64::from(s.path_ms) * 1e-3);
        out.set_item("path_s", column(py, path))?;
        let state: Vec<_> = states
            .iter()
            .map(|(_, s)| format!("{:?}", s.state))
            .collect();
        out.set_item("state", state)?;
        let fault = states
            .iter()
            .map(|(_, s)| s.fault.map(|fault| fault.fault.name()));
        out.set_item("fault", fault.collect::<Vec<_>>())?;
        Ok(out)
    }

    /// Changes of state and faults: time (s) and words.
    fn changes(&self, py: Python<'_>) -> Vec<(f64, String)> {
        let changes = py.detach(|| self.run.changes()).into_iter();
        changes.map(|change| (change.time_s, change.text)).collect()
    }

    /// The log: time, level, words.
    fn log<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let lines = self.run.log.iter().map(
            |line| json!({ "time_s": line.time_s, "level": line.level, "message": line.text }),
        );
        to_python(py, &lines.collect())
    }
}

/// One number per row.
fn column<T: numpy::Element>(py: Python<'_>, values: impl Iterator<Item = T>) -> Py<PyArray1<T>> {
    PyArray1::from_vec(py, values.collect()).unbind()
}
