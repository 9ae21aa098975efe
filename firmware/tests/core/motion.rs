use crate::segment::{hermite, rest};
use mcdpr_firmware::motion::{CAPACITY, Motion, Progress};
use mcdpr_firmware::segment::{Point, StoredKnot};
use mcdpr_protocol::{MicrometresPerSecond, TenthMicrometres};

const STOP_MS: u32 = 300;
/// Cable 1 runs at 0.2 m/s throughout: its length gives the path time exactly.
const STEADY_UMPS: i32 = 200_000;

/// Position of the path after a tick, and the result of that tick.
#[derive(Clone, Copy)]
struct Sample<const N: usize> {
    points: [Point; N],
    progress: Progress,
}

fn advance(motion: &mut Motion<2>) -> Option<Sample<2>> {
    let progress = motion.tick(STOP_MS)?;
    let mut points = [Point::default(); 2];
    motion.evaluate(|cable, point, _| points[cable] = *point);
    Some(Sample { points, progress })
}

/// Cable 2 oscillates while cable 1 marks the time.
fn knots(count: u32, ends: bool) -> Vec<StoredKnot<2>> {
    (0..count)
        .map(|k| {
            let mut knot = rest([0, 0]);
            knot.time_ms = 50 * k;
            knot.cables[0].length = TenthMicrometres(50 * k as i32 * STEADY_UMPS / 100);
            knot.cables[0].velocity = MicrometresPerSecond(STEADY_UMPS);
            let phase = f64::from(k) * 0.7;
            knot.cables[1].length = TenthMicrometres((phase.sin() * 50_000.0) as i32);
            knot.cables[1].velocity = MicrometresPerSecond((phase.cos() * 70_000.0) as i32);
            knot.last = ends && k + 1 == count;
            knot
        })
        .collect()
}

fn started(knots: &[StoredKnot<2>]) -> Motion<2> {
    let mut motion = Motion::default();
    for knot in knots {
        assert!(motion.push(*knot));
    }
    motion.run(STOP_MS);
    motion
}

/// Position of cable 2 on its path at the time that cable 1 marks.
fn on_path(knots: &[StoredKnot<2>], sample: &Sample<2>) -> f64 {
    let time_ms = sample.points[0].length_q8 as f64 / 256.0 / (f64::from(STEADY_UMPS) / 100.0);
    let k = ((time_ms / 50.0) as usize).min(knots.len() - 2);
    let t = time_ms - 50.0 * k as f64;
    hermite(&knots[k].cables[1], &knots[k + 1].cables[1], 50.0, t)[0]
}

fn length(sample: &Sample<2>, cable: usize) -> f64 {
    sample.points[cable].length_q8 as f64 / 256.0
}

#[test]
fn at_full_speed_a_tick_is_a_millisecond_and_the_last_knot_is_met_exactly() {
    let path = knots(10, true);
    let mut motion = started(&path);
    for tick in 1..450 {
        let sample = advance(&mut motion).unwrap();
        assert_eq!(sample.progress, Progress::Running, "tick {tick}");
        assert_eq!(motion.path_ms(), tick);
        assert_eq!(sample.points[0].length(), tick as i32 * STEADY_UMPS / 100);
    }
    let end = advance(&mut motion).unwrap();
    assert_eq!(end.progress, Progress::Done);
    for i in 0..2 {
        assert_eq!(
            end.points[i].length_q8,
            i64::from(path[9].cables[i].length.0) << 8
        );
    }
}

#[test]
fn braking_runs_along_the_path_rests_within_the_stop_time_and_resumes_to_the_same_end() {
    let path = knots(CAPACITY as u32, true);
    for brake_at in [1, 49, 50, 137, 300] {
        let mut motion = started(&path);
        let mut last = None;
        for _ in 0..brake_at {
            last = advance(&mut motion);
        }
        let mut before = last.unwrap();
        motion.brake(STOP_MS);
        let mut ticks = 0;
        loop {
            let sample = advance(&mut motion).unwrap();
            ticks += 1;
            assert!((length(&sample, 1) - on_path(&path, &sample)).abs() <= 2.0);
            assert!(length(&sample, 0) >= length(&before, 0), "never backwards");
            before = sample;
            if sample.progress == Progress::Paused {
                break;
            }
        }
        assert!(ticks <= STOP_MS, "{ticks}");
        assert_eq!(before.points[1].velocity_umps, 0);
        // At rest it stays, to the last bit.
        let still = advance(&mut motion).unwrap();
        assert_eq!(still.points[1].length_q8, before.points[1].length_q8);
        assert!(motion.is_paused());
        motion.run(STOP_MS);
        let mut ticks = 0;
        let end = loop {
            let sample = advance(&mut motion).unwrap();
            ticks += 1;
            if sample.progress == Progress::Done {
                break sample;
            }
            assert!((length(&sample, 1) - on_path(&path, &sample)).abs() <= 2.0);
            assert!(ticks < 2000);
        };
        assert_eq!(
            end.points[1].length_q8,
            i64::from(path[15].cables[1].length.0) << 8
        );
    }
}

