//! The plant's cable paths against brute force and finite differences.

use super::brute::hull_length_m;
use crate::plant::pulley::Pulley;
use crate::plant::sensors::Noise;
use crate::plant::vec3::{V3, add, axpy, cross, dot, norm, scale, sub};

fn pulleys() -> Vec<Pulley> {
    let tilted = scale([0.3, -0.5, 0.8], 1.0 / norm([0.3, -0.5, 0.8]));
    let mut all = Vec::new();
    for axis in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], tilted] {
        for radius_m in [0.004, 0.01, 0.05] {
            all.push(Pulley {
                anchor_m: [0.1, -0.37, 0.024],
                axis,
                radius_m,
            });
        }
    }
    all
}

/// A point at `out` across and `up` along the pulley's axis, in a direction by `turn`.
fn point(pulley: &Pulley, out: f64, up: f64, turn: f64) -> V3 {
    let any = if pulley.axis[0].abs() < 0.9 {
        [1.0, 0.0, 0.0]
    } else {
        [0.0, 1.0, 0.0]
    };
    let u = cross(pulley.axis, any);
    let u = scale(u, 1.0 / norm(u));
    let v = cross(pulley.axis, u);
    let across = add(scale(u, out * turn.cos()), scale(v, out * turn.sin()));
    axpy(add(pulley.anchor_m, across), up, pulley.axis)
}

#[test]
fn lengths_match_a_string_around_a_polygon() {
    let mut noise = Noise::new(3);
    let mut worst = 0.0_f64;
    for pulley in pulleys() {
        for _ in 0..20 {
            let out = 2.0 * pulley.radius_m + 0.7 * noise.uniform() + 0.01;
            let up = noise.uniform() - 0.7;
            let p = point(&pulley, out, up, 6.3 * noise.uniform());
            let got = pulley.path_to(p).expect("outside").length_m;
            let want = hull_length_m(pulley.anchor_m, pulley.axis, pulley.radius_m, p, 20_000);
            worst = worst.max((got - want).abs());
        }
    }
    // The polygon is inside the circle: short by R pi (pi / corners)^2 / 6 = 0.6 nm at 50 mm.
    assert!(worst < 2e-9, "{worst}");
}

#[test]
fn wrap_and_tangent_follow_the_right_triangle() {
    // The textbook form with an inverse cosine, against the complex product of the plant.
    let pulley = &pulleys()[1];
    for (out, up) in [(0.3, -0.2), (0.1, -0.5), (0.5, 0.3), (0.03, -0.01)] {
        let path = pulley
            .path_to(point(pulley, out, up, 0.4))
            .expect("outside");
        let r = pulley.radius_m;
        let reach = (out - r).hypot(up);
        let mut bearing = up.atan2(-(out - r));
        if bearing < 0.0 {
            bearing += std::f64::consts::TAU;
        }
        let wrap = bearing - (r / reach).acos();
        let straight = (reach * reach - r * r).sqrt();
        assert!((path.length_m - (r * wrap + straight)).abs() < 1e-15);
        assert!((dot(path.direction, pulley.axis) - wrap.cos()).abs() < 1e-14);
        assert!((norm(path.direction) - 1.0).abs() < 1e-14);
    }
}

#[test]
fn the_direction_is_the_gradient_of_the_length() {
    // Virtual work: the force on the platform must equal the derivative of the energy, swivel
    // included.
    let mut noise = Noise::new(5);
    let mut worst = 0.0_f64;
    for pulley in pulleys() {
        for _ in 0..20 {
            let out = 2.0 * pulley.radius_m + 0.6 * noise.uniform() + 0.05;
            let p = point(&pulley, out, noise.uniform() - 0.7, 6.3 * noise.uniform());
            let path = pulley.path_to(p).expect("outside");
            for axis in 0..3 {
                let mut e = [0.0; 3];
                e[axis] = 1e-5;
                let ahead = pulley.path_to(add(p, e)).expect("outside").length_m;
                let behind = pulley.path_to(sub(p, e)).expect("outside").length_m;
                worst = worst.max(((ahead - behind) / 2e-5 - path.direction[axis]).abs());
            }
        }
    }
    assert!(worst < 1e-8, "{worst}");
}

#[test]
fn a_point_anchor_is_a_straight_line_even_along_the_axis() {
    let anchor = Pulley {
        anchor_m: [0.0; 3],
        axis: [0.0, 0.0, 1.0],
        radius_m: 0.0,
    };
    let path = anchor.path_to([0.0, 0.0, -2.0]).expect("a line");
    assert_eq!((path.length_m, path.direction), (2.0, [0.0, 0.0, -1.0]));
    assert_eq!(anchor.path_to([0.0; 3]), None);
}

#[test]
fn there_is_no_path_inside_the_wheel_or_on_its_axis() {
    let pulley = &pulleys()[1];
    let r = pulley.radius_m;
    assert_eq!(pulley.path_to(point(pulley, r, 0.0, 1.0)), None);
    assert_eq!(pulley.path_to(point(pulley, 1.5 * r, 0.3 * r, 1.0)), None);
    assert_eq!(
        pulley.path_to(axpy(pulley.anchor_m, -0.4, pulley.axis)),
        None
    );
    assert_eq!(pulley.path_to([f64::NAN, 0.0, 0.0]), None);
    assert!(pulley.path_to(point(pulley, 2.1 * r, 0.0, 1.0)).is_some());
}
