//! A recorded run: read back, judged, and prepared for the page.
//!
//! | module | what it is for |
//! |---|---|
//! | [`mcap`] | the container that a run is kept in |
//! | [`pack`] | calls of a line, packed |
//! | [`load`](mod@load) | a recorded run, read back |
//! | [`scenario`] | the inputs of a run, for repeating it |
//! | [`figures`], [`judge`](mod@judge) | figures and verdicts of a run |
//! | [`past`], [`traces`] | its motion and its charts for the page |

pub mod figures;
pub mod judge;
pub mod load;
pub mod mcap;
pub mod pack;
pub mod past;
pub mod scenario;
pub mod traces;

pub use load::{Change, LoadError, LogLine, RecordedRun, Report};
pub use scenario::{Doing, Machine, RobotText, Scenario, TaskSource, protocol_version};

/// Name of the record in a run's folder.
pub const FILE_NAME: &str = "run.mcap";
/// Topic of the bytes on the wire.
pub const WIRE: &str = "/wire";
