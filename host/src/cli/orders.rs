//! `mcdpr stop`, `pause`, `resume`: orders to a robot that another mcdpr moves.

use super::{Common, Outcome, print_json};
use crate::control::{Handle, Order, Server, SocketError, View, call_all};
use crate::link::{Client, ClientError};
use crate::run::{self, RunError};
use mcdpr_protocol::{BoardState, StopKind};
use std::time::{Duration, Instant};

/// A stop takes 300 ms along the path, 150 ms of braking under torque, and some polling.
const AT_REST: Duration = Duration::from_secs(4);

/// Stop a robot that another terminal moves: along its path, brakes closed, torque off
#[derive(Debug, clap::Args)]
pub(crate) struct Stop {
    /// Brakes and torque off at once, not along the path; only if drive control is lost
    #[arg(long)]
    emergency: bool,
}

/// Hold a robot that another terminal moves: it stays on its path, under tension
#[derive(Debug, clap::Args)]
pub(crate) struct Pause {}

/// Resume a paused robot along its path
#[derive(Debug, clap::Args)]
pub(crate) struct Resume {}

/// Listens for orders while a robot is moved. If that fails the robot is moved all the same, with a
/// warning that only Ctrl-C stops it.
///
/// # Errors
/// [`SocketError::Taken`]: two programs must not move one robot.
pub(crate) fn listen(common: &Common, handle: &Handle) -> Result<Option<Server>, SocketError> {
    match Server::start(&common.on, &common.robot, handle.clone()) {
        Ok(server) => Ok(Some(server)),
        Err(error @ SocketError::Taken { .. }) => Err(error),
        Err(error) => {
            eprintln!("orders from another terminal will not arrive, Ctrl-C will: {error}");
            Ok(None)
        }
    }
}

impl Stop {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let (order, kind) = if self.emergency {
            (Order::Emergency, StopKind::Emergency)
        } else {
            (Order::Stop, StopKind::Stop)
        };
        match call_all(&common.on, &common.robot, Some(order)) {
            Ok(_) => {
                let view = at_rest(common)?;
                print_answer(common, "stopped", view.as_ref())
            }
            // No program feeds the board, but it may still be armed: it accepts a stop from any
            // program.
            Err(SocketError::Nobody { .. }) if !matches!(common.on.as_str(), "sim" | "chip") => {
                let link = common.open_port().map_err(ClientError::from)?;
                let mut client =
                    Client::connect(link, run::new_session()).map_err(RunError::from)?;
                client.stop(kind).map_err(RunError::from)?;
                let status = run::status(&mut client)?;
                let mut view = View::default();
                view.take_status(&status);
                print_answer(common, "stopped", Some(&view))
            }
            Err(error) => Err(error.into()),
        }
    }
}

impl Pause {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let views = call_all(&common.on, &common.robot, Some(Order::Pause))?;
        print_answer(common, "paused", views.first())
    }
}

impl Resume {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let views = call_all(&common.on, &common.robot, Some(Order::Resume))?;
        print_answer(common, "resumed", views.first())
    }
}

/// Waits until the program that moves the robot has closed its brakes, or has ended.
fn at_rest(common: &Common) -> Result<Option<View>, SocketError> {
    let give_up = Instant::now() + AT_REST;
    let mut last = None;
    while Instant::now() < give_up {
        match call_all(&common.on, &common.robot, None) {
            Ok(views) => {
                let rest = |view: &View| {
                    matches!(
                        view.state,
                        None | Some(BoardState::Disarmed | BoardState::Fault | BoardState::EStop)
                    )
                };
                let all = views.iter().all(rest);
                last = views.into_iter().next();
                if all {
                    break;
                }
            }
            // It stopped and ended between two polls.
            Err(SocketError::Nobody { .. } | SocketError::System { .. }) => break,
            Err(error) => return Err(error),
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    Ok(last)
}

fn print_answer(common: &Common, what: &str, view: Option<&View>) -> Outcome {
    if common.json {
        return print_json(&serde_json::json!({ "done": what, "view": view }));
    }
    match view.and_then(|view| Some((view.state?, view))) {
        Some((state, view)) => say!(
            "{what}: the board is {state:?}, {:.2} s along its path",
            view.path_s
        ),
        None => say!("{what}"),
    }
    Ok(())
}
