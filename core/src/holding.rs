//! Which cables are held by length and which by tension, and what that leaves the robot free to do.
//!
//! The lengths hold the platform: as many cables as it has freedoms that cables can hold are held by
//! length, the others by tension (position control for the pose, force control for the redundancy:
//! hybrid control as in Pott, 2018, section 7.4). So no two cables work against each other when a
//! sensor or a pulley is off.

use mcdpr_kinematics::{AnyRobot, Pose};
use miette::Diagnostic;
use nalgebra::{DMatrix, Vector3, Vector6};
use thiserror::Error;

/// Points closer than this are one point, m.
const SAME_M: f64 = 1e-6;
/// Below this ratio of least to greatest singular value the lengths do not hold a direction.
/// At this ratio 1 um of cable moves the platform by about 1 mm in that direction.
const LEAST_CONDITION: f64 = 1e-3;
/// Conditionings are compared in steps of this relative size: mirror images are equal.
const STEP: f64 = 1e-5;

/// What cables can do with the platform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Freedom {
    /// Three lengths place the tool; gravity decides the attitude.
    Hanging,
    /// Six lengths place and turn the platform.
    Pose,
    /// All cables meet in one point of the platform: three lengths place it, and it hangs level below.
    Point,
    /// All cables lie in a vertical plane and meet in one point: two lengths place it in the plane.
    PlanePoint {
        /// Unit normal of the plane, world.
        normal: Vector3<f64>,
    },
    /// All cables lie in a vertical plane: three lengths place and turn the platform in it.
    Plane {
        /// Unit normal of the plane, world.
        normal: Vector3<f64>,
    },
}

/// Why a set of length-held cables does not hold a robot.
#[derive(Debug, Clone, PartialEq, Error, Diagnostic)]
pub enum HoldingError {
    /// The wrong number of cables is held by length.
    #[error("{held} cables are held by length: {robot} needs {needed}")]
    #[diagnostic(
        code(mcdpr::plan::holding),
        help(
            "set control = \"auto\" for every cable of the robot file, or control = \"tension\" for the cables that keep it taut"
        )
    )]
    Count {
        /// Cables that are.
        held: usize,
        /// What kind of robot it is.
        robot: &'static str,
        /// What it needs.
        needed: &'static str,
    },
    /// A direction in which the platform can move although all lengths are held.
    #[error(
        "the cables held by length ({held}) do not hold the platform: nothing holds {direction}"
    )]
    #[diagnostic(
        code(mcdpr::plan::unheld),
        help("hold other cables by length: control = \"auto\" in the robot file chooses them")
    )]
    Unheld {
        /// The cables held by length, from 1.
        held: String,
        /// The free direction, in words.
        direction: String,
    },
    /// The load hangs beside the point in which its cables meet.
    #[error(
        "all cables meet in one point, and the centre of mass is not below it but {off_mm:.1} mm beside and {above_mm:.1} mm above it"
    )]
    #[diagnostic(
        code(mcdpr::plan::pendulum),
        help(
            "correct center_of_mass_mm or attachment_mm: such a load hangs straight below the point"
        )
    )]
    Pendulum {
        /// Horizontal distance, mm.
        off_mm: f64,
        /// Height, mm.
        above_mm: f64,
    },
}

/// Which cables are held by length, which by tension, and what the lengths hold.
#[derive(Debug, Clone, PartialEq)]
pub struct Holding {
    freedom: Freedom,
    by_length: Vec<usize>,
    by_tension: Vec<usize>,
}

/// Cables chosen to be held by length.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// Whether each cable is held by length.
    pub by_length: Vec<bool>,
    /// Least ratio of smallest to greatest singular value of their Jacobian over the work space.
    pub condition: f64,
    /// That of the next best choice; `None` if there is no other.
    pub next: Option<f64>,
}

