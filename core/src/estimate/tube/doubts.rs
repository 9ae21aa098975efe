//! How far a machine may be off from its description.

/// What is not known of a machine: standard deviations about its description. Errors with a known sign
/// count by their root mean square.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Doubts {
    /// Anchors, per axis, m.
    pub anchor_m: f64,
    /// Attachments, per axis, m.
    pub attachment_m: f64,
    /// Radius of each pulley, m.
    pub radius_m: f64,
    /// Paid-out lengths beyond what the home place says, each, m.
    pub length_m: f64,
    /// The place at home where the lengths were taken, per axis, m.
    pub home_m: f64,
    /// Radius of each drum, relative.
    pub drum: f64,
    /// Stiffness EA of each cable, relative.
    pub compliance: f64,
    /// Gain of each tension sensor, relative.
    pub gain: f64,
    /// Zero and remaining noise of each tension sensor, N.
    pub zero_n: f64,
    /// Tension lost at each pulley, beyond what the file says, as a share.
    pub loss: f64,
    /// Mass, relative.
    pub mass: f64,
    /// Centre of mass, per axis, m.
    pub center_m: f64,
    /// Force that no model has, per axis, share of the weight.
    pub force: f64,
    /// Moment that no model has, per axis, over the weight, m.
    pub moment_m: f64,
    /// A load that the plan does not know, at the tool, up to this mass, kg.
    pub payload_kg: f64,
    /// Bandwidth of each drive, relative.
    pub bandwidth: f64,
    /// How much later all drives follow than the inverse of their bandwidth says, as a share of it: their inner loops.
    pub loops: f64,
    /// Time by which the readings of all drives are late or early together, s.
    pub late_s: f64,
    /// Standard deviation of the swing over the amplitude that a plan excites by the platform's natural modes.
    pub swing: f64,
    /// Time in which a swing dies away to 1/e, s.
    pub swing_s: f64,
}

/// A uniform error of half width 1 as a standard deviation: one over the root of three.
pub(super) const UNIFORM: f64 = 0.577_350_269_189_625_8;
/// A sine of amplitude 1 stays within 0.997 for 95 % of the time: a normal distribution of this standard deviation within 1.
const SINE: f64 = 0.51;
/// Readings of drives are used as if they were half a tick old, beside whole ticks: any age within the tick, s.
const LATE_S: f64 = 5e-4 * UNIFORM;
/// A speed loop at least three times as fast as the position loop around it, the usual rule of cascades, and a current loop
/// within: drives follow later by a third of the position loop's time constant.
const LOOPS: f64 = 0.35;
/// Time in which a swing dies away, s. Nothing is known of a real platform's.
const SWING_S: f64 = 30.0;

impl Doubts {
    /// A machine whose anchors were measured with a tape, within 5 mm.
    #[must_use]
    pub const fn by_tape() -> Self {
        Self::within(5e-3)
    }

    /// A machine that is known by its robot file, its anchors within this half width, m: 5 mm by a tape
    /// measure, 0.3 mm surveyed.
    ///
    /// Half widths of 0.1 mm for attachments, 0.05 mm for the radii of pulleys, 1 mm for the centre of mass, 2 % of mass
    /// and of tension at the pulleys, 20 % of stiffness and bandwidth, 1 % of a sensor's gain.
    #[must_use]
    pub const fn within(anchors_m: f64) -> Self {
        Self {
            anchor_m: anchors_m * UNIFORM,
            attachment_m: 1e-4 * UNIFORM,
            radius_m: 5e-5 * UNIFORM,
            length_m: 3e-5,
            home_m: 0.0,
            drum: 0.0,
            compliance: 0.2 * UNIFORM,
            gain: 0.01 * UNIFORM,
            zero_n: 0.02,
            loss: 0.02,
            mass: 0.02 * UNIFORM,
            center_m: 1e-3 * UNIFORM,
            force: 0.0,
            moment_m: 0.0,
            payload_kg: 0.0,
            bandwidth: 0.2 * UNIFORM,
            loops: LOOPS,
            late_s: LATE_S,
            swing: SINE,
            swing_s: SWING_S,
        }
    }
}
