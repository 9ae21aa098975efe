//! The robot: its file, its calibration, and its mathematics over rows of poses.

use crate::batch::{CLOSED_FORM, ITERATIVE, in_parts};
use crate::edit::set;
use crate::failure::{Failure, to_python};
use crate::poses::{self, Poses, table_of};
use crate::rows::{Answers, Table, array, fill};
use crate::workspace::{self, Asked, Verdicts};
use mcdpr::calibration::at_rest::AtRest;
use mcdpr::calibration::result;
use mcdpr::compute::{ComputeError, Free, Subject};
use mcdpr::model_file::{self, Format, Winches};
use mcdpr_core::machine;
use mcdpr_core::robot::{BUILT_IN, BuiltInModules, ModuleFiles};
use mcdpr_kinematics::{
    AnyGoal, AnyRobot, Balance, Equilibrium, ForwardOptions, MAX_CABLES, Pose, Stability,
};
use nalgebra::{Vector3, Vector6};
use numpy::{PyArray2, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use serde_json::Value;
use std::hint::black_box;
use std::path::Path;

/// Columns of natural frequencies; missing ones are NaN.
const MODES: usize = 6;

/// A robot with its geometry and the texts that it was read from.
#[pyclass(frozen, name = "Robot", module = "mcdpr._mcdpr")]
pub(crate) struct Robot {
    pub(crate) subject: Subject,
    /// The robot file and the winch module files that it names: name and text.
    files: Vec<(String, String)>,
    origin: String,
}

/// Winch module files that were read with a robot, then the built-in ones.
struct Kept<'a>(&'a [(String, String)]);

impl ModuleFiles for Kept<'_> {
    fn open(&self, asked: &str) -> Result<(String, String), (String, String)> {
        let mut files = self.0.iter().skip(1);
        match files.find(|(name, _)| name == asked) {
            Some(found) => Ok(found.clone()),
            None => BuiltInModules.open(asked),
        }
    }
}

type Two = Py<PyArray2<f64>>;

/// Names of the built-in robots.
#[pyfunction]
pub(crate) fn built_in() -> Vec<&'static str> {
    BUILT_IN.iter().map(|(name, _)| *name).collect()
}

#[pymethods]
impl Robot {
    /// By path, or by the name of a built-in robot.
    #[staticmethod]
    fn load(name: &str) -> PyResult<Self> {
        let robot = mcdpr::robot::find(name).map_err(Failure::from)?;
        Ok(Self {
            subject: Subject::new(robot).map_err(Failure::from)?,
            files: mcdpr::robot::sources(name),
            origin: name.to_owned(),
        })
    }

    /// From the text of a robot file.
    #[staticmethod]
    fn parse(text: &str, origin: &str) -> PyResult<Self> {
        let robot = mcdpr::robot::parse(text, Path::new(origin)).map_err(Failure::from)?;
        Ok(Self {
            subject: Subject::new(robot).map_err(Failure::from)?,
            files: vec![(origin.to_owned(), text.to_owned())],
            origin: origin.to_owned(),
        })
    }

    /// With other values: an object of dotted keys, in the robot file's units.
    fn edited(&self, changes: &str) -> PyResult<Self> {
        let (name, text) = self
            .files
            .first()
            .ok_or_else(|| Failure::input("this robot has no file to edit"))?;
        let mut table: toml::Table = text
            .parse()
            .map_err(|error| Failure::input(format!("{name}: {error}")))?;
        let changes: serde_json::Map<String, Value> = serde_json::from_str(changes)
            .map_err(|error| Failure::input(format!("values: {error}")))?;
        for (key, value) in changes {
            let value = toml::Value::try_from(&value)
                .map_err(|error| Failure::input(format!("{key}: {error}")))?;
            set(&mut table, &key, value)?;
        }
        let text = toml::to_string(&table)
            .map_err(|error| Failure::input(format!("the edited robot: {error}")))?;
        let mut files = self.files.clone();
        if let Some(first) = files.first_mut() {
            first.1.clone_from(&text);
        }
        let origin = format!("{} (edited)", self.origin);
        let robot = mcdpr_core::robot::Robot::parse(&text, &origin, &Kept(&files));
        Ok(Self {
            subject: Subject::new(robot.map_err(Failure::from)?).map_err(Failure::from)?,
            files,
            origin,
        })
    }

