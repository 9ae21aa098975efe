//! Host library.

pub mod robot;
