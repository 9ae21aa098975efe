//! Executes the orders of a [`Handle`](crate::control::Handle) in the thread that feeds the board.

use super::{RunError, interrupted};
use crate::control::Order;
use crate::link::{Client, Link};
use mcdpr_protocol::{BoardState, Request, StopKind};

/// The requested kind of stop, if any: by Ctrl-C, or by an order that is not executed yet.
pub fn stop_wanted<L: Link>(client: &Client<L>) -> Option<StopKind> {
    match client.handle().stop_ordered() {
        Some(Order::Emergency) => Some(StopKind::Emergency),
        Some(_) => Some(StopKind::Stop),
        None => interrupted().then(|| {
            // The record must contain it like every other order.
            client.handle().interrupt();
            StopKind::Stop
        }),
    }
}

/// Executes waiting orders while a motion is in progress or held. Stops are left to
/// [`stop_wanted`].
///
/// # Errors
/// The line's. A refusal by the board is reported to the sender of the order, and changes nothing.
pub(crate) fn obey_in_motion<L: Link>(client: &mut Client<L>) -> Result<(), RunError> {
    while client.handle().stop_ordered().is_none() {
        let Some((ticket, order)) = client.handle().take() else {
            return Ok(());
        };
        let moving = client
            .beat()
            .is_some_and(|beat| beat.state == BoardState::Moving);
        let outcome = match order {
            Order::Pause if moving => {
                client.stop(StopKind::Hold)?;
                client.handle().publish(|view| view.paused = true);
                Ok(())
            }
            Order::Pause => Err("nothing moves".to_owned()),
            Order::Resume => refusable(client, Request::Resume)?.inspect(|()| {
                client.handle().publish(|view| view.paused = false);
            }),
            Order::Gripper { closed } => refusable(client, Request::Gripper { closed })?,
            Order::Jog { .. } => Err("a task is under way: stop it first".to_owned()),
            Order::Clear => Err("no fault is latched".to_owned()),
            Order::Stop | Order::Emergency => return Ok(()),
        };
        client.handle().done(ticket, outcome);
    }
    Ok(())
}

/// Refuses waiting orders: the current activity can only be stopped. An emergency stop is passed on
/// even while a stop is in progress.
pub(crate) fn refuse_while<L: Link>(
    client: &mut Client<L>,
    doing: &str,
    stopping: bool,
) -> Result<(), RunError> {
    // Left to `stop_wanted`, which stops the robot.
    if !stopping && client.handle().stop_ordered().is_some() {
        return Ok(());
    }
    while let Some((ticket, order)) = client.handle().take() {
        let outcome = match order {
            Order::Emergency => client.stop(StopKind::Emergency).map_err(RunError::from),
            Order::Stop => Ok(()),
            other => {
                let reason = format!("{} is not possible while {doing}", other.name());
                client.handle().done(ticket, Err(reason));
                continue;
            }
        };
        client.handle().done(ticket, Ok(()));
        outcome?;
    }
    Ok(())
}

/// A request whose refusal is an answer, not the end of the run.
pub(crate) fn refusable<L: Link>(
    client: &mut Client<L>,
    request: Request,
) -> Result<Result<(), String>, RunError> {
    match client.request(request) {
        Ok(_) => Ok(Ok(())),
        Err(refused @ crate::link::ClientError::Refused { .. }) => Ok(Err(refused.to_string())),
        Err(error) => Err(error.into()),
    }
}
