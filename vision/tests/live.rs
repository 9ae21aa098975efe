//! Live folders: the reader accepts complete pictures taken after its request, and reports what is
//! missing.

use mcdpr_vision::live::{LiveFolder, LiveWriter, WANTED, now_s};
use mcdpr_vision::{Camera, Cameras, DepthImage, Image, RgbImage, Source};
use nalgebra::Isometry3;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

fn camera() -> Camera {
    Camera {
        size_px: [16, 12],
        focal_px: [20.0; 2],
        center_px: [8.0, 6.0],
        distortion: [0.0; 5],
    }
}

fn cameras() -> Cameras {
    Cameras {
        color: camera(),
        depth: camera(),
        color_from_depth: Isometry3::identity(),
    }
}

fn color(value: u8) -> RgbImage {
    RgbImage::filled(16, 12, [value; 3])
}

fn depth() -> DepthImage {
    DepthImage {
        steps: Image::filled(16, 12, 4000),
        unit_m: 1e-4,
    }
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("live-{name}"));
    let _ = std::fs::remove_dir_all(&folder);
    folder
}

/// Runs a camera beside a reader: `answer` gets each request with its number.
fn beside<T>(
    writer: &mut LiveWriter,
    mut answer: impl FnMut(&mut LiveWriter, u64) + Send,
    read: impl FnOnce() -> T,
) -> T {
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut count = 0;
            while !over.load(Ordering::Relaxed) {
                if writer.is_wanted() {
                    count += 1;
                    answer(writer, count);
                }
                std::thread::yield_now();
            }
        });
        let out = read();
        over.store(true, Ordering::Relaxed);
        out
    })
}

#[test]
fn each_picture_is_one_that_was_taken_after_it_was_asked_for() {
    let path = folder("fresh");
    let mut writer = LiveWriter::create(&path, &cameras(), 1e-4).unwrap();
    // Older pictures do not count.
    writer.add(now_s(), &color(1), Some(&depth())).unwrap();
    let mut reader = LiveFolder::open(&path).unwrap();
    let answer = |writer: &mut LiveWriter, count: u64| {
        // One whose exposure began too early, then the one that was asked for.
        let value = 10 * u8::try_from(count).unwrap();
        writer
            .add(now_s() - 5.0, &color(value), Some(&depth()))
            .unwrap();
        writer
            .add(now_s(), &color(value + 1), Some(&depth()))
            .unwrap();
    };
    let seen = beside(&mut writer, answer, || {
        let first = reader.frame().unwrap();
        assert_eq!(first.depth, depth());
        [
            first.color,
            reader.color().unwrap(),
            reader.frame().unwrap().color,
        ]
    });
    assert_eq!(seen, [color(11), color(21), color(31)]);
    // Seven were written; the oldest went.
    let left = std::fs::read_dir(&path).unwrap().count();
    assert_eq!(left, 4 * 3 + 2, "intrinsics and the request stay");
}

#[test]
fn a_picture_counts_when_its_frame_file_is_there() {
    let path = folder("whole");
    let mut writer = LiveWriter::create(&path, &cameras(), 1e-4).unwrap();
    let mut reader = LiveFolder::open(&path)
        .unwrap()
        .patient(Duration::from_millis(60));
    let half = |_: &mut LiveWriter, _| {
        // Pictures, and a frame file that is being written under another name.
        mcdpr_vision::recorded::write_color(&path.join("color_0001.png"), &color(1)).unwrap();
        std::fs::write(path.join("frame_0001.part"), "{\"taken_s\"").unwrap();
    };
    let error = beside(&mut writer, half, || reader.color().unwrap_err());
    let words = error.to_string();
    assert!(
        words.contains("no new picture within") && words.contains("no frame file"),
        "{words}"
    );
    assert!(path.join(WANTED).is_file());
}

#[test]
fn what_is_missing_or_wrong_is_reported() {
    let path = folder("wrong");
    let none = LiveFolder::open(&path).unwrap_err().to_string();
    assert!(none.contains("there is no such folder"), "{none}");
    std::fs::create_dir_all(&path).unwrap();
    let none = LiveFolder::open(&path).unwrap_err().to_string();
    assert!(none.contains("intrinsics.json"), "{none}");
    let mut writer = LiveWriter::create(&path, &cameras(), 1e-4).unwrap();
    let mut reader = LiveFolder::open(&path)
        .unwrap()
        .patient(Duration::from_secs(60));
    let mut said = |answer: &(dyn Fn(&mut LiveWriter) + Sync)| {
        let error = beside(
            &mut writer,
            |writer, _| answer(writer),
            || reader.frame().unwrap_err(),
        );
        error.to_string()
    };
    let words = said(&|writer| writer.add(now_s(), &color(1), None).unwrap());
    assert!(words.contains("depth_0001.png"), "{words}");
    let small = RgbImage::filled(8, 6, [1; 3]);
    let words = said(&|writer| writer.add(now_s(), &small, Some(&depth())).unwrap());
    assert!(
        words.contains("8 x 6") && words.contains("16 x 12"),
        "{words}"
    );
    let words = said(&|writer| {
        writer
            .add(now_s() + 3600.0, &color(1), Some(&depth()))
            .unwrap()
    });
    assert!(words.contains("ahead of this machine's clock"), "{words}");
    let torn = |_: &mut LiveWriter| std::fs::write(path.join("frame_0009.json"), "{}").unwrap();
    let words = said(&torn);
    assert!(words.contains("taken_s"), "{words}");
}

#[test]
fn a_camera_that_has_stopped_is_reported_with_the_age_of_its_last_picture() {
    let path = folder("stopped");
    let mut writer = LiveWriter::create(&path, &cameras(), 1e-4).unwrap();
    writer
        .add(now_s() - 90.0, &color(1), Some(&depth()))
        .unwrap();
    let mut reader = LiveFolder::open(&path)
        .unwrap()
        .patient(Duration::from_millis(20));
    let words = reader.frame().unwrap_err().to_string();
    assert!(words.contains("number 1, taken 90."), "{words}");
}

#[test]
fn recorded_pictures_are_not_deleted_and_an_earlier_writers_are() {
    let path = folder("recorded");
    std::fs::create_dir_all(&path).unwrap();
    let (kept, intrinsics) = (path.join("color_0001.png"), path.join("intrinsics.json"));
    std::fs::write(&kept, "a picture of the user's").unwrap();
    std::fs::write(&intrinsics, "its camera").unwrap();
    let refused = LiveWriter::create(&path, &cameras(), 1e-4).unwrap_err();
    assert!(
        refused.to_string().contains("would be deleted"),
        "{refused}"
    );
    assert!(kept.is_file());
    assert_eq!(std::fs::read_to_string(&intrinsics).unwrap(), "its camera");
    // A reader has asked there before: a live folder, whose writer was killed between two files.
    std::fs::write(path.join(WANTED), "1.0\n").unwrap();
    LiveWriter::create(&path, &cameras(), 1e-4).unwrap();
    assert!(!kept.exists());
}
