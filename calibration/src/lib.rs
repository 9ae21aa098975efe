//! Self-calibration: the robot's anchors, initial lengths, camera and tags from cable lengths,
//! tensions and pictures of tags at a few poses.
//!
//! | file | what it is for |
//! |---|---|
//! | [`data`] | what was measured, and what is known beforehand; `read` is its file form |
//! | [`check`] | what can be said against data before anything is solved |
//! | [`pnp`] | where tags are in one picture |
//! | `unknowns`, `rows` | what the joint method estimates, and what each measurement says about it |
//! | `normal`, `solve` | elimination of the poses; Levenberg-Marquardt; outliers |
//! | [`dense`] | the same as a plain implementation solves it, for comparison |
//! | `observability`, `predict` | what the data fix, and how far off the platform would be |
//! | [`mod@joint`], [`answer`] | the default method, its verdict and its file form |
//! | `assay` | upper poses against lower ones, the map of the expected error, what to measure next |
//! | [`mod@paper`], `hand_eye`, `lengths` | the paper's method, for comparison; anchors from lengths where tag poses are given |
//! | `design`, [`space`], [`views`], [`plan`] | worth of poses, where they can be, what is seen there, their choice |
//! | [`result`] | the calibration in its file form, and the robot that it makes |
//! | [`target`] | tags to print |
//! | [`general`] | whatever sensors there are, real scatter, several sessions |
//! | [`slip`] | is the calibration of the running robot still true, and which cable slipped |
//! | [`verify`] | against poses measured by other means |
//! | [`mod@simulate`], [`study`] | data of a known robot, and errors over them |

pub mod answer;
mod assay;
pub mod check;
mod corner;
pub mod data;
pub mod dense;
mod design;
pub mod error;
mod fit;
pub mod general;
mod hand_eye;
pub mod joint;
mod lengths;
mod normal;
mod observability;
pub mod paper;
pub mod plan;
pub mod pnp;
mod predict;
mod read;
pub mod result;
mod rows;
pub mod simulate;
pub mod slip;
mod solve;
pub mod space;
pub mod study;
pub mod target;
mod unknowns;
pub mod verify;
pub mod views;

pub use answer::Answer;
pub use data::Data;
pub use error::Refusal;
pub use joint::{Options, joint};
