//! From pictures to what a robot needs of them: tags with their poses, objects with their grasps.
//!
//! The crate knows no robot and no network link. Lengths are metres, angles radians, pixels are
//! counted from the top left corner of the picture, so that the first pixel's centre lies at
//! (0.5, 0.5). A camera's frame has x to the right, y down and z ahead.

pub mod camera;
pub mod image;
pub mod tag;

pub use camera::Camera;
pub use image::{DepthImage, GrayImage, Image, RgbImage};
