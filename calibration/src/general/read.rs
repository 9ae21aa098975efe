//! Reads data sets: the project's formats, version 1 and 2, and the layout
//! `source / robot / sensors / samples` in SI units that other laboratories' logs are kept in.

use super::data::{Eye, Machine, Sample, Set, Stated};
use super::outside_read::{distances, outside_json, positions, tapes, trackers};
use crate::check;
use crate::data::{Data, SCHEMA, matrix_mm};
use crate::error::Refusal;
use crate::read::{NOT_FINITE, Node, Read, camera, parsed, tag, view};
use mcdpr_kinematics::{Cable, MAX_CABLES};
use nalgebra::Vector3;
use serde_json::{Value, json};

/// Name of version 2 of the format.
pub(crate) const SCHEMA_2: &str = "mcdpr-calibration-data-2";

impl Set {
    /// Reads a data set of any of the three layouts. A reading that is not a finite number is left
    /// out and noted; the rest is used.
    ///
    /// # Errors
    /// [`Refusal::NotJson`], [`Refusal::Schema`], or [`Refusal::Field`] that names the place.
    pub fn from_json(text: &str) -> Read<Self> {
        let value = parsed(text)?;
        match value.get("schema").and_then(Value::as_str) {
            Some(SCHEMA) => return Self::from_data(&Data::from_json(text)?),
            Some(SCHEMA_2) => {}
            Some(other) => {
                return Err(Refusal::Schema {
                    found: format!("\"{other}\""),
                });
            }
            None if value.get("samples").is_some() => {}
            None => {
                return Err(Refusal::Schema {
                    found: "missing".to_owned(),
                });
            }
        }
        let root = Node {
            value: &value,
            path: String::new(),
        };
        // The SI layout of other laboratories has no schema key, and its lengths are absolute.
        let absolute = match root.optional("lengths") {
            None => value.get("schema").is_none(),
            Some(node) => match node.text()? {
                "absolute" => true,
                "change" => false,
                _ => return Err(node.wrong("must be \"absolute\" or \"change\"")),
            },
        };
        let robot = machine(&root.get("robot")?, absolute)?;
        let eye = eye(&root)?;
        let mut set = Self {
            id: match value.get("id").or_else(|| value["robot"].get("name")) {
                Some(Value::String(id)) => id.clone(),
                _ => String::new(),
            },
            robot,
            eye,
            trackers: trackers(&root)?,
            tapes: tapes(&root)?,
            sessions: Vec::new(),
            homed: Vec::new(),
            samples: Vec::new(),
            notes: Vec::new(),
            stated: Stated::default(),
        };
        if let Some(noise) = root.optional("noise_1sigma") {
            let stated = |key: &str| noise.optional(key).map(|node| node.positive()).transpose();
            set.stated = Stated {
                length_m: stated("length_mm")?.map(|mm| mm * 1e-3),
                tension_n: stated("tension_N")?,
                corner_px: stated("corner_px")?,
                position_m: stated("position_mm")?.map(|mm| mm * 1e-3),
                distance_m: stated("distance_mm")?.map(|mm| mm * 1e-3),
            };
        }
        if let Some(sessions) = root.optional("sessions") {
            for node in sessions.each(Ok)? {
                set.sessions.push(node.get("name")?.text()?.to_owned());
                let homed = node.optional("homed").and_then(|node| node.value.as_bool());
                set.homed.push(homed.unwrap_or(true));
            }
        }
        for (k, node) in root.get("samples")?.each(Ok)?.iter().enumerate() {
            let sample = sample(node, k + 1, &mut set)?;
            set.samples.push(sample);
        }
        if set.samples.is_empty() {
            return Err(root.get("samples")?.wrong("holds no sample"));
        }
        super::clock::check(&mut set);
        Ok(set)
    }

