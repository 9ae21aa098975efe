//! One motion on several boards: every board's path clock counts its own milliseconds from its own
//! start, and all cables must be where the robot's path has them at the same time.
//!
//! A board starts in the tick after it hears the order, so boards start some milliseconds apart.
//! Therefore every motion begins with a rest, in which each board's answers show in which tick it
//! started. Then the knots follow, with times and places by each board's own clock: a knot falls on
//! a whole millisecond of the board, which is a fraction of a millisecond off the robot's, and takes
//! the place that the path has there. So neither the phase of a board's ticks nor the drift of its
//! crystal is left in what the drums do, and no board needs to know of another.

use super::layout::Layout;
use super::phase::Phase;

use mcdpr_protocol::{CableKnot, Knot, MicrometresPerSecond, Millinewtons, TenthMicrometres};

/// Path time of the first board at which the robot's path begins, ms.
pub(super) const LEAD_MS: u32 = 300;
/// Path time up to which every board rests by the first knots, ms.
const REST_MS: u32 = 280;
/// Least time between knots that a board takes, ms.
const LEAST_MS: u32 = 4;
/// How much faster or slower than the clocks' drift a board's path may be led to where it should
/// be, as a share: at 0.5 m/s a speed of 2.5 mm/s.
const LEAD_SHARE: f64 = 0.005;

/// A knot's place in robot time and in a board's path time, ms.
#[derive(Debug, Clone, Copy, Default)]
struct Mapped {
    robot_ms: f64,
    board_ms: f64,
    sent_ms: u32,
}

/// The motion in progress.
#[derive(Debug, Default)]
pub(super) struct Course {
    /// Counted tick minus path time of each board, ms: when it started.
    starts: Vec<Option<f64>>,
    /// Counted tick and path time of each board's last answer.
    seen: Vec<Option<(f64, u32)>>,
    mapped: Vec<Mapped>,
    /// The robot's knot before the next one.
    before: Option<Knot>,
    /// Number of the next knot.
    next: u16,
}

impl Course {
    /// A motion of this many boards that begins at this knot, at rest.
    pub(super) fn new(boards: usize, first: &Knot) -> Self {
        Self {
            starts: vec![None; boards],
            seen: vec![None; boards],
            mapped: vec![
                Mapped {
                    board_ms: f64::NAN,
                    sent_ms: REST_MS,
                    ..Mapped::default()
                };
                boards
            ],
            before: Some(Knot {
                rows: mcdpr_protocol::List::new(),
                ..first.clone()
            }),
            next: 2,
        }
    }

    /// The two knots of a board between which it rests.
    pub(super) fn rest(&self, layout: &Layout, board: usize) -> Vec<Knot> {
        let Some(first) = &self.before else {
            return Vec::new();
        };
        let mut begin = layout.knot(board, first);
        begin.last = false;
        let mut end = begin.clone();
        (begin.index, begin.time_ms) = (0, 0);
        (end.index, end.time_ms) = (1, REST_MS);
        vec![begin, end]
    }

    /// A board moves: in this counted tick its path time is this, ms. Two answers between which the
    /// path clock ran at full rate tell when the path started.
    pub(super) fn seen(&mut self, board: usize, count: f64, path_ms: u32) {
        let Some(place) = self.seen.get_mut(board) else {
            return;
        };
        let now = (count, f64::from(path_ms));
        let before = place.replace((count, path_ms));
        let steady = before.is_some_and(|(then, before_ms)| {
            now.0 > then && (now.0 - then - (now.1 - f64::from(before_ms))).abs() < 0.5
        });
        if steady && let Some(start) = self.starts.get_mut(board) {
            *start = Some(now.0 - now.1);
        }
    }

    /// How much later one board's path is than another's, ms of path time, by their last answers;
    /// 0 before all starts are known.
    pub(super) fn apart_ms(&self, phases: &[Phase]) -> f64 {
        let behind = |board: usize| -> Option<f64> {
            let (count, path_ms) = self.seen.get(board).copied().flatten()?;
            let host_us = phases.get(board)?.host_us(count)?;
            // The first board's path time at the same moment.
            let (first, first_ms) = self.seen.first().copied().flatten()?;
            let then = phases.first()?.count_at(host_us)?;
            Some(f64::from(first_ms) + then - first - f64::from(path_ms) - self.offset_ms(board))
        };
        if !self.is_synced() {
            return 0.0;
        }
        let all = (0..self.seen.len()).filter_map(behind);
        all.fold(0.0, |most: f64, one| most.max(one.abs()))
    }

    /// How much later than the first a board started its path clock, ms, when it was last led.
    fn offset_ms(&self, board: usize) -> f64 {
        let (Some(first), Some(this)) = (self.mapped.first(), self.mapped.get(board)) else {
            return 0.0;
        };
        let offset = first.board_ms - this.board_ms;
        if offset.is_nan() { 0.0 } else { offset }
    }

