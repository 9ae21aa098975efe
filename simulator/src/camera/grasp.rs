//! Result of closing the jaws: decided by contact, friction and weight.
//!
//! Two flat pads move towards each other along the tool's y axis. The result is decided from the
//! solids themselves: fingers that come down on something stop there; the first surfaces that the
//! pads touch must belong to one body, face the pads within the friction cone, reach far enough up
//! the pads and lie near the body's centre of mass, and the squeeze must carry its weight.

use super::frame::Frame;
use super::scene::Body;
use super::shape::Span;
use crate::plant::vec3::{V3, axpy, dot, norm, sub};

/// A gripper with two parallel jaws. Its tool frame: origin in the middle between the pads, z up
/// along the fingers, jaws closing along y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gripper {
    /// Distance between the open pads, m.
    pub opening_m: f64,
    /// Half of a pad's width along x, m.
    pub pad_half_width_m: f64,
    /// How far the pads reach below the tool point, m.
    pub below_m: f64,
    /// How far the pads reach above the tool point, m.
    pub above_m: f64,
    /// Thickness of a finger along y, m.
    pub finger_m: f64,
    /// Friction between pad and object.
    pub friction: f64,
    /// Closing force, N.
    pub force_n: f64,
    /// Time to close or open, s.
    pub close_s: f64,
}

impl Default for Gripper {
    fn default() -> Self {
        Self {
            opening_m: 0.06,
            pad_half_width_m: 0.006,
            below_m: 0.005,
            above_m: 0.02,
            finger_m: 0.006,
            friction: 0.5,
            force_n: 15.0,
            close_s: 0.3,
        }
    }
}

/// What the closed jaws hold.
#[derive(Debug, Clone, PartialEq)]
pub enum Grip {
    /// A body, this wide between the pads.
    Held {
        /// Which of the bodies.
        body: usize,
        /// Distance between the pads, m.
        width_m: f64,
        /// By how much the body moved along the jaws when it was centred, m.
        shift_m: f64,
    },
    /// Nothing, with the reason.
    Missed(String),
}

/// Surfaces this far behind the first contact are touched too, m: rubber.
const SOFT_M: f64 = 5e-4;
/// Least height of contact on a pad, m.
const ENGAGED_MIN_M: f64 = 3e-3;
/// Sample points on a pad along x and along z.
const ACROSS: usize = 7;
const UP: usize = 12;
/// Radius of the friction patch against turning, m.
const PATCH_M: f64 = 0.006;
/// Factor on the weight while the robot accelerates.
const SHAKE: f64 = 1.3;

struct Contact {
    way_m: f64,
    normal: V3,
    height: usize,
    point: V3,
    body: usize,
}

impl Gripper {
    /// Closes the jaws at `world_from_tool` among the bodies; those without mass do not move.
    #[must_use]
    pub fn close(&self, bodies: &[Body], world_from_tool: &Frame) -> Grip {
        if let Some(name) = self.fingers_in(bodies, world_from_tool) {
            return Grip::Missed(format!("a finger came down on: {name}"));
        }
        let left = self.contacts(bodies, world_from_tool, 1.0);
        let right = self.contacts(bodies, world_from_tool, -1.0);
        let (Some(first_left), Some(first_right)) = (nearest(&left), nearest(&right)) else {
            return Grip::Missed("nothing between the jaws".to_owned());
        };
        let width_m = self.opening_m - first_left.way_m - first_right.way_m;
        if width_m <= 0.0 {
            return Grip::Missed("nothing between the jaws".to_owned());
        }
        let (left, right) = (touching(&left), touching(&right));
        let body = left[0].body;
        if let Some(other) = left.iter().chain(&right).find(|c| c.body != body) {
            let (one, two) = (&bodies[body].name, &bodies[other.body].name);
            return Grip::Missed(format!("two things between the jaws: {one}, {two}"));
        }
        let held = &bodies[body];
        if held.mass_kg <= 0.0 {
            return Grip::Missed(format!("the jaws closed on: {}", held.name));
        }
        if let Some(reason) = self.slips(held, world_from_tool, &left, &right) {
            return Grip::Missed(format!("{} {reason}", held.name));
        }
        // Both pads go the same way in the end: the body is pushed to the middle.
        let shift_m = 0.5 * (first_left.way_m - first_right.way_m);
        Grip::Held {
            body,
            width_m,
            shift_m,
        }
    }

