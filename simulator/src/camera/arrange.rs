//! Trays with objects in them, and objects that fall.
//!
//! Objects are lowered onto the surface below (a map of heights, 2 mm cells) and stay if their
//! centre of mass is above their support; otherwise other positions are tried. So piles are at
//! rest, but no object leans.

use super::frame::Frame;
use super::objects::{Kind, kinds};
use super::scene::{Body, Part, Scene};
use super::shape::{Shape, Span, Surface, TagRows};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::f64::consts::{PI, TAU};

/// A tray on a table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tray {
    /// Middle of its floor, world, m.
    pub center_m: [f64; 3],
    /// Half of its inner sides, m.
    pub half_m: [f64; 2],
    /// Height of its walls over the floor, m.
    pub wall_m: f64,
    /// Printed tags that its floor is covered with, and the table around it.
    pub mat: Option<TagRows>,
}

impl Default for Tray {
    /// Below the paper's robot, around its grasp point (252, -39, -517) mm and beside its place of
    /// release.
    fn default() -> Self {
        Self {
            center_m: [0.315, -0.03, -0.545],
            half_m: [0.115, 0.105],
            wall_m: 0.015,
            mat: None,
        }
    }
}

/// How objects lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Apart from each other, so that jaws fit between.
    Separate,
    /// Touching and on top of each other.
    Cluttered,
}

const CELL_M: f64 = 0.002;
const WALL_THICKNESS_M: f64 = 0.004;
/// How far the printed side lies over the floor, m.
const PAPER_M: f64 = 5e-5;
/// Room around an object for a finger and its error, m.
const GAP_M: f64 = 0.012;
/// Distance from the walls, m.
const WALL_GAP_M: f64 = 0.012;
/// Origins of bodies in a pile are at most this high over the floor, m: no towers.
const HIGHEST_M: f64 = 0.055;
const WOOD: [f64; 3] = [0.42, 0.38, 0.33];
const TABLE: [f64; 3] = [0.25, 0.27, 0.3];

impl Tray {
    /// Standing on a plate covered with tags of 16 mm, numbers from 100 on: it extends beyond the
    /// walls, because near them a camera beside the gripper sees over them.
    #[must_use]
    pub const fn with_mat(mut self) -> Self {
        self.mat = Some(TagRows {
            first: 100,
            count: [21, 20],
            size_m: 0.016,
            pitch_m: 0.02,
        });
        self
    }

    /// The sheet with the tags, face up.
    fn sheet(&self, rows: TagRows) -> Body {
        let shape = Shape::Sheet {
            half_m: [0, 1].map(|i| 0.5 * rows.count[i] as f64 * rows.pitch_m),
        };
        let [x, y, z] = self.center_m;
        Body {
            name: "mat".to_owned(),
            parts: vec![Part {
                shape,
                body_from_part: Frame::default(),
                surface: Surface::Tags(rows),
                drop_out: 0.0,
            }],
            world_from_body: Frame::looking_down([x, y, z + PAPER_M]),
            mass_kg: 0.0,
        }
    }

    /// Table, floor, walls and mat. The first body is the table.
    #[must_use]
    pub fn bodies(&self) -> Vec<Body> {
        let [x, y, z] = self.center_m;
        let [hx, hy] = self.half_m;
        let t = WALL_THICKNESS_M;
        // The floor is 1 mm thick: the table's top lies 1 mm under the floor's.
        let table = Frame::at([x, y, z - 0.011]);
        let floor = Frame::at([x, y, z - 0.0005]);
        let mut bodies = vec![
            Body::fixed_box("table", [0.6, 0.6, 0.01], table, TABLE),
            Body::fixed_box("tray", [hx + t, hy + t, 0.0005], floor, WOOD),
        ];
        let middle = z + self.wall_m / 2.0;
        let half = self.wall_m / 2.0;
        let walls = [
            ([x - hx - t / 2.0, y, middle], [t / 2.0, hy + t, half]),
            ([x + hx + t / 2.0, y, middle], [t / 2.0, hy + t, half]),
            ([x, y - hy - t / 2.0, middle], [hx, t / 2.0, half]),
            ([x, y + hy + t / 2.0, middle], [hx, t / 2.0, half]),
        ];
        for (place, half_m) in walls {
            bodies.push(Body::fixed_box("tray wall", half_m, Frame::at(place), WOOD));
        }
        bodies.extend(self.mat.map(|rows| self.sheet(rows)));
        bodies
    }

    /// Whether a point of the world is above the tray's floor.
    #[must_use]
    pub fn holds(&self, point_m: [f64; 3]) -> bool {
        (0..2).all(|i| (point_m[i] - self.center_m[i]).abs() < self.half_m[i])
    }