    /// With the calibration of a file applied.
    fn calibrated(&self, path: &str) -> PyResult<Self> {
        let robot = result::apply(&self.subject.robot, Path::new(path))
            .map_err(|error| Failure::of("CalibrationError", &error))?;
        self.with_robot(robot)
    }

    /// With the calibration of a document applied; `name` names it in messages.
    fn calibrated_by(&self, text: &str, name: &str) -> PyResult<Self> {
        let robot = result::apply_text(&self.subject.robot, text, Path::new(name))
            .map_err(|what| Failure::new("CalibrationError", format!("{name}: {what}")))?;
        self.with_robot(robot)
    }

    #[getter]
    fn name(&self) -> &str {
        &self.subject.robot.name
    }

    #[getter]
    fn cable_count(&self) -> usize {
        self.subject.count()
    }

    #[getter]
    fn is_calibrated(&self) -> bool {
        self.subject.robot.calibrated.is_some()
    }

    /// Expected error of the platform at rest; `None` where the robot cannot rest.
    fn at_rest<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &serde_json::json!(AtRest::of(&self.subject.robot)))
    }

    #[getter]
    fn content_hash(&self) -> u32 {
        self.subject.robot.content_hash()
    }

    /// The robot file and the module files that it names.
    #[getter]
    fn files(&self) -> Vec<(String, String)> {
        self.files.clone()
    }

    /// Cables (from 0) that are held by tension.
    #[getter]
    fn tension_held(&self) -> Vec<usize> {
        let own = self.subject.own_tensions();
        let held = own.iter().enumerate().filter(|(_, own)| own.is_some());
        held.map(|(index, _)| index).collect()
    }

    /// Every value, SI.
    fn values<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let value = serde_json::to_value(&self.subject.robot)
            .map_err(|error| Failure::input(error.to_string()))?;
        to_python(py, &value)
    }

    /// Lengths alone.
    fn lengths(
        &self,
        py: Python<'_>,
        position_m: PyReadonlyArray2<'_, f64>,
        attitude_rad: Option<PyReadonlyArray2<'_, f64>>,
        tool: bool,
        nan: bool,
    ) -> PyResult<Two> {
        let count = position_m.shape()[0];
        let poses = Poses::of(&self.subject, &position_m, attitude_rad.as_ref(), tool)?;
        let cables = self.subject.count();
        let geometry = &self.subject.geometry;
        let mut out = [vec![0.0; cables * count]];
        py.detach(|| {
            in_parts(&mut out, [cables], count, CLOSED_FORM, |range, [rows]| {
                poses::lengths(geometry, &poses, nan, range, rows)
            })
        })?;
        let [out] = out;
        array(py, out, cables)
    }

    /// `count` lengths in Rust alone, over and over at some poses, which are prepared, with nothing kept: the
    /// loop of the crate's own benchmark, to compare with.
    fn lengths_alone(
        &self,
        py: Python<'_>,
        position_m: PyReadonlyArray2<'_, f64>,
        count: usize,
    ) -> PyResult<()> {
        let some = position_m.shape()[0];
        let poses = Poses::of(&self.subject, &position_m, None, false)?;
        let prepared: Vec<Pose> = (0..some).map(|k| poses.at(k)).collect();
        let geometry = &self.subject.geometry;
        py.detach(|| {
            let poses = prepared.iter().cycle().take(count);
            match geometry {
                AnyRobot::C4(robot) => poses.for_each(|pose| {
                    let _ = black_box(robot.lengths_m(black_box(pose)));
                }),
                robot => {
                    let mut out = [0.0; MAX_CABLES];
                    poses.for_each(|pose| {
                        let _ = black_box(robot.lengths_into(black_box(pose), &mut out));
                    });
                }
            }
        });
        Ok(())
    }

    /// Lengths, wrap angles, directions, tangent points.
    fn ik(
        &self,
        py: Python<'_>,
        position_m: PyReadonlyArray2<'_, f64>,
        attitude_rad: Option<PyReadonlyArray2<'_, f64>>,
        tool: bool,
        nan: bool,
    ) -> PyResult<[Two; 4]> {
        let count = position_m.shape()[0];
        let poses = Poses::of(&self.subject, &position_m, attitude_rad.as_ref(), tool)?;
        let cables = self.subject.count();
        let widths = [cables, cables, 3 * cables, 3 * cables];
        let geometry = &self.subject.geometry;
        let answers = Answers::solve(py, (count, CLOSED_FORM), widths, nan, |index, rows| {
            let [lengths, wraps, directions, tangents] = rows;
            let paths = geometry.paths(&poses.at(index))?;
            fill(lengths, paths.iter().map(|path| &path.length_m));
            fill(wraps, paths.iter().map(|path| &path.wrap_rad));
            fill(
                directions,
                paths.iter().flat_map(|path| path.direction.iter()),
            );
            fill(
                tangents,
                paths.iter().flat_map(|path| path.tangent_point_m.iter()),
            );
            Ok(())
        })?;
        answers.arrays(py)
    }

    /// Rows of the Jacobian, by twist or by the rates of the angles.
    fn jacobian(
        &self,
        py: Python<'_>,
        position_m: PyReadonlyArray2<'_, f64>,
        attitude_rad: Option<PyReadonlyArray2<'_, f64>>,
        tool: bool,
        euler: bool,
        nan: bool,
    ) -> PyResult<Two> {
        let count = position_m.shape()[0];
        let poses = Poses::of(&self.subject, &position_m, attitude_rad.as_ref(), tool)?;
        let geometry = &self.subject.geometry;
        let width = 6 * self.subject.count();
        let answers = Answers::solve(py, (count, CLOSED_FORM), [width], nan, |index, [row]| {
            let pose = poses.at(index);
            let rows = match euler {
                true => geometry.euler_jacobian(&pose)?,
                false => geometry.twist_jacobian(&pose)?,
            };
            fill(row, rows.iter().flatten());
            Ok(())
        })?;
        let [rows] = answers.arrays(py)?;
        Ok(rows)
    }

    /// Position, attitude, residual, iterations from lengths alone.
    fn forward(
        &self,
        py: Python<'_>,
        lengths_m: PyReadonlyArray2<'_, f64>,
        attitude_rad: Option<PyReadonlyArray2<'_, f64>>,
        free: Option<&str>,
        max_residual_m: f64,
        nan: bool,
    ) -> PyResult<[Two; 4]> {
        let count = lengths_m.shape()[0];
        let lengths = Table::of("lengths_m", &lengths_m, self.subject.count())?;
        let attitude = table_of("attitude_rad", attitude_rad.as_ref(), 3)?;
        let free = match free {
            None => None,
            Some("yaw") => Some(Free::Yaw),
            Some("all") => Some(Free::All),
            Some(other) => {
                let words = format!("free: \"{other}\"; it is \"yaw\", \"all\" or None");
                return Err(Failure::input(words).into());
            }
        };
        let options = ForwardOptions {
            max_residual_m,
            ..ForwardOptions::default()
        };
        let answers = Answers::solve(py, (count, ITERATIVE), [3, 3, 1, 1], nan, |index, rows| {
            let [position, angles, residual, iterations] = rows;
            let attitude = attitude.as_ref().map(|table| table.triple(index));
            let (found, _) = self
                .subject
                .forward(lengths.row(index), attitude, free, &options)?;
            fill(position, found.pose.position_m.iter());
            fill(angles, &found.pose.rpy());
            fill(residual, &[found.residual_m]);
            fill(iterations, &[found.iterations as f64]);
            Ok(())
        })?;
        answers.arrays(py)
    }

    /// The pose at rest for held lengths and tensions; NaN for what is not held.
    fn rest(
        &self,
        py: Python<'_>,
        lengths_m: PyReadonlyArray2<'_, f64>,
        tensions_n: PyReadonlyArray2<'_, f64>,
        nan: bool,
    ) -> PyResult<[Two; 9]> {
        let count = lengths_m.shape()[0];
        let cables = self.subject.count();
        let lengths = Table::of("lengths_m", &lengths_m, cables)?;
        let tensions = Table::of("tensions_n", &tensions_n, cables)?;
        self.equilibria(py, count, nan, |index| {
            let tensions = held(tensions.row(index));
            self.subject.rest(&held(lengths.row(index)), &tensions)
        })
    }

    /// Equilibrium at a place; NaN for the tension of a length-held cable.
    fn hang(
        &self,
        py: Python<'_>,
        position_m: PyReadonlyArray2<'_, f64>,
        tensions_n: PyReadonlyArray2<'_, f64>,
        attitude_rad: Option<PyReadonlyArray2<'_, f64>>,
        tool: bool,
        nan: bool,
    ) -> PyResult<[Two; 9]> {
        let count = position_m.shape()[0];
        let position = Table::of("position_m", &position_m, 3)?;
        let tensions = Table::of("tensions_n", &tensions_n, self.subject.count())?;
        let attitude = table_of("attitude_rad", attitude_rad.as_ref(), 3)?;
        self.equilibria(py, count, nan, |index| {
            let place = Vector3::from(position.triple(index));
            let tensions = held(tensions.row(index));
            let attitude = attitude.as_ref().map(|table| table.triple(index));
            self.subject.hang(&place, tool, &tensions, attitude)
        })
    }

    /// The tensions that a plan chooses at places, N; NaN for length-held cables.
    fn planned(
        &self,
        py: Python<'_>,
        position_m: PyReadonlyArray2<'_, f64>,
        tool: bool,
    ) -> PyResult<Two> {
        let count = position_m.shape()[0];
        let position = Table::of("position_m", &position_m, 3)?;
        let (planned, own) = (self.subject.planned(tool), self.subject.own_tensions());
        let cables = self.subject.count();
        let answers = Answers::solve(py, (count, ITERATIVE), [cables], false, |index, [row]| {
            let place = Vector3::from(position.triple(index));
            let tensions = planned
                .as_ref()
                .map_or(own, |rule| rule.tensions_n(&place, &mut None));
            let numbers: Vec<f64> = tensions.iter().map(|n| n.unwrap_or(f64::NAN)).collect();
            fill(row, &numbers);
            Ok(())
        })?;
        let [tensions] = answers.arrays(py)?;
        Ok(tensions)
    }

    /// Tensions that balance gravity and a wrench.
    #[expect(
        clippy::too_many_arguments,
        reason = "the arguments of one Python call"
    )]
    fn distribute(
        &self,
        py: Python<'_>,
        position_m: PyReadonlyArray2<'_, f64>,
        attitude_rad: Option<PyReadonlyArray2<'_, f64>>,
        wrench: PyReadonlyArray2<'_, f64>,
        min_n: Vec<f64>,
        max_n: Vec<f64>,
        forces_only: bool,
        minimum_norm: bool,
        near_n: Option<Vec<f64>>,
        nan: bool,
    ) -> PyResult<Two> {
        let count = position_m.shape()[0];
        let poses = Poses::of(&self.subject, &position_m, attitude_rad.as_ref(), false)?;
        let wrench = Table::of("wrench", &wrench, 6)?;
        let balance = if forces_only {
            Balance::Forces
        } else {
            Balance::Wrench
        };
        let cables = self.subject.count();
        let answers = Answers::solve(py, (count, CLOSED_FORM), [cables], nan, |index, [row]| {
            let goal = match (&near_n, minimum_norm) {
                (Some(near), _) => AnyGoal::NearestTo(near),
                (None, true) => AnyGoal::MinimumNorm,
                (None, false) => AnyGoal::Middle,
            };
            let wrench = Vector6::from_iterator(wrench.row(index).iter().copied());
            let found = self
                .subject
                .geometry
                .distribute(&poses.at(index), &wrench, balance, &min_n, &max_n, goal)
                .map_err(|error| self.subject.refused(error))?;
            fill(row, &*found);
            Ok(())
        })?;
        let [tensions] = answers.arrays(py)?;
        Ok(tensions)
    }

    /// Verdicts on a grid, x fastest: a code and the cable (from 1, or 0) of each point.
    #[expect(
        clippy::too_many_arguments,
        reason = "the arguments of one Python call"
    )]
    fn workspace(
        &self,
        py: Python<'_>,
        min_m: [f64; 3],
        max_m: [f64; 3],
        counts: [usize; 3],
        test: &str,
        tool: bool,
        attitude_rad: [f64; 3],
        tensions_n: Option<Vec<f64>>,
        min_n: Vec<f64>,
        max_n: Vec<f64>,
        tilt_max_rad: f64,
    ) -> PyResult<Verdicts> {
        let asked = Asked {
            tool,
            attitude_rad,
            tensions_n: tensions_n.map(|given| held(&given)),
            min_n: &min_n,
            max_n: &max_n,
            tilt_max_rad,
        };
        let corners_m = [Vector3::from(min_m), Vector3::from(max_m)];
        workspace::verdicts(py, &self.subject, test, corners_m, counts, &asked)
    }

    /// As a model file for other programs.
    fn model_file(&self, format: &str, every_winch: bool) -> PyResult<String> {
        let winches = if every_winch {
            Winches::All
        } else {
            Winches::Held
        };
        let format = match format {
            "mjcf" => Format::Mjcf,
            _ => Format::Urdf,
        };
        let text = model_file::write(&self.subject.robot, format, winches);
        Ok(text.map_err(Failure::from)?)
    }

    /// Lowest and highest corner of the box to search in, world, m.
    #[getter]
    fn search_box_m(&self) -> [[f64; 3]; 2] {
        self.subject.robot.search_box_in_world_m().map(Into::into)
    }
}