    /// The first body that an open finger would collide with.
    fn fingers_in(&self, bodies: &[Body], tool: &Frame) -> Option<String> {
        let span = |from: f64, to: f64, count: usize| {
            (0..count).map(move |k| from + (to - from) * k as f64 / (count - 1) as f64)
        };
        let half = self.opening_m / 2.0;
        for side in [-1.0, 1.0] {
            for x in span(-self.pad_half_width_m, self.pad_half_width_m, 5) {
                for y in span(half, half + self.finger_m, 4) {
                    // Fingers are as wide as the pads and reach 30 mm above them.
                    for z in span(-self.below_m, self.above_m + 0.03, 20) {
                        let point = tool.point([x, side * y, z]);
                        if let Some(body) = bodies.iter().find(|body| body.contains(point, 0.0)) {
                            return Some(body.name.clone());
                        }
                    }
                }
            }
        }
        None
    }

    /// The first contact of each sample point of a pad on its way to the other pad. `side` 1 is the
    /// pad at positive y.
    fn contacts(&self, bodies: &[Body], tool: &Frame, side: f64) -> Vec<Contact> {
        let along = tool.direction([0.0, -side, 0.0]);
        let mut contacts = Vec::new();
        for height in 0..UP {
            let z =
                -self.below_m + (self.below_m + self.above_m) * (height as f64 + 0.5) / UP as f64;
            for column in 0..ACROSS {
                let x = self.pad_half_width_m * (2.0 * column as f64 / (ACROSS - 1) as f64 - 1.0);
                let from = tool.point([x, side * self.opening_m / 2.0, z]);
                let mut best: Option<Contact> = None;
                for (index, body) in bodies.iter().enumerate() {
                    let Some((way_m, normal)) = first_surface(body, from, along) else {
                        continue;
                    };
                    let nearer = best.as_ref().is_none_or(|b| way_m < b.way_m);
                    if way_m < self.opening_m && nearer {
                        best = Some(Contact {
                            way_m,
                            normal,
                            height,
                            point: axpy(from, way_m, along),
                            body: index,
                        });
                    }
                }
                contacts.extend(best);
            }
        }
        contacts
    }

    /// Why the body would not stay between the pads.
    fn slips(
        &self,
        body: &Body,
        tool: &Frame,
        left: &[&Contact],
        right: &[&Contact],
    ) -> Option<String> {
        let jaw = tool.direction([0.0, 1.0, 0.0]);
        let rise = (self.below_m + self.above_m) / UP as f64;
        let mut middle = [0.0; 3];
        for (contacts, outward) in [(left, 1.0), (right, -1.0)] {
            let mut heights: Vec<usize> = contacts.iter().map(|c| c.height).collect();
            heights.sort_unstable();
            heights.dedup();
            let engaged_m = heights.len() as f64 * rise;
            if engaged_m < ENGAGED_MIN_M {
                return Some(format!(
                    "slipped: only {:.1} mm of it on a pad",
                    engaged_m * 1e3
                ));
            }
            let share = 1.0 / contacts.len() as f64;
            let normal = contacts
                .iter()
                .fold([0.0; 3], |sum, c| axpy(sum, share, c.normal));
            let facing = outward * dot(normal, jaw) / norm(normal).max(1e-9);
            // The flat pad turns a loose body until an edge of it lies flat; beyond 1.2 of
            // the friction angle it slips out.
            let angle = libm::acos(facing.clamp(-1.0, 1.0));
            let limit = 1.2 * libm::atan(self.friction);
            if angle > limit {
                return Some(format!(
                    "slipped: surfaces at {:.0} deg to the jaws, {:.0} deg hold",
                    angle.to_degrees(),
                    limit.to_degrees()
                ));
            }
            for contact in contacts {
                middle = axpy(middle, 0.5 * share, contact.point);
            }
        }
        // Two pads carry the weight, each with friction times the closing force.
        let weight_n = body.mass_kg * 9.81 * SHAKE;
        let friction_n = 2.0 * self.friction * self.force_n;
        if weight_n > friction_n {
            return Some(format!(
                "is too heavy: {weight_n:.1} N for a grip of {friction_n:.1} N"
            ));
        }
        // Turning about the jaws' axis under the weight beside it.
        let off = sub(body.world_from_body.position_m, middle);
        let sideways = axpy(off, -dot(off, jaw), jaw);
        let lever_m = libm::hypot(sideways[0], sideways[1]);
        let torque_nm = weight_n * lever_m;
        let holds_nm = friction_n * PATCH_M;
        (torque_nm > holds_nm).then(|| {
            format!(
                "turned out of the jaws: held {:.0} mm beside its centre of mass",
                lever_m * 1e3
            )
        })
    }
}

