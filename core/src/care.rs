//! Wear of cables, drums and brakes: bending cycles and loads counted from runs, and the life that is left.
//!
//! A piece of cable is bent and straightened once each time that it runs over its pulley, and bent half as
//! often again where it winds on the drum. Each cable is counted in pieces of 10 mm; the piece that was bent
//! most decides. Damage adds up by Palmgren and Miner: one bending under a tension T uses 1/N(T) of a life.

use crate::robot::Robot;
use crate::run::Measured;
use serde::{Deserialize, Serialize};

/// Length of a piece of cable, m.
const PIECE_M: f64 = 0.01;
/// Pieces of one cable that are counted at most: 100 m.
const MOST_PIECES: usize = 10_000;
/// A drum that turns back less than this at the cable has not reversed, m: it hunts.
const REVERSAL_M: f64 = 1e-3;
/// Time of one sample, s.
const SAMPLE_S: f64 = 1e-3;
/// A cable below this tension carries nothing, N.
const LOADED_N: f64 = 1.0;
/// Classes of the load history: equal shares of the sensor's range.
const CLASSES: usize = 10;

/// What a cable is made of, and what is known of its life.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Rope {
    /// Steel wire rope: Feyrer's equation for bending cycles.
    Steel,
    /// A rope of polymer fibre: there is no equation with published constants for thin ropes at small
    /// loads, so what its maker tested is all that counts.
    Polymer {
        /// Bendings that the maker's test lasted, and the tension of the test, N; `None`: not known.
        tested: Option<[f64; 2]>,
    },
}

impl Default for Rope {
    fn default() -> Self {
        Self::Polymer { tested: None }
    }
}

/// Bendings over a sheave until half of the steel ropes break, at a tension (N), sheave and rope diameter (m).
///
/// lg N = b0 + (b1 + b3 lg(D/d)) (lg(S/d^2) - 0.4 lg(R/1770)) + b2 lg(D/d) + lg f_d, with S in N, d in mm, and
/// b0 = 1.280, b1 = 0.029, b2 = 6.241, b3 = -1.613 (Feyrer, Wire Ropes, 2nd ed., Springer 2015, parallel lay,
/// eight strands, fibre core; wires of 1770 N/mm2), f_d = 0.52 / (0.48 + (d/16)^0.3). **The constants were not compared
/// with the book: assumptions.** The tests were made with ropes of some millimetres to 40 mm: for a cable of 1 mm it
/// extrapolates, and ten times more or less must be expected. Among equal ropes N scatters by a factor of about two.
fn steel_bendings(tension_n: f64, sheave_m: f64, rope_m: f64) -> f64 {
    let ratio = libm::log10((sheave_m / rope_m).max(1.0));
    let rope_mm = rope_m * 1e3;
    let load = libm::log10((tension_n / (rope_mm * rope_mm)).max(1.0));
    let size = 0.52 / (0.48 + libm::pow(rope_mm / 16.0, 0.3));
    let lg = 1.280 + (0.029 - 1.613 * ratio) * load + 6.241 * ratio + libm::log10(size);
    libm::pow(10.0, lg)
}

/// Wear of one cable with its drum.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct CableWear {
    /// What it is made of.
    pub rope: Rope,
    /// Bendings of each piece of 10 mm, from the platform's end on.
    pub bendings: Vec<f64>,
    /// Share of its life that each piece has used; zero where no life is known.
    pub damage: Vec<f64>,
    /// Seconds beyond the tension of the maker's test: those bendings are not covered by it.
    pub beyond_test_s: f64,
    /// Seconds under tension, in tenths of the sensor's range.
    pub loaded_s: [f64; CLASSES],
    /// Greatest tension, N.
    pub greatest_n: f64,
    /// Cable that ran off and on the drum, m.
    pub travel_m: f64,
    /// Reversals of the drum.
    pub reversals: u64,
}

/// Wear of a robot.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Wear {
    /// Name of the robot.
    pub robot: String,
    /// Cable by cable.
    pub cables: Vec<CableWear>,
    /// Runs that were counted, by their names: none counts twice.
    pub runs: Vec<String>,
    /// Closings of the brakes.
    pub brake_closings: u64,
}

/// Where a cable ran, with the play of a hunting drum taken out.
struct Play {
    at_m: f64,
    width_m: f64,
}

impl Play {
    /// Moves to where the cable is; gives where it was and is, if it moved.
    fn follow(&mut self, length_m: f64) -> Option<[f64; 2]> {
        let before = self.at_m;
        self.at_m = before.clamp(length_m - self.width_m, length_m + self.width_m);
        (self.at_m != before).then_some([before, self.at_m])
    }
}

