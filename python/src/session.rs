//! A robot that is connected: simulated, in virtual time, or behind a port.
//!
//! A thread of its own holds the session, so that the link is served while Python does something
//! else: a board behind a port hears its heartbeats, and virtual time stands.

use crate::engine::Engine;
use crate::failure::{Failure, of_fault, to_python};
use crate::followed::{Followed, truth_arrays};
use crate::plan::{self, Plan, What};
use crate::robot::Robot;
use crate::world::{Job, Opened, World, serve};
use mcdpr::experiment::SimulatedRobot;
use mcdpr::link::SerialLink;
use mcdpr::machine::Mismatch;
use mcdpr::run::{LengthFiles, new_session};
use mcdpr::scenario::{FaultyLink, Injection, Scenario};
use mcdpr_core::control::Handle;
use mcdpr_core::link::{ClientError, Link};
use mcdpr_core::motion::Model;
use mcdpr_core::run::{Homing, Recorder, RunError, Session as Robots};
use mcdpr_protocol::{Request, SessionId};
use mcdpr_simulator::Simulation;
use nalgebra::Vector3;
use numpy::PyArray1;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::{Value, json};
use std::sync::Mutex;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::Duration;

/// How often a waiting call looks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// A robot under Python's control.
#[pyclass(frozen, name = "Session", module = "mcdpr._mcdpr")]
pub(crate) struct Session {
    jobs: Mutex<Option<Sender<Job>>>,
    thread: Mutex<Option<JoinHandle<()>>>,
    handle: Handle,
    model: Model,
}

