//! The live page: one embedded page on loopback, fed over a WebSocket, with buttons that give
//! orders to the thread that moves the robot.
//!
//! | module | what it is for |
//! |---|---|
//! | [`feed`] | data for viewers, collected from the line on a separate thread |
//! | [`server`] | the listener: the page, and a WebSocket for each viewer |
//! | `notices` | what other parts of the program tell viewers: steps of set-up, picking, output |
//! | `orders` | permission to give orders: with the token, one page at a time |
//!
//! Viewers cannot slow the robot: they read a snapshot. Orders need the token that the program
//! prints; without it a viewer is read-only. Of the pages with the token one has the controls,
//! until it is closed; the others are read-only, except that they may stop and hold. Pages of other
//! sites cannot connect: the host and origin that a browser sends must be this server's.

mod camera;
pub mod feed;
mod http;
pub(crate) mod notices;
mod orders;
pub mod server;

pub use camera::CameraWatcher;
pub use feed::{Feed, FeedWatcher, Picture};
pub use server::{Desk, ServeError, Server};

/// The complete page: no other file and no network is needed.
#[must_use]
pub fn page() -> String {
    include_str!("page.html")
        .replace(
            "/*STYLE*/",
            concat!(include_str!("page.css"), include_str!("setup.css")),
        )
        .replace("/*SCENE*/", include_str!("scene.js"))
        .replace("/*SCRIPT*/", include_str!("page.js"))
        .replace("/*WORK*/", include_str!("work.js"))
        .replace("/*RUNS*/", include_str!("runs.js"))
        .replace("/*ROBOT*/", include_str!("robot.js"))
        .replace("/*SETUP*/", include_str!("setup.js"))
        .replace("/*PICK*/", include_str!("pick.js"))
}
