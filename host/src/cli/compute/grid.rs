//! The grid of `mcdpr workspace`: points, verdicts, counts.

use super::workspace::{Question, Test};
use crate::compute::{ComputeError, Subject};
use crate::units::Quantity;
use mcdpr_kinematics::{
    AnyRobot, Bound, EquilibriumGuess, Error, Grid, Pose, StaticOptions, Verdict,
};
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Most points of a grid: some seconds of a test at given tensions, half an hour of the rule of plans, 100 MB.
const MOST_POINTS: f64 = 2e7;

/// Result at a grid point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cell {
    /// The verdict of the statics.
    Judged(Verdict),
    /// It would be feasible, but these two cables (from 1) come too near.
    CablesNear([u8; 2]),
    /// It would be feasible, but this cable (from 1) comes too near to the platform's body.
    PlatformNear(u8),
}

impl Cell {
    pub(super) fn is_feasible(self) -> bool {
        matches!(self, Self::Judged(Verdict::Feasible))
    }

    /// Its name in files, and the cable concerned (from 1).
    pub(super) fn name(self) -> (&'static str, Option<u8>) {
        match self {
            Self::Judged(verdict) => match verdict {
                Verdict::Feasible => ("feasible", None),
                Verdict::Limited { cable, bound } => match bound {
                    Bound::Minimum => ("below_minimum", Some(cable)),
                    Bound::Maximum => ("above_maximum", Some(cable)),
                },
                Verdict::NoPath { cable } => ("no_path", Some(cable)),
                Verdict::Tilted => ("tilted", None),
                Verdict::Unstable => ("unstable", None),
                Verdict::Unbalanced => ("unbalanced", None),
            },
            Self::CablesNear([first, _]) => ("cables_near", Some(first)),
            Self::PlatformNear(cable) => ("platform_near", Some(cable)),
        }
    }
}

/// The grid over a box with a step; its points begin at the lowest corner.
///
/// # Errors
/// [`ComputeError::Grid`] for a step that gives no points or too many.
pub(super) fn over(bounds: [Vector3<f64>; 2], step_m: f64) -> Result<Grid, ComputeError> {
    let [low, high] = bounds;
    // Rounding must not drop the last point.
    let fitting = (high - low).map(|extent| (extent / step_m * (1.0 + 1e-12)).floor() + 1.0);
    let points = fitting.product();
    if !(step_m > 0.0 && (1.0..=MOST_POINTS).contains(&points)) {
        return Err(ComputeError::Grid {
            step_mm: step_m * 1e3,
            points,
            most: MOST_POINTS,
        });
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "checked above"
    )]
    let counts = fitting.map(|n| n as usize);
    Ok(Grid {
        min_m: low,
        max_m: low + fitting.map(|n| (n - 1.0) * step_m),
        counts: counts.into(),
    })
}

/// A world axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Axis {
    X,
    Y,
    Z,
}

impl Axis {
    /// Axis and place (m) from a text such as `z=-100`.
    ///
    /// # Errors
    /// [`ComputeError::Slice`] or [`ComputeError::Quantity`].
    pub(super) fn parse(text: &str) -> Result<(Self, f64), ComputeError> {
        let wrong = || ComputeError::Slice {
            text: text.to_owned(),
        };
        let (axis, place) = text.split_once('=').ok_or_else(wrong)?;
        let axis = match axis.trim() {
            "x" => Self::X,
            "y" => Self::Y,
            "z" => Self::Z,
            _ => return Err(wrong()),
        };
        Ok((axis, super::quantity("--slice", Quantity::Length, place)?))
    }

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
        }
    }

    pub(super) const fn index(self) -> usize {
        self as usize
    }

    /// Indices of the other two axes, ascending.
    pub(super) const fn others(self) -> [usize; 2] {
        match self {
            Self::X => [1, 2],
            Self::Y => [0, 2],
            Self::Z => [0, 1],
        }
    }

    /// The grid with one layer across this axis.
    pub(super) fn cut(self, grid: &Grid, place_m: f64) -> Grid {
        let mut cut = *grid;
        let k = self.index();
        cut.min_m[k] = place_m;
        cut.max_m[k] = place_m;
        if let Some(count) = cut.counts.get_mut(k) {
            *count = 1;
        }
        cut
    }
}

