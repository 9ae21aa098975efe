//! A timer's two inputs: their filters, and what their edges count (RM0008, 15.3.12 and 15.4.7).

use super::encoder_line::Edge;

/// Input filters (CCMR1, ICxF): cycles from one sample to the next, and equal samples that an edge needs.
const FILTERS: [(u64, u64); 16] = [
    (1, 0),
    (1, 2),
    (1, 4),
    (1, 8),
    (2, 6),
    (2, 8),
    (4, 6),
    (4, 8),
    (8, 6),
    (8, 8),
    (16, 5),
    (16, 6),
    (16, 8),
    (32, 5),
    (32, 6),
    (32, 8),
];
/// Filters from here on sample at the clock that CKD divides.
const DIVIDED: u32 = 4;

/// An input filter, in the unit of its `period`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Sampling {
    pub period: u64,
    /// Equal samples; 0 for no filter.
    pub samples: u64,
}

impl Sampling {
    /// In cycles of the timer's clock. `divider` is CKD.
    pub fn new(code: u32, divider: u32) -> Self {
        let (period, samples) = FILTERS[(code & 15) as usize];
        // CKD slows the sampling clock by 1, 2 or 4.
        let shift = if code & 15 < DIVIDED { 0 } else { divider & 3 };
        Self {
            period: period << shift,
            samples,
        }
    }

    /// A level that is shorter is filtered out.
    pub const fn length(self) -> u64 {
        self.period * self.samples
    }

    /// In ticks.
    pub const fn scaled(self, cycle: u64) -> Self {
        Self {
            period: self.period * cycle,
            ..self
        }
    }
}

/// One filtered input.
#[derive(Debug, Clone, Copy)]
struct Input {
    level: bool,
    /// Behind the filter.
    filtered: bool,
    /// Samples in a row that differ from it.
    different: u64,
    /// Samples before this time are counted.
    since: u64,
}

impl Input {
    const fn new(level: bool, since: u64) -> Self {
        Self {
            level,
            filtered: level,
            different: 0,
            since,
        }
    }

    /// The level stays until then. Returns when the filtered level changes, if it does.
    const fn stays(&mut self, until: u64, by: Sampling) -> Option<u64> {
        if until <= self.since {
            return None;
        }
        // Sampled at every multiple of the period.
        let first = self.since.div_ceil(by.period);
        let samples = until.div_ceil(by.period) - first;
        self.since = until;
        if self.level == self.filtered {
            if samples > 0 {
                self.different = 0;
            }
            return None;
        }
        let needed = by.samples.saturating_sub(self.different);
        if samples < needed {
            self.different += samples;
            return None;
        }
        self.filtered = self.level;
        self.different = 0;
        Some((first + needed.saturating_sub(1)) * by.period)
    }

    /// The level changes. Without a filter that is at once an edge.
    const fn becomes(&mut self, level: bool, by: Sampling) -> bool {
        self.level = level;
        let edge = by.samples == 0 && level != self.filtered;
        if edge {
            self.filtered = level;
        }
        edge
    }
}

/// What an edge of an input counts, by the level of the other: RM0008, table "Counting direction versus encoder
/// signals", the rows for counting on TI1 and TI2.
const fn counts(line: usize, rises: bool, other: bool) -> i64 {
    match (line, rises, other) {
        (0, true, false) | (0, false, true) => 1,
        (0, ..) => -1,
        (_, true, true) | (_, false, false) => 1,
        _ => -1,
    }
}

/// Both inputs, and what has been counted in this slice.
#[derive(Debug, Clone)]
pub(crate) struct Decoder {
    inputs: [Input; 2],
    /// The levels that the last edges left.
    levels: [bool; 2],
    /// When, and in which direction.
    pub counted: Vec<(u64, i64)>,
}

impl Decoder {
    /// Filters that have had their levels for long.
    pub fn new(levels: [bool; 2], now: u64) -> Self {
        Self {
            inputs: levels.map(|level| Input::new(level, now)),
            levels,
            counted: Vec::new(),
        }
    }

