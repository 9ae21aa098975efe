//! How far apart the boards of a simulated robot are along its path.
//!
//! By what each board wants of its winches in each of its ticks, and the simulator's true time: neither an estimate of
//! the host nor a winch enters. The first board's path clock is the robot's. Where another board wants a length that the
//! plan has at another moment of that clock, it is early or late.

use mcdpr_core::robot::Robot;
use mcdpr_protocol::{BoardState, CableKnot, Knot};
use mcdpr_simulator::BoardPoint;

/// Path time over which one figure is taken, s.
const WINDOW_S: f64 = 1.0;
/// Below this speed of the cables (root of the mean square) lengths tell no time, m/s.
const LEAST_MPS: f64 = 0.01;

/// Sums of least squares over a window.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    /// Squared speeds, m²/s².
    vv: f64,
    /// Speed times how much longer the cable is wanted than the plan has it, m²/s.
    ve: f64,
    count: f64,
}

impl Sums {
    /// How late the lengths are, s.
    fn late_s(&self) -> Option<f64> {
        let moves = self.vv > LEAST_MPS * LEAST_MPS * self.count && self.count > 0.0;
        moves.then(|| -self.ve / self.vv)
    }
}

/// A second of the path.
#[derive(Debug, Clone, PartialEq)]
pub struct Window {
    /// Path time of its middle, s.
    pub path_s: f64,
    /// How late each board is, s; less than zero is early.
    pub late_s: Vec<f64>,
}

impl Window {
    /// Time between the earliest and the latest board, s.
    #[must_use]
    pub fn skew_s(&self) -> f64 {
        let low = self.late_s.iter().copied().fold(f64::MAX, f64::min);
        let high = self.late_s.iter().copied().fold(f64::MIN, f64::max);
        high - low
    }
}

/// One motion of several boards, while it goes on.
#[derive(Debug)]
pub struct Together {
    knots: Vec<Knot>,
    /// The robot's cable on each channel of each board.
    cables: Vec<Vec<usize>>,
    /// What is added to the plan's lengths because the robot did not hang exactly where the plan begins, m.
    gaps_m: Vec<Vec<f64>>,
    /// True time, µs, and path time, ms, of the first board's last ticks.
    clock: Vec<(f64, u32)>,
    /// Rows that the first board's clock has not reached yet.
    rows: Vec<BoardPoint>,
    /// By window and board.
    sums: Vec<Vec<Sums>>,
}

impl Together {
    /// Before a motion of these knots begins.
    #[must_use]
    pub fn new(robot: &Robot, knots: &[Knot]) -> Self {
        let bare = knots.iter().map(|knot| Knot {
            rows: mcdpr_protocol::List::new(),
            ..knot.clone()
        });
        Self {
            knots: bare.collect(),
            cables: robot
                .boards
                .iter()
                .map(|board| board.cables.clone())
                .collect(),
            gaps_m: vec![Vec::new(); robot.boards.len()],
            clock: Vec::new(),
            rows: Vec::new(),
            sums: Vec::new(),
        }
    }

    /// Takes what the boards did since the last call, in the order of time.
    pub fn take(&mut self, points: Vec<BoardPoint>) {
        let moving = |point: &BoardPoint| point.state == BoardState::Moving;
        for point in points.into_iter().filter(moving) {
            let gaps = self.gaps_m.get_mut(point.board);
            if let (Some(gaps), Some(first)) = (gaps, self.knots.first())
                && gaps.is_empty()
            {
                // Every board's motion begins with a rest.
                let cables = self.cables.get(point.board).into_iter().flatten();
                let wanted = point.lengths.iter().zip(cables);
                let gap = |(length, cable): (&mcdpr_protocol::TenthMicrometres, &usize)| {
                    let planned = first.cables.get(*cable).map_or(0.0, |c| c.length.metres());
                    length.metres() - planned
                };
                *gaps = wanted.map(gap).collect();
            }
            if point.board == 0 {
                self.clock.push((point.at_us, point.path_ms));
            }
            self.rows.push(point);
        }
        let reached_us = self.clock.last().map_or(0.0, |(at_us, _)| *at_us);
        let rows = std::mem::take(&mut self.rows);
        let (known, later): (Vec<_>, Vec<_>) =
            rows.into_iter().partition(|row| row.at_us <= reached_us);
        self.rows = later;
        for row in &known {
            self.sum(row);
        }
        // The last tick is the beginning of the next rows' interval.
        let old = self.clock.len().saturating_sub(2);
        self.clock.drain(..old);
    }

