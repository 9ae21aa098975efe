//! Mistakes in a robot file, reported with file, line, key and remedy.

use std::fmt;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use miette::{Diagnostic, LabeledSpan, NamedSource, SourceCode, SourceSpan};

/// One mistake in a robot or winch module file.
#[derive(Debug, Clone)]
pub struct Problem {
    /// The file as the user named it.
    pub file: String,
    /// Line of the mistake, from 1.
    pub line: usize,
    /// Where in the robot: `[platform]`, `cable 3`, `winch 2`.
    pub place: String,
    /// What is wrong, with key and value.
    pub what: String,
    /// What to do about it.
    pub help: Option<String>,
    /// Bytes of the file that the mistake is about.
    pub span: SourceSpan,
    /// Text of the file, for the excerpt that is shown with the message.
    pub text: NamedSource<Arc<str>>,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}:{}: {}: {}",
            self.file, self.line, self.place, self.what
        )
    }
}

impl std::error::Error for Problem {}

impl Diagnostic for Problem {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.help
            .as_ref()
            .map(|help| Box::new(help) as Box<dyn fmt::Display>)
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        Some(&self.text)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let label = LabeledSpan::new_with_span(Some("here".into()), self.span);
        Some(Box::new(std::iter::once(label)))
    }
}

/// Why a robot could not be loaded.
#[derive(Debug, thiserror::Error)]
pub enum RobotError {
    /// The name is neither a file nor a built-in robot.
    #[error("no robot file or built-in robot `{asked}`: tried {}", listed(.tried))]
    NotFound {
        /// What was asked for.
        asked: String,
        /// The paths that were tried.
        tried: Vec<PathBuf>,
        /// The built-in robots' names.
        built_in: Vec<&'static str>,
    },
    /// The file is there but cannot be read.
    #[error("cannot read the robot file {}: {source}", .path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The system's message.
        source: io::Error,
    },
    /// The file was read but is invalid; the first mistake is the message, the others follow as
    /// related ones.
    #[error("{}{}", .0.first, more(.0.others.len()))]
    Invalid(Box<Invalid>),
}

/// The mistakes of one robot file, in the order of the file.
#[derive(Debug, Clone)]
pub struct Invalid {
    /// The first mistake.
    pub first: Problem,
    /// The further ones.
    pub others: Vec<Problem>,
}

impl RobotError {
    /// The mistakes of an invalid file, first one first; empty for the other errors.
    #[cfg(test)]
    pub(crate) fn problems(&self) -> Vec<&Problem> {
        match self {
            RobotError::Invalid(invalid) => std::iter::once(&invalid.first)
                .chain(&invalid.others)
                .collect(),
            _ => Vec::new(),
        }
    }

    fn first(&self) -> Option<&Problem> {
        match self {
            RobotError::Invalid(invalid) => Some(&invalid.first),
            _ => None,
        }
    }
}

impl RobotError {
    /// Every problem, a line each, without colours or excerpts of the file.
    #[must_use]
    pub fn plain_words(&self) -> String {
        let others = self.related().into_iter().flatten();
        let others = others.map(ToString::to_string);
        let problems = std::iter::once(self.to_string()).chain(others);
        problems.collect::<Vec<_>>().join("\n")
    }
}

impl Diagnostic for RobotError {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        match self {
            RobotError::NotFound {
                asked, built_in, ..
            } => {
                let meant = crate::near::nearest(asked, built_in.iter().copied());
                let meant =
                    meant.map_or(String::new(), |name| format!("did you mean `{name}`? Or "));
                Some(Box::new(format!(
                    "{meant}give the path of a robot file or the name of a built-in robot: {}",
                    built_in.join(", ")
                )))
            }
            RobotError::Unreadable { .. } => Some(Box::new(
                "check that it is a text file that you may read".to_string(),
            )),
            RobotError::Invalid(invalid) => invalid.first.help(),
        }
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.first().and_then(Diagnostic::source_code)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        self.first().and_then(Diagnostic::labels)
    }

    fn related<'a>(&'a self) -> Option<Box<dyn Iterator<Item = &'a dyn Diagnostic> + 'a>> {
        match self {
            RobotError::Invalid(invalid) if !invalid.others.is_empty() => Some(Box::new(
                invalid
                    .others
                    .iter()
                    .map(|problem| problem as &dyn Diagnostic),
            )),
            _ => None,
        }
    }
}

fn listed(paths: &[PathBuf]) -> String {
    let shown: Vec<String> = paths
        .iter()
        .map(|path| path.display().to_string())
        .collect();
    shown.join(", ")
}

fn more(count: usize) -> String {
    match count {
        0 => String::new(),
        1 => " (and 1 more mistake)".into(),
        _ => format!(" (and {count} more mistakes)"),
    }
}
