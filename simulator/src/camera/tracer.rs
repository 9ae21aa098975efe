//! Rays through a scene: their first hit, and the light that returns.
//!
//! Most rays pass far from most parts. Each part therefore has outlines that are checked before the
//! intersection is computed: as seen from the eye, as seen from the lamp, and its box in the world.
//! They are never smaller than the part, so that the picture is the same as without them, bit by
//! bit.

use super::frame::Frame;
use super::scene::{Hit, Scene};
use super::shape::{Shape, Span, Surface};
use crate::plant::vec3::{V3, add, axpy, cross, dot, norm, scale};

/// A scene prepared for many rays from one eye.
pub(crate) struct Tracer<'a> {
    scene: &'a Scene,
    eye: Frame,
    parts: Vec<Prepared>,
    /// Number of each body's first part among all parts.
    first: Vec<usize>,
    /// Towards the lamp, and two directions across it.
    lamp: V3,
    across: [V3; 2],
}

/// A part and its bounds.
struct Prepared {
    /// As the eye sees it: x/z and y/z in the eye's frame.
    seen: Outline,
    /// As the lamp sees it, m.
    lit: Outline,
    /// The box around it, world, m.
    low_m: V3,
    high_m: V3,
    place: Frame,
    shape: Shape,
    /// The eye in the part's frame, m.
    eye_m: V3,
    body: usize,
    number: usize,
}

/// A rectangle.
#[derive(Clone, Copy)]
struct Outline {
    low: [f64; 2],
    high: [f64; 2],
}

/// Outlines are wider than their parts by this, m and without unit: more than rounding.
const WIDER: f64 = 1e-9;
/// A part that comes closer to the eye's plane than this has no outline, m.
const BEHIND_M: f64 = 1e-6;

impl Outline {
    const EVERYTHING: Self = Self {
        low: [f64::NEG_INFINITY; 2],
        high: [f64::INFINITY; 2],
    };

    fn around(points: impl Iterator<Item = [f64; 2]>) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in points {
            for i in 0..2 {
                low[i] = low[i].min(point[i] - WIDER);
                high[i] = high[i].max(point[i] + WIDER);
            }
        }
        Self { low, high }
    }

    fn holds(&self, x: f64, y: f64) -> bool {
        x >= self.low[0] && x <= self.high[0] && y >= self.low[1] && y <= self.high[1]
    }
}

/// The part that a pixel shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Seen {
    /// Index of its body.
    pub(crate) body: usize,
    /// Index within the body.
    pub(crate) part: usize,
    /// Whether the lamp reaches it.
    pub(crate) lit: bool,
}

impl Prepared {
    fn new(
        (body, number): (usize, usize),
        place: Frame,
        shape: Shape,
        eye: &Frame,
        across: &[V3; 2],
    ) -> Self {
        let half = shape.half_box_m();
        let corner = |k: usize| {
            let side = |i: usize| if k >> i & 1 == 1 { half[i] } else { -half[i] };
            place.point([side(0), side(1), side(2)])
        };
        let corners: [V3; 8] = std::array::from_fn(corner);
        let from_eye = corners.map(|corner| eye.point_inside(corner));
        let seen = if from_eye.iter().any(|point| point[2] < BEHIND_M) {
            Outline::EVERYTHING
        } else {
            Outline::around(from_eye.iter().map(|[x, y, z]| [x / z, y / z]))
        };
        let lit = Outline::around(
            corners
                .iter()
                .map(|corner| across.map(|side| dot(side, *corner))),
        );
        let extreme = |of: fn(f64, f64) -> f64, wider: f64| {
            [0, 1, 2].map(|i| corners.iter().map(|c| c[i]).reduce(of).unwrap_or(0.0) + wider)
        };
        Self {
            seen,
            lit,
            low_m: extreme(f64::min, -WIDER),
            high_m: extreme(f64::max, WIDER),
            place,
            shape,
            eye_m: place.point_inside(eye.position_m),
            body,
            number,
        }
    }

    /// Whether the box around it is in the way from a point on.
    fn ahead(&self, from: V3, along: V3) -> bool {
        (0..3).all(|i| {
            !(along[i] >= 0.0 && from[i] > self.high_m[i]
                || along[i] <= 0.0 && from[i] < self.low_m[i])
        })
    }