#[test]
fn d4_an_eased_clock_slows_as_in_a_stop_to_a_quarter_stays_on_the_path_and_comes_back() {
    let path = knots(16, true);
    let mut motion = started(&path);
    for _ in 0..50 {
        advance(&mut motion).unwrap();
    }
    let mut before = advance(&mut motion).unwrap();
    let mut rates = Vec::new();
    for tick in 0..420 {
        motion.ease(tick < 300);
        let sample = advance(&mut motion).unwrap();
        assert!((length(&sample, 1) - on_path(&path, &sample)).abs() <= 2.0);
        // Cable 1 runs at 200 mm/s of path time: 200 of 0.1 µm are a tick at full rate.
        rates.push((length(&sample, 0) - length(&before, 0)) / 2000.0);
        before = sample;
    }
    let near = |rate: f64, wanted: f64| (rate - wanted).abs() < 0.01;
    assert!(near(rates[0], 1.0 - 1.0 / 300.0), "{}", rates[0]);
    assert!(near(rates[150], 0.5), "{}", rates[150]);
    assert!(near(rates[299], 0.25), "{}", rates[299]);
    assert!(near(rates[399], 0.25 + 100.0 / 300.0), "{}", rates[399]);
    // A stop continues to rest, slowed or not.
    motion.ease(true);
    motion.brake(STOP_MS);
    let paused = (0..STOP_MS).any(|_| advance(&mut motion).unwrap().progress == Progress::Paused);
    assert!(paused);
}

#[test]
fn while_braking_velocity_and_acceleration_are_those_of_real_time() {
    let path = knots(CAPACITY as u32, true);
    let mut motion = started(&path);
    let mut samples = vec![];
    for tick in 0..500 {
        if tick == 120 {
            motion.brake(STOP_MS);
        }
        let sample = advance(&mut motion).unwrap();
        samples.push(sample);
        if sample.progress == Progress::Paused {
            break;
        }
    }
    assert!(samples.len() > 300);
    for three in samples[130..samples.len() - 1].windows(3) {
        for i in 0..2 {
            // 0.1 µm per ms is 100 µm/s.
            let velocity = (length(&three[2], i) - length(&three[0], i)) * 50.0;
            let reported = f64::from(three[1].points[i].velocity_umps);
            // The clock steps once per tick, so the velocity of a tick lags half of one.
            assert!((velocity - reported).abs() < 800.0, "{velocity} {reported}");
        }
        // The steady cable only decelerates with the clock: 0.2 m/s in 0.3 s.
        let reported = f64::from(three[1].points[0].acceleration_umps2);
        let truth = -f64::from(STEADY_UMPS) / 0.3;
        assert!(
            (reported - truth).abs() < 0.01 * truth.abs(),
            "{reported} {truth}"
        );
    }
}

#[test]
fn k6_an_empty_buffer_appends_a_stop_along_the_tangent_and_ends_at_rest() {
    let path = knots(3, false);
    let mut motion = started(&path);
    for _ in 1..100 {
        assert_eq!(advance(&mut motion).unwrap().progress, Progress::Running);
    }
    // The very tick at which the last knot is reached.
    assert_eq!(advance(&mut motion).unwrap().progress, Progress::RanEmpty);
    let from = path[2].cables;
    let mut ticks = 1;
    let end = loop {
        let sample = advance(&mut motion).unwrap();
        ticks += 1;
        // Both cables continue in the ratio of their speeds: along the tangent.
        let along = length(&sample, 0) - f64::from(from[0].length.0);
        let across = length(&sample, 1) - f64::from(from[1].length.0);
        let ratio = f64::from(from[1].velocity.0) / f64::from(from[0].velocity.0);
        assert!((across - ratio * along).abs() < 4.0);
        if sample.progress == Progress::Stopped {
            break sample;
        }
        assert_eq!(sample.progress, Progress::Running);
        let slowing = f64::from(sample.points[0].acceleration_umps2);
        let truth = -f64::from(STEADY_UMPS) / 0.3;
        assert!((slowing - truth).abs() < 0.01 * truth.abs(), "{slowing}");
        assert!(ticks <= STOP_MS + 2);
    };
    assert!(ticks <= STOP_MS + 2, "{ticks}");
    assert_eq!(end.points[0].velocity_umps, 0);
    // Half of 0.2 m/s times 0.3 s is 30 mm.
    let way = length(&end, 0) - f64::from(from[0].length.0);
    assert!((way - 300_000.0).abs() < 2500.0, "{way}");
    assert!(!motion.is_paused(), "a stop segment cannot be resumed");
    assert!(!motion.push(rest([0, 0])), "nothing joins a stop segment");
}

