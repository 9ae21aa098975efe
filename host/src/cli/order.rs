//! The order of the commands in `--help`: as a laboratory uses them.

use super::Cli;
use clap::{Command, CommandFactory, FromArgMatches};

/// Names of commands in their order; other commands follow them.
const ORDER: &[&str] = &[
    // Overview.
    "ports",
    "doctor",
    "config",
    "camera",
    "states",
    "faults",
    // Commissioning.
    "flash",
    "commission",
    "rig",
    "calibrate",
    "tune",
    "home",
    "recover",
    // Move.
    "demo",
    "plan",
    "run",
    "move",
    "jog",
    "pick",
    "gripper",
    "arm",
    "pause",
    "resume",
    "stop",
    "park",
    "disarm",
    "clear",
    // Evaluate.
    "serve",
    "monitor",
    "replay",
    "report",
    "compare",
    "export",
    "estimate",
    "predict",
    "reproduce",
    "fingerprint",
    // Compute.
    "ik",
    "fk",
    "statics",
    "workspace",
    "model",
    // Simulate.
    "sim",
    "emulate",
    // Shell.
    "completions",
    "man",
];

const AFTER: &str = "\
Exit codes: 0 done, 1 refused or failed with a reason, 2 wrong usage, 3 stopped by a fault,
130 interrupted after a safe stop. Results go to standard output, everything else to standard
error. Colours are used on a terminal only, and not where NO_COLOR is set.";

/// The command line with its commands in order.
pub(super) fn command() -> Command {
    let mut command = Cli::command().after_help(AFTER);
    let names: Vec<_> = command
        .get_subcommands()
        .map(|sub| sub.get_name().to_owned())
        .collect();
    for name in names {
        let place = ORDER.iter().position(|known| *known == name);
        let place = place.unwrap_or(ORDER.len());
        command = command.mut_subcommand(name, |sub| sub.display_order(place));
    }
    command
}

/// Reads the program's command line, and returns the words of its command too; wrong usage ends the
/// program with code 2.
pub(super) fn parse() -> (Cli, String) {
    let matches = command().get_matches();
    let mut words = Vec::new();
    let mut inner = matches.subcommand();
    while let Some((name, rest)) = inner {
        words.push(name);
        inner = rest.subcommand();
    }
    // Without a command it is the demo.
    if words.is_empty() {
        words.push("demo");
    }
    let words = words.join(" ");
    // A command line that clap has accepted has the form of `Cli`.
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    (cli, words)
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_command_line_is_sound_and_every_command_says_what_it_does() {
        let command = super::command();
        command.clone().debug_assert();
        for sub in command.get_subcommands() {
            let name = sub.get_name();
            assert!(
                sub.get_about().is_some(),
                "{name} says nothing about itself"
            );
        }
    }
}