/// NaN stands for what is not held.
fn held(values: &[f64]) -> Vec<Option<f64>> {
    let given = |value: &f64| (!value.is_nan()).then_some(*value);
    values.iter().map(given).collect()
}

impl Robot {
    fn with_robot(&self, robot: mcdpr_core::robot::Robot) -> PyResult<Self> {
        Ok(Self {
            subject: Subject::new(robot).map_err(Failure::from)?,
            files: self.files.clone(),
            origin: self.origin.clone(),
        })
    }

    /// Position, attitude, lengths, tensions, paid-out lengths, slack, stable, modes, stiffness.
    fn equilibria(
        &self,
        py: Python<'_>,
        count: usize,
        nan: bool,
        solve: impl Fn(usize) -> Result<(Equilibrium, Stability), ComputeError> + Sync,
    ) -> PyResult<[Two; 9]> {
        let n = self.subject.count();
        let widths = [3, 3, n, n, n, n, 1, MODES, 36];
        let robot = &self.subject.robot;
        let answers = Answers::solve(py, (count, ITERATIVE), widths, nan, |index, rows| {
            let [
                position,
                attitude,
                lengths,
                tensions,
                paid_out,
                slack,
                stable,
                modes,
                stiffness,
            ] = rows;
            let (found, stability) = solve(index)?;
            fill(position, found.pose.position_m.iter());
            fill(attitude, &found.pose.rpy());
            fill(lengths, &*found.lengths_m);
            fill(tensions, &*found.tensions_n);
            let pairs = found.lengths_m.iter().zip(&found.tensions_n);
            for (cable, (slot, (length, tension))) in paid_out.iter_mut().zip(pairs).enumerate() {
                *slot = machine::paid_out_m(robot, cable, *length, *tension);
            }
            for (cable, slot) in slack.iter_mut().enumerate() {
                *slot = f64::from(u8::from(found.slack.contains(cable)));
            }
            fill(stable, &[f64::from(u8::from(stability.stable))]);
            fill(modes, &*stability.modes_hz);
            // Symmetric: its order does not matter.
            fill(stiffness, stability.stiffness.iter());
            Ok(())
        })?;
        answers.arrays(py)
    }
}
