//! Tables of a survey: by row of the fault table, by phase, and the confusions.

use mcdpr_protocol::FaultId;
use mcdpr_twin::faults::survey::{Moment, Outcome, word};
use std::collections::BTreeMap;

fn share(part: usize, of: usize) -> String {
    if of == 0 {
        "-".to_owned()
    } else {
        format!("{:.1}", 100.0 * part as f64 / of as f64)
    }
}

/// Counts of a set of runs.
#[derive(Default)]
struct Counts {
    runs: usize,
    due: usize,
    noticed: usize,
    fault: usize,
    told: usize,
    cable: usize,
}

fn counts<'a>(outcomes: impl Iterator<Item = &'a Outcome>) -> Counts {
    let mut counts = Counts::default();
    for outcome in outcomes {
        counts.runs += 1;
        if outcome.may_be_silent {
            continue;
        }
        counts.due += 1;
        counts.noticed += usize::from(outcome.is_noticed());
        counts.fault += usize::from(outcome.named.fault);
        counts.told += usize::from(outcome.told.fault);
        counts.cable += usize::from(outcome.told.cable);
    }
    counts
}

/// Prints all tables of the runs in which every fault was injected.
pub(crate) fn print(all: &[Outcome]) {
    let injected: Vec<_> = all.iter().filter(|outcome| outcome.injected).collect();
    let single = || {
        let runs = injected.iter().copied();
        runs.filter(|outcome| outcome.drawn.injections.len() == 1)
    };
    println!("{} runs whose faults were injected.\n", injected.len());
    println!(
        "One fault, by row. Times in ms, ways in mm; latched while it was under torque or parked, not at the next arming.\n"
    );
    println!(
        "| fault | runs | noticed, % | latched right, % | told right, % | cable too, % | median | latest | deviation | drop | over limit | slack | share |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    for &fault in FaultId::ALL {
        let of = || single().filter(move |o| o.drawn.injections[0].fault == fault);
        if of().next().is_some() {
            row(fault.name(), &of().collect::<Vec<_>>());
        }
    }
    println!("\nBy phase.\n");
    println!(
        "| phase | runs | to be noticed | noticed, % | latched right, % | told right, % | cable too, % |"
    );
    println!("|---|---|---|---|---|---|---|");
    for moment in Moment::ALL {
        let of = single().filter(|outcome| outcome.drawn.moment == moment);
        phase(moment.name(), &counts(of));
    }
    phase("all", &counts(single()));
    let pairs = injected.iter().copied();
    let pairs = pairs.filter(|outcome| outcome.drawn.injections.len() > 1);
    phase("pairs", &counts(pairs));
    println!(
        "\nConfusions: what a user was told, the probable cause or else the latched fault; `-` is nothing, `host` an error \
         of the host's program.\n"
    );
    println!("| injected | told, cable right | told, another cable |");
    println!("|---|---|---|");
    for &fault in FaultId::ALL {
        let of = || single().filter(move |o| o.drawn.injections[0].fault == fault);
        if of().next().is_some() {
            confusion(fault.name(), of());
        }
    }
}

fn row(name: &str, of: &[&Outcome]) {
    let counted = counts(of.iter().copied());
    let at_once = of.iter().filter(|outcome| !outcome.at_next_arming);
    let mut times: Vec<_> = at_once.filter_map(|o| o.latched_after_ms).collect();
    times.sort_unstable();
    let time = |at: Option<&usize>| at.map_or("-".to_owned(), ToString::to_string);
    let most = |value: fn(&Outcome) -> f64| of.iter().map(|o| value(o)).fold(0.0, f64::max);
    println!(
        "| {name} | {} | {} | {} | {} | {} | {} | {} | {:.2} | {:.2} | {} | {} | {:.2} |",
        counted.runs,
        share(counted.noticed, counted.due),
        share(counted.fault, counted.due),
        share(counted.told, counted.due),
        share(counted.cable, counted.due),
        time(times.get(times.len() / 2)),
        time(times.last()),
        most(|o| o.deviation_m * 1e3),
        most(|o| o.drop_m * 1e3),
        of.iter().map(|o| o.over_ms).max().unwrap_or(0),
        of.iter().map(|o| o.slack_ms).max().unwrap_or(0),
        most(|o| o.most_share),
    );
}

fn phase(name: &str, counted: &Counts) {
    println!(
        "| {name} | {} | {} | {} | {} | {} | {} |",
        counted.runs,
        counted.due,
        share(counted.noticed, counted.due),
        share(counted.fault, counted.due),
        share(counted.told, counted.due),
        share(counted.cable, counted.due),
    );
}

fn confusion<'a>(name: &str, of: impl Iterator<Item = &'a Outcome>) {
    let (mut same, mut other) = (BTreeMap::new(), BTreeMap::new());
    for outcome in of {
        let cable = outcome.drawn.injections[0].cable + 1;
        let own = |number: u8| number == 0 || usize::from(number) == cable;
        let (latched, right) = match (&outcome.diagnosed, outcome.latched) {
            (Some(why), _) => (why.fault.name(), own(why.cable)),
            (None, Some(record)) => (record.fault.name(), own(record.cable)),
            (None, None) if outcome.refused.is_some() => ("host", true),
            (None, None) => ("-", true),
        };
        let into = if right { &mut same } else { &mut other };
        *into.entry(latched).or_insert(0_usize) += 1;
    }
    let list = |counts: BTreeMap<&str, usize>| {
        let words: Vec<_> = counts.iter().map(|(k, n)| format!("{k} {n}")).collect();
        words.join(", ")
    };
    println!("| {name} | {} | {} |", list(same), list(other));
}

/// Lists every run: its faults with their strengths, what was said, and whether that was right.
pub(crate) fn list(all: &[Outcome]) {
    println!("\nRuns.\n");
    for outcome in all.iter().filter(|outcome| outcome.injected) {
        let injections = outcome.drawn.injections.iter();
        let words: Vec<_> = injections
            .map(|injection| format!("{} ({:.2})", word(injection), injection.strength))
            .collect();
        let said = match (&outcome.latched, &outcome.refused) {
            (Some(record), _) => format!("{record:?}"),
            (None, Some(refused)) => format!("host: {refused}"),
            (None, None) => "nothing".to_owned(),
        };
        let verdict = match outcome.told {
            _ if outcome.may_be_silent => "need not be noticed",
            named if named.fault && named.cable => "right",
            named if named.fault => "wrong cable",
            _ => "wrong",
        };
        println!(
            "seed {} ({}): {}: {verdict}: {said} after {:?} ms{}",
            outcome.drawn.seed,
            outcome.drawn.moment.name(),
            words.join(" "),
            outcome.latched_after_ms,
            outcome
                .diagnosed
                .as_ref()
                .map_or_else(String::new, |why| format!("; {why}")),
        );
    }
}
