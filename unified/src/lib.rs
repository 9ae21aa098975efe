//! Nothing: the features of dependencies that all packages share. `Cargo.toml` gives the reason.
