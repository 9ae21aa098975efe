//! Grasps by a network in an ONNX file (feature `onnx`).
//!
//! A file states how many numbers go in and come out, but not their meaning: the user declares its
//! [`Head`]. The weights of the paper's network are in no package registry, so they are not
//! shipped; load a network that was trained elsewhere and exported with one of these heads.

mod maps;

pub use maps::{Head, Maps, Peak, blurred};

use super::{Closing, Detector, Grasp, HeightMap, NoGrasp, Wanted};
use crate::align::Aligned;
use nalgebra::{Point3, Vector2, Vector3};
use rten::{Dimension, Model, RunError, Value};
use rten_tensor::prelude::*;
use rten_tensor::{NdTensor, Tensor};
use std::fmt::{Debug, Display, Formatter};
use std::path::Path;
use std::sync::Arc;
use thiserror::Error;

/// Why a network cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum NetworkError {
    /// The file is missing, is not ONNX or contains something that the library does not support.
    #[error("{name} cannot be used as a network: {reason}")]
    Unreadable {
        /// Which file.
        name: String,
        /// Why.
        reason: String,
    },
    /// Another number of inputs or outputs.
    #[error(
        "{name} has {found} {what}, the head `{head}` has {wanted}: declare another head or export the network with these"
    )]
    Count {
        /// Which file.
        name: String,
        /// Inputs or outputs.
        what: &'static str,
        /// How many it has.
        found: usize,
        /// How many the head has.
        wanted: usize,
        /// Which head.
        head: &'static str,
    },
    /// An input or output of another shape.
    #[error("{name}: {what} has the shape {found}, the head `{head}` has {wanted}")]
    Shape {
        /// Which file.
        name: String,
        /// Which input or output.
        what: String,
        /// Its shape.
        found: String,
        /// The head's.
        wanted: String,
        /// Which head.
        head: &'static str,
    },
}

/// Most bytes of a network's file.
const MOST_BYTES: u64 = 1 << 30;

/// A grasp network.
#[derive(Clone)]
pub struct Network {
    model: Arc<Model>,
    head: Head,
    name: String,
}

impl Debug for Network {
    fn fmt(&self, out: &mut Formatter<'_>) -> std::fmt::Result {
        let mut out = out.debug_struct("Network");
        out.field("head", &self.head).field("name", &self.name);
        out.finish_non_exhaustive()
    }
}

impl Network {
    /// Loads a file.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub fn load(path: &Path, head: Head) -> Result<Self, NetworkError> {
        let name = path.display().to_string();
        let bytes =
            crate::input::read(path, MOST_BYTES).map_err(|error| unreadable(&name, &error))?;
        Self::read(&bytes, head, &name)
    }

    /// As [`Network::load`], from the bytes of a file. Runs the network once, on zeros: an ONNX
    /// file need not state the shapes of its outputs.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub fn read(bytes: &[u8], head: Head, name: &str) -> Result<Self, NetworkError> {
        let model = Model::load(bytes.to_vec()).map_err(|error| unreadable(name, &error))?;
        let count = |what, found, wanted| {
            if found == wanted {
                return Ok(());
            }
            Err(NetworkError::Count {
                name: name.to_owned(),
                what,
                found,
                wanted,
                head: head.name(),
            })
        };
        count("inputs", model.input_ids().len(), 1)?;
        count("outputs", model.output_ids().len(), head.outputs().len())?;
        let shape = |what: String, found: String, wanted: String| NetworkError::Shape {
            name: name.to_owned(),
            what,
            found,
            wanted,
            head: head.name(),
        };
        let input = head.input();
        let declared = model.input_shape(0).unwrap_or_default();
        let fits = |(dimension, wanted): (&Dimension, usize)| match dimension {
            Dimension::Fixed(size) => *size == wanted,
            // A size that the file leaves open: the run on zeros below shows whether it fits.
            Dimension::Symbolic(_) => true,
        };
        if !declared.is_empty()
            && (declared.len() != input.len() || !declared.iter().zip(input).all(fits))
        {
            let (found, wanted) = (shape_of(&declared), format!("{input:?}"));
            return Err(shape("the input".to_owned(), found, wanted));
        }
        let network = Self {
            model: Arc::new(model),
            head,
            name: name.to_owned(),
        };
        let zeros = vec![0.0; input.iter().product()];
        let outputs = network
            .infer(&zeros)
            .map_err(|error| unreadable(name, &error))?;
        for (index, (output, wanted)) in outputs.into_iter().zip(head.outputs()).enumerate() {
            let kind = output.dtype();
            let found = output.into_tensor::<f32>().map(|map| map.shape().to_vec());
            if found.as_deref() != Some(wanted.as_slice()) {
                let found = match found {
                    Some(found) => format!("{found:?} of f32"),
                    None => format!("values of {kind}"),
                };
                let what = format!("output {}", index + 1);
                return Err(shape(what, found, format!("{wanted:?} of f32")));
            }
        }
        Ok(network)
    }

    /// The raw output of the network for its own input ([`Head::prepare`]), without smoothing.
    ///
    /// # Errors
    /// If the network fails, or gives numbers that its head cannot give.
    pub fn run(&self, input: &[f32]) -> Result<Maps, NoGrasp> {
        let failed = |reason: &dyn Display| NoGrasp::Network(format!("{}: {reason}", self.name));
        let given = self.infer(input).map_err(|error| failed(&error))?;
        let mut outputs = Vec::new();
        for output in given {
            let map: Option<Tensor<f32>> = output.into_tensor();
            let map = map.ok_or_else(|| failed(&"an output is no longer of f32"))?;
            outputs.push(map.to_vec());
        }
        self.head.decode(&outputs).map_err(|reason| failed(&reason))
    }

    fn infer(&self, input: &[f32]) -> Result<Vec<Value>, RunError> {
        let tensor = NdTensor::from_data(self.head.input(), input.to_vec());
        let inputs = self.model.input_ids().iter().take(1);
        let inputs = inputs.map(|id| (*id, tensor.clone().into())).collect();
        self.model.run(inputs, self.model.output_ids(), None)
    }
}

