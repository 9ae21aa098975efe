//! What there is to be seen.

use super::frame::Frame;
use super::shape::{Shape, Surface};
use crate::plant::vec3::{V3, add, axpy, dot, norm, scale, sub};

/// A piece of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Its form.
    pub shape: Shape,
    /// Its place in the body.
    pub body_from_part: Frame,
    /// How it looks.
    pub surface: Surface,
    /// Share of its surface on which a stereo depth camera finds nothing: shine.
    pub drop_out: f64,
}

/// A rigid body of parts.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    /// What it is, for reports.
    pub name: String,
    /// Its parts.
    pub parts: Vec<Part>,
    /// Its place.
    pub world_from_body: Frame,
    /// Mass, kg; 0 for what stands fast.
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
pub struct Hit {
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
    /// A body of one box that stands fast.
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

    /// A board of printed tags: number, edge (m) and place on the board of each.
    #[must_use]
    pub fn tags(tags: &[(usize, f64, Frame)], world_from_board: Frame) -> Self {
        let part = |&(id, size_m, body_from_part): &(usize, f64, Frame)| Part {
            shape: Shape::Sheet {
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

/// A scene prepared for many rays.
pub(crate) struct Tracer<'a> {
    scene: &'a Scene,
    /// Sphere around each body, and the places of its parts.
    bodies: Vec<(V3, f64, Vec<Frame>)>,
    lamp: V3,
}

impl<'a> Tracer<'a> {
    pub(crate) fn new(scene: &'a Scene) -> Self {
        let prepare = |body: &Body| {
            let places = body.parts.iter();
            (
                body.world_from_body.position_m,
                body.radius_m(),
                places
                    .map(|part| body.world_from_body.then(&part.body_from_part))
                    .collect(),
            )
        };
        let towards = scene.light.towards;
        Self {
            scene,
            bodies: scene.bodies.iter().map(prepare).collect(),
            lamp: scale(towards, 1.0 / norm(towards).max(1e-12)),
        }
    }

    pub(crate) const fn scene(&self) -> &Scene {
        self.scene
    }

    /// The first thing on the ray, further than `least` along it.
    pub(crate) fn cast(&self, from: V3, along: V3, least: f64) -> Option<Hit> {
        let length2 = dot(along, along);
        let mut best: Option<Hit> = None;
        for (index, (center, radius, places)) in self.bodies.iter().enumerate() {
            let to = sub(*center, from);
            let middle = dot(to, along) / length2;
            if dot(to, to) - middle * middle * length2 > radius * radius {
                continue;
            }
            let parts = places.iter().zip(&self.scene.bodies[index].parts);
            for (number, (place, part)) in parts.enumerate() {
                let (start, way) = (place.point_inside(from), place.direction_inside(along));
                let Some((near, _, normal)) = part.shape.span(start, way) else {
                    continue;
                };
                if near <= least || best.is_some_and(|hit| hit.way <= near) {
                    continue;
                }
                best = Some(Hit {
                    way: near,
                    body: index,
                    part: number,
                    normal: place.direction(normal),
                    point_in_part_m: axpy(start, near, way),
                });
            }
        }
        best
    }

    /// Whether anything lies on the ray between `least` and `most`.
    pub(crate) fn blocked(&self, from: V3, along: V3, least: f64, most: f64) -> bool {
        self.cast(from, along, least)
            .is_some_and(|hit| hit.way < most)
    }

    /// Light from a hit towards the eye: red, green, blue in grey values; and whether the lamp
    /// reaches it.
    pub(crate) fn shade(&self, from: V3, along: V3, hit: &Hit) -> ([f64; 3], bool) {
        let facing = dot(hit.normal, self.lamp).max(0.0);
        let point = add(from, scale(along, hit.way));
        let lit = facing > 0.0 && !self.blocked(point, self.lamp, 1e-6, f64::INFINITY);
        (self.thrown_back(hit, lit), lit)
    }

    fn thrown_back(&self, hit: &Hit, lit: bool) -> [f64; 3] {
        let part = &self.scene.bodies[hit.body].parts[hit.part];
        let light = &self.scene.light;
        let facing = dot(hit.normal, self.lamp).max(0.0);
        let brightness = light.around + if lit { light.lamp * facing } else { 0.0 };
        let color = part.surface.color(hit.point_in_part_m);
        color.map(|share| share * brightness)
    }

    /// The mean of what [`Tracer::cast`] and [`Tracer::shade`] give for rays that are known to meet
    /// this part of this body first, lit or not: print needs many rays and has nothing in front.
    pub(crate) fn shade_on(
        &self,
        from: V3,
        rays: impl Iterator<Item = V3>,
        (body, part, lit): (usize, usize, bool),
    ) -> [f64; 3] {
        let place = &self.bodies[body].2[part];
        let shape = &self.scene.bodies[body].parts[part].shape;
        let start = place.point_inside(from);
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        for along in rays {
            let way = place.direction_inside(along);
            let Some((near, _, normal)) = shape.span(start, way) else {
                continue;
            };
            let hit = Hit {
                way: near,
                body,
                part,
                normal: place.direction(normal),
                point_in_part_m: axpy(start, near, way),
            };
            sum = add(sum, self.thrown_back(&hit, lit));
            count += 1.0;
        }
        scale(sum, 1.0 / f64::max(count, 1.0))
    }

    /// Whether a part is a sheet of many tags.
    pub(crate) fn is_rows(&self, (body, part, _): (usize, usize, bool)) -> bool {
        let surface = &self.scene.bodies[body].parts[part].surface;
        matches!(surface, super::shape::Surface::Tags(_))
    }
}
