//! What is known of a robot's slow states before its first rest.

use super::rows::RowSigmas;

/// What is known of the states at the start, as standard deviations, and how fast they drift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Anchors, per axis, m.
    pub anchor_m: f64,
    /// Lengths, m. Where they were taken at home: beyond what the home place says.
    pub length_m: f64,
    /// Whether the lengths were taken at home, as a robot file describes it: they then contain the errors that anchors and
    /// stiffness make there.
    pub homed: bool,
    /// Relative error of the elastic compliance.
    pub compliance: f64,
    /// Relative error of a tension sensor.
    pub gain: f64,
    /// What a sensor shows without tension, N.
    pub zero_n: f64,
    /// Loss over each pulley: mean and standard deviation.
    pub loss: [f64; 2],
    /// Relative error of the platform's mass.
    pub mass: f64,
    /// Its centre, per axis, m.
    pub center_m: f64,
    /// Final creep at the tension set-point: mean and standard deviation, strain.
    pub creep: [f64; 2],
    /// Correlation of the final creep of cables of one rope, and of its fast and its slow part.
    pub creep_alike: f64,
    /// The camera's mounting: shift per axis, m, and turn, rad.
    pub camera: [f64; 2],
    /// Drift in eight hours: anchors and lengths, m.
    pub drift_m: f64,
    /// Drift of the tension sensors in eight hours, N.
    pub drift_n: f64,
    /// Logarithm of each retardation time of creep.
    pub creep_time: f64,
    /// Errors of each rest.
    pub rows: RowSigmas,
    /// Where a payload's centre is, below the tool: mean and standard deviation, m.
    pub below_m: [f64; 2],
    /// The same, sideways: standard deviation, m.
    pub grasp_m: f64,
    /// Greatest shift of the planned tool by what one rest taught, m.
    pub step_m: f64,
}

impl Default for Prior {
    /// A robot calibrated in the morning: the errors of `Mismatch::realistic`.
    fn default() -> Self {
        Self {
            anchor_m: 2e-4,
            length_m: 1e-4,
            homed: false,
            compliance: 0.12,
            gain: 0.006,
            zero_n: 0.05,
            loss: [0.01, 0.01],
            mass: 0.012,
            center_m: 6e-4,
            creep: [0.0015, 0.0015],
            creep_alike: 0.88,
            camera: [1e-4, 2e-4],
            drift_m: 1e-4,
            drift_n: 0.15,
            creep_time: 0.17,
            rows: RowSigmas::default(),
            below_m: [0.03, 0.02],
            grasp_m: 0.015,
            step_m: 5e-4,
        }
    }
}
