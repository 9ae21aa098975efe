//! Recorded folders: written pictures are read again, and errors are reported.

use mcdpr_vision::recorded::{Recorded, Recording, read_color, write_color, write_depth};
use mcdpr_vision::{Camera, Cameras, DepthImage, Frame, Image, RgbImage, Source};
use nalgebra::{Isometry3, Vector3};
use std::path::{Path, PathBuf};

fn camera(width: usize, height: usize) -> Camera {
    Camera {
        size_px: [width, height],
        focal_px: [600.0, 601.0],
        center_px: [width as f64 / 2.0, height as f64 / 2.0],
        distortion: [0.01, 0.0, 0.0, 0.0, 0.0],
    }
}

fn frame() -> Frame {
    let color = (0..32 * 24).map(|i| [u8::try_from(i % 256).unwrap(), 7, 250]);
    let steps = (0..16 * 12).map(|i| if i % 5 == 0 { 0 } else { 4000 + i });
    Frame {
        color: RgbImage::new(32, 24, color.collect()).unwrap(),
        depth: DepthImage {
            steps: Image::new(16, 12, steps.collect()).unwrap(),
            unit_m: 1e-4,
        },
        cameras: Cameras {
            color: camera(32, 24),
            depth: camera(16, 12),
            color_from_depth: Isometry3::new(
                Vector3::new(0.015, 0.0, 0.0),
                Vector3::new(0.01, -0.02, 0.0),
            ),
        },
    }
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    folder
}

fn written(name: &str) -> PathBuf {
    let folder = folder(name);
    let frame = frame();
    let mut recording = Recording::create(&folder, &frame.cameras, 1e-4).unwrap();
    recording.add(&frame).unwrap();
    recording.add(&frame).unwrap();
    folder
}

fn reason(folder: &Path) -> String {
    match Recorded::open(folder) {
        Err(error) => error.to_string(),
        Ok(mut recorded) => recorded.frame().unwrap_err().to_string(),
    }
}

#[test]
fn a_recorded_folder_reads_as_the_camera_that_filled_it() {
    let folder = written("whole");
    let mut recorded = Recorded::open(&folder).unwrap();
    assert_eq!(recorded.count(), 2);
    for _ in 0..2 {
        let back = recorded.frame().unwrap();
        assert_eq!(back.color, frame().color);
        assert_eq!(back.depth, frame().depth);
        let (a, b) = (
            back.cameras.color_from_depth,
            frame().cameras.color_from_depth,
        );
        assert!((a.to_homogeneous() - b.to_homogeneous()).norm() < 1e-12);
    }
    let end = recorded.frame().unwrap_err().to_string();
    assert!(end.contains("no more pictures: 2 were read"), "{end}");
}

#[test]
fn missing_intrinsics_are_reported() {
    let folder = written("no_intrinsics");
    std::fs::remove_file(folder.join("intrinsics.json")).unwrap();
    let reason = reason(&folder);
    assert!(reason.contains("intrinsics.json"), "{reason}");
    assert!(reason.contains("camera record"), "{reason}");
}

#[test]
fn pictures_of_another_size_are_reported() {
    let folder = written("size");
    write_color(
        &folder.join("color_0001.png"),
        &RgbImage::filled(8, 6, [0; 3]),
    )
    .unwrap();
    let reason = reason(&folder);
    assert!(reason.contains("colour picture is 8 x 6 px"), "{reason}");
    assert!(reason.contains("for 32 x 24 px"), "{reason}");
}

#[test]
fn a_wrong_depth_unit_is_reported() {
    let folder = written("unit");
    let path = folder.join("intrinsics.json");
    let text = std::fs::read_to_string(&path).unwrap();
    let wrong = text.replace("\"depth_unit_m\": 0.0001", "\"depth_unit_m\": 0.01");
    assert_ne!(wrong, text);
    std::fs::write(&path, wrong).unwrap();
    let unlikely = reason(&folder);
    assert!(
        unlikely.contains("is the depth unit 0.01 m right?"),
        "{unlikely}"
    );
    let wrong = text.replace("\"depth_unit_m\": 0.0001", "\"depth_unit_m\": 1.0");
    std::fs::write(&path, wrong).unwrap();
    let refused = reason(&folder);
    assert!(refused.contains("depth_unit_m is 1"), "{refused}");
}

#[test]
fn an_empty_depth_picture_is_reported() {
    let folder = written("zero");
    write_depth(&folder.join("depth_0001.png"), &Image::filled(16, 12, 0)).unwrap();
    let reason = reason(&folder);
    assert!(reason.contains("holds no distance at all"), "{reason}");
}

#[test]
fn depth_with_eight_bits_and_unknown_keys_are_reported() {
    let folder = written("bits");
    let color = std::fs::read(folder.join("color_0001.png")).unwrap();
    std::fs::write(folder.join("depth_0001.png"), color).unwrap();
    let bits = reason(&folder);
    assert!(bits.contains("must be 16-bit grey"), "{bits}");
    let path = folder.join("intrinsics.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("focal_px", "focal")).unwrap();
    let key = reason(&folder);
    assert!(key.contains("unknown field `focal`"), "{key}");
    std::fs::write(folder.join("color_0001.png"), b"no picture").unwrap();
    assert!(read_color(&folder.join("color_0001.png")).is_err());
}

/// A file of a hundred bytes that states 2.7 GB: the size is checked before memory is allocated.
#[test]
fn a_picture_that_would_fill_the_memory_is_refused_by_its_size() {
    let folder = written("huge");
    let path = folder.join("color_0001.png");
    let mut encoder = png::Encoder::new(std::fs::File::create(&path).unwrap(), 30_000, 30_000);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().unwrap();
    // The beginning of a compressed stream, without data.
    writer.write_chunk(png::chunk::IDAT, &[0x78, 0x9C]).unwrap();
    drop(writer);
    assert!(std::fs::metadata(&path).unwrap().len() < 200);
    let error = read_color(&path).unwrap_err().to_string();
    assert!(
        error.contains("30000 x 30000 px") && error.contains("at most"),
        "{error}"
    );
    let reason = reason(&folder);
    assert!(reason.contains("30000 x 30000 px"), "{reason}");
}

#[test]
#[cfg(unix)]
fn a_named_pipe_in_place_of_a_picture_keeps_nobody_waiting() {
    let folder = written("pipe");
    let path = folder.join("color_0001.png");
    std::fs::remove_file(&path).unwrap();
    let made = std::process::Command::new("mkfifo").arg(&path).status();
    assert!(made.unwrap().success());
    let error = read_color(&path).unwrap_err().to_string();
    assert!(error.contains("it is not a file"), "{error}");
}