/// A hold during a stop segment, as the controller orders it for K6 itself, and a buffer that runs
/// empty during a hold: neither decelerates harder than a stop does.
#[test]
fn k6_a_stop_and_an_empty_buffer_together_do_not_brake_twice() {
    for brake_at in [20, 60, 99, 100, 150, 250] {
        let path = knots(3, false);
        let mut motion = started(&path);
        let mut speeds = vec![];
        let mut stopped = false;
        for tick in 1..900 {
            if tick == brake_at {
                motion.brake(STOP_MS);
            }
            let before = length_of(&motion);
            let sample = advance(&mut motion).unwrap();
            speeds.push((length(&sample, 0) - before) * 100.0);
            if matches!(sample.progress, Progress::Stopped | Progress::Paused) {
                stopped = true;
                assert_eq!(sample.points[0].velocity_umps, 0);
                assert!(
                    tick <= 100 + STOP_MS + 1,
                    "brake at {brake_at}: rest at {tick}"
                );
                break;
            }
        }
        assert!(stopped);
        let most = f64::from(STEADY_UMPS) / f64::from(STOP_MS);
        for two in speeds[1..].windows(2) {
            let slower = two[0] - two[1];
            assert!(
                slower <= 1.05 * most + 3.0,
                "brake at {brake_at}: {slower} µm/s in a tick"
            );
        }
    }
}

/// Length of cable 1 before the next tick, 0.1 µm.
fn length_of(motion: &Motion<2>) -> f64 {
    let mut copy = motion.clone();
    // A clock at rest evaluates the present position: brake at once, tick, check.
    copy.brake(1);
    advance(&mut copy).map_or(0.0, |sample| length(&sample, 0))
}

#[test]
fn k7_a_full_buffer_takes_nothing_and_loses_nothing() {
    let path = knots(CAPACITY as u32 + 1, true);
    let mut motion = Motion::<2>::default();
    for (k, knot) in path[..CAPACITY].iter().enumerate() {
        assert_eq!(usize::from(motion.free()), CAPACITY - k);
        assert!(motion.push(*knot));
    }
    assert_eq!(motion.free(), 0);
    let index = motion.next_index();
    assert!(!motion.push(path[CAPACITY]));
    assert_eq!(motion.next_index(), index);
    assert_eq!(motion.newest().unwrap().time_ms, path[CAPACITY - 1].time_ms);
    // The buffered part is run to its end.
    motion.run(STOP_MS);
    assert_eq!(
        motion.free(),
        1,
        "the first knot is the start of the segment"
    );
    let mut tick = 0;
    while advance(&mut motion).unwrap().progress == Progress::Running {
        tick += 1;
    }
    assert_eq!(tick, 50 * (CAPACITY as u32 - 1) - 1);
}

#[test]
fn k5_the_window_for_the_next_knot_never_lies_in_the_past() {
    let mut motion = started(&knots(3, false));
    assert_eq!(motion.time_window_ms(), (104, 4100));
    for _ in 0..99 {
        advance(&mut motion);
    }
    assert_eq!(motion.time_window_ms(), (104, 4100));
    let mut fresh = Motion::<2>::default();
    assert_eq!(fresh.time_window_ms(), (0, 0));
    let mut late = rest([0, 0]);
    late.time_ms = u32::MAX;
    fresh.push(late);
    assert_eq!(fresh.time_window_ms(), (u32::MAX, u32::MAX), "no overflow");
}

#[test]
fn the_buffer_says_whether_it_covers_a_stop() {
    let mut motion = started(&knots(6, false));
    // 250 ms are buffered and a stop takes 150 ms of path.
    for tick in 1..=249_u32 {
        advance(&mut motion).unwrap();
        assert_eq!(motion.covers_a_stop(STOP_MS), tick <= 100, "tick {tick}");
    }
}
