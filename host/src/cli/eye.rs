//! `--camera`: the real camera beside a robot on a port.

use super::Failed;
use super::live::LivePage;
use crate::robot::Robot;
use crate::sight::{Camera, CameraTags};
use mcdpr_vision::SourceError;
use mcdpr_vision::live::LiveFolder;
use miette::IntoDiagnostic as _;
use std::path::PathBuf;

/// A camera beside the robot.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Eye {
    /// Camera beside a robot on a port: a folder into which your program writes pictures
    /// (docs/vision.md), or, in builds with these features, a RealSense or a V4L2 device (for tags
    /// only)
    #[arg(long, value_name = "folder:DIR|realsense|v4l2:DEVICE")]
    camera: Option<Kind>,
}

/// Which camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Kind {
    Folder(PathBuf),
    RealSense,
    V4l2(PathBuf),
}

impl std::str::FromStr for Kind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            Some(("folder", path)) if !path.is_empty() => Ok(Self::Folder(path.into())),
            Some(("v4l2", path)) if !path.is_empty() => Ok(Self::V4l2(path.into())),
            None if text == "realsense" => Ok(Self::RealSense),
            _ => Err("give folder:DIR, realsense, or v4l2:DEVICE such as v4l2:/dev/video0".into()),
        }
    }
}

/// Greatest relative difference of a focal length from the robot file's.
const SAME_FOCAL: f64 = 0.2;

impl Eye {
    /// This camera, or none.
    pub(crate) const fn of(camera: Option<Kind>) -> Self {
        Self { camera }
    }

    /// Whether a camera was named.
    pub(crate) const fn is_given(&self) -> bool {
        self.camera.is_some()
    }

    /// A camera beside the simulator in this process, which has its own, is refused. `option` names it.
    ///
    /// # Errors
    /// If one was named.
    pub(crate) fn refused_on_simulator(&self, option: &str) -> Result<(), Failed> {
        if self.is_given() {
            return Err(Failed::from_error(option)(format!(
                "the simulated robot in this process has its own camera; {option} goes with --on PORT"
            )));
        }
        Ok(())
    }

    /// Tags by this camera, at the robot file's picture size; `None` if none was named. A live page shows its
    /// pictures.
    ///
    /// # Errors
    /// A camera that cannot be opened, or gives pictures of another size.
    pub(crate) fn tags(
        &self,
        robot: &Robot,
        page: &LivePage,
    ) -> miette::Result<Option<CameraTags>> {
        let lens = robot.camera.lens;
        let Some(camera) = self.open(&lens)? else {
            return Ok(None);
        };
        let ids = robot.tags.iter().map(|tag| tag.id).collect();
        Ok(Some(
            CameraTags::start(camera, lens, ids, page.pictures()).into_diagnostic()?,
        ))
    }

    /// This camera with pictures of the size that `lens` has; `None` if none was named.
    ///
    /// # Errors
    /// A camera that cannot be opened, or whose lens differs.
    pub(crate) fn open(&self, lens: &mcdpr_vision::Camera) -> miette::Result<Option<Camera>> {
        let lens = *lens;
        let camera = match self.camera.clone() {
            None => return Ok(None),
            Some(Kind::Folder(path)) => Camera::start(move || LiveFolder::open(&path)),
            Some(Kind::RealSense) => realsense(lens),
            Some(Kind::V4l2(path)) => v4l2(path, lens),
        };
        let camera = camera.into_diagnostic()?;
        is_like(&camera, &lens)?;
        Ok(Some(camera))
    }

    /// Whether the named camera measures distances.
    pub(crate) const fn has_depth(&self) -> bool {
        matches!(&self.camera, Some(Kind::Folder(_) | Kind::RealSense))
    }
}

/// Whether a camera's pictures match those of the robot file's camera in this mode.
fn is_like(camera: &Camera, wanted: &mcdpr_vision::Camera) -> Result<(), Failed> {
    use mcdpr_vision::Source as _;
    let color = camera.cameras().color;
    let failed = |reason: String| Failed::from_error(&camera.name())(reason);
    if color.size_px != wanted.size_px {
        let ([width, height], [to_width, to_height]) = (color.size_px, wanted.size_px);
        return Err(failed(format!(
            "its colour pictures are {width} x {height} px, {to_width} x {to_height} px are needed here \
             ([camera] of the robot file; picking uses 640 x 480)"
        )));
    }
    let off = (color.focal_px[0] / wanted.focal_px[0] - 1.0).abs();
    if off > SAME_FOCAL {
        return Err(failed(format!(
            "its focal length is {:.0} px, by the robot file it is {:.0} px at this size: another camera \
             or another mode",
            color.focal_px[0], wanted.focal_px[0]
        )));
    }
    Ok(())
}

#[cfg(feature = "realsense")]
fn realsense(lens: mcdpr_vision::Camera) -> Result<Camera, SourceError> {
    Camera::start(move || mcdpr_vision::realsense::RealSense::open(lens.size_px))
}

#[cfg(not(feature = "realsense"))]
fn realsense(_: mcdpr_vision::Camera) -> Result<Camera, SourceError> {
    Err(SourceError::Device {
        name: "realsense".to_owned(),
        reason: "this build reads none: cargo build --release --features realsense".to_owned(),
    })
}

#[cfg(all(feature = "v4l2", target_os = "linux"))]
fn v4l2(path: PathBuf, lens: mcdpr_vision::Camera) -> Result<Camera, SourceError> {
    use mcdpr_vision::v4l2::V4l2;
    use mcdpr_vision::{Cameras, Frame, RgbImage, Source};

    /// Colour without distances, by the robot file's lens.
    struct ColorOnly(V4l2, mcdpr_vision::Camera);

    impl Source for ColorOnly {
        fn name(&self) -> String {
            self.0.name()
        }
        fn cameras(&self) -> Cameras {
            Cameras {
                color: self.1,
                depth: self.1,
                color_from_depth: nalgebra::Isometry3::identity(),
            }
        }
        fn frame(&mut self) -> Result<Frame, SourceError> {
            Err(SourceError::Device {
                name: self.name(),
                reason: "it has no distances".to_owned(),
            })
        }
        fn color(&mut self) -> Result<RgbImage, SourceError> {
            self.0.newest()
        }
    }

    Camera::start(move || Ok(ColorOnly(V4l2::open(&path, lens.size_px)?, lens)))
}

#[cfg(not(all(feature = "v4l2", target_os = "linux")))]
fn v4l2(path: PathBuf, _: mcdpr_vision::Camera) -> Result<Camera, SourceError> {
    Err(SourceError::Device {
        name: path.display().to_string(),
        reason: "this build has no support for V4L2 devices: cargo build --release --features v4l2 (Linux)"
            .to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_are_named_by_kind_and_place() {
        let folder = "folder:/tmp/a:b".parse();
        assert_eq!(folder, Ok(Kind::Folder("/tmp/a:b".into())));
        assert_eq!("realsense".parse(), Ok(Kind::RealSense));
        assert_eq!(
            "v4l2:/dev/video2".parse(),
            Ok(Kind::V4l2("/dev/video2".into()))
        );
        for wrong in ["folder:", "v4l2", "/dev/video0", "webcam:0", "realsense:1"] {
            assert!(wrong.parse::<Kind>().is_err(), "{wrong}");
        }
    }
}
