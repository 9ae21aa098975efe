//! Grasp networks: small ones made here, compared with the same sums computed plainly.
#![cfg(feature = "onnx")]

#[allow(dead_code)]
mod common;
#[path = "common/onnx.rs"]
mod onnx;

use mcdpr_simulator::camera::{Order, Tray};
use mcdpr_vision::grasp::network::{Head, Network, NetworkError, blurred};
use mcdpr_vision::grasp::{Area, Detector, Hand, NoGrasp, Wanted};
use mcdpr_vision::{Aligned, align};
use nalgebra::Isometry3;
use onnx::{Layer, Net};

fn picture(order: Order, count: usize) -> Aligned {
    let cell = common::cell(order, count, 3);
    let (rgbd, place) = common::look();
    align(&common::frame(&rgbd, cell.look(&rgbd, &place, 3)))
}

/// Greatest difference of two maps.
fn apart(one: &[f32], two: &[f32]) -> f32 {
    assert_eq!(one.len(), two.len());
    let pairs = one.iter().zip(two);
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn both_heads_give_what_the_sums_give() {
    let picture = picture(Order::Separate, 6);
    for (head, seed) in [(Head::Affga, 1), (Head::Ggcnn, 2)] {
        let net = Net::drawn(head, seed);
        let network = Network::read(&net.file(), head, "drawn").unwrap();
        let (input, corner) = head.prepare(&picture).unwrap();
        let size = head.size();
        assert_eq!(corner, [(640 - size) / 2, (480 - size) / 2]);

        // Before: every number again from the picture.
        let cells = size * size;
        let raw: Vec<f64> = (0..input.len())
            .map(|at| {
                let (channel, row, column) = (at / cells, at % cells / size, at % size);
                let (x, y) = (corner[0] + column, corner[1] + row);
                match head {
                    Head::Affga => f64::from(picture.color.row(y)[x][channel]) / 255.0,
                    Head::Ggcnn => picture.depth.depth_m(x, y).unwrap_or(f64::NAN),
                }
            })
            .collect();
        let mean: f64 = match head {
            Head::Affga => raw.iter().sum::<f64>() / raw.len() as f64,
            // Filled holes are included in the mean, which shows in the input where there is a
            // distance.
            Head::Ggcnn => {
                let known = raw.iter().position(|value| !value.is_nan()).unwrap();
                raw[known] - f64::from(input[known])
            }
        };
        for (value, raw) in input.iter().zip(&raw) {
            assert!(value.is_finite());
            assert!(raw.is_nan() || (f64::from(*value) - (raw - mean)).abs() < 1e-5);
        }
        let rest: f64 = input.iter().map(|v| f64::from(*v)).sum::<f64>() / input.len() as f64;
        assert!(rest.abs() < 1e-4, "{rest}");

        // Between: the network.
        let outputs = net.outputs(&input);
        let maps = network.run(&input).unwrap();
        assert!(apart(&maps.quality, &outputs[0]) < 1e-4);
        let (width, factor) = match head {
            Head::Affga => (&outputs[2], 200.0),
            Head::Ggcnn => (&outputs[3], 150.0),
        };
        let width: Vec<f32> = width.iter().map(|value| value * factor).collect();
        assert!(apart(&maps.width_px, &width) < 2e-2);

        // After: angles. Two classes that differ by rounding may change places.
        let mut other = 0;
        for at in 0..cells {
            let angle = f64::from(maps.angle_rad[at]);
            let wanted = match head {
                Head::Affga => {
                    let of = |class: usize| outputs[1][class * cells + at];
                    let best = (0..120).max_by(|a, b| of(*a).total_cmp(&of(*b))).unwrap();
                    best as f64 * 3.0_f64.to_radians()
                }
                Head::Ggcnn => 0.5 * f64::from(outputs[2][at]).atan2(f64::from(outputs[1][at])),
            };
            other += usize::from((angle - wanted).abs() > 1e-3);
        }
        assert!(other < cells / 1000, "{other} of {cells} angles");
    }
}

#[test]
fn smoothing_is_a_gaussian_and_peaks_are_its_maxima() {
    let size = 41;
    let mut map = vec![0.0; size * size];
    map[20 * size + 20] = 1.0;
    let smooth = blurred(&map, size, 2.0);
    for (y, x) in [(20, 20), (20, 23), (17, 22)] {
        let r2 = (y as f64 - 20.0).powi(2) + (x as f64 - 20.0).powi(2);
        let wanted = (-r2 / 8.0).exp() / (8.0 * std::f64::consts::PI);
        let found = f64::from(smooth[y * size + x]);
        assert!((found - wanted).abs() < 1e-4, "{found} {wanted}");
    }
    // A constant map stays constant, up to the border.
    let same = blurred(&vec![0.7; size * size], size, 1.0);
    assert!(apart(&same, &vec![0.7; size * size]) < 1e-6);
}

/// Quality grows with height over the mean of the picture, jaws close along x, width is 30 px: a
/// network that is known to choose the highest object.
fn highest() -> Net {
    let layer = |from: usize, side: usize, weights: Vec<f32>, bias: f32| Layer {
        from,
        to: weights.len() / (from * side * side),
        side,
        bias: vec![bias; weights.len() / (from * side * side)],
        weights,
    };
    let mut first = vec![0.0; 9];
    first[4] = -20.0;
    Net {
        first: layer(1, 3, first, 0.0),
        last: vec![
            layer(1, 1, vec![1.0], 0.0),
            layer(1, 1, vec![0.0], 1.0),
            layer(1, 1, vec![0.0], 0.0),
            layer(1, 1, vec![0.0], 0.2),
        ],
        sigmoid: false,
        input: Head::Ggcnn.input(),
    }
}

#[test]
fn a_network_that_likes_heights_grasps_what_stands_there() {
    let mut network = Network::read(&highest().file(), Head::Ggcnn, "highest").unwrap();
    let wanted = Wanted::anywhere(Hand::default());
    let seen = picture(Order::Separate, 6);
    let grasps = network.detect(&seen, &wanted).unwrap();
    assert!(!grasps.is_empty());
    for pair in grasps.windows(2) {
        assert!(pair[0].quality >= pair[1].quality);
    }
    for grasp in &grasps {
        assert!(grasp.top_m > 0.008, "{grasp:?}");
        assert!(grasp.closing.x.abs() > 0.98, "{grasp:?}");
        let distance = grasp.point_m.coords.z;
        let wide_m = 30.0 * distance / 613.3;
        assert!((grasp.width_m - wide_m).abs() < 0.1 * wide_m, "{grasp:?}");
        // The tool point lies below the pixel that was chosen, at most as deep as fingers go.
        let back = seen.camera.project(&grasp.point_m).unwrap();
        assert!((back - grasp.pixel).norm() < 15.0, "{grasp:?}");
    }
    let empty = picture(Order::Separate, 0);
    // Within the tray's walls, which stand over the ground themselves.
    let tray = Tray::default();
    let [x, y, z] = tray.center_m;
    let (_, place) = common::look();
    let within = Wanted {
        area: Some(Area {
            camera_from_area: common::isometry(&place).inverse() * Isometry3::translation(x, y, z),
            half_m: tray.half_m.map(|half| half - 0.006),
        }),
        ..wanted
    };
    assert_eq!(network.detect(&empty, &within), Err(NoGrasp::Empty));
    // Jaws that open 18 mm do not take a grasp of 30 px.
    let hand = Hand {
        opening_m: 0.018,
        ..Hand::default()
    };
    let narrow = network.detect(&seen, &Wanted::anywhere(hand));
    assert!(matches!(narrow, Err(NoGrasp::TooWide { .. })), "{narrow:?}");
}

#[test]
fn other_heads_shapes_and_files_are_reported() {
    let affga = Net::drawn(Head::Affga, 1);
    let error = Network::read(&affga.file(), Head::Ggcnn, "net.onnx").unwrap_err();
    let NetworkError::Count {
        found: 3,
        wanted: 4,
        ..
    } = error
    else {
        panic!("{error}");
    };
    assert!(error.to_string().contains("3 outputs"), "{error}");

    let mut small = Net::drawn(Head::Ggcnn, 1);
    small.input = [1, 1, 224, 224];
    let error = Network::read(&small.file(), Head::Ggcnn, "net.onnx").unwrap_err();
    assert!(error.to_string().contains("224"), "{error}");

    let mut classes = affga.clone();
    classes.last[1] = affga.last[0].clone();
    let error = Network::read(&classes.file(), Head::Affga, "net.onnx").unwrap_err();
    assert!(matches!(error, NetworkError::Shape { .. }), "{error}");
    assert!(error.to_string().contains("output 2"), "{error}");

    let error = Network::read(b"no network at all", Head::Affga, "net.onnx").unwrap_err();
    assert!(matches!(error, NetworkError::Unreadable { .. }), "{error}");
    let path = std::path::Path::new("not/there.onnx");
    let error = Network::load(path, Head::Affga).unwrap_err();
    assert!(error.to_string().contains("not/there.onnx"), "{error}");
}

#[test]
fn numbers_that_a_head_can_not_give_are_reported() {
    let mut net = Net::drawn(Head::Affga, 1);
    net.sigmoid = false;
    net.last[0].bias = vec![5.0];
    let network = Network::read(&net.file(), Head::Affga, "net.onnx").unwrap();
    let (input, _) = Head::Affga.prepare(&picture(Order::Separate, 2)).unwrap();
    let NoGrasp::Network(reason) = network.run(&input).unwrap_err() else {
        panic!("no reason");
    };
    assert!(reason.contains("sigmoid"), "{reason}");
}

#[test]
fn names_of_heads_are_those_of_the_command_line() {
    for head in [Head::Affga, Head::Ggcnn] {
        assert_eq!(Head::of(head.name()), Some(head));
    }
    assert_eq!(Head::of("yolo"), None);
}
