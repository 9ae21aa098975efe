//! `cargo xtask study planning`: seeded robots and tasks through planning, with bounds on time and
//! memory. What it prints is its result; it fails where an input panics or breaks a bound.

use mcdpr_tests::fuzz::mutate::Rng;
use mcdpr_tests::fuzz::planning::{Came, draw, plan};
use std::panic::catch_unwind;
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Processor time that one input may take, s.
const MOST_S: f64 = 5.0;
/// Memory that the process may take at its peak, kB.
const MOST_KB: u64 = 1_000_000;
/// An input that takes this long on the clock hangs.
const HANGS: Duration = Duration::from_secs(120);

/// The seed under way, for whoever looks after it.
static SEED: AtomicU64 = AtomicU64::new(0);

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let option = |name: &str, default: u64| {
        let at = arguments.iter().position(|argument| argument == name);
        let value = at.and_then(|at| arguments.get(at + 1));
        value
            .and_then(|value| value.parse().ok())
            .unwrap_or(default)
    };
    let (first, runs) = (option("--seed", 1), option("--runs", 1_000_000));
    let end = first.saturating_add(runs);
    SEED.store(first, Ordering::Relaxed);
    // A panic is counted and named by its seed; where it was, is on standard error.
    let worker = std::thread::spawn(move || study(first, end));
    let mut since = (first, Instant::now());
    while !worker.is_finished() {
        std::thread::park_timeout(Duration::from_millis(200));
        let now = SEED.load(Ordering::Relaxed);
        if now != since.0 {
            since = (now, Instant::now());
        } else if since.1.elapsed() > HANGS {
            eprintln!("seed {now} hangs");
            return ExitCode::FAILURE;
        }
    }
    match worker.join() {
        Ok(true) => ExitCode::SUCCESS,
        _ => ExitCode::FAILURE,
    }
}

fn study(first: u64, end: u64) -> bool {
    let mut counts = [0_u64; Came::ALL.len()];
    let (mut panics, mut late) = (0_u64, 0_u64);
    let mut longest = (0.0, first);
    let mut hash = 0xCBF2_9CE4_8422_2325_u64;
    let began_s = cpu_s();
    let mut before_s = began_s;
    for seed in first..end {
        SEED.store(seed, Ordering::Relaxed);
        let came = catch_unwind(|| plan(&draw(&mut Rng(seed))));
        let now_s = cpu_s();
        let took_s = now_s - before_s;
        before_s = now_s;
        if took_s > longest.0 {
            longest = (took_s, seed);
        }
        if took_s > MOST_S {
            late += 1;
            eprintln!("seed {seed} takes {took_s:.1} s");
        }
        let number = match came {
            Ok(came) => Came::ALL.iter().position(|one| *one == came).unwrap_or(0),
            Err(_) => {
                panics += 1;
                eprintln!("seed {seed} panics");
                continue;
            }
        };
        counts[number] += 1;
        // FNV-1a (Fowler, Noll, Vo) over the outcomes: two runs agree, or they do not.
        hash = (hash ^ number as u64).wrapping_mul(0x0100_0000_01B3);
    }
    let peak_kb = peak_kb();
    println!(
        "{} inputs, seeds {first} to {}: {panics} panics, {late} over {MOST_S} s, hash {hash:016x}",
        end - first,
        end.saturating_sub(1)
    );
    for (came, count) in Came::ALL.iter().zip(counts) {
        println!("{came:?}: {count}");
    }
    println!(
        "{:.0} s of processor time; the longest input {:.2} s (seed {}); {:.0} MB at the peak",
        before_s - began_s,
        longest.0,
        longest.1,
        peak_kb as f64 / 1e3
    );
    panics == 0 && late == 0 && peak_kb <= MOST_KB
}

/// Processor time of this thread, s, from Linux's count of hundredths; elsewhere the clock's time.
fn cpu_s() -> f64 {
    static BEGAN: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    let began = BEGAN.get_or_init(Instant::now);
    let stat = std::fs::read_to_string("/proc/thread-self/stat").unwrap_or_default();
    // The name in parentheses may hold anything; user and system time are fields 14 and 15.
    let fields = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
    let ticks: Vec<f64> = fields
        .split_whitespace()
        .skip(11)
        .take(2)
        .filter_map(|field| field.parse().ok())
        .collect();
    match ticks[..] {
        [user, system] => (user + system) / 100.0,
        _ => began.elapsed().as_secs_f64(),
    }
}

/// Most memory that this process ever had, kB; 0 where the system does not say.
fn peak_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let number = line.and_then(|rest| rest.split_whitespace().next());
    number.and_then(|n| n.parse().ok()).unwrap_or(0)
}
