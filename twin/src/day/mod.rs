//! A day of work, simulated at rest from second to second: picks with payloads, circles, looks at a mat.
//!
//! The machine is the simulator's plant at rest ([`mcdpr_simulator::plant::DayPlant`]); the robot's side
//! plans with its own model and knows encoder counts, tensions and pictures only. It works like the
//! robot file says, or as its tracked state says. Motion is slow: drives' lag and swing are not here.

mod machine;
mod robot;
#[cfg(test)]
mod tests;
mod work;

pub use work::{Day, DayError, Kind, Knocked, LoadError, Sample, Work};
