//! Nothing: without a build script Cargo leaves out the build dependencies, whose features matter here.

fn main() {}
