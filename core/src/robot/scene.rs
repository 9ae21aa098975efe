//! The camera and the tags of the file.

use mcdpr_kinematics::Pose;
use mcdpr_vision::Camera as Lens;
use nalgebra::Vector3;

use super::build::{MM_PER_M, point_m};
use super::model::{Camera, Tag};
use super::read::{Reader, Values};
use super::schema::{self, Named, key};

pub(super) fn camera(reader: &mut Reader, mut table: Values) -> Camera {
    let pose = table.take_table(
        key!(CAMERA, "camera_from_platform"),
        &schema::CAMERA_FROM_PLATFORM,
    );
    let width = table.whole(key!(CAMERA, "width"));
    let height = table.whole(key!(CAMERA, "height"));
    let mut principal = |key: Named, pixels: i64| {
        let pixels = pixels as f64;
        let value = table.number_given(key).unwrap_or(pixels / 2.0);
        if !(0.0..=pixels).contains(&value) {
            reader.problem(
                &table.at(key),
                &table.place,
                format!(
                    "`{}` {value} lies outside the picture of {pixels} px",
                    key.name()
                ),
                Some("give the principal point in px of the full picture".into()),
            );
        }
        value
    };
    let cx_px = principal(key!(CAMERA, "cx"), width);
    let cy_px = principal(key!(CAMERA, "cy"), height);
    let mut distortion = [0.0; 5];
    for (slot, value) in distortion
        .iter_mut()
        .zip(table.numbers(key!(CAMERA, "distortion")))
    {
        *slot = value;
    }
    let mut attitude_rad = [0.0; 3];
    for (slot, value) in attitude_rad
        .iter_mut()
        .zip(pose.numbers(key!(CAMERA_FROM_PLATFORM, "attitude_deg")))
    {
        *slot = value.to_radians();
    }
    Camera {
        lens: Lens {
            size_px: [width, height].map(|size| usize::try_from(size).unwrap_or(0)),
            focal_px: [
                table.number(key!(CAMERA, "fx")),
                table.number(key!(CAMERA, "fy")),
            ],
            center_px: [cx_px, cy_px],
            distortion,
        },
        depth: table.switch(key!(CAMERA, "depth")),
        camera_from_platform: Pose::from_rpy(
            point_m(&pose.numbers(key!(CAMERA_FROM_PLATFORM, "position_mm"))),
            attitude_rad,
        ),
    }
}

pub(super) fn tags(reader: &mut Reader, tables: &[Values]) -> Vec<Tag> {
    let number = |number: i64| u32::try_from(number).unwrap_or(0);
    let mut tags: Vec<Tag> = Vec::new();
    for (index, table) in tables.iter().enumerate() {
        let place_in_file = index as i64;
        let size_m = table.number(key!(TAG, "size_mm")) / MM_PER_M;
        let s = size_m / 2.0;
        let mut corners_in_body_m =
            [(-s, -s), (s, -s), (s, s), (-s, s)].map(|(x, y)| Vector3::new(x, y, 0.0));
        if let Some(given) = table.numbers_given(key!(TAG, "corners_in_body_mm")) {
            for (corner, row) in corners_in_body_m.iter_mut().zip(given.chunks(3)) {
                *corner = point_m(row);
            }
        }
        let tag = Tag {
            id: number(table.whole_given(key!(TAG, "id")).unwrap_or(place_in_file)),
            family: table.text(key!(TAG, "family")).to_owned(),
            size_m,
            body: number(
                table
                    .whole_given(key!(TAG, "body"))
                    .unwrap_or(place_in_file),
            ),
            corners_in_body_m,
        };
        let mut refuse = |key: Named, what: String, help: &str| {
            reader.problem(&table.at(key), &table.place, what, Some(help.into()));
        };
        let [a, b, c, d] = corners_in_body_m;
        // 1 % allows for measured corners; a diagonal in wrong order is 41 % longer.
        let edges = [(b - a), (c - b), (d - c), (a - d)].map(|edge| edge.norm());
        if edges
            .iter()
            .any(|edge| (edge - size_m).abs() > 0.01 * size_m)
        {
            refuse(
                key!(TAG, "corners_in_body_mm"),
                format!(
                    "`corners_in_body_mm` have edges of {:.1}, {:.1}, {:.1} and {:.1} mm, \
                     but size_mm is {}",
                    edges[0] * 1e3,
                    edges[1] * 1e3,
                    edges[2] * 1e3,
                    edges[3] * 1e3,
                    table.number(key!(TAG, "size_mm"))
                ),
                "list the corners in the detector's order around the square",
            );
        }
        if tags
            .iter()
            .any(|other| other.id == tag.id && other.family == tag.family)
        {
            refuse(
                key!(TAG, "id"),
                format!(
                    "`id` {} of family {} is already the id of another tag",
                    tag.id, tag.family
                ),
                "every tag in the scene needs its own id",
            );
        }
        if tags
            .iter()
            .any(|other| other.body == tag.body && other.corners_in_body_m == tag.corners_in_body_m)
        {
            refuse(
                key!(TAG, "body"),
                format!(
                    "`body` {} already carries a tag at the same corners",
                    tag.body
                ),
                "give corners_in_body_mm of every tag of a board",
            );
        }
        tags.push(tag);
    }
    tags
}
