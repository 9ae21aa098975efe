//! Self-calibration: the robot's anchors, initial lengths, camera and tags from cable lengths,
//! tensions and pictures of tags at a few poses.
//!
//! | file | what it is for |
//! |---|---|
//! | [`data`] | measurements and prior knowledge; `read` is its file form |
//! | `causes` | mistakes that explain data which fit no robot |
//! | [`check`] | checks of the data before anything is solved |
//! | [`pnp`] | poses of tags from one picture |
//! | `unknowns`, `rows`, `stretch` | the unknowns of the joint method, the row of each measurement, the encoders' weights |
//! | `variance` | scatter and priors that the data widen |
//! | `normal`, `solve` | elimination of the poses; Levenberg-Marquardt; outliers |
//! | [`dense`] | the same in a plain implementation, for comparison |
//! | `observability`, `predict` | which unknowns the data determine, and the expected position error |
//! | [`mod@joint`], `fit`, `judge`, [`answer`] | the default method, its verdict and its file form |
//! | `assay` | upper poses against lower ones, the map of the expected error, the next pose to measure |
//! | `restart` | a start where the stated places of tags and camera are far off |
//! | [`mod@paper`], `hand_eye`, `lengths` | the paper's method, for comparison; anchors from lengths if tag poses are given |
//! | `design`, [`space`], [`views`], [`plan`] | information of poses, reachable poses, tags in view, selection |
//! | [`result`] | the calibration in its file form, and the calibrated robot |
//! | [`target`], [`sheets`] | tags to print, and the paper that they need |
//! | [`general`] | any combination of sensors, real scatter, several sessions |
//! | [`slip`] | checks the calibration of the running robot, and names the cable that slipped |
//! | [`verify`] | comparison with poses measured by other means |
//! | [`mod@simulate`], [`study`] | data of a known robot, and errors over them |

mod alike;
pub mod answer;
mod assay;
mod causes;
pub mod check;
mod corner;
pub mod data;
pub mod dense;
mod design;
pub mod drawing;
pub mod error;
mod fit;
pub mod general;
mod hand_eye;
pub mod joint;
mod judge;
mod lengths;
mod leverage;
mod normal;
mod observability;
pub mod paper;
pub mod plan;
pub mod pnp;
mod predict;
mod read;
mod restart;
pub mod result;
mod rows;
pub mod sheets;
pub mod simulate;
pub mod slip;
mod solve;
pub mod space;
mod stretch;
pub mod study;
pub mod target;
mod tilt;
mod unknowns;
mod variance;
pub mod verify;
pub mod views;

pub use answer::Answer;
pub use data::Data;
pub use error::Refusal;
pub use joint::{Options, joint};
