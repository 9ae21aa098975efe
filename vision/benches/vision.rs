//! Speed of the steps that a robot waits for: tags at 1280 x 720, grasps at 640 x 480, one core.

#[path = "../tests/common/mod.rs"]
#[allow(dead_code)]
mod common;

use criterion::{Criterion, criterion_group, criterion_main};
use mcdpr_simulator::camera::{Body, Frame as Place, Lens, Optics, Order, Scene, render_color};
use mcdpr_vision::grasp::{Antipodal, Detector, Hand, Wanted};
use mcdpr_vision::tag::{Options, detect, pose_of_tag};
use mcdpr_vision::{RgbImage, align};
use std::hint::black_box;

fn tags(criterion: &mut Criterion) {
    let lens = Lens {
        size_px: [1280, 720],
        focal_px: [920.0; 2],
        center_px: [640.0, 360.0],
        distortion: [0.0; 5],
    };
    let scene = Scene {
        bodies: vec![
            Body::fixed_box(
                "floor",
                [2.0, 2.0, 0.01],
                Place::at([0.0, 0.0, -0.012]),
                [0.4; 3],
            ),
            Body::tag(7, 0.1, Place::looking_down([0.0; 3])),
        ],
        ..Scene::default()
    };
    let place = Place::from_rpy([0.02, 0.05, 0.6], [std::f64::consts::PI - 0.1, 0.05, 0.4]);
    let seen = render_color(&scene, &lens, &place, &Optics::default(), 1);
    let picture = RgbImage::new(1280, 720, seen.pixels).unwrap().to_gray();
    let camera = common::camera(&lens);
    criterion.bench_function("tag pose at 1280 x 720", |bencher| {
        bencher.iter(|| {
            let found = detect(black_box(&picture), Some(&camera), &Options::default());
            pose_of_tag(&camera, &found, 7, 0.1).unwrap()
        });
    });
}

fn grasps(criterion: &mut Criterion) {
    let cell = common::cell(Order::Separate, 7, 3);
    let (rgbd, place) = common::look();
    let frame = common::frame(&rgbd, cell.look(&rgbd, &place, 3));
    criterion.bench_function("depth into colour at 640 x 480", |bencher| {
        bencher.iter(|| align(black_box(&frame)));
    });
    let aligned = align(&frame);
    let wanted = Wanted::anywhere(Hand::default());
    criterion.bench_function("grasps at 640 x 480", |bencher| {
        bencher.iter(|| {
            Antipodal::default()
                .detect(black_box(&aligned), &wanted)
                .unwrap()
        });
    });
}

criterion_group!(benches, tags, grasps);
criterion_main!(benches);
