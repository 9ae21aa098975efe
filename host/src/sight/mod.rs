//! Tags in pictures of a real camera, and of the simulated robot's.

mod camera;
mod pictures;
mod scene;
mod simulated;
mod tilt;

pub use camera::Camera;
pub(crate) use camera::CameraTags;
pub use mcdpr_core::sight::*;
pub use pictures::SceneCamera;
pub use scene::Scene;
pub use simulated::SimulatedTags;
pub(crate) use tilt::SerialTilt;
pub use tilt::{SimulatedTilt, TiltSource, WithTilt};
