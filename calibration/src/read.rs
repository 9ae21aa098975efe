//! Reads calibration data, and reports errors with their path in the document.

use super::data::Limits;
use super::data::{Data, Noise, NominalRobot, Observation, Origin, SCHEMA, Tag, View};
use super::error::Refusal;
use mcdpr_kinematics::{Cable, MAX_CABLES, Pose};
use mcdpr_vision::Camera;
use nalgebra::{Matrix3, Rotation3, Vector3};
use serde_json::Value;

pub(super) type Read<T> = Result<T, Refusal>;

/// A value and its place in the document.
pub(super) struct Node<'a> {
    pub(super) value: &'a Value,
    pub(super) path: String,
}

impl Data {
    /// Reads a document of the format `mcdpr-calibration-data-1`.
    ///
    /// # Errors
    /// [`Refusal::NotJson`], [`Refusal::Schema`], or [`Refusal::Field`] that names the place:
    /// missing, of the wrong shape, not a finite number (NaN), negative where it must not be.
    pub fn from_json(text: &str) -> Read<Self> {
        let value = parsed(text)?;
        let root = Node {
            value: &value,
            path: String::new(),
        };
        match value.get("schema").and_then(Value::as_str) {
            Some(SCHEMA) => {}
            Some(other) => {
                return Err(Refusal::Schema {
                    found: format!("\"{other}\""),
                });
            }
            None => {
                return Err(Refusal::Schema {
                    found: "missing".to_owned(),
                });
            }
        }
        let robot = robot(&root.get("robot")?)?;
        let count = robot.cables.len();
        let nominal = root.get("nominal")?;
        let bodies = nominal.get("H_world_tag_bodies")?.each(Node::pose)?;
        let tags = root.get("tags")?.each(|node| tag(&node, bodies.len()))?;
        for (i, tag) in tags.iter().enumerate() {
            if tags.iter().take(i).any(|other| other.id == tag.id) {
                return Err(Refusal::field(
                    format!("tags[{i}].id"),
                    format!("tag {} is listed twice; list it once", tag.id),
                ));
            }
        }
        let poses = root
            .get("poses")?
            .each(|node| observation(&node, count, &tags))?;
        // Data that a plan reads have no poses yet.
        if robot.home >= poses.len() && !poses.is_empty() {
            return Err(Refusal::field(
                "robot.home_pose_index",
                format!("there are only {} poses", poses.len()),
            ));
        }
        let noise = root.get("noise_1sigma")?;
        let tilted = poses.iter().any(|pose| pose.tilt_rad.is_some());
        Ok(Self {
            id: match value.get("id") {
                Some(Value::String(id)) => id.clone(),
                _ => String::new(),
            },
            camera: camera(&root.get("camera")?)?,
            noise: Noise {
                encoder_m: noise.get("encoder_mm")?.positive()? * 1e-3,
                corner_px: noise.get("corner_px")?.positive()?,
                tension_n: match noise.optional("tension_N") {
                    Some(node) => Some(node.positive()?),
                    None => None,
                },
                tilt_rad: match noise.optional("tilt_deg") {
                    Some(node) => Some(node.positive()?.to_radians()),
                    None => tilted.then_some(TILT_RAD),
                },
            },
            world_from_body: bodies,
            camera_from_platform: nominal.get("H_camera_platform")?.pose()?,
            at_rest: match root.optional("poses_at_rest") {
                None => false,
                Some(node) => node
                    .value
                    .as_bool()
                    .ok_or_else(|| node.wrong("must be true or false"))?,
            },
            holdout: match root.optional("holdout_H_tag_platform") {
                None => Vec::new(),
                Some(node) => node.each(Node::pose)?,
            },
            robot,
            tags,
            poses,
            origin: root
                .optional("origin")
                .map(|node| origin(&node))
                .transpose()?,
        })
    }
}

/// The document. Other programs write NaN and Infinity, which JSON does not allow: they are read as
/// words, so that their place can be reported.
pub(super) fn parsed(text: &str) -> Read<Value> {
    serde_json::from_str(text).or_else(|error| {
        serde_json::from_str(&quoted(text)).map_err(|_| Refusal::NotJson(error.to_string()))
    })
}

fn origin(node: &Node<'_>) -> Read<Origin> {
    let hash = node.get("robot_hash")?;
    let robot_hash = u32::from_str_radix(hash.text()?, 16)
        .map_err(|_| hash.wrong("must be eight hexadecimal digits"))?;
    Ok(Origin {
        robot: node.get("robot")?.text()?.to_owned(),
        robot_hash,
        simulated_seed: match node.optional("simulated_seed") {
            None => None,
            Some(seed) => Some(seed.index()? as u64),
        },
        simulated_machine: match node.optional("simulated_machine") {
            None => None,
            Some(name) => Some(name.text()?.to_owned()),
        },
        date: node.get("date")?.text()?.to_owned(),
    })
}