/// Judges every point of a grid, on all cores.
///
/// # Errors
/// Errors of invalid limits and tensions.
pub(super) fn assess(
    subject: &Subject,
    question: &Question,
    grid: &Grid,
) -> Result<Vec<Cell>, ComputeError> {
    // With a given attitude the solver needs the platform's origin.
    let mut of_origin = *grid;
    if question.test != Test::Equilibrium {
        let shift = question.rotation() * question.point_m;
        of_origin.min_m -= shift;
        of_origin.max_m -= shift;
    }
    let (verdicts, tensions): (Vec<_>, Vec<_>) = match &question.planned {
        Some(planned) => {
            let judged = planned.workspace(&subject.geometry, grid, &question.limits())?;
            judged.into_iter().unzip()
        }
        None => {
            let geometry = &subject.geometry;
            let verdicts = geometry.workspace_parallel(&of_origin, &question.test())?;
            (verdicts, Vec::new())
        }
    };
    let at = |index: usize| tensions.get(index).unwrap_or(&question.tensions_n);
    let mut cells: Vec<_> = verdicts.into_iter().map(Cell::Judged).collect();
    if question.clearance_m.is_some() {
        cells
            .par_iter_mut()
            .enumerate()
            .try_for_each(|(index, cell)| {
                if cell.is_feasible() {
                    let place = of_origin.point_m(index);
                    *cell = near(&subject.geometry, question, &place, at(index))?.unwrap_or(*cell);
                }
                Ok::<_, ComputeError>(())
            })?;
    }
    Ok(cells)
}

/// The cable, if any, that comes too near to an obstacle at a feasible point.
fn near(
    geometry: &AnyRobot,
    question: &Question,
    place_m: &Vector3<f64>,
    tensions_n: &[Option<f64>],
) -> Result<Option<Cell>, Error> {
    let Some(clearance_m) = question.clearance_m else {
        return Ok(None);
    };
    let pose = match question.test {
        Test::Equilibrium => {
            let found = geometry.equilibrium_at(
                &question.point_m,
                place_m,
                tensions_n,
                EquilibriumGuess::Cold,
                &StaticOptions::default(),
            );
            found?.pose
        }
        Test::Wrench | Test::Forces => Pose::new(*place_m, question.rotation()),
    };
    let number = |cable: usize| u8::try_from(cable).unwrap_or(u8::MAX);
    if let Some(pair) = geometry.closest_cables(&pose)?
        && pair.distance_m < clearance_m
    {
        return Ok(Some(Cell::CablesNear(pair.cables.map(number))));
    }
    if let Some(body) = &question.body {
        // The end at the attachment touches by design; so does everything within the clearance of
        // it.
        let stub_m = 2.0 * clearance_m;
        let nearest = geometry.closest_to_platform(&pose, body, stub_m)?;
        if nearest.distance_m < clearance_m {
            return Ok(Some(Cell::PlatformNear(number(nearest.cable))));
        }
    }
    Ok(None)
}

/// How often each cable is the limit.
#[derive(Debug, Clone, Copy, Default, Serialize)]
struct Limiting {
    cable: usize,
    below_minimum: usize,
    above_maximum: usize,
    no_path: usize,
    platform_near: usize,
}

/// How often two cables come too near.
#[derive(Debug, Clone, Copy, Serialize)]
struct Pair {
    cables: [u8; 2],
    points: usize,
}

/// Number of points per verdict.
#[derive(Debug, Serialize)]
pub(super) struct Counts {
    verdicts: BTreeMap<&'static str, usize>,
    limiting: Vec<Limiting>,
    cables_near: Vec<Pair>,
}

impl Counts {
    /// Counts the cells of a robot with so many cables.
    pub(super) fn of(cells: &[Cell], cables: usize) -> Self {
        let names = [
            "feasible",
            "below_minimum",
            "above_maximum",
            "no_path",
            "tilted",
        ];
        let more = ["unstable", "unbalanced", "cables_near", "platform_near"];
        let mut verdicts: BTreeMap<_, _> = names
            .into_iter()
            .chain(more)
            .map(|name| (name, 0))
            .collect();
        let mut limiting: Vec<_> = (1..=cables)
            .map(|cable| Limiting {
                cable,
                ..Limiting::default()
            })
            .collect();
        let mut pairs: BTreeMap<[u8; 2], usize> = BTreeMap::new();
        for cell in cells {
            let (name, cable) = cell.name();
            *verdicts.entry(name).or_default() += 1;
            let row = cable.and_then(|cable| limiting.get_mut(usize::from(cable).checked_sub(1)?));
            match (cell, row) {
                (Cell::CablesNear(pair), _) => *pairs.entry(*pair).or_default() += 1,
                (Cell::PlatformNear(_), Some(row)) => row.platform_near += 1,
                (Cell::Judged(Verdict::NoPath { .. }), Some(row)) => row.no_path += 1,
                (Cell::Judged(Verdict::Limited { bound, .. }), Some(row)) => match bound {
                    Bound::Minimum => row.below_minimum += 1,
                    Bound::Maximum => row.above_maximum += 1,
                },
                _ => {}
            }
        }
        Self {
            verdicts,
            limiting,
            cables_near: pairs
                .into_iter()
                .map(|(cables, points)| Pair { cables, points })
                .collect(),
        }
    }

