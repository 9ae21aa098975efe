//! Why picking ended.

use crate::motion::PlanError;
use crate::run::RunError;
use miette::Diagnostic;
use thiserror::Error;

/// Why picking failed. An empty tray is not an error.
#[derive(Debug, Error, Diagnostic)]
pub enum PickError {
    /// The board, the line, a fault, a stop.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Run(#[from] RunError),
    /// The robot cannot go there.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Plan(#[from] PlanError),
    /// No usable picture. Nothing was moved because of it.
    #[error("no usable picture: {0}")]
    #[diagnostic(
        code(mcdpr::pick::picture),
        help("see docs/vision.md for what a picture must have")
    )]
    Picture(#[from] mcdpr_vision::SourceError),
    /// The depth camera and the mat disagree.
    #[error(
        "the depth camera has the ground {depth_m:.3} m ahead, the printed mat lies {mat_m:.3} m ahead: \
         another depth unit, another mat, or something between"
    )]
    #[diagnostic(
        code(mcdpr::pick::distances),
        help(
            "check the depth unit of the camera and that the mat was printed at its size; --no-mat picks without"
        )
    )]
    Distances {
        /// By the depth camera, m.
        depth_m: f64,
        /// By the mat, m.
        mat_m: f64,
    },
    /// The simulated robot could not be calibrated beforehand.
    #[error("the simulated robot was to be calibrated first, and was not: {reason}")]
    #[diagnostic(
        code(mcdpr::pick::calibration),
        help(
            "`mcdpr calibrate all --target board` does the same step by step; --nominal picks without"
        )
    )]
    Calibration {
        /// Why not.
        reason: String,
    },
    /// Picking cannot continue: the position is not known.
    #[error("the board does not know its lengths")]
    #[diagnostic(
        code(mcdpr::pick::not_referenced),
        help("find out where the tool is: `mcdpr recover`; then `mcdpr pick --resume`")
    )]
    NotReferenced,
    /// Picking cannot continue: nobody knows what the jaws hold.
    #[error(
        "the jaws are closed, no switch says what they hold, and {weight_n:.1} N more than the platform's \
         weight are too little to tell"
    )]
    #[diagnostic(
        code(mcdpr::pick::jaws),
        help(
            "take what is in the jaws out of them, and run `mcdpr pick` from its start: it looks at the tray first"
        )
    )]
    Jaws {
        /// Weight by tensions and statics, N.
        weight_n: f64,
    },
    /// A simulated recovery refused.
    #[error("not recovered: {sentence}")]
    #[diagnostic(code(mcdpr::pick::not_recovered), help("{next}"))]
    NotRecovered {
        /// Why.
        sentence: String,
        /// What to do.
        next: String,
    },
    /// The picking was over before the simulated cut.
    #[error("the picking was over before the power failed")]
    #[diagnostic(code(mcdpr::pick::early), help("give --fault an earlier time"))]
    NotCut,
    /// The study's results cannot be saved.
    #[error("{file}: {reason}")]
    #[diagnostic(
        code(mcdpr::pick::kept),
        help(
            "a file of kept scenes has one JSON document a line, as --keep writes it; name another to begin anew"
        )
    )]
    Kept {
        /// Which file.
        file: String,
        /// Why not.
        reason: String,
    },
    /// The robot file has no gripper.
    #[error("the robot {robot} has no gripper")]
    #[diagnostic(
        code(mcdpr::pick::no_gripper),
        help("add [gripper] kind = \"digital\" with its stroke_mm to the robot file")
    )]
    NoGripper {
        /// Which robot.
        robot: String,
    },
    /// The robot file has no depth camera.
    #[error("the robot {robot} has no depth camera")]
    #[diagnostic(
        code(mcdpr::pick::no_depth),
        help("picking needs distances: set depth = true in [camera] if the camera gives them")
    )]
    NoDepth {
        /// Which robot.
        robot: String,
    },
    /// Objects would be released into the tray, or on its edge.
    #[error(
        "the place of release ({:.0}, {:.0}, {:.0}) mm is in the tray, whose middle is ({:.0}, {:.0}, {:.0}) mm",
        .release_mm[0], .release_mm[1], .release_mm[2], .tray_mm[0], .tray_mm[1], .tray_mm[2]
    )]
    #[diagnostic(
        code(mcdpr::pick::no_room),
        help(
            "give another with --release-mm or release_mm of [surroundings]: at least {:.0} mm from the middle in x or {:.0} mm in y",
            .half_mm[0], .half_mm[1]
        )
    )]
    NoRoom {
        /// Middle of the tray's floor, mm.
        tray_mm: [f64; 3],
        /// The place of release, mm.
        release_mm: [f64; 3],
        /// Least distances in x and y, mm.
        half_mm: [f64; 2],
    },
    /// No camera with distances was named.
    #[error("on {on} the pictures must come from a camera with distances, and none was named")]
    #[diagnostic(
        code(mcdpr::pick::no_camera),
        help(
            "--camera folder:DIR reads what a program of yours writes, --camera realsense a RealSense: see docs/vision.md"
        )
    )]
    NoCamera {
        /// Where the robot is.
        on: String,
    },
}

impl PickError {
    /// The program's exit code for this error.
    #[must_use]
    pub const fn exit_code(&self) -> i32 {
        match self {
            Self::Run(error) => error.exit_code(),
            _ => 1,
        }
    }
}