fn robot(node: &Node<'_>) -> Read<NominalRobot> {
    let anchors = node.get("anchors_nominal_mm")?.each(Node::point_mm)?;
    let count = anchors.len();
    if !(3..=MAX_CABLES).contains(&count) {
        return Err(node.get("anchors_nominal_mm")?.wrong(&format!(
            "{count} cables are given, 3 to {MAX_CABLES} can be calibrated"
        )));
    }
    let sized = |key: &str, got: usize| {
        if got == count {
            Ok(())
        } else {
            Err(Refusal::field(
                format!("robot.{key}"),
                format!("{got} entries for {count} cables; give one per cable"),
            ))
        }
    };
    let axes = node.get("pulley_axis")?.each(|node| node.numbers::<3>())?;
    sized("pulley_axis", axes.len())?;
    let attachments = node.get("attachments_mm")?.each(Node::point_mm)?;
    sized("attachments_mm", attachments.len())?;
    let radius = node.get("pulley_radius_mm")?;
    let radii = if radius.value.is_array() {
        radius.each(|node| node.not_negative())?
    } else {
        vec![radius.not_negative()?; count]
    };
    sized("pulley_radius_mm", radii.len())?;
    let mut cables = Vec::with_capacity(count);
    for (i, (((anchor_m, axis), radius), attachment_m)) in anchors
        .into_iter()
        .zip(axes)
        .zip(radii)
        .zip(attachments)
        .enumerate()
    {
        let axis = Vector3::from(axis);
        if axis.norm() < 1e-6 {
            return Err(Refusal::field(
                format!("robot.pulley_axis[{i}]"),
                format!("cable {}: the axis has no direction", i + 1),
            ));
        }
        cables.push(Cable {
            anchor_m,
            swivel_axis: axis.normalize(),
            pulley_radius_m: radius * 1e-3,
            attachment_m,
        });
    }
    let routing_m = match node.optional("routing_lengths_mm") {
        None => vec![0.0; count],
        Some(list) => list.each(|node| Ok(node.not_negative()? * 1e-3))?,
    };
    sized("routing_lengths_mm", routing_m.len())?;
    Ok(NominalRobot {
        cables,
        routing_m,
        compliance_per_n: match node.optional("cable_ea_N") {
            None => 0.0,
            Some(node) => 1.0 / node.positive()?,
        },
        anchor_half_tolerance_m: node.get("anchor_half_tolerance_mm")?.positive()? * 1e-3,
        mass_kg: match node.optional("platform_mass_kg") {
            Some(node) => node.positive()?,
            None => 1.0,
        },
        center_of_mass_m: match node.optional("platform_com_mm") {
            Some(node) => node.point_mm()?,
            None => Vector3::zeros(),
        },
        limits: node
            .optional("limits")
            .map(|node| limits(&node))
            .transpose()?,
        home: match node.optional("home_pose_index") {
            Some(node) => node.index()?,
            None => 0,
        },
    })
}

fn limits(node: &Node<'_>) -> Read<Limits> {
    let corners = node.get("box_mm")?;
    let box_in_world_m = <[Vector3<f64>; 2]>::try_from(corners.each(Node::point_mm)?)
        .map_err(|_| corners.wrong("a box has two corners, the least and the greatest"))?;
    let [low, high] = box_in_world_m;
    if (0..3).any(|k| low[k] > high[k]) {
        return Err(corners.wrong("the first corner must not exceed the second along any axis"));
    }
    let range = |name: &str| -> Read<[f64; 2]> {
        let node = node.get(name)?;
        let [least, most] = node.numbers::<2>()?;
        if least <= 0.0 || least >= most {
            return Err(node.wrong("must be two tensions over 0, the less one first"));
        }
        Ok([least, most])
    };
    Ok(Limits {
        box_in_world_m,
        tension_n: range("tension_N")?,
        held_n: range("held_tension_N")?,
        tilt_max_rad: node.get("tilt_deg")?.positive()?.to_radians(),
    })
}

pub(super) fn camera(node: &Node<'_>) -> Read<Camera> {
    let distortion = match node.optional("distortion") {
        None => [0.0; 5],
        Some(list) => {
            let numbers = list.each(|node| node.number())?;
            let mut out = [0.0; 5];
            if numbers.len() > out.len() {
                return Err(list.wrong("at most five coefficients k1, k2, p1, p2, k3"));
            }
            for (slot, number) in out.iter_mut().zip(numbers) {
                *slot = number;
            }
            out
        }
    };
    Ok(Camera {
        focal_px: [node.get("fx")?.positive()?, node.get("fy")?.positive()?],
        center_px: [node.get("cx")?.number()?, node.get("cy")?.number()?],
        size_px: [node.get("width")?.pixels()?, node.get("height")?.pixels()?],
        distortion,
    })
}