impl CableWear {
    /// Bendings of the worst piece.
    #[must_use]
    pub fn worst(&self) -> f64 {
        self.bendings.iter().copied().fold(0.0, f64::max)
    }

    /// Share of its life that the worst piece has used; `None` where no life is known.
    #[must_use]
    pub fn used(&self) -> Option<f64> {
        match self.rope {
            Rope::Polymer { tested: None } => None,
            _ => Some(self.damage.iter().copied().fold(0.0, f64::max)),
        }
    }

    /// Hours under tension.
    #[must_use]
    pub fn hours(&self) -> f64 {
        self.loaded_s.iter().sum::<f64>() / 3600.0
    }

    /// Hours under tension that are left if it is used as before; `None` where no life is known, or nothing
    /// of it is used.
    #[must_use]
    pub fn hours_left(&self) -> Option<f64> {
        let used = self.used().filter(|used| *used > 0.0)?;
        Some((1.0 - used).max(0.0) / used * self.hours())
    }

    /// Every piece between two lengths was bent `times`, under a tension of which it withstands `bendings`.
    fn bend(&mut self, [from_m, to_m]: [f64; 2], times: f64, life: f64) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturates"
        )]
        let piece = |m: f64| ((m / PIECE_M).ceil().max(0.0) as usize).min(MOST_PIECES);
        let (first, last) = (piece(from_m.min(to_m)), piece(from_m.max(to_m)));
        if self.bendings.len() < last {
            self.bendings.resize(last, 0.0);
            self.damage.resize(last, 0.0);
        }
        for slot in self.bendings.iter_mut().take(last).skip(first) {
            *slot += times;
        }
        for slot in self.damage.iter_mut().take(last).skip(first) {
            *slot += times / life;
        }
    }
}

impl Wear {
    /// A robot with new cables.
    #[must_use]
    pub fn of(robot: &Robot) -> Self {
        Self {
            robot: robot.name.clone(),
            cables: vec![CableWear::default(); robot.cables.len()],
            ..Self::default()
        }
    }

    /// Counts the samples of a run; `false` if a run of this name was counted before.
    ///
    /// # Errors
    /// In words: another robot's wear.
    pub fn take(&mut self, robot: &Robot, run: &str, samples: &[Measured]) -> Result<bool, String> {
        if self.robot != robot.name || self.cables.len() != robot.cables.len() {
            return Err(format!(
                "it is of robot {} with {} cables, the run is of {} with {}",
                self.robot,
                self.cables.len(),
                robot.name,
                robot.cables.len()
            ));
        }
        if self.runs.iter().any(|known| known == run) {
            return Ok(false);
        }
        self.runs.push(run.to_owned());
        self.brake_closings += 1;
        for (index, wear) in self.cables.iter_mut().enumerate() {
            count(wear, robot, index, samples);
        }
        Ok(true)
    }
}

