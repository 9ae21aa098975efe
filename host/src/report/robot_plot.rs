//! A robot as it is described: its frame, cables and platform at home, from above and from the front.

use crate::chart::{Chart, Curve, Figure};
use crate::robot::Robot;
use nalgebra::Vector3;

/// Two views of a robot with its platform level and its tool at home.
pub(crate) fn draw_robot(robot: &Robot) -> Figure {
    let views = [
        ("From above", "x, mm", "y, mm", [0, 1]),
        ("From the front", "x, mm", "z, mm", [0, 2]),
    ];
    let charts = views.map(|(title, across, up, axes)| view(robot, title, [across, up], axes));
    let title = format!("{}, tool at home", robot.name);
    Figure::new(title, 2, charts)
}

/// One view: the named axes of the world, in mm.
fn view(robot: &Robot, title: &str, [across, up]: [&str; 2], axes: [usize; 2]) -> Chart {
    let flat = |point_m: Vector3<f64>| {
        let [x, y] = axes.map(|axis| point_m[axis] * 1e3);
        (x, y)
    };
    let origin_m = robot.tool.home_in_world_m - robot.tool.tcp_in_platform_m;
    let anchors = robot.cables.iter().map(|cable| cable.anchor_in_world_m);
    let ends = robot
        .cables
        .iter()
        .map(|cable| origin_m + cable.attachment_in_platform_m);
    let ends: Vec<_> = ends.collect();
    // A break in the line after each cable.
    let cables = anchors.clone().zip(&ends);
    let cables = cables.flat_map(|(a, b)| [flat(a), flat(*b), (f64::NAN, f64::NAN)]);
    let middle = ends.iter().sum::<Vector3<f64>>() / ends.len().max(1) as f64;
    let platform = ends.iter().flat_map(|end| [flat(middle), flat(*end)]);
    let mut curves = vec![
        Curve::new("tool", 1, [flat(robot.tool.home_in_world_m)]).crosses(),
        Curve::new("anchors", 4, anchors.map(flat)).crosses(),
        Curve::new("platform", 2, platform),
        Curve::new("cables", 0, cables),
    ];
    if let Some([low, high]) = robot.limits.box_in_world_m {
        let [i, j] = axes;
        let corners = [
            (low[i], low[j]),
            (high[i], low[j]),
            (high[i], high[j]),
            (low[i], high[j]),
        ];
        let rim = corners.into_iter().cycle().take(5);
        let rim = rim.map(|(x, y)| (x * 1e3, y * 1e3));
        curves.push(Curve::new("working box", 7, rim).dashed());
    }
    Chart::new(title, across, up).with(curves).square()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_robot_is_drawn_in_two_views_of_finite_numbers() {
        for (name, _) in mcdpr_core::robot::BUILT_IN {
            let svg = draw_robot(&crate::robot::find(name).unwrap()).svg();
            assert_eq!(svg.matches("<svg").count(), 3, "{name}");
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{name}");
            assert!(svg.contains("anchors") && svg.contains("From the front"));
        }
    }
}
