//! Objects to pick: the kinds of the paper (screwdriver, printed brackets, machined parts, screws)
//! and groceries similar to the YCB set, as boxes and cylinders. Sizes are chosen for jaws of 60
//! mm; they do not model particular products.

use super::frame::Frame;
use super::scene::{Body, Part};
use super::shape::Shape;
use std::f64::consts::FRAC_PI_2;

/// A kind of object.
#[derive(Debug, Clone, PartialEq)]
pub struct Kind {
    /// A body of this kind at the origin, z up.
    pub body: Body,
    /// Attitudes (roll, pitch, yaw) in which it rests on a table.
    pub rests_rad: Vec<[f64; 3]>,
}

const ORANGE: [f64; 3] = [0.9, 0.45, 0.1];
const STEEL: [f64; 3] = [0.55, 0.56, 0.6];
const BLUE: [f64; 3] = [0.15, 0.3, 0.75];
const ALUMINIUM: [f64; 3] = [0.75, 0.76, 0.78];
const RED: [f64; 3] = [0.75, 0.12, 0.12];
const YELLOW: [f64; 3] = [0.85, 0.75, 0.2];
const GREEN: [f64; 3] = [0.2, 0.6, 0.25];

fn block(sides_mm: [f64; 3], at_mm: [f64; 3], color: [f64; 3], drop_out: f64) -> Part {
    Part {
        drop_out,
        ..Part::plain(
            Shape::Box {
                half_m: sides_mm.map(|side| side * 0.5e-3),
            },
            Frame::at(at_mm.map(|value| value * 1e-3)),
            color,
        )
    }
}

/// A cylinder along z.
fn upright(
    radius_mm: f64,
    height_mm: f64,
    at_mm: [f64; 3],
    color: [f64; 3],
    drop_out: f64,
) -> Part {
    Part {
        drop_out,
        ..Part::plain(
            Shape::Cylinder {
                radius_m: radius_mm * 1e-3,
                half_m: height_mm * 0.5e-3,
            },
            Frame::at(at_mm.map(|value| value * 1e-3)),
            color,
        )
    }
}

/// A cylinder along x.
fn lying(radius_mm: f64, length_mm: f64, x_mm: f64, color: [f64; 3], drop_out: f64) -> Part {
    let mut part = upright(radius_mm, length_mm, [0.0; 3], color, drop_out);
    part.body_from_part = Frame::from_rpy([x_mm * 1e-3, 0.0, 0.0], [0.0, FRAC_PI_2, 0.0]);
    part
}

fn kind(name: &str, mass_kg: f64, parts: Vec<Part>, rests_rad: &[[f64; 3]]) -> Kind {
    Kind {
        body: Body {
            name: name.to_owned(),
            parts,
            world_from_body: Frame::default(),
            mass_kg,
        },
        rests_rad: rests_rad.to_vec(),
    }
}

const FLAT: [f64; 3] = [0.0; 3];
const ON_SIDE: [f64; 3] = [FRAC_PI_2, 0.0, 0.0];
const ON_END: [f64; 3] = [0.0, FRAC_PI_2, 0.0];

/// The kinds that scenes are made of. The origin of each lies near its centre of mass.
#[must_use]
pub fn kinds() -> Vec<Kind> {
    vec![
        kind(
            "screwdriver",
            0.07,
            vec![
                lying(13.0, 80.0, 0.0, ORANGE, 0.0),
                lying(3.0, 60.0, 70.0, STEEL, 0.1),
            ],
            &[FLAT],
        ),
        kind(
            "printed bracket",
            0.03,
            vec![
                block([56.0, 8.0, 22.0], [8.0, -16.0, 0.0], BLUE, 0.0),
                block([8.0, 40.0, 22.0], [-16.0, 8.0, 0.0], BLUE, 0.0),
            ],
            &[FLAT],
        ),
        kind(
            "machined block",
            0.14,
            vec![
                block([44.0, 32.0, 24.0], [0.0; 3], ALUMINIUM, 0.03),
                upright(9.0, 10.0, [4.0, 0.0, 17.0], ALUMINIUM, 0.03),
            ],
            &[FLAT],
        ),
        kind(
            "flange",
            0.12,
            vec![
                upright(22.0, 16.0, [0.0, 0.0, -4.0], ALUMINIUM, 0.03),
                upright(10.0, 18.0, [0.0, 0.0, 12.0], ALUMINIUM, 0.03),
            ],
            &[FLAT],
        ),
        kind(
            "screw M16",
            0.11,
            vec![
                lying(8.0, 56.0, 8.0, STEEL, 0.06),
                lying(12.5, 10.0, -25.0, STEEL, 0.06),
            ],
            &[FLAT],
        ),
        kind(
            "bar",
            0.06,
            vec![block([90.0, 18.0, 18.0], [0.0; 3], STEEL, 0.05)],
            &[FLAT],
        ),
        kind(
            "small box",
            0.08,
            vec![block([46.0, 34.0, 28.0], [0.0; 3], RED, 0.0)],
            &[FLAT, ON_SIDE, ON_END],
        ),
        kind(
            "gelatin box",
            0.09,
            vec![block([70.0, 42.0, 24.0], [0.0; 3], YELLOW, 0.0)],
            &[FLAT],
        ),
        kind(
            "can",
            0.13,
            vec![upright(19.0, 44.0, [0.0; 3], GREEN, 0.0)],
            &[FLAT, ON_END],
        ),
    ]
}

/// A block that no jaws of 60 mm span.
#[must_use]
pub fn too_wide() -> Kind {
    kind(
        "block of 90 mm",
        0.4,
        vec![block([90.0, 90.0, 30.0], [0.0; 3], BLUE, 0.0)],
        &[FLAT],
    )
}
