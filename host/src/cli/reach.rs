//! A robot for commands that move it: a session on the simulator, the emulated chip or a board.

#[cfg(unix)]
use super::orders::listen;
use super::recorded::{About, Recorded};
use super::{Common, Failed};
use crate::control::Handle;
use crate::experiment;
use crate::link::{ClientError, Link, Paced};
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::record::witness::{TruthTap, Watched};
use crate::record::{Doing, TaskSource, Witness};
use crate::run::{Homing, RunError, Session, new_session, watch_for_interrupts};
use mcdpr_simulator::LinkOptions;

/// Opens the robot, does something with it, and lets orders from other terminals reach it. What
/// has a name is recorded under it.
pub(crate) fn with_session<T>(
    common: &Common,
    model: &Model,
    name: Option<&str>,
    homing: Option<Homing<'_>>,
    work: impl for<'a> FnOnce(Session<'a, Box<dyn Link + 'a>>) -> Result<T, RunError>,
) -> miette::Result<T> {
    watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
    let handle = Handle::new();
    #[cfg(unix)]
    let _listening = listen(common, &handle)?;
    let mismatch = Mismatch::realistic();
    let session = new_session();
    let recorded = name
        .map(|name| {
            let task = TaskSource {
                name: name.to_owned(),
                text: None,
                tool_z_m: 0.0,
            };
            let about = About {
                name,
                task,
                session,
                mismatch: &mismatch,
                doing: Doing::Orders,
                at_home: common.on == "sim",
            };
            Recorded::start(common, Some(model), about)
        })
        .transpose()?;
    let nobody = Witness::default();
    let witness = recorded
        .as_ref()
        .map_or(&nobody, |recorded| &recorded.witness);
    let (link, homing): (Box<dyn Link + '_>, _) = if common.on == "sim" {
        let options = LinkOptions::default();
        let link = experiment::simulated_robot(model, &mismatch, common.seed, &options)?;
        let home = Homing::Place(model.robot().tool.home_in_world_m);
        let mut watched = Watched::new(link.clone(), witness).with_orders(&handle);
        if recorded.is_some() {
            watched = watched.with_truth(TruthTap::forgetful(link, model.robot().cables.len()));
        }
        let link: Box<dyn Link + '_> = match common.checked_time_scale()? {
            Some(scale) => Box::new(Paced::new(watched, scale)),
            None => Box::new(watched),
        };
        (link, homing.unwrap_or(home))
    } else {
        let link = common.open_port().map_err(ClientError::from)?;
        let watched = Watched::new(link, witness).with_orders(&handle);
        (Box::new(watched), homing.unwrap_or(Homing::Known))
    };
    let done = Session::open(model, link, session, &handle, homing).and_then(work);
    handle.close("the command has ended");
    if let Some(recorded) = recorded {
        let folder = recorded.finish();
        if done.is_err() {
            eprintln!("what happened is recorded in {}", folder.path().display());
        }
    }
    Ok(done?)
}