impl Freedom {
    /// What the cables of a robot can do, from their geometry alone.
    #[must_use]
    pub fn of(geometry: &AnyRobot) -> Self {
        let cables = geometry.cables();
        let first = cables.first().map_or(Vector3::zeros(), |c| c.attachment_m);
        let point = cables
            .iter()
            .all(|cable| (cable.attachment_m - first).norm() < SAME_M);
        match (vertical_plane(geometry), point) {
            (Some(normal), true) => Self::PlanePoint { normal },
            (Some(normal), false) => Self::Plane { normal },
            (None, true) => Self::Point,
            (None, false) if cables.len() >= 6 => Self::Pose,
            (None, false) => Self::Hanging,
        }
    }

    /// The twists `[velocity, angular velocity]` (world, about the platform's origin) that lengths
    /// hold; for a hanging platform its translations.
    #[must_use]
    pub(crate) fn twists(&self) -> Vec<Vector6<f64>> {
        let shift = |v: Vector3<f64>| Vector6::new(v.x, v.y, v.z, 0.0, 0.0, 0.0);
        let turn = |v: Vector3<f64>| Vector6::new(0.0, 0.0, 0.0, v.x, v.y, v.z);
        let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
        match *self {
            Self::Hanging | Self::Point => vec![shift(x), shift(y), shift(z)],
            Self::Pose => vec![shift(x), shift(y), shift(z), turn(x), turn(y), turn(z)],
            Self::PlanePoint { normal } => vec![shift(normal.cross(&z)), shift(z)],
            Self::Plane { normal } => vec![shift(normal.cross(&z)), shift(z), turn(normal)],
        }
    }

    /// Unit normal of the vertical plane in which the robot moves, world; `None` for one that moves in space.
    #[must_use]
    pub const fn normal(&self) -> Option<Vector3<f64>> {
        match *self {
            Self::Plane { normal } | Self::PlanePoint { normal } => Some(normal),
            Self::Hanging | Self::Pose | Self::Point => None,
        }
    }

    /// How many cables must be held by length.
    #[must_use]
    pub fn count(&self) -> usize {
        match self {
            Self::Pose => 6,
            Self::PlanePoint { .. } => 2,
            Self::Hanging | Self::Point | Self::Plane { .. } => 3,
        }
    }

    /// Whether a motion may ask for an attitude.
    #[must_use]
    pub const fn turns(&self) -> bool {
        matches!(self, Self::Pose | Self::Plane { .. })
    }

    /// In words: the robot, and what it needs.
    fn words(&self) -> (&'static str, &'static str) {
        match self {
            Self::Hanging => ("a hanging platform", "exactly three, the rest by tension"),
            Self::Pose => (
                "a platform of six degrees of freedom",
                "exactly six, the rest by tension (or three, and gravity decides its attitude)",
            ),
            Self::Point => ("a load on one point", "exactly three, the rest by tension"),
            Self::PlanePoint { .. } => (
                "a load on one point in a plane",
                "exactly two, the rest by tension",
            ),
            Self::Plane { .. } => (
                "a platform in a plane",
                "exactly three, the rest by tension",
            ),
        }
    }
}

impl Holding {
    /// What these cables hold, judged at a pose.
    ///
    /// # Errors
    /// [`HoldingError`] with the number or the direction that is not held.
    pub fn new(geometry: &AnyRobot, by_length: &[bool], pose: &Pose) -> Result<Self, HoldingError> {
        Self::as_designed(geometry, geometry, by_length, pose)
    }