fn first_surface(body: &Body, from: V3, along: V3) -> Option<(f64, V3)> {
    let place = &body.world_from_body;
    let (start, way) = (place.point_inside(from), place.direction_inside(along));
    let mut best: Option<(f64, V3)> = None;
    for part in &body.parts {
        let inner = &part.body_from_part;
        let span = part
            .shape
            .span(inner.point_inside(start), inner.direction_inside(way));
        if let Some(Span { near, normal, .. }) = span
            && near > 0.0
            && best.is_none_or(|(way, _)| near < way)
        {
            best = Some((near, place.direction(inner.direction(normal))));
        }
    }
    best
}

fn nearest(contacts: &[Contact]) -> Option<&Contact> {
    contacts.iter().min_by(|a, b| a.way_m.total_cmp(&b.way_m))
}

fn touching(contacts: &[Contact]) -> Vec<&Contact> {
    let first = nearest(contacts).map_or(0.0, |c| c.way_m);
    contacts
        .iter()
        .filter(|c| c.way_m <= first + SOFT_M)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(half_mm: [f64; 3], place: Frame, mass_kg: f64) -> Body {
        let half_m = half_mm.map(|v| v * 1e-3);
        Body {
            mass_kg,
            ..Body::fixed_box("block", half_m, place, [0.5; 3])
        }
    }

    fn close(bodies: &[Body], tool: Frame) -> Grip {
        Gripper::default().close(bodies, &tool)
    }

    fn reason(grip: Grip) -> String {
        match grip {
            Grip::Missed(reason) => reason,
            Grip::Held { .. } => panic!("held"),
        }
    }

    #[test]
    fn a_block_in_the_middle_is_held_and_centred() {
        let body = block([20.0, 15.0, 12.0], Frame::at([0.0, 0.004, 0.0]), 0.1);
        let Grip::Held {
            width_m, shift_m, ..
        } = close(&[body], Frame::default())
        else {
            panic!("missed");
        };
        assert!((width_m - 0.03).abs() < 1e-9);
        assert!((shift_m - -0.004).abs() < 1e-9 || (shift_m - 0.004).abs() < 1e-9);
    }

    #[test]
    fn wrong_places_fail_for_their_reasons() {
        let at = |x: f64, y: f64, z: f64| Frame::at([x, y, z]);
        let body = |place| block([20.0, 15.0, 12.0], place, 0.1);
        let nothing = reason(close(&[body(at(0.1, 0.0, 0.0))], Frame::default()));
        assert_eq!(nothing, "nothing between the jaws");
        let on = reason(close(&[body(at(0.0, 0.018, 0.0))], Frame::default()));
        assert!(on.contains("a finger came down on"), "{on}");
        let floor = block([200.0, 200.0, 10.0], at(0.0, 0.0, -0.0145), 0.0);
        let deep = reason(close(&[body(at(0.0, 0.0, 0.0)), floor], Frame::default()));
        assert!(deep.contains("a finger came down on"), "{deep}");
        // Only the lowest 2 mm of the pads beside it.
        let low = reason(close(&[body(at(0.0, 0.0, -0.0151))], Frame::default()));
        assert!(low.contains("slipped: only"), "{low}");
        let skew = Frame::from_rpy([0.0; 3], [0.0, 0.0, 0.8]);
        let turned = reason(close(
            &[block([15.0, 15.0, 12.0], skew, 0.1)],
            Frame::default(),
        ));
        assert!(turned.contains("slipped: surfaces at"), "{turned}");
        let heavy = block([20.0, 15.0, 12.0], Frame::default(), 1.5);
        assert!(reason(close(&[heavy], Frame::default())).contains("too heavy"));
        let aside = block([60.0, 15.0, 12.0], at(0.05, 0.0, 0.0), 0.5);
        let aside = reason(close(&[aside], Frame::default()));
        assert!(aside.contains("turned out of the jaws"), "{aside}");
        let two = [
            block([10.0, 6.0, 12.0], at(0.0, -0.007, 0.0), 0.1),
            block([10.0, 6.0, 12.0], at(0.0, 0.007, 0.0), 0.1),
        ];
        assert!(reason(close(&two, Frame::default())).contains("two things"));
        let wide = block([45.0, 45.0, 15.0], Frame::default(), 0.1);
        assert!(reason(close(&[wide], Frame::default())).contains("came down on"));
    }
}
