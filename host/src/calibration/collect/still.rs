//! Waits until the platform is at rest, and averages the measurements.
//!
//! Its swing is hardly damped, and drum encoders do not detect it: the pictures do. If it does not
//! decay within the waiting time, whole periods are averaged under a window that suppresses the
//! swing (Hann, 1901; see Harris, 1978), and a higher noise is stated.

use super::CollectError;
use crate::link::{Client, Event, Link};
use crate::run::{Recorder, RunError, stop_now, stop_wanted};
use crate::sight::{TagSource, TagView};

/// Swing below which the platform is at rest, m.
pub(crate) const AT_REST_M: f64 = 5e-5;
/// Time between pictures, us.
const FRAME_US: u64 = 33_333;
/// Polling interval for a picture, us.
const POLL_US: u64 = 4_000;
/// Fewest pictures, for a slow camera.
const FRAMES_MIN: usize = 3;
/// Shortest window, s.
const WINDOW_MIN_S: f64 = 0.6;
/// After this time whole periods are averaged instead of waiting on, s.
const PATIENCE_S: f64 = 4.0;
/// Swing above which averaging is useless, m.
const SWING_MAX_M: f64 = 2e-3;
/// Time after which a pose is given up, s.
const GIVE_UP_S: f64 = 25.0;
/// Whole slowest periods that are averaged over.
const PERIODS: f64 = 5.0;
/// Residual of a swing at twice its own frequency and above after the window.
const LEAK: f64 = 0.027;
/// Error that averaging does not remove (lens, print, detector), px.
pub(crate) const CORNER_FLOOR_PX: f64 = 0.03;

/// Measurements at one pose.
#[derive(Debug, Clone)]
pub struct Still {
    /// Paid-out lengths, m.
    pub lengths_m: Vec<f64>,
    /// Tensions at the winches, N.
    pub tensions_n: Vec<f64>,
    /// The tags that were in every picture.
    pub tags: Vec<MeanTag>,
    /// Roll and pitch by the inclinometer, rad; `None` without one.
    pub tilt_rad: Option<[f64; 2]>,
    /// Standard deviation of each mean coordinate, px.
    pub sigma_px: f64,
    /// Amplitude of the swing, m.
    pub swing_m: f64,
    /// Whether whole periods had to be averaged.
    pub averaged: bool,
    /// Number of pictures.
    pub frames: usize,
}

/// A tag over several pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeanTag {
    /// Its number.
    pub id: u32,
    /// Mean of its corners, px.
    pub corners_px: [[f64; 2]; 4],
}

struct Window {
    frames: Vec<Vec<TagView>>,
    /// Roll and pitch beside each picture, rad.
    tilts_rad: Vec<Option<[f64; 2]>>,
    recorder: Recorder,
}

/// The result of waiting for rest at a pose.
#[derive(Debug, Clone)]
pub enum Waited {
    /// The platform came to rest.
    Still(Still),
    /// This pose gives nothing, for this reason; others may.
    Nothing(String),
}

/// Waits for rest and measures.
///
/// # Errors
/// The link's, the camera's, an interruption.
pub fn measure<L: Link, S: TagSource>(
    client: &mut Client<L>,
    source: &mut S,
    size_m: impl Fn(u32) -> Option<f64>,
    slowest_s: f64,
) -> Result<Waited, CollectError> {
    let begun_us = client.now_us();
    // A whole period of the slowest swing: a shorter look would miss it.
    let window_s = slowest_s.max(WINDOW_MIN_S);
    loop {
        let seen = look(client, source, window_s)?;
        let waited_s = (client.now_us() - begun_us) as f64 * 1e-6;
        let ids = common(&seen.frames);
        if ids.is_empty() {
            return Ok(Waited::Nothing(nothing(&seen.frames)));
        }
        let swing_m = swing(&seen.frames, &ids, &size_m);
        if swing_m < AT_REST_M {
            return Ok(Waited::Still(mean(&seen, &ids, swing_m, false)));
        }
        if waited_s > PATIENCE_S && swing_m < SWING_MAX_M {
            let long = look(client, source, PERIODS * slowest_s)?;
            let ids = common(&long.frames);
            if ids.is_empty() {
                return Ok(Waited::Nothing(nothing(&long.frames)));
            }
            let swing_m = swing(&long.frames, &ids, &size_m);
            return Ok(Waited::Still(mean(&long, &ids, swing_m, true)));
        }
        if waited_s > GIVE_UP_S {
            return Ok(Waited::Nothing(format!(
                "the platform still swings by {:.2} mm after {waited_s:.0} s, at most {:.0} mm can be \
                 averaged: look for draught, a loose cable or a tension loop that oscillates",
                swing_m * 1e3,
                SWING_MAX_M * 1e3
            )));
        }
    }
}

