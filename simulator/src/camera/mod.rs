//! Pictures of cameras on the platform: a ray caster over simple solids, with the faults of real
//! cameras.
//!
//! A [`Scene`] holds bodies made of boxes, cylinders and printed tags. [`render_color`] gives the
//! colour picture (light, shadow, blur, noise), `render_depth` the picture of a stereo depth camera
//! (separate position and lens, disparity noise and steps, shadow where only one of its two imagers
//! sees, drop-outs on shiny parts). All of it is determined by the scene, the cameras' poses and a
//! seed.
//!
//! A [`Cell`] is a [`Tray`] with objects that the gripper of a plant moves: [`Gripper::close`]
//! decides what the jaws hold.
//!
//! SI units. A camera's frame has x to the right, y down, z ahead; pixels are counted from the
//! top left corner, the first pixel's centre at (0.5, 0.5). Nothing here is shared with the crate
//! that reads the pictures.
//!
//! ```
//! use mcdpr_simulator::camera::{Body, Frame, Lens, Optics, Scene, render_color};
//! let mut scene = Scene::default();
//! // A tag on the floor, facing up: its z axis points into it, down.
//! scene.bodies.push(Body::tag(0, 0.1, Frame::looking_down([0.0, 0.0, 0.0])));
//! let lens = Lens { size_px: [160, 120], focal_px: [150.0; 2], center_px: [80.0, 60.0], distortion: [0.0; 5] };
//! let camera = Frame::looking_down([0.0, 0.0, 0.3]);
//! let picture = render_color(&scene, &lens, &camera, &Optics::default(), 1);
//! let grey = |x: usize, y: usize| picture.pixels[y * 160 + x][1];
//! assert!(grey(80 - 24, 60) < 60 && grey(80 - 27, 60) > 150); // black frame, white rim: 50 px wide
//! ```

mod arrange;
mod cell;
mod codes;
mod color;
mod depth;
mod frame;
mod grasp;
mod lens;
mod noise;
mod objects;
mod scene;
mod shape;
mod tracer;

pub use arrange::{Order, Tray};
pub use cell::{Cell, CellEvent, Rgbd};
pub use color::{ColorPicture, Optics, render_color};
pub use depth::{DepthPicture, Stereo};
pub use frame::Frame;
pub use grasp::{Grip, Gripper};
pub use lens::Lens;
pub use objects::{Kind, kinds, too_wide};
pub use scene::{Body, Light, Part, Scene};
pub use shape::{Shape, Surface, TagRows};
