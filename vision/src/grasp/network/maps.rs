//! Inputs of a grasp network and the meaning of its outputs.

use crate::align::Aligned;
use std::f64::consts::TAU;

/// Layouts of grasp networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Head {
    /// AFFGA-Net (the paper's reference 41). In: 1 x 3 x 320 x 320, the middle of the colour
    /// picture, RGB over 255 minus the mean of all its numbers. Out, each after its sigmoid:
    /// graspable 1 x 1 x 320 x 320; angle 1 x 120 x 320 x 320, classes over a full turn, the
    /// greatest holds; width 1 x 1 x 320 x 320, times 200 px. Graspable and width are smoothed
    /// with a Gaussian of 1 px.
    Affga,
    /// GG-CNN (Morrison et al., 2018). In: 1 x 1 x 300 x 300, the middle of the depth picture in
    /// metres, holes filled from their neighbours, minus its mean, cut to -1 .. 1. Out, each 1 x 1
    /// x 300 x 300: quality, cosine and sine of twice the angle, width times 150 px. Quality and
    /// angle are smoothed with a Gaussian of 2 px, width with 1 px.
    Ggcnn,
}

const AFFGA_PX: usize = 320;
const AFFGA_CLASSES: usize = 120;
const AFFGA_WIDTH_PX: f64 = 200.0;
const GGCNN_PX: usize = 300;
const GGCNN_WIDTH_PX: f64 = 150.0;
/// Peaks below this do not count, and two are at least this far apart.
const PEAK_MIN: f32 = 0.2;
const PEAK_APART_PX: usize = 10;
const PEAKS_MAX: usize = 24;
/// A sigmoid's values lie between 0 and 1; rounding may exceed them by this.
const ROUNDING: f32 = 1e-4;

/// Three maps of a network, row by row: how good a grasp at a pixel is, its angle, its width.
#[derive(Debug, Clone, PartialEq)]
pub struct Maps {
    /// Width and height of the square, px.
    pub size: usize,
    /// Quality, 0 to 1.
    pub quality: Vec<f32>,
    /// Closing direction against the clock from the picture's x axis, rad.
    pub angle_rad: Vec<f32>,
    /// Distance between the pads, px.
    pub width_px: Vec<f32>,
}

/// A local maximum of quality.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// Column and row in the network's square.
    pub at: [usize; 2],
    /// Its quality.
    pub quality: f64,
    /// Closing direction against the clock from the picture's x axis, rad.
    pub angle_rad: f64,
    /// Distance between the pads, px.
    pub width_px: f64,
}

