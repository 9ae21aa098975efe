//! Readings of a robot with closed brakes: their means, and the motion of the platform meanwhile.
//!
//! Statics describe a platform at rest with taut cables. A platform that swings, that sinks because a
//! brake slips, or that has a slack cable, has other tensions and another position in each picture. So the
//! spread of the readings over the sensors' noise, the difference between both halves and the least
//! readings are figures of their own.
//!
//! Means are weighted with a Hann window: of a swing with more than two periods in the readings, under
//! 3 % of its amplitude are left in such a mean (Harris 1978, table 1), of one with equal weights up to 16 %.

use crate::robot::Robot;
use crate::sight::TagView;
use std::f64::consts::{SQRT_2, TAU};

/// Noise of one tension reading, N, one standard deviation: assumption, 0.02 to 0.1 N.
const NOISE_N: f64 = 0.06;
/// A cable at or under this tension counts as slack, N: the sag of a cable is not in the statics under
/// about 0.25 N, and a sensor's zero is off by 0.12 N (one standard deviation, three of them here).
const SLACK_N: f64 = 0.6;
/// So many readings at or under [`SLACK_N`] make a cable slack: one may be a disturbance.
const SLACK_READINGS: usize = 2;
/// Motion that counts as rest, peak to peak, at the tag, m.
const STILL_M: f64 = 1e-3;
/// Swing of a tension that counts as rest, peak to peak, N.
const STILL_N: f64 = 0.5;
/// Difference of a tension's mean between both halves that a platform at rest has at most, N, and
/// the share of the swing that adds to it: a part of a period counts more in one half.
const DRIFT_N: f64 = 0.15;
const DRIFT_SHARE: f64 = 0.06;
/// The same for a tag's corners, at the tag, m.
const DRIFT_M: f64 = 1e-3;
const DRIFT_SHARE_M: f64 = 0.35;
/// Share of a swing's standard deviation that its weighted mean is off by, at least: the window's highest
/// side lobe, 0.027 of the amplitude.
const LEAK_LEAST: f64 = 0.04;

/// Readings at equal times.
#[derive(Debug, Clone, Default)]
pub struct Looks {
    /// Tensions, one row a reading, N.
    pub tensions_n: Vec<Vec<f64>>,
    /// Tags, one list a picture.
    pub pictures: Vec<Vec<TagView>>,
}

/// Mean tensions, and the platform's motion while they were read.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RestReadings {
    /// Mean tensions, N.
    pub tensions_n: Vec<f64>,
    /// Standard errors of the means, N, the swing's spread included.
    pub tension_errors_n: Vec<f64>,
    /// The second-lowest reading of each tension, N.
    pub least_n: Vec<f64>,
    /// Swing of each tension over its noise, peak to peak of a sinusoid of this variance, N.
    pub swing_n: Vec<f64>,
    /// Mean of the second half minus that of the first, N.
    pub drift_n: Vec<f64>,
    /// The same swing of the corners in the pictures, at the tag, m; absent without tags.
    pub swing_m: Option<f64>,
    /// Standard error of a corner's mean coordinate by the platform's motion, px.
    pub picture_error_px: f64,
    /// Distance of the corners between the means of both halves, at the tag, m.
    pub drift_m: Option<f64>,
}

/// A cable without enough tension.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Slack {
    /// The cable, from 0.
    pub(crate) cable: usize,
    /// Its mean tension, or the least one if it is slack at times only, N.
    pub(crate) tension_n: f64,
    /// Whether its mean is slack.
    pub(crate) always: bool,
}

impl Looks {
    /// Means and motion. Tags that the robot file does not have are left out.
    #[must_use]
    pub fn rest(&self, robot: &Robot) -> RestReadings {
        let cables = self.tensions_n.first().map_or(0, Vec::len);
        let mut rest = RestReadings::default();
        let weights = taper(self.tensions_n.len());
        let noise_share: f64 = weights.iter().map(|weight| weight * weight).sum();
        let mut swings = Vec::new();
        for cable in 0..cables {
            let column = self.tensions_n.iter();
            let mut series: Vec<f64> = column.filter_map(|row| row.get(cable).copied()).collect();
            let moments = Moments::of(&series);
            rest.tensions_n.push(moments.tapered);
            swings.push(moments.swing(NOISE_N.powi(2)));
            // The sensor's noise is not a motion.
            rest.swing_n.push(swing(moments.variance - NOISE_N.powi(2)));
            rest.drift_n.push(moments.drift);
            series.sort_by(f64::total_cmp);
            let least = series.get(SLACK_READINGS - 1).or(series.first());
            rest.least_n.push(least.copied().unwrap_or(0.0));
        }
        let leak = leak(&swings);
        rest.tension_errors_n = swings
            .iter()
            .map(|swing| (NOISE_N.powi(2) * noise_share + swing.variance * leak * leak).sqrt())
            .collect();
        for tag in &robot.tags {
            let views: Vec<&TagView> = self
                .pictures
                .iter()
                .filter_map(|picture| picture.iter().find(|view| view.id == tag.id))
                .collect();
            if let Some(motion) = TagMotion::of(&views, tag.size_m) {
                let most =
                    |before: Option<f64>, now: f64| Some(before.map_or(now, |of| of.max(now)));
                rest.swing_m = most(rest.swing_m, motion.swing_m);
                rest.drift_m = most(rest.drift_m, motion.drift_m);
                rest.picture_error_px = rest.picture_error_px.max(motion.error_px);
            }
        }
        rest
    }

