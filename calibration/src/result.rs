//! A calibration in its file form, and the calibrated robot.
//!
//! It holds the answer with its covariance, the date, the hash of the data, and the hash of the
//! description that it belongs to; the nominal values stay in the robot file.

use super::answer::{Answer, Unexplained};
use super::data::Data;
use super::unknowns::Layout;
use mcdpr_core::estimate::tube::Errors;
use mcdpr_core::motion::{Model, PlanError};
use mcdpr_core::robot::{Calibrated, Robot, Tag, TagPlace};
use mcdpr_kinematics::Pose;
use nalgebra::{DMatrix, Matrix3, Rotation3, Vector3};
use serde_json::{Value, json};
use std::path::Path;

/// Name of the file format.
pub const SCHEMA: &str = "mcdpr-calibration-1";

/// CRC-32 of data in their file form.
#[must_use]
pub(crate) fn data_hash(data: &Data) -> u32 {
    mcdpr_protocol::frame::crc32(data.to_json().to_string().as_bytes())
}

/// The file form of an answer for the robot that the data were collected on, made at `date` (UTC, as
/// in 2026-03-01T12:00:00Z).
#[must_use]
pub fn document(robot: &Robot, data: &Data, answer: &Answer, date: &str) -> Value {
    let mut solved = answer.to_json();
    if let Some(fields) = solved.as_object_mut() {
        fields.remove("holdout_dl_mm");
        fields.remove("holdout_position_cov_mm2");
    }
    let covariance = answer.covariance.as_ref().map(|matrix| {
        let row = |i: usize| matrix.row(i).iter().copied().collect::<Vec<f64>>();
        (0..matrix.nrows()).map(row).collect::<Vec<_>>()
    });
    let bodies: Vec<u32> = (0..data.world_from_body.len())
        .map(|index| {
            // Numbered as in the robot file if the tags are those of the file.
            let mut tags = data.tags.iter().filter(|tag| tag.body == index);
            let found = tags.find_map(|tag| robot.tags.iter().find(|known| known.id == tag.id));
            found.map_or(u32::try_from(index).unwrap_or(0), |tag| tag.body)
        })
        .collect();
    let tags: Vec<Value> = data
        .tags
        .iter()
        .map(|tag| {
            json!({"id": tag.id, "size_mm": tag.size_m * 1e3, "body": bodies[tag.body],
                   "corners_in_body_mm": tag.corners_in_body_m.each_ref().map(|c| [c.x * 1e3, c.y * 1e3, c.z * 1e3])})
        })
        .collect();
    json!({
        "schema": SCHEMA,
        "robot": robot.name,
        "robot_hash": format!("{:08x}", robot.content_hash()),
        "date": date,
        "data_id": data.id,
        "data_hash": format!("{:08x}", data_hash(data)),
        "simulated_seed": data.origin.as_ref().and_then(|origin| origin.simulated_seed),
        "simulated_machine": data.origin.as_ref().and_then(|origin| origin.simulated_machine.clone()),
        "bodies": bodies,
        "tags": tags,
        "answer": solved,
        "covariance_of_shared_unknowns_si": covariance,
    })
}

/// Standard deviation per axis of the camera's place on a calibrated robot's platform: position (m) and
/// attitude (rad), root mean squares over the axes. `None` without a covariance.
#[must_use]
pub fn camera_sd(robot: &Robot) -> Option<[f64; 2]> {
    let first = Layout::of(robot)?.camera();
    let covariance = robot.calibrated.as_ref()?.covariance.as_ref()?;
    let rms = |from: usize| {
        let sum: f64 = (from..from + 3).map(|i| covariance[(i, i)].max(0.0)).sum();
        (sum / 3.0).sqrt()
    };
    Some([rms(first), rms(first + 3)])
}

/// The robot with a new calibration ([`document`]) applied.
///
/// # Errors
/// The value that cannot be used.
pub fn applied(robot: &Robot, document: &Value) -> Result<Robot, String> {
    overlay(robot, document, Path::new(""))
}

/// The robot with the text of a calibration file applied; `path` names it in the robot.
///
/// # Errors
/// What is wrong: another format, another description, or invalid JSON.
pub fn apply_text(robot: &Robot, text: &str, path: &Path) -> Result<Robot, String> {
    let value: Value = serde_json::from_str(text).map_err(|error| format!("no JSON: {error}"))?;
    if value["schema"] != SCHEMA {
        return Err(format!(
            "its schema is {}, not \"{SCHEMA}\"",
            value["schema"]
        ));
    }
    let hash = format!("{:08x}", robot.content_hash());
    if value["robot_hash"] != hash.as_str() {
        return Err(format!(
            "it belongs to robot {} with hash {}, this is {} with hash {hash}: the description was \
             changed since, or it is another machine",
            value["robot"], value["robot_hash"], robot.name
        ));
    }
    overlay(robot, &value, path)
}

