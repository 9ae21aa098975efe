//! How long each step takes: the longest are printed at the end, so that a slow one shows on any machine.

use std::sync::Mutex;
use std::time::{Duration, Instant};

static STEPS: Mutex<Vec<(String, Duration)>> = Mutex::new(Vec::new());
/// Steps that are printed.
const PRINTED: usize = 16;
/// Characters of a step's name that are printed.
const WIDTH: usize = 100;

/// Does a step and keeps its time.
pub(crate) fn timed<T>(name: &str, step: impl FnOnce() -> T) -> T {
    let began = Instant::now();
    let done = step();
    if let Ok(mut steps) = STEPS.lock() {
        steps.push((name.to_owned(), began.elapsed()));
    }
    done
}

/// The longest steps, and the whole since `began`.
pub(crate) fn summary(began: Instant) -> String {
    let mut steps = STEPS.lock().map(|all| all.clone()).unwrap_or_default();
    steps.sort_by_key(|(_, took)| std::cmp::Reverse(*took));
    let line = |(name, took): &(String, Duration)| {
        let short: String = name.chars().take(WIDTH).collect();
        format!("{:6.0} s  {short}", took.as_secs_f64())
    };
    let whole = ("in all".to_owned(), began.elapsed());
    let lines: Vec<_> = std::iter::once(&whole)
        .chain(steps.iter().take(PRINTED))
        .map(line)
        .collect();
    format!("xtask: times\n{}", lines.join("\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_step_comes_first_after_the_whole() {
        let began = Instant::now();
        assert_eq!(timed("quick", || 7), 7);
        let push = |name: &str, seconds| {
            STEPS
                .lock()
                .unwrap()
                .push((name.to_owned(), Duration::from_secs(seconds)));
        };
        push("short", 3);
        push(&"long".repeat(100), 60);
        let text = summary(began);
        let lines: Vec<_> = text.lines().collect();
        assert!(lines[1].ends_with("in all"), "{text}");
        assert!(lines[2].starts_with("    60 s  longlong") && lines[2].len() < 120);
        assert_eq!(lines[3], "     3 s  short");
    }
}
