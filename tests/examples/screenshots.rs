//! The pictures of the documents: the page of a simulated robot in a real browser. `cargo xtask screenshots` runs it
//! with the folder of the pictures.

#[path = "../tests/browser/mod.rs"]
mod browser;

use browser::{Browser, Page, Serve};
use mcdpr_tests::mcdpr;
use mcdpr_tests::process::Folder;
use std::path::{Path, PathBuf};
use std::time::Duration;

const PATIENCE: Duration = Duration::from_secs(120);
/// Most bytes of a picture: documents are read over slow lines, too.
const MOST_BYTES: usize = 200_000;

fn main() {
    let out = std::env::args().nth(1).map(PathBuf::from);
    let out = std::path::absolute(out.expect("which folder?")).unwrap();
    std::fs::create_dir_all(&out).unwrap();
    let folder = Folder::new("screenshots");
    for (task, name) in [
        ("paper:table8", "2026-01-01-line"),
        ("paper:table7", "2026-01-02-circle"),
    ] {
        let record = format!("runs/{name}");
        let words = ["run", task, "--record", &record];
        let done = mcdpr()
            .args(words)
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert!(
            done.status.success(),
            "{}",
            String::from_utf8_lossy(&done.stderr)
        );
    }
    let serve = Serve::start_in(folder.path(), &["--idle"]);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    page.look([1400, 900], 1.0, false);
    page.wait("mcdpr.may && mcdpr.live && mcdpr.live.pose", PATIENCE);
    page.run("document.getElementById('see-currents').click()");
    page.run("document.getElementById('see-path').click()");
    page.run("mcdpr.send({ order: 'start' })");
    for (name, size, scale, dark) in [
        ("page-light", [1400, 900], 1.0, false),
        ("page-dark", [1400, 900], 1.0, true),
        ("page-tablet", [820, 1180], 1.0, false),
        ("page-phone", [390, 844], 1.5, false),
    ] {
        page.look(size, scale, dark);
        // In the middle of its circle, which the simulated robot repeats.
        let moving =
            "mcdpr.live.state === 'Moving' && mcdpr.live.path_s > 5 && mcdpr.live.path_s < 8";
        page.wait(moving, PATIENCE);
        save(&mut page, &out, name);
    }
    page.press("Escape");
    page.wait(
        "!['Arming', 'Moving', 'Stopping'].includes(mcdpr.live.state)",
        PATIENCE,
    );
    page.look([1400, 1100], 1.0, false);
    page.click("#tab-runs");
    page.wait(
        "document.getElementById('run-list').options.length >= 2",
        PATIENCE,
    );
    page.fill("run-list", "2026-01-02-circle");
    page.click("#run-show");
    page.wait(
        "Scene.past && mcdpr.runCharts.data && !mcdpr.runCharts.busy",
        PATIENCE,
    );
    page.fill("run-time", "8");
    page.run("window.scrollTo(0, 0)");
    save(&mut page, &out, "runs");
    page.click("#run-leave");
    page.look([1400, 900], 1.0, false);
    page.click("#tab-robot");
    page.wait("mcdpr.robotFile.file", PATIENCE);
    page.run("document.getElementById('robot-all').open = true");
    page.run("window.scrollTo(0, 0)");
    save(&mut page, &out, "robot");
}

/// Writes a picture of the page when what was changed has been drawn.
fn save(page: &mut Page, folder: &Path, name: &str) {
    // The second picture of the page after now has the new sizes and colours.
    page.run("window.drawn = 0; requestAnimationFrame(function next() { if (++window.drawn < 12) requestAnimationFrame(next); })");
    page.wait("window.drawn >= 12", PATIENCE);
    let bytes = decoded(&page.screenshot());
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
        .read_info()
        .unwrap();
    let mut colors = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut colors).unwrap();
    colors.truncate(info.buffer_size());
    let mut small = encoded(&info, &colors);
    // Fewer colours, until it is small enough.
    for bits in [2, 3, 4] {
        if small.len() <= MOST_BYTES {
            break;
        }
        let keep = 0xff_u8 << bits;
        colors
            .iter_mut()
            .for_each(|value| *value = (*value & keep) | (*value >> (8 - bits)));
        small = encoded(&info, &colors);
    }
    assert!(small.len() <= MOST_BYTES, "{name}: {} bytes", small.len());
    std::fs::write(folder.join(format!("{name}.png")), &small).unwrap();
    println!(
        "{name}.png: {} x {}, {} kB",
        info.width,
        info.height,
        small.len() / 1000
    );
}

fn encoded(info: &png::OutputInfo, colors: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, info.width, info.height);
    encoder.set_color(info.color_type);
    encoder.set_depth(info.bit_depth);
    encoder.set_compression(png::Compression::High);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(colors).unwrap();
    writer.finish().unwrap();
    bytes
}

/// Bytes of text in base64.
fn decoded(text: &str) -> Vec<u8> {
    const DIGITS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let (mut bytes, mut held, mut bits) = (Vec::new(), 0_u32, 0);
    for digit in text.bytes().filter(|digit| *digit != b'=') {
        let value = DIGITS.iter().position(|known| *known == digit).unwrap();
        held = held << 6 | u32::try_from(value).unwrap();
        bits += 6;
        if bits >= 8 {
            bits -= 8;
            bytes.push(u8::try_from(held >> bits & 0xff).unwrap());
        }
    }
    bytes
}