fn overlay(designed: &Robot, value: &Value, path: &Path) -> Result<Robot, String> {
    let answer = &value["answer"];
    let mut robot = designed.clone();
    let mut machine = designed.clone();
    let count = robot.cables.len();
    let anchors = points_mm(&answer["anchors_mm"], "anchors_mm")?;
    let initial = numbers(&answer["initial_lengths_mm"], "initial_lengths_mm")?;
    if anchors.len() != count || initial.len() != count {
        return Err(format!("it has another number of cables than {count}"));
    }
    let attachments = optional(&answer["attachments_mm"], |v| {
        points_mm(v, "attachments_mm")
    })?;
    let radii = optional(&answer["pulley_radius_mm"], |v| {
        numbers(v, "pulley_radius_mm")
    })?;
    let compliances = optional(&answer["cable_compliances_per_N"], |v| {
        numbers(v, "cable_compliances_per_N")
    })?;
    let common = answer["cable_compliance_per_N"].as_f64();
    for (i, cable) in robot.cables.iter_mut().enumerate() {
        cable.anchor_in_world_m = anchors[i];
        if let Some(at) = attachments.as_ref().and_then(|list| list.get(i)) {
            cable.attachment_in_platform_m = *at;
        }
        if let Some(radius) = radii.as_ref().and_then(|list| list.get(i)) {
            cable.pulley_radius_m = radius * 1e-3;
        }
        let own = compliances.as_ref().and_then(|list| list.get(i).copied());
        // EA over 10 MN is not distinguished from a stiff cable: the file's value stays.
        if let Some(compliance) = own.or(common).filter(|c| *c > 1e-7) {
            cable.ea_n = 1.0 / compliance;
        }
    }
    // The radius turns counts into lengths: a length per reading is a factor on it.
    let drums = match optional(&answer["drum_scales"], |v| numbers(v, "drum_scales"))? {
        Some(drums) if drums.len() == count => drums,
        Some(_) => return Err("drum_scales has another number of cables".to_owned()),
        // Files of earlier versions have one number for all drums.
        None => vec![answer["drum_scale"].as_f64().unwrap_or(1.0); count],
    };
    for (cable, drum) in robot.cables.iter().zip(&drums) {
        if let Some(winch) = robot.winches.get_mut(cable.winch_index) {
            winch.drum_radius_m *= drum;
        }
    }
    if let Some(mass) = answer["platform_mass_kg"].as_f64() {
        // Nothing was learned about the platform's shape: its inertia grows with its mass.
        let scale = mass / robot.platform.mass_kg;
        robot.platform.mass_kg = mass;
        robot.platform.inertia_kg_m2 *= scale;
    }
    if let Some(center) = optional(&answer["platform_com_mm"], |v| {
        point_mm(v, "platform_com_mm")
    })? {
        robot.platform.center_of_mass_m = center;
    }
    let camera = &answer["camera"];
    let set = |slot: &mut f64, key: &str| {
        if let Some(number) = camera[key].as_f64() {
            *slot = number;
        }
    };
    let lens = &mut robot.camera.lens;
    set(&mut lens.focal_px[0], "fx");
    set(&mut lens.focal_px[1], "fy");
    set(&mut lens.center_px[0], "cx");
    set(&mut lens.center_px[1], "cy");
    if let Ok(list) = numbers(&camera["distortion"], "distortion") {
        for (slot, number) in lens.distortion.iter_mut().zip(list) {
            *slot = number;
        }
    }
    robot.camera.camera_from_platform =
        transform(&answer["H_camera_platform"], "H_camera_platform")?;
    let tag_scale = answer["tag_scale"].as_f64().unwrap_or(1.0);
    let tags = tags(&value["tags"])?;
    machine.tags.clone_from(&tags);
    robot.tags = tags
        .into_iter()
        .map(|tag| Tag {
            size_m: tag.size_m * tag_scale,
            corners_in_body_m: tag.corners_in_body_m.map(|c| c * tag_scale),
            ..tag
        })
        .collect();
    let places = list(&answer["H_world_tag_bodies"], "H_world_tag_bodies")?;
    let numbers = list(&value["bodies"], "bodies")?;
    let mut found = Vec::new();
    for (number, place) in numbers.iter().zip(places) {
        let number = number.as_u64().and_then(|n| u32::try_from(n).ok());
        let number = number.ok_or("bodies must be whole numbers")?;
        found.push(TagPlace {
            body: number,
            world_from_body: transform(place, "H_world_tag_bodies")?,
        });
    }
    let home_m: Vec<f64> = initial.iter().map(|mm| mm * 1e-3).collect();
    robot.calibrated = Some(Box::new(Calibrated {
        designed: machine,
        places: found,
        simulated_seed: value["simulated_seed"].as_u64(),
        simulated_machine: value["simulated_machine"].as_str().map(str::to_owned),
        date: value["date"].as_str().unwrap_or("").to_owned(),
        predicted_error_m: answer["predicted_tcp_error_mm"]
            .as_f64()
            .map(|mm| mm * 1e-3),
        home_lengths_m: home_m.clone(),
        drum_scales: drums,
        covariance: optional(&value["covariance_of_shared_unknowns_si"], |v| {
            square(v, "covariance_of_shared_unknowns_si")
        })?,
        errors: None,
        file: path.to_owned(),
    }));
    // Only now: what its cables can do is judged by its description.
    robot.tool.home_in_world_m = home_of(&robot, &home_m).map_err(|error| error.to_string())?;
    let unexplained = optional(&answer["unexplained_force_N"], |force_n| {
        Ok(Unexplained {
            force_n: pair(force_n, "unexplained_force_N")?,
            moment_nm: pair(&answer["unexplained_moment_Nm"], "unexplained_moment_Nm")?,
        })
    })?;
    let errors = open_errors(&robot, unexplained.as_ref());
    if let Some(calibrated) = robot.calibrated.as_mut() {
        calibrated.errors = errors;
    }
    Ok(robot)
}

