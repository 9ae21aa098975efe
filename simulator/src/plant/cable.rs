//! One elastic cable: it pulls and never pushes, and its pulley takes a hysteretic share.

use super::error::PlantError;
use super::params::CableParams;
use super::pulley::{Path, Pulley};
use super::vec3::{V3, norm, scale};

/// Shortest unstretched cable that the plant still simulates (m).
const SHORTEST_M: f64 = 1e-3;

/// A cable's constants and state.
#[derive(Debug, Clone)]
pub(crate) struct Cable {
    pub pulley: Pulley,
    /// Attachment in principal axes about the centre of mass (m).
    pub attachment: V3,
    pub ea_n: f64,
    damping_time_s: f64,
    pub(super) routing_m: f64,
    pub(super) loss: f64,
    presliding_m: f64,
    /// Unstretched length from drum to attachment when the drum's displacement is 0 (m).
    pub unstretched_zero_m: f64,
    /// Cable wound per drum displacement: 1 unless the winding is disturbed.
    pub winding_gain: f64,
    /// Length without load over the length at the start: creep and warmth. 1 unless slow physics are on.
    pub growth: f64,
    /// State of the pulley's friction: +1 after hauling in, -1 after paying out.
    pub friction_state: f64,
    /// Cable paid out over the pulley when the friction state was last brought up to date (m).
    pub paid_out_m: f64,
    /// Tensions of the latest substep (N).
    pub tension: Tension,
    pub broken: bool,
    /// An external force sideways on the middle of the free part, world (N).
    pub side_pull_n: V3,
}

/// Tension on both sides of the pulley (N), and the same without the cable's damping, which
/// determines the stored elastic energy.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Tension {
    pub platform_n: f64,
    pub winch_n: f64,
    pub elastic_platform_n: f64,
}

impl Cable {
    pub(crate) fn new(p: &CableParams, attachment: V3) -> Self {
        Self {
            pulley: Pulley {
                anchor_m: p.anchor_m,
                axis: scale(p.swivel_axis, 1.0 / norm(p.swivel_axis)),
                radius_m: p.pulley_radius_m,
            },
            attachment,
            ea_n: p.ea_n,
            damping_time_s: p.damping_time_s,
            routing_m: p.routing_length_m,
            loss: p.pulley_loss,
            presliding_m: p.pulley_presliding_m,
            unstretched_zero_m: 1.0,
            winding_gain: 1.0,
            growth: 1.0,
            friction_state: 0.0,
            paid_out_m: 0.0,
            tension: Tension::default(),
            broken: false,
            side_pull_n: [0.0; 3],
        }
    }

    /// Unstretched length from drum to attachment (m).
    #[inline(always)]
    pub(crate) fn unstretched_m(&self, drum_m: f64) -> f64 {
        self.growth * (self.unstretched_zero_m + self.winding_gain * drum_m)
    }

    /// Cuts the cable to the length that carries `tension_n` along a path of `length_m`, without
    /// pulley friction, with the drum at displacement 0.
    pub(crate) fn cut_to(&mut self, length_m: f64, tension_n: f64) {
        // Stretched length = unstretched (1 + T / EA), solved for the unstretched one.
        self.unstretched_zero_m =
            (length_m + self.routing_m) / ((1.0 + tension_n / self.ea_n) * self.growth);
        self.rest_under(Tension {
            platform_n: tension_n,
            winch_n: tension_n,
            elastic_platform_n: tension_n,
        });
    }

    /// Starts over with the drum at displacement 0 and the pulley's friction undecided.
    pub(crate) fn rest_under(&mut self, tension: Tension) {
        self.friction_state = 0.0;
        self.tension = tension;
        self.paid_out_m = self.paid_out(0.0);
    }

    /// Tension for a path of `length_m` that grows by `path_rate` (m/s) while the drum, at
    /// displacement `drum_m`, pays out `drum_rate` (m/s).
    ///
    /// The free part and the routing behind the pulley stretch in series, the routing under the
    /// winch's tension. With the friction state s, winch = platform (1 + loss s).
    #[inline(always)]
    pub(crate) fn tension(
        &self,
        length_m: f64,
        path_rate: f64,
        drum_m: f64,
        drum_rate: f64,
    ) -> Tension {
        let unstretched = self.unstretched_m(drum_m);
        let stretch = length_m + self.routing_m - unstretched;
        if self.side_pull_n != [0.0; 3] && !self.broken {
            return self.plucked(length_m, stretch, unstretched);
        }
        if stretch <= 0.0 || self.broken {
            return Tension::default();
        }
        let ratio = 1.0 + self.loss * self.friction_state;
        // Free part under T, routing under ratio T: T (free + ratio routing) / EA is the stretch.
        let stiffness = self.ea_n / (unstretched + self.routing_m * (ratio - 1.0));
        let elastic_platform_n = stiffness * stretch;
        let rate = path_rate - self.growth * self.winding_gain * drum_rate;
        // A taut cable that shortens fast would push by its damping alone: it cannot.
        let platform_n = (elastic_platform_n + stiffness * self.damping_time_s * rate).max(0.0);
        Tension {
            platform_n,
            winch_n: platform_n * ratio,
            elastic_platform_n,
        }
    }