impl Head {
    /// The head of a name, as given on the command line.
    #[must_use]
    pub fn of(name: &str) -> Option<Self> {
        [Self::Affga, Self::Ggcnn]
            .into_iter()
            .find(|head| head.name() == name)
    }

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Affga => "affga",
            Self::Ggcnn => "ggcnn",
        }
    }

    /// Side of its square, px.
    #[must_use]
    pub const fn size(self) -> usize {
        match self {
            Self::Affga => AFFGA_PX,
            Self::Ggcnn => GGCNN_PX,
        }
    }

    /// Shape of the input: pictures, channels, rows, columns.
    #[must_use]
    pub const fn input(self) -> [usize; 4] {
        let channels = match self {
            Self::Affga => 3,
            Self::Ggcnn => 1,
        };
        [1, channels, self.size(), self.size()]
    }

    /// Shapes of the outputs, in order.
    #[must_use]
    pub fn outputs(self) -> Vec<[usize; 4]> {
        let channels: &[usize] = match self {
            Self::Affga => &[1, AFFGA_CLASSES, 1],
            Self::Ggcnn => &[1, 1, 1, 1],
        };
        let shape = |&count| [1, count, self.size(), self.size()];
        channels.iter().map(shape).collect()
    }

    /// The network's input from a picture, and the first column and row of its square.
    ///
    /// # Errors
    /// If the picture is smaller than the square, or has no distance where one is needed.
    pub fn prepare(self, picture: &Aligned) -> Result<(Vec<f32>, [usize; 2]), String> {
        let size = self.size();
        let [width, height] = picture.camera.size_px;
        if width < size || height < size {
            return Err(format!(
                "the picture has {width} x {height} px, the head `{}` needs {size} x {size}",
                self.name()
            ));
        }
        let corner = [(width - size) / 2, (height - size) / 2];
        let input = match self {
            Self::Affga => color(picture, corner, size),
            Self::Ggcnn => depth(picture, corner, size)?,
        };
        Ok((input, corner))
    }

    /// Maps from the network's outputs; the shapes are those of [`Head::outputs`].
    ///
    /// # Errors
    /// Numbers that this head cannot give.
    pub fn decode(self, outputs: &[Vec<f32>]) -> Result<Maps, String> {
        let size = self.size();
        let cells = size * size;
        let lengths: Vec<usize> = outputs.iter().map(Vec::len).collect();
        let wanted: Vec<usize> = self.outputs().iter().map(|s| s.iter().product()).collect();
        if lengths != wanted {
            return Err(format!("it gave {lengths:?} numbers, not {wanted:?}"));
        }
        for (index, output) in outputs.iter().enumerate() {
            if let Some(bad) = output.iter().find(|value| !value.is_finite()) {
                return Err(format!("output {} has a value of {bad}", index + 1));
            }
            let outside = |value: &&f32| !(-ROUNDING..=1.0 + ROUNDING).contains(*value);
            if self == Self::Affga
                && let Some(bad) = output.iter().find(outside)
            {
                return Err(format!(
                    "output {} has a value of {bad}, a sigmoid's lie between 0 and 1: export the \
                     network with its sigmoids",
                    index + 1
                ));
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "maps are single")]
        Ok(match self {
            Self::Affga => Maps {
                size,
                quality: outputs[0].clone(),
                angle_rad: (0..cells)
                    .map(|at| {
                        // The first of equal ones.
                        let mut best = 0;
                        for class in 1..AFFGA_CLASSES {
                            if outputs[1][class * cells + at] > outputs[1][best * cells + at] {
                                best = class;
                            }
                        }
                        (best as f64 * TAU / AFFGA_CLASSES as f64) as f32
                    })
                    .collect(),
                width_px: scaled(&outputs[2], AFFGA_WIDTH_PX),
            },
            Self::Ggcnn => Maps {
                size,
                quality: outputs[0].clone(),
                angle_rad: (outputs[1].iter().zip(&outputs[2]))
                    // Half a turn gives the same grasp: the network learns twice the angle, which
                    // has no jump there.
                    .map(|(cos, sin)| 0.5 * sin.atan2(*cos))
                    .collect(),
                width_px: scaled(&outputs[3], GGCNN_WIDTH_PX),
            },
        })
    }
}

#[expect(clippy::cast_possible_truncation, reason = "maps are single")]
fn scaled(values: &[f32], factor: f64) -> Vec<f32> {
    values
        .iter()
        .map(|value| (f64::from(*value) * factor) as f32)
        .collect()
}

/// Channels after each other, over 255, minus the mean of all.
fn color(picture: &Aligned, corner: [usize; 2], size: usize) -> Vec<f32> {
    let mut input = Vec::with_capacity(3 * size * size);
    for channel in 0..3 {
        for row in 0..size {
            for pixel in &picture.color.row(corner[1] + row)[corner[0]..corner[0] + size] {
                input.push(f32::from(pixel[channel]) / 255.0);
            }
        }
    }
    let mean = mean(&input);
    for value in &mut input {
        *value -= mean;
    }
    input
}

#[expect(clippy::cast_possible_truncation, reason = "inputs are single")]
fn mean(values: &[f32]) -> f32 {
    let sum: f64 = values.iter().map(|value| f64::from(*value)).sum();
    (sum / values.len().max(1) as f64) as f32
}