pub(super) fn tag(node: &Node<'_>, bodies: usize) -> Read<Tag> {
    let id = node.get("id")?;
    let body = node.get("body")?;
    let index = body.index()?;
    if index >= bodies {
        return Err(body.wrong(&format!(
            "there is no start value for body {index}: nominal.H_world_tag_bodies holds {bodies}"
        )));
    }
    let list = node.get("corners_in_body_mm")?;
    let corners = <[Vector3<f64>; 4]>::try_from(list.each(Node::point_mm)?)
        .map_err(|_| list.wrong("a tag has four corners"))?;
    let size_m = node.get("size_mm")?.positive()? * 1e-3;
    for (i, corner) in corners.iter().enumerate() {
        let next = corners[(i + 1) % 4];
        let edge_m = (next - corner).norm();
        if (edge_m - size_m).abs() > 1e-3 * size_m {
            return Err(list.wrong(&format!(
                "an edge of the tag is {:.3} mm long, but size_mm says {:.3}; correct one of them",
                edge_m * 1e3,
                size_m * 1e3
            )));
        }
    }
    Ok(Tag {
        id: u32::try_from(id.index()?).map_err(|_| id.wrong("is too large a number for a tag"))?,
        size_m,
        body: index,
        corners_in_body_m: corners,
    })
}

/// Noise of an inclinometer if none is stated, rad.
const TILT_RAD: f64 = 8.7e-4;

/// Roll and pitch, rad. A platform that hangs on cables does not stand on edge.
fn tilt(node: &Node<'_>) -> Read<[f64; 2]> {
    let degrees = node.numbers::<2>()?;
    if degrees.iter().any(|d| d.abs() > 80.0) {
        return Err(node.wrong("must be within 80 degrees: are these radians or another unit?"));
    }
    Ok(degrees.map(f64::to_radians))
}

fn observation(node: &Node<'_>, count: usize, tags: &[Tag]) -> Read<Observation> {
    let list = node.get("encoder_dl_mm")?;
    let encoder_m = list.each(|node| match node.value {
        Value::Null => Ok(None),
        _ => Ok(Some(node.number()? * 1e-3)),
    })?;
    if encoder_m.len() != count {
        return Err(list.wrong(&format!("{} entries for {count} cables", encoder_m.len())));
    }
    let tension_n = match node.optional("tension_N") {
        None => None,
        Some(list) => {
            let forces = list.each(|node| node.number())?;
            if forces.len() != count {
                return Err(list.wrong(&format!("{} entries for {count} cables", forces.len())));
            }
            Some(forces)
        }
    };
    let corners = node.get("corners_px")?;
    let seen = corners
        .value
        .as_object()
        .ok_or_else(|| corners.wrong("must be an object: tag id to four corners"))?;
    let mut views = Vec::with_capacity(seen.len());
    for (id, value) in seen {
        views.push(view(&corners, id, value, tags)?);
    }
    // The order of keys in a file has no meaning: equal data must give equal rows.
    views.sort_by_key(|view| view.tag);
    Ok(Observation {
        encoder_m,
        tension_n,
        views,
        tilt_rad: match node.optional("roll_pitch_deg") {
            None => None,
            Some(node) => Some(tilt(&node)?),
        },
        noise_factor: match node.optional("noise_factor") {
            None => 1.0,
            Some(node) => {
                let factor = node.number()?;
                if factor < 1.0 {
                    return Err(node.wrong("must be 1 or more"));
                }
                factor
            }
        },
    })
}

/// One tag in one picture.
pub(super) fn view(corners: &Node<'_>, id: &str, value: &Value, tags: &[Tag]) -> Read<View> {
    let view = Node {
        value,
        path: format!("{}.{id}", corners.path),
    };
    let tag = tags
        .iter()
        .position(|tag| tag.id.to_string() == *id)
        .ok_or_else(|| view.wrong(&format!("tag {id} is not among the tags of the data")))?;
    let corners_px = <[[f64; 2]; 4]>::try_from(view.each(|node| node.numbers::<2>())?)
        .map_err(|_| view.wrong("a tag has four corners"))?;
    Ok(View { tag, corners_px })
}

impl<'a> Node<'a> {
    pub(super) fn wrong(&self, what: &str) -> Refusal {
        Refusal::field(self.path.clone(), what)
    }

