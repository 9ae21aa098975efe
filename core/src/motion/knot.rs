//! The knots that go to a board are built here.

use super::spline::Spline;
use mcdpr_protocol::{CableKnot, Knot, List, PerCable};

/// The knot `number` of a motion, from 0. It is not marked as the motion's last, and has no
/// consistency rows. Numbers wrap after 65,536 knots.
pub fn knot(number: usize, time_ms: u32, cables: impl IntoIterator<Item = CableKnot>) -> Knot {
    Knot {
        index: u16::try_from(number & usize::from(u16::MAX)).unwrap_or(0),
        time_ms,
        last: false,
        cables: PerCable::collect(cables),
        rows: List::new(),
    }
}

/// The cables' state at the knot `index` of their splines (m), with these tensions (N).
pub fn on_splines(
    splines: &[Spline],
    index: usize,
    tensions_n: &[f64],
) -> impl Iterator<Item = CableKnot> {
    splines
        .iter()
        .zip(tensions_n)
        .map(move |(spline, &tension_n)| {
            let knot = spline.knots().get(index);
            let (length_m, velocity_mps) = knot.map_or((0.0, 0.0), |k| (k.value, k.velocity));
            CableKnot::from_si(length_m, velocity_mps, tension_n)
        })
}

/// Ends a motion with its last knot.
pub fn end(knots: &mut [Knot]) {
    if let Some(last) = knots.last_mut() {
        last.last = true;
    }
}

/// A time (s) in whole ms.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "saturates beyond any motion"
)]
pub fn milliseconds(time_s: f64) -> u32 {
    (time_s * 1e3).round() as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::spline::Ends;
    use mcdpr_protocol::{Millinewtons, TenthMicrometres};

    #[test]
    fn a_motion_of_two_knots_has_hand_checkable_numbers() {
        let still = Ends::Clamped {
            start: 0.0,
            end: 0.0,
        };
        // 10 mm in 1 s from rest to rest; the middle passes at 15 mm/s.
        let spline = Spline::interpolate(&[0.0, 0.5, 1.0], &[0.5, 0.505, 0.51], still).unwrap();
        let at = |index| on_splines(std::slice::from_ref(&spline), index, &[12.5]);
        let mut knots = vec![
            knot(0, milliseconds(0.0), at(0)),
            knot(65_537, milliseconds(0.5), at(1)),
        ];
        end(&mut knots);
        assert_eq!(knots[0].cables[0].length, TenthMicrometres(5_000_000));
        assert_eq!(knots[0].cables[0].velocity.0, 0);
        assert_eq!(knots[1].cables[0].velocity.0, 15_000);
        assert_eq!(knots[1].cables[0].tension, Millinewtons(12_500));
        assert_eq!((knots[1].index, knots[1].time_ms), (1, 500));
        assert!(!knots[0].last && knots[1].last);
        assert!(knots[1].rows.is_empty());
    }
}