    /// The file form, version 2.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let mm = |v: &Vector3<f64>| [v.x * 1e3, v.y * 1e3, v.z * 1e3];
        let cables = &self.robot.cables;
        let scaled = |list: &[Option<f64>], factor: f64| -> Vec<Option<f64>> {
            list.iter().map(|value| value.map(|v| v * factor)).collect()
        };
        let samples: Vec<Value> = self
            .samples
            .iter()
            .map(|sample| {
                let mut out = json!({
                    "session": self.sessions[sample.session],
                    "length_mm": scaled(&sample.length_m, 1e3),
                    "tension_N": sample.tension_n,
                    "swivel_rad": sample.swivel_rad,
                    "rpy_rad": sample.rpy_rad,
                    "arrived": sample.arrived,
                });
                if let Some(time) = sample.time_s {
                    out["time_s"] = json!(time);
                }
                if let Some(speed) = sample.speed_mps {
                    // The format has a speed per cable; only the fastest was kept.
                    out["speed_mm_s"] = json!(vec![speed * 1e3; cables.len()]);
                }
                if sample.noise_factor > 1.0 {
                    out["noise_factor"] = json!(sample.noise_factor);
                }
                outside_json(self, sample, &mut out);
                if let (false, Some(eye)) = (sample.views.is_empty(), &self.eye) {
                    let corners: serde_json::Map<_, _> = sample
                        .views
                        .iter()
                        .filter_map(|view| {
                            let tag = eye.tags.get(view.tag)?;
                            Some((tag.id.to_string(), json!(view.corners_px)))
                        })
                        .collect();
                    out["corners_px"] = json!(corners);
                }
                out
            })
            .collect();
        let sessions = self.sessions.iter().zip(&self.homed);
        let mut out = json!({
            "schema": SCHEMA_2, "id": self.id,
            "lengths": if self.robot.absolute { "absolute" } else { "change" },
            "robot": {
                "anchors_mm": cables.iter().map(|c| mm(&c.anchor_m)).collect::<Vec<_>>(),
                "pulley_axis": cables.iter().map(|c| <[f64; 3]>::from(c.swivel_axis)).collect::<Vec<_>>(),
                "pulley_radius_mm": cables.iter().map(|c| c.pulley_radius_m * 1e3).collect::<Vec<_>>(),
                "attachments_mm": cables.iter().map(|c| mm(&c.attachment_m)).collect::<Vec<_>>(),
                "platform_mass_kg": self.robot.mass_kg,
                "platform_com_mm": mm(&self.robot.center_of_mass_m),
                "routing_lengths_mm": self.robot.routing_m.iter().map(|l| l * 1e3).collect::<Vec<_>>(),
            },
            "sessions": sessions
                .map(|(name, homed)| json!({"name": name, "homed": homed}))
                .collect::<Vec<_>>(),
            "samples": samples,
        });
        if let Some(half) = self.robot.anchor_half_tolerance_m {
            out["robot"]["anchor_half_tolerance_mm"] = json!(half * 1e3);
        }
        let stated = &self.stated;
        let noise = [
            ("length_mm", stated.length_m.map(|s| s * 1e3)),
            ("tension_N", stated.tension_n),
            ("corner_px", stated.corner_px),
            ("position_mm", stated.position_m.map(|s| s * 1e3)),
            ("distance_mm", stated.distance_m.map(|s| s * 1e3)),
        ];
        for (key, value) in noise {
            if let Some(value) = value {
                out["noise_1sigma"][key] = json!(value);
            }
        }
        for (key, list) in super::outside_read::described(self) {
            out[key] = list;
        }
        if let Some(eye) = &self.eye {
            let lens = &eye.camera;
            out["camera"] = json!({
                "fx": lens.focal_px[0], "fy": lens.focal_px[1],
                "cx": lens.center_px[0], "cy": lens.center_px[1],
                "width": lens.size_px[0], "height": lens.size_px[1],
                "distortion": lens.distortion,
            });
            let tags = eye.tags.iter().map(|tag| {
                json!({"id": tag.id, "size_mm": tag.size_m * 1e3, "body": tag.body,
                       "corners_in_body_mm": tag.corners_in_body_m.each_ref().map(mm)})
            });
            out["tags"] = tags.collect();
            out["nominal"] = json!({
                "H_world_tag_bodies": eye.world_from_body.iter().map(matrix_mm).collect::<Vec<_>>(),
                "H_camera_platform": matrix_mm(&eye.camera_from_platform),
            });
        }
        out
    }

    /// The same of data of version 1: one session, lengths since its homing, pictures, tensions.
    ///
    /// # Errors
    /// As the checks of version 1 refuse.
    pub fn from_data(data: &Data) -> Read<Self> {
        let usable = check::usable(data)?;
        let n = data.cable_count();
        let robot = &data.robot;
        let samples = usable
            .data
            .poses
            .iter()
            .zip(&usable.number)
            .zip(&usable.start)
            .map(|((seen, number), start)| Sample {
                length_m: seen.encoder_m.clone(),
                tension_n: seen
                    .tension_n
                    .as_ref()
                    .map_or_else(|| vec![None; n], |t| t.iter().copied().map(Some).collect()),
                views: seen.views.clone(),
                rpy_rad: seen
                    .tilt_rad
                    .map_or([None; 3], |[roll, pitch]| [Some(roll), Some(pitch), None]),
                noise_factor: seen.noise_factor,
                start: Some(*start),
                ..Sample::empty(0, number + 1, n)
            })
            .collect();
        Ok(Self {
            id: data.id.clone(),
            robot: Machine {
                cables: robot.cables.clone(),
                mass_kg: robot.mass_kg,
                center_of_mass_m: robot.center_of_mass_m,
                routing_m: robot.routing_m.clone(),
                anchor_half_tolerance_m: Some(robot.anchor_half_tolerance_m),
                // Version 1 has changes of lengths since a homing.
                absolute: false,
            },
            eye: Some(Eye {
                camera: data.camera,
                tags: data.tags.clone(),
                world_from_body: data.world_from_body.clone(),
                camera_from_platform: data.camera_from_platform,
            }),
            trackers: Vec::new(),
            tapes: Vec::new(),
            sessions: vec!["data".to_owned()],
            homed: vec![true],
            samples,
            notes: usable.warnings,
            stated: Stated {
                length_m: Some(data.noise.encoder_m),
                tension_n: data.noise.tension_n,
                corner_px: Some(data.noise.corner_px),
                ..Stated::default()
            },
        })
    }
}