    pub(super) fn optional(&self, key: &str) -> Option<Node<'a>> {
        let value = self.value.get(key).filter(|value| !value.is_null())?;
        let path = if self.path.is_empty() {
            key.to_owned()
        } else {
            format!("{}.{key}", self.path)
        };
        Some(Node { value, path })
    }

    pub(super) fn get(&self, key: &str) -> Read<Node<'a>> {
        self.optional(key).ok_or_else(|| {
            let path = if self.path.is_empty() {
                key.to_owned()
            } else {
                format!("{}.{key}", self.path)
            };
            Refusal::field(path, "is missing; the format needs it")
        })
    }

    pub(super) fn each<T>(&self, read: impl Fn(Node<'a>) -> Read<T>) -> Read<Vec<T>> {
        let list = self
            .value
            .as_array()
            .ok_or_else(|| self.wrong("must be a list"))?;
        list.iter()
            .enumerate()
            .map(|(i, value)| {
                read(Node {
                    value,
                    path: format!("{}[{i}]", self.path),
                })
            })
            .collect()
    }

    pub(super) fn number(&self) -> Read<f64> {
        match self.value {
            Value::Number(number) => number
                .as_f64()
                .filter(|x| x.is_finite())
                .ok_or_else(|| self.wrong("is not a finite number")),
            Value::String(word) if word == NOT_FINITE => Err(self.wrong(
                "is not a finite number (NaN or infinite); leave the pose out, or write null for an \
                 encoder reading that is missing",
            )),
            other => Err(self.wrong(&format!("must be a number, not {other}"))),
        }
    }

    pub(super) fn text(&self) -> Read<&'a str> {
        let word = self.value.as_str();
        word.ok_or_else(|| self.wrong(&format!("must be a word, not {}", self.value)))
    }

    pub(super) fn positive(&self) -> Read<f64> {
        self.number().and_then(|x| {
            if x > 0.0 {
                Ok(x)
            } else {
                Err(self.wrong(&format!("is {x}, but must be positive")))
            }
        })
    }

    /// A picture's width or height; `1280.0` is as good as `1280`.
    fn pixels(&self) -> Read<usize> {
        let size = self.positive()?;
        if size.fract() != 0.0 || size > 16_384.0 {
            return Err(self.wrong(&format!(
                "is {size}, but must be a whole number up to 16384"
            )));
        }
        Ok(size as usize)
    }

    pub(super) fn not_negative(&self) -> Read<f64> {
        self.number().and_then(|x| {
            if x >= 0.0 {
                Ok(x)
            } else {
                Err(self.wrong(&format!("is {x}, but must not be negative")))
            }
        })
    }

    fn index(&self) -> Read<usize> {
        self.value
            .as_u64()
            .and_then(|n| usize::try_from(n).ok())
            .ok_or_else(|| self.wrong("must be a whole number, 0 or more"))
    }

    pub(super) fn numbers<const K: usize>(&self) -> Read<[f64; K]> {
        <[f64; K]>::try_from(self.each(|node| node.number())?)
            .map_err(|list| self.wrong(&format!("{} numbers, {K} needed", list.len())))
    }

    fn point_mm(self) -> Read<Vector3<f64>> {
        Ok(Vector3::from(self.numbers::<3>()?) * 1e-3)
    }

    /// A row-major 4x4 matrix in mm.
    pub(super) fn pose(self) -> Read<Pose> {
        let rows = self.each(|node| node.numbers::<4>())?;
        let rows = <[[f64; 4]; 4]>::try_from(rows)
            .map_err(|rows| self.wrong(&format!("{} rows, 4 needed", rows.len())))?;
        let m = Matrix3::from_fn(|i, j| rows[i][j]);
        let square = (m * m.transpose() - Matrix3::identity()).norm();
        if square > 1e-3 || m.determinant() < 0.0 || rows[3] != [0.0, 0.0, 0.0, 1.0] {
            return Err(self.wrong(
                "is not a rigid transformation: its upper left 3x3 must be a rotation, its last row \
                 0, 0, 0, 1",
            ));
        }
        Ok(Pose::new(
            Vector3::from_fn(|i, _| rows[i][3]) * 1e-3,
            Rotation3::from_matrix_eps(&m, 1e-15, 100, Rotation3::from_matrix_unchecked(m)),
        ))
    }
}

pub(super) const NOT_FINITE: &str = "not finite";

/// The text with every bare NaN and Infinity replaced by a word in quotes.
fn quoted(text: &str) -> String {
    let mut out = String::with_capacity(text.len() + 64);
    let (mut rest, mut inside) = (text, false);
    while let Some(c) = rest.chars().next() {
        let word = ["NaN", "-Infinity", "Infinity", "nan", "-inf", "inf"]
            .into_iter()
            .find(|word| !inside && rest.starts_with(word));
        if let Some(word) = word {
            out.push('"');
            out.push_str(NOT_FINITE);
            out.push('"');
            rest = &rest[word.len()..];
            continue;
        }
        let mut length = c.len_utf8();
        if c == '"' {
            inside = !inside;
        } else if c == '\\' && inside {
            // An escaped character does not end the string.
            length += rest[1..].chars().next().map_or(0, char::len_utf8);
        }
        out.push_str(&rest[..length]);
        rest = &rest[length..];
    }
    out
}
