//! A robot for commands that move it: a session on the simulator, the emulated chip or a board.

#[cfg(unix)]
use super::orders::listen;
use super::{Common, Failed};
use crate::control::Handle;
use crate::experiment;
use crate::link::{ClientError, Link, Paced, SerialLink};
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::run::{Homing, RunError, Session, new_session, watch_for_interrupts};
use mcdpr_simulator::LinkOptions;

/// Opens the robot, does something with it, and lets orders from other terminals reach it.
pub(crate) fn with_session<T>(
    common: &Common,
    model: &Model,
    homing: Option<Homing<'_>>,
    work: impl FnOnce(Session<'_, Box<dyn Link>>) -> Result<T, RunError>,
) -> miette::Result<T> {
    watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
    let handle = Handle::new();
    #[cfg(unix)]
    let _listening = listen(common, &handle)?;
    let (link, homing): (Box<dyn Link>, _) = if common.on == "sim" {
        let mismatch = Mismatch::realistic();
        let options = LinkOptions::default();
        let link = experiment::simulated_robot(model, &mismatch, common.seed, &options)?;
        let home = Homing::Place(model.robot().tool.home_in_world_m);
        let link: Box<dyn Link> = match common.checked_time_scale()? {
            Some(scale) => Box::new(Paced::new(link, scale)),
            None => Box::new(link),
        };
        (link, homing.unwrap_or(home))
    } else {
        let link = SerialLink::open(&common.on).map_err(ClientError::from)?;
        (Box::new(link), homing.unwrap_or(Homing::Known))
    };
    let session = Session::open(model, link, new_session(), &handle, homing)?;
    let done = work(session);
    handle.close("the command has ended");
    Ok(done?)
}
