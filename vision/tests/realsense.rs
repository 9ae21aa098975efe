//! The RealSense source with a library that answers according to librealsense2's C interface. Not
//! covered: Intel's own library, and a real camera.

use mcdpr_vision::Source;
use mcdpr_vision::realsense::RealSense;
use std::path::PathBuf;
use std::process::Command;

/// A camera of 4 x 2 px, whose lines are longer than their pixels; handles are small numbers.
const LIBRARY: &str = r#"
#include <stdint.h>
#include <string.h>
#ifndef NO_CAMERA
#define NO_CAMERA 0
#endif
#ifndef OTHER_LENS
#define OTHER_LENS 0
#endif
typedef struct { int width, height; float ppx, ppy, fx, fy; int model; float coeffs[5]; } intrinsics;
typedef struct { float rotation[9], translation[3]; } extrinsics;
static int released, taken;
static uint8_t color[2 * 16];
static uint8_t depth[2 * 12];
static void fail(void **error, const char *why) { *error = (void *)why; }
const char *rs2_get_error_message(void *error) { return error; }
void rs2_free_error(void *error) { (void)error; }
int rs2_get_api_version(void **e) { (void)e; return 25500; }
void *rs2_create_context(int version, void **e) { if (version != 25500) fail(e, "version"); return (void *)1; }
void *rs2_create_pipeline(void *context, void **e) { (void)e; return context == (void *)1 ? (void *)2 : 0; }
void *rs2_create_config(void **e) { (void)e; return (void *)3; }
void rs2_config_enable_stream(void *c, int stream, int index, int w, int h, int format, int rate, void **e) {
  if (c != (void *)3 || index != -1 || rate != 30) fail(e, "arguments");
  if (w != 4 || h != 2) fail(e, "no such size");
  if (!((stream == 1 && format == 1) || (stream == 2 && format == 5))) fail(e, "no such format");
}
void *rs2_pipeline_start_with_config(void *p, void *c, void **e) {
  if (p != (void *)2 || c != (void *)3) fail(e, "handles");
  if (NO_CAMERA) { fail(e, "No device connected"); return 0; }
  return (void *)4;
}
void *rs2_pipeline_wait_for_frames(void *p, unsigned ms, void **e) {
  if (p != (void *)2 || ms != 5000) fail(e, "wait");
  /* All of the pair before was given back: itself and its two pictures. */
  if (released != 3 * taken) fail(e, "frames were not given back");
  taken++;
  for (int y = 0; y < 2; y++) for (int x = 0; x < 4; x++) {
    color[16 * y + 3 * x] = 10 * y + x; color[16 * y + 3 * x + 1] = 100; color[16 * y + 3 * x + 2] = taken;
    uint16_t steps = 500 + 100 * y + x; memcpy(depth + 12 * y + 2 * x, &steps, 2);
  }
  return (void *)5;
}
int rs2_embedded_frames_count(void *f, void **e) { (void)e; return f == (void *)5 ? 2 : 0; }
void *rs2_extract_frame(void *f, int i, void **e) { (void)f; (void)e; return (void *)(intptr_t)(6 + i); }
void *rs2_get_frame_stream_profile(void *f, void **e) { (void)e; return (char *)f + 10; }
void rs2_get_stream_profile_data(void *p, int *stream, int *format, int *n, int *id, int *rate, void **e) {
  (void)e; *n = 0; *id = 1; *rate = 30;
  if (p == (void *)16) { *stream = 1; *format = 1; } else { *stream = 2; *format = 5; }
}
void rs2_get_video_stream_intrinsics(void *p, intrinsics *i, void **e) {
  (void)e;
  intrinsics d = { 4, 2, 1.5f, 0.5f, 3.0f, 3.0f, 4, { 0 } };
  if (p == (void *)17) { d.fx = 3.5f; d.coeffs[0] = 0.1f; }
  if (OTHER_LENS) d.model = 3;
  *i = d;
}
int rs2_get_frame_stride_in_bytes(void *f, void **e) { (void)e; return f == (void *)6 ? 12 : 16; }
int rs2_get_frame_data_size(void *f, void **e) { (void)e; return f == (void *)6 ? 24 : 32; }
const void *rs2_get_frame_data(void *f, void **e) { (void)e; return f == (void *)6 ? depth : color; }
float rs2_depth_frame_get_units(void *f, void **e) { if (f != (void *)6) fail(e, "no depth"); return 0.001f; }
void rs2_get_extrinsics(void *from, void *to, extrinsics *x, void **e) {
  if (from != (void *)16 || to != (void *)17) fail(e, "profiles");
  if (released != 3 * (taken - 1) + 2) fail(e, "the pair of the profiles is gone");
  /* A quarter turn about z, by columns. */
  extrinsics d = { { 0, 1, 0, -1, 0, 0, 0, 0, 1 }, { 0.015f, 0, 0 } };
  *x = d;
}
void rs2_release_frame(void *f) { (void)f; released++; }
void rs2_pipeline_stop(void *p, void **e) { (void)p; (void)e; }
void rs2_delete_pipeline_profile(void *p) { (void)p; }
void rs2_delete_config(void *p) { (void)p; }
void rs2_delete_pipeline(void *p) { (void)p; }
void rs2_delete_context(void *p) { (void)p; }
"#;

