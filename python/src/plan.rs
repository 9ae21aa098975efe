//! Plans: a task judged and sampled.

use crate::failure::{Failure, to_python};
use crate::robot::Robot;
use crate::rows::array;
use mcdpr::report;
use mcdpr_core::motion::{self, Model, PlanOptions, Task, Watch};
use mcdpr_core::run;
use nalgebra::Vector3;
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use serde_json::json;
use std::borrow::Cow;

/// Height of a level platform's origin for the built-in tasks, m, as `mcdpr run` has it.
const HEIGHT_M: f64 = -0.1;

/// What to do, as Python names it.
#[derive(Clone, Debug, FromPyObject)]
pub(crate) enum What {
    /// A place of the tool, world, m.
    #[pyo3(transparent)]
    Place([f64; 3]),
    /// A built-in task or a file; or the text of a task file, with `text:` in front.
    #[pyo3(transparent)]
    Name(String),
}

impl What {
    /// The task. `height_m` is that of a level platform's origin for the built-in ones.
    pub(crate) fn task(&self, model: &Model, height_m: Option<f64>) -> Result<Task, Failure> {
        match self {
            Self::Place(place_m) => Ok(Task::go_to("move", Vector3::from(*place_m))?),
            Self::Name(name) => match name.strip_prefix("text:") {
                Some(text) => Ok(Task::parse(text, "task.toml".into())?),
                None => {
                    let tool_m = model.robot().tool.tcp_in_platform_m.z;
                    let height_m = height_m.unwrap_or(HEIGHT_M) + tool_m;
                    Ok(mcdpr::motion::find_task_for(model, name, height_m)?)
                }
            },
        }
    }
}

/// How to plan, by the names that a record has for them.
pub(crate) fn options(
    planner: &str,
    tensioning: &str,
    shaping: &str,
) -> Result<PlanOptions, Failure> {
    let name = |text: &str| text.replace('-', "_");
    let form = json!({
        "planner": name(planner),
        "tensioning": name(tensioning),
        "shaping": name(shaping),
    });
    serde_json::from_value(form).map_err(|error| Failure::input(error.to_string()))
}

/// The robot as the planner sees it.
pub(crate) fn model(robot: &Robot, options: PlanOptions) -> Result<Model, Failure> {
    Ok(Model::new(&robot.subject.robot)?.with_options(options))
}

/// A judged plan.
#[pyclass(frozen, name = "Plan", module = "mcdpr._mcdpr")]
pub(crate) struct Plan {
    plan: motion::Plan,
    name: String,
}

type Two = Py<PyArray2<f64>>;

#[pymethods]
impl Plan {
    #[new]
    #[expect(
        clippy::too_many_arguments,
        reason = "the arguments of one Python call"
    )]
    fn new(
        py: Python<'_>,
        robot: &Robot,
        what: What,
        start_m: Option<[f64; 3]>,
        speed_mps: Option<f64>,
        height_m: Option<f64>,
        planner: &str,
        tensioning: &str,
        shaping: &str,
    ) -> PyResult<Self> {
        let options = options(planner, tensioning, shaping)?;
        let planned = py.detach(|| {
            let model = model(robot, options)?;
            let task = what.task(&model, height_m)?;
            let name = task.name.clone();
            let home_m = model.robot().tool.home_in_world_m;
            let start_m = start_m.map_or(home_m, Vector3::from);
            let plan = run::plan_from(&model, task, &start_m, speed_mps)?;
            Ok::<_, Failure>(Self { plan, name })
        });
        Ok(planned?)
    }

    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    #[getter]
    fn duration_s(&self) -> f64 {
        self.plan.timed.duration_s()
    }

    /// How close it comes to its limits.
    fn extremes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let seen = self
            .plan
            .extremes(&Watch::default())
            .map_err(Failure::from)?;
        let value = serde_json::to_value(&seen).map_err(|e| Failure::input(e.to_string()))?;
        to_python(py, &value)
    }

    /// Expected states at these times: tool, position, attitude, tensions, lengths, paid out, speed.
    fn at(&self, py: Python<'_>, times_s: Vec<f64>) -> PyResult<[Two; 7]> {
        let n = self.plan.model().robot().cables.len();
        let sampled = py.detach(|| {
            let mut all: [Vec<f64>; 7] = Default::default();
            for &time_s in &times_s {
                let rest = self.plan.timed.rest(self.plan.model(), time_s)?;
                let [tool, position, attitude, tensions, lengths, paid_out, speed] = &mut all;
                tool.extend(self.plan.timed.tool_m(time_s)?.iter());
                position.extend(rest.equilibrium.pose.position_m.iter());
                attitude.extend(rest.equilibrium.pose.rpy());
                tensions.extend(rest.tensions_n());
                lengths.extend(&rest.equilibrium.lengths_m);
                paid_out.extend(&rest.paid_out_m);
                speed.push(self.plan.timed.speed_mps(time_s));
            }
            Ok::<_, Failure>(all)
        });
        let [tool, position, attitude, tensions, lengths, paid_out, speed] = sampled?;
        Ok([
            array(py, tool, 3)?,
            array(py, position, 3)?,
            array(py, attitude, 3)?,
            array(py, tensions, n)?,
            array(py, lengths, n)?,
            array(py, paid_out, n)?,
            array(py, speed, 1)?,
        ])
    }

    /// What goes to the board: times (s), lengths (m), speeds (m/s), tensions (N).
    fn knots(&self, py: Python<'_>) -> PyResult<(Py<PyArray1<f64>>, Two, Two, Two)> {
        let n = self.plan.model().robot().cables.len();
        let (mut times, mut lengths, mut speeds, mut tensions) = (vec![], vec![], vec![], vec![]);
        for knot in &self.plan.knots {
            times.push(f64::from(knot.time_ms) * 1e-3);
            for cable in knot.cables.iter() {
                lengths.push(cable.length.metres());
                speeds.push(cable.velocity.metres_per_second());
                tensions.push(cable.tension.newtons());
            }
        }
        Ok((
            PyArray1::from_vec(py, times).unbind(),
            array(py, lengths, n)?,
            array(py, speeds, n)?,
            array(py, tensions, n)?,
        ))
    }

    /// The plan as `mcdpr plan --record` draws it (SVG).
    fn svg(&self) -> Result<String, Failure> {
        Ok(report::draw_plan(&self.name, &self.plan)?)
    }

    /// The same picture (PNG).
    fn png(&self) -> Result<Cow<'static, [u8]>, Failure> {
        report::draw_plan_png(&self.name, &self.plan)
            .map(Cow::Owned)
            .map_err(|error| Failure::new("Error", error.to_string()))
    }
}

impl Plan {
    /// A plan that was made elsewhere.
    pub(crate) const fn of(plan: motion::Plan, name: String) -> Self {
        Self { plan, name }
    }
}
