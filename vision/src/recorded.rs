//! Recorded folders: pictures as PNG files with their cameras' numbers.
//!
//! ```text
//! intrinsics.json     the two cameras, color_from_depth, depth_unit_m
//! color_0001.png      8-bit RGB
//! depth_0001.png      16-bit grey: distance along z in depth units, 0 where nothing was measured
//! color_0002.png ...
//! ```

use crate::frame::{Cameras, CamerasFile, Frame};
use crate::image::{DepthImage, Image, RgbImage};
use crate::source::{Source, SourceError};
use std::fs::File;
use std::io::{BufReader, BufWriter};
use std::path::{Path, PathBuf};

const INTRINSICS: &str = "intrinsics.json";

/// A folder that is read picture by picture.
#[derive(Debug)]
pub struct Recorded {
    folder: PathBuf,
    intrinsics: Intrinsics,
    read: u64,
}

/// Content of a folder's `intrinsics.json`.
#[derive(Debug)]
pub(crate) struct Intrinsics {
    pub cameras: Cameras,
    /// One step of the depth pictures, m.
    pub depth_unit_m: f64,
}

impl Intrinsics {
    pub(crate) fn read(folder: &Path) -> Result<Self, SourceError> {
        let path = folder.join(INTRINSICS);
        let text = crate::input::read_text(&path).map_err(|error| SourceError::Unreadable {
            path: path.clone(),
            reason: format!(
                "{error}; a folder of pictures needs it, `mcdpr camera record` writes it"
            ),
        })?;
        let malformed = |what: String| SourceError::Malformed {
            path: path.clone(),
            what,
        };
        let file: CamerasFile =
            serde_json::from_str(&text).map_err(|error| malformed(error.to_string()))?;
        Ok(Self {
            cameras: file.cameras().map_err(malformed)?,
            depth_unit_m: file.depth_unit_m,
        })
    }
}

impl Recorded {
    /// Opens a folder.
    ///
    /// # Errors
    /// Missing or malformed intrinsics.
    pub fn open(folder: &Path) -> Result<Self, SourceError> {
        Ok(Self {
            folder: folder.to_owned(),
            intrinsics: Intrinsics::read(folder)?,
            read: 0,
        })
    }

    /// Number of pictures in the folder.
    #[must_use]
    pub fn count(&self) -> usize {
        (1..)
            .take_while(|number| picture_path(&self.folder, "color", *number).is_file())
            .count()
    }
}

impl Source for Recorded {
    fn name(&self) -> String {
        format!("folder {}", self.folder.display())
    }

    fn cameras(&self) -> Cameras {
        self.intrinsics.cameras
    }

    fn frame(&mut self) -> Result<Frame, SourceError> {
        let number = self.read + 1;
        let color_path = picture_path(&self.folder, "color", number);
        if !color_path.is_file() {
            return Err(SourceError::End {
                path: self.folder.clone(),
                count: usize::try_from(self.read).unwrap_or(usize::MAX),
            });
        }
        let color = read_color(&color_path)?;
        let steps = read_depth(&picture_path(&self.folder, "depth", number))?;
        let frame = Frame {
            color,
            depth: DepthImage {
                steps,
                unit_m: self.intrinsics.depth_unit_m,
            },
            cameras: self.intrinsics.cameras,
        };
        // Counted even if it cannot be used: the next call goes on behind it.
        self.read = number;
        frame.checked().map_err(|reason| SourceError::Frame {
            name: self.name(),
            number: usize::try_from(number).unwrap_or(usize::MAX),
            reason,
        })
    }
}

/// A folder that is being written.
#[derive(Debug)]
pub struct Recording {
    folder: PathBuf,
    written: u64,
}

impl Recording {
    /// Makes the folder and writes the cameras.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(
        folder: &Path,
        cameras: &Cameras,
        depth_unit_m: f64,
    ) -> Result<Self, SourceError> {
        write_intrinsics(folder, cameras, depth_unit_m)?;
        Ok(Self {
            folder: folder.to_owned(),
            written: 0,
        })
    }

    /// Adds a pair of pictures.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn add(&mut self, frame: &Frame) -> Result<(), SourceError> {
        let number = self.written + 1;
        write_color(&picture_path(&self.folder, "color", number), &frame.color)?;
        write_depth(
            &picture_path(&self.folder, "depth", number),
            &frame.depth.steps,
        )?;
        self.written = number;
        Ok(())
    }
}

/// Makes a folder and writes its `intrinsics.json`.
pub(crate) fn write_intrinsics(
    folder: &Path,
    cameras: &Cameras,
    depth_unit_m: f64,
) -> Result<(), SourceError> {
    let path = folder.join(INTRINSICS);
    let text = serde_json::to_string_pretty(&CamerasFile::new(cameras, depth_unit_m))
        .map_err(|error| unwritable(&path, error))?;
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(&path, text + "\n"))
        .map_err(|error| unwritable(&path, error))
}

pub(crate) fn picture_path(folder: &Path, kind: &str, number: u64) -> PathBuf {
    folder.join(format!("{kind}_{number:04}.png"))
}

pub(crate) fn unwritable(path: &Path, error: impl std::fmt::Display) -> SourceError {
    SourceError::Unwritable {
        path: path.to_owned(),
        reason: error.to_string(),
    }
}

/// Most pixels of a picture: more than any camera of a robot gives, and in memory at most 400 MB.
const MOST_PIXELS: u64 = 50_000_000;

