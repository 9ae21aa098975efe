use crate::support::{Rng, build, entries};
use mcdpr_firmware::encoder::{Encoder, LengthScale, Sampled};
use mcdpr_protocol::{CableKey, ConfigKey};

#[test]
fn s3_sixteen_bits_follow_a_64_bit_reference_over_random_walks_and_wraps() {
    for seed in 0..20 {
        let mut rng = Rng(seed);
        let start = rng.between(0, 65_535);
        let (mut truth, mut encoder) = (start, Encoder::default());
        // The counter may have counted before the first sample, in either direction.
        encoder.sample(truth as u16, u16::MAX);
        let first = i64::from(truth as u16 as i16);
        assert_eq!(encoder.counts(), first);
        let drift = rng.between(-2000, 2000);
        let (mut low, mut high) = (0, 0);
        for _ in 0..20_000 {
            let step = (drift + rng.between(-1000, 1000)).clamp(-3000, 3000);
            truth += step;
            assert_eq!(encoder.sample(truth as u16, 3000), Sampled::Good);
            assert_eq!(encoder.counts(), first + truth - start, "seed {seed}");
            (low, high) = (low.min(truth), high.max(truth));
        }
        assert!(
            high - low > 65_536 || drift.abs() < 10,
            "the walk of seed {seed} never wrapped"
        );
    }
}

#[test]
fn s3_a_standing_drum_at_the_edge_of_the_counter_does_not_step() {
    let mut encoder = Encoder::default();
    encoder.sample(0, 10);
    for _ in 0..100 {
        encoder.sample(65_535, 10);
        assert_eq!(encoder.counts(), -1);
        encoder.sample(0, 10);
        assert_eq!(encoder.counts(), 0);
    }
}

/// Runs at 7 counts per tick with a glitch of `bad` samples; what was seen during it.
fn glitch(bad: usize, jump: u16, speed: i64) -> (Vec<Sampled>, i64, i64) {
    // 36 counts below the counter's zero.
    let (mut encoder, mut truth) = (Encoder::default(), -36_i64);
    encoder.sample(truth as u16, u16::MAX);
    let mut seen = Vec::new();
    for tick in 0..50 {
        truth += speed;
        let shown = truth as u16;
        let in_glitch = (20..20 + bad).contains(&tick);
        let shown = if in_glitch {
            shown.wrapping_add(jump)
        } else {
            shown
        };
        let sampled = encoder.sample(shown, 40);
        if in_glitch {
            seen.push(sampled);
            if sampled == Sampled::Rejected {
                assert_eq!(encoder.counts(), truth, "prediction at tick {tick}");
            }
        } else if bad <= 2 {
            assert_eq!(sampled, Sampled::Good);
        }
    }
    (seen, encoder.counts(), truth)
}

#[test]
fn s1_glitches_of_one_and_two_samples_leave_no_trace_in_either_direction() {
    for jump in [200, 0x4000, 0x8000, 0xC000, 65_300] {
        for speed in [-7, 0, 7, 35] {
            for bad in [1, 2] {
                let (seen, counts, truth) = glitch(bad, jump, speed);
                assert!(
                    seen.iter().all(|&s| s == Sampled::Rejected),
                    "{jump} {speed} {bad}"
                );
                assert_eq!(counts, truth, "jump {jump} speed {speed}");
            }
        }
    }
}

#[test]
fn s6_a_third_jump_means_that_the_encoder_is_lost() {
    let (seen, ..) = glitch(3, 0x4000, 7);
    assert_eq!(seen, [Sampled::Rejected, Sampled::Rejected, Sampled::Lost]);
}

#[test]
fn s6_a_lost_encoder_counts_on_from_its_new_place_so_that_it_can_be_referenced_again() {
    let mut encoder = Encoder::default();
    encoder.sample(100, 40);
    for _ in 0..3 {
        encoder.sample(30_000, 40);
    }
    let before = encoder.counts();
    for step in 1..=10_u16 {
        assert_eq!(encoder.sample(30_000 + 5 * step, 40), Sampled::Good);
        assert_eq!(encoder.counts(), before + 5 * i64::from(step));
    }
}

#[test]
fn lengths_are_true_to_a_tenth_of_a_micrometre_over_twenty_metres() {
    let mut rng = Rng(5);
    for (radius, per_turn) in [
        (200_000, 4096),
        (50_000, 1024),
        (123_457, 8192),
        (600_000, 16_384),
    ] {
        for sign in [-1, 1] {
            let mut all = entries();
            for (key, value) in [
                (CableKey::DrumRadius, radius),
                (CableKey::EncoderCountsPerTurn, per_turn),
                (CableKey::EncoderSign, sign),
            ] {
                let key = ConfigKey::cable(0, key);
                all.iter_mut().find(|e| e.key == key).unwrap().value = value;
            }
            let scale = LengthScale {
                reference_counts: 12_345,
                reference: 1_000_000,
                per_count_q24: build(&all).unwrap().cables[0].per_count_q24,
            };
            let per_count = std::f64::consts::TAU * f64::from(radius) / f64::from(per_turn);
            // Twenty metres either way.
            let most = (200_000_000.0 / per_count) as i64;
            for _ in 0..2000 {
                let counts = rng.between(-most, most);
                let truth = 1_000_000.0 + f64::from(sign) * per_count * counts as f64;
                let length = scale.length(12_345 + counts).0;
                let error = f64::from(length) - truth;
                assert!(error.abs() <= 1.0, "{radius} {per_turn} {counts}: {error}");
            }
        }
    }
}