    /// Whether the box around it reaches between two points.
    fn between(&self, one: V3, other: V3) -> bool {
        (0..3).all(|i| {
            one[i].min(other[i]) <= self.high_m[i] && one[i].max(other[i]) >= self.low_m[i]
        })
    }

    /// Whether the ray enters it between `least` and `most`.
    fn entered(&self, from: V3, along: V3, least: f64, most: f64) -> bool {
        let start = self.place.point_inside(from);
        let way = self.place.direction_inside(along);
        let span = self.shape.span(start, way);
        span.is_some_and(|span| span.near > least && span.near < most)
    }
}

impl<'a> Tracer<'a> {
    /// For rays that start where `world_from_eye` is.
    pub(crate) fn new(scene: &'a Scene, world_from_eye: &Frame) -> Self {
        let towards = scene.light.towards;
        let lamp = scale(towards, 1.0 / norm(towards).max(1e-12));
        let across = across(lamp);
        let (mut parts, mut first) = (Vec::new(), Vec::new());
        for (index, body) in scene.bodies.iter().enumerate() {
            first.push(parts.len());
            for (number, part) in body.parts.iter().enumerate() {
                let place = body.world_from_body.then(&part.body_from_part);
                let which = (index, number);
                parts.push(Prepared::new(
                    which,
                    place,
                    part.shape,
                    world_from_eye,
                    &across,
                ));
            }
        }
        Self {
            scene,
            eye: *world_from_eye,
            parts,
            first,
            lamp,
            across,
        }
    }

    pub(crate) const fn scene(&self) -> &Scene {
        self.scene
    }

    /// The first thing on a ray from the eye, whose direction in the eye's frame has z = 1.
    pub(crate) fn cast(&self, ray: V3) -> Option<Hit> {
        let along = self.eye.direction(ray);
        let mut best: Option<Hit> = None;
        for part in &self.parts {
            if !part.seen.holds(ray[0], ray[1]) {
                continue;
            }
            let way = part.place.direction_inside(along);
            let Some(Span { near, normal, .. }) = part.shape.span(part.eye_m, way) else {
                continue;
            };
            if near <= 0.0 || best.is_some_and(|hit| hit.way <= near) {
                continue;
            }
            best = Some(Hit {
                way: near,
                body: part.body,
                part: part.number,
                normal: part.place.direction(normal),
                point_in_part_m: axpy(part.eye_m, near, way),
            });
        }
        best
    }

    /// Whether anything lies on a ray (of length 1) between `least` and `most`, m.
    pub(crate) fn blocked(&self, from: V3, along: V3, least: f64, most: f64) -> bool {
        let to = axpy(from, most, along);
        let mut parts = self.parts.iter();
        parts.any(|part| part.between(from, to) && part.entered(from, along, least, most))
    }

    /// Whether nothing lies between a point and the lamp.
    fn reached(&self, point: V3) -> bool {
        let [x, y] = self.across.map(|side| dot(side, point));
        !self.parts.iter().any(|part| {
            part.lit.holds(x, y)
                && part.ahead(point, self.lamp)
                // 1e-6 m: a point must not shade itself.
                && part.entered(point, self.lamp, 1e-6, f64::INFINITY)
        })
    }

    /// Light from a hit towards the eye: red, green, blue in grey values; and whether the lamp
    /// reaches it.
    pub(crate) fn shade(&self, ray: V3, hit: &Hit) -> ([f64; 3], bool) {
        let facing = dot(hit.normal, self.lamp).max(0.0);
        let along = self.eye.direction(ray);
        let point = add(self.eye.position_m, scale(along, hit.way));
        let lit = facing > 0.0 && self.reached(point);
        (self.thrown_back(hit, lit), lit)
    }

    fn thrown_back(&self, hit: &Hit, lit: bool) -> [f64; 3] {
        let part = &self.scene.bodies[hit.body].parts[hit.part];
        let light = &self.scene.light;
        let facing = dot(hit.normal, self.lamp).max(0.0);
        // Lambert: a matt surface looks equally bright from every side.
        let brightness = light.around + if lit { light.lamp * facing } else { 0.0 };
        let color = part.surface.color(hit.point_in_part_m);
        color.map(|share| share * brightness)
    }

