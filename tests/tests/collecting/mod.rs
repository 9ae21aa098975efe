//! Collecting where tensions misbehave.

mod high_up;
mod shaken;
