//! Host library.

pub mod link;
pub mod machine;
pub mod robot;
