//! Collecting where tensions misbehave, or a cable slips.

mod high_up;
mod shaken;
mod slipping;
mod tilted;