    /// The tray with `count` objects, the same for the same seed. Fewer if there is no room for
    /// more.
    #[must_use]
    pub fn scene(&self, order: Order, count: usize, seed: u64) -> Scene {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x7472_6179);
        let kinds = kinds();
        let mut scene = Scene {
            bodies: self.bodies(),
            ..Scene::default()
        };
        let fixed = scene.bodies.len();
        // Three draws per object: a full tray ends the search.
        for _ in 0..3 * count {
            if scene.bodies.len() == fixed + count {
                break;
            }
            let kind = &kinds[rng.next_u32() as usize % kinds.len()];
            if let Some(body) = self.place(&scene, fixed, kind, order, &mut rng) {
                scene.bodies.push(body);
            }
        }
        scene
    }

    fn place(
        &self,
        scene: &Scene,
        fixed: usize,
        kind: &Kind,
        order: Order,
        rng: &mut ChaCha8Rng,
    ) -> Option<Body> {
        let mut draw =
            |half: f64| half * (2.0 * f64::from(rng.next_u32()) / f64::from(u32::MAX) - 1.0);
        for _ in 0..400 {
            // Piles grow in the middle.
            let spread = if order == Order::Cluttered { 0.55 } else { 1.0 };
            let x = self.center_m[0] + draw(self.half_m[0] * spread);
            let y = self.center_m[1] + draw(self.half_m[1] * spread);
            let [roll, pitch, _] = pick(&kind.rests_rad, draw(1.0));
            let yaw = draw(PI);
            let mut body = kind.body.clone();
            body.world_from_body = Frame::from_rpy([x, y, 0.0], [roll, pitch, yaw]);
            let gap = if order == Order::Separate { GAP_M } else { 0.0 };
            let Some(rest) = self.lower(&scene.bodies[fixed..], &body, gap) else {
                continue;
            };
            let low_m = rest.height_m - self.center_m[2];
            if low_m > HIGHEST_M || (order == Order::Separate && !rest.on_floor) {
                continue;
            }
            body.world_from_body.position_m[2] = rest.height_m;
            return Some(body);
        }
        None
    }

    /// Resting position of a body that is lowered onto the others; `None` if it would not stay, or
    /// not be in the tray. With `gap_m`, everything within that distance also supports it.
    fn lower(&self, others: &[Body], body: &Body, gap_m: f64) -> Option<RestPose> {
        let cells = columns(body);
        let [x, y, floor] = self.center_m;
        let inside = |point: [f64; 2]| {
            (point[0] - x).abs() < self.half_m[0] - WALL_GAP_M
                && (point[1] - y).abs() < self.half_m[1] - WALL_GAP_M
        };
        if cells.is_empty() || !cells.iter().all(|column| inside(column.place_m)) {
            return None;
        }
        let mut rest = drop_on(others, &cells, floor)?;
        if gap_m > 0.0 && !clear(others, &cells, gap_m) {
            rest.on_floor = false;
        }
        rest.carries(body.world_from_body.position_m)
            .then_some(rest)
    }
}

fn pick(rests: &[[f64; 3]], draw: f64) -> [f64; 3] {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let index = ((draw + 1.0) / 2.0 * rests.len() as f64) as usize;
    rests[index.min(rests.len() - 1)]
}

/// The volume of a body above one cell of the table.
#[derive(Debug, Clone, Copy)]
struct Column {
    place_m: [f64; 2],
    low_m: f64,
}

/// The columns that a body fills, at cells of a common grid.
fn columns(body: &Body) -> Vec<Column> {
    let [x, y, _] = body.world_from_body.position_m;
    let radius = body.radius_m();
    let mut columns = Vec::new();
    let cell = |value: f64| (value / CELL_M).floor();
    let mut row = cell(y - radius);
    while row <= cell(y + radius) {
        let mut column = cell(x - radius);
        while column <= cell(x + radius) {
            let place_m = [(column + 0.5) * CELL_M, (row + 0.5) * CELL_M];
            if let Some((low_m, _)) = heights(body, place_m) {
                columns.push(Column { place_m, low_m });
            }
            column += 1.0;
        }
        row += 1.0;
    }
    columns
}

/// Least and greatest height of a body above a place.
fn heights(body: &Body, [x, y]: [f64; 2]) -> Option<(f64, f64)> {
    // From a metre above the body: higher than any pile.
    let top = body.world_from_body.position_m[2] + 1.0;
    let start = body.world_from_body.point_inside([x, y, top]);
    let down = body.world_from_body.direction_inside([0.0, 0.0, -1.0]);
    let mut found: Option<(f64, f64)> = None;
    for part in &body.parts {
        let place = &part.body_from_part;
        let span = part
            .shape
            .span(place.point_inside(start), place.direction_inside(down));
        let Some(Span { near, far, .. }) = span else {
            continue;
        };
        let (low, high) = (top - far, top - near);
        found = Some(found.map_or((low, high), |(l, h)| (l.min(low), h.max(high))));
    }
    found
}

struct RestPose {
    /// Height of the body's origin, m.
    height_m: f64,
    on_floor: bool,
    /// Points of support.
    contacts_m: Vec<[f64; 2]>,
}

impl RestPose {
    /// Whether the contacts surround a place.
    fn carries(&self, [x, y, _]: [f64; 3]) -> bool {
        // A contact ahead in each of 16 directions: the place is inside their hull.
        (0..16).all(|k| {
            let angle = TAU * f64::from(k) / 16.0;
            let (s, c) = libm::sincos(angle);
            self.contacts_m
                .iter()
                .any(|contact| (contact[0] - x) * c + (contact[1] - y) * s > 0.0)
        })
    }
}

