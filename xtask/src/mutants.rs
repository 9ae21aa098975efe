//! A study of the tests: cargo-mutants changes the code in one place at a time, and the tests of its crate must notice.

use crate::tools;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// A crate whose tests are studied, and the tests of it that judge its code.
struct Subject {
    name: &'static str,
    package: &'static str,
    /// After `cargo test`. The schematic's and the wiring guide's tests do not execute the core.
    tests: &'static [&'static str],
}

const SUBJECTS: [Subject; 2] = [
    Subject {
        name: "firmware",
        package: "mcdpr-firmware",
        tests: &["--lib", "--test", "core"],
    },
    Subject {
        name: "protocol",
        package: "mcdpr-protocol",
        tests: &["--tests"],
    },
];

/// Least time after which tests that do not end count as failed, s. They take 4 s, and twenty on a busy computer.
const LEAST_TIMEOUT_S: &str = "90";
/// What cargo-mutants answers if mutants were missed, or timed out: results, not errors.
const MISSED: i32 = 2;
const TIMED_OUT: i32 = 3;

/// Draws mutants of a crate, tests them, and prints what became of them.
pub(crate) fn study(options: &[String]) -> Result<(), String> {
    let options = Options::parse(options)?;
    let subject = options.subject;
    let program = std::path::absolute(tools::ensure_mutants()?).map_err(|e| e.to_string())?;
    let all = count(&program, subject, &[])?;
    let drawn = draw(all, options.sample, options.seed);
    let chosen = count(&program, subject, &drawn)?;
    println!(
        "{}: {chosen} of {all} mutants ({})",
        subject.name,
        drawn.join(" ")
    );
    let folder = tools::target().join("mutants").join(subject.name);
    std::fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let status = tool(&program, subject)
        .args(["--output".as_ref(), folder.as_os_str()])
        .args(["--jobs", "1", "--no-shuffle", "--colors", "never"])
        .args(["--profile", "mutants", "--cargo-arg", "--locked"])
        .args(["--minimum-test-timeout", LEAST_TIMEOUT_S])
        .args(&drawn)
        .arg("--")
        .args(subject.tests)
        .status()
        .map_err(|error| format!("xtask: cargo-mutants cannot be started: {error}"))?;
    if !status.success() && !matches!(status.code(), Some(MISSED | TIMED_OUT)) {
        return Err(format!("xtask: cargo-mutants failed: {status}"));
    }
    let outcome = Outcome::read(&folder.join("mutants.out"))?;
    print!("{}", outcome.summary());
    if outcome.tested() + outcome.unviable.len() == chosen {
        Ok(())
    } else {
        Err("xtask: cargo-mutants did not test every mutant of the sample".to_owned())
    }
}

struct Options {
    subject: &'static Subject,
    sample: usize,
    seed: u64,
}

impl Options {
    fn parse(words: &[String]) -> Result<Self, String> {
        let mut options = Self {
            subject: &SUBJECTS[0],
            sample: 150,
            seed: 1,
        };
        for pair in words.chunks(2) {
            let [key, value] = pair else {
                return Err(format!("xtask: {} needs a value", pair[0]));
            };
            let wrong = |_| format!("xtask: {key} {value}: not a number");
            match key.as_str() {
                "--package" => {
                    let found = SUBJECTS.iter().find(|subject| subject.name == value);
                    options.subject = found.ok_or_else(|| {
                        format!("xtask: --package {value}: it is firmware or protocol")
                    })?;
                }
                "--sample" => options.sample = value.parse().map_err(wrong)?,
                "--seed" => options.seed = value.parse().map_err(wrong)?,
                _ => return Err(format!("xtask: study mutants: {key} is not known")),
            }
        }
        Ok(options)
    }
}

fn tool(program: &Path, subject: &Subject) -> Command {
    let mut command = Command::new(program);
    command.args(["mutants", "--package", subject.package]);
    // It copies the workspace and builds there: builds of other sources would spoil a shared folder.
    command.env_remove("CARGO_TARGET_DIR");
    command
}

/// How many mutants a crate has, or a part of them.
fn count(program: &Path, subject: &Subject, part: &[String]) -> Result<usize, String> {
    let output = tool(program, subject)
        .arg("--list")
        .args(part)
        .stderr(Stdio::inherit())
        .output()
        .map_err(|error| format!("xtask: cargo-mutants cannot be started: {error}"))?;
    if !output.status.success() {
        return Err(format!("xtask: cargo-mutants failed: {}", output.status));
    }
    Ok(String::from_utf8_lossy(&output.stdout).lines().count())
}