    /// Tension with a sideways force in the middle of the free part: the cable runs in two straight
    /// halves, and each half carries half of the force across the chord. The hand replaces the
    /// cable's own damping, so that is left out.
    fn plucked(&self, length_m: f64, stretch: f64, unstretched: f64) -> Tension {
        let half_n = 0.5 * norm(self.side_pull_n);
        let ratio = 1.0 + self.loss * self.friction_state;
        let stiffness = self.ea_n / (unstretched + self.routing_m * (ratio - 1.0));
        // Extra length of the cable over its chord, less the stretch by this tension: falls as the
        // tension rises, from infinity at half the force.
        let excess = |tension_n: f64| {
            let across = half_n / tension_n;
            // Half of a chord under an angle whose sine is `across`; 1e-12 keeps the root from
            // zero.
            let longer = length_m * (1.0 / (1.0 - across * across).max(1e-12).sqrt() - 1.0);
            stiffness * (stretch + longer) - tension_n
        };
        // With half of the force the halves would lie along it: no tension below can carry it.
        let mut low = half_n * (1.0 + 1e-9);
        let mut high = low + 1.0;
        while excess(high) > 0.0 && high < self.ea_n {
            high *= 2.0;
        }
        // 60 halvings of at most 50 kN leave less than the rounding of a double.
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if excess(middle) > 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        Tension {
            platform_n: low,
            winch_n: low * ratio,
            elastic_platform_n: low,
        }
    }

    /// Addition of a sideways force to the cable's pull along its chord: the force on the platform
    /// (world, N) is `-tension * along * direction + across`.
    #[inline(always)]
    pub(crate) fn hand(&self) -> Option<(f64, V3)> {
        if self.side_pull_n == [0.0; 3] {
            return None;
        }
        let across = 0.5 * norm(self.side_pull_n) / self.tension.platform_n.max(1e-9);
        let along = (1.0 - across * across).max(0.0).sqrt();
        Some((along, scale(self.side_pull_n, 0.5)))
    }

    /// Cable that has passed the pulley toward the platform: the drum's pay-out and the stretch of
    /// the routing (m).
    #[inline(always)]
    pub(super) fn paid_out(&self, drum_m: f64) -> f64 {
        self.winding_gain * drum_m + self.tension.winch_n * self.routing_m / self.ea_n
    }

    /// Brings the pulley's friction up to date with the cable's travel: Dahl's model (1968) with
    /// exponent 1, integrated exactly over the travel, so that it does not depend on the rate.
    #[inline(always)]
    pub(crate) fn rub(&mut self, drum_m: f64) {
        if self.loss == 0.0 {
            return;
        }
        let paid_out = self.paid_out(drum_m);
        self.friction_state = self.rubbed(self.friction_state, paid_out);
        self.paid_out_m = paid_out;
    }

    /// The state of the friction after travel from where it was last up to date to `paid_out_m`.
    #[inline(always)]
    pub(super) fn rubbed(&self, state: f64, paid_out_m: f64) -> f64 {
        let hauled = (self.paid_out_m - paid_out_m) / self.presliding_m;
        if hauled == 0.0 {
            return state;
        }
        // Dahl: ds/dx = (end - s) / sigma. After 3 sigma (0.6 mm) 95 % of a reversal is done.
        let end = hauled.signum();
        end + (state - end) * libm::exp(-hauled.abs())
    }

    /// Force that the cable exerts on the drum, paying out positive (N). It is the derivative of
    /// the stored energy by the drum's displacement; in addition to the tension, the cable that
    /// leaves the drum takes up half the strain energy density, `T^2 / (2 EA)`.
    #[inline(always)]
    pub(crate) fn force_on_drum(&self, winch_n: f64) -> f64 {
        self.growth * self.winding_gain * winch_n * (1.0 + 0.5 * winch_n / self.ea_n)
    }

    /// Elastic energy of both parts (J).
    pub(crate) fn energy(&self, tension: &Tension, drum_m: f64) -> f64 {
        let ratio = 1.0 + self.loss * self.friction_state;
        let free = self.unstretched_m(drum_m) - self.routing_m;
        let platform = tension.elastic_platform_n;
        0.5 * platform * platform * (free + self.routing_m * ratio * ratio) / self.ea_n
    }

    pub(crate) fn path(&self, attachment_m: V3, cable: usize) -> Result<Path, PlantError> {
        self.pulley
            .path_to(attachment_m)
            .ok_or(PlantError::InsidePulley { cable })
    }

    /// `true` once the drum has taken in all of the cable.
    pub(crate) fn exhausted(&self, drum_m: f64) -> bool {
        self.unstretched_m(drum_m) - self.routing_m < SHORTEST_M
    }
}
