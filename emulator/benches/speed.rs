//! How fast the emulated chip runs the real firmware file: emulated seconds per second.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mcdpr_emulator::Chip;
use std::hint::black_box;

/// Virtual time of one sample, microseconds.
const SPAN_US: u64 = 100_000;

fn speed(criterion: &mut Criterion) {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    let path = std::env::var("MCDPR_FIRMWARE")
        .unwrap_or_else(|_| format!("{root}/target/thumbv7m-none-eabi/firmware/mcdpr-firmware"));
    let Ok(elf) = std::fs::read(&path) else {
        eprintln!("{path} is missing: build it with `cargo fw`");
        return;
    };
    let Ok(mut chip) = Chip::load(&elf) else {
        eprintln!("{path} is not this chip's firmware: build it with `cargo fw`");
        return;
    };
    let mut group = criterion.benchmark_group("firmware");
    // Elements are emulated microseconds: 10 Melem/s is ten times real time.
    group.throughput(Throughput::Elements(SPAN_US));
    group.sample_size(20);
    group.bench_function("emulated_us", |bencher| {
        bencher.iter(|| {
            for _ in 0..SPAN_US / 50 {
                let run = chip.run_us(50);
                assert_eq!(run, Ok(()));
            }
            black_box(chip.uart_take());
        });
    });
    group.finish();
}

criterion_group!(benches, speed);
criterion_main!(benches);