/// Lengths and tensions averaged over whole periods, without a camera to detect rest.
///
/// # Errors
/// The link's, an interruption.
pub fn blind<L: Link>(client: &mut Client<L>, slowest_s: f64) -> Result<Still, CollectError> {
    let seen = look(client, &mut Blind, PERIODS * slowest_s.max(WINDOW_MIN_S))?;
    Ok(mean(&seen, &[], 0.0, true))
}

/// No camera.
struct Blind;

impl TagSource for Blind {
    fn look(&mut self) -> Result<Vec<TagView>, crate::sight::SightError> {
        Ok(Vec::new())
    }
}

fn nothing(frames: &[Vec<TagView>]) -> String {
    let seen = frames.iter().filter(|views| !views.is_empty()).count();
    if seen == 0 {
        "no known tag is in view: the robot or its tags are not where they were thought to be"
            .into()
    } else {
        format!(
            "no tag was in all {} pictures, only in {seen}",
            frames.len()
        )
    }
}

/// Takes pictures and samples for some seconds.
fn look<L: Link, S: TagSource>(
    client: &mut Client<L>,
    source: &mut S,
    seconds: f64,
) -> Result<Window, CollectError> {
    let mut out = Window {
        frames: Vec::new(),
        tilts_rad: Vec::new(),
        recorder: Recorder::default(),
    };
    // What was read on the way is not of this pose.
    source.tilt_rad()?;
    // Samples of the move before are not of this pose.
    while client.next_event().is_some() {}
    let end_us = client.now_us() + (seconds * 1e6) as u64;
    while client.now_us() < end_us || out.frames.len() < FRAMES_MIN {
        let next_us = client.now_us() + FRAME_US;
        client.pump(next_us).map_err(RunError::from)?;
        if let Some(kind) = stop_wanted(client) {
            return Err(stop_now(client, kind).into());
        }
        while let Some(event) = client.next_event() {
            if let Event::Samples(block) = event {
                out.recorder.take(&block, 0.0);
            }
        }
        if let Some(record) = client.status().and_then(|status| status.fault) {
            return Err(RunError::Fault { record, why: None }.into());
        }
        let views = loop {
            if let Some(views) = source.poll() {
                break views?;
            }
            client
                .pump(client.now_us() + POLL_US)
                .map_err(RunError::from)?;
        };
        out.frames.push(views);
        out.tilts_rad.push(source.tilt_rad()?);
    }
    Ok(out)
}

/// Tags in every picture.
fn common(frames: &[Vec<TagView>]) -> Vec<u32> {
    let Some(first) = frames.first() else {
        return Vec::new();
    };
    let all = |id: &u32| frames.iter().all(|views| views.iter().any(|v| v.id == *id));
    first.iter().map(|view| view.id).filter(all).collect()
}

fn of(views: &[TagView], id: u32) -> Option<&TagView> {
    views.iter().find(|view| view.id == id)
}

