//! Targets to print: the tags, where they are on the sheet, and the drawing at true scale.
//!
//! Tag family 36h11 (Olson, 2011). Its code words are those of the vision crate's detector.

use super::simulate::{Target, tags_of};
use crate::robot::Tag;
use std::fmt::Write as _;

/// Tags of a standard target as the robot file would list them.
#[must_use]
pub fn tags(target: Target) -> Vec<Tag> {
    let (tags, _) = tags_of(target);
    tags.into_iter()
        .map(|tag| Tag {
            id: tag.id,
            family: "36h11".to_owned(),
            size_m: tag.size_m,
            body: u32::try_from(tag.body).unwrap_or(0),
            corners_in_body_m: tag.corners_in_body_m,
        })
        .collect()
}

/// The `[[tag]]` tables of a robot file for these tags.
#[must_use]
pub fn tables(tags: &[Tag]) -> String {
    let mut out = String::new();
    for tag in tags {
        let corner = |c: &nalgebra::Vector3<f64>| {
            let [x, y, z] = [c.x, c.y, c.z].map(|v| (v * 1e6).round() * 1e-3);
            format!("[{x}, {y}, {z}]")
        };
        let corners: Vec<String> = tag.corners_in_body_m.iter().map(corner).collect();
        let _ = writeln!(
            out,
            "[[tag]]\nid = {}\nfamily = \"{}\"\nsize_mm = {}\nbody = {}\ncorners_in_body_mm = [{}]\n",
            tag.id,
            tag.family,
            (tag.size_m * 1e6).round() * 1e-3,
            tag.body,
            corners.join(", ")
        );
    }
    out
}
