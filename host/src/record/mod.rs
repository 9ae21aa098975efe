//! Recording and viewing a run: the bytes on the line and the host's notes, for records and live
//! views.
//!
//! | module | what it is for |
//! |---|---|
//! | [`mcap`] | the container that a run is kept in |
//! | [`decode`] | decodes the bytes of a line, both ways |
//! | [`events`] | passes events to watchers on separate threads |
//! | [`recording`] | the watcher that writes the MCAP file |
//! | `panel` | the robot in Foxglove's terms, for its 3-D panel |
//! | `rosbag`, `ros2`, `cdr` | a record as a bag of ROS 2; its messages, and their bytes |
//! | [`load()`] | reads a recorded run back |
//! | [`scenario`] | the inputs of a run, as this program collects them |
//! | [`words`] | states and limits in words |
//!
//! Watchers see a run from outside: the bytes that pass (with the link's own times), and notes of
//! the host (its plan). The thread that moves the robot copies a few hundred bytes into a queue and
//! continues, independent of the disk or a browser.

pub(crate) mod cdr;
pub mod events;
pub mod mcap;
pub(crate) mod panel;
pub mod recording;
pub(crate) mod ros2;
pub(crate) mod rosbag;
pub mod scenario;
mod schemas;
mod short;

pub use mcdpr_twin::record::{
    Change, Doing, FILE_NAME, LoadError, Machine, RecordedRun, Report, RobotText, Scenario,
    TaskSource, protocol_version,
};
pub use mcdpr_twin::{decode, words};

pub use events::{EventBus, Level, PlanNote, PlanPoint, RunEvent, TruthPoint, Watched};
pub use recording::{Recording, Summary};
pub use scenario::{starting_now, task_source};

use std::path::Path;

/// Most bytes of a record: days of a robot.
const MOST_BYTES: u64 = 4 << 30;

/// Reads a run's folder or file.
///
/// # Errors
/// [`LoadError`]. A file that is cut short or partly corrupt is read as far as it goes.
pub fn load(run: &Path) -> Result<RecordedRun, LoadError> {
    let path = if run.is_dir() {
        run.join(FILE_NAME)
    } else {
        run.to_owned()
    };
    let bytes = crate::files::read_bytes(&path, MOST_BYTES);
    let bytes = bytes.map_err(|error| LoadError::Missing {
        path: path.clone(),
        reason: error.to_string(),
    })?;
    RecordedRun::parse(&bytes, path)
}
