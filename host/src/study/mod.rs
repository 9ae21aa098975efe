//! Studies in the simulator: many seeds, medians, kept with seed and hash.

pub mod iso9283;
pub mod motion;
pub(crate) mod robots;
pub mod tube;
