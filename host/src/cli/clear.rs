//! `mcdpr clear`: acknowledge the fault that a board has latched.

use super::{Common, Failed, Outcome, print_json};
use crate::link::{Client, ClientError, describe_fault};
use crate::run::{self, RunError};
use mcdpr_protocol::{FaultId, Reject, Request};

/// Acknowledge a board's latched fault after its cause is removed
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {}

/// Time for which a clear is repeated that the board refuses because this host was silent, us.
const PATIENCE_US: u64 = 2_000_000;
/// Time between two attempts, us: some heartbeats.
const AGAIN_US: u64 = 50_000;

/// Clears the latched fault. On a busy computer a heartbeat may have been late just when the board got the order: the
/// cause of L10 ends by itself then, so the order is repeated for a while.
fn clear<L: crate::link::Link>(client: &mut Client<L>) -> Result<(), ClientError> {
    let give_up_us = client.now_us() + PATIENCE_US;
    loop {
        match client.request(Request::ClearFault) {
            Err(ClientError::Refused { reject, .. })
                if reject == SILENT && client.now_us() < give_up_us =>
            {
                client.pump(client.now_us() + AGAIN_US)?;
            }
            answer => return answer.map(|_| ()),
        }
    }
}

/// The board has not heard the host for a while.
const SILENT: Reject = Reject::CauseRemains {
    fault: FaultId::L10,
};

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
            clear(&mut client).map_err(RunError::from)?;
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