    /// The mean of the results of [`Tracer::cast`] and [`Tracer::shade`] for rays that are known to
    /// hit this part of this body first, lit or not: print needs many rays and has nothing in
    /// front.
    pub(crate) fn shade_on(&self, rays: impl Iterator<Item = V3>, seen: Seen) -> [f64; 3] {
        let Seen {
            body,
            part: number,
            lit,
        } = seen;
        let part = &self.parts[self.first[body] + number];
        let (place, shape, start) = (&part.place, &part.shape, part.eye_m);
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        for along in rays {
            let way = place.direction_inside(along);
            let Some(Span { near, normal, .. }) = shape.span(start, way) else {
                continue;
            };
            let hit = Hit {
                way: near,
                body,
                part: number,
                normal: place.direction(normal),
                point_in_part_m: axpy(start, near, way),
            };
            sum = add(sum, self.thrown_back(&hit, lit));
            count += 1.0;
        }
        scale(sum, 1.0 / f64::max(count, 1.0))
    }

    /// Whether a part is a sheet of many tags.
    pub(crate) fn is_rows(&self, seen: Seen) -> bool {
        let surface = &self.scene.bodies[seen.body].parts[seen.part].surface;
        matches!(surface, Surface::Tags(_))
    }
}

/// Two directions across a third, and across each other.
fn across(axis: V3) -> [V3; 2] {
    // Away from the axis's greatest coordinate, so that the product is not short.
    let least = (0..3).min_by(|a, b| axis[*a].abs().total_cmp(&axis[*b].abs()));
    let mut other = [0.0; 3];
    other[least.unwrap_or(0)] = 1.0;
    let one = cross(axis, other);
    let one = scale(one, 1.0 / norm(one).max(1e-12));
    [one, cross(axis, one)]
}

#[cfg(test)]
mod tests {
    use super::super::{Order, Tray};
    use super::*;

    /// The same without any outline.
    fn plain<'a>(scene: &'a Scene, eye: &Frame) -> Tracer<'a> {
        let mut tracer = Tracer::new(scene, eye);
        for part in &mut tracer.parts {
            (part.seen, part.lit) = (Outline::EVERYTHING, Outline::EVERYTHING);
            part.low_m = [f64::NEG_INFINITY; 3];
            part.high_m = [f64::INFINITY; 3];
        }
        tracer
    }

    #[test]
    fn outlines_leave_nothing_out() {
        let tray = Tray::default().with_mat();
        let [x, y, z] = tray.center_m;
        // From above; aslant; and from among the objects, so that some lie behind the eye.
        let eyes = [
            Frame::from_rpy([x, y, z + 0.4], [3.0, 0.1, 0.4]),
            Frame::from_rpy([x - 0.4, y, z + 0.3], [2.6, -0.7, 0.0]),
            Frame::from_rpy([x, y, z + 0.02], [1.5, 0.0, 0.3]),
        ];
        let (mut hits, mut dark, mut hidden) = (0, 0, 0);
        for (seed, order) in [(1, Order::Separate), (2, Order::Cluttered)] {
            let scene = tray.scene(order, 8, seed);
            for eye in &eyes {
                let (quick, sure) = (Tracer::new(&scene, eye), plain(&scene, eye));
                let second = eye.point([0.055, 0.0, 0.0]);
                for i in 0..160 {
                    for j in 0..120 {
                        let ray = [f64::from(i - 80) / 90.0, f64::from(j - 60) / 90.0, 1.0];
                        let hit = sure.cast(ray);
                        assert_eq!(quick.cast(ray), hit);
                        let Some(hit) = hit else { continue };
                        let lit = sure.shade(ray, &hit);
                        assert_eq!(quick.shade(ray, &hit), lit);
                        let point = axpy(eye.position_m, hit.way, eye.direction(ray));
                        let start = axpy(point, 1e-6, hit.normal);
                        let to = axpy(second, -1.0, point);
                        let (length, along) = (norm(to), scale(to, 1.0 / norm(to)));
                        let blocked = sure.blocked(start, along, 1e-6, length);
                        assert_eq!(quick.blocked(start, along, 1e-6, length), blocked);
                        hits += 1;
                        dark += usize::from(!lit.1);
                        hidden += usize::from(blocked);
                    }
                }
            }
        }
        assert!(
            hits > 10_000 && dark > 1000 && hidden > 200,
            "{hits} {dark} {hidden}"
        );
    }
}