    /// Number of feasible points.
    pub(super) fn feasible(&self) -> usize {
        self.verdicts.get("feasible").copied().unwrap_or(0)
    }

    /// A table for users: points that are not feasible, and the limiting cable.
    pub(super) fn rows(&self) -> Vec<Vec<String>> {
        let head = ["not feasible", "points"].map(str::to_owned).to_vec();
        let mut rows = vec![head];
        let mut row = |what: String, points: usize| {
            if points > 0 {
                rows.push(vec![what, points.to_string()]);
            }
        };
        for limiting in &self.limiting {
            let cable = limiting.cable;
            row(
                format!("cable {cable} below its least tension"),
                limiting.below_minimum,
            );
            row(
                format!("cable {cable} over its greatest tension"),
                limiting.above_maximum,
            );
            row(format!("cable {cable} has no path"), limiting.no_path);
            row(
                format!("cable {cable} too near to the platform"),
                limiting.platform_near,
            );
        }
        for pair in &self.cables_near {
            let [a, b] = pair.cables;
            row(format!("cables {a} and {b} too near"), pair.points);
        }
        for (name, words) in [
            ("tilted", "tilted too far"),
            ("unstable", "unstable"),
            ("unbalanced", "no equilibrium"),
        ] {
            row(
                words.to_owned(),
                self.verdicts.get(name).copied().unwrap_or(0),
            );
        }
        rows
    }
}

/// The points of a grid as CSV.
pub(super) fn table(grid: &Grid, cells: &[Cell]) -> String {
    let mut text = String::from("x_m,y_m,z_m,verdict,cable\n");
    for (index, cell) in cells.iter().enumerate() {
        let at = grid.point_m(index);
        let (name, cable) = cell.name();
        let cable = cable.map_or(String::new(), |cable| cable.to_string());
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{},{},{},{name},{cable}", at.x, at.y, at.z);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_has_both_ends_where_the_step_divides_the_box() {
        let bounds = [Vector3::new(0.0, -0.3, -0.7), Vector3::new(0.1, 0.3, -0.65)];
        let grid = over(bounds, 0.02).unwrap();
        assert_eq!(grid.counts, [6, 31, 3]);
        assert!((grid.max_m - Vector3::new(0.1, 0.3, -0.66)).norm() < 1e-12);
        for step_m in [0.0, -1.0, f64::NAN, 1e-6] {
            assert!(over(bounds, step_m).is_err(), "{step_m}");
        }
    }

    #[test]
    fn slices_are_named_by_axis() {
        assert_eq!(Axis::parse("z=-100").unwrap(), (Axis::Z, -0.1));
        assert_eq!(Axis::parse("x = 0.3m").unwrap(), (Axis::X, 0.3));
        for text in ["w=1", "z", "z=", "=3", "z=1deg"] {
            assert!(Axis::parse(text).is_err(), "{text}");
        }
        let grid = over([Vector3::zeros(), Vector3::repeat(0.1)], 0.05).unwrap();
        let cut = Axis::Y.cut(&grid, 7.0);
        assert_eq!(cut.counts, [3, 1, 3]);
        assert_eq!(cut.point_m(4), Vector3::new(0.05, 7.0, 0.05));
    }

    #[test]
    fn counts_add_up() {
        let low = Verdict::Limited {
            cable: 2,
            bound: Bound::Minimum,
        };
        let cells = [
            Cell::Judged(Verdict::Feasible),
            Cell::Judged(low),
            Cell::Judged(low),
            Cell::CablesNear([1, 3]),
            Cell::PlatformNear(3),
        ];
        let counts = Counts::of(&cells, 3);
        assert_eq!(counts.feasible(), 1);
        assert_eq!(counts.verdicts.values().sum::<usize>(), cells.len());
        assert_eq!(counts.limiting[1].below_minimum, 2);
        assert_eq!(counts.limiting[2].platform_near, 1);
        assert_eq!(counts.cables_near[0].cables, [1, 3]);
        let listed: usize = counts.rows()[1..]
            .iter()
            .map(|r| r[1].parse::<usize>().unwrap())
            .sum();
        assert_eq!(listed, 4);
    }
}