#[pymethods]
impl Session {
    /// A simulated robot at home: `mismatch` is a name or the object of a mismatch.
    #[staticmethod]
    #[expect(
        clippy::too_many_arguments,
        reason = "the arguments of one Python call"
    )]
    fn simulate(
        py: Python<'_>,
        robot: &Robot,
        seed: u64,
        mismatch: &str,
        planner: &str,
        tensioning: &str,
        shaping: &str,
        keep_truth: bool,
    ) -> PyResult<Self> {
        let mismatch = mismatch_of(mismatch)?;
        let model = plan::model(robot, plan::options(planner, tensioning, shaping)?)?;
        let open = move |model: &Model| -> Result<Opened, RunError> {
            let link = SimulatedRobot::new(mismatch, seed).at_home(model)?;
            if keep_truth {
                link.with(Simulation::record_truth);
            }
            let line = FaultyLink::new(link.clone(), &[]);
            let home = Homing::Place(model.robot().tool.home_in_world_m);
            Ok((
                Box::new(line.clone()) as Box<dyn Link>,
                Some((link, line)),
                home,
            ))
        };
        Self::start(py, model, SessionId(1), open)
    }

    /// The robot behind a serial port.
    #[staticmethod]
    #[expect(
        clippy::too_many_arguments,
        reason = "the arguments of one Python call"
    )]
    fn connect(
        py: Python<'_>,
        robot: &Robot,
        port: &str,
        home_m: Option<[f64; 3]>,
        time_scale: f64,
        planner: &str,
        tensioning: &str,
        shaping: &str,
    ) -> PyResult<Self> {
        let calibrated = robot.subject.robot.calibrated.as_ref();
        if calibrated.is_some_and(|calibrated| calibrated.simulated_seed.is_some()) {
            let words = "this calibration was made on the simulator; calibrate this machine";
            return Err(Failure::new("RunError", words).into());
        }
        let model = plan::model(robot, plan::options(planner, tensioning, shaping)?)?;
        if !(0.01..=100.0).contains(&time_scale) {
            let words = format!("time_scale: {time_scale} is not between 0.01 and 100");
            return Err(Failure::input(words).into());
        }
        let port = port.to_owned();
        let open = move |_: &Model| -> Result<Opened, RunError> {
            let link = SerialLink::open(&port).map_err(ClientError::from)?;
            let link = link.at_scale(time_scale);
            let homing = home_m.map_or(Homing::Known, |at| Homing::Place(at.into()));
            Ok((Box::new(link) as Box<dyn Link>, None, homing))
        };
        Self::start(py, model, new_session(), open)
    }

    /// Enables drives, checks, opens brakes; it holds then.
    fn arm(&self, py: Python<'_>) -> PyResult<()> {
        self.ask(py, |world| {
            let done = world.session()?.arm();
            world.settle(done)?;
            world.armed = true;
            Ok(())
        })
    }

    /// Closes the brakes, switches torque off, gives the board back.
    fn disarm(&self, py: Python<'_>) -> PyResult<()> {
        self.ask(py, |world| world.give_back())
    }

    /// Acknowledges a fault; gives it in words.
    fn clear(&self, py: Python<'_>) -> PyResult<Option<String>> {
        self.ask(py, |world| {
            world.armed = false;
            world.come_to_rest()?;
            let client = world.session()?.client();
            let fault = mcdpr_core::run::status(client)?.fault;
            if fault.is_some() {
                client
                    .request(Request::ClearFault)
                    .map_err(RunError::from)?;
            }
            Ok(fault.map(|record| mcdpr_core::faults::describe_fault(&record)))
        })
    }

    /// Plans a task from where the tool is, runs it, holds at its end: the plan and what was
    /// measured.
    fn follow(
        &self,
        py: Python<'_>,
        what: What,
        speed_mps: Option<f64>,
        height_m: Option<f64>,
    ) -> PyResult<(Plan, Followed)> {
        let (plan, samples, trace, name) = self.ask(py, move |world| {
            let task = what.task(world.model, height_m)?;
            let name = task.name.clone();
            let plan = world.session()?.plan(task, speed_mps)?;
            world.arm()?;
            // What was true before the motion belongs to no run.
            let _ = world.simulation(Simulation::take_trace);
            let mut recorder = Recorder::default();
            let done = world.session()?.follow(&plan, &mut recorder, |_| {});
            world.settle(done)?;
            let trace = world.simulation(Simulation::take_trace).ok();
            Ok((plan, recorder.samples, trace, name))
        })?;
        let followed = Followed::new(&self.model, &plan, samples, trace)?;
        Ok((Plan::of(plan, name), followed))
    }

    /// Moves the tool at a velocity for some seconds; the limit that ended it early, if one did.
    fn jog(
        &self,
        py: Python<'_>,
        velocity_mps: [f64; 3],
        seconds: f64,
    ) -> PyResult<Option<String>> {
        self.ask(py, move |world| {
            world.arm()?;
            let done = world.session()?.jog(Vector3::from(velocity_mps), seconds);
            world.settle(done)
        })
    }

    /// Lets time pass. A fault is raised where the robot was armed.
    fn wait(&self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        if !(0.0..=3600.0).contains(&seconds) {
            let words = format!("seconds: {seconds}; it is 0 to 3600");
            return Err(Failure::input(words).into());
        }
        self.ask(py, move |world| {
            if world.armed {
                let done = world.session()?.hold(Some(seconds));
                return world.settle(done);
            }
            let client = world.session()?.client();
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "an hour at most"
            )]
            let until_us = client.now_us() + (seconds * 1e6) as u64;
            while client.now_us() < until_us {
                client.pump(until_us).map_err(RunError::from)?;
                while client.next_event().is_some() {}
            }
            Ok(())
        })
    }

    /// Opens or closes the gripper.
    fn gripper(&self, py: Python<'_>, closed: bool) -> PyResult<()> {
        self.ask(py, move |world| {
            let done = world.session()?.gripper(closed);
            world.settle(done)
        })
    }

    /// Stops what moves, from any thread: along its path, then brakes.
    fn stop(&self) {
        self.handle.stop();
    }

    /// What the board says about itself.
    fn status<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let value = self.ask(py, |world| {
            let session = world.session()?;
            let status = mcdpr_core::run::status(session.client())?;
            let tool: [f64; 3] = session.tool_m().into();
            let lengths: Vec<_> = status.lengths.iter().map(|l| l.metres()).collect();
            let setpoints: Vec<_> = status.setpoints.iter().map(|l| l.metres()).collect();
            let tensions: Vec<_> = status.tensions.iter().map(|t| t.newtons()).collect();
            let fault = status.fault.map(|record| {
                let fields = of_fault(&record).into_iter();
                Value::Object(fields.map(|(key, value)| (key.to_owned(), value)).collect())
            });
            Ok(json!({
                "tick": status.tick.0,
                "state": format!("{:?}", status.state),
                "path_s": f64::from(status.path_ms) * 1e-3,
                "referenced": status.referenced,
                "brakes_open": status.brakes_open,
                "torque_on": status.torque_on,
                "lengths_m": lengths,
                "setpoints_m": setpoints,
                "tensions_n": tensions,
                "planned_tool_m": tool,
                "fault": fault,
            }))
        })?;
        to_python(py, &value)
    }

    /// Breaks something now: `S2:1` is fault S2 on cable 1.
    fn inject(&self, py: Python<'_>, words: &str, strength: f64) -> PyResult<()> {
        let cables = self.model.robot().cables.len();
        let refused = |error: &mcdpr::scenario::ScenarioError| Failure::of("ScenarioError", error);
        let text = format!("{words}@start");
        let mut injection = Injection::parse(&text, cables).map_err(|error| refused(&error))?;
        injection.strength = strength;
        let scenario = Scenario {
            name: words.to_owned(),
            injections: vec![injection],
        };
        let suits = scenario.suits(self.model.robot());
        suits.map_err(|error| refused(&error))?;
        self.ask(py, move |world| match &world.simulated {
            Some((_, line)) => {
                line.add(injection);
                Ok(())
            }
            None => world.simulation(|_| ()),
        })
    }

    /// Loads the platform from outside: a force (N) and a moment (N m), world, at its origin.
    fn load(&self, py: Python<'_>, force_n: [f64; 3], moment_nm: [f64; 3]) -> PyResult<()> {
        self.ask(py, move |world| {
            let done =
                world.simulation(|s| s.plant_mut().set_load(force_n, [0.0; 3], moment_nm))?;
            done.map_err(|error| Failure::new("RunError", error.to_string()))
        })
    }

    /// Another engine has the platform and the cables from now on; see `Engine`.
    fn fly(&self, py: Python<'_>, engine: Py<PyAny>) -> PyResult<()> {
        let engine = Engine(engine);
        self.ask(py, move |world| {
            world.simulation(|simulation| simulation.plant_mut().set_foreign(engine))
        })
    }

    /// Virtual time since the board got power, s.
    fn now_s(&self, py: Python<'_>) -> PyResult<f64> {
        self.ask(py, |world| {
            world.simulation(|simulation| simulation.now_us() as f64 * 1e-6)
        })
    }

    /// What is really the case now.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let truth = self.ask(py, |world| {
            let truth = world.simulation(|simulation| simulation.plant().truth())?;
            truth.map_err(|error| Failure::new("RunError", error.to_string()))
        })?;
        let n = self.model.robot().cables.len();
        let row = |values: &[f64]| {
            let cut = values.iter().take(n).copied().collect();
            PyArray1::from_vec(py, cut)
        };
        let three = |values: [f64; 3]| PyArray1::from_vec(py, values.to_vec());
        let out = PyDict::new(py);
        out.set_item("time_s", truth.time_s)?;
        out.set_item("tool_m", three(truth.tool_position_m))?;
        out.set_item("position_m", three(truth.pose.position_m))?;
        let [w, x, y, z] = truth.pose.rotation_wxyz;
        out.set_item("rotation_xyzw", PyArray1::from_vec(py, vec![x, y, z, w]))?;
        out.set_item("velocity_mps", three(truth.velocity_mps))?;
        out.set_item(
            "angular_velocity_rad_s",
            three(truth.angular_velocity_rad_s),
        )?;
        out.set_item("lengths_m", row(&truth.cable_lengths_m))?;
        out.set_item("tensions_n", row(&truth.tensions_platform_n))?;
        out.set_item("winch_tensions_n", row(&truth.tensions_winch_n))?;
        out.set_item("drum_positions_m", row(&truth.drum_positions_m))?;
        out.set_item("drum_speeds_mps", row(&truth.drum_speeds_mps))?;
        out.set_item("motor_currents_a", row(&truth.motor_currents_a))?;
        out.set_item("energy_j", truth.energy_j)?;
        Ok(out)
    }

    /// What was true in every tick since the last call.
    fn take_truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let trace = self.ask(py, |world| world.simulation(Simulation::take_trace))?;
        truth_arrays(py, &trace, self.model.robot().cables.len())
    }

    /// Ends: brakes closed, the board given back.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let open = self.jobs.lock().is_ok_and(|jobs| jobs.is_some());
        if !open {
            return Ok(());
        }
        let ended = self.ask(py, |world| world.give_back());
        self.end(py);
        ended
    }
}

