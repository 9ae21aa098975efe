//! Seeing a run: what went over the line and what the host knew, for records and live views.
//!
//! | module | what it is for |
//! |---|---|
//! | [`mcap`] | the container that a run is kept in |
//! | [`decode`] | bytes of a line, both ways, as what they mean |
//! | [`witness`] | hands what happens to watchers on threads of their own |
//! | [`recording`] | the watcher that writes the MCAP file |
//! | `panel` | the robot in Foxglove's terms, for its 3-D panel |
//! | `rosbag`, `cdr` | a record as a bag of ROS 2 |
//! | [`load`] | a recorded run, read back |
//! | [`scenario`] | what was run, so that it can be run again |
//! | [`words`] | states and limits in words |
//!
//! Whoever watches sees a run from outside: the bytes that pass (with the link's own times), and
//! notes of the host (its plan). The thread that moves the robot copies a few hundred bytes into a
//! queue and goes on, whatever the disk or a browser does.

mod cdr;
pub mod decode;
pub mod load;
pub mod mcap;
mod pack;
mod panel;
pub mod recording;
pub(crate) mod rosbag;
pub mod scenario;
mod schemas;
mod short;
pub mod witness;
pub mod words;

pub use load::{LoadError, RecordedRun};
pub use recording::{Recording, Summary};
pub use scenario::{Doing, Machine, RobotText, Scenario, TaskSource};
pub use witness::{Happening, Level, PlanNote, PlanPoint, TruthPoint, Watched, Witness};

/// Name of the record in a run's folder.
pub const FILE_NAME: &str = "run.mcap";
