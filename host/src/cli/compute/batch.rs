//! `--batch`: JSON lines on standard input, one result per line on standard output.

use super::super::{Failed, Outcome};
use crate::compute::ComputeError;
use miette::Diagnostic;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{self, BufRead, BufReader, Read, Write};

/// Longest line that is read; 16 cables' lengths take less than 1 kB.
const MOST_BYTES: u64 = 1 << 16;

/// Result of a batch.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Tally {
    lines: u64,
    failed: u64,
}

/// A batch in which lines failed.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[error("{failed} of {lines} lines failed")]
#[diagnostic(
    code(mcdpr::compute::batch),
    help("each failed line's result on standard output is an object with `error` and `line`")
)]
struct LinesFailed {
    /// Lines that failed.
    failed: u64,
    /// Lines read.
    lines: u64,
}

#[derive(Serialize)]
struct Refusal<'a> {
    error: &'a str,
    line: u64,
}

/// Answers the lines of standard input with `answer`.
///
/// # Errors
/// [`LinesFailed`] at the end, if lines failed; errors of reading and writing.
pub(super) fn run<Q: DeserializeOwned, A: Serialize>(
    answer: impl FnMut(Q) -> Result<A, ComputeError>,
) -> Outcome {
    let mut input = BufReader::with_capacity(1 << 16, io::stdin().lock());
    let mut output = io::BufWriter::with_capacity(1 << 16, io::stdout().lock());
    let tally = process(&mut input, &mut output, answer)
        .map_err(Failed::from_error("reading lines and writing results"))?;
    match tally {
        Tally { failed: 0, .. } => Ok(()),
        Tally { failed, lines } => Err(LinesFailed { failed, lines }.into()),
    }
}

fn process<Q: DeserializeOwned, A: Serialize>(
    input: &mut BufReader<impl Read>,
    output: &mut impl Write,
    mut answer: impl FnMut(Q) -> Result<A, ComputeError>,
) -> io::Result<Tally> {
    let mut tally = Tally::default();
    let (mut line, mut result) = (Vec::new(), Vec::new());
    loop {
        // The next read may wait for a program that waits for this answer.
        if !input.buffer().contains(&b'\n') {
            output.flush()?;
        }
        line.clear();
        if input.take(MOST_BYTES).read_until(b'\n', &mut line)? == 0 {
            output.flush()?;
            return Ok(tally);
        }
        tally.lines += 1;
        let whole = line.ends_with(b"\n") || (line.len() as u64) < MOST_BYTES;
        let answered = if whole {
            parse(&line).and_then(|question| answer(question).map_err(|e| e.to_string()))
        } else {
            skip_line(input)?;
            Err(format!("the line is longer than {MOST_BYTES} bytes"))
        };
        result.clear();
        match answered {
            Ok(answer) => serde_json::to_writer(&mut result, &answer)?,
            Err(error) => {
                tally.failed += 1;
                let (error, line) = (error.as_str(), tally.lines);
                serde_json::to_writer(&mut result, &Refusal { error, line })?;
            }
        }
        result.push(b'\n');
        output.write_all(&result)?;
    }
}

fn skip_line(input: &mut impl BufRead) -> io::Result<()> {
    loop {
        let held = input.fill_buf()?;
        let (used, done) = match held.iter().position(|&b| b == b'\n') {
            Some(at) => (at + 1, true),
            None => (held.len(), held.is_empty()),
        };
        input.consume(used);
        if done {
            return Ok(());
        }
    }
}

/// One line as a question, or why it is invalid.
fn parse<Q: DeserializeOwned>(line: &[u8]) -> Result<Q, String> {
    // A list would be read as the object's values in order: too easily a mistake.
    match line.trim_ascii_start().first() {
        Some(b'{') => {}
        Some(_) => return Err("the line is not a JSON object; write one per line".to_owned()),
        None => return Err("the line is empty; write one JSON object per line".to_owned()),
    }
    serde_json::from_slice(line).map_err(|error| {
        let message = error.to_string();
        // The parser counts lines within its text, not those of the input.
        let place = format!(" at line {} column {}", error.line(), error.column());
        let message = message.strip_suffix(&place).unwrap_or(&message);
        format!("{message} (column {})", error.column())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Question {
        x: f64,
    }

    fn doubled(text: &str, capacity: usize) -> (String, Tally) {
        let mut output = Vec::new();
        let mut input = BufReader::with_capacity(capacity, text.as_bytes());
        let tally = process(&mut input, &mut output, |question: Question| {
            Ok::<_, ComputeError>(2.0 * question.x)
        });
        (String::from_utf8(output).unwrap(), tally.unwrap())
    }

    #[test]
    fn every_line_is_answered_in_its_place() {
        let text = "{\"x\": 1}\nnonsense\n\n{\"x\": 2, \"why\": 0}\n{\"x\": 3}";
        for capacity in [1, 7, 1000] {
            let (output, tally) = doubled(text, capacity);
            let lines: Vec<_> = output.lines().collect();
            assert_eq!(lines.len(), 5);
            assert_eq!((lines[0], lines[4]), ("2.0", "6.0"));
            assert!(lines[1].contains("\"line\":2") && lines[2].contains("\"line\":3"));
            assert!(
                lines[3].contains("`why`") && lines[3].contains("\"line\":4"),
                "{}",
                lines[3]
            );
            assert_eq!(
                tally,
                Tally {
                    lines: 5,
                    failed: 3
                }
            );
        }
    }

    #[test]
    fn a_line_without_end_is_refused_and_the_next_one_answered() {
        let text = format!("{}\n{{\"x\": 4}}\n", "[".repeat(200_000));
        let (output, tally) = doubled(&text, 4096);
        let lines: Vec<_> = output.lines().collect();
        assert!(lines[0].contains("longer than"), "{}", lines[0]);
        assert_eq!(lines[1], "8.0");
        assert_eq!(
            tally,
            Tally {
                lines: 2,
                failed: 1
            }
        );
    }
}
