//! What a host of the robot does that needs no operating system: it runs on a computer, and in a
//! web page.
//!
//! | module | what it is for |
//! |---|---|
//! | [`holding`] | which cables are held by length, which by tension |
//! | [`robot`] | the robot description, from text |
//! | [`machine`] | the description as geometry and as a board's configuration |
//! | [`random`] | random numbers from a seed |
//! | [`sight`] | what sees tags |
//! | [`motion`] | tasks, paths, plans: what the tool does and what the cables must do for it |
//! | [`estimate`] | where the platform is, from lengths, tensions and tags, and which cable slipped |
//! | [`faults`] | faults and refusals in words |
//! | [`diagnosis`] | what failed, by the samples around a fault |
//! | [`control`] | orders to a robot that is being moved |
//! | [`link`] | the host's half of the protocol, over any byte stream |
//! | [`boards`] | several boards behind one line: one robot |
//! | [`run`] | running a plan on a board |
//! | [`care`] | wear of cables, drums and brakes, counted from runs |
//!
//! Files, ports, clocks and threads are left to the caller: texts come in as strings, a
//! [`link::Link`] brings its own clock, lengths are kept by a [`run::saved::LengthStore`].

pub mod boards;
pub mod care;
pub mod control;
pub mod diagnosis;
pub mod estimate;
pub mod faults;
pub mod holding;
pub mod link;
pub mod machine;
pub mod motion;
mod near;
pub mod random;
pub mod recovery;
pub mod robot;
pub mod run;
pub mod sight;
