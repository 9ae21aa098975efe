//! The probable cause of a fault, looked for while the robot comes to rest.

use super::{RunError, orders};
use crate::diagnosis::{Diagnosis, diagnose};
use crate::link::{Client, Link, Note};
use crate::motion::Model;
use mcdpr_protocol::{BoardState, FaultRecord};

/// Time after a stop in which a platform finds its new rest, µs.
const SETTLES_US: u64 = 1_000_000;
/// The longest stop: its path, the brakes and their test, µs.
const STOPS_US: u64 = 5_000_000;

/// Adds to a fault what the samples around it show; other errors stay as they are. The board is kept fed until the robot
/// rests, and a second longer. An order to stop that comes meanwhile ends that at once.
pub fn explained<L: Link>(client: &mut Client<L>, model: &Model, error: RunError) -> RunError {
    let RunError::Fault { record, why: None } = error else {
        return error;
    };
    let why = watch(client, model, &record);
    if let Some(why) = &why {
        client.note(Note::Remark(&why.to_string()));
    }
    RunError::Fault {
        record,
        why: why.map(Box::new),
    }
}

/// `None` where the samples show no other cause, or the board does not answer any more.
fn watch<L: Link>(
    client: &mut Client<L>,
    model: &Model,
    record: &FaultRecord,
) -> Option<Diagnosis> {
    // Who ordered a stop already waits for its end.
    let ordered = orders::stop_wanted(client).is_some();
    let mut until_us = client.now_us() + STOPS_US;
    let mut rests = false;
    while client.now_us() < until_us {
        if !ordered && orders::stop_wanted(client).is_some() {
            break;
        }
        let next_us = client.now_us() + 20_000;
        client.pump(next_us).ok()?;
        let state = client.status().map(|status| status.state);
        let resting = matches!(
            state,
            Some(BoardState::Fault | BoardState::EStop | BoardState::Holding)
        );
        if resting && !rests {
            rests = true;
            until_us = client.now_us() + SETTLES_US;
        }
    }
    diagnose(model, record, &client.recent())
}
