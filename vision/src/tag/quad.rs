//! Outlines of dark regions, and the quadrangles among them.

use crate::image::Image;
use nalgebra::Vector2;

/// The eight neighbours, clockwise on the screen from the right.
const AROUND: [(isize, isize); 8] = [
    (1, 0),
    (1, 1),
    (0, 1),
    (-1, 1),
    (-1, 0),
    (-1, -1),
    (0, -1),
    (1, -1),
];
/// An outline may lie this far off its quadrangle, px, or this share of its edge.
const BEND_PX: f64 = 2.0;
const BEND_SHARE: f64 = 0.05;

/// Rough corners of each dark quadrangle, clockwise on the screen, px.
pub(super) fn quads(dark: &Image<u8>, edge_min_px: f64) -> Vec<[Vector2<f64>; 4]> {
    let width = dark.width();
    let mut traced = vec![false; dark.pixels().len()];
    let mut outline = Vec::new();
    let mut quads = Vec::new();
    for y in 0..dark.height() {
        let row = dark.row(y);
        let mut left = 0;
        for (x, &here) in row.iter().enumerate() {
            let starts = here == 1 && left == 0;
            left = here;
            if !starts || traced[y * width + x] {
                continue;
            }
            trace(dark, (x, y), &mut traced, &mut outline);
            // Four edges; diagonal steps save some of their pixels.
            if (outline.len() as f64) < 3.0 * edge_min_px {
                continue;
            }
            quads.extend(quad_of(&outline, edge_min_px));
        }
    }
    quads
}

/// Follows the outline of the region from its topmost, then leftmost pixel, clockwise (Moore's
/// neighbours, with the stop rule of Jacob).
fn trace(
    dark: &Image<u8>,
    start: (usize, usize),
    traced: &mut [bool],
    outline: &mut Vec<(i32, i32)>,
) {
    outline.clear();
    let width = dark.width();
    let step = |at: (usize, usize), way: usize| {
        let (dx, dy) = AROUND[way];
        let x = at.0.checked_add_signed(dx)?;
        let y = at.1.checked_add_signed(dy)?;
        (dark.get(x, y)? == 1).then_some((x, y))
    };
    // The pixel to the left is not dark: the search begins behind it.
    let (mut at, mut from) = (start, 4);
    loop {
        traced[at.1 * width + at.0] = true;
        #[allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap)]
        outline.push((at.0 as i32, at.1 as i32));
        let next = (1..=8).map(|turn| (from + turn) % 8);
        let Some((way, to)) = next.filter_map(|way| Some((way, step(at, way)?))).next() else {
            return;
        };
        // Look from the last free neighbour on.
        at = to;
        from = (way + 4) % 8;
        // No quadrangle has an outline this long, and the loop must end.
        if outline.len() > 4 * (width + dark.height()) * 8 {
            return;
        }
        if at == start {
            // Another turn begins only if the start is left the same way as at first.
            let again = (1..=8).map(|turn| (from + turn) % 8);
            let leaves = again.filter_map(|way| step(at, way)).next();
            let first = outline
                .get(1)
                .and_then(|&(x, y)| Some((usize::try_from(x).ok()?, usize::try_from(y).ok()?)));
            if leaves == first || first.is_none() {
                return;
            }
        }
    }
}

