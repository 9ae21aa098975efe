//! Collecting where tensions misbehave, or a cable slips, and on robots of other kinds.

mod flat;
mod high_up;
mod shaken;
mod slipping;
mod tilted;
