//! A RealSense depth camera through Intel's librealsense2 (feature `realsense`).
//!
//! The library is loaded when the camera is opened: it is not needed to build this project nor to
//! run it without such a camera. Functions, constants and layouts are those of its C interface
//! (`librealsense2/rs.h` and its includes, version 2). Not tested on a camera: the tests use a
//! library of their own that answers according to that interface.
#![allow(
    unsafe_code,
    reason = "a C library's functions, and the bytes of its pictures"
)]

mod library;

use crate::camera::Camera;
use crate::frame::{Cameras, Frame};
use crate::image::{DepthImage, Image, RgbImage};
use crate::source::{Source, SourceError};
use library::{Api, Extrinsics, Handle, Intrinsics, call, device};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::ffi::{OsStr, c_float, c_int, c_uint};
use std::ptr;

/// `rs2_stream`: what a picture is of.
const DEPTH: c_int = 1;
const COLOR: c_int = 2;
/// `rs2_format`.
const Z16: c_int = 1;
const RGB8: c_int = 5;
/// `rs2_distortion`: the model of [`Camera`].
const BROWN_CONRADY: c_int = 4;
/// Longest wait for a pair of pictures, ms.
const WAIT_MS: c_uint = 5000;
/// Pairs that are discarded first: exposure settles meanwhile.
/// Half a second at 30 pictures a second.
const SETTLE: usize = 15;

/// File names of the library.
const NAME: &str = if cfg!(target_os = "windows") {
    "realsense2.dll"
} else if cfg!(target_os = "macos") {
    "librealsense2.dylib"
} else {
    "librealsense2.so"
};

/// One picture of a pair, as the library has it.
struct Taken {
    pixels: Vec<u8>,
    camera: Camera,
    profile: Handle,
    unit_m: f64,
}

/// An open camera.
pub struct RealSense {
    api: Api,
    context: Handle,
    config: Handle,
    pipeline: Handle,
    profile: Handle,
    cameras: Option<Cameras>,
    taken: usize,
}

impl RealSense {
    /// Opens the first camera that the installed library finds, both pictures of this size (px) at
    /// 30 a second, and lets its exposure settle.
    ///
    /// # Errors
    /// [`SourceError::Device`] where the library or a camera is missing, or gives no such pictures.
    pub fn open(size_px: [usize; 2]) -> Result<Self, SourceError> {
        Self::open_with(NAME.as_ref(), size_px)
    }

