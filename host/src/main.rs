//! The mcdpr program.
fn main() {}
