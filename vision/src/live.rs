//! Live folders: pictures of a camera written by a user's program, in any language.
//!
//! ```text
//! intrinsics.json     as of a recorded folder
//! color_0001.png      as of a recorded folder
//! depth_0001.png      the same; a camera without distances writes none
//! frame_0001.json     {"taken_s": 1732248446.25}: written last, and under its name at once
//! color_0002.png ...
//! wanted              written by the reader: when it last asked for a picture
//! ```
//!
//! Numbers rise, also when the writer starts anew; otherwise it deletes existing pictures. A
//! picture counts once its `frame` file exists: it is written under another name and then renamed,
//! after the pictures. `taken_s` is when the exposure began, in seconds since 1970 by the clock of
//! this machine; a picture taken before it was requested is not used. A writer that takes pictures
//! on demand takes one whenever `wanted` changes; one that takes them continuously may ignore it.
//! The writer deletes old pictures.

use crate::frame::{Cameras, Frame};
use crate::image::{DepthImage, RgbImage, SizeError};
use crate::recorded::{self, Intrinsics};
use crate::source::{Source, SourceError};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Name of the file that asks for a picture; it holds the time of the request, s since 1970.
pub const WANTED: &str = "wanted";
/// Timeout of a picture.
pub const PATIENCE: Duration = Duration::from_secs(10);
/// Polling interval of the folder.
const LOOK_EVERY: Duration = Duration::from_millis(4);
/// A picture taken later than now by more than this has another clock, s.
const AHEAD_S: f64 = 1.0;

/// Content of a `frame` file.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct FrameFile {
    /// When the exposure began, s since 1970.
    taken_s: f64,
}

/// A folder into which a camera program writes.
#[derive(Debug)]
pub struct LiveFolder {
    folder: PathBuf,
    intrinsics: Intrinsics,
    patience: Duration,
}

impl LiveFolder {
    /// Opens a folder that a camera program writes into.
    ///
    /// # Errors
    /// No such folder; missing or malformed intrinsics.
    pub fn open(folder: &Path) -> Result<Self, SourceError> {
        if !folder.is_dir() {
            return Err(SourceError::Unreadable {
                path: folder.to_owned(),
                reason: "there is no such folder; the camera program makes it".to_owned(),
            });
        }
        Ok(Self {
            folder: folder.to_owned(),
            intrinsics: Intrinsics::read(folder)?,
            patience: PATIENCE,
        })
    }

    /// Sets the timeout of a picture, instead of [`PATIENCE`].
    #[must_use]
    pub const fn patient(mut self, patience: Duration) -> Self {
        self.patience = patience;
        self
    }

    /// Requests a picture and waits until `read` returns one that was taken since.
    fn next<T>(
        &self,
        read: impl Fn(&Self, u64) -> Result<T, SourceError>,
    ) -> Result<T, SourceError> {
        let (asked_s, began) = (now_s(), Instant::now());
        write_whole(&self.folder.join(WANTED), &format!("{asked_s:.6}\n"))?;
        loop {
            let newest = self.newest()?;
            let mut seen = "it has no frame file at all".to_owned();
            if let Some(number) = newest {
                seen = format!("the newest picture is number {number}");
                match self.taken_s(number) {
                    Ok(taken_s) if taken_s > now_s() + AHEAD_S => {
                        return Err(self.malformed(
                            number,
                            format!(
                                "taken_s is {:.0} s ahead of this machine's clock; it is in seconds \
                                 since 1970",
                                taken_s - now_s()
                            ),
                        ));
                    }
                    // An older picture may show the robot where it was before.
                    Ok(taken_s) if taken_s >= asked_s => {
                        match read(self, number) {
                            // A writer that keeps few pictures may have deleted it again.
                            Err(_) if self.newest()? > newest => {}
                            done => return done,
                        }
                    }
                    Ok(taken_s) => {
                        seen +=
                            &format!(", taken {:.1} s before it was asked for", asked_s - taken_s);
                    }
                    Err(_) if self.newest()? > newest => {}
                    Err(error) => return Err(error),
                }
            }
            if began.elapsed() > self.patience {
                return Err(SourceError::Device {
                    name: self.name(),
                    reason: format!(
                        "no new picture within {:.0} s: {seen}; does the camera program run?",
                        self.patience.as_secs_f64()
                    ),
                });
            }
            std::thread::sleep(LOOK_EVERY);
        }
    }