    /// As [`Self::open`], with the library by name or path.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_with(library: &OsStr, [width, height]: [usize; 2]) -> Result<Self, SourceError> {
        let mut camera = Self {
            api: Api::open(library)?,
            context: ptr::null_mut(),
            config: ptr::null_mut(),
            pipeline: ptr::null_mut(),
            profile: ptr::null_mut(),
            cameras: None,
            taken: 0,
        };
        let api = &camera.api;
        let [width, height] = [width, height].map(|size| c_int::try_from(size).unwrap_or(0));
        // It takes the version of the header that a program was built with: pass the library's own.
        let version = call!(api, rs2_get_api_version() -> c_int)?;
        camera.context = call!(api, rs2_create_context(version => c_int) -> Handle)?;
        camera.pipeline = call!(api, rs2_create_pipeline(camera.context => Handle) -> Handle)?;
        camera.config = call!(api, rs2_create_config() -> Handle)?;
        for (stream, format) in [(DEPTH, Z16), (COLOR, RGB8)] {
            call!(api, rs2_config_enable_stream(
                camera.config => Handle, stream => c_int, -1 => c_int, width => c_int,
                height => c_int, format => c_int, 30 => c_int) -> ())?;
        }
        camera.profile = call!(api, rs2_pipeline_start_with_config(
            camera.pipeline => Handle, camera.config => Handle) -> Handle)?;
        for _ in 0..SETTLE {
            camera.pair()?;
        }
        Ok(camera)
    }

    /// The next pair: colour and depth, as they are.
    fn pair(&mut self) -> Result<Frame, SourceError> {
        let api = &self.api;
        let frames = call!(api, rs2_pipeline_wait_for_frames(
            self.pipeline => Handle, WAIT_MS => c_uint) -> Handle)?;
        // The profiles belong to the frames: they are read before the frames are released.
        let taken = self.unpack(frames).and_then(|[color, depth]| {
            let color_from_depth = self.between(depth.profile, color.profile)?;
            Ok((color, depth, color_from_depth))
        });
        self.api.release(b"rs2_release_frame\0", frames);
        let (color, depth, color_from_depth) = taken?;
        let (size, steps) = (depth.camera.size_px, depth.pixels.chunks_exact(2));
        let steps = steps.map(|two| u16::from_le_bytes([two[0], two[1]]));
        let failed = |error| device(&error);
        let steps =
            Image::new(size[0], size[1], steps.collect()).map_err(|e| failed(e.to_string()))?;
        let [width, height] = color.camera.size_px;
        let pixels = color.pixels.chunks_exact(3);
        let pixels = pixels.map(|three| [three[0], three[1], three[2]]).collect();
        let picture = RgbImage::new(width, height, pixels).map_err(|e| failed(e.to_string()))?;
        let cameras = Cameras {
            color: color.camera,
            depth: depth.camera,
            color_from_depth,
        };
        self.cameras = Some(cameras);
        self.taken += 1;
        Ok(Frame {
            color: picture,
            depth: DepthImage {
                steps,
                unit_m: depth.unit_m,
            },
            cameras,
        })
    }

    fn unpack(&self, frames: Handle) -> Result<[Taken; 2], SourceError> {
        let api = &self.api;
        let count = call!(api, rs2_embedded_frames_count(frames => Handle) -> c_int)?;
        let (mut color, mut depth) = (None, None);
        for index in 0..count {
            let frame = call!(api, rs2_extract_frame(frames => Handle, index => c_int) -> Handle)?;
            let taken = self.picture(frame);
            self.api.release(b"rs2_release_frame\0", frame);
            match taken? {
                (COLOR, taken) => color = Some(taken),
                (DEPTH, taken) => depth = Some(taken),
                _ => {}
            }
        }
        match (color, depth) {
            (Some(color), Some(depth)) => Ok([color, depth]),
            (None, _) => Err(device(&"it gave no colour picture")),
            (_, None) => Err(device(&"it gave no depth picture")),
        }
    }

    /// What a picture is of, and a copy of it.
    fn picture(&self, frame: Handle) -> Result<(c_int, Taken), SourceError> {
        let api = &self.api;
        let profile = call!(api, rs2_get_frame_stream_profile(frame => Handle) -> Handle)?;
        let (mut stream, mut format, mut number, mut id, mut rate) = (0, 0, 0, 0, 0);
        call!(api, rs2_get_stream_profile_data(
            profile => Handle, &raw mut stream => *mut c_int, &raw mut format => *mut c_int,
            &raw mut number => *mut c_int, &raw mut id => *mut c_int,
            &raw mut rate => *mut c_int) -> ())?;
        let mut lens = Intrinsics::default();
        call!(api, rs2_get_video_stream_intrinsics(
            profile => Handle, &raw mut lens => *mut Intrinsics) -> ())?;
        let bytes_per_pixel = match (stream, format) {
            (DEPTH, Z16) => 2,
            (COLOR, RGB8) => 3,
            _ => return Err(device(&format!("stream {stream} has the format {format}"))),
        };
        let camera = camera(&lens)?;
        let [width, height] = camera.size_px;
        let stride = call!(api, rs2_get_frame_stride_in_bytes(frame => Handle) -> c_int)?;
        let stride = usize::try_from(stride).unwrap_or(0);
        let line = width * bytes_per_pixel;
        let size = call!(api, rs2_get_frame_data_size(frame => Handle) -> c_int)?;
        let needed = stride * height.saturating_sub(1) + line;
        let data = call!(api, rs2_get_frame_data(frame => Handle) -> *const u8)?;
        if data.is_null() || stride < line || usize::try_from(size).unwrap_or(0) < needed {
            return Err(device(&format!(
                "a picture of {size} bytes, {needed} are needed"
            )));
        }
        // SAFETY: the library guarantees this number of bytes, as long as the frame lives, which
        // its caller releases after this.
        let bytes = unsafe { std::slice::from_raw_parts(data, needed) };
        // Lines may end with padding, which is not part of the picture.
        let lines = bytes.chunks(stride).take(height);
        let pixels = lines
            .flat_map(|bytes| bytes.iter().take(line).copied())
            .collect();
        let unit_m = if stream == DEPTH {
            f64::from(call!(api, rs2_depth_frame_get_units(frame => Handle) -> c_float)?)
        } else {
            0.0
        };
        Ok((
            stream,
            Taken {
                pixels,
                camera,
                profile,
                unit_m,
            },
        ))
    }

    /// Takes points of one picture's camera to the other's, m.
    fn between(&self, from: Handle, to: Handle) -> Result<Isometry3<f64>, SourceError> {
        let api = &self.api;
        let mut place = Extrinsics::default();
        call!(api, rs2_get_extrinsics(
            from => Handle, to => Handle, &raw mut place => *mut Extrinsics) -> ())?;
        // The library stores this rotation column by column.
        let rotation = Matrix3::from_column_slice(&place.rotation.map(f64::from));
        if (rotation.determinant() - 1.0).abs() > 1e-3 {
            return Err(device(
                &"the rotation between its cameras is not a rotation matrix",
            ));
        }
        let rotation = Rotation3::from_matrix(&rotation);
        Ok(Isometry3::from_parts(
            Translation3::from(Vector3::from(place.translation.map(f64::from))),
            UnitQuaternion::from_rotation_matrix(&rotation),
        ))
    }
}

