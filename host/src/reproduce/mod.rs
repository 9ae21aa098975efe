//! The paper's experiments, repeated on the simulator, with the paper's numbers beside ours.
//!
//! Three columns of ours: under the paper's conditions (the machine exactly as described), under
//! realistic conditions (mismatch and pulley loss), and on the emulated chip, which executes the
//! firmware file. The simulator replaces CoppeliaSim, and the hardware: a number of the paper's
//! hardware beside one of a simulation compares a prototype with a model, and the table says so in
//! every row.

mod calibration;
mod geometry;
mod grasp;
mod hold;
mod modules;
mod tracking;

use crate::chart::Chart;
use crate::report::html;
use crate::robot::{Robot, RobotError};
use crate::run::RunError;
use miette::Diagnostic;
use serde::Serialize;
use thiserror::Error;

/// Why an experiment could not be run.
#[derive(Debug, Error, Diagnostic)]
pub enum ReproduceError {
    /// There is no such experiment.
    #[error("there is no experiment {name}")]
    #[diagnostic(
        code(mcdpr::reproduce::unknown),
        help("the experiments are {}", EXPERIMENTS.map(|e| e.id).join(", "))
    )]
    Unknown {
        /// What was asked for.
        name: String,
    },
    /// A run failed.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Run(#[from] RunError),
    /// The robot could not be built.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Robot(#[from] RobotError),
    /// A quantity of a winch, a sensor or a path could not be measured or computed.
    #[error("{0}")]
    #[diagnostic(code(mcdpr::reproduce::failed))]
    Service(String),
    /// A calibration was refused.
    #[error("the calibration with seed {seed} was refused: {reason}")]
    #[diagnostic(code(mcdpr::reproduce::calibration))]
    Calibration {
        /// The seed.
        seed: u64,
        /// Why.
        reason: String,
    },
}

impl From<crate::motion::PlanError> for ReproduceError {
    fn from(error: crate::motion::PlanError) -> Self {
        Self::Run(error.into())
    }
}

/// Whether the paper measured or simulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Origin {
    /// On its prototype.
    Hardware,
    /// In CoppeliaSim.
    Simulation,
    /// By arithmetic on its printed numbers.
    Arithmetic,
}

/// One quantity.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Its name, with its unit.
    pub quantity: String,
    /// The paper's number.
    pub paper: String,
    /// Source of the paper's number.
    pub origin: Origin,
    /// Ours under the paper's conditions.
    pub as_described: String,
    /// Ours under realistic conditions.
    pub realistic: String,
    /// Ours on the emulated chip, realistic conditions.
    pub chip: String,
}

/// An experiment's outcome.
#[derive(Debug, Clone, Serialize)]
pub struct Outcome {
    /// Short name.
    pub id: &'static str,
    /// The paper's name for it.
    pub title: &'static str,
    /// Its quantities.
    pub rows: Vec<Row>,
    /// Notes needed for a comparison.
    pub notes: Vec<String>,
    /// Plots like the paper's figures.
    #[serde(skip)]
    pub charts: Vec<Chart>,
    /// Pictures like the paper's, as `svg` elements.
    #[serde(skip)]
    pub pictures: Vec<String>,
}

/// Inputs of all experiments.
pub struct Bench {
    /// First seed.
    pub seed: u64,
    /// Number of seeds for random quantities.
    pub seeds: u64,
    /// The firmware for the emulated chip's column, if there is one.
    pub firmware: Option<crate::machine::Firmware>,
}

/// An experiment.
pub struct Experiment {
    /// Short name, for `--only`.
    pub id: &'static str,
    /// The paper's name for it.
    pub title: &'static str,
    run: fn(&Bench) -> Result<Outcome, ReproduceError>,
}

/// All experiments, in the paper's order.
pub(crate) const EXPERIMENTS: [Experiment; 12] = [
    Experiment {
        id: "calibration",
        title: "Self-calibration in simulation (Table 3, Figure 12, Section 6.1.1)",
        run: calibration::free_poses,
    },
    Experiment {
        id: "grasp-pose",
        title: "Grasp pose before and after calibration (Table 4)",
        run: calibration::reachable_poses,
    },
    Experiment {
        id: "hardware-calibration",
        title: "Self-calibration of the prototype (Tables 5 and 6)",
        run: calibration::printed_numbers,
    },
    Experiment {
        id: "motor",
        title: "The motor's reduction (Section 3, Eq. 50)",
        run: modules::motor,
    },
    Experiment {
        id: "sensor",
        title: "Calibration of a tension sensor (Figure 16)",
        run: modules::sensor,
    },
    Experiment {
        id: "geometry",
        title: "The circle and the line at z = 24 mm, kinematics only (Tables 7 and 8)",
        run: geometry::at_24_mm,
    },
    Experiment {
        id: "circle",
        title: "The circle (Table 7, Figures 19 to 22)",
        run: tracking::circle,
    },
    Experiment {
        id: "line",
        title: "The line (Table 8, Figures 28 to 30)",
        run: tracking::line,
    },
    Experiment {
        id: "grasp-cycle",
        title: "Grasp, carry and release at the paper's places (Figures 26 and 27)",
        run: grasp::cycle,
    },
    Experiment {
        id: "picking",
        title: "Picking by pictures (Figures 13 to 15 and 23 to 25)",
        run: grasp::picking,
    },
    Experiment {
        id: "tension-static",
        title: "Constant tension at rest (Figures 31a and 32)",
        run: hold::at_rest,
    },
    Experiment {
        id: "tension-disturbed",
        title: "Constant tension under disturbance (Figures 31b and 33)",
        run: hold::disturbed,
    },
];

