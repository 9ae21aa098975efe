//! `mcdpr clear`: acknowledge the fault that a board has latched.

use super::{Common, Failed, Outcome, print_json};
use crate::link::{Client, ClientError, describe_fault};
use crate::run::{self, RunError};
use mcdpr_protocol::Request;

/// Acknowledge a board's latched fault after its cause is removed
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        if common.on == "sim" {
            let reason = "name the board's port with --on; the simulator in this process starts without faults";
            return Err(Failed::from_error("nothing to clear")(reason).into());
        }
        let link = common.open_port().map_err(ClientError::from)?;
        let mut client = Client::connect(link, run::new_session()).map_err(RunError::from)?;
        let fault = run::status(&mut client)?.fault;
        if fault.is_some() && !common.dry_run {
            client
                .request(Request::ClearFault)
                .map_err(RunError::from)?;
        }
        client.request(Request::Close).map_err(RunError::from)?;
        let text = fault.map(|record| describe_fault(&record));
        let done = if common.dry_run { "latched" } else { "cleared" };
        if common.json {
            return print_json(&serde_json::json!({ (done): text }));
        }
        match text {
            Some(text) => say!("{done} {text}"),
            None => say!("no fault is latched"),
        }
        Ok(())
    }
}
