//! `mcdpr states`: the board's supervisor as a table.

use super::table::lay_out;
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
        let mut rows = vec![
            std::iter::once("event".to_owned())
                .chain(STATES.iter().map(|state| format!("{state:?}")))
                .collect::<Vec<_>>(),
        ];
        for (column, event) in Event::ALL.iter().enumerate() {
            let cells = TABLE
                .iter()
                .map(|row| row.get(column).map_or(String::new(), word));
            rows.push(std::iter::once(format!("{event:?}")).chain(cells).collect());
        }
        super::write_out(&lay_out(&rows));
        say!(
            "\n.: refused or without meaning   stay: accepted, same state   \
             settle: Fault if one is latched, else Disarmed"
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
