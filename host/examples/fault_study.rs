//! `cargo xtask study invariants`: the seeded fault runs, with their summary by row.

use mcdpr::scenario::campaign::{self, DRAWN, Verdict};
use mcdpr_protocol::FaultId;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let option = |name: &str, default: u64| {
        let at = arguments.iter().position(|argument| argument == name);
        let value = at.and_then(|at| arguments.get(at + 1));
        value
            .and_then(|value| value.parse().ok())
            .unwrap_or(default)
    };
    let (first, runs) = (option("--seed", 1), option("--runs", 10_000));
    let end = first.saturating_add(runs);
    let all = campaign::run_all(first..end, |_, verdict| {
        if let Some(verdict) = verdict.filter(|verdict| !verdict.violations.is_empty()) {
            eprintln!("{}", verdict.line());
        }
    });
    let without = all.iter().filter(|verdict| verdict.is_none()).count();
    let verdicts: Vec<_> = all.into_iter().flatten().collect();
    // FNV-1a (Fowler, Noll, Vo) over all measurements: shows whether two runs are identical.
    let mut hash = 0xCBF2_9CE4_8422_2325_u64;
    for byte in verdicts.iter().flat_map(|v| format!("{v:?}").into_bytes()) {
        hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01B3);
    }
    let failed = verdicts.iter().filter(|v| !v.violations.is_empty()).count();
    println!(
        "{} runs, seeds {first} to {}, {without} without a motion; {failed} broke an invariant; hash {hash:016x}\n",
        verdicts.len(),
        end.saturating_sub(1)
    );
    println!("Runs with one fault; the worst of each column.\n");
    println!(
        "| fault | runs | noticed | latest, ms | drop, mm | its bound, mm | over limit by 10 %, ms | slack, ms | broken |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for fault in DRAWN {
        print_row(*fault, &verdicts);
    }
    if failed == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

fn print_row(fault: FaultId, verdicts: &[Verdict]) {
    let of: Vec<_> = verdicts
        .iter()
        .filter(|v| matches!(v.injections.as_slice(), [one] if one.fault == fault))
        .collect();
    let worst = |value: fn(&Verdict) -> f64| of.iter().map(|v| value(v)).fold(0.0, f64::max);
    let noticed = of.iter().filter(|v| v.noticed.is_some()).count();
    let latest = of.iter().filter_map(|v| v.noticed_after_ms).max();
    println!(
        "| {} | {} | {noticed} | {} | {:.2} | {:.1} | {} | {} | {} |",
        fault.name(),
        of.len(),
        latest.map_or("-".to_owned(), |ms| ms.to_string()),
        worst(|v| v.drop_m * 1e3),
        worst(|v| v.drop_bound_m * 1e3),
        of.iter().map(|v| v.over_ms).max().unwrap_or(0),
        of.iter().map(|v| v.slack_ms).max().unwrap_or(0),
        of.iter().filter(|v| !v.violations.is_empty()).count(),
    );
}
