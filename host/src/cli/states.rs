//! `mcdpr states`: the board's supervisor, state by state.

use super::{Common, Outcome, print_json};
use mcdpr_firmware::supervisor::{Cell, Event, STATES, TABLE};
use serde_json::{Map, Value};

/// Show the board's states and the effect of every event in them
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        if common.json {
            return print_json(&as_json());
        }
        for (state, row) in STATES.iter().zip(TABLE.iter()) {
            say!("{state:?}");
            for (event, cell) in Event::ALL.iter().zip(row) {
                if *cell != Cell::No {
                    say!("   {:<16} {}", format!("{event:?}"), word(cell));
                }
            }
        }
        say!(
            "\nstay: accepted, same state; settle: Fault if one is latched, else Disarmed; an event that is not listed is refused or has no meaning in that state"
        );
        Ok(())
    }
}

fn word(cell: &Cell) -> String {
    match cell {
        Cell::No => ".".to_owned(),
        Cell::Stay => "stay".to_owned(),
        Cell::To(state) => format!("{state:?}"),
        Cell::Settle => "settle".to_owned(),
    }
}

/// Per state, the possible events and the next state.
fn as_json() -> Value {
    let states = STATES.iter().zip(TABLE.iter()).map(|(state, row)| {
        let cells = Event::ALL
            .iter()
            .zip(row)
            .filter(|(_, cell)| **cell != Cell::No);
        let cells = cells.map(|(event, cell)| (format!("{event:?}"), Value::from(word(cell))));
        (format!("{state:?}"), Value::Object(cells.collect()))
    });
    Value::Object(states.collect::<Map<_, _>>())
}
