//! What is known of a machine, and how well.

use super::doubts::{Doubts, UNIFORM};
use crate::motion::{Model, PlanError, StaticState};
use crate::robot::Robot;
use mcdpr_kinematics::{CablePath, CableVec, GRAVITY_MPS2};
use nalgebra::{DMatrix, DVector};

/// Unknown errors of one cable.
pub(super) const PER_CABLE: usize = 15;
/// Unknown errors of the whole machine.
const SHARED: usize = 12;
/// Pulleys of one build lose alike: correlation of their losses.
const LOSSES_ALIKE: f64 = 0.9;

/// Order of the errors in a covariance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Errors {
    /// Number of cables.
    pub cables: usize,
}

impl Errors {
    /// Number of errors.
    #[must_use]
    pub const fn count(self) -> usize {
        self.cables * PER_CABLE + SHARED
    }
    /// First of three: an anchor, world, m.
    #[must_use]
    pub const fn anchor(self, cable: usize) -> usize {
        cable * PER_CABLE
    }
    /// First of three: an attachment, platform's frame, m.
    #[must_use]
    pub const fn attachment(self, cable: usize) -> usize {
        cable * PER_CABLE + 3
    }
    /// What is paid out beyond what the encoder says, m.
    #[must_use]
    pub const fn length(self, cable: usize) -> usize {
        cable * PER_CABLE + 6
    }
    /// A drum's radius, relative.
    #[must_use]
    pub const fn drum(self, cable: usize) -> usize {
        cable * PER_CABLE + 7
    }
    /// 1/EA, relative.
    #[must_use]
    pub const fn compliance(self, cable: usize) -> usize {
        cable * PER_CABLE + 8
    }
    /// What a sensor shows too much, relative.
    #[must_use]
    pub const fn gain(self, cable: usize) -> usize {
        cable * PER_CABLE + 9
    }
    /// What a sensor shows without tension, N.
    #[must_use]
    pub const fn zero(self, cable: usize) -> usize {
        cable * PER_CABLE + 10
    }
    pub(super) const fn late(self, cable: usize) -> usize {
        cable * PER_CABLE + 11
    }
    /// How much longer a cable is without load: creep, strain.
    #[must_use]
    pub const fn strain(self, cable: usize) -> usize {
        cable * PER_CABLE + 12
    }
    /// A pulley's radius, m.
    #[must_use]
    pub const fn radius(self, cable: usize) -> usize {
        cable * PER_CABLE + 13
    }
    /// Tension lost at a pulley, as a share.
    #[must_use]
    pub(crate) const fn loss(self, cable: usize) -> usize {
        cable * PER_CABLE + 14
    }
    pub(super) const fn shared(self) -> usize {
        self.cables * PER_CABLE
    }
    /// Whether the tracker of slow changes has this error among its states.
    pub(super) const fn is_tracked(self, error: usize) -> bool {
        if error < self.shared() {
            matches!(error % PER_CABLE, 0..=2 | 6 | 8..=10 | 12 | 14)
        } else {
            error < self.payload()
        }
    }
    /// The platform's mass, kg.
    #[must_use]
    pub const fn mass(self) -> usize {
        self.shared()
    }
    /// First of three: its centre of mass, platform's frame, m.
    #[must_use]
    pub const fn center(self) -> usize {
        self.shared() + 1
    }
    pub(super) const fn payload(self) -> usize {
        self.shared() + 4
    }
    /// First of three: a force at the centre of mass, world, N.
    #[must_use]
    pub const fn force(self) -> usize {
        self.shared() + 5
    }
    /// First of three: a moment, world's axes, N m.
    #[must_use]
    pub const fn moment(self) -> usize {
        self.shared() + 8
    }
    pub(super) const fn all_late(self) -> usize {
        self.shared() + 11
    }
}

/// Cables and robot where the lengths were taken.
pub(super) type AtHome = (CableVec<CablePath>, StaticState);

/// What is known of a machine: the covariance of its errors, in the order of [`Errors`].
#[derive(Debug, Clone)]
pub struct Belief {
    pub(super) covariance: DMatrix<f64>,
    pub(super) doubts: Doubts,
    /// Whether the lengths were taken at home: their errors are then those of the geometry there.
    pub(super) homed: bool,
    /// Whether slow changes are tracked: what a tracked error does at home is then in the tracked lengths.
    pub(super) tracked: bool,
    /// In words, for reports.
    pub(super) source: String,
}

impl Belief {
    /// What is known of a robot: by its calibration, if one with a covariance is applied, else by its file.
    /// Errors that a calibration does not estimate keep those of `doubts`.
    #[must_use]
    pub fn of(robot: &Robot, doubts: &Doubts) -> Self {
        let others = spread(robot, doubts);
        let known = robot.calibrated.as_deref();
        let known = known.and_then(|known| Some((known, known.errors.clone()?)));
        let Some((known, mut covariance)) = known.filter(|(_, c)| c.shape() == others.shape())
        else {
            return Self {
                covariance: others,
                doubts: *doubts,
                homed: true,
                tracked: false,
                source: "the robot file alone".to_owned(),
            };
        };
        let open: Vec<usize> = (0..covariance.nrows())
            .filter(|k| covariance[(*k, *k)] <= 0.0)
            .collect();
        for (i, j) in open.iter().flat_map(|i| open.iter().map(move |j| (*i, *j))) {
            covariance[(i, j)] = others[(i, j)];
        }
        Self {
            covariance,
            doubts: *doubts,
            homed: false,
            tracked: false,
            source: format!("the calibration of {}", known.date),
        }
    }

    #[cfg(test)]
    pub(crate) fn variance(&self, error: usize) -> f64 {
        self.covariance[(error, error)]
    }