    /// Adds later readings.
    pub fn then(&mut self, later: Self) {
        self.tensions_n.extend(later.tensions_n);
        self.pictures.extend(later.pictures);
    }

    /// Means of all readings; motion and least tensions of the last `count` only. A picture is taken at every
    /// second reading.
    #[must_use]
    pub fn rest_of_last(&self, robot: &Robot, count: usize) -> RestReadings {
        let all = self.rest(robot);
        let mut last = self.clone();
        let before = last.tensions_n.len().saturating_sub(count);
        last.tensions_n.drain(..before);
        let before = last.pictures.len().saturating_sub(count / 2);
        last.pictures.drain(..before);
        RestReadings {
            tensions_n: all.tensions_n,
            tension_errors_n: all.tension_errors_n,
            picture_error_px: all.picture_error_px,
            ..last.rest(robot)
        }
    }

    /// The views of all tags that are in (nearly) all pictures. A tag that leaves the picture at one end
    /// of a swing would shift the mean towards the other end.
    #[must_use]
    pub fn steady_views(&self) -> Vec<TagView> {
        let steady = |view: &&TagView| {
            let with = self.pictures.iter();
            let with = with.filter(|picture| picture.iter().any(|of| of.id == view.id));
            with.count() * 10 >= self.pictures.len() * 9
        };
        let all = self.pictures.iter().flatten();
        all.filter(steady).copied().collect()
    }

    /// Whether a tag was in view in some pictures only.
    #[must_use]
    pub fn lost_tag(&self) -> bool {
        self.steady_views().is_empty() && self.pictures.iter().any(|picture| !picture.is_empty())
    }
}

impl RestReadings {
    /// Whether the platform hangs as still as it needs to.
    #[must_use]
    pub fn is_still(&self) -> bool {
        self.swing_m.is_none_or(|swing_m| swing_m <= STILL_M)
            && self.swing_n.iter().all(|swing_n| *swing_n <= STILL_N)
            && self.drift().is_none()
    }

    /// The cable with the least tension, if that is slack, with its sensor's uncertainty.
    #[must_use]
    pub(crate) fn slack(&self) -> Option<Slack> {
        let least = self.least_n.iter().zip(&self.tensions_n).enumerate();
        let (cable, (least_n, mean_n)) = least.min_by(|(_, a), (_, b)| a.0.total_cmp(b.0))?;
        let always = *mean_n <= SLACK_N;
        (*least_n <= SLACK_N).then_some(Slack {
            cable,
            tension_n: if always { *mean_n } else { *least_n },
            always,
        })
    }

    /// A motion in one direction, in words: a brake that slips, or a hand at the platform.
    #[must_use]
    pub(crate) fn drift(&self) -> Option<String> {
        let swing_n = self.swing_n.iter().copied().fold(0.0, f64::max);
        let most_n = DRIFT_SHARE.mul_add(swing_n, DRIFT_N);
        let mut rows = (1_usize..).zip(&self.drift_n);
        if let Some((cable, drift_n)) = rows.find(|(_, drift_n)| drift_n.abs() > most_n) {
            return Some(format!(
                "tension {cable} still changes, by {drift_n:.2} N in two seconds: a brake slips, or somebody holds the platform"
            ));
        }
        let most_m = DRIFT_SHARE_M.mul_add(self.swing_m.unwrap_or(0.0), DRIFT_M);
        let drift_m = self.drift_m.filter(|drift_m| *drift_m > most_m)?;
        Some(format!(
            "the platform still moves, by {:.1} mm in two seconds: a brake slips, or somebody holds the platform",
            drift_m * 1e3
        ))
    }
}

/// Weights of a Hann window over so many equidistant readings; their sum is one.
///
/// Harris, "On the use of windows for harmonic analysis with the discrete Fourier transform", 1978.
#[must_use]
pub(crate) fn taper(count: usize) -> Vec<f64> {
    let whole = count.max(1) as f64;
    let weight = |index: usize| (1.0 - libm::cos(TAU * (index as f64 + 0.5) / whole)) / whole;
    match count {
        0 | 1 => vec![1.0; count],
        _ => (0..count).map(weight).collect(),
    }
}

