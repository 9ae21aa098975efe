//! Encoders whose lines are not ideal: each test runs the firmware file, and compares what it counts
//! with what the drums have turned.

mod support;

use mcdpr_emulator::EncoderLine;
use mcdpr_protocol::{Reply, Request};
use support::{Bench, SLICE_US};

/// A count takes so long, us, at the top speed of the fastest drums: 300 rpm at 4096 counts per turn are 20,480 counts
/// per second (robots/lab-direct.toml, winch 4; the other fast winches reach 20,227).
const TOP_US: u64 = 48;
/// The same of the paper's robot: 8000 rpm / 371.13 are 1,472 counts per second.
const PAPER_US: u64 = 679;

const IDEAL: EncoderLine = EncoderLine {
    phase_error_deg: 0.0,
    duty_error_deg: 0.0,
    jitter_deg: 0.0,
    bounces: 0,
    bounce_ns: 0,
};
/// As bad as data sheets allow: 90 +- 45 degrees from A to B.
const EARLY: EncoderLine = EncoderLine {
    phase_error_deg: -45.0,
    jitter_deg: 15.0,
    bounces: 3,
    bounce_ns: 100,
    ..IDEAL
};
const LATE: EncoderLine = EncoderLine {
    phase_error_deg: 45.0,
    bounce_ns: 300,
    ..EARLY
};
const UNEVEN: EncoderLine = EncoderLine {
    phase_error_deg: 30.0,
    duty_error_deg: 25.0,
    jitter_deg: 15.0,
    bounces: 5,
    bounce_ns: 200,
};
const BAD: [EncoderLine; 4] = [EARLY, LATE, UNEVEN, LATE];

fn bench(lines: [EncoderLine; 4]) -> Bench {
    let mut bench = Bench::new();
    for (timer, line) in (1..).zip(lines) {
        bench.chip.set_encoder_line(timer, line);
    }
    bench
}

/// What the firmware has counted since power-on, on each encoder.
fn counted(bench: &mut Bench) -> [i64; 4] {
    // The filters' delay and the tick that reads them.
    bench.run_ms(2);
    [1, 2, 3, 4].map(|cable| match bench.done(Request::Winch { cable }) {
        Reply::Winch(winch) => i64::from(winch.drum_counts),
        other => panic!("{other:?}"),
    })
}

/// Turns all drums by so many counts, `step` in each slice.
fn turn(bench: &mut Bench, place: &mut i64, counts: i64, step: i64, slice_us: u64) {
    for _ in 0..counts.abs() / step {
        *place += step * counts.signum();
        for timer in 1..=4 {
            bench.chip.set_encoder(timer, *place);
        }
        assert_eq!(bench.chip.run_us(slice_us), Ok(()));
    }
}

#[test]
fn no_count_is_lost_on_the_worst_lines_of_the_data_sheets_at_any_speed_of_the_robots() {
    for slice_us in [TOP_US, PAPER_US] {
        let mut bench = bench(BAD);
        let mut place = 0;
        for counts in [100_000, -100_000] {
            for _ in 0..10 {
                turn(&mut bench, &mut place, counts / 10, 1, slice_us);
                assert_eq!(counted(&mut bench), [place; 4], "{slice_us} us");
            }
        }
        assert!((1..=4).all(|timer| bench.chip.lost_counts(timer) == 0));
    }
}

#[test]
fn drums_that_turn_to_and_fro_over_one_edge_lose_nothing() {
    let mut bench = bench(BAD);
    let mut place = 0;
    for length in [1, 2, 3, 5, 4, 1] {
        for _ in 0..500 {
            turn(&mut bench, &mut place, length, 1, TOP_US);
            turn(&mut bench, &mut place, 1 - length, 1, TOP_US);
        }
        assert_eq!(counted(&mut bench), [place; 4]);
    }
    assert_eq!(place, 3000);
}

#[test]
fn bounces_that_pass_the_filter_are_counted_and_add_up_to_nothing() {
    // The filter takes 1.8 us.
    let long = EncoderLine {
        bounces: 3,
        bounce_ns: 2500,
        ..IDEAL
    };
    let mut bench = bench([long; 4]);
    let mut place = 0;
    for counts in [20_000, -20_000, 1001] {
        turn(&mut bench, &mut place, counts, 1, TOP_US);
        assert_eq!(counted(&mut bench), [place; 4]);
    }
}