    /// What these cables hold where the robot is meant to be `designed`: the anchors that a calibration finds lie in no
    /// plane, nor its attachments in one point, and it moves as it was built to all the same.
    ///
    /// # Errors
    /// As [`Holding::new`].
    pub(crate) fn as_designed(
        geometry: &AnyRobot,
        designed: &AnyRobot,
        by_length: &[bool],
        pose: &Pose,
    ) -> Result<Self, HoldingError> {
        let mut freedom = Freedom::of(designed);
        let list = |wanted: bool| -> Vec<usize> {
            let pairs = by_length.iter().enumerate();
            pairs
                .filter_map(|(index, held)| (*held == wanted).then_some(index))
                .collect()
        };
        let (lengths, tensions) = (list(true), list(false));
        // Six cables and more may also be led as a platform that gravity turns.
        if freedom == Freedom::Pose && lengths.len() == 3 {
            freedom = Freedom::Hanging;
        }
        if lengths.len() != freedom.count() {
            let (robot, needed) = freedom.words();
            return Err(HoldingError::Count {
                held: lengths.len(),
                robot,
                needed,
            });
        }
        if matches!(freedom, Freedom::Point | Freedom::PlanePoint { .. }) {
            pendulum(designed)?;
        }
        // A hanging platform is judged where it hangs: its attitude follows from statics.
        if freedom != Freedom::Hanging
            && let Some((condition, direction)) = condition(geometry, &freedom, &lengths, pose)
            && condition < LEAST_CONDITION
        {
            let held: Vec<_> = lengths.iter().map(|i| (i + 1).to_string()).collect();
            return Err(HoldingError::Unheld {
                held: held.join(", "),
                direction: in_words(&direction),
            });
        }
        Ok(Self {
            freedom,
            by_length: lengths,
            by_tension: tensions,
        })
    }

    /// What the lengths hold.
    #[must_use]
    pub const fn freedom(&self) -> Freedom {
        self.freedom
    }

    /// The cables held by length, from 0, ascending.
    #[must_use]
    pub fn by_length(&self) -> &[usize] {
        &self.by_length
    }

    /// The cables held by tension, from 0, ascending.
    #[must_use]
    pub fn by_tension(&self) -> &[usize] {
        &self.by_tension
    }

    /// The first cable held by tension, from 0.
    #[must_use]
    pub fn first_by_tension(&self) -> Option<usize> {
        self.by_tension.first().copied()
    }

    /// Whether the lengths hold the platform at a pose.
    #[must_use]
    pub(crate) fn holds_at(&self, geometry: &AnyRobot, pose: &Pose) -> bool {
        condition(geometry, &self.freedom, &self.by_length, pose)
            .is_some_and(|(condition, _)| condition >= LEAST_CONDITION)
    }

    /// Whether gravity decides the attitude.
    #[must_use]
    pub fn hangs(&self) -> bool {
        self.freedom == Freedom::Hanging
    }
}

/// Chooses the cables to hold by length: of all sets of the right size that keep what is `fixed`
/// (`Some(true)`: by length), the one whose worst conditioning at the `poses` is best; equal ones in
/// ascending order.
///
/// # Errors
/// [`HoldingError`] where no set holds the platform.
pub fn choose(
    geometry: &AnyRobot,
    fixed: &[Option<bool>],
    poses: &[Pose],
) -> Result<Choice, HoldingError> {
    let freedom = Freedom::of(geometry);
    let (count, wanted) = (fixed.len(), freedom.count());
    let mut found: Vec<(f64, Vec<bool>)> = Vec::new();
    let mut worst_direction = None;
    // 16 cables at most: 65,536 sets, of which those of the right size are judged.
    for set in 0_u32..1 << count.min(16) {
        let by_length: Vec<bool> = (0..count).map(|i| set >> i & 1 == 1).collect();
        let lengths: Vec<usize> = (0..count).filter(|&i| set >> i & 1 == 1).collect();
        let kept = fixed
            .iter()
            .zip(&by_length)
            .all(|(fixed, held)| fixed.is_none_or(|fixed| fixed == *held));
        if lengths.len() != wanted || !kept {
            continue;
        }
        let mut least = f64::INFINITY;
        for pose in poses {
            if let Some((here, direction)) = condition(geometry, &freedom, &lengths, pose)
                && here < least
            {
                least = here;
                worst_direction = Some(direction);
            }
        }
        found.push((least, by_length));
    }
    // Of equal sets the one with the first cables comes first.
    let steps = |condition: f64| (libm::log(condition) / STEP).round();
    found.sort_by(|a, b| {
        let better = steps(b.0).total_cmp(&steps(a.0));
        better.then_with(|| b.1.cmp(&a.1))
    });
    let Some((condition, by_length)) = found.first().cloned() else {
        let (robot, needed) = freedom.words();
        let held = fixed.iter().filter(|held| **held == Some(true)).count();
        return Err(HoldingError::Count {
            held,
            robot,
            needed,
        });
    };
    if condition.is_nan() || condition < LEAST_CONDITION {
        let held: Vec<_> = (1..)
            .zip(&by_length)
            .filter_map(|(number, held)| held.then_some(number.to_string()))
            .collect();
        return Err(HoldingError::Unheld {
            held: held.join(", "),
            direction: worst_direction.map_or_else(|| "it".to_owned(), |d| in_words(&d)),
        });
    }
    Ok(Choice {
        by_length,
        condition,
        next: found.get(1).map(|(next, _)| *next),
    })
}

