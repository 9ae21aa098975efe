//! Reads trackers and tapes of a data set, and writes them.

use super::data::{Sample, Set, Tape, Tracker};
use super::read::{first, reading};
use crate::data::matrix_mm;
use crate::read::{Node, Read};
use mcdpr_kinematics::Pose;
use nalgebra::Vector3;
use serde_json::{Map, Value, json};

/// Standard deviation of a point that is entered, m, if it is not stated.
const TOLERANCE_M: f64 = 2e-3;

fn named<'a>(node: &Node<'a>, known: &[String]) -> Read<&'a str> {
    let name = node.get("name")?;
    let word = name.text()?;
    if word.is_empty() || known.iter().any(|other| other == word) {
        return Err(name.wrong("must be a name that no other has"));
    }
    Ok(word)
}

/// A point in mm, or in m with the other ending.
fn point(node: &Node<'_>, key: &str) -> Read<Option<Vector3<f64>>> {
    let (mm, m) = (format!("{key}_mm"), format!("{key}_m"));
    first(node, &[(&mm, 1e-3), (&m, 1.0)])
        .map(|(node, factor)| Ok(Vector3::from(node.numbers::<3>()?) * factor))
        .transpose()
}

fn tolerance(node: &Node<'_>) -> Read<f64> {
    let given = node.optional("tolerance_mm");
    given.map_or(Ok(TOLERANCE_M), |node| Ok(node.positive()? * 1e-3))
}

/// The list `trackers` of the file.
pub(super) fn trackers(root: &Node<'_>) -> Read<Vec<Tracker>> {
    let (mut out, mut names) = (Vec::new(), Vec::new());
    let Some(list) = root.optional("trackers") else {
        return Ok(out);
    };
    for node in list.each(Ok)? {
        let name = named(&node, &names)?.to_owned();
        names.push(name.clone());
        out.push(Tracker {
            name,
            target_m: point(&node, "target")?,
            tolerance_m: tolerance(&node)?,
            start: None,
        });
    }
    Ok(out)
}

/// The list `tapes` of the file: both ends must be known.
pub(super) fn tapes(root: &Node<'_>) -> Read<Vec<Tape>> {
    let (mut out, mut names) = (Vec::new(), Vec::new());
    let Some(list) = root.optional("tapes") else {
        return Ok(out);
    };
    for node in list.each(Ok)? {
        let name = named(&node, &names)?.to_owned();
        names.push(name.clone());
        let end = |key: &str, what: &str| {
            point(&node, key)?.ok_or_else(|| {
                node.wrong(&format!(
                    "has no {key}_mm: give the tape's end on the {what}, or leave the tape out"
                ))
            })
        };
        out.push(Tape {
            name: name.clone(),
            from_m: end("from", "frame, in the frame of the anchors")?,
            to_m: end("to", "platform, in its frame")?,
            tolerance_m: tolerance(&node)?,
        });
    }
    Ok(out)
}

/// The readings of named instruments: an object from name to value.
fn by_name<'a>(node: &Node<'a>, names: &[&str], kind: &str) -> Read<Vec<(usize, Node<'a>)>> {
    let entries = node.value.as_object();
    let entries = entries
        .ok_or_else(|| node.wrong(&format!("must be an object: {kind}'s name to reading")))?;
    let mut out = Vec::with_capacity(entries.len());
    for (name, value) in entries {
        let index = names.iter().position(|known| known == name);
        let index = index.ok_or_else(|| {
            let known = match names {
                [] => format!("the file has no list {kind}s"),
                names => format!("the list {kind}s has {}", names.join(", ")),
            };
            node.wrong(&format!("names {kind} {name}, but {known}"))
        })?;
        let path = format!("{}.{name}", node.path);
        out.push((index, Node { value, path }));
    }
    Ok(out)
}

