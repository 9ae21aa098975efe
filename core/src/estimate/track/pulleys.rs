//! Friction of the pulleys: how far each has turned back since it last turned the other way, and how sure that is.

use crate::robot::Robot;

/// Travel over which a pulley's friction turns (m), as the robot takes it: no key of its file says it.
const PRESLIDING_M: f64 = 2e-4;
/// Standard deviation of that travel, as a share of it: pulleys differ.
const PRESLIDING_SHARE: f64 = 0.2;
/// Standard deviation of the cables' stiffness, as a share of it: a change of tension stretches the routing past the pulley.
const STIFFNESS_SHARE: f64 = 0.12;
/// Least standard deviation of a friction's state: Dahl's law with exponent 1 is a model.
const LEAST: f64 = 0.02;

/// State of one pulley's friction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rubbing {
    /// 1 where cable was hauled in last, -1 where it was paid out, between while friction turns.
    pub side: f64,
    /// Its standard deviation.
    pub unsure: f64,
}

/// One pulley as its cable's travel shows it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pulley {
    side: f64,
    /// Cable that has passed at the last reading that counted, m.
    passed_m: f64,
    /// Routing's stretch in it, m.
    stretch_m: f64,
    /// Variance of the side by readings before the last, and by what was unknown at the start.
    variance: f64,
    /// Slope of the side by the last reading, 1/m.
    by_reading: f64,
    /// Slopes of the side by a relative error of the travel over which friction turns, and of the stiffness.
    by_travel: f64,
    by_stiffness: f64,
    /// Shorter ways are noise of the encoder, m.
    grain_m: f64,
    /// Standard deviation of a reading, m.
    reading_m: f64,
}

impl Pulley {
    /// Nothing is known of its friction, at this reading.
    fn unknown(passed_m: f64, stretch_m: f64, count_m: f64, grain_m: f64) -> Self {
        Self {
            side: 0.0,
            passed_m,
            stretch_m,
            // Anything between -1 and 1.
            variance: 1.0 / 3.0,
            by_reading: 0.0,
            by_travel: 0.0,
            by_stiffness: 0.0,
            grain_m,
            // Even within a count, or within what does not count as a way.
            reading_m: (count_m / 12.0_f64.sqrt()).max(grain_m / 3.0_f64.sqrt()),
        }
    }

    /// Takes a straight way into account: Dahl's law (1968) with exponent 1, and its slopes.
    fn turn(&mut self, passed_m: f64, stretch_m: f64) {
        let way_m = self.passed_m - passed_m;
        if way_m == 0.0 || way_m.abs() < self.grain_m {
            return;
        }
        let end = way_m.signum();
        let keep = libm::exp(-way_m.abs() / PRESLIDING_M);
        let left = (end - self.side) * keep;
        // Slope of the new side by the way, hauled in counts positive.
        let by_way = end * left / PRESLIDING_M;
        let by_before = keep * self.by_reading + by_way;
        self.variance = keep * keep * self.variance + (by_before * self.reading_m).powi(2);
        self.by_reading = -by_way;
        self.by_travel = keep * self.by_travel - by_way * way_m;
        self.by_stiffness = keep * self.by_stiffness - by_way * (self.stretch_m - stretch_m);
        self.side = end - left;
        self.passed_m = passed_m;
        self.stretch_m = stretch_m;
    }

    fn rubbing(&self) -> Rubbing {
        // The cable may have gone half a count either way since the last reading: mean square of both slopes.
        let unseen = (1.0 + self.side * self.side).sqrt() / PRESLIDING_M * self.reading_m;
        let squares = self.variance
            + unseen * unseen
            + (self.by_travel * PRESLIDING_SHARE).powi(2)
            + (self.by_stiffness * STIFFNESS_SHARE).powi(2)
            + LEAST * LEAST;
        Rubbing {
            side: self.side,
            unsure: squares.sqrt(),
        }
    }
}

/// State of the pulleys' friction, followed from lengths and tensions.
#[derive(Debug, Clone, PartialEq)]
pub struct Pulleys(Vec<Pulley>);

impl Pulleys {
    /// Friction unknown, at these paid-out lengths (m), as encoders show them, and tensions (N).
    #[must_use]
    pub fn new(robot: &Robot, lengths_m: &[f64], tensions_n: &[f64]) -> Self {
        Self::with_grain(robot, lengths_m, tensions_n, 0.0)
    }

    /// The same where readings are taken many times a second: what is shorter than a count and a half does not count as a
    /// way, or a reading at the edge between two counts would wear the friction away.
    #[must_use]
    pub(crate) fn by_encoders(robot: &Robot, lengths_m: &[f64], tensions_n: &[f64]) -> Self {
        Self::with_grain(robot, lengths_m, tensions_n, 1.5)
    }

    fn with_grain(robot: &Robot, lengths_m: &[f64], tensions_n: &[f64], counts: f64) -> Self {
        let count_m = |cable: usize| {
            robot.winch_of(cable).map_or(0.0, |winch| {
                let turn_m = std::f64::consts::TAU * winch.drum_radius_m;
                turn_m / f64::from(winch.encoder_counts_per_turn)
            })
        };
        let passed = passed(robot, lengths_m, tensions_n).enumerate();
        let pulley = |(cable, (passed_m, stretch_m))| {
            let count_m = count_m(cable);
            Pulley::unknown(passed_m, stretch_m, count_m, counts * count_m)
        };
        Self(passed.map(pulley).collect())
    }

    /// The friction of each pulley.
    #[must_use]
    pub fn rubbing(&self) -> Vec<Rubbing> {
        self.0.iter().map(Pulley::rubbing).collect()
    }

    /// The friction after a straight way to these paid-out lengths (m) under these tensions (N).
    #[must_use]
    pub fn after(&self, robot: &Robot, lengths_m: &[f64], tensions_n: &[f64]) -> Vec<Rubbing> {
        let mut next = self.clone();
        next.turn(robot, lengths_m, tensions_n);
        next.rubbing()
    }

    /// Takes a straight way to these paid-out lengths (m) under these tensions (N) into account.
    pub fn turn(&mut self, robot: &Robot, lengths_m: &[f64], tensions_n: &[f64]) {
        let now = passed(robot, lengths_m, tensions_n);
        for (pulley, (passed_m, stretch_m)) in self.0.iter_mut().zip(now) {
            pulley.turn(passed_m, stretch_m);
        }
    }
}

/// Cable past each pulley at these lengths (m) and tensions (N), and the routing's stretch in it: a load stretches the routing,
/// so cable passes though no drum turns.
fn passed<'a>(
    robot: &'a Robot,
    lengths_m: &'a [f64],
    tensions_n: &'a [f64],
) -> impl Iterator<Item = (f64, f64)> + 'a {
    let cables = robot.cables.iter().zip(lengths_m.iter().zip(tensions_n));
    cables.map(|(cable, (length_m, tension_n))| {
        let stretch_m = tension_n * cable.routing_length_m / cable.ea_n;
        (length_m + stretch_m, stretch_m)
    })
}

#[cfg(test)]
mod tests;