/// The node of the first key that is there, with the factor to SI.
pub(super) fn first<'a>(node: &Node<'a>, keys: &[(&str, f64)]) -> Option<(Node<'a>, f64)> {
    keys.iter()
        .find_map(|(key, factor)| Some((node.optional(key)?, *factor)))
}

fn needed<'a>(node: &Node<'a>, keys: &[(&str, f64)]) -> Read<(Node<'a>, f64)> {
    match first(node, keys) {
        Some(found) => Ok(found),
        None => Err(node
            .get(keys.first().map_or("", |(key, _)| key))
            .err()
            .unwrap_or_else(|| node.wrong("is missing"))),
    }
}

fn points(node: &Node<'_>, keys: &[(&str, f64)]) -> Read<Vec<Vector3<f64>>> {
    let (list, factor) = needed(node, keys)?;
    list.each(|node| Ok(Vector3::from(node.numbers::<3>()?) * factor))
}

fn machine(node: &Node<'_>, absolute: bool) -> Read<Machine> {
    let anchors = points(node, &[("anchors_mm", 1e-3), ("anchors_m", 1.0)])?;
    let n = anchors.len();
    // Fewer than three cables leave a position open.
    if !(3..=MAX_CABLES).contains(&n) {
        return Err(node.wrong(&format!(
            "{n} anchors are given, 3 to {MAX_CABLES} cables can be calibrated"
        )));
    }
    let sized = |what: &str, got: usize| {
        if got == n {
            return Ok(());
        }
        Err(node.wrong(&format!("{got} {what} for {n} anchors; give one per cable")))
    };
    let axes = points(node, &[("pulley_axis", 1.0), ("swivel_axes", 1.0)])?;
    sized("swivel axes", axes.len())?;
    let attachments = points(node, &[("attachments_mm", 1e-3), ("attachments_m", 1.0)])?;
    sized("attachments", attachments.len())?;
    let (list, factor) = needed(
        node,
        &[("pulley_radius_mm", 1e-3), ("pulley_radius_m", 1.0)],
    )?;
    let radii = if list.value.is_array() {
        list.each(|node| node.not_negative())?
    } else {
        vec![list.not_negative()?; n]
    };
    sized("pulley radii", radii.len())?;
    let mut cables = Vec::with_capacity(n);
    for (i, ((anchor_m, axis), attachment_m)) in
        anchors.into_iter().zip(axes).zip(attachments).enumerate()
    {
        if axis.norm() < 1e-6 {
            return Err(node.wrong(&format!("cable {}: the axis has no direction", i + 1)));
        }
        cables.push(Cable {
            anchor_m,
            swivel_axis: axis.normalize(),
            pulley_radius_m: radii[i] * factor,
            attachment_m,
        });
    }
    let platform = node.optional("platform");
    let platform = platform.as_ref().unwrap_or(node);
    let (mass, _) = needed(platform, &[("mass_kg", 1.0), ("platform_mass_kg", 1.0)])?;
    let center = [
        ("center_of_mass_m", 1.0),
        ("platform_com_mm", 1e-3),
        ("center_of_mass_mm", 1e-3),
    ];
    let center_of_mass_m = match first(platform, &center) {
        None => Vector3::zeros(),
        Some((node, factor)) => Vector3::from(node.numbers::<3>()?) * factor,
    };
    let routing_m = match first(
        node,
        &[("routing_lengths_mm", 1e-3), ("routing_lengths_m", 1.0)],
    ) {
        None => vec![0.0; n],
        Some((list, factor)) => list.each(|node| Ok(node.not_negative()? * factor))?,
    };
    sized("routing lengths", routing_m.len())?;
    let tolerance = [
        ("anchor_half_tolerance_mm", 1e-3),
        ("anchor_half_tolerance_m", 1.0),
    ];
    Ok(Machine {
        cables,
        mass_kg: mass.positive()?,
        center_of_mass_m,
        routing_m,
        anchor_half_tolerance_m: match first(node, &tolerance) {
            None => None,
            Some((node, factor)) => Some(node.positive()? * factor),
        },
        absolute,
    })
}

