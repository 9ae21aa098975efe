//! Tags with their poses and objects with their grasps, from pictures.
//!
//! The crate does not depend on a robot or a network link. Lengths are metres, angles radians,
//! pixels are counted from the top left corner of the picture, so that the first pixel's centre
//! lies at (0.5, 0.5). A camera's frame has x to the right, y down and z ahead.

pub mod align;
mod camera;
mod frame;
pub mod grasp;
pub mod image;
mod input;
pub mod live;
#[cfg(feature = "realsense")]
pub mod realsense;
pub mod recorded;
mod source;
pub mod tag;
#[cfg(all(feature = "v4l2", target_os = "linux"))]
pub mod v4l2;

pub use align::{Aligned, align};
pub use camera::{Camera, Projection};
pub use frame::{Cameras, Frame, FrameError};
pub use image::{DepthImage, GrayImage, Image, RgbImage};
pub use source::{Source, SourceError};
