//! A picture of the robot's camera with the detections in it, for observers.

use mcdpr_vision::recorded::color_as_png;
use mcdpr_vision::{Camera, RgbImage};
use nalgebra::{Point3, Vector3};
use serde::Serialize;
use std::sync::Arc;

/// A tag in a picture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TagMark {
    /// The number that it encodes.
    pub id: u32,
    /// Its corners, px.
    pub corners_px: [[f64; 2]; 4],
}

/// A grasp in a picture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GraspMark {
    /// Its middle, px.
    pub middle_px: [f64; 2],
    /// Where the two pads touch, px.
    pub pads_px: [[f64; 2]; 2],
    /// Distance between the pads, m.
    pub width_m: f64,
}

impl GraspMark {
    /// Half of a pad's width as it is drawn, as a share of the grasp's.
    const PAD: f64 = 0.3;

    /// The grasp with its tool point at `point_m`, closing along the unit vector `closing`, both in
    /// the camera's frame; `None` if it is not in front of the camera.
    #[must_use]
    pub fn new(
        camera: &Camera,
        middle_px: [f64; 2],
        point_m: &Point3<f64>,
        closing: &Vector3<f64>,
        width_m: f64,
    ) -> Option<Self> {
        let pad = |side: f64| camera.project(&(point_m + closing * (side * 0.5 * width_m)));
        let (a, b) = (pad(-1.0)?, pad(1.0)?);
        // The pads are drawn about the pixel that was found, not about their projected middle.
        let shift = nalgebra::Vector2::from(middle_px) - (a + b) * 0.5;
        Some(Self {
            middle_px,
            pads_px: [(a + shift).into(), (b + shift).into()],
            width_m,
        })
    }

    /// The rectangle between the pads, corner by corner, px.
    #[must_use]
    pub fn corners_px(&self) -> [[f64; 2]; 4] {
        let [a, b] = self.pads_px;
        let across = [-(b[1] - a[1]) * Self::PAD, (b[0] - a[0]) * Self::PAD];
        let corner = |pad: [f64; 2], side: f64| [0, 1].map(|k| pad[k] + side * across[k]);
        [
            corner(a, -1.0),
            corner(b, -1.0),
            corner(b, 1.0),
            corner(a, 1.0),
        ]
    }
}

/// A picture with the detections in it. Clones share the pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Shown {
    /// The picture.
    pub picture: Arc<RgbImage>,
    /// Its source, in words.
    pub source: &'static str,
    /// Tags that were found.
    pub tags: Vec<TagMark>,
    /// The grasp that was chosen, if one was.
    pub grasp: Option<GraspMark>,
}

impl Shown {
    /// Width and height, px.
    #[must_use]
    pub fn size_px(&self) -> [usize; 2] {
        [self.picture.width(), self.picture.height()]
    }

    /// The picture alone, as the bytes of a PNG file.
    #[must_use]
    pub fn png(&self) -> Vec<u8> {
        color_as_png(&self.picture)
    }
}

const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/// Bytes as base64 (RFC 4648, with padding), as JSON and HTML carry them.
///
/// ```
/// assert_eq!(mcdpr_core::sight::base64(b"MCDPR"), "TUNEUFI=");
/// ```
#[must_use]
pub fn base64(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for part in bytes.chunks(3) {
        let byte = |index: usize| u32::from(part.get(index).copied().unwrap_or(0));
        let word = byte(0) << 16 | byte(1) << 8 | byte(2);
        for index in 0..4 {
            if index > part.len() {
                text.push('=');
            } else {
                let letter = LETTERS[(word >> (18 - 6 * index) & 63) as usize];
                text.push(char::from(letter));
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_the_standard() {
        let known = [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
            ("foobar", "Zm9vYmFy"),
        ];
        for (plain, wanted) in known {
            assert_eq!(base64(plain.as_bytes()), wanted);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xfe]), "+//+");
    }

    #[test]
    fn a_grasp_is_drawn_where_the_pads_touch() {
        let camera = Camera {
            size_px: [640, 480],
            focal_px: [600.0; 2],
            center_px: [320.0, 240.0],
            distortion: [0.0; 5],
        };
        // 30 mm at 0.6 m with 600 px of focal length: 30 px, closing along the picture's x axis.
        let at = Point3::new(0.0, 0.0, 0.6);
        let mark = GraspMark::new(&camera, [320.0, 240.0], &at, &Vector3::x(), 0.03).unwrap();
        assert!((mark.pads_px[0][0] - 305.0).abs() < 1e-9);
        assert!((mark.pads_px[1][0] - 335.0).abs() < 1e-9);
        let corners = mark.corners_px();
        assert!((corners[2][1] - 249.0).abs() < 1e-9, "{corners:?}");
        assert!(GraspMark::new(&camera, [0.0; 2], &-at, &Vector3::x(), 0.03).is_none());
    }
}