    /// Number of the newest complete picture.
    fn newest(&self) -> Result<Option<u64>, SourceError> {
        let unreadable = |error: std::io::Error| SourceError::Unreadable {
            path: self.folder.clone(),
            reason: error.to_string(),
        };
        let entries = std::fs::read_dir(&self.folder).map_err(unreadable)?;
        let numbers = entries.filter_map(|entry| {
            let name = entry.ok()?.file_name();
            let digits = name
                .to_str()?
                .strip_prefix("frame_")?
                .strip_suffix(".json")?;
            digits.parse().ok()
        });
        Ok(numbers.max())
    }

    fn taken_s(&self, number: u64) -> Result<f64, SourceError> {
        let path = frame_path(&self.folder, number);
        let text = crate::input::read_text(&path).map_err(|error| SourceError::Unreadable {
            path: path.clone(),
            reason: error.to_string(),
        })?;
        let file: FrameFile = serde_json::from_str(&text).map_err(|error| {
            self.malformed(number, format!("{error}; it holds {{\"taken_s\": ...}}"))
        })?;
        Ok(file.taken_s)
    }

    fn malformed(&self, number: u64, what: String) -> SourceError {
        SourceError::Malformed {
            path: frame_path(&self.folder, number),
            what,
        }
    }

    fn read_color(&self, number: u64) -> Result<RgbImage, SourceError> {
        let picture = recorded::read_color(&recorded::picture_path(&self.folder, "color", number))?;
        let [camera_width, camera_height] = self.intrinsics.cameras.color.size_px;
        let (width, height) = (picture.width(), picture.height());
        if [width, height] == [camera_width, camera_height] {
            return Ok(picture);
        }
        let what = "colour";
        let size = SizeError::Camera {
            what,
            width,
            height,
            camera_width,
            camera_height,
        };
        Err(self.unusable(number, size.into()))
    }

    fn read_frame(&self, number: u64) -> Result<Frame, SourceError> {
        let depth = recorded::picture_path(&self.folder, "depth", number);
        let frame = Frame {
            color: self.read_color(number)?,
            depth: DepthImage {
                steps: recorded::read_depth(&depth)?,
                unit_m: self.intrinsics.depth_unit_m,
            },
            cameras: self.intrinsics.cameras,
        };
        frame
            .checked()
            .map_err(|reason| self.unusable(number, reason))
    }

    fn unusable(&self, number: u64, reason: crate::frame::FrameError) -> SourceError {
        SourceError::Frame {
            name: self.name(),
            number: usize::try_from(number).unwrap_or(usize::MAX),
            reason,
        }
    }
}

impl Source for LiveFolder {
    fn name(&self) -> String {
        format!("live folder {}", self.folder.display())
    }

    fn cameras(&self) -> Cameras {
        self.intrinsics.cameras
    }

    fn frame(&mut self) -> Result<Frame, SourceError> {
        self.next(Self::read_frame)
    }

    fn color(&mut self) -> Result<RgbImage, SourceError> {
        self.next(Self::read_color)
    }
}

/// Writes a live folder: the camera program's side.
#[derive(Debug)]
pub struct LiveWriter {
    folder: PathBuf,
    written: u64,
    answered: String,
}

/// Pictures that are kept in the folder.
const KEPT: u64 = 4;