/// A sample's positions and poses by trackers.
pub(super) fn positions(
    node: &Node<'_>,
    trackers: &[Tracker],
    out: &mut Sample,
    notes: &mut Vec<String>,
) -> Read<()> {
    let names: Vec<&str> = trackers
        .iter()
        .map(|tracker| tracker.name.as_str())
        .collect();
    out.position_m = vec![[None; 3]; trackers.len()];
    out.turned = vec![None; trackers.len()];
    let number = out.number;
    if let Some((list, factor)) = first(node, &[("position_mm", 1e-3), ("position_m", 1.0)]) {
        for (index, value) in by_name(&list, &names, "tracker")? {
            if value.value.is_null() {
                continue;
            }
            let axes = value.each(Ok)?;
            if axes.len() != 3 {
                return Err(value.wrong(&format!("{} numbers, 3 needed", axes.len())));
            }
            for (k, axis) in axes.iter().enumerate() {
                let what = format!(
                    "sample {number}: tracker {}'s {}",
                    names[index],
                    ["x", "y", "z"][k]
                );
                out.position_m[index][k] = reading(axis, factor, &what, notes)?;
            }
        }
    }
    if let Some(list) = node.optional("H_tracker_target") {
        for (index, value) in by_name(&list, &names, "tracker")? {
            if value.value.is_null() {
                continue;
            }
            let pose = value.pose()?;
            out.position_m[index] = [0, 1, 2].map(|k| Some(pose.position_m[k]));
            out.turned[index] = Some(pose.rotation);
        }
    }
    Ok(())
}

/// A sample's distances by tapes.
pub(super) fn distances(
    node: &Node<'_>,
    tapes: &[Tape],
    out: &mut Sample,
    notes: &mut Vec<String>,
) -> Read<()> {
    let names: Vec<&str> = tapes.iter().map(|tape| tape.name.as_str()).collect();
    out.distance_m = vec![None; tapes.len()];
    let Some((list, factor)) = first(node, &[("distance_mm", 1e-3), ("distance_m", 1.0)]) else {
        return Ok(());
    };
    for (index, value) in by_name(&list, &names, "tape")? {
        let what = format!("sample {}: tape {}", out.number, names[index]);
        out.distance_m[index] = reading(&value, factor, &what, notes)?;
    }
    Ok(())
}

fn mm(v: &Vector3<f64>) -> [f64; 3] {
    [v.x * 1e3, v.y * 1e3, v.z * 1e3]
}

/// The instruments in the file form, by key.
pub(super) fn described(set: &Set) -> Vec<(&'static str, Value)> {
    let mut out = Vec::new();
    if !set.trackers.is_empty() {
        let list = set.trackers.iter().map(|tracker| {
            let mut one = json!({"name": tracker.name, "tolerance_mm": tracker.tolerance_m * 1e3});
            if let Some(target) = &tracker.target_m {
                one["target_mm"] = json!(mm(target));
            }
            one
        });
        out.push(("trackers", list.collect()));
    }
    if !set.tapes.is_empty() {
        let list = set.tapes.iter().map(|tape| {
            json!({
                "name": tape.name, "from_mm": mm(&tape.from_m), "to_mm": mm(&tape.to_m),
                "tolerance_mm": tape.tolerance_m * 1e3,
            })
        });
        out.push(("tapes", list.collect()));
    }
    out
}

/// Writes a sample's readings of these instruments.
pub(super) fn outside_json(set: &Set, sample: &Sample, out: &mut Value) {
    let (mut places, mut poses, mut lengths) = (Map::new(), Map::new(), Map::new());
    for (index, tracker) in set.trackers.iter().enumerate() {
        let Some(place) = sample.position_m.get(index) else {
            continue;
        };
        match (place, sample.turned.get(index)) {
            ([Some(x), Some(y), Some(z)], Some(Some(turned))) => {
                let pose = Pose::new(Vector3::new(*x, *y, *z), *turned);
                poses.insert(tracker.name.clone(), json!(matrix_mm(&pose)));
            }
            _ if sample.is_tracked(index) => {
                let mm = place.map(|axis| axis.map(|m| m * 1e3));
                places.insert(tracker.name.clone(), json!(mm));
            }
            _ => {}
        }
    }
    for (tape, read) in set.tapes.iter().zip(&sample.distance_m) {
        if let Some(read) = read {
            lengths.insert(tape.name.clone(), json!(read * 1e3));
        }
    }
    let all = [
        ("position_mm", places),
        ("H_tracker_target", poses),
        ("distance_mm", lengths),
    ];
    for (key, map) in all {
        if !map.is_empty() {
            out[key] = Value::Object(map);
        }
    }
}
