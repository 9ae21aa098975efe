//! Measuring a robot at rest.

use super::session::Sight;
use super::tracking::AtRest;
use super::{RunError, orders, stop_now};
use crate::link::client::Row;
use crate::link::{Client, Link};
use crate::sight::TagView;

/// Swing dies away in this time after a motion, s.
const CALM_S: f64 = 1.0;
/// The measurements are averaged over this time, s, a period of the slowest swing.
const MEASURE_S: f64 = 1.0;
/// Readings, and pictures, in that time.
const READINGS: u32 = 25;
/// The detector's own error of a corner, which no mean of pictures removes, px.
const DETECTOR_PX: f64 = 0.04;

/// Waits for the swing to die away, then measures. Orders are obeyed meanwhile.
pub(super) fn measure<L: Link>(
    client: &mut Client<L>,
    mut sight: Option<Sight<'_>>,
) -> Result<AtRest, RunError> {
    wait(client, CALM_S)?;
    let mut rest = AtRest::default();
    let mut corners: Vec<Corners> = Vec::new();
    let share = 1.0 / f64::from(READINGS);
    for _ in 0..READINGS {
        wait(client, MEASURE_S * share)?;
        let status = super::status(client)?;
        if let Some(record) = status.fault {
            return Err(RunError::Fault { record, why: None });
        }
        rest.lengths_m.resize(status.lengths.len(), 0.0);
        rest.tensions_n.resize(status.tensions.len(), 0.0);
        let lengths = rest.lengths_m.iter_mut().zip(status.lengths_m());
        lengths.for_each(|(sum, length_m)| *sum += length_m * share);
        let tensions = rest.tensions_n.iter_mut().zip(status.tensions_n());
        tensions.for_each(|(sum, tension_n)| *sum += tension_n * share);
        // A picture that has not arrived yet is not waited for: the board needs its host.
        if let Some(pictured) = sight.as_mut().and_then(|sight| sight.camera.poll()) {
            for view in pictured.map_err(RunError::Sight)? {
                match corners.iter_mut().find(|seen| seen.sum.id == view.id) {
                    Some(seen) => seen.add(&view),
                    None => corners.push(Corners {
                        sum: view,
                        count: 1.0,
                    }),
                }
            }
        }
    }
    rest.now_us = client.now_us();
    rest.ticks = last_ticks(client, CALM_S + MEASURE_S);
    if let Some(sight) = sight {
        rest.views = corners.into_iter().map(Corners::mean).collect();
        rest.places = sight.places.to_vec();
    }
    Ok(rest)
}

/// What the board sampled in the last `seconds`; nothing where it does not sample.
fn last_ticks<L: Link>(client: &Client<L>, seconds: f64) -> Vec<Row> {
    let mut rows = client.recent();
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "seconds"
    )]
    let ticks = (seconds * 1e3) as usize;
    rows.drain(..rows.len().saturating_sub(ticks));
    rows
}

/// Waits, s; a stop that is asked for ends it.
fn wait<L: Link>(client: &mut Client<L>, seconds: f64) -> Result<(), RunError> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a second"
    )]
    let until_us = client.now_us() + (seconds * 1e6) as u64;
    while client.now_us() < until_us {
        if let Some(kind) = orders::stop_wanted(client) {
            return Err(stop_now(client, kind));
        }
        orders::refuse_while(client, "the robot measures", false)?;
        // In slices of 40 ms: a stop waits no longer.
        let next_us = until_us.min(client.now_us() + 40_000);
        client.pump(next_us)?;
    }
    Ok(())
}

/// The corners of one tag over several pictures.
struct Corners {
    /// Sums of the corners and of their covariances.
    sum: TagView,
    count: f64,
}

impl Corners {
    fn add(&mut self, view: &TagView) {
        let corners = self.sum.corners_px.iter_mut().zip(&view.corners_px);
        for (sum, corner) in corners {
            sum[0] += corner[0];
            sum[1] += corner[1];
        }
        let covariances = self.sum.covariance_px2.iter_mut().zip(&view.covariance_px2);
        for (sum, covariance) in covariances {
            for (row, by) in sum.iter_mut().zip(covariance) {
                row[0] += by[0];
                row[1] += by[1];
            }
        }
        self.sum.image_time_us = view.image_time_us;
        self.count += 1.0;
    }

    /// The mean, with the covariance of a mean.
    fn mean(self) -> TagView {
        let Self { mut sum, count } = self;
        for corner in sum.corners_px.iter_mut().flatten() {
            *corner /= count;
        }
        for covariance in &mut sum.covariance_px2 {
            for (i, row) in covariance.iter_mut().enumerate() {
                row.iter_mut().for_each(|value| *value /= count * count);
                row[i] += DETECTOR_PX * DETECTOR_PX;
            }
        }
        sum
    }
}