impl LiveWriter {
    /// Makes the folder and writes the cameras into it. Deletes the files of an earlier writer.
    ///
    /// # Errors
    /// If it cannot be written; if it contains pictures of another origin, such as a recorded
    /// folder.
    pub fn create(
        folder: &Path,
        cameras: &Cameras,
        depth_unit_m: f64,
    ) -> Result<Self, SourceError> {
        let old = Self::left(folder)?;
        recorded::write_intrinsics(folder, cameras, depth_unit_m)?;
        for path in old {
            std::fs::remove_file(&path).map_err(|error| recorded::unwritable(&path, error))?;
        }
        Ok(Self {
            folder: folder.to_owned(),
            written: 0,
            answered: String::new(),
        })
    }

    /// The files of an earlier writer.
    fn left(folder: &Path) -> Result<Vec<PathBuf>, SourceError> {
        if !folder.exists() {
            return Ok(Vec::new());
        }
        let unwritable = |error| recorded::unwritable(folder, error);
        let (mut old, mut is_live) = (Vec::new(), false);
        for entry in std::fs::read_dir(folder).map_err(unwritable)? {
            let path = entry.map_err(unwritable)?.path();
            let name = path.file_name().and_then(|name| name.to_str());
            let starts = |kind: &str| name.is_some_and(|name| name.starts_with(kind));
            is_live |= name == Some(WANTED) || starts("frame_");
            if ["color_", "depth_", "frame_"]
                .iter()
                .any(|kind| starts(kind))
            {
                old.push(path);
            }
        }
        // Only a folder that was live before is emptied: recorded pictures are kept.
        if is_live || old.is_empty() {
            return Ok(old);
        }
        let reason =
            "it holds pictures that were recorded, which would be deleted: name another folder";
        Err(recorded::unwritable(folder, reason))
    }

    /// Whether a picture was requested since the last call that returned true.
    pub fn is_wanted(&mut self) -> bool {
        let wanted = std::fs::read_to_string(self.folder.join(WANTED)).unwrap_or_default();
        let new = !wanted.is_empty() && wanted != self.answered;
        if new {
            self.answered = wanted;
        }
        new
    }

    /// Adds a picture that was taken at a time, s since 1970, with distances where there are any.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn add(
        &mut self,
        taken_s: f64,
        color: &RgbImage,
        depth: Option<&DepthImage>,
    ) -> Result<(), SourceError> {
        let number = self.written + 1;
        recorded::write_color(
            &recorded::picture_path(&self.folder, "color", number),
            color,
        )?;
        if let Some(depth) = depth {
            let path = recorded::picture_path(&self.folder, "depth", number);
            recorded::write_depth(&path, &depth.steps)?;
        }
        let path = frame_path(&self.folder, number);
        let text = serde_json::to_string(&FrameFile { taken_s })
            .map_err(|error| recorded::unwritable(&path, error))?;
        write_whole(&path, &text)?;
        self.written = number;
        if let Some(old) = number.checked_sub(KEPT) {
            // The frame file first: without it the picture counts as incomplete.
            let of = |kind: &str| recorded::picture_path(&self.folder, kind, old);
            for path in [frame_path(&self.folder, old), of("color"), of("depth")] {
                // A reader on another system may hold it open, and there may be no depth.
                let _ = std::fs::remove_file(path);
            }
        }
        Ok(())
    }
}

/// Now by this machine's clock, s since 1970.
#[must_use]
pub fn now_s() -> f64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0.0, |since| since.as_secs_f64())
}

fn frame_path(folder: &Path, number: u64) -> PathBuf {
    folder.join(format!("frame_{number:04}.json"))
}

/// Renamed in one step: a reader sees the whole file or none.
fn write_whole(path: &Path, text: &str) -> Result<(), SourceError> {
    let part = path.with_extension("part");
    std::fs::write(&part, text)
        .and_then(|()| std::fs::rename(&part, path))
        .map_err(|error| recorded::unwritable(path, error))
}
