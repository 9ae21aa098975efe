//! Sources of pictures: one trait, one file per kind of camera.

use crate::frame::{Cameras, Frame, FrameError};
use crate::image::RgbImage;
use std::path::PathBuf;
use thiserror::Error;

/// A camera, real or replaced by a file.
pub trait Source {
    /// Its description for users.
    fn name(&self) -> String;

    /// Its cameras.
    fn cameras(&self) -> Cameras;

    /// The next pair of pictures, checked ([`Frame::checked`]).
    ///
    /// # Errors
    /// [`SourceError`] with what is missing or wrong.
    fn frame(&mut self) -> Result<Frame, SourceError>;

    /// The next colour picture alone, for callers that need no distances: nearer than its least
    /// range a depth camera measures none.
    ///
    /// # Errors
    /// [`SourceError`].
    fn color(&mut self) -> Result<RgbImage, SourceError> {
        Ok(self.frame()?.color)
    }

    /// The next pair of pictures as by [`Source::frame`], or `None` if it has not arrived yet: a
    /// caller with other work asks again. Most sources wait.
    fn poll_frame(&mut self) -> Option<Result<Frame, SourceError>> {
        Some(self.frame())
    }

    /// The next colour picture as by [`Source::color`], or `None` if it has not arrived yet.
    fn poll_color(&mut self) -> Option<Result<RgbImage, SourceError>> {
        Some(self.color())
    }
}

/// Why there is no picture.
#[derive(Debug, Error)]
pub enum SourceError {
    /// A file is missing or cannot be read.
    #[error("{path} cannot be read: {reason}")]
    Unreadable {
        /// Which.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A file cannot be written.
    #[error("{path} cannot be written: {reason}")]
    Unwritable {
        /// Which.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// The content of a file is invalid.
    #[error("{path}: {what}")]
    Malformed {
        /// Which.
        path: PathBuf,
        /// What is wrong, and what is expected.
        what: String,
    },
    /// No more pictures.
    #[error("{path} has no more pictures: {count} were read")]
    End {
        /// Which folder.
        path: PathBuf,
        /// Pictures so far.
        count: usize,
    },
    /// The pictures exist but cannot be used.
    #[error("picture {number} of {name}: {reason}")]
    Frame {
        /// Which source.
        name: String,
        /// Which picture, 1 for the first.
        number: usize,
        /// Why.
        reason: FrameError,
    },
    /// The camera does not answer as expected.
    #[error("camera {name}: {reason}")]
    Device {
        /// Which.
        name: String,
        /// Why.
        reason: String,
    },
}
