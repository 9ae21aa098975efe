//! The host of a modular cable-driven parallel robot: all parts that do not run on the board.
//!
//! | module | what it is for |
//! |---|---|
//! | [`robot`] | the robot description file |
//! | [`calibration`] | the robot's parameters from lengths, tensions and pictures of tags |
//! | [`control`] | orders to a running robot, from this process or another |
//! | [`estimate`] | the platform's pose, from lengths, tensions and tags, and the cable that slipped |
//! | [`compute`] | the robot's mathematics for commands and programs |
//! | [`model_file`] | the description as a model of MuJoCo, or for viewers |
//! | [`hil`] | a real board in front of the simulated drives and robot |
//! | [`machine`] | the description as geometry, as a board's configuration, as physics |
//! | [`motion`] | tasks, paths, plans: motions of the tool and of the cables |
//! | [`link`] | byte streams to a board and the host's half of the protocol |
//! | [`record`] | runs saved in MCAP files, and read back |
//! | [`replay`] | the host and the core run again on recorded bytes |
//! | [`report`] | figures, plots and files of a run |
//! | [`serve`] | the live page |
//! | `ros` | topics and services of ROS 2, through a process that speaks DDS |
//! | [`reproduce`] | the paper's experiments, compared with its numbers |
//! | [`run`] | running a plan on a board |
//! | [`scenario`] | fault injection, and its results |
//! | `tracked` | the tracked state of a robot in files, and its history |
//! | [`tension`] | experiments on the tension loop, tuning and calibration of tension |
//! | [`experiment`] | a task from connecting to disarming, and its results |
//! | `chart` | charts for pages, and as files: SVG, PNG, PDF |
//! | `stamp` | date and time for names and records |
//! | `files` | external files: read up to a limit, written completely or not at all |
//! | [`sight`] | tags in the camera's pictures |
//! | [`pick`] | bin picking: look, choose, take, carry, release |
//! | [`study`] | studies in the simulator that the documents quote |
//! | [`doctor`] | checks of all parts, and remedies |
//! | [`mod@bench`] | the self-test of a board without a robot |
//! | [`flash`] | the board's firmware: checked, then written through a debug probe |
//! | [`service`] | work on one unloaded winch |
//! | `units` | numbers with units on the command line |
//! | [`cli`] | the command line |

/// Like the standard library's macro, but a closed terminal does not end the program: the robot may
/// be moving, and must be stopped properly.
macro_rules! eprintln {
    () => {
        $crate::write_stderr(format_args!("\n"))
    };
    ($($what:tt)*) => {
        $crate::write_stderr(format_args!("{}\n", format_args!($($what)*)))
    };
}

/// Like `eprintln`, without the end of the line.
macro_rules! eprint {
    ($($what:tt)*) => {
        $crate::write_stderr(format_args!($($what)*))
    };
}

/// Writes to standard error, if there is one.
fn write_stderr(what: std::fmt::Arguments<'_>) {
    use std::io::Write as _;
    let _ = std::io::stderr().write_fmt(what);
}

pub mod bench;
pub mod calibration;
mod care;
mod chart;
pub mod cli;
pub mod compute;
pub mod control;
pub mod doctor;
pub mod experiment;
mod files;
// Without a probe only the check of a file is used.
#[cfg_attr(not(feature = "flash"), allow(dead_code))]
pub mod flash;
pub mod hil;
pub mod link;
pub mod machine;
pub mod model_file;
pub mod motion;
pub mod pick;
pub mod record;
pub mod recovery;
pub mod replay;
pub mod report;
pub mod reproduce;
pub mod robot;
mod ros;
pub mod run;
pub mod scenario;
pub mod serve;
pub mod service;
pub mod sight;
mod stamp;
pub mod study;
pub mod tension;
mod tracked;
mod units;

pub use mcdpr_core::estimate;
