//! Friction of the pulleys: how far each has turned back since it last turned the other way.

use crate::robot::Robot;

/// Travel over which a pulley's friction turns (m), as the robot takes it: no key of its file says it.
const PRESLIDING_M: f64 = 2e-4;

/// State of the pulleys' friction (Dahl, 1968), followed from lengths and tensions.
#[derive(Debug, Clone, PartialEq)]
pub struct Pulleys {
    /// 1 where cable was hauled in last, -1 where it was paid out, between while friction turns.
    hauled: Vec<f64>,
    /// Cable that has passed each pulley, m.
    passed_m: Vec<f64>,
    /// Shorter ways are noise of the encoder, m.
    grain_m: Vec<f64>,
}

impl Pulleys {
    /// Friction unknown, at these paid-out lengths (m) and tensions (N).
    #[must_use]
    pub fn new(robot: &Robot, lengths_m: &[f64], tensions_n: &[f64]) -> Self {
        Self {
            hauled: vec![0.0; robot.cables.len()],
            passed_m: passed_m(robot, lengths_m, tensions_n),
            grain_m: vec![0.0; robot.cables.len()],
        }
    }

    /// The same, for lengths that are read from encoders: what is shorter than a count and a half does not count
    /// as a way, or a reading at the edge between two counts would wear the friction away.
    #[must_use]
    pub(crate) fn by_encoders(robot: &Robot, lengths_m: &[f64], tensions_n: &[f64]) -> Self {
        let grain = |cable: usize| {
            robot.winch_of(cable).map_or(0.0, |winch| {
                let turn_m = std::f64::consts::TAU * winch.drum_radius_m;
                1.5 * turn_m / f64::from(winch.encoder_counts_per_turn)
            })
        };
        Self {
            grain_m: (0..robot.cables.len()).map(grain).collect(),
            ..Self::new(robot, lengths_m, tensions_n)
        }
    }

    /// For each pulley 1 if its cable was hauled in last, -1 if paid out, between while its friction turns.
    #[must_use]
    pub fn hauled(&self) -> &[f64] {
        &self.hauled
    }

    /// The friction after a straight way to these paid-out lengths (m) under these tensions (N).
    #[must_use]
    pub fn after(&self, robot: &Robot, lengths_m: &[f64], tensions_n: &[f64]) -> Vec<f64> {
        let mut next = self.clone();
        next.turn(robot, lengths_m, tensions_n);
        next.hauled
    }

    /// Takes the way into account.
    pub fn turn(&mut self, robot: &Robot, lengths_m: &[f64], tensions_n: &[f64]) {
        let now_m = passed_m(robot, lengths_m, tensions_n);
        let pulleys = self.hauled.iter_mut().zip(&mut self.passed_m);
        for ((state, from), (to, grain_m)) in pulleys.zip(now_m.into_iter().zip(&self.grain_m)) {
            let way_m = *from - to;
            if way_m == 0.0 || way_m.abs() < *grain_m {
                continue;
            }
            let end = way_m.signum();
            *state = end + (*state - end) * libm::exp(-way_m.abs() / PRESLIDING_M);
            *from = to;
        }
    }
}

/// Cable past each pulley at these lengths (m) and tensions (N): a load stretches the routing, so cable passes
/// though no drum turns.
fn passed_m(robot: &Robot, lengths_m: &[f64], tensions_n: &[f64]) -> Vec<f64> {
    let cables = robot.cables.iter().zip(lengths_m.iter().zip(tensions_n));
    cables
        .map(|(cable, (length_m, tension_n))| {
            length_m + tension_n * cable.routing_length_m / cable.ea_n
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_turns_over_its_travel_and_a_flickering_encoder_does_not_wear_it_away() {
        let robot = Robot::built_in("lab-fast").unwrap();
        let tensions_n = [10.0; 4];
        let at = |m: f64| vec![0.6 - m; 4];
        let mut pulleys = Pulleys::by_encoders(&robot, &at(0.0), &tensions_n);
        pulleys.turn(&robot, &at(0.01), &tensions_n);
        assert!(pulleys.hauled().iter().all(|&state| state > 0.999));
        for _ in 0..100 {
            pulleys.turn(&robot, &at(0.010_03), &tensions_n);
            pulleys.turn(&robot, &at(0.01), &tensions_n);
        }
        assert!(pulleys.hauled().iter().all(|&state| state > 0.999));
        // A way back of the travel: 1 - 2 (1 - 1/e) = -0.26.
        pulleys.turn(&robot, &at(0.01 - PRESLIDING_M), &tensions_n);
        let state = pulleys.hauled()[2];
        assert!((state + 0.264).abs() < 0.01, "{state}");
    }
}
