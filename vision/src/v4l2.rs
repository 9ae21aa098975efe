//! Colour pictures from a camera of the Linux kernel (V4L2; feature `v4l2`).
//!
//! Such a camera has no distances: it is for tags, not for picking. It must provide YUYV, which
//! every USB camera does at 640 x 480. Not tested on a device: the machines that test this project
//! have none; the processing of the bytes is tested.

use crate::image::RgbImage;
use crate::source::SourceError;
use linuxvideo::format::{PixFormat, PixelFormat};
use linuxvideo::stream::ReadStream;
use linuxvideo::{BufType, Device};
use std::fmt::Display;
use std::path::Path;

/// An open camera.
pub struct V4l2 {
    name: String,
    stream: ReadStream,
    size_px: [usize; 2],
    bytes_per_line: usize,
}

/// Pictures that are discarded first: exposure settles meanwhile.
const SETTLE: usize = 5;
/// Pictures that may wait in a driver.
const WAITING_MAX: usize = 32;

impl V4l2 {
    /// Opens a device at a picture size and lets its exposure settle.
    ///
    /// # Errors
    /// [`SourceError::Device`] if it is missing, or does not provide YUYV or this size.
    pub fn open(path: &Path, size_px: [usize; 2]) -> Result<Self, SourceError> {
        let name = path.display().to_string();
        let failed = |error: std::io::Error| device(&name, &error);
        let opened = Device::open(path).map_err(failed)?;
        let formats: Vec<_> = opened
            .formats(BufType::VIDEO_CAPTURE)
            .filter_map(Result::ok)
            .map(|format| format.pixel_format())
            .collect();
        if !formats.contains(&PixelFormat::YUYV) {
            return Err(device(
                &name,
                &format!("it gives {formats:?}, and YUYV is needed"),
            ));
        }
        let [width, height] = size_px.map(|size| u32::try_from(size).unwrap_or(u32::MAX));
        let wanted = PixFormat::new(width, height, PixelFormat::YUYV);
        let capture = opened.video_capture(wanted).map_err(failed)?;
        let given = capture.format();
        // A driver answers with the nearest size that it has; the intrinsics belong to one size
        // only.
        if [given.width(), given.height()] != [width, height] {
            return Err(device(
                &name,
                &format!(
                    "it gives {} x {} px where the robot file has {width} x {height}: change \
                     [camera] width and height, and its intrinsics with them",
                    given.width(),
                    given.height()
                ),
            ));
        }
        let bytes_per_line = given.bytes_per_line() as usize;
        let stream = capture.into_stream().map_err(failed)?;
        let mut camera = Self {
            name: name.clone(),
            stream,
            size_px,
            bytes_per_line,
        };
        for _ in 0..SETTLE {
            camera.picture()?;
        }
        Ok(camera)
    }

    /// Its description for users.
    #[must_use]
    pub fn name(&self) -> String {
        format!("V4L2 camera {}", self.name)
    }

    /// The next picture.
    ///
    /// # Errors
    /// [`SourceError::Device`].
    pub fn picture(&mut self) -> Result<RgbImage, SourceError> {
        let bytes = self
            .stream
            .dequeue(|view| Ok(view.to_vec()))
            .map_err(|error| device(&self.name, &error))?;
        rgb_from_yuyv(&bytes, self.size_px, self.bytes_per_line)
            .map_err(|reason| device(&self.name, &reason))
    }

    /// A picture whose exposure began after the call: pictures waiting in the driver are old, and
    /// one may be in progress.
    ///
    /// # Errors
    /// [`SourceError::Device`].
    pub fn newest(&mut self) -> Result<RgbImage, SourceError> {
        for _ in 0..WAITING_MAX {
            let none = self.stream.will_block();
            if none.map_err(|error| device(&self.name, &error))? {
                break;
            }
            self.skip()?;
        }
        self.skip()?;
        self.picture()
    }

    fn skip(&mut self) -> Result<(), SourceError> {
        let skipped = self.stream.dequeue(|_| Ok(()));
        skipped.map_err(|error| device(&self.name, &error))
    }
}

fn device(name: &str, reason: &dyn Display) -> SourceError {
    SourceError::Device {
        name: name.to_owned(),
        reason: reason.to_string(),
    }
}

/// RGB from YUYV (BT.601, limited range): two pixels share their colour.
///
/// # Errors
/// If the bytes are too few for the size, or the width is odd.
pub(crate) fn rgb_from_yuyv(
    bytes: &[u8],
    [width, height]: [usize; 2],
    bytes_per_line: usize,
) -> Result<RgbImage, String> {
    if !width.is_multiple_of(2) || bytes_per_line < 2 * width {
        return Err(format!(
            "lines of {bytes_per_line} bytes hold no {width} px of YUYV"
        ));
    }
    let needed = bytes_per_line * height.saturating_sub(1) + 2 * width;
    if bytes.len() < needed {
        let found = bytes.len();
        return Err(format!("a picture of {found} bytes, {needed} are needed"));
    }
    let mut pixels = Vec::with_capacity(width * height);
    for line in bytes.chunks(bytes_per_line).take(height) {
        for pair in line[..2 * width].chunks_exact(4) {
            let (u, v) = (f64::from(pair[1]) - 128.0, f64::from(pair[3]) - 128.0);
            for luma in [pair[0], pair[2]] {
                // 255 / 219: in the limited range black is 16 and white 235.
                let y = 1.164_384 * (f64::from(luma) - 16.0);
                let rgb = [
                    y + 1.596_027 * v,
                    y - 0.391_762 * u - 0.812_968 * v,
                    y + 2.017_232 * u,
                ];
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "cut to a byte"
                )]
                pixels.push(rgb.map(|value| value.round().clamp(0.0, 255.0) as u8));
            }
        }
    }
    RgbImage::new(width, height, pixels).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn yuyv_gives_white_black_and_the_three_colours() {
        // BT.601's own values of white, black, red, green, blue.
        let colors = [
            ([235, 128, 128], [255, 255, 255]),
            ([16, 128, 128], [0, 0, 0]),
            ([81, 90, 240], [254, 0, 0]),
            ([145, 54, 34], [0, 255, 1]),
            ([41, 240, 110], [0, 0, 255]),
        ];
        for ([y, u, v], wanted) in colors {
            // One line of two pixels, with two bytes of padding.
            let picture = rgb_from_yuyv(&[y, u, y, v, 9, 9], [2, 1], 6).unwrap();
            for pixel in picture.row(0) {
                for (found, wanted) in pixel.iter().zip(wanted) {
                    assert!(found.abs_diff(wanted) <= 1, "{pixel:?} {wanted:?}");
                }
            }
        }
    }

    #[test]
    fn a_cut_picture_and_odd_widths_are_reported() {
        let cut = rgb_from_yuyv(&[0; 7], [2, 2], 4).unwrap_err();
        assert!(cut.contains("7 bytes, 8"), "{cut}");
        assert!(rgb_from_yuyv(&[0; 60], [3, 2], 6).is_err());
        assert!(rgb_from_yuyv(&[0; 60], [4, 2], 6).is_err());
    }

    #[test]
    fn a_device_that_is_not_there_is_reported() {
        let error = V4l2::open(Path::new("/dev/video250"), [640, 480])
            .err()
            .unwrap();
        assert!(error.to_string().contains("/dev/video250"), "{error}");
    }
}
