//! The two lines of an encoder that is not ideal: when their levels change, as its drum turns.
//!
//! Going up, A rises, B rises, A falls, B falls. At a whole position the levels are those of that count; ideal edges
//! lie halfway between two.

/// What an encoder's lines have that ideal ones do not. Angles are electrical degrees: 360 are one line, four counts.
///
/// Data sheets of incremental encoders allow 90 +- 45 degrees from an edge of A to the next of B. While half of the
/// phase error, half of the duty error and the jitter are under 45 degrees together, the levels at every whole
/// position are the right ones.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EncoderLine {
    /// B follows A by 90 degrees and this.
    pub phase_error_deg: f64,
    /// Both are high for 180 degrees and this.
    pub duty_error_deg: f64,
    /// Each edge is early or late by up to this, 90 at most.
    pub jitter_deg: f64,
    /// After each edge the line goes back so many times,
    pub bounces: u32,
    /// each time for so long, and as long between them, ns.
    pub bounce_ns: u32,
}

/// A count is a quarter of a line.
const DEG_PER_COUNT: f64 = 90.0;
/// Counts of a line.
const COUNTS: f64 = 4.0;

/// A level of line 0 (A) or 1 (B) from a time on, in ticks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Edge {
    pub at: u64,
    pub line: usize,
    pub level: bool,
}

/// The lines of one encoder.
#[derive(Debug, Clone)]
pub(crate) struct Lines {
    is: EncoderLine,
    noise: u64,
    levels: [bool; 2],
    /// Edges that come later: bounces.
    later: Vec<Edge>,
}

impl Lines {
    /// At a position; encoders with different seeds have different jitter.
    pub fn new(is: EncoderLine, position: i64, seed: u64) -> Self {
        let place = position.rem_euclid(4);
        Self {
            is,
            noise: (seed + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15),
            levels: [matches!(place, 1 | 2), matches!(place, 2 | 3)],
            later: Vec::new(),
        }
    }

    /// Other properties from now on; what bounces goes on as it was.
    pub(crate) const fn become_like(&mut self, is: EncoderLine) {
        self.is = is;
    }

    /// Levels at the beginning of the next slice.
    pub const fn levels(&self) -> [bool; 2] {
        self.levels
    }