    /// The time of the last knot, ms of the robot's path.
    pub(super) fn last_ms(&self) -> u32 {
        self.before.as_ref().map_or(0, |knot| knot.time_ms)
    }

    /// Whether the start of every board is known.
    pub(super) fn is_synced(&self) -> bool {
        self.starts.iter().all(Option::is_some)
    }

    /// When a board started, counted tick.
    pub(super) fn start(&self, board: usize) -> Option<f64> {
        self.starts.get(board).copied().flatten()
    }

    /// A board's path time at a time of the robot's path, both ms; `None` before the starts are
    /// known.
    fn board_ms(&self, phases: &[Phase], board: usize, robot_ms: f64) -> Option<f64> {
        let path_ms = f64::from(LEAD_MS) + robot_ms;
        if board == 0 {
            return Some(path_ms);
        }
        // The first board's clock is the robot's.
        let host_us = phases.first()?.host_us(self.start(0)? + path_ms)?;
        Some(phases.get(board)?.count_at(host_us)? - self.start(board)?)
    }

    /// Each board's part of the robot's next knot; `None` before the starts are known.
    pub(super) fn next(
        &mut self,
        layout: &Layout,
        phases: &[Phase],
        knot: &Knot,
    ) -> Option<Vec<Knot>> {
        let before = self.before.as_ref()?;
        let robot_ms = f64::from(knot.time_ms);
        let mut parts = Vec::new();
        let mut mapped = Vec::new();
        for (board, last) in self.mapped.iter().enumerate() {
            let wanted = self.board_ms(phases, board, robot_ms)?;
            // The estimates of the clocks change a little with every answer, and after a hold the
            // starts do: the path is led there, not thrown.
            let passed = robot_ms - last.robot_ms;
            let even = last.board_ms + passed;
            let reach = LEAD_SHARE * passed;
            let board_ms = if last.board_ms.is_nan() {
                wanted
            } else {
                wanted.clamp(even - reach, even + reach)
            };
            let rate = if last.board_ms.is_nan() || passed <= 0.0 {
                1.0
            } else {
                (board_ms - last.board_ms) / passed
            };
            // Before the knot, so that the segment up to it has the place; only the end is after,
            // because it must be at rest.
            let whole = if knot.last {
                board_ms.ceil()
            } else {
                board_ms.floor()
            };
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "positive, and saturates"
            )]
            let sent_ms = (whole as u32).max(last.sent_ms + LEAST_MS);
            let off_ms = (f64::from(sent_ms) - board_ms) / rate;
            let mut moved = at(before, knot, robot_ms + off_ms, rate);
            moved.index = self.next;
            moved.time_ms = sent_ms;
            parts.push(layout.knot(board, &moved));
            mapped.push(Mapped {
                robot_ms,
                board_ms,
                sent_ms,
            });
        }
        self.mapped = mapped;
        self.next = self.next.wrapping_add(1);
        self.before = Some(knot.clone());
        Some(parts)
    }
}

/// The path at a time next to a knot, ms, from the cubic that ends there; velocities are per time
/// of a clock that runs at this rate.
fn at(before: &Knot, knot: &Knot, time_ms: f64, rate: f64) -> Knot {
    let mut moved = knot.clone();
    let span_ms = f64::from(knot.time_ms) - f64::from(before.time_ms);
    if knot.last || span_ms <= 0.0 {
        // At rest: the place is that of the knot.
        return moved;
    }
    let share = (time_ms - f64::from(before.time_ms)) / span_ms;
    for (cable, (from, to)) in moved
        .cables
        .iter_mut()
        .zip(before.cables.iter().zip(knot.cables.iter()))
    {
        *cable = between(from, to, span_ms * 1e-3, share, rate);
    }
    moved
}

fn between(from: &CableKnot, to: &CableKnot, span_s: f64, share: f64, rate: f64) -> CableKnot {
    let (begin, end) = (from.length.metres(), to.length.metres());
    let per_s = |v: MicrometresPerSecond| f64::from(v.0) * 1e-6;
    let (v0, v1) = (per_s(from.velocity) * span_s, per_s(to.velocity) * span_s);
    // The cubic in powers of the share.
    let b = 3.0 * (end - begin) - 2.0 * v0 - v1;
    let c = 2.0 * (begin - end) + v0 + v1;
    let length_m = begin + share * (v0 + share * (b + share * c));
    let velocity = (v0 + share * (2.0 * b + 3.0 * share * c)) / span_s;
    let tension_n =
        from.tension.newtons() + share * (to.tension.newtons() - from.tension.newtons());
    CableKnot {
        length: TenthMicrometres::from_metres(length_m),
        velocity: MicrometresPerSecond::from_metres_per_second(velocity / rate),
        tension: Millinewtons::from_newtons(tension_n),
    }
}
