//! The command line: its commands in the order in which a laboratory uses them, and negative values of options.

use super::Cli;
use clap::{Command, CommandFactory, FromArgMatches};
use std::collections::BTreeSet;
use std::ffi::OsString;

/// Names of commands in their order; other commands follow them.
const ORDER: &[&str] = &[
    // Overview.
    "ports",
    "doctor",
    "care",
    "track",
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
    let command = command();
    let words = with_negative_values(&command, std::env::args_os().collect());
    let matches = command.get_matches_from(words);
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

/// Words of a command line in which an option and its negative value are one word: `--speed -3mm/s` as
/// `--speed=-3mm/s`. Otherwise the parser takes the value for an option, and says nothing about its sign.
/// Only options with exactly one value are joined; positions have several and are read as they are.
fn with_negative_values(command: &Command, words: Vec<OsString>) -> Vec<OsString> {
    let mut names = BTreeSet::new();
    let mut others = BTreeSet::new();
    sort_options(command, &mut names, &mut others);
    let single = |word: &str| {
        let name = word.strip_prefix("--");
        name.is_some_and(|name| names.contains(name) && !others.contains(name))
    };
    let mut out: Vec<OsString> = Vec::with_capacity(words.len());
    let mut only_values = false;
    for word in words {
        let text = word.to_str().unwrap_or_default();
        only_values |= text == "--";
        let negative = text.strip_prefix('-').is_some_and(|rest| {
            rest.starts_with(|first: char| first.is_ascii_digit() || first == '.')
        });
        match out.last_mut() {
            Some(option) if !only_values && negative && option.to_str().is_some_and(single) => {
                option.push("=");
                option.push(&word);
            }
            _ => out.push(word),
        }
    }
    out
}

/// The long names of all options of a command and of those below it: with exactly one value, and others.
fn sort_options(command: &Command, single: &mut BTreeSet<String>, others: &mut BTreeSet<String>) {
    for option in command.get_arguments() {
        let Some(name) = option.get_long() else {
            continue;
        };
        let takes = option.get_action().takes_values();
        let values = option.get_num_args().unwrap_or_else(|| 1.into());
        let one = takes && values.min_values() == 1 && values.max_values() == 1;
        let list = if one { &mut *single } else { &mut *others };
        list.insert(name.to_owned());
    }
    for below in command.get_subcommands() {
        sort_options(below, single, others);
    }
}

#[cfg(test)]
mod tests {
    use super::with_negative_values;

    fn read(line: &str) -> Vec<String> {
        let words = line.split(' ').map(Into::into).collect();
        let words = with_negative_values(&super::command(), words);
        words
            .into_iter()
            .map(|word| word.into_string().unwrap())
            .collect()
    }

    #[test]
    fn a_negative_value_belongs_to_the_option_before_it() {
        let joined = read("mcdpr move 0 0 0 --speed -3mm/s --json");
        assert_eq!(joined[5..], ["--speed=-3mm/s", "--json"]);
        for as_it_is in [
            "mcdpr move --json -0.3 -0.05 -0.2",
            "mcdpr ik -0.3 0 0",
            "mcdpr plan --keep-in-view -1 2 -3 task.toml",
            "mcdpr move 0 0 0 -- --speed -3",
        ] {
            assert_eq!(read(as_it_is).join(" "), as_it_is);
        }
        let refused = super::command().try_get_matches_from(read("mcdpr move 0 0 0 --speed -3"));
        let reason = refused.unwrap_err().to_string();
        assert!(reason.contains("must be above 0"), "{reason}");
    }

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
