//! What a command prints: lines, questions, its result and the reason of its failure.

use crate::cli::under_page::reason_of;

/// A piece of output.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Piece {
    /// A complete line.
    Line(String),
    /// The beginning of a line that waits for an answer.
    Question(String),
}

/// Ends of the questions that commands ask.
const QUESTIONS: [&str; 3] = ["[y/N]", "[y/n]", "press Enter"];
/// A longer line is cut into pieces, bytes.
const LONGEST: usize = 4096;

/// Collects bytes into lines.
#[derive(Debug, Default)]
pub(super) struct Lines {
    rest: Vec<u8>,
    asked: bool,
}

impl Lines {
    /// Takes bytes, and returns what they complete.
    pub(super) fn take(&mut self, bytes: &[u8]) -> Vec<Piece> {
        let mut pieces = Vec::new();
        for &byte in bytes {
            if byte == b'\n' || self.rest.len() >= LONGEST {
                pieces.extend(self.end());
            }
            if byte != b'\n' && byte != b'\r' {
                self.rest.push(byte);
            }
        }
        let rest = String::from_utf8_lossy(&self.rest).trim_end().to_owned();
        if !self.asked && QUESTIONS.iter().any(|end| rest.ends_with(end)) {
            self.asked = true;
            pieces.push(Piece::Question(rest));
        }
        pieces
    }

    /// What is left at the end.
    pub(super) fn end(&mut self) -> Option<Piece> {
        let bytes = std::mem::take(&mut self.rest);
        let asked = std::mem::take(&mut self.asked);
        let line = String::from_utf8_lossy(&bytes).trim_end().to_owned();
        // A question was shown when it was asked.
        (!asked && !line.is_empty()).then_some(Piece::Line(line))
    }
}

/// The address of a command's live page, from its output: authority and token.
pub(super) fn address_of(line: &str) -> Option<(String, String)> {
    let address = line.strip_prefix("to give orders:")?.trim();
    let (host, token) = address.strip_prefix("http://")?.split_once("/#token=")?;
    Some((host.to_owned(), token.to_owned()))
}

/// Whether a line has the address of a live page, which a page needs not show: its token gives orders.
pub(super) fn is_address(line: &str) -> bool {
    line.starts_with("to look:") || line.starts_with("to give orders:")
}

/// Lines of results that say most, by their beginnings.
const TELLING: [&str; 13] = [
    "verdict:",
    "predicted position error",
    "expected error of the platform",
    "one more pose",
    "warning:",
    "written",
    "nothing was",
    "winch ",
    "place ",
    "# ",
    "calibrated",
    "as described",
    "run folder:",
];

/// What is kept of a command's output to judge it.
#[derive(Debug, Default)]
pub(super) struct Judged {
    good: usize,
    notes: usize,
    bad: Vec<String>,
    remedies: Vec<String>,
    telling: Vec<String>,
    last: String,
    reason: Option<(String, Option<String>)>,
    usage: Option<String>,
}

impl Judged {
    /// Takes a line; returns whether it is for viewers.
    pub(super) fn take(&mut self, line: &str, is_result: bool) -> bool {
        if let Some(reason) = reason_of(line) {
            self.reason = Some(reason);
            return false;
        }
        if let Some(usage) = line.strip_prefix("error: ") {
            self.usage = Some(usage.to_owned());
        }
        self.good += usize::from(line.starts_with("ok  "));
        self.notes += usize::from(line.starts_with("note  "));
        if let Some(bad) = line.strip_prefix("BAD ") {
            self.bad
                .push(bad.split_whitespace().collect::<Vec<_>>().join(" "));
        } else if let Some(remedy) = line.trim_start().strip_prefix("-> ")
            && self.remedies.len() < self.bad.len()
        {
            self.remedies.push(remedy.to_owned());
        }
        if is_result && TELLING.iter().any(|begin| line.starts_with(begin)) {
            self.telling.push(line.to_owned());
        } else if is_result {
            line.clone_into(&mut self.last);
        }
        true
    }

