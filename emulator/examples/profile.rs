//! Where the control tick spends its instructions: one line per address with how often it was
//! executed in all ticks of a second, and in the longest tick. To be read with a symboliser:
//!
//! `cargo run --release -p mcdpr-emulator --example profile | while read a all longest; do
//! echo "$all $longest $(addr2line -f -e FIRMWARE.elf $a | head -1)"; done`

#[path = "../tests/support/mod.rs"]
mod support;

use mcdpr_emulator::ProfileRow;
use mcdpr_protocol::Request;
use support::Bench;

fn main() {
    let mut bench = Bench::new();
    bench.prepare();
    bench.done(Request::Samples { enabled: true });
    bench.run_ms(100);
    bench.chip.profile_ticks();
    bench.chip.take_tick_stats();
    for beat in 0..10 {
        for timer in 1..=4 {
            bench.chip.set_encoder(timer, i64::from(beat));
        }
        bench.done(Request::Heartbeat { host_time_us: beat });
        bench.run_ms(88);
    }
    let stats = bench.chip.tick_stats();
    eprintln!(
        "{} ticks, median {}, most {}",
        stats.count, stats.median, stats.max
    );
    for ProfileRow {
        address,
        all,
        longest,
    } in bench.chip.tick_profile()
    {
        println!("{address:#010x} {all} {longest}");
    }
}
