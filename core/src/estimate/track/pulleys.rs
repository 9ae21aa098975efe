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
        // The cable may have gone either way since the last reading: mean square of both slopes.
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
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn friction_turns_over_its_travel_and_a_flickering_encoder_does_not_wear_it_away() {
        let robot = Robot::built_in("lab-fast").unwrap();
        let tensions_n = [10.0; 4];
        let at = |m: f64| vec![0.6 - m; 4];
        let mut pulleys = Pulleys::by_encoders(&robot, &at(0.0), &tensions_n);
        pulleys.turn(&robot, &at(0.01), &tensions_n);
        assert!(pulleys.rubbing().iter().all(|rub| rub.side > 0.999));
        for _ in 0..100 {
            pulleys.turn(&robot, &at(0.010_03), &tensions_n);
            pulleys.turn(&robot, &at(0.01), &tensions_n);
        }
        assert!(pulleys.rubbing().iter().all(|rub| rub.side > 0.999));
        // A way back of the travel: 1 - 2 (1 - 1/e) = -0.26.
        pulleys.turn(&robot, &at(0.01 - PRESLIDING_M), &tensions_n);
        let state = pulleys.rubbing()[2].side;
        assert!((state + 0.264).abs() < 0.01, "{state}");
    }

    /// Pulleys whose travel, stiffness and encoder's edges differ go a way of long and short moves; the law by hand is Dahl's,
    /// written as its differential equation.
    #[test]
    fn a_friction_is_off_by_as_much_as_is_said() {
        let robot = Robot::built_in("lab-fast").unwrap();
        let cable = &robot.cables[0];
        let winch = robot.winch_of(0).unwrap();
        let count_m =
            std::f64::consts::TAU * winch.drum_radius_m / f64::from(winch.encoder_counts_per_turn);
        let mut random = Random::new(5);
        let (mut squares, mut counted) = ([0.0; 2], [0.0; 2]);
        for _ in 0..400 {
            let travel_m = PRESLIDING_M * (1.0 + random.within(0.3));
            let softer = 1.0 + random.within(0.2);
            let phase = random.unit();
            let read = |true_m: f64| ((true_m / count_m + phase).floor() + 0.5 - phase) * count_m;
            let (mut length_m, mut tension_n) = (0.6, 10.0);
            let mut side = random.within(1.0);
            let mut pulleys = Pulleys::new(&robot, &[read(length_m)], &[tension_n]);
            for _ in 0..12 {
                let size_m = [1e-5, 1e-4, 3e-4, 1e-2][(4.0 * random.unit()) as usize];
                let way_m = random.within(size_m);
                let pull_n = random.within(8.0);
                let stretch_m = pull_n * cable.routing_length_m / cable.ea_n * softer;
                let passed_m = way_m + stretch_m;
                for _ in 0..2000 {
                    let step_m = -passed_m / 2000.0;
                    side += (step_m.signum() - side) * step_m.abs() / travel_m;
                }
                (length_m, tension_n) = (length_m + way_m, tension_n + pull_n);
                pulleys.turn(&robot, &[read(length_m)], &[tension_n]);
                let said = pulleys.rubbing()[0];
                let turning = usize::from(said.side.abs() < 0.9);
                squares[turning] += ((said.side - side) / said.unsure).powi(2);
                counted[turning] += 1.0;
            }
        }
        // Of turning friction about as much as is said, at its ends less: most of the doubt there is of moves that no count shows.
        let [ends, turning] = [0, 1].map(|k| (squares[k] / counted[k]).sqrt());
        assert!((0.6..1.1).contains(&turning), "{turning}");
        assert!((0.1..1.0).contains(&ends), "{ends}");
    }
}
