//! Self-calibration: the robot's anchors, initial lengths, camera and tags from cable lengths,
//! tensions and pictures of tags at a few poses.
//!
//! | file | what it is for |
//! |---|---|
//! | [`data`] | what was measured, and what is known beforehand; `read` is its file form |
//! | [`check`] | what can be said against data before anything is solved |
//! | [`pnp`] | where tags are in one picture |
//! | [`unknowns`], [`rows`] | what the joint method estimates, and what each measurement says about it |
//! | [`normal`], [`mod@solve`] | elimination of the poses; Levenberg-Marquardt; outliers |
//! | [`dense`] | the same as a plain implementation solves it, for comparison |
//! | [`observability`], [`predict`] | what the data fix, and how far off the platform would be |
//! | [`mod@joint`], [`answer`] | the default method, its verdict and its file form |
//! | [`assay`] | upper poses against lower ones, the map of the expected error, what to measure next |
//! | [`mod@paper`], [`hand_eye`], [`lengths`] | the paper's method, for comparison; anchors from lengths where tag poses are given |
//! | [`design`], [`space`], [`plan`], [`collect`] | worth of poses, where they can be, their choice; measuring them on a robot |
//! | [`result`] | the calibration as a file beside the robot file |
//! | [`target`] | tags to print |
//! | [`general`] | whatever sensors there are, real scatter, several sessions |
//! | [`slip`] | is the calibration of the running robot still true, and which cable slipped |
//! | [`verify`] | against poses measured by other means |
//! | [`mod@simulate`], [`study`] | data of a known robot, and errors over them |

pub mod answer;
pub mod assay;
pub mod check;
pub mod collect;
pub mod data;
pub mod dense;
pub mod design;
pub mod error;
pub mod general;
pub mod hand_eye;
pub mod joint;
pub mod lengths;
pub mod normal;
pub mod observability;
pub mod paper;
pub mod plan;
pub mod pnp;
pub mod predict;
mod read;
pub mod result;
pub mod rows;
pub mod simulate;
pub mod slip;
pub mod solve;
pub mod space;
pub mod study;
pub mod target;
pub mod unknowns;
pub mod verify;

pub use answer::Answer;
pub use data::Data;
pub use error::Refusal;
pub use joint::{Options, joint};
