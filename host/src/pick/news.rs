//! What picking does now, for viewers.

use super::report::{End, Outcome};
use mcdpr_simulator::camera::Cell;
use mcdpr_simulator::camera::Shape;
use nalgebra::Vector3;
use serde::Serialize;

/// What the robot does now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Phase {
    /// The simulated machine is calibrated, the robot arms.
    Preparing,
    /// It moves to where it sees the tray, and takes a picture.
    Looking,
    /// Grasps are found in the picture and judged.
    Choosing,
    /// It measures the chosen grasp again from nearby.
    LookingAgain,
    /// It moves over the grasp.
    Approaching,
    /// It goes down to the grasp, corrected on the way.
    Descending,
    /// The jaws close.
    Closing,
    /// It lifts and weighs.
    Lifting,
    /// It carries the object to the release place.
    Carrying,
    /// The jaws open over the release place.
    Releasing,
    /// It goes back up with empty jaws, or to the final place.
    Returning,
}

/// A grasp that is not taken, and why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Refusal {
    /// The grasp's point in the world, m.
    pub at_m: [f64; 3],
    /// Distance between the contacts, m.
    pub width_m: f64,
    /// Why not.
    pub reason: &'static str,
}

/// A grasp that is taken.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Chosen {
    /// Commanded place of the tool, world, m.
    pub tool_m: [f64; 3],
    /// The two contacts, world, m.
    pub pads_m: [[f64; 3]; 2],
    /// Distance between the contacts, m.
    pub width_m: f64,
    /// Turn of the jaws, rad.
    pub wrist_rad: f64,
    /// Tilt of the tool there, rad.
    pub tilt_rad: f64,
    /// Its rank among all grasps, 0 to 1.
    pub rank: f64,
}

/// A body as two polygons of equal size, one opposite the other; world, m.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Prism {
    /// One end.
    pub low_m: Vec<[f64; 3]>,
    /// The other.
    pub high_m: Vec<[f64; 3]>,
}

/// News from a picking task, in the order in which things happen.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum News {
    /// The places of the task.
    Places {
        /// Middle of the tray's floor, world, m.
        tray_m: [f64; 3],
        /// Half of the tray's sides, m.
        half_m: [f64; 2],
        /// Where objects are released, world, m.
        release_m: [f64; 3],
    },
    /// The simulated objects, where they truly are now.
    Objects(Vec<Prism>),
    /// Something begins.
    Phase(Phase),
    /// A picture was judged.
    Judged {
        /// Grasps found in it.
        grasps: usize,
        /// Those that the robot could take.
        possible: usize,
        /// Those that it cannot take, the first of them.
        refused: Vec<Refusal>,
    },
    /// A grasp was chosen.
    Chosen(Chosen),
    /// A chosen grasp was given up on the way there.
    Refused(Refusal),
    /// What the jaws lifted was weighed.
    Weighed {
        /// Weight by the difference of tensions, N.
        weight_n: f64,
    },
    /// An attempt has ended.
    Attempt {
        /// How.
        outcome: Outcome,
        /// Weight of what was lifted, N; `None` if nothing was lifted.
        weight_n: Option<f64>,
    },
    /// Picking has ended.
    End(End),
}

/// Receives the news; the robot waits meanwhile, so it must return soon.
pub(crate) type Tell<'a> = Option<&'a dyn Fn(&News)>;

/// Corners of a circle in a drawing.
const CORNERS: u32 = 12;

/// The objects of a simulated cell as they are now.
pub(crate) fn objects(cell: &Cell) -> Vec<Prism> {
    let bodies = cell.objects().iter();
    bodies
        .flat_map(|body| {
            body.parts.iter().filter_map(|part| {
                let ring: Vec<[f64; 2]> = match part.shape {
                    Shape::Box { half_m: [x, y, _] } => {
                        vec![[-x, -y], [x, -y], [x, y], [-x, y]]
                    }
                    Shape::Cylinder { radius_m, .. } => (0..CORNERS)
                        .map(|corner| {
                            let turn = std::f64::consts::TAU * f64::from(corner);
                            let (sin, cos) = (turn / f64::from(CORNERS)).sin_cos();
                            [radius_m * cos, radius_m * sin]
                        })
                        .collect(),
                    Shape::Sheet { .. } => return None,
                };
                let half_m = match part.shape {
                    Shape::Box { half_m: [.., z] } => z,
                    Shape::Cylinder { half_m, .. } => half_m,
                    Shape::Sheet { .. } => 0.0,
                };
                let end = |z_m: f64| {
                    let points = ring.iter().map(|[x, y]| {
                        let on_body = part.body_from_part.point([*x, *y, z_m]);
                        body.world_from_body.point(on_body)
                    });
                    points.collect()
                };
                Some(Prism {
                    low_m: end(-half_m),
                    high_m: end(half_m),
                })
            })
        })
        .collect()
}

/// The contacts of jaws at a place, closing along a direction, world, m.
pub(super) fn pads(at_m: &Vector3<f64>, closing: &Vector3<f64>, width_m: f64) -> [[f64; 3]; 2] {
    let half = closing * (0.5 * width_m);
    [(at_m - half).into(), (at_m + half).into()]
}
