//! The live page: one embedded page on loopback, fed over a WebSocket, with buttons that give
//! orders to the thread that moves the robot. The page itself and its data are those of [`mcdpr_twin`].
//!
//! | module | what it is for |
//! |---|---|
//! | [`server`] | the listener: the page, and a WebSocket for each viewer |
//! | `orders` | permission to give orders: with the token, one page at a time |
//!
//! Viewers cannot slow the robot: they read a snapshot. Orders need the token that the program
//! prints; without it a viewer is read-only. Of the pages with the token one has the controls,
//! until it is closed; the others are read-only, except that they may stop and hold. Pages of other
//! sites cannot connect: the host and origin that a browser sends must be this server's.

mod camera;
mod http;
mod orders;
pub mod server;

pub use camera::CameraWatcher;
pub use mcdpr_twin::feed::{self, Feed, FeedWatcher, Picture};
pub use mcdpr_twin::page;
pub use server::{Desk, ServeError, Server};

use std::sync::OnceLock;
use std::time::Instant;

/// Time since the first call, s: the clock of a [`Feed`] here.
fn clock_s() -> f64 {
    static BEGAN: OnceLock<Instant> = OnceLock::new();
    BEGAN.get_or_init(Instant::now).elapsed().as_secs_f64()
}

/// An empty feed with this computer's clock.
#[must_use]
pub fn feed() -> Feed {
    Feed::new(clock_s)
}