/// Motion in one series of readings.
struct Swing {
    /// Variance over the noise.
    variance: f64,
    /// Square of half the difference between the weighted means of both halves, over the noise.
    halves: f64,
}

/// Share of a swing's standard deviation that is left in the weighted mean of its readings, of all
/// series together, because they have the same periods. The halves show it: a mean over half the time
/// contains more of the swing than one over all of it.
fn leak(swings: &[Swing]) -> f64 {
    let sum = |of: fn(&Swing) -> f64| swings.iter().map(of).sum::<f64>();
    let (variance, halves) = (sum(|of| of.variance), sum(|of| of.halves));
    if variance <= 0.0 {
        return 1.0;
    }
    (halves / variance).sqrt().clamp(LEAK_LEAST, 1.0)
}

struct Moments {
    /// Mean with the weights of [`taper`].
    tapered: f64,
    variance: f64,
    /// Mean of the second half minus that of the first.
    drift: f64,
    /// The same with weighted means.
    tapered_drift: f64,
    count: usize,
}

impl Moments {
    fn of(series: &[f64]) -> Self {
        let mean_of = |part: &[f64]| part.iter().sum::<f64>() / part.len().max(1) as f64;
        let mean = mean_of(series);
        let squares = series.iter().map(|value| (value - mean).powi(2));
        let (first, second) = series.split_at(series.len() / 2);
        let tapered_of = |part: &[f64]| {
            let pairs = part.iter().zip(taper(part.len()));
            pairs.map(|(value, weight)| value * weight).sum::<f64>()
        };
        Self {
            tapered: tapered_of(series),
            tapered_drift: if first.is_empty() {
                0.0
            } else {
                tapered_of(second) - tapered_of(first)
            },
            count: series.len(),
            variance: squares.sum::<f64>() / series.len().max(1) as f64,
            drift: if first.is_empty() {
                0.0
            } else {
                mean_of(second) - mean_of(first)
            },
        }
    }

    /// The motion in the series, over readings with this variance of their noise.
    fn swing(&self, noise: f64) -> Swing {
        // A Hann window averages noise as two thirds of its readings do.
        let of_noise = 2.0 * noise * 1.5 / (0.5 * self.count.max(2) as f64);
        Swing {
            variance: (self.variance - noise).max(0.0),
            halves: (self.tapered_drift.powi(2) - of_noise).max(0.0) / 4.0,
        }
    }
}

/// Peak to peak of the sinusoid that has this variance.
fn swing(variance: f64) -> f64 {
    2.0 * SQRT_2 * variance.max(0.0).sqrt()
}

struct TagMotion {
    swing_m: f64,
    drift_m: f64,
    /// Standard error of a corner's weighted mean by the motion, px.
    error_px: f64,
}

impl TagMotion {
    /// Motion of a tag of this edge in the pictures; `None` with fewer than four views.
    fn of(views: &[&TagView], edge_m: f64) -> Option<Self> {
        if views.len() < 4 {
            return None;
        }
        let count = views.len() as f64;
        // Sums over both axes, means over four corners.
        let (mut variance, mut noise, mut drift, mut edge_px) = (0.0, 0.0, 0.0, 0.0);
        let sigmas_px2 = views.iter().map(|view| view.sigma_px().powi(2));
        let noise_px2 = sigmas_px2.sum::<f64>() / count;
        let mut swings = Vec::new();
        for corner in 0..4 {
            for axis in 0..2 {
                let at = |view: &&TagView| view.corners_px.get(corner)?.get(axis).copied();
                let series: Vec<f64> = views.iter().filter_map(at).collect();
                let moments = Moments::of(&series);
                swings.push(moments.swing(noise_px2));
                variance += moments.variance / 4.0;
                drift += moments.drift.powi(2) / 4.0;
            }
        }
        for view in views {
            noise += 2.0 * view.sigma_px().powi(2) / count;
            let [a, b, c, d] = view.corners_px;
            let far = |a: [f64; 2], b: [f64; 2]| libm::hypot(a[0] - b[0], a[1] - b[1]);
            edge_px += (far(a, b) + far(b, c) + far(c, d) + far(d, a)) / 4.0 / count;
        }
        // The tag's edge gives the scale at its own distance, without a camera model.
        let m_per_px = edge_m / edge_px.max(1.0);
        Some(Self {
            swing_m: swing(variance - noise) * m_per_px,
            // Noise alone moves the difference of two half means: variance 2 x noise / (count / 2).
            drift_m: (drift - 4.0 * noise / count).max(0.0).sqrt() * m_per_px,
            error_px: leak(&swings) * (0.5 * (variance - noise)).max(0.0).sqrt(),
        })
    }
}

#[cfg(test)]
mod tests;
