//! Samples of several boards as those of one, at the ticks of the first board.

use super::layout::Layout;
use super::phase::Phase;
use mcdpr_protocol::{PerCable, Sample, SampleBlock, TenthMicrometres, Tick};
use std::collections::VecDeque;

/// Ticks of the first board that wait for those of the others before they are given up.
const WAIT_TICKS: usize = 400;

/// All channels of a board in a tick.
#[derive(Debug, Clone)]
struct Row {
    count: f64,
    path_ms: u32,
    samples: PerCable<Sample>,
}

/// The other boards' channels at the time of a tick of the first.
enum Others {
    Here(Vec<PerCable<Sample>>),
    /// They may still come.
    Late,
    /// The line lost them.
    Lost,
}

/// Joins samples.
#[derive(Debug, Default)]
pub(super) struct Merger {
    rows: Vec<VecDeque<Row>>,
    block: SampleBlock,
    filled: usize,
    /// The lengths of the tick before.
    before: Option<(u32, PerCable<TenthMicrometres>)>,
}

impl Merger {
    pub(super) fn new(boards: usize) -> Self {
        Self {
            rows: vec![VecDeque::new(); boards],
            ..Self::default()
        }
    }

    /// Takes a block of a board.
    pub(super) fn take(&mut self, board: usize, phase: &Phase, block: &SampleBlock) {
        let Some(rows) = self.rows.get_mut(board) else {
            return;
        };
        block.unpack(|tick, row| {
            let since = tick.0.wrapping_sub(block.tick.0);
            let Some(count) = phase.count(tick.0) else {
                return;
            };
            // A block that was sent again brings nothing new.
            if rows.back().is_none_or(|last| last.count < count) {
                rows.push_back(Row {
                    count,
                    path_ms: if block.path_ms > 0 {
                        block.path_ms + since
                    } else {
                        0
                    },
                    samples: PerCable::collect(row.iter().copied()),
                });
            }
        });
    }

    /// Blocks of all cables that are complete now; path times count from `lead_ms` of the first
    /// board.
    pub(super) fn joined(
        &mut self,
        layout: &Layout,
        phases: &[Phase],
        lead_ms: u32,
    ) -> Vec<SampleBlock> {
        let mut blocks = Vec::new();
        while let Some(first) = self.rows.first().and_then(|rows| rows.front()).cloned() {
            let parts = match self.others(phases, &first) {
                Others::Here(parts) => parts,
                Others::Late if self.rows.first().map_or(0, VecDeque::len) <= WAIT_TICKS => break,
                Others::Late | Others::Lost => {
                    self.drop_first();
                    continue;
                }
            };
            self.drop_first();
            let slices: Vec<&[Sample]> = parts.iter().map(|part| &part[..]).collect();
            let samples = layout.whole(&slices);
            let number = phases.first().map_or(0, |phase| phase.number(first.count));
            let path_ms = first.path_ms.saturating_sub(lead_ms);
            blocks.extend(self.append(number, path_ms, &samples));
        }
        blocks
    }

    fn drop_first(&mut self) {
        if let Some(rows) = self.rows.first_mut() {
            rows.pop_front();
        }
    }

    /// Every board's channels at the time of a tick of the first.
    fn others(&mut self, phases: &[Phase], first: &Row) -> Others {
        let Some(host_us) = phases.first().and_then(|phase| phase.host_us(first.count)) else {
            return Others::Late;
        };
        let mut parts = vec![first.samples.clone()];
        for (rows, phase) in self.rows.iter_mut().zip(phases).skip(1) {
            let Some(at) = phase.count_at(host_us) else {
                return Others::Late;
            };
            while rows.get(1).is_some_and(|next| next.count <= at) {
                rows.pop_front();
            }
            let (Some(low), Some(high)) = (rows.front(), rows.get(1)) else {
                return Others::Late;
            };
            // Rows that were lost on the line leave a gap that is not bridged.
            if at < low.count || high.count - low.count > 1.5 {
                return Others::Lost;
            }
            let share = (at - low.count) / (high.count - low.count);
            let pairs = low.samples.iter().zip(high.samples.iter());
            parts.push(PerCable::collect(
                pairs.map(|(low, high)| between(low, high, share)),
            ));
        }
        Others::Here(parts)
    }

    fn append(
        &mut self,
        tick: u32,
        path_ms: u32,
        samples: &PerCable<Sample>,
    ) -> Option<SampleBlock> {
        let lengths = PerCable::collect(samples.iter().map(|sample| sample.length));
        let follows = self
            .before
            .as_ref()
            .is_some_and(|(before, _)| before.wrapping_add(1) == tick);
        let mut done = None;
        if self.filled > 0 && !follows {
            done = Some(std::mem::take(&mut self.block));
            self.filled = 0;
        }
        let before = match &self.before {
            Some((_, lengths)) if follows => lengths.clone(),
            _ => lengths.clone(),
        };
        if self.filled == 0 {
            self.block = SampleBlock {
                tick: Tick(tick),
                path_ms,
                lengths: before.clone(),
                packed: mcdpr_protocol::List::new(),
            };
        }
        self.block.append(self.filled, &before, samples);
        self.filled += 1;
        self.before = Some((tick, lengths));
        if done.is_none() && self.filled >= SampleBlock::ticks(samples.len()) {
            done = Some(std::mem::take(&mut self.block));
            self.filled = 0;
        }
        done
    }
}

fn between(low: &Sample, high: &Sample, share: f64) -> Sample {
    #[expect(clippy::cast_possible_truncation, reason = "between two of its kind")]
    let mix = |low: i32, high: i32| {
        let (low, high) = (f64::from(low), f64::from(high));
        (low + share * (high - low)).round() as i32
    };
    Sample {
        length: TenthMicrometres(mix(low.length.0, high.length.0)),
        tension: mcdpr_protocol::Millinewtons(mix(low.tension.0, high.tension.0)),
        current: if share < 0.5 {
            low.current
        } else {
            high.current
        },
    }
}