fn count(wear: &mut CableWear, robot: &Robot, index: usize, samples: &[Measured]) {
    let (Some(cable), Some(winch)) = (robot.cables.get(index), robot.winch_of(index)) else {
        return;
    };
    let at = |sample: &Measured| {
        let pair = (sample.lengths_m.get(index)?, sample.tensions_n.get(index)?);
        (pair.0.is_finite() && pair.1.is_finite()).then_some((*pair.0, *pair.1))
    };
    let Some((first_m, _)) = samples.iter().find_map(at) else {
        return;
    };
    let rope_m = winch.cable_diameter_m;
    let sheave_m = 2.0 * cable.pulley_radius_m;
    // A piece is bent once it has run over the whole arc of the pulley: about a quarter of a turn.
    let arc_m = (cable.pulley_radius_m * std::f64::consts::FRAC_PI_2).max(REVERSAL_M);
    let mut pulley = Play {
        at_m: first_m,
        width_m: 0.5 * arc_m,
    };
    let mut drum = Play {
        at_m: first_m,
        width_m: 0.5 * REVERSAL_M,
    };
    let mut direction = 0.0;
    for (length_m, tension_n) in samples.iter().filter_map(at) {
        wear.greatest_n = wear.greatest_n.max(tension_n);
        if tension_n > LOADED_N {
            let share = tension_n / winch.tension_max_n * CLASSES as f64;
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a small index"
            )]
            let class = (share.max(0.0) as usize).min(CLASSES - 1);
            wear.loaded_s[class] += SAMPLE_S;
        }
        let life = |diameter_m: f64| match wear.rope {
            Rope::Steel => steel_bendings(tension_n, diameter_m, rope_m),
            Rope::Polymer { tested } => tested.map_or(f64::INFINITY, |[bendings, _]| bendings),
        };
        let (over_pulley, over_drum) = (life(sheave_m), life(2.0 * winch.drum_radius_m));
        if let Some(way) = pulley.follow(length_m).filter(|_| sheave_m > 0.0) {
            wear.bend(way, 1.0, over_pulley);
        }
        if let Some([from_m, to_m]) = drum.follow(length_m) {
            wear.travel_m += (to_m - from_m).abs();
            let now = (to_m - from_m).signum();
            if direction != 0.0 && now != direction {
                wear.reversals += 1;
            }
            direction = now;
            let behind = cable.routing_length_m;
            wear.bend([from_m + behind, to_m + behind], 0.5, over_drum);
        }
        if let Rope::Polymer {
            tested: Some([_, test_n]),
        } = wear.rope
            && tension_n > test_n
        {
            wear.beyond_test_s += SAMPLE_S;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot() -> Robot {
        Robot::built_in("lab-fast").unwrap()
    }

    /// Cable 1 goes out and back by `way_m` so many times under 10 N.
    fn runs(way_m: f64, times: u32) -> Vec<Measured> {
        let steps = 200_u32;
        let mut out = Vec::new();
        for tick in 0..=(2 * steps * times) {
            let phase = f64::from(tick % (2 * steps)) / f64::from(steps);
            let share = if phase <= 1.0 { phase } else { 2.0 - phase };
            let mut lengths_m = vec![0.4; 4];
            lengths_m[0] += way_m * share;
            out.push(Measured {
                tick,
                path_s: None,
                lengths_m,
                tensions_n: vec![10.0; 4],
                currents_a: vec![0.0; 4],
            });
        }
        out
    }

    #[test]
    fn a_piece_that_runs_out_and_back_is_bent_twice_and_one_at_rest_never() {
        let robot = robot();
        let mut wear = Wear::of(&robot);
        assert!(wear.take(&robot, "one", &runs(0.2, 5)).unwrap());
        let first = &wear.cables[0];
        // Five times out and back; no piece reaches both pulley and drum on 200 mm.
        assert_eq!(first.worst(), 10.0);
        assert_eq!(first.reversals, 9);
        assert!((first.travel_m - 2.0).abs() < 0.02, "{}", first.travel_m);
        assert!((first.hours() * 3600.0 - 2.0).abs() < 0.01);
        assert_eq!(wear.cables[1].worst(), 0.0);
        // Hunting by less than the arc of the pulley bends nothing.
        let mut still = Wear::of(&robot);
        still.take(&robot, "two", &runs(0.0005, 50)).unwrap();
        assert_eq!(
            (still.cables[0].worst(), still.cables[0].reversals),
            (0.0, 0)
        );
    }

    #[test]
    fn a_run_counts_once_and_of_its_own_robot_only() {
        let robot = robot();
        let mut wear = Wear::of(&robot);
        let samples = runs(0.1, 1);
        assert!(wear.take(&robot, "one", &samples).unwrap());
        let before = wear.clone();
        assert!(!wear.take(&robot, "one", &samples).unwrap());
        let other = Robot::built_in("eight-cable").unwrap();
        assert!(wear.take(&other, "two", &samples).is_err());
        assert_eq!(wear, before);
    }

    #[test]
    fn steel_lives_longer_on_larger_sheaves_and_shorter_under_load() {
        // D/d = 25 and 100 N/mm2 on a rope of 16 mm: some hundred thousand, as tables of rope makers have it.
        let usual = steel_bendings(100.0 * 256.0, 0.4, 0.016);
        assert!((1e5..1e6).contains(&usual), "{usual}");
        assert!(steel_bendings(200.0 * 256.0, 0.4, 0.016) < 0.5 * usual);
        assert!(steel_bendings(100.0 * 256.0, 0.2, 0.016) < 0.3 * usual);
    }

    #[test]
    fn what_nobody_tested_has_no_life_and_what_was_tested_has_one() {
        let robot = robot();
        let mut wear = Wear::of(&robot);
        wear.cables[1].rope = Rope::Steel;
        wear.cables[0].rope = Rope::Polymer {
            tested: Some([1000.0, 20.0]),
        };
        wear.take(&robot, "one", &runs(0.2, 5)).unwrap();
        assert!((wear.cables[0].used().unwrap() - 0.01).abs() < 1e-9);
        let left = wear.cables[0].hours_left().unwrap();
        assert!((left / wear.cables[0].hours() - 99.0).abs() < 1e-6);
        assert_eq!(wear.cables[2].used(), None);
        assert_eq!(wear.cables[1].used(), Some(0.0));
        assert_eq!(wear.cables[1].hours_left(), None);
    }
}
