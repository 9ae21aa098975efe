use super::*;

fn v(x: f64, y: f64, z: f64) -> Vector3<f64> {
    Vector3::new(x, y, z)
}

/// Tangent and curvature against differences of the position.
fn check_derivatives(piece: &Piece) {
    let h = 1e-5;
    for share in [0.1, 0.37, 0.5, 0.93] {
        let s = share * piece.length_m();
        let [a, b, c] = [s - h, s, s + h].map(|s| piece.point(s).unwrap());
        let tangent = (c.position_m - a.position_m) / (2.0 * h);
        let curvature = (c.tangent - a.tangent) / (2.0 * h);
        assert!((tangent - b.tangent).norm() < 1e-8, "{tangent} {b:?}");
        assert!((curvature - b.curvature_per_m).norm() < 1e-6, "{b:?}");
        assert!((b.tangent.norm() - 1.0).abs() < 1e-14);
    }
}

#[test]
fn derivatives_of_lines_and_arcs_are_those_of_the_position() {
    check_derivatives(&Piece::line(v(0.1, 0.2, 0.3), v(-0.4, 0.0, 1.0)).unwrap());
    for sweep in [TAU, -TAU, 0.5, -2.0] {
        let arc = Piece::arc(v(1.0, 2.0, 3.0), 0.1, v(1.06, 2.08, 3.0), sweep).unwrap();
        check_derivatives(&arc);
        assert!((arc.length_m() - 0.1 * f64::abs(sweep)).abs() < 1e-15);
    }
}

#[test]
fn arc_of_a_quarter_turn_ends_where_geometry_says() {
    let quarter = TAU / 4.0;
    let start = v(2.0, 0.0, 5.0);
    let arc = Piece::arc(v(0.0, 0.0, 5.0), 2.0, start, quarter).unwrap();
    assert!((arc.end().position_m - v(0.0, 2.0, 5.0)).norm() < 1e-15);
    assert!((arc.start().tangent - v(0.0, 1.0, 0.0)).norm() < 1e-15);
    let back = Piece::arc(v(0.0, 0.0, 5.0), 2.0, start, -quarter).unwrap();
    assert!((back.end().position_m - v(0.0, -2.0, 5.0)).norm() < 1e-15);
    assert!((back.start().tangent - v(0.0, -1.0, 0.0)).norm() < 1e-15);
}

#[test]
fn table_7_is_an_approach_of_67_mm_and_a_whole_circle() {
    let path = Path::paper_circle(-0.1).unwrap();
    let [approach, circle] = path.pieces() else {
        panic!("{path:?}")
    };
    // sqrt(80^2 + 105^2) - 65 = 132.004 - 65 mm
    assert!((approach.length_m() - 0.067_003_79).abs() < 1e-8);
    assert!((circle.length_m() - TAU * 0.065).abs() < 1e-15);
    assert_eq!(approach.start().position_m, v(0.255, -0.105, -0.1));
    let there = circle.start().position_m;
    assert!((circle.end().position_m - there).norm() < 1e-15);
    for step in 0..=100 {
        let s = circle.length_m() * f64::from(step) / 100.0;
        let point = circle.point(s).unwrap().position_m;
        let arm = point - v(0.335, 0.0, -0.1);
        assert!((arm.norm() - 0.065).abs() < 1e-15 && arm.z == 0.0);
    }
    // The approach runs towards the centre.
    let inward = (v(0.335, 0.0, -0.1) - there).normalize();
    assert!((approach.end().tangent - inward).norm() < 1e-12);
}

#[test]
fn table_8_is_500_mm_long() {
    let path = Path::paper_line(0.024).unwrap();
    assert!((path.length_m() - 0.5).abs() < 1e-15);
    let middle = path.point(0.25).unwrap();
    assert!((middle.position_m - v(0.35, 0.0, 0.024)).norm() < 1e-15);
    assert_eq!(path.least_radius_m(), None);
    assert_eq!(
        Path::paper_circle(0.0).unwrap().least_radius_m(),
        Some(0.065)
    );
}

#[test]
fn a_path_is_continuous_over_its_joins_and_ends_at_its_end() {
    let path = Path::paper_circle(0.024).unwrap();
    let join = path.pieces()[0].length_m();
    let before = path.point(join - 1e-9).unwrap();
    let after = path.point(join).unwrap();
    assert!((before.position_m - after.position_m).norm() < 2e-9);
    // At the join the later piece applies: the tangent has turned by a right angle.
    assert!(before.tangent.dot(&after.tangent).abs() < 1e-9);
    let end = path.point(path.length_m()).unwrap();
    assert!((end.position_m - path.pieces()[1].end().position_m).norm() < 1e-12);
}

#[test]
fn bad_pieces_and_paths_are_refused_by_name() {
    let (a, b) = (v(0.0, 0.0, 0.0), v(1.0, 0.0, 0.0));
    assert_eq!(
        Piece::line(a, a),
        Err(PathError::NoLength { length_m: 0.0 })
    );
    for bad in [f64::NAN, f64::INFINITY, 1e308] {
        let far = v(bad, -bad, 0.0);
        assert!(Piece::line(a, far).is_err_and(|e| matches!(e, PathError::NotFinite { .. })));
        assert!(Piece::arc(a, bad, b, 1.0).is_err());
        assert!(Path::paper_line(bad).is_err() || bad == 1e308);
        assert!(Path::paper_circle(bad).is_err() || bad == 1e308);
    }
    assert!(Piece::arc(a, 1.0, b, f64::NAN).is_err());
    assert!(matches!(
        Piece::arc(a, 1.0, b, 0.0),
        Err(PathError::NoLength { .. })
    ));
    assert!(matches!(
        Piece::arc(a, 0.9, b, 1.0),
        Err(PathError::OffCircle { .. })
    ));
    assert!(matches!(
        Piece::arc(a, 1.0, v(1.0, 0.0, 0.1), 1.0),
        Err(PathError::OffCircle { .. })
    ));
    assert!(Piece::arc(a, -1.0, b, 1.0).is_err());
    assert!(Piece::arc(a, 0.0, a, 1.0).is_err());
    let line = Piece::line(a, b).unwrap();
    assert_eq!(
        Path::new(vec![line.clone(), line]),
        Err(PathError::Gap {
            next: 2,
            gap_m: 1.0
        })
    );
    assert_eq!(Path::new(vec![]), Err(PathError::Empty));
    assert_eq!(Path::through(&[a]), Err(PathError::Empty));
    let path = Path::through(&[a, b]).unwrap();
    for off in [-1e-3, 1.001, f64::NAN] {
        assert!(matches!(path.point(off), Err(PathError::OffPath { .. })));
    }
    assert_eq!(path.point(1.0 + 1e-12).unwrap().position_m, b);
}
