//! Tags in the camera's pictures: the common source for homing, calibration and picking.
//!
//! A [`TagSource`] gives the tags of the newest picture as [`TagView`]s: corners in px with their
//! covariance, and the time of the picture. Implementations are a detector on real or rendered
//! pictures, and a projection of the simulated robot's tags.

mod shown;

pub use shown::{GraspMark, Shown, TagMark, base64};

use miette::Diagnostic;

/// One tag in one picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TagView {
    /// The number that the tag encodes.
    pub id: u32,
    /// Its corners in the order of [`crate::robot::Tag::corners_in_body_m`], px: u to the right, v
    /// down. Pixel centres sit at whole numbers and a half: the first pixel's is (0.5, 0.5).
    pub corners_px: [[f64; 2]; 4],
    /// Covariance of each corner, px^2, row-major.
    pub covariance_px2: [[[f64; 2]; 2]; 4],
    /// When the picture was taken, on the clock of the link to the robot (`Link::now_us`), us.
    pub image_time_us: u64,
}

impl TagView {
    /// Standard deviation of a corner's coordinate, root mean square over the corners, px.
    ///
    /// ```
    /// use mcdpr_core::sight::TagView;
    /// let view = TagView {
    ///     id: 0,
    ///     corners_px: [[0.0; 2]; 4],
    ///     covariance_px2: [[[0.01, 0.0], [0.0, 0.01]]; 4],
    ///     image_time_us: 0,
    /// };
    /// assert!((view.sigma_px() - 0.1).abs() < 1e-15);
    /// ```
    #[must_use]
    pub fn sigma_px(&self) -> f64 {
        let sum: f64 = self.covariance_px2.iter().map(|c| c[0][0] + c[1][1]).sum();
        (sum / 8.0).sqrt()
    }
}

/// A source of tag observations.
pub trait TagSource {
    /// The tags of one new picture, in the order of their numbers; empty if none is in view. A tag
    /// counts as in view only with all four corners in the picture.
    ///
    /// # Errors
    /// [`SightError`] if there is no picture.
    fn look(&mut self) -> Result<Vec<TagView>, SightError>;

    /// As [`TagSource::look`], or `None` if the picture has not arrived yet: a caller that feeds a
    /// robot asks again.
    fn poll(&mut self) -> Option<Result<Vec<TagView>, SightError>> {
        Some(self.look())
    }

    /// Roll and pitch of the sensor on the platform since the last call, R = Rz Ry Rx, rad; `None` without such a
    /// sensor, or if nothing has arrived since.
    ///
    /// # Errors
    /// [`SightError::NoTilt`] if the sensor is gone.
    fn tilt_rad(&mut self) -> Result<Option<[f64; 2]>, SightError> {
        Ok(None)
    }
}

impl<S: TagSource + ?Sized> TagSource for &mut S {
    fn look(&mut self) -> Result<Vec<TagView>, SightError> {
        (**self).look()
    }
    fn poll(&mut self) -> Option<Result<Vec<TagView>, SightError>> {
        (**self).poll()
    }
    fn tilt_rad(&mut self) -> Result<Option<[f64; 2]>, SightError> {
        (**self).tilt_rad()
    }
}

impl<S: TagSource + ?Sized> TagSource for Box<S> {
    fn look(&mut self) -> Result<Vec<TagView>, SightError> {
        (**self).look()
    }
    fn poll(&mut self) -> Option<Result<Vec<TagView>, SightError>> {
        (**self).poll()
    }
    fn tilt_rad(&mut self) -> Result<Option<[f64; 2]>, SightError> {
        (**self).tilt_rad()
    }
}

/// Why there is no picture.
#[derive(Debug, Clone, PartialEq, thiserror::Error, Diagnostic)]
pub enum SightError {
    /// The camera gives no picture.
    #[error("the camera gave no picture: {what}")]
    #[diagnostic(
        code(mcdpr::sight::camera),
        help("check the camera's cable and that no other program has it")
    )]
    NoPicture {
        /// What went wrong.
        what: String,
    },
    /// The inclinometer gives no readings.
    #[error("the inclinometer: {what}")]
    #[diagnostic(
        code(mcdpr::sight::inclinometer),
        help(
            "it must send lines such as `1.25 -0.40`, roll and pitch in degrees, at the speed `baud` of [imu]; without \
             --imu its readings are left out"
        )
    )]
    NoTilt {
        /// What went wrong.
        what: String,
    },
    /// The simulated robot failed, so there is nothing to see.
    #[error("the simulated robot failed: {what}")]
    #[diagnostic(code(mcdpr::sight::simulation))]
    Simulation {
        /// The plant's message.
        what: String,
    },
}
