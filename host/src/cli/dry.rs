//! Effect of `--dry-run` on each command: it is only judged, or it is refused before anything is
//! connected. A command that is not in the table fails the test below.

use super::{Failed, Outcome};

/// Treatment of `--dry-run` by a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DryRun {
    /// It judges the action, connects to nothing, moves nothing and writes only what `--record`
    /// asks for. If it cannot judge the action, it refuses.
    Judges,
    /// It reads the state of a board or of a running program and changes nothing; no motor gets
    /// torque.
    Looks,
    /// It never connects to a robot: it computes, reads, or writes files.
    Computes,
    /// There is nothing to judge beforehand: it refuses.
    Refuses,
}

use DryRun::{Computes, Judges, Looks, Refuses};

/// Every command by its words.
pub const DRY_RUNS: &[(&str, DryRun)] = &[
    ("arm", Refuses),
    ("bench", Refuses),
    ("calibrate all", Judges),
    ("calibrate camera", Judges),
    ("calibrate check", Refuses),
    ("calibrate collect", Refuses),
    ("calibrate frame", Judges),
    ("calibrate history", Judges),
    ("calibrate plan", Computes),
    ("calibrate study", Computes),
    ("calibrate target", Judges),
    ("calibrate tension", Judges),
    ("calibrate verify", Computes),
    ("calibrate winch", Refuses),
    ("camera list", Computes),
    ("camera record", Refuses),
    ("camera show", Computes),
    ("care", Computes),
    ("clear", Looks),
    ("commission", Refuses),
    ("compare", Computes),
    ("completions", Computes),
    ("config check", Computes),
    ("config compose", Computes),
    ("config init", Computes),
    ("config schema", Computes),
    ("config show", Computes),
    ("demo", Judges),
    ("disarm", Refuses),
    ("doctor", Looks),
    ("emulate", Refuses),
    ("estimate", Looks),
    ("experiment", Judges),
    ("export", Computes),
    ("faults", Computes),
    ("fingerprint", Refuses),
    ("fk", Computes),
    ("flash", Judges),
    ("gripper", Refuses),
    ("home", Judges),
    ("ik", Computes),
    ("jog", Judges),
    ("man", Computes),
    ("model export", Computes),
    ("monitor", Looks),
    ("move", Judges),
    ("park", Judges),
    ("pause", Refuses),
    ("pick", Refuses),
    ("plan", Computes),
    ("ports", Computes),
    ("predict", Computes),
    ("recover", Refuses),
    ("replay", Computes),
    ("report", Computes),
    ("reproduce", Refuses),
    ("resume", Refuses),
    ("rig attach", Refuses),
    ("rig lower", Refuses),
    ("rig spool", Refuses),
    ("rig tension", Refuses),
    ("ros", Judges),
    ("run", Judges),
    ("serve", Judges),
    ("sim", Refuses),
    ("states", Computes),
    ("statics", Computes),
    ("stop", Refuses),
    ("study calibrated", Refuses),
    ("study day", Refuses),
    ("study demo", Refuses),
    ("study iso9283", Refuses),
    ("study motion", Refuses),
    ("study power", Refuses),
    ("study real", Computes),
    ("study robots", Computes),
    ("study tension", Refuses),
    ("study track", Refuses),
    ("study tube", Refuses),
    ("study winch", Refuses),
    ("track", Judges),
    ("tune tension", Refuses),
    ("workspace", Computes),
];

/// Every command of the program by its words, those with commands of their own left out.
#[must_use]
pub fn commands() -> Vec<String> {
    let mut found = Vec::new();
    leaves(&super::order::command(), "", &mut found);
    found.sort();
    found
}

fn leaves(command: &clap::Command, before: &str, found: &mut Vec<String>) {
    for sub in command.get_subcommands() {
        let words = format!("{before}{}", sub.get_name());
        if sub.has_subcommands() {
            leaves(sub, &format!("{words} "), found);
        } else {
            found.push(words);
        }
    }
}

/// Refuses `--dry-run` for a command, by its words, that does not support it. An unknown command is
/// refused too.
pub(super) fn check(words: &str) -> Outcome {
    let rule = DRY_RUNS.iter().find(|(known, _)| *known == words);
    match rule {
        Some((_, Judges | Looks | Computes)) => Ok(()),
        Some((_, Refuses)) | None => Err(refusal(words).into()),
    }
}

/// Refuses an action that cannot be judged without doing it.
pub(super) fn refusal(words: &str) -> Failed {
    Failed::from_error("--dry-run")(format!(
        "`mcdpr {words}` cannot be judged without doing it; nothing was connected and nothing moved"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_honours_a_dry_run_or_refuses_it() {
        let known: Vec<_> = DRY_RUNS
            .iter()
            .map(|(words, _)| (*words).to_owned())
            .collect();
        assert_eq!(commands(), known, "say in DRY_RUNS what a new command does");
        assert!(check("arm").is_err() && check("plan").is_ok());
        assert!(check("a command of tomorrow").is_err());
    }
}
