//! `mcdpr faults`: all faults, the robot's reaction, and the remedy.

use super::{Common, Outcome, print_json};
use crate::link::advice;
use crate::scenario::{How, how, rows};
use mcdpr_protocol::FaultId;
use miette::miette;
use serde::Serialize;

/// List the faults: what each means, what the robot does, what you should do
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Only these: ids such as S2, or groups such as S
    #[arg(value_name = "ID")]
    ids: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Row {
    id: &'static str,
    number: u8,
    meaning: &'static str,
    robot: &'static str,
    you: &'static str,
    injected: Option<String>,
    why_not: Option<&'static str>,
}

impl Row {
    fn of(fault: FaultId) -> Self {
        let (injected, why_not) = match how(fault) {
            How::Plant(what) => (Some(format!("plant: {what}")), None),
            How::Line(what) => (Some(format!("line: {what}")), None),
            How::Host(what) => (Some(format!("host: {what}")), None),
            How::Not(why) => (None, Some(why)),
        };
        Self {
            id: fault.name(),
            number: fault.number(),
            meaning: fault.what(),
            robot: rows::reaction(fault),
            you: advice(fault),
            injected,
            why_not,
        }
    }
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        for id in &self.ids {
            if !FaultId::ALL.iter().any(|fault| matches(*fault, id)) {
                return Err(miette!(
                    help = "`mcdpr faults` without an id lists all of them",
                    "there is no fault {id}"
                ));
            }
        }
        let wanted =
            |fault: FaultId| self.ids.is_empty() || self.ids.iter().any(|id| matches(fault, id));
        let faults = FaultId::ALL.iter().copied().filter(|fault| wanted(*fault));
        let table: Vec<_> = faults.map(Row::of).collect();
        if common.json {
            return print_json(&table);
        }
        for (letter, group) in rows::GROUPS {
            let mut of_group = table
                .iter()
                .filter(|row| row.id.starts_with(letter))
                .peekable();
            if of_group.peek().is_none() {
                continue;
            }
            say!("{letter}: {group}");
            for row in of_group {
                say!("  {:<4} {}", row.id, row.meaning);
                say!("       robot: {}", row.robot);
                say!("       you:   {}", row.you);
                if let Some(injected) = &row.injected {
                    say!(
                        "       try:   mcdpr demo --fault {}@{}   ({injected})",
                        row.id,
                        try_at(row.id)
                    );
                }
            }
        }
        Ok(())
    }
}

fn try_at(id: &str) -> &'static str {
    if matches!(id, "B1" | "B2" | "D5") {
        "start"
    } else {
        "3.0s"
    }
}

fn matches(fault: FaultId, id: &str) -> bool {
    let name = fault.name();
    let group = id.len() == 1 && name.get(..1).is_some_and(|g| g.eq_ignore_ascii_case(id));
    name.eq_ignore_ascii_case(id) || group
}
