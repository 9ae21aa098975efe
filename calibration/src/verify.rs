//! Compares a calibration with poses measured by other means, such as an external camera (the
//! paper's Table 6): the position from the lengths, and the observed one.

use mcdpr_core::motion::{Model, PlanError};
use mcdpr_core::robot::{Control, Robot};
use mcdpr_kinematics::{Held, Pose, Start, StaticOptions};
use nalgebra::{Matrix3, Vector3};

/// One measured pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Line of the file, from 1.
    pub line: usize,
    /// Change of each cable's length since home, as the encoders read it, m.
    pub encoder_m: Vec<f64>,
    /// Tension of the tension-held cable, N; the robot's set-point if not given.
    pub tension_n: Option<f64>,
    /// The observed origin of the platform, in the frame of the other instrument, m.
    pub seen_m: Vector3<f64>,
}

/// Why poses cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error, miette::Diagnostic)]
#[diagnostic(
    code(mcdpr_calibration::verify),
    help(
        "the columns are dl1_mm to dlN_mm, x_mm, y_mm, z_mm and, if wanted, tension_N; docs/calibration.md"
    )
)]
pub enum VerifyError {
    /// A column is missing.
    #[error("the poses have no column {column}")]
    Column {
        /// Its name.
        column: String,
    },
    /// A cell is not a finite number.
    #[error("line {line}, column {column}: \"{text}\" is not a finite number")]
    Cell {
        /// Line of the file, from 1.
        line: usize,
        /// The column.
        column: String,
        /// Its content.
        text: String,
    },
    /// Too few poses to determine the other instrument's frame.
    #[error("{got} poses are given, at least 4 are needed to find the other instrument's frame")]
    Few {
        /// How many.
        got: usize,
    },
    /// The lengths do not belong to any pose.
    #[error("line {line}: the lengths fit no resting pose: {what}")]
    Pose {
        /// Line of the file, from 1.
        line: usize,
        /// Why.
        what: String,
    },
    /// The poses do not determine a frame.
    #[error("the poses lie in one place or on one line, so that no frame can be fitted to them")]
    Degenerate,
}

/// Reads poses from CSV with a header line.
///
/// # Errors
/// [`VerifyError`] that names line and column.
pub fn rows(text: &str, cables: usize) -> Result<Vec<Row>, VerifyError> {
    let mut lines = text
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty());
    let header: Vec<&str> = lines
        .next()
        .map_or(Vec::new(), |(_, l)| l.split(',').map(str::trim).collect());
    let find = |name: &str| header.iter().position(|column| *column == name);
    let needed = |name: String| find(&name).ok_or(VerifyError::Column { column: name });
    let lengths: Vec<usize> = (1..=cables)
        .map(|i| needed(format!("dl{i}_mm")))
        .collect::<Result<_, _>>()?;
    let place: Vec<usize> = ["x_mm", "y_mm", "z_mm"]
        .iter()
        .map(|n| needed((*n).to_owned()))
        .collect::<Result<_, _>>()?;
    let tension = find("tension_N");
    let mut out = Vec::new();
    for (at, line) in lines {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let number = |column: usize| {
            let text = cells.get(column).copied().unwrap_or("");
            let value = text.parse::<f64>().ok().filter(|x| x.is_finite());
            value.ok_or_else(|| VerifyError::Cell {
                line: at + 1,
                column: header.get(column).copied().unwrap_or("").to_owned(),
                text: text.to_owned(),
            })
        };
        let mm: Vec<f64> = place.iter().map(|c| number(*c)).collect::<Result<_, _>>()?;
        out.push(Row {
            line: at + 1,
            encoder_m: lengths
                .iter()
                .map(|c| Ok(number(*c)? * 1e-3))
                .collect::<Result<_, _>>()?,
            tension_n: tension.map(number).transpose()?,
            seen_m: Vector3::from_iterator(mm.iter().map(|v| v * 1e-3)),
        });
    }
    if out.len() < 4 {
        return Err(VerifyError::Few { got: out.len() });
    }
    Ok(out)
}

/// Distances between the position from the lengths and the observed one, after the best rigid
/// motion between both frames, m, one per row.
///
/// # Errors
/// [`VerifyError`].
pub fn distances(robot: &Robot, rows: &[Row]) -> Result<Vec<f64>, VerifyError> {
    let failed = |line: usize| {
        move |error: PlanError| VerifyError::Pose {
            line,
            what: error.to_string(),
        }
    };
    let model = Model::new(robot).map_err(failed(0))?;
    model
        .comes_to_rest("the comparison with a tracker")
        .map_err(failed(0))?;
    let (home_m, scales) = match &robot.calibrated {
        Some(calibrated) => (
            calibrated.home_lengths_m.clone(),
            calibrated.drum_scales.clone(),
        ),
        None => {
            let home = model.rest_at_home().map_err(failed(0))?;
            (home.paid_out_m, vec![1.0; robot.cables.len()])
        }
    };
    let mut said = Vec::with_capacity(rows.len());
    for row in rows {
        let paid_out: Vec<f64> = row
            .encoder_m
            .iter()
            .zip(home_m.iter().zip(&scales))
            .map(|(dl, (home, scale))| home + dl * scale)
            .collect();
        let pose = resting(&model, &paid_out, row.tension_n).map_err(failed(row.line))?;
        said.push(pose.position_m);
    }
    let seen: Vec<Vector3<f64>> = rows.iter().map(|row| row.seen_m).collect();
    // The other instrument has a frame of its own: only what remains after the best motion is an
    // error.
    let (rotation, shift) = best_motion(&said, &seen).ok_or(VerifyError::Degenerate)?;
    let pairs = said.iter().zip(&seen);
    Ok(pairs
        .map(|(a, b)| (rotation * a + shift - b).norm())
        .collect())
}

