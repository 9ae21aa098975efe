//! Positions that an external tracker measured while a robot drove the test cycles.

use super::POSES;
use nalgebra::Vector3;
use thiserror::Error;

/// Columns of the file, in any order; others are ignored.
const COLUMNS: [&str; 5] = ["cycle", "pose", "x_mm", "y_mm", "z_mm"];

/// Why a tracker's file cannot be used.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum TrackerError {
    /// A column is missing.
    #[error("line 1: there is no column {0}; the file needs cycle, pose, x_mm, y_mm and z_mm")]
    Column(&'static str),
    /// A row that cannot be read.
    #[error("line {line}: {what}")]
    Row {
        /// Which, from 1.
        line: usize,
        /// What is wrong.
        what: String,
    },
    /// A pose without its position in some cycle.
    #[error(
        "pose P{pose} was measured in {found} cycles, P1 in {wanted}; each cycle needs all five"
    )]
    Missing {
        /// Which pose, from 1.
        pose: usize,
        /// Cycles in which it was measured.
        found: usize,
        /// Cycles of P1.
        wanted: usize,
    },
    /// No spread can be computed.
    #[error("there are {0} cycles; at least 2 are needed, the standard asks for 30")]
    Few(usize),
    /// The five places do not span a plane.
    #[error(
        "the measured places lie on one line; is the unit mm, and are the poses numbered 1 to 5?"
    )]
    Flat,
}

/// Reads a tracker's file: the positions attained at P1 to P5 in the order of the cycles, in the
/// tracker's frame, m.
///
/// # Errors
/// [`TrackerError`] with the line.
pub fn read(text: &str) -> Result<[Vec<Vector3<f64>>; POSES], TrackerError> {
    let mut lines = text.lines().enumerate();
    let head: Vec<&str> = lines
        .next()
        .map(|(_, line)| line.split(',').map(str::trim).collect())
        .unwrap_or_default();
    let mut place = [0; COLUMNS.len()];
    for (at, column) in place.iter_mut().zip(COLUMNS) {
        let found = head.iter().position(|name| *name == column);
        *at = found.ok_or(TrackerError::Column(column))?;
    }
    let mut rows: [Vec<(u64, Vector3<f64>)>; POSES] = Default::default();
    for (index, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        let wrong = |what: String| TrackerError::Row {
            line: index + 1,
            what,
        };
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let cell = |column: usize| {
            let text = cells.get(place[column]);
            text.copied()
                .ok_or_else(|| wrong(format!("{} is missing", COLUMNS[column])))
        };
        let whole = |column: usize| -> Result<u64, TrackerError> {
            let text = cell(column)?;
            let bad = |_| {
                wrong(format!(
                    "{} is `{text}`, not a whole number",
                    COLUMNS[column]
                ))
            };
            text.parse::<u64>().map_err(bad)
        };
        let metres = |column: usize| -> Result<f64, TrackerError> {
            let text = cell(column)?;
            let value = text.parse::<f64>().ok().filter(|v| v.is_finite());
            value
                .map(|mm| mm * 1e-3)
                .ok_or_else(|| wrong(format!("{} is `{text}`, not a number", COLUMNS[column])))
        };
        let (cycle, pose) = (whole(0)?, whole(1)?);
        let slot = usize::try_from(pose)
            .ok()
            .and_then(|pose| rows.get_mut(pose.checked_sub(1)?))
            .ok_or_else(|| wrong(format!("pose is {pose}, not 1 to {POSES}")))?;
        if slot.iter().any(|(known, _)| *known == cycle) {
            return Err(wrong(format!(
                "pose P{pose} of cycle {cycle} is there twice"
            )));
        }
        slot.push((cycle, Vector3::new(metres(2)?, metres(3)?, metres(4)?)));
    }
    for slot in &mut rows {
        slot.sort_by_key(|(cycle, _)| *cycle);
    }
    let cycles_of = |slot: &[(u64, Vector3<f64>)]| -> Vec<u64> {
        slot.iter().map(|(cycle, _)| *cycle).collect()
    };
    let wanted = cycles_of(&rows[0]);
    for (index, slot) in rows.iter().enumerate() {
        if cycles_of(slot) != wanted {
            return Err(TrackerError::Missing {
                pose: index + 1,
                found: slot.len(),
                wanted: wanted.len(),
            });
        }
    }
    if wanted.len() < super::LEAST_CYCLES {
        return Err(TrackerError::Few(wanted.len()));
    }
    Ok(rows.map(|slot| slot.into_iter().map(|(_, at)| at).collect()))
}

