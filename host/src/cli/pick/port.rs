//! Picking with a robot on a port and a real camera.

use super::board::Board;
use super::{Cmd, seen, table};
use crate::cli::recorded::{About, Recorded};
use crate::cli::{Common, Failed, Outcome, print_json};
use crate::control::Handle;
use crate::link::ClientError;
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::pick::study::planning;
use crate::pick::{
    Arm, Choice, News, Options, Outcome as Came, PickError, Picker, Report, Watcher, workcell,
};
use crate::record::{Doing, TaskSource, Watched};
use crate::recovery::load;
use crate::robot::Robot;
use crate::run::saved::scale_of;
use crate::run::{RunError, new_session, watch_for_interrupts};
use mcdpr_core::estimate::track::Prior;
use mcdpr_simulator::camera::Tray;
use mcdpr_vision::Source;

/// There is no simulated surrounding to notify.
struct Nobody;

impl Watcher for Nobody {
    fn chosen(&mut self, choice: &Choice) {
        let [x, y, z] = (choice.tool_m * 1e3).into();
        eprintln!("takes what is at ({x:.0}, {y:.0}, {z:.0}) mm");
    }
    fn closing(&mut self, _: &Choice) {}
    fn lifted(&mut self) {}
}

impl Cmd {
    /// Picks on the robot of `--on`.
    pub(super) fn on_port(&self, common: &Common, robot: &Robot) -> Outcome {
        let no_camera = || {
            let on = common.on.clone();
            PickError::NoCamera { on }
        };
        if self.scenes.is_some() || self.nominal || self.ideal {
            return Err(Failed::from_error("picking on a port")(
                "--scenes, --nominal and --ideal are of the simulator",
            )
            .into());
        }
        if !self.eye.has_depth() {
            return Err(no_camera().into());
        }
        let model = Model::new(robot)?.with_options(planning());
        let options = self.options(&model)?;
        let mut detector = self.detector()?;
        let eye = self.eye.open(&workcell::color_camera(robot))?;
        let mut eye = eye.ok_or_else(no_camera)?;
        eprintln!("pictures: {}", eye.name());
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let handle = Handle::new();
        #[cfg(unix)]
        let _listening = crate::cli::orders::listen(common, &handle)?;
        let about = About {
            name: "pick",
            task: TaskSource {
                name: "pick".to_owned(),
                text: None,
                tool_z_m: 0.0,
            },
            session: new_session(),
            mismatch: &Mismatch::default(),
            doing: Doing::Pictures,
            at_home: false,
            orders: Some(&handle),
        };
        let session = about.session;
        let hash = crate::recovery::task_hash(&about.task);
        let recorded = Recorded::start(common, Some(&model), about)?;
        let board = recorded.feed().map(Board::new);
        let tell = |news: &News| {
            if let Some(board) = &board {
                board.take(news);
            }
        };
        let mut picked = || -> Result<Report, PickError> {
            let port = common.open_port().map_err(ClientError::from);
            let port = port.map_err(RunError::from)?;
            let line = Watched::new(port, &recorded.events).with_orders(&handle);
            let (mut arm, was_closed) = if self.resume {
                let journal = |board: &str| load(board, scale_of(model.robot()));
                Arm::resume(model.clone(), line, session, &handle, hash, journal)
                    .map(|(arm, was_closed)| (arm, Some(was_closed)))?
            } else {
                let mut arm = Arm::start(model.clone(), line, session, &handle)?;
                if self.track {
                    arm.track(&Prior::default());
                }
                (arm, None)
            };
            let mut picker = Picker::new(&mut arm, &mut eye, detector.as_mut(), &options)
                .telling(board.is_some().then_some(&tell));
            let done = match was_closed {
                Some(was_closed) => picker.resume(was_closed, &mut Nobody),
                None => picker.run(&mut Nobody),
            };
            match done {
                Ok(report) => {
                    arm.finish()?;
                    Ok(report)
                }
                // An error of the line has stopped the robot already.
                Err(error @ PickError::Run(_)) => Err(error),
                Err(error) => {
                    arm.finish()?;
                    Err(error)
                }
            }
        };
        let outcome = picked();
        let folder = recorded.finish();
        if let Ok(report) = &outcome
            && let Err(error) = folder.write_json("summary.json", report)
        {
            crate::cli::run::incomplete(&error);
        }
        eprintln!("run folder: {}", folder.path().display());
        let report = outcome?;
        if common.json {
            return print_json(&report);
        }
        if let Some(resumed) = &report.resumed {
            say!("continued: {}", super::continued(resumed));
        }
        table(&report, &[]);
        seen(&report);
        let came = report.attempts.iter().map(|attempt| attempt.outcome);
        say!(
            "{} picked in {} attempts and {:.0} s; {}",
            came.filter(|came| *came == Came::Delivered).count(),
            report.attempts.len(),
            report.duration_s,
            super::end(&report.end)
        );
        Ok(())
    }

    /// The task at the tray's position (docs/picking.md).
    fn options(&self, model: &Model) -> Result<Options, PickError> {
        let mut options = if self.task == "paper" {
            workcell::paper(model)?.1
        } else {
            workcell::options(model.robot())?
        };
        let mat = Tray::default().with_mat().mat;
        if let Some(rows) = mat.filter(|_| !self.no_mat) {
            options.mat = Some(workcell::mat(&rows));
            options.hand.margin_m = workcell::MARGIN_BY_MAT_M;
        }
        workcell::look_from(&mut options, usize::from(self.views));
        if self.far_only {
            options.near_m = None;
        }
        if let Some(most) = self.attempts {
            options.attempts_max = most;
        }
        // The board's gripper opens and closes; it has no wrist.
        options.turns = false;
        Ok(options)
    }
}
