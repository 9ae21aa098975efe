//! Steady turns of a drum: motor current, speed, and motor against drum, on the middle of each turn, where the speed is
//! constant.

use super::{Bench, ServiceError};
use crate::link::Link;

/// Speeding up and slowing down each take this share of the time of a way.
const RAMP: f64 = 0.3;
/// Readings begin at this share of the time: until then the drive's loops have settled.
const SETTLED: f64 = 0.42;
/// Time between two looks, ms.
const LOOK_MS: u64 = 10;
/// Step of a reported current, A.
pub(super) const CURRENT_STEP_A: f64 = 1e-3;

/// The mean of one turn.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Pass {
    /// Motor current, A.
    pub current_a: f64,
    /// Speed of the motor, rpm, without a sign.
    pub rpm: f64,
    /// Reading of the tension channel, its steps.
    pub tension_adc: f64,
    /// Motor ahead of the drum, turns of the drum.
    pub gap: f64,
}

impl<L: Link> Bench<'_, L> {
    /// One turn, and the result of its stretch of constant speed.
    pub(super) fn way(
        &mut self,
        from_rad: f64,
        to_rad: f64,
        share: f64,
        same_way: bool,
    ) -> Result<Pass, ServiceError> {
        let time_s = self.begin_cruise(from_rad, to_rad, share)?;
        let start_us = self.client.now_us();
        let winch = self.described();
        let per_turn = winch.motor_counts_per_turn;
        // By the result, not by the file.
        let sign = if same_way { 1.0 } else { -1.0 };
        let drum_per_turn = f64::from(winch.encoder_counts_per_turn) * sign * per_turn.signum();
        let (mut sum, mut count) = (Pass::default(), 0.0);
        let mut ends = None;
        loop {
            self.pause(LOOK_MS)?;
            let since_s = (self.client.now_us() - start_us) as f64 * 1e-6;
            if since_s > (1.0 - RAMP) * time_s {
                break;
            }
            if since_s < SETTLED * time_s {
                continue;
            }
            let look = self.look()?;
            let motor = f64::from(look.motor_counts) / per_turn;
            sum.current_a += f64::from(look.current_ma) * 1e-3;
            sum.tension_adc += f64::from(look.tension_adc);
            sum.gap += motor - f64::from(look.drum_counts) / drum_per_turn;
            count += 1.0;
            let (first, _) = *ends.get_or_insert(((since_s, motor), (since_s, motor)));
            ends = Some((first, (since_s, motor)));
        }
        crate::run::wait_for(
            self.client,
            mcdpr_protocol::BoardState::Holding,
            time_s + 2.0,
        )?;
        let gear_ratio = self.described().gear_ratio;
        let rpm = ends.map_or(0.0, |(first, last)| {
            (last.1 - first.1) / (last.0 - first.0).max(1e-3) * 60.0 * gear_ratio
        });
        Ok(Pass {
            current_a: sum.current_a / f64::max(count, 1.0),
            rpm: rpm.abs(),
            tension_adc: sum.tension_adc / f64::max(count, 1.0),
            gap: sum.gap / f64::max(count, 1.0),
        })
    }

    /// Begins a turn of constant speed between two ramps (a cubic from rest to speed); returns its
    /// duration, s.
    fn begin_cruise(
        &mut self,
        from_rad: f64,
        to_rad: f64,
        share_of_speed: f64,
    ) -> Result<f64, ServiceError> {
        let way = to_rad - from_rad;
        let time_s = way.abs() / (share_of_speed * self.service_rad_per_s() * (1.0 - RAMP));
        // Distance after a share `x` of the ramp, as a share of speed times duration.
        let ramp = |x: f64| RAMP * (x.powi(3) - 0.5 * x.powi(4));
        let speed = |x: f64| x * x * (3.0 - 2.0 * x);
        self.send_turn((from_rad, way), time_s, |share| {
            let (far, fast) = if share < RAMP {
                (ramp(share / RAMP), speed(share / RAMP))
            } else if share > 1.0 - RAMP {
                let left = (1.0 - share) / RAMP;
                (1.0 - RAMP - ramp(left), speed(left))
            } else {
                (share - 0.5 * RAMP, 1.0)
            };
            (far / (1.0 - RAMP), fast / (1.0 - RAMP))
        })
    }
}

/// Mean of some numbers and its standard error.
pub(super) fn mean(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let values: Vec<f64> = values.collect();
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares = values
        .iter()
        .map(|value| (value - mean).powi(2))
        .sum::<f64>();
    // Standard error: s / sqrt(n), with s by n - 1.
    (mean, (squares / (count - 1.0).max(1.0) / count).sqrt())
}
