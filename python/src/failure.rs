//! What the host refuses, as Python exceptions: the same words, with the numbers as fields.

use mcdpr::compute::ComputeError;
use mcdpr::record::LoadError;
use mcdpr::robot::RobotError;
use mcdpr::run::RunError;
use mcdpr_calibration::Refusal;
use mcdpr_core::faults::{advice, describe_fault};
use mcdpr_core::holding::HoldingError;
use mcdpr_core::motion::{PlanError, TaskError};
use mcdpr_kinematics::Error;
use mcdpr_protocol::FaultRecord;
use miette::Diagnostic;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use serde_json::{Value, json};

/// An exception that is still to be raised: it passes between threads, and needs no Python.
#[derive(Debug)]
pub(crate) struct Failure {
    class: &'static str,
    message: String,
    help: Option<String>,
    code: Option<String>,
    causes: Vec<String>,
    fields: Vec<(&'static str, Value)>,
}

impl Failure {
    /// Of a class of `mcdpr.errors`, with these words.
    pub(crate) fn new(class: &'static str, message: impl Into<String>) -> Self {
        Self {
            class,
            message: message.into(),
            help: None,
            code: None,
            causes: Vec::new(),
            fields: Vec::new(),
        }
    }

    /// An invalid argument.
    pub(crate) fn input(message: impl Into<String>) -> Self {
        Self::new("InputError", message)
    }

    /// As the program words it.
    pub(crate) fn of(class: &'static str, error: &(impl Diagnostic + ?Sized)) -> Self {
        let mut causes = Vec::new();
        let mut cause = std::error::Error::source(error);
        while let Some(inner) = cause {
            causes.push(inner.to_string());
            cause = inner.source();
        }
        Self {
            class,
            message: error.to_string(),
            help: error.help().map(|help| help.to_string()),
            code: error.code().map(|code| code.to_string()),
            causes,
            fields: Vec::new(),
        }
    }

    /// With one more field.
    pub(crate) fn with(mut self, name: &'static str, value: impl Into<Value>) -> Self {
        self.fields.push((name, value.into()));
        self
    }

    fn with_all(mut self, fields: Vec<(&'static str, Value)>) -> Self {
        self.fields.extend(fields);
        self
    }

    fn raise(self, py: Python<'_>) -> PyResult<PyErr> {
        let fields = PyDict::new(py);
        fields.set_item("help", self.help)?;
        fields.set_item("code", self.code)?;
        fields.set_item("causes", self.causes)?;
        for (name, value) in self.fields {
            fields.set_item(name, to_python(py, &value)?)?;
        }
        let class = py.import("mcdpr.errors")?.getattr(self.class)?;
        Ok(PyErr::from_value(
            class.call((self.message,), Some(&fields))?,
        ))
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        Python::attach(|py| failure.raise(py).unwrap_or_else(|error| error))
    }
}

/// A JSON value as Python has it.
pub(crate) fn to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Null => py.None().into_bound(py),
        Value::Bool(value) => value.into_pyobject(py)?.to_owned().into_any(),
        Value::Number(number) => match (number.as_i64(), number.as_f64()) {
            (Some(whole), _) => whole.into_pyobject(py)?.into_any(),
            (None, Some(number)) => number.into_pyobject(py)?.into_any(),
            (None, None) => return Err(PyRuntimeError::new_err("a number that JSON cannot hold")),
        },
        Value::String(text) => text.into_pyobject(py)?.into_any(),
        Value::Array(values) => {
            let list = PyList::empty(py);
            for value in values {
                list.append(to_python(py, value)?)?;
            }
            list.into_any()
        }
        Value::Object(entries) => {
            let dict = PyDict::new(py);
            for (key, value) in entries {
                dict.set_item(key, to_python(py, value)?)?;
            }
            dict.into_any()
        }
    })
}

