//! The slow states and where they stand in the vector.

/// Slow states of one cable.
pub(super) const PER_CABLE: usize = 12;
/// Slow states that all cables share.
const SHARED: usize = 14;

/// Positions of the states of a robot with some number of cables.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    pub(super) cables: usize,
}

impl Layout {
    pub(super) const fn size(self) -> usize {
        self.cables * PER_CABLE + SHARED
    }

    /// Cable on the drum side that the encoder does not know of, m.
    pub(super) const fn offset(self, cable: usize) -> usize {
        cable * PER_CABLE
    }

    /// Logarithm of the retardation time of the fast (0) and the slow (1) element over the assumed one.
    pub(super) const fn creep_time(self, cable: usize, element: usize) -> usize {
        cable * PER_CABLE + 1 + element
    }

    /// What the tension sensor shows without tension, N.
    pub(super) const fn zero(self, cable: usize) -> usize {
        cable * PER_CABLE + 3
    }

    /// Relative error of the tension sensor's gain.
    pub(super) const fn gain(self, cable: usize) -> usize {
        cable * PER_CABLE + 4
    }

    /// Relative error of the elastic compliance.
    pub(super) const fn compliance(self, cable: usize) -> usize {
        cable * PER_CABLE + 5
    }

    /// First of three: the anchor's error, world, m.
    pub(super) const fn anchor(self, cable: usize) -> usize {
        cable * PER_CABLE + 6
    }

    /// Final creep over elastic stretch of the fast (0) and the slow (1) element.
    pub(super) const fn creep_ratio(self, cable: usize, element: usize) -> usize {
        cable * PER_CABLE + 9 + element
    }

    /// Share of tension lost over the pulley.
    pub(super) const fn loss(self, cable: usize) -> usize {
        cable * PER_CABLE + 11
    }

    const fn shared(self) -> usize {
        self.cables * PER_CABLE
    }

    /// Error of the platform's mass (kg), and the next three of its moment: mass times centre, kg m.
    pub(super) const fn platform(self) -> usize {
        self.shared()
    }

    /// Mass of the payload (kg), and the next three its moment: mass times centre, kg m.
    pub(super) const fn payload(self) -> usize {
        self.shared() + 4
    }

    /// First of six: how far the camera is off its mounting, a shift (m) and a turn (rad), camera frame.
    pub(super) const fn camera(self) -> usize {
        self.shared() + 8
    }
}