/// Compiles the library with these lines in front; each has its own state.
fn library(name: &str, before: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let source = folder.join(format!("{name}.c"));
    std::fs::write(&source, format!("{before}\n{LIBRARY}")).unwrap();
    let built = folder.join(format!("lib{name}.so"));
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    let done = Command::new(compiler)
        .args(["-shared", "-fPIC", "-o"])
        .args([&built, &source])
        .status();
    assert!(done.unwrap().success(), "a C compiler builds the library");
    built
}

fn refusal(library: &std::path::Path, size_px: [usize; 2]) -> String {
    let opened = RealSense::open_with(library.as_os_str(), size_px);
    opened.err().unwrap().to_string()
}

#[test]
fn pictures_lenses_places_and_units_come_through() {
    let library = library("whole", "");
    let mut camera = RealSense::open_with(library.as_os_str(), [4, 2]).unwrap();
    let frame = camera.frame().unwrap();
    // Fifteen pairs went by while its exposure settled.
    assert_eq!(frame.color.row(1)[2], [12, 100, 16]);
    assert_eq!(frame.depth.steps.row(1), [600, 601, 602, 603]);
    assert!((frame.depth.unit_m - 1e-3).abs() < 1e-9);
    let cameras = camera.cameras();
    assert_eq!(cameras.color.size_px, [4, 2]);
    assert_eq!(cameras.color.focal_px, [3.5, 3.0]);
    // The library counts from the first pixel's centre.
    assert_eq!(cameras.depth.center_px, [2.0, 1.0]);
    assert!((cameras.color.distortion[0] - 0.1).abs() < 1e-6);
    let seen = cameras.color_from_depth * nalgebra::Point3::new(1.0, 0.0, 2.0);
    assert!(
        (seen - nalgebra::Point3::new(0.015, 1.0, 2.0)).norm() < 1e-6,
        "{seen}"
    );
    assert_eq!(camera.frame().unwrap().color.row(0)[0], [0, 100, 17]);
}

#[test]
fn what_is_missing_is_reported_in_the_librarys_words() {
    let none = refusal("libnot-there.so".as_ref(), [4, 2]);
    assert!(none.contains("install librealsense2"), "{none}");
    let whole = library("sizes", "");
    let size = refusal(&whole, [640, 480]);
    assert!(
        size.contains("rs2_config_enable_stream: no such size"),
        "{size}"
    );
    let unplugged = library("unplugged", "#define NO_CAMERA 1");
    let unplugged = refusal(&unplugged, [4, 2]);
    assert!(unplugged.contains("No device connected"), "{unplugged}");
    let lens = library("lens", "#define OTHER_LENS 1");
    let lens = refusal(&lens, [4, 2]);
    assert!(lens.contains("distortion model 3"), "{lens}");
}