#[test]
fn a_program_fault_at_top_speed_costs_no_more_counts_on_bad_lines_than_on_ideal_ones() {
    for lines in [[IDEAL; 4], BAD] {
        let mut bench = bench(lines);
        let mut place = 0;
        turn(&mut bench, &mut place, 1000, 1, TOP_US);
        bench.chip.inject_hard_fault();
        let by = mcdpr_emulator::ResetBy::Software;
        while bench.chip.run_us(1).is_ok() {}
        bench.chip.restart(by);
        // The counters start after some instructions; meanwhile the core has 8 MHz, and so have the filters.
        let began = place;
        turn(&mut bench, &mut place, 2000, 1, TOP_US);
        for found in counted(&mut bench) {
            assert!((found - (place - began)).abs() <= 2, "{found}, {lines:?}");
        }
    }
}

#[test]
fn edges_in_the_wrong_order_are_counted_wrongly() {
    let exchanged = |phase_error_deg| EncoderLine {
        phase_error_deg,
        ..IDEAL
    };
    let mut bench = bench([exchanged(100.0), exchanged(-100.0), exchanged(80.0), IDEAL]);
    let mut place = 0;
    turn(&mut bench, &mut place, 1000, 1, TOP_US);
    let found = counted(&mut bench);
    println!("1000 counts with A to B 190, -10, 170 and 90 degrees: {found:?}");
    // B before A is the other direction.
    assert!(
        found[..2].iter().all(|count| (count + 1000).abs() <= 4),
        "{found:?}"
    );
    assert_eq!(found[2..], [1000; 2]);
    assert!(bench.chip.lost_counts(1) > 1900);
}

/// Whether counts are exact both ways, at so many counts per slice of 50 us.
fn exact(bench: &mut Bench, place: &mut i64, step: i64) -> [bool; 4] {
    let mut exact = [true; 4];
    for counts in [1200, -1200] {
        let (before, from) = (counted(bench), *place);
        turn(bench, place, counts, step, SLICE_US);
        let after = counted(bench);
        for (index, exact) in exact.iter_mut().enumerate() {
            *exact &= after[index] - before[index] == *place - from;
        }
    }
    exact
}

#[test]
fn the_speed_at_which_each_kind_of_line_breaks_first() {
    // Least factor over the top speed that no change may undercut.
    let rows = [
        ("ideal", IDEAL, 50.0),
        (
            "45 deg late",
            EncoderLine {
                jitter_deg: 0.0,
                bounces: 0,
                ..LATE
            },
            20.0,
        ),
        (
            "45 deg early, jitter 15 deg",
            EncoderLine {
                bounces: 0,
                ..EARLY
            },
            10.0,
        ),
        ("the same, 3 bounces of 100 ns", EARLY, 8.0),
        ("45 deg late, jitter, 3 bounces of 300 ns", LATE, 4.0),
        (
            "3 bounces of 1.5 us",
            EncoderLine {
                bounces: 3,
                bounce_ns: 1500,
                ..IDEAL
            },
            2.0,
        ),
        (
            "3 bounces of 2.5 us",
            EncoderLine {
                bounces: 3,
                bounce_ns: 2500,
                ..IDEAL
            },
            1.5,
        ),
        (
            "the same, 45 deg late",
            EncoderLine {
                bounces: 3,
                bounce_ns: 2500,
                phase_error_deg: 45.0,
                ..IDEAL
            },
            0.0,
        ),
    ];
    let top = 1e6 / TOP_US as f64;
    for (name, line, least) in rows {
        let mut bench = bench([line; 4]);
        let (mut place, mut breaks) = (0, None);
        // 20,000 counts per second are one in each slice.
        for step in 1..=80 {
            if breaks.is_none() && exact(&mut bench, &mut place, step) != [true; 4] {
                breaks = Some(step as f64 * 1e6 / SLICE_US as f64);
            }
        }
        let breaks = breaks.expect("some speed is too fast");
        println!(
            "{name}: from {breaks} counts/s on, {:.1} times the top speed",
            breaks / top
        );
        assert!(breaks >= least * top, "{name}");
    }
}