/// Kind and numbers of a refusal of the mathematics.
fn of_kinematics(error: &Error) -> Vec<(&'static str, Value)> {
    let solver = |solver: &mcdpr_kinematics::Solver| json!(solver.to_string());
    match error {
        Error::CableCount { expected, got } => vec![
            ("kind", json!("CableCount")),
            ("expected", json!(expected)),
            ("got", json!(got)),
        ],
        Error::InvalidCable { cable, value, .. } => vec![
            ("kind", json!("InvalidCable")),
            ("cable", json!(cable)),
            ("value", json!(value)),
        ],
        Error::InvalidPlatform { value, .. } => {
            vec![("kind", json!("InvalidPlatform")), ("value", json!(value))]
        }
        Error::InvalidInput { cable, value, .. } => vec![
            ("kind", json!("InvalidInput")),
            ("cable", json!(cable)),
            ("value", json!(value)),
        ],
        Error::InsidePulley {
            cable,
            distance_m,
            radius_m,
        } => vec![
            ("kind", json!("InsidePulley")),
            ("cable", json!(cable)),
            ("distance_m", json!(distance_m)),
            ("radius_m", json!(radius_m)),
        ],
        Error::OnSwivelAxis { cable } => {
            vec![("kind", json!("OnSwivelAxis")), ("cable", json!(cable))]
        }
        Error::TooFewCables {
            solver: by,
            needed,
            got,
        } => vec![
            ("kind", json!("TooFewCables")),
            ("solver", solver(by)),
            ("needed", json!(needed)),
            ("got", json!(got)),
        ],
        Error::NotConverged {
            solver: by,
            iterations,
            residual,
        } => vec![
            ("kind", json!("NotConverged")),
            ("solver", solver(by)),
            ("iterations", json!(iterations)),
            ("residual", json!(residual)),
        ],
        Error::ResidualTooLarge {
            solver: by,
            residual_m,
            limit_m,
        } => vec![
            ("kind", json!("ResidualTooLarge")),
            ("solver", solver(by)),
            ("residual_m", json!(residual_m)),
            ("limit_m", json!(limit_m)),
        ],
        Error::Singular { solver: by } => vec![("kind", json!("Singular")), ("solver", solver(by))],
        Error::NegativeTension { cable, tension_n } => vec![
            ("kind", json!("NegativeTension")),
            ("cable", json!(cable)),
            ("tension_n", json!(tension_n)),
        ],
        Error::OutsideTensionLimits {
            cable,
            bound,
            violation_n,
        } => vec![
            ("kind", json!("OutsideTensionLimits")),
            ("cable", json!(cable)),
            ("bound", json!(bound.to_string())),
            ("violation_n", json!(violation_n)),
        ],
        Error::WrenchNotBalanced { residual_n } => vec![
            ("kind", json!("WrenchNotBalanced")),
            ("residual_n", json!(residual_n)),
        ],
        Error::Unbounded { solver: by } => {
            vec![("kind", json!("Unbounded")), ("solver", solver(by))]
        }
        other => vec![("kind", json!(format!("{other:?}")))],
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self::from(ComputeError::from(error))
    }
}

impl From<ComputeError> for Failure {
    fn from(error: ComputeError) -> Self {
        let failure = Self::of("KinematicsError", &error);
        match &error {
            ComputeError::Kinematics(inner) => failure.with_all(of_kinematics(inner)),
            ComputeError::Planar { refusal } => failure
                .with("kind", "Planar")
                .with("refusal", refusal.to_string()),
            ComputeError::BothHeld { cable } => {
                failure.with("kind", "BothHeld").with("cable", *cable)
            }
            ComputeError::NeitherHeld { cable } => {
                failure.with("kind", "NeitherHeld").with("cable", *cable)
            }
            ComputeError::LengthHeld { held, count, .. } => failure
                .with("kind", "LengthHeld")
                .with("held", *held)
                .with("count", *count),
            ComputeError::AttitudeFollows => failure.with("kind", "AttitudeFollows"),
            ComputeError::TooFewForAll { count } => {
                failure.with("kind", "TooFewForAll").with("count", *count)
            }
            _ => failure.with("kind", "Arguments"),
        }
    }
}

