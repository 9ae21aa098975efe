//! The simulated robot of a robot file, and what viewers see of a robot.
//!
//! Files, clocks, threads and sockets are left to the caller, so that the program and the playground,
//! which runs in a browser, share all of it.
//!
//! | module | what it is for |
//! |---|---|
//! | [`plant`] | a robot description as physics, exact or with a stated mismatch |
//! | [`line`](mod@line) | the line to a simulated robot, in virtual time |
//! | [`together`] | how far apart several boards are along their path |
//! | [`events`], [`watched`] | what happens on a line, for records and live views |
//! | [`decode`], [`words`] | the bytes of a line decoded; states and limits in words |
//! | [`faults`] | faults to inject, and a line that injects them on time |
//! | [`gears`] | geared winches over the range that such winches have |
//! | [`notices`] | what other parts of a program tell viewers |
//! | [`feed`] | the data that viewers share |
//! | [`viewer`] | the messages that a viewer gets |
//! | [`attend`] | waiting for orders to an idle robot, and jogging |
//! | [`day`] | a day of work at rest from second to second, and its judge |
//! | [`fingerprint`](mod@fingerprint) | a hash of everything in a simulated run |
//! | [`asked`], [`preview`] | orders of the page that ask for a plan; what a plan would do |
//! | [`plans`] | what Start begins |
//! | [`record`] | a recorded run: read, judged, and prepared for the page |
//! | [`page()`] | the live page |

pub mod asked;
pub mod attend;
pub mod day;
pub mod decode;
pub mod events;
pub mod faults;
pub mod feed;
pub mod fingerprint;
pub mod gears;
pub mod line;
pub mod notices;
mod page;
pub mod plans;
pub mod plant;
pub mod preview;
pub mod record;
pub mod together;
pub mod viewer;
pub mod watched;
pub mod words;

pub use events::{Level, PlanNote, PlanPoint, RunEvent, TruthPoint, Watcher};
pub use feed::{Feed, FeedWatcher};
pub use line::SimulatedLink;
pub use page::page;
pub use watched::{Sink, TruthTap, Watched};