/// What a calibration left open, for the tube of a plan: its covariance, in the frame of the first body
/// of tags, which a camera can compare with, and the forces that no statics explained. A robot in a plane turns about
/// the plane's normal only, so that nothing tells where its camera is along that: there the frame is that of its anchors,
/// on average.
fn open_errors(robot: &Robot, unexplained: Option<&Unexplained>) -> Option<DMatrix<f64>> {
    let layout = Layout::of(robot)?;
    let calibrated = robot.calibrated.as_deref()?;
    let covariance = calibrated.covariance.as_ref()?;
    let body_m = calibrated.places.first()?.world_from_body.position_m;
    let errors = Errors {
        cables: robot.cables.len(),
    };
    let normal = Model::new(robot).ok()?.holding().freedom().normal();
    let across = normal.map_or_else(Matrix3::zeros, |normal| normal * normal.transpose());
    let count = robot.cables.len() as f64;
    let mut map = DMatrix::zeros(errors.count(), layout.len());
    for (i, cable) in robot.cables.iter().enumerate() {
        let from_body = (cable.anchor_in_world_m - body_m).cross_matrix();
        for axis in 0..3 {
            let row = errors.anchor(i) + axis;
            map[(row, layout.anchor(i) + axis)] = 1.0;
            for along in 0..3 {
                let shared = across[(axis, along)];
                map[(row, layout.body(0) + along)] = shared - f64::from(u8::from(axis == along));
                for j in 0..robot.cables.len() {
                    map[(row, layout.anchor(j) + along)] -= shared / count;
                }
            }
            for turn in 0..3 {
                map[(row, layout.body(0) + 3 + turn)] = from_body[(axis, turn)];
            }
            map[(errors.attachment(i) + axis, layout.attachment(i) + axis)] = 1.0;
        }
        map[(errors.length(i), layout.initial_length(i))] = 1.0;
        map[(errors.radius(i), layout.radius(i))] = 1.0;
        map[(errors.drum(i), layout.scales())] = 1.0;
        map[(errors.drum(i), layout.drum(i))] = 1.0;
        if layout.statics {
            map[(errors.compliance(i), layout.statics())] = cable.ea_n;
            map[(errors.compliance(i), layout.soft(i))] = cable.ea_n;
            map[(errors.gain(i), layout.loss(i))] = 1.0;
            map[(errors.zero(i), layout.zero(i))] = 1.0;
        }
    }
    let weight_n = robot.platform.mass_kg * mcdpr_kinematics::GRAVITY_MPS2;
    if layout.statics {
        map[(errors.mass(), layout.statics() + 1)] = 1.0;
        for axis in 0..3 {
            map[(errors.center() + axis, layout.statics() + 2 + axis)] = 1.0;
        }
    }
    // In a frame that is turned by mistake the weight points elsewhere.
    let turned = Vector3::new(0.0, 0.0, -weight_n).cross_matrix();
    for axis in 0..3 {
        for turn in 0..3 {
            map[(errors.force() + axis, layout.body(0) + 3 + turn)] = turned[(axis, turn)];
        }
    }
    let mut open = &map * covariance * map.transpose();
    if let Some(unexplained) = unexplained {
        for axis in 0..3 {
            let direction = usize::from(axis == 2);
            let (force, moment) = (errors.force() + axis, errors.moment() + axis);
            open[(force, force)] += unexplained.force_n[direction].powi(2);
            open[(moment, moment)] += unexplained.moment_nm[direction].powi(2);
        }
    }
    Some(open)
}