impl From<RobotError> for Failure {
    fn from(error: RobotError) -> Self {
        let invalid = match &error {
            RobotError::Invalid(invalid) => Some(invalid),
            _ => None,
        };
        let problems: Vec<_> = invalid
            .into_iter()
            .flat_map(|invalid| std::iter::once(&invalid.first).chain(&invalid.others))
            .map(|problem| {
                json!({
                    "file": problem.file,
                    "line": problem.line,
                    "place": problem.place,
                    "what": problem.what,
                    "help": problem.help,
                })
            })
            .collect();
        Self::of("RobotError", &error).with("problems", problems)
    }
}

impl From<PlanError> for Failure {
    fn from(error: PlanError) -> Self {
        let failure = Self::of("PlanError", &error);
        match &error {
            PlanError::Limit {
                time_s,
                x_mm,
                y_mm,
                z_mm,
                what,
                value,
                limit,
                unit,
            } => failure
                .with("time_s", *time_s)
                .with("tool_m", json!([x_mm * 1e-3, y_mm * 1e-3, z_mm * 1e-3]))
                .with("what", what.clone())
                .with("value", *value)
                .with("limit", *limit)
                .with("unit", *unit),
            PlanError::NoEquilibrium {
                x_mm,
                y_mm,
                z_mm,
                source,
            } => failure
                .with("tool_m", json!([x_mm * 1e-3, y_mm * 1e-3, z_mm * 1e-3]))
                .with_all(of_kinematics(source)),
            PlanError::Step {
                what,
                asked,
                limit,
                unit,
            } => failure
                .with("what", what.clone())
                .with("value", *asked)
                .with("limit", *limit)
                .with("unit", *unit),
            PlanError::Holding(HoldingError::Count { held, .. }) => failure.with("held", *held),
            PlanError::Reach {
                step,
                cable,
                distance_mm,
                reach_mm,
                ..
            } => failure
                .with("step", *step)
                .with("cable", *cable)
                .with("distance_m", distance_mm * 1e-3)
                .with("reach_m", reach_mm * 1e-3),
            _ => failure,
        }
    }
}

impl From<TaskError> for Failure {
    fn from(error: TaskError) -> Self {
        Self::of("TaskError", &error)
    }
}

/// The fields of a fault.
pub(crate) fn of_fault(record: &FaultRecord) -> Vec<(&'static str, Value)> {
    vec![
        ("fault", json!(record.fault.name())),
        ("cable", json!((record.cable > 0).then_some(record.cable))),
        ("tick", json!(record.tick.0)),
        ("value", json!(record.value)),
        ("limit", json!(record.limit)),
        ("words", json!(describe_fault(record))),
        ("advice", json!(advice(record.fault))),
    ]
}

impl From<RunError> for Failure {
    fn from(error: RunError) -> Self {
        match error {
            RunError::Plan(error) => error.into(),
            RunError::Task(error) => error.into(),
            RunError::Fault { record, ref why } => Self::of("FaultError", &error)
                .with_all(of_fault(&record))
                .with("probable_cause", why.as_ref().map(|why| why.fault.name()))
                .with("probable_cable", why.as_ref().map(|why| why.cable)),
            RunError::Latched { record } => {
                Self::of("FaultError", &error).with_all(of_fault(&record))
            }
            error => Self::of("RunError", &error),
        }
    }
}

impl From<Refusal> for Failure {
    fn from(error: Refusal) -> Self {
        let failure = Self::of("CalibrationError", &error);
        match &error {
            Refusal::Field { path, what } => failure
                .with("path", path.clone())
                .with("what", what.clone()),
            Refusal::TooFewPoses {
                got, total, needed, ..
            } => failure
                .with("got", *got)
                .with("total", *total)
                .with("needed", *needed),
            Refusal::Degenerate { rank, expected, .. } => {
                failure.with("rank", *rank).with("expected", *expected)
            }
            _ => failure,
        }
    }
}

impl From<LoadError> for Failure {
    fn from(error: LoadError) -> Self {
        Self::of("RecordError", &error)
    }
}