/// Metres, holes filled, minus the mean, cut to -1 .. 1.
#[expect(clippy::cast_possible_truncation, reason = "inputs are single")]
fn depth(picture: &Aligned, corner: [usize; 2], size: usize) -> Result<Vec<f32>, String> {
    let mut input: Vec<f32> = (0..size * size)
        .map(|at| {
            let (x, y) = (corner[0] + at % size, corner[1] + at / size);
            picture.depth.depth_m(x, y).map_or(f32::NAN, |d| d as f32)
        })
        .collect();
    if input.iter().all(|value| value.is_nan()) {
        return Err(format!(
            "the middle {size} x {size} px of the depth picture have no distance"
        ));
    }
    // Ring by ring, the mean of the known neighbours.
    while input.iter().any(|value| value.is_nan()) {
        let known = input.clone();
        for at in 0..known.len() {
            if !known[at].is_nan() {
                continue;
            }
            let (x, y) = (at % size, at / size);
            let (mut sum, mut count) = (0.0, 0_u8);
            for row in y.saturating_sub(1)..(y + 2).min(size) {
                for value in
                    &known[row * size + x.saturating_sub(1)..row * size + (x + 2).min(size)]
                {
                    if !value.is_nan() {
                        sum += value;
                        count += 1;
                    }
                }
            }
            if count > 0 {
                input[at] = sum / f32::from(count);
            }
        }
    }
    let mean = mean(&input);
    for value in &mut input {
        *value = (*value - mean).clamp(-1.0, 1.0);
    }
    Ok(input)
}

impl Maps {
    /// The maps smoothed as their head is ([`Head`]).
    #[must_use]
    pub(crate) fn smoothed(&self, head: Head) -> Self {
        let blur = |map: &[f32], sigma_px| blurred(map, self.size, sigma_px);
        match head {
            Head::Affga => Self {
                size: self.size,
                quality: blur(&self.quality, 1.0),
                angle_rad: self.angle_rad.clone(),
                width_px: blur(&self.width_px, 1.0),
            },
            Head::Ggcnn => Self {
                size: self.size,
                quality: blur(&self.quality, 2.0),
                angle_rad: blur(&self.angle_rad, 2.0),
                width_px: blur(&self.width_px, 1.0),
            },
        }
    }

    /// Local maxima of quality, best first: at least 0.2, at least 10 px apart and from the border.
    #[must_use]
    pub fn peaks(&self) -> Vec<Peak> {
        let (size, apart) = (self.size, PEAK_APART_PX);
        let mut found: Vec<Peak> = Vec::new();
        for y in apart..size.saturating_sub(apart) {
            for x in apart..size.saturating_sub(apart) {
                let at = y * size + x;
                let here = self.quality[at];
                if here < PEAK_MIN {
                    continue;
                }
                // Equal neighbours pass here; `near` keeps the first pixel of such a plateau.
                let highest = (y - apart..=y + apart).all(|row| {
                    let from = row * size + x - apart;
                    (self.quality[from..=from + 2 * apart].iter()).all(|other| *other <= here)
                });
                let near = |peak: &Peak| {
                    peak.at[0].abs_diff(x) <= apart && peak.at[1].abs_diff(y) <= apart
                };
                if highest && !found.iter().any(near) {
                    found.push(Peak {
                        at: [x, y],
                        quality: f64::from(here),
                        angle_rad: f64::from(self.angle_rad[at]),
                        width_px: f64::from(self.width_px[at]),
                    });
                }
            }
        }
        found.sort_by(|a, b| b.quality.total_cmp(&a.quality));
        found.truncate(PEAKS_MAX);
        found
    }
}

/// A square map smoothed with a Gaussian, cut off at four standard deviations; the border's values
/// go on outside.
#[must_use]
pub fn blurred(map: &[f32], size: usize, sigma_px: f64) -> Vec<f32> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "some pixels"
    )]
    let reach = (4.0 * sigma_px + 0.5) as usize;
    // Cut off as by SciPy's `gaussian_filter`: int(4 sigma + 0.5) on either side.
    let weights: Vec<f64> = (0..=2 * reach)
        .map(|k| (-0.5 * ((k as f64 - reach as f64) / sigma_px).powi(2)).exp())
        .collect();
    let sum: f64 = weights.iter().sum();
    let pass = |map: &[f32], step: usize| -> Vec<f32> {
        (0..map.len())
            .map(|at| {
                let along = if step == 1 { at % size } else { at / size };
                let start = at - along * step;
                let mut value = 0.0;
                for (k, weight) in weights.iter().enumerate() {
                    let place = (along + k).saturating_sub(reach).min(size - 1);
                    value += weight * f64::from(map[start + place * step]);
                }
                #[expect(clippy::cast_possible_truncation, reason = "maps are single")]
                let value = (value / sum) as f32;
                value
            })
            .collect()
    };
    pass(&pass(map, 1), size)
}