fn quad_of(outline: &[(i32, i32)], edge_min_px: f64) -> Option<[Vector2<f64>; 4]> {
    let points: Vec<Vector2<f64>> = outline
        .iter()
        .map(|&(x, y)| Vector2::new(f64::from(x) + 0.5, f64::from(y) + 0.5))
        .collect();
    let cross = |a: &Vector2<f64>, b: &Vector2<f64>| a.x * b.y - a.y * b.x;
    let next = |i: usize| &points[(i + 1) % points.len()];
    let double_area: f64 = (0..points.len()).map(|i| cross(&points[i], next(i))).sum();
    // Clockwise on the screen is positive with y down; a hole's outline runs the other way.
    if double_area < 2.0 * (0.3 * edge_min_px).powi(2) {
        return None;
    }
    let middle = points.iter().sum::<Vector2<f64>>() / points.len() as f64;
    let farthest = |score: &dyn Fn(&Vector2<f64>) -> f64| {
        let scores = points.iter().enumerate().map(|(i, p)| (i, score(p)));
        scores.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
    };
    let a = farthest(&|p| (p - middle).norm_squared())?;
    let c = farthest(&|p| (p - points[a]).norm_squared())?;
    let diagonal = points[c] - points[a];
    let b = farthest(&|p| -cross(&diagonal, &(p - points[a])))?;
    let d = farthest(&|p| cross(&diagonal, &(p - points[a])))?;
    let mut order = [a, b, c, d];
    order.sort_unstable();
    let mut corners = order.map(|i| points[i]);
    let mut quad_area = 0.0;
    for i in 0..4 {
        let (here, there) = (corners[i], corners[(i + 1) % 4]);
        quad_area += cross(&here, &there);
        let edge = (there - here).norm();
        if edge < edge_min_px - 2.0 {
            return None;
        }
        let turn = cross(
            &(there - here).normalize(),
            &(corners[(i + 2) % 4] - there).normalize(),
        );
        // The sine of the turn: under 9 degrees three corners are on one line.
        if turn < 0.15 {
            return None;
        }
    }
    // A disc has 1.57 times the area of its quadrangle, a star less than it.
    if !(0.8..1.25).contains(&(double_area / quad_area)) {
        return None;
    }
    for i in 0..4 {
        let (first, last) = (order[i], order[(i + 1) % 4]);
        let (from, to) = (points[first], points[last]);
        let along = (to - from).normalize();
        let bend = BEND_PX.max(BEND_SHARE * (to - from).norm());
        let count = (last + points.len() - first) % points.len();
        let off = (0..count).filter(|k| {
            let p = points[(first + k) % points.len()] - from;
            cross(&along, &p).abs() > bend
        });
        // Single pixels that stick out are noise.
        if off.count() * 10 > count {
            return None;
        }
    }
    // The outline runs through the outermost dark pixels' centres: the edge is half a pixel out.
    for corner in &mut corners {
        let out = *corner - middle;
        *corner += out.normalize() * std::f64::consts::FRAC_1_SQRT_2;
    }
    Some(corners)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(inside: impl Fn(f64, f64) -> bool) -> Image<u8> {
        let mut dark = Image::filled(100, 80, 0_u8);
        for y in 0..80 {
            for x in 0..100 {
                dark.set(x, y, u8::from(inside(x as f64 + 0.5, y as f64 + 0.5)));
            }
        }
        dark
    }

    #[test]
    fn a_ring_has_one_outer_quadrangle() {
        let ring = picture(|x, y| {
            let r = (x - 50.0).abs().max((y - 40.0).abs());
            (20.0..30.0).contains(&r)
        });
        let quads = quads(&ring, 20.0);
        assert_eq!(quads.len(), 1);
        for (corner, wanted) in
            quads[0]
                .iter()
                .zip([[20.0, 10.0], [80.0, 10.0], [80.0, 70.0], [20.0, 70.0]])
        {
            assert!((corner - Vector2::from(wanted)).norm() < 1.0, "{corner}");
        }
    }

    #[test]
    fn a_disc_and_a_triangle_are_none() {
        let disc = picture(|x, y| (x - 50.0).hypot(y - 40.0) < 30.0);
        assert!(quads(&disc, 20.0).is_empty());
        let triangle = picture(|x, y| y > 10.0 && y < 70.0 && (x - 50.0).abs() < (y - 10.0) / 2.0);
        assert!(quads(&triangle, 20.0).is_empty());
    }

    #[test]
    fn a_region_at_the_border_of_the_picture_ends_there() {
        let cut = picture(|x, _| x > 60.0);
        let all = picture(|_, _| true);
        // Neither may run out of the picture or go on for ever.
        let _ = (quads(&cut, 20.0), quads(&all, 20.0));
        let dot = picture(|x, y| (x - 50.0).abs() < 0.6 && (y - 40.0).abs() < 0.6);
        assert!(quads(&dot, 20.0).is_empty());
    }
}
