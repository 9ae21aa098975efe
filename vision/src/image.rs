//! Pictures in memory.

use thiserror::Error;

/// A picture whose size does not fit its pixels or another picture.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SizeError {
    /// The number of pixels is not width times height.
    #[error("a picture of {width} x {height} px needs {} pixels, got {got}", width * height)]
    Pixels {
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
        /// Number of pixels.
        got: usize,
    },
    /// The picture has another size than the camera that took it.
    #[error(
        "the {what} picture is {width} x {height} px, its camera's intrinsics are for {camera_width} x {camera_height} px"
    )]
    Camera {
        /// Which picture.
        what: &'static str,
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
        /// Width that the intrinsics are for, px.
        camera_width: usize,
        /// Height that the intrinsics are for, px.
        camera_height: usize,
    },
}

/// A picture: rows from the top, each from the left.
#[derive(Debug, Clone, PartialEq)]
pub struct Image<T> {
    width: usize,
    height: usize,
    pixels: Vec<T>,
}

/// Grey values, 0 black.
pub type GrayImage = Image<u8>;
/// Red, green, blue.
pub type RgbImage = Image<[u8; 3]>;

impl<T: Copy> Image<T> {
    /// A picture from its pixels.
    ///
    /// # Errors
    /// [`SizeError::Pixels`].
    pub fn new(width: usize, height: usize, pixels: Vec<T>) -> Result<Self, SizeError> {
        if pixels.len() != width * height || pixels.is_empty() {
            let got = pixels.len();
            return Err(SizeError::Pixels { width, height, got });
        }
        Ok(Self {
            width,
            height,
            pixels,
        })
    }

    /// A picture with the same value everywhere. A side of 0 counts as 1.
    #[must_use]
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        Self {
            width,
            height,
            pixels: vec![value; width * height],
        }
    }

    /// Width, px.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Height, px.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row by row.
    #[must_use]
    pub fn pixels(&self) -> &[T] {
        &self.pixels
    }

    /// All pixels, row by row, to change.
    pub(crate) fn pixels_mut(&mut self) -> &mut [T] {
        &mut self.pixels
    }

    /// One row.
    ///
    /// # Panics
    /// Below the picture.
    #[must_use]
    pub fn row(&self, y: usize) -> &[T] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// The pixel in column `x` and row `y`, `None` outside.
    #[must_use]
    pub fn get(&self, x: usize, y: usize) -> Option<T> {
        (x < self.width && y < self.height).then(|| self.pixels[y * self.width + x])
    }

    /// Changes the pixel in column `x` and row `y`; nothing outside.
    pub fn set(&mut self, x: usize, y: usize, value: T) {
        if x < self.width && y < self.height {
            self.pixels[y * self.width + x] = value;
        }
    }

    /// The pixel that holds a point given in px, `None` outside.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn at(&self, point_px: [f64; 2]) -> Option<T> {
        let [x, y] = point_px;
        if !(x >= 0.0 && y >= 0.0) {
            return None;
        }
        self.get(x as usize, y as usize)
    }

    /// The picture with each pixel changed.
    #[must_use]
    pub fn map<U>(&self, change: impl FnMut(&T) -> U) -> Image<U> {
        Image {
            width: self.width,
            height: self.height,
            pixels: self.pixels.iter().map(change).collect(),
        }
    }
}

impl GrayImage {
    /// Grey value at a point in px, linear between the centres of the four pixels around it; the
    /// border's values outside.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn sample(&self, x_px: f64, y_px: f64) -> f64 {
        let x = (x_px - 0.5).clamp(0.0, (self.width - 1) as f64);
        let y = (y_px - 0.5).clamp(0.0, (self.height - 1) as f64);
        let (left, top) = (x as usize, y as usize);
        let (right, below) = (
            (left + 1).min(self.width - 1),
            (top + 1).min(self.height - 1),
        );
        let (fx, fy) = (x - left as f64, y - top as f64);
        let grey = |x: usize, y: usize| f64::from(self.pixels[y * self.width + x]);
        let upper = grey(left, top) * (1.0 - fx) + grey(right, top) * fx;
        let lower = grey(left, below) * (1.0 - fx) + grey(right, below) * fx;
        upper * (1.0 - fy) + lower * fy
    }
}

impl RgbImage {
    /// Grey values: 0.299 red + 0.587 green + 0.114 blue (ITU-R BT.601).
    #[must_use]
    pub fn to_gray(&self) -> GrayImage {
        self.map(|&[r, g, b]| {
            // In 256ths: 77 + 150 + 29 = 256, so that white stays white.
            let sum = 77 * u32::from(r) + 150 * u32::from(g) + 29 * u32::from(b);
            #[allow(clippy::cast_possible_truncation)]
            let grey = (sum >> 8) as u8;
            grey
        })
    }
}

/// Distances along the camera's z axis in steps of a unit; 0 where nothing was measured.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthImage {
    /// The steps.
    pub steps: Image<u16>,
    /// One step, m.
    pub unit_m: f64,
}

impl DepthImage {
    /// Distance in column `x` and row `y`, m; `None` outside and where nothing was measured.
    #[must_use]
    pub fn depth_m(&self, x: usize, y: usize) -> Option<f64> {
        match self.steps.get(x, y)? {
            0 => None,
            steps => Some(f64::from(steps) * self.unit_m),
        }
    }

    /// Share of the pixels at which something was measured.
    #[must_use]
    pub fn measured_share(&self) -> f64 {
        let pixels = self.steps.pixels();
        let count = pixels.iter().filter(|&&steps| steps > 0).count();
        count as f64 / pixels.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_knows_its_size() {
        assert!(Image::new(2, 2, vec![0_u8; 3]).is_err());
        assert!(Image::<u8>::new(0, 0, vec![]).is_err());
        let picture = Image::new(2, 1, vec![3_u8, 5]).unwrap();
        assert_eq!((picture.get(1, 0), picture.get(2, 0)), (Some(5), None));
        assert_eq!(picture.at([1.9, 0.2]), Some(5));
        assert_eq!(picture.at([-0.1, 0.2]), None);
    }

    #[test]
    fn samples_are_linear_between_pixel_centres() {
        let picture = Image::new(2, 2, vec![0_u8, 100, 100, 200]).unwrap();
        assert_eq!(picture.sample(0.5, 0.5), 0.0);
        assert_eq!(picture.sample(1.0, 0.5), 50.0);
        assert_eq!(picture.sample(1.0, 1.0), 100.0);
        assert_eq!(picture.sample(9.0, 9.0), 200.0);
    }

    #[test]
    fn white_stays_white_in_grey() {
        let picture = Image::new(1, 1, vec![[255_u8; 3]]).unwrap();
        assert_eq!(picture.to_gray().pixels(), [255]);
    }
}
