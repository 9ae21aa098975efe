//! The control core against references, bounds and a small simulated plant, without hardware.
//!
//! References are in floating point and written here from the equations, not from the core.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::float_arithmetic,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    clippy::needless_range_loop,
    clippy::type_complexity,
    missing_docs
)]

mod arming;
mod brakes;
mod config;
mod encoder;
mod energy;
mod fault_line;
mod link_loss;
mod motion;
mod reports;
mod requests;
mod segment;
mod server;
mod speed_output;
mod stops;
mod support;
mod tension;
mod units;
mod watch;
mod watch_motion;