    /// The lines that say most.
    pub(super) fn result(&self) -> Vec<String> {
        if self.good > 0 {
            let (good, notes, bad) = (self.good, self.notes, self.bad.len());
            return vec![format!(
                "parts that are good: {good}, with a note: {notes}, to be repaired: {bad}"
            )];
        }
        // A folder alone says nothing about what was found.
        let says = |line: &String| !line.starts_with("run folder:");
        if !self.last.is_empty() && !self.telling.iter().any(says) {
            let last = std::iter::once(self.last.clone());
            return last.chain(self.telling.iter().cloned()).collect();
        }
        self.telling.clone()
    }

    /// Why it failed, and what to do.
    pub(super) fn failure(&self, code: Option<i32>) -> (String, String) {
        let (reason, next) = match (&self.reason, &self.usage) {
            (Some((reason, next)), _) => (reason.clone(), next.clone()),
            (None, Some(usage)) => (usage.clone(), None),
            (None, None) => {
                let how = code.map_or("was killed".to_owned(), |code| {
                    format!("ended with code {code}")
                });
                (format!("the command {how}, without a reason"), None)
            }
        };
        let reason = if self.bad.is_empty() {
            reason
        } else {
            format!("{reason}: {}", self.bad.join("; "))
        };
        let next = match (self.remedies.is_empty(), next) {
            (false, _) => self.remedies.join("; "),
            (true, Some(next)) => next,
            (true, None) => "read its output, remove the cause, and run it again".to_owned(),
        };
        (reason, next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_and_questions_are_told_apart() {
        let mut lines = Lines::default();
        let line = |text: &str| Piece::Line(text.to_owned());
        assert_eq!(lines.take(b"one\r\ntw"), [line("one")]);
        assert_eq!(lines.take(b"o\n\nlet it down? [y/N"), [line("two")]);
        let asked = Piece::Question("let it down? [y/N]".to_owned());
        assert_eq!(lines.take(b"] "), [asked]);
        // Asked once; the answer's end of line ends it.
        assert_eq!(lines.take(b"\nstill\n"), [line("still")]);
        assert_eq!(lines.take(&[b'x'; LONGEST + 1]).len(), 1);
        assert_eq!(lines.end(), Some(line("x")));
        assert_eq!(lines.end(), None);
    }

    #[test]
    fn the_address_of_a_live_page_is_found() {
        let line = "to give orders:  http://127.0.0.1:4242/#token=abc";
        let wanted = Some(("127.0.0.1:4242".to_owned(), "abc".to_owned()));
        assert_eq!(address_of(line), wanted);
        assert!(is_address(line) && !is_address("ok    port"));
        assert_eq!(address_of("to look:         http://127.0.0.1:1/"), None);
    }

    #[test]
    fn a_failure_has_its_reason_and_the_next_step() {
        let mut judged = Judged::default();
        assert!(judged.take("BAD   port           no such device", true));
        assert!(judged.take("                     -> plug it in", true));
        assert!(judged.take("note  line           slow", true));
        assert!(judged.take("                     -> use another cable", true));
        let line = "mcdpr-failed: {\"reason\":\"doctor: one part\",\"next\":null}";
        assert!(!judged.take(line, false));
        judged.take("ok    board", true);
        let result = judged.result();
        assert_eq!(
            result,
            ["parts that are good: 1, with a note: 1, to be repaired: 1"]
        );
        let (reason, next) = judged.failure(Some(1));
        assert_eq!(reason, "doctor: one part: port no such device");
        assert_eq!(next, "plug it in");
        let (reason, next) = Judged::default().failure(None);
        assert!(reason.contains("killed") && !next.is_empty());
    }

    #[test]
    fn a_result_is_what_says_most() {
        let mut judged = Judged::default();
        judged.take("cable   anchor x", true);
        judged.take("homed: tool at (1, 2, 3) mm", true);
        assert_eq!(judged.result(), ["homed: tool at (1, 2, 3) mm"]);
        judged.take("run folder: runs/1", true);
        assert_eq!(judged.result().len(), 2);
        judged.take("predicted position error 0.55 mm", true);
        judged.take("verdict: accepted", true);
        judged.take("verdict: not a result", false);
        assert_eq!(judged.result().len(), 3);
    }
}