/// How the robot hangs at paid-out lengths and a tension of its tension-held cable.
fn resting(model: &Model, paid_out_m: &[f64], tension_n: Option<f64>) -> Result<Pose, PlanError> {
    let robot = model.robot();
    if !model.holding().hangs() {
        // Lengths hold the whole pose. Tensions only stretch the cables: those at home are near enough.
        let home = model.rest_at_home()?;
        let rest = model.rest_from_lengths(paid_out_m, home.tensions_n())?;
        return Ok(rest.equilibrium.pose);
    }
    let held_n = tension_n.unwrap_or(robot.tension.setpoint_n);
    let mut tensions = vec![held_n; paid_out_m.len()];
    let mut pose = None;
    // The stretch depends on tensions that follow from the pose.
    for _ in 0..6 {
        let cables = robot.cables.iter().zip(paid_out_m.iter().zip(&tensions));
        let held: Vec<Held> = cables
            .map(|(cable, (length, tension))| match cable.control {
                Control::Tension => Held::Tension(held_n),
                Control::Position => {
                    let total = (length + cable.routing_length_m) * (1.0 + tension / cable.ea_n);
                    Held::Length(total - cable.routing_length_m)
                }
            })
            .collect();
        let start = pose.as_ref().map_or(Start::Cold, Start::Pose);
        let options = StaticOptions::default();
        let found = model.geometry().geometrico_static(&held, start, &options);
        let found = found.map_err(|source| PlanError::Lengths { source })?;
        tensions = found.tensions_n.iter().copied().collect();
        pose = Some(found.pose);
    }
    pose.ok_or(PlanError::Lengths {
        source: mcdpr_kinematics::Error::TooFewCables {
            solver: mcdpr_kinematics::Solver::GeometricoStatic,
            needed: 3,
            got: 0,
        },
    })
}

/// Rotation and shift that take the first points nearest to the second (Kabsch, 1976).
///
/// `None` where the first points lie on one line.
#[must_use]
pub fn best_motion(
    from: &[Vector3<f64>],
    to: &[Vector3<f64>],
) -> Option<(Matrix3<f64>, Vector3<f64>)> {
    let n = from.len() as f64;
    let middle = |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / n;
    let (a, b) = (middle(from), middle(to));
    let mut cross = Matrix3::zeros();
    for (p, q) in from.iter().zip(to) {
        cross += (q - b) * (p - a).transpose();
    }
    // Points on one line leave a turn about it open: the second singular value is then zero.
    let sizes = cross.singular_values();
    if sizes[1] < 1e-9 * sizes[0].max(1e-12) {
        return None;
    }
    let rotation = super::pnp::nearest_rotation(&cross)?.into_inner();
    Some((rotation, b - rotation * a))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    /// Poses of a robot, observed in a frame that is turned and shifted.
    fn table(robot: &Robot) -> String {
        let model = Model::new(robot).unwrap();
        let home = model.rest_at_home().unwrap();
        let turn = Rotation3::new(Vector3::new(0.3, -0.2, 1.1));
        let mut out = "x_mm,y_mm,z_mm,dl1_mm,dl2_mm,dl3_mm,dl4_mm,tension_N\n".to_owned();
        for (x, y, z) in [
            (0.255, -0.105, -0.18),
            (0.33, 0.0, -0.3),
            (0.4, 0.1, -0.25),
            (0.25, 0.12, -0.4),
            (0.42, -0.1, -0.35),
            (0.3, -0.05, -0.22),
        ] {
            let rest = model.rest(&Vector3::new(x, y, z), None).unwrap();
            let seen = turn * rest.equilibrium.pose.position_m + Vector3::new(0.1, 0.2, -0.5);
            let mut cells: Vec<String> = seen.iter().map(|v| (v * 1e3).to_string()).collect();
            let pairs = rest.paid_out_m.iter().zip(&home.paid_out_m);
            cells.extend(pairs.map(|(l, h)| ((l - h) * 1e3).to_string()));
            cells.push(rest.tensions_n()[3].to_string());
            out += &(cells.join(",") + "\n");
        }
        out
    }

    #[test]
    fn the_robots_own_poses_are_found_and_anothers_are_not() {
        let robot = Robot::built_in("paper-optimistic").unwrap();
        let rows = rows(&table(&robot), 4).unwrap();
        let worst = |robot: &Robot| {
            distances(robot, &rows)
                .unwrap()
                .into_iter()
                .fold(0.0, f64::max)
        };
        assert!(worst(&robot) < 1e-5, "{}", worst(&robot));
        let mut other = robot;
        other.cables[1].anchor_in_world_m.x += 5e-3;
        other.cables[2].anchor_in_world_m.z -= 5e-3;
        assert!(worst(&other) > 2e-4, "{}", worst(&other));
    }

    #[test]
    fn bad_tables_are_refused_with_line_and_column() {
        let good = table(&Robot::built_in("paper-optimistic").unwrap());
        let missing = rows(&good.replace("dl3_mm", "dl9_mm"), 4);
        assert_eq!(
            missing,
            Err(VerifyError::Column {
                column: "dl3_mm".into()
            })
        );
        let mut lines: Vec<String> = good.lines().map(str::to_owned).collect();
        lines[3] = lines[3].replacen(|c: char| c.is_ascii_digit(), "x", 1);
        let words = rows(&lines.join("\n"), 4).unwrap_err().to_string();
        assert!(words.contains("line 4, column x_mm"), "{words}");
        assert_eq!(
            rows(&lines[..3].join("\n"), 4),
            Err(VerifyError::Few { got: 2 })
        );
    }
}
