//! `control = "auto"`: the program chooses which cables are held by length.

use super::model::{Control, Robot};
use super::read::{Reader, Values};
use super::schema::key;
use crate::holding::{self, Freedom};
use mcdpr_kinematics::Pose;

/// Places along each edge of the work space at which a choice is judged, as shares of it.
const SHARES: [f64; 3] = [0.1, 0.5, 0.9];

/// Fills in the control of the cables that leave it to the program; `None` if a mistake has been noted.
pub(super) fn choose(reader: &mut Reader, tables: &[Values], robot: &mut Robot) -> Option<()> {
    let word = |table: &Values| match table.text(key!(CABLE, "control")) {
        "auto" => None,
        word => Some(word != "tension"),
    };
    let fixed: Vec<Option<bool>> = tables.iter().map(word).collect();
    let Some(first) = tables.iter().find(|table| word(table).is_none()) else {
        return Some(());
    };
    // A geometry that cannot be built is reported where it is used.
    let Ok(geometry) = robot.geometry() else {
        return Some(());
    };
    let freedom = Freedom::of(&geometry);
    let plane = match freedom {
        Freedom::Plane { normal } | Freedom::PlanePoint { normal } => Some(normal),
        _ => None,
    };
    let anchor_m = robot.cables.first().map(|cable| cable.anchor_in_world_m)?;
    let [low, high] = robot.search_box_in_world_m();
    let mut poses = Vec::new();
    for x in SHARES {
        for y in SHARES {
            for z in SHARES {
                let share = nalgebra::Vector3::new(x, y, z);
                let mut at_m = low + (high - low).component_mul(&share);
                at_m -= robot.tool.tcp_in_platform_m;
                if let Some(normal) = plane {
                    at_m -= normal * normal.dot(&(at_m - anchor_m));
                }
                // Level: no task is known yet.
                poses.push(Pose::level(at_m));
            }
        }
    }
    match holding::choose(&geometry, &fixed, &poses) {
        Ok(choice) => {
            for (cable, held) in robot.cables.iter_mut().zip(&choice.by_length) {
                cable.control = if *held {
                    Control::Position
                } else {
                    Control::Tension
                };
            }
            robot.chosen = Some(choice);
            Some(())
        }
        Err(error) => {
            reader.problem(
                &first.at(key!(CABLE, "control")),
                &first.place,
                format!("`control` \"auto\" finds no cables to hold by length: {error}"),
                Some(
                    "change anchors or attachments, or the work space (box_mm of [limits])".into(),
                ),
            );
            None
        }
    }
}