/// At least `sample` of `all` mutants, evenly over the sources: every n-th, from a place that the seed gives. Seeds from
/// 0 to n - 1 give samples without a common mutant. (Not by name: the filter `--re` always lets deleted fields through.)
fn draw(all: usize, sample: usize, seed: u64) -> Vec<String> {
    let step = (all / sample.max(1)).max(1) as u64;
    let shard = format!("{}/{step}", seed % step);
    ["--sharding", "round-robin", "--shard", &shard]
        .map(str::to_owned)
        .to_vec()
}

/// What became of the mutants.
struct Outcome {
    caught: Vec<String>,
    missed: Vec<String>,
    timed_out: Vec<String>,
    /// They do not compile, and say nothing about the tests.
    unviable: Vec<String>,
}

impl Outcome {
    fn read(folder: &Path) -> Result<Self, String> {
        let lines = |name: &str| -> Result<Vec<String>, String> {
            let path: PathBuf = folder.join(name);
            let text = std::fs::read_to_string(&path)
                .map_err(|error| format!("{}: {error}", path.display()))?;
            Ok(text.lines().map(str::to_owned).collect())
        };
        Ok(Self {
            caught: lines("caught.txt")?,
            missed: lines("missed.txt")?,
            timed_out: lines("timeout.txt")?,
            unviable: lines("unviable.txt")?,
        })
    }

    fn tested(&self) -> usize {
        self.caught.len() + self.missed.len() + self.timed_out.len()
    }

    /// A mutant whose tests do not end is noticed, as one whose tests fail.
    fn summary(&self) -> String {
        let noticed = self.caught.len() + self.timed_out.len();
        let (low, high) = wilson(noticed, self.tested());
        let mut text = format!(
            "caught {}, timed out {}, missed {}, unviable {}\n\
             noticed: {noticed} of {}, {:.1} % (95 %: {:.1} to {:.1} %)\n",
            self.caught.len(),
            self.timed_out.len(),
            self.missed.len(),
            self.unviable.len(),
            self.tested(),
            100.0 * noticed as f64 / self.tested().max(1) as f64,
            100.0 * low,
            100.0 * high,
        );
        for (what, names) in [("missed", &self.missed), ("timed out", &self.timed_out)] {
            for name in names {
                text.push_str(&format!("{what}: {name}\n"));
            }
        }
        text
    }
}

/// Interval of a share at 95 % (Wilson 1927).
fn wilson(hits: usize, of: usize) -> (f64, f64) {
    const Z: f64 = 1.96;
    if of == 0 {
        return (0.0, 1.0);
    }
    let n = of as f64;
    let share = hits as f64 / n;
    let middle = share + Z * Z / (2.0 * n);
    let half = Z * (share * (1.0 - share) / n + Z * Z / (4.0 * n * n)).sqrt();
    let whole = 1.0 + Z * Z / n;
    ((middle - half) / whole, (middle + half) / whole)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(count: usize) -> Vec<String> {
        (0..count).map(|index| format!("mutant {index}")).collect()
    }

    #[test]
    fn a_seed_gives_every_nth_mutant_from_its_own_place() {
        let shard = |all, sample, seed| draw(all, sample, seed).pop().unwrap();
        assert_eq!(shard(3080, 150, 1), "1/20");
        assert_eq!(shard(3080, 150, 22), "2/20");
        for whole in [3080, 5000, 2000] {
            assert_eq!(shard(3080, whole, 7), "0/1");
        }
    }

    #[test]
    fn the_interval_is_wilsons() {
        // Wald's would be 100 to 100 % and 81.6 to 98.4 %.
        let (low, high) = wilson(10, 10);
        assert!((low - 0.7225).abs() < 1e-3 && (high - 1.0).abs() < 1e-9);
        let (low, high) = wilson(45, 50);
        assert!((low - 0.7864).abs() < 1e-3 && (high - 0.9565).abs() < 1e-3);
    }

    #[test]
    fn options_have_defaults_and_wrong_ones_are_named() {
        let parse = |text: &str| {
            let words: Vec<String> = text.split_whitespace().map(str::to_owned).collect();
            Options::parse(&words)
        };
        let good = parse("--package protocol --sample 9 --seed 4").unwrap();
        assert_eq!(
            (good.subject.name, good.sample, good.seed),
            ("protocol", 9, 4)
        );
        assert_eq!(parse("").unwrap().subject.name, "firmware");
        for wrong in ["--sample", "--sample x", "--package host", "--sed 1"] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn tests_that_do_not_end_notice_their_mutant() {
        let outcome = Outcome {
            caught: names(7),
            missed: vec!["left".to_owned()],
            timed_out: names(2),
            unviable: names(3),
        };
        let text = outcome.summary();
        assert!(
            text.contains("caught 7, timed out 2, missed 1, unviable 3"),
            "{text}"
        );
        assert!(text.contains("noticed: 9 of 10, 90.0 %"), "{text}");
        assert!(text.contains("missed: left\n"), "{text}");
    }
}