/// Ratio of least to greatest singular value of the Jacobian of some cables along the freedoms, and the
/// direction that they hold least. Turns count as the way of a point at the attachments' mean distance.
/// `None` where a cable has no path.
fn condition(
    geometry: &AnyRobot,
    freedom: &Freedom,
    cables: &[usize],
    pose: &Pose,
) -> Option<(f64, Vector6<f64>)> {
    let rows = geometry.twist_jacobian(pose).ok()?;
    let arms = geometry.cables().iter().map(|c| c.attachment_m.norm());
    let lever_m = (arms.sum::<f64>() / geometry.cable_count() as f64).max(SAME_M);
    let twists = freedom.twists();
    let scaled: Vec<Vector6<f64>> = twists
        .iter()
        .map(|twist| {
            let turning = twist.fixed_rows::<3>(3).norm() > 0.0;
            if turning { twist / lever_m } else { *twist }
        })
        .collect();
    let mut matrix = DMatrix::<f64>::zeros(cables.len(), scaled.len());
    for (r, &cable) in cables.iter().enumerate() {
        let row = rows.get(cable)?;
        for (c, twist) in scaled.iter().enumerate() {
            matrix[(r, c)] = row
                .iter()
                .zip(twist.iter())
                .map(|(a, b)| a * b)
                .sum::<f64>();
        }
    }
    let svd = matrix.svd(false, true);
    let least = svd.singular_values.imin();
    let greatest: f64 = svd.singular_values.max();
    let weights = svd.v_t?.row(least).transpose();
    let mut direction = Vector6::<f64>::zeros();
    for (weight, twist) in weights.iter().zip(&scaled) {
        direction += twist * *weight;
    }
    let ratio = svd.singular_values.get(least)? / greatest.max(f64::MIN_POSITIVE);
    Some((ratio, direction))
}

/// A twist in words.
fn in_words(twist: &Vector6<f64>) -> String {
    let shift = twist.fixed_rows::<3>(0).into_owned();
    let turn = twist.fixed_rows::<3>(3).into_owned();
    let unit = |v: Vector3<f64>| {
        let v = v.try_normalize(1e-12).unwrap_or_default();
        format!("({:.2}, {:.2}, {:.2})", v.x, v.y, v.z)
    };
    if turn.norm() < 1e-6 {
        return format!("a translation along {}", unit(shift));
    }
    if shift.norm() < 1e-3 * turn.norm() {
        return format!("a turn about {}", unit(turn));
    }
    let mm_per_degree = shift.norm() / turn.norm() * 1f64.to_radians() * 1e3;
    format!(
        "a turn about {} with a translation along {} of {mm_per_degree:.1} mm per degree",
        unit(turn),
        unit(shift)
    )
}

/// Whether a load on one point hangs level below it.
fn pendulum(geometry: &AnyRobot) -> Result<(), HoldingError> {
    let first = geometry.cables().first();
    let point = first.map_or(Vector3::zeros(), |c| c.attachment_m);
    let arm = geometry.platform().center_of_mass_m - point;
    let off_m = libm::hypot(arm.x, arm.y);
    // 1 mrad of tilt counts as level: 1 mm beside the point for a load 1 m below it.
    if off_m > 1e-3 * arm.z.abs() + SAME_M || arm.z > SAME_M {
        return Err(HoldingError::Pendulum {
            off_mm: off_m * 1e3,
            above_mm: arm.z * 1e3,
        });
    }
    Ok(())
}

