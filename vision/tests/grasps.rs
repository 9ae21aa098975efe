//! From rendered pictures to grasps that the simulator's jaws hold.

mod common;

use common::{cell, frame, isometry, look, place};
use mcdpr_simulator::camera::{Body, Cell, Frame as Place, Grip, Order, Scene, Tray, too_wide};
use mcdpr_vision::grasp::{Antipodal, Area, Closing, Detector, Grasp, Hand, NoGrasp, Wanted};
use mcdpr_vision::{Frame, align};
use nalgebra::{Isometry3, Matrix3, Rotation3, Vector3};

fn take(cell: &Cell, seed: u64) -> (Frame, Place) {
    let (rgbd, camera) = look();
    (frame(&rgbd, cell.look(&rgbd, &camera, seed)), camera)
}

fn grasps(cell: &Cell, seed: u64) -> (Result<Vec<Grasp>, NoGrasp>, Place) {
    let (frame, camera) = take(cell, seed);
    let aligned = align(&frame.checked().unwrap());
    let found = Antipodal::default().detect(&aligned, &wanted(&camera, Closing::Any));
    (found, camera)
}

/// The tray's floor as the area, slightly inside its walls.
fn wanted(camera: &Place, closing: Closing) -> Wanted {
    let tray = Tray::default();
    let world_from_area = isometry(&Place::at(tray.center_m));
    Wanted {
        hand: Hand::default(),
        closing,
        area: Some(Area {
            camera_from_area: isometry(camera).inverse() * world_from_area,
            half_m: tray.half_m.map(|half| half - 0.004),
        }),
    }
}

/// The tool upright at a grasp.
fn tool(grasp: &Grasp, camera: &Place) -> Isometry3<f64> {
    let world_from_camera = isometry(camera);
    let point = world_from_camera * grasp.point_m;
    let mut jaw = world_from_camera.rotation * grasp.closing;
    jaw.z = 0.0;
    let jaw = jaw.normalize();
    let rotation = Matrix3::from_columns(&[jaw.cross(&Vector3::z()), jaw, Vector3::z()]);
    let rotation = Rotation3::from_matrix_unchecked(rotation);
    Isometry3::from_parts(point.coords.into(), rotation.into())
}

#[test]
fn the_best_grasp_of_a_picture_holds() {
    let mut failed = Vec::new();
    for (order, name, least) in [
        (Order::Separate, "separate", 0.9),
        (Order::Cluttered, "cluttered", 0.8),
    ] {
        let (mut held, mut tried) = (0, 0);
        for seed in 0..12 {
            let count = 5 + usize::try_from(seed % 4).unwrap();
            let cell = cell(order, count, seed);
            let (found, camera) = grasps(&cell, seed);
            let found = found.unwrap_or_else(|reason| panic!("{name} {seed}: {reason}"));
            let tool = place(&tool(&found[0], &camera));
            tried += 1;
            match cell.gripper.close(&cell.scene.bodies, &tool) {
                Grip::Held { .. } => held += 1,
                Grip::Missed(reason) => {
                    failed.push(format!("{name} {seed}: {reason}; {:?}", found[0]))
                }
            }
        }
        println!("{name}: {held} of {tried} first grasps held");
        let rate = f64::from(held) / f64::from(tried);
        assert!(rate >= least, "{name}: {rate}, {failed:#?}");
    }
}

fn with(bodies: Vec<Body>) -> Cell {
    let tray = Tray::default();
    let mut scene = Scene {
        bodies: tray.bodies(),
        ..Scene::default()
    };
    scene.bodies.extend(bodies);
    Cell::new(
        tray,
        scene,
        mcdpr_simulator::camera::Gripper::default(),
        [0.0; 3],
    )
}

#[test]
fn an_empty_tray_and_an_object_wider_than_the_jaws_give_their_reasons() {
    assert_eq!(grasps(&with(vec![]), 1).0, Err(NoGrasp::Empty));
    let mut wide = too_wide().body;
    let [x, y, z] = Tray::default().center_m;
    wide.world_from_body = Place::at([x, y, z + 0.015]);
    let reason = grasps(&with(vec![wide]), 1).0.unwrap_err();
    let NoGrasp::TooWide { narrowest_mm, .. } = reason else {
        panic!("{reason}");
    };
    assert!((60.0..130.0).contains(&narrowest_mm), "{narrowest_mm}");
}

#[test]
fn a_grasp_tells_width_angle_and_place_of_a_block() {
    let [x, y, z] = Tray::default().center_m;
    let turn = 0.5;
    let place = Place::from_rpy([x + 0.02, y - 0.03, z + 0.012], [0.0, 0.0, turn]);
    let mut block = Body::fixed_box("block", [0.03, 0.014, 0.012], place, [0.8, 0.2, 0.2]);
    block.mass_kg = 0.1;
    let (found, camera) = grasps(&with(vec![block]), 4);
    let best = &found.unwrap()[0];
    let tool = tool(best, &camera);
    let jaw = tool.rotation * Vector3::y();
    let across = Vector3::new(-turn.sin(), turn.cos(), 0.0);
    let angle = jaw.dot(&across).abs().min(1.0).acos().to_degrees();
    assert!(angle < 10.0, "{angle} deg");
    assert!((best.width_m - 0.028).abs() < 0.0025, "{}", best.width_m);
    assert!((best.top_m - 0.024).abs() < 0.0015, "{}", best.top_m);
    let off = tool.translation.vector - Vector3::from(place.position_m);
    let across_off = off.dot(&across);
    assert!(across_off.abs() < 1.5e-3, "{across_off}");
    assert!(off.xy().norm() < 0.012, "{off}");
    assert!(best.quality > 0.5 && best.clearance_m > 0.004);
}

#[test]
fn a_thin_rod_ranks_low_and_a_bar_does_not() {
    let [x, y, z] = Tray::default().center_m;
    let best = |radius_m: f64, seed: u64| {
        let part = mcdpr_simulator::camera::Part::plain(
            mcdpr_simulator::camera::Shape::Cylinder {
                radius_m,
                half_m: 0.04,
            },
            Place::default(),
            [0.6; 3],
        );
        // Lying, and high enough for the pads: on its own a rod of 6 mm is too low to be taken.
        let high_m = 0.02;
        let place = Place::from_rpy(
            [x + 0.01, y, z + high_m],
            [0.0, std::f64::consts::FRAC_PI_2, 0.0],
        );
        let rod = Body {
            name: "rod".to_owned(),
            parts: vec![part],
            world_from_body: place,
            mass_kg: 0.05,
        };
        let found = grasps(&with(vec![rod]), seed).0;
        found.map_or(0.0, |found| found[0].quality)
    };
    for seed in 1..=6 {
        let (rod, bar) = (best(0.003, seed), best(0.007, seed));
        assert!(rod < 0.08 && bar > 0.3, "seed {seed}: {rod} {bar}");
    }
}

#[test]
fn jaws_that_can_not_turn_get_grasps_along_their_direction_only() {
    let cell = cell(Order::Separate, 7, 2);
    let (frame, camera) = take(&cell, 2);
    let aligned = align(&frame);
    let along = Vector3::new(0.0, 1.0, 0.0);
    let found = Antipodal::default()
        .detect(&aligned, &wanted(&camera, Closing::Along(along)))
        .unwrap();
    for grasp in found {
        assert!(grasp.closing.dot(&along).abs() > 0.99);
    }
}