/// Experiments that are not reproduced, and why.
pub(crate) const NOT_REPRODUCED: [(&str, &str); 7] = [
    (
        "Table 3, the printed values themselves",
        "the printed initial lengths are geometrically impossible, and with vertical swivel axes \
         translation and yaw of the frame cannot be seen in these data: accuracy is stated in \
         quantities that do not depend on the frame",
    ),
    (
        "Tables 5 and 6",
        "measurements of one prototype; the 58.33 % cannot be derived from the printed numbers",
    ),
    (
        "Table 7 and 8 at z = 24 mm",
        "10 mm below the pulleys' tops the tensions exceed the sensors' range: the path is run at \
         z = -100 mm, and at 24 mm only its kinematics is computed",
    ),
    (
        "Figures 13 to 15, 23 to 25: the paper's own scenes",
        "its network has no public weights and its scenes are not described: the experiment \
         `picking` has scenes and a detector of the project's own, and the paper prints no number \
         to compare with",
    ),
    (
        "Figure 26, the return to (335, 0, -9) mm",
        "a hanging robot needs tensions over the sensors' range there: already 39.2 N at z = -60 mm",
    ),
    (
        "Figure 16 and the reduction 371.13, as measurements",
        "they are properties of one prototype; the simulated machine has them by its robot file, \
         and the experiments `sensor` and `motor` show only how well the commands find them again",
    ),
    (
        "Figures 17, 18, 23, 24, 31: photographs",
        "pictures of the laboratory hold no data",
    ),
];

/// Runs the experiments of these names, all if none is given; `progress` is called before each.
///
/// # Errors
/// [`ReproduceError`].
pub fn reproduce(
    bench: &Bench,
    only: &[String],
    mut progress: impl FnMut(&Experiment, usize, usize),
) -> Result<Vec<Outcome>, ReproduceError> {
    if let Some(name) = only
        .iter()
        .find(|name| EXPERIMENTS.iter().all(|e| e.id != name.as_str()))
    {
        return Err(ReproduceError::Unknown { name: name.clone() });
    }
    let wanted: Vec<_> = EXPERIMENTS
        .iter()
        .filter(|e| only.is_empty() || only.iter().any(|name| name == e.id))
        .collect();
    let mut outcomes = Vec::new();
    for (index, experiment) in wanted.iter().enumerate() {
        progress(experiment, index, wanted.len());
        outcomes.push((experiment.run)(bench)?);
    }
    Ok(outcomes)
}

/// The paper's robot.
fn paper_robot() -> Result<Robot, ReproduceError> {
    Ok(Robot::built_in("paper-table5")?)
}

/// An empty cell: the column does not apply.
fn none() -> String {
    "-".to_owned()
}

/// The rows of an outcome as a table, the head first.
#[must_use]
pub fn table(outcome: &Outcome) -> Vec<Vec<String>> {
    let head = [
        "quantity",
        "the paper",
        "its origin",
        "ours, as described",
        "ours, realistic",
        "ours, emulated chip",
    ];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    rows.extend(outcome.rows.iter().map(|row| {
        let origin = match row.origin {
            Origin::Hardware => "hardware",
            Origin::Simulation => "simulation",
            Origin::Arithmetic => "arithmetic",
        };
        vec![
            row.quantity.clone(),
            row.paper.clone(),
            origin.to_owned(),
            row.as_described.clone(),
            row.realistic.clone(),
            row.chip.clone(),
        ]
    }));
    rows
}

/// The report as one self-contained page.
#[must_use]
pub fn page(outcomes: &[Outcome], bench: &Bench) -> String {
    let mut body = format!(
        "<h1>The paper's experiments, reproduced</h1><p class=\"about\">Mai et al., Sensors 2026, \
         26(7), 2204. Ours are simulations, seeds {} to {}: this simulator takes the place of \
         CoppeliaSim and of the prototype. Rows whose origin is hardware compare a prototype with \
         a model. As described: the machine is exactly its file. Realistic: anchors, mass, \
         stiffness, drives and sensors off, 2 % of the tension lost at every pulley. Emulated \
         chip: as realistic, the control core is the firmware's own file{}.</p>",
        bench.seed,
        bench.seed + bench.seeds - 1,
        if bench.firmware.is_some() {
            ""
        } else {
            " (none was given: --firmware FILE, built by cargo fw)"
        },
    );
    for outcome in outcomes {
        body += &format!("<h2>{}</h2>", html::escape(outcome.title));
        body += &html::table(&table(outcome));
        for note in &outcome.notes {
            body += &format!("<p class=\"about\">{}</p>", html::escape(note));
        }
        body += "<div class=\"plots\">";
        for chart in &outcome.charts {
            body += &chart.svg();
        }
        for picture in &outcome.pictures {
            body += picture;
        }
        body += "</div>";
    }
    body += "<h2>What is not reproduced, and why</h2>";
    let mut rows = vec![vec!["what".to_owned(), "why".to_owned()]];
    let reasons = NOT_REPRODUCED.iter();
    rows.extend(reasons.map(|(what, why)| vec![(*what).to_owned(), (*why).to_owned()]));
    body += &html::table(&rows);
    html::page("The paper's experiments, reproduced", &body)
}
