//! Calibration: data in, answer with covariance out.

use crate::failure::{Failure, to_python};
use crate::robot::Robot;
use crate::rows::array;
use mcdpr::calibration::paper::{Weights, paper};
use mcdpr::calibration::{Data, Options, joint, result};
use numpy::PyArray2;
use pyo3::prelude::*;

/// What a calibration found, with the data it was found from.
#[pyclass(frozen, name = "Answer", module = "mcdpr._mcdpr")]
pub(crate) struct Answer {
    data: Data,
    answer: mcdpr::calibration::Answer,
}

#[pymethods]
impl Answer {
    /// Solves data (text of a file of format `mcdpr-calibration-data-1`).
    #[new]
    fn new(py: Python<'_>, text: &str, method: &str, without_statics: bool) -> PyResult<Self> {
        let solved = py.detach(|| {
            let data = Data::from_json(text)?;
            let answer = match method {
                "joint" => joint(
                    &data,
                    &Options {
                        without_statics,
                        closer_looks: true,
                        ..Options::default()
                    },
                )?,
                "paper" => paper(&data, &Weights::default())?,
                other => {
                    let words = format!("method: \"{other}\"; it is \"joint\" or \"paper\"");
                    return Err(Failure::input(words));
                }
            };
            Ok::<_, Failure>(Self { data, answer })
        });
        Ok(solved?)
    }

    /// The document of `mcdpr calibrate all --json`: mm, kg, N, px.
    fn document<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.answer.to_json())
    }

    /// The text of the calibration file for a robot.
    fn file(&self, robot: &Robot) -> PyResult<String> {
        let document = result::document(&robot.subject.robot, &self.data, &self.answer)
            .map_err(|error| Failure::of("CalibrationError", &error))?;
        let text = serde_json::to_string_pretty(&document)
            .map_err(|error| Failure::new("CalibrationError", error.to_string()))?;
        Ok(format!("{text}\n"))
    }

    #[getter]
    fn anchors_m(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        let anchors = self.answer.cables.iter();
        let values = anchors.flat_map(|cable| cable.anchor_m.iter().copied().collect::<Vec<_>>());
        array(py, values.collect(), 3)
    }

    #[getter]
    fn attachments_m(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        let cables = self.answer.cables.iter();
        let each = |cable: &mcdpr_kinematics::Cable| {
            cable.attachment_m.iter().copied().collect::<Vec<_>>()
        };
        array(py, cables.flat_map(each).collect(), 3)
    }

    #[getter]
    fn initial_length_m(&self) -> Vec<f64> {
        self.answer.initial_length_m.clone()
    }

    /// Covariance of all shared unknowns, SI.
    #[getter]
    fn covariance(&self, py: Python<'_>) -> PyResult<Option<Py<PyArray2<f64>>>> {
        let Some(covariance) = &self.answer.covariance else {
            return Ok(None);
        };
        // Symmetric: its order does not matter.
        let values = covariance.iter().copied().collect();
        Ok(Some(array(py, values, covariance.ncols())?))
    }

    /// Names of the rows of the covariance.
    #[getter]
    fn unknowns(&self) -> Vec<String> {
        let Some(solved) = &self.answer.solved else {
            return Vec::new();
        };
        let layout = &solved.layout;
        let mut names = vec![String::new(); layout.len()];
        let mut put = |first: usize, words: &[String]| {
            for (slot, word) in names.iter_mut().skip(first).zip(words) {
                slot.clone_from(word);
            }
        };
        let each = |what: &str, parts: &[&str]| -> Vec<String> {
            parts.iter().map(|part| format!("{what}.{part}")).collect()
        };
        let turn = ["x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"];
        for cable in 0..layout.cables {
            let name = format!("cable.{}", cable + 1);
            let place = |what: &str| each(&format!("{name}.{what}"), &turn[..3]);
            put(layout.anchor(cable), &place("anchor"));
            put(layout.attachment(cable), &place("attachment"));
            put(
                layout.initial_length(cable),
                &[format!("{name}.initial_length_m")],
            );
            put(layout.drum(cable), &[format!("{name}.own_drum_scale")]);
            put(layout.radius(cable), &[format!("{name}.pulley_radius_m")]);
            if layout.statics {
                put(layout.loss(cable), &[format!("{name}.loss")]);
                put(layout.zero(cable), &[format!("{name}.tension_zero_n")]);
                put(
                    layout.soft(cable),
                    &[format!("{name}.own_compliance_per_n")],
                );
            }
        }
        put(layout.camera(), &each("camera_from_platform", &turn));
        for body in 0..layout.bodies {
            put(layout.body(body), &each(&format!("body.{body}"), &turn));
        }
        let scales = [
            "drum_scale",
            "focal_scale",
            "cx_px",
            "cy_px",
            "k1",
            "tag_scale",
        ];
        put(layout.scales(), &scales.map(str::to_owned));
        if layout.statics {
            let statics = [
                "compliance_per_n",
                "mass_kg",
                "center_of_mass.x_m",
                "center_of_mass.y_m",
                "center_of_mass.z_m",
            ];
            put(layout.statics(), &statics.map(str::to_owned));
        }
        names
    }

    #[getter]
    fn predicted_error_m(&self) -> f64 {
        self.answer.predicted_error_m
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.answer.warnings.clone()
    }
}
