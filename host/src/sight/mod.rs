//! Tags in pictures of a camera, and in those of the simulated robot's.

mod camera;
mod pictures;
mod scene;
mod simulated;

pub use camera::{Camera, CameraTags};
pub use mcdpr_core::sight::*;
pub use pictures::{PictureTags, SceneCamera};
pub use scene::Scene;
pub use simulated::SimulatedTags;
