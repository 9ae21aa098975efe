//! The visible scene.

use super::frame::Frame;
use super::shape::{Shape, Surface};
use crate::plant::vec3::norm;

/// A piece of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Its shape.
    pub shape: Shape,
    /// Its pose in the body.
    pub body_from_part: Frame,
    /// Its appearance.
    pub surface: Surface,
    /// Share of its surface on which a stereo depth camera measures nothing, because it is shiny.
    pub drop_out: f64,
}

/// A rigid body of parts.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    /// Its name, for reports.
    pub name: String,
    /// Its parts.
    pub parts: Vec<Part>,
    /// Its pose.
    pub world_from_body: Frame,
    /// Mass, kg; 0 if it does not move.
    pub mass_kg: f64,
}

/// The light: one lamp far away, and light from all around.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Towards the lamp, world.
    pub towards: [f64; 3],
    /// Grey values that the lamp adds to a white surface that faces it.
    pub lamp: f64,
    /// Grey values from all around on a white surface.
    pub around: f64,
}

impl Default for Light {
    fn default() -> Self {
        Self {
            towards: [0.25, -0.35, 0.9],
            // A white surface that faces the lamp has 150 + 90 = 240 of 255 grey values: not
            // saturated.
            lamp: 150.0,
            around: 90.0,
        }
    }
}

/// Bodies and light.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Scene {
    /// The bodies.
    pub bodies: Vec<Body>,
    /// The light.
    pub light: Light,
}

/// Where a ray meets the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Hit {
    /// Along the ray, in lengths of its direction.
    pub way: f64,
    /// Which body.
    pub body: usize,
    /// Which part of it.
    pub part: usize,
    /// Outward normal, world.
    pub normal: [f64; 3],
    /// The point in the part's frame, m.
    pub point_in_part_m: [f64; 3],
}

impl Part {
    /// A plain part.
    #[must_use]
    pub const fn plain(shape: Shape, body_from_part: Frame, color: [f64; 3]) -> Self {
        Self {
            shape,
            body_from_part,
            surface: Surface::Plain(color),
            drop_out: 0.0,
        }
    }
}

impl Body {
    /// A body of one box that does not move.
    #[must_use]
    pub fn fixed_box(name: &str, half_m: [f64; 3], place: Frame, color: [f64; 3]) -> Self {
        Self {
            name: name.to_owned(),
            parts: vec![Part::plain(Shape::Box { half_m }, Frame::default(), color)],
            world_from_body: place,
            mass_kg: 0.0,
        }
    }

    /// A printed tag with its white rim of an eighth all around. `world_from_tag` has x to the
    /// right and y down as one looks at it, z into the tag.
    #[must_use]
    pub fn tag(id: usize, size_m: f64, world_from_tag: Frame) -> Self {
        Self::tags(&[(id, size_m, Frame::default())], world_from_tag)
    }

    /// A board of printed tags: number, edge (m) and position on the board of each.
    #[must_use]
    pub fn tags(tags: &[(usize, f64, Frame)], world_from_board: Frame) -> Self {
        let part = |&(id, size_m, body_from_part): &(usize, f64, Frame)| Part {
            shape: Shape::Sheet {
                // Half of the edge, and an eighth of it for the rim: 1/2 + 1/8.
                half_m: [size_m * 0.625; 2],
            },
            body_from_part,
            surface: Surface::Tag { id, size_m },
            drop_out: 0.0,
        };
        Self {
            name: "tag".to_owned(),
            parts: tags.iter().map(part).collect(),
            world_from_body: world_from_board,
            mass_kg: 0.0,
        }
    }

    /// Radius of the sphere around the body's origin that holds it, m.
    #[must_use]
    pub fn radius_m(&self) -> f64 {
        // An upper bound: the distance of the part's centre, and the part's own radius.
        let reach = |part: &Part| norm(part.body_from_part.position_m) + part.shape.radius_m();
        self.parts.iter().map(reach).fold(0.0, f64::max)
    }

    /// Whether a point of the world lies in the body or closer to it than `margin_m`.
    #[must_use]
    pub fn contains(&self, point_m: [f64; 3], margin_m: f64) -> bool {
        let point = self.world_from_body.point_inside(point_m);
        self.parts.iter().any(|part| {
            let inside = part.body_from_part.point_inside(point);
            part.shape.contains(inside, margin_m)
        })
    }
}
