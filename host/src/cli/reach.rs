//! A robot for commands that move it: a session on the simulator, the emulated chip or a board.

#[cfg(unix)]
use super::orders::listen;
use super::recorded::{OnRecord, Work, off_record, on_record};
use super::{Common, Failed};
use crate::control::Handle;
use crate::experiment::SimulatedRobot;
use crate::link::{ClientError, Link, Paced};
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::record::Doing;
use crate::run::{Homing, LengthFiles, RunError, Session, watch_for_interrupts};

/// Opens the robot, runs an action, and accepts orders from other terminals. An action with a name
/// is recorded under it.
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
    let done = |record: &OnRecord<'_>| {
        let (link, homing): (Box<dyn Link + '_>, _) = if common.on == "sim" {
            let link = SimulatedRobot::new(mismatch, common.seed)
                .controller(&common.controller)
                .at_home(model)?;
            let home = Homing::Place(model.robot().tool.home_in_world_m);
            let watched = record.watched_simulated(link).with_orders(&handle);
            let link: Box<dyn Link + '_> = match common.pace()? {
                Some(scale) => Box::new(Paced::new(watched, scale)),
                None => Box::new(watched),
            };
            (link, homing.unwrap_or(home))
        } else {
            let link = common.open_port().map_err(ClientError::from)?;
            let watched = record.watched(link).with_orders(&handle);
            (Box::new(watched), homing.unwrap_or(Homing::Known))
        };
        let done = Session::open(model, link, record.session, &handle, homing, &LengthFiles)
            .and_then(work);
        handle.close("the command has ended");
        Ok(done?)
    };
    match name {
        Some(name) => {
            let work = Work::new(name, Doing::Orders, mismatch, model).with_orders(&handle);
            let work = work.planned_first();
            Ok(on_record(common, &work, done)?.0)
        }
        None => off_record(common, model.robot().cables.len(), done),
    }
}