/// A shape as a file declares it, unknown sizes by their names.
fn shape_of(declared: &[Dimension]) -> String {
    let sizes: Vec<_> = declared
        .iter()
        .map(|dimension| match dimension {
            Dimension::Fixed(size) => size.to_string(),
            Dimension::Symbolic(name) => name.clone(),
        })
        .collect();
    format!("[{}]", sizes.join(", "))
}

fn unreadable(name: &str, reason: &dyn Display) -> NetworkError {
    NetworkError::Unreadable {
        name: name.to_owned(),
        reason: reason.to_string(),
    }
}

/// Objects lower than this over the ground are ignored, m.
const LEAST_HEIGHT_M: f64 = 0.008;
/// How far finger tips go below the top that is seen, m.
const DEPTH_M: f64 = 0.016;
/// Jaws that cannot turn take grasps within this of their direction.
const ALONG_COS: f64 = 0.98;

impl Detector for Network {
    fn name(&self) -> String {
        format!("network {} with the head `{}`", self.name, self.head.name())
    }

    fn detect(&mut self, picture: &Aligned, wanted: &Wanted) -> Result<Vec<Grasp>, NoGrasp> {
        let map = HeightMap::new(picture)?;
        let (input, corner) = self.head.prepare(picture).map_err(NoGrasp::Network)?;
        let maps = self.run(&input)?;
        let peaks = maps.smoothed(self.head).peaks();
        let (mut grasps, mut narrowest_m) = (Vec::new(), f64::INFINITY);
        for peak in &peaks {
            let pixel = Vector2::new(
                (peak.at[0] + corner[0]) as f64 + 0.5,
                (peak.at[1] + corner[1]) as f64 + 0.5,
            );
            let Some(grasp) = grasp(picture, &map, wanted, pixel, peak) else {
                continue;
            };
            let fits_m = wanted.hand.opening_m - 2.0 * wanted.hand.margin_m;
            if grasp.width_m > fits_m {
                narrowest_m = narrowest_m.min(grasp.width_m);
            } else {
                grasps.push(grasp);
            }
        }
        if !grasps.is_empty() {
            return Ok(grasps);
        }
        if narrowest_m.is_finite() {
            return Err(NoGrasp::TooWide {
                narrowest_mm: narrowest_m * 1e3,
                opening_mm: (wanted.hand.opening_m - 2.0 * wanted.hand.margin_m) * 1e3,
            });
        }
        // The network cannot distinguish an empty tray from objects that it was not trained on.
        match super::Antipodal::default().detect_in(&map, picture, wanted) {
            Err(NoGrasp::Empty) => Err(NoGrasp::Empty),
            _ => Err(NoGrasp::Network(format!(
                "{}: things are there, but none of its {} peaks is a grasp on one of them",
                self.name,
                peaks.len()
            ))),
        }
    }
}

/// A peak of the network's maps as a grasp: the point from the depth picture, the direction in the
/// ground plane, finger tips as deep as the ground allows.
fn grasp(
    picture: &Aligned,
    map: &HeightMap,
    wanted: &Wanted,
    pixel: Vector2<f64>,
    peak: &Peak,
) -> Option<Grasp> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a pixel of the picture"
    )]
    let (column, row) = (pixel.x as usize, pixel.y as usize);
    let depth_m = picture.depth.depth_m(column, row)?;
    let along = picture.camera.direction(&pixel);
    let seen = Point3::new(along.x * depth_m, along.y * depth_m, depth_m);
    if !wanted.holds(&seen) {
        return None;
    }
    let place = map.camera_from_map.inverse_transform_point(&seen);
    // The map's median removes a thin top: the measured point itself counts as well.
    let top_m = map.height_m(place.x, place.y).max(place.z);
    if top_m < LEAST_HEIGHT_M {
        return None;
    }
    // Angles are counted from the picture's x axis against the clock; its y points down.
    let (sin, cos) = peak.angle_rad.sin_cos();
    let in_map = map.camera_from_map.rotation.inverse() * Vector3::new(cos, -sin, 0.0);
    let flat = Vector3::new(in_map.x, in_map.y, 0.0).try_normalize(1e-6)?;
    let closing = map.camera_from_map.rotation * flat;
    if let Closing::Along(direction) = wanted.closing
        && direction.normalize().dot(&closing).abs() < ALONG_COS
    {
        return None;
    }
    let hand = &wanted.hand;
    let height_m = (top_m - DEPTH_M).max(hand.margin_m) + hand.below_m;
    let focal_px = 0.5 * (picture.camera.focal_px[0] + picture.camera.focal_px[1]);
    let width_m = peak.width_px * depth_m / focal_px;
    Some(Grasp {
        pixel,
        point_m: map.to_camera(place.x, place.y, height_m),
        closing,
        width_m,
        clearance_m: 0.5 * (hand.opening_m - width_m),
        top_m,
        height_m,
        quality: peak.quality.clamp(0.0, 1.0),
    })
}
