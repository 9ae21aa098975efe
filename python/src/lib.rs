//! The native half of the Python package `mcdpr`: rows of numbers in and out. Shapes, names and
//! documentation for users are in the package itself (`python/mcdpr`).

#![expect(
    clippy::result_large_err,
    reason = "a failure ends the call: it becomes a Python exception at once"
)]

mod batch;
mod calibrate;
mod edit;
mod engine;
mod environment;
mod failure;
mod followed;
mod plan;
mod poses;
mod record;
mod robot;
mod rows;
mod session;
mod workspace;
mod world;

/// The module `mcdpr._mcdpr`.
#[pyo3::pymodule]
mod _mcdpr {
    #[pymodule_export]
    use super::calibrate::Answer;
    #[pymodule_export]
    use super::environment::Machines;
    #[pymodule_export]
    use super::followed::Followed;
    #[pymodule_export]
    use super::plan::Plan;
    #[pymodule_export]
    use super::record::Record;
    #[pymodule_export]
    use super::robot::{Robot, built_in};
    #[pymodule_export]
    use super::session::Session;

    /// Version of the package and the program.
    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");
}
