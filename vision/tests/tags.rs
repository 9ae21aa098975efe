//! Rendered tags are found again: the simulator's camera and the detector share no code.

use mcdpr_simulator::camera::{Body, Frame, Lens, Light, Optics, Scene, render_color};
use mcdpr_vision::tag::{Detection, Options, detect, pose_of_tag};
use mcdpr_vision::{Camera, GrayImage, RgbImage};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, Vector2, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

const SIZE_M: f64 = 0.1;

fn camera(distortion: [f64; 5]) -> (Camera, Lens) {
    let size_px = [1280, 720];
    let focal_px = [920.0; 2];
    let center_px = [640.0, 360.0];
    (
        Camera {
            size_px,
            focal_px,
            center_px,
            distortion,
        },
        Lens {
            size_px,
            focal_px,
            center_px,
            distortion,
        },
    )
}

fn scene(tags: &[(usize, f64, Frame)]) -> Scene {
    let floor = Frame::at([0.0, 0.0, -0.012]);
    Scene {
        bodies: vec![
            Body::fixed_box("floor", [2.0, 2.0, 0.01], floor, [0.35, 0.33, 0.3]),
            Body::tags(tags, Frame::looking_down([0.0; 3])),
        ],
        light: Light::default(),
    }
}

fn picture(scene: &Scene, lens: &Lens, place: &Frame, seed: u64) -> GrayImage {
    let seen = render_color(scene, lens, place, &Optics::default(), seed);
    RgbImage::new(seen.width, seen.height, seen.pixels)
        .unwrap()
        .to_gray()
}

/// A camera that looks down on the origin from about `height_m`, tilted and shifted at random.
fn random_place(rng: &mut ChaCha8Rng, height_m: f64) -> Frame {
    let mut draw = |half: f64| (f64::from(rng.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0) * half;
    let turn = [
        std::f64::consts::PI + draw(0.3),
        draw(0.3),
        draw(std::f64::consts::PI),
    ];
    let aside = 0.12 * height_m;
    let turned = Frame::from_rpy([0.0; 3], turn);
    // Back along the line of sight from a point near the tag.
    let sight = turned.direction([0.0, 0.0, 1.0]);
    let aim = [draw(aside), draw(aside)];
    Frame {
        position_m: [
            aim[0] - height_m * sight[0],
            aim[1] - height_m * sight[1],
            -height_m * sight[2],
        ],
        ..turned
    }
}

fn true_corners(lens: &Lens, place: &Frame) -> [[f64; 2]; 4] {
    let s = SIZE_M / 2.0;
    let tag = Frame::looking_down([0.0; 3]);
    [(-s, -s), (s, -s), (s, s), (-s, s)].map(|(x, y)| {
        let world = tag.point([x, y, 0.0]);
        lens.pixel(place.point_inside(world)).unwrap()
    })
}

fn isometry(frame: &Frame) -> Isometry3<f64> {
    let rotation = Matrix3::from_fn(|i, j| frame.rotation[i][j]);
    Isometry3::from_parts(
        Translation3::from(Vector3::from(frame.position_m)),
        Rotation3::from_matrix_unchecked(rotation).into(),
    )
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).round() as usize]
}

/// Corner errors (px), pose errors (m, rad) and their sizes in standard deviations over many views.
struct Errors {
    corners_px: Vec<f64>,
    positions_m: Vec<f64>,
    turns_rad: Vec<f64>,
    deviations: Vec<f64>,
}

fn errors(distortion: [f64; 5], height_m: f64, views: u64) -> Errors {
    let (camera, lens) = camera(distortion);
    let scene = scene(&[(7, SIZE_M, Frame::default())]);
    let mut rng = ChaCha8Rng::seed_from_u64(42);
    let mut errors = Errors {
        corners_px: vec![],
        positions_m: vec![],
        turns_rad: vec![],
        deviations: vec![],
    };
    for seed in 0..views {
        let place = random_place(&mut rng, height_m);
        let found = detect(
            &picture(&scene, &lens, &place, seed),
            Some(&camera),
            &Options::default(),
        );
        assert_eq!(found.len(), 1, "view {seed}");
        assert_eq!((found[0].id, found[0].errors), (7, 0), "view {seed}");
        let truth = true_corners(&lens, &place);
        for (corner, truth) in found[0].corners_px.iter().zip(truth) {
            errors
                .corners_px
                .push((corner - Vector2::from(truth)).norm());
        }
        let poses = pose_of_tag(&camera, &found, 7, SIZE_M).unwrap();
        let pose = &poses[0].camera_from_tag;
        let tag = Frame::looking_down([0.0; 3]);
        let truth = isometry(&place.inverse().then(&tag));
        let shift = pose.translation.vector - truth.translation.vector;
        let turn = (pose.rotation * truth.rotation.inverse()).scaled_axis();
        errors.positions_m.push(shift.norm());
        errors.turns_rad.push(turn.norm());
        let deviation = poses[0].covariance.diagonal().map(f64::sqrt);
        for i in 0..3 {
            errors.deviations.push(turn[i].abs() / deviation[i]);
            errors.deviations.push(shift[i].abs() / deviation[i + 3]);
        }
    }
    errors
}

