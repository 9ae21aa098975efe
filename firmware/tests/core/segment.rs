use crate::support::Rng;
use mcdpr_firmware::segment::{MAX_SPACING_MS, MIN_SPACING_MS, Segment, StoredKnot, StoredRow};
use mcdpr_protocol::{
    CableKnot, MicrometresPerSecond, Millinewtons, ResidualRow, TenthMicrometres,
};

/// Position (0.1 µm), velocity (µm/s), acceleration (µm/s²) of the cubic Hermite polynomial.
pub fn hermite(from: &CableKnot, to: &CableKnot, spacing_ms: f64, t_ms: f64) -> [f64; 3] {
    let h = spacing_ms * 1e-3;
    let s = t_ms / spacing_ms;
    let (p0, p1) = (f64::from(from.length.0) * 0.1, f64::from(to.length.0) * 0.1);
    let (m0, m1) = (f64::from(from.velocity.0) * h, f64::from(to.velocity.0) * h);
    let value = (2.0 * s.powi(3) - 3.0 * s * s + 1.0) * p0
        + (s.powi(3) - 2.0 * s * s + s) * m0
        + (3.0 * s * s - 2.0 * s.powi(3)) * p1
        + (s.powi(3) - s * s) * m1;
    let slope = 6.0 * (s * s - s) * (p0 - p1)
        + (3.0 * s * s - 4.0 * s + 1.0) * m0
        + (3.0 * s * s - 2.0 * s) * m1;
    let bend = (12.0 * s - 6.0) * (p0 - p1) + (6.0 * s - 4.0) * m0 + (6.0 * s - 2.0) * m1;
    [value * 10.0, slope / h, bend / (h * h)]
}

/// A knot after `from` whose segment stays near the speed limit that a board would accept.
fn next_knot(rng: &mut Rng, from: &StoredKnot<2>, spacing_ms: u32, speed: i64) -> StoredKnot<2> {
    let mut next = *from;
    next.time_ms += spacing_ms;
    for cable in &mut next.cables {
        let mean = rng.between(-speed, speed);
        let way = mean * i64::from(spacing_ms) / 100;
        cable.length = TenthMicrometres((i64::from(cable.length.0) + way) as i32);
        cable.velocity = MicrometresPerSecond(rng.between(-speed, speed) as i32);
        cable.tension = Millinewtons(rng.between(0, 30_000) as i32);
    }
    next
}

pub fn rest(lengths: [i32; 2]) -> StoredKnot<2> {
    StoredKnot {
        time_ms: 0,
        last: false,
        cables: lengths.map(|length| CableKnot {
            length: TenthMicrometres(length),
            ..CableKnot::default()
        }),
        rows: [StoredRow::default(); ResidualRow::PER_KNOT],
    }
}

fn spacings(rng: &mut Rng) -> Vec<u32> {
    let mut all = vec![
        MIN_SPACING_MS,
        5,
        7,
        20,
        100,
        333,
        1000,
        1023,
        3999,
        MAX_SPACING_MS,
    ];
    all.extend((0..30).map(|_| rng.between(4, 4000) as u32));
    all
}

#[test]
fn segments_join_at_their_knots_exactly_and_without_a_jump_before_them() {
    let mut rng = Rng(1);
    for speed in [1000, 50_000, 500_000, 2_000_000] {
        for spacing_ms in spacings(&mut rng) {
            let a = next_knot(&mut rng, &rest([100_000_000, -50]), 1000, speed);
            let b = next_knot(&mut rng, &a, spacing_ms, speed);
            let segment = Segment::between(&a, &b);
            let end = u64::from(spacing_ms) << 16;
            let (first, before, last) = (segment.at(0), segment.at(end - 1), segment.at(end));
            for i in 0..2 {
                assert_eq!(first[i].length(), a.cables[i].length.0);
                assert_eq!(last[i].length(), b.cables[i].length.0);
                assert_eq!(last[i].length_q8, i64::from(b.cables[i].length.0) << 8);
                let jump = (before[i].length() - last[i].length()).abs();
                assert!(
                    jump <= 1,
                    "{spacing_ms} ms, {speed} µm/s: jumps by {jump} before the knot"
                );
            }
            let after = segment.at(end + (5 << 16));
            assert_eq!(
                after[0].length_q8, last[0].length_q8,
                "the end is not passed"
            );
            assert_eq!(
                segment.tensions(0),
                [a.cables[0].tension.0, a.cables[1].tension.0]
            );
            assert_eq!(
                segment.tensions(end),
                [b.cables[0].tension.0, b.cables[1].tension.0]
            );
        }
    }
}