    /// The robot's path time at a true time, s; `None` before the path begins and while it stands.
    fn path_s(&self, at_us: f64) -> Option<f64> {
        let after = self.clock.partition_point(|(tick_us, _)| *tick_us < at_us);
        let (after_us, after_ms) = self.clock.get(after)?;
        if *after_us <= at_us {
            return (*after_ms > 0).then(|| f64::from(*after_ms) * 1e-3);
        }
        let (before_us, before_ms) = self.clock.get(after.checked_sub(1)?)?;
        let passed = after_ms.checked_sub(*before_ms).filter(|ms| *ms > 0)?;
        let share = (at_us - before_us) / (after_us - before_us);
        (*before_ms > 0).then(|| (f64::from(*before_ms) + share * f64::from(passed)) * 1e-3)
    }

    fn sum(&mut self, row: &BoardPoint) {
        let Some(path_s) = self.path_s(row.at_us) else {
            return;
        };
        let next = self.knots.partition_point(|knot| knot.time_s() <= path_s);
        let (Some(from), Some(to)) = (
            next.checked_sub(1).and_then(|last| self.knots.get(last)),
            self.knots.get(next),
        ) else {
            return;
        };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "positive, and an hour at most"
        )]
        let window = (path_s / WINDOW_S) as usize;
        if self.sums.len() <= window {
            let none = vec![Sums::default(); self.cables.len()];
            self.sums.resize(window + 1, none);
        }
        let (Some(cables), Some(gaps)) = (self.cables.get(row.board), self.gaps_m.get(row.board))
        else {
            return;
        };
        let sums = self.sums.get_mut(window);
        let Some(sums) = sums.and_then(|boards| boards.get_mut(row.board)) else {
            return;
        };
        let span_s = to.time_s() - from.time_s();
        let share = (path_s - from.time_s()) / span_s;
        for ((cable, gap_m), wanted) in cables.iter().zip(gaps).zip(row.lengths.iter()) {
            let (Some(from), Some(to)) = (from.cables.get(*cable), to.cables.get(*cable)) else {
                continue;
            };
            let (length_m, speed_mps) = cubic(from, to, span_s, share);
            let longer_m = wanted.metres() - gap_m - length_m;
            sums.vv += speed_mps * speed_mps;
            sums.ve += speed_mps * longer_m;
            sums.count += 1.0;
        }
    }

    /// The seconds so far in which every board moved its cables.
    #[must_use]
    pub fn windows(&self) -> Vec<Window> {
        let numbered = self.sums.iter().enumerate();
        let known = numbered.filter_map(|(number, boards)| {
            let late_s: Option<Vec<f64>> = boards.iter().map(Sums::late_s).collect();
            #[expect(clippy::cast_precision_loss, reason = "thousands")]
            let path_s = (number as f64 + 0.5) * WINDOW_S;
            Some(Window {
                path_s,
                late_s: late_s?,
            })
        });
        known.collect()
    }
}

/// Length, m, and its rate, m/s, of a cubic between two knots at a share of their time.
fn cubic(from: &CableKnot, to: &CableKnot, span_s: f64, share: f64) -> (f64, f64) {
    let (begin_m, end_m) = (from.length.metres(), to.length.metres());
    let (v0, v1) = (
        f64::from(from.velocity.0) * 1e-6 * span_s,
        f64::from(to.velocity.0) * 1e-6 * span_s,
    );
    let b = 3.0 * (end_m - begin_m) - 2.0 * v0 - v1;
    let c = 2.0 * (begin_m - end_m) + v0 + v1;
    let length_m = begin_m + share * (v0 + share * (b + share * c));
    let rate = v0 + share * (2.0 * b + 3.0 * share * c);
    (length_m, rate / span_s)
}
