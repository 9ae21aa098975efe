//! A calibration as a goal of ROS 2: collecting, solving, and the file.

use super::Node;
use crate::calibration::at_rest::AtRest;
use crate::calibration::collect::{CollectError, Options, Step, collect};
use crate::calibration::{Answer, Data, Options as Solving, history, joint, result};
use crate::cli::calibrate::collect::{Keeper, data_path};
use crate::cli::line::in_words;
use crate::link::{Client, Link, meanwhile};
use crate::motion::Model;
use crate::ros::{Ending, Goal};
use crate::run::{RunError, new_session};
use mcdpr_protocol::SessionId;
use std::path::PathBuf;

/// Reachable poses to choose from, as `mcdpr calibrate collect` has them.
const CANDIDATES: usize = 300;

impl Node<'_> {
    /// Collects `poses`, solves them, and writes the calibration beside the robot file. Whoever asked learns the
    /// predicted error and the file's name, or the reason why there is none.
    pub(super) fn calibrated(
        &self,
        mut line: impl Link,
        number: SessionId,
        mut goal: Goal,
        poses: usize,
    ) -> Result<(), RunError> {
        let prepared = self.prepared();
        let (model, keeper) = match prepared {
            Ok(prepared) => prepared,
            Err(reason) => {
                goal.judged(Err(reason));
                return Ok(());
            }
        };
        goal.judged(Ok(0.0));
        goal.came_to(share(0, poses));
        self.feed.set_task("calibrate");
        let done = self.collected(&mut line, &model, number, keeper, poses, &goal);
        let done = match done {
            Ok(data) => self.solved(&mut line, &model, &data),
            Err(error) => Err(error),
        };
        let (ending, outcome) = match done {
            Ok(said) => {
                self.feed.say(&said);
                (Ending::Reached(said), Ok(()))
            }
            Err(CollectError::Run(RunError::Interrupted)) => {
                (Ending::Stopped, Err(RunError::Interrupted))
            }
            Err(CollectError::Run(error)) => (Ending::Failed(in_words(&error)), Err(error)),
            Err(error) => {
                let reason = in_words(&error);
                self.feed.set_trouble(&reason);
                (Ending::Failed(reason), Ok(()))
            }
        };
        goal.ended(ending);
        outcome
    }

    /// The robot as designed, and the file for the data; or why there can be no calibration.
    fn prepared(&self) -> Result<(Model, Keeper), String> {
        if self.tags.borrow().is_none() {
            return Err(
                "a calibration on a board needs its camera: start mcdpr ros with --tags-from"
                    .to_owned(),
            );
        }
        let robot = crate::robot::find(&self.common.robot).map_err(|error| in_words(&error))?;
        let model = Model::new(&robot).map_err(|error| in_words(&error))?;
        model
            .comes_to_rest("collecting")
            .map_err(|error| in_words(&error))?;
        let keeper = Keeper::start(data_path(&self.common.robot));
        Ok((model, keeper.map_err(|error| error.to_string())?))
    }

    fn collected<L: Link>(
        &self,
        line: &mut L,
        model: &Model,
        number: SessionId,
        mut keeper: Keeper,
        poses: usize,
        goal: &Goal,
    ) -> Result<Data, CollectError> {
        let mut tags = self.tags.borrow_mut();
        let tags = tags.as_mut().ok_or_else(|| {
            CollectError::impossible("there is no camera", "start mcdpr ros with --tags-from")
        })?;
        let options = Options {
            poses,
            candidates: CANDIDATES,
            target_error_m: None,
            seed: self.common.seed,
            simulated_seed: self.simulated.then_some(self.common.seed),
            simulated_machine: None,
            described: Some(model.robot().content_hash()),
            session: Some(number),
            orders: self.handle.clone(),
        };
        let keep = |data: &Data| keeper.keep(data);
        let progress = |step: Step| match step {
            Step::Going { .. } | Step::Returned { .. } => {}
            Step::Measured { done, wanted, .. } => {
                goal.came_to(share(done, wanted));
                self.feed.say(&format!("pose {done} of {wanted} measured"));
            }
            Step::Skipped { reason } => self.feed.say(&format!("pose left out: {reason}")),
        };
        let done = collect(model, line, tags, &options, None, keep, progress);
        // Also if it ended early: the measurements so far are kept.
        let kept = keeper.finish();
        let data = done?;
        kept?;
        Ok(data)
    }

    /// Solves while the robot, whose brakes are closed, is polled as before.
    fn solved<L: Link>(
        &self,
        line: &mut L,
        model: &Model,
        data: &Data,
    ) -> Result<String, CollectError> {
        let mut client = Client::connect(line, new_session())?;
        let solving = Solving {
            closer_looks: true,
            ..Solving::default()
        };
        let answer: Answer = meanwhile(&mut client, || joint(data, &solving))??;
        let document = result::document(model.robot(), data, &answer)?;
        let path: PathBuf = result::path_for(&self.common.robot);
        result::write_whole(&path, format!("{document:#}\n"))?;
        history::remember(model.robot(), &path, "calibrated by ROS")?;
        let at_rest = AtRest::by(model.robot(), &document);
        let at_rest = at_rest.map(|at_rest| format!("; {}", at_rest.words()));
        Ok(format!(
            "predicted position error {:.2} mm by the cables' lengths{}; written to {}, which `mcdpr ros` uses when it starts again",
            answer.predicted_error_m * 1e3,
            at_rest.unwrap_or_default(),
            path.display()
        ))
    }
}

fn share(done: usize, wanted: usize) -> [f64; 2] {
    [done, wanted].map(|count| count as f64)
}