/// Unit normal of the vertical plane in which all anchors, and all attachments of a level platform with
/// its origin in that plane, lie; `None` if there is no such plane.
#[must_use]
pub fn vertical_plane(geometry: &AnyRobot) -> Option<Vector3<f64>> {
    let cables = geometry.cables();
    let first = cables.first()?;
    let across = |v: &Vector3<f64>| Vector3::new(v.x, v.y, 0.0);
    let spread = cables
        .iter()
        .map(|cable| across(&(cable.anchor_m - first.anchor_m)));
    let widest = spread.fold(
        Vector3::zeros(),
        |a: Vector3<f64>, b| {
            if b.norm() > a.norm() { b } else { a }
        },
    );
    let normal = widest.cross(&Vector3::z()).try_normalize(1e-12)?;
    let flat = 1e-6 * widest.norm();
    cables
        .iter()
        .all(|cable| {
            let anchor = (cable.anchor_m - first.anchor_m).dot(&normal);
            anchor.abs() <= flat && cable.attachment_m.dot(&normal).abs() <= flat
        })
        .then_some(normal)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine;
    use crate::robot::Robot;

    fn home(robot: &Robot) -> Pose {
        Pose::level(robot.tool.home_in_world_m - robot.tool.tcp_in_platform_m)
    }

    #[test]
    fn every_shipped_robot_is_held() {
        for (name, freedom) in [
            ("paper-optimistic", 3),
            ("eight-cable", 6),
            ("planar-four", 2),
            ("three-point", 3),
        ] {
            let robot = Robot::built_in(name).unwrap();
            let geometry = machine::geometry(&robot).unwrap();
            let by_length: Vec<_> = robot
                .cables
                .iter()
                .map(|c| c.control == crate::robot::Control::Position)
                .collect();
            let holding = Holding::new(&geometry, &by_length, &home(&robot)).unwrap();
            assert_eq!(holding.by_length().len(), freedom, "{name}");
            assert_eq!(holding.freedom().count(), freedom, "{name}");
        }
    }

    #[test]
    fn cables_that_leave_a_direction_free_are_refused_with_it() {
        let robot = Robot::built_in("planar-four").unwrap();
        let geometry = machine::geometry(&robot).unwrap();
        let too_many = Holding::new(&geometry, &[true, true, true, false], &home(&robot));
        assert!(matches!(too_many, Err(HoldingError::Count { held: 3, .. })));
        // On the line between both anchors nothing holds the height.
        let pulley_m = 0.01;
        let between = Pose::level(Vector3::new(0.0, 0.0, 1.2 + pulley_m));
        let flat = Holding::new(&geometry, &[true, true, false, false], &between);
        if let Err(error) = flat {
            let text = error.to_string();
            assert!(
                text.contains("a translation along (0.00, 0.00, 1.00)"),
                "{text}"
            );
        } else {
            let (condition, _) =
                condition(&geometry, &Freedom::of(&geometry), &[0, 1], &between).unwrap();
            assert!(condition < 0.05, "{condition}");
        }
    }

    #[test]
    fn the_choice_is_the_best_of_all_sets() {
        let robot = Robot::built_in("eight-cable").unwrap();
        let geometry = machine::geometry(&robot).unwrap();
        let poses = [home(&robot)];
        let free = choose(&geometry, &[None; 8], &poses).unwrap();
        assert_eq!(free.by_length.iter().filter(|held| **held).count(), 6);
        assert!(
            free.next
                .is_some_and(|next| next <= free.condition * 1.0001)
        );
        let mut fixed = [None; 8];
        fixed[0] = Some(false);
        let other = choose(&geometry, &fixed, &poses).unwrap();
        assert!(!other.by_length[0] && other.condition <= free.condition * 1.0001);
    }
}
