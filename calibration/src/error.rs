//! Why a calibration was refused.

use miette::Diagnostic;

/// Why a calibration was refused. Cables, poses and tags are named as the user knows them: cables
/// and poses are counted from 1, tags by their id.
#[derive(Debug, Clone, PartialEq, thiserror::Error, Diagnostic)]
#[diagnostic(
    code(mcdpr::calibration),
    help("docs/calibration.md explains the data and the checks")
)]
pub enum Refusal {
    /// The text is not valid JSON.
    #[error("the data are not readable as JSON: {0}; write the file again")]
    NotJson(String),
    /// The document is of another format.
    #[error(
        "the data's schema is {found}, but only \"{}\" is understood; convert the file",
        super::data::SCHEMA
    )]
    Schema {
        /// The schema in the file, quoted, or a note that it is missing.
        found: String,
    },
    /// A value is missing or invalid.
    #[error("{path}: {what}")]
    Field {
        /// Where in the document, such as `poses[3].encoder_dl_mm[2]` (counted from 0, as in JSON).
        path: String,
        /// What is wrong and what to do.
        what: String,
    },
    /// Not enough poses for the unknowns.
    #[error(
        "{got} usable poses of {total}, at least {needed} are needed (20 is a good number): record more\
         {note}"
    )]
    TooFewPoses {
        /// Poses that count.
        got: usize,
        /// Poses in the data.
        total: usize,
        /// Poses needed.
        needed: usize,
        /// Why poses did not count, or empty.
        note: String,
    },
    /// Two poses contain identical numbers.
    #[error(
        "poses {first} and {second} hold the same numbers: one measurement was written twice; remove \
         pose {second}"
    )]
    Duplicate {
        /// The earlier pose, from 1.
        first: usize,
        /// The later pose, from 1.
        second: usize,
    },
    /// The platform's tilt does not vary.
    #[error(
        "all poses have one tilt: the platform's tilt varies by {spread_deg:.2} degrees over the data, \
         at least {needed_deg} are needed to find where the camera sits; record poses farther from \
         the middle and with other tensions"
    )]
    OneTilt {
        /// Largest angle between the platform's vertical axes at two poses.
        spread_deg: f64,
        /// Angle needed.
        needed_deg: f64,
    },
    /// The data do not determine the unknowns.
    #[error(
        "the data do not fix the robot: rank {rank} of {expected}; free: {directions}; record poses \
         that move and tilt the platform in more ways"
    )]
    Degenerate {
        /// Rank reached.
        rank: usize,
        /// Rank that good data reach.
        expected: usize,
        /// Unobservable directions in words.
        directions: String,
    },
    /// The solver found no minimum.
    #[error(
        "no estimate explains the data: {what}; check the start values (`nominal`) and the tags' corners"
    )]
    NotConverged {
        /// What went wrong.
        what: String,
    },
    /// The data contradict the model.
    #[error("{what}")]
    Contradiction {
        /// The contradiction, its size, the likely cause, and the remedy.
        what: String,
    },
}

impl Refusal {
    /// Whether a mistake in the data may be its cause.
    pub(crate) const fn may_be_a_mistake(&self) -> bool {
        matches!(
            self,
            Self::Contradiction { .. } | Self::NotConverged { .. } | Self::Degenerate { .. }
        )
    }

    pub(crate) fn field(path: impl Into<String>, what: impl Into<String>) -> Self {
        Self::Field {
            path: path.into(),
            what: what.into(),
        }
    }
}