#[test]
fn corners_are_found_to_a_twentieth_of_a_pixel_and_poses_follow() {
    for (name, distortion) in [
        ("no distortion", [0.0; 5]),
        ("distortion", [0.05, -0.08, 0.001, -0.0007, 0.02]),
    ] {
        let mut errors = errors(distortion, 0.6, 24);
        let median = quantile(&mut errors.corners_px, 0.5);
        let worst = quantile(&mut errors.corners_px, 1.0);
        let position = quantile(&mut errors.positions_m, 0.5);
        let turn = quantile(&mut errors.turns_rad, 0.5);
        let spread = quantile(&mut errors.deviations, 0.68);
        println!(
            "{name}: corners {median:.4} px median, {worst:.4} px at most; position \
             {:.3} mm, attitude {:.3} deg median; 68 % within {spread:.2} standard deviations",
            position * 1e3,
            turn.to_degrees()
        );
        assert!(median < 0.05, "{name}: median corner error {median} px");
        assert!(worst < 0.2, "{name}: worst corner error {worst} px");
        assert!(position < 0.3e-3, "{name}: {position} m");
        assert!(turn < 2e-3, "{name}: {turn} rad");
        // The covariance is plausible: neither ten times too small nor too large.
        assert!((0.3..3.0).contains(&spread), "{name}: {spread}");
    }
}

#[test]
fn a_board_is_read_whole_and_its_tags_do_not_mix() {
    let place = |x: f64, y: f64| Frame::at([x, y, 0.0]);
    let tags = [
        (0, 0.04, place(-0.06, -0.03)),
        (1, 0.04, place(0.0, -0.03)),
        (2, 0.04, place(0.06, -0.03)),
        (586, 0.04, place(-0.03, 0.03)),
        (300, 0.04, place(0.03, 0.03)),
    ];
    let (camera, lens) = camera([0.0; 5]);
    let place = Frame::looking_down([0.0, 0.01, 0.5]);
    let found = detect(
        &picture(&scene(&tags), &lens, &place, 3),
        Some(&camera),
        &Options::default(),
    );
    let mut ids: Vec<u32> = found.iter().map(|tag| tag.id).collect();
    ids.sort_unstable();
    assert_eq!(ids, [0, 1, 2, 300, 586]);
}

#[test]
fn a_tag_half_out_of_view_is_not_seen_and_the_reason_says_so() {
    let (camera, lens) = camera([0.0; 5]);
    let scene = scene(&[(7, SIZE_M, Frame::default())]);
    // The tag's middle lies on the picture's left side.
    let place = Frame::looking_down([0.6 * 640.0 / 920.0, 0.0, 0.6]);
    let seen = picture(&scene, &lens, &place, 1);
    let found: Vec<Detection> = detect(&seen, Some(&camera), &Options::default());
    assert_eq!(found, []);
    let reason = pose_of_tag(&camera, &found, 7, SIZE_M)
        .unwrap_err()
        .to_string();
    assert!(
        reason.contains("tag 7 is not wholly in the picture"),
        "{reason}"
    );
}

#[test]
fn a_picture_without_tags_gives_none() {
    let (camera, lens) = camera([0.0; 5]);
    let mut scene = scene(&[]);
    let dark = Frame::from_rpy([0.0, 0.0, 0.02], [0.0, 0.0, 0.4]);
    scene.bodies.push(Body::fixed_box(
        "dark block",
        [0.05, 0.05, 0.02],
        dark,
        [0.02; 3],
    ));
    let place = Frame::looking_down([0.0, 0.0, 0.5]);
    let seen = picture(&scene, &lens, &place, 1);
    assert_eq!(detect(&seen, Some(&camera), &Options::default()), []);
}