impl Session {
    /// Starts the thread and waits until the session is open.
    fn start(
        py: Python<'_>,
        model: Model,
        number: SessionId,
        open: impl FnOnce(&Model) -> Result<Opened, RunError> + Send + 'static,
    ) -> PyResult<Self> {
        let (jobs, queue) = mpsc::channel::<Job>();
        let (ready, opened) = mpsc::channel::<Result<(), Failure>>();
        let handle = Handle::new();
        let (model_there, handle_there) = (model.clone(), handle.clone());
        let thread = std::thread::Builder::new()
            .name("mcdpr session".to_owned())
            .spawn(move || {
                let (model, handle) = (&model_there, &handle_there);
                let session = open(model).and_then(|(link, simulated, homing)| {
                    let session = Robots::open(model, link, number, handle, homing, &LengthFiles)?;
                    Ok((session, simulated))
                });
                let (session, simulated) = match session {
                    Ok(session) => session,
                    Err(error) => {
                        let _ = ready.send(Err(error.into()));
                        return;
                    }
                };
                let _ = ready.send(Ok(()));
                let world = World {
                    model,
                    handle,
                    session: Some(session),
                    simulated,
                    sessions: number.0,
                    lost: None,
                    armed: false,
                };
                serve(world, &queue);
            })
            .map_err(|error| PyRuntimeError::new_err(error.to_string()))?;
        let answer = py.detach(move || opened.recv());
        match answer {
            Ok(Ok(())) => Ok(Self {
                jobs: Mutex::new(Some(jobs)),
                thread: Mutex::new(Some(thread)),
                handle,
                model,
            }),
            Ok(Err(failure)) => Err(failure.into()),
            Err(_) => Err(PyRuntimeError::new_err("the session ended as it began")),
        }
    }