/// Worst deviation from the reference: length 0.1 µm, velocity µm/s, acceleration µm/s².
fn worst(speed: i64, seed: u64) -> [f64; 3] {
    let mut rng = Rng(seed);
    let mut worst = [0.0_f64; 3];
    for spacing_ms in spacings(&mut rng) {
        let a = next_knot(&mut rng, &rest([100_000_000, 0]), 1000, speed);
        let b = next_knot(&mut rng, &a, spacing_ms, speed);
        let segment = Segment::between(&a, &b);
        for place in 0..=200_u64 {
            let elapsed_q16 = (u64::from(spacing_ms) << 16) * place / 200;
            let t_ms = elapsed_q16 as f64 / 65_536.0;
            let points = segment.at(elapsed_q16);
            for i in 0..2 {
                let truth = hermite(&a.cables[i], &b.cables[i], f64::from(spacing_ms), t_ms);
                let got = [
                    points[i].length_q8 as f64 / 256.0,
                    f64::from(points[i].velocity_umps),
                    f64::from(points[i].acceleration_umps2),
                ];
                for k in 0..3 {
                    worst[k] = worst[k].max((got[k] - truth[k]).abs());
                }
            }
        }
    }
    worst
}

#[test]
fn eq_53_is_met_within_a_fifth_of_a_micrometre_and_20_um_per_s_at_the_robots_speeds() {
    for speed in [1000, 50_000, 500_000] {
        let [length, velocity, acceleration] = worst(speed, 3);
        println!("{speed} µm/s: {length:.3} x 0.1 µm, {velocity:.2} µm/s, {acceleration:.0} µm/s²");
        assert!(length <= 2.0, "{speed}: {length} x 0.1 µm");
        assert!(velocity <= 20.0, "{speed}: {velocity} µm/s");
        assert!(acceleration <= 2000.0, "{speed}: {acceleration} µm/s²");
    }
}

#[test]
fn the_fastest_motion_that_a_configuration_allows_does_not_overflow() {
    // 20 m/s; its shortest and longest segments; the second derivative saturates at 2147 m/s².
    let [length, velocity, _] = worst(20_000_000, 4);
    assert!(length <= 40.0, "{length} x 0.1 µm");
    assert!(velocity <= 200.0, "{velocity} µm/s");
}

#[test]
fn expected_tensions_are_linear_between_knots() {
    let mut rng = Rng(8);
    for spacing_ms in spacings(&mut rng) {
        let a = next_knot(&mut rng, &rest([0, 0]), 1000, 1000);
        let b = next_knot(&mut rng, &a, spacing_ms, 1000);
        let segment = Segment::between(&a, &b);
        for place in 0..=50_u64 {
            let elapsed_q16 = (u64::from(spacing_ms) << 16) * place / 50;
            let share = elapsed_q16 as f64 / 65_536.0 / f64::from(spacing_ms);
            let tensions = segment.tensions(elapsed_q16);
            for i in 0..2 {
                let (t0, t1) = (a.cables[i].tension.0, b.cables[i].tension.0);
                let truth = f64::from(t0) + share * f64::from(t1 - t0);
                assert!((f64::from(tensions[i]) - truth).abs() <= 0.6);
            }
        }
    }
}