/// The same positions in the robot's frame: turned and shifted so that the barycentres of the five
/// poses come nearest to the commanded places. A tracker's frame is not known beforehand, so what a
/// rotation or a shift of the whole robot does to its accuracy is not seen.
///
/// # Errors
/// [`TrackerError::Flat`].
pub(crate) fn in_robot_frame(
    mut attained_m: [Vec<Vector3<f64>>; POSES],
    commanded_m: &[Vector3<f64>; POSES],
) -> Result<[Vec<Vector3<f64>>; POSES], TrackerError> {
    let middles: Option<Vec<_>> = attained_m.iter().map(|all| super::mean(all)).collect();
    let middles = middles.ok_or(TrackerError::Few(0))?;
    let (rotation, shift_m) =
        crate::calibration::verify::best_motion(&middles, commanded_m).ok_or(TrackerError::Flat)?;
    for at in attained_m.iter_mut().flatten() {
        *at = rotation * *at + shift_m;
    }
    Ok(attained_m)
}

#[cfg(test)]
mod tests {
    use super::super::Cube;
    use super::super::simulated::figures;
    use super::*;
    use nalgebra::Rotation3;

    fn file(cycles: u32, place: impl Fn(u32, usize) -> Vector3<f64>) -> String {
        let mut text = "time_s,cycle,pose,x_mm,y_mm,z_mm\n".to_owned();
        for cycle in 0..cycles {
            for pose in [5, 4, 3, 2, 1] {
                let at = place(cycle, pose) * 1e3;
                text.push_str(&format!("0.0,{cycle},{pose},{},{},{}\n", at.x, at.y, at.z));
            }
        }
        text
    }

    const CUBE: Cube = Cube {
        middle_m: Vector3::new(0.3, 0.0, -0.3),
        side_m: 0.2,
        normal: None,
    };

    #[test]
    fn a_tracker_in_another_frame_sees_the_same_repeatability() {
        let turn = Rotation3::new(Vector3::new(0.4, -1.1, 2.0));
        let poses_m = CUBE.poses_m();
        let text = file(30, |cycle, pose| {
            // One millimetre to either side in turn.
            let off = if cycle % 2 == 0 { 1e-3 } else { -1e-3 };
            turn * (poses_m[pose - 1] + Vector3::new(0.0, off, 0.0)) + Vector3::new(2.0, 1.0, 5.0)
        });
        let attained = in_robot_frame(read(&text).unwrap(), &poses_m).unwrap();
        let found = figures(&CUBE, &attained).unwrap();
        for pose in &found.poses {
            assert!(pose.accuracy_m < 1e-9, "{pose:?}");
            assert!((pose.repeatability_m - 1e-3).abs() < 1e-9, "{pose:?}");
        }
        assert!(found.distance.repeatability_m < 1e-9);
    }

    #[test]
    fn a_pose_that_is_off_is_found_but_not_a_shift_of_all() {
        let poses_m = CUBE.poses_m();
        let shifted = |off: [f64; POSES]| {
            let text = file(3, |_, pose| {
                poses_m[pose - 1] + Vector3::new(0.0, 0.0, off[pose - 1])
            });
            let attained = in_robot_frame(read(&text).unwrap(), &poses_m).unwrap();
            figures(&CUBE, &attained).unwrap()
        };
        let all = shifted([5e-3; POSES]);
        assert!(all.poses.iter().all(|pose| pose.accuracy_m < 1e-9));
        let one = shifted([5e-3, 0.0, 0.0, 0.0, 0.0]);
        // The middle is 5 mm above the others: 4 mm above the fitted frame.
        assert!((one.poses[0].accuracy_m - 4e-3).abs() < 1e-4, "{one:?}");
    }

    #[test]
    fn bad_files_are_refused_with_line_and_reason() {
        let said = |text: &str| read(text).unwrap_err().to_string();
        assert!(said("cycle,pose,x_mm,y_mm\n").contains("z_mm"));
        let head = "cycle,pose,x_mm,y_mm,z_mm\n";
        assert!(said(&format!("{head}1,1,0,0\n")).contains("line 2: z_mm is missing"));
        assert!(said(&format!("{head}1,1,0,nan,0\n")).contains("y_mm is `nan`"));
        assert!(said(&format!("{head}1,6,0,0,0\n")).contains("not 1 to 5"));
        assert!(said(&format!("{head}1,1,0,0,0\n1,1,0,0,0\n")).contains("twice"));
        assert!(said(&format!("{head}1,1,0,0,0\n")).contains("P2"));
        let one = file(1, |_, pose| CUBE.poses_m()[pose - 1]);
        assert!(said(&one).contains("at least 2"));
        let flat = read(&file(2, |_, _| Vector3::new(1.0, 2.0, 3.0))).unwrap();
        assert_eq!(
            in_robot_frame(flat, &CUBE.poses_m()),
            Err(TrackerError::Flat)
        );
    }
}