    /// Has the thread do something and waits for it. Ctrl-C stops the robot along its path.
    fn ask<T: Send + 'static>(
        &self,
        py: Python<'_>,
        job: impl for<'m> FnOnce(&mut World<'m>) -> Result<T, Failure> + Send + 'static,
    ) -> PyResult<T> {
        let (done, answer) = mpsc::channel();
        let job: Job = Box::new(move |world| {
            let _ = done.send(job(world));
        });
        let gone = || Failure::new("RunError", "the session has ended");
        {
            let jobs = self.jobs.lock().map_err(|_| gone())?;
            let jobs = jobs.as_ref().ok_or_else(gone)?;
            jobs.send(job).map_err(|_| gone())?;
        }
        let mut interrupted = None;
        let mut answer = answer;
        loop {
            let (said, back) = py.detach(move || (answer.recv_timeout(LOOK), answer));
            answer = back;
            match said {
                Ok(done) => {
                    return match interrupted {
                        Some(interrupt) => Err(interrupt),
                        None => Ok(done?),
                    };
                }
                Err(RecvTimeoutError::Disconnected) => return Err(gone().into()),
                Err(RecvTimeoutError::Timeout) => {
                    if let Err(signal) = py.check_signals() {
                        self.handle.stop();
                        interrupted = Some(signal);
                    }
                }
            }
        }
    }

    fn end(&self, py: Python<'_>) {
        if let Ok(mut jobs) = self.jobs.lock() {
            *jobs = None;
        }
        let thread = self.thread.lock().ok().and_then(|mut thread| thread.take());
        if let Some(thread) = thread {
            py.detach(|| {
                let _ = thread.join();
            });
        }
    }
}

impl Drop for Session {
    /// Whoever forgot to close it leaves no robot under tension without a host: what is armed is
    /// disarmed as the queue ends.
    fn drop(&mut self) {
        if let Ok(jobs) = self.jobs.get_mut() {
            *jobs = None;
        }
    }
}

pub(crate) fn mismatch_of(text: &str) -> Result<Mismatch, Failure> {
    match text {
        "as_built" => Ok(Mismatch::as_built()),
        "as_found" => Ok(Mismatch::as_found()),
        name if Mismatch::named(name).is_some() => Ok(Mismatch::named(name).unwrap_or_default()),
        other => serde_json::from_str(other).map_err(|error| {
            Failure::input(format!(
                "mismatch: {error}; it is \"exact\", \"realistic\", \"as_built\" or the fields of one"
            ))
        }),
    }
}