impl Source for RealSense {
    fn name(&self) -> String {
        "RealSense".to_owned()
    }

    fn cameras(&self) -> Cameras {
        // Opening took pictures, and each has its cameras.
        let none = Camera {
            size_px: [0, 0],
            focal_px: [0.0; 2],
            center_px: [0.0; 2],
            distortion: [0.0; 5],
        };
        self.cameras.unwrap_or(Cameras {
            color: none,
            depth: none,
            color_from_depth: Isometry3::identity(),
        })
    }

    fn frame(&mut self) -> Result<Frame, SourceError> {
        let frame = self.pair()?;
        frame.checked().map_err(|reason| SourceError::Frame {
            name: self.name(),
            number: self.taken - SETTLE,
            reason,
        })
    }
}

impl Drop for RealSense {
    fn drop(&mut self) {
        if !self.profile.is_null() {
            let stop = || call!(&self.api, rs2_pipeline_stop(self.pipeline => Handle) -> ());
            // There is no caller left to report to.
            let _ = stop();
        }
        for (name, handle) in [
            (&b"rs2_delete_pipeline_profile\0"[..], self.profile),
            (b"rs2_delete_config\0", self.config),
            (b"rs2_delete_pipeline\0", self.pipeline),
            (b"rs2_delete_context\0", self.context),
        ] {
            self.api.release(name, handle);
        }
    }
}

/// A camera from the library's numbers, which count pixels from the first one's centre.
fn camera(lens: &Intrinsics) -> Result<Camera, SourceError> {
    let bent = lens.coefficients.iter().any(|value| *value != 0.0);
    if bent && lens.model != BROWN_CONRADY {
        return Err(device(&format!(
            "its lens has the distortion model {} of librealsense2, only that of Brown and Conrady ({BROWN_CONRADY}) can be taken",
            lens.model
        )));
    }
    let size_px = [lens.width, lens.height].map(|size| usize::try_from(size).unwrap_or(0));
    let camera = Camera {
        size_px,
        focal_px: [lens.fx.into(), lens.fy.into()],
        center_px: [f64::from(lens.ppx) + 0.5, f64::from(lens.ppy) + 0.5],
        distortion: lens.coefficients.map(f64::from),
    };
    camera.validate().map_err(|error| device(&error))?;
    Ok(camera)
}
