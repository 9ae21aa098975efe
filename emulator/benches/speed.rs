//! How fast the emulated chip runs the real firmware file: emulated seconds per second.
//!
//! Elements are emulated microseconds: 10 Melem/s is ten times real time.

#[path = "../tests/support/mod.rs"]
mod support;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mcdpr_emulator::{CanFrame, CanWiring, Chip};
use mcdpr_protocol::Request;
use std::hint::black_box;
use support::Bench;

/// Virtual time of one sample, microseconds.
const SPAN_US: u64 = 100_000;
/// Feedback of an RMDS, and its node's place in an identifier.
const FEEDBACK: u16 = 0xB;
const NODE_SHIFT: u16 = 4;

/// A slice of virtual time; every millisecond two of the four drives report their positions, as on
/// a bus at 500 Hz.
fn slice(chip: &mut Chip, slice: u64, drives: bool) {
    if drives && slice.is_multiple_of(20) {
        let first = 1 + 2 * (slice / 20 % 2) as u16;
        for node in [first, first + 1] {
            let id = (node << NODE_SHIFT) | FEEDBACK;
            chip.can_send(
                chip.now_us(),
                CanFrame::standard(id, &[0, 40, 0, 0, 0, 0, 0, node as u8]),
            );
        }
        black_box(chip.can_take());
    }
    assert_eq!(chip.run_us(support::SLICE_US), Ok(()));
}

fn speed(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("firmware");
    group.throughput(Throughput::Elements(SPAN_US));
    group.sample_size(20);
    for (name, drives) in [
        ("just_started", false),
        ("configured_with_can_and_samples", true),
    ] {
        let mut bench = Bench::new();
        if drives {
            bench.chip.set_can_wiring(CanWiring {
                bitrate: 1_000_000,
                others: true,
                shorted: false,
            });
            bench.prepare();
            bench.done(Request::Samples { enabled: true });
        }
        let mut slices = 0;
        let chip = &mut bench.chip;
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                for _ in 0..SPAN_US / support::SLICE_US {
                    slice(chip, slices, drives);
                    slices += 1;
                }
                black_box(chip.uart_take());
            });
        });
    }
    group.finish();
}

criterion_group!(benches, speed);
criterion_main!(benches);