fn top_of(others: &[Body], place_m: [f64; 2], floor_m: f64) -> f64 {
    let reach = |body: &&Body| {
        let [x, y, _] = body.world_from_body.position_m;
        libm::hypot(place_m[0] - x, place_m[1] - y) <= body.radius_m()
    };
    others
        .iter()
        .filter(reach)
        .filter_map(|body| heights(body, place_m))
        .map(|(_, high)| high)
        .fold(floor_m, f64::max)
}

fn drop_on(others: &[Body], cells: &[Column], floor_m: f64) -> Option<RestPose> {
    let tops: Vec<f64> = cells
        .iter()
        .map(|cell| top_of(others, cell.place_m, floor_m))
        .collect();
    let rise = cells
        .iter()
        .zip(&tops)
        .map(|(cell, top)| top - cell.low_m)
        .reduce(f64::max)?;
    let touching = cells.iter().zip(&tops);
    let contacts_m = touching
        .filter(|(cell, top)| cell.low_m + rise - *top < 5e-4)
        .map(|(cell, _)| cell.place_m)
        .collect();
    Some(RestPose {
        height_m: rise,
        on_floor: tops.iter().all(|top| *top <= floor_m),
        contacts_m,
    })
}

/// Whether no other body comes nearer than `gap_m` to the columns, seen from above.
fn clear(others: &[Body], cells: &[Column], gap_m: f64) -> bool {
    let near: Vec<Vec<Column>> = others.iter().map(columns).collect();
    !cells.iter().any(|cell| {
        near.iter().flatten().any(|other| {
            let [x, y] = cell.place_m;
            libm::hypot(other.place_m[0] - x, other.place_m[1] - y) < gap_m
        })
    })
}

/// Lets a body fall straight down onto the others and the floor at `floor_m`; it keeps its attitude
/// and stops at the first contact.
pub(super) fn fall(others: &[Body], body: &mut Body, floor_m: f64) {
    if let Some(rest) = drop_on(others, &columns(body), floor_m) {
        body.world_from_body.position_m[2] += rest.height_m;
    }
}

/// Whether `upper` lies on `lower`: straight above part of it, closer than a millimetre.
pub(super) fn lies_on(upper: &Body, lower: &Body) -> bool {
    columns(upper).iter().any(|cell| {
        heights(lower, cell.place_m).is_some_and(|(_, high)| (cell.low_m - high).abs() < 1e-3)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn separate_objects_lie_on_the_floor_and_apart() {
        let tray = Tray::default();
        let fixed = tray.bodies().len();
        for seed in 0..5 {
            let scene = tray.scene(Order::Separate, 7, seed);
            let objects = &scene.bodies[fixed..];
            assert!(objects.len() >= 5, "seed {seed}: {}", objects.len());
            for (i, body) in objects.iter().enumerate() {
                let low = columns(body).iter().map(|c| c.low_m).fold(1.0, f64::min);
                assert!((low - tray.center_m[2]).abs() < 1e-4, "{} {low}", body.name);
                let others: Vec<Body> = objects[i + 1..].to_vec();
                assert!(clear(&others, &columns(body), 0.01));
            }
        }
        assert_eq!(
            tray.scene(Order::Separate, 7, 3),
            tray.scene(Order::Separate, 7, 3)
        );
    }

    #[test]
    fn cluttered_objects_touch_or_overlap_and_none_cuts_another() {
        let tray = Tray::default();
        let fixed = tray.bodies().len();
        let mut stacked = 0;
        for seed in 0..5 {
            let scene = tray.scene(Order::Cluttered, 8, seed);
            let objects = &scene.bodies[fixed..];
            for (i, body) in objects.iter().enumerate() {
                let low = columns(body).iter().map(|c| c.low_m).fold(1.0, f64::min);
                stacked += usize::from(low > tray.center_m[2] + 1e-3);
                for other in &objects[i + 1..] {
                    // A later body lies above an earlier one wherever they overlap.
                    for cell in columns(other) {
                        if let Some((_, high)) = heights(body, cell.place_m) {
                            assert!(cell.low_m >= high - 1e-6);
                        }
                    }
                }
            }
        }
        assert!(stacked >= 5, "{stacked}");
    }

    #[test]
    fn a_body_falls_onto_what_is_below() {
        let floor = Frame::at([0.0, 0.0, 0.01]);
        let below = Body::fixed_box("below", [0.02, 0.02, 0.01], floor, [0.5; 3]);
        let high = Frame::at([0.01, 0.0, 0.5]);
        let mut body = Body::fixed_box("body", [0.01, 0.01, 0.01], high, [0.5; 3]);
        fall(std::slice::from_ref(&below), &mut body, 0.0);
        assert!((body.world_from_body.position_m[2] - 0.03).abs() < 1e-9);
        assert!(lies_on(&body, &below));
        fall(&[], &mut body, 0.0);
        assert!((body.world_from_body.position_m[2] - 0.01).abs() < 1e-9);
    }
}