/// Amplitude of the motion in the pictures beyond their noise, m at the tags.
fn swing(frames: &[Vec<TagView>], ids: &[u32], size_m: &impl Fn(u32) -> Option<f64>) -> f64 {
    let n = frames.len() as f64;
    let (mut sum, mut count) = (0.0, 0.0);
    for &id in ids {
        let views: Vec<&TagView> = frames.iter().filter_map(|views| of(views, id)).collect();
        let (Some(first), Some(size_m)) = (views.first(), size_m(id)) else {
            continue;
        };
        let [a, b, ..] = first.corners_px;
        let px_per_m = (b[0] - a[0]).hypot(b[1] - a[1]) / size_m;
        let noise: f64 = views.iter().map(|v| v.sigma_px().powi(2)).sum::<f64>() / n;
        for corner in 0..4 {
            for axis in 0..2 {
                let values = views.iter().map(|v| v.corners_px[corner][axis]);
                let mean = values.clone().sum::<f64>() / n;
                let variance = values.map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
                // The square of a sine's amplitude is twice its variance, here without the noise's.
                sum += 2.0 * (variance - noise) / (px_per_m * px_per_m);
                count += 1.0;
            }
        }
    }
    // Both axes of a corner move: the amplitude is that of the motion's length.
    (2.0 * sum / f64::max(count, 1.0)).max(0.0).sqrt()
}

/// Weights of `n` equally spaced values, sum 1: equal, or a Hann window.
fn weights(n: usize, window: bool) -> Vec<f64> {
    let raw: Vec<f64> = (0..n)
        .map(|k| {
            if window {
                let phase = std::f64::consts::TAU * (k as f64 + 0.5) / n as f64;
                // Hann: zero at both ends, so that a part of a period left over hardly counts.
                1.0 - phase.cos()
            } else {
                1.0
            }
        })
        .collect();
    let sum: f64 = raw.iter().sum();
    raw.iter().map(|w| w / sum).collect()
}

/// Fewest readings of the inclinometer: it may be slower than the camera.
const TILTS_MIN: usize = 3;

/// Mean of the readings beside the pictures; a picture may have none.
fn mean_tilt(tilts_rad: &[Option<[f64; 2]>], frame_weights: &[f64]) -> Option<[f64; 2]> {
    let pairs = || tilts_rad.iter().zip(frame_weights);
    let known = pairs().filter_map(|(tilt, weight)| Some(((*tilt)?, weight)));
    let (mut sum, mut weights, mut count) = ([0.0; 2], 0.0, 0);
    for (tilt, weight) in known {
        for (slot, angle) in sum.iter_mut().zip(tilt) {
            *slot += weight * angle;
        }
        weights += weight;
        count += 1;
    }
    (count >= TILTS_MIN).then(|| sum.map(|s| s / weights))
}

