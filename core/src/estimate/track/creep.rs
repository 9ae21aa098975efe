//! Creep of the cables: what its law makes of the tensions so far. Final size and retardation times are states.
//!
//! Two elements of Kelvin and Voigt in a row (as Piao et al., 2017): each creeps towards a multiple of the elastic stretch, its
//! ratio, with its retardation time. The tensions are known, so that the creep of an element is its ratio times a number that
//! follows from them, and no state of its own. A wrong retardation time errs all day in the way that is computed here, and
//! not at random.

use super::gaussian::Gaussian;
use super::layout::Layout;
use serde::{Deserialize, Serialize};

/// Retardation times of the creep model, s: rough, as in `Creep::polymer`'s ranges.
pub(super) const RETARDATION_S: [f64; 2] = [300.0, 7200.0];
/// Shares of the final creep.
pub(super) const CREEP_SHARES: [f64; 2] = [0.4, 0.6];

/// What one element would have crept by now with a ratio of one.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Element {
    /// With the assumed retardation time, strain.
    pub(super) unit: f64,
    /// Its derivative by the logarithm of the retardation time, strain.
    pub(super) by_time: f64,
}

impl Element {
    /// Both after `seconds` under a tension that stretches the cable by `elastic` (strain).
    fn pass(&mut self, seconds: f64, retardation_s: f64, elastic: f64) {
        let share = seconds / retardation_s;
        let keep = libm::exp(-share);
        let gap = elastic - self.unit;
        self.by_time = keep * (self.by_time - share * gap);
        self.unit += (1.0 - keep) * gap;
    }

    /// What may be multiplied by the ratio: the creep at a retardation time that is longer by this logarithm, to first order.
    fn at(&self, longer: f64) -> f64 {
        self.unit + self.by_time * longer
    }
}

/// Both elements of a cable.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Creeping(pub(super) [Element; 2]);

impl Creeping {
    /// Lets time pass under a tension that stretches the cable by `elastic` (strain).
    pub(super) fn pass(&mut self, seconds: f64, elastic: f64) {
        for (element, retardation_s) in self.0.iter_mut().zip(RETARDATION_S) {
            element.pass(seconds, retardation_s, elastic);
        }
    }

    /// Strain of a cable (from 0) with the states `x`.
    pub(super) fn strain(&self, layout: Layout, x: &[f64], cable: usize) -> f64 {
        let at = |state: usize| x.get(state).copied().unwrap_or(0.0);
        let of = |(k, element): (usize, &Element)| {
            at(layout.creep_ratio(cable, k)) * element.at(at(layout.creep_time(cable, k)))
        };
        self.0.iter().enumerate().map(of).sum()
    }

    /// Slopes of that strain by its four states.
    pub(super) fn slopes(&self, layout: Layout, x: &[f64], cable: usize) -> [(usize, f64); 4] {
        let at = |state: usize| x.get(state).copied().unwrap_or(0.0);
        core::array::from_fn(|state| {
            let k = state / 2;
            let element = self.0[k];
            let (ratio, time) = (layout.creep_ratio(cable, k), layout.creep_time(cable, k));
            if state % 2 == 0 {
                (ratio, element.at(at(time)))
            } else {
                (time, at(ratio) * element.by_time)
            }
        })
    }
}

impl Gaussian {
    /// What a cable (from 0) has crept by the tensions so far; nothing, if there is no such cable.
    pub(super) fn creeping(&self, cable: usize) -> Creeping {
        self.creeping.get(cable).copied().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAYOUT: Layout = Layout { cables: 1 };

    /// An hour under load, ten minutes without, in steps of 20 s.
    fn hour(retardation_s: f64) -> Element {
        let mut element = Element::default();
        for _ in 0..180 {
            element.pass(20.0, retardation_s, 1e-4);
        }
        for _ in 0..30 {
            element.pass(20.0, retardation_s, 0.0);
        }
        element
    }

    #[test]
    fn an_element_follows_the_law_however_time_is_divided() {
        let law = |s: f64| 1.0 - libm::exp(-s / 7200.0);
        let want = 1e-4 * (law(4200.0) - law(600.0));
        let found = hour(7200.0);
        assert!((found.unit - want).abs() < 1e-12, "{found:?} {want}");
        let mut at_once = Element::default();
        at_once.pass(3600.0, 7200.0, 1e-4);
        at_once.pass(600.0, 7200.0, 0.0);
        assert!((at_once.unit - found.unit).abs() < 1e-12);
        assert!((at_once.by_time - found.by_time).abs() < 1e-12);
    }

    #[test]
    fn a_longer_retardation_time_does_what_the_derivative_says() {
        for retardation_s in RETARDATION_S {
            let element = hour(retardation_s);
            let longer = libm::exp(0.02);
            let (more, less) = (hour(retardation_s * longer), hour(retardation_s / longer));
            let slope = (more.unit - less.unit) / 0.04;
            assert!(
                (slope - element.by_time).abs() < 2e-3 * slope.abs() + 1e-11,
                "{slope} {element:?}"
            );
            assert!(element.at(0.2) != element.unit);
        }
    }

    #[test]
    fn the_slopes_of_the_strain_are_those_of_its_states() {
        let mut creeping = Creeping::default();
        creeping.pass(2000.0, 1e-4);
        let mut x = vec![0.0; LAYOUT.size()];
        for k in 0..2 {
            x[LAYOUT.creep_ratio(0, k)] = 5.0 + k as f64;
            x[LAYOUT.creep_time(0, k)] = 0.1 - 0.3 * k as f64;
        }
        let slopes = creeping.slopes(LAYOUT, &x, 0);
        for (state, slope) in slopes {
            let mut moved = x.clone();
            moved[state] += 0.5;
            let by = creeping.strain(LAYOUT, &moved, 0) - creeping.strain(LAYOUT, &x, 0);
            assert!(slope != 0.0 && (by - 0.5 * slope).abs() < 1e-15, "{state}");
        }
        let mut states: Vec<usize> = slopes.iter().map(|(state, _)| *state).collect();
        states.sort_unstable();
        states.dedup();
        assert_eq!(states.len(), 4);
    }
}