    /// The same, with what is tracked in place of the errors that it concerns: `tracked` is their covariance about
    /// zero, with the other rows and columns empty. The tracked lengths contain what tracked errors do where the lengths were
    /// taken. If that was at home (`homed`), they contain what the other errors do there as well.
    pub(crate) fn with_tracked(
        mut self,
        tracked: &DMatrix<f64>,
        homed: bool,
        source: &str,
    ) -> Self {
        let errors = Errors {
            cables: (self.covariance.nrows() - SHARED) / PER_CABLE,
        };
        let known = |error: usize| errors.is_tracked(error);
        // A calibration ties a pulley's radius to its cable's length: only what the length does not explain is left of it.
        for i in 0..errors.cables {
            let (radius, length) = (errors.radius(i), errors.length(i));
            let tie = self.covariance[(radius, length)];
            if self.covariance[(length, length)] > 0.0 {
                let explained = tie * tie / self.covariance[(length, length)];
                self.covariance[(radius, radius)] -= explained;
            }
        }
        for (i, j) in (0..errors.count()).flat_map(|i| (0..errors.count()).map(move |j| (i, j))) {
            if known(i) || known(j) {
                self.covariance[(i, j)] = tracked[(i, j)];
            }
        }
        self.homed &= homed;
        self.tracked = true;
        self.source = source.to_owned();
        self
    }

    /// The cables and the robot at home, if the lengths were taken there.
    pub(super) fn home(&self, model: &Model) -> Result<Option<AtHome>, PlanError> {
        if !self.homed {
            return Ok(None);
        }
        let rest = model.rest_at_home()?;
        Ok(Some((
            model.geometry().paths(&rest.equilibrium.pose)?,
            rest,
        )))
    }
}

/// Covariance of independent errors.
fn spread(robot: &Robot, doubts: &Doubts) -> DMatrix<f64> {
    let errors = Errors {
        cables: robot.cables.len(),
    };
    let mut sigmas = vec![0.0; errors.count()];
    for i in 0..errors.cables {
        for axis in 0..3 {
            sigmas[errors.anchor(i) + axis] = doubts.anchor_m;
            sigmas[errors.attachment(i) + axis] = doubts.attachment_m;
        }
        sigmas[errors.length(i)] = doubts.length_m;
        sigmas[errors.radius(i)] = doubts.radius_m;
        sigmas[errors.drum(i)] = doubts.drum;
        sigmas[errors.compliance(i)] = doubts.compliance;
        sigmas[errors.gain(i)] = doubts.gain;
        sigmas[errors.zero(i)] = doubts.zero_n;
        sigmas[errors.loss(i)] = doubts.loss;
        let lag_s = robot
            .winch_of(i)
            .map_or(0.0, |winch| 1.0 / winch.drive_bandwidth_rad_s);
        sigmas[errors.late(i)] = doubts.bandwidth * lag_s;
    }
    let weight_n = robot.platform.mass_kg * GRAVITY_MPS2;
    sigmas[errors.mass()] = doubts.mass * robot.platform.mass_kg;
    // Uniform from none to the greatest; the tube lies around the plan, which knows of none.
    sigmas[errors.payload()] = doubts.payload_kg * UNIFORM;
    sigmas[errors.all_late()] = doubts.late_s;
    for axis in 0..3 {
        sigmas[errors.center() + axis] = doubts.center_m;
        sigmas[errors.force() + axis] = doubts.force * weight_n;
        sigmas[errors.moment() + axis] = doubts.moment_m * weight_n;
    }
    let variances = sigmas.iter().map(|sigma| sigma * sigma);
    let mut covariance = DMatrix::from_diagonal(&DVector::from_iterator(errors.count(), variances));
    let lag_s = |i: usize| {
        robot
            .winch_of(i)
            .map_or(0.0, |winch| 1.0 / winch.drive_bandwidth_rad_s)
    };
    let pairs = (0..errors.cables).flat_map(|i| (0..errors.cables).map(move |j| (i, j)));
    for (i, j) in pairs {
        // Drives of one kind are late together.
        covariance[(errors.late(i), errors.late(j))] += doubts.loops.powi(2) * lag_s(i) * lag_s(j);
        if i != j {
            covariance[(errors.loss(i), errors.loss(j))] = LOSSES_ALIKE * doubts.loss.powi(2);
        }
    }
    covariance
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_tracked_takes_with_a_length_what_the_length_explains_of_a_radius() {
        let robot = Robot::built_in("planar-vertical").unwrap();
        let mut belief = Belief::of(&robot, &Doubts::by_tape());
        let errors = Errors {
            cables: robot.cables.len(),
        };
        // A calibration knows their sum within 0.1 mm, each within 2 mm.
        let (length, radius) = (errors.length(1), errors.radius(1));
        let (apart_m, sum_m) = (2e-3_f64, 1e-4_f64);
        belief.covariance[(length, length)] = apart_m * apart_m;
        belief.covariance[(radius, radius)] = apart_m * apart_m + sum_m * sum_m;
        belief.covariance[(length, radius)] = -apart_m * apart_m;
        belief.covariance[(radius, length)] = -apart_m * apart_m;
        let other_m2 = belief.covariance[(errors.radius(0), errors.radius(0))];
        let nothing = DMatrix::zeros(errors.count(), errors.count());
        let tracked = belief.with_tracked(&nothing, false, "a test").covariance;
        let left_m = tracked[(radius, radius)].sqrt();
        assert!((left_m / sum_m - 1.0).abs() < 1e-6, "{left_m}");
        assert_eq!(tracked[(errors.radius(0), errors.radius(0))], other_m2);
        assert!(tracked[(radius, length)].abs() + tracked[(length, length)] < 1e-18);
    }
}