    /// A slice with these edges, in their order. Adds what they count; returns the sum.
    pub fn pass(&mut self, edges: &[Edge], until: u64, by: [Sampling; 2]) -> i64 {
        let mut filtered = Vec::new();
        for (line, (input, by)) in self.inputs.iter_mut().zip(by).enumerate() {
            let mut note = |at: u64, level: bool| filtered.push(Edge { at, line, level });
            for edge in edges.iter().filter(|edge| edge.line == line) {
                let level = input.level;
                if let Some(at) = input.stays(edge.at, by) {
                    note(at, level);
                }
                if input.becomes(edge.level, by) {
                    note(edge.at, edge.level);
                }
            }
            let level = input.level;
            if let Some(at) = input.stays(until, by) {
                note(at, level);
            }
        }
        filtered.sort_by_key(|edge| edge.at);
        let before = self.counted.len();
        let mut rest = filtered.as_slice();
        while let [edge, others @ ..] = rest {
            let both = others
                .first()
                .is_some_and(|next| next.at == edge.at && next.line != edge.line);
            if both {
                // The table holds for inputs that do not switch at once. Here such a pair counts nothing.
                self.levels = self.levels.map(|level| !level);
                rest = &others[1..];
                continue;
            }
            let other = self.levels[1 - edge.line];
            self.counted
                .push((edge.at, counts(edge.line, edge.level, other)));
            self.levels[edge.line] = edge.level;
            rest = others;
        }
        self.counted[before..].iter().map(|(_, step)| step).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OFF: [Sampling; 2] = [Sampling {
        period: 1,
        samples: 0,
    }; 2];

    /// Independent of the decoder: places of the levels A, B on the circle of a line.
    fn place(levels: [bool; 2]) -> i64 {
        match levels {
            [false, false] => 0,
            [true, false] => 1,
            [true, true] => 2,
            [false, true] => 3,
        }
    }

    #[test]
    fn every_edge_counts_one_step_around_the_circle() {
        for start in [[false, false], [false, true], [true, false], [true, true]] {
            for line in 0..2 {
                let mut after = start;
                after[line] = !after[line];
                let edge = Edge {
                    at: 5,
                    line,
                    level: after[line],
                };
                let counted = Decoder::new(start, 0).pass(&[edge], 10, OFF);
                let step = (place(after) - place(start) + 4) % 4;
                assert_eq!(
                    counted,
                    if step == 3 { -1 } else { step },
                    "{start:?} {after:?}"
                );
            }
        }
    }

    #[test]
    fn any_course_of_the_levels_ends_where_the_circle_does() {
        let mut noise = 7_u32;
        let mut levels = [false; 2];
        let mut decoder = Decoder::new(levels, 0);
        let (mut sum, mut truth) = (0, 0);
        for slice in 0..1000 {
            let mut edges = Vec::new();
            for at in 0..20 {
                noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let line = (noise >> 31) as usize;
                let before = place(levels);
                levels[line] = !levels[line];
                truth += (place(levels) - before + 5) % 4 - 1;
                edges.push(Edge {
                    at: 100 * slice + at,
                    line,
                    level: levels[line],
                });
            }
            sum += decoder.pass(&edges, 100 * (slice + 1), OFF);
            assert_eq!(sum, truth);
        }
        assert!(truth != 0);
    }

    #[test]
    fn two_edges_at_once_count_nothing_and_the_next_ones_count_again() {
        let edges = [(5, 0, true), (5, 1, true), (7, 0, false), (9, 1, false)];
        let edges = edges.map(|(at, line, level)| Edge { at, line, level });
        let mut decoder = Decoder::new([false; 2], 0);
        assert_eq!(decoder.pass(&edges, 10, OFF), 2);
        assert_eq!(decoder.counted, [(7, 1), (9, 1)]);
    }

    #[test]
    fn a_filter_needs_its_equal_samples_in_a_row() {
        // The firmware's: eight samples, 16 cycles apart.
        let by = Sampling::new(12, 0);
        assert_eq!((by.period, by.samples, by.length()), (16, 8, 128));
        // CKD divides only the clock of the slower ones.
        assert_eq!(Sampling::new(12, 2).length(), 512);
        assert_eq!(Sampling::new(3, 2).length(), 8);
        // A pulse of so many cycles from cycle 100 on; what it counts, and when.
        let pulse = |cycles: u64| {
            let edges = [(100, true), (100 + cycles, false)];
            let edges = edges.map(|(at, level)| Edge { at, line: 0, level });
            let mut decoder = Decoder::new([false; 2], 0);
            assert_eq!(decoder.pass(&edges, 10_000, [by; 2]), 0);
            decoder.counted
        };
        // The samples are at 112, 128, ... 224.
        assert_eq!(pulse(124), []);
        assert_eq!(pulse(125), [(224, 1), (352, -1)]);
        // Two pulses that are too short, of 120 cycles each: the filter begins anew.
        let edges = [(100, true), (220, false), (245, true), (365, false)];
        let edges = edges.map(|(at, level)| Edge { at, line: 0, level });
        let mut decoder = Decoder::new([false; 2], 0);
        decoder.pass(&edges, 10_000, [by; 2]);
        assert_eq!(decoder.counted, []);
    }

    #[test]
    fn a_filter_does_not_notice_where_a_slice_ends() {
        let by = [Sampling::new(12, 0); 2];
        let edges = [
            (100, 0, true),
            (300, 1, true),
            (330, 1, false),
            (900, 0, false),
        ];
        let edges = edges.map(|(at, line, level)| Edge { at, line, level });
        let mut whole = Decoder::new([false; 2], 0);
        whole.pass(&edges, 2000, by);
        let mut sliced = Decoder::new([false; 2], 0);
        for end in 1..=2000 {
            let now = edges.iter().copied().filter(|edge| edge.at == end - 1);
            sliced.pass(&now.collect::<Vec<_>>(), end, by);
        }
        assert_eq!(whole.counted, [(224, 1), (1024, -1)]);
        assert_eq!(sliced.counted, whole.counted);
    }
}
