//! Picking in closed loop: pictures, plans, link, control core, physics, jaws.

use mcdpr::pick::study::{self, Knowledge, SceneReport, Study, Wanted};
use mcdpr::pick::{End, Outcome};
use mcdpr::robot::Robot;
use mcdpr_simulator::camera::Order;

fn robot() -> Robot {
    study::picking_robot(&Robot::built_in("lab-fast").unwrap())
}

fn wanted(count: usize, seed: u64) -> Wanted {
    Wanted {
        order: Order::Separate,
        count,
        knowledge: Knowledge::Calibrated,
        seed,
        turns: true,
        attempts_max: Some(8),
        views: 1,
        near: true,
        paper: false,
        mat: true,
        heavier: 1.0,
        tracked: false,
    }
}

fn median(values: &[f64]) -> f64 {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// The program knows what it has: its words are those of the jaws.
fn knows(scene: &SceneReport) {
    assert_eq!(scene.misjudged(), 0, "{:?}", scene.grips);
    assert_eq!(scene.left + scene.carried_off, scene.objects);
    for (attempt, grip) in scene.report.attempts.iter().zip(&scene.grips) {
        // The switch shows whether the jaws hold something.
        assert_eq!(
            attempt.outcome == Outcome::Delivered,
            grip.starts_with("holds"),
            "{grip}"
        );
        let lifted = attempt.lifted_n.is_some();
        assert_eq!(lifted, grip.starts_with("holds"), "{grip}");
    }
}

#[test]
fn a_tray_is_emptied_and_the_program_knows_what_it_has() {
    let scene = study::scene(&robot(), &wanted(5, 1)).unwrap();
    println!("{scene:#?}");
    knows(&scene);
    assert_eq!(scene.carried_off, 5, "{:?}", scene.grips);
    assert_eq!(scene.report.end, End::Empty);
    assert!(scene.report.attempts.len() <= 6, "{:?}", scene.grips);
    let error = median(&scene.errors_m);
    assert!(error < 1e-3, "{:?}", scene.errors_m);
    for [x, y, _] in &scene.off_m {
        // Across: a pixel at the edge of a boss of 10 mm is that much higher for the judge than for the grasp.
        assert!(x.hypot(*y) < 2.5e-3, "{:?}", scene.off_m);
    }
    for attempt in &scene.report.attempts {
        // What lengths say was corrected before the jaws closed.
        assert!(attempt.left_m < 1e-3, "{}", attempt.left_m);
        let budget = attempt.budget;
        let parts = [budget.depth_m, budget.hand_eye_m, budget.mat_m];
        // The mat was seen at the look and at the grasp, and the anchors do not count.
        assert!(budget.mat_m > 0.0 && budget.geometry_m == 0.0, "{budget:?}");
        let total: f64 = parts.iter().map(|part| part * part).sum::<f64>().sqrt();
        assert!((budget.total_m - total).abs() < 1e-9 && total < 2e-3);
    }
}

#[test]
fn a_machine_as_described_closes_within_a_millimetre() {
    let exact = Wanted {
        knowledge: Knowledge::Exact,
        ..wanted(3, 1)
    };
    let scene = study::scene(&robot(), &exact).unwrap();
    knows(&scene);
    assert_eq!(scene.carried_off, 3, "{:?}", scene.grips);
    for error in &scene.errors_m {
        assert!(*error < 1e-3, "{:?}", scene.errors_m);
    }
}

#[test]
fn the_papers_pixel_is_the_papers_point() {
    let paper = Wanted {
        paper: true,
        knowledge: Knowledge::Exact,
        ..wanted(1, 1)
    };
    let scene = study::scene(&robot(), &paper).unwrap();
    println!("{scene:#?}");
    let seen = scene.report.probe_m.unwrap();
    for (seen, paper) in seen.iter().zip([0.252, -0.039, -0.517]) {
        assert!((seen - paper).abs() < 2e-3, "{seen} {paper}");
    }
    assert_eq!(scene.carried_off, 1, "{:?}", scene.grips);
    let back = scene.report.returned_m.unwrap();
    assert!(
        (back[0] - 0.335).abs() < 1e-6 && back[1].abs() < 1e-6,
        "{back:?}"
    );
}

#[test]
fn an_empty_tray_ends_it_before_anything_is_tried() {
    let scene = study::scene(&robot(), &wanted(0, 3)).unwrap();
    assert_eq!(scene.report.end, End::Empty);
    assert!(scene.report.attempts.is_empty());
}

/// The short version of `mcdpr pick --robot lab-fast --scenes 300`. Its aims are 98 % and 90 %, and the
/// study is what shows them (98.8 and 96.4 %); of the 40 or so attempts here two may fail (at 98.8 % a
/// third fails for one set of seeds in a hundred), and four of the seventeen or so in three cluttered
/// scenes. Failures there come together: in scene 8, where things lie against each other, four attempts in a
/// row close on two of them.
#[test]
fn ten_scenes_are_picked_about_as_often_and_as_well_as_asked() {
    let study = Study {
        scenes: 10,
        knowledges: vec![Knowledge::Calibrated],
        first_seed: 1,
        turns: true,
        near: true,
        mat: true,
        keep: None,
    };
    let mut seen = 0;
    let robot = Robot::built_in("lab-fast").unwrap();
    let lines = study.run(&robot, |_, _| seen += 1).unwrap();
    assert_eq!(seen, 10);
    for (line, (is_cluttered, least)) in lines.iter().zip([(false, 0.94), (true, 0.75)]) {
        let figures = &line.figures;
        println!("{figures:?} {:?}", line.failures);
        assert_eq!(line.cluttered, is_cluttered);
        assert!(figures.scenes > 2 && figures.attempts > 10, "{figures:?}");
        assert_eq!(figures.stopped, 0, "{figures:?}");
        assert!(figures.rate >= least, "{figures:?} {:?}", line.failures);
        assert!(figures.error_median_m < 1e-3, "{figures:?}");
        // Two things between the jaws push the tool aside.
        assert!(
            line.cluttered || figures.error_p95_m < 2.5e-3,
            "{figures:?}"
        );
    }
}
