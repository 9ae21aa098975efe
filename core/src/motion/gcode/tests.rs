use super::*;

fn length_mm(step: &Step) -> f64 {
    match step {
        Step::Move { path, .. } => path.length_m() * 1e3,
        _ => 0.0,
    }
}

#[test]
fn the_gripper_acts_before_the_move_of_its_block() {
    let steps = read("G90 G0 X300 Y0 Z-180\nG1 X310 M3 F600\nM5 G4 P1")
        .unwrap()
        .steps;
    assert!(matches!(
        steps[..],
        [
            Step::Gripper { closed: true },
            Step::Move { .. },
            Step::Gripper { closed: false },
            Step::Dwell { .. }
        ]
    ));
}

#[test]
fn a_program_of_every_word_is_understood() {
    let text = "%\n(a square with a round corner) G21 G90 G17\n\
        N10 G0 X300 Y0 Z-180 ; start\nG1 X340 F600\nG3 X360 Y20 I0 J20\nG2 X360 Y20 I-10 J0\n\
        G4 P0.5\nM3\nG91\ng1 y 20\nG90 G0 Z-190\nM5\nM30\nnot read any more";
    let Program {
        start_m,
        start_attitude,
        steps,
    } = read(text).unwrap();
    assert_eq!(start_m, Some(Vector3::new(0.3, 0.0, -0.18)));
    assert!(start_attitude.is_none());
    let lengths: Vec<_> = steps.iter().map(length_mm).collect();
    let quarter = std::f64::consts::PI * 10.0;
    let wanted = [40.0, quarter, 2.0 * quarter, 0.0, 0.0, 20.0, 10.0, 0.0];
    assert_eq!(lengths.len(), wanted.len(), "{steps:?}");
    for (length, wanted) in lengths.iter().zip(wanted) {
        assert!((length - wanted).abs() < 1e-9, "{length} {wanted}");
    }
    assert!(matches!(steps[0], Step::Move { speed_mps: Some(v), .. } if (v - 0.01).abs() < 1e-12));
    assert!(matches!(steps[3], Step::Dwell { duration_s } if (duration_s - 0.5).abs() < 1e-12));
    assert!(matches!(steps[4], Step::Gripper { closed: true }));
    assert!(matches!(
        steps[6],
        Step::Move {
            speed_mps: None,
            ..
        }
    ));
}

#[test]
fn angles_turn_the_platform_on_the_way_or_in_place() {
    let text = "G0 X0 Y0 Z700 B5\nG1 X100 F6000 A10\nG1 X200\nG1 C-20 F60\nG91 G0 A-10 B-5 C20 Z10";
    let Program {
        start_attitude,
        steps,
        ..
    } = read(text).unwrap();
    let near = |found: Option<Rotation3<f64>>, degrees: [f64; 3]| {
        // R = Rz(C) Ry(B) Rx(A), by the axes.
        let [a, b, c] = degrees.map(f64::to_radians);
        let about = |axis, angle| Rotation3::from_axis_angle(&axis, angle);
        let wanted =
            about(Vector3::z_axis(), c) * about(Vector3::y_axis(), b) * about(Vector3::x_axis(), a);
        assert!((found.unwrap().matrix() - wanted.matrix()).norm() < 1e-12);
    };
    near(start_attitude, [0.0, 5.0, 0.0]);
    let moves: Vec<_> = steps
        .iter()
        .map(|step| match step {
            Step::Move {
                path, speed_mps, ..
            } => (path.attitude(), path.length_m(), *speed_mps),
            _ => panic!("{step:?}"),
        })
        .collect();
    assert_eq!(moves.len(), 4);
    near(moves[0].0, [10.0, 5.0, 0.0]);
    assert!(moves[1].0.is_none());
    near(moves[2].0, [10.0, 5.0, -20.0]);
    near(moves[3].0, [0.0, 0.0, 0.0]);
    // 20 degrees in 20 s, one degree a second; the length of a turn in place is its angle times 0.2 m.
    let (_, length_m, speed_mps) = moves[2];
    assert!((length_m / speed_mps.unwrap() - 20.0).abs() < 1e-9);
    assert!((moves[3].1 - 0.01).abs() < 1e-12);
}

#[test]
fn malformed_programs_are_refused_with_line_and_column() {
    for (text, line, column, words) in [
        ("G0 X300 Y0 Z-180\nG1 X", 2, 5, "X needs a number"),
        ("G0 X300 Y0 Z-180\n  G1 X1..2 F5", 2, 7, "X needs a number"),
        ("G0 X300 Y0 Z-180\nG1 X310", 2, 1, "no speed"),
        ("X300", 1, 1, "without G0"),
        ("G0 X300 Y0 Z-180\nG1 X300 F10", 2, 1, "no length"),
        ("G0 X300 Y0 Z-180\nG5 X1", 2, 1, "G5 is not understood"),
        ("G20", 1, 1, "inches"),
        ("G0 X300 Y0 Z-180\nG2 X310 F10", 2, 1, "centre"),
        ("G0 X300 Y0 Z-180\nG2 X310 I3 F10", 2, 1, "from its centre"),
        ("G0 X300 Y0 Z-180\nG3 X310 Z-170 I5 F10", 2, 1, "height"),
        ("G0 X300 Y0 Z-180\nG4", 2, 1, "P"),
        ("G91 G1 X3 F1", 1, 8, "G91 before"),
        ("G0 X0 Y0 Z1\nG1 C200 F9", 2, 4, "half a turn"),
        ("G0 X0 Y0 Z1\nG1 C20", 2, 1, "degrees/min"),
        ("G0 X0 Y0 Z1\nG4 P1 A2", 2, 7, "does not move"),
        ("G0 X300 (never ends", 1, 9, "no end"),
        ("G0 X300 Y0 Z#1", 1, 13, "needs a number, there is #1"),
        ("G1 F-3", 1, 4, "over 0"),
        ("G0 X300", 1, 1, "complete position"),
    ] {
        let error = read(text).unwrap_err();
        assert!(error.message.contains(words), "{text:?}: {}", error.message);
        assert_eq!(
            (error.line, error.column),
            (line, column),
            "{text:?}: {}",
            error.message
        );
    }
}
