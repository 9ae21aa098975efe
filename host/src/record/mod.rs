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
//! | [`load`] | a recorded run, read back |
//! | [`scenario`] | the inputs of a run, for repeating it |
//! | [`words`] | states and limits in words |
//!
//! Watchers see a run from outside: the bytes that pass (with the link's own times), and notes of
//! the host (its plan). The thread that moves the robot copies a few hundred bytes into a queue and
//! continues, independent of the disk or a browser.

pub(crate) mod cdr;
pub mod events;
pub mod load;
pub mod mcap;
mod pack;
pub(crate) mod panel;
pub mod recording;
pub(crate) mod ros2;
pub(crate) mod rosbag;
pub mod scenario;
mod schemas;
mod short;

pub use mcdpr_twin::{decode, words};

pub use events::{EventBus, Level, PlanNote, PlanPoint, RunEvent, TruthPoint, Watched};
pub use load::{Change, LoadError, RecordedRun, Report};
pub use recording::{Recording, Summary};
pub use scenario::{Doing, Machine, RobotText, Scenario, TaskSource};

/// Name of the record in a run's folder.
pub const FILE_NAME: &str = "run.mcap";