    /// The edges while the drum turns evenly between two positions, in their order.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a time within the slice"
    )]
    pub fn turn(&mut self, from: i64, to: i64, begin: u64, ticks: u64) -> Vec<Edge> {
        let counts = (to - from).unsigned_abs() as f64;
        for line in 0..2 {
            let mut last = begin;
            for (distance, level) in self.crossed(line, from as f64, to as f64) {
                let jitter = self.draw() * self.is.jitter_deg.min(90.0) / DEG_PER_COUNT;
                let share = ((distance + jitter) / counts).clamp(0.0, 1.0);
                // Jitter exchanges no two edges of a line.
                let at = (begin + (share * ticks as f64).round() as u64).max(last);
                last = at;
                self.add(Edge { at, line, level });
            }
        }
        let end = begin + ticks;
        self.later.sort_by_key(|edge| edge.at);
        let ended = self.later.partition_point(|edge| edge.at <= end);
        let edges: Vec<Edge> = self.later.drain(..ended).collect();
        for edge in &edges {
            self.levels[edge.line] = edge.level;
        }
        edges
    }

    /// Edges of a line between two positions: how far away, in counts, and the level behind.
    fn crossed(&self, line: usize, from: f64, to: f64) -> Vec<(f64, bool)> {
        // A leads and B lags by half of the phase error; a duty error lets the line rise early and fall late.
        let lag = [-0.5, 0.5][line] * self.is.phase_error_deg / DEG_PER_COUNT;
        let duty = 0.5 * self.is.duty_error_deg / DEG_PER_COUNT;
        let (low, high) = (from.min(to), from.max(to));
        let mut crossed = Vec::new();
        for rises in [true, false] {
            let first = if rises { 0.5 - duty } else { 2.5 + duty } + line as f64 + lag;
            // A position on an edge is behind it.
            let mut place = first + COUNTS * ((low - first) / COUNTS).floor() + COUNTS;
            while place <= high {
                crossed.push(((place - from).abs(), rises == (to > from)));
                place += COUNTS;
            }
        }
        crossed.sort_by(|a, b| a.0.total_cmp(&b.0));
        crossed
    }

    /// Adds an edge and its bounces. It ends those of the edge before.
    fn add(&mut self, edge: Edge) {
        let before = |other: &Edge| other.line != edge.line || other.at < edge.at;
        self.later.retain(before);
        self.later.push(edge);
        // 72 ticks are 1000 ns.
        let ticks = (u64::from(self.is.bounce_ns) * 72).div_ceil(1000).max(1);
        for half in 1..=2 * u64::from(self.is.bounces) {
            self.later.push(Edge {
                at: edge.at + half * ticks,
                level: edge.level == half.is_multiple_of(2),
                ..edge
            });
        }
    }

    /// A number from -1 to 1.
    fn draw(&mut self) -> f64 {
        self.noise ^= self.noise << 13;
        self.noise ^= self.noise >> 7;
        self.noise ^= self.noise << 17;
        (self.noise >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Edges over some counts of 90 ticks each: a tick is a degree.
    fn edges(is: EncoderLine, from: i64, to: i64) -> Vec<(u64, usize, bool)> {
        let ticks = 90 * (to - from).unsigned_abs();
        let turned = Lines::new(is, from, 0).turn(from, to, 0, ticks);
        let edges = turned.iter();
        edges.map(|edge| (edge.at, edge.line, edge.level)).collect()
    }

    #[test]
    fn ideal_edges_lie_halfway_between_counts() {
        let up = [
            (45, 0, true),
            (135, 1, true),
            (225, 0, false),
            (315, 1, false),
        ];
        assert_eq!(edges(EncoderLine::default(), 0, 4), up);
        let down = [
            (45, 1, true),
            (135, 0, true),
            (225, 1, false),
            (315, 0, false),
        ];
        assert_eq!(edges(EncoderLine::default(), 4, 0), down);
    }

    #[test]
    fn phase_and_duty_errors_move_edges_by_their_angle() {
        let late = EncoderLine {
            phase_error_deg: 40.0,
            ..EncoderLine::default()
        };
        // 130 degrees from A to B, 50 from B to A.
        let up = [
            (25, 0, true),
            (155, 1, true),
            (205, 0, false),
            (335, 1, false),
        ];
        assert_eq!(edges(late, 0, 4), up);
        let wide = EncoderLine {
            duty_error_deg: 40.0,
            ..EncoderLine::default()
        };
        // 220 degrees high.
        let up = [
            (25, 0, true),
            (115, 1, true),
            (245, 0, false),
            (335, 1, false),
        ];
        assert_eq!(edges(wide, 0, 4), up);
    }

    #[test]
    fn a_line_bounces_after_its_edge_and_into_the_next_slice() {
        let bouncing = EncoderLine {
            bounces: 2,
            bounce_ns: 500,
            ..EncoderLine::default()
        };
        let mut lines = Lines::new(bouncing, 0, 0);
        let times = |edges: Vec<Edge>| -> Vec<(u64, bool)> {
            edges.iter().map(|edge| (edge.at, edge.level)).collect()
        };
        // 500 ns are 36 ticks.
        let first = times(lines.turn(0, 1, 0, 100));
        assert_eq!(first, [(50, true), (86, false)]);
        assert_eq!(lines.levels(), [false, false]);
        let second = times(lines.turn(1, 1, 100, 100));
        assert_eq!(second, [(122, true), (158, false), (194, true)]);
        assert_eq!(lines.levels(), [true, false]);
    }

    #[test]
    fn jitter_stays_within_its_bound_and_repeats() {
        let jitter = EncoderLine {
            jitter_deg: 15.0,
            ..EncoderLine::default()
        };
        let found = edges(jitter, 0, 4000);
        assert_eq!(found, edges(jitter, 0, 4000));
        let off = |index: usize| found[index].0 as f64 - (45 + 90 * index) as f64;
        let most = (0..4000).map(|index| off(index).abs()).fold(0.0, f64::max);
        assert!((13.0..=16.0).contains(&most), "{most}");
        assert!((0..4000).map(off).sum::<f64>().abs() < 4000.0);
    }
}