/// Iterations between position and tensions at home.
const HOME_PASSES: usize = 4;

/// Where the tool is (world, m) at the lengths at which the encoders were zeroed (one per cable, m), as this robot's
/// description has it.
///
/// # Errors
/// Where no resting pose fits these lengths.
pub fn home_of(robot: &Robot, home_m: &[f64]) -> Result<Vector3<f64>, PlanError> {
    let model = Model::new(robot)?;
    // The tensions follow from the position by the rule for set-points, and the position from the
    // lengths under these tensions: each pass reduces the error to a hundredth.
    let mut place = robot.tool.home_in_world_m;
    for _ in 0..HOME_PASSES {
        let tensions = match model.rest(&place, None) {
            Ok(rest) => rest.tensions_n().to_vec(),
            // The robot may be unable to hang at the position in the description.
            Err(_) => vec![robot.tension.setpoint_n; home_m.len()],
        };
        place = model.tool_m(&model.rest_from_lengths(home_m, &tensions)?);
    }
    Ok(place)
}

fn list<'a>(value: &'a Value, name: &str) -> Result<&'a Vec<Value>, String> {
    value.as_array().ok_or_else(|| format!("{name} is missing"))
}

fn optional<T>(
    value: &Value,
    read: impl Fn(&Value) -> Result<T, String>,
) -> Result<Option<T>, String> {
    if value.is_null() {
        Ok(None)
    } else {
        read(value).map(Some)
    }
}

fn numbers(value: &Value, name: &str) -> Result<Vec<f64>, String> {
    let all: Option<Vec<f64>> = list(value, name)?.iter().map(Value::as_f64).collect();
    all.ok_or_else(|| format!("{name} must hold numbers"))
}

fn pair(value: &Value, name: &str) -> Result<[f64; 2], String> {
    <[f64; 2]>::try_from(numbers(value, name)?).map_err(|_| format!("{name} must have two entries"))
}

fn square(value: &Value, name: &str) -> Result<DMatrix<f64>, String> {
    let rows = list(value, name)?.iter().map(|row| numbers(row, name));
    let rows = rows.collect::<Result<Vec<_>, _>>()?;
    let size = rows.len();
    if rows.iter().any(|row| row.len() != size) {
        return Err(format!("{name} is not square"));
    }
    let all = rows.into_iter().flatten();
    Ok(DMatrix::from_row_iterator(size, size, all))
}

fn point_mm(value: &Value, name: &str) -> Result<Vector3<f64>, String> {
    match numbers(value, name)?.as_slice() {
        [x, y, z] => Ok(Vector3::new(*x, *y, *z) * 1e-3),
        _ => Err(format!("{name} must have three coordinates")),
    }
}

fn points_mm(value: &Value, name: &str) -> Result<Vec<Vector3<f64>>, String> {
    list(value, name)?
        .iter()
        .map(|v| point_mm(v, name))
        .collect()
}

fn transform(value: &Value, name: &str) -> Result<Pose, String> {
    let rows = list(value, name)?;
    let mut numbers_of = Vec::new();
    for row in rows {
        numbers_of.push(numbers(row, name)?);
    }
    let whole = numbers_of.len() == 4 && numbers_of.iter().all(|row| row.len() == 4);
    if !whole {
        return Err(format!("{name} must be a 4x4 matrix"));
    }
    let rotation = Matrix3::from_fn(|i, j| numbers_of[i][j]);
    if (rotation * rotation.transpose() - Matrix3::identity()).norm() > 1e-6 {
        return Err(format!("{name} is not a rigid transformation"));
    }
    Ok(Pose::new(
        Vector3::from_fn(|i, _| numbers_of[i][3]) * 1e-3,
        Rotation3::from_matrix_unchecked(rotation),
    ))
}

fn tags(value: &Value) -> Result<Vec<Tag>, String> {
    let read = |tag: &Value| {
        let whole = |key: &str| tag[key].as_u64().and_then(|n| u32::try_from(n).ok());
        let corners = points_mm(&tag["corners_in_body_mm"], "corners_in_body_mm")?;
        Ok(Tag {
            id: whole("id").ok_or("a tag's id is missing")?,
            family: "36h11".to_owned(),
            size_m: tag["size_mm"]
                .as_f64()
                .ok_or("a tag's size_mm is missing")?
                * 1e-3,
            body: whole("body").ok_or("a tag's body is missing")?,
            corners_in_body_m: <[Vector3<f64>; 4]>::try_from(corners)
                .map_err(|_| "a tag has four corners")?,
        })
    };
    list(value, "tags")?.iter().map(read).collect()
}