/// Pixels of a PNG file with its width, height and form, which must be one of those wanted. A file
/// states its size before its pixels, and a small file can state any size: both are checked before
/// memory is allocated.
fn read_png(
    path: &Path,
    what: &str,
    wanted: &[(png::ColorType, png::BitDepth)],
) -> Result<(Vec<u8>, png::OutputInfo), SourceError> {
    let unreadable = |reason: String| SourceError::Unreadable {
        path: path.to_owned(),
        reason,
    };
    let file = crate::input::open(path).map_err(|error| unreadable(error.to_string()))?;
    let decoder = png::Decoder::new(BufReader::new(file));
    let mut reader = decoder
        .read_info()
        .map_err(|error| unreadable(error.to_string()))?;
    let header = reader.info();
    let pixels = u64::from(header.width) * u64::from(header.height);
    if pixels > MOST_PIXELS {
        return Err(unreadable(format!(
            "it is {} x {} px; a picture has at most {MOST_PIXELS} pixels",
            header.width, header.height
        )));
    }
    let (color, depth) = reader.output_color_type();
    if !wanted.contains(&(color, depth)) {
        return Err(SourceError::Malformed {
            path: path.to_owned(),
            what: format!("{what}, this one is {color:?} with {depth:?} bits"),
        });
    }
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| unreadable("it is too large".to_owned()))?;
    let mut bytes = vec![0; size];
    let info = reader
        .next_frame(&mut bytes)
        .map_err(|error| unreadable(error.to_string()))?;
    bytes.truncate(info.buffer_size());
    Ok((bytes, info))
}

/// Reads an 8-bit RGB or RGBA picture.
///
/// # Errors
/// [`SourceError::Unreadable`], [`SourceError::Malformed`] for another form.
pub fn read_color(path: &Path) -> Result<RgbImage, SourceError> {
    let wanted = [png::ColorType::Rgb, png::ColorType::Rgba].map(|c| (c, png::BitDepth::Eight));
    let (bytes, info) = read_png(path, "colour pictures must be 8-bit RGB", &wanted)?;
    let step = info.color_type.samples();
    let pixels = bytes.chunks_exact(step).map(|c| [c[0], c[1], c[2]]);
    sized(path, &info, pixels.collect())
}

/// Reads a 16-bit grey picture.
///
/// # Errors
/// [`SourceError::Unreadable`], [`SourceError::Malformed`] for another form.
pub(crate) fn read_depth(path: &Path) -> Result<Image<u16>, SourceError> {
    let wanted = [(png::ColorType::Grayscale, png::BitDepth::Sixteen)];
    let (bytes, info) = read_png(path, "depth pictures must be 16-bit grey", &wanted)?;
    let pixels = bytes
        .chunks_exact(2)
        .map(|c| u16::from_be_bytes([c[0], c[1]]));
    sized(path, &info, pixels.collect())
}

fn sized<T: Copy>(
    path: &Path,
    info: &png::OutputInfo,
    pixels: Vec<T>,
) -> Result<Image<T>, SourceError> {
    Image::new(info.width as usize, info.height as usize, pixels).map_err(|error| {
        SourceError::Malformed {
            path: path.to_owned(),
            what: error.to_string(),
        }
    })
}

fn write_png(
    path: &Path,
    size: [usize; 2],
    form: (png::ColorType, png::BitDepth),
    bytes: &[u8],
) -> Result<(), SourceError> {
    let file = File::create(path).map_err(|error| unwritable(path, error))?;
    encode(BufWriter::new(file), size, form, bytes).map_err(|error| unwritable(path, error))
}

fn encode(
    to: impl std::io::Write,
    size: [usize; 2],
    form: (png::ColorType, png::BitDepth),
    bytes: &[u8],
) -> Result<(), png::EncodingError> {
    let [width, height] = size.map(|value| u32::try_from(value).unwrap_or(u32::MAX));
    let mut encoder = png::Encoder::new(to, width, height);
    encoder.set_color(form.0);
    encoder.set_depth(form.1);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(bytes)?;
    writer.finish()
}

/// An 8-bit RGB picture as the bytes of a PNG file; empty for a picture without pixels.
#[must_use]
pub fn color_as_png(picture: &RgbImage) -> Vec<u8> {
    let form = (png::ColorType::Rgb, png::BitDepth::Eight);
    let size = [picture.width(), picture.height()];
    let mut bytes = Vec::new();
    // Writing to memory cannot fail; a picture of no size cannot be encoded.
    if encode(&mut bytes, size, form, picture.pixels().as_flattened()).is_err() {
        bytes.clear();
    }
    bytes
}

/// Writes an 8-bit RGB picture.
///
/// # Errors
/// [`SourceError::Unwritable`].
pub fn write_color(path: &Path, picture: &RgbImage) -> Result<(), SourceError> {
    let form = (png::ColorType::Rgb, png::BitDepth::Eight);
    let size = [picture.width(), picture.height()];
    write_png(path, size, form, picture.pixels().as_flattened())
}

/// Writes a 16-bit grey picture.
///
/// # Errors
/// [`SourceError::Unwritable`].
pub fn write_depth(path: &Path, picture: &Image<u16>) -> Result<(), SourceError> {
    let form = (png::ColorType::Grayscale, png::BitDepth::Sixteen);
    let bytes: Vec<u8> = picture
        .pixels()
        .iter()
        .flat_map(|v| v.to_be_bytes())
        .collect();
    write_png(path, [picture.width(), picture.height()], form, &bytes)
}