fn mean(seen: &Window, ids: &[u32], swing_m: f64, window: bool) -> Still {
    let frame_weights = weights(seen.frames.len(), window);
    let (mut tags, mut variance, mut leak_px) = (Vec::new(), 0.0, 0.0_f64);
    for &id in ids {
        let mut corners = [[0.0; 2]; 4];
        let (mut noise, mut edge_px) = (0.0, 0.0);
        for (views, weight) in seen.frames.iter().zip(&frame_weights) {
            let Some(view) = of(views, id) else { continue };
            for (slot, value) in corners
                .iter_mut()
                .flatten()
                .zip(view.corners_px.iter().flatten())
            {
                *slot += weight * value;
            }
            noise += (weight * view.sigma_px()).powi(2);
            let [a, b, ..] = view.corners_px;
            edge_px = (b[0] - a[0]).hypot(b[1] - a[1]);
        }
        variance += noise / ids.len() as f64;
        leak_px = leak_px.max(edge_px);
        tags.push(MeanTag {
            id,
            corners_px: corners,
        });
    }
    let samples = &seen.recorder.samples;
    let sample_weights = weights(samples.len(), window);
    let cables = samples.first().map_or(0, |s| s.lengths_m.len());
    let averaged = |get: &dyn Fn(usize) -> f64| {
        let terms = sample_weights.iter().enumerate();
        terms.map(|(k, w)| w * get(k)).sum::<f64>()
    };
    let sum = |i: usize| averaged(&|k| samples[k].lengths_m[i]);
    let pull = |i: usize| averaged(&|k| samples[k].tensions_n[i]);
    // Residual of the swing: in the pictures about as much as on the tag's edge of 0.1 m.
    let left_px = if window {
        LEAK * swing_m * leak_px / 0.1
    } else {
        0.0
    };
    Still {
        lengths_m: (0..cables).map(sum).collect(),
        tensions_n: (0..cables).map(pull).collect(),
        tags,
        tilt_rad: mean_tilt(&seen.tilts_rad, &frame_weights),
        sigma_px: (variance + CORNER_FLOOR_PX.powi(2) + left_px * left_px).sqrt(),
        swing_m,
        averaged: window,
        frames: seen.frames.len(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(n: usize, swing_px: f64, hz: f64) -> Vec<Vec<TagView>> {
        let corners = [[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]];
        (0..n)
            .map(|k| {
                let t = k as f64 * FRAME_US as f64 * 1e-6;
                let off = swing_px * (std::f64::consts::TAU * hz * t + 0.4).sin();
                vec![TagView {
                    id: 7,
                    corners_px: corners.map(|[u, v]| [u + off, v]),
                    covariance_px2: [[[1e-12, 0.0], [0.0, 1e-12]]; 4],
                    image_time_us: 0,
                }]
            })
            .collect()
    }

    #[test]
    fn the_swing_is_measured_in_metres() {
        // 1 px of 1000 px/m, over two periods.
        let found = swing(&frames(60, 1.0, 1.0), &[7], &|_| Some(0.1));
        assert!((found - 1e-3).abs() < 2e-5, "{found}");
        assert!(swing(&frames(60, 0.0, 1.0), &[7], &|_| Some(0.1)) < 1e-8);
    }

    #[test]
    fn whole_periods_under_a_window_leave_less_than_stated() {
        // Five periods of the slowest swing, which here is 0.83 of the one present.
        for hz in [1.2, 1.7, 2.9] {
            let seen = Window {
                frames: frames(150, 1.0, hz),
                tilts_rad: Vec::new(),
                recorder: Recorder::default(),
            };
            let found = mean(&seen, &[7], 1e-3, true);
            let off = found.tags[0].corners_px[0][0].abs();
            assert!(off < LEAK, "{hz} Hz: {off}");
            assert!(found.sigma_px > CORNER_FLOOR_PX);
        }
    }

    #[test]
    fn the_tilt_is_the_mean_of_what_was_read() {
        let weights = weights(4, false);
        let some = [Some([0.1, 0.2]), None, Some([0.3, 0.0]), Some([0.2, 0.1])];
        let [roll, pitch] = mean_tilt(&some, &weights).unwrap();
        assert!((roll - 0.2).abs() < 1e-15 && (pitch - 0.1).abs() < 1e-15);
        // A sensor that is slower than the camera, and one that has stopped.
        let slow: Vec<_> = (0..30)
            .map(|k| (k % 10 == 9).then_some([0.1, 0.2]))
            .collect();
        let [roll, pitch] = mean_tilt(&slow, &super::weights(30, true)).unwrap();
        assert!((roll - 0.1).abs() < 1e-15 && (pitch - 0.2).abs() < 1e-15);
        assert_eq!(
            mean_tilt(&[Some([0.1, 0.2]), None, None, None], &weights),
            None
        );
    }

    #[test]
    fn only_tags_in_every_picture_count() {
        let mut frames = frames(5, 0.0, 1.0);
        frames[3].clear();
        assert!(common(&frames).is_empty());
        assert!(nothing(&frames).contains("only in 4"));
    }
}