fn eye(root: &Node<'_>) -> Read<Option<Eye>> {
    let Some(lens) = root.optional("camera") else {
        return Ok(None);
    };
    let nominal = root.get("nominal")?;
    let world_from_body = nominal.get("H_world_tag_bodies")?.each(Node::pose)?;
    let tags = root
        .get("tags")?
        .each(|node| tag(&node, world_from_body.len()))?;
    Ok(Some(Eye {
        camera: camera(&lens)?,
        tags,
        world_from_body,
        camera_from_platform: nominal.get("H_camera_platform")?.pose()?,
    }))
}

/// One reading: missing where it is null, and noted where it is not a finite number.
pub(super) fn reading(
    node: &Node<'_>,
    factor: f64,
    what: &str,
    notes: &mut Vec<String>,
) -> Read<Option<f64>> {
    match node.value {
        Value::Null => Ok(None),
        // Other programs write NaN, which JSON lacks: `parsed` has turned it into this word.
        Value::String(word) if word == NOT_FINITE => {
            notes.push(format!("{what} is not a finite number: left out"));
            Ok(None)
        }
        _ => Ok(Some(node.number()? * factor)),
    }
}

fn sample(node: &Node<'_>, number: usize, set: &mut Set) -> Read<Sample> {
    let n = set.cable_count();
    let session = match first(node, &[("session", 1.0), ("log", 1.0)]) {
        None => "session 1".to_owned(),
        Some((node, _)) => node.text()?.to_owned(),
    };
    // A session that is not listed counts as homed at the common home.
    let session = set.session(&session).unwrap_or_else(|| {
        set.sessions.push(session);
        set.homed.push(true);
        set.sessions.len() - 1
    });
    let mut out = Sample::empty(session, number, n);
    let notes = &mut set.notes;
    let name = |what: &str, i: usize| format!("sample {number}: cable {}'s {what}", i + 1);
    let mut per_cable = |keys: &[(&str, f64)], what: &str| -> Read<Vec<Option<f64>>> {
        let Some((list, factor)) = first(node, keys) else {
            return Ok(vec![None; n]);
        };
        let values = list.each(Ok)?;
        if values.len() != n {
            return Err(list.wrong(&format!("{} entries for {n} cables", values.len())));
        }
        let each = values.iter().enumerate();
        each.map(|(i, value)| reading(value, factor, &name(what, i), notes))
            .collect()
    };
    out.length_m = per_cable(&[("length_mm", 1e-3), ("lengths_m", 1.0)], "length")?;
    out.tension_n = per_cable(&[("tension_N", 1.0), ("tensions_n", 1.0)], "tension")?;
    let turns = [("swivel_rad", 1.0), ("swivel_deg", 1f64.to_radians())];
    out.swivel_rad = per_cable(&turns, "swivel angle")?;
    out.arrived = per_cable(&[("arrived", 1.0)], "last motion")?
        .into_iter()
        .map(|sign| sign.filter(|s| *s != 0.0).map(f64::signum))
        .collect();
    let speeds = per_cable(&[("speed_mps", 1.0), ("speed_mm_s", 1e-3)], "speed")?;
    out.speed_mps = speeds
        .iter()
        .flatten()
        .map(|speed| speed.abs())
        .max_by(f64::total_cmp);
    let attitude = [
        ("rpy_rad", 1.0),
        ("ahrs_rad", 1.0),
        ("rpy_deg", 1f64.to_radians()),
    ];
    if let Some((list, factor)) = first(node, &attitude) {
        let values = list.each(Ok)?;
        if !(2..=3).contains(&values.len()) {
            return Err(list.wrong("must be roll, pitch and, if there is one, yaw"));
        }
        for (k, value) in values.iter().enumerate() {
            let what = format!("sample {number}: {}", ["roll", "pitch", "yaw"][k]);
            out.rpy_rad[k] = reading(value, factor, &what, notes)?;
        }
    }
    let time = first(node, &[("t_s", 1.0), ("time_s", 1.0)]);
    out.time_s = time.map(|(node, _)| node.number()).transpose()?;
    if let Some(factor) = node.optional("noise_factor") {
        out.noise_factor = factor.number()?.max(1.0);
    }
    positions(node, &set.trackers, &mut out, notes)?;
    distances(node, &set.tapes, &mut out, notes)?;
    if let (Some(corners), Some(eye)) = (node.optional("corners_px"), &set.eye) {
        let seen = corners.value.as_object();
        let seen =
            seen.ok_or_else(|| corners.wrong("must be an object: tag id to four corners"))?;
        for (id, value) in seen {
            out.views.push(view(&corners, id, value, &eye.tags)?);
        }
        out.views.sort_by_key(|view| view.tag);
    }
    Ok(out)
}
