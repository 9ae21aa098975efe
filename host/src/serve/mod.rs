//! The live page: one embedded page on loopback, fed over a WebSocket, with buttons that give
//! orders to whoever moves the robot.
//!
//! | module | what it is for |
//! |---|---|
//! | [`feed`] | what viewers are shown, gathered from the line on a thread of its own |
//! | [`server`] | the listener: the page, and a WebSocket for each viewer |
//! | `orders` | who may give orders: those with the token, one page at a time |
//!
//! Viewers cannot slow the robot: they read a snapshot. Orders need the token that the program
//! prints; without it a viewer only looks. Of those that have it one page has the controls, until it
//! is closed; the others look on, and may stop and hold. Pages of other sites cannot connect: the host and
//! origin that a browser names must be this server's.

mod camera;
pub mod feed;
mod http;
mod orders;
pub mod server;

pub use camera::CameraWatcher;
pub use feed::{Feed, FeedWatcher, Picture};
pub use server::{Desk, ServeError, Server};

/// The page, whole: no other file and no network is needed.
#[must_use]
pub fn page() -> String {
    include_str!("page.html")
        .replace("/*STYLE*/", include_str!("page.css"))
        .replace("/*SCENE*/", include_str!("scene.js"))
        .replace("/*SCRIPT*/", include_str!("page.js"))
}
