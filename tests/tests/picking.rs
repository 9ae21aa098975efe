//! Picking in closed loop: pictures, plans, link, control core, physics, jaws.

use mcdpr::pick::study::{self, Knowledge, Wanted};
use mcdpr::robot::Robot;
use mcdpr_simulator::camera::Order;

fn robot() -> Robot {
    study::picking_robot(&Robot::find("lab-fast").unwrap(), None)
}

#[test]
fn scenes_of_separate_and_cluttered_objects_are_picked() {
    let robot = robot();
    let mut scenes = Vec::new();
    for seed in 0..10 {
        let order = if seed < 6 {
            Order::Separate
        } else {
            Order::Cluttered
        };
        let count = 5 + usize::try_from(seed % 4).unwrap();
        let scene = study::scene(
            &robot,
            &Wanted {
                order,
                count,
                knowledge: Knowledge::Calibrated,
                seed,
                turns: true,
                attempts_max: None,
            },
        );
        match &scene {
            Ok(scene) => println!(
                "scene {seed}: {} of {} in {} attempts, {} left, {:?}, {:.0} s; {:?} {:?}",
                scene.carried_off,
                scene.objects,
                scene.report.attempts.len(),
                scene.left,
                scene.report.end,
                scene.report.duration_s,
                scene.grips,
                scene.errors_m,
            ),
            Err(error) => println!("scene {seed}: {error} {error:?}"),
        }
        scenes.push(scene);
    }
    let figures = study::figures(&scenes);
    println!("{figures:#?}");
    assert_eq!(figures.stopped, 0);
    assert!(figures.rate >= 0.85, "{figures:?}");
    assert!(figures.cleared >= 0.8, "{figures:?}");
    assert!(figures.error_median_m <= 1e-3, "{figures:?}");
    assert!(figures.error_p95_m <= 2.5e-3, "{figures:?}");
}
