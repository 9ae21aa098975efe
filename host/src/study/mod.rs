//! Studies in the simulator: many seeds, medians, recorded with seed and hash.

pub mod motion;
